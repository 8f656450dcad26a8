//! Light at the scope's tip.

use crate::RaycastError;

/// Light at the camera's centre, as on a bronchoscope: the light has the direction of the ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// Fraction of a sample's colour that does not depend on the direction of the surface.
    pub ambient: f32,
    /// Fraction of a sample's colour that is proportional to the cosine between surface normal and light.
    pub diffuse: f32,
    /// Strength of the white highlight of a wet surface at normal incidence.
    pub specular: f32,
    /// Exponent of the highlight as a power of two: `2^shininess_log2`.
    ///
    /// Powers are computed by squaring, so no sample needs `pow`.
    pub shininess_log2: u32,
    /// Distance from the camera in mm at which half the light is left; infinite for no loss.
    pub reach_mm: f32,
}

impl Light {
    /// Return an error if a number of the light is not finite or outside its range.
    ///
    /// # Errors
    ///
    /// Returns an error if a number is negative or not finite, or would overflow.
    pub fn check(&self) -> Result<(), RaycastError> {
        let refuse = |what: &'static str, expected: &str, found: f32| {
            Err(RaycastError::Setting {
                what,
                expected: expected.to_owned(),
                found: found.to_string(),
            })
        };
        for (what, v) in [
            ("ambient light", self.ambient),
            ("diffuse light", self.diffuse),
            ("specular light", self.specular),
        ] {
            if !(0.0..=10.0).contains(&v) {
                return refuse(what, "0 to 10", v);
            }
        }
        if self.shininess_log2 > 10 {
            return refuse("shininess (log2)", "0 to 10", self.shininess_log2 as f32);
        }
        if self.reach_mm.is_nan() || self.reach_mm <= 0.0 {
            return refuse("reach of the light", "above 0 mm", self.reach_mm);
        }
        Ok(())
    }

    /// Return the weights of a sample's diffuse colour and of white light in its shaded colour.
    ///
    /// `facing` is the cosine between surface normal and light (0 to 1).
    #[inline(always)]
    pub(crate) fn factors(&self, facing: f32, distance_mm: f32) -> (f32, f32) {
        let mut highlight = facing;
        for _ in 0..self.shininess_log2 {
            highlight *= highlight;
        }
        // The factor of the remaining light is reach^2 / (reach^2 + d^2): it decreases with the square of a large
        // distance d and is constant at a small one, like the automatic exposure of a scope.
        let part = distance_mm / self.reach_mm;
        let left = 1.0 / part.mul_add(part, 1.0);
        let diffuse = facing.mul_add(self.diffuse, self.ambient);
        (diffuse * left, self.specular * highlight * left)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Light at the camera of the test pictures.
    const LIGHT: Light = Light {
        ambient: 0.1,
        diffuse: 0.9,
        specular: 0.5,
        shininess_log2: 3,
        reach_mm: 20.0,
    };

    #[test]
    fn half_the_light_is_left_at_the_reach_and_all_of_it_at_the_tip() {
        assert_eq!(LIGHT.factors(1.0, 0.0), (1.0, 0.5));
        assert_eq!(LIGHT.factors(1.0, 20.0), (0.5, 0.25));
        let endless = Light {
            reach_mm: f32::INFINITY,
            ..LIGHT
        };
        assert_eq!(endless.factors(1.0, 500.0), (1.0, 0.5));
    }

    #[test]
    fn the_highlight_is_a_power_of_the_cosine() {
        // f32 represents 0.5^8 exactly.
        assert_eq!(LIGHT.factors(0.5, 0.0).1, 0.5 / 256.0);
        assert!(
            Light {
                diffuse: f32::NAN,
                ..LIGHT
            }
            .check()
            .is_err()
        );
        assert!(
            Light {
                reach_mm: 0.0,
                ..LIGHT
            }
            .check()
            .is_err()
        );
        assert!(LIGHT.check().is_ok());
    }
}
