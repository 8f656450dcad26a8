//! AVX-512 F, BW, DQ and VL: instruction set with sixteen lanes.
#![allow(
    clippy::wildcard_imports,
    reason = "half a hundred intrinsics, each named in full where it is used"
)]

use std::{arch::x86_64::*, sync::atomic::AtomicI32};

use super::{
    lanes::{Array, Lanes, MAX_LANES},
    loads::{
        eight_numbers, eight_voxels, four_bytes, four_links, four_pairs, four_quads, interleaved,
        lane_pointers,
    },
};

/// Instruction set AVX-512 F, BW, DQ and VL; a value proves that the machine has all of them.
#[derive(Clone, Copy)]
pub(super) struct Avx512 {
    /// Whether pairs of voxels are read by gather instructions.
    gathers: bool,
}

impl Avx512 {
    /// Create the proof that the machine has the instruction set.
    ///
    /// `gathers` selects gather instructions for reads of voxel pairs ([`super::gathers`]).
    ///
    /// # Safety
    ///
    /// The machine must have AVX-512 F, BW, DQ and VL.
    #[inline(always)]
    pub(super) const unsafe fn new(gathers: bool) -> Self {
        Self { gathers }
    }
}

/// Macro that defines the operations that consist of one or a few instructions.
macro_rules! operations {
    ($(fn $name:ident($($arg:ident: $type:ty),*) -> $out:ty { $body:expr })*) => {$(
        #[inline(always)]
        fn $name(self, $($arg: $type),*) -> $out {
            // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole
            // arrays. Benchmark: benchmarks/measurements/rendering.md.
            unsafe { $body }
        }
    )*};
}

/// Return one register that contains four quarters.
///
/// # Safety
///
/// The machine must have AVX-512 F.
#[inline(always)]
unsafe fn whole_of([a, b, c, d]: [__m128i; 4]) -> __m512i {
    // SAFETY: the caller guarantees AVX-512 F.
    unsafe {
        let ab = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(a), b);
        let cd = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(c), d);
        _mm512_inserti64x4::<1>(_mm512_castsi256_si512(ab), cd)
    }
}

impl Lanes for Avx512 {
    /// Number of lanes of a register, each with one ray.
    const N: usize = 16;
    type F = __m512;
    type I = __m512i;
    type M = __mmask16;

    operations! {
        fn splat(v: f32) -> __m512 { _mm512_set1_ps(v) }
        fn splat_i(v: i32) -> __m512i { _mm512_set1_epi32(v) }
        fn store(v: __m512) -> Array<f32> {{
            let mut out = [0.0; MAX_LANES];
            _mm512_storeu_ps(out.as_mut_ptr(), v);
            out
        }}
        fn store_i(v: __m512i) -> Array<i32> {{
            let mut out = [0; MAX_LANES];
            _mm512_storeu_si512(out.as_mut_ptr().cast(), v);
            out
        }}
        fn load_i(values: &Array<i32>) -> __m512i { _mm512_loadu_si512(values.as_ptr().cast()) }
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

        fn quarters(a: __m512i) -> __m512i { _mm512_srli_epi32::<2>(a) }
        fn modulo_4(a: __m512i) -> __m512i { _mm512_and_si512(a, _mm512_set1_epi32(3)) }

        fn low_byte(a: __m512i) -> __m512i { _mm512_and_si512(a, _mm512_set1_epi32(0xff)) }
        fn second_byte(a: __m512i) -> __m512i {
            _mm512_and_si512(_mm512_srli_epi32::<8>(a), _mm512_set1_epi32(0xff))
        }

        // The products with 1, 0 and -1, added in pairs as i32, cannot overflow.
        fn first(pair: __m512i) -> __m512i { _mm512_madd_epi16(pair, _mm512_set1_epi32(1)) }
        fn second(pair: __m512i) -> __m512i { _mm512_srai_epi32::<16>(pair) }
        fn rise(pair: __m512i) -> __m512i { _mm512_madd_epi16(pair, _mm512_set1_epi32(0x0001_ffff)) }
    }

