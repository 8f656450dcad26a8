//! From rays to rows of a picture: the choice of caster, rows shared among threads, what was done.

use std::{
    ops::Range,
    sync::atomic::{AtomicBool, Ordering},
};

use rayon::prelude::*;

use crate::{
    ClassMap, Frame, InstructionSet, Interpolation, RaycastError,
    appearance::Lighting,
    brute,
    composite::Gathered,
    frame::Ray,
    leap::{self, Start},
    packet::{BAND_ROWS, Packets, light_rows},
    surface::cast_walls_row,
    worth::if_it_pays,
};

/// Which caster.
#[derive(Debug, Clone, Copy)]
pub enum Method<'a> {
    /// Every sample.
    Brute,
    /// Leaps over transparent classes; the radius map of these classes alone.
    LeapTransparent(&'a [u8]),
    /// Leaps over all classes by the step table; only without shading.
    LeapClasses(ClassMap<'a>),
}

/// What a picture took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CastStats {
    /// Rays cast.
    pub num_rays: u64,
    /// Samples read from the volume.
    pub num_samples: u64,
    /// Look-ups in the radius map.
    pub num_lookups: u64,
    /// Leaps taken.
    pub num_leaps: u64,
    /// Samples that leaps stood for.
    pub num_skipped: u64,
    /// Samples that were lit, for which a gradient was read.
    pub num_shaded: u64,
    /// Reads of the volume and of the maps: see [`CastStats::sample_loads`].
    pub num_loads: u64,
}

impl CastStats {
    /// Reads of a sample: the four rows of its cell, two voxels each; or the nearest voxel.
    pub(crate) const fn sample_loads(nearest: bool) -> u32 {
        if nearest { 1 } else { 4 }
    }

    /// Further reads of a lit sample: its gradient takes the eight rows beside its cell. (The cell's own are then read two
    /// voxels longer.)
    const GRADIENT_LOADS: u64 = 8;

    /// Reads of a lit first wall: fourteen samples for its normal and one beneath it.
    const LIGHTING_LOADS: u64 = 15 * 4;

    /// Counts the reads, which follow from the other counts: of samples and their gradients, one radius for each look-up,
    /// and one label for each leap over a class. Reads of the transfer and step tables are left out: they are small and
    /// stay in the nearest cache, and a leap saves them as well.
    #[must_use]
    pub fn with_loads(self, frame: &Frame<'_>, method: Method<'_>) -> Self {
        let nearest = frame.options.interpolation == Interpolation::Nearest;
        let labels = match method {
            Method::LeapClasses(_) => self.num_leaps,
            Method::Brute | Method::LeapTransparent(_) => 0,
        };
        let samples = u64::from(Self::sample_loads(nearest)) * self.num_samples;
        let gradients = Self::GRADIENT_LOADS * self.num_shaded;
        Self {
            num_loads: samples + gradients + self.num_lookups + labels,
            ..self
        }
    }

    /// Counts the lighting of first walls.
    pub(crate) fn lit(self, walls: &[Gathered]) -> Self {
        let num_lit = walls.iter().filter(|wall| wall.hit >= 0.0).count() as u64;
        Self {
            num_shaded: num_lit,
            num_loads: self.num_loads + Self::LIGHTING_LOADS * num_lit,
            ..self
        }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            num_rays: self.num_rays + other.num_rays,
            num_samples: self.num_samples + other.num_samples,
            num_lookups: self.num_lookups + other.num_lookups,
            num_leaps: self.num_leaps + other.num_leaps,
            num_skipped: self.num_skipped + other.num_skipped,
            num_shaded: self.num_shaded + other.num_shaded,
            num_loads: self.num_loads + other.num_loads,
        }
    }
}

/// Casts `rows` of the picture as 8-bit RGB, `[row, column, channel]`.
///
/// Rows are independent, so strips cast anywhere assemble to the whole picture bit for bit.
pub fn cast_rows(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: Range<usize>,
    simd: InstructionSet,
) -> Result<(Vec<u8>, CastStats), RaycastError> {
    cast(frame, method, &rows, simd, None)
}

