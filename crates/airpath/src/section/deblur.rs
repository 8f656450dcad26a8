//! What the scanner's blur does to half-maximum edges, and taking it out.
//!
//! A wall thinner than the blur shows less than its true peak, so the half-way levels are too low on both sides: the lumen
//! comes out too small and the wall too thick. For a flat wall of thickness `w` between two equally dark sides and a Gaussian
//! blur of standard deviation `sigma` the half-maximum thickness is `sigma * G(w / sigma)`, a known function that starts at
//! 2.355 and joins `G(x) = x` from about 4 on. Solved for `w` it gives the wall, and both edges move apart again by half of
//! what was added (the model of Reinhardt et al. 1997, "Accurate measurement of intrathoracic airways"). A curved edge moves
//! besides by `sigma^2 / (2 r)` towards the centre of its circle.
//!
//! The blur is the scan's own: an edge without a far side (thick tissue behind it) takes 1.349 sigma from a quarter to three
//! quarters of its rise. It is taken along the slices and across them separately.

use std::sync::LazyLock;

use carina_grid::{Grid, dot, unit};

use crate::section::rays::{Cast, NUM_RAYS, direction, median, plane_axes, without_outliers};
use crate::tree::smooth::Point;

/// Edges that the blur is taken from, at least.
const LEAST_EDGES: usize = 200;
/// Share of the slice axis in a ray's direction below and above which it counts for one of the two blurs.
const IN_PLANE: f64 = 0.35;
const ACROSS: f64 = 0.8;
/// No wall is thinner than this share of the blur: half-maximum thickness hardly tells thinner ones apart.
const THINNEST: f64 = 0.6;

/// The scanner's blur (with that of the voxels and of the interpolation), standard deviations in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blur {
    /// Unit vector across the slices.
    pub slice_normal: Point,
    /// Within a slice.
    pub in_plane_mm: f64,
    /// Across the slices.
    pub across_mm: f64,
}

/// The correction of one section.
#[derive(Debug, Clone, PartialEq)]
pub struct Correction {
    /// How far each edge of the lumen moves outwards.
    pub shift_mm: [f64; NUM_RAYS],
    /// Thickness of the wall.
    pub wall_mm: f64,
}

impl Blur {
    /// A blur of this grid.
    #[must_use]
    pub fn new(grid: &Grid, in_plane_mm: f64, across_mm: f64) -> Self {
        Self {
            slice_normal: slice_normal(grid),
            in_plane_mm,
            across_mm,
        }
    }

    /// The blur of a scan from the rays that met thick tissue; `None` where there are too few.
    #[must_use]
    pub fn of_casts(grid: &Grid, casts: &[Cast]) -> Option<Self> {
        let slice_normal = slice_normal(grid);
        let (mut in_plane, mut across) = (Vec::new(), Vec::new());
        for cast in casts {
            let axes = plane_axes(cast.normal);
            let met = without_outliers(&cast.rays);
            for (n, ray) in cast.rays.iter().enumerate() {
                let Some(sigma) = ray.sigma_mm() else {
                    continue;
                };
                if !met[n].is_finite() {
                    continue;
                }
                let share = dot(direction(axes, n), slice_normal).abs();
                if share < IN_PLANE {
                    in_plane.push(sigma);
                } else if share > ACROSS {
                    across.push(sigma);
                }
            }
        }
        if in_plane.len() < LEAST_EDGES {
            return None;
        }
        let spacing = grid.spacing_mm();
        let in_plane_mm = median(in_plane);
        let across_mm = if across.len() < LEAST_EDGES {
            // The box of a slice is wider by so much than that of a pixel: variance of a box is its width^2 / 12.
            let widest = spacing.into_iter().fold(0.0, f64::max);
            let wider = widest * widest - grid.min_spacing_mm().powi(2);
            (in_plane_mm.powi(2) + wider / 12.0).sqrt()
        } else {
            median(across)
        };
        Some(Self::new(grid, in_plane_mm, across_mm))
    }

    /// The blur along a direction.
    #[must_use]
    pub fn along_mm(&self, dir: Point) -> f64 {
        let share = dot(dir, self.slice_normal).powi(2).min(1.0);
        (self.in_plane_mm.powi(2) * (1.0 - share) + self.across_mm.powi(2) * share).sqrt()
    }

    /// The larger of both.
    #[must_use]
    pub fn mean_mm(&self) -> f64 {
        self.in_plane_mm.max(self.across_mm)
    }

