//! Resources on the device: volumes, maps and decorations, directions of rays, transfer tables, buffers of pictures.

use std::sync::{Arc, Mutex};

use carina_grid::LensRays;

use crate::slope_store::SlopeStore;

/// Volume of int16 values on the device.
#[derive(Debug)]
pub struct GpuVolume {
    pub(crate) view: wgpu::TextureView,
    pub(crate) shape_zyx: [usize; 3],
    pub(crate) owner: u64,
    /// Slopes at the voxels near walls, from earlier pictures.
    pub(crate) slopes: Mutex<Option<Arc<SlopeStore>>>,
}

/// Radius map for leaps in the memory of the device.
#[derive(Debug)]
pub struct GpuMap {
    pub(crate) view: wgpu::TextureView,
    pub(crate) shape_zyx: [usize; 3],
    pub(crate) owner: u64,
}

/// Anatomical data of airway walls on the device.
#[derive(Debug)]
pub struct GpuDecoration {
    pub(crate) cells: wgpu::Buffer,
    pub(crate) num_numbers: usize,
    pub(crate) owner: u64,
}

/// Data of a scene on one device: volume, radius map for leaps, and anatomical data for the decoration.
#[derive(Debug, Clone, Copy)]
pub struct Resident<'a> {
    /// Values of the frame's volume.
    pub volume: &'a GpuVolume,
    /// Radius map for leaps over transparent classes; without a map the casters read every sample of a ray.
    pub map: Option<&'a GpuMap>,
    /// Anatomical data of the frame; without them, a decorated picture uploads them.
    pub decoration: Option<&'a GpuDecoration>,
}

/// Unit directions and gains of the pixels behind a lens, in camera space.
#[derive(Debug)]
pub(crate) struct Directions {
    pub(crate) buffer: wgpu::Buffer,
    /// Rays of the lens; the reference prevents other rays from getting the same address.
    pub(crate) lens: Arc<LensRays>,
}

/// Transfer table (colour and opacity by value) in the memory of the device.
#[derive(Debug)]
pub(crate) struct TableOnDevice {
    pub(crate) buffer: wgpu::Buffer,
    pub(crate) entries: Vec<[f32; 4]>,
}

/// Number of bytes of the counters of a picture's work in the buffer that is read back.
pub(crate) const COUNT_BYTES: u64 = 40;
/// Number of bytes of the results at the start of `State` that are read back.
pub(crate) const RESULT_BYTES: u64 = 16;
/// Number of bytes of `State` before the list of silhouettes.
pub(crate) const STATE_BYTES: u64 = RESULT_BYTES + 4 * 144;

/// Sizes of the buffers of a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SlotSize {
    /// Number of pixels for which the slot's buffers have colours, depths and silhouettes.
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
