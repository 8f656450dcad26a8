//! Bricks of wall slopes: the gradients that the shading of walls needs, computed once for all pictures of a volume.
//!
//! A shaded pixel needs the volume's slope (a smoothed gradient) round its wall. Computed separately for each pixel,
//! the slope needs fourteen samples, most of which the neighbouring pixels also need. Here the slope is computed at
//! voxels, in bricks of 4 x 4 x 4 cells that are filled when a ray first meets a wall in them, and interpolated between
//! voxels (docs/decisions/0132). The picture does not depend on which bricks exist.

use std::cell::RefCell;

use super::store::{CELLS, Fill, Numbers, PER_BRICK, PER_VOXEL, STRIDE, Store, VOXELS};
use crate::{Field, shared_constants::shared_constants};

shared_constants! {
    /// Distance from a voxel to the six samples on the axes round it, as a multiple of the reach (`Normals::reach`).
    ///
    /// A slope uses these six samples and eight samples at the corners of a box. The numbers were chosen by trial: on a
    /// plane edge blurred by 0.7 voxels the mean error of the normal is 0.2 degrees.
    pub(crate) const AXIS_AT: f32 = 1.2;
    /// Weight in a slope of the difference between the two samples on the axis of the slope.
    pub(crate) const AXIS_WEIGHT: f32 = 0.96;
    /// Distance along each axis from a voxel to the eight corner samples round it, as a multiple of the reach.
    pub(crate) const CORNER_AT: f32 = 0.7;
    /// Weight in a slope of the difference between the samples at the corners before and behind the voxel.
    pub(crate) const CORNER_WEIGHT: f32 = 0.7;
}

/// Cached bricks of the slopes of one volume, for one set of parameters of the normals.
#[derive(Debug)]
pub struct NormalBricks {
    store: Store,
    reach: [f32; 3],
    held: [f32; 2],
    taps: [Taps; 3],
    /// Factor from slopes (differences of voxel values) to the stored int16 numbers.
    scale: f32,
}

/// Positions, relative to a voxel, of the two samples whose difference is the slope along one axis.
///
/// `near` is that of the corners of the box, `far` that of the samples on the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Taps {
    near: Tap,
    far: Tap,
}

/// Distance of a sample from a voxel, divided into whole voxels and the remaining fraction.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tap {
    whole: usize,
    rest: f32,
}

impl Tap {
    fn of(distance: f32) -> Self {
        Self {
            whole: distance as usize,
            rest: distance - (distance as usize) as f32,
        }
    }

    /// Return the interpolated values at this distance after and before index `at` of a line whose items are `stride`
    /// apart.
    #[inline(always)]
    fn both(self, line: &[f32], at: usize, stride: usize) -> (f32, f32) {
        let (one, two) = (self.whole * stride, (self.whole + 1) * stride);
        let between = |a: f32, b: f32| a + self.rest * (b - a);
        (
            between(line[at + one], line[at + two]),
            between(line[at - one], line[at - two]),
        )
    }
}

impl Taps {
    /// Return the number of voxels beyond each side of a brick whose values the slopes in the brick need.
    fn halo(&self) -> usize {
        self.far.whole + 1
    }
}

impl NormalBricks {
    /// Create an empty cache of slopes for a volume of a given shape.
    ///
    /// `reach` is the distance of the samples in voxels, `held` the range to which values are clamped, and `most` the
    /// capacity in bricks.
    pub(crate) fn new(shape: [usize; 3], reach: [f32; 3], held: [f32; 2], most: usize) -> Self {
        let [low, high] = held;
        // The steepest possible slope is the sum of the largest axis part and the largest corner part.
        let steepest = (AXIS_WEIGHT + 4.0 * CORNER_WEIGHT) * (high - low);
        Self {
            store: Store::new(shape, most),
            reach,
            held,
            taps: reach.map(|reach| Taps {
                near: Tap::of(CORNER_AT * reach),
                far: Tap::of(AXIS_AT * reach),
            }),
            scale: 32_767.0 / steepest,
        }
    }

    /// Return whether the slopes were computed for a volume of this shape and for these parameters of the normals.
    pub(crate) fn are(&self, shape: [usize; 3], reach: [f32; 3], held: [f32; 2]) -> bool {
        self.store.shape == shape && self.reach == reach && self.held == held
    }

    /// Return the number of bricks that are in the cache.
    #[must_use]
    pub fn len(&self) -> usize {
        self.store.len()
    }

    /// Return whether no brick is stored.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Return whether the cache is full; pictures are still correct then, but slow.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.store.is_full()
    }

    /// Return the factor from slopes to the stored int16 numbers.
    pub(crate) fn scale(&self) -> f32 {
        self.scale
    }

    /// Return the factor from the stored int16 numbers to slopes.
    pub(crate) fn unit(&self) -> f32 {
        1.0 / self.scale
    }

    /// Compute or read the brick that contains a cell; return its numbers and the index of the cell's lower corner in
    /// them.
    ///
    /// `cell` must be within the volume's cells.
    pub(crate) fn brick_of(&self, field: &Field<'_>, cell: [usize; 3]) -> (Numbers, usize) {
        let within = (0..3).map(|a| cell[a] % CELLS * STRIDE[a]).sum();
        (self.filled(field, cell.map(|c| c / CELLS)), within)
    }

    /// Compute the slopes at the voxels of a brick.
    ///
    /// A slope combines differences on each axis and differences between the corners of a box, of values clamped to the
    /// range round the wall's value. The corner part is computed as three successive sums along the axes.
    fn filled(&self, field: &Field<'_>, brick: [usize; 3]) -> Numbers {
        thread_local! {
            /// Buffers for the computation of one brick, which each thread reuses.
            static WORK: RefCell<Work> = RefCell::default();
        }
        WORK.with_borrow_mut(|work| {
            work.read(self, field, brick);
            work.sum_along_k(&self.taps);
            work.sum_along_j(&self.taps);
            work.slopes(&self.taps, self.scale)
        })
    }
}

