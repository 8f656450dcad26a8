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
}

impl InstructionSet {
    /// The fastest one of this machine.
    #[must_use]
    pub fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2")
            && std::arch::is_x86_feature_detected!("fma")
            && std::arch::is_x86_feature_detected!("bmi2")
        {
            return Self::Avx2;
        }
        Self::Portable
    }

    /// By name (`portable`, `avx2`), or `None` if unknown or if this machine lacks it.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "portable" => Some(Self::Portable),
            "avx2" => (Self::best() == Self::Avx2).then_some(Self::Avx2),
            _ => None,
        }
    }

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2 => "avx2",
        }
    }
}
