//! Sixteen rays: AVX-512 F, BW, DQ and VL.

use std::arch::x86_64::{
    __m512, __m512i, __mmask16, _CMP_LT_OQ, _MM_FROUND_NO_EXC, _MM_FROUND_TO_NEG_INF, _mm_loadu_ps,
    _mm512_abs_ps, _mm512_add_epi32, _mm512_add_ps, _mm512_and_si512, _mm512_castps128_ps512,
    _mm512_castsi512_si256, _mm512_cmp_ps_mask, _mm512_cmplt_epi32_mask, _mm512_cvtepi32_ps,
    _mm512_cvttps_epi32, _mm512_div_ps, _mm512_extracti64x4_epi64, _mm512_fmadd_ps,
    _mm512_i32gather_epi32, _mm512_i32gather_epi64, _mm512_insertf32x4, _mm512_loadu_ps,
    _mm512_loadu_si512, _mm512_madd_epi16, _mm512_mask_blend_epi32, _mm512_mask_blend_ps,
    _mm512_mask_expand_epi32, _mm512_mask_expand_ps, _mm512_maskz_compress_epi32,
    _mm512_maskz_compress_ps, _mm512_max_epi32, _mm512_max_ps, _mm512_min_epi32, _mm512_min_ps,
    _mm512_mul_ps, _mm512_mullo_epi32, _mm512_permutex2var_epi32, _mm512_roundscale_ps,
    _mm512_set1_epi32, _mm512_set1_ps, _mm512_setr_epi32, _mm512_shuffle_ps, _mm512_slli_epi32,
    _mm512_sqrt_ps, _mm512_srai_epi32, _mm512_srlv_epi32, _mm512_storeu_ps, _mm512_storeu_si512,
    _mm512_sub_epi32, _mm512_sub_ps, _mm512_unpackhi_ps, _mm512_unpacklo_ps,
};

use super::lanes::{Array, Lanes};

/// The machine has AVX-512 F, BW, DQ and VL.
#[derive(Clone, Copy)]
pub(super) struct Avx512(());

impl Avx512 {
    /// The proof.
    ///
    /// # Safety
    /// The machine must have AVX-512 F, BW, DQ and VL.
    #[inline(always)]
    pub(super) unsafe fn new() -> Self {
        Self(())
    }
}

/// Each operation is one or a few instructions.
macro_rules! operations {
    ($(fn $name:ident($($arg:ident: $type:ty),*) -> $out:ty { $body:expr })*) => {$(
        #[inline(always)]
        fn $name(self, $($arg: $type),*) -> $out {
            // SAFETY: `self` exists only where the machine has the instructions; loads and stores are of whole arrays.
            // Benchmark: docs/decisions/0003-packets.md.
            unsafe { $body }
        }
    )*};
}

impl Lanes for Avx512 {
    const N: usize = 16;
    type F = __m512;
    type I = __m512i;
    type M = __mmask16;

    operations! {
        fn splat(v: f32) -> __m512 { _mm512_set1_ps(v) }
        fn splat_i(v: i32) -> __m512i { _mm512_set1_epi32(v) }
        fn store(v: __m512) -> Array<f32> {{
            let mut out = [0.0; 16];
            _mm512_storeu_ps(out.as_mut_ptr(), v);
            out
        }}
        fn store_i(v: __m512i) -> Array<i32> {{
            let mut out = [0; 16];
            _mm512_storeu_si512(out.as_mut_ptr().cast(), v);
            out
        }}
        fn fill(old: __m512, mask: u32, values: &Array<f32>) -> __m512 {
            _mm512_mask_expand_ps(old, mask as u16, _mm512_loadu_ps(values.as_ptr()))
        }
        fn fill_i(old: __m512i, mask: u32, values: &Array<i32>) -> __m512i {
            _mm512_mask_expand_epi32(old, mask as u16, _mm512_loadu_si512(values.as_ptr().cast()))
        }
        fn pack(v: __m512, mask: u32) -> __m512 { _mm512_maskz_compress_ps(mask as u16, v) }
        fn pack_i(v: __m512i, mask: u32) -> __m512i { _mm512_maskz_compress_epi32(mask as u16, v) }

        fn add(a: __m512, b: __m512) -> __m512 { _mm512_add_ps(a, b) }
        fn sub(a: __m512, b: __m512) -> __m512 { _mm512_sub_ps(a, b) }
        fn mul(a: __m512, b: __m512) -> __m512 { _mm512_mul_ps(a, b) }
        fn div(a: __m512, b: __m512) -> __m512 { _mm512_div_ps(a, b) }
        fn fma(a: __m512, b: __m512, c: __m512) -> __m512 { _mm512_fmadd_ps(a, b, c) }
        fn min(a: __m512, b: __m512) -> __m512 { _mm512_min_ps(a, b) }
        fn max(a: __m512, b: __m512) -> __m512 { _mm512_max_ps(a, b) }
        fn abs(a: __m512) -> __m512 { _mm512_abs_ps(a) }
        fn sqrt(a: __m512) -> __m512 { _mm512_sqrt_ps(a) }
        fn floor(a: __m512) -> __m512 {
            _mm512_roundscale_ps::<{ _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC }>(a)
        }
        fn less(a: __m512, b: __m512) -> __mmask16 { _mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, b) }
        fn select(mask: __mmask16, yes: __m512, no: __m512) -> __m512 { _mm512_mask_blend_ps(mask, no, yes) }

