//! Selection of the slope store of a volume for a lighting.

use std::sync::{Arc, Mutex, atomic::AtomicBool};

use carina_raycast::WallLighting;

use crate::{Gpu, GpuError, device::lock, slope_store::SlopeStore};

/// Size in bytes of one brick in the buffer of slopes: 512 int16.
const BRICK_BYTES: usize = 1024;
/// Size in bytes of the header before the table of the bricks.
const HEADER_BYTES: usize = 16;

impl Gpu {
    /// Return the slope store of a volume for a lighting: the one in `stored`, or a new empty one if the transfer
    /// function has changed.
    pub(crate) fn slopes_of(
        &self,
        stored: &Mutex<Option<Arc<SlopeStore>>>,
        light: &WallLighting<'_>,
    ) -> Result<Arc<SlopeStore>, GpuError> {
        let mut stored = lock(stored);
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
