//! Vector operations on the costs (in quanta) and weights of sixteen voxels in a row along i.
//!
//! The sweeps of [`crate::field_sweep`] use them.
#![allow(
    clippy::inline_always,
    reason = "small functions of the inner loop, compiled once for each instruction set"
)]

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::Avx512;

/// Number of voxels that one vector register holds.
pub(crate) const LANES: usize = 16;
/// Length of a row of a tile's buffer: 16 lanes, one neighbour at each end, and padding for reads of whole registers.
pub(crate) const ROW: usize = 24;
/// Index, in a row of the buffer, of the first voxel of the tile; the voxels before it belong to the neighbouring tile.
pub(crate) const FIRST_VOXEL: usize = 4;

/// Cost in quanta of a voxel that no path has reached.
///
/// A step into or out of a wall costs more, and the sum of such a step and `UNREACHED` still fits in 32 bits.
pub(crate) const UNREACHED: u32 = i32::MAX as u32;

/// Instruction set with the operations that the sweeps need on 16 lanes.
///
/// A value of the implementing type proves that the machine has the instruction set.
pub(crate) trait Lanes: Copy {
    /// Register of costs in quanta, at most 2^31 each.
    type Costs: Copy;
    /// Register of weights; the weight of a wall is infinite.
    type Weights: Copy;

    fn costs(self, row: &[u32; ROW], at: usize) -> Self::Costs;
    fn weights(self, row: &[f32; ROW], at: usize) -> Self::Weights;
    fn store(self, costs: Self::Costs, row: &mut [u32; ROW], at: usize);
    /// Load costs that are stored as the differences [`UNREACHED`] minus cost.
    fn costs_of_left(self, left: &[i32; LANES]) -> Self::Costs;
    /// Store costs as the differences [`UNREACHED`] minus cost.
    fn store_left(self, costs: Self::Costs, left: &mut [i32; LANES]);
    /// Copy weights to a row of the buffer from index `at` on; NaN becomes infinity.
    fn copy_weights(self, from: &[f32; LANES], row: &mut [f32; ROW], at: usize);
    /// Store numbers below 256 as one byte each.
    fn store_bytes(self, numbers: Self::Costs, bytes: &mut [u8; LANES]);
    /// Return in each lane the cost of `a` if the lane's bit is set, otherwise that of `b`.
    fn select(self, bits: u16, a: Self::Costs, b: Self::Costs) -> Self::Costs;
    fn sum(self, a: Self::Weights, b: Self::Weights) -> Self::Weights;
    /// Return weights times `scale`, rounded to integer quanta (ties to even); 2^31 for infinite weights.
    fn quanta(self, weights: Self::Weights, scale: f32) -> Self::Costs;
    fn plus(self, a: Self::Costs, b: Self::Costs) -> Self::Costs;
    fn least(self, a: Self::Costs, b: Self::Costs) -> Self::Costs;
    /// Return a register with the same cost in all lanes.
    fn all(self, cost: u32) -> Self::Costs;
    /// Return one bit per lane, set if `a` is less than `b`.
    fn less(self, a: Self::Costs, b: Self::Costs) -> u16;
    /// Return one bit per lane, set if `a` and `b` are equal.
    fn equal(self, a: Self::Costs, b: Self::Costs) -> u16;
    /// Move costs to higher lanes: each lane gets the cost `N` lanes before it; the first `N` lanes become unreached.
    ///
    /// `N` is 1, 2, 4 or 8.
    fn up<const N: usize>(self, a: Self::Costs) -> Self::Costs;
    /// Move costs to lower lanes: each lane gets the cost `N` lanes after it; the last `N` lanes become unreached.
    ///
    /// `N` is 1, 2, 4 or 8.
    fn down<const N: usize>(self, a: Self::Costs) -> Self::Costs;
}

/// Instruction set of plain loops, which the compiler translates to the registers of the target.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Portable;

impl Lanes for Portable {
    type Costs = [u32; LANES];
    type Weights = [f32; LANES];

    #[inline(always)]
    fn costs(self, row: &[u32; ROW], at: usize) -> Self::Costs {
        std::array::from_fn(|lane| row[at + lane])
    }

    #[inline(always)]
    fn weights(self, row: &[f32; ROW], at: usize) -> Self::Weights {
        std::array::from_fn(|lane| row[at + lane])
    }

    #[inline(always)]
    fn store(self, costs: Self::Costs, row: &mut [u32; ROW], at: usize) {
        row[at..at + LANES].copy_from_slice(&costs);
    }

