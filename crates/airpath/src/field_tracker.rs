//! The resumable tree of least-cost paths over a whole volume, with no graph in memory (paper 6, Algorithm 1).
//!
//! Kept per voxel: one byte, the step that leads to it from its predecessor, and one bit, whether a path may still come to
//! it. Where a step costs what the voxel costs that it leads into, that is all: the first touch is the least. Where it
//! costs by both ends, the 4 bytes of the least cost so far are kept, too. The queue is [`crate::buckets`]. Nothing is written where no path has come: a target
//! near the root costs what lies between.
#![allow(
    clippy::inline_always,
    reason = "small functions of the inner loop: called for each of 26 neighbours of each voxel"
)]

use crate::buckets::{Block, Buckets};
use crate::field::{HERE, Quanta, StepCost, VoxelField, offset};
use crate::{TrackError, Watch};

/// Nodes settled between two looks at the watch, about.
const NODES_PER_LOOK: usize = 1 << 16;

/// Entries of the queue between asking for the memory round one and settling it.
const AHEAD: usize = 6;

/// Greatest cost in quanta that is kept beside a voxel: 31 bits.
const MOST_QUANTA: i32 = i32::MAX;

/// A least-cost tree in a [`VoxelField`] that grows as far as it is asked to.
#[derive(Debug)]
pub struct FieldTracker<C: StepCost> {
    quanta: Quanta<C>,
    layout: Layout,
    root: u32,
    /// Cell of the step that led here, plus 1; 0 where no path has come.
    step_here: Vec<u8>,
    /// One bit for each voxel and for a rim round the box, 1 where a path may still come: for the first time where the cost is
    /// by voxel, a cheaper one where it is by both ends.
    open: Vec<u8>,
    /// By both ends: what is left of `MOST_QUANTA` after the least cost so far; 0 where no path has come, so that fresh
    /// memory will do.
    left: Vec<i32>,
    queue: Buckets,
    /// Scratch of [`touch`].
    touched: Vec<Touch>,
    num_settled: usize,
    /// Nothing is open any more.
    done: bool,
}

/// Places of the neighbours in the arrays.
#[derive(Debug, Clone)]
pub(crate) struct Layout {
    pub(crate) shape: [usize; 3],
    by_row: Divisor,
    by_slice: Divisor,
    /// Place of the box's first voxel in the volume's arrays, their rows and slices.
    first: usize,
    volume_row: usize,
    volume_slice: usize,
    num_values: usize,
    /// For each cell: nodes from here.
    pub(crate) node_step: [isize; 27],
    /// For each cell: values from here.
    pub(crate) value_step: [isize; 27],
    /// Bits of a row of the box with its rim, and rows of a slice with its rim.
    bits_of_row: usize,
    rows_of_slice: usize,
}

/// Division of 32-bit numbers by one that is known: a multiplication (Lemire, Kaser, Kurz 2019).
#[derive(Debug, Clone, Copy)]
struct Divisor(u64);

impl Divisor {
    const fn new(by: usize) -> Self {
        // For 1 the reciprocal wraps to 0, which marks it.
        Self((u64::MAX / by as u64).wrapping_add(1))
    }

    #[inline(always)]
    const fn quotient(self, n: u32) -> usize {
        if self.0 == 0 {
            return n as usize;
        }
        ((self.0 as u128 * n as u128) >> 64) as usize
    }
}

impl Layout {
    pub(crate) fn new(field: &VoxelField<'_>) -> Self {
        let shape = field.shape_ijk();
        let (first, volume_row, volume_slice) = field.layout();
        let by_cell = |row: usize, slice: usize| {
            std::array::from_fn(|cell| {
                let [i, j, k] = offset(cell);
                i + j * row as isize + k * slice as isize
            })
        };
        Self {
            shape,
            by_row: Divisor::new(shape[0]),
            by_slice: Divisor::new(shape[0] * shape[1]),
            first,
            volume_row,
            volume_slice,
            num_values: field.values().len(),
            node_step: by_cell(shape[0], shape[0] * shape[1]),
            value_step: by_cell(volume_row, volume_slice),
            bits_of_row: (shape[0] + 2).next_multiple_of(8),
            rows_of_slice: shape[1] + 2,
        }
    }

