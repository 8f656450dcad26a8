//! Parameters of a frame that the shading of first walls needs.

use std::sync::Arc;

use crate::{Appearance, Frame, NormalBricks, normals::Normals};

/// Parameters for the shading of a frame's first walls, computed once in f64.
#[derive(Debug, Clone)]
pub(crate) struct Lighting {
    pub appearance: Appearance,
    pub normals: Normals,
    pub bricks: Arc<NormalBricks>,
    pub origin_ijk: [f32; 3],
    pub camera_lps: [f32; 3],
    pub step_mm: f32,
    pub lps_from_ijk: [[f32; 3]; 3],
    pub ijk_from_lps: [[f32; 3]; 3],
    /// Map from patient space to the CT at rest: matrix and offset in mm; `None` if the tissue is at rest.
    pub rest_from_lps: Option<([[f32; 3]; 3], [f32; 3])>,
    pub camera_from_lps: [[f32; 3]; 3],
    /// Positions of the scope's light guides relative to the camera's centre, LPS mm.
    pub guides: [[f32; 3]; 2],
    /// Width of a pixel in the middle of the picture at a distance of 1 mm from the camera, mm.
    pub pixel_mm: f32,
    pub background: [f32; 3],
    /// Brightness of the light guides, measured or given by the appearance.
    pub exposure: f32,
}

impl Lighting {
    /// Return the lighting of a frame, without its exposure; `None` if the frame's options have no appearance.
    pub(crate) fn of(frame: &Frame<'_>) -> Option<Self> {
        frame.options.appearance?;
        let bricks = frame.bricks.clone();
        let bricks = bricks.unwrap_or_else(|| Arc::new(NormalBricks::of(frame)));
        Self::reading(frame, bricks)
    }

    /// Return the lighting of a frame, without its exposure, with the cache `bricks` for the wall normals.
    pub(crate) fn reading(frame: &Frame<'_>, bricks: Arc<NormalBricks>) -> Option<Self> {
        let appearance = frame.options.appearance?;
        let camera = frame.camera();
        let rows = |m: &carina_grid::Affine| {
            m.rows()
                .map(|row| [row[0] as f32, row[1] as f32, row[2] as f32])
        };
        Some(Self {
            appearance,
            normals: Normals::of(frame),
            bricks,
            origin_ijk: frame.origin3(),
            camera_lps: camera.origin_lps().map(|v| v as f32),
            step_mm: frame.step_mm,
            lps_from_ijk: rows(frame.grid.lps_from_ijk()),
            ijk_from_lps: rows(frame.grid.ijk_from_lps()),
            rest_from_lps: frame
                .rest_from_lps
                .map(|map| (rows(&map), map.column(3).map(|v| v as f32))),
            camera_from_lps: std::array::from_fn(|a| {
                camera.lps_from_camera().column(a).map(|v| v as f32)
            }),
            guides: appearance.guides_mm.map(|guide| {
                let lps = camera.lps_from_camera().vector(guide.map(f64::from));
                lps.map(|v| v as f32)
            }),
            pixel_mm: (1.0 / camera.focal_px()) as f32,
            background: frame.options.background,
            exposure: appearance.exposure.unwrap_or(1.0),
        })
    }
}
