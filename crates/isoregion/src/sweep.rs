//! Kernels for chessboard distances within a slab of slices, and across the border of two slabs.
//!
//! The distance of a voxel to the nearest 0 is the length of a path of steps to any of the 26 neighbours. The steps of
//! such a path can be reordered: first those along x, then those of a forward sweep (`FORWARD` below), then those of a
//! backward sweep; no step leaves the box of its two ends. So distances along rows, which need only the row itself,
//! followed by two sweeps are exact. The sweeps read the rows before (after) a row, not the row itself, so there is no
//! dependency chain along x.

use crate::{
    bytes::{Bytes, Kernel},
    uniform::{Source, Uniform},
};

/// Kernel that computes the chessboard distances in slices `first_z ..` of a volume, as many slices as `out` has.
///
/// The kernel assumes that there is no 0 beyond these slices. `stopped` is called before each slice; the distances of a
/// stopped sweep are not valid.
pub(crate) struct Sweep<'a> {
    pub(crate) source: Source<'a>,
    pub(crate) shape_zyx: [usize; 3],
    pub(crate) first_z: usize,
    pub(crate) out: &'a mut [u8],
    pub(crate) stopped: &'a dyn Fn() -> bool,
}

impl Kernel for Sweep<'_> {
    #[inline(always)]
    fn run<B: Bytes>(self, b: B) {
        let Self {
            source,
            shape_zyx,
            first_z,
            out,
            stopped,
        } = self;
        let [nz, ny, nx] = shape_zyx;
        let plane = ny * nx;
        let num_slices = out.len() / plane;
        if shape_zyx.iter().any(|&n| n < 3) {
            out.fill(0);
            return;
        }
        let inner = |n: usize| (1..nz - 1).contains(&(first_z + n));
        let mut uniform = Uniform::new(source, shape_zyx);
        let mut bits = vec![0; uniform.num_words()];
        let mut read = first_z.saturating_sub(1);
        for n in 0..num_slices {
            if stopped() {
                return;
            }
            let (done, rest) = out.split_at_mut(n * plane);
            let slice = &mut rest[..plane];
            if !inner(n) {
                slice.fill(0);
                continue;
            }
            let z = first_z + n;
            while read <= z + 1 {
                uniform.read(b, read);
                read += 1;
            }
            slice[..nx].fill(0);
            slice[plane - nx..].fill(0);
            for y in 1..ny - 1 {
                let (above, here) = slice.split_at_mut(y * nx);
                let row = &mut here[..nx];
                if !uniform.row(z, y, &mut bits) {
                    row.fill(0);
                    continue;
                }
                distances_along_row(b, &bits, row);
                let above = &above[(y - 1) * nx..];
                if n > 0 {
                    let last = &done[(n - 1) * plane..];
                    relax(b, row, beside(last, y, nx).with(above));
                } else {
                    relax(b, row, [above]);
                }
            }
        }
        for n in (0..num_slices).rev().filter(|&n| inner(n)) {
            if stopped() {
                return;
            }
            let (rest, done) = out.split_at_mut((n + 1) * plane);
            let slice = &mut rest[n * plane..];
            for y in (1..ny - 1).rev() {
                let (here, below) = slice.split_at_mut((y + 1) * nx);
                let row = &mut here[y * nx..];
                if n + 1 < num_slices {
                    relax(b, row, beside(done, y, nx).with(below));
                } else {
                    relax(b, row, [&*below]);
                }
            }
        }
    }
}

/// Kernel that propagates chessboard distances from `edge`, the adjacent slice of the finished neighbouring slab, into
/// a slab.
///
/// The kernel propagates forward from the slab's first slice on, or backward from its last. The distances within both
/// slabs are exact, so only steps to other slices are missing.
pub(crate) struct Push<'a> {
    pub(crate) edge: &'a [u8],
    pub(crate) slab: &'a mut [u8],
    pub(crate) shape_yx: [usize; 2],
    pub(crate) forward: bool,
}

