//! Removal of the bias that the scanner's blur causes in the half-maximum edges of airways.
//!
//! A wall thinner than the blur shows less than its true peak, so the half-way levels are too low on both sides: the
//! lumen appears too small and the wall too thick. A section is therefore compared with the image of a round tube under
//! the scan's own blur ([`crate::section::blurred_tube`]): the tube with the measured half-maximum edges and rise from
//! lumen to wall. In the direction of a vessel or of tissue the wall rises more, and the edge there moves less.
//!
//! The blur within the slices and the blur across them are measured separately. An edge without a far side (thick
//! tissue behind it) takes 1.349 sigma from a quarter to three quarters of its rise. Edges across thick slices give
//! little information about the diameter; their weight is the fourth power of the ratio of both blurs.
//!
//! For a wall that is wide relative to the blur, the thickness follows from its half-maximum edges instead: for a flat
//! wall of thickness `w` between two equally dark sides the half-maximum thickness is `sigma * G(w / sigma)`, a known
//! function that starts at 2.355 and approaches `G(x) = x` from about 4 on (the model of Reinhardt et al. 1997).

use std::sync::LazyLock;

use carina_grid::{Grid, dot, unit};

use crate::section::blurred_tube::{Tube, normal_cdf, within_tables};
use crate::section::rays::{Cast, NUM_RAYS, direction, median, plane_axes, without_outliers};
use crate::tree::smooth::Point;

/// Number of edges below which the blur of a scan is not measured.
const MIN_EDGES: usize = 200;
/// Limits for rays that show the blur within the slices: the absolute cosine between ray and slice axis is below the
/// limit.
///
/// The first limit with `ENOUGH_EDGES` edges is used, because rays with a small slope already show the blur of thick
/// slices.
const IN_PLANE: [f64; 4] = [0.1, 0.15, 0.2, 0.35];
/// Number of edges below a limit of `IN_PLANE` that suffice to use this limit.
const ENOUGH_EDGES: usize = 1000;
/// Absolute cosine between ray and slice axis above which a ray counts for the blur across the slices.
const ACROSS: f64 = 0.8;
/// Quantile of the blurs of single edges that is used as the blur within the slices.
///
/// Not all tissue has a sharp edge, so the steeper edges show the blur.
const STEEP_SHARE: f64 = 0.3;
/// Factor by which interpolation widens an edge across the slices, which contains few values.
const WIDENED_ACROSS: f64 = 1.36;
/// Minimum accepted ratio of the blur across the slices to the blur within them.
const MIN_ACROSS: f64 = 0.8;
/// Wall thickness, as a multiple of the blur, above which the wall's half-maximum edges contribute to the measured
/// thickness.
const EDGE_WEIGHT_START: f64 = 2.2;
/// Increase of the wall thickness above the previous limit, as a multiple of the blur, over which the contribution of
/// the half-maximum edges grows to all of the measured thickness.
const EDGE_WEIGHT_RANGE: f64 = 1.2;
/// Weight of a ray below which the ray does not count for the thickness of the wall.
const CERTAIN: f64 = 0.6;
/// Number of rays on each side of a ray over which the rise of the wall is averaged.
const SMOOTHED_RAYS: usize = 2;
/// Maximum ratio of blur to radius for which the bias of the fitted tube is known.
const MAX_BLURRED: f64 = 0.8;
/// Maximum ratio of the blur across the slices to that within them, for which the bias of the fitted tube is known.
const MAX_ACROSS: f64 = 4.0;
/// Blur in pixels of a kernel that does not overshoot at edges.
const NO_RIM: f64 = 0.9;
/// Difference of the blur from `NO_RIM`, in pixels, above which a kernel overshoots clearly and the error increases.
const SHARP: f64 = 0.3;
/// Number of iterations of the fit of a blurred tube to a section.
const FITS: usize = 14;
/// Minimum wall thickness, in blurs, of a result: thinner walls have nearly the same half-maximum thickness.
const THINNEST: f64 = 0.6;

/// Blur of a CT, from the scanner, the voxels and the interpolation together; standard deviations in mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blur {
    /// Unit vector perpendicular to the slices, LPS.
    pub slice_normal: Point,
    /// Blur within a slice, as a standard deviation in mm.
    pub in_plane_mm: f64,
    /// Blur across the slices, as a standard deviation in mm.
    pub across_mm: f64,
    /// Smallest voxel spacing of the grid, mm.
    pub pixel_mm: f64,
}

/// Correction of the lumen edges of one section for the blur, with the resulting wall thickness.
#[derive(Debug, Clone, PartialEq)]
pub struct Correction {
    /// Distance by which the edge of the lumen on each ray moves outwards, mm.
    pub shift_mm: [f64; NUM_RAYS],
    /// Thickness of the wall without the blur, mm.
    pub wall_mm: f64,
    /// Half-width, as a fraction of the radius, of an interval that should contain the true radius in 95 of 100 cases,
    /// without noise.
    pub error: f64,
}

