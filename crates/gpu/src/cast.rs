//! Casting of a picture on the device: one dispatch for each band of rows, read back when the band is finished.

use std::ops::Range;

use carina_raycast::{
    CastStats, Frame, FrameParameters, Gathered, Interpolation, Method, RaycastError,
    rows_to_gather,
};
use rayon::prelude::*;

use crate::{
    Gpu, GpuError, GpuMap, GpuVolume,
    device::{Variant, lock},
    resources::Slot,
    uniforms::Uniforms,
};

/// Number of pixels along each side of a workgroup.
const GROUP: usize = 8;
/// Largest number of pixels of a band; it limits the buffers to 16 MB for a picture and to 80 MB for walls.
const BAND_PIXELS: usize = 1 << 21;
/// Largest number of samples of all rays of a band.
///
/// Desktop systems reset a device that does not answer for about two seconds; the slowest useful device takes some 10^9
/// samples a second.
const BAND_SAMPLES: f64 = 5e8;
/// Largest number of steps of a ray; f32 counts steps exactly to 2^24, and the ends of a ray are computed in f32 here.
const MAX_STEPS: f64 = 4_194_304.0;
/// Number of 32-bit words per pixel in the output of walls.
const WORDS_OF_A_WALL: usize = 5;
/// Smallest number of pixels that one CPU thread converts after the read-back.
const SHARE: usize = 1 << 13;
/// Number of counters that a workgroup writes.
const COUNTS: usize = 5;

/// Frame to be cast, with its volume and its radius map on the device.
#[derive(Clone, Copy)]
struct Job<'a> {
    frame: &'a Frame<'a>,
    parameters: &'a FrameParameters<'a>,
    volume: &'a GpuVolume,
    map: Option<&'a GpuMap>,
    variant: Variant,
}

impl Gpu {
    /// Cast `rows` of a picture as 8-bit RGB, `[row, column, channel]`.
    ///
    /// `volume` contains the values of the frame's volume, `map` the radii of its transparent classes; without a map
    /// every sample is taken. The picture equals that of the CPU within one grey level on all but a few pixels (see the
    /// crate documentation).
    ///
    /// # Errors
    ///
    /// Returns an error if the device cannot cast the frame or is lost.
    pub fn cast(
        &self,
        frame: &Frame<'_>,
        volume: &GpuVolume,
        map: Option<&GpuMap>,
        rows: Range<usize>,
    ) -> Result<(Vec<u8>, CastStats), GpuError> {
        let mut rgb: Vec<[u8; 3]> = Vec::with_capacity(rows.len() * frame.camera().width());
        let stats = self.bands(frame, volume, map, rows, false, |words| {
            let pixels = words.as_chunks::<4>().0.par_iter().with_min_len(SHARE);
            rgb.par_extend(pixels.clone().map(|&[r, g, b, _]| [r, g, b]));
            // The buffer was cleared, so a pixel that the kernel did not write has an alpha of 0.
            pixels.filter(|pixel| pixel[3] != 255).count()
        })?;
        Ok((rgb.into_flattened(), stats))
    }

    /// Cast the rays of `rows` without any light and return their results, including first walls, `[row, column]`.
    ///
    /// [`carina_raycast::light_gathered`] shades the result if the frame has an appearance.
    ///
    /// # Errors
    ///
    /// Returns an error if the device cannot cast the frame or is lost.
    pub fn cast_walls(
        &self,
        frame: &Frame<'_>,
        volume: &GpuVolume,
        map: Option<&GpuMap>,
        rows: Range<usize>,
    ) -> Result<(Vec<Gathered>, CastStats), GpuError> {
        let mut walls = Vec::with_capacity(rows.len() * frame.camera().width());
        let stats = self.bands(frame, volume, map, rows, true, |words| {
            let before = walls.len();
            let pixels = words.as_chunks::<{ 4 * WORDS_OF_A_WALL }>().0.par_iter();
            walls.par_extend(pixels.with_min_len(SHARE).map(|pixel| {
                let [r, g, b, transparency, hit] = bytemuck::pod_read_unaligned::<[f32; 5]>(pixel);
                Gathered {
                    rgb: [r, g, b],
                    transparency,
                    hit,
                }
            }));
            // The distance of a first wall is above 0 steps; -1 means no wall.
            walls[before..]
                .par_iter()
                .with_min_len(SHARE)
                .filter(|wall| wall.hit == 0.0)
                .count()
        })?;
        Ok((walls, stats))
    }

