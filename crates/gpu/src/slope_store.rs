//! Store on the device of the slopes (smoothed gradients) at the voxels near walls, shared by all pictures of a volume.

use std::sync::atomic::{AtomicBool, Ordering};

/// Bricks (cubes of voxels) of the slopes of one volume, for one transfer function.
#[derive(Debug)]
pub(crate) struct SlopeStore {
    pub(crate) reach: [f32; 3],
    pub(crate) held: [f32; 2],
    /// Header and entries of the bricks, with the layout of `Bricks` in `lighting.wgsl`.
    pub(crate) bricks: wgpu::Buffer,
    /// Slopes of the stored bricks.
    pub(crate) slopes: wgpu::Buffer,
    /// Number of bricks of the volume along each axis, and capacity of the store.
    pub(crate) num_bricks: [u32; 4],
    /// Whether a picture has requested more bricks than the store has, so that the next picture empties the store.
    pub(crate) is_full: AtomicBool,
}

impl SlopeStore {
    /// Record how many bricks pictures have requested; the store is full if this number exceeds its capacity.
    pub(crate) fn record_requested(&self, requested: u32) {
        let [ni, nj, nk, capacity] = self.num_bricks;
        if requested >= capacity && capacity < ni * nj * nk {
            self.is_full.store(true, Ordering::Relaxed);
        }
    }

    /// Empty the store if it is full; pictures in progress then request their bricks again.
    pub(crate) fn empty_if_full(&self, encoder: &mut wgpu::CommandEncoder) {
        if self.is_full.swap(false, Ordering::Relaxed) {
            encoder.clear_buffer(&self.bricks, 0, None);
        }
    }
}
