//! Rays of all pixels of a picture behind a lens, computed once for a lens, a picture size and an image field.

use rayon::prelude::*;

use crate::{GridError, Optics};

/// Gain of a pixel with full brightness; other gains are fractions of this number.
pub const FULL_GAIN: u16 = 1 << 15;
/// Exponent between linear light and display values, with which gains are applied to a displayed picture.
///
/// The lens attenuates the light before the display curve; the exponent of sRGB is close enough for a vignette.
const DISPLAY_GAMMA: f64 = 2.2;

/// Shape of the outline of the picture on the monitor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldShape {
    /// The picture fills the whole viewport.
    Full,
    /// The outline is a circle over the shorter side of the viewport.
    Round,
    /// The outline is a regular octagon over the shorter side of the viewport.
    Octagon,
}

/// Part of the viewport that shows a picture, and its darkening towards the edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageField {
    /// Outline of the picture; pixels outside have no ray and are black.
    pub shape: FieldShape,
    /// Width of the soft edge inside the outline, pixels.
    pub edge_px: f64,
    /// Strength of the vignette: 0 for uniform brightness, 1 for the lens's natural fall-off of light.
    pub vignette: f64,
}

impl ImageField {
    /// Image field of the whole viewport with uniform brightness.
    pub const FULL: Self = Self {
        shape: FieldShape::Full,
        edge_px: 0.0,
        vignette: 0.0,
    };

    /// Return the distance in pixels from a point to the outline, positive inside.
    ///
    /// The point is at (x, y) from the middle; `half` is half of the shorter side.
    fn depth_px(&self, x: f64, y: f64, half: f64) -> f64 {
        match self.shape {
            FieldShape::Full => f64::INFINITY,
            FieldShape::Round => half - (x * x + y * y).sqrt(),
            FieldShape::Octagon => {
                let (x, y) = (x.abs(), y.abs());
                let side = half - x.max(y);
                // The cut corners are as far from the middle as the sides.
                side.min(half - (x + y) / core::f64::consts::SQRT_2)
            }
        }
    }
}

/// Relative brightness of the picture, as a function of the cosine of the angle from the axis.
struct Light {
    /// Brightness at `LIGHT_STEPS + 1` cosines from 0 to 1; empty for uniform brightness.
    table: Vec<f64>,
}

/// Number of steps of the brightness table, so that neighbouring gains differ by less than a grey level.
const LIGHT_STEPS: usize = 1024;

impl Light {
    fn of(optics: &Optics, vignette: f64) -> Self {
        let at = |n: usize| {
            let cosine = n as f64 / LIGHT_STEPS as f64;
            let sine = (1.0 - cosine * cosine).sqrt();
            libm::pow(
                optics.natural_light([sine, 0.0, cosine]),
                vignette / DISPLAY_GAMMA,
            )
        };
        Self {
            table: if vignette > 0.0 {
                (0..=LIGHT_STEPS).map(at).collect()
            } else {
                Vec::new()
            },
        }
    }

    fn in_direction(&self, direction: [f64; 3]) -> f64 {
        if self.table.is_empty() {
            return 1.0;
        }
        let at = direction[2].clamp(0.0, 1.0) * LIGHT_STEPS as f64;
        let n = (at as usize).min(LIGHT_STEPS - 1);
        let part = at - n as f64;
        self.table[n] + part * (self.table[n + 1] - self.table[n])
    }
}

/// Direction of the ray and gain of each pixel of a picture behind a lens.
#[derive(Debug, Clone, PartialEq)]
pub struct LensRays {
    optics: Optics,
    /// x, y and z of unit directions in camera space; all 0 for a pixel without a ray.
    dirs: [Vec<f32>; 3],
    /// Gain of each pixel; `None` if all pixels have full brightness.
    gains: Option<Vec<u16>>,
}