    /// Cast the rays that [`carina_raycast::light_gathered`] needs to shade `rows`.
    ///
    /// The statistics are of `rows` alone, so that the statistics of strips can be added.
    ///
    /// # Errors
    ///
    /// Returns an error if the device cannot cast the frame or is lost.
    pub fn cast_walls_to_light(
        &self,
        frame: &Frame<'_>,
        volume: &GpuVolume,
        map: Option<&GpuMap>,
        rows: &Range<usize>,
    ) -> Result<(Vec<Gathered>, CastStats), GpuError> {
        let all = rows_to_gather(frame, rows);
        let (walls, stats) = self.cast_walls(frame, volume, map, rows.clone())?;
        if all == *rows {
            return Ok((walls, stats));
        }
        let cast_rows = |rows: Range<usize>| {
            if rows.is_empty() {
                return Ok(Vec::new());
            }
            Ok::<_, GpuError>(self.cast_walls(frame, volume, map, rows)?.0)
        };
        let (before, after) = (
            cast_rows(all.start..rows.start)?,
            cast_rows(rows.end..all.end)?,
        );
        Ok(([before, walls, after].concat(), stats))
    }

    /// Cast rows of a frame band by band.
    ///
    /// `take` receives the output of the kernel for each band and returns the number of pixels that the kernel did not
    /// write.
    fn bands(
        &self,
        frame: &Frame<'_>,
        volume: &GpuVolume,
        map: Option<&GpuMap>,
        rows: Range<usize>,
        walls: bool,
        mut take: impl FnMut(&[u8]) -> usize,
    ) -> Result<CastStats, GpuError> {
        self.check_alive()?;
        let parameters = &frame.parameters();
        check(self, parameters, volume, map, &rows, walls)?;
        let variant = Variant {
            shaded: parameters.options.light.is_some() && !walls,
            nearest: parameters.options.interpolation == Interpolation::Nearest,
            leap: map.is_some(),
            walls,
        };
        let job = Job {
            frame,
            parameters,
            volume,
            map,
            variant,
        };
        let by_samples = BAND_SAMPLES / (parameters.width as f64 * parameters.most_steps);
        let num_rows = (BAND_PIXELS / parameters.width)
            .min(by_samples as usize)
            .max(1);
        let mut stats = CastStats {
            num_rays: (rows.len() * parameters.width) as u64,
            ..CastStats::default()
        };
        for first in rows.clone().step_by(num_rows) {
            let band = first..(first + num_rows).min(rows.end);
            let num_missing = self.band(job, &band, &mut stats, &mut take)?;
            if num_missing > 0 {
                return Err(GpuError::Incomplete {
                    name: self.facts.name.clone(),
                    num_missing,
                });
            }
        }
        // Leaps with a map of transparent classes read no label, so the reads are those of brute force plus the
        // look-ups.
        Ok(stats.with_loads(frame, Method::Brute))
    }

