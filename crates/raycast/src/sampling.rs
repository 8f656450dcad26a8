//! Interpolation of a volume at positions between its voxels.

use carina_grid::VolumeView;

/// Point or offset in voxel coordinates; the fourth lane is 0, so that the lanes fill one register.
pub(crate) type Lanes = [f32; 4];

/// Volume of int16 values, prepared for sampling at f32 voxel coordinates; indices are clamped to the edge.
#[derive(Debug, Clone, Copy)]
pub struct Field<'a> {
    pub(crate) data: &'a [i16],
    /// Largest coordinate of a voxel per axis, `n - 1`; coordinates are clamped to `0 ..= last`.
    pub(crate) last: Lanes,
    /// Largest index of a cell's lower corner on each axis: `max(n - 2, 0)`.
    pub(crate) last_cell: [i32; 4],
    /// Distance in memory to the next voxel; 0 on an axis of one voxel, so that its second corner is its first.
    pub(crate) stride: [usize; 3],
}

/// Cell of eight neighbouring voxels, and a position in the cell.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cell {
    /// Voxel at the lower corner of the cell.
    ijk: [i32; 4],
    /// Index in memory of the voxel at the lower corner.
    base: usize,
    /// Position of the sampled point in its cell, 0 to 1 on each axis.
    t: Lanes,
}

#[inline(always)]
fn lerp(t: f32, a: f32, b: f32) -> f32 {
    t.mul_add(b - a, a)
}

/// Interpolate linearly between two integers, whose difference is exact.
#[inline(always)]
fn lerp_ints(t: f32, a: i32, b: i32) -> f32 {
    t.mul_add((b - a) as f32, a as f32)
}

/// Return the first of the two voxels that an i32 holds.
#[inline(always)]
const fn low(pair: i32) -> i32 {
    pair << 16 >> 16
}

/// Return the second of the two voxels that an i32 holds.
#[inline(always)]
const fn high(pair: i32) -> i32 {
    pair >> 16
}

/// Return the integer part of a voxel coordinate that is not negative.
#[inline(always)]
fn whole(x: f32) -> i32 {
    debug_assert!((0.0..=2e9).contains(&x));
    // SAFETY: coordinates are clamped to 0 ..= n - 1 and at most 1/2 is added; a grid has at most 2^31 voxels, so the
    // result fits an i32. Benchmark: the checked cast saturates with comparisons and moves, which cost a tenth of the
    // brute-force caster.
    unsafe { x.to_int_unchecked() }
}

/// Clamp coordinates to `0 ..= last`; NaN becomes 0.
#[inline(always)]
fn clamp(p: Lanes, last: Lanes) -> Lanes {
    // Comparisons compile to one instruction each; `f32::min` also handles a NaN in `last`, which cannot occur.
    std::array::from_fn(|a| {
        let x = if p[a] > 0.0 { p[a] } else { 0.0 };
        if x < last[a] { x } else { last[a] }
    })
}

impl<'a> Field<'a> {
    /// Prepare a volume for sampling between its voxels.
    #[must_use]
    pub fn new(volume: VolumeView<'a, i16>) -> Self {
        let [ni, nj, nk] = volume.grid().shape_ijk();
        let step = |n: usize, stride: usize| if n > 1 { stride } else { 0 };
        let four = [ni, nj, nk, 1];
        Self {
            data: volume.data(),
            last: four.map(|n| (n - 1) as f32),
            last_cell: four.map(|n| n.saturating_sub(2) as i32),
            stride: [step(ni, 1), step(nj, ni), step(nk, ni * nj)],
        }
    }

    /// Return the cell that contains a point in voxel coordinates (i, j, k), clamped to the volume.
    #[inline(always)]
    pub(crate) fn cell(&self, p: Lanes) -> Cell {
        let x = clamp(p, self.last);
        let ijk: [i32; 4] = std::array::from_fn(|a| whole(x[a]).min(self.last_cell[a]));
        Cell {
            ijk,
            base: self.index(ijk),
            t: std::array::from_fn(|a| x[a] - ijk[a] as f32),
        }
    }

    #[inline(always)]
    fn index(&self, ijk: [i32; 4]) -> usize {
        // An axis of one voxel has stride 0 and index 0. Indices are never negative.
        ijk[0] as usize + ijk[1] as usize * self.stride[1] + ijk[2] as usize * self.stride[2]
    }

