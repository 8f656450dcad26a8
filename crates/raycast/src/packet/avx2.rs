//! AVX2 and FMA: instruction set with eight lanes.
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

/// Instruction set AVX2 and FMA; a value proves that the machine has both.
#[derive(Clone, Copy)]
pub(super) struct Avx2 {
    /// Whether pairs of voxels are read by gather instructions.
    gathers: bool,
}

impl Avx2 {
    /// Create the proof that the machine has the instruction set.
    ///
    /// `gathers` selects gather instructions for reads of voxel pairs ([`super::gathers`]).
    ///
    /// # Safety
    ///
    /// The machine must have AVX2 and FMA.
    #[inline(always)]
    pub(super) const unsafe fn new(gathers: bool) -> Self {
        Self { gathers }
    }
}

/// For each mask of eight lanes and each lane, the index of the packed value that the lane receives.
static TURN: [[i32; 8]; 256] = {
    let mut turns = [[0; 8]; 256];
    let mut mask = 0;
    while mask < 256 {
        let (mut lane, mut turn) = (0, 0);
        while lane < 8 {
            if mask >> lane & 1 == 1 {
                turns[mask][lane] = turn;
                turn += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    turns
};

/// For each mask of eight lanes, the indices of the mask's lanes in ascending order.
static PLACE: [[i32; 8]; 256] = {
    let mut places = [[0; 8]; 256];
    let mut mask = 0;
    while mask < 256 {
        let (mut lane, mut turn) = (0, 0);
        while lane < 8 {
            if mask >> lane & 1 == 1 {
                places[mask][turn] = lane;
                turn += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    places
};

/// Return a register with all bits of a lane set for each set bit of `bits`.
///
/// # Safety
///
/// The machine must have AVX2.
#[inline(always)]
unsafe fn lanes_of(bits: u32) -> __m256i {
    // SAFETY: the caller guarantees AVX2.
    unsafe {
        let bit = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
        _mm256_cmpeq_epi32(_mm256_and_si256(_mm256_set1_epi32(bits as i32), bit), bit)
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

/// Return one register that contains two halves.
///
/// # Safety
///
/// The machine must have AVX2.
#[inline(always)]
unsafe fn whole_of([a, b]: [__m128i; 2]) -> __m256i {
    // SAFETY: the caller guarantees AVX2.
    unsafe { _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(a), b) }
}

impl Lanes for Avx2 {
    /// Number of lanes of a register, each with one ray.
    const N: usize = 8;
    type F = __m256;
    type I = __m256i;
    type M = __m256i;

    operations! {
        fn splat(v: f32) -> __m256 { _mm256_set1_ps(v) }
        fn splat_i(v: i32) -> __m256i { _mm256_set1_epi32(v) }
        fn store(v: __m256) -> Array<f32> {{
            let mut out = [0.0; MAX_LANES];
            _mm256_storeu_ps(out.as_mut_ptr(), v);
            out
        }}
        fn store_i(v: __m256i) -> Array<i32> {{
            let mut out = [0; MAX_LANES];
            _mm256_storeu_si256(out.as_mut_ptr().cast(), v);
            out
        }}
        fn load_i(values: &Array<i32>) -> __m256i { _mm256_loadu_si256(values.as_ptr().cast()) }
        fn add(a: __m256, b: __m256) -> __m256 { _mm256_add_ps(a, b) }
        fn sub(a: __m256, b: __m256) -> __m256 { _mm256_sub_ps(a, b) }
        fn mul(a: __m256, b: __m256) -> __m256 { _mm256_mul_ps(a, b) }
        fn div(a: __m256, b: __m256) -> __m256 { _mm256_div_ps(a, b) }
        fn fma(a: __m256, b: __m256, c: __m256) -> __m256 { _mm256_fmadd_ps(a, b, c) }
        fn min(a: __m256, b: __m256) -> __m256 { _mm256_min_ps(a, b) }
        fn max(a: __m256, b: __m256) -> __m256 { _mm256_max_ps(a, b) }
        fn abs(a: __m256) -> __m256 {
            _mm256_and_ps(a, _mm256_castsi256_ps(_mm256_set1_epi32(i32::MAX)))
        }
        fn sqrt(a: __m256) -> __m256 { _mm256_sqrt_ps(a) }
        fn floor(a: __m256) -> __m256 { _mm256_floor_ps(a) }
        fn less(a: __m256, b: __m256) -> __m256i { _mm256_castps_si256(_mm256_cmp_ps::<_CMP_LT_OQ>(a, b)) }
        fn select(mask: __m256i, yes: __m256, no: __m256) -> __m256 {
            _mm256_blendv_ps(no, yes, _mm256_castsi256_ps(mask))
        }

        fn add_i(a: __m256i, b: __m256i) -> __m256i { _mm256_add_epi32(a, b) }
        fn sub_i(a: __m256i, b: __m256i) -> __m256i { _mm256_sub_epi32(a, b) }
        fn mul_i(a: __m256i, b: __m256i) -> __m256i { _mm256_mullo_epi32(a, b) }
        fn min_i(a: __m256i, b: __m256i) -> __m256i { _mm256_min_epi32(a, b) }
        fn max_i(a: __m256i, b: __m256i) -> __m256i { _mm256_max_epi32(a, b) }
        fn less_i(a: __m256i, b: __m256i) -> __m256i { _mm256_cmpgt_epi32(b, a) }
        fn select_i(mask: __m256i, yes: __m256i, no: __m256i) -> __m256i { _mm256_blendv_epi8(no, yes, mask) }

        fn whole(a: __m256) -> __m256i { _mm256_cvttps_epi32(a) }
        fn to_f(a: __m256i) -> __m256 { _mm256_cvtepi32_ps(a) }

        fn mask(bits: u32) -> __m256i { lanes_of(bits) }
        fn bits(a: __m256i) -> u32 { _mm256_movemask_ps(_mm256_castsi256_ps(a)) as u32 }
        fn and(a: __m256i, b: __m256i) -> __m256i { _mm256_and_si256(a, b) }
        fn or(a: __m256i, b: __m256i) -> __m256i { _mm256_or_si256(a, b) }
        fn without(a: __m256i, b: __m256i) -> __m256i { _mm256_andnot_si256(b, a) }

        fn quarters(a: __m256i) -> __m256i { _mm256_srli_epi32::<2>(a) }
        fn modulo_4(a: __m256i) -> __m256i { _mm256_and_si256(a, _mm256_set1_epi32(3)) }

        fn low_byte(a: __m256i) -> __m256i { _mm256_and_si256(a, _mm256_set1_epi32(0xff)) }
        fn second_byte(a: __m256i) -> __m256i {
            _mm256_and_si256(_mm256_srli_epi32::<8>(a), _mm256_set1_epi32(0xff))
        }

        // The products with 1, 0 and -1, added in pairs as i32, cannot overflow.
        fn first(pair: __m256i) -> __m256i { _mm256_madd_epi16(pair, _mm256_set1_epi32(1)) }
        fn second(pair: __m256i) -> __m256i { _mm256_srai_epi32::<16>(pair) }
        fn rise(pair: __m256i) -> __m256i { _mm256_madd_epi16(pair, _mm256_set1_epi32(0x0001_ffff)) }
    }

    #[inline(always)]
    fn fill(self, old: __m256, mask: u32, values: &[f32]) -> __m256 {
        let values = &values[..Self::N];
        // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole arrays.
        unsafe {
            let values = _mm256_loadu_ps(values.as_ptr());
            let turn = _mm256_loadu_si256(TURN[(mask & 255) as usize].as_ptr().cast());
            let new = _mm256_permutevar8x32_ps(values, turn);
            _mm256_blendv_ps(old, new, _mm256_castsi256_ps(lanes_of(mask)))
        }
    }
    #[inline(always)]
    fn fill_i(self, old: __m256i, mask: u32, values: &[i32]) -> __m256i {
        let values = &values[..Self::N];
        // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole arrays.
        unsafe {
            let values = _mm256_loadu_si256(values.as_ptr().cast());
            let turn = _mm256_loadu_si256(TURN[(mask & 255) as usize].as_ptr().cast());
            let new = _mm256_permutevar8x32_epi32(values, turn);
            _mm256_blendv_epi8(old, new, lanes_of(mask))
        }
    }
    #[inline(always)]
    fn put(self, v: __m256, mask: u32, out: &mut [f32]) {
        let out = &mut out[..Self::N];
        // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole arrays.
        unsafe {
            let lane = _mm256_loadu_si256(PLACE[(mask & 255) as usize].as_ptr().cast());
            _mm256_storeu_ps(out.as_mut_ptr(), _mm256_permutevar8x32_ps(v, lane));
        }
    }
    #[inline(always)]
    fn put_i(self, v: __m256i, mask: u32, out: &mut [i32]) {
        let out = &mut out[..Self::N];
        // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole arrays.
        unsafe {
            let lane = _mm256_loadu_si256(PLACE[(mask & 255) as usize].as_ptr().cast());
            let packed = _mm256_permutevar8x32_epi32(v, lane);
            _mm256_storeu_si256(out.as_mut_ptr().cast(), packed);
        }
    }

    #[inline(always)]
    unsafe fn pairs<const R: usize>(
        self,
        data: *const i16,
        base: __m256i,
        offsets: [i32; R],
    ) -> [__m256i; R] {
        let mut out = [base; R];
        if self.gathers {
            for n in 0..R {
                // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that
                // every pair is in the data.
                out[n] = unsafe {
                    _mm256_i32gather_epi32::<2>(data.offset(offsets[n] as isize).cast(), base)
                };
            }
            return out;
        }
        let index = self.store_i(base);
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that every
        // pair is in the data. Four lanes are read at a time, so that their addresses stay in registers for all
        // offsets.
        unsafe {
            let mut parts = [[_mm_setzero_si128(); 2]; R];
            for part in 0..2 {
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
        base: __m256i,
        offsets: [i32; R],
    ) -> [[__m256i; 2]; R] {
        let index = self.store_i(base);
        let mut out = [[base; 2]; R];
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that all
        // four voxels are in the data.
        unsafe {
            let mut parts = [[[_mm_setzero_si128(); 2]; 2]; R];
            for part in 0..2 {
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
        base: __m256i,
        offsets: [i32; R],
    ) -> [[__m256i; 4]; R] {
        let index = self.store_i(base);
        let mut out = [[base; 4]; R];
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that all
        // eight numbers are in the data.
        unsafe {
            let order = _mm256_broadcastsi128_si256(interleaved());
            let mut parts = [[_mm256_setzero_si256(); 4]; R];
            for part in 0..4 {
                let a = data.add(index[part] as u32 as usize);
                let b = data.add(index[part + 4] as u32 as usize);
                for n in 0..R {
                    let two = [eight_numbers(a, offsets[n]), eight_numbers(b, offsets[n])];
                    parts[n][part] = _mm256_shuffle_epi8(whole_of(two), order);
                }
            }
            for n in 0..R {
                let [a, b, c, d] = parts[n];
                let (ab_lo, ab_hi) = (_mm256_unpacklo_epi32(a, b), _mm256_unpackhi_epi32(a, b));
                let (cd_lo, cd_hi) = (_mm256_unpacklo_epi32(c, d), _mm256_unpackhi_epi32(c, d));
                out[n] = [
                    _mm256_unpacklo_epi64(ab_lo, cd_lo),
                    _mm256_unpackhi_epi64(ab_lo, cd_lo),
                    _mm256_unpacklo_epi64(ab_hi, cd_hi),
                    _mm256_unpackhi_epi64(ab_hi, cd_hi),
                ];
            }
        }
        out
    }

    #[inline(always)]
    unsafe fn links(self, table: *const AtomicI32, index: __m256i) -> __m256i {
        let index = self.store_i(index);
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that each
        // lane's link is in the table.
        unsafe { whole_of([four_links(table, &index, 0), four_links(table, &index, 4)]) }
    }

    #[inline(always)]
    unsafe fn voxels(self, data: *const i16, index: __m256i) -> __m256i {
        let index = self.store_i(index);
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that the
        // voxel is in the data.
        unsafe { _mm256_cvtepi16_epi32(eight_voxels(data, &index, 0)) }
    }

    #[inline(always)]
    unsafe fn bytes(self, data: *const u8, index: __m256i) -> __m256i {
        let index = self.store_i(index);
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that the
        // byte is in the data.
        unsafe {
            let (a, b) = (four_bytes(data, &index, 0), four_bytes(data, &index, 4));
            _mm256_cvtepu8_epi32(_mm_unpacklo_epi32(a, b))
        }
    }

    #[inline(always)]
    unsafe fn entries(self, table: *const [f32; 4], index: __m256i) -> [__m256; 4] {
        let at = self.store_i(index);
        // SAFETY: `self` is created only if the CPU has the instructions, and the caller guarantees that each
        // lane's entry is in the table. Eight loads of four numbers and a transposition need a quarter of the loads of
        // four gathers.
        unsafe {
            let entry = |n: usize| _mm_loadu_ps(table.add(at[n] as usize).cast());
            let two = |n: usize| {
                _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(entry(n)), entry(n + 4))
            };
            let (a, b, c, d) = (two(0), two(1), two(2), two(3));
            let (ab_lo, ab_hi) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
            let (cd_lo, cd_hi) = (_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
            [
                _mm256_shuffle_ps::<0x44>(ab_lo, cd_lo),
                _mm256_shuffle_ps::<0xee>(ab_lo, cd_lo),
                _mm256_shuffle_ps::<0x44>(ab_hi, cd_hi),
                _mm256_shuffle_ps::<0xee>(ab_hi, cd_hi),
            ]
        }
    }
}
