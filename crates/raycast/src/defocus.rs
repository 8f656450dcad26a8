//! Depth of field of a fixed-focus lens: blur of a picture by the depth of its pixels.
//!
//! The blur needs the whole picture and its depth map, because it crosses the borders of strips.

use core::f32::consts::PI;

use carina_grid::LensRays;
use rayon::prelude::*;

use crate::RaycastError;

/// Maximum diameter of a circle of confusion that counts as sharp, as a fraction of the picture's shorter side.
///
/// The limit is about one sensor pixel of a video bronchoscope (400 x 400).
const SHARP_PART: f32 = 1.0 / 400.0;
/// Maximum radius of a circle of confusion, as a fraction of the picture's shorter side.
///
/// A wall that would need a larger circle is too near for a scope to see anything.
const WIDEST_PART: f32 = 1.0 / 32.0;

/// Radius of the circle of confusion that marks a pixel without a ray, which is not part of the picture.
const NO_RAY: f32 = -1.0;

/// Range of distances from the scope's tip, mm, that the picture shows sharply.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Focus {
    /// Nearest distance that is in focus, mm.
    pub near_mm: f32,
    /// Farthest distance that is in focus, mm.
    pub far_mm: f32,
}

impl Focus {
    fn check(self) -> Result<(), RaycastError> {
        if 0.0 < self.near_mm && self.near_mm < self.far_mm && self.far_mm.is_finite() {
            return Ok(());
        }
        Err(RaycastError::Setting {
            what: "depth of field",
            expected: "from above 0 mm to a larger distance".to_owned(),
            found: format!("{} to {} mm", self.near_mm, self.far_mm),
        })
    }

    /// Return the radius in pixels of the circle of confusion of a point at `depth_mm`; NaN counts as infinitely far.
    ///
    /// The circles of a thin fixed-focus lens are proportional to `|1/d - 1/d_focus|`. At the nearest and at the
    /// farthest distance in focus the circle has the largest diameter that counts as sharp ([`SHARP_PART`]); these two
    /// conditions determine focus and aperture.
    fn radius_px(self, depth_mm: f32, side: f32) -> f32 {
        let (near, far) = (1.0 / self.near_mm, 1.0 / self.far_mm);
        let (focus, range) = (f32::midpoint(near, far), (near - far) / 2.0);
        let at = if depth_mm > 0.0 { 1.0 / depth_mm } else { 0.0 };
        let sharp = side * SHARP_PART / 2.0;
        (sharp * (at - focus).abs() / range).min(side * WIDEST_PART)
    }
}

