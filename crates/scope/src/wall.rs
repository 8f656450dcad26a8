//! The lumen's wall as a signed distance: how far a point is from it, and which way is away from it.
//!
//! Distances are samples of a lattice and are read trilinearly. Only bricks of the lattice near the wall are stored: a
//! trachea and its branches are thin things in a large box.

use carina_grid::Affine;

use crate::ScopeError;

/// Cells of a brick on each axis; a brick stores one sample more, so that a cell never needs two bricks.
pub(crate) const CELLS: usize = 8;
const SIDE: usize = CELLS + 1;
pub(crate) const SAMPLES: usize = SIDE * SIDE * SIDE;
/// Distances are kept from this far outside the lumen ...
pub(crate) const OUTSIDE_MM: f64 = 2.5;
/// ... to this far inside; beyond, they say only that it is farther. No scope has such a radius.
pub(crate) const INSIDE_MM: f64 = 4.5;
const FAR_OUTSIDE: u32 = u32::MAX;
const FAR_INSIDE: u32 = u32::MAX - 1;

/// What a brick holds.
pub(crate) enum Brick {
    /// Farther than [`OUTSIDE_MM`] outside the lumen.
    Outside,
    /// Farther than [`INSIDE_MM`] from the wall.
    Inside,
    /// Samples, x fastest.
    Near(Vec<f32>),
}

impl Brick {
    /// What these samples make.
    pub(crate) fn of(samples: Vec<f32>) -> Self {
        if samples.iter().all(|&d| f64::from(d) <= -OUTSIDE_MM) {
            Self::Outside
        } else if samples.iter().all(|&d| f64::from(d) >= INSIDE_MM) {
            Self::Inside
        } else {
            Self::Near(samples)
        }
    }
}

/// Signed distance to the wall in mm, positive in the lumen.
#[derive(Debug, Clone, PartialEq)]
pub struct WallField {
    lattice_from_lps: Affine,
    lps_from_lattice: Affine,
    /// Samples along i, j, k.
    shape_ijk: [usize; 3],
    num_bricks: [usize; 3],
    brick_at: Vec<u32>,
    samples: Vec<f32>,
    /// Half the smallest distance of samples: the step of differences.
    step_mm: f64,
}

impl WallField {
    /// A field from signed distances on a grid, positive in the lumen, `[z, y, x]`, x fastest.
    pub fn from_distances(
        distance_mm: &[f32],
        shape_ijk: [usize; 3],
        lps_from_ijk: &Affine,
    ) -> Result<Self, ScopeError> {
        if distance_mm.len() != shape_ijk.iter().product::<usize>() {
            return Err(ScopeError::Wall {
                reason: format!(
                    "expected a distance for each of {shape_ijk:?} samples, found {}",
                    distance_mm.len()
                ),
            });
        }
        if let Some(at) = distance_mm.iter().position(|d| d.is_nan()) {
            return Err(ScopeError::Wall {
                reason: format!("the distance of sample {at} is not a number"),
            });
        }
        let [nx, ny, _] = shape_ijk;
        Self::build(shape_ijk, *lps_from_ijk, |first| {
            let samples: Vec<f32> = (0..SAMPLES)
                .map(|n| {
                    let local = [n % SIDE, n / SIDE % SIDE, n / SIDE / SIDE];
                    let at: [usize; 3] =
                        std::array::from_fn(|a| (first[a] + local[a]).min(shape_ijk[a] - 1));
                    clamped(distance_mm[(at[2] * ny + at[1]) * nx + at[0]])
                })
                .collect();
            Brick::of(samples)
        })
    }

