//! Pictures whose first walls are lit after casting: all rows are cast, with a row more on each side of a strip, and then
//! lit, since a pixel on a silhouette is known by its neighbours.

use std::{ops::Range, sync::atomic::AtomicBool};

use crate::{
    CastStats, Frame, InstructionSet, Method,
    composite::Gathered,
    lighting::Lighting,
    packet::{BAND_ROWS, Packets, light_rows},
    rows::share,
    silhouette::{WallRows, smooth_silhouettes},
    surface::cast_walls_row,
};

/// The rows that a picture of `rows` is lit from: the row before and the row after, too, where silhouettes are smoothed.
#[must_use]
pub fn rows_to_gather(frame: &Frame<'_>, rows: &Range<usize>) -> Range<usize> {
    let smooth = frame
        .options
        .appearance
        .is_some_and(|look| look.silhouettes);
    if smooth && !rows.is_empty() {
        rows.start.saturating_sub(1)..(rows.end + 1).min(frame.camera().height())
    } else {
        rows.clone()
    }
}

/// Casts rows, by packets or without them by the scalar casters, and lights them. The rays of the rows beside a strip are
/// not counted: they are another strip's.
pub(crate) fn cast_lit(
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
    let blank = (Gathered::NOTHING, width);
    let (walls, stats) = share(rows, blank, BAND_ROWS, stop, |first, out| {
        cast(first, out).with_loads(frame, method)
    });
    let all = rows_to_gather(frame, rows);
    let beside = |rows: Range<usize>| {
        let mut out = vec![Gathered::NOTHING; rows.len() * width];
        if !out.is_empty() {
            cast(rows.start, &mut out);
        }
        out
    };
    let (before, after) = (beside(all.start..rows.start), beside(rows.end..all.end));
    let walls = WallRows {
        width,
        first_row: rows.start,
        walls: &walls,
        before: &before,
        after: &after,
    };
    let how = (packets.is_some(), simd);
    let (rgb, lit) = light_walls(frame, method, light, how, rows, &walls, stop);
    let num_shaded = lit.num_shaded;
    (
        rgb,
        CastStats {
            num_shaded,
            ..stats.plus(lit)
        },
    )
}

/// Lights rows that have been gathered; where the look asks for it, silhouettes are cast and lit anew. The counts hold
/// what that took.
pub(crate) fn light_walls(
    frame: &Frame<'_>,
    method: Method<'_>,
    light: &Lighting,
    (in_packets, simd): (bool, InstructionSet),
    rows: &Range<usize>,
    walls: &WallRows<'_>,
    stop: Option<&AtomicBool>,
) -> (Vec<u8>, CastStats) {
    let width = walls.width;
    let (mut rgb, stats) = share(rows, (0u8, 3 * width), BAND_ROWS, stop, |first, out| {
        let at = (first - rows.start) * width;
        let here = &walls.walls[at..at + out.len() / 3];
        light_rows(frame, light, simd, first, here, out);
        CastStats::default().lit(here)
    });
    if !light.look.silhouettes {
        return (rgb, stats);
    }
    let how = (in_packets, simd);
    let smoothed = smooth_silhouettes(frame, method, light, how, walls, &mut rgb, stop);
    (rgb, stats.plus(smoothed))
}
