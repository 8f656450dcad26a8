//! Casting of a picture on the device: bands of rows, one after the other, and one read-back of the finished picture.

use std::ops::Range;

use carina_raycast::{
    CastStats, Frame, FrameParameters, Gathered, Interpolation, Method, RaycastError, WallLighting,
    rows_to_gather,
};
use rayon::prelude::*;

use crate::{
    Gpu, GpuError, GpuMap, GpuVolume,
    light_uniforms::LightUniforms,
    passes::Tables,
    picture::{Picture, WORDS_OF_A_WALL},
    read_back::add_counts,
    resources::{COUNT_BYTES, RESULT_BYTES, Resident, SlotSize},
    stages::{Stage, Variant},
    uniforms::{Band, Uniforms},
};

/// Number of pixels along each side of the square that one workgroup casts.
const GROUP: usize = 8;
/// Maximum number of pixels of a band (rows that are cast together); it limits the buffer of a band's rays to 40 MB.
const BAND_PIXELS: usize = 1 << 21;
/// Maximum number of samples of all rays of a band (rows that are cast together).
///
/// Desktop systems reset a device that does not answer for about two seconds; the slowest useful device takes some 10^9
/// samples a second.
const BAND_SAMPLES: f64 = 5e8;
/// Maximum number of steps of a ray; f32 counts steps exactly to 2^24, and the shader computes the ends of a ray in
/// f32.
const MAX_STEPS: f64 = 4_194_304.0;
/// Minimum number of pixels that one CPU thread converts after they were read back from the device.
const SHARE: usize = 1 << 13;
/// Number of workgroups that compute the requested bricks (cubes of voxels) of slopes.
const FILL_GROUPS: u32 = 256;
/// Maximum number of workgroups that cast silhouette pixels again, and number of threads of each.
const SMOOTH_GROUPS: usize = 512;
const SMOOTH_THREADS: usize = 64;
/// Number of workgroups that cast the eight rays each from which the exposure is measured.
const METER_GROUPS: u32 = 18;

impl Gpu {
    /// Cast and shade `rows` of a picture on the device; return 8-bit RGB, `[row, column, channel]`.
    ///
    /// `darken` applies the gains of the lens. The picture equals that of the CPU within one grey level on all but a few
    /// pixels (see the crate documentation).
    ///
    /// # Errors
    ///
    /// Returns an error if the device cannot cast the frame or is lost.
    pub fn cast(
        &self,
        frame: &Frame<'_>,
        resident: Resident<'_>,
        rows: Range<usize>,
        darken: bool,
    ) -> Result<(Vec<u8>, CastStats), GpuError> {
        let parameters = &frame.parameters();
        check(self, parameters, resident, &rows)?;
        let width = parameters.width;
        let mut stats = CastStats {
            num_rays: (rows.len() * width) as u64,
            ..CastStats::default()
        };
        if rows.is_empty() {
            return Ok((Vec::new(), stats));
        }
        let lighting = frame.wall_lighting();
        let smooths = lighting
            .as_ref()
            .is_some_and(|light| light.appearance.silhouettes);
        let variant = Variant {
            shaded: parameters.options.light.is_some(),
            nearest: parameters.options.interpolation == Interpolation::Nearest,
            leap: resident.map.is_some(),
            walls: lighting.is_some(),
        };
        let all = rows_to_gather(frame, &rows);
        let num_rows = rows_per_band(parameters);
        let picture = self.prepared(
            frame,
            resident,
            variant,
            (all.clone(), num_rows),
            lighting.as_ref(),
            darken,
        )?;
        self.start_picture(&picture)?;
        let mut bands: Vec<Band> = Vec::new();
        let mut add = |rows: Range<usize>, counts_work: bool| {
            let starts = rows.clone().step_by(num_rows);
            bands.extend(starts.map(|first| Band {
                rows: first..(first + num_rows).min(rows.end),
                all: all.clone(),
                counts_work,
            }));
        };
        // The rows beside a strip belong to other strips, which count their work.
        add(all.start..rows.start, false);
        add(rows.clone(), true);
        add(rows.end..all.end, false);
        for band in &bands {
            self.band(&picture, band);
        }
        if smooths {
            self.smooth(&picture, &rows, parameters);
        }
        let first = (rows.start - all.start) * width;
        let mut rgb: Vec<[u8; 3]> = Vec::with_capacity(rows.len() * width);
        let num_missing = self.results(picture, first..first + rows.len() * width, |results| {
            add_counts(&mut stats, results.counts, variant.shaded);
            let pixels = results
                .pixels
                .as_chunks::<4>()
                .0
                .par_iter()
                .with_min_len(SHARE);
            rgb.par_extend(pixels.clone().map(|&[r, g, b, _]| [r, g, b]));
            stats = stats.with_loads(frame, Method::Brute);
            if variant.walls {
                stats = stats.with_lit_walls(u64::from(results.num_lit));
            }
            // The buffer was cleared, so a pixel that the kernels did not write has an alpha of 0.
            pixels.filter(|pixel| pixel[3] != 255).count()
        })?;
        if num_missing > 0 {
            return Err(GpuError::Incomplete {
                name: self.facts.name.clone(),
                num_missing,
            });
        }
        Ok((rgb.into_flattened(), stats))
    }

