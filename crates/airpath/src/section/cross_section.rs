//! Cross-sections of an airway, perpendicular to its centreline: lumen area, diameters and wall thickness with their
//! errors.
//!
//! Rays start at the centre, in the plane. Along each ray the values are interpolated between the voxels (Catmull-Rom),
//! and the lumen's lowest value and the wall's first peak are found. The edge of the lumen is where the profile is
//! half-way between them (full width at half maximum: Reinhardt et al. 1997; Nakano et al. 2000). The wall ends
//! half-way between its peak and the lowest value behind it. A ray whose wall has no far side (a vessel or the
//! mediastinum touches it) does not count for the wall's thickness. Then the plane's centre moves to the centre of the
//! lumen found, and the rays are cast again.
//!
//! Half-maximum edges of thin walls are biased, and [`crate::section::deblur`] removes the known part of the bias. This
//! module finds the raw edges and computes measurements from the corrected ones.

use carina_grid::{Grid, Lps, VolumeView, length};
use rayon::prelude::*;

use crate::section::deblur::Blur;
use crate::section::profile::{Edges, Profile, SectionLevels, WALL_REACH_MM, edges_of};
use crate::section::rays::{
    Cast, NUM_RAYS, angle, centroid, direction, filled, median, plane_axes, share_of,
    without_outliers,
};
use crate::tree::smooth::Point;
use carina_leastcost::{TrackError, Watch};

/// Minimum fraction of rays that must show the far side of the wall; with fewer, no wall thickness is reported.
pub const MIN_WALL_SHARE: f64 = 0.3;
/// Maximum thickness of an airway's wall, mm; a larger measured thickness includes tissue that touches the wall.
pub const THICKEST_WALL_MM: f64 = 3.0;
/// Distance between the centre of the rays and that of the lumen found, in voxels, below which no further cast is
/// needed.
const CENTRED_VOX: f64 = 0.1;
/// Maximum number of times that the rays of a plane are cast, even if the centre still moves.
const MAX_CASTS: usize = 4;
/// Number of planes between two checks of the watch.
///
/// The number is small, so that a picture that waits for the computation is delayed by some milliseconds at most.
const PLANES_PER_CHECK: usize = 16;
/// Standard deviation of one edge due to interpolation and step length, in voxels.
const EDGE_VOX: f64 = 0.1;
/// Half of the width of a 95 % interval, in standard deviations.
const HALF_95: f64 = 1.96;
/// Error of a radius if the blur of the CT is not known, as a fraction of the radius.
const UNKNOWN_BLUR: f64 = 0.2;
/// Ratio of the wall thickness's error to the radius's error, both due to the blur model.
const WALL_BY_MODEL: f64 = 2.0;
/// Weight of a ray's edge from which the edge counts fully for the smallest and the largest width of a section.
const SHAPE_WEIGHT: f64 = 0.5;
/// Error of the measured wall thickness because the wall is modelled as flat and of constant thickness, in standard
/// deviations of the blur.
const WALL_BY_BLUR: f64 = 0.4;

/// Plane of a cross-section: a point in the lumen and the direction of the airway.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Point well inside the lumen, LPS mm.
    pub centre: Point,
    /// Unit vector along the airway, LPS, perpendicular to the plane.
    pub normal: Point,
    /// Approximate distance to the wall, mm; it determines the length of the rays ([`reach_mm`]).
    pub radius_mm: f64,
}

/// Measurements of one cross-section of an airway.
///
/// Lengths are in mm. A measurement without a value is NaN.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// Centre of the area of the lumen, in the plane, LPS mm.
    pub centre: Point,
    /// Area of the lumen in the plane, mm^2.
    pub area_mm2: f64,
    /// Diameter of the circle with the area of the lumen, mm.
    pub equivalent_mm: f64,
    /// Smallest width in mm of the lumen through its centre.
    pub min_mm: f64,
    /// Largest width in mm of the lumen through its centre.
    pub max_mm: f64,
    /// Thickness of the wall, from the rays that show the wall's far side, mm.
    pub wall_mm: f64,
    /// Mean distance by which the blur correction moved the edges outwards from the half-maximum, mm.
    pub shift_mm: f64,
    /// Half-width of the 95 % interval of `equivalent_mm`, mm; see [`Section::set_errors`].
    pub equivalent_error_mm: f64,
    /// Half-width of the 95 % interval of `min_mm` and of `max_mm`, mm.
    pub width_error_mm: f64,
    /// Half-width of the 95 % interval of `wall_mm`, mm.
    pub wall_error_mm: f64,
    /// Fraction of rays that met a wall, 0 to 1.
    pub share: f64,
    /// Fraction of rays that show the far side of the wall, 0 to 1.
    pub wall_share: f64,
    /// Fraction of rays that left the volume before they met a wall, 0 to 1.
    pub left_share: f64,
    /// Distance of the lumen's edge from `centre` along each ray, mm; NaN where no edge was found.
    pub edge_mm: [f64; NUM_RAYS],
    /// Distance of the wall's outer edge from `centre` along each ray, mm; NaN where no edge was found.
    pub outer_mm: [f64; NUM_RAYS],
}

