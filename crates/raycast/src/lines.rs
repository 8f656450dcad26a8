//! Pictures whose rows are arbitrary straight lines in the volume: curved reformations, and slabs round a plane.

use carina_grid::VolumeView;
use rayon::prelude::*;

use crate::{Field, PlaneImage, RaycastError, Window, plane::check_size};

/// Line of the volume that one picture row shows: pixel `c` has its centre at `start + (c + 1/2) step`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelLine {
    /// Left edge of the row's first pixel, at half its height, LPS mm.
    pub start_lps: [f64; 3],
    /// Vector from a pixel of the row to the next, LPS mm.
    pub step_lps: [f64; 3],
    /// Unit vector perpendicular to the picture, along which a slab is sampled.
    pub through_lps: [f64; 3],
}

/// Projection of the values across a slab.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SlabKind {
    /// Largest value across the slab, which shows vessels and nodules.
    Maximum,
    /// Smallest value across the slab, which shows airways.
    Minimum,
    /// Mean value across the slab: a thicker slice with less noise.
    Mean,
}

/// Thick slice round the plane of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slab {
    /// Thickness of the slab from front to back, mm.
    pub thickness_mm: f64,
    /// Projection of the values across the slab.
    pub kind: SlabKind,
}

/// Maximum thickness of a slab, mm; a thicker slab is a projection and would take seconds.
const MAX_SLAB_MM: f64 = 100.0;
/// Maximum number of samples across a slab; in a thick slab of small voxels the samples are farther apart.
const MAX_SLAB_SAMPLES: f64 = 256.0;

/// Sample a picture line by line; pixels whose centre is outside the volume are 0.
///
/// Samples across a slab are at most the smallest voxel spacing apart, unless this would need more than 256. Samples
/// outside the volume do not count.
///
/// # Errors
///
/// Returns an error if the size of the picture or the slab is not valid.
pub fn sample_lines(
    volume: VolumeView<'_, i16>,
    lines: &[PixelLine],
    width: usize,
    window: Window,
    slab: Option<Slab>,
) -> Result<PlaneImage, RaycastError> {
    check_size(width, lines.len())?;
    let offsets_mm = offsets_of(slab, volume.grid().min_spacing_mm())?;
    let kind = slab.map_or(SlabKind::Mean, |slab| slab.kind);
    let ijk_from_lps = volume.grid().ijk_from_lps();
    let field = Field::new(volume);
    let mut image = PlaneImage {
        grey: vec![0; width * lines.len()],
        inside: vec![0; width * lines.len()],
    };
    image
        .grey
        .par_chunks_mut(width)
        .zip(image.inside.par_chunks_mut(width))
        .zip(lines)
        .for_each(|((grey, inside), line)| {
            let start = ijk_from_lps.point(line.start_lps).map(|v| v as f32);
            let step = ijk_from_lps.vector(line.step_lps).map(|v| v as f32);
            let through = ijk_from_lps.vector(line.through_lps).map(|v| v as f32);
            for (column, (grey, inside)) in grey.iter_mut().zip(inside).enumerate() {
                let t = column as f32 + 0.5;
                let middle: [f32; 3] = std::array::from_fn(|a| t.mul_add(step[a], start[a]));
                let (mut count, mut gathered) = (0u32, 0f32);
                for offset in &offsets_mm {
                    let p = std::array::from_fn(|a| offset.mul_add(through[a], middle[a]));
                    if !field.contains(p) {
                        continue;
                    }
                    let value = field.value(p);
                    gathered = match kind {
                        _ if count == 0 => value,
                        SlabKind::Maximum => gathered.max(value),
                        SlabKind::Minimum => gathered.min(value),
                        SlabKind::Mean => gathered + value,
                    };
                    count += 1;
                }
                if count > 0 {
                    let value = match kind {
                        SlabKind::Mean => gathered / count as f32,
                        _ => gathered,
                    };
                    *grey = window.grey(value);
                    *inside = 1;
                }
            }
        });
    Ok(image)
}