    /// A field of bricks, each made from the lattice place of its first sample.
    pub(crate) fn build(
        shape_ijk: [usize; 3],
        lps_from_lattice: Affine,
        mut brick: impl FnMut([usize; 3]) -> Brick,
    ) -> Result<Self, ScopeError> {
        let Some(lattice_from_lps) = lps_from_lattice.inverse() else {
            return Err(ScopeError::Wall {
                reason: "the lattice has no volume".to_owned(),
            });
        };
        if shape_ijk.iter().any(|&n| n < 2) {
            return Err(ScopeError::Wall {
                reason: format!("expected two samples or more on each axis, found {shape_ijk:?}"),
            });
        }
        let num_bricks = shape_ijk.map(|n| (n - 1).div_ceil(CELLS));
        let mut brick_at = Vec::with_capacity(num_bricks.iter().product());
        let mut samples: Vec<f32> = Vec::new();
        for n in 0..num_bricks.iter().product::<usize>() {
            let [bx, by, _] = num_bricks;
            let first = [n % bx, n / bx % by, n / bx / by].map(|b| b * CELLS);
            brick_at.push(match brick(first) {
                Brick::Outside => FAR_OUTSIDE,
                Brick::Inside => FAR_INSIDE,
                Brick::Near(values) => {
                    samples.extend_from_slice(&values);
                    (samples.len() / SAMPLES - 1) as u32
                }
            });
        }
        if samples.is_empty() {
            return Err(ScopeError::Wall {
                reason: "the lattice contains no wall".to_owned(),
            });
        }
        let spacing = [0, 1, 2].map(|a| carina_grid::length(lps_from_lattice.column(a)));
        Ok(Self {
            lattice_from_lps,
            lps_from_lattice,
            shape_ijk,
            num_bricks,
            brick_at,
            samples,
            step_mm: 0.5 * spacing[0].min(spacing[1]).min(spacing[2]),
        })
    }

    /// Where the lattice lies.
    #[must_use]
    pub const fn lps_from_lattice(&self) -> &Affine {
        &self.lps_from_lattice
    }

    /// Memory of the samples.
    #[must_use]
    pub const fn num_bytes(&self) -> usize {
        self.samples.len() * size_of::<f32>()
    }

    /// All that it holds, as bytes one after the other: equal fields give equal bytes.
    pub fn for_each_part(&self, mut take: impl FnMut(&[u8])) {
        for row in self.lps_from_lattice.rows() {
            for v in row {
                take(&v.to_le_bytes());
            }
        }
        for n in self.shape_ijk {
            take(&(n as u64).to_le_bytes());
        }
        let mut piece = Vec::new();
        for brick in &self.brick_at {
            piece.extend_from_slice(&brick.to_le_bytes());
        }
        take(&piece);
        for brick in self.samples.chunks(SAMPLES) {
            piece.clear();
            for v in brick {
                piece.extend_from_slice(&v.to_le_bytes());
            }
            take(&piece);
        }
    }

    /// Distance to the wall, positive in the lumen. It ends at -2.5 mm outside (also beyond the lattice, and for a point
    /// that is no number) and at 4.5 mm inside.
    #[must_use]
    pub fn distance_mm(&self, p_lps: [f64; 3]) -> f64 {
        let at = self.lattice_from_lps.point(p_lps);
        let mut cell = [0usize; 3];
        let mut share = [0.0; 3];
        for a in 0..3 {
            // Written so that a NaN is outside.
            if !(at[a] >= 0.0 && at[a] <= (self.shape_ijk[a] - 1) as f64) {
                return -OUTSIDE_MM;
            }
            cell[a] = (at[a] as usize).min(self.shape_ijk[a] - 2);
            share[a] = at[a] - cell[a] as f64;
        }
        let b = cell.map(|c| c / CELLS);
        let brick = self.brick_at[(b[2] * self.num_bricks[1] + b[1]) * self.num_bricks[0] + b[0]];
        if brick >= FAR_INSIDE {
            return if brick == FAR_INSIDE {
                INSIDE_MM
            } else {
                -OUTSIDE_MM
            };
        }
        let local: [usize; 3] = std::array::from_fn(|a| cell[a] - b[a] * CELLS);
        let first = brick as usize * SAMPLES + (local[2] * SIDE + local[1]) * SIDE + local[0];
        let value = |offset: usize| f64::from(self.samples[first + offset]);
        let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
        let row = |offset: usize| mix(value(offset), value(offset + 1), share[0]);
        let plane = |offset: usize| mix(row(offset), row(offset + SIDE), share[1]);
        mix(plane(0), plane(SIDE * SIDE), share[2])
    }