    #[inline(always)]
    fn costs_of_left(self, left: &[i32; LANES]) -> Self::Costs {
        std::array::from_fn(|lane| UNREACHED - left[lane] as u32)
    }

    #[inline(always)]
    fn store_left(self, costs: Self::Costs, left: &mut [i32; LANES]) {
        *left = std::array::from_fn(|lane| (UNREACHED - costs[lane]) as i32);
    }

    #[inline(always)]
    fn copy_weights(self, from: &[f32; LANES], row: &mut [f32; ROW], at: usize) {
        for lane in 0..LANES {
            row[at + lane] = open_weight(from[lane]);
        }
    }

    #[inline(always)]
    fn store_bytes(self, numbers: Self::Costs, bytes: &mut [u8; LANES]) {
        *bytes = numbers.map(|number| number as u8);
    }

    #[inline(always)]
    fn select(self, bits: u16, a: Self::Costs, b: Self::Costs) -> Self::Costs {
        std::array::from_fn(|lane| {
            if bits >> lane & 1 != 0 {
                a[lane]
            } else {
                b[lane]
            }
        })
    }

    #[inline(always)]
    fn sum(self, a: Self::Weights, b: Self::Weights) -> Self::Weights {
        std::array::from_fn(|lane| a[lane] + b[lane])
    }

    #[inline(always)]
    fn quanta(self, weights: Self::Weights, scale: f32) -> Self::Costs {
        weights.map(|weight| quanta(weight, scale))
    }

    #[inline(always)]
    fn plus(self, a: Self::Costs, b: Self::Costs) -> Self::Costs {
        std::array::from_fn(|lane| a[lane] + b[lane])
    }

    #[inline(always)]
    fn least(self, a: Self::Costs, b: Self::Costs) -> Self::Costs {
        std::array::from_fn(|lane| a[lane].min(b[lane]))
    }

    #[inline(always)]
    fn all(self, cost: u32) -> Self::Costs {
        [cost; LANES]
    }

    #[inline(always)]
    fn less(self, a: Self::Costs, b: Self::Costs) -> u16 {
        (0..LANES).fold(0, |bits, lane| bits | u16::from(a[lane] < b[lane]) << lane)
    }

    #[inline(always)]
    fn equal(self, a: Self::Costs, b: Self::Costs) -> u16 {
        (0..LANES).fold(0, |bits, lane| bits | u16::from(a[lane] == b[lane]) << lane)
    }

    #[inline(always)]
    fn up<const N: usize>(self, a: Self::Costs) -> Self::Costs {
        let mut moved = [UNREACHED; LANES];
        moved[N..].copy_from_slice(&a[..LANES - N]);
        moved
    }

    #[inline(always)]
    fn down<const N: usize>(self, a: Self::Costs) -> Self::Costs {
        let mut moved = [UNREACHED; LANES];
        moved[..LANES - N].copy_from_slice(&a[N..]);
        moved
    }
}

/// Return a weight unchanged, or infinity (a wall) for NaN.
#[inline(always)]
pub(crate) fn open_weight(weight: f32) -> f32 {
    if weight < f32::INFINITY {
        weight
    } else {
        f32::INFINITY
    }
}