impl Fill for NormalBricks {
    fn store(&self) -> &Store {
        &self.store
    }

    fn fill(&self, field: &Field<'_>, number: usize) -> bool {
        let brick = self.store.brick(number);
        let filled = || Some(self.filled(field, brick));
        self.store.fill(number, filled).is_some()
    }
}

/// Buffers for the intermediate results of a brick.
#[derive(Default)]
struct Work {
    halo: [usize; 3],
    /// Values of the voxels that the brick's slopes need, `[k, j, i]`, and the number of these voxels along each axis.
    read: Vec<f32>,
    n: [usize; 3],
    /// Sums and differences along k at the brick's voxels, `[voxel of the brick, j, i]`.
    sum_k: Vec<f32>,
    rise_k: Vec<f32>,
    /// Results along k and then j, `[voxel, voxel, i]`: sum along both axes; rise along j; rise along k.
    sums: Vec<f32>,
    rise_j: Vec<f32>,
    rise_k_sum_j: Vec<f32>,
}

impl Work {
    fn read(&mut self, bricks: &NormalBricks, field: &Field<'_>, brick: [usize; 3]) {
        self.halo = bricks.taps.map(|taps| taps.halo());
        self.n = self.halo.map(|halo| VOXELS + 2 * halo);
        let [low, high] = bricks.held;
        let last = bricks.store.shape.map(|n| n as isize - 1);
        let at = |a: usize, n: usize| {
            let voxel = (brick[a] * CELLS + n) as isize - self.halo[a] as isize;
            voxel.clamp(0, last[a]) as usize * field.stride[a]
        };
        self.read.clear();
        for k in 0..self.n[2] {
            for j in 0..self.n[1] {
                let row = at(2, k) + at(1, j);
                for i in 0..self.n[0] {
                    let value = f32::from(field.data[row + at(0, i)]);
                    self.read.push(value.max(low).min(high));
                }
            }
        }
    }

    fn sum_along_k(&mut self, taps: &[Taps; 3]) {
        let plane = self.n[0] * self.n[1];
        self.sum_k.clear();
        self.rise_k.clear();
        for k in 0..VOXELS {
            let first = (k + self.halo[2]) * plane;
            for n in first..first + plane {
                let (after, before) = taps[2].near.both(&self.read, n, plane);
                self.sum_k.push(after + before);
                self.rise_k.push(after - before);
            }
        }
    }

    fn sum_along_j(&mut self, taps: &[Taps; 3]) {
        let [row, rows, _] = self.n;
        for out in [&mut self.sums, &mut self.rise_j, &mut self.rise_k_sum_j] {
            out.clear();
        }
        for k in 0..VOXELS {
            for j in 0..VOXELS {
                let first = (k * rows + j + self.halo[1]) * row;
                for n in first..first + row {
                    let (after, before) = taps[1].near.both(&self.sum_k, n, row);
                    self.sums.push(after + before);
                    self.rise_j.push(after - before);
                    let (after, before) = taps[1].near.both(&self.rise_k, n, row);
                    self.rise_k_sum_j.push(after + before);
                }
            }
        }
    }

    fn slopes(&self, taps: &[Taps; 3], scale: f32) -> Numbers {
        let [row, rows, _] = self.n;
        let stride = [1, row, row * rows];
        let mut out = Box::new([0; PER_BRICK]);
        for k in 0..VOXELS {
            for j in 0..VOXELS {
                for i in 0..VOXELS {
                    let line = (k * VOXELS + j) * row + i + self.halo[0];
                    let near = taps[0].near;
                    let (after, before) = near.both(&self.sums, line, 1);
                    let along_i = after - before;
                    let (after, before) = near.both(&self.rise_j, line, 1);
                    let along_j = after + before;
                    let (after, before) = near.both(&self.rise_k_sum_j, line, 1);
                    let along_k = after + before;
                    let voxel = (k + self.halo[2]) * stride[2]
                        + (j + self.halo[1]) * stride[1]
                        + i
                        + self.halo[0];
                    let to = ((k * VOXELS + j) * VOXELS + i) * PER_VOXEL;
                    for (a, corners) in [along_i, along_j, along_k].into_iter().enumerate() {
                        let (after, before) = taps[a].far.both(&self.read, voxel, stride[a]);
                        let slope = AXIS_WEIGHT * (after - before) + CORNER_WEIGHT * corners;
                        out[to + a] = (slope * scale).round() as i16;
                    }
                }
            }
        }
        out
    }
}
