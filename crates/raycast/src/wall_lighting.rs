//! Parameters of a frame that other hardware (the GPU) needs to shade its first walls in the same way.

use std::sync::Arc;

use crate::{
    Appearance, Frame, NormalBricks,
    bricks::{Fill, MAX_BRICKS},
    lighting::Lighting,
};

/// Grid of anatomical data from which decoration (rings, membranous wall, ridges) is drawn on airway walls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WallDecoration<'a> {
    /// Anatomical data of the grid's cells, two items of four numbers per cell, x fastest.
    pub cells: &'a [[f32; 4]],
    /// Number of cells of the grid along x, y and z.
    pub shape: [i32; 3],
    /// Position of the centre of the grid's first cell, LPS mm.
    pub origin_lps: [f32; 3],
    /// Number of cells of the grid per mm.
    pub cells_per_mm: f32,
}

/// Parameters of a [`Frame`] for the shading of its first walls, as this crate uses them.
#[derive(Debug, Clone, PartialEq)]
pub struct WallLighting<'a> {
    /// Light, gloss, texture and decoration.
    pub appearance: Appearance,
    /// Position of the camera's centre, LPS mm.
    pub camera_lps: [f32; 3],
    /// Matrix from voxels to LPS mm, without translation.
    pub lps_from_ijk: [[f32; 3]; 3],
    /// Matrix from LPS mm to voxels, without translation.
    pub ijk_from_lps: [[f32; 3]; 3],
    /// Matrix from LPS to camera space, without translation.
    pub camera_from_lps: [[f32; 3]; 3],
    /// Positions of the light guides relative to the camera's centre, LPS mm.
    pub guides: [[f32; 3]; 2],
    /// Width of a pixel in the middle of the picture at a distance of 1 mm, mm.
    pub pixel_mm: f32,
    /// Distance along each axis from a voxel to the samples for its slope, voxels.
    pub reach: [f32; 3],
    /// Lower and upper limit to which the samples for a slope are clamped.
    pub held: [f32; 2],
    /// Matrix from slopes to inward normals in LPS.
    pub inward: [[f32; 3]; 3],
    /// Factor from slopes to the integers that are stored in bricks and interpolated between voxels.
    pub slope_scale: f32,
    /// Factor from the stored integers back to slopes.
    pub slope_unit: f32,
    /// Number of bricks of the volume along each axis.
    pub num_bricks: [usize; 3],
    /// Capacity of the cache of bricks.
    pub most_bricks: usize,
    /// Grid of anatomical data; `None` if no airway tree is given.
    pub decoration: Option<WallDecoration<'a>>,
}

impl Frame<'_> {
    /// Return the parameters for the shading of this frame's walls; `None` for a frame without an appearance.
    #[must_use]
    pub fn wall_lighting(&self) -> Option<WallLighting<'_>> {
        // The slopes' parameters are needed, not their cache.
        let bricks = Arc::new(NormalBricks::with_capacity(self, 0));
        let light = Lighting::reading(self, Arc::clone(&bricks))?;
        let decoration = self.decoration.as_ref();
        Some(WallLighting {
            appearance: light.appearance,
            camera_lps: light.camera_lps,
            lps_from_ijk: light.lps_from_ijk,
            ijk_from_lps: light.ijk_from_lps,
            camera_from_lps: light.camera_from_lps,
            guides: light.guides,
            pixel_mm: light.pixel_mm,
            reach: light.normals.reach,
            held: light.normals.held,
            inward: light.normals.rows,
            slope_scale: bricks.scale(),
            slope_unit: bricks.unit(),
            num_bricks: bricks.store().num_bricks(),
            most_bricks: MAX_BRICKS.min(bricks.store().table().len()),
            decoration: decoration
                .filter(|_| light.appearance.knows_anatomy())
                .map(|field| WallDecoration {
                    cells: field.cells,
                    shape: field.shape_ijk,
                    origin_lps: field.origin_lps,
                    cells_per_mm: field.cells_per_mm,
                }),
        })
    }
}
