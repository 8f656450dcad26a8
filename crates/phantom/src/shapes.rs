//! Shapes as signed distances in mm (negative inside), and combinations of shapes.

use carina_grid::{cross, dot, length, unit};

/// Standard deviation of the scanner's blur, added to the average over a voxel, mm.
pub(crate) const SIGMA_MM: f64 = 0.35;

pub(crate) fn add(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + b[i])
}

pub(crate) fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Return the vector `a + f * b`.
pub(crate) fn along(a: [f64; 3], f: f64, b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + f * b[i])
}

pub(crate) fn mix(a: f64, b: f64, t: f64) -> f64 {
    a + t * (b - a)
}

/// Return the unit vector of `v`, whose length must not be 0.
pub(crate) fn direction(v: [f64; 3]) -> [f64; 3] {
    unit(v).unwrap_or([0.0, 0.0, 1.0])
}

/// Return two unit vectors perpendicular to `dir` and to each other.
pub(crate) fn normals(dir: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let helper = if dir[2].abs() < 0.8 {
        [0.0, 0.0, 1.0]
    } else {
        [0.0, 1.0, 0.0]
    };
    let across = direction(cross(dir, helper));
    (across, cross(dir, across))
}

/// Return the direction `dir` tilted by the angle `tilt` towards the direction at the angle `turn` round `dir`.
pub(crate) fn tilted(
    dir: [f64; 3],
    across: [f64; 3],
    up: [f64; 3],
    turn: f64,
    tilt: f64,
) -> [f64; 3] {
    let (s, c) = (libm::sin(turn), libm::cos(turn));
    let side: [f64; 3] = std::array::from_fn(|i| c * across[i] + s * up[i]);
    let (st, ct) = (libm::sin(tilt), libm::cos(tilt));
    direction(std::array::from_fn(|i| ct * dir[i] + st * side[i]))
}

/// Return the signed distance of the union of two shapes, with a quadratic fillet of about `k` mm between them.
pub(crate) fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0);
    a.min(b) - h * h / (4.0 * k)
}

/// Return the signed distance of the intersection of two shapes, with an edge rounded by about `k` mm.
pub(crate) fn smooth_max(a: f64, b: f64, k: f64) -> f64 {
    -smooth_min(-a, -b, k)
}

/// Return the fraction of a point-spread function of width `sigma_mm` that is inside a flat surface at distance `d`.
///
/// The function is a cubic step with the slope of the Gaussian's integral at the surface; it ends at 1.88 sigma, which
/// keeps lists short.
pub(crate) fn cover(d: f64, sigma_mm: f64) -> f64 {
    let t = (0.5 - d / (3.76 * sigma_mm)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Piece of a tube: a straight axis with a radius that changes linearly along it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Piece {
    pub(crate) start: [f64; 3],
    pub(crate) end: [f64; 3],
    pub(crate) start_radius: f64,
    pub(crate) end_radius: f64,
}

impl Piece {
    /// Return the distance of a point from the axis, and the position (0 to 1) of the nearest point of the axis.
    pub(crate) fn axis_distance(&self, p: [f64; 3]) -> (f64, f64) {
        let axis = sub(self.end, self.start);
        let from = sub(p, self.start);
        let t = (dot(from, axis) / dot(axis, axis).max(1e-12)).clamp(0.0, 1.0);
        (length(along(from, -t, axis)), t)
    }

    /// Return the signed distance of a point from the surface, and the position (0 to 1) of the nearest point of the
    /// axis.
    pub(crate) fn distance(&self, p: [f64; 3]) -> (f64, f64) {
        let (away, t) = self.axis_distance(p);
        (away - mix(self.start_radius, self.end_radius, t), t)
    }

    /// Return the box in LPS that contains every point within `margin` of the surface.
    pub(crate) fn bounds(&self, margin: f64) -> ([f64; 3], [f64; 3]) {
        self.axis_bounds(self.start_radius.max(self.end_radius) + margin)
    }

    /// Return the box in LPS that contains every point within `r` of the axis.
    pub(crate) fn axis_bounds(&self, r: f64) -> ([f64; 3], [f64; 3]) {
        (
            std::array::from_fn(|a| self.start[a].min(self.end[a]) - r),
            std::array::from_fn(|a| self.start[a].max(self.end[a]) + r),
        )
    }
}

/// Return the signed distance to an ellipsoid with axes along LPS, to first order near the surface.
pub(crate) fn ellipsoid(p: [f64; 3], centre: [f64; 3], radii: [f64; 3]) -> f64 {
    let inverse = radii.map(|r| 1.0 / r);
    let q: [f64; 3] = std::array::from_fn(|a| (p[a] - centre[a]) * inverse[a]);
    let k0 = length(q);
    let k1 = length(std::array::from_fn(|a| q[a] * inverse[a]));
    if k1 < 1e-9 {
        return -radii[0].min(radii[1]).min(radii[2]);
    }
    k0 * (k0 - 1.0) / k1
}

/// Return the point at `t` (0 to 1) on the cubic curve from `a`, with tangent `ta`, to `b`, with tangent `tb`.
///
/// The tangents have lengths in mm.
pub(crate) fn hermite(a: [f64; 3], ta: [f64; 3], b: [f64; 3], tb: [f64; 3], t: f64) -> [f64; 3] {
    let (t2, t3) = (t * t, t * t * t);
    let (h0, h1) = (2.0 * t3 - 3.0 * t2 + 1.0, t3 - 2.0 * t2 + t);
    let (h2, h3) = (-2.0 * t3 + 3.0 * t2, t3 - t2);
    std::array::from_fn(|i| h0 * a[i] + h1 * ta[i] + h2 * b[i] + h3 * tb[i])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_smooth_union_contains_both_shapes_and_touches_nothing_far_off() {
        assert!(smooth_min(1.0, 1.0, 2.0) < 1.0);
        assert!((smooth_min(1.0, 4.0, 2.0) - 1.0).abs() < 1e-15);
        assert!((smooth_max(1.0, 4.0, 2.0) - 4.0).abs() < 1e-15);
    }

    #[test]
    fn a_surface_through_the_middle_covers_half() {
        assert!((cover(0.0, 0.4) - 0.5).abs() < 1e-15);
        assert!(cover(-1.0, 0.4) > 0.999 && cover(1.0, 0.4) < 0.001);
    }

    #[test]
    fn the_distance_to_an_ellipsoid_is_right_along_its_axes() {
        let d = ellipsoid([0.0, 33.0, 0.0], [0.0; 3], [10.0, 30.0, 20.0]);
        assert!((d - 3.0).abs() < 0.3, "{d}");
    }
}