    #[inline(always)]
    fn fill(self, old: __m512, mask: u32, values: &[f32]) -> __m512 {
        let values = &values[..Self::N];
        // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole arrays.
        unsafe { _mm512_mask_expand_ps(old, mask as u16, _mm512_loadu_ps(values.as_ptr())) }
    }
    #[inline(always)]
    fn fill_i(self, old: __m512i, mask: u32, values: &[i32]) -> __m512i {
        let values = &values[..Self::N];
        // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole arrays.
        unsafe {
            let values = _mm512_loadu_si512(values.as_ptr().cast());
            _mm512_mask_expand_epi32(old, mask as u16, values)
        }
    }
    #[inline(always)]
    fn put(self, v: __m512, mask: u32, out: &mut [f32]) {
        let out = &mut out[..Self::N];
        // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole arrays.
        unsafe {
            _mm512_storeu_ps(out.as_mut_ptr(), _mm512_maskz_compress_ps(mask as u16, v));
        }
    }
    #[inline(always)]
    fn put_i(self, v: __m512i, mask: u32, out: &mut [i32]) {
        let out = &mut out[..Self::N];
        // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole arrays.
        unsafe {
            let packed = _mm512_maskz_compress_epi32(mask as u16, v);
            _mm512_storeu_si512(out.as_mut_ptr().cast(), packed);
        }
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
    fn or(self, a: __mmask16, b: __mmask16) -> __mmask16 {
        a | b
    }
    #[inline(always)]
    fn without(self, a: __mmask16, b: __mmask16) -> __mmask16 {
        a & !b
    }

    #[inline(always)]
    unsafe fn pairs<const R: usize>(
        self,
        data: *const i16,
        base: __m512i,
        offsets: [i32; R],
    ) -> [__m512i; R] {
        let mut out = [base; R];
        if self.gathers {
            for n in 0..R {
                // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that
                // every pair is in the data.
                out[n] = unsafe {
                    _mm512_i32gather_epi32::<2>(base, data.offset(offsets[n] as isize).cast())
                };
            }
            return out;
        }
        let index = self.store_i(base);
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that every
        // pair is in the data. Four lanes are read at a time, so that their addresses stay in registers for all
        // offsets.
        unsafe {
            let mut parts = [[_mm_setzero_si128(); 4]; R];
            for part in 0..4 {
                let lanes = lane_pointers(data, &index, 4 * part);
                for n in 0..R {
                    parts[n][part] = four_pairs(lanes, offsets[n]);
                }
            }
            for n in 0..R {
                out[n] = whole_of(parts[n]);
            }
        }
        out
    }

    #[inline(always)]
    unsafe fn quads<const R: usize>(
        self,
        data: *const i16,
        base: __m512i,
        offsets: [i32; R],
    ) -> [[__m512i; 2]; R] {
        let index = self.store_i(base);
        let mut out = [[base; 2]; R];
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that all
        // four voxels are in the data.
        unsafe {
            let mut parts = [[[_mm_setzero_si128(); 4]; 2]; R];
            for part in 0..4 {
                let lanes = lane_pointers(data, &index, 4 * part);
                for n in 0..R {
                    let [first, second] = four_quads(lanes, offsets[n]);
                    parts[n][0][part] = first;
                    parts[n][1][part] = second;
                }
            }
            for n in 0..R {
                out[n] = [whole_of(parts[n][0]), whole_of(parts[n][1])];
            }
        }
        out
    }

    #[inline(always)]
    unsafe fn quadruples<const R: usize>(
        self,
        data: *const i16,
        base: __m512i,
        offsets: [i32; R],
    ) -> [[__m512i; 4]; R] {
        let index = self.store_i(base);
        let mut out = [[base; 4]; R];
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that all
        // eight numbers are in the data.
        unsafe {
            let order = _mm512_broadcast_i32x4(interleaved());
            let mut parts = [[_mm512_setzero_si512(); 4]; R];
            for part in 0..4 {
                let a = data.add(index[part] as u32 as usize);
                let b = data.add(index[part + 4] as u32 as usize);
                let c = data.add(index[part + 8] as u32 as usize);
                let d = data.add(index[part + 12] as u32 as usize);
                for n in 0..R {
                    let four = [
                        eight_numbers(a, offsets[n]),
                        eight_numbers(b, offsets[n]),
                        eight_numbers(c, offsets[n]),
                        eight_numbers(d, offsets[n]),
                    ];
                    parts[n][part] = _mm512_shuffle_epi8(whole_of(four), order);
                }
            }
            for n in 0..R {
                let [a, b, c, d] = parts[n];
                let (ab_lo, ab_hi) = (_mm512_unpacklo_epi32(a, b), _mm512_unpackhi_epi32(a, b));
                let (cd_lo, cd_hi) = (_mm512_unpacklo_epi32(c, d), _mm512_unpackhi_epi32(c, d));
                out[n] = [
                    _mm512_unpacklo_epi64(ab_lo, cd_lo),
                    _mm512_unpackhi_epi64(ab_lo, cd_lo),
                    _mm512_unpacklo_epi64(ab_hi, cd_hi),
                    _mm512_unpackhi_epi64(ab_hi, cd_hi),
                ];
            }
        }
        out
    }

    #[inline(always)]
    unsafe fn links(self, table: *const AtomicI32, index: __m512i) -> __m512i {
        let index = self.store_i(index);
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that each
        // lane's link is in the table.
        unsafe {
            whole_of([
                four_links(table, &index, 0),
                four_links(table, &index, 4),
                four_links(table, &index, 8),
                four_links(table, &index, 12),
            ])
        }
    }

    #[inline(always)]
    unsafe fn voxels(self, data: *const i16, index: __m512i) -> __m512i {
        let index = self.store_i(index);
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that the
        // voxel is in the data.
        unsafe {
            let (a, b) = (eight_voxels(data, &index, 0), eight_voxels(data, &index, 8));
            _mm512_cvtepi16_epi32(_mm256_inserti128_si256::<1>(_mm256_castsi128_si256(a), b))
        }
    }

    #[inline(always)]
    unsafe fn bytes(self, data: *const u8, index: __m512i) -> __m512i {
        let index = self.store_i(index);
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that the
        // byte is in the data.
        unsafe {
            let (a, b) = (four_bytes(data, &index, 0), four_bytes(data, &index, 4));
            let (c, d) = (four_bytes(data, &index, 8), four_bytes(data, &index, 12));
            let (ab, cd) = (_mm_unpacklo_epi32(a, b), _mm_unpacklo_epi32(c, d));
            _mm512_cvtepu8_epi32(_mm_unpacklo_epi64(ab, cd))
        }
    }

    #[inline(always)]
    unsafe fn entries(self, table: *const [f32; 4], index: __m512i) -> [__m512; 4] {
        let at = self.store_i(index);
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that each
        // lane's entry is in the table. Sixteen loads of four numbers and a transposition need a quarter of the loads
        // of four gathers.
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
