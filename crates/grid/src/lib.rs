//! Voxel grids and their coordinate spaces: voxel indices, patient millimetres (LPS), the camera.
//!
//! Conventions (docs/conventions.md): voxel (0, 0, 0) is the *centre* of the first voxel, so a grid of `n` voxels spans
//! `-0.5 ..= n - 0.5` on each index axis. Arrays are `[z, y, x]`, x fastest; points and shapes here are `(i, j, k)`.
//! The camera looks along +z, with +x right and +y down.
//!
//! [`InstructionSet`] is in this crate because every crate with kernels for several instruction sets depends on this
//! one.

mod affine;
mod camera;
mod clip;
mod distortion;
mod error;
mod lens;
#[cfg(test)]
mod lens_tests;
mod rays;
mod resample;
mod simd;
mod vector;
mod volume;

pub use affine::Affine;
pub use camera::{Camera, PixelRay};
pub use clip::clip_line_to_box;
pub use distortion::Distortion;
pub use error::GridError;
pub use lens::{Calibration, Lens, MAX_FOV_RAD, MIN_FOV_RAD, Optics};
pub use rays::{FULL_GAIN, FieldShape, ImageField, LensRays};
pub use resample::resampled;
pub use simd::InstructionSet;
pub use vector::{cross, dot, length, unit};
pub use volume::{Grid, Ijk, Lps, VolumeView, ijk_from_zyx, zyx_from_ijk};