    #[inline(always)]
    pub(crate) const fn ijk(&self, node: u32) -> [usize; 3] {
        let k = self.by_slice.quotient(node);
        let rest = node as usize - k * self.shape[0] * self.shape[1];
        let j = self.by_row.quotient(rest as u32);
        [rest - j * self.shape[0], j, k]
    }

    #[inline(always)]
    pub(crate) const fn value_at(&self, [i, j, k]: [usize; 3]) -> usize {
        self.first + i + j * self.volume_row + k * self.volume_slice
    }

    /// Bit of a voxel's left neighbour.
    #[inline(always)]
    const fn bit_left_of(&self, [i, j, k]: [usize; 3]) -> usize {
        ((k + 1) * self.rows_of_slice + j + 1) * self.bits_of_row + i
    }

    const fn num_bit_bytes(&self) -> usize {
        // The last row is read 16 bits at a time.
        self.bits_of_row / 8 * self.rows_of_slice * (self.shape[2] + 2) + 2
    }
}

impl<C: StepCost> FieldTracker<C> {
    /// A tracker with one root and nothing settled.
    ///
    /// `root_ijk` is a voxel of the volume.
    pub fn new(field: &VoxelField<'_>, root_ijk: [usize; 3]) -> Result<Self, TrackError> {
        let root = open_root(field, root_ijk)?;
        let quanta = Quanta::<C>::choose(field)?;
        let layout = Layout::new(field);
        let num_nodes = field.num_nodes();
        let open = open_bits(field, &layout, quanta.num_open == num_nodes);
        let left = if C::BY_VOXEL {
            Vec::new()
        } else {
            fresh::<i32>(num_nodes)
        };
        // By voxel the order of the costs is needed; by both ends only that no step stays within the front bucket.
        let span_log2 = if C::BY_VOXEL {
            0
        } else {
            (quanta.cheapest as u32).max(1).ilog2()
        };
        let mut tracker = Self {
            quanta,
            layout,
            root,
            step_here: fresh::<u8>(num_nodes),
            open,
            left,
            queue: Buckets::new(quanta.dearest as u64, span_log2),
            touched: Vec::new(),
            num_settled: 0,
            done: false,
        };
        tracker.step_here[root as usize] = HERE as u8 + 1;
        if C::BY_VOXEL {
            let bit = tracker.layout.bit_left_of(tracker.layout.ijk(root)) + 1;
            tracker.open[bit / 8] &= !(1 << (bit % 8));
        } else {
            tracker.left[root as usize] = MOST_QUANTA;
        }
        tracker.queue.push(0, root);
        Ok(tracker)
    }

    /// Settles what is needed to know the least cost of a node; true if a path exists.
    ///
    /// `field` must be the one the tracker was made with.
    pub fn solve_to(
        &mut self,
        field: &VoxelField<'_>,
        target: u32,
        watch: &impl Watch,
    ) -> Result<bool, TrackError> {
        self.check(field, Some(target))?;
        self.go_on(field, Some(target), watch)?;
        Ok(self.is_known(target))
    }

    /// Settles every node that a path can reach.
    pub fn solve_all(
        &mut self,
        field: &VoxelField<'_>,
        watch: &impl Watch,
    ) -> Result<(), TrackError> {
        self.check(field, None)?;
        self.go_on(field, None, watch)
    }

    fn check(&self, field: &VoxelField<'_>, target: Option<u32>) -> Result<(), TrackError> {
        if field.shape_ijk() != self.layout.shape || field.values().len() != self.layout.num_values
        {
            return Err(TrackError::Argument {
                what: "field",
                expected: format!("{:?} voxels, as the tracker's", self.layout.shape),
                found: format!("{:?}", field.shape_ijk()),
            });
        }
        if let Some(target) = target.filter(|t| *t as usize >= self.step_here.len()) {
            return Err(TrackError::Argument {
                what: "target",
                expected: format!("a node below {}", self.step_here.len()),
                found: target.to_string(),
            });
        }
        Ok(())
    }

