//! Ridges of tissue between branches, which a wall field adds to the wall.
//!
//! The blur of a CT hides the thin edge of a ridge, so the segmented lumen extends too far between two branches. A ridge
//! is a thin plate that continues the wall there.

use carina_grid::dot;

use crate::ScopeError;
use crate::body::distance;

/// Maximum number of ridges of a wall field: one bit of a brick's mask for each.
pub const MAX_RIDGES: usize = 32;
/// Distance from a ridge up to which it affects the field, mm; a scope is at most 7.8 mm wide.
const REACH_MM: f64 = 4.5;

/// Plate of tissue with a rounded edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ridge {
    /// Middle of the plate, LPS mm.
    pub middle: [f64; 3],
    /// Vectors from the middle to the middles of two neighbouring edges, LPS mm, perpendicular to each other.
    pub sides: [[f64; 3]; 2],
    /// Half of the thickness of the plate, mm.
    pub half_mm: f64,
}

impl Ridge {
    /// Return the distance from a point to the surface of the plate in mm, negative inside.
    fn distance_mm(&self, p: [f64; 3]) -> f64 {
        let mut off: [f64; 3] = std::array::from_fn(|a| p[a] - self.middle[a]);
        for side in self.sides {
            let share = (dot(off, side) / dot(side, side)).clamp(-1.0, 1.0);
            off = std::array::from_fn(|a| off[a] - share * side[a]);
        }
        libm::sqrt(dot(off, off)) - self.half_mm
    }

    /// Return the distance from the middle to a corner of the plate, mm.
    fn radius_mm(&self) -> f64 {
        libm::sqrt(self.sides.iter().map(|&side| dot(side, side)).sum()) + self.half_mm
    }
}

/// Ridges of a wall field, with a bit mask for each brick of the ridges near the brick.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Ridges {
    all: Vec<Ridge>,
    /// Bits of the ridges that are near each brick.
    near: Vec<u32>,
}

impl Ridges {
    /// Create ridges in a lattice of `num` bricks; `middle` returns the middle of a brick and half of its diagonal, mm.
    pub(crate) fn new(
        all: &[Ridge],
        num: usize,
        middle: impl Fn(usize) -> ([f64; 3], f64),
    ) -> Result<Self, ScopeError> {
        let refuse = |reason: String| Err(ScopeError::Wall { reason });
        if all.len() > MAX_RIDGES {
            return refuse(format!(
                "expected at most {MAX_RIDGES} ridges, found {}",
                all.len()
            ));
        }
        for ridge in all {
            let [one, other] = ridge.sides;
            let (a, b) = (dot(one, one), dot(other, other));
            let is_finite = ridge.middle.iter().all(|v| v.is_finite()) && (a + b).is_finite();
            if !(is_finite && a > 0.0 && b > 0.0) || dot(one, other).abs() > 1e-6 * (a + b) {
                return refuse("a ridge is not a plate with two perpendicular sides".to_owned());
            }
            if !(ridge.half_mm > 0.0 && ridge.half_mm.is_finite()) {
                return refuse("the thickness of a ridge is not above 0".to_owned());
            }
        }
        let near = (0..num)
            .map(|brick| {
                let (at, half_mm) = middle(brick);
                all.iter().enumerate().fold(0, |bits, (n, ridge)| {
                    let is_near =
                        distance(ridge.middle, at) <= ridge.radius_mm() + REACH_MM + half_mm;
                    bits | u32::from(is_near) << n
                })
            })
            .collect();
        Ok(Self {
            all: all.to_vec(),
            near,
        })
    }

    /// Return the minimum of `mm`, a distance to the wall, and the distance from a point in a brick to the nearest
    /// ridge.
    pub(crate) fn at_most(&self, brick: usize, p: [f64; 3], mm: f64) -> f64 {
        let (mut bits, mut least) = (self.near[brick], mm);
        while bits != 0 {
            let n = bits.trailing_zeros() as usize;
            least = least.min(self.all[n].distance_mm(p));
            bits &= bits - 1;
        }
        least
    }

    /// Call `take` with the bytes of each ridge.
    pub(crate) fn for_each_part(&self, mut take: impl FnMut(&[u8])) {
        for ridge in &self.all {
            for v in [ridge.middle, ridge.sides[0], ridge.sides[1]]
                .iter()
                .flatten()
            {
                take(&v.to_le_bytes());
            }
            take(&ridge.half_mm.to_le_bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLATE: Ridge = Ridge {
        middle: [1.0, 2.0, 3.0],
        sides: [[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        half_mm: 0.25,
    };

    #[test]
    fn the_distance_to_a_plate_is_that_to_its_face_edge_or_corner() {
        let off = |x: f64, y: f64, z: f64| PLATE.distance_mm([1.0 + x, 2.0 + y, 3.0 + z]);
        for (found, truth) in [
            (off(0.0, 0.0, 0.0), -0.25),
            (off(1.5, -0.5, 2.0), 1.75),
            (off(3.0, 0.0, 0.0), 0.75),
            (off(-5.0, 5.0, 0.0), 4.75),
            (off(2.0, -1.0, -1.0), 0.75),
        ] {
            assert!((found - truth).abs() < 1e-12, "{found} {truth}");
        }
    }

    #[test]
    fn ridges_that_are_no_plates_are_rejected() {
        let made = |ridge: Ridge| Ridges::new(&[ridge], 1, |_| ([0.0; 3], 1.0));
        assert!(made(PLATE).is_ok());
        for bad in [
            Ridge {
                half_mm: 0.0,
                ..PLATE
            },
            Ridge {
                sides: [[2.0, 0.0, 0.0], [0.0; 3]],
                ..PLATE
            },
            Ridge {
                sides: [[2.0, 0.0, 0.0], [1.0, 1.0, 0.0]],
                ..PLATE
            },
            Ridge {
                middle: [f64::NAN; 3],
                ..PLATE
            },
        ] {
            assert!(made(bad).is_err(), "{bad:?}");
        }
        assert!(Ridges::new(&[PLATE; MAX_RIDGES + 1], 1, |_| ([0.0; 3], 1.0)).is_err());
    }
}
