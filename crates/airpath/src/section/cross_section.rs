//! Cross-sections of an airway, perpendicular to its centreline: lumen area, diameters and wall thickness with their errors.
//!
//! Rays leave the centre in the plane. Along each the values are read between the voxels (Catmull-Rom), the lumen's lowest
//! value and the wall's first peak are looked up, and the edge of the lumen is where the profile passes half-way between
//! them (full width at half maximum: Reinhardt et al. 1997; Nakano et al. 2000). The wall ends half-way between its peak and
//! the lowest value behind it; a ray whose wall has no far side (a vessel or the mediastinum lies against it) has no say in
//! the wall's thickness. The plane's centre then moves to the centre of the lumen found, and the rays are cast again.
//!
//! Half-maximum edges of thin walls are biased, and [`crate::section::deblur`] takes the known part of that out. This file finds
//! the raw edges and turns corrected ones into figures.

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

/// With a smaller share of rays whose wall has a far side its thickness is not told.
pub const LEAST_WALL_SHARE: f64 = 0.3;
/// What is thicker is not the wall alone: the far side found is that of what lies against it.
pub const THICKEST_WALL_MM: f64 = 3.0;
/// A centre that is off by less than this share of a voxel is in the middle.
const CENTRED_VOX: f64 = 0.1;
const MAX_CASTS: usize = 4;
/// Planes between two looks at the watch; few, so that pictures that are due do not wait for more than some milliseconds.
const PLANES_PER_LOOK: usize = 16;
/// What interpolation and stepping leave unknown of one edge, in voxels (one standard deviation).
const EDGE_VOX: f64 = 0.1;
/// Half of a 95 % interval, in standard deviations.
const HALF_95: f64 = 1.96;
/// Error of a radius whose blur is not known, as a share of it.
const UNKNOWN_BLUR: f64 = 0.2;
/// Error of a wall by the model of the blur, over that of the radius.
const WALL_BY_MODEL: f64 = 2.0;
/// From this weight of a direction on the shape of a section counts in full for its widths.
const SHAPE_WEIGHT: f64 = 0.5;
/// Error of a wall by its model, which is flat and as thick all round, in blurs.
const WALL_BY_BLUR: f64 = 0.4;

/// Where to cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// A point well inside the lumen, LPS mm.
    pub centre: Point,
    /// Unit vector along the airway.
    pub normal: Point,
    /// About how far the wall is, mm: rays give up at [`reach_mm`].
    pub radius_mm: f64,
}

/// What a plane shows. Lengths in mm; NaN where there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// Centre of the lumen found (of its area), in the plane.
    pub centre: Point,
    /// Area of the lumen.
    pub area_mm2: f64,
    /// Diameter of the circle with that area.
    pub equivalent_mm: f64,
    /// Least and greatest width through the centre.
    pub min_mm: f64,
    /// See `min_mm`.
    pub max_mm: f64,
    /// Median over the rays whose wall has a far side.
    pub wall_mm: f64,
    /// How far the edges lie outside the half-maximum ones (mean over the rays): the correction for the blur.
    pub shift_mm: f64,
    /// Half of an interval meant to hold the truth in 95 of 100 cases; see [`Section::set_errors`].
    pub equivalent_error_mm: f64,
    /// The same for the widths.
    pub width_error_mm: f64,
    /// The same for the wall.
    pub wall_error_mm: f64,
    /// Rays that met a wall, 0 to 1.
    pub share: f64,
    /// Rays whose wall has a far side, 0 to 1.
    pub wall_share: f64,
    /// Rays that left the volume before they met a wall, 0 to 1.
    pub left_share: f64,
    /// Distance of the lumen's edge from `centre` along each ray; NaN where it was not found.
    pub edge_mm: [f64; NUM_RAYS],
    /// Distance of the wall's outer edge likewise.
    pub outer_mm: [f64; NUM_RAYS],
}

/// How far a ray looks for the lumen's edge, mm: 3 radii, for a lumen three times as wide as high, and 3 voxels.
#[must_use]
pub fn reach_mm(radius_mm: f64, voxel_mm: f64) -> f64 {
    3.0 * radius_mm + 3.0 * voxel_mm
}