impl LensRays {
    /// Compute the ray of every pixel on all cores.
    ///
    /// # Errors
    ///
    /// Returns an error if a value of the image field is out of range.
    pub fn build(optics: Optics, field: &ImageField) -> Result<Self, GridError> {
        for (what, value, most) in [
            ("soft edge", field.edge_px, 100.0),
            ("vignette", field.vignette, 1.0),
        ] {
            if !(0.0..=most).contains(&value) {
                return Err(GridError::Camera {
                    what,
                    expected: format!("0 to {most}"),
                    found: format!("{value}"),
                });
            }
        }
        let [width, height] = optics.size_px();
        let half = [width as f64 / 2.0, height as f64 / 2.0];
        let radius = half[0].min(half[1]);
        let plain = field.shape == FieldShape::Full && field.vignette == 0.0;
        let light = Light::of(&optics, field.vignette);
        let pixel = |column: usize, row: usize| {
            let at = [column as f64 + 0.5, row as f64 + 0.5];
            let depth_px = field.depth_px(at[0] - half[0], at[1] - half[1], radius);
            let bare = ([0.0f32; 3], 0u16);
            if depth_px <= 0.0 {
                return bare;
            }
            let Some(d) = optics.direction(at) else {
                return bare;
            };
            let edge = if field.edge_px > 0.0 {
                (depth_px / field.edge_px).min(1.0)
            } else {
                1.0
            };
            let gain = edge * light.in_direction(d) * f64::from(FULL_GAIN) + 0.5;
            (d.map(|v| v as f32), gain as u16)
        };
        let mut pixels = vec![([0.0f32; 3], 0u16); width * height];
        if optics.is_symmetric() {
            // Only a quarter of the picture is computed; the other quarters are its mirror images.
            let (columns, rows) = (width.div_ceil(2), height.div_ceil(2));
            pixels
                .par_chunks_mut(width)
                .take(rows)
                .enumerate()
                .for_each(|(row, out)| {
                    for column in 0..columns {
                        let ([x, y, z], gain) = pixel(column, row);
                        out[column] = ([x, y, z], gain);
                        // The middle column of an odd width is its own mirror image, with x = 0.
                        out[width - 1 - column] = ([0.0 - x, y, z], gain);
                    }
                });
            let (above, below) = pixels.split_at_mut(rows * width);
            below
                .par_chunks_mut(width)
                .enumerate()
                .for_each(|(n, out)| {
                    let row = height - 1 - (rows + n);
                    for (to, &([x, y, z], gain)) in out.iter_mut().zip(&above[row * width..]) {
                        *to = ([x, 0.0 - y, z], gain);
                    }
                });
        } else {
            pixels
                .par_chunks_mut(width)
                .enumerate()
                .for_each(|(row, out)| {
                    for (column, out) in out.iter_mut().enumerate() {
                        *out = pixel(column, row);
                    }
                });
        }
        // The model's tangential part may fold back inside the circle although the circle itself has directions.
        let inside = |n: usize| {
            let (x, y) = (
                (n % width) as f64 + 0.5 - half[0],
                (n / width) as f64 + 0.5 - half[1],
            );
            (x * x + y * y).sqrt() < radius - 0.5
        };
        let folded = |n: usize| pixels[n].0 == [0.0; 3] && inside(n);
        if (0..pixels.len()).into_par_iter().any(folded) {
            return optics.refuse_fold();
        }
        Ok(Self {
            optics,
            dirs: std::array::from_fn(|a| pixels.iter().map(|(d, _)| d[a]).collect()),
            gains: (!plain).then(|| pixels.iter().map(|&(_, gain)| gain).collect()),
        })
    }

    /// Create the rays of a list of directions in camera space, as a picture of one row, so that the same code casts
    /// them.
    pub(crate) fn listed(directions: &[[f32; 3]]) -> Self {
        Self {
            optics: Optics::of_list(directions.len()),
            dirs: std::array::from_fn(|a| directions.iter().map(|d| d[a]).collect()),
            gains: None,
        }
    }

    /// Return the lens with the size of the picture.
    #[must_use]
    pub const fn optics(&self) -> &Optics {
        &self.optics
    }

    /// Return the width of the viewport, pixels.
    #[must_use]
    pub const fn width(&self) -> usize {
        self.optics.size_px()[0]
    }

    /// Return the height of the viewport, pixels.
    #[must_use]
    pub const fn height(&self) -> usize {
        self.optics.size_px()[1]
    }

    /// Return the unit direction of a pixel in camera space; all 0 for a pixel without a ray.
    #[inline]
    #[must_use]
    pub fn direction(&self, column: usize, row: usize) -> [f32; 3] {
        let n = row * self.width() + column;
        [self.dirs[0][n], self.dirs[1][n], self.dirs[2][n]]
    }

    /// Return the factor, at most [`FULL_GAIN`], by which the vignette multiplies the brightness of a pixel.
    #[must_use]
    pub fn gain(&self, column: usize, row: usize) -> u16 {
        let gains = self.gains.as_ref();
        gains.map_or(FULL_GAIN, |gains| gains[row * self.width() + column])
    }

    /// Return the directions of a row's pixels, one array for each axis.
    #[must_use]
    pub fn directions_of(&self, row: usize) -> [&[f32]; 3] {
        let columns = row * self.width()..(row + 1) * self.width();
        [0, 1, 2].map(|a| &self.dirs[a][columns.clone()])
    }

