//! Resources on the device: volumes, radius maps, anatomical data, ray directions, transfer tables, picture buffers.

use std::sync::{Arc, Mutex};

use carina_grid::LensRays;

use crate::slope_store::SlopeStore;

/// Volume of int16 values on the device.
#[derive(Debug)]
pub struct GpuVolume {
    pub(crate) view: wgpu::TextureView,
    pub(crate) shape_zyx: [usize; 3],
    pub(crate) owner: u64,
    /// Store of the slopes (smoothed gradients) at voxels near walls, which earlier pictures have filled.
    pub(crate) slopes: Mutex<Option<Arc<SlopeStore>>>,
}

/// Radius map of uniform regions, which rays skip (empty-space skipping), in the memory of the device.
#[derive(Debug)]
pub struct GpuMap {
    pub(crate) view: wgpu::TextureView,
    pub(crate) shape_zyx: [usize; 3],
    pub(crate) owner: u64,
}

/// Grid of anatomical data of airway walls on the device, for drawn features such as cartilage rings.
#[derive(Debug)]
pub struct GpuDecoration {
    pub(crate) cells: wgpu::Buffer,
    pub(crate) num_numbers: usize,
    pub(crate) owner: u64,
}

/// Data of a scene on one device: volume, radius map for empty-space skipping, and anatomical data for drawn features.
#[derive(Debug, Clone, Copy)]
pub struct Resident<'a> {
    /// Values of the frame's volume.
    pub volume: &'a GpuVolume,
    /// Radius map of transparent regions, which rays skip; without a map the casters read every sample of a ray.
    pub map: Option<&'a GpuMap>,
    /// Anatomical data for drawn features; without them on the device, a picture that needs them uploads them.
    pub decoration: Option<&'a GpuDecoration>,
}

/// Ray directions (unit vectors in camera space) and gains of the pixels of a lens.
#[derive(Debug)]
pub(crate) struct Directions {
    pub(crate) buffer: wgpu::Buffer,
    /// Rays of the lens; the reference prevents other rays from getting the same address.
    pub(crate) lens: Arc<LensRays>,
}

/// Buffer with a transfer table (colour and opacity by value).
#[derive(Debug)]
pub(crate) struct TableOnDevice {
    pub(crate) buffer: wgpu::Buffer,
    pub(crate) entries: Vec<[f32; 4]>,
}

/// Number of bytes of the work counters at the start of the buffer that is read back.
pub(crate) const COUNT_BYTES: u64 = 40;
/// Number of bytes of `State` that are read back; they are its first.
pub(crate) const RESULT_BYTES: u64 = 16;
/// Number of bytes of `State` that precede the list of silhouette pixels.
pub(crate) const STATE_BYTES: u64 = RESULT_BYTES + 4 * 144;

/// Sizes of the buffers of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SlotSize {
    /// Number of pixels for which the buffers have room for colours, depths and silhouette marks.
    pub(crate) num_pixels: u64,
    /// Size in bytes of the buffer for the first walls of a band.
    pub(crate) wall_bytes: u64,
    /// Whether the device shades the walls; otherwise the processor does.
    pub(crate) is_lit: bool,
    /// Size in bytes of the buffer that is read back.
    pub(crate) read_bytes: u64,
}

impl SlotSize {
    pub(crate) fn fits(&self, wanted: &Self) -> bool {
        self.num_pixels >= wanted.num_pixels
            && self.wall_bytes >= wanted.wall_bytes
            && self.read_bytes >= wanted.read_bytes
            && (self.is_lit || !wanted.is_lit)
    }
}

/// Buffers of one picture, which are reused for later pictures.
#[derive(Debug)]
pub(crate) struct Slot {
    pub(crate) size: SlotSize,
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
