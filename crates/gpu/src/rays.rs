//! Cached data on the device that change rarely between pictures: ray directions of a lens and transfer tables.

use std::sync::Arc;

use carina_grid::{Camera, FULL_GAIN, LensRays};
use carina_raycast::FrameParameters;
use rayon::prelude::*;

use crate::{
    Gpu, GpuError,
    device::lock,
    resources::{Directions, TableOnDevice},
};

/// Maximum number of cached sets of ray directions, and of cached transfer tables.
///
/// While a camera moves, the frame budget alternates between a few picture sizes and ray steps.
const MAX_CACHED: usize = 6;
/// Maximum number of bytes of all cached ray directions; the directions of one picture are cached even if they are
/// larger.
const MAX_DIRECTION_BYTES: u64 = 192 << 20;

/// Return for each pixel the direction of its ray through the lens, a unit vector in camera space, and the pixel's
/// gain.
///
/// The direction of a pixel without a ray is 0.
fn directions(lens: &LensRays) -> Vec<[f32; 4]> {
    let width = lens.width();
    let pixels = (0..width * lens.height()).into_par_iter();
    pixels
        .map(|n| {
            let (column, row) = (n % width, n / width);
            let [x, y, z] = lens.direction(column, row);
            let gain = f32::from(lens.gain(column, row)) / f32::from(FULL_GAIN);
            [x, y, z, gain]
        })
        .collect()
}

impl Gpu {
    /// Return the buffer with the ray directions of all pixels of a camera that has a lens.
    ///
    /// One buffer serves all bands of a picture. The shader computes the directions of a pinhole camera.
    pub(crate) fn directions_of(&self, camera: &Camera) -> Result<wgpu::Buffer, GpuError> {
        let Some(lens) = camera.shared_lens_rays() else {
            return Ok(self.nothing.clone());
        };
        let mut all = lock(&self.directions);
        if let Some(n) = all.iter().position(|item| Arc::ptr_eq(&item.lens, lens)) {
            let item = all.remove(n);
            all.insert(0, item);
        } else {
            let buffer = self.filled(
                "the rays of the lens",
                bytemuck::cast_slice(&directions(lens)),
            )?;
            let lens = Arc::clone(lens);
            all.insert(0, Directions { buffer, lens });
            all.truncate(MAX_CACHED);
            while all.len() > 1
                && all.iter().map(|item| item.buffer.size()).sum::<u64>() > MAX_DIRECTION_BYTES
            {
                all.pop();
            }
        }
        Ok(all[0].buffer.clone())
    }

    /// Return the buffer with a transfer table; upload the table if it is not cached.
    pub(crate) fn table_of(
        &self,
        parameters: &FrameParameters<'_>,
    ) -> Result<wgpu::Buffer, GpuError> {
        let mut all = lock(&self.tables);
        let wanted = parameters.entries;
        if let Some(n) = all.iter().position(|item| item.entries == wanted) {
            let item = all.remove(n);
            all.insert(0, item);
        } else {
            let buffer = self.filled("the transfer table", bytemuck::cast_slice(wanted))?;
            let entries = wanted.to_vec();
            all.insert(0, TableOnDevice { buffer, entries });
            all.truncate(MAX_CACHED);
        }
        Ok(all[0].buffer.clone())
    }

    /// Create a buffer of zeros on the device that shaders can read and write.
    pub(crate) fn storage(
        &self,
        what: &'static str,
        bytes: usize,
    ) -> Result<wgpu::Buffer, GpuError> {
        let most = self.device.limits().max_storage_buffer_binding_size;
        if bytes as u64 > most {
            return Err(GpuError::DoesNotFit {
                what,
                reason: format!("{bytes} bytes; a buffer has at most {most} here"),
            });
        }
        let (buffer, refused) = self.watched(|| {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(what),
                size: bytes.max(16) as u64,
                usage: wgpu::BufferUsages::STORAGE
                    | wgpu::BufferUsages::COPY_DST
                    | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            })
        });
        refused.map_or(Ok(buffer), |reason| {
            Err(GpuError::DoesNotFit { what, reason })
        })
    }

    /// Create a buffer on the device that contains `bytes`.
    pub(crate) fn filled(
        &self,
        what: &'static str,
        bytes: &[u8],
    ) -> Result<wgpu::Buffer, GpuError> {
        let buffer = self.storage(what, bytes.len())?;
        self.queue.write_buffer(&buffer, 0, bytes);
        Ok(buffer)
    }
}
