//! Parameters of the shading of walls, in the memory layout of the shader.

use bytemuck::{Pod, Zeroable};
use carina_raycast::WallLighting;

/// Rows of a 3x3 matrix, each padded to four numbers.
type Rows = [[f32; 4]; 3];

/// Parameters of the shading, equal field by field to the struct `Lighting` of `lighting.wgsl`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
pub(crate) struct LightUniforms {
    guides: [[f32; 4]; 2],
    camera_lps: [f32; 4],
    lps_from_ijk: Rows,
    ijk_from_lps: Rows,
    camera_from_lps: Rows,
    inward: Rows,
    reach: [f32; 4],
    held: [f32; 4],
    num_bricks: [u32; 4],
    cells_shape: [i32; 4],
    cells_origin: [f32; 4],
    exposure: f32,
    ambient: f32,
    wrap: f32,
    gloss: f32,
    paleness: f32,
    texture: f32,
    vessels: f32,
    specks: f32,
    secretions: f32,
    fog: f32,
    rings: f32,
    membrane: f32,
    hue: f32,
    spurs: f32,
    pixel_mm: f32,
    slope_scale: f32,
    slope_unit: f32,
    shininess_log2: u32,
    has_decoration: u32,
    first_marked: u32,
    most_marked: u32,
    unused: [u32; 3],
}

impl LightUniforms {
    /// Return the parameters for a dispatch that smooths at most `most` silhouette pixels, from entry `first` of their
    /// list.
    pub(crate) fn smoothing(&self, first: usize, most: usize) -> Self {
        Self {
            first_marked: first as u32,
            most_marked: most as u32,
            ..*self
        }
    }

    /// Return the parameters of a frame's lighting; `num_bricks`: number of bricks along each axis, and the store's
    /// capacity.
    pub(crate) fn new(light: &WallLighting<'_>, num_bricks: [u32; 4]) -> Self {
        let lanes = |v: [f32; 3]| [v[0], v[1], v[2], 0.0];
        let rows = |m: [[f32; 3]; 3]| m.map(lanes);
        let appearance = &light.appearance;
        let field = light.decoration.as_ref();
        let [nx, ny, nz] = field.map_or([0; 3], |field| field.shape);
        let [x, y, z] = field.map_or([0.0; 3], |field| field.origin_lps);
        Self {
            guides: light.guides.map(lanes),
            camera_lps: lanes(light.camera_lps),
            lps_from_ijk: rows(light.lps_from_ijk),
            ijk_from_lps: rows(light.ijk_from_lps),
            camera_from_lps: rows(light.camera_from_lps),
            inward: rows(light.inward),
            reach: lanes(light.reach),
            held: [
                light.held[0],
                light.held[1],
                appearance.pale_hu[0],
                appearance.pale_hu[1],
            ],
            num_bricks,
            cells_shape: [nx, ny, nz, 0],
            cells_origin: [x, y, z, field.map_or(0.0, |field| field.cells_per_mm)],
            exposure: appearance.exposure.unwrap_or(-1.0),
            ambient: appearance.ambient,
            wrap: appearance.wrap,
            gloss: appearance.gloss,
            paleness: appearance.paleness,
            texture: appearance.texture,
            vessels: appearance.vessels,
            specks: appearance.specks,
            secretions: appearance.secretions,
            fog: appearance.fog,
            rings: appearance.rings,
            membrane: appearance.membrane,
            hue: appearance.hue,
            spurs: appearance.spurs,
            pixel_mm: light.pixel_mm,
            slope_scale: light.slope_scale,
            slope_unit: light.slope_unit,
            shininess_log2: appearance.shininess_log2,
            has_decoration: u32::from(field.is_some()),
            first_marked: 0,
            most_marked: 0,
            unused: [0; 3],
        }
    }
}
