//! Casting of rows of a picture: choice of the caster, distribution of rows to threads, statistics.

use std::{
    ops::Range,
    sync::atomic::{AtomicBool, Ordering},
};

use crate::{
    CastStats, Frame, InstructionSet, Interpolation, Method, RaycastError, brute,
    composite::Gathered,
    frame::Ray,
    leap::{self, Start},
    leap_trial::faster_method,
    lighting::Lighting,
    packet::{BAND_ROWS, Packets},
    rows::{check, share},
    shaded_walls::cast_shaded,
};

/// Cast `rows` of the picture as 8-bit RGB, `[row, column, channel]`.
///
/// Rows are independent, so strips that are cast anywhere assemble to the whole picture bit for bit.
///
/// # Errors
///
/// Returns an error if the rows, the instruction set or the maps of `method` are not valid for the frame.
pub fn cast_rows(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: Range<usize>,
    simd: InstructionSet,
) -> Result<(Vec<u8>, CastStats), RaycastError> {
    cast(frame, method, &rows, simd, None)
}

/// Cast `rows` as [`cast_rows`] does, but stop when another thread sets `stop`; then return `None`.
///
/// The flag is checked before each band of a few rows, so the delay is at most the time of the slowest band.
///
/// # Errors
///
/// Returns an error if the rows, the instruction set or the maps of `method` are not valid for the frame.
pub fn cast_rows_until(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: Range<usize>,
    simd: InstructionSet,
    stop: &AtomicBool,
) -> Result<Option<(Vec<u8>, CastStats)>, RaycastError> {
    let done = cast(frame, method, &rows, simd, Some(stop))?;
    Ok((!stop.load(Ordering::Relaxed)).then_some(done))
}

fn cast(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: &Range<usize>,
    simd: InstructionSet,
    stop: Option<&AtomicBool>,
) -> Result<(Vec<u8>, CastStats), RaycastError> {
    check(frame, method, rows, simd)?;
    let method = faster_method(frame, method, simd);
    let bytes = (0u8, 3 * frame.camera().width());
    if let Some(light) = Lighting::exposed(frame, method) {
        let packets = Packets::of(frame, method, simd);
        let how = (packets.as_ref(), simd);
        return Ok(cast_shaded(frame, method, &light, how, rows, stop));
    }
    if let Some(packets) = Packets::of(frame, method, simd) {
        return Ok(share(rows, bytes, BAND_ROWS, stop, |first, out| {
            packets.cast_band(first, out).with_loads(frame, method)
        }));
    }
    let start = Start::of(frame, method);
    Ok(share(rows, bytes, 1, stop, |row, out| {
        cast_row(frame, method, start, row, out, simd).with_loads(frame, method)
    }))
}

/// Cast `rows` with the scalar casters, which are the reference for all others; the result is equal for any instruction
/// set.
///
/// # Errors
///
/// Returns an error if the rows, the instruction set or the maps of `method` are not valid for the frame.
pub fn cast_rows_scalar(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: Range<usize>,
    simd: InstructionSet,
) -> Result<(Vec<u8>, CastStats), RaycastError> {
    check(frame, method, &rows, simd)?;
    let method = faster_method(frame, method, simd);
    let bytes = (0u8, 3 * frame.camera().width());
    if let Some(light) = Lighting::exposed(frame, method) {
        let scalar = (None, InstructionSet::Portable);
        return Ok(cast_shaded(frame, method, &light, scalar, &rows, None));
    }
    let start = Start::of(frame, method);
    Ok(share(&rows, bytes, 1, None, |row, out| {
        cast_row(frame, method, start, row, out, simd).with_loads(frame, method)
    }))
}