/// Properties of a section that determine the bias and the error of its fitted tube.
#[derive(Debug, Clone, Copy)]
struct Size {
    /// Ratio of the blur within the slices to the radius.
    blur_over_radius: f64,
    /// Ratio of the blurs across and within the slices minus 1, times the squared sine between airway and slice normal.
    across: f64,
    /// Blur of a kernel without overshoot (`NO_RIM`) minus this blur, in pixels; 0 for a wider blur.
    sharpness: f64,
}

impl Size {
    /// Return the bias of the fitted tube: the logarithm of the ratio of the true radius to the fitted one.
    ///
    /// A scan differs from the model: slices and pixels are boxes, values are discrete and are interpolated, and sharp
    /// kernels overshoot. The weights were fitted to painted phantoms and one painted patient (docs/decisions/0117).
    fn rest(self) -> f64 {
        let (a, k) = (self.blur_over_radius, self.sharpness);
        let within = a * a * (0.498 - 0.915 * a + 1.209 * k + 3.334 * k * k);
        (within + a * self.across * (0.273 - 0.923 * a)).clamp(-0.15, 0.25)
    }

    /// Return the error of the corrected radius ([`Correction::error`]), fitted to the data of `rest`.
    fn error(self) -> f64 {
        let (a, sharp) = (self.blur_over_radius, (self.sharpness - SHARP).max(0.0));
        0.0053 + a * a * (0.263 + 0.4 * a + 1.25 * sharp) + 0.093 * a * self.across.max(0.0).sqrt()
    }
}

impl Blur {
    /// Create a blur from its standard deviations within and across the slices of a grid.
    #[must_use]
    pub fn new(grid: &Grid, in_plane_mm: f64, across_mm: f64) -> Self {
        Self {
            slice_normal: slice_normal(grid),
            in_plane_mm,
            across_mm,
            pixel_mm: grid.min_spacing_mm(),
        }
    }

