//! Casting of pictures whose first walls are shaded after casting.
//!
//! A few rows are cast, then shaded while their rays are in the cache. Only the depths are stored for all rows, with
//! one more row on each side of a strip, because the neighbours of a pixel show whether it is on a silhouette.

use std::{
    ops::Range,
    sync::atomic::{AtomicBool, Ordering},
};

use rayon::prelude::*;

use crate::{
    CastStats, Frame, InstructionSet, Method,
    composite::Gathered,
    lighting::Lighting,
    packet::{BAND_ROWS, Packets, light_rows},
    silhouette::{DepthRows, smooth_silhouettes},
    surface::cast_walls_row,
};

/// Return the rows that must be cast to shade `rows`: these rows and one beyond each end, for the silhouettes.
///
/// If the appearance smooths silhouettes, the result also has the row before and the row after `rows`.
#[must_use]
pub fn rows_to_gather(frame: &Frame<'_>, rows: &Range<usize>) -> Range<usize> {
    let smooth = frame
        .options
        .appearance
        .is_some_and(|appearance| appearance.silhouettes);
    if smooth && !rows.is_empty() {
        rows.start.saturating_sub(1)..(rows.end + 1).min(frame.camera().height())
    } else {
        rows.clone()
    }
}

/// Function that casts rows, starting with the given row, into a buffer and returns its statistics.
type CastWalls<'a> = &'a (dyn Fn(usize, &mut [Gathered]) -> CastStats + Sync);

/// Cast and shade rows, in packets or with the scalar casters.
///
/// The statistics count the rays of `rows` only. The rows before and after them are cast too, because the silhouettes
/// need their depths, but other strips count these rows.
///
/// The statistics exclude the rays of the rows beside the strip, because these rows belong to other strips.
pub(crate) fn cast_shaded(
    frame: &Frame<'_>,
    method: Method<'_>,
    light: &Lighting,
    (packets, simd): (Option<&Packets<'_>>, InstructionSet),
    rows: &Range<usize>,
    stop: Option<&AtomicBool>,
) -> (Vec<u8>, CastStats) {
    let width = frame.camera().width();
    let cast = |first_row: usize, out: &mut [Gathered]| match packets {
        Some(packets) => packets.cast_walls(first_row, out),
        None => out
            .chunks_mut(width)
            .enumerate()
            .map(|(n, walls)| cast_walls_row(frame, method, first_row + n, walls))
            .fold(CastStats::default(), CastStats::plus),
    };
    let all = rows_to_gather(frame, rows);
    let beside = |rows: Range<usize>| {
        let mut out = vec![Gathered::NOTHING; rows.len() * width];
        if !out.is_empty() {
            cast(rows.start, &mut out);
        }
        out.iter().map(|wall| wall.hit).collect()
    };
    let beside = [beside(all.start..rows.start), beside(rows.end..all.end)];
    let cast = |first: usize, out: &mut [Gathered]| cast(first, out).with_loads(frame, method);
    let how = (packets.is_some(), simd);
    light_walls(frame, method, light, how, (rows, &cast), &beside, stop)
}

/// Shade the first walls of rows, a few rows at a time, and smooth silhouettes (edges of near walls) if the appearance
/// requires it.
///
/// `beside` has the depths of the row before and of the row after, empty at the picture's edge. After `stop` is set,
/// the remaining rows stay black. `num_shaded` counts only this shading.
fn light_walls(
    frame: &Frame<'_>,
    method: Method<'_>,
    light: &Lighting,
    (in_packets, simd): (bool, InstructionSet),
    (rows, cast): (&Range<usize>, CastWalls<'_>),
    beside: &[Vec<f32>; 2],
    stop: Option<&AtomicBool>,
) -> (Vec<u8>, CastStats) {
    let width = frame.camera().width();
    let num_pixels = rows.len() * width;
    let (mut rgb, mut depths) = (vec![0u8; 3 * num_pixels], vec![0.0f32; num_pixels]);
    let (cast, lit) = rgb
        .par_chunks_mut(3 * width * BAND_ROWS)
        .zip(depths.par_chunks_mut(width * BAND_ROWS))
        .enumerate()
        // Rows differ in cost, so each job has one item (see `share`).
        .with_max_len(1)
        .map_init(Vec::new, |buffer, (n, (rgb, depths))| {
            if stop.is_some_and(|stop| stop.load(Ordering::Relaxed)) {
                return Default::default();
            }
            let first = rows.start + n * BAND_ROWS;
            buffer.clear();
            buffer.resize(depths.len(), Gathered::NOTHING);
            let stats = cast(first, buffer);
            light_rows(frame, light, simd, first, buffer, rgb);
            for (depth, wall) in depths.iter_mut().zip(&*buffer) {
                *depth = wall.hit;
            }
            (stats, CastStats::default().lit(buffer))
        })
        .reduce(Default::default, |(a, b), (c, d)| (a.plus(c), b.plus(d)));
    let mut lit = lit;
    if light.appearance.silhouettes {
        let [before, after] = beside;
        let depths = DepthRows {
            width,
            first_row: rows.start,
            depths: &depths,
            before,
            after,
        };
        let how = (in_packets, simd);
        lit = lit.plus(smooth_silhouettes(
            frame, method, light, how, &depths, &mut rgb, stop,
        ));
    }
    let num_shaded = lit.num_shaded;
    let stats = CastStats {
        num_shaded,
        ..cast.plus(lit)
    };
    (rgb, stats)
}
