//! What a caster on other hardware needs in order to cast the same rays.

use carina_grid::Affine;

use crate::{CastStats, Frame, FrameOptions, leap::Price};

/// The shortest leap over a transparent class that sets a ray's patience back.
#[must_use]
pub const fn paying_leap(nearest: bool) -> u32 {
    Price::of(CastStats::sample_loads(nearest), 1).pays
}

/// The numbers behind a [`Frame`], as the casters of this crate use them.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameNumbers<'a> {
    /// Voxels per mm, from directions in camera space.
    pub ijk_from_camera: Affine,
    /// Camera centre, voxels.
    pub origin_ijk: [f64; 3],
    /// Voxels of each axis.
    pub shape_ijk: [usize; 3],
    /// Length of a ray step.
    pub step_mm: f64,
    /// `|gradient in LPS per mm|^2 = g^T metric g` for gradients per voxel: xx, yy, zz, 2xy, 2xz, 2yz.
    pub metric: [f32; 6],
    /// What a leap keeps away from the end of its cube, voxels.
    pub guard_vox: f32,
    /// No ray has more steps.
    pub most_steps: f64,
    /// Rays stop when less than this shines through.
    pub stop: f32,
    /// HU of the transfer table's first entry.
    pub low_hu: i32,
    /// Premultiplied colour and opacity of one ray step, by integer HU; values beyond clamp.
    pub entries: &'a [[f32; 4]],
    /// Sampling, light, background.
    pub options: FrameOptions,
    /// Viewport.
    pub width: usize,
    /// Viewport.
    pub height: usize,
}

impl Frame<'_> {
    /// The numbers behind this frame.
    #[must_use]
    pub fn numbers(&self) -> FrameNumbers<'_> {
        FrameNumbers {
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
