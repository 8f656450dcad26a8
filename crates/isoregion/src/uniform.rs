//! Bit sets of the uniform voxels and cells of a volume (all voxels round them are equal), computed slice by slice.
//!
//! A uniform voxel is at the centre of 3x3x3 equal voxels; a uniform cell has eight equal corners.

use crate::bytes::Bytes;

/// Element that one bit, and later one radius, describes.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unit {
    /// Voxel; it is uniform if it equals the 26 voxels round it.
    Voxel,
    /// Cell of eight voxels, stored at its lower corner; it is uniform if the eight are equal.
    Cell,
}

/// Data of a volume with the criterion by which two voxels count as equal.
#[derive(Clone, Copy)]
pub(crate) enum Source<'a> {
    /// Voxels are equal if they have the same label other than 0.
    Labels(&'a [u8], Unit),
    /// Voxels are equal if their values are in the same run; only for cells.
    ///
    /// A run is given by its first value and the distance to its last value. Runs are disjoint; a value in no run is
    /// unequal to all values.
    Runs(&'a [i16], &'a [(i16, u16)]),
}

/// Bits of the last three slices for one criterion by which voxels count as equal.
struct Ring {
    /// One bit per voxel, set if its 3x3 neighbourhood in the slice is equal; for cells, if its 2x2 voxels are equal.
    flat: [Vec<u64>; 3],
    /// One bit per voxel, set if the voxel equals the voxel in the next slice; empty if `flat` implies this.
    alike: [Vec<u64>; 3],
}

/// Sliding window over the slices of a volume, which computes their uniform voxels or cells.
///
/// The rows of bits are whole words of 64 bits.
pub(crate) struct Uniform<'a> {
    source: Source<'a>,
    shape_zyx: [usize; 3],
    words: usize,
    rings: Vec<Ring>,
    /// Bits of the current slice, set if three voxels (for a cell two) along x are equal.
    across: Vec<u64>,
    /// Bits of the current slice, set if the voxel equals the voxel in the next row.
    down: Vec<u64>,
    /// Row of zeros, with which labels are compared.
    zeros: Vec<u8>,
}

impl<'a> Uniform<'a> {
    pub(crate) fn new(source: Source<'a>, shape_zyx: [usize; 3]) -> Self {
        let [_, ny, nx] = shape_zyx;
        let words = nx.div_ceil(64);
        let slice = || vec![0; ny * words];
        let (num_rings, labelled) = match source {
            Source::Labels(..) => (1, true),
            Source::Runs(_, runs) => (runs.len(), false),
        };
        let ring = || Ring {
            flat: std::array::from_fn(|_| slice()),
            alike: std::array::from_fn(|_| if labelled { slice() } else { Vec::new() }),
        };
        Self {
            source,
            shape_zyx,
            words,
            rings: (0..num_rings).map(|_| ring()).collect(),
            across: slice(),
            down: if labelled { slice() } else { Vec::new() },
            zeros: vec![0; if labelled { nx } else { 0 }],
        }
    }

    pub(crate) const fn num_words(&self) -> usize {
        self.words
    }

    /// Read slice `z` of the volume into the window.
    ///
    /// Slices must be read in order.
    #[inline(always)]
    pub(crate) fn read<B: Bytes>(&mut self, b: B, z: usize) {
        let [nz, ny, nx] = self.shape_zyx;
        let (words, plane) = (self.words, ny * nx);
        match self.source {
            Source::Labels(labels, unit) => {
                let slice = &labels[z * plane..][..plane];
                let after = labels.get((z + 1) * plane..).filter(|_| z + 1 < nz);
                let ring = &mut self.rings[0];
                for y in 0..ny {
                    let row = &slice[y * nx..][..nx];
                    let across = &mut self.across[y * words..][..words];
                    equal(b, row, &row[1..], nx - 1, across);
                    if unit == Unit::Voxel {
                        both_sides(across);
                    }
                    without_first(across);
                    // `down` temporarily contains the voxels of label 0.
                    let down = &mut self.down[y * words..][..words];
                    equal(b, row, &self.zeros, nx, down);
                    for (across, down) in across.iter_mut().zip(&*down) {
                        *across &= !down;
                    }
                    if y + 1 < ny {
                        equal(b, row, &slice[(y + 1) * nx..], nx, down);
                    }
                    if let Some(after) = after {
                        equal(
                            b,
                            row,
                            &after[y * nx..],
                            nx,
                            &mut ring.alike[z % 3][y * words..][..words],
                        );
                    }
                }
                flatten(
                    unit,
                    &mut ring.flat[z % 3],
                    &self.across,
                    Some(&self.down),
                    words,
                );
            }
            Source::Runs(values, runs) => {
                let slice = &values[z * plane..][..plane];
                for (ring, &run) in self.rings.iter_mut().zip(runs) {
                    for y in 0..ny {
                        let across = &mut self.across[y * words..][..words];
                        within(b, &slice[y * nx..][..nx], run, across);
                        after_in_set(across);
                        without_first(across);
                    }
                    flatten(Unit::Cell, &mut ring.flat[z % 3], &self.across, None, words);
                }
            }
        }
    }

