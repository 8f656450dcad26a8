//! Which instructions the kernels are compiled for. All give the same bits.

/// An instruction set that the kernels exist for.
///
/// Fused multiply-add is one rounding by definition, in hardware or in software, so the choice changes the speed only.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InstructionSet {
    /// Whatever the build's target always has.
    Portable,
    /// AVX2 and FMA (`x86_64` since about 2013).
    Avx2,
    /// AVX-512 F, BW, DQ and VL (servers since about 2017, AMD since Zen 4).
    Avx512,
    /// NEON, which every `aarch64` has.
    Neon,
}

impl InstructionSet {
    /// The sets that this machine has, slowest first.
    #[must_use]
    pub fn available() -> Vec<Self> {
        [Self::Portable, Self::Avx2, Self::Avx512, Self::Neon]
            .into_iter()
            .filter(|simd| simd.is_available())
            .collect()
    }

    /// True if this machine has it.
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

    /// The fastest one of this machine.
    #[must_use]
    pub fn best() -> Self {
        Self::available().pop().unwrap_or(Self::Portable)
    }

    /// By name (`portable`, `avx2`, `avx512`, `neon`), or `None` if unknown or if this machine lacks it.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::available()
            .into_iter()
            .find(|simd| simd.name() == name)
    }

    /// Its name.
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
