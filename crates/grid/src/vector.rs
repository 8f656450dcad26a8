//! Products and lengths of vectors of three numbers.

/// Return the dot product of two vectors.
#[must_use]
#[inline]
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Return the cross product of two vectors.
#[must_use]
#[inline]
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Return the Euclidean length of a vector.
#[must_use]
#[inline]
pub fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// Return a vector scaled to length 1; `None` if the vector is shorter than 1e-12.
#[must_use]
#[inline]
pub fn unit(a: [f64; 3]) -> Option<[f64; 3]> {
    let len = length(a);
    (len > 1e-12).then(|| a.map(|v| v / len))
}
