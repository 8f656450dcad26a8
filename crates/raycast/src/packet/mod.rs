//! Packets: the casters with one ray in each lane of a register (docs/decisions/0003-packets.md).
//!
//! The scalar casters in [`crate::brute`] and [`crate::leap`] define truth. A lane does their operations in their order,
//! so pictures and statistics are equal bit for bit; only which rays advance together differs.

mod avx2;
mod avx512;
mod kernel;
mod lanes;
mod out;
mod pool;
mod setup;
mod voxels;

use crate::{CastStats, Frame, InstructionSet, Interpolation, Method, composite::Gathered};
use kernel::Scene;
use lanes::Lanes;
use out::{Out, Rgb8, Walls};
use pool::Source;
use voxels::Voxels;

/// Rows of a picture that are cast together: packets cover squares of pixels.
pub(crate) const BAND_ROWS: usize = 4;

/// A picture that packets can cast.
#[derive(Clone, Copy)]
pub(crate) struct Packets<'a> {
    scene: Scene<'a>,
    shaded: bool,
    leaps: bool,
    simd: InstructionSet,
}

impl<'a> Packets<'a> {
    /// `None` where the scalar casters do the work: nearest voxels, leaps over all classes, volumes beyond 32-bit
    /// indices, rays of 2^30 steps, instruction sets without packets.
    ///
    /// The maps have been checked against the volume.
    pub(crate) fn of(
        frame: &'a Frame<'a>,
        method: Method<'a>,
        simd: InstructionSet,
    ) -> Option<Self> {
        let radius = match method {
            Method::Brute => None,
            Method::LeapTransparent(radius) => Some(radius),
            Method::LeapClasses(_) => return None,
        };
        let fits = simd != InstructionSet::Portable
            && frame.options.interpolation == Interpolation::Trilinear
            && frame.most_steps() < f64::from(1 << 30);
        let voxels = Voxels::of(&frame.field).filter(|_| fits)?;
        debug_assert!(radius.is_none_or(|radius| radius.len() == voxels.num_voxels()));
        Some(Self {
            scene: Scene {
                frame,
                voxels,
                radius: radius.unwrap_or(&[]),
            },
            shaded: frame.options.light.is_some(),
            leaps: radius.is_some(),
            simd,
        })
    }

    /// Casts rows from `first_row` on, as many as `out` holds.
    pub(crate) fn cast_band(&self, first_row: usize, out: &mut [u8]) -> CastStats {
        let background = self.scene.frame.options.background;
        let num_pixels = out.len() / 3;
        let out = Rgb8 {
            rgb: out,
            background,
        };
        self.cast_to(first_row, num_pixels, out)
    }

    /// The same with all that the rays gather, first walls included; `out` holds [`Gathered::NOTHING`]. The light at the
    /// tip is left out.
    pub(crate) fn cast_walls(&self, first_row: usize, out: &mut [Gathered]) -> CastStats {
        let num_pixels = out.len();
        self.cast_to(first_row, num_pixels, Walls(out))
    }

    fn cast_to<O: Out>(&self, first_row: usize, num_pixels: usize, out: O) -> CastStats {
        let width = self.scene.frame.camera().width();
        let source = Source::new(width, first_row, num_pixels / width);
        match self.simd {
            // SAFETY: the instruction set is only handed out where the machine has it. Benchmark:
            // docs/decisions/0003-packets.md.
            InstructionSet::Avx512 => unsafe { self.cast_avx512(source, out) },
            // SAFETY: as above.
            InstructionSet::Avx2 => unsafe { self.cast_avx2(source, out) },
            InstructionSet::Portable => unreachable!("`of` makes no packets for it"),
        }
    }

    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn cast_avx512<O: Out>(&self, source: Source, out: O) -> CastStats {
        // SAFETY: this function runs only where the machine has the instructions.
        self.cast(unsafe { avx512::Avx512::new() }, source, out)
    }

    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn cast_avx2<O: Out>(&self, source: Source, out: O) -> CastStats {
        // SAFETY: this function runs only where the machine has the instructions.
        self.cast(unsafe { avx2::Avx2::new() }, source, out)
    }

    #[inline(always)]
    fn cast<L: Lanes, O: Out>(&self, l: L, source: Source, out: O) -> CastStats {
        match (self.shaded && !O::HITS, self.leaps) {
            (true, true) => self.scene.cast::<L, O, true, true>(l, source, out),
            (true, false) => self.scene.cast::<L, O, true, false>(l, source, out),
            (false, true) => self.scene.cast::<L, O, false, true>(l, source, out),
            (false, false) => self.scene.cast::<L, O, false, false>(l, source, out),
        }
    }
}