    /// The correction of a section from its half-maximum thicknesses (NaN where there is no far side).
    ///
    /// The wall is taken as equally thick all round: one unknown from many rays, each with the blur of its direction.
    #[must_use]
    pub fn correction(
        &self,
        axes: (Point, Point),
        thick_mm: &[f64; NUM_RAYS],
        radius_mm: f64,
    ) -> Correction {
        let sigma: [f64; NUM_RAYS] = std::array::from_fn(|n| self.along_mm(direction(axes, n)));
        let there: Vec<usize> = (0..NUM_RAYS).filter(|&n| thick_mm[n].is_finite()).collect();
        // Medians: a vessel that lies against a part of the wall makes it thicker there.
        let wall_mm = median(
            there
                .iter()
                .map(|&n| true_thickness_mm(thick_mm[n], sigma[n]))
                .collect(),
        );
        let shift_mm = std::array::from_fn(|n| {
            let curved = sigma[n] * sigma[n] / (2.0 * radius_mm.max(2.0 * sigma[n]));
            if thick_mm[n].is_finite() {
                0.5 * (half_maximum_mm(wall_mm, sigma[n]) - wall_mm) + curved
            } else {
                curved
            }
        });
        Correction { shift_mm, wall_mm }
    }
}

/// The axis of the grid with the widest spacing; the third where all are equal.
fn slice_normal(grid: &Grid) -> Point {
    let spacing = grid.spacing_mm();
    let widest = (0..3)
        .rev()
        .reduce(|best, axis| {
            if spacing[axis] > 1.05 * spacing[best] {
                axis
            } else {
                best
            }
        })
        .unwrap_or(2);
    unit(grid.lps_from_ijk().column(widest)).unwrap_or([0.0, 0.0, 1.0])
}

/// Integral of the standard normal distribution up to `x` (Abramowitz and Stegun 7.1.26: 1.5e-7).
fn normal_cdf(x: f64) -> f64 {
    let z = x.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let series = t
        * (0.254_829_592
            + t * (-0.284_496_736
                + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let erf = 1.0 - series * (-z * z).exp();
    0.5 * (1.0 + if x < 0.0 { -erf } else { erf })
}

/// Steps of the table of `G` per unit of `w / sigma`.
const TABLE_STEPS: usize = 50;
/// From here on the blur does not matter.
const TABLE_END: usize = 6;

/// `G(w / sigma)`, half-maximum thickness in blurs, for thicknesses of 0 to [`TABLE_END`] blurs.
static TABLE: LazyLock<Vec<f64>> = LazyLock::new(|| {
    (0..=TABLE_STEPS * TABLE_END)
        .map(|n| half_maximum_slow((n as f64 / TABLE_STEPS as f64).max(1e-3)))
        .collect()
});

/// `G`, by bisection.
fn half_maximum_slow(wall: f64) -> f64 {
    let at = |x: f64| normal_cdf(x + 0.5 * wall) - normal_cdf(x - 0.5 * wall);
    let half = 0.5 * at(0.0);
    let (mut inside, mut outside) = (0.0, 0.5 * wall + 3.0);
    for _ in 0..50 {
        let middle = 0.5 * (inside + outside);
        if at(middle) > half {
            inside = middle;
        } else {
            outside = middle;
        }
    }
    inside + outside
}

/// Half-maximum thickness of a blurred flat wall between equally dark sides.
#[must_use]
pub fn half_maximum_mm(wall_mm: f64, sigma_mm: f64) -> f64 {
    let at = wall_mm / sigma_mm * TABLE_STEPS as f64;
    let before = at as usize;
    if before + 1 >= TABLE.len() {
        return wall_mm;
    }
    let share = at - before as f64;
    sigma_mm * (TABLE[before] + share * (TABLE[before + 1] - TABLE[before]))
}

/// The wall that has this half-maximum thickness, at least [`THINNEST`] blurs.
#[must_use]
pub fn true_thickness_mm(thick_mm: f64, sigma_mm: f64) -> f64 {
    let thick = thick_mm / sigma_mm;
    let after = TABLE.partition_point(|&g| g < thick);
    if after >= TABLE.len() {
        return thick_mm;
    }
    let wall = if after == 0 {
        0.0
    } else {
        let (low, high) = (TABLE[after - 1], TABLE[after]);
        (after as f64 - 1.0 + (thick - low) / (high - low)) / TABLE_STEPS as f64
    };
    sigma_mm * wall.max(THINNEST)
}
