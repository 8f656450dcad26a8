//! Upload of volumes and radius maps to the device.

use std::sync::Mutex;

use crate::{Gpu, GpuError, GpuMap, GpuVolume};

/// Number of bytes that are passed to the driver at a time; the driver copies each part until the part is uploaded.
const UPLOAD_BYTES: usize = 32 << 20;

impl Gpu {
    /// Upload the values of a volume, `[z, y, x]`.
    ///
    /// # Errors
    ///
    /// Returns an error if the volume does not fit or the device is lost.
    pub fn upload_volume(
        &self,
        hu_zyx: &[i16],
        shape_zyx: [usize; 3],
    ) -> Result<GpuVolume, GpuError> {
        let bytes = bytemuck::cast_slice(hu_zyx);
        let format = wgpu::TextureFormat::R16Sint;
        Ok(GpuVolume {
            view: self.upload("the volume", bytes, shape_zyx, 2, format)?,
            shape_zyx,
            owner: self.id,
            slopes: Mutex::default(),
        })
    }

    /// Upload the radius map of the cells of transparent classes, `[z, y, x]`.
    ///
    /// # Errors
    ///
    /// Returns an error if the map has the wrong size or does not fit, or if the device is lost.
    pub fn upload_map(&self, radius_zyx: &[u8], shape_zyx: [usize; 3]) -> Result<GpuMap, GpuError> {
        let format = wgpu::TextureFormat::R8Uint;
        Ok(GpuMap {
            view: self.upload("the radius map", radius_zyx, shape_zyx, 1, format)?,
            shape_zyx,
            owner: self.id,
        })
    }

    /// Upload voxel data to a 3D texture.
    ///
    /// A texture needs one fetch per voxel, has locality along all three axes, and is independent of the largest buffer
    /// that a shader may bind (128 MB on some devices).
    fn upload(
        &self,
        what: &'static str,
        bytes: &[u8],
        [nz, ny, nx]: [usize; 3],
        bytes_per_voxel: usize,
        format: wgpu::TextureFormat,
    ) -> Result<wgpu::TextureView, GpuError> {
        assert_eq!(
            bytes.len(),
            nz * ny * nx * bytes_per_voxel,
            "the values are not of this shape"
        );
        let most = self.device.limits().max_texture_dimension_3d as usize;
        if [nz, ny, nx].iter().any(|&n| n > most || n == 0) {
            return Err(GpuError::DoesNotFit {
                what,
                reason: format!("{nx} x {ny} x {nz} voxels; an axis has 1 to {most} here"),
            });
        }
        let (texture, refused) = self.watched(|| {
            self.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(what),
                size: extent(nx, ny, nz),
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D3,
                format,
                usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
                view_formats: &[],
            })
        });
        if let Some(reason) = refused {
            return Err(GpuError::DoesNotFit { what, reason });
        }
        let slice = ny * nx * bytes_per_voxel;
        let slices = (UPLOAD_BYTES / slice).max(1);
        let ((), failed) = self.watched(|| {
            for (n, part) in bytes.chunks(slice * slices).enumerate() {
                self.queue.write_texture(
                    wgpu::TexelCopyTextureInfo {
                        texture: &texture,
                        mip_level: 0,
                        origin: wgpu::Origin3d {
                            x: 0,
                            y: 0,
                            z: (n * slices) as u32,
                        },
                        aspect: wgpu::TextureAspect::All,
                    },
                    part,
                    wgpu::TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some((nx * bytes_per_voxel) as u32),
                        rows_per_image: Some(ny as u32),
                    },
                    extent(nx, ny, part.len() / slice),
                );
                // Before the next part is copied, the driver must have released this copy.
                let index = self.queue.submit([]);
                self.wait(index);
            }
        });
        if let Some(reason) = failed {
            return Err(GpuError::DoesNotFit { what, reason });
        }
        self.check_alive()?;
        Ok(texture.create_view(&wgpu::TextureViewDescriptor::default()))
    }
}

const fn extent(nx: usize, ny: usize, nz: usize) -> wgpu::Extent3d {
    wgpu::Extent3d {
        width: nx as u32,
        height: ny as u32,
        depth_or_array_layers: nz as u32,
    }
}
