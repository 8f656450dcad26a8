//! Vector operations on plain arrays, which compilers translate to the instructions of the build's target (SSE2, NEON).

use super::Bytes;

/// Instruction set whose register is an array of `N` bytes: 16, or 1 for rows shorter than a register.
#[derive(Clone, Copy)]
pub(crate) struct Portable<const N: usize>;

impl<const N: usize> Bytes for Portable<N> {
    /// Number of voxels in a register.
    const N: usize = N;
    type V = [u8; N];

    #[inline(always)]
    fn splat(self, v: u8) -> [u8; N] {
        [v; N]
    }
    #[inline(always)]
    fn min(self, a: [u8; N], b: [u8; N]) -> [u8; N] {
        std::array::from_fn(|n| a[n].min(b[n]))
    }
    #[inline(always)]
    fn add(self, a: [u8; N], b: [u8; N]) -> [u8; N] {
        std::array::from_fn(|n| a[n].saturating_add(b[n]))
    }
    #[inline(always)]
    fn is_zero(self, v: [u8; N]) -> bool {
        v == [0; N]
    }
    #[inline(always)]
    fn same(self, a: [u8; N], b: [u8; N]) -> bool {
        a == b
    }
    #[inline(always)]
    fn previous(self, before: [u8; N], v: [u8; N]) -> [u8; N] {
        std::array::from_fn(|n| if n == 0 { before[N - 1] } else { v[n - 1] })
    }
    #[inline(always)]
    fn next(self, v: [u8; N], after: [u8; N]) -> [u8; N] {
        std::array::from_fn(|n| if n == N - 1 { after[0] } else { v[n + 1] })
    }
    #[inline(always)]
    fn expand(self, bits: u64) -> [u8; N] {
        std::array::from_fn(|n| if bits >> n & 1 == 1 { 255 } else { 0 })
    }
    #[inline(always)]
    fn spread(self, mut v: [u8; N]) -> [u8; N] {
        // Distances of 1, 2, 4 .. combine to every distance.
        let mut s = 1;
        while s < N {
            let old = v;
            for n in 0..N {
                let up = if n >= s { old[n - s] } else { 255 };
                let down = if n + s < N { old[n + s] } else { 255 };
                v[n] = old[n].min(up.min(down).saturating_add(s as u8));
            }
            s *= 2;
        }
        v
    }
    #[inline(always)]
    fn rising(self) -> [u8; N] {
        std::array::from_fn(|n| n as u8 + 1)
    }
    #[inline(always)]
    fn falling(self) -> [u8; N] {
        std::array::from_fn(|n| (N - n) as u8)
    }

    #[inline(always)]
    unsafe fn load(self, at: *const u8) -> [u8; N] {
        // SAFETY: the caller guarantees that `N` bytes from `at` are readable. Benchmark:
        // crates/isoregion/benches/map.rs, as for all operations below.
        unsafe { at.cast::<[u8; N]>().read_unaligned() }
    }
    #[inline(always)]
    unsafe fn store(self, at: *mut u8, v: [u8; N]) {
        // SAFETY: the caller guarantees that `N` bytes from `at` are writable.
        unsafe { at.cast::<[u8; N]>().write_unaligned(v) }
    }
    #[inline(always)]
    unsafe fn equal64(self, a: *const u8, b: *const u8) -> u64 {
        // SAFETY: the caller guarantees that 64 bytes from `a` and from `b` are readable; an array of bytes needs no
        // alignment.
        let (a, b) = unsafe { (a.cast::<[u8; 64]>().read(), b.cast::<[u8; 64]>().read()) };
        bits(std::array::from_fn(|n| u8::from(a[n] == b[n])))
    }
    #[inline(always)]
    unsafe fn within64(self, at: *const i16, lo: i16, width: u16) -> u64 {
        // SAFETY: the caller guarantees that 64 values from `at` are readable.
        let v = unsafe { at.cast::<[i16; 64]>().read_unaligned() };
        bits(std::array::from_fn(|n| {
            u8::from(v[n].wrapping_sub(lo).cast_unsigned() <= width)
        }))
    }
}

/// Return a mask of 64 bits from 64 bytes of 0 or 1: bit n is byte n.
#[inline(always)]
fn bits(flags: [u8; 64]) -> u64 {
    let mut out = 0;
    for (n, eight) in flags.as_chunks::<8>().0.iter().enumerate() {
        // The product moves bit 8 n to bit 56 + n, and no two terms overlap in the top byte.
        let top = u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56;
        out |= top << (8 * n);
    }
    out
}