/// Blur a picture (RGB) by the depth of its pixels (mm; NaN for a pixel without a wall).
///
/// Each pixel gathers the pixels whose circle of confusion reaches it. The colours of pixels behind a sharp edge are
/// not spread over the edge. Pixels for which `rays` has no ray are neither read nor changed.
///
/// # Errors
///
/// Returns an error if the range of `focus` or the number of depths is not valid.
pub fn defocus(
    rgb: &[u8],
    depth_mm: &[f32],
    width: usize,
    focus: Focus,
    rays: Option<&LensRays>,
) -> Result<Vec<u8>, RaycastError> {
    focus.check()?;
    let height = depth_mm.len().checked_div(width).unwrap_or(0);
    if rgb.len() != depth_mm.len() * 3 || width * height != depth_mm.len() {
        return Err(RaycastError::Setting {
            what: "depth",
            expected: format!("one for each of {} pixels", rgb.len() / 3),
            found: format!("{}", depth_mm.len()),
        });
    }
    let side = width.min(height) as f32;
    let has_ray = |column, row| rays.is_none_or(|r| r.direction(column, row) != [0.0; 3]);
    let radii: Vec<f32> = depth_mm
        .par_iter()
        .enumerate()
        .map(|(n, &depth)| {
            if has_ray(n % width, n / width) {
                focus.radius_px(depth, side)
            } else {
                NO_RAY
            }
        })
        .collect();
    let depth = |n: usize| {
        if depth_mm[n] > 0.0 {
            depth_mm[n]
        } else {
            f32::INFINITY
        }
    };
    let widest = radii.iter().copied().fold(0.0, f32::max);
    let reach = (widest + 0.5).ceil() as usize;
    let mut out = rgb.to_vec();
    out.par_chunks_mut(width * 3)
        .enumerate()
        .for_each(|(row, out)| {
            for (column, pixel) in out.chunks_exact_mut(3).enumerate() {
                let here = row * width + column;
                if radii[here] == NO_RAY {
                    continue;
                }
                let (mut sum, mut total) = ([0.0f32; 3], 0.0f32);
                for y in row.saturating_sub(reach)..(row + reach + 1).min(height) {
                    for x in column.saturating_sub(reach)..(column + reach + 1).min(width) {
                        let there = y * width + x;
                        let mut radius = radii[there];
                        if radius == NO_RAY {
                            continue;
                        }
                        if depth(there) > depth(here) {
                            radius = radius.min(radii[here]);
                        }
                        let (dx, dy) = (x.abs_diff(column) as f32, y.abs_diff(row) as f32);
                        let covered = (radius + 0.5 - (dx * dx + dy * dy).sqrt()).clamp(0.0, 1.0);
                        // A circle within its own pixel adds light to no other pixel.
                        let spread = radius.max(0.5);
                        let weight = covered / (PI * spread * spread);
                        total += weight;
                        for c in 0..3 {
                            sum[c] += weight * f32::from(rgb[there * 3 + c]);
                        }
                    }
                }
                for c in 0..3 {
                    pixel[c] = (sum[c] / total + 0.5) as u8;
                }
            }
        });
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Range of distances that is in focus in these tests.
    const FOCUS: Focus = Focus {
        near_mm: 3.0,
        far_mm: 50.0,
    };

    /// Return a picture with a white edge on black, 400 pixels square, whose pixels have one depth, blurred with
    /// `FOCUS`.
    fn edge(depth_mm: f32) -> Vec<u8> {
        let rgb: Vec<u8> = (0..400 * 400)
            .flat_map(|n| [if n % 400 < 200 { 255 } else { 0 }; 3])
            .collect();
        defocus(&rgb, &vec![depth_mm; 400 * 400], 400, FOCUS, None).unwrap()
    }

    /// Return the number of pixels over which the edge of `edge` changes from light to dark.
    fn width_of_edge(picture: &[u8]) -> usize {
        (0..400)
            .filter(|column| (10..245).contains(&picture[(200 * 400 + column) * 3]))
            .count()
    }

    #[test]
    fn edges_in_the_focus_range_are_sharp_and_nearer_edges_are_blurred() {
        for depth_mm in [3.0, 6.0, 20.0, 50.0] {
            assert!(width_of_edge(&edge(depth_mm)) <= 2, "{depth_mm} mm");
        }
        let near = width_of_edge(&edge(1.0));
        let nearer = width_of_edge(&edge(0.5));
        assert!(near >= 4 && nearer > near, "{near} {nearer}");
    }

    #[test]
    fn a_uniform_picture_and_a_sharp_edge_before_a_blurred_wall_are_unchanged() {
        let even = vec![77; 60 * 60 * 3];
        let depths: Vec<f32> = (0..3600).map(|n| 0.3 + (n % 60) as f32).collect();
        assert_eq!(defocus(&even, &depths, 60, FOCUS, None).unwrap(), even);
        // The scene is a dark wall in focus before a white, very distant background that is out of focus.
        let focus = Focus {
            near_mm: 3.0,
            far_mm: 4.0,
        };
        let half = |n: usize| n % 400 < 200;
        let rgb: Vec<u8> = (0..160_000)
            .flat_map(|n| [if half(n) { 0 } else { 255 }; 3])
            .collect();
        let depths: Vec<f32> = (0..160_000)
            .map(|n| if half(n) { 3.4 } else { f32::NAN })
            .collect();
        let picture = defocus(&rgb, &depths, 400, focus, None).unwrap();
        let at = |column: usize| picture[(200 * 400 + column) * 3];
        assert!(at(197) == 0 && at(195) == 0, "nothing runs over the wall");
    }

    #[test]
    fn an_invalid_focus_range_and_depths_of_another_size_are_rejected() {
        let run = |near_mm, far_mm, num_depths| {
            let focus = Focus { near_mm, far_mm };
            defocus(&[0; 27], &vec![1.0; num_depths], 3, focus, None)
        };
        assert!(run(3.0, 50.0, 9).is_ok());
        for (near_mm, far_mm) in [
            (0.0, 5.0),
            (5.0, 5.0),
            (f32::NAN, 5.0),
            (3.0, f32::INFINITY),
        ] {
            assert!(run(near_mm, far_mm, 9).is_err());
        }
        assert!(run(3.0, 50.0, 8).is_err());
    }
}