    /// Measure the blur of a scan from the rays that met thick tissue; return `None` if too few rays did.
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
                if share < IN_PLANE[IN_PLANE.len() - 1] {
                    in_plane.push((share, sigma));
                } else if share > ACROSS {
                    across.push(sigma);
                }
            }
        }
        if in_plane.len() < MIN_EDGES {
            return None;
        }
        let flat = |limit: f64| in_plane.iter().filter(move |edge| edge.0 < limit);
        let limit = IN_PLANE
            .into_iter()
            .find(|limit| flat(*limit).count() >= ENOUGH_EDGES)
            .unwrap_or(IN_PLANE[IN_PLANE.len() - 1]);
        let mut steep: Vec<f64> = flat(limit).map(|edge| edge.1).collect();
        steep.sort_by(f64::total_cmp);
        let in_plane_mm = steep[(STEEP_SHARE * steep.len() as f64) as usize];
        let spacing = grid.spacing_mm();
        let across_mm = if across.len() < MIN_EDGES {
            // Without enough edges across the slices, their blur follows from their thickness: the variance of a box is
            // its width^2 / 12.
            let widest = spacing.into_iter().fold(0.0, f64::max);
            let wider = widest * widest - grid.min_spacing_mm().powi(2);
            (in_plane_mm.powi(2) + wider / 12.0).sqrt()
        } else {
            (median(across) / WIDENED_ACROSS).max(MIN_ACROSS * in_plane_mm)
        };
        Some(Self::new(grid, in_plane_mm, across_mm))
    }

    /// Return the blur along a unit vector (LPS), as a standard deviation in mm.
    #[must_use]
    pub fn along_mm(&self, dir: Point) -> f64 {
        let share = dot(dir, self.slice_normal).powi(2).min(1.0);
        (self.in_plane_mm.powi(2) * (1.0 - share) + self.across_mm.powi(2) * share).sqrt()
    }

    /// Return a weight for the edge on each ray of a plane: 1 for a ray parallel to the slices, less for wider blur.
    #[must_use]
    pub fn weights(&self, axes: (Point, Point)) -> [f64; NUM_RAYS] {
        std::array::from_fn(|n| {
            (self.in_plane_mm / self.along_mm(direction(axes, n)))
                .min(1.0)
                .powi(4)
        })
    }

    /// Compute the correction of a section's edges for the blur.
    ///
    /// The function fits the round tube whose blurred image has the section's edges and its rise from lumen to wall.
    /// The wall is modelled as soft tissue of constant thickness. The thickness of a wall thinner than the blur follows
    /// from its rise, that of a thick wall from its half-maximum edges.
    ///
    /// `edge_mm` and `thick_mm` are the half-maximum edges and wall thicknesses of the rays (NaN where there is none).
    /// `wall_rise` is the rise of an unblurred wall above air.
    #[must_use]
    pub fn correction(
        &self,
        cast: &Cast,
        edge_mm: &[f64; NUM_RAYS],
        thick_mm: &[f64; NUM_RAYS],
        wall_rise: f64,
    ) -> Correction {
        let axes = plane_axes(cast.normal);
        let sigma = self.in_plane_mm;
        let steepest = (1.0 - dot(cast.normal, self.slice_normal).powi(2)).max(0.0);
        let ratio = (1.0 - steepest + (self.across_mm / sigma).powi(2) * steepest).sqrt();
        let turns: [f64; NUM_RAYS] = std::array::from_fn(|n| {
            let share =
                dot(direction(axes, n), self.slice_normal).abs() / steepest.sqrt().max(1e-6);
            let turn = share.min(1.0).asin() / std::f64::consts::FRAC_PI_2;
            if steepest < 1e-6 { 0.0 } else { turn }
        });
        let weights = self.weights(axes);
        let met = |n: &usize| edge_mm[*n].is_finite();
        let walled = |n: &usize| thick_mm[*n].is_finite();
        // A vessel or a fissure beside the wall increases its rise over several rays, so the rise is averaged.
        let rise: [f64; NUM_RAYS] = std::array::from_fn(|n| {
            let near =
                (0..=2 * SMOOTHED_RAYS).map(|d| (n + NUM_RAYS + d - SMOOTHED_RAYS) % NUM_RAYS);
            let near: Vec<f64> = near.filter(walled).map(|m| cast.rays[m].rise).collect();
            near.iter().sum::<f64>() / near.len() as f64 / wall_rise
        });
        let certain = |n: &usize| walled(n) && weights[*n] >= CERTAIN;
        let mut radius = weighted_mean(&weights, met, |n| edge_mm[n]) / sigma + 0.5;
        let mut shift = [0.0; NUM_RAYS];
        let mut walls = [f64::NAN; NUM_RAYS];
        for _ in 0..FITS {
            let tube = Tube::new(radius, ratio);
            for n in 0..NUM_RAYS {
                let edge = if walled(&n) {
                    let (wall, edge) = tube.wall_that_rises(rise[n], turns[n]);
                    walls[n] = wall;
                    edge
                } else {
                    tube.edge_in_tissue(turns[n])
                };
                shift[n] = within_tables(radius) - edge;
            }
            let next = weighted_mean(&weights, met, |n| edge_mm[n] / sigma + shift[n]);
            radius += 0.6 * (next - radius);
        }
        // Medians are used, because a vessel that touches a part of the wall makes it thicker there.
        let by_rise = median((0..NUM_RAYS).filter(certain).map(|n| walls[n]).collect());
        let by_edges = median(
            (0..NUM_RAYS)
                .filter(certain)
                .map(|n| true_thickness_mm(thick_mm[n], self.along_mm(direction(axes, n))))
                .collect(),
        ) / sigma;
        let edge_weight = ((by_edges - EDGE_WEIGHT_START) / EDGE_WEIGHT_RANGE).clamp(0.0, 1.0);
        let size = Size {
            blur_over_radius: radius.recip().min(MAX_BLURRED),
            across: steepest * ((self.across_mm / sigma).min(MAX_ACROSS) - 1.0),
            sharpness: (NO_RIM - sigma / self.pixel_mm).max(0.0),
        };
        let wider = radius * (size.rest().exp() - 1.0);
        Correction {
            shift_mm: shift.map(|s| sigma * (s + wider)),
            error: size.error(),
            wall_mm: sigma * (by_rise + edge_weight * (by_edges - by_rise)),
        }
    }
}

fn weighted_mean(
    weights: &[f64; NUM_RAYS],
    is_used: impl Fn(&usize) -> bool,
    value: impl Fn(usize) -> f64,
) -> f64 {
    let (mut sum, mut total) = (0.0, 0.0);
    for n in (0..NUM_RAYS).filter(is_used) {
        sum += weights[n] * value(n);
        total += weights[n];
    }
    sum / total
}

/// Return the direction in LPS of the grid axis with the widest spacing; the third axis if all are equal.
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

/// Number of table entries of `G` per unit of `w / sigma`.
const TABLE_STEPS: usize = 50;
/// Wall thickness, in blurs, above which the half-maximum thickness equals the true one.
const TABLE_END: usize = 6;

/// Table of `G(w / sigma)`, the half-maximum thickness in blurs, for thicknesses of 0 to [`TABLE_END`] blurs.
static TABLE: LazyLock<Vec<f64>> = LazyLock::new(|| {
    (0..=TABLE_STEPS * TABLE_END)
        .map(|n| half_maximum_slow((n as f64 / TABLE_STEPS as f64).max(1e-3)))
        .collect()
});

/// Compute `G`, the half-maximum thickness of a wall in blurs, by bisection on the blurred profile.
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

/// Return the half-maximum thickness in mm of a flat wall between equally dark sides, blurred by `sigma_mm`.
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

/// Return the true thickness in mm of a wall with a half-maximum thickness of `thick_mm`, at least [`THINNEST`] blurs.
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
