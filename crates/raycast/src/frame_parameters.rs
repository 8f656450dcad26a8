//! Parameters of a frame that a caster on other hardware (the GPU) needs to cast the same rays.

use carina_grid::Affine;

use crate::{CastStats, Frame, FrameOptions, leap::Price};

/// Return the minimum length of a leap, in samples, that resets a ray's patience (number of samples before its next
/// look-up).
#[must_use]
pub const fn paying_leap(nearest: bool) -> u32 {
    Price::of(CastStats::sample_loads(nearest), 1).pays
}

/// Parameters of a [`Frame`] in voxel coordinates, in which the casters step along rays without further transforms.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameParameters<'a> {
    /// Transform from directions in camera space (mm) to voxels.
    pub ijk_from_camera: Affine,
    /// Position of the camera's centre, voxels.
    pub origin_ijk: [f64; 3],
    /// Number of voxels of the volume along each axis.
    pub shape_ijk: [usize; 3],
    /// Length of a ray step, mm.
    pub step_mm: f64,
    /// Metric that converts a gradient `g` per voxel: `|gradient in LPS per mm|^2 = g^T metric g`.
    ///
    /// The items are xx, yy, zz, 2xy, 2xz, 2yz.
    pub metric: [f32; 6],
    /// Distance in voxels by which a leap (skipped part of a ray) stays inside the cube of equal labels.
    pub guard_vox: f32,
    /// Upper bound of the number of steps of any ray.
    pub most_steps: f64,
    /// Transparency below which a ray stops.
    pub stop: f32,
    /// HU of the transfer table's first entry.
    pub low_hu: i32,
    /// Premultiplied colour and opacity of one ray step, by integer HU; values outside the table are clamped.
    pub entries: &'a [[f32; 4]],
    /// Interpolation, light, appearance and background of the frame.
    pub options: FrameOptions,
    /// Width of the viewport, pixels.
    pub width: usize,
    /// Height of the viewport, pixels.
    pub height: usize,
}

impl Frame<'_> {
    /// Return the parameters of this frame.
    #[must_use]
    pub fn parameters(&self) -> FrameParameters<'_> {
        FrameParameters {
            ijk_from_camera: self.ijk_from_camera,
            origin_ijk: self.origin_ijk,
            shape_ijk: self.grid.shape_ijk(),
            step_mm: self.table.step_mm(),
            metric: self.metric,
            guard_vox: self.guard_vox,
            most_steps: self.most_steps(),
            stop: self.stop,
            low_hu: self.table.lo_hu,
            entries: &self.table.entries,
            options: self.options,
            width: self.camera().width(),
            height: self.camera().height(),
        }
    }
}
