//! Reading a volume between its voxels.

use carina_grid::VolumeView;

/// An int16 volume prepared for sampling at f32 voxel coordinates; indices clamp to the edge.
#[derive(Debug, Clone, Copy)]
pub struct Field<'a> {
    data: &'a [i16],
    /// `n - 1` per axis: coordinates are clamped to `0 ..= last`.
    last: [f32; 3],
    /// The highest lower corner of a cell, `max(n - 2, 0)`.
    last_cell: [usize; 3],
    /// Distance in memory to the next voxel; 0 on an axis of one voxel, so that its second corner is its first.
    stride: [usize; 3],
}

/// A cell of eight voxels and the place in it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cell {
    /// Lower corner.
    ijk: [usize; 3],
    /// Its place in memory.
    base: usize,
    /// 0..1 on each axis.
    t: [f32; 3],
}

#[inline(always)]
fn lerp(t: f32, a: f32, b: f32) -> f32 {
    t.mul_add(b - a, a)
}

impl<'a> Field<'a> {
    /// Prepares a volume.
    #[must_use]
    pub fn new(volume: VolumeView<'a, i16>) -> Self {
        let n = volume.grid().shape_ijk();
        let step = |axis: usize, stride: usize| if n[axis] > 1 { stride } else { 0 };
        Self {
            data: volume.data(),
            last: n.map(|n| (n - 1) as f32),
            last_cell: n.map(|n| n.saturating_sub(2)),
            stride: [step(0, 1), step(1, n[0]), step(2, n[0] * n[1])],
        }
    }

    /// The cell that holds a point, clamped to the volume.
    #[inline(always)]
    pub(crate) fn cell(&self, p: [f32; 3]) -> Cell {
        let mut ijk = [0; 3];
        let mut t = [0.0; 3];
        for a in 0..3 {
            // max first: it also turns NaN into 0.
            let x = p[a].max(0.0).min(self.last[a]);
            ijk[a] = (x as usize).min(self.last_cell[a]);
            t[a] = x - ijk[a] as f32;
        }
        Cell {
            ijk,
            base: ijk[0] + ijk[1] * self.stride[1] + ijk[2] * self.stride[2],
            t,
        }
    }

    #[inline(always)]
    fn at(&self, index: usize) -> f32 {
        f32::from(self.data[index])
    }

    /// Interpolated value: along x, then y, then z, each as `a + t (b - a)` with one rounding.
    #[inline(always)]
    pub(crate) fn value_in(&self, cell: &Cell) -> f32 {
        let [sx, sy, sz] = self.stride;
        let row = |base: usize| lerp(cell.t[0], self.at(base), self.at(base + sx));
        let plane = |base: usize| lerp(cell.t[1], row(base), row(base + sy));
        lerp(cell.t[2], plane(cell.base), plane(cell.base + sz))
    }

    /// Interpolated value at voxel coordinates.
    #[inline(always)]
    #[must_use]
    pub fn value(&self, p: [f32; 3]) -> f32 {
        self.value_in(&self.cell(p))
    }

    /// Central differences per voxel, interpolated between the eight corners.
    ///
    /// At the edge the missing neighbour is the edge voxel itself, so a difference there is half the one-sided one.
    #[inline(always)]
    pub(crate) fn gradient_in(&self, cell: &Cell) -> [f32; 3] {
        let [sx, sy, sz] = self.stride;
        // Memory steps from the lower corner to the voxels before it and two after it, held at the edge.
        let mut before = [0usize; 3];
        let mut after = [0usize; 3];
        for a in 0..3 {
            let s = self.stride[a];
            before[a] = if cell.ijk[a] > 0 { s } else { 0 };
            after[a] = if cell.ijk[a] < self.last_cell[a] {
                2 * s
            } else {
                s
            };
        }
        let b = cell.base;
        let v = |index: usize| self.at(index);
        let [tx, ty, tz] = cell.t;
        // d/dx at both ends of a row, then between the four rows.
        let dx_row = |r: usize| lerp(tx, v(r + sx) - v(r - before[0]), v(r + after[0]) - v(r));
        let dx = lerp(
            tz,
            lerp(ty, dx_row(b), dx_row(b + sy)),
            lerp(ty, dx_row(b + sz), dx_row(b + sy + sz)),
        );
        let x_of = |r: usize| lerp(tx, v(r), v(r + sx));
        let (r00, r10, r01, r11) = (x_of(b), x_of(b + sy), x_of(b + sz), x_of(b + sy + sz));
        let dy_plane = |r: usize, near: f32, far: f32| {
            lerp(ty, far - x_of(r - before[1]), x_of(r + after[1]) - near)
        };
        let dy = lerp(tz, dy_plane(b, r00, r10), dy_plane(b + sz, r01, r11));
        let dz_row = |r: usize, near: f32, far: f32| {
            lerp(tz, far - x_of(r - before[2]), x_of(r + after[2]) - near)
        };
        let dz = lerp(ty, dz_row(b, r00, r01), dz_row(b + sy, r10, r11));
        [dx * 0.5, dy * 0.5, dz * 0.5]
    }

    /// The voxel nearest to a point, as array position, clamped to the volume.
    #[inline(always)]
    pub(crate) fn nearest(&self, p: [f32; 3]) -> (usize, [f32; 3]) {
        let mut v = [0.0f32; 3];
        let mut index = 0;
        for a in 0..3 {
            v[a] = (p[a] + 0.5).floor().max(0.0).min(self.last[a]);
            index += v[a] as usize * self.stride[a];
        }
        (index, v)
    }

    /// The value of a voxel by array position.
    #[inline(always)]
    pub(crate) fn voxel(&self, index: usize) -> i16 {
        self.data[index]
    }

    /// True if the point lies in the box of the voxels, half a voxel beyond the outer centres included.
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

    /// Value in f64 by the textbook sum over eight clamped corners.
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
            // Three roundings at up to 4096: below 0.001 HU. The classes allow 0.25.
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
            let found = field.gradient_in(&field.cell(p));
            for axis in 0..3 {
                // Central differences at the eight corners, with clamped indices, weighted.
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