    /// True once the least cost of a node is known.
    fn is_known(&self, node: u32) -> bool {
        if self.step_here[node as usize] == 0 {
            return false;
        }
        if C::BY_VOXEL || self.done {
            return true;
        }
        // What is open still may become cheaper, but not below the front bucket.
        let cost = (MOST_QUANTA - self.left[node as usize]) as u64;
        self.queue.bucket_of(cost) <= self.queue.bucket_of(self.queue.front_cost())
    }

    fn go_on(
        &mut self,
        field: &VoxelField<'_>,
        target: Option<u32>,
        watch: &impl Watch,
    ) -> Result<(), TrackError> {
        let mut looked_at = self.num_settled;
        while !self.done && target.is_none_or(|t| !self.is_known(t)) {
            if !self.queue.advance() {
                self.done = true;
                break;
            }
            let cost = self.queue.front_cost();
            if !C::BY_VOXEL && cost + 2 * self.quanta.dearest as u64 > MOST_QUANTA as u64 {
                return Err(TrackError::CostOverflow {
                    most: MOST_QUANTA as f64 * self.quanta.unit,
                });
            }
            // A target that the front bucket holds is known now: by both ends all in it is final.
            if !C::BY_VOXEL && target.is_some_and(|t| self.is_known(t)) {
                break;
            }
            while let Some(block) = self.queue.take() {
                self.num_settled += if C::BY_VOXEL {
                    self.touch(field.values(), block, cost)
                } else {
                    self.relax(field.values(), block)
                };
                self.queue.give_back(block);
                if self.num_settled - looked_at >= NODES_PER_LOOK {
                    looked_at = self.num_settled;
                    watch.go_on(looked_at as f64 / self.quanta.num_open as f64)?;
                }
            }
        }
        Ok(())
    }

    /// The fixed root.
    #[must_use]
    pub const fn root(&self) -> u32 {
        self.root
    }

    /// The run's integer unit.
    #[must_use]
    pub const fn quanta(&self) -> &Quanta<C> {
        &self.quanta
    }

    /// Nodes whose edges were looked at.
    #[must_use]
    pub const fn num_settled(&self) -> usize {
        self.num_settled
    }

    /// Bytes held, the queue's apart.
    #[must_use]
    pub fn num_bytes(&self) -> (usize, usize) {
        let kept = self.step_here.capacity() + self.open.capacity() + 4 * self.left.capacity();
        let queue = self.queue.num_bytes() + size_of::<Touch>() * self.touched.capacity();
        (kept, queue)
    }

    /// The node before a settled one on its path, or `None` at the root and where nothing is known.
    #[must_use]
    pub fn predecessor(&self, node: u32) -> Option<u32> {
        let cell = usize::from(self.step_here[node as usize]).checked_sub(1)?;
        if cell == HERE || !self.is_known(node) {
            return None;
        }
        Some((node as isize - self.layout.node_step[cell]) as u32)
    }

    /// Nodes from the root to `target`, or `None` where its least cost is not known.
    #[must_use]
    pub fn path_to(&self, target: u32) -> Option<Vec<u32>> {
        if target as usize >= self.step_here.len() || !self.is_known(target) {
            return None;
        }
        // What is before a known node is known.
        let mut path = vec![target];
        let mut node = target;
        loop {
            let cell = usize::from(self.step_here[node as usize]) - 1;
            if cell == HERE {
                path.reverse();
                return Some(path);
            }
            node = (node as isize - self.layout.node_step[cell]) as u32;
            path.push(node);
        }
    }

    /// Least cost of a node in quanta, summed along its path; `None` where it is not known.
    #[must_use]
    pub fn cost_quanta(&self, field: &VoxelField<'_>, target: u32) -> Option<u64> {
        let path = self.path_to(target)?;
        Some(
            path.windows(2)
                .map(|step| {
                    let cell = usize::from(self.step_here[step[1] as usize]) - 1;
                    let (from, into) = (field.value(step[0]), field.value(step[1]));
                    u64::from(self.quanta.of_step(from, into, cell))
                })
                .sum(),
        )
    }

