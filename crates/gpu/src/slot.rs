//! Reusable buffers on the device for pictures in progress.

use crate::{Gpu, GpuError, device::lock, light_uniforms::LightUniforms, uniforms::Uniforms};

/// Number of bytes of the counters of a picture's work.
pub(crate) const COUNT_BYTES: u64 = 40;
/// Number of bytes of the results at the start of `State` that are read back.
pub(crate) const RESULT_BYTES: u64 = 16;
/// Number of bytes of `State` before the list of silhouettes.
const STATE_BYTES: u64 = RESULT_BYTES + 4 * 144;

/// Sizes of the buffers of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SlotSize {
    /// Number of pixels whose colours, depths and silhouettes are stored.
    pub(crate) num_pixels: u64,
    /// Number of bytes of the rays of a band.
    pub(crate) wall_bytes: u64,
    /// Whether walls are shaded on the device.
    pub(crate) is_lit: bool,
    /// Number of bytes that are read back.
    pub(crate) read_bytes: u64,
}

impl SlotSize {
    fn fits(&self, wanted: &Self) -> bool {
        self.num_pixels >= wanted.num_pixels
            && self.wall_bytes >= wanted.wall_bytes
            && self.read_bytes >= wanted.read_bytes
            && (self.is_lit || !wanted.is_lit)
    }
}

/// Buffers of one picture, which are reused for later pictures.
#[derive(Debug)]
pub(crate) struct Slot {
    size: SlotSize,
    pub(crate) uniforms: wgpu::Buffer,
    pub(crate) light: wgpu::Buffer,
    pub(crate) walls: wgpu::Buffer,
    pub(crate) counts: wgpu::Buffer,
    pub(crate) pixels: wgpu::Buffer,
    pub(crate) depths: wgpu::Buffer,
    pub(crate) state: wgpu::Buffer,
    /// Buffer through which the CPU reads the results.
    pub(crate) staging: wgpu::Buffer,
}

impl Gpu {
    /// Return buffers of at least the given sizes; free buffers are reused.
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