    fn band(
        &self,
        job: Job<'_>,
        rows: &Range<usize>,
        stats: &mut CastStats,
        take: &mut impl FnMut(&[u8]) -> usize,
    ) -> Result<usize, GpuError> {
        let width = job.parameters.width;
        let words = if job.variant.walls {
            WORDS_OF_A_WALL
        } else {
            1
        };
        let groups = [width.div_ceil(GROUP), rows.len().div_ceil(GROUP)];
        let out_bytes = 4 * (rows.len() * width * words) as u64;
        let count_bytes = 4 * (groups[0] * groups[1] * COUNTS) as u64;
        let slot = self.slot(out_bytes, count_bytes);
        let uniforms = Uniforms::new(job.parameters, rows.len());
        self.queue
            .write_buffer(&slot.uniforms, 0, bytemuck::bytes_of(&uniforms));
        let bindings = self.bindings(job, rows, &slot);
        let mut encoder = self
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        // The buffer is cleared, because a pixel that the kernel does not write must not show the previous picture.
        encoder.clear_buffer(&slot.out, 0, Some(out_bytes));
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&self.pipeline(job.variant));
            pass.set_bind_group(0, &bindings, &[]);
            pass.dispatch_workgroups(groups[0] as u32, groups[1] as u32, 1);
        }
        let end = out_bytes + count_bytes;
        encoder.copy_buffer_to_buffer(&slot.out, 0, &slot.staging, 0, out_bytes);
        encoder.copy_buffer_to_buffer(&slot.counts, 0, &slot.staging, out_bytes, count_bytes);
        let index = self.queue.submit([encoder.finish()]);
        // The read-back is queued behind the kernel; another thread may submit its picture while this one waits.
        let (sender, receiver) = std::sync::mpsc::channel();
        slot.staging
            .map_async(wgpu::MapMode::Read, 0..end, move |done| {
                let _ = sender.send(done);
            });
        self.wait(index);
        self.check_alive()?;
        let lost = |reason: String| GpuError::Device {
            name: self.facts.name.clone(),
            reason,
        };
        // The first thread that detects the completion runs all callbacks; this may be the thread of another picture.
        receiver
            .recv_timeout(self.facts.kind.patience())
            .map_err(|_| lost("the picture did not come back".to_owned()))?
            .map_err(|e| lost(e.to_string()))?;
        let num_missing = {
            let bytes = slot.staging.get_mapped_range(0..end);
            let bytes = bytes.map_err(|e| lost(e.to_string()))?;
            let (out, counts) = bytes.split_at(out_bytes as usize);
            add_counts(stats, counts, job.variant.shaded);
            take(out)
        };
        slot.staging.unmap();
        self.check_alive()?;
        // The slot is returned only after success, because the slot of a failed picture may still be mapped or in use.
        lock(&self.slots).push(slot);
        Ok(num_missing)
    }

    fn bindings(&self, job: Job<'_>, rows: &Range<usize>, slot: &Slot) -> wgpu::BindGroup {
        let directions = self.directions_of(job.frame.camera(), rows);
        let table = self.table_of(job.parameters);
        let textures = [&job.volume.view, &job.map.unwrap_or(&self.no_map).view];
        let buffers = [&table.buffer, &directions.buffer, &slot.out, &slot.counts];
        let mut resources = vec![slot.uniforms.as_entire_binding()];
        resources.extend(textures.map(wgpu::BindingResource::TextureView));
        resources.extend(buffers.map(wgpu::Buffer::as_entire_binding));
        let entries: Vec<_> = (0u32..)
            .zip(resources)
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("airway"),
            layout: &self.layout,
            entries: &entries,
        })
    }
}

/// Add the counters of all workgroups to the statistics.
fn add_counts(stats: &mut CastStats, counts: &[u8], shaded: bool) {
    for group in counts.as_chunks::<{ 4 * COUNTS }>().0 {
        let [samples, lookups, leaps, skipped, lit] =
            bytemuck::pod_read_unaligned::<[u32; COUNTS]>(group).map(u64::from);
        stats.num_samples += samples;
        stats.num_lookups += lookups;
        stats.num_leaps += leaps;
        stats.num_skipped += skipped;
        stats.num_shaded += if shaded { lit } else { 0 };
    }
}

fn check(
    gpu: &Gpu,
    parameters: &FrameParameters<'_>,
    volume: &GpuVolume,
    map: Option<&GpuMap>,
    rows: &Range<usize>,
    walls: bool,
) -> Result<(), GpuError> {
    let refuse = |what: &'static str, expected: String, found: String| {
        let setting = RaycastError::Setting {
            what,
            expected,
            found,
        };
        Err(GpuError::Raycast(setting))
    };
    if rows.start > rows.end || rows.end > parameters.height {
        return refuse(
            "rows",
            format!("a range within 0 to {}", parameters.height),
            format!("{} to {}", rows.start, rows.end),
        );
    }
    let [ni, nj, nk] = parameters.shape_ijk;
    let map = map.map(|map| ("radius map on the device", map.shape_zyx, map.owner));
    let volume = ("volume on the device", volume.shape_zyx, volume.owner);
    for (what, shape, owner) in [volume].into_iter().chain(map) {
        if shape != [nk, nj, ni] || owner != gpu.id {
            return refuse(
                what,
                format!("the frame's {ni} x {nj} x {nk} voxels, on the same device"),
                format!("{} x {} x {}", shape[2], shape[1], shape[0]),
            );
        }
    }
    if parameters.options.appearance.is_some() && !walls {
        return Err(GpuError::Unsupported {
            reason: "light is laid on walls after casting: cast_walls, then light_gathered"
                .to_owned(),
        });
    }
    if parameters.most_steps > MAX_STEPS {
        return Err(GpuError::Unsupported {
            reason: format!(
                "a ray has {:.0} steps, at most {MAX_STEPS:.0} are counted exactly",
                parameters.most_steps
            ),
        });
    }
    Ok(())
}
