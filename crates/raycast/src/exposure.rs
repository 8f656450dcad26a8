//! Brightness of the light guides in a picture: set by the appearance, or computed from the walls in the picture.

use crate::{
    Frame, Method, lighting::Lighting, packet::brightness, shared_constants::shared_constants,
    surface,
};

shared_constants! {
    /// Number of rays along each side of the grid of rays with which the exposure is measured.
    const METERED: usize = 12;
    /// Linear light, before the tone curve, that an automatic exposure gives to the bright parts of a picture.
    const EXPOSED_TO: f64 = 1.1;
}

impl Lighting {
    /// Return the lighting of a frame with its exposure (brightness of the guides); `None` if its options have no
    /// appearance.
    pub(crate) fn exposed(frame: &Frame<'_>, method: Method<'_>) -> Option<Self> {
        let mut light = Self::of(frame)?;
        if light.appearance.exposure.is_none() {
            light.exposure = light.find_exposure(frame, method);
        }
        Some(light)
    }

    /// Compute the exposure from rays that are spread over the whole picture, so that every strip gets the same value.
    ///
    /// The automatic exposure of a video bronchoscope favours bright parts, so that a near wall is hardly overexposed.
    /// Here the fourth root of the mean fourth power of the brightness is set to a fixed level. The mean depends mostly
    /// on the near walls, not on how much of the picture the dark lumen ahead covers.
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
        // A ray that meets no wall counts as dark.
        let sum: f64 = brightness(frame, self, &walls)
            .into_iter()
            .map(|v| f64::from(v).powi(4))
            .sum();
        let mean = sum / (METERED * METERED) as f64;
        (EXPOSED_TO / mean.sqrt().sqrt().max(1e-9)).min(1e6) as f32
    }
}
