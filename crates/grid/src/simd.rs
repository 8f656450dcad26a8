//! Instruction sets for which the kernels of all crates are compiled.
//!
//! A kernel gives the same bits with every instruction set.

/// Instruction set for which a kernel is compiled.
///
/// Fused multiply-add is one rounding by definition, in hardware or in software, so the choice changes only the speed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InstructionSet {
    /// Instructions that every machine of the build's target has.
    Portable,
    /// AVX2 and FMA (`x86_64` since about 2013).
    Avx2,
    /// AVX-512 F, BW, DQ and VL (servers since about 2017, AMD since Zen 4).
    Avx512,
    /// NEON, which every `aarch64` processor has.
    Neon,
}

impl InstructionSet {
    /// Return the instruction sets that this machine has, slowest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        [Self::Portable, Self::Avx2, Self::Avx512, Self::Neon]
            .into_iter()
            .filter(|simd| simd.is_available())
            .collect()
    }

    /// Return true if this machine has the instruction set.
    #[must_use]
    pub fn is_available(self) -> bool {
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::is_x86_feature_detected as has;
            let avx2 = || {
                has!("avx2")
                    && has!("fma")
                    && has!("bmi1")
                    && has!("bmi2")
                    && has!("lzcnt")
                    && has!("popcnt")
            };
            match self {
                Self::Portable => true,
                Self::Avx2 => avx2(),
                Self::Avx512 => {
                    avx2()
                        && has!("avx512f")
                        && has!("avx512bw")
                        && has!("avx512dq")
                        && has!("avx512vl")
                }
                Self::Neon => false,
            }
        }
        #[cfg(not(target_arch = "x86_64"))]
        {
            self == Self::Portable || (cfg!(target_arch = "aarch64") && self == Self::Neon)
        }
    }

    /// Return the fastest instruction set of this machine.
    #[must_use]
    pub fn best() -> Self {
        Self::available().pop().unwrap_or(Self::Portable)
    }

    /// Return the instruction set with a name (`portable`, `avx2`, `avx512`, `neon`).
    ///
    /// The result is `None` if the name is unknown or this machine lacks the instruction set.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::available()
            .into_iter()
            .find(|simd| simd.name() == name)
    }

    /// Return the name of the instruction set.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
            Self::Neon => "neon",
        }
    }
}
