//! Silhouettes: two rays for a pixel where a near wall ends before a far one, so that its edge is no staircase.
//!
//! Which pixels these are follows from the first walls of a pixel and of its four neighbours in the whole picture, and
//! the rays lie at fixed places in the pixel; so strips agree with the whole, leaps with brute force, and packets with
//! the scalar casters. Depth and measures stay those of the ray through the pixel's middle.

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
    surface::cast_walls_row,
};

/// Where the two rays lie, from the middle of a pixel, in pixels: about a third of it apart along both axes and along
/// neither diagonal, so that edges of most directions have a step between.
const BESIDE: [[f64; 2]; 2] = [[-0.2, -0.36], [0.2, 0.36]];
/// How far the inverse depth may bend from pixel to pixel, as a part of the nearest one's. It is straight along a plane,
/// however steeply that is seen; a bend of an eighth is 1/8 of the brightness of a wall.
const BEND: f32 = 0.125;
/// Light of a wall seen head on that is too faint for a staircase to be seen, linear.
const FAINT: f32 = 0.02;

/// How far light creeps round a silhouette, at least: an edge that is thin and wet is not the dark line that matt stone has
/// where it turns away.
const EDGE_WRAP: f32 = 0.6;

/// Rows that are searched together, and pixels that are cast together.
const ROWS_AT_A_TIME: usize = 16;
const PIXELS_AT_A_TIME: usize = 256;

/// Depths of the first walls of some rows in ray steps, with the rows before and after them where the picture has these.
#[derive(Clone, Copy)]
pub(crate) struct DepthRows<'a> {
    pub width: usize,
    pub first_row: usize,
    pub depths: &'a [f32],
    /// Empty at the picture's edge.
    pub before: &'a [f32],
    pub after: &'a [f32],
}

impl<'a> DepthRows<'a> {
    /// The pixels of a row, if they are known.
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

/// Inverse depths of a row in ray steps; 0 for a ray that meets no wall. A wall within the first step touches the lens.
/// Pixels outside the outline of a scope's picture have no ray and are no wall's edge: with NaN no comparison holds.
fn inverses(frame: &Frame<'_>, depths: &[f32], row: usize) -> Vec<f32> {
    let mut inverse = depths.to_vec();
    // Without a branch: several pixels at a time.
    for v in &mut inverse {
        let near = 1.0 / if *v > 1.0 { *v } else { 1.0 };
        *v = if *v < 0.0 { 0.0 } else { near };
    }
    if let Some(rays) = frame.camera().lens_rays() {
        let [x, y, z] = rays.directions_of(row);
        for (((v, x), y), z) in inverse.iter_mut().zip(x).zip(y).zip(z) {
            // Unit directions, or none.
            let has_ray = x * x + y * y + z * z > 0.5;
            *v = if has_ray { *v } else { f32::NAN };
        }
    }
    inverse
}

/// The pixels (column, row) of some rows that lie on a silhouette.
fn pixels_of(
    frame: &Frame<'_>,
    light: &Lighting,
    rows: &DepthRows<'_>,
    wanted: Range<usize>,
) -> Vec<(usize, usize)> {
    let known = |row: Option<usize>| {
        rows.row(row)
            .map(|pixels| inverses(frame, pixels, row.unwrap_or(0)))
    };
    // Where the light that comes back, `exposure / depth^2`, is faint.
    let least = (FAINT / light.exposure.max(1e-9)).sqrt() * light.step_mm;
    let mut found = Vec::new();
    let mut above = known(wanted.start.checked_sub(1));
    let mut here = known(Some(wanted.start));
    let mut on = vec![false; rows.width];
    for row in wanted {
        let below = known(Some(row + 1));
        let Some(middle) = here else {
            break;
        };
        on.fill(false);
        if let [_, between @ .., _] = &mut on[..] {
            mark_bends([&middle, &middle[1..], &middle[2..]], least, between);
        }
        if let (Some(above), Some(below)) = (&above, &below) {
            mark_bends([above, &middle, below], least, &mut on);
        }
        let columns = on.iter().enumerate();
        found.extend(columns.filter_map(|(column, &on)| on.then_some((column, row))));
        (above, here) = (Some(middle), below);
    }
    found
}

/// Marks where the inverse depth bends from the first over the second to the third.
fn mark_bends(three: [&[f32]; 3], least: f32, on: &mut [bool]) {
    let [before, middle, after] = three.map(|row| &row[..on.len()]);
    let larger = |a: f32, b: f32| if a > b { a } else { b };
    for n in 0..on.len() {
        let nearest = larger(larger(before[n], middle[n]), after[n]);
        let bend = (before[n] - 2.0 * middle[n] + after[n]).abs();
        on[n] |= nearest > least && bend > BEND * nearest;
    }
}

/// Casts and lights the two rays of every pixel on a silhouette in the rows that `rgb` holds, and shows their mean there.
/// Without packets the scalar casters do so. Once `stop` is set, what is left stays as it is.
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
    // A picture has few such pixels: collected from all rows, their rays fill whole packets.
    let pixels: Vec<(usize, usize)> = (0..num_rows.div_ceil(ROWS_AT_A_TIME))
        .into_par_iter()
        .flat_map_iter(|n| {
            let from = n * ROWS_AT_A_TIME;
            let to = (from + ROWS_AT_A_TIME).min(num_rows);
            pixels_of(frame, light, rows, first + from..first + to)
        })
        .collect();
    let mut round = light.clone();
    round.look.wrap = round.look.wrap.max(EDGE_WRAP);
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
    // Rays are counted by pixel.
    let stats = CastStats {
        num_rays: 0,
        ..stats.with_loads(frame, method).lit(&walls)
    };
    (stats, shown.collect())
}
