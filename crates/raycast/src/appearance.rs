//! How a wall looks through a scope: lit after casting, once for each pixel, at its first wall (docs/decisions/0008).
//!
//! The casters gather flat colours; [`Appearance`] says what light, gloss and texture are laid on them.

use crate::{
    Frame, Method, RaycastError,
    packet::brightness,
    surface::{self, Normals},
};

/// Light, gloss and texture of the wall of an airway.
///
/// All is worked out in linear light and shown with a gamma of 2, so that a square root stands for the display's curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance {
    /// Where the ends of the two light guides are, camera mm; equal for one guide. Each gives half the light.
    pub guides_mm: [[f32; 3]; 2],
    /// Light of the guides; `None` for automatic, which holds the bright parts of a picture below white.
    pub exposure: Option<f32>,
    /// Light that comes from the walls round about, as part of what a guide gives head on.
    pub ambient: f32,
    /// How far light creeps round the edge of a shadow beneath the surface, 0..1.
    pub wrap: f32,
    /// Highlights of the film of mucus.
    pub gloss: f32,
    /// The highlight's exponent is `2^shininess_log2`.
    pub shininess_log2: u32,
    /// How far the mucosa pales over dense tissue, 0..1.
    pub paleness: f32,
    /// Values beneath the surface at which it begins to pale and at which it is palest, HU.
    pub pale_hu: [f32; 2],
    /// Fine texture: mottling, and the micro relief that breaks highlights up, 0 for none.
    pub texture: f32,
    /// Vessels in the mucosa, 0 for none. No CT shows them, and many of them are a sign of disease.
    pub vessels: f32,
}

impl Appearance {
    /// Refuses values that are not finite or would overflow.
    pub fn check(&self) -> Result<(), RaycastError> {
        let refuse = |what: &'static str, expected: &str, found: f32| {
            Err(RaycastError::Setting {
                what,
                expected: expected.to_owned(),
                found: found.to_string(),
            })
        };
        for &v in self.guides_mm.iter().flatten() {
            if !(-100.0..=100.0).contains(&v) {
                return refuse("position of a light guide", "-100 to 100 mm", v);
            }
        }
        if let Some(v) = self.exposure
            && !(0.0..=1e6).contains(&v)
        {
            return refuse("exposure", "0 to 1000000", v);
        }
        for (what, v, most) in [
            ("ambient light", self.ambient, 10.0),
            ("wrap of light", self.wrap, 1.0),
            ("gloss", self.gloss, 100.0),
            ("paleness", self.paleness, 1.0),
            ("texture", self.texture, 4.0),
            ("vessels", self.vessels, 4.0),
        ] {
            if !(0.0..=most).contains(&v) {
                return refuse(what, &format!("0 to {most}"), v);
            }
        }
        if self.shininess_log2 > 10 {
            return refuse("shininess (log2)", "0 to 10", self.shininess_log2 as f32);
        }
        let [from, to] = self.pale_hu;
        if !(from.is_finite() && to.is_finite() && from < to) {
            return refuse("values of pale tissue", "two, the lower first", to);
        }
        Ok(())
    }
}

/// What the lighting of a frame needs, set up once in f64.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Lighting {
    pub look: Appearance,
    pub normals: Normals,
    pub origin_ijk: [f32; 3],
    pub camera_lps: [f32; 3],
    pub step_mm: f32,
    pub lps_from_ijk: [[f32; 3]; 3],
    pub ijk_from_lps: [[f32; 3]; 3],
    /// Light guides from the camera's centre, LPS mm.
    pub guides: [[f32; 3]; 2],
    /// Width of a pixel seen from 1 mm, in the middle of the picture.
    pub pixel_mm: f32,
    pub background: [f32; 3],
    /// Light of the guides, found or given.
    pub exposure: f32,
}

impl Lighting {
    /// The lighting of a frame whose options have an appearance; its exposure is to be found.
    pub(crate) fn of(frame: &Frame<'_>) -> Option<Self> {
        let look = frame.options.appearance?;
        let camera = frame.camera();
        let rows = |m: &carina_grid::Affine| {
            m.rows()
                .map(|row| [row[0] as f32, row[1] as f32, row[2] as f32])
        };
        Some(Self {
            look,
            normals: Normals::of(frame),
            origin_ijk: frame.origin3(),
            camera_lps: camera.origin_lps().map(|v| v as f32),
            step_mm: frame.step_mm,
            lps_from_ijk: rows(frame.grid.lps_from_ijk()),
            ijk_from_lps: rows(frame.grid.ijk_from_lps()),
            guides: look.guides_mm.map(|guide| {
                let lps = camera.lps_from_camera().vector(guide.map(f64::from));
                lps.map(|v| v as f32)
            }),
            pixel_mm: (1.0 / camera.focal_px()) as f32,
            background: frame.options.background,
            exposure: look.exposure.unwrap_or(1.0),
        })
    }

    /// The lighting of a frame whose options have an appearance, exposed.
    pub(crate) fn exposed(frame: &Frame<'_>, method: Method<'_>) -> Option<Self> {
        let mut light = Self::of(frame)?;
        if light.look.exposure.is_none() {
            light.exposure = light.find_exposure(frame, method);
        }
        Some(light)
    }

    /// Exposure from rays spread over the whole picture, so that every strip finds the same.
    ///
    /// As the automatic exposure of a video bronchoscope weights bright parts, so that a near wall does not burn out, the
    /// root of the mean square is brought to a fixed level; the lumen ahead goes dark.
    fn find_exposure(&self, frame: &Frame<'_>, method: Method<'_>) -> f32 {
        let (width, height) = (frame.camera().width(), frame.camera().height());
        let place = |n: usize, size: usize| (2 * n + 1) * size / (2 * METERED);
        let walls: Vec<_> = (0..METERED * METERED)
            .map(|n| (place(n % METERED, width), place(n / METERED, height)))
            .filter_map(|(column, row)| {
                let wall = surface::wall_at(frame, method, column, row);
                (wall.hit >= 0.0).then_some((column, row, wall))
            })
            .collect();
        // Where no wall is met, it is dark.
        let sum: f64 = brightness(frame, self, &walls)
            .into_iter()
            .map(|v| f64::from(v) * f64::from(v))
            .sum();
        let mean = sum / (METERED * METERED) as f64;
        (EXPOSED_TO / mean.sqrt().max(1e-9)).min(1e6) as f32
    }
}

/// Rays on each side of the picture that the exposure is found from.
const METERED: usize = 12;
/// Linear light that the bright parts of an exposed picture have on average, before the tone curve.
const EXPOSED_TO: f64 = 0.7;
