//! Whether a section of a way looks like an airway.

use carina_grid::Grid;

use crate::find::tubeness::Section;

/// Blur of a scanner with a smooth kernel (sigma): 1.4 mm full width.
const SCANNER_BLUR_MM: f64 = 0.6;
/// Below this many widths of the blur a radius is the blur's own, and says nothing about how dark the lumen should be.
const BLURRED: f64 = 0.75;
/// Share of the sides of a section on which there must be wall; a fork leaves a quarter open.
const MIN_WALLED: f64 = 0.7;

/// What stands between a lumen and its values.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Blur {
    /// Of scanner, voxel and smoothing.
    pub(crate) sigma_mm: f64,
    /// In the volume's numbers.
    pub(crate) noise: f64,
}

impl Blur {
    /// Of everything that blurs on a grid: scanner, voxel, smoothing.
    pub(crate) fn on(grid: &Grid, noise: f64) -> Self {
        let voxel_mm = grid.spacing_mm().iter().product::<f64>().cbrt();
        Self {
            sigma_mm: SCANNER_BLUR_MM.hypot(0.5 * voxel_mm),
            noise,
        }
    }
}

/// Wall on most sides, and as dark in the middle as a lumen that wide must be.
///
/// Blur leaves `exp(-r^2 / 2 s^2)` of the wall's brightness in the middle of a tube of radius r. A wide tube is as dark as the
/// trachea; a groove between a vessel and an airway's wall is as wide, and as bright as lung.
pub(crate) fn looks_like_airway(section: &Section, own: f64, air: f64, blur: Blur) -> bool {
    let wall = own + section.rise;
    let widths = section.radius_mm / blur.sigma_mm;
    let left = if widths < BLURRED {
        1.0
    } else {
        (-0.5 * widths.powi(2)).exp()
    };
    section.walled >= MIN_WALLED && own <= air + left * (wall - air) + blur.noise
}