    /// Cast the rays of `rows` without any light; return colour, transparency and first wall of each, `[row, column]`.
    ///
    /// # Errors
    ///
    /// Returns an error if the device cannot cast the frame or is lost.
    pub fn cast_walls(
        &self,
        frame: &Frame<'_>,
        resident: Resident<'_>,
        rows: Range<usize>,
    ) -> Result<(Vec<Gathered>, CastStats), GpuError> {
        let parameters = &frame.parameters();
        check(self, parameters, resident, &rows)?;
        let width = parameters.width;
        let variant = Variant {
            shaded: false,
            nearest: parameters.options.interpolation == Interpolation::Nearest,
            leap: resident.map.is_some(),
            walls: true,
        };
        let mut stats = CastStats {
            num_rays: (rows.len() * width) as u64,
            ..CastStats::default()
        };
        let mut walls = Vec::with_capacity(rows.len() * width);
        let num_rows = rows_per_band(parameters);
        for first in rows.clone().step_by(num_rows) {
            let band = first..(first + num_rows).min(rows.end);
            let picture = self.prepared(
                frame,
                resident,
                variant,
                (band.clone(), num_rows),
                None,
                false,
            )?;
            self.start_picture(&picture)?;
            let num_pixels = band.len() * width;
            self.band(
                &picture,
                &Band {
                    rows: band.clone(),
                    all: band,
                    counts_work: true,
                },
            );
            let before = walls.len();
            self.results(picture, 0..num_pixels, |results| {
                add_counts(&mut stats, results.counts, false);
                let pixels = results
                    .pixels
                    .as_chunks::<{ 4 * WORDS_OF_A_WALL }>()
                    .0
                    .par_iter();
                walls.par_extend(pixels.with_min_len(SHARE).map(|pixel| {
                    let [r, g, b, transparency, hit] =
                        bytemuck::pod_read_unaligned::<[f32; 5]>(pixel);
                    Gathered {
                        rgb: [r, g, b],
                        transparency,
                        hit,
                    }
                }));
            })?;
            // The distance of a first wall is above 0 steps; -1 means no wall.
            let new = walls[before..].par_iter().with_min_len(SHARE);
            let num_missing = new.filter(|wall| wall.hit == 0.0).count();
            if num_missing > 0 {
                return Err(GpuError::Incomplete {
                    name: self.facts.name.clone(),
                    num_missing,
                });
            }
        }
        // A radius map of transparent classes has no labels to read. The reads of a picture with leaps (skipped
        // regions) are therefore counted as those of its samples by brute force, plus the reads of the map.
        Ok((walls, stats.with_loads(frame, Method::Brute)))
    }

