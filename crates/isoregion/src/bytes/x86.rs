//! Instruction sets of `x86_64`: SSE2, which every such machine has, AVX2 and AVX-512.

use std::arch::x86_64::{
    __m128i, __m256i, __m512i, _mm_adds_epu8, _mm_and_si128, _mm_cmpeq_epi8, _mm_cmpeq_epi16,
    _mm_loadu_si128, _mm_min_epu8, _mm_movemask_epi8, _mm_or_si128, _mm_packs_epi16, _mm_set1_epi8,
    _mm_set1_epi16, _mm_set1_epi64x, _mm_setzero_si128, _mm_slli_si128, _mm_srli_si128,
    _mm_storeu_si128, _mm_sub_epi16, _mm_subs_epu16, _mm_unpacklo_epi64, _mm256_adds_epu8,
    _mm256_alignr_epi8, _mm256_and_si256, _mm256_cmpeq_epi8, _mm256_cmpeq_epi16,
    _mm256_loadu_si256, _mm256_max_epu16, _mm256_min_epu8, _mm256_movemask_epi8,
    _mm256_packs_epi16, _mm256_permute2x128_si256, _mm256_permute4x64_epi64, _mm256_set1_epi8,
    _mm256_set1_epi16, _mm256_set1_epi32, _mm256_set1_epi64x, _mm256_setr_epi8,
    _mm256_shuffle_epi8, _mm256_storeu_si256, _mm256_sub_epi16, _mm256_testz_si256,
    _mm512_adds_epu8, _mm512_alignr_epi8, _mm512_alignr_epi64, _mm512_cmpeq_epu8_mask,
    _mm512_cmple_epu16_mask, _mm512_loadu_si512, _mm512_min_epu8, _mm512_movm_epi8,
    _mm512_set1_epi8, _mm512_set1_epi16, _mm512_storeu_si512, _mm512_sub_epi16,
    _mm512_test_epi8_mask,
};

use super::Bytes;

/// Bytes 1, 2 ..= 64, from which a register with rising values is loaded.
const RISING: [u8; 64] = {
    let mut out = [0; 64];
    let mut n = 0;
    while n < 64 {
        out[n] = n as u8 + 1;
        n += 1;
    }
    out
};

/// Bytes 64 ..= 2, 1; the part `FALLING[64 - N ..]` falls from N to 1.
const FALLING: [u8; 64] = {
    let mut out = [0; 64];
    let mut n = 0;
    while n < 64 {
        out[n] = 64 - n as u8;
        n += 1;
    }
    out
};

/// Macro that defines the operations that consist of one or a few instructions.
macro_rules! operations {
    ($(fn $name:ident($($arg:ident: $type:ty),*) -> $out:ty { $body:expr })*) => {$(
        #[inline(always)]
        fn $name(self, $($arg: $type),*) -> $out {
            // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole
            // arrays. Benchmark: crates/isoregion/benches/map.rs.
            unsafe { $body }
        }
    )*};
}

/// Instruction set AVX-512 F and BW; a value proves that the machine has both.
#[derive(Clone, Copy)]
pub(crate) struct Avx512(());

impl Avx512 {
    /// Create the proof that the machine has the instruction set.
    ///
    /// # Safety
    ///
    /// The machine must have AVX-512 F and BW.
    #[inline(always)]
    pub(crate) unsafe fn new() -> Self {
        Self(())
    }
}

impl Bytes for Avx512 {
    /// Number of voxels in a register.
    const N: usize = 64;
    type V = __m512i;