    /// Return the value of a voxel, given its index in memory.
    #[inline(always)]
    fn at(&self, index: usize) -> i32 {
        debug_assert!(index < self.data.len());
        // SAFETY: every index is a sum over the axes of (0 ..= n - 1) * stride: `cell` clamps the lower corner to
        // last_cell, so that one step more is a voxel; `gradient_in` steps further only where the neighbour exists.
        // Benchmark: checked loads cost a fifth of the brute-force caster.
        i32::from(unsafe { *self.data.get_unchecked(index) })
    }

    /// Return a voxel and its neighbour along x in the low and the high half of an i32.
    ///
    /// The neighbour is the voxel itself if x has one voxel.
    #[inline(always)]
    fn pair(&self, index: usize) -> i32 {
        if self.stride[0] == 0 {
            let v = self.at(index);
            return v << 16 | v & 0xffff;
        }
        debug_assert!(index + 1 < self.data.len());
        // SAFETY: `index` and `index + 1` are voxels of one row, because `cell` clamps the lower corner to last_cell;
        // every bit pattern is a valid `[i16; 2]`, which has the alignment of i16. Benchmark: a sample needs half the
        // loads.
        let pair: [i16; 2] = unsafe { self.data.as_ptr().add(index).cast::<[i16; 2]>().read() };
        i32::from(pair[1]) << 16 | i32::from(pair[0]) & 0xffff
    }

    /// Interpolate `N` rows of two voxels along x, which start at the indices `starts`.
    #[inline(always)]
    fn rows<const N: usize>(&self, tx: f32, starts: [usize; N]) -> [f32; N] {
        let pairs = starts.map(|start| self.pair(start));
        std::array::from_fn(|n| lerp_ints(tx, low(pairs[n]), high(pairs[n])))
    }

    /// Return the interpolated value in a cell: along x, then y, then z, each as `a + t (b - a)` with one rounding.
    #[inline(always)]
    pub(crate) fn value_in(&self, cell: &Cell) -> f32 {
        let [_, sy, sz] = self.stride;
        let b = cell.base;
        let [r00, r10, r01, r11] = self.rows(cell.t[0], [b, b + sy, b + sz, b + sy + sz]);
        lerp(
            cell.t[2],
            lerp(cell.t[1], r00, r10),
            lerp(cell.t[1], r01, r11),
        )
    }

    /// Return the interpolated value at voxel coordinates.
    #[inline(always)]
    #[must_use]
    pub fn value(&self, [x, y, z]: [f32; 3]) -> f32 {
        self.value_in(&self.cell([x, y, z, 0.0]))
    }

    /// Return the gradient in a cell: central differences per voxel at the eight corners, interpolated like values.
    ///
    /// At the edge of the volume the missing neighbour is replaced by the edge voxel itself, so a difference there is
    /// half the one-sided one.
    #[inline(always)]
    pub(crate) fn gradient_in(&self, cell: &Cell) -> [f32; 3] {
        let [tx, ty, tz, _] = cell.t;
        std::array::from_fn(|a| {
            let stride = self.stride[a];
            // Strides to the voxel before the lower corners and to the voxel after the upper ones; 0 at the edge.
            let before = if cell.ijk[a] > 0 { stride } else { 0 };
            let after = if cell.ijk[a] < self.last_cell[a] {
                stride
            } else {
                0
            };
            let rise = |corner: usize| {
                let steps: usize = (0..3).map(|b| (corner >> b & 1) * self.stride[b]).sum();
                let at = cell.base + steps;
                if corner >> a & 1 == 0 {
                    self.at(at + stride) - self.at(at - before)
                } else {
                    self.at(at + after) - self.at(at - stride)
                }
            };
            let row = |n: usize| lerp_ints(tx, rise(2 * n), rise(2 * n + 1));
            let low = lerp(ty, row(0), row(1));
            let high = lerp(ty, row(2), row(3));
            lerp(tz, low, high) * 0.5
        })
    }

    /// Return the voxel nearest to a point, clamped to the volume: its index in memory and its coordinates.
    #[inline(always)]
    pub(crate) fn nearest(&self, p: Lanes) -> (usize, Lanes) {
        // The sum is at most last + 1/2, whose integer part is last.
        let ijk = clamp(p, self.last).map(|x| whole(x + 0.5));
        (self.index(ijk), ijk.map(|v| v as f32))
    }

    /// Return the cell that contains a point, clamped to the volume: the index of its lower corner, and its centre.
    ///
    /// For a point on or beyond the volume's upper face the result is the cell that starts at that face. Maps of cells
    /// have radius 0 there.
    #[inline(always)]
    pub(crate) fn cell_of(&self, p: Lanes) -> (usize, Lanes) {
        let ijk = clamp(p, self.last).map(whole);
        (self.index(ijk), ijk.map(|v| v as f32 + 0.5))
    }

