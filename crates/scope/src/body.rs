//! The scope's sizes, and which points of its tip feel for the wall.

use carina_grid::{dot, length};

use crate::ScopeError;
use crate::wall::WallField;

/// Distance of the nodes of the scope's axis.
pub(crate) const NODE_MM: f64 = 2.0;
/// Radius of the rounded edge of the tip's face.
const EDGE_MM: f64 = 0.6;
/// Balls of a ring round the tip's edge and sides.
const NUM_ROUND: usize = 20;

/// Sizes of a scope. Lengths in mm, angles in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScopeBody {
    /// Radius of the rigid tip and of the bending section.
    pub tip_radius_mm: f64,
    /// Radius of the insertion tube.
    pub tube_radius_mm: f64,
    /// Length of the rigid tip.
    pub rigid_mm: f64,
    /// Length of the bending section.
    pub bending_mm: f64,
    /// Greatest flexion upwards.
    pub up_rad: f64,
    /// Greatest flexion downwards, positive.
    pub down_rad: f64,
    /// Working length.
    pub length_mm: f64,
}

impl ScopeBody {
    /// Refuses sizes that are no scope.
    pub fn checked(self) -> Result<Self, ScopeError> {
        let within = |what: &str, value: f64, low: f64, high: f64| {
            if (low..=high).contains(&value) {
                return Ok(());
            }
            Err(ScopeError::Scope {
                reason: format!("expected {what} from {low} to {high}, found {value}"),
            })
        };
        // A tip that is twice as wide as the edge of its face is round; 3.9 is less than half of what the field knows.
        within("a tip radius (mm)", self.tip_radius_mm, 0.7, 3.9)?;
        within("a tube radius (mm)", self.tube_radius_mm, 0.5, 3.9)?;
        within("a rigid tip (mm)", self.rigid_mm, 2.0, 20.0)?;
        within("a bending section (mm)", self.bending_mm, 10.0, 100.0)?;
        within("a flexion upwards (rad)", self.up_rad, 0.0, 4.0)?;
        within("a flexion downwards (rad)", self.down_rad, 0.0, 4.0)?;
        within("a working length (mm)", self.length_mm, 100.0, 1000.0)?;
        Ok(self)
    }

    pub(crate) fn rigid_nodes(&self) -> usize {
        ((self.rigid_mm / NODE_MM).round() as usize).max(1)
    }

    pub(crate) fn bending_nodes(&self) -> usize {
        ((self.bending_mm / NODE_MM).round() as usize).max(2)
    }

    /// Radius of the scope at a distance behind the face.
    pub(crate) fn radius_mm(&self, behind_mm: f64) -> f64 {
        if behind_mm < (self.rigid_nodes() + self.bending_nodes()) as f64 * NODE_MM {
            self.tip_radius_mm
        } else {
            self.tube_radius_mm
        }
    }
}

/// A ball of the tip: its centre in the tip's frame (right, down, forward; the face's centre is the origin) and radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Feeler {
    pub(crate) at: [f64; 3],
    pub(crate) radius: f64,
}

/// The balls that stand for the rigid tip: a cylinder with a flat face and a rounded edge.
pub(crate) fn feelers(body: &ScopeBody) -> Vec<Feeler> {
    let r = body.tip_radius_mm;
    let edge = EDGE_MM.min(0.5 * r);
    let mut all = vec![Feeler {
        at: [0.0, 0.0, -edge],
        radius: edge,
    }];
    let mut ring = |across: f64, behind: f64, num: usize, shift: f64| {
        for n in 0..num {
            let turn = core::f64::consts::TAU * (n as f64 + shift) / num as f64;
            all.push(Feeler {
                at: [across * libm::cos(turn), across * libm::sin(turn), -behind],
                radius: edge,
            });
        }
    };
    ring(0.5 * (r - edge), edge, NUM_ROUND / 2, 0.0);
    // Rings stand on gap, so that the gaps between balls are small.
    let levels = ((r - edge) / 0.5).ceil() as usize;
    for level in 0..=levels {
        let behind = edge + (r - edge) * level as f64 / (levels + 1) as f64;
        ring(r - edge, behind, NUM_ROUND, 0.5 * (level % 2) as f64);
    }
    // Behind that the cylinder is the balls on its axis.
    let mut behind = r;
    while behind < body.rigid_mm {
        all.push(Feeler {
            at: [0.0, 0.0, -behind],
            radius: r,
        });
        behind += 1.0;
    }
    all
}