/// Size of a voxel along the rays of a plane, mm (root mean square over the rays).
#[must_use]
pub fn voxel_in_plane_mm(grid: &Grid, axes: (Point, Point)) -> f64 {
    let square: f64 = (0..NUM_RAYS)
        .map(|n| length(grid.ijk_from_lps().vector(direction(axes, n))).powi(-2))
        .sum();
    (square / NUM_RAYS as f64).sqrt()
}

/// Casts the rays of many planes over all cores; the result does not depend on their number.
pub fn cast_planes(
    values: VolumeView<'_, i16>,
    planes: &[Plane],
    levels: SectionLevels,
    watch: &impl Watch,
) -> Result<Vec<Cast>, TrackError> {
    let mut sections = Vec::with_capacity(planes.len());
    for (n, chunk) in planes.chunks(PLANES_PER_LOOK).enumerate() {
        watch.go_on((n * PLANES_PER_LOOK) as f64 / planes.len() as f64)?;
        let found: Vec<Cast> = chunk
            .par_iter()
            .map(|plane| cast_plane(values, *plane, levels))
            .collect();
        sections.extend(found);
    }
    Ok(sections)
}

/// Casts the rays of one plane from the centre of the lumen it shows.
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
        // A hole in the contour can pull the centre out of the lumen: at most half a radius at a time.
        let share = (0.5 * plane.radius_mm / far_mm).min(1.0);
        let next: Point =
            std::array::from_fn(|a| centre[a] + share * (u * axes.0[a] + v * axes.1[a]));
        let cast_again = cast(values, next, axes, plane.radius_mm, levels);
        // A step that loses the wall was one into a neighbour.
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

/// Edges that lie as near to the section's circle as the blur in their direction makes them uncertain.
///
/// Thick slices do not show the shape of an airway across them. The circle has the area that the certain edges tell.
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
    /// Figures of a cast, with the blur's effect taken out of its edges (`None`: raw half-maximum edges).
    ///
    /// `voxel_mm` is the spacing in the plane.
    #[must_use]
    pub fn of(cast: &Cast, blur: Option<&Blur>, voxel_mm: f64, levels: SectionLevels) -> Self {
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
        // Widths are no means over directions: they keep the shape as far as it is visible at all.
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
        if section.wall_share >= LEAST_WALL_SHARE {
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

    /// The errors: half of an interval meant to hold the truth in 95 of 100 cases.
    ///
    /// One edge is known to `e`, with `e^2 = (noise / slope)^2 + (0.1 voxel)^2`. A section of radius `r` has as many
    /// independent edges as voxels on its edge, `n = 2 pi r / voxel`, at most one per ray. To their error, `1.96 e /
    /// sqrt(n)`, comes that of the model of the blur ([`Correction::error`]; without a blur all of it). A width has fewer
    /// edges for itself: `n / 4`. The wall adds both its edges and a share of the blur.
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

    /// True if the section has an area.
    #[must_use]
    pub fn is_measured(&self) -> bool {
        self.area_mm2.is_finite()
    }
}

/// What noise and voxels leave unknown of one edge: one standard deviation.
fn edge_error_mm(cast: &Cast, edge_mm: &[f64; NUM_RAYS], voxel_mm: f64, noise: f64) -> f64 {
    let slopes = (0..NUM_RAYS)
        .filter(|n| edge_mm[*n].is_finite())
        .map(|n| cast.rays[n].slope_per_mm())
        .filter(|s| s.is_finite())
        .collect();
    (noise / median(slopes).max(1e-3)).hypot(EDGE_VOX * voxel_mm)
}

/// Least and greatest width through the centre.
///
/// The width at an angle is the sum of two opposite edges, which only even harmonics of the contour have. Small lumens are
/// seen as ellipses (second harmonic): finer shapes are smaller than their voxels. Noise alone makes a circle look flat;
/// what it adds to a harmonic's square on average (4 e^2 / n, see [`Section::set_errors`]) is taken off it.
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
