//! Which voxels lie in the middle of 3x3x3 equal ones, or which cells have eight equal corners: one bit each, slice after
//! slice.

use crate::bytes::Bytes;

/// What a bit, and later a radius, belongs to.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Unit {
    /// A voxel, and the 26 round it.
    Voxel,
    /// The cell between a voxel and the seven after it.
    Cell,
}

/// What makes two voxels equal.
#[derive(Clone, Copy)]
pub(crate) enum Source<'a> {
    /// One label, other than 0.
    Labels(&'a [u8], Unit),
    /// Values in one run: its first value, and how far the last one is from it. Runs are disjoint; values in none of
    /// them are unequal to all. Of cells.
    Runs(&'a [i16], &'a [(i16, u16)]),
}

/// The last three slices of one kind of equality.
struct Ring {
    /// The 3x3 voxels of the slice round it are equal; of a cell the 2x2.
    flat: [Vec<u64>; 3],
    /// It equals the voxel in the slice after; empty where `flat` says it already.
    alike: [Vec<u64>; 3],
}

/// Slides over the slices; rows are whole words of 64 bits.
pub(crate) struct Uniform<'a> {
    source: Source<'a>,
    shape_zyx: [usize; 3],
    words: usize,
    rings: Vec<Ring>,
    /// Of the slice under way: its three voxels (a cell's two) along x are equal; it equals the voxel in the row after.
    across: Vec<u64>,
    down: Vec<u64>,
    /// Stands for label 0.
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

    /// Reads slice `z`. Slices come one after the other.
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
                    // `down` holds the voxels of label 0 for a moment.
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

    /// Row `y` of slice `z`; slices `z - 1 ..= z + 1` are the last that were read. False if no bit is set.
    #[inline(always)]
    pub(crate) fn row(&self, z: usize, y: usize, out: &mut [u64]) -> bool {
        let at = y * self.words..(y + 1) * self.words;
        let (before, here, after) = ((z + 2) % 3, z % 3, (z + 1) % 3);
        out.fill(0);
        let mut any = 0;
        for ring in &self.rings {
            // A cell has nothing to do with the slice before.
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

/// `flat[y] = across[y - 1 ..= y + 1]`, of cells `across[y ..= y + 1]`, and with `down` rows equal to the next; no bits in the
/// first and last row.
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

/// Nothing at a row's first voxel: what lies before it is missing.
#[inline(always)]
fn without_first(row: &mut [u64]) {
    row[0] &= !1;
}

/// From "in the run" to "in it, with the one after it".
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

/// From "equals the voxel after" to "equals both beside it".
#[inline(always)]
fn both_sides(row: &mut [u64]) {
    let mut carry = 0;
    for word in row {
        let after = *word;
        *word &= after << 1 | carry;
        carry = after >> 63;
    }
}

/// A comparison of voxels `at ..` of two rows, or of a row with a run. Not a closure: a closure is a function of its own
/// and has not the instructions of its kernel.
trait Compare {
    /// # Safety
    /// 64 voxels from `at` must lie in the rows.
    unsafe fn word<B: Bytes>(&self, b: B, at: usize) -> u64;
    fn one(&self, at: usize) -> bool;
}

struct Equal<'a>(&'a [u8], &'a [u8]);

impl Compare for Equal<'_> {
    #[inline(always)]
    unsafe fn word<B: Bytes>(&self, b: B, at: usize) -> u64 {
        // SAFETY: as promised by the caller. Benchmark: benches/map.rs.
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
        // SAFETY: as promised by the caller. Benchmark: benches/map.rs.
        unsafe { b.within64(self.0.as_ptr().add(at), lo, width) }
    }
    #[inline(always)]
    fn one(&self, at: usize) -> bool {
        let (lo, width) = self.1;
        self.0[at].wrapping_sub(lo).cast_unsigned() <= width
    }
}

/// Bit n is set where `a[n] == c[n]`, for n below `count`; the other bits are 0.
#[inline(always)]
fn equal<B: Bytes>(b: B, a: &[u8], c: &[u8], count: usize, out: &mut [u64]) {
    assert!(a.len() >= count && c.len() >= count);
    // SAFETY: both hold `count` voxels.
    unsafe { fill_words(b, &Equal(a, c), count, out) };
}

/// Bit n is set where `values[n]` lies in the run; the bits beyond the row are 0.
#[inline(always)]
fn within<B: Bytes>(b: B, values: &[i16], run: (i16, u16), out: &mut [u64]) {
    // SAFETY: these are all of them.
    unsafe { fill_words(b, &Within(values, run), values.len(), out) };
}

/// Words from 64 voxels each, the last one from the last 64 of the row; voxel by voxel where there are no 64.
///
/// # Safety
/// The rows that are compared must hold `count` voxels.
#[inline(always)]
unsafe fn fill_words<B: Bytes>(b: B, compare: &impl Compare, count: usize, out: &mut [u64]) {
    let (whole, rest) = (count / 64, count % 64);
    for (n, out) in out[..whole].iter_mut().enumerate() {
        // SAFETY: 64 (n + 1) <= count. Benchmark: benches/map.rs.
        *out = unsafe { compare.word(b, 64 * n) };
    }
    if whole < out.len() {
        out[whole..].fill(0);
        if rest > 0 && whole > 0 {
            // SAFETY: the last 64 of at least 64 voxels.
            out[whole] = unsafe { compare.word(b, count - 64) } >> (64 - rest);
        } else {
            for n in 0..rest {
                out[whole] |= u64::from(compare.one(64 * whole + n)) << n;
            }
        }
    }
}