    operations! {
        fn splat(v: u8) -> __m512i { _mm512_set1_epi8(v.cast_signed()) }
        fn min(a: __m512i, b: __m512i) -> __m512i { _mm512_min_epu8(a, b) }
        fn add(a: __m512i, b: __m512i) -> __m512i { _mm512_adds_epu8(a, b) }
        fn is_zero(v: __m512i) -> bool { _mm512_test_epi8_mask(v, v) == 0 }
        fn same(a: __m512i, b: __m512i) -> bool { _mm512_cmpeq_epu8_mask(a, b) == u64::MAX }
        fn previous(before: __m512i, v: __m512i) -> __m512i {
            _mm512_alignr_epi8::<15>(v, _mm512_alignr_epi64::<6>(v, before))
        }
        fn next(v: __m512i, after: __m512i) -> __m512i {
            _mm512_alignr_epi8::<1>(_mm512_alignr_epi64::<2>(after, v), v)
        }
        fn expand(bits: u64) -> __m512i { _mm512_movm_epi8(bits) }
        fn spread(v: __m512i) -> __m512i {{
            let full = _mm512_set1_epi8(-1);
            let mut v = v;
            macro_rules! step {
                ($s:literal, $up:expr, $down:expr) => {
                    let near = _mm512_min_epu8($up, $down);
                    v = _mm512_min_epu8(v, _mm512_adds_epu8(near, _mm512_set1_epi8($s)));
                };
            }
            macro_rules! bytes {
                ($s:literal, $rest:literal) => {
                    step!(
                        $s,
                        _mm512_alignr_epi8::<$rest>(v, _mm512_alignr_epi64::<6>(v, full)),
                        _mm512_alignr_epi8::<$s>(_mm512_alignr_epi64::<2>(full, v), v)
                    );
                };
            }
            bytes!(1, 15);
            bytes!(2, 14);
            bytes!(4, 12);
            bytes!(8, 8);
            step!(16, _mm512_alignr_epi64::<6>(v, full), _mm512_alignr_epi64::<2>(full, v));
            step!(32, _mm512_alignr_epi64::<4>(v, full), _mm512_alignr_epi64::<4>(full, v));
            v
        }}
        fn rising() -> __m512i { _mm512_loadu_si512(RISING.as_ptr().cast()) }
        fn falling() -> __m512i { _mm512_loadu_si512(FALLING.as_ptr().cast()) }
    }

    #[inline(always)]
    unsafe fn load(self, at: *const u8) -> __m512i {
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that the
        // bytes are readable. Benchmark: crates/isoregion/benches/map.rs.
        unsafe { _mm512_loadu_si512(at.cast()) }
    }
    #[inline(always)]
    unsafe fn store(self, at: *mut u8, v: __m512i) {
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that the
        // bytes are writable.
        unsafe { _mm512_storeu_si512(at.cast(), v) }
    }
    #[inline(always)]
    unsafe fn equal64(self, a: *const u8, b: *const u8) -> u64 {
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that 64
        // bytes from `a` and from `b` are readable.
        unsafe { _mm512_cmpeq_epu8_mask(self.load(a), self.load(b)) }
    }
    #[inline(always)]
    unsafe fn within64(self, at: *const i16, lo: i16, width: u16) -> u64 {
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that 64
        // values from `at` are readable.
        unsafe {
            let (lo, width) = (
                _mm512_set1_epi16(lo),
                _mm512_set1_epi16(width.cast_signed()),
            );
            let first = _mm512_sub_epi16(_mm512_loadu_si512(at.cast()), lo);
            let second = _mm512_sub_epi16(_mm512_loadu_si512(at.add(32).cast()), lo);
            u64::from(_mm512_cmple_epu16_mask(first, width))
                | u64::from(_mm512_cmple_epu16_mask(second, width)) << 32
        }
    }
}

/// Instruction set AVX2; a value proves that the machine has it.
#[derive(Clone, Copy)]
pub(crate) struct Avx2(());

impl Avx2 {
    /// Create the proof that the machine has the instruction set.
    ///
    /// # Safety
    ///
    /// The machine must have AVX2.
    #[inline(always)]
    pub(crate) unsafe fn new() -> Self {
        Self(())
    }
}

impl Bytes for Avx2 {
    /// Number of voxels in a register.
    const N: usize = 32;
    type V = __m256i;

