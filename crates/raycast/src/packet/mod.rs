//! Packets: the casters with one ray in each lane of a register (docs/decisions/0103).
//!
//! The scalar casters in [`crate::brute`] and [`crate::leap`] define the correct result. A lane performs their
//! operations in their order, so pictures and statistics are equal bit for bit; only the grouping of rays differs.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod bricks;
mod film;
#[cfg(target_arch = "x86_64")]
mod gathers;
mod kernel;
mod lanes;
mod lighting;
#[cfg(target_arch = "x86_64")]
mod loads;
mod map_lookup;
mod mist;
mod out;
#[cfg(target_arch = "x86_64")]
mod pair;
mod plane;
mod pool;
mod portable;
mod rings;
mod sample;
mod scene;
mod setup;
mod slopes;
mod source;
mod texture;
mod vectors;
mod voxels;

use carina_isoregion::SegmentTable;

use crate::{
    CastStats, ClassMap, Frame, InstructionSet, Interpolation, Method,
    composite::Gathered,
    leap::{CELL_REACH, Price, Start, class_margin, value_margin},
    shared_constants::SharedConstant,
};
#[cfg(target_arch = "x86_64")]
use gathers::gathers_are_faster;
use lanes::Lanes;
use out::{Out, Rgb8, Walls};
#[cfg(target_arch = "x86_64")]
use pair::Pair;
pub(crate) use plane::{PlaneTiles, TILE_ROWS};
use scene::{BRUTE, CLASSES, Scene, TRANSPARENT, VALUES, VALUES_PREFETCHED};
pub(crate) use source::BAND_ROWS;
use source::Source;
use voxels::Voxels;

/// Return names and values of the constants of the packets' shading that the GPU's shaders need too.
pub(crate) fn shared() -> Vec<SharedConstant> {
    [
        film::shared(),
        lighting::shared(),
        mist::shared(),
        rings::shared(),
        texture::shared(),
    ]
    .concat()
}

pub(crate) use lighting::{brightness, light_rows};
#[cfg(test)]
pub(crate) use {
    lanes::Lanes as TestLanes, portable::Portable as TestSet, slopes::rise as test_rise,
};

/// Picture that is cast in packets, with the choice of kernel.
#[derive(Clone, Copy)]
pub(crate) struct Packets<'a> {
    scene: Scene<'a>,
    shaded: bool,
    nearest: bool,
    leap: u8,
    simd: InstructionSet,
}

/// Segment table without classes, for pictures whose rays do not skip regions of all classes.
static NO_SEGMENTS: SegmentTable = SegmentTable::EMPTY;

impl<'a> Packets<'a> {
    /// Prepare a picture for packets; return `None` if only the scalar casters can cast it.
    ///
    /// Packets do not support volumes beyond 32-bit indices, volumes with an axis above 65,535 voxels or one voxel
    /// along x, and rays of 2^30 steps. The caller must have checked the maps against the volume.
    pub(crate) fn of(
        frame: &'a Frame<'a>,
        method: Method<'a>,
        simd: InstructionSet,
    ) -> Option<Self> {
        let nearest = frame.options.interpolation == Interpolation::Nearest;
        let none = ClassMap {
            labels: &[],
            radius: &[],
            segments: &NO_SEGMENTS,
        };
        let (leap, map, margin, lookup_loads) = match method {
            Method::Brute => (BRUTE, none, 0.0, 1),
            Method::LeapTransparent(radius) => (
                TRANSPARENT,
                ClassMap { radius, ..none },
                CELL_REACH - frame.guard_vox,
                1,
            ),
            Method::LeapClasses(map) if map.segments.entries().is_empty() => return None,
            Method::LeapClasses(map) => (CLASSES, map, class_margin(frame), 2),
            Method::LeapValues(map) => (
                if map.prefetch {
                    VALUES_PREFETCHED
                } else {
                    VALUES
                },
                ClassMap {
                    segments: map.segments,
                    ..none
                },
                value_margin(frame),
                1,
            ),
        };
        let words = match method {
            Method::LeapValues(map) => map.words,
            _ => &[],
        };
        let fits = frame.most_steps() < f64::from(1 << 30);
        let voxels = Voxels::of(&frame.field).filter(|_| fits)?;
        let voxels = voxels.reading(frame);
        Some(Self {
            scene: Scene {
                frame,
                voxels,
                radius: map.radius,
                labels: map.labels,
                words,
                segments: map.segments,
                margin,
                start: Start::of(frame, method),
                price: Price::of(CastStats::sample_loads(nearest), lookup_loads),
            },
            shaded: frame.options.light.is_some(),
            nearest,
            leap,
            simd,
        })
    }

