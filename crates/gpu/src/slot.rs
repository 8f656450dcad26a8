//! Reusable buffers on the device for pictures in progress.

use crate::{Gpu, device::lock, resources::Slot, uniforms::Uniforms};

impl Gpu {
    /// Return buffers of at least the given sizes; free buffers are reused.
    pub(crate) fn slot(&self, out_bytes: u64, count_bytes: u64) -> Slot {
        {
            let mut free = lock(&self.slots);
            let fits = |slot: &Slot| slot.out_bytes >= out_bytes && slot.count_bytes >= count_bytes;
            if let Some(n) = free.iter().position(fits) {
                return free.swap_remove(n);
            }
            // The free slot is too small, so a larger one replaces it.
            free.pop();
        }
        let buffer = |label: &str, size: u64, usage: wgpu::BufferUsages| {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let written = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC;
        Slot {
            out_bytes,
            count_bytes,
            uniforms: buffer(
                "frame",
                size_of::<Uniforms>() as u64,
                wgpu::BufferUsages::UNIFORM,
            ),
            out: buffer("pixels", out_bytes, written),
            counts: buffer("counts", count_bytes, written),
            staging: buffer(
                "read-back",
                out_bytes + count_bytes,
                wgpu::BufferUsages::MAP_READ,
            ),
        }
    }
}
