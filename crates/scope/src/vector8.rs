//! Vectors of eight f32, in registers if the machine has them.
#![allow(
    clippy::inline_always,
    reason = "operations must become registers in the function that has them enabled"
)]

/// Number of f32 that a vector holds.
pub(crate) const LANES: usize = 8;

/// Vector of eight f32, one per lane.
///
/// No operation is fused or approximated, so all implementations give the same bits.
pub(crate) trait Vector8: Copy {
    /// Create a vector from the values of its lanes.
    fn from_array(values: [f32; LANES]) -> Self;
    /// Return the values of all lanes as an array.
    fn to_array(self) -> [f32; LANES];
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    /// Return in each lane the greater number; `other` if `self` is not greater.
    fn greater(self, other: Self) -> Self;
    /// Return in each lane the lesser number; `other` if `self` is not less.
    fn lesser(self, other: Self) -> Self;
    fn root(self) -> Self;
    /// Return `yes` in lanes where `self` is above 0, and `no` in the other lanes.
    fn above_zero(self, yes: Self, no: Self) -> Self;
    /// Return whether in any lane the number of `self` is at most that of `other`.
    fn any_within(self, other: Self) -> bool;

    #[inline(always)]
    fn all(value: f32) -> Self {
        Self::from_array([value; LANES])
    }
}

/// Implementation by arrays, which the compiler translates to the instructions of the build's target.
#[derive(Clone, Copy)]
pub(crate) struct ArrayVector([f32; LANES]);

/// Macro that defines operations as loops, not closures, so that each becomes one instruction on registers.
macro_rules! each {
    ($n:ident, $value:expr) => {{
        let mut out = [0.0; LANES];
        for $n in 0..LANES {
            out[$n] = $value;
        }
        Self(out)
    }};
}

impl Vector8 for ArrayVector {
    #[inline(always)]
    fn from_array(values: [f32; LANES]) -> Self {
        Self(values)
    }
    #[inline(always)]
    fn to_array(self) -> [f32; LANES] {
        self.0
    }
    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        each!(n, self.0[n] + other.0[n])
    }
    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        each!(n, self.0[n] - other.0[n])
    }
    #[inline(always)]
    fn times(self, other: Self) -> Self {
        each!(n, self.0[n] * other.0[n])
    }
    #[inline(always)]
    fn greater(self, other: Self) -> Self {
        each!(
            n,
            if self.0[n] > other.0[n] {
                self.0[n]
            } else {
                other.0[n]
            }
        )
    }
    #[inline(always)]
    fn lesser(self, other: Self) -> Self {
        each!(
            n,
            if self.0[n] < other.0[n] {
                self.0[n]
            } else {
                other.0[n]
            }
        )
    }
    #[inline(always)]
    fn root(self) -> Self {
        each!(n, self.0[n].sqrt())
    }
    #[inline(always)]
    fn above_zero(self, yes: Self, no: Self) -> Self {
        each!(n, if self.0[n] > 0.0 { yes.0[n] } else { no.0[n] })
    }
    #[inline(always)]
    fn any_within(self, other: Self) -> bool {
        let mut any = false;
        for n in 0..LANES {
            any |= self.0[n] <= other.0[n];
        }
        any
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64 as x86;

    use super::{LANES, Vector8};

    /// Implementation by AVX2 registers.
    ///
    /// Values are created only in functions that run on machines with AVX2 (`Packets::signed`).
    #[derive(Clone, Copy)]
    pub(crate) struct Avx2(x86::__m256);

    // SAFETY of all operations: a value exists only on a machine with AVX2 (see the type). Loads and stores are of
    // arrays of eight f32 and need no alignment.
    impl Vector8 for Avx2 {
        #[inline(always)]
        fn from_array(values: [f32; LANES]) -> Self {
            // SAFETY: this code runs only on a machine with AVX2 (see the type), and the array has eight f32; the load
            // needs no alignment.
            Self(unsafe { x86::_mm256_loadu_ps(values.as_ptr()) })
        }
        #[inline(always)]
        fn all(value: f32) -> Self {
            // SAFETY: this code runs only on a machine with AVX2 (see the type).
            Self(unsafe { x86::_mm256_set1_ps(value) })
        }
        #[inline(always)]
        fn to_array(self) -> [f32; LANES] {
            let mut out = [0.0; LANES];
            // SAFETY: this code runs only on a machine with AVX2 (see the type), and the array has eight f32; the store
            // needs no alignment.
            unsafe { x86::_mm256_storeu_ps(out.as_mut_ptr(), self.0) };
            out
        }
        #[inline(always)]
        fn plus(self, other: Self) -> Self {
            // SAFETY: this code runs only on a machine with AVX2 (see the type).
            Self(unsafe { x86::_mm256_add_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn minus(self, other: Self) -> Self {
            // SAFETY: this code runs only on a machine with AVX2 (see the type).
            Self(unsafe { x86::_mm256_sub_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn times(self, other: Self) -> Self {
            // SAFETY: this code runs only on a machine with AVX2 (see the type).
            Self(unsafe { x86::_mm256_mul_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn greater(self, other: Self) -> Self {
            // SAFETY: this code runs only on a machine with AVX2 (see the type).
            Self(unsafe { x86::_mm256_max_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn lesser(self, other: Self) -> Self {
            // SAFETY: this code runs only on a machine with AVX2 (see the type).
            Self(unsafe { x86::_mm256_min_ps(self.0, other.0) })
        }
        #[inline(always)]
        fn root(self) -> Self {
            // SAFETY: this code runs only on a machine with AVX2 (see the type).
            Self(unsafe { x86::_mm256_sqrt_ps(self.0) })
        }
        #[inline(always)]
        fn above_zero(self, yes: Self, no: Self) -> Self {
            // SAFETY: this code runs only on a machine with AVX2 (see the type).
            unsafe {
                let above =
                    x86::_mm256_cmp_ps::<{ x86::_CMP_GT_OQ }>(self.0, x86::_mm256_setzero_ps());
                Self(x86::_mm256_blendv_ps(no.0, yes.0, above))
            }
        }
        #[inline(always)]
        fn any_within(self, other: Self) -> bool {
            // SAFETY: this code runs only on a machine with AVX2 (see the type).
            unsafe {
                x86::_mm256_movemask_ps(x86::_mm256_cmp_ps::<{ x86::_CMP_LE_OQ }>(self.0, other.0))
                    != 0
            }
        }
    }
}
