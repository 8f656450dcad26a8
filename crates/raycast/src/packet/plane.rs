//! Sampling of a plane with as many pixels at once as a register has lanes: [`crate::sample_plane`], tile by tile.

#![cfg_attr(
    not(target_arch = "x86_64"),
    expect(
        dead_code,
        unused_variables,
        reason = "elsewhere than with AVX2 pixels are taken one by one"
    )
)]

#[cfg(target_arch = "x86_64")]
use super::{avx2, avx512, gathers::gathers_are_faster, pair::Pair};
use super::{
    lanes::{Array, Lanes, MAX_LANES},
    voxels::Voxels,
};
use crate::{Field, InstructionSet, Window};

/// Number of rows of a tile, the part of a plane that is sampled at once (docs/decisions/0132).
pub(crate) const TILE_ROWS: usize = 64;
/// Number of columns of a tile (docs/decisions/0132).
///
/// In an oblique plane, each pixel of a row reads one or two other rows of voxels. 256 pixels read more cache lines
/// than the nearest cache holds; the lines of 16 pixels stay in the cache for the next row.
const TILE_COLUMNS: usize = 16;
/// Number of rows between the row that is sampled and the row that is prefetched (docs/decisions/0132).
const ROWS_AHEAD: usize = 8;

/// Parameters that all tiles of a plane share.
#[derive(Clone, Copy)]
pub(crate) struct PlaneTiles<'a> {
    voxels: Voxels<'a>,
    /// Voxel coordinates of the centre of the last voxel.
    last: [f32; 3],
    /// Voxel coordinates of the upper end of the box of the voxels.
    end: [f32; 3],
    along_row: [f32; 3],
    window: Window,
    simd: InstructionSet,
    gathers: bool,
}

/// Position of all pixels of a tile relative to the volume.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Tile {
    /// All pixels are in cells of eight voxels.
    Between,
    /// No pixel is in the box of the voxels.
    Outside,
    /// Some pixels are between voxels, others are not.
    Any,
}

/// Return the smallest and the largest voxel coordinates of the starts of rows; `None` if a coordinate is not finite.
#[inline(always)]
fn range_of(starts: &[[f32; 3]]) -> Option<[[f32; 3]; 2]> {
    let (mut least, mut most) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for start in starts {
        for a in 0..3 {
            least[a] = if start[a] < least[a] {
                start[a]
            } else {
                least[a]
            };
            most[a] = if start[a] > most[a] {
                start[a]
            } else {
                most[a]
            };
        }
    }
    let finite = starts.as_flattened().iter().all(|v| v.is_finite());
    finite.then_some([least, most])
}

impl<'a> PlaneTiles<'a> {
    /// Prepare a plane for tiles; return `None` if its pixels must be sampled one by one.
    ///
    /// Pixels are sampled one by one without AVX2, for volumes beyond 32-bit indices, and for one voxel along x.
    pub(crate) fn of(
        field: &Field<'a>,
        along_row: [f32; 3],
        window: Window,
        simd: InstructionSet,
    ) -> Option<Self> {
        #[cfg(target_arch = "x86_64")]
        {
            if !matches!(simd, InstructionSet::Avx2 | InstructionSet::Avx512) {
                return None;
            }
            Some(Self {
                voxels: Voxels::of(field)?,
                last: [0, 1, 2].map(|a| field.last[a]),
                end: [0, 1, 2].map(|a| field.last[a] + 0.5),
                along_row,
                window,
                simd,
                gathers: gathers_are_faster(simd),
            })
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            let _ = (field, along_row, window, simd);
            None
        }
    }

    /// Return the plane with or without gather instructions for its reads, so that tests can compare both.
    #[cfg(test)]
    pub(crate) fn with_gathers(self, gathers: bool) -> Self {
        Self { gathers, ..self }
    }