    operations! {
        fn splat(v: u8) -> __m256i { _mm256_set1_epi8(v.cast_signed()) }
        fn min(a: __m256i, b: __m256i) -> __m256i { _mm256_min_epu8(a, b) }
        fn add(a: __m256i, b: __m256i) -> __m256i { _mm256_adds_epu8(a, b) }
        fn is_zero(v: __m256i) -> bool { _mm256_testz_si256(v, v) == 1 }
        fn same(a: __m256i, b: __m256i) -> bool { _mm256_movemask_epi8(_mm256_cmpeq_epi8(a, b)) == -1 }
        fn previous(before: __m256i, v: __m256i) -> __m256i {
            _mm256_alignr_epi8::<15>(v, _mm256_permute2x128_si256::<0x21>(before, v))
        }
        fn next(v: __m256i, after: __m256i) -> __m256i {
            _mm256_alignr_epi8::<1>(_mm256_permute2x128_si256::<0x21>(v, after), v)
        }
        fn expand(bits: u64) -> __m256i {{
            // Byte n gets the byte that contains bit n, keeps only that bit, and becomes 255 if the bit is set.
            let byte = _mm256_setr_epi8(
                0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3, 3,
            );
            let bit = _mm256_set1_epi64x(0x8040_2010_0804_0201_u64.cast_signed());
            let spread = _mm256_shuffle_epi8(_mm256_set1_epi32((bits as u32).cast_signed()), byte);
            _mm256_cmpeq_epi8(_mm256_and_si256(spread, bit), bit)
        }}
        fn spread(v: __m256i) -> __m256i {{
            let full = _mm256_set1_epi8(-1);
            let mut v = v;
            macro_rules! step {
                ($s:literal, $up:expr, $down:expr) => {
                    let near = _mm256_min_epu8($up, $down);
                    v = _mm256_min_epu8(v, _mm256_adds_epu8(near, _mm256_set1_epi8($s)));
                };
            }
            macro_rules! bytes {
                ($s:literal, $rest:literal) => {
                    step!(
                        $s,
                        _mm256_alignr_epi8::<$rest>(v, _mm256_permute2x128_si256::<0x21>(full, v)),
                        _mm256_alignr_epi8::<$s>(_mm256_permute2x128_si256::<0x21>(v, full), v)
                    );
                };
            }
            bytes!(1, 15);
            bytes!(2, 14);
            bytes!(4, 12);
            bytes!(8, 8);
            step!(
                16,
                _mm256_permute2x128_si256::<0x21>(full, v),
                _mm256_permute2x128_si256::<0x21>(v, full)
            );
            v
        }}
        fn rising() -> __m256i { _mm256_loadu_si256(RISING.as_ptr().cast()) }
        fn falling() -> __m256i { _mm256_loadu_si256(FALLING[32..].as_ptr().cast()) }
    }

    #[inline(always)]
    unsafe fn load(self, at: *const u8) -> __m256i {
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that the
        // bytes are readable. Benchmark: crates/isoregion/benches/map.rs.
        unsafe { _mm256_loadu_si256(at.cast()) }
    }
    #[inline(always)]
    unsafe fn store(self, at: *mut u8, v: __m256i) {
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that the
        // bytes are writable.
        unsafe { _mm256_storeu_si256(at.cast(), v) }
    }
    #[inline(always)]
    unsafe fn equal64(self, a: *const u8, b: *const u8) -> u64 {
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that 64
        // bytes from `a` and from `b` are readable.
        unsafe {
            let first = _mm256_cmpeq_epi8(self.load(a), self.load(b));
            let second = _mm256_cmpeq_epi8(self.load(a.add(32)), self.load(b.add(32)));
            u64::from(_mm256_movemask_epi8(first).cast_unsigned())
                | u64::from(_mm256_movemask_epi8(second).cast_unsigned()) << 32
        }
    }
    #[inline(always)]
    unsafe fn within64(self, at: *const i16, lo: i16, width: u16) -> u64 {
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that 64
        // values from `at` are readable.
        unsafe {
            let (lo, width) = (
                _mm256_set1_epi16(lo),
                _mm256_set1_epi16(width.cast_signed()),
            );
            let first = within_bytes(at, lo, width);
            let second = within_bytes(at.add(32), lo, width);
            u64::from(_mm256_movemask_epi8(first).cast_unsigned())
                | u64::from(_mm256_movemask_epi8(second).cast_unsigned()) << 32
        }
    }
}

/// Instruction set SSE2, which needs no proof, because it is part of `x86_64`.
#[derive(Clone, Copy)]
pub(crate) struct Sse2;

impl Bytes for Sse2 {
    /// Number of voxels in a register.
    const N: usize = 16;
    type V = __m128i;

