//! Slopes of walls, kept in bricks: what lighting reads of a volume, worked out once for all pictures of it.
//!
//! A lit pixel needs the volume's slope round its wall. Taken anew for each pixel that is fourteen samples, most of which
//! its neighbours take as well. Here it is worked out at voxels, in bricks of 4 x 4 x 4 cells that are filled when a ray
//! first meets a wall in them, and read between voxels (docs/decisions/0080). Which bricks exist never shows in a picture.

use std::{
    cell::{RefCell, UnsafeCell},
    sync::atomic::{AtomicU32, AtomicUsize, Ordering},
};

use crate::Field;

/// Six samples along the axes and eight at the corners of a box: their places in units of the reach, and the weight of
/// those along the axes. Chosen by trial: on a plane edge blurred by 0.7 voxels the normal is off by 0.2 degrees (0.6 at
/// most), where the corners alone miss by 4 and the axes alone by 2.4.
pub(crate) const AXIS_AT: f32 = 1.2;
pub(crate) const AXIS_WEIGHT: f32 = 0.96;
pub(crate) const CORNER_AT: f32 = 0.7;
pub(crate) const CORNER_WEIGHT: f32 = 0.7;

/// Cells of a brick along each axis.
pub(crate) const CELLS: usize = 4;
/// Voxels of a brick along each axis: both ends of its cells.
const VOXELS: usize = CELLS + 1;
/// Numbers in memory for each voxel: the slope along i, j and k, and one that is 0, so that a voxel is one 64-bit load.
pub(crate) const PER_VOXEL: usize = 4;
/// Numbers in memory for each brick, of which the last few are 0.
pub(crate) const PER_BRICK: usize = 512;
/// Memory steps of a brick from voxel to voxel along each axis.
pub(crate) const STRIDE: [usize; 3] = [PER_VOXEL, PER_VOXEL * VOXELS, PER_VOXEL * VOXELS * VOXELS];
/// At most so many bricks are kept: 64 MB, some fifty views of an airway.
pub(crate) const MOST_BRICKS: usize = 1 << 16;

/// In the table: not there, and being filled. Others are one more than the brick's number.
const ABSENT: u32 = 0;
const BUSY: u32 = u32::MAX;

/// Bricks of slopes of one volume, for one way of finding normals.
#[derive(Debug)]
pub struct NormalBricks {
    shape: [usize; 3],
    num_bricks: [usize; 3],
    reach: [f32; 3],
    held: [f32; 2],
    taps: [Taps; 3],
    /// Stored numbers are slopes times this.
    scale: f32,
    /// For each brick of the volume where it is kept.
    table: Box<[AtomicU32]>,
    kept: Kept,
}

/// Memory for bricks; each is written once, by the thread that has claimed it, before the table tells of it.
#[derive(Debug)]
struct Kept {
    numbers: UnsafeCell<Vec<i16>>,
    most: usize,
    len: AtomicUsize,
}

// SAFETY: a brick is written by the one thread that has claimed it, and read by others only after the table tells of it
// (release, then acquire); the vector itself never grows.
unsafe impl Sync for Kept {}

/// Samples before and after a voxel along one axis: `near` at the corners of the box, `far` on the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Taps {
    near: Tap,
    far: Tap,
}

/// A distance in whole voxels and the rest.
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

    /// Values at this distance after and before `at`, in a line whose neighbours are `stride` apart.
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
    /// Voxels that are needed beyond a brick's own.
    fn halo(&self) -> usize {
        self.far.whole + 1
    }
}

/// Where a lane finds its cell.
pub(crate) enum Place {
    /// Place in [`NormalBricks::numbers`].
    Kept(usize),
    /// No more bricks can be kept; these are the numbers.
    Lent(Box<[i16; PER_BRICK]>),
}

impl NormalBricks {
    /// No brick yet: for a volume of this shape, slopes over `reach` voxels of values held in a range, and room for `most`
    /// bricks.
    pub(crate) fn new(shape: [usize; 3], reach: [f32; 3], held: [f32; 2], most: usize) -> Self {
        let num_bricks = shape.map(|n| n.saturating_sub(1).div_ceil(CELLS).max(1));
        let num = num_bricks.iter().product();
        let most = most.min(num);
        let [low, high] = held;
        // What both parts of a slope are at most.
        let steepest = (AXIS_WEIGHT + 4.0 * CORNER_WEIGHT) * (high - low);
        Self {
            shape,
            num_bricks,
            reach,
            held,
            taps: reach.map(|reach| Taps {
                near: Tap::of(CORNER_AT * reach),
                far: Tap::of(AXIS_AT * reach),
            }),
            scale: 32_767.0 / steepest,
            table: absent(num),
            kept: Kept {
                // Lanes that have no brick read the first.
                numbers: UnsafeCell::new(vec![0; most.max(1) * PER_BRICK]),
                most,
                len: AtomicUsize::new(0),
            },
        }
    }

