//! Appearance of the airway wall in the scope's picture (docs/decisions/0133).
//!
//! Walls are shaded after casting, once per pixel at the first wall. The casters gather flat colours; [`Appearance`]
//! describes the light, gloss and texture that the shading adds.

use crate::RaycastError;

/// Light, gloss, texture and decoration of the airway wall in a scope's picture.
///
/// Shading is computed in linear light and displayed with a gamma of 2, so that a square root replaces the display's
/// curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance {
    /// Positions of the ends of the two light guides in camera space, mm; both are equal for a scope with one guide.
    ///
    /// Each guide gives half the light.
    pub guides_mm: [[f32; 3]; 2],
    /// Brightness of the light guides; `None` selects an automatic exposure, which leaves the bright parts of a picture
    /// below white.
    pub exposure: Option<f32>,
    /// Ambient light from the surrounding walls, as a fraction of the light that a guide gives at normal incidence.
    pub ambient: f32,
    /// Extent to which scattered light passes the boundary between lit and unlit wall (wrap lighting), 0 to 1.
    pub wrap: f32,
    /// Strength of the highlights on the film of mucus; 0 for none.
    pub gloss: f32,
    /// Exponent of the highlight as a power of two: `2^shininess_log2`.
    pub shininess_log2: u32,
    /// Amount by which the mucosa is paler over dense tissue, 0 to 1.
    pub paleness: f32,
    /// HU values beneath the wall at which the paling of the mucosa begins and at which it is strongest.
    pub pale_hu: [f32; 2],
    /// Strength of the fine texture of the mucosa (mottling, and fine relief that breaks up highlights); 0 for none.
    pub texture: f32,
    /// Strength of the vessels that are drawn in the mucosa; 0 for none.
    ///
    /// CT does not show these vessels, and many of them are a sign of disease.
    pub vessels: f32,
    /// Whether pixels at the edge of a near wall in front of a far wall get two rays.
    ///
    /// This is not decoration: both rays show the CT.
    pub silhouettes: bool,
    /// Strength of highlights on droplets in the film of mucus, which are visible also at a distance; 0 for none.
    pub specks: f32,
    /// Strength of glossy pools and bubbles of secretions on the lowest wall of a supine patient; 0 for none.
    pub secretions: f32,
    /// Strength of mist on the lens, from 0 (none) to 1 (the lumen is hardly visible).
    pub fog: f32,
    /// Strength of cartilage rings and plates; 0 for none.
    ///
    /// `rings`, `membrane`, `hue` and `spurs` need a frame with a [`crate::Decoration`].
    pub rings: f32,
    /// Strength of the flat, folded membranous wall at the back of trachea and main bronchi; 0 for none.
    pub membrane: f32,
    /// Strength of the colour differences by region (a paler trachea, redder bronchi); 0 for one colour.
    pub hue: f32,
    /// Strength of the pale ridges at forks; 0 for none.
    pub spurs: f32,
}

impl Appearance {
    /// Return true if a feature that depends on anatomy (`rings`, `membrane`, `hue`, `spurs`) is enabled.
    pub(crate) fn knows_anatomy(&self) -> bool {
        self.rings > 0.0 || self.membrane > 0.0 || self.hue > 0.0 || self.spurs > 0.0
    }

    /// Return a copy of the appearance without decoration, the features that do not come from the patient's CT
    /// (texture, vessels, droplets, rings, membranous wall, colour by region, ridges).
    pub(crate) const fn undecorated(self) -> Self {
        Self {
            texture: 0.0,
            vessels: 0.0,
            rings: 0.0,
            membrane: 0.0,
            hue: 0.0,
            spurs: 0.0,
            specks: 0.0,
            secretions: 0.0,
            fog: 0.0,
            ..self
        }
    }

    /// Return an error if a number of the appearance is not finite or outside its range.
    ///
    /// # Errors
    ///
    /// Returns an error if a number is not finite or would overflow.
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
            ("specks", self.specks, 4.0),
            ("secretions", self.secretions, 1.0),
            ("fog", self.fog, 1.0),
            ("rings", self.rings, 2.0),
            ("membranous wall", self.membrane, 2.0),
            ("colour by region", self.hue, 2.0),
            ("ridges of forks", self.spurs, 1.0),
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