/// Return the offsets in mm from the middle of a slab at which it is sampled; one offset of 0 without a slab.
fn offsets_of(slab: Option<Slab>, spacing_mm: f64) -> Result<Vec<f32>, RaycastError> {
    let Some(Slab { thickness_mm, .. }) = slab else {
        return Ok(vec![0.0]);
    };
    if !(0.0..=MAX_SLAB_MM).contains(&thickness_mm) {
        return Err(RaycastError::Setting {
            what: "slab",
            expected: format!("0 to {MAX_SLAB_MM} mm"),
            found: format!("{thickness_mm} mm"),
        });
    }
    let num = (thickness_mm / spacing_mm)
        .ceil()
        .clamp(1.0, MAX_SLAB_SAMPLES) as usize;
    Ok((0..num)
        .map(|n| (((n as f64 + 0.5) / num as f64 - 0.5) * thickness_mm) as f32)
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use carina_grid::{Affine, Grid};

    fn grid() -> Grid {
        // The grid is anisotropic and has swapped axes.
        let place = Affine::from_columns(
            [0.0, 0.5, 0.0],
            [0.0, 0.0, -2.0],
            [-3.0, 0.0, 0.0],
            [7.0, 8.0, 9.0],
        );
        Grid::new([4, 5, 6], place).unwrap()
    }

    /// Return values that encode their position: 100 k + 10 j + i.
    fn data() -> Vec<i16> {
        (0..120)
            .map(|n| (n / 30 * 100 + n / 6 % 5 * 10 + n % 6) as i16)
            .collect()
    }

    fn lines_at(grid: &Grid, k: f64) -> Vec<PixelLine> {
        let place = grid.lps_from_ijk();
        (0..5)
            .map(|j| PixelLine {
                start_lps: place.point([-0.5, f64::from(j), k]),
                step_lps: place.vector([1.0, 0.0, 0.0]),
                through_lps: [-1.0, 0.0, 0.0],
            })
            .collect()
    }

    #[test]
    fn rows_read_the_voxels_they_pass_through() {
        let (grid, data) = (grid(), data());
        let volume = VolumeView::new(&data, &grid).unwrap();
        let window = Window::new(255.0, 127.5).unwrap();
        let image = sample_lines(volume, &lines_at(&grid, 2.0), 7, window, None).unwrap();
        for j in 0..5 {
            for i in 0..7 {
                let expected = if i < 6 { (200 + 10 * j + i) as u8 } else { 0 };
                assert_eq!(image.grey[j * 7 + i], expected);
                assert_eq!(image.inside[j * 7 + i] == 1, i < 6);
            }
        }
    }

    #[test]
    fn a_slab_combines_values_along_its_normal_and_ignores_samples_outside() {
        let (grid, data) = (grid(), data());
        let volume = VolumeView::new(&data, &grid).unwrap();
        let window = Window::new(255.0, 127.5).unwrap();
        let look = |k: f64, thickness_mm: f64, kind| {
            let slab = Some(Slab { thickness_mm, kind });
            sample_lines(volume, &lines_at(&grid, k), 6, window, slab)
                .unwrap()
                .grey[13]
        };
        // Voxel (1, 2) of each slice is 21 + 100 k. Slices are 3 mm apart and the smallest spacing is 0.5 mm: 6 mm are
        // sampled at 12 positions, the outermost 0.25 mm from the slab's faces, where k = 0.083 and 1.917.
        assert_eq!(look(1.0, 6.0, SlabKind::Maximum), 213);
        assert_eq!(look(1.0, 6.0, SlabKind::Minimum), 29);
        assert_eq!(look(1.0, 6.0, SlabKind::Mean), 121);
        assert_eq!(look(1.0, 0.0, SlabKind::Mean), 121);
        // Half of the slab is outside: k from -1 to -0.5 does not count, and k from -0.5 to 0 is clamped to the first
        // slice.
        assert_eq!(look(0.0, 6.0, SlabKind::Minimum), 21);
        assert!(look(0.0, 6.0, SlabKind::Mean) > 21);
    }

    #[test]
    fn slabs_out_of_range_are_rejected() {
        let (grid, data) = (grid(), data());
        let volume = VolumeView::new(&data, &grid).unwrap();
        let window = Window::new(255.0, 127.5).unwrap();
        for thickness_mm in [-1.0, 101.0, f64::NAN] {
            let slab = Some(Slab {
                thickness_mm,
                kind: SlabKind::Mean,
            });
            let found = sample_lines(volume, &lines_at(&grid, 2.0), 6, window, slab);
            assert_eq!(found.unwrap_err().code(), "render.setting");
        }
    }
}
