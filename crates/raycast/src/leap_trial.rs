//! Rule that decides for each picture whether its rays skip regions of equal labels or read every sample.
//!
//! In dense or noisy tissue a ray skips too few samples to compensate for its look-ups (reads of the radius map).
//!
//! A few rays that are spread over the whole picture are cast first and counted. The rule uses only these counts, so
//! the decision is the same for every strip, instruction set and number of threads. Both casters give the same picture,
//! so the decision changes only the time. The statistics of a picture exclude these rays.

use crate::{
    CastStats, Frame, InstructionSet, Interpolation, Method, brute,
    leap::{self, Start},
};

/// Number of rows, and of columns, of the grid of trial rays, which measure how many samples can be skipped.
const TRIAL_SIDE: usize = 8;
/// Minimum number of pixels of a picture for a trial; a smaller picture is cast with leaps without a trial.
const MIN_PIXELS: usize = 64 * TRIAL_SIDE * TRIAL_SIDE;

/// Return the faster method for a picture: `method`, or brute force if the trial rays show that skipping would take
/// longer.
pub(crate) fn faster_method<'a>(
    frame: &Frame<'_>,
    method: Method<'a>,
    simd: InstructionSet,
) -> Method<'a> {
    let camera = frame.camera();
    let small = camera.width() * camera.height() < MIN_PIXELS;
    if small || frame.always_leap || matches!(method, Method::Brute) {
        return method;
    }
    let stats = match simd {
        InstructionSet::Portable | InstructionSet::Neon => trial_counts(frame, method),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: an `InstructionSet` value of these sets exists only on a machine with AVX2, FMA, BMI1, BMI2, LZCNT
        // and POPCNT. Benchmark: without them every fused multiply-add is a call, and the trial takes a tenth of the
        // time of a small picture.
        InstructionSet::Avx2 | InstructionSet::Avx512 => unsafe {
            trial_counts_avx2(frame, method)
        },
        #[cfg(not(target_arch = "x86_64"))]
        InstructionSet::Avx2 | InstructionSet::Avx512 => trial_counts(frame, method),
    };
    if pays(method, stats) {
        method
    } else {
        Method::Brute
    }
}

/// Return whether leaps are faster than brute force, by the counts of the trial rays and the measured times of a step.
fn pays(method: Method<'_>, stats: CastStats) -> bool {
    let num_rays = (TRIAL_SIDE * TRIAL_SIDE) as u64;
    if let Method::LeapValues(_) = method {
        // A step takes about as long as a sample of a volume that fits the caches. The start of a ray, and the search
        // for the end of its last segment, together take as long as 22 samples (benchmarks/measurements/rendering.md,
        // 0104).
        let num_samples = stats.num_samples + stats.num_skipped;
        return 20 * num_samples > 19 * stats.num_lookups + 440 * num_rays;
    }
    // Measured time of a look-up, in units of a brute-force sample (docs/decisions/0104).
    let lookup_price = if matches!(method, Method::LeapClasses(_)) {
        12
    } else {
        2
    };
    // The start of a ray is a little slower with leaps, by about three samples.
    stats.num_skipped > lookup_price * stats.num_lookups + 3 * num_rays
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn trial_counts_avx2(frame: &Frame<'_>, method: Method<'_>) -> CastStats {
    trial_counts(frame, method)
}

#[inline(always)]
fn trial_counts(frame: &Frame<'_>, method: Method<'_>) -> CastStats {
    let camera = frame.camera();
    let start = Start::of(frame, method);
    let nearest = frame.options.interpolation == Interpolation::Nearest;
    let place = |n: usize, size: usize| (2 * n + 1) * size / (2 * TRIAL_SIDE);
    let mut stats = CastStats::default();
    for row in 0..TRIAL_SIDE {
        for column in 0..TRIAL_SIDE {
            let ray = &frame.ray(place(column, camera.width()), place(row, camera.height()));
            let stats = &mut stats;
            // Light changes neither where a ray samples nor where it stops.
            match (method, nearest) {
                (Method::Brute, _) => brute::cast::<false, false, false>(frame, ray, stats),
                (Method::LeapTransparent(radius), false) => {
                    leap::cast_transparent::<false, false, false>(frame, radius, start, ray, stats)
                }
                (Method::LeapTransparent(radius), true) => {
                    leap::cast_transparent::<false, true, false>(frame, radius, start, ray, stats)
                }
                (Method::LeapClasses(map), _) => {
                    leap::cast_classes::<false>(frame, map, start, ray, stats)
                }
                (Method::LeapValues(map), _) => leap::cast_values::<false>(frame, map, ray, stats),
            };
        }
    }
    stats
}
