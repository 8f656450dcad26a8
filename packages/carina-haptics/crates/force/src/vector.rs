//! Operations on points and vectors in LPS.

use carina_grid::length;

/// Point in LPS mm, or a vector.
pub(crate) type Point = [f64; 3];

/// Return the vector `a - b`.
pub(crate) fn sub(a: Point, b: Point) -> Point {
    std::array::from_fn(|k| a[k] - b[k])
}

/// Return the vector `a + f * b`.
pub(crate) fn along(a: Point, f: f64, b: Point) -> Point {
    std::array::from_fn(|k| a[k] + f * b[k])
}

/// Return the distance between two points.
pub(crate) fn distance(a: Point, b: Point) -> f64 {
    length(sub(a, b))
}