    /// Least cost of a node; `None` where it is not known. Right within 0.5 %; exact where the unit is 1.
    #[must_use]
    pub fn cost(&self, field: &VoxelField<'_>, target: u32) -> Option<f64> {
        self.cost_quanta(field, target)
            .map(|quanta| quanta as f64 * self.quanta.unit)
    }
}

/// The node of a root, which must be open.
pub(crate) fn open_root(field: &VoxelField<'_>, root_ijk: [usize; 3]) -> Result<u32, TrackError> {
    let root = field
        .node_at_voxel(root_ijk)
        .ok_or_else(|| TrackError::Argument {
            what: "root",
            expected: "a voxel of the region".to_owned(),
            found: format!("{root_ijk:?}"),
        })?;
    if !field.is_open(root) {
        return Err(TrackError::NoResult(format!(
            "the root, voxel {root_ijk:?}, is not open: its weight is not finite or the mask leaves it out; \
             choose a voxel inside"
        )));
    }
    Ok(root)
}

/// The bit of each voxel that may be walked on; `all` if every voxel may.
fn open_bits(field: &VoxelField<'_>, layout: &Layout, all: bool) -> Vec<u8> {
    let mut bits = vec![0u8; layout.num_bit_bytes()];
    let [nx, ny, _] = layout.shape;
    for (number, (row, mask)) in field.rows().enumerate() {
        let first = layout.bit_left_of([0, number % ny, number / ny]) / 8;
        let bytes = &mut bits[first..first + layout.bits_of_row / 8];
        // Bit 0 is the rim; the row begins at bit 1.
        if all || (mask.is_none() && is_all_open(row)) {
            bytes[..=nx / 8].fill(u8::MAX);
            bytes[0] &= !1;
            // Bits 0 to nx of the row are set by now, and those behind them in the last byte.
            bytes[nx / 8] &= ((2u16 << (nx % 8)) - 1) as u8;
            continue;
        }
        for (at, byte) in bytes.iter_mut().enumerate() {
            let low = (8 * at).max(1) - 1;
            let high = (8 * at + 7).min(nx);
            let mut open = 0u8;
            for i in low..high {
                let inside = row[i] < f32::INFINITY && mask.is_none_or(|mask| mask[i] != 0);
                open |= u8::from(inside) << ((i + 1) % 8);
            }
            *byte = open;
        }
    }
    bits
}

fn is_all_open(row: &[f32]) -> bool {
    let (chunks, rest) = row.as_chunks::<16>();
    let mut open = [u32::MAX; 16];
    for chunk in chunks {
        for lane in 0..16 {
            open[lane] &= if chunk[lane] < f32::INFINITY {
                u32::MAX
            } else {
                0
            };
        }
    }
    open.iter().all(|lane| *lane != 0) && rest.iter().all(|weight| *weight < f32::INFINITY)
}

/// Zeros that the system gives page by page where they are first written, in large pages where it has them.
fn fresh<T: Copy + Default>(len: usize) -> Vec<T> {
    let zeros = vec![T::default(); len];
    #[cfg(target_os = "linux")]
    if size_of_val(zeros.as_slice()) >= 1 << 22 {
        const PAGE: usize = 1 << 12;
        let first = zeros.as_ptr() as usize;
        let inside = first.next_multiple_of(PAGE);
        let len = (size_of_val(zeros.as_slice()) - (inside - first)) / PAGE * PAGE;
        // SAFETY: whole pages inside the vector's own memory; the advice changes how they are backed, never what they hold.
        // A system that refuses is as well off as before. (`cargo bench --bench field`: a neighbourhood lies on 9 small pages.)
        unsafe { libc::madvise(inside as *mut libc::c_void, len, libc::MADV_HUGEPAGE) };
    }
    zeros
}