    /// Compute row `y` of slice `z` from slices `z - 1 ..= z + 1`; return false if no bit is set.
    ///
    /// These slices must be the last ones that were read.
    #[inline(always)]
    pub(crate) fn row(&self, z: usize, y: usize, out: &mut [u64]) -> bool {
        let at = y * self.words..(y + 1) * self.words;
        let (before, here, after) = ((z + 2) % 3, z % 3, (z + 1) % 3);
        out.fill(0);
        let mut any = 0;
        for ring in &self.rings {
            // A cell does not depend on the previous slice.
            let first = match self.source {
                Source::Labels(_, Unit::Voxel) => before,
                _ => here,
            };
            let [a, c, e] = [
                &ring.flat[first][at.clone()],
                &ring.flat[here][at.clone()],
                &ring.flat[after][at.clone()],
            ];
            for (n, out) in out.iter_mut().enumerate() {
                let mut all = a[n] & c[n] & e[n];
                if let Some(alike) = ring.alike[first].get(at.clone()) {
                    all &= alike[n] & ring.alike[here][at.start + n];
                }
                *out |= all;
                any |= all;
            }
        }
        any != 0
    }
}

/// Set `flat[y]` to the conjunction of `across[y - 1 ..= y + 1]` (for cells `across[y ..= y + 1]`).
///
/// With `down`, a bit is set only if the rows are also equal to the next row. The first and the last row have no bits.
#[inline(always)]
fn flatten(unit: Unit, flat: &mut [u64], across: &[u64], down: Option<&[u64]>, words: usize) {
    let before = if unit == Unit::Voxel { words } else { 0 };
    let count = flat.len();
    for n in words..count - words {
        flat[n] = across[n - before] & across[n] & across[n + words];
    }
    if let Some(down) = down {
        for n in words..count - words {
            flat[n] &= down[n - before] & down[n];
        }
    }
}

/// Clear the bit of a row's first voxel, which has no previous voxel.
#[inline(always)]
fn without_first(row: &mut [u64]) {
    row[0] &= !1;
}

/// Convert the bits "in the run" of a row to "in the run together with the next voxel".
#[inline(always)]
fn after_in_set(row: &mut [u64]) {
    for n in 0..row.len() {
        let next = if n + 1 < row.len() {
            row[n + 1] << 63
        } else {
            0
        };
        row[n] &= row[n] >> 1 | next;
    }
}

/// Convert the bits "equals the next voxel" of a row to "equals both neighbours".
#[inline(always)]
fn both_sides(row: &mut [u64]) {
    let mut carry = 0;
    for word in row {
        let after = *word;
        *word &= after << 1 | carry;
        carry = after >> 63;
    }
}

/// Comparison of the voxels from index `at` on of two rows, or of one row with a run of values.
///
/// The comparison is not a closure, because a closure is a separate function without the instructions of its kernel.
trait Compare {
    /// Compare 64 voxels from `at` on and return one bit each.
    ///
    /// # Safety
    ///
    /// 64 voxels from `at` must be in the rows.
    unsafe fn word<B: Bytes>(&self, b: B, at: usize) -> u64;
    fn one(&self, at: usize) -> bool;
}

struct Equal<'a>(&'a [u8], &'a [u8]);

impl Compare for Equal<'_> {
    #[inline(always)]
    unsafe fn word<B: Bytes>(&self, b: B, at: usize) -> u64 {
        // SAFETY: the caller guarantees that 64 voxels from `at` are in both rows. Benchmark: benches/map.rs.
        unsafe { b.equal64(self.0.as_ptr().add(at), self.1.as_ptr().add(at)) }
    }
    #[inline(always)]
    fn one(&self, at: usize) -> bool {
        self.0[at] == self.1[at]
    }
}

struct Within<'a>(&'a [i16], (i16, u16));

impl Compare for Within<'_> {
    #[inline(always)]
    unsafe fn word<B: Bytes>(&self, b: B, at: usize) -> u64 {
        let (lo, width) = self.1;
        // SAFETY: the caller guarantees that 64 voxels from `at` are in the row. Benchmark: benches/map.rs.
        unsafe { b.within64(self.0.as_ptr().add(at), lo, width) }
    }
    #[inline(always)]
    fn one(&self, at: usize) -> bool {
        let (lo, width) = self.1;
        self.0[at].wrapping_sub(lo).cast_unsigned() <= width
    }
}

/// Set bit n of `out` where `a[n] == c[n]`, for n below `count`; the other bits become 0.
#[inline(always)]
fn equal<B: Bytes>(b: B, a: &[u8], c: &[u8], count: usize, out: &mut [u64]) {
    assert!(a.len() >= count && c.len() >= count);
    // SAFETY: both rows contain `count` voxels.
    unsafe { fill_words(b, &Equal(a, c), count, out) };
}

/// Set bit n of `out` where `values[n]` is in the run; the bits beyond the row become 0.
#[inline(always)]
fn within<B: Bytes>(b: B, values: &[i16], run: (i16, u16), out: &mut [u64]) {
    // SAFETY: `values.len()` is the number of voxels in the row.
    unsafe { fill_words(b, &Within(values, run), values.len(), out) };
}

/// Compute words of 64 comparisons each, the last word from the last 64 voxels of the row.
///
/// Rows shorter than 64 voxels are processed voxel by voxel.
///
/// # Safety
///
/// The rows that are compared must contain `count` voxels.
#[inline(always)]
unsafe fn fill_words<B: Bytes>(b: B, compare: &impl Compare, count: usize, out: &mut [u64]) {
    let (whole, rest) = (count / 64, count % 64);
    for (n, out) in out[..whole].iter_mut().enumerate() {
        // SAFETY: 64 (n + 1) <= count, so the 64 voxels are in the rows. Benchmark: benches/map.rs.
        *out = unsafe { compare.word(b, 64 * n) };
    }
    if whole < out.len() {
        out[whole..].fill(0);
        if rest > 0 && whole > 0 {
            // SAFETY: the row has at least 64 voxels, so its last 64 are in the rows.
            out[whole] = unsafe { compare.word(b, count - 64) } >> (64 - rest);
        } else {
            for n in 0..rest {
                out[whole] |= u64::from(compare.one(64 * whole + n)) << n;
            }
        }
    }
}
