//! The light of a picture: given, or found from its walls.

use crate::{Frame, Method, lighting::Lighting, packet::brightness, surface};

/// Rays on each side of the picture that the exposure is found from.
const METERED: usize = 12;
/// Linear light that the bright parts of an exposed picture have on average, before the tone curve.
const EXPOSED_TO: f64 = 1.1;

impl Lighting {
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
    /// As the automatic exposure of a video bronchoscope weights bright parts, so that a near wall hardly burns out, the
    /// fourth root of the mean fourth power is brought to a fixed level: it is the near rim's brightness, however much of
    /// the picture the lumen ahead takes up, and that goes dark.
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
            .map(|v| f64::from(v).powi(4))
            .sum();
        let mean = sum / (METERED * METERED) as f64;
        (EXPOSED_TO / mean.sqrt().sqrt().max(1e-9)).min(1e6) as f32
    }
}