/// As [`cast_rows`], but given up once another thread sets `stop`; then `None`.
///
/// Looked at before each band of a few rows, so it takes no longer than the dearest band.
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
    let method = if_it_pays(frame, method, simd);
    let bytes = (0u8, 3 * frame.camera().width());
    if let Some(light) = Lighting::exposed(frame, method) {
        let packets = Packets::of(frame, method, simd);
        return Ok(share(rows, bytes, BAND_ROWS, stop, |first, out| {
            cast_lit(frame, method, &light, (packets.as_ref(), simd), first, out)
        }));
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

/// The same picture by the scalar casters, which define truth, whatever the instruction set has.
pub fn cast_rows_scalar(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: Range<usize>,
    simd: InstructionSet,
) -> Result<(Vec<u8>, CastStats), RaycastError> {
    check(frame, method, &rows, simd)?;
    let method = if_it_pays(frame, method, simd);
    let bytes = (0u8, 3 * frame.camera().width());
    if let Some(light) = Lighting::exposed(frame, method) {
        return Ok(share(&rows, bytes, BAND_ROWS, None, |first, out| {
            let scalar = (None, InstructionSet::Portable);
            cast_lit(frame, method, &light, scalar, first, out)
        }));
    }
    let start = Start::of(frame, method);
    Ok(share(&rows, bytes, 1, None, |row, out| {
        cast_row(frame, method, start, row, out, simd).with_loads(frame, method)
    }))
}

/// Casts a band of rows and then lights its first walls.
fn cast_lit(
    frame: &Frame<'_>,
    method: Method<'_>,
    light: &Lighting,
    (packets, simd): (Option<&Packets<'_>>, InstructionSet),
    first_row: usize,
    out: &mut [u8],
) -> CastStats {
    let width = frame.camera().width();
    let mut walls = vec![Gathered::NOTHING; out.len() / 3];
    let stats = match packets {
        Some(packets) => packets.cast_walls(first_row, &mut walls),
        None => walls
            .chunks_mut(width)
            .enumerate()
            .map(|(n, walls)| cast_walls_row(frame, method, first_row + n, walls))
            .fold(CastStats::default(), CastStats::plus),
    };
    light_rows(frame, light, simd, first_row, &walls, out);
    stats.with_loads(frame, method).lit(&walls)
}

/// Shares rows of `blank` items, `per_row` in each, among the threads, `num_rows` at a time; once `stop` is set, what is
/// left stays blank.
pub(crate) fn share<T: Copy + Send>(
    rows: &Range<usize>,
    (blank, per_row): (T, usize),
    num_rows: usize,
    stop: Option<&AtomicBool>,
    cast: impl Fn(usize, &mut [T]) -> CastStats + Sync,
) -> (Vec<T>, CastStats) {
    let mut items = vec![blank; rows.len() * per_row];
    let stats = items
        .par_chunks_mut(per_row * num_rows)
        .enumerate()
        // Rows differ in cost by far (dark lumen, near wall): small shares let a thread that is done take more.
        .with_max_len(4 / num_rows)
        .map(|(n, out)| {
            if stop.is_some_and(|stop| stop.load(Ordering::Relaxed)) {
                return CastStats::default();
            }
            cast(rows.start + n * num_rows, out)
        })
        .reduce(CastStats::default, CastStats::plus);
    (items, stats)
}

pub(crate) fn check(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: &Range<usize>,
    simd: InstructionSet,
) -> Result<(), RaycastError> {
    let height = frame.camera().height();
    if rows.start > rows.end || rows.end > height {
        return Err(RaycastError::Setting {
            what: "rows",
            expected: format!("a range within 0 to {height}"),
            found: format!("{} to {}", rows.start, rows.end),
        });
    }
    if !simd.is_available() {
        return Err(RaycastError::Setting {
            what: "instruction set",
            expected: "one that this machine has".to_owned(),
            found: simd.name().to_owned(),
        });
    }
    check_maps(frame, method)
}

fn check_maps(frame: &Frame<'_>, method: Method<'_>) -> Result<(), RaycastError> {
    let expected = frame.grid.num_voxels();
    let check = |what: &'static str, found: usize| {
        if found == expected {
            return Ok(());
        }
        Err(RaycastError::Setting {
            what,
            expected: format!("{expected} voxels, as in the volume"),
            found: format!("{found}"),
        })
    };
    match method {
        Method::Brute => Ok(()),
        Method::LeapTransparent(radius) => check("radius map", radius.len()),
        Method::LeapClasses(map) => {
            check("radius map", map.radius.len())?;
            check("label volume", map.labels.len())?;
            if frame.options.light.is_some() {
                return Err(RaycastError::Setting {
                    what: "leaps over all classes",
                    expected: "shading off, since shading varies inside a class".to_owned(),
                    found: "shading on".to_owned(),
                });
            }
            Ok(())
        }
    }
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
        // SAFETY: these sets are only handed out where the machine has AVX2, FMA, BMI1, BMI2, LZCNT and POPCNT.
        // Benchmark: the portable build calls a function for every fused multiply-add and is several times slower.
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
        (Method::LeapClasses(map), _, false) => each_pixel(
            frame,
            row,
            out,
            #[inline(always)]
            |frame, ray, stats| leap::cast_classes::<false, false>(frame, map, start, ray, stats),
        ),
        (Method::LeapClasses(map), _, true) => each_pixel(
            frame,
            row,
            out,
            #[inline(always)]
            |frame, ray, stats| leap::cast_classes::<true, false>(frame, map, start, ray, stats),
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
