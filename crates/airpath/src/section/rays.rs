//! Rays of a cross-section and its contour: distances at equal angles round a point, in the plane across an airway.

use carina_grid::{cross, unit};

use crate::section::profile::Edges;
use crate::tree::smooth::Point;

/// Number of rays of a section, and of points of its contour.
pub const NUM_RAYS: usize = 64;

/// Minimum fraction of the rays that must meet a wall; with fewer, the section has no closed lumen.
pub const MIN_SHARE: f64 = 0.6;

/// Rays of one plane across an airway, with the edges found on them.
#[derive(Debug, Clone, PartialEq)]
pub struct Cast {
    /// Origin of the rays, LPS mm.
    pub centre: Point,
    /// Unit vector along the airway, LPS, perpendicular to the rays.
    pub normal: Point,
    /// Edges on each ray; the rays run counterclockwise as seen against the normal, from the first axis of
    /// [`plane_axes`].
    pub rays: [Edges; NUM_RAYS],
}

/// Return two unit vectors that span the plane across `normal` and form a right-handed frame with it.
#[must_use]
pub fn plane_axes(normal: Point) -> (Point, Point) {
    // The helper is the LPS axis with the smallest component along the normal, so equal normals give equal axes.
    let mut helper = [0.0; 3];
    let least = (0..3)
        .min_by(|&a, &b| normal[a].abs().total_cmp(&normal[b].abs()))
        .unwrap_or(0);
    helper[least] = 1.0;
    let across = unit(cross(normal, helper)).unwrap_or([1.0, 0.0, 0.0]);
    (across, cross(normal, across))
}

/// Return the unit vector of ray `n` in the plane of two axes.
pub(crate) fn direction((across, up): (Point, Point), n: usize) -> Point {
    let (s, c) = angle(n).sin_cos();
    std::array::from_fn(|a| c * across[a] + s * up[a])
}

pub(crate) fn angle(n: usize) -> f64 {
    std::f64::consts::TAU * n as f64 / NUM_RAYS as f64
}

/// Return the distance of the lumen's edge on each ray, without edges of other structures.
///
/// The result is NaN for a ray without an edge, and for an edge that is far from those of the neighbouring rays. Such
/// an edge belongs to another structure, for example the far wall of a branch that leaves here.
pub(crate) fn without_outliers(rays: &[Edges; NUM_RAYS]) -> [f64; NUM_RAYS] {
    without_far(&std::array::from_fn(|n| {
        rays[n].inner_mm.unwrap_or(f64::NAN)
    }))
}

/// Return the lengths of the rays, with NaN for each length that is far from those of the neighbouring rays.
pub(crate) fn without_far(lengths: &[f64; NUM_RAYS]) -> [f64; NUM_RAYS] {
    /// Number of neighbouring rays on each side with which a ray is compared to find outliers.
    const REACH: usize = 5;
    std::array::from_fn(|n| {
        let near = (0..=2 * REACH)
            .map(|d| lengths[(n + NUM_RAYS + d - REACH) % NUM_RAYS])
            .filter(|l| l.is_finite())
            .collect();
        let middle = median(near);
        if (lengths[n] - middle).abs() <= 0.5 * middle + 0.5 {
            lengths[n]
        } else {
            f64::NAN
        }
    })
}

/// Fill the gaps (NaN) of a contour from the nearest rays on both sides; return `None` if there are too many gaps.
pub(crate) fn filled(met: &[f64; NUM_RAYS]) -> Option<[f64; NUM_RAYS]> {
    if share_of(met) < MIN_SHARE {
        return None;
    }
    Some(std::array::from_fn(|n| {
        if met[n].is_finite() {
            return met[n];
        }
        // The nearest ray with a length on each side, round the circle.
        let side = |step: usize| {
            (1..NUM_RAYS)
                .map(|d| (d, (n + d * step) % NUM_RAYS))
                .find(|(_, at)| met[*at].is_finite())
        };
        match (side(1), side(NUM_RAYS - 1)) {
            (Some((d, after)), Some((e, before))) => {
                (met[after] * e as f64 + met[before] * d as f64) / (d + e) as f64
            }
            _ => f64::NAN,
        }
    }))
}

pub(crate) fn share_of(lengths: &[f64; NUM_RAYS]) -> f64 {
    lengths.iter().filter(|r| r.is_finite()).count() as f64 / NUM_RAYS as f64
}

/// Return the median of a list of numbers; NaN for an empty list.
pub(crate) fn median(mut list: Vec<f64>) -> f64 {
    list.sort_by(f64::total_cmp);
    list.get(list.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Return the centroid of the area inside a contour, in coordinates of the plane's axes.
pub(crate) fn centroid(contour: &[f64; NUM_RAYS]) -> [f64; 2] {
    let (mut u, mut v, mut area) = (0.0, 0.0, 0.0);
    for (n, r) in contour.iter().enumerate() {
        let (s, c) = angle(n).sin_cos();
        u += r.powi(3) * c / 3.0;
        v += r.powi(3) * s / 3.0;
        area += r * r / 2.0;
    }
    if area > 0.0 {
        [u / area, v / area]
    } else {
        [0.0; 2]
    }
}