impl Kernel for Push<'_> {
    #[inline(always)]
    fn run<B: Bytes>(self, b: B) {
        let Self {
            edge,
            slab,
            shape_yx: [ny, nx],
            forward,
        } = self;
        let plane = ny * nx;
        let num_slices = slab.len() / plane;
        for n in 0..num_slices {
            let (slice, last): (&mut [u8], &[u8]) = if forward {
                let (done, rest) = slab.split_at_mut(n * plane);
                let last = n.checked_sub(1).map_or(edge, |m| &done[m * plane..]);
                (&mut rest[..plane], last)
            } else {
                let (rest, done) = slab.split_at_mut((num_slices - n) * plane);
                let start = rest.len() - plane;
                (
                    &mut rest[start..],
                    if n == 0 { edge } else { &done[..plane] },
                )
            };
            let mut changed = false;
            for y in 1..ny - 1 {
                changed |= relax(b, &mut slice[y * nx..][..nx], beside(last, y, nx));
            }
            // Slices further on depend only on this slice, which has not changed, so the propagation ends here.
            if !changed {
                return;
            }
        }
    }
}

/// Return rows `y - 1`, `y` and `y + 1` of a slice.
#[inline(always)]
fn beside(slice: &[u8], y: usize, nx: usize) -> [&[u8]; 3] {
    [
        &slice[(y - 1) * nx..][..nx],
        &slice[y * nx..][..nx],
        &slice[(y + 1) * nx..][..nx],
    ]
}

/// Extension of an array of rows by one further row.
trait With<'a> {
    fn with(self, row: &'a [u8]) -> [&'a [u8]; 4];
}

impl<'a> With<'a> for [&'a [u8]; 3] {
    #[inline(always)]
    fn with(self, row: &'a [u8]) -> [&'a [u8]; 4] {
        [self[0], self[1], self[2], row]
    }
}

// The functions from here on contain no closures, because a closure is a separate function without the instructions of
// its kernel.

/// Compute for each voxel of a row the distance along the row to the nearest bit that is not set, 0 at such a bit.
///
/// The last voxel's bit must not be set.
#[inline(always)]
fn distances_along_row<B: Bytes>(b: B, bits: &[u64], row: &mut [u8]) {
    let nx = row.len();
    assert!(nx >= B::N);
    let (mut x, mut before) = (0, 0);
    while x + B::N <= nx {
        before = distances_in_block(b, bits, row, x, before);
        x += B::N;
    }
    if x < nx {
        // The last register is a whole one, so some of its voxels are computed a second time.
        let x = nx - B::N;
        distances_in_block(b, bits, row, x, ones_before(bits, x));
    }
}

/// Compute the distances of `distances_along_row` for voxels `x ..= x + N - 1`; return the number of set bits at their
/// end.
///
/// `before` is the number of consecutive set bits directly before `x`; the result is the number directly before `x +
/// N`.
#[inline(always)]
fn distances_in_block<B: Bytes>(b: B, bits: &[u64], row: &mut [u8], x: usize, before: u8) -> u8 {
    let whole = if B::N == 64 { !0 } else { (1 << B::N) - 1 };
    let set = bits_from(bits, x) & whole;
    let mut out = b.splat(0);
    if set != 0 {
        let rising = b.add(b.rising(), b.splat(before));
        let falling = b.add(b.falling(), b.splat(ones_from(bits, x + B::N)));
        out = b.min(rising, falling);
        if set != whole {
            out = b.min(b.spread(b.expand(set)), out);
        }
    }
    debug_assert!(x + B::N <= row.len());
    // SAFETY: the callers' loops end at the end of the row, so `N` bytes from `x` are in the row. Benchmark:
    // benches/map.rs.
    unsafe { b.store(row.as_mut_ptr().add(x), out) };
    if set == whole {
        before.saturating_add(B::N as u8)
    } else {
        (set << (64 - B::N)).leading_ones() as u8
    }
}

