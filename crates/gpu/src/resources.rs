//! Resources on the device: volumes and maps, buffers of pictures, directions of rays, transfer tables.

use std::{ops::Range, sync::Arc};

use carina_grid::LensRays;

/// Volume of int16 values on the device.
#[derive(Debug)]
pub struct GpuVolume {
    pub(crate) view: wgpu::TextureView,
    pub(crate) shape_zyx: [usize; 3],
    pub(crate) owner: u64,
}

/// Radius map on the device.
#[derive(Debug)]
pub struct GpuMap {
    pub(crate) view: wgpu::TextureView,
    pub(crate) shape_zyx: [usize; 3],
    pub(crate) owner: u64,
}

/// Buffers of one band of rows, which are reused for later bands.
#[derive(Debug)]
pub(crate) struct Slot {
    pub(crate) out_bytes: u64,
    pub(crate) count_bytes: u64,
    pub(crate) uniforms: wgpu::Buffer,
    pub(crate) out: wgpu::Buffer,
    pub(crate) counts: wgpu::Buffer,
    /// Buffer through which the CPU reads pixels and counters.
    pub(crate) staging: wgpu::Buffer,
}

/// Unit directions of some rows of pixels in camera space, for one lens and one size of picture.
#[derive(Debug)]
pub(crate) struct Directions {
    pub(crate) buffer: wgpu::Buffer,
    pub(crate) key: DirectionsKey,
}

/// Key of cached directions: all parameters on which they depend. The pose is not one of them.
#[derive(Debug, Clone)]
pub(crate) struct DirectionsKey {
    /// Rays of the lens, `None` for a pinhole; the reference prevents other rays from getting the same address.
    pub(crate) lens: Option<Arc<LensRays>>,
    pub(crate) focal_px_bits: u64,
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) rows: Range<usize>,
}

impl PartialEq for DirectionsKey {
    fn eq(&self, other: &Self) -> bool {
        let lens = match (&self.lens, &other.lens) {
            (None, None) => true,
            (Some(a), Some(b)) => Arc::ptr_eq(a, b),
            _ => false,
        };
        lens && self.focal_px_bits == other.focal_px_bits
            && (self.width, self.height) == (other.width, other.height)
            && self.rows == other.rows
    }
}

/// Transfer table on the device.
#[derive(Debug)]
pub(crate) struct TableOnDevice {
    pub(crate) buffer: wgpu::Buffer,
    pub(crate) entries: Vec<[f32; 4]>,
}
