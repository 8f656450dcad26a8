//! Memory for bricks, and who fills them.

use std::{
    cell::UnsafeCell,
    sync::atomic::{AtomicI32, AtomicUsize, Ordering},
};

use crate::Field;

/// Cells of a brick along each axis.
pub(crate) const CELLS: usize = 4;
/// Voxels of a brick along each axis: both ends of its cells.
pub(super) const VOXELS: usize = CELLS + 1;
/// Numbers in memory for each voxel: four, so that a voxel is one 64-bit load.
pub(crate) const PER_VOXEL: usize = 4;
/// Numbers in memory for each brick, of which the last few are 0.
pub(crate) const PER_BRICK: usize = 512;
/// Memory steps of a brick from voxel to voxel along each axis.
pub(crate) const STRIDE: [usize; 3] = [PER_VOXEL, PER_VOXEL * VOXELS, PER_VOXEL * VOXELS * VOXELS];
/// At most so many bricks are kept: 64 MB, some fifty views of an airway.
pub(crate) const MOST_BRICKS: usize = 1 << 16;

/// The numbers of a brick.
pub(crate) type Numbers = Box<[i16; PER_BRICK]>;

/// In the table: not there; being filled; cannot be stored. Others are one more than the brick's place.
const ABSENT: i32 = 0;
const BUSY: i32 = -1;
const UNFIT: i32 = -2;

/// What bricks hold.
pub(crate) trait Fill {
    fn store(&self) -> &Store;
    /// Fills a brick, by its place among those of the volume, if this is the first to ask; false if it cannot be kept.
    fn fill(&self, field: &Field<'_>, number: usize) -> bool;
}

/// Bricks of one volume.
#[derive(Debug)]
pub(crate) struct Store {
    pub(super) shape: [usize; 3],
    num_bricks: [usize; 3],
    /// For each brick of the volume where it is kept.
    table: Box<[AtomicI32]>,
    /// Memory for bricks; each is written once, by the thread that has claimed it, before the table tells of it.
    numbers: UnsafeCell<Vec<i16>>,
    most: usize,
    len: AtomicUsize,
}

// SAFETY: a brick is written by the one thread that has claimed it, and read by others only after the table tells of it
// (release, then acquire); the vector itself never grows.
unsafe impl Sync for Store {}

impl Store {
    /// No brick yet, and room for `most`.
    pub(super) fn new(shape: [usize; 3], most: usize) -> Self {
        let num_bricks = shape.map(|n| n.saturating_sub(1).div_ceil(CELLS).max(1));
        let num = num_bricks.iter().product();
        let most = most.min(num);
        Self {
            shape,
            num_bricks,
            table: absent(num),
            // Lanes that have no brick read the first.
            numbers: UnsafeCell::new(vec![0; most.max(1) * PER_BRICK]),
            most,
            len: AtomicUsize::new(0),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.len.load(Ordering::Relaxed).min(self.most)
    }

    /// Whether no further brick can be kept.
    pub(super) fn is_full(&self) -> bool {
        self.len() == self.most && self.most < self.table.len()
    }

    /// The numbers of all bricks.
    pub(crate) fn numbers(&self) -> *const i16 {
        // SAFETY: the vector never changes, only what it holds; no reference to that is made here.
        unsafe { (*self.numbers.get()).as_ptr() }
    }

    /// For each brick of the volume one more than its place, or a number that is not positive.
    pub(crate) fn table(&self) -> &[AtomicI32] {
        &self.table
    }

    /// Bricks of the volume along each axis.
    pub(crate) fn num_bricks(&self) -> [usize; 3] {
        self.num_bricks
    }

    /// Place of a brick in [`Self::numbers`], which is filled if this is the first to ask; `None` where it is not kept.
    ///
    /// `fill` gives nothing where the numbers cannot be stored, which is kept, too.
    #[cold]
    pub(super) fn fill(
        &self,
        number: usize,
        fill: impl FnOnce() -> Option<Numbers>,
    ) -> Option<usize> {
        let entry = &self.table[number];
        loop {
            match entry.load(Ordering::Acquire) {
                ABSENT if self.len.load(Ordering::Relaxed) >= self.most => return None,
                ABSENT => {
                    let (ok, no) = (Ordering::Acquire, Ordering::Relaxed);
                    if entry.compare_exchange(ABSENT, BUSY, ok, no).is_ok() {
                        break;
                    }
                }
                BUSY => std::thread::yield_now(),
                UNFIT => return None,
                kept => return Some((kept as usize - 1) * PER_BRICK),
            }
        }
        let Some(numbers) = fill() else {
            entry.store(UNFIT, Ordering::Release);
            return None;
        };
        let claimed = self.len.fetch_add(1, Ordering::Relaxed);
        if claimed >= self.most {
            self.len.store(self.most, Ordering::Relaxed);
            entry.store(ABSENT, Ordering::Release);
            return None;
        }
        // SAFETY: claimed < most, and no other thread has or will have this place; see `Store`.
        unsafe {
            let to = (*self.numbers.get()).as_mut_ptr().add(claimed * PER_BRICK);
            to.copy_from_nonoverlapping(numbers.as_ptr(), PER_BRICK);
        }
        entry.store(claimed as i32 + 1, Ordering::Release);
        Some(claimed * PER_BRICK)
    }

    /// A brick by its place among those of the volume.
    pub(super) fn brick(&self, number: usize) -> [usize; 3] {
        let [ni, nj, _] = self.num_bricks;
        [number % ni, number / ni % nj, number / (ni * nj)]
    }
}

/// A table without bricks: memory that is zero and touched only where a ray comes.
fn absent(num: usize) -> Box<[AtomicI32]> {
    let zeros = vec![ABSENT; num].into_boxed_slice();
    // SAFETY: an AtomicI32 has the size, the alignment and the bits of an i32. Benchmark: one by one they would be written,
    // 10 MB for a chest, of which a view touches a hundredth.
    unsafe { Box::from_raw(Box::into_raw(zeros) as *mut [AtomicI32]) }
}