/// Return the distance up to which a ray searches for the lumen's edge, mm.
///
/// The distance is 3 radii, for a lumen three times as wide as high, and 3 voxels.
#[must_use]
pub fn reach_mm(radius_mm: f64, voxel_mm: f64) -> f64 {
    3.0 * radius_mm + 3.0 * voxel_mm
}

/// Return the root mean square, over the rays of a plane, of the size of a voxel along the ray, mm.
#[must_use]
pub fn voxel_in_plane_mm(grid: &Grid, axes: (Point, Point)) -> f64 {
    let square: f64 = (0..NUM_RAYS)
        .map(|n| length(grid.ijk_from_lps().vector(direction(axes, n))).powi(-2))
        .sum();
    (square / NUM_RAYS as f64).sqrt()
}

/// Cast the rays of many planes on all cores; the result does not depend on the number of cores.
///
/// # Errors
///
/// Returns an error if `watch` stops the computation.
pub fn cast_planes(
    values: VolumeView<'_, i16>,
    planes: &[Plane],
    levels: SectionLevels,
    watch: &impl Watch,
) -> Result<Vec<Cast>, TrackError> {
    let mut sections = Vec::with_capacity(planes.len());
    for (n, chunk) in planes.chunks(PLANES_PER_CHECK).enumerate() {
        watch.report_fraction((n * PLANES_PER_CHECK) as f64 / planes.len() as f64)?;
        let found: Vec<Cast> = chunk
            .par_iter()
            .map(|plane| cast_plane(values, *plane, levels))
            .collect();
        sections.extend(found);
    }
    Ok(sections)
}

/// Cast the rays of one plane, after the plane's centre has moved to the centre of the lumen.
#[must_use]
pub fn cast_plane(values: VolumeView<'_, i16>, plane: Plane, levels: SectionLevels) -> Cast {
    let axes = plane_axes(plane.normal);
    let centred_mm = CENTRED_VOX * values.grid().min_spacing_mm();
    let mut centre = plane.centre;
    let mut rays = cast(values, centre, axes, plane.radius_mm, levels);
    for _ in 1..MAX_CASTS {
        let Some(contour) = filled(&without_outliers(&rays)) else {
            break;
        };
        let [u, v] = centroid(&contour);
        let far_mm = u.hypot(v);
        if far_mm <= centred_mm {
            break;
        }
        // A hole in the contour can move the centre out of the lumen, so the centre moves by at most half a radius per
        // cast.
        let share = (0.5 * plane.radius_mm / far_mm).min(1.0);
        let next: Point =
            std::array::from_fn(|a| centre[a] + share * (u * axes.0[a] + v * axes.1[a]));
        let cast_again = cast(values, next, axes, plane.radius_mm, levels);
        // If fewer rays meet a wall than before, the centre has moved into a neighbouring airway; the previous cast is
        // used.
        if share_met(&cast_again) + 0.05 < share_met(&rays) {
            break;
        }
        (centre, rays) = (next, cast_again);
    }
    Cast {
        centre,
        normal: plane.normal,
        rays,
    }
}

fn cast(
    values: VolumeView<'_, i16>,
    centre: Point,
    (across, up): (Point, Point),
    radius_mm: f64,
    levels: SectionLevels,
) -> [Edges; NUM_RAYS] {
    let voxel_mm = values.grid().min_spacing_mm();
    let step_mm = (0.25 * voxel_mm).clamp(0.05, 0.3);
    let reach_mm = reach_mm(radius_mm, voxel_mm);
    let from = values.grid().to_ijk(Lps(centre)).0;
    let mut profile = Profile::default();
    std::array::from_fn(|n| {
        let dir = direction((across, up), n);
        let dir_ijk = values.grid().ijk_from_lps().vector(dir);
        profile.read(values, from, dir_ijk, step_mm, reach_mm + WALL_REACH_MM);
        edges_of(&profile, reach_mm, levels)
    })
}

