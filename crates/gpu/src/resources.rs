//! Resources on the device: volumes, maps and decorations, directions of rays, transfer tables.

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

/// Radius map on the device.
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
    /// Radii of the transparent classes; without a map every sample is taken.
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

/// Transfer table on the device.
#[derive(Debug)]
pub(crate) struct TableOnDevice {
    pub(crate) buffer: wgpu::Buffer,
    pub(crate) entries: Vec<[f32; 4]>,
}
