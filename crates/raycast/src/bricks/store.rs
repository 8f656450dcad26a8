//! Memory of a volume's bricks, which threads fill and read concurrently.

use std::{
    cell::UnsafeCell,
    sync::atomic::{AtomicI32, AtomicUsize, Ordering},
};

use crate::{Field, shared_constants::shared_constants};

shared_constants! {
    /// Number of cells of a brick along each axis; a cell is the cube between eight voxel centres.
    pub(crate) const CELLS: usize = 4;
    /// Number of voxels of a brick along each axis, the first and the last voxel of its cells included.
    pub(super) const VOXELS: usize = CELLS + 1;
    /// Number of stored numbers per voxel: four, so that a voxel is one 64-bit load.
    pub(crate) const PER_VOXEL: usize = 4;
    /// Number of int16 numbers that a brick stores: those of its voxels, and zeros up to a power of two.
    pub(crate) const PER_BRICK: usize = 512;
    /// Maximum number of stored bricks: 64 MB, enough for some fifty views of an airway.
    pub(crate) const MAX_BRICKS: usize = 1 << 16;
}

/// Distance in memory between neighbouring voxels of a brick along each axis, in int16 numbers.
pub(crate) const STRIDE: [usize; 3] = [PER_VOXEL, PER_VOXEL * VOXELS, PER_VOXEL * VOXELS * VOXELS];

/// The int16 values that one brick stores.
pub(crate) type Numbers = Box<[i16; PER_BRICK]>;

/// Table entry of a brick that is not stored; the entry of a stored brick is one more than its index.
const ABSENT: i32 = 0;
/// Table entry of a brick that a thread is filling.
const BUSY: i32 = -1;
/// Table entry of a brick that cannot be stored.
const UNFIT: i32 = -2;

/// Interface of a cache of bricks (cubes of voxels that are stored together), which computes a brick at its first use.
pub(crate) trait Fill {
    fn store(&self) -> &Store;
    /// Compute and store a brick if it is not yet stored; return false if it cannot be stored.
    ///
    /// `number` is the brick's number among the bricks of the volume.
    fn fill(&self, field: &Field<'_>, number: usize) -> bool;
}

/// Memory of the bricks of one volume.
#[derive(Debug)]
pub(crate) struct Store {
    pub(super) shape: [usize; 3],
    num_bricks: [usize; 3],
    /// Entry of each brick of the volume: [`ABSENT`], [`BUSY`], [`UNFIT`], or one more than the index of a stored
    /// brick.
    table: Box<[AtomicI32]>,
    /// Int16 numbers of the stored bricks.
    ///
    /// Each brick is written once, by the thread that has claimed it, before the table refers to it.
    numbers: UnsafeCell<Vec<i16>>,
    most: usize,
    len: AtomicUsize,
}

// SAFETY: a brick is written only by the thread that has claimed it, and other threads read it only after the table
// refers to it (release store, then acquire load); the vector itself never grows.
unsafe impl Sync for Store {}

impl Store {
    /// Create an empty store with capacity for `most` bricks.
    pub(super) fn new(shape: [usize; 3], most: usize) -> Self {
        let num_bricks = shape.map(|n| n.saturating_sub(1).div_ceil(CELLS).max(1));
        let num = num_bricks.iter().product();
        let most = most.min(num);
        Self {
            shape,
            num_bricks,
            table: absent(num),
            // Lanes without a brick read the first brick, so its memory must exist.
            numbers: UnsafeCell::new(vec![0; most.max(1) * PER_BRICK]),
            most,
            len: AtomicUsize::new(0),
        }
    }

    pub(super) fn len(&self) -> usize {
        self.len.load(Ordering::Relaxed).min(self.most)
    }

    /// Return whether the store is full.
    pub(super) fn is_full(&self) -> bool {
        self.len() == self.most && self.most < self.table.len()
    }

    /// Return a pointer to the numbers of all stored bricks.
    pub(crate) fn numbers(&self) -> *const i16 {
        // SAFETY: the vector itself never changes, only its elements, and no reference to the elements is created here.
        unsafe { (*self.numbers.get()).as_ptr() }
    }

    /// Return the table: for each brick of the volume one more than its index, or 0 or less for a brick that is not
    /// stored.
    pub(crate) fn table(&self) -> &[AtomicI32] {
        &self.table
    }

    /// Return the number of bricks of the volume along each axis.
    pub(crate) fn num_bricks(&self) -> [usize; 3] {
        self.num_bricks
    }

    /// Compute and store a brick if it is not yet stored; return its index in [`Self::numbers`], or `None` if it cannot
    /// be stored.
    ///
    /// `fill` returns `None` if the numbers cannot be stored; the table then records this.
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
        // SAFETY: claimed < most, so the brick's memory is inside the vector; `fetch_add` gives each thread another
        // index, so no other thread writes there, and none reads it before the table refers to it (see `Store`).
        unsafe {
            let to = (*self.numbers.get()).as_mut_ptr().add(claimed * PER_BRICK);
            to.copy_from_nonoverlapping(numbers.as_ptr(), PER_BRICK);
        }
        entry.store(claimed as i32 + 1, Ordering::Release);
        Some(claimed * PER_BRICK)
    }

    /// Return the coordinates of a brick from its number in the volume.
    pub(super) fn brick(&self, number: usize) -> [usize; 3] {
        let [ni, nj, _] = self.num_bricks;
        [number % ni, number / ni % nj, number / (ni * nj)]
    }
}

/// Return a table in which no brick is stored.
///
/// The table is zeroed memory, whose pages the operating system provides only when a ray needs them.
fn absent(num: usize) -> Box<[AtomicI32]> {
    let zeros = vec![ABSENT; num].into_boxed_slice();
    // SAFETY: an AtomicI32 has the size, the alignment and the bit representation of an i32. Benchmark: initialising
    // one by one would write 10 MB for a chest, of which a view needs a hundredth.
    unsafe { Box::from_raw(Box::into_raw(zeros) as *mut [AtomicI32]) }
}