    /// Which way the distance grows, unit length; `None` where it is the same all round.
    #[must_use]
    pub fn away_from_wall(&self, p_lps: [f64; 3]) -> Option<[f64; 3]> {
        let h = self.step_mm;
        let slope: [f64; 3] = std::array::from_fn(|a| {
            let (mut low, mut high) = (p_lps, p_lps);
            low[a] -= h;
            high[a] += h;
            self.distance_mm(high) - self.distance_mm(low)
        });
        carina_grid::unit(slope)
    }

    /// The nearest place with at least `clearance_mm` to the wall that steps away from the wall lead to.
    #[must_use]
    pub fn freed(&self, p_lps: [f64; 3], clearance_mm: f64) -> Option<[f64; 3]> {
        let mut p = p_lps;
        for _ in 0..64 {
            let lack = clearance_mm - self.distance_mm(p);
            if lack <= 0.0 {
                return Some(p);
            }
            let away = self.away_from_wall(p)?;
            p = std::array::from_fn(|a| p[a] + lack.max(0.05) * away[a]);
        }
        None
    }
}

pub(crate) fn clamped(distance_mm: f32) -> f32 {
    distance_mm.clamp(-OUTSIDE_MM as f32, INSIDE_MM as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use carina_grid::length;

    /// A tube along z, on anisotropic samples that are turned by 30 degrees.
    fn tube(radius: f64) -> WallField {
        let (s, c) = (0.5, libm::sqrt(0.75));
        let lps = Affine::from_columns(
            [0.5 * c, 0.5 * s, 0.0],
            [-0.6 * s, 0.6 * c, 0.0],
            [0.0, 0.0, 0.9],
            [-8.0, -14.0, -20.0],
        );
        let shape = [50, 44, 45];
        let distances: Vec<f32> = (0..shape.iter().product::<usize>())
            .map(|n| {
                let p = lps.point([(n % 50) as f64, (n / 50 % 44) as f64, (n / 50 / 44) as f64]);
                (radius - libm::hypot(p[0], p[1])) as f32
            })
            .collect();
        WallField::from_distances(&distances, shape, &lps).unwrap()
    }

    #[test]
    fn the_distance_in_a_tube_is_its_radius_less_that_from_its_axis() {
        let field = tube(4.0);
        for (x, y) in [(1.5, 0.3), (-2.0, 1.9), (3.2, -2.0), (3.5, 3.0)] {
            let truth = 4.0 - libm::hypot(x, y);
            let found = field.distance_mm([x, y, 1.3]);
            // h^2 / (8 r) for samples 0.6 mm apart and a radius of curvature of 1.5 mm.
            assert!((found - truth).abs() < 0.03, "{found} {truth}");
            let away = field.away_from_wall([x, y, 1.3]).unwrap();
            let inwards = [-x, -y, 0.0].map(|v| v / libm::hypot(x, y));
            assert!(length(std::array::from_fn(|a| away[a] - inwards[a])) < 0.1);
        }
    }

    #[test]
    fn outside_the_lattice_and_at_no_number_it_is_outside_the_lumen() {
        let field = tube(4.0);
        assert_eq!(field.distance_mm([0.0, 0.0, 900.0]), -OUTSIDE_MM);
        assert_eq!(field.distance_mm([f64::NAN, 0.0, 0.0]), -OUTSIDE_MM);
        assert!(field.away_from_wall([0.0, 0.0, 900.0]).is_none());
    }

    #[test]
    fn a_point_in_the_wall_is_freed_and_one_without_room_is_not() {
        let field = tube(4.0);
        let freed = field.freed([4.8, 0.5, 0.0], 2.0).unwrap();
        assert!(field.distance_mm(freed) >= 2.0);
        assert!(field.freed([4.8, 0.5, 0.0], 5.0).is_none());
    }

    #[test]
    fn distances_that_are_no_numbers_or_too_few_are_refused() {
        assert!(WallField::from_distances(&[1.0; 7], [2, 2, 2], &Affine::IDENTITY).is_err());
        assert!(WallField::from_distances(&[f32::NAN; 8], [2, 2, 2], &Affine::IDENTITY).is_err());
        assert!(WallField::from_distances(&[-9.0; 8], [2, 2, 2], &Affine::IDENTITY).is_err());
    }
}