/// Move each edge towards the circle of the section as far as the blur in its direction makes it uncertain.
///
/// Thick slices do not show the shape of an airway across them. The circle has the weighted mean area of all edges.
fn rounded_across(edge_mm: &[f64; NUM_RAYS], weights: &[f64; NUM_RAYS]) -> [f64; NUM_RAYS] {
    let (mut square, mut total) = (0.0, 0.0);
    for n in (0..NUM_RAYS).filter(|n| edge_mm[*n].is_finite()) {
        square += weights[n] * edge_mm[n].powi(2);
        total += weights[n];
    }
    let circle_mm = (square / total).sqrt();
    std::array::from_fn(|n| circle_mm + weights[n] * (edge_mm[n] - circle_mm))
}

fn share_met(rays: &[Edges; NUM_RAYS]) -> f64 {
    rays.iter().filter(|r| r.inner_mm.is_some()).count() as f64 / NUM_RAYS as f64
}

impl Section {
    /// Compute the measurements of a section from a cast, with edges corrected for `blur` (`None`: half-maximum edges).
    ///
    /// `voxel_mm` is the size of a voxel in the plane.
    #[must_use]
    pub fn of_cast(cast: &Cast, blur: Option<&Blur>, voxel_mm: f64, levels: SectionLevels) -> Self {
        let noise = f64::from(levels.noise);
        let axes = plane_axes(cast.normal);
        let raw_mm = without_outliers(&cast.rays);
        let thick_mm: [f64; NUM_RAYS] = std::array::from_fn(|n| {
            let thick = cast.rays[n].outer_mm.unwrap_or(f64::NAN) - raw_mm[n];
            if thick <= THICKEST_WALL_MM {
                thick
            } else {
                f64::NAN
            }
        });
        let correction =
            blur.map(|b| b.correction(cast, &raw_mm, &thick_mm, f64::from(levels.wall_rise)));
        let shift: [f64; NUM_RAYS] =
            std::array::from_fn(|n| correction.as_ref().map_or(0.0, |c| c.shift_mm[n]));
        let weights = blur.map_or([1.0; NUM_RAYS], |b| b.weights(axes));
        let moved_mm = std::array::from_fn(|n| raw_mm[n] + shift[n]);
        let edge_mm = rounded_across(&moved_mm, &weights);
        // A width depends on single directions, so it uses the measured edges except where blur makes them uncertain.
        let shape_mm = rounded_across(&moved_mm, &weights.map(|w| (w / SHAPE_WEIGHT).min(1.0)));
        let mut section = Self {
            centre: cast.centre,
            area_mm2: f64::NAN,
            equivalent_mm: f64::NAN,
            min_mm: f64::NAN,
            max_mm: f64::NAN,
            wall_mm: f64::NAN,
            shift_mm: f64::NAN,
            equivalent_error_mm: f64::NAN,
            width_error_mm: f64::NAN,
            wall_error_mm: f64::NAN,
            share: share_of(&raw_mm),
            wall_share: share_of(&thick_mm),
            left_share: cast.rays.iter().filter(|r| r.left_volume).count() as f64 / NUM_RAYS as f64,
            edge_mm,
            outer_mm: [f64::NAN; NUM_RAYS],
        };
        let Some(contour) = filled(&edge_mm) else {
            return section;
        };
        section.area_mm2 = 0.5 * std::f64::consts::TAU / NUM_RAYS as f64
            * contour.iter().map(|r| r * r).sum::<f64>();
        section.equivalent_mm = 2.0 * (section.area_mm2 / std::f64::consts::PI).sqrt();
        section.shift_mm = (0..NUM_RAYS)
            .filter(|n| edge_mm[*n].is_finite())
            .map(|n| shift[n])
            .sum::<f64>()
            / (NUM_RAYS as f64 * section.share);
        (section.min_mm, section.max_mm) = widths(
            &filled(&shape_mm).unwrap_or(contour),
            voxel_mm,
            edge_error_mm(cast, &edge_mm, voxel_mm, noise),
        );
        if section.wall_share >= MIN_WALL_SHARE {
            let half_maximum_mm = median(thick_mm.into_iter().filter(|t| t.is_finite()).collect());
            section.wall_mm = correction.as_ref().map_or(half_maximum_mm, |c| c.wall_mm);
            section.outer_mm = std::array::from_fn(|n| {
                let there = thick_mm[n].is_finite();
                if there {
                    edge_mm[n] + section.wall_mm
                } else {
                    f64::NAN
                }
            });
        }
        let model = correction.map_or(UNKNOWN_BLUR, |c| c.error);
        section.set_errors(
            cast,
            voxel_mm,
            noise,
            model,
            blur.map_or(0.0, |b| b.in_plane_mm),
        );
        section
    }

