//! Search for the voxel outside the lumen that is nearest to each lumen voxel, limited to the lumen and its border.
//!
//! The method is the separable transform of [`crate::distance`] on runs of lumen voxels: along a line, no voxel beyond
//! the first voxel outside a run can be nearest to a voxel of the run, so only a run and its two ends matter. The
//! result for a voxel depends only on the lumen and not on a box round it, so an edited lumen gives, bit for bit, the
//! same result as an equal new lumen.

use crate::voxel_set::VoxelSet;

/// Value that marks the absence of a voxel outside the lumen, if the lumen fills the volume.
pub(crate) const NO_SITE: [u16; 3] = [u16::MAX; 3];

#[derive(Debug, Clone, Copy)]
struct Near {
    site: [u16; 3],
    squared_mm2: f64,
}

/// Value for a position of which no voxel outside the lumen is known.
const NOTHING: Near = Near {
    site: NO_SITE,
    squared_mm2: f64::INFINITY,
};

/// Return for each lumen voxel the nearest voxel outside the lumen; [`NO_SITE`] if there is none.
///
/// `voxels` are the members of `lumen` in array order. Distances are between voxel centres with `spacing_mm` along i,
/// j, k. The region beyond the volume (`shape_ijk`) is unknown, so the volume's faces are not a wall.
pub(crate) fn nearest_outside_lumen(
    lumen: &VoxelSet,
    voxels: &[[u16; 3]],
    shape_ijk: [usize; 3],
    spacing_mm: [f64; 3],
) -> Vec<[u16; 3]> {
    let mut near = vec![NOTHING; voxels.len()];
    let mut line = Line::default();
    for axis in 0..3 {
        for (first, voxel) in voxels.iter().enumerate() {
            let mut at = voxel.map(|v| v as isize);
            at[axis] -= 1;
            if lumen.holds(at) {
                continue;
            }
            // This voxel is the first of a run of lumen. The voxel outside the lumen before the run is added first.
            line.begin(outside(*voxel, axis, -1, shape_ijk));
            let mut next = Some(first as u32);
            at[axis] += 1;
            while let Some(node) = next {
                line.push(node, near[node as usize]);
                at[axis] += 1;
                next = lumen.place(at);
            }
            let last = at.map(|v| v as u16);
            line.end(((at[axis] as usize) < shape_ijk[axis]).then_some(last));
            line.solve(spacing_mm[axis], &mut near);
        }
    }
    near.into_iter().map(|n| n.site).collect()
}

fn outside(voxel: [u16; 3], axis: usize, step: i32, shape_ijk: [usize; 3]) -> Option<[u16; 3]> {
    let there = i32::from(voxel[axis]) + step;
    (there >= 0 && (there as usize) < shape_ijk[axis]).then(|| {
        let mut site = voxel;
        site[axis] = there as u16;
        site
    })
}

/// Run of lumen voxels with the voxels at its two ends, and the lower envelope of one parabola per position.
#[derive(Debug, Default)]
struct Line {
    nodes: Vec<u32>,
    /// Heights of the parabolas at all positions of the run and at one position beyond either end.
    heights: Vec<Near>,
    lowest: Vec<(usize, f64)>,
}

impl Line {
    fn begin(&mut self, site: Option<[u16; 3]>) {
        self.nodes.clear();
        self.heights.clear();
        self.heights.push(end_of_run(site));
    }

    fn push(&mut self, node: u32, near: Near) {
        self.nodes.push(node);
        self.heights.push(near);
    }

    fn end(&mut self, site: Option<[u16; 3]>) {
        self.heights.push(end_of_run(site));
    }

    fn solve(&mut self, spacing_mm: f64, near: &mut [Near]) {
        let place = |p: usize| p as f64 * spacing_mm;
        self.lowest.clear();
        for (q, height) in self.heights.iter().enumerate() {
            if !height.squared_mm2.is_finite() {
                continue;
            }
            let mut begins = f64::NEG_INFINITY;
            while let Some(&(p, p_begins)) = self.lowest.last() {
                // The intersection of the two parabolas.
                let (x, y) = (place(p), place(q));
                begins = ((height.squared_mm2 + y * y) - (self.heights[p].squared_mm2 + x * x))
                    / (2.0 * (y - x));
                if begins > p_begins {
                    break;
                }
                self.lowest.pop();
                begins = f64::NEG_INFINITY;
            }
            self.lowest.push((q, begins));
        }
        if self.lowest.is_empty() {
            return;
        }
        let mut part = 0;
        for (n, node) in self.nodes.iter().enumerate() {
            let x = place(n + 1);
            while part + 1 < self.lowest.len() && self.lowest[part + 1].1 <= x {
                part += 1;
            }
            let from = self.lowest[part].0;
            let along = x - place(from);
            near[*node as usize] = Near {
                site: self.heights[from].site,
                squared_mm2: self.heights[from].squared_mm2 + along * along,
            };
        }
    }
}

fn end_of_run(site: Option<[u16; 3]>) -> Near {
    site.map_or(NOTHING, |site| Near {
        site,
        squared_mm2: 0.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distance::VoxelBox;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_distance_to_the_nearest_site_equals_an_exhaustive_search(
            outside in prop::collection::vec(prop::bool::weighted(0.1), 5 * 6 * 7),
            spacing in prop::array::uniform3(0.3f64..3.0),
        ) {
            let voxel_box = VoxelBox { first_ijk: [0; 3], shape_ijk: [5, 6, 7] };
            let voxels: Vec<[u16; 3]> = (0..outside.len())
                .filter(|at| !outside[*at])
                .map(|at| voxel_box.voxel(at).map(|v| v as u16))
                .collect();
            let lumen = VoxelSet::new(voxel_box, voxels.iter().map(|v| v.map(|x| x as isize)));
            let found = nearest_outside_lumen(&lumen, &voxels, [5, 6, 7], spacing);
            let distance = |p: [u16; 3], q: [u16; 3]| {
                (0..3).map(|a| ((f64::from(p[a]) - f64::from(q[a])) * spacing[a]).powi(2)).sum::<f64>().sqrt()
            };
            for (voxel, site) in voxels.iter().zip(found) {
                let best = (0..outside.len())
                    .filter(|at| outside[*at])
                    .map(|at| distance(*voxel, voxel_box.voxel(at).map(|v| v as u16)))
                    .reduce(f64::min);
                match best {
                    None => prop_assert_eq!(site, NO_SITE),
                    // The tolerance of 1e-9 mm allows for the rounding of the intersections of the parabolas.
                    Some(best) => prop_assert!((distance(*voxel, site) - best).abs() < 1e-9),
                }
            }
        }
    }
}
