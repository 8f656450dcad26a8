//! Silhouettes: a pixel at the edge of a near wall in front of a far one gets two rays, so that the edge has no
//! staircase.
//!
//! The choice of these pixels depends only on the first walls of a pixel and of its four neighbours in the whole
//! picture, and the two rays have fixed positions in the pixel. So strips agree with the whole picture, casting with
//! leaps agrees with brute force, and packets agree with the scalar casters. Depths and measurements remain those of
//! the ray through the pixel's centre.

use std::{
    ops::Range,
    sync::atomic::{AtomicBool, Ordering},
};

use rayon::prelude::*;

use crate::{
    CastStats, Frame, InstructionSet, Method,
    composite::Gathered,
    lighting::Lighting,
    packet::{Packets, light_rows},
    shared_constants::shared_constants,
    surface::cast_walls_row,
};

shared_constants! {
    /// Offsets of the two rays of a silhouette pixel from the pixel's centre, in pixels.
    ///
    /// The rays are a fraction of a pixel apart along both axes and along neither diagonal, so that edges of most
    /// directions get an intermediate level.
    const BESIDE: [[f64; 2]; 2] = [[-0.2, -0.36], [0.2, 0.36]];
    /// Maximum second difference of the inverse depth from pixel to pixel in a wall; a larger one marks a silhouette.
    ///
    /// The limit is a fraction of the nearest pixel's inverse depth. The inverse depth of a plane is linear at any
    /// inclination; a deviation of 1/8 changes the brightness of a wall by about as much as a visible step.
    const BEND: f32 = 0.125;
    /// Linear light of a wall at normal incidence below which jagged pixels at its edge are not visible.
    const FAINT: f32 = 0.02;

    /// Minimum wrap lighting of a wall at a silhouette.
    ///
    /// The wet mucosa at an edge scatters light, so its edge is not the dark line that a matt surface shows where it
    /// turns away.
    const EDGE_WRAP: f32 = 0.6;
}

/// Number of rows in which one parallel task searches for silhouette pixels.
const ROWS_AT_A_TIME: usize = 16;
/// Number of silhouette pixels that one parallel task casts.
const PIXELS_AT_A_TIME: usize = 256;

/// Depths of the first walls of some rows, in ray steps, with the rows before and after them if the picture has them.
#[derive(Clone, Copy)]
pub(crate) struct DepthRows<'a> {
    pub width: usize,
    pub first_row: usize,
    pub depths: &'a [f32],
    /// Depths of the row before the rows of `depths`; empty at the picture's edge.
    pub before: &'a [f32],
    /// Depths of the row after the rows of `depths`; empty at the picture's edge.
    pub after: &'a [f32],
}

impl<'a> DepthRows<'a> {
    /// Return the depths of the walls in a row; `None` if the row is outside the picture.
    fn row(&self, row: Option<usize>) -> Option<&'a [f32]> {
        let row = row?;
        let num_rows = self.depths.len() / self.width;
        let pixels = if row + 1 == self.first_row {
            self.before
        } else if row == self.first_row + num_rows {
            self.after
        } else {
            let at = row.checked_sub(self.first_row)? * self.width;
            self.depths.get(at..at + self.width)?
        };
        (!pixels.is_empty()).then_some(pixels)
    }
}

/// Compute the inverse depth of each pixel of a row, in ray steps; 0 for a ray that meets no wall.
///
/// A depth below one step counts as one step, so the largest result is 1. Pixels outside the outline of a scope's picture have no ray and are
/// not at a wall's edge: they get NaN, for which every comparison is false. This function and the functions that mark
/// pixels have no closures and no branches, so that the compiler vectorises them with the instruction set of the caller.
#[inline(always)]
fn inverses(frame: &Frame<'_>, depths: &[f32], row: usize, out: &mut [f32]) {
    let count = out.len().min(depths.len());
    for n in 0..count {
        let v = depths[n];
        let near = 1.0 / if v > 1.0 { v } else { 1.0 };
        out[n] = if v < 0.0 { 0.0 } else { near };
    }
    if let Some(rays) = frame.camera().lens_rays() {
        let [x, y, z] = rays.directions_of(row).map(|of_row| &of_row[..count]);
        for n in 0..count {
            // A direction is a unit vector, or 0 for a pixel without a ray.
            let has_ray = x[n] * x[n] + y[n] * y[n] + z[n] * z[n] > 0.5;
            out[n] = if has_ray { out[n] } else { f32::NAN };
        }
    }
}