    /// Return true if packets can find the first walls of this picture.
    ///
    /// Packets find no first walls with nearest-voxel samples, nor within segments of opaque classes.
    pub(crate) fn find_walls(&self) -> bool {
        !self.nearest && self.leap != CLASSES
    }

    /// Cast as many rows as `out` contains, from `first_row` on, as 8-bit RGB.
    pub(crate) fn cast_band(&self, first_row: usize, out: &mut [u8]) -> CastStats {
        let background = self.scene.frame.options.background;
        let num_pixels = out.len() / 3;
        let out = Rgb8 {
            rgb: out,
            background,
        };
        self.cast_to(first_row, num_pixels, out)
    }

    /// Cast as many rows as `out` contains, from `first_row` on; write colour, transparency and first wall of each ray.
    ///
    /// The light at the tip is not applied.
    pub(crate) fn cast_walls(&self, first_row: usize, out: &mut [Gathered]) -> CastStats {
        let num_pixels = out.len();
        self.cast_to(first_row, num_pixels, Walls(out))
    }

    fn cast_to<O: Out>(&self, first_row: usize, num_pixels: usize, out: O) -> CastStats {
        let width = self.scene.frame.camera().width();
        let source = Source::new(width, first_row, num_pixels / width);
        match self.simd {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
            // Benchmark: benchmarks/measurements/rendering.md.
            InstructionSet::Avx512 => unsafe { self.cast_avx512(source, out) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
            InstructionSet::Avx2 => unsafe { self.cast_avx2(source, out) },
            InstructionSet::Portable | InstructionSet::Neon => {
                self.cast((portable::Portable, portable::Portable), source, out)
            }
            #[cfg(not(target_arch = "x86_64"))]
            InstructionSet::Avx2 | InstructionSet::Avx512 => {
                unreachable!("not handed out on this machine")
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn cast_avx512<O: Out>(&self, source: Source, out: O) -> CastStats {
        // SAFETY: this function runs only on a machine with the instructions of its target features.
        let l = Pair(unsafe { avx512::Avx512::new(gathers_are_faster(self.simd)) });
        self.cast((l, l), source, out)
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    fn cast_avx2<O: Out>(&self, source: Source, out: O) -> CastStats {
        // SAFETY: this function runs only on a machine with the instructions of its target features.
        let l = Pair(unsafe { avx2::Avx2::new(false) });
        // The search stage moves twice as many rays together as the shading stage shades;
        // benchmarks/measurements/rendering.md has the times.
        self.cast((Pair(l), l), source, out)
    }

    /// Cast a band of rows: search for visible samples in the lanes of the first instruction set, and shade them in
    /// those of the second.
    #[inline(always)]
    fn cast<L: Lanes, S: Lanes, O: Out>(&self, l: (L, S), source: Source, out: O) -> CastStats {
        let scene = &self.scene;
        if O::HITS {
            return match self.leap {
                BRUTE => scene.cast::<L, S, O, false, false, BRUTE, true>(l, source, out),
                _ => scene.cast::<L, S, O, false, false, TRANSPARENT, true>(l, source, out),
            };
        }
        match (self.shaded, self.nearest, self.leap) {
            (true, _, BRUTE) => scene.cast::<L, S, O, true, false, BRUTE, true>(l, source, out),
            (true, _, _) => scene.cast::<L, S, O, true, false, TRANSPARENT, true>(l, source, out),
            (false, false, BRUTE) => {
                scene.cast::<L, S, O, false, false, BRUTE, true>(l, source, out)
            }
            (false, false, TRANSPARENT) => {
                scene.cast::<L, S, O, false, false, TRANSPARENT, true>(l, source, out)
            }
            (false, false, _) => {
                scene.cast::<L, S, O, false, false, CLASSES, false>(l, source, out)
            }
            (false, true, BRUTE) => {
                scene.cast::<L, S, O, false, true, BRUTE, false>(l, source, out)
            }
            (false, true, TRANSPARENT) => {
                scene.cast::<L, S, O, false, true, TRANSPARENT, false>(l, source, out)
            }
            (false, true, VALUES_PREFETCHED) => {
                scene.cast::<L, S, O, false, true, VALUES_PREFETCHED, false>(l, source, out)
            }
            (false, true, _) => scene.cast::<L, S, O, false, true, VALUES, false>(l, source, out),
        }
    }
}
