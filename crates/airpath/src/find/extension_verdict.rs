//! Criteria by which a cross-section of a path, and a whole path, count as airway.

use carina_grid::Grid;

use crate::find::extension_levels::{Divided, ExtensionLimits};
use crate::find::tubeness::Section;

/// Blur (sigma) in mm of a scanner with a smooth kernel, in a CT that was interpolated once between voxels.
const SCANNER_BLUR_MM: f64 = 0.75;
/// Radius of a lumen, as a multiple of the blur's sigma, below which the blur alone determines the measured radius.
///
/// The darkness that a lumen must have then cannot be computed from its radius.
const BLURRED: f64 = 0.75;
/// Minimum share of the sides of a cross-section that must have a wall; a fork leaves a quarter of the sides open.
const MIN_WALLED: f64 = 0.7;

/// Weights of the products of pairs of the seven features of a cross-section ([`log_odds`]), as a triangular matrix.
const WEIGHTS: [&[f64]; 7] = [
    &[-8.55, 0.68, 3.23, 0.45, -0.63, 3.90, -0.58],
    &[0.44, 2.72, 0.21, 1.43, -4.59, -2.21],
    &[4.85, -0.76, 0.58, 7.50, 0.12],
    &[0.55, 0.75, 1.30, -0.81],
    &[0.83, 2.70, -1.33],
    &[-7.69, 3.79],
    &[-1.98],
];
/// Weights of the five features of a whole path in the logistic model of its probability, without divided slices.
///
/// The features are: 1; logarithm of the evidence of its sections; distance from other lumens (mm); share of the
/// surrounding lung that the search reached; straightness (distance of the path's ends divided by its length).
pub(crate) const WAY_WEIGHTS: [f64; 5] = [-8.23, 1.09, 0.57, -8.62, 6.44];
/// Weights as in [`WAY_WEIGHTS`] for divided slices, where the evidence is the sum of the sections' log-odds.
pub(crate) const WAY_WEIGHTS_DIVIDED: [f64; 5] = [-7.64, 1.03, 0.61, -2.82, 3.95];

/// Blur (sigma) of a CT within its slices, mm.
const BLUR_IN_SLICE_MM: f64 = 0.65;
/// Minimum blur (sigma) of a CT across its slices, mm, with which paths are judged.
const MIN_BLUR_ACROSS_MM: f64 = 0.5;

/// Blur and noise by which the values of a lumen in the volume differ from its true values.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Blur {
    /// Blur (sigma) of scanner, voxel and smoothing together, mm.
    pub(crate) sigma_mm: f64,
    /// Standard deviation of the noise, in the volume's numbers.
    pub(crate) noise: f64,
}

impl Blur {
    /// Return the blur of scanner, voxel and smoothing together for the voxels of a grid.
    pub(crate) fn on(grid: &Grid, noise: f64) -> Self {
        let voxel_mm = grid.spacing_mm().iter().product::<f64>().cbrt();
        Self {
            sigma_mm: SCANNER_BLUR_MM.hypot(0.5 * voxel_mm),
            noise,
        }
    }
}

/// Return the log-odds that a cross-section of a path in divided slices belongs to an airway (docs/decisions/0114).
///
/// Thick slices blur in one direction, so the expected darkness of a lumen depends on the direction of its airway. The
/// features are: 1; the enclosure (logarithm, in thresholds); the brightness of the middle between air and the wall,
/// and between air and half a wall; the radius; the share of sides with a wall; and the logarithm of the ratio between
/// the blur that gives a lumen of that radius this brightness and the blur of the slices in this direction.
///
/// `own` is the value in the middle of the section. `enclosure` is the rise of the values round the path, in
/// thresholds. `along` is the component of the path's direction across the slices.
pub(crate) fn log_odds(
    section: &Section,
    own: f64,
    enclosure: f64,
    along: f64,
    limits: &ExtensionLimits,
    divided: Divided,
) -> f64 {
    let share = share_of_wall(section, own, limits.air);
    let figures = [
        1.0,
        enclosure.clamp(0.2, 10.0).ln(),
        share,
        radius_of(section),
        section.walled,
        ((own - limits.air) / (f64::from(limits.brightest) - limits.air)).clamp(0.0, 0.9),
        log_blur_ratio(section, own, along, limits.air, divided),
    ];
    WEIGHTS
        .iter()
        .enumerate()
        .flat_map(|(a, row)| {
            row.iter()
                .enumerate()
                .map(move |(b, weight)| (a, a + b, weight))
        })
        .map(|(a, b, weight)| weight * figures[a] * figures[b])
        .sum()
}

/// Return the probability that a path is an airway, given that the airway from which it branches is one.
///
/// `figures` are the features that [`WAY_WEIGHTS`] describes.
pub(crate) fn probability_of_way(figures: [f64; 5], weights: &[f64; 5]) -> f64 {
    let odds: f64 = weights.iter().zip(figures).map(|(w, f)| w * f).sum();
    1.0 / (1.0 + (-odds).exp())
}