fn cast_row(
    frame: &Frame<'_>,
    method: Method<'_>,
    start: Start,
    row: usize,
    out: &mut [u8],
    simd: InstructionSet,
) -> CastStats {
    match simd {
        InstructionSet::Portable | InstructionSet::Neon => {
            cast_row_body(frame, method, start, row, out)
        }
        #[cfg(target_arch = "x86_64")]
        // SAFETY: an `InstructionSet` value of these sets exists only on a machine with AVX2, FMA, BMI1, BMI2, LZCNT
        // and POPCNT. Benchmark: the portable build calls a function for every fused multiply-add and is several times
        // slower.
        InstructionSet::Avx2 | InstructionSet::Avx512 => unsafe {
            cast_row_avx2(frame, method, start, row, out)
        },
        #[cfg(not(target_arch = "x86_64"))]
        InstructionSet::Avx2 | InstructionSet::Avx512 => {
            cast_row_body(frame, method, start, row, out)
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn cast_row_avx2(
    frame: &Frame<'_>,
    method: Method<'_>,
    start: Start,
    row: usize,
    out: &mut [u8],
) -> CastStats {
    cast_row_body(frame, method, start, row, out)
}

#[allow(
    clippy::redundant_closure,
    reason = "a function passed as a value is compiled outside cast_row_avx2 and loses its instruction set: 3 times slower"
)]
#[inline(always)]
fn cast_row_body(
    frame: &Frame<'_>,
    method: Method<'_>,
    start: Start,
    row: usize,
    out: &mut [u8],
) -> CastStats {
    let shaded = frame.options.light.is_some();
    let nearest = frame.options.interpolation == Interpolation::Nearest;
    match (method, shaded, nearest) {
        (Method::Brute, true, _) => each_pixel(
            frame,
            row,
            out,
            #[inline(always)]
            |frame, ray, stats| brute::cast::<true, false, false>(frame, ray, stats),
        ),
        (Method::Brute, false, false) => each_pixel(
            frame,
            row,
            out,
            #[inline(always)]
            |frame, ray, stats| brute::cast::<false, false, false>(frame, ray, stats),
        ),
        (Method::Brute, false, true) => each_pixel(
            frame,
            row,
            out,
            #[inline(always)]
            |frame, ray, stats| brute::cast::<false, true, false>(frame, ray, stats),
        ),
        (Method::LeapTransparent(radius), true, _) => each_pixel(
            frame,
            row,
            out,
            #[inline(always)]
            |frame, ray, stats| {
                leap::cast_transparent::<true, false, false>(frame, radius, start, ray, stats)
            },
        ),
        (Method::LeapTransparent(radius), false, false) => each_pixel(
            frame,
            row,
            out,
            #[inline(always)]
            |frame, ray, stats| {
                leap::cast_transparent::<false, false, false>(frame, radius, start, ray, stats)
            },
        ),
        (Method::LeapTransparent(radius), false, true) => each_pixel(
            frame,
            row,
            out,
            #[inline(always)]
            |frame, ray, stats| {
                leap::cast_transparent::<false, true, false>(frame, radius, start, ray, stats)
            },
        ),
        (Method::LeapClasses(map), ..) => each_pixel(
            frame,
            row,
            out,
            #[inline(always)]
            |frame, ray, stats| leap::cast_classes::<false>(frame, map, start, ray, stats),
        ),
        (Method::LeapValues(map), ..) => each_pixel(
            frame,
            row,
            out,
            #[inline(always)]
            |frame, ray, stats| leap::cast_values::<false>(frame, map, ray, stats),
        ),
    }
}

#[inline(always)]
fn each_pixel(
    frame: &Frame<'_>,
    row: usize,
    out: &mut [u8],
    cast: impl Fn(&Frame<'_>, &Ray, &mut CastStats) -> Gathered,
) -> CastStats {
    let mut stats = CastStats::default();
    for (column, pixel) in out.chunks_exact_mut(3).enumerate() {
        let ray = frame.ray(column, row);
        let gathered = cast(frame, &ray, &mut stats);
        pixel.copy_from_slice(&gathered.to_rgb8(frame.options.background));
    }
    stats.num_rays = (out.len() / 3) as u64;
    stats
}
