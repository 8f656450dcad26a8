//! Cached data on the device that change rarely between pictures: directions of rays and transfer tables.

use std::{ops::Range, sync::Arc};

use carina_grid::Camera;
use carina_raycast::FrameParameters;

use crate::{
    Gpu,
    device::lock,
    resources::{Directions, DirectionsKey, TableOnDevice},
};

/// Number of cached sets of ray directions, and of cached transfer tables.
///
/// While a camera moves, the frame budget alternates between a few picture sizes and ray steps.
const MAX_CACHED: usize = 6;

/// Return the cached item of a key, or create and cache it; the least recently used item is removed if the cache is
/// full.
fn cached<T, K: PartialEq + ?Sized>(
    all: &mut Vec<Arc<T>>,
    key: &K,
    key_of: impl Fn(&T) -> &K,
    make: impl FnOnce() -> T,
) -> Arc<T> {
    let place = all.iter().position(|item| key_of(item) == key);
    let item = place.map_or_else(|| Arc::new(make()), |n| all.remove(n));
    all.insert(0, Arc::clone(&item));
    all.truncate(MAX_CACHED);
    item
}

/// Return the directions of the rays of `rows` in camera space; 0 for a pixel without a ray.
///
/// Directions of a pinhole camera are computed in f64 and rounded once, those of a lens are copied.
fn directions(camera: &Camera, rows: &Range<usize>) -> Vec<f32> {
    let (width, z) = (camera.width(), camera.focal_px());
    let (half_width, half_height) = (width as f64 / 2.0, camera.height() as f64 / 2.0);
    let mut out = Vec::with_capacity(rows.len() * width * 3);
    for row in rows.clone() {
        for column in 0..width {
            if let Some(rays) = camera.lens_rays() {
                out.extend(rays.direction(column, row));
                continue;
            }
            let (x, y) = (
                (column as f64 + 0.5) - half_width,
                (row as f64 + 0.5) - half_height,
            );
            let len = (x * x + y * y + z * z).sqrt();
            out.extend([x / len, y / len, z / len].map(|v| v as f32));
        }
    }
    out
}

impl Gpu {
    pub(crate) fn directions_of(&self, camera: &Camera, rows: &Range<usize>) -> Arc<Directions> {
        let key = DirectionsKey {
            lens: camera.shared_lens_rays().cloned(),
            focal_px_bits: camera.focal_px().to_bits(),
            width: camera.width(),
            height: camera.height(),
            rows: rows.clone(),
        };
        let mut all = lock(&self.directions);
        cached(
            &mut all,
            &key,
            |item| &item.key,
            || Directions {
                buffer: self.filled(
                    "directions",
                    bytemuck::cast_slice(&directions(camera, rows)),
                ),
                key: key.clone(),
            },
        )
    }

    pub(crate) fn table_of(&self, parameters: &FrameParameters<'_>) -> Arc<TableOnDevice> {
        let mut all = lock(&self.tables);
        let wanted = parameters.entries;
        cached(
            &mut all,
            wanted,
            |item| &item.entries,
            || TableOnDevice {
                buffer: self.filled("table", bytemuck::cast_slice(wanted)),
                entries: wanted.to_vec(),
            },
        )
    }

    /// Create a buffer on the device that contains `bytes` and that shaders can read.
    fn filled(&self, label: &str, bytes: &[u8]) -> wgpu::Buffer {
        let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.len() as u64,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        self.queue.write_buffer(&buffer, 0, bytes);
        buffer
    }
}