/// Return the brightness of a section's middle between air (0) and the section's wall (1), limited to 0.02 to 0.98.
fn share_of_wall(section: &Section, own: f64, air: f64) -> f64 {
    if section.rise > 0.0 {
        ((own - air) / (own + section.rise - air).max(1.0)).clamp(0.02, 0.98)
    } else {
        0.98
    }
}

/// Return the radius in mm of a section's lumen, limited to the range to which the weights were fitted.
fn radius_of(section: &Section) -> f64 {
    section.radius_mm.clamp(0.4, 2.2)
}

/// Return the logarithm of the ratio between the blur that a section shows and the blur of the slices in its direction.
///
/// The blur that the section shows is the one that gives a lumen of its radius the brightness of its middle. `along` is
/// the component of the path's direction across the slices.
fn log_blur_ratio(section: &Section, own: f64, along: f64, air: f64, divided: Divided) -> f64 {
    let blur_mm = radius_of(section) / (-2.0 * share_of_wall(section, own, air).ln()).sqrt();
    let across_mm = (divided.slice_mm / 12f64.sqrt()).hypot(MIN_BLUR_ACROSS_MM);
    let up_mm = (BLUR_IN_SLICE_MM * along).hypot(across_mm * (1.0 - along * along).max(0.0).sqrt());
    (blur_mm / (BLUR_IN_SLICE_MM * up_mm).sqrt())
        .clamp(0.3, 4.0)
        .ln()
}

/// Return true if a section has wall on most sides and its middle is as dark as the lumen of an airway of its width.
///
/// Blur leaves `exp(-r^2 / 2 s^2)` of the wall's brightness in the middle of a tube of radius r. A wide tube is as dark
/// as the trachea. A groove between a vessel and an airway's wall is as wide, but as bright as lung.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::find::extension_levels::{TEST_DIVIDED, TEST_LIMITS};

    fn section(radius_mm: f64, walled: f64, rise: f64) -> Section {
        Section {
            walled,
            radius_mm,
            rise,
        }
    }

    #[test]
    fn a_thin_blurred_tube_is_a_more_probable_airway_than_an_equally_bright_wide_gap() {
        let tube = log_odds(
            &section(1.0, 0.95, 250.0),
            -760.0,
            3.0,
            0.3,
            &TEST_LIMITS,
            TEST_DIVIDED,
        );
        let gap = log_odds(
            &section(2.0, 0.75, 250.0),
            -760.0,
            1.1,
            0.3,
            &TEST_LIMITS,
            TEST_DIVIDED,
        );
        assert!(tube > 0.0 && gap < 0.0, "{tube} {gap}");
    }

    #[test]
    fn the_log_blur_ratio_of_a_tube_blurred_by_its_slices_is_one() {
        for along in [0.0, 0.4, 1.0] {
            let across: f64 = (3.0 / 12f64.sqrt()).hypot(MIN_BLUR_ACROSS_MM);
            let up = (BLUR_IN_SLICE_MM * along).hypot(across * f64::sqrt(1.0 - along * along));
            let sigma = (BLUR_IN_SLICE_MM * up).sqrt();
            let left = (-0.5 * (1.2 / sigma).powi(2)).exp();
            let own = -1000.0 + left * 600.0;
            let ratio = log_blur_ratio(
                &section(1.2, 1.0, -400.0 - own),
                own,
                along,
                TEST_LIMITS.air,
                TEST_DIVIDED,
            );
            assert!(ratio.abs() < 1e-9, "{along} {ratio}");
        }
    }

    #[test]
    fn a_straight_path_far_from_lumens_is_more_probable_than_a_winding_one_beside_them() {
        for weights in [WAY_WEIGHTS, WAY_WEIGHTS_DIVIDED] {
            let of = |evidence: f64, clear_mm: f64, reached: f64, straight: f64| {
                probability_of_way([1.0, evidence.ln(), clear_mm, reached, straight], &weights)
            };
            let clear = of(8.0, 6.0, 0.01, 0.95);
            assert!(clear > 0.8, "{clear}");
            assert!(of(2.0, 6.0, 0.01, 0.95) < clear);
            assert!(of(8.0, 2.0, 0.01, 0.95) < clear);
            assert!(of(8.0, 6.0, 0.2, 0.95) < clear);
            assert!(of(8.0, 6.0, 0.01, 0.5) < clear);
            let winding = of(4.0, 2.5, 0.1, 0.6);
            assert!(winding < 0.3, "{winding}");
        }
    }

    #[test]
    fn every_product_of_two_features_has_one_weight() {
        let num = WEIGHTS.len();
        assert!(
            WEIGHTS
                .iter()
                .enumerate()
                .all(|(n, row)| row.len() == num - n)
        );
    }
}