/// Return the pixels (column, row) in the wanted rows that are on a silhouette.
fn pixels_of(
    frame: &Frame<'_>,
    light: &Lighting,
    rows: &DepthRows<'_>,
    wanted: Range<usize>,
    simd: InstructionSet,
) -> Vec<(usize, usize)> {
    match simd {
        InstructionSet::Portable | InstructionSet::Neon => search(frame, light, rows, wanted),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: an `InstructionSet` value of these sets exists only on a machine with AVX2, BMI1, BMI2, LZCNT and
        // POPCNT. Benchmark: benchmarks/measurements/rendering.md, cost of the appearance's decoration.
        InstructionSet::Avx2 | InstructionSet::Avx512 => unsafe {
            search_avx2(frame, light, rows, wanted)
        },
        #[cfg(not(target_arch = "x86_64"))]
        InstructionSet::Avx2 | InstructionSet::Avx512 => search(frame, light, rows, wanted),
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn search_avx2(
    frame: &Frame<'_>,
    light: &Lighting,
    rows: &DepthRows<'_>,
    wanted: Range<usize>,
) -> Vec<(usize, usize)> {
    search(frame, light, rows, wanted)
}

#[inline(always)]
fn search(
    frame: &Frame<'_>,
    light: &Lighting,
    rows: &DepthRows<'_>,
    wanted: Range<usize>,
) -> Vec<(usize, usize)> {
    // Inverse depth below which the reflected light, `exposure / depth^2`, is too faint for a visible staircase.
    let least = (FAINT / light.exposure.max(1e-9)).sqrt() * light.step_mm;
    let mut found = Vec::new();
    // Ring buffer of the inverse depths of three rows: the row above, the row itself and the row below.
    let mut inverse = [(); 3].map(|()| vec![0.0f32; rows.width]);
    let mut known = [false; 3];
    for (n, row) in [wanted.start.checked_sub(1), Some(wanted.start)]
        .into_iter()
        .enumerate()
    {
        if let Some(depths) = rows.row(row) {
            inverses(frame, depths, row.unwrap_or(0), &mut inverse[n]);
            known[n] = true;
        }
    }
    let mut on = vec![0u8; rows.width];
    for row in wanted {
        let depths = rows.row(Some(row + 1));
        known[2] = depths.is_some();
        if let Some(depths) = depths {
            inverses(frame, depths, row + 1, &mut inverse[2]);
        }
        if !known[1] {
            break;
        }
        on.fill(0);
        let [above, middle, below] = &inverse;
        if let [_, between @ .., _] = &mut on[..] {
            mark_bends([middle, &middle[1..], &middle[2..]], least, between);
        }
        if known[0] && known[2] {
            mark_bends([above, middle, below], least, &mut on);
        }
        // Few pixels are marked, so eight are tested together.
        for (n, eight) in on.chunks(8).enumerate() {
            if eight.iter().fold(0, |any, &on| any | on) != 0 {
                let columns = eight.iter().enumerate().filter(|&(_, &on)| on != 0);
                found.extend(columns.map(|(at, _)| (8 * n + at, row)));
            }
        }
        inverse.rotate_left(1);
        known.rotate_left(1);
    }
    found
}

/// Mark the pixels where the second difference of the inverse depth over three rows or columns exceeds [`BEND`].
#[inline(always)]
fn mark_bends(three: [&[f32]; 3], least: f32, on: &mut [u8]) {
    let [before, middle, after] = three;
    let count = on.len();
    let (before, middle, after) = (&before[..count], &middle[..count], &after[..count]);
    for n in 0..count {
        let (a, b, c) = (before[n], middle[n], after[n]);
        let nearest = if a > b { a } else { b };
        let nearest = if nearest > c { nearest } else { c };
        let bend = (a - 2.0 * b + c).abs();
        on[n] |= u8::from(nearest > least) & u8::from(bend > BEND * nearest);
    }
}

/// Cast and shade two rays for every pixel on a silhouette in the rows of `rgb`, and store their mean in `rgb`.
///
/// Without packets the scalar casters are used. After `stop` is set, the remaining pixels stay unchanged.
pub(crate) fn smooth_silhouettes(
    frame: &Frame<'_>,
    method: Method<'_>,
    light: &Lighting,
    (leaps, simd): (bool, InstructionSet),
    rows: &DepthRows<'_>,
    rgb: &mut [u8],
    stop: Option<&AtomicBool>,
) -> CastStats {
    let (width, first) = (rows.width, rows.first_row);
    let num_rows = rgb.len() / (3 * width);
    // A picture has few such pixels; collecting them from all rows fills whole packets with their rays.
    let pixels: Vec<(usize, usize)> = (0..num_rows.div_ceil(ROWS_AT_A_TIME))
        .into_par_iter()
        .flat_map_iter(|n| {
            let from = n * ROWS_AT_A_TIME;
            let to = (from + ROWS_AT_A_TIME).min(num_rows);
            pixels_of(frame, light, rows, first + from..first + to, simd)
        })
        .collect();
    let mut round = light.clone();
    round.appearance.wrap = round.appearance.wrap.max(EDGE_WRAP);
    let smoothed: Vec<(CastStats, Vec<[u8; 3]>)> = pixels
        .par_chunks(PIXELS_AT_A_TIME)
        .map(|pixels| {
            if stop.is_some_and(|stop| stop.load(Ordering::Relaxed)) {
                return (CastStats::default(), vec![]);
            }
            smoothed_pixels(frame, method, &round, (leaps, simd), pixels)
        })
        .collect();
    let mut stats = CastStats::default();
    for (pixels, (counts, shown)) in pixels.chunks(PIXELS_AT_A_TIME).zip(smoothed) {
        stats = stats.plus(counts);
        for (&(column, row), shown) in pixels.iter().zip(shown) {
            let at = 3 * ((row - first) * width + column);
            rgb[at..at + 3].copy_from_slice(&shown);
        }
    }
    stats
}

fn smoothed_pixels(
    frame: &Frame<'_>,
    method: Method<'_>,
    light: &Lighting,
    (leaps, simd): (bool, InstructionSet),
    pixels: &[(usize, usize)],
) -> (CastStats, Vec<[u8; 3]>) {
    let directions: Vec<[f32; 3]> = pixels
        .iter()
        .flat_map(|&(column, row)| {
            BESIDE.map(|beside| {
                let dir = frame.camera().direction_beside(column, row, beside);
                dir.map(|v| v as f32)
            })
        })
        .collect();
    let listed = frame.listing(&directions);
    let mut walls = vec![Gathered::NOTHING; directions.len()];
    let packets = leaps.then(|| Packets::of(&listed, method, simd)).flatten();
    let stats = match packets {
        Some(packets) => packets.cast_walls(0, &mut walls),
        None => cast_walls_row(&listed, method, 0, &mut walls),
    };
    let mut shown = vec![0u8; 3 * walls.len()];
    light_rows(&listed, light, simd, 0, &walls, &mut shown);
    let (pairs, _) = shown.as_chunks::<6>();
    let mean = |a: u8, b: u8| u16::midpoint(u16::from(a), u16::from(b) + 1) as u8;
    let shown = pairs
        .iter()
        .map(|two| [0, 1, 2].map(|c| mean(two[c], two[3 + c])));
    // The number of rays is the number of pixels, so the additional rays of a pixel are not counted.
    let stats = CastStats {
        num_rays: 0,
        ..stats.with_loads(frame, method).lit(&walls)
    };
    (stats, shown.collect())
}