        fn add_i(a: __m512i, b: __m512i) -> __m512i { _mm512_add_epi32(a, b) }
        fn sub_i(a: __m512i, b: __m512i) -> __m512i { _mm512_sub_epi32(a, b) }
        fn mul_i(a: __m512i, b: __m512i) -> __m512i { _mm512_mullo_epi32(a, b) }
        fn min_i(a: __m512i, b: __m512i) -> __m512i { _mm512_min_epi32(a, b) }
        fn max_i(a: __m512i, b: __m512i) -> __m512i { _mm512_max_epi32(a, b) }
        fn less_i(a: __m512i, b: __m512i) -> __mmask16 { _mm512_cmplt_epi32_mask(a, b) }
        fn select_i(mask: __mmask16, yes: __m512i, no: __m512i) -> __m512i { _mm512_mask_blend_epi32(mask, no, yes) }

        fn whole(a: __m512) -> __m512i { _mm512_cvttps_epi32(a) }
        fn to_f(a: __m512i) -> __m512 { _mm512_cvtepi32_ps(a) }

        // Products with 1, 0 and -1, added in pairs, in i32: nothing can overflow.
        fn first(pair: __m512i) -> __m512i { _mm512_madd_epi16(pair, _mm512_set1_epi32(1)) }
        fn second(pair: __m512i) -> __m512i { _mm512_srai_epi32::<16>(pair) }
        fn rise(pair: __m512i) -> __m512i { _mm512_madd_epi16(pair, _mm512_set1_epi32(0x0001_ffff)) }
    }

    #[inline(always)]
    fn mask(self, bits: u32) -> __mmask16 {
        bits as __mmask16
    }
    #[inline(always)]
    fn bits(self, a: __mmask16) -> u32 {
        u32::from(a)
    }
    #[inline(always)]
    fn and(self, a: __mmask16, b: __mmask16) -> __mmask16 {
        a & b
    }
    #[inline(always)]
    fn without(self, a: __mmask16, b: __mmask16) -> __mmask16 {
        a & !b
    }

    #[inline(always)]
    unsafe fn pairs(self, data: *const i16, index: __m512i) -> __m512i {
        // SAFETY: as promised by the caller; a gather needs no alignment.
        unsafe { _mm512_i32gather_epi32::<2>(index, data.cast()) }
    }

    #[inline(always)]
    unsafe fn quads(self, data: *const i16, index: __m512i) -> [__m512i; 2] {
        // SAFETY: as promised by the caller; a gather needs no alignment.
        unsafe {
            let lo = _mm512_i32gather_epi64::<2>(_mm512_castsi512_si256(index), data.cast());
            let hi =
                _mm512_i32gather_epi64::<2>(_mm512_extracti64x4_epi64::<1>(index), data.cast());
            let even = _mm512_setr_epi32(0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30);
            let odd = _mm512_setr_epi32(1, 3, 5, 7, 9, 11, 13, 15, 17, 19, 21, 23, 25, 27, 29, 31);
            [
                _mm512_permutex2var_epi32(lo, even, hi),
                _mm512_permutex2var_epi32(lo, odd, hi),
            ]
        }
    }

    #[inline(always)]
    unsafe fn bytes(self, data: *const u8, last_word: i32, index: __m512i) -> __m512i {
        // SAFETY: 4 bytes from an index of at most `last_word` lie in the data, as promised by the caller.
        unsafe {
            let start = _mm512_min_epi32(index, _mm512_set1_epi32(last_word));
            let word = _mm512_i32gather_epi32::<1>(start, data.cast());
            let shift = _mm512_slli_epi32::<3>(_mm512_sub_epi32(index, start));
            _mm512_and_si512(_mm512_srlv_epi32(word, shift), _mm512_set1_epi32(255))
        }
    }

    #[inline(always)]
    unsafe fn entries(self, table: *const [f32; 4], index: __m512i) -> [__m512; 4] {
        let at = self.store_i(index);
        // SAFETY: each lane's entry lies in the table, as promised by the caller.
        // Sixteen loads of four numbers and a transposition: a quarter of the loads of four gathers.
        unsafe {
            let entry = |n: usize| _mm_loadu_ps(table.add(at[n] as usize).cast());
            let four = |n: usize| {
                let v = _mm512_castps128_ps512(entry(n));
                let v = _mm512_insertf32x4::<1>(v, entry(n + 4));
                let v = _mm512_insertf32x4::<2>(v, entry(n + 8));
                _mm512_insertf32x4::<3>(v, entry(n + 12))
            };
            let (a, b, c, d) = (four(0), four(1), four(2), four(3));
            let (ab_lo, ab_hi) = (_mm512_unpacklo_ps(a, b), _mm512_unpackhi_ps(a, b));
            let (cd_lo, cd_hi) = (_mm512_unpacklo_ps(c, d), _mm512_unpackhi_ps(c, d));
            [
                _mm512_shuffle_ps::<0x44>(ab_lo, cd_lo),
                _mm512_shuffle_ps::<0xee>(ab_lo, cd_lo),
                _mm512_shuffle_ps::<0x44>(ab_hi, cd_hi),
                _mm512_shuffle_ps::<0xee>(ab_hi, cd_hi),
            ]
        }
    }
}
