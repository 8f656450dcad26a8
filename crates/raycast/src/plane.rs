//! Planes through a volume: one sample per pixel (paper 3.1, cut-plane view; and the slices).

use carina_grid::{Affine, VolumeView};
use rayon::prelude::*;

use crate::{Field, RaycastError};

/// Window and level: which values become black and white.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    lo: f32,
    scale: f32,
}

impl Window {
    /// Values from `level - width / 2` (black) to `level + width / 2` (white).
    pub fn new(width_hu: f64, level_hu: f64) -> Result<Self, RaycastError> {
        if !(width_hu.is_finite() && width_hu > 0.0 && level_hu.is_finite()) {
            return Err(RaycastError::Setting {
                what: "window",
                expected: "a width above 0 and a finite level".to_owned(),
                found: format!("width {width_hu}, level {level_hu}"),
            });
        }
        Ok(Self {
            lo: (level_hu - width_hu / 2.0) as f32,
            scale: (255.0 / width_hu) as f32,
        })
    }

    /// The grey level of a value.
    #[inline(always)]
    #[must_use]
    pub fn grey(&self, value: f32) -> u8 {
        // The cast saturates below 0 and above 255.
        (value - self.lo).mul_add(self.scale, 0.5) as u8
    }
}

/// Grey levels of a plane, `[row, column]`; 0 outside the volume.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlaneImage {
    /// Grey levels.
    pub grey: Vec<u8>,
    /// 1 where the pixel's centre lies in the volume.
    pub inside: Vec<u8>,
}

/// Samples a plane. `lps_from_pixel` maps pixel corners (column, row, 0) to patient space; pixel centres are at + 1/2.
pub fn sample_plane(
    volume: VolumeView<'_, i16>,
    lps_from_pixel: &Affine,
    width: usize,
    height: usize,
    window: Window,
) -> Result<PlaneImage, RaycastError> {
    check_size(width, height)?;
    let ijk_from_pixel = volume.grid().ijk_from_lps().after(lps_from_pixel);
    let field = Field::new(volume);
    let along_row = ijk_from_pixel.column(0).map(|v| v as f32);
    let mut image = PlaneImage {
        grey: vec![0; width * height],
        inside: vec![0; width * height],
    };
    image
        .grey
        .par_chunks_mut(width)
        .zip(image.inside.par_chunks_mut(width))
        .enumerate()
        .for_each(|(row, (grey, inside))| {
            let start = ijk_from_pixel
                .point([0.0, row as f64 + 0.5, 0.0])
                .map(|v| v as f32);
            for column in 0..width {
                let t = column as f32 + 0.5;
                let p = std::array::from_fn(|a| t.mul_add(along_row[a], start[a]));
                if field.contains(p) {
                    grey[column] = window.grey(field.value(p));
                    inside[column] = 1;
                }
            }
        });
    Ok(image)
}

pub(crate) fn check_size(width: usize, height: usize) -> Result<(), RaycastError> {
    if (1..=8192).contains(&width) && (1..=8192).contains(&height) {
        return Ok(());
    }
    Err(RaycastError::Setting {
        what: "viewport",
        expected: "1 to 8192 pixels on each side".to_owned(),
        found: format!("{width} x {height}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use carina_grid::Grid;

    #[test]
    fn a_window_maps_its_ends_to_black_and_white() {
        let w = Window::new(1500.0, -600.0).unwrap();
        assert_eq!(w.grey(-1350.0), 0);
        assert_eq!(w.grey(150.0), 255);
        assert_eq!(w.grey(-3000.0), 0);
        assert_eq!(w.grey(3000.0), 255);
        assert_eq!(w.grey(-600.0), 128);
        assert!(Window::new(0.0, 0.0).is_err());
    }

    #[test]
    fn a_plane_reads_the_voxels_it_passes_through_and_is_black_outside() {
        // Values say where they are: 100 k + 10 j + i, on an anisotropic grid with swapped axes.
        let place = Affine::from_columns(
            [0.0, 0.5, 0.0],
            [0.0, 0.0, -2.0],
            [-3.0, 0.0, 0.0],
            [7.0, 8.0, 9.0],
        );
        let grid = Grid::new([4, 5, 6], place).unwrap();
        let data: Vec<i16> = (0..120)
            .map(|n| (n / 30 * 100 + n / 6 % 5 * 10 + n % 6) as i16)
            .collect();
        let volume = VolumeView::new(&data, &grid).unwrap();
        // Columns along i, rows along j, at k = 2; one pixel margin to the left.
        let lps_from_ijk = *grid.lps_from_ijk();
        let ijk_from_pixel = Affine::from_columns(
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [-1.5, -0.5, 2.0],
        );
        let window = Window::new(255.0, 210.0).unwrap();
        let image =
            sample_plane(volume, &lps_from_ijk.after(&ijk_from_pixel), 8, 5, window).unwrap();
        for row in 0..5 {
            for column in 0..8 {
                let expected = if (1..7).contains(&column) {
                    window.grey((200 + 10 * row + column - 1) as f32)
                } else {
                    0
                };
                assert_eq!(image.grey[row * 8 + column], expected, "{row} {column}");
                assert_eq!(
                    image.inside[row * 8 + column] == 1,
                    (1..7).contains(&column)
                );
            }
        }
    }
}