/// A tip in space: the face's centre and unit axes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tip {
    pub(crate) at: [f64; 3],
    pub(crate) right: [f64; 3],
    pub(crate) down: [f64; 3],
    pub(crate) forward: [f64; 3],
}

impl Tip {
    pub(crate) fn place(&self, f: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|a| {
            self.at[a] + f[0] * self.right[a] + f[1] * self.down[a] + f[2] * self.forward[a]
        })
    }
}

/// The plane through which the scope enters; what lies behind it is not looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Entry {
    pub(crate) at: [f64; 3],
    pub(crate) into: [f64; 3],
}

impl Entry {
    pub(crate) fn depth_mm(&self, p: [f64; 3]) -> f64 {
        dot(std::array::from_fn(|a| p[a] - self.at[a]), self.into)
    }
}

/// Least clearance of the tip's balls, and where in the tip's frame and in space.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Clearance {
    pub(crate) mm: f64,
    pub(crate) at_lps: [f64; 3],
    pub(crate) in_tip: [f64; 3],
}

pub(crate) fn tip_clearance(
    field: &WallField,
    feelers: &[Feeler],
    tip: &Tip,
    entry: &Entry,
) -> Clearance {
    let mut least = Clearance {
        mm: f64::INFINITY,
        at_lps: tip.at,
        in_tip: [0.0; 3],
    };
    // With room for a ball round the face and what is behind it, no ball of the face can touch.
    let r = feelers.last().map_or(0.0, |f| f.radius);
    let is_clear = entry.depth_mm(tip.at) >= 0.0
        && field.distance_mm(tip.place([0.0, 0.0, -0.5 * r])) > 1.2 * r + 1.0;
    let skipped = if is_clear {
        feelers.iter().position(|f| f.radius == r).unwrap_or(0)
    } else {
        0
    };
    for feeler in &feelers[skipped..] {
        let p = tip.place(feeler.at);
        if entry.depth_mm(p) < 0.0 {
            continue;
        }
        let mm = field.distance_mm(p) - feeler.radius;
        if mm < least.mm {
            least = Clearance {
                mm,
                at_lps: p,
                in_tip: feeler.at,
            };
        }
    }
    least
}

pub(crate) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    length(std::array::from_fn(|k| a[k] - b[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const BODY: ScopeBody = ScopeBody {
        tip_radius_mm: 2.45,
        tube_radius_mm: 2.45,
        rigid_mm: 10.0,
        bending_mm: 40.0,
        up_rad: 3.1,
        down_rad: 2.27,
        length_mm: 600.0,
    };

    #[test]
    fn the_balls_fill_the_tip_to_its_face_and_nowhere_stick_out() {
        let all = feelers(&BODY);
        for f in &all {
            assert!(libm::hypot(f.at[0], f.at[1]) + f.radius <= 2.45 + 1e-12);
            assert!(f.at[2] + f.radius <= 1e-12);
        }
        // Any point of the cylinder's side behind the rounded edge is near a ball: a spike could sink in by 0.12 mm, a wall cannot.
        for n in 0..3600 {
            let turn = f64::from(n) * 0.1;
            let z = -0.6 - 8.0 * f64::from(n % 97) / 97.0;
            let p = [2.45 * libm::cos(turn), 2.45 * libm::sin(turn), z];
            let gap = all
                .iter()
                .map(|f| distance(p, f.at) - f.radius)
                .fold(f64::INFINITY, f64::min);
            assert!(gap < 0.12, "{gap} at {p:?}");
        }
    }

    #[test]
    fn a_scope_of_impossible_sizes_is_refused() {
        assert!(BODY.checked().is_ok());
        assert!(
            ScopeBody {
                tip_radius_mm: f64::NAN,
                ..BODY
            }
            .checked()
            .is_err()
        );
        assert!(
            ScopeBody {
                bending_mm: 0.0,
                ..BODY
            }
            .checked()
            .is_err()
        );
    }
}
