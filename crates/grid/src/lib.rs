//! Voxel grids and the spaces they live in: voxel indices, patient millimetres (LPS), the camera.
//!
//! Conventions (docs/conventions.md): voxel (0, 0, 0) is the *centre* of the first voxel, so a grid of `n` voxels spans
//! `-0.5 ..= n - 0.5` on each index axis. Arrays are `[z, y, x]`, x fastest; points and shapes here are `(i, j, k)`.
//! The camera looks along +z, with +x right and +y down.
//!
//! [`InstructionSet`] is here because every crate with kernels for several of them stands on this one.

mod affine;
mod camera;
mod clip;
mod distortion;
mod error;
mod lens;
#[cfg(test)]
mod lens_tests;
mod rays;
mod simd;
mod volume;

pub use affine::Affine;
pub use camera::{Camera, MAX_FOV_RAD, MIN_FOV_RAD, PixelRay};
pub use clip::clip_line_to_box;
pub use distortion::Distortion;
pub use error::GridError;
pub use lens::{Calibration, Lens, Optics};
pub use rays::{FULL_GAIN, FieldShape, ImageField, LensRays};
pub use simd::InstructionSet;
pub use volume::{Grid, Ijk, Lps, VolumeView, ijk_from_zyx, zyx_from_ijk};

/// Dot product.
#[must_use]
pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Cross product.
#[must_use]
pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Euclidean length.
#[must_use]
pub fn length(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

/// The vector scaled to length 1, or `None` where it is shorter than 1e-12.
#[must_use]
pub fn unit(a: [f64; 3]) -> Option<[f64; 3]> {
    let len = length(a);
    (len > 1e-12).then(|| a.map(|v| v / len))
}
