//! Pictures of planes through a volume, with one sample per pixel (cut-plane view of paper 3.1, and slices).

use std::ops::Range;

use carina_grid::{Affine, VolumeView};
use rayon::prelude::*;

use crate::{
    Field, InstructionSet, RaycastError, Window,
    packet::{PlaneTiles, TILE_ROWS},
};

/// Grey levels of a plane, `[row, column]`; 0 outside the volume.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlaneImage {
    /// Grey level of each pixel, 0 to 255, row by row.
    pub grey: Vec<u8>,
    /// Mask of the pixels: 1 if the pixel's centre is in the volume.
    pub inside: Vec<u8>,
}

/// Sample the picture of a plane through a volume.
///
/// `lps_from_pixel` maps pixel corners (column, row, 0) to patient space; pixel centres are at + 1/2.
///
/// # Errors
///
/// Returns an error if the size of the picture is not valid.
pub fn sample_plane(
    volume: VolumeView<'_, i16>,
    lps_from_pixel: &Affine,
    width: usize,
    height: usize,
    window: Window,
) -> Result<PlaneImage, RaycastError> {
    let simd = InstructionSet::best();
    sample_plane_by(volume, lps_from_pixel, width, 0..height, window, simd)
}

/// Sample rows of a plane with a given instruction set; the results are equal for all sets, bit for bit.
///
/// # Errors
///
/// Returns an error if the size of the picture is not valid.
pub fn sample_plane_by(
    volume: VolumeView<'_, i16>,
    lps_from_pixel: &Affine,
    width: usize,
    rows: Range<usize>,
    window: Window,
    simd: InstructionSet,
) -> Result<PlaneImage, RaycastError> {
    check_size(width, rows.end)?;
    check_size(width, rows.len())?;
    let ijk_from_pixel = volume.grid().ijk_from_lps().after(lps_from_pixel);
    let field = Field::new(volume);
    let along_row = ijk_from_pixel.column(0).map(|v| v as f32);
    let tiles = PlaneTiles::of(&field, along_row, window, simd);
    Ok(sample_rows(
        &field,
        &ijk_from_pixel,
        width,
        rows,
        window,
        tiles.as_ref(),
    ))
}

/// Sample rows of a plane in tiles, or pixel by pixel if the instruction set has no tiles.
fn sample_rows(
    field: &Field<'_>,
    ijk_from_pixel: &Affine,
    width: usize,
    rows: Range<usize>,
    window: Window,
    tiles: Option<&PlaneTiles<'_>>,
) -> PlaneImage {
    let height = rows.len();
    let along_row = ijk_from_pixel.column(0).map(|v| v as f32);
    let mut image = PlaneImage {
        grey: vec![0; width * height],
        inside: vec![0; width * height],
    };
    let start_of = |row: usize| {
        let row = (rows.start + row) as f64 + 0.5;
        ijk_from_pixel.point([0.0, row, 0.0]).map(|v| v as f32)
    };
    // A row takes half a microsecond, so a small picture is finished before another thread wakes up.
    let band_rows = (BAND_PIXELS / width).max(1);
    let sample_band = |(band, (grey, inside)): (usize, (&mut [u8], &mut [u8]))| {
        let mut first = band * band_rows;
        let parts = grey
            .chunks_mut(width * TILE_ROWS)
            .zip(inside.chunks_mut(width * TILE_ROWS));
        for (grey, inside) in parts {
            let mut starts = [[0.0; 3]; TILE_ROWS];
            let starts = &mut starts[..grey.len() / width];
            for (n, start) in starts.iter_mut().enumerate() {
                *start = start_of(first + n);
            }
            first += TILE_ROWS;
            if let Some(tiles) = tiles {
                tiles.sample(starts, grey, inside);
                continue;
            }
            let lines = grey.chunks_mut(width).zip(inside.chunks_mut(width));
            for (start, (grey, inside)) in starts.iter().zip(lines) {
                sample_row(field, *start, along_row, window, grey, inside);
            }
        }
    };
    if height <= band_rows {
        sample_band((0, (&mut image.grey, &mut image.inside)));
    } else {
        image
            .grey
            .par_chunks_mut(width * band_rows)
            .zip(image.inside.par_chunks_mut(width * band_rows))
            .enumerate()
            .for_each(sample_band);
    }
    image
}

/// Number of pixels of a band that one thread samples; a smaller picture has one band.
const BAND_PIXELS: usize = 1 << 16;

