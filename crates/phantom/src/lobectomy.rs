//! Resection of a lobe of a phantom's lung.
//!
//! Of a lobe's airways only the stump of its bronchus remains, and neighbouring airways have moved into the free space.

use carina_grid::length;

use crate::airways::AirwayTree;
use crate::shapes::{along, sub};

/// Lobe that can be resected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(
    clippy::upper_case_acronyms,
    reason = "the names that clinicians write"
)]
pub enum Lobe {
    /// Right upper lobe.
    RUL,
    /// Middle lobe.
    RML,
    /// Right lower lobe.
    RLL,
    /// Left upper lobe, including the lingula.
    LUL,
    /// Left lower lobe.
    LLL,
}

impl Lobe {
    /// All lobes, the right lung first.
    pub const ALL: [Self; 5] = [Self::RUL, Self::RML, Self::RLL, Self::LUL, Self::LLL];

    /// Return the name of the lobe's bronchus.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::RUL => "RUL",
            Self::RML => "RML",
            Self::RLL => "RLL",
            Self::LUL => "LUL",
            Self::LLL => "LLL",
        }
    }
}

/// Length of the stump of a lobe's bronchus beyond the wall of the airway that it leaves, mm.
const STUMP_MM: f64 = 6.0;
/// Displacement of neighbouring airways, as a fraction of their distance to the lobe's hilum.
const SHIFT: f64 = 0.15;
/// Distance from the hilum over which the displacement decays, mm.
const SHIFT_REACH_MM: f64 = 80.0;
/// Distance from the midline up to which no airway moves, mm; at twice this distance the full displacement applies.
///
/// Trachea and main bronchi thus stay in place.
const MIDLINE_MM: f64 = 12.0;

impl AirwayTree {
    /// Resect a lobe: remove its airways except for the stump, and move neighbouring airways.
    ///
    /// No remaining branch has a name of the lobe; the remaining branches get new ids in the same order.
    pub(crate) fn resect(&mut self, lobe: Lobe) {
        let Some(lost) = self.named(lobe.name()) else {
            return;
        };
        let (first, middle) = (lost.id, lost.tip());
        let parent_radius = lost.parent.map_or(0.0, |p| self.branches[p].tip_radius());
        let mut is_gone = vec![false; self.branches.len()];
        for branch in &self.branches {
            is_gone[branch.id] = branch
                .parent
                .is_some_and(|parent| parent == first || is_gone[parent]);
        }
        let stump = &mut self.branches[first];
        stump.name = None;
        let mut along_mm = 0.0;
        let kept = stump
            .points
            .windows(2)
            .take_while(|w| {
                along_mm += length(sub(w[1], w[0]));
                along_mm <= parent_radius + STUMP_MM
            })
            .count()
            .max(1)
            + 1;
        stump.points.truncate(kept);
        stump.radius_mm.truncate(kept);
        for branch in &mut self.branches {
            for p in &mut branch.points {
                *p = shifted(*p, middle);
            }
        }
        let mut ids = vec![None; self.branches.len()];
        for (new, old) in (0..ids.len()).filter(|&n| !is_gone[n]).enumerate() {
            ids[old] = Some(new);
        }
        self.branches.retain(|branch| !is_gone[branch.id]);
        for branch in &mut self.branches {
            branch.id = ids[branch.id].unwrap_or(0);
            branch.parent = branch.parent.and_then(|parent| ids[parent]);
            branch.children = branch.children.iter().filter_map(|&c| ids[c]).collect();
        }
    }
}

/// Return the new position of a point of the same lung after a lobe with this hilum was resected.
fn shifted(p: [f64; 3], hilum: [f64; 3]) -> [f64; 3] {
    let side = hilum[0].signum();
    let beside = ((p[0] * side - MIDLINE_MM) / MIDLINE_MM).clamp(0.0, 1.0);
    let toward = sub(hilum, p);
    let share = SHIFT * beside * beside * (3.0 - 2.0 * beside);
    along(
        p,
        share * libm::exp(-length(toward) / SHIFT_REACH_MM),
        toward,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::variants::Variants;

    #[test]
    fn a_resected_lobe_leaves_a_stump_and_a_consistent_tree() {
        for lobe in Lobe::ALL {
            let before = AirwayTree::grow(3, 6, 110.0, Variants::default());
            let lost = before.named(lobe.name()).unwrap();
            let mut after = before.clone();
            after.resect(lobe);
            assert!(after.named(lobe.name()).is_none());
            let siblings: Vec<_> = after
                .branches
                .iter()
                .filter(|b| b.children.is_empty() && b.name.is_none() && b.wall_mm == lost.wall_mm)
                .collect();
            let [stump] = siblings[..] else {
                panic!("{lobe:?}: one stump")
            };
            assert!(stump.length_mm() < lost.length_mm().min(14.0), "{lobe:?}");
            for (n, branch) in after.branches.iter().enumerate() {
                assert_eq!(branch.id, n);
                for &child in &branch.children {
                    assert_eq!(after.branches[child].parent, Some(n));
                    assert_eq!(after.branches[child].points[0], branch.tip());
                }
            }
            // The other lung and the trachea must stay in place.
            let other = if lobe.name().starts_with('R') {
                "LB6"
            } else {
                "RB6"
            };
            assert_eq!(
                after.named(other).unwrap().points,
                before.named(other).unwrap().points
            );
            assert_eq!(after.branches[0].points, before.branches[0].points);
        }
    }
}