/// Return a weight times `scale`, rounded to integer quanta; 2^31 if the weight is infinite.
#[inline(always)]
pub(crate) fn quanta(weight: f32, scale: f32) -> u32 {
    let quanta = weight * scale;
    if quanta < 8_388_608.0 {
        crate::field::rounded(quanta) as u32
    } else {
        1 << 31
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m512, __m512i, _mm_storeu_si128, _mm512_add_epi32, _mm512_add_ps, _mm512_alignr_epi32,
        _mm512_cmpeq_epu32_mask, _mm512_cmplt_epu32_mask, _mm512_cvtepi32_epi8, _mm512_cvtps_epi32,
        _mm512_loadu_ps, _mm512_loadu_si512, _mm512_mask_mov_epi32, _mm512_min_epu32,
        _mm512_min_ps, _mm512_mul_ps, _mm512_set1_epi32, _mm512_set1_ps, _mm512_storeu_ps,
        _mm512_storeu_si512, _mm512_sub_epi32,
    };

    use super::{LANES, Lanes, ROW, UNREACHED};

    /// Instruction set AVX-512 F; a value proves that the machine has it.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Avx512(());

    impl Avx512 {
        /// Create the proof that the machine has the instruction set.
        ///
        /// # Safety
        ///
        /// The machine must have AVX-512 F.
        #[inline(always)]
        pub(crate) unsafe fn new() -> Self {
            Self(())
        }
    }

    /// Macro that defines methods of [`Lanes`] which consist of one or a few instructions each.
    macro_rules! operations {
        ($(fn $name:ident$(<const $n:ident: usize>)?($($arg:ident: $type:ty),*) $(-> $out:ty)? { $body:expr })*) => {$(
            #[inline(always)]
            fn $name$(<const $n: usize>)?(self, $($arg: $type),*) $(-> $out)? {
                // SAFETY: `self` is created only if the CPU has the instructions; loads and stores are of whole
                // registers inside a row. Benchmark: benches/field.rs.
                unsafe { $body }
            }
        )*};
    }

    impl Lanes for Avx512 {
        type Costs = __m512i;
        type Weights = __m512;

        operations! {
            fn costs(row: &[u32; ROW], at: usize) -> __m512i {{
                assert!(at + LANES <= ROW);
                _mm512_loadu_si512(row.as_ptr().add(at).cast())
            }}
            fn weights(row: &[f32; ROW], at: usize) -> __m512 {{
                assert!(at + LANES <= ROW);
                _mm512_loadu_ps(row.as_ptr().add(at))
            }}
            fn store(costs: __m512i, row: &mut [u32; ROW], at: usize) {{
                assert!(at + LANES <= ROW);
                _mm512_storeu_si512(row.as_mut_ptr().add(at).cast(), costs);
            }}
            // Values that do not fit in an i32, infinity and NaN become 2^31; the others are rounded to the nearest
            // integer, ties to even.
            fn quanta(weights: __m512, scale: f32) -> __m512i {
                _mm512_cvtps_epi32(_mm512_mul_ps(weights, _mm512_set1_ps(scale)))
            }
            fn sum(a: __m512, b: __m512) -> __m512 { _mm512_add_ps(a, b) }
            fn costs_of_left(left: &[i32; LANES]) -> __m512i {
                _mm512_sub_epi32(_mm512_set1_epi32(UNREACHED as i32), _mm512_loadu_si512(left.as_ptr().cast()))
            }
            fn store_left(costs: __m512i, left: &mut [i32; LANES]) {
                _mm512_storeu_si512(
                    left.as_mut_ptr().cast(),
                    _mm512_sub_epi32(_mm512_set1_epi32(UNREACHED as i32), costs),
                )
            }
            // If one of the two operands is NaN, the instruction returns its second operand, which is infinity.
            fn copy_weights(from: &[f32; LANES], row: &mut [f32; ROW], at: usize) {{
                assert!(at + LANES <= ROW);
                let weights = _mm512_min_ps(_mm512_loadu_ps(from.as_ptr()), _mm512_set1_ps(f32::INFINITY));
                _mm512_storeu_ps(row.as_mut_ptr().add(at), weights);
            }}
            fn store_bytes(numbers: __m512i, bytes: &mut [u8; LANES]) {
                _mm_storeu_si128(bytes.as_mut_ptr().cast(), _mm512_cvtepi32_epi8(numbers))
            }
            fn select(bits: u16, a: __m512i, b: __m512i) -> __m512i { _mm512_mask_mov_epi32(b, bits, a) }
            fn plus(a: __m512i, b: __m512i) -> __m512i { _mm512_add_epi32(a, b) }
            fn least(a: __m512i, b: __m512i) -> __m512i { _mm512_min_epu32(a, b) }
            fn all(cost: u32) -> __m512i { _mm512_set1_epi32(cost as i32) }
            fn less(a: __m512i, b: __m512i) -> u16 { _mm512_cmplt_epu32_mask(a, b) }
            fn equal(a: __m512i, b: __m512i) -> u16 { _mm512_cmpeq_epu32_mask(a, b) }
            fn up<const N: usize>(a: __m512i) -> __m512i {{
                let before = _mm512_set1_epi32(UNREACHED as i32);
                match N {
                    1 => _mm512_alignr_epi32::<15>(a, before),
                    2 => _mm512_alignr_epi32::<14>(a, before),
                    4 => _mm512_alignr_epi32::<12>(a, before),
                    _ => _mm512_alignr_epi32::<8>(a, before),
                }
            }}
            fn down<const N: usize>(a: __m512i) -> __m512i {{
                let behind = _mm512_set1_epi32(UNREACHED as i32);
                match N {
                    1 => _mm512_alignr_epi32::<1>(behind, a),
                    2 => _mm512_alignr_epi32::<2>(behind, a),
                    4 => _mm512_alignr_epi32::<4>(behind, a),
                    _ => _mm512_alignr_epi32::<8>(behind, a),
                }
            }}
        }
    }
}