    /// Darken rows of a picture (RGB, from `first_row` on) by the gains of their pixels.
    ///
    /// Pixels are independent, so strips agree with the whole picture.
    pub fn shade_rows(&self, first_row: usize, rgb: &mut [u8]) {
        let Some(gains) = &self.gains else {
            return;
        };
        let width = self.width();
        let num_rows = rgb.len() / (3 * width);
        let gains = &gains[first_row * width..(first_row + num_rows) * width];
        rgb.par_chunks_exact_mut(3 * width)
            .zip(gains.par_chunks_exact(width))
            .for_each(|(rgb, gains)| {
                for (pixel, &gain) in rgb.chunks_exact_mut(3).zip(gains) {
                    for value in pixel {
                        let part = u32::from(*value) * u32::from(gain) + u32::from(FULL_GAIN) / 2;
                        *value = (part / u32::from(FULL_GAIN)) as u8;
                    }
                }
            });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Lens;

    fn rays(shape: FieldShape, edge_px: f64, vignette: f64) -> LensRays {
        let field = ImageField {
            shape,
            edge_px,
            vignette,
        };
        LensRays::build(
            Optics::new(&Lens::Equidistant, Some(2.0), 60, 40).unwrap(),
            &field,
        )
        .unwrap()
    }

    fn has_ray(rays: &LensRays, column: usize, row: usize) -> bool {
        rays.direction(column, row) != [0.0; 3]
    }

    #[test]
    fn pixels_outside_the_outline_have_no_ray_and_are_black() {
        for (shape, corner) in [
            (FieldShape::Round, false),
            (FieldShape::Octagon, false),
            (FieldShape::Full, true),
        ] {
            let rays = rays(shape, 1.5, 0.0);
            assert!(has_ray(&rays, 30, 20) && has_ray(&rays, 30, 0));
            assert_eq!(has_ray(&rays, 10, 0), corner, "{shape:?}");
            assert_eq!(has_ray(&rays, 2, 20), corner, "beside the shorter side");
            let mut rgb = vec![200; 60 * 40 * 3];
            rays.shade_rows(0, &mut rgb);
            assert_eq!(rgb[0], if corner { 200 } else { 0 });
            assert_eq!(rgb[(20 * 60 + 30) * 3], 200);
        }
        // An octagon contains more of the corners than a circle.
        let area = |shape| {
            let rays = rays(shape, 0.0, 0.0);
            (0..2400).filter(|n| has_ray(&rays, n % 60, n / 60)).count() as f64
        };
        // The count of pixel centres inside a curve approximates its area to within a fraction of its length.
        assert!((area(FieldShape::Round) - core::f64::consts::PI * 400.0).abs() < 15.0);
        assert!(
            (area(FieldShape::Octagon) - 8.0 * (core::f64::consts::PI / 8.0).tan() * 400.0).abs()
                < 15.0
        );
    }

    #[test]
    fn mirrored_quarters_equal_the_directions_of_the_lens() {
        for (width, height) in [(31, 20), (20, 31), (9, 9), (1, 1), (2, 5)] {
            let optics = Optics::new(&Lens::Equidistant, Some(2.5), width, height).unwrap();
            assert!(optics.is_symmetric());
            let rays = LensRays::build(optics.clone(), &ImageField::FULL).unwrap();
            for n in 0..width * height {
                let (column, row) = (n % width, n / width);
                let at = [column as f64 + 0.5, row as f64 + 0.5];
                let expected = optics.direction(at).unwrap().map(|v| v as f32);
                assert_eq!(rays.direction(column, row), expected, "{column} {row}");
            }
        }
    }

    #[test]
    fn the_edge_is_soft_and_the_vignette_grows_towards_it() {
        let value = |rays: &LensRays, row: usize| {
            let mut rgb = vec![200; 60 * 40 * 3];
            rays.shade_rows(0, &mut rgb);
            rgb[(row * 60 + 30) * 3]
        };
        let soft = rays(FieldShape::Round, 2.0, 0.0);
        assert!(value(&soft, 0) > 0 && value(&soft, 0) < 100 && value(&soft, 3) == 200);
        let dark = rays(FieldShape::Full, 0.0, 1.0);
        assert!(value(&dark, 0) < value(&dark, 10) && value(&dark, 10) < value(&dark, 20));
        let faint = rays(FieldShape::Full, 0.0, 0.3);
        assert!(value(&faint, 0) > value(&dark, 0));
    }

    #[test]
    fn strips_are_darkened_equally_to_the_whole_picture() {
        let rays = rays(FieldShape::Octagon, 1.5, 0.7);
        let picture: Vec<u8> = (0..60 * 40 * 3).map(|n| (n * 7 % 256) as u8).collect();
        let mut whole = picture.clone();
        rays.shade_rows(0, &mut whole);
        let mut strips = picture;
        for first in [0, 13, 29] {
            let last = [13, 29, 40][[0, 13, 29].iter().position(|&f| f == first).unwrap()];
            rays.shade_rows(first, &mut strips[first * 180..last * 180]);
        }
        assert_eq!(whole, strips);
    }

    #[test]
    fn an_image_field_out_of_range_is_rejected_with_the_value() {
        for (edge_px, vignette) in [(-1.0, 0.0), (0.0, 1.5), (f64::NAN, 0.0), (0.0, f64::NAN)] {
            let field = ImageField {
                shape: FieldShape::Round,
                edge_px,
                vignette,
            };
            let optics = Optics::new(&Lens::Pinhole, Some(1.0), 8, 8).unwrap();
            assert!(LensRays::build(optics, &field).is_err());
        }
    }
}