    /// Set the errors: half-widths of intervals that should contain the true values in 95 of 100 cases.
    ///
    /// One edge has the standard deviation `e`, with `e^2 = (noise / slope)^2 + (0.1 voxel)^2`. A section of radius `r`
    /// has as many independent edges as voxels on its edge, `n = 2 pi r / voxel`, at most one per ray. Their error,
    /// `1.96 e / sqrt(n)`, is combined with the error of the blur model ([`crate::section::deblur::Correction`];
    /// without a blur a fixed fraction). A width has fewer independent edges, `n / 4`. The error of the wall includes
    /// both of its edges and a fraction of the blur.
    fn set_errors(&mut self, cast: &Cast, voxel_mm: f64, noise: f64, model: f64, blur_mm: f64) {
        let edge = edge_error_mm(cast, &self.edge_mm, voxel_mm, noise);
        let num_rays = NUM_RAYS as f64 * self.share;
        let num = (std::f64::consts::PI * self.equivalent_mm / voxel_mm).clamp(1.0, num_rays);
        let model_mm = 0.5 * self.equivalent_mm * model;
        let half = |num: f64, model_mm: f64| (HALF_95 * edge / num.sqrt()).hypot(model_mm);
        self.equivalent_error_mm = 2.0 * half(num, model_mm);
        self.width_error_mm = 2.0 * half((num / 4.0).max(1.0), model_mm);
        if self.wall_mm.is_finite() {
            let num = (num * self.wall_share).max(1.0);
            self.wall_error_mm = half(
                num / 2.0,
                (WALL_BY_MODEL * model_mm).hypot(WALL_BY_BLUR * blur_mm),
            );
        }
    }

    /// Return true if the section has a lumen area, that is, if its contour was closed.
    #[must_use]
    pub fn is_measured(&self) -> bool {
        self.area_mm2.is_finite()
    }
}

/// Return the standard deviation of one edge due to noise and voxels, mm.
fn edge_error_mm(cast: &Cast, edge_mm: &[f64; NUM_RAYS], voxel_mm: f64, noise: f64) -> f64 {
    let slopes = (0..NUM_RAYS)
        .filter(|n| edge_mm[*n].is_finite())
        .map(|n| cast.rays[n].slope_per_mm())
        .filter(|s| s.is_finite())
        .collect();
    (noise / median(slopes).max(1e-3)).hypot(EDGE_VOX * voxel_mm)
}

/// Return the smallest and the largest width of a contour through its centre, mm.
///
/// The width at an angle is the sum of two opposite edges, which depends only on even harmonics of the contour. Small
/// lumens are treated as ellipses (second harmonic), because finer shapes are smaller than their voxels. Noise alone
/// makes a circle look flat; its mean contribution to the square of a harmonic (4 e^2 / n, see [`Section::set_errors`])
/// is subtracted.
fn widths(contour: &[f64; NUM_RAYS], voxel_mm: f64, edge_mm: f64) -> (f64, f64) {
    let mean = contour.iter().sum::<f64>() / NUM_RAYS as f64;
    let num = (std::f64::consts::TAU * mean / voxel_mm).clamp(1.0, NUM_RAYS as f64);
    let finest = (num / 8.0).clamp(2.0, 8.0) as usize;
    let mut width = [2.0 * mean; NUM_RAYS / 2];
    for order in (2..=finest).step_by(2) {
        let (mut c, mut s) = (0.0, 0.0);
        for (n, r) in contour.iter().enumerate() {
            let (sin, cos) = (order as f64 * angle(n)).sin_cos();
            c += 2.0 / NUM_RAYS as f64 * r * cos;
            s += 2.0 / NUM_RAYS as f64 * r * sin;
        }
        let square = c * c + s * s;
        let kept = (1.0 - 4.0 * edge_mm * edge_mm / num / square.max(1e-12))
            .max(0.0)
            .sqrt();
        for (n, w) in width.iter_mut().enumerate() {
            let (sin, cos) = (order as f64 * angle(n)).sin_cos();
            *w += 2.0 * kept * (c * cos + s * sin);
        }
    }
    let least = width.iter().copied().fold(f64::INFINITY, f64::min);
    (least, width.iter().copied().fold(0.0, f64::max))
}