    operations! {
        fn splat(v: u8) -> __m128i { _mm_set1_epi8(v.cast_signed()) }
        fn min(a: __m128i, b: __m128i) -> __m128i { _mm_min_epu8(a, b) }
        fn add(a: __m128i, b: __m128i) -> __m128i { _mm_adds_epu8(a, b) }
        fn is_zero(v: __m128i) -> bool { _mm_movemask_epi8(_mm_cmpeq_epi8(v, _mm_setzero_si128())) == 0xffff }
        fn same(a: __m128i, b: __m128i) -> bool { _mm_movemask_epi8(_mm_cmpeq_epi8(a, b)) == 0xffff }
        fn previous(before: __m128i, v: __m128i) -> __m128i {
            _mm_or_si128(_mm_slli_si128::<1>(v), _mm_srli_si128::<15>(before))
        }
        fn next(v: __m128i, after: __m128i) -> __m128i {
            _mm_or_si128(_mm_srli_si128::<1>(v), _mm_slli_si128::<15>(after))
        }
        fn expand(bits: u64) -> __m128i {{
            // Eight copies of each of two bytes, of which byte n keeps only bit n and becomes 255 if the bit is set.
            let eight = |n: u64| _mm_set1_epi8((bits >> n) as i8);
            let bit = _mm_set1_epi64x(0x8040_2010_0804_0201_u64.cast_signed());
            let spread = _mm_unpacklo_epi64(eight(0), eight(8));
            _mm_cmpeq_epi8(_mm_and_si128(spread, bit), bit)
        }}
        fn spread(v: __m128i) -> __m128i {{
            let full = _mm_set1_epi8(-1);
            let mut v = v;
            macro_rules! step {
                ($s:literal, $rest:literal) => {
                    let up = _mm_or_si128(_mm_slli_si128::<$s>(v), _mm_srli_si128::<$rest>(full));
                    let down = _mm_or_si128(_mm_srli_si128::<$s>(v), _mm_slli_si128::<$rest>(full));
                    v = _mm_min_epu8(v, _mm_adds_epu8(_mm_min_epu8(up, down), _mm_set1_epi8($s)));
                };
            }
            step!(1, 15);
            step!(2, 14);
            step!(4, 12);
            step!(8, 8);
            v
        }}
        fn rising() -> __m128i { _mm_loadu_si128(RISING.as_ptr().cast()) }
        fn falling() -> __m128i { _mm_loadu_si128(FALLING[48..].as_ptr().cast()) }
    }

    #[inline(always)]
    unsafe fn load(self, at: *const u8) -> __m128i {
        // SAFETY: every x86_64 has SSE2, and the caller guarantees that the bytes are readable. Benchmark:
        // crates/isoregion/benches/map.rs.
        unsafe { _mm_loadu_si128(at.cast()) }
    }
    #[inline(always)]
    unsafe fn store(self, at: *mut u8, v: __m128i) {
        // SAFETY: every x86_64 has SSE2, and the caller guarantees that the bytes are writable.
        unsafe { _mm_storeu_si128(at.cast(), v) }
    }
    #[inline(always)]
    unsafe fn equal64(self, a: *const u8, b: *const u8) -> u64 {
        let mut out = 0;
        for n in [0, 16, 32, 48] {
            // SAFETY: every x86_64 has SSE2, and the caller guarantees that 64 bytes from `a` and from `b` are
            // readable.
            let bits = unsafe {
                _mm_movemask_epi8(_mm_cmpeq_epi8(self.load(a.add(n)), self.load(b.add(n))))
            };
            out |= u64::from(bits.cast_unsigned()) << n;
        }
        out
    }
    #[inline(always)]
    unsafe fn within64(self, at: *const i16, lo: i16, width: u16) -> u64 {
        let mut out = 0;
        for n in [0, 16, 32, 48] {
            // SAFETY: every x86_64 has SSE2, and the caller guarantees that 64 values from `at` are readable.
            let bits = unsafe {
                let (lo, width) = (_mm_set1_epi16(lo), _mm_set1_epi16(width.cast_signed()));
                // Unsigned comparison: v <= width if v - width, saturated at 0, is 0.
                let first =
                    _mm_subs_epu16(_mm_sub_epi16(_mm_loadu_si128(at.add(n).cast()), lo), width);
                let second = _mm_subs_epu16(
                    _mm_sub_epi16(_mm_loadu_si128(at.add(n + 8).cast()), lo),
                    width,
                );
                let zero = _mm_setzero_si128();
                let first = _mm_cmpeq_epi16(first, zero);
                _mm_movemask_epi8(_mm_packs_epi16(first, _mm_cmpeq_epi16(second, zero)))
            };
            out |= u64::from(bits.cast_unsigned()) << n;
        }
        out
    }
}

/// Return bytes of 255 where 32 values from `at` are in `lo ..= lo + width`.
///
/// # Safety
///
/// The machine must have AVX2, and the values must be readable.
#[inline(always)]
unsafe fn within_bytes(at: *const i16, lo: __m256i, width: __m256i) -> __m256i {
    // SAFETY: the caller guarantees AVX2 and that the values are readable.
    unsafe {
        let first = _mm256_sub_epi16(_mm256_loadu_si256(at.cast()), lo);
        let second = _mm256_sub_epi16(_mm256_loadu_si256(at.add(16).cast()), lo);
        // AVX2 has no unsigned comparison, but v <= width if the larger of both is width.
        let first = _mm256_cmpeq_epi16(_mm256_max_epu16(first, width), width);
        let second = _mm256_cmpeq_epi16(_mm256_max_epu16(second, width), width);
        // Packing works within halves, so the quarters are put back in order.
        _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_packs_epi16(first, second))
    }
}
