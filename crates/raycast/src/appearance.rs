//! How a wall looks through a scope: lit after casting, once for each pixel, at its first wall (docs/decisions/0105).
//!
//! The casters gather flat colours; [`Appearance`] says what light, gloss and texture are laid on them.

use crate::RaycastError;

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
    /// Pixels where a near wall ends before a far one take two rays. No decoration: both show the CT.
    pub silhouettes: bool,
    /// Highlights on droplets in the film of mucus, which a scope sees at a distance, too; 0 for none.
    pub specks: f32,
    /// Glossy pools and bubbles of secretions on the wall that lies lowest in a supine patient; 0 for none.
    pub secretions: f32,
    /// Mist on the lens, 0 for none, 1 for a picture that hardly shows the lumen.
    pub fog: f32,
    /// Cartilage rings and plates, 0 for none; drawn where a frame has a [`crate::Decoration`], as are the next three.
    pub rings: f32,
    /// The flat, folded membranous wall at the back of trachea and main bronchi, 0 for none.
    pub membrane: f32,
    /// Colour by region: a paler trachea, redder bronchi; 0 for one colour.
    pub hue: f32,
    /// Pale ridges of forks, 0 for none.
    pub spurs: f32,
}

impl Appearance {
    /// True if a part is on that is fixed to anatomy.
    pub(crate) fn knows_anatomy(&self) -> bool {
        self.rings > 0.0 || self.membrane > 0.0 || self.hue > 0.0 || self.spurs > 0.0
    }

    /// The same with nothing on it that is not the patient's.
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
