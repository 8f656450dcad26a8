//! Parameters that all rays of a picture share, in the memory layout of the shader.

use std::ops::Range;

use bytemuck::{Pod, Zeroable};
use carina_raycast::Frame;

/// Parameters of a picture, equal field by field to the struct `Frame` of `airway.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct Uniforms {
    step_i: [f32; 4],
    step_j: [f32; 4],
    step_k: [f32; 4],
    origin: [f32; 4],
    to_low_face: [f32; 4],
    to_high_face: [f32; 4],
    between_faces: [u32; 4],
    last: [i32; 4],
    metric_square: [f32; 4],
    metric_mixed: [f32; 4],
    background: [f32; 4],
    light: [f32; 4],
    width: u32,
    num_rows: u32,
    shininess_log2: u32,
    table_last: i32,
    table_low_hu: i32,
    step_mm: f32,
    guard_vox: f32,
    stop: f32,
    focal_px: f32,
    half_width: f32,
    half_height: f32,
    height: u32,
    first_row: u32,
    out_row: u32,
    has_lens: u32,
    darkens: u32,
    counts_work: u32,
    num_all_rows: u32,
    first_of_all: u32,
    unused: u32,
}

/// Rows of a picture that one dispatch processes.
#[derive(Debug, Clone)]
pub(crate) struct Band {
    /// Rows of the picture that the band contains.
    pub(crate) rows: Range<usize>,
    /// Rows for which the buffers of the picture have space.
    pub(crate) all: Range<usize>,
    /// Whether the counters of rays, samples and look-ups include this band.
    pub(crate) counts_work: bool,
}

impl Uniforms {
    /// Return the parameters for a band of a frame; `darken` multiplies pixels by the gains of the lens (vignette).
    pub(crate) fn new(frame: &Frame<'_>, band: &Band, darken: bool) -> Self {
        let parameters = &frame.parameters();
        let camera = frame.camera();
        let has_lens = camera.lens_rays().is_some();
        // Products are computed in f64 and rounded once; the shader then needs three products per direction.
        let step = |row: usize| -> [f32; 4] {
            let m = parameters.ijk_from_camera.rows()[row];
            [m[0], m[1], m[2], 0.0].map(|v| (v * parameters.step_mm) as f32)
        };
        let lanes = |values: [f64; 3]| [values[0], values[1], values[2], 0.0].map(|v| v as f32);
        let shape = parameters.shape_ijk;
        let low: [f64; 3] = std::array::from_fn(|a| -0.5 - parameters.origin_ijk[a]);
        let high: [f64; 3] =
            std::array::from_fn(|a| shape[a] as f64 - 0.5 - parameters.origin_ijk[a]);
        let [xx, yy, zz, xy, xz, yz] = parameters.metric;
        let light = parameters.options.light;
        let [r, g, b] = parameters.options.background;
        Self {
            step_i: step(0),
            step_j: step(1),
            step_k: step(2),
            origin: lanes(parameters.origin_ijk),
            to_low_face: lanes(low),
            to_high_face: lanes(high),
            between_faces: std::array::from_fn(|a| {
                u32::from(a < 3 && low[a] <= 0.0 && high[a] >= 0.0)
            }),
            last: std::array::from_fn(|a| if a < 3 { shape[a] as i32 - 1 } else { 0 }),
            metric_square: [xx, yy, zz, 0.0],
            metric_mixed: [xy, xz, yz, 0.0],
            background: [r, g, b, 1.0],
            // For an infinite reach, 1/inf is 0: no light is lost. WGSL has no reliable infinities.
            light: light.map_or([0.0; 4], |light| {
                [
                    light.ambient,
                    light.diffuse,
                    light.specular,
                    1.0 / light.reach_mm,
                ]
            }),
            width: parameters.width as u32,
            num_rows: band.rows.len() as u32,
            shininess_log2: light.map_or(0, |light| light.shininess_log2),
            table_last: parameters.entries.len() as i32 - 1,
            table_low_hu: parameters.low_hu,
            step_mm: parameters.step_mm as f32,
            guard_vox: parameters.guard_vox,
            stop: parameters.stop,
            focal_px: camera.focal_px() as f32,
            half_width: parameters.width as f32 / 2.0,
            half_height: parameters.height as f32 / 2.0,
            height: parameters.height as u32,
            first_row: band.rows.start as u32,
            out_row: (band.rows.start - band.all.start) as u32,
            has_lens: u32::from(has_lens),
            darkens: u32::from(has_lens && darken),
            counts_work: u32::from(band.counts_work),
            num_all_rows: band.all.len() as u32,
            first_of_all: band.all.start as u32,
            unused: 0,
        }
    }
}