    /// Prepare the device's resources of a picture: buffers, directions of rays, transfer table and stores.
    ///
    /// `rows` are the rows of the picture's buffers and the number of rows of a band.
    fn prepared<'a>(
        &self,
        frame: &'a Frame<'a>,
        resident: Resident<'a>,
        variant: Variant,
        (all, num_rows): (Range<usize>, usize),
        lighting: Option<&WallLighting<'_>>,
        darken: bool,
    ) -> Result<Picture<'a>, GpuError> {
        self.check_alive()?;
        let parameters = &frame.parameters();
        let num_pixels = (all.len() * parameters.width) as u64;
        let band_pixels = (num_rows.min(all.len()) * parameters.width) as u64;
        let wall_bytes = if variant.walls {
            4 * WORDS_OF_A_WALL as u64 * band_pixels
        } else {
            0
        };
        let only_walls = variant.walls && lighting.is_none();
        let pixel_bytes = if only_walls {
            wall_bytes
        } else {
            4 * num_pixels
        };
        let slot = self.slot(SlotSize {
            num_pixels,
            wall_bytes,
            is_lit: lighting.is_some(),
            read_bytes: pixel_bytes + COUNT_BYTES + RESULT_BYTES + 4,
        })?;
        let field = lighting.and_then(|light| light.decoration);
        let cells = match (field, resident.decoration) {
            (None, _) => self.nothing.clone(),
            (Some(field), Some(on_device)) => {
                if on_device.owner != self.id || on_device.num_numbers != 4 * field.cells.len() {
                    return refuse(
                        "decoration on the device",
                        format!(
                            "the frame's {} numbers, on the same device",
                            4 * field.cells.len()
                        ),
                        on_device.num_numbers.to_string(),
                    );
                }
                on_device.cells.clone()
            }
            (Some(field), None) => {
                self.filled("the decoration", bytemuck::cast_slice(field.cells))?
            }
        };
        let light = match lighting {
            None => None,
            Some(light) => {
                let slopes = self.slopes_of(&resident.volume.slopes, light)?;
                Some((LightUniforms::new(light, slopes.num_bricks), slopes))
            }
        };
        Ok(Picture {
            frame,
            resident,
            variant,
            all,
            darken,
            tables: Tables {
                transfer: self.table_of(parameters)?,
                directions: self.directions_of(frame.camera())?,
                cells,
            },
            slot,
            light,
        })
    }

    pub(crate) fn encoder(&self) -> wgpu::CommandEncoder {
        self.device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// Add the dispatch of a stage's kernel to a compute pass.
    fn dispatch(
        &self,
        pass: &mut wgpu::ComputePass<'_>,
        picture: &Picture<'_>,
        stage: Stage,
        [x, y]: [u32; 2],
    ) {
        let slopes = picture.light.as_ref().map(|(_, slopes)| &**slopes);
        let (resident, tables) = (&picture.resident, &picture.tables);
        pass.set_pipeline(&self.pipeline(stage, picture.variant));
        let bindings = self.bound(stage, resident, tables, &picture.slot, slopes);
        pass.set_bind_group(0, &bindings, &[]);
        pass.dispatch_workgroups(x, y, 1);
    }

    /// Clear the buffers of a picture and compute its exposure.
    fn start_picture(&self, picture: &Picture<'_>) -> Result<(), GpuError> {
        let slot = &picture.slot;
        let mut encoder = self.encoder();
        // The pixels are cleared, because a pixel that no kernel writes must not show the previous picture.
        encoder.clear_buffer(&slot.pixels, 0, None);
        encoder.clear_buffer(&slot.counts, 0, None);
        encoder.clear_buffer(&slot.state, 0, Some(RESULT_BYTES));
        if let Some((light, slopes)) = &picture.light {
            self.queue
                .write_buffer(&slot.light, 0, bytemuck::bytes_of(light));
            self.write_uniforms(picture, &picture.all, false);
            slopes.empty_if_full(&mut encoder);
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            self.dispatch(&mut pass, picture, Stage::Meter, [METER_GROUPS, 1]);
            self.dispatch(&mut pass, picture, Stage::Expose, [1, 1]);
        }
        self.queue.submit([encoder.finish()]);
        self.check_alive()
    }

    fn write_uniforms(&self, picture: &Picture<'_>, rows: &Range<usize>, counts_work: bool) {
        let band = Band {
            rows: rows.clone(),
            all: picture.all.clone(),
            counts_work,
        };
        let uniforms = Uniforms::new(picture.frame, &band, picture.darken);
        self.queue
            .write_buffer(&picture.slot.uniforms, 0, bytemuck::bytes_of(&uniforms));
    }

    /// Cast and shade the rows of a band on the device; no result is read back.
    fn band(&self, picture: &Picture<'_>, band: &Band) {
        self.write_uniforms(picture, &band.rows, band.counts_work);
        let groups = groups_of(picture.frame, &band.rows);
        let mut encoder = self.encoder();
        encoder.clear_buffer(&picture.slot.walls, 0, None);
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            self.dispatch(&mut pass, picture, Stage::Cast, groups);
            if picture.light.is_some() {
                self.dispatch(&mut pass, picture, Stage::Request, groups);
                self.dispatch(&mut pass, picture, Stage::Fill, [FILL_GROUPS, 1]);
                self.dispatch(&mut pass, picture, Stage::Light, groups);
            }
        }
        self.queue.submit([encoder.finish()]);
    }

    /// Smooth the silhouettes in the rows of a picture, in dispatches that are short enough for the driver's time
    /// limit.
    fn smooth(&self, picture: &Picture<'_>, rows: &Range<usize>, parameters: &FrameParameters<'_>) {
        let Some((light, _)) = &picture.light else {
            return;
        };
        self.write_uniforms(picture, rows, true);
        let mut encoder = self.encoder();
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            let groups = groups_of(picture.frame, rows);
            self.dispatch(&mut pass, picture, Stage::Mark, groups);
        }
        self.queue.submit([encoder.finish()]);
        let num_pixels = rows.len() * parameters.width;
        // Each of the pixels gets two rays.
        let most = ((BAND_SAMPLES / (2.0 * parameters.most_steps)) as usize).clamp(1, num_pixels);
        for first in (0..num_pixels).step_by(most) {
            let part = light.smoothing(first, most);
            self.queue
                .write_buffer(&picture.slot.light, 0, bytemuck::bytes_of(&part));
            let mut encoder = self.encoder();
            {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                let groups = most.div_ceil(SMOOTH_THREADS).min(SMOOTH_GROUPS);
                self.dispatch(&mut pass, picture, Stage::Smooth, [groups as u32, 1]);
            }
            self.queue.submit([encoder.finish()]);
        }
    }
}

