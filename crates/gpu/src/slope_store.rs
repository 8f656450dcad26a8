//! Store of the slopes at the voxels near walls, which the device fills and all pictures of a volume share.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use carina_raycast::WallLighting;

use crate::{Gpu, GpuError, GpuVolume, device::lock};

/// Number of bytes of a stored brick.
const BRICK_BYTES: usize = 1024;
/// Number of bytes before the entries of the bricks.
const HEADER_BYTES: usize = 16;

/// Bricks of slopes of one volume, for one transfer function.
#[derive(Debug)]
pub(crate) struct SlopeStore {
    reach: [f32; 3],
    held: [f32; 2],
    /// Header and entries of the bricks, with the layout of `Bricks` in `lighting.wgsl`.
    pub(crate) bricks: wgpu::Buffer,
    /// Slopes of the stored bricks.
    pub(crate) slopes: wgpu::Buffer,
    /// Number of bricks of the volume along each axis, and capacity of the store.
    pub(crate) num_bricks: [u32; 4],
    /// Whether a picture has requested more bricks than the store has, so that the next picture empties the store.
    is_full: AtomicBool,
}

impl SlopeStore {
    /// Record the number of bricks that pictures have requested.
    pub(crate) fn record_requested(&self, requested: u32) {
        let [ni, nj, nk, capacity] = self.num_bricks;
        if requested >= capacity && capacity < ni * nj * nk {
            self.is_full.store(true, Ordering::Relaxed);
        }
    }

    /// Empty the store if it is full; the bricks of other pictures in progress are filled again.
    pub(crate) fn empty_if_full(&self, encoder: &mut wgpu::CommandEncoder) {
        if self.is_full.swap(false, Ordering::Relaxed) {
            encoder.clear_buffer(&self.bricks, 0, None);
        }
    }
}

impl Gpu {
    /// Return the store of a volume's slopes for a lighting; it starts empty for another transfer function.
    pub(crate) fn slopes_of(
        &self,
        volume: &GpuVolume,
        light: &WallLighting<'_>,
    ) -> Result<Arc<SlopeStore>, GpuError> {
        let mut stored = lock(&volume.slopes);
        let fits =
            |store: &&Arc<SlopeStore>| store.reach == light.reach && store.held == light.held;
        if let Some(store) = stored.as_ref().filter(fits) {
            return Ok(Arc::clone(store));
        }
        // The old store is released first, because the device may not hold two.
        *stored = None;
        let num: usize = light.num_bricks.iter().product();
        let most = self.device.limits().max_storage_buffer_binding_size as usize;
        let capacity = light.most_bricks.min(most / BRICK_BYTES);
        let bytes = HEADER_BYTES + 4 * num;
        let [ni, nj, nk] = light.num_bricks.map(|n| n as u32);
        let store = SlopeStore {
            reach: light.reach,
            held: light.held,
            bricks: self.storage("the table of slopes", bytes)?,
            slopes: self.storage("the slopes of the walls", capacity.max(1) * BRICK_BYTES)?,
            num_bricks: [ni, nj, nk, capacity as u32],
            is_full: AtomicBool::new(false),
        };
        Ok(Arc::clone(stored.insert(Arc::new(store))))
    }
}