/// Asks for a place in memory that will be read soon: the wave front is spread over the volume, and without it most of the
/// time goes into waiting (`cargo bench --bench field`).
#[inline(always)]
fn prefetch<T>(slice: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: every x86_64 has SSE, and a prefetch changes nothing and faults at no address, inside the slice or not.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(slice.as_ptr().wrapping_add(at).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (slice, at);
}

/// A voxel that was touched first from its neighbour.
#[derive(Debug, Clone, Copy)]
struct Touch {
    node: u32,
    value_at: u32,
    cell: u8,
}

impl Layout {
    /// Which of the 27 cells round a voxel are open: bit by cell. `byte` holds the bit of the first neighbour.
    #[inline(always)]
    fn around(&self, open: &[u8], byte: usize, shift: usize) -> u32 {
        let (row_bytes, slice_bytes) = self.row_and_slice_bytes();
        let mut around = 0u32;
        for row in 0..9 {
            let from = byte + row / 3 * slice_bytes + row % 3 * row_bytes;
            let pair = u16::from_le_bytes([open[from], open[from + 1]]);
            around |= (u32::from(pair) >> shift & 7) << (3 * row);
        }
        around
    }

    #[inline(always)]
    const fn row_and_slice_bytes(&self) -> (usize, usize) {
        let row_bytes = self.bits_of_row / 8;
        (row_bytes, row_bytes * self.rows_of_slice)
    }

    /// Byte and bit of the first of the 27 cells round a voxel.
    #[inline(always)]
    const fn first_bit_around(&self, ijk: [usize; 3]) -> (usize, usize) {
        let (row_bytes, slice_bytes) = self.row_and_slice_bytes();
        let bit = self.bit_left_of(ijk);
        (bit / 8 - slice_bytes - row_bytes, bit % 8)
    }

    /// The voxel's own bit.
    #[inline(always)]
    const fn is_open(&self, open: &[u8], ijk: [usize; 3]) -> bool {
        let bit = self.bit_left_of(ijk) + 1;
        open[bit / 8] >> (bit % 8) & 1 != 0
    }

    /// Closes a cell, given the first bit round its centre.
    #[inline(always)]
    const fn close(&self, open: &mut [u8], byte: usize, shift: usize, cell: usize) {
        let (row_bytes, slice_bytes) = self.row_and_slice_bytes();
        let bit = shift + cell % 3;
        open[byte + cell / 9 * slice_bytes + cell / 3 % 3 * row_bytes + bit / 8] &=
            !(1 << (bit % 8));
    }

    /// A row of bits is short: three rows of a slice are in one or two lines of the cache.
    #[inline(always)]
    fn prefetch_bits(&self, open: &[u8], ijk: [usize; 3]) {
        let (row_bytes, slice_bytes) = self.row_and_slice_bytes();
        let byte = self.first_bit_around(ijk).0 + row_bytes;
        for slice in 0..3 {
            prefetch(open, byte + slice * slice_bytes);
        }
    }
}

impl<C: StepCost> FieldTracker<C> {
    /// Settles a block of nodes of one cost where a step costs by voxel: whoever is touched first is touched by the least.
    fn touch(&mut self, values: &[f32], block: Block, cost: u64) -> usize {
        let Self {
            quanta,
            layout,
            step_here,
            open,
            queue,
            touched,
            ..
        } = self;
        touched.clear();
        for at in 0..block.len {
            let ahead = queue.entry(block, (at + AHEAD).min(block.len - 1));
            layout.prefetch_bits(open, layout.ijk(ahead));
            let node = queue.entry(block, at);
            let ijk = layout.ijk(node);
            let (byte, shift) = layout.first_bit_around(ijk);
            let mut around = layout.around(open, byte, shift);
            let value_at = layout.value_at(ijk);
            while around != 0 {
                let cell = around.trailing_zeros() as usize;
                around &= around - 1;
                layout.close(open, byte, shift, cell);
                let node = (node as isize + layout.node_step[cell]) as u32;
                let value_at = (value_at as isize + layout.value_step[cell]) as u32;
                prefetch(values, value_at as usize);
                prefetch(step_here, node as usize);
                touched.push(Touch {
                    node,
                    value_at,
                    cell: cell as u8,
                });
            }
        }
        for touch in touched.iter() {
            step_here[touch.node as usize] = touch.cell + 1;
            // The factor is the same for every cell.
            let into = values[touch.value_at as usize];
            let step = quanta.of_lane(0.0, into, quanta.scale[0][0]);
            queue.push(cost + step as u64, touch.node);
        }
        block.len
    }

    /// Settles a block of the front bucket where a step costs by both ends; the number settled.
    fn relax(&mut self, values: &[f32], block: Block) -> usize {
        let Self {
            quanta,
            layout,
            step_here,
            open,
            left,
            queue,
            ..
        } = self;
        let mut num_settled = 0;
        for at in 0..block.len {
            // A node is queued once for each bucket that its cost sank to, five times and more where steps differ much in
            // length: all but the first, cheapest entry are stale, and nothing but a bit is read for them.
            let far = queue.entry(block, (at + 2 * AHEAD).min(block.len - 1));
            prefetch(open, layout.bit_left_of(layout.ijk(far)) / 8);
            let near = queue.entry(block, (at + AHEAD).min(block.len - 1));
            let near_ijk = layout.ijk(near);
            if layout.is_open(open, near_ijk) {
                layout.prefetch_bits(open, near_ijk);
                let value_at = layout.value_at(near_ijk);
                for row in 0..9 {
                    let step = layout.node_step[3 * row + 1];
                    prefetch(left, (near as usize).wrapping_add_signed(step));
                    let step = layout.value_step[3 * row + 1];
                    prefetch(values, value_at.wrapping_add_signed(step));
                }
            }

            let node = queue.entry(block, at);
            let ijk = layout.ijk(node);
            if !layout.is_open(open, ijk) {
                continue;
            }
            let (byte, shift) = layout.first_bit_around(ijk);
            layout.close(open, byte, shift, HERE);
            let around = layout.around(open, byte, shift);
            num_settled += 1;
            let here = left[node as usize];
            let value_at = layout.value_at(ijk);
            let from = values[value_at];
            for row in 0..9 {
                let lanes = around >> (3 * row) & 7;
                let middle = 3 * row + 1;
                let n = (node as usize)
                    .wrapping_add_signed(layout.node_step[middle])
                    .wrapping_sub(1);
                let v = value_at
                    .wrapping_add_signed(layout.value_step[middle])
                    .wrapping_sub(1);
                // Three are read as four; at the very ends of the arrays one by one.
                let old = left
                    .get(n..n.wrapping_add(4))
                    .and_then(|x| x.first_chunk::<4>());
                let into = values
                    .get(v..v.wrapping_add(4))
                    .and_then(|x| x.first_chunk::<4>());
                let mut candidates = [0i32; 4];
                if let (Some(old), Some(into)) = (old, into) {
                    let mut any = 0;
                    for lane in 0..4 {
                        candidates[lane] =
                            here - quanta.of_lane(from, into[lane], quanta.scale[row][lane]);
                    }
                    for lane in 0..3 {
                        // The sign: both are from 0 to 2^31 - 1.
                        any |= old[lane] - candidates[lane];
                    }
                    if any >= 0 {
                        continue;
                    }
                } else {
                    for lane in (0..3).filter(|lane| lanes >> lane & 1 != 0) {
                        let into = values[v.wrapping_add(lane)];
                        candidates[lane] =
                            here - quanta.of_lane(from, into, quanta.scale[row][lane]);
                    }
                }
                for lane in (0..3).filter(|lane| lanes >> lane & 1 != 0) {
                    let neighbour = n.wrapping_add(lane);
                    let (old, candidate) = (left[neighbour], candidates[lane]);
                    if candidate <= old {
                        continue;
                    }
                    left[neighbour] = candidate;
                    step_here[neighbour] = (3 * row + lane) as u8 + 1;
                    let cost = (MOST_QUANTA - candidate) as u64;
                    // Still in the bucket it is queued in already: found there.
                    if old == 0
                        || queue.bucket_of((MOST_QUANTA - old) as u64) != queue.bucket_of(cost)
                    {
                        queue.push(cost, neighbour as u32);
                    }
                }
            }
        }
        num_settled
    }
}