/// Return the 64 bits of a bit array that start at position `at`; bits beyond its end are 0.
#[inline(always)]
fn bits_from(bits: &[u64], at: usize) -> u64 {
    let (word, shift) = (at / 64, at % 64);
    if word >= bits.len() {
        return 0;
    }
    let low = bits[word] >> shift;
    if shift == 0 || word + 1 == bits.len() {
        low
    } else {
        low | bits[word + 1] << (64 - shift)
    }
}

/// Return the number of consecutive set bits of `bits` that start at position `at`, up to 255.
#[inline(always)]
fn ones_from(bits: &[u64], at: usize) -> u8 {
    let mut count = 0;
    while count < 255 {
        let ones = bits_from(bits, at + count).trailing_ones() as usize;
        count += ones;
        if ones < 64 {
            break;
        }
    }
    count.min(255) as u8
}

/// Return the number of consecutive set bits of `bits` directly before position `at`, up to 255.
#[inline(always)]
fn ones_before(bits: &[u64], at: usize) -> u8 {
    let set = |n: &usize| bits[n / 64] >> (n % 64) & 1 == 1;
    (0..at).rev().take(255).take_while(set).count() as u8
}

/// Return for voxels `x ..= x + N - 1` the minimum over several rows.
///
/// # Safety
///
/// Every row must contain these voxels.
#[inline(always)]
unsafe fn least<B: Bytes, const R: usize>(b: B, rows: [&[u8]; R], x: usize) -> B::V {
    // SAFETY: the caller guarantees that every row contains `N` voxels from `x`. Benchmark: benches/map.rs.
    unsafe {
        let mut out = b.load(rows[0].as_ptr().add(x));
        let mut n = 1;
        while n < R {
            out = b.min(out, b.load(rows[n].as_ptr().add(x)));
            n += 1;
        }
        out
    }
}

/// Set `row = min(row, 1 + min over the rows' voxels at x - 1, x and x + 1)`; return true if a value changed.
///
/// The first and the last voxel of the row are 0, so the values beyond the row's ends do not matter.
#[inline(always)]
fn relax<B: Bytes, const R: usize>(b: B, row: &mut [u8], rows: [&[u8]; R]) -> bool {
    let nx = row.len();
    assert!(nx >= B::N);
    for r in rows {
        assert!(r.len() >= nx);
    }
    let start = row.as_mut_ptr();
    let (full, one) = (b.splat(255), b.splat(1));
    let mut changed = false;
    let (mut x, mut ready) = (0, false);
    let (mut before, mut here) = (full, full);
    // SAFETY: x + N <= nx wherever N voxels from x are read or written, and all rows are at least nx long. Benchmark:
    // benches/map.rs.
    unsafe {
        while x + B::N <= nx {
            let old = b.load(start.add(x));
            if b.is_zero(old) {
                ready = false;
            } else {
                if !ready {
                    if x > 0 {
                        before = least(b, rows, x - B::N);
                    }
                    here = least(b, rows, x);
                }
                // If no whole register follows, the neighbour of the last voxel is processed with the remainder below.
                ready = x + 2 * B::N <= nx;
                let after = if ready {
                    least(b, rows, x + B::N)
                } else {
                    full
                };
                let beside = b.min(b.previous(before, here), b.next(here, after));
                let new = b.min(old, b.add(b.min(here, beside), one));
                // Many registers do not change, so their stores are skipped to save memory traffic.
                if !b.same(new, old) {
                    changed = true;
                    b.store(start.add(x), new);
                }
                (before, here) = (here, after);
            }
            x += B::N;
        }
        if x < nx {
            let x = nx - B::N;
            let old = b.load(start.add(x));
            if !b.is_zero(old) {
                let here = least(b, rows, x);
                let beside = b.min(least(b, rows, x - 1), b.next(here, full));
                let new = b.min(old, b.add(b.min(here, beside), one));
                changed |= !b.same(new, old);
                b.store(start.add(x), new);
            }
        }
    }
    changed
}
