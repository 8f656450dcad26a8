//! Buffers on the device for pictures in progress, which later pictures reuse.

use crate::{
    Gpu, GpuError,
    device::lock,
    light_uniforms::LightUniforms,
    resources::{COUNT_BYTES, STATE_BYTES, Slot, SlotSize},
    uniforms::Uniforms,
};

impl Gpu {
    /// Return picture buffers of at least the given sizes; reuse free buffers if they are large enough.
    pub(crate) fn slot(&self, size: SlotSize) -> Result<Slot, GpuError> {
        {
            let mut free = lock(&self.slots);
            if let Some(n) = free.iter().position(|slot| slot.size.fits(&size)) {
                return Ok(free.swap_remove(n));
            }
            // The free slot is too small, so a larger one replaces it.
            free.pop();
        }
        let most = self.device.limits().max_storage_buffer_binding_size;
        let of_lit = |bytes: u64| if size.is_lit { bytes } else { 16 };
        let state_bytes = of_lit(STATE_BYTES + 4 * size.num_pixels);
        if state_bytes.max(4 * size.num_pixels).max(size.wall_bytes) > most {
            return Err(GpuError::Unsupported {
                reason: format!(
                    "a picture of {} pixels is too large for it",
                    size.num_pixels
                ),
            });
        }
        let buffer = |label: &str, size: u64, usage: wgpu::BufferUsages| {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: size.max(16),
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let written = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
        let (slot, refused) = self.watched(|| Slot {
            size,
            uniforms: buffer(
                "frame",
                size_of::<Uniforms>() as u64,
                wgpu::BufferUsages::UNIFORM,
            ),
            light: buffer(
                "lighting",
                size_of::<LightUniforms>() as u64,
                wgpu::BufferUsages::UNIFORM,
            ),
            walls: buffer("rays", size.wall_bytes, written),
            counts: buffer("counts", COUNT_BYTES, written),
            pixels: buffer("pixels", 4 * size.num_pixels, written),
            depths: buffer("depths", of_lit(4 * size.num_pixels), written),
            state: buffer("state", state_bytes, written),
            staging: buffer("read-back", size.read_bytes, wgpu::BufferUsages::MAP_READ),
        });
        refused.map_or(Ok(slot), |reason| {
            Err(GpuError::DoesNotFit {
                what: "the picture",
                reason,
            })
        })
    }
}