/// Sample a row of a plane pixel by pixel; packets must give the same result.
fn sample_row(
    field: &Field<'_>,
    start: [f32; 3],
    along_row: [f32; 3],
    window: Window,
    grey: &mut [u8],
    inside: &mut [u8],
) {
    for column in 0..grey.len() {
        let t = column as f32 + 0.5;
        let p = std::array::from_fn(|a| t.mul_add(along_row[a], start[a]));
        if field.contains(p) {
            grey[column] = window.grey(field.value(p));
            inside[column] = 1;
        }
    }
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
    fn planes_of_every_instruction_set_equal_single_pixels() {
        let mut state = 5u64;
        let mut random = |most: f64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 11) as f64 / (1u64 << 53) as f64 * most
        };
        let mut num_seen = 0;
        for shape in [
            [9, 11, 13],
            [1, 7, 5],
            [6, 1, 2],
            [5, 4, 1],
            [1, 1, 1],
            [30, 40, 50],
            [70, 90, 80],
        ] {
            let place = Affine::from_columns(
                [0.1, 0.5, 0.0],
                [0.0, 0.2, -2.0],
                [-3.0, 0.0, 0.3],
                [7.0, 8.0, 9.0],
            );
            let grid = Grid::new(shape, place).unwrap();
            let data: Vec<i16> = (0..grid.num_voxels())
                .map(|_| (random(4000.0) - 1000.0) as i16)
                .collect();
            let volume = VolumeView::new(&data, &grid).unwrap();
            let field = Field::new(volume);
            let window = Window::new(1500.0, 300.0).unwrap();
            for (width, height) in [(1, 1), (7, 5), (37, 21), (64, 64), (129, 3)] {
                for turn in 0..6 {
                    // The planes go through the middle at any angle; the last ones are along an axis, with pixels
                    // exactly on the faces of the box.
                    let step = if turn < 4 { random(0.4) } else { 0.5 };
                    let mut axis = || {
                        if turn < 4 {
                            random(2.0) - 1.0
                        } else {
                            f64::from(turn - 4)
                        }
                    };
                    let across = [axis() * step, axis() * step, step];
                    let down = [step, axis() * step, axis() * step];
                    let middle = [shape[2], shape[1], shape[0]].map(|n| (n as f64 - 1.0) / 2.0);
                    let first = std::array::from_fn(|a| {
                        middle[a] - across[a] * width as f64 / 2.0 - down[a] * height as f64 / 2.0
                    });
                    let ijk_from_pixel =
                        Affine::from_columns(across, down, [0.3, -0.7, 0.2], first);
                    let matrix = place.after(&ijk_from_pixel);
                    let mut expected = PlaneImage {
                        grey: vec![0; width * height],
                        inside: vec![0; width * height],
                    };
                    let exact = grid.ijk_from_lps().after(&matrix);
                    for row in 0..height {
                        let start = exact.point([0.0, row as f64 + 0.5, 0.0]).map(|v| v as f32);
                        let part = row * width..(row + 1) * width;
                        sample_row(
                            &field,
                            start,
                            exact.column(0).map(|v| v as f32),
                            window,
                            &mut expected.grey[part.clone()],
                            &mut expected.inside[part],
                        );
                    }
                    num_seen += expected.grey.iter().filter(|&&g| g > 0 && g < 255).count();
                    for simd in InstructionSet::available() {
                        let found =
                            sample_plane_by(volume, &matrix, width, 0..height, window, simd)
                                .unwrap();
                        assert!(found == expected, "{simd:?} {shape:?} {width} x {height}");
                        let along_row = exact.column(0).map(|v| v as f32);
                        for gathers in [false, true] {
                            let Some(tiles) = PlaneTiles::of(&field, along_row, window, simd)
                            else {
                                continue;
                            };
                            let tiles = tiles.with_gathers(gathers);
                            let found =
                                sample_rows(&field, &exact, width, 0..height, window, Some(&tiles));
                            assert!(found == expected, "{simd:?} {shape:?} gathers: {gathers}");
                        }
                        let rows = height / 3..height - height / 4;
                        let strip =
                            sample_plane_by(volume, &matrix, width, rows.clone(), window, simd)
                                .unwrap();
                        let part = rows.start * width..rows.end * width;
                        assert!(strip.grey == expected.grey[part.clone()], "{rows:?}");
                        assert!(strip.inside == expected.inside[part], "{rows:?}");
                    }
                }
            }
        }
        assert!(num_seen > 10_000, "the planes meet the volumes");
    }

    #[test]
    fn a_plane_of_numbers_too_large_is_black() {
        let grid = Grid::new([8, 9, 10], Affine::IDENTITY).unwrap();
        let data = vec![500i16; grid.num_voxels()];
        let volume = VolumeView::new(&data, &grid).unwrap();
        let window = Window::new(100.0, 0.0).unwrap();
        for (across, first) in [(1e300, 0.0), (-1e300, 1e300), (1.0, 1e300), (3e38, -3e38)] {
            let matrix = Affine::from_columns(
                [across, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [0.0, 0.0, 1.0],
                [first; 3],
            );
            for simd in InstructionSet::available() {
                let image = sample_plane_by(volume, &matrix, 40, 0..70, window, simd).unwrap();
                assert!(
                    image.grey.iter().all(|&g| g == 0),
                    "{simd:?} {across} {first}"
                );
                assert!(
                    image.inside.iter().all(|&i| i == 0),
                    "{simd:?} {across} {first}"
                );
            }
        }
    }

    #[test]
    fn a_plane_reads_the_voxels_it_passes_through_and_is_black_outside() {
        // Values encode their position: 100 k + 10 j + i, on an anisotropic grid with swapped axes.
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