    /// Return the value of the voxel whose index [`Self::nearest`] returned.
    #[inline(always)]
    pub(crate) fn voxel(&self, index: usize) -> i16 {
        self.data[index]
    }

    /// Return true if a point is in the box of the voxels, which extends half a voxel beyond the outer centres.
    #[inline(always)]
    pub(crate) fn contains(&self, p: [f32; 3]) -> bool {
        (0..3).all(|a| p[a] >= -0.5 && p[a] <= self.last[a] + 0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use carina_grid::{Affine, Grid};
    use proptest::prelude::*;

    fn random_volume(n: usize, seed: u64) -> Vec<i16> {
        let mut state = seed | 1;
        (0..n)
            .map(|_| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                ((state >> 40) % 4096) as i16 - 1024
            })
            .collect()
    }

    /// Return the interpolated value in f64 by the textbook sum over eight clamped corners.
    fn reference(volume: VolumeView<'_, i16>, p: [f64; 3]) -> f64 {
        let mut sum = 0.0;
        for corner in 0..8 {
            let mut weight = 1.0;
            let ijk = std::array::from_fn(|a| {
                let (floor, t) = (p[a].floor(), p[a] - p[a].floor());
                let high = corner >> a & 1;
                weight *= if high == 1 { t } else { 1.0 - t };
                floor as isize + high as isize
            });
            sum += weight * f64::from(volume.at_clamped(ijk));
        }
        sum
    }

    proptest! {
        #[test]
        fn interpolation_stays_within_a_quarter_hu_of_the_exact_value_and_of_its_corners(
            shape in prop::array::uniform3(1usize..7),
            at in prop::array::uniform3(0.0f64..1.0),
            seed in any::<u64>(),
        ) {
            let grid = Grid::new(shape, Affine::IDENTITY).unwrap();
            let data = random_volume(grid.num_voxels(), seed);
            let volume = VolumeView::new(&data, &grid).unwrap();
            let n = grid.shape_ijk();
            let p: [f32; 3] = std::array::from_fn(|a| (at[a] * n[a] as f64 - 0.5) as f32);
            let field = Field::new(volume);
            let value = f64::from(field.value(p));
            // Three roundings at values up to 4096 give an error below 0.001 HU. The classes allow 0.25 HU.
            prop_assert!((value - reference(volume, p.map(f64::from))).abs() < 0.01);
            let corners: Vec<i16> = (0..8)
                .map(|c| volume.at_clamped(std::array::from_fn(|a| p[a].floor() as isize + (c >> a & 1))))
                .collect();
            let (lo, hi) = (*corners.iter().min().unwrap(), *corners.iter().max().unwrap());
            prop_assert!(value >= f64::from(lo) - 0.25 && value <= f64::from(hi) + 0.25);
        }

        #[test]
        fn the_gradient_is_the_interpolated_central_difference(
            shape in prop::array::uniform3(1usize..7),
            at in prop::array::uniform3(0.0f64..1.0),
            seed in any::<u64>(),
        ) {
            let grid = Grid::new(shape, Affine::IDENTITY).unwrap();
            let data = random_volume(grid.num_voxels(), seed);
            let volume = VolumeView::new(&data, &grid).unwrap();
            let n = grid.shape_ijk();
            let p: [f32; 3] = std::array::from_fn(|a| (at[a] * (n[a] as f64 - 1.0)) as f32);
            let field = Field::new(volume);
            let found = field.gradient_in(&field.cell([p[0], p[1], p[2], 0.0]));
            for axis in 0..3 {
                // The expected gradient: central differences at the eight corners, with clamped indices, weighted.
                let mut sum = 0.0;
                for corner in 0..8 {
                    let mut weight = 1.0;
                    let ijk: [isize; 3] = std::array::from_fn(|a| {
                        let x = f64::from(p[a]);
                        let high = corner >> a & 1;
                        weight *= if high == 1 { x - x.floor() } else { 1.0 - (x - x.floor()) };
                        (x.floor() as isize + high as isize).min(n[a] as isize - 1)
                    });
                    let (mut before, mut after) = (ijk, ijk);
                    before[axis] -= 1;
                    after[axis] += 1;
                    sum += weight * 0.5 * (f64::from(volume.at_clamped(after)) - f64::from(volume.at_clamped(before)));
                }
                prop_assert!((f64::from(found[axis]) - sum).abs() < 0.01, "axis {axis}: {} {sum}", found[axis]);
            }
        }
    }
}
