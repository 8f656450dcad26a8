//! Memory layout of the arrays of [`crate::field_tracker`]: offsets of a voxel's neighbours, and bit arrays with a rim.
#![allow(
    clippy::inline_always,
    reason = "small functions of the inner loop: called for each of 26 neighbours of each voxel"
)]

use crate::field::{VoxelField, offset};

/// Positions of voxels in the arrays of the tracker and of the volume, and offsets to the neighbours of a voxel.
#[derive(Debug, Clone)]
pub(crate) struct Layout {
    pub(crate) shape: [usize; 3],
    by_row: Divisor,
    by_slice: Divisor,
    /// Index in the volume's arrays of the first voxel of the search box.
    first: usize,
    /// Difference between the indices of successive rows in the volume's arrays.
    volume_row: usize,
    /// Difference between the indices of successive slices in the volume's arrays.
    volume_slice: usize,
    pub(crate) num_values: usize,
    /// Difference between the node number of each of the 27 cells and that of the voxel.
    pub(crate) node_step: [isize; 27],
    /// Difference between the index of each of the 27 cells and that of the voxel, in the volume's arrays.
    pub(crate) value_step: [isize; 27],
    /// Number of bits for a row of the search box with one more voxel at each end.
    bits_of_row: usize,
    /// Number of rows for a slice of the search box with one more row at each end.
    rows_of_slice: usize,
}

/// Divisor of 32-bit numbers, applied as a multiplication by its reciprocal (Lemire, Kaser, Kurz 2019).
#[derive(Debug, Clone, Copy)]
struct Divisor(u64);

impl Divisor {
    const fn new(by: usize) -> Self {
        // For a divisor of 1 the reciprocal wraps to 0, which marks this case.
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

    /// Return the index of the bit of a voxel's left neighbour in the bit array.
    #[inline(always)]
    pub(crate) const fn bit_left_of(&self, [i, j, k]: [usize; 3]) -> usize {
        ((k + 1) * self.rows_of_slice + j + 1) * self.bits_of_row + i
    }

    pub(crate) const fn num_bit_bytes(&self) -> usize {
        // Two bytes of padding, because the last row is read 16 bits at a time.
        self.bits_of_row / 8 * self.rows_of_slice * (self.shape[2] + 2) + 2
    }
}
impl Layout {
    /// Return one bit for each of the 27 cells round a voxel, set if the cell is open.
    ///
    /// `byte` and `shift` are the position of the first cell's bit ([`Layout::first_bit_around`]).
    #[inline(always)]
    pub(crate) fn around(&self, open: &[u8], byte: usize, shift: usize) -> u32 {
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
    pub(crate) const fn row_and_slice_bytes(&self) -> (usize, usize) {
        let row_bytes = self.bits_of_row / 8;
        (row_bytes, row_bytes * self.rows_of_slice)
    }

    /// Return the byte and the bit of the first of the 27 cells round a voxel.
    #[inline(always)]
    pub(crate) const fn first_bit_around(&self, ijk: [usize; 3]) -> (usize, usize) {
        let (row_bytes, slice_bytes) = self.row_and_slice_bytes();
        let bit = self.bit_left_of(ijk);
        (bit / 8 - slice_bytes - row_bytes, bit % 8)
    }

    /// Return whether the bit of a voxel is set, so that a path may still change the voxel.
    #[inline(always)]
    pub(crate) const fn is_open(&self, open: &[u8], ijk: [usize; 3]) -> bool {
        let bit = self.bit_left_of(ijk) + 1;
        open[bit / 8] >> (bit % 8) & 1 != 0
    }

    /// Clear the bit of a cell, given the position of the first of the 27 bits round the voxel.
    #[inline(always)]
    pub(crate) const fn close(&self, open: &mut [u8], byte: usize, shift: usize, cell: usize) {
        let (row_bytes, slice_bytes) = self.row_and_slice_bytes();
        let bit = shift + cell % 3;
        open[byte + cell / 9 * slice_bytes + cell / 3 % 3 * row_bytes + bit / 8] &=
            !(1 << (bit % 8));
    }

    /// Prefetch the bits of the 27 cells round a voxel.
    ///
    /// Rows of bits are short, so three rows of a slice are in one or two cache lines.
    #[inline(always)]
    pub(crate) fn prefetch_bits(&self, open: &[u8], ijk: [usize; 3]) {
        let (row_bytes, slice_bytes) = self.row_and_slice_bytes();
        let byte = self.first_bit_around(ijk).0 + row_bytes;
        for slice in 0..3 {
            prefetch(open, byte + slice * slice_bytes);
        }
    }
}
/// Return the bit array of the open voxels; `all` means that every voxel of the box is open.
pub(crate) fn open_bits(field: &VoxelField<'_>, layout: &Layout, all: bool) -> Vec<u8> {
    let mut bits = vec![0u8; layout.num_bit_bytes()];
    let [nx, ny, _] = layout.shape;
    for (number, (row, mask)) in field.rows().enumerate() {
        let first = layout.bit_left_of([0, number % ny, number / ny]) / 8;
        let bytes = &mut bits[first..first + layout.bits_of_row / 8];
        // Bit 0 is the rim; the voxels of the row begin at bit 1.
        if all || (mask.is_none() && is_all_open(row)) {
            bytes[..=nx / 8].fill(u8::MAX);
            bytes[0] &= !1;
            // Only bits 0 to nx of the row belong to it; the remaining bits of the last byte are cleared.
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

/// Allocate zeroed memory whose pages the operating system provides at the first write, as large pages if possible.
pub(crate) fn fresh<T: Copy + Default>(len: usize) -> Vec<T> {
    let zeros = vec![T::default(); len];
    #[cfg(target_os = "linux")]
    if size_of_val(zeros.as_slice()) >= 1 << 22 {
        /// Size of a memory page in bytes.
        const PAGE: usize = 1 << 12;
        let first = zeros.as_ptr() as usize;
        let inside = first.next_multiple_of(PAGE);
        let len = (size_of_val(zeros.as_slice()) - (inside - first)) / PAGE * PAGE;
        // SAFETY: the range consists of whole pages inside the vector's own memory; the advice changes only the page
        // size, never the contents. If the system rejects the advice, nothing changes. Large pages are faster, because
        // the 27 voxels of a neighbourhood are in 9 small pages (`cargo bench --bench field`).
        unsafe { libc::madvise(inside as *mut libc::c_void, len, libc::MADV_HUGEPAGE) };
    }
    zeros
}

/// Prefetch an element of a slice into the cache; the index may be outside the slice.
///
/// The front of the search is spread over the volume, and without prefetches most of the time is spent waiting for
/// memory (`cargo bench --bench field`).
#[inline(always)]
pub(crate) fn prefetch<T>(slice: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: every x86_64 processor has SSE, and a prefetch changes nothing and faults at no address, whether
        // inside the slice or not.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(slice.as_ptr().wrapping_add(at).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (slice, at);
}