    /// Whether they are slopes of such a volume, found so.
    pub(crate) fn are(&self, shape: [usize; 3], reach: [f32; 3], held: [f32; 2]) -> bool {
        self.shape == shape && self.reach == reach && self.held == held
    }

    /// Bricks kept.
    #[must_use]
    pub fn len(&self) -> usize {
        self.kept.len.load(Ordering::Relaxed).min(self.kept.most)
    }

    /// Whether no brick is kept.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether no further brick can be kept: pictures stay right and become slow.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.len() == self.kept.most && self.kept.most < self.table.len()
    }

    /// Slopes are stored numbers times this.
    pub(crate) fn unit(&self) -> f32 {
        1.0 / self.scale
    }

    /// The numbers of all bricks.
    pub(crate) fn numbers(&self) -> *const i16 {
        // SAFETY: the vector never changes, only what it holds; no reference to that is made here.
        unsafe { (*self.kept.numbers.get()).as_ptr() }
    }

    /// Where the lower corner of a cell lies; its brick is filled if this is the first to ask.
    ///
    /// `cell` must be within the volume's cells.
    #[inline(always)]
    pub(crate) fn place(&self, field: &Field<'_>, cell: [usize; 3]) -> (Place, usize) {
        let brick = cell.map(|c| c / CELLS);
        let number = brick[0] + self.num_bricks[0] * (brick[1] + self.num_bricks[1] * brick[2]);
        let within: usize = (0..3).map(|a| cell[a] % CELLS * STRIDE[a]).sum();
        let kept = self.table[number].load(Ordering::Acquire);
        if kept != ABSENT && kept != BUSY {
            return (Place::Kept((kept as usize - 1) * PER_BRICK), within);
        }
        (self.fill(field, number, brick), within)
    }

    #[cold]
    fn fill(&self, field: &Field<'_>, number: usize, brick: [usize; 3]) -> Place {
        let entry = &self.table[number];
        let (ok, mine) = (Ordering::Acquire, Ordering::Acquire);
        match entry.compare_exchange(ABSENT, BUSY, ok, mine) {
            Ok(_) => {}
            Err(mut kept) => {
                while kept == BUSY {
                    std::thread::yield_now();
                    kept = entry.load(Ordering::Acquire);
                }
                if kept != ABSENT {
                    return Place::Kept((kept as usize - 1) * PER_BRICK);
                }
                return Place::Lent(self.filled(field, brick));
            }
        }
        let slot = self.kept.len.fetch_add(1, Ordering::Relaxed);
        if slot >= self.kept.most {
            self.kept.len.store(self.kept.most, Ordering::Relaxed);
            entry.store(ABSENT, Ordering::Release);
            return Place::Lent(self.filled(field, brick));
        }
        let numbers = self.filled(field, brick);
        // SAFETY: slot < most, and no other thread has or will have this slot; see `Kept`.
        unsafe {
            let to = (*self.kept.numbers.get())
                .as_mut_ptr()
                .add(slot * PER_BRICK);
            to.copy_from_nonoverlapping(numbers.as_ptr(), PER_BRICK);
        }
        entry.store(slot as u32 + 1, Ordering::Release);
        Place::Kept(slot * PER_BRICK)
    }

    /// The slopes at the voxels of a brick: differences across it, on each axis by itself and between the corners of a box,
    /// of values held near the wall's own. The corners' part is a product of three sums along the axes.
    fn filled(&self, field: &Field<'_>, brick: [usize; 3]) -> Box<[i16; PER_BRICK]> {
        thread_local! {
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

/// A table without bricks: memory that is zero and touched only where a ray comes.
fn absent(num: usize) -> Box<[AtomicU32]> {
    let zeros = vec![ABSENT; num].into_boxed_slice();
    // SAFETY: an AtomicU32 has the size, the alignment and the bits of a u32. Benchmark: one by one they would be written,
    // 10 MB for a chest, of which a view touches a hundredth.
    unsafe { Box::from_raw(Box::into_raw(zeros) as *mut [AtomicU32]) }
}

/// The parts of a brick on the way to its slopes.
#[derive(Default)]
struct Work {
    halo: [usize; 3],
    /// Voxels read, `[k, j, i]`, and how many along each axis.
    read: Vec<f32>,
    n: [usize; 3],
    /// Sums and differences along k, `[voxel of the brick, j, i]`.
    sum_k: Vec<f32>,
    rise_k: Vec<f32>,
    /// Along k and j, `[voxel, voxel, i]`: both sums; rise along j; rise along k.
    sums: Vec<f32>,
    rise_j: Vec<f32>,
    rise_k_sum_j: Vec<f32>,
}

impl Work {
    fn read(&mut self, bricks: &NormalBricks, field: &Field<'_>, brick: [usize; 3]) {
        self.halo = bricks.taps.map(|taps| taps.halo());
        self.n = self.halo.map(|halo| VOXELS + 2 * halo);
        let [low, high] = bricks.held;
        let last = bricks.shape.map(|n| n as isize - 1);
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

    fn slopes(&self, taps: &[Taps; 3], scale: f32) -> Box<[i16; PER_BRICK]> {
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