    /// Sample rows of pixels, at most [`TILE_ROWS`], that start at voxel coordinates `starts`.
    ///
    /// Both output slices must contain zeros.
    pub(crate) fn sample(&self, starts: &[[f32; 3]], grey: &mut [u8], inside: &mut [u8]) {
        match self.simd {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
            // Benchmark: `carina bench isoregion`, the oblique slice.
            InstructionSet::Avx512 => unsafe { self.sample_avx512(starts, grey, inside) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
            InstructionSet::Avx2 => unsafe { self.sample_avx2(starts, grey, inside) },
            _ => unreachable!("`of` makes no tiles for it"),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn sample_avx512(&self, starts: &[[f32; 3]], grey: &mut [u8], inside: &mut [u8]) {
        // SAFETY: this function runs only on a machine with the instructions of its target features.
        let l = unsafe { avx512::Avx512::new(self.gathers) };
        self.tiles::<_, false>(l, starts, grey, inside);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn sample_avx2(&self, starts: &[[f32; 3]], grey: &mut [u8], inside: &mut [u8]) {
        // SAFETY: this function runs only on a machine with the instructions of its target features.
        let l = Pair(unsafe { avx2::Avx2::new(self.gathers) });
        self.tiles::<_, true>(l, starts, grey, inside);
    }

    /// Return the position, relative to the volume, of the pixels in a range of columns of a tile.
    ///
    /// A coordinate is `t * along + start` with one rounding, which is monotonic in both `t` and `start`: over a tile
    /// it is between the coordinates at the corners.
    #[inline(always)]
    fn place(&self, range: &[[f32; 3]; 2], first_column: usize, last_column: usize) -> Tile {
        let ends = [first_column, last_column].map(|c| c as f32 + 0.5);
        let mut between = true;
        for a in 0..3 {
            let corners = ends.map(|t| range.map(|start| t.mul_add(self.along_row[a], start[a])));
            let corners = corners.as_flattened();
            if corners.iter().all(|&p| p < -0.5) || corners.iter().all(|&p| p > self.end[a]) {
                return Tile::Outside;
            }
            between &= corners.iter().all(|&p| p >= 0.0 && p < self.last[a]);
        }
        if between { Tile::Between } else { Tile::Any }
    }

    /// Return the voxel coordinates of the pixels that are `t` columns from the start of a row.
    #[inline(always)]
    fn places<L: Lanes>(&self, l: L, t: L::F, start: &[f32; 3]) -> [L::F; 3] {
        let mut p = [t; 3];
        for a in 0..3 {
            p[a] = l.fma(t, l.splat(self.along_row[a]), l.splat(start[a]));
        }
        p
    }

    /// Sample rows of pixels tile by tile; `PREFETCHES` enables prefetches.
    #[inline(always)]
    fn tiles<L: Lanes, const PREFETCHES: bool>(
        &self,
        l: L,
        starts: &[[f32; 3]],
        grey: &mut [u8],
        inside: &mut [u8],
    ) {
        let mut centres: Array<f32> = [0.0; MAX_LANES];
        for n in 0..MAX_LANES {
            centres[n] = n as f32 + 0.5;
        }
        let centres = l.fill(l.splat(0.0), u32::MAX >> (32 - L::N), &centres);
        let width = grey.len() / starts.len();
        let range = range_of(starts);
        let mut first = 0;
        while first < width {
            let end = (first + TILE_COLUMNS).min(width);
            let tile = range.map_or(Tile::Any, |range| self.place(&range, first, end - 1));
            let whole = tile == Tile::Between && (end - first).is_multiple_of(L::N);
            if tile != Tile::Outside {
                for row in 0..starts.len() {
                    let mut column = first;
                    while column < end {
                        let t = l.add(l.splat(column as f32), centres);
                        if PREFETCHES {
                            // Prefetch later rows of this tile, and at the tile's end those of the next tile.
                            let soon = row + ROWS_AHEAD;
                            let beside = if soon < starts.len() { 0 } else { TILE_COLUMNS };
                            let t = l.add(t, l.splat(beside as f32));
                            let start = &starts[soon % starts.len()];
                            self.voxels.prefetch_cells(l, self.places(l, t, start));
                        }
                        let p = self.places(l, t, &starts[row]);
                        let at = row * width + column;
                        if whole {
                            let pixels = at..at + L::N;
                            // SAFETY: `place` has returned `Tile::Between` for this tile.
                            unsafe { self.sample_between(l, p, &mut grey[pixels.clone()]) };
                            inside[pixels].fill(1);
                        } else {
                            let pixels = at..at + L::N.min(end - column);
                            self.sample_any(l, p, &mut grey[pixels.clone()], &mut inside[pixels]);
                        }
                        column += L::N;
                    }
                }
            }
            first = end;
        }
    }

    /// Sample pixels that are all in cells of eight voxels; `grey` has as many items as a register has lanes.
    ///
    /// # Safety
    ///
    /// The pixels must be in a tile for which [`Self::place`] returns [`Tile::Between`].
    #[inline(always)]
    unsafe fn sample_between<L: Lanes>(&self, l: L, p: [L::F; 3], grey: &mut [u8]) {
        // SAFETY: the caller guarantees that the pixels are in cells of eight voxels. Benchmark:
        // `carina bench isoregion`, the oblique slice; without clamps and tests a slice takes a tenth less.
        let cells = unsafe { self.voxels.cells_between(l, p) };
        let level = self.level(l, self.voxels.value(l, &cells));
        for n in 0..L::N {
            grey[n] = level[n] as u8;
        }
    }

    /// Sample pixels at any position, as many as `grey` and `inside` have items.
    #[inline(always)]
    fn sample_any<L: Lanes>(&self, l: L, p: [L::F; 3], grey: &mut [u8], inside: &mut [u8]) {
        // True in all lanes. The comparisons below clear lanes outside the box, and lanes with a NaN.
        let mut within = l.less(l.splat(-1.0), l.splat(0.0));
        for a in 0..3 {
            within = l.and(within, l.less(l.splat(f32::NEG_INFINITY), p[a]));
            within = l.without(within, l.less(p[a], l.splat(-0.5)));
            within = l.without(within, l.less(l.splat(self.end[a]), p[a]));
        }
        let within = l.bits(within);
        if within == 0 {
            return;
        }
        let value = self.voxels.value(l, &self.voxels.cells(l, p));
        let level = self.level(l, value);
        for n in 0..grey.len().min(L::N) {
            let set = (within >> n & 1) as u8;
            inside[n] = set;
            grey[n] = level[n] as u8 * set;
        }
    }

    /// Return the grey levels of values; the operations equal [`Window::grey`].
    #[inline(always)]
    fn level<L: Lanes>(&self, l: L, value: L::F) -> Array<i32> {
        let (lo, scale) = self.window.ramp();
        let level = l.fma(l.sub(value, l.splat(lo)), l.splat(scale), l.splat(0.5));
        let level = l.min(l.max(level, l.splat(0.0)), l.splat(255.0));
        l.store_i(l.whole(level))
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;
    use carina_grid::{Affine, Grid, VolumeView};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_tile_is_between_voxels_or_outside_only_if_all_of_its_pixels_are(
            shape in prop::array::uniform3(2usize..90),
            along in prop::array::uniform3(-1.0f32..1.0),
            down in prop::array::uniform3(-1.0f32..1.0),
            middle in prop::array::uniform3(-0.2f32..1.2),
            num_rows in 1usize..=TILE_ROWS,
            num_columns in 1usize..=TILE_COLUMNS,
        ) {
            let grid = Grid::new(shape, Affine::IDENTITY).unwrap();
            let data = vec![0i16; grid.num_voxels()];
            let field = Field::new(VolumeView::new(&data, &grid).unwrap());
            let window = Window::new(100.0, 0.0).unwrap();
            let Some(tiles) = PlaneTiles::of(&field, along, window, InstructionSet::Avx2) else {
                return Ok(());
            };
            let starts: Vec<[f32; 3]> = (0..num_rows)
                .map(|row| [0, 1, 2].map(|a| middle[a] * tiles.last[a] + (row as f32 - 8.0) * down[a]))
                .collect();
            let first = 16;
            let tile = tiles.place(&range_of(&starts).unwrap(), first, first + num_columns - 1);
            for start in &starts {
                for column in first..first + num_columns {
                    let p: [f32; 3] = std::array::from_fn(|a| (column as f32 + 0.5).mul_add(along[a], start[a]));
                    match tile {
                        Tile::Between => prop_assert!((0..3).all(|a| p[a] >= 0.0 && p[a] < field.last[a])),
                        Tile::Outside => prop_assert!(!field.contains(p)),
                        Tile::Any => {}
                    }
                }
            }
        }
    }

    #[test]
    fn tiles_in_the_middle_are_classified_between_voxels_and_distant_tiles_outside() {
        let grid = Grid::new([40, 50, 60], Affine::IDENTITY).unwrap();
        let data = vec![0i16; grid.num_voxels()];
        let field = Field::new(VolumeView::new(&data, &grid).unwrap());
        let window = Window::new(100.0, 0.0).unwrap();
        let Some(tiles) = PlaneTiles::of(&field, [0.5, -0.2, 0.1], window, InstructionSet::Avx2)
        else {
            return;
        };
        let place = |start: [f32; 3]| tiles.place(&[start, start.map(|s| s + 5.0)], 0, 15);
        assert!(place([20.0; 3]) == Tile::Between);
        assert!(place([-2.0, 20.0, 20.0]) == Tile::Any);
        assert!(place([20.0, 20.0, 44.0]) == Tile::Outside);
        assert!(range_of(&[[0.0; 3], [f32::NAN; 3]]).is_none());
    }
}