/// Return the number of workgroups across and down that cover rows of a picture.
fn groups_of(frame: &Frame<'_>, rows: &Range<usize>) -> [u32; 2] {
    [frame.camera().width(), rows.len()].map(|n| n.div_ceil(GROUP) as u32)
}

/// Return the number of rows that the device casts in one dispatch, so that no dispatch takes too long.
fn rows_per_band(parameters: &FrameParameters<'_>) -> usize {
    let by_samples = BAND_SAMPLES / (parameters.width as f64 * parameters.most_steps);
    (BAND_PIXELS / parameters.width)
        .min(by_samples as usize)
        .max(1)
}

/// Return the error of an invalid setting.
fn refuse<T>(what: &'static str, expected: String, found: String) -> Result<T, GpuError> {
    Err(GpuError::Raycast(RaycastError::Setting {
        what,
        expected,
        found,
    }))
}

fn check(
    gpu: &Gpu,
    parameters: &FrameParameters<'_>,
    resident: Resident<'_>,
    rows: &Range<usize>,
) -> Result<(), GpuError> {
    if rows.start > rows.end || rows.end > parameters.height {
        return refuse(
            "rows",
            format!("a range within 0 to {}", parameters.height),
            format!("{} to {}", rows.start, rows.end),
        );
    }
    let [ni, nj, nk] = parameters.shape_ijk;
    let of_map = |map: &GpuMap| ("radius map on the device", map.shape_zyx, map.owner);
    let of_volume = |volume: &GpuVolume| ("volume on the device", volume.shape_zyx, volume.owner);
    let volume = of_volume(resident.volume);
    for (what, shape, owner) in [volume].into_iter().chain(resident.map.map(of_map)) {
        if shape != [nk, nj, ni] || owner != gpu.id {
            return refuse(
                what,
                format!("the frame's {ni} x {nj} x {nk} voxels, on the same device"),
                format!("{} x {} x {}", shape[2], shape[1], shape[0]),
            );
        }
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
