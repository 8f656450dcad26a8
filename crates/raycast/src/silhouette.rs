//! Silhouettes: two rays for a pixel where a near wall ends before a far one, so that its edge is no staircase.
//!
//! Which pixels these are follows from the first walls of a pixel and of its four neighbours in the whole picture, and
//! the rays lie at fixed places in the pixel; so strips agree with the whole, leaps with brute force, and packets with
//! the scalar casters. Depth and measures stay those of the ray through the pixel's middle.

use std::ops::Range;

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

/// What the rays of some rows have gathered, with the rows before and after them where the picture has these.
#[derive(Clone, Copy)]
pub(crate) struct WallRows<'a> {
    pub width: usize,
    pub first_row: usize,
    pub walls: &'a [Gathered],
    /// Empty at the picture's edge.
    pub before: &'a [Gathered],
    pub after: &'a [Gathered],
}

impl<'a> WallRows<'a> {
    /// The pixels of a row, if they are known.
    fn row(&self, row: Option<usize>) -> Option<&'a [Gathered]> {
        let row = row?;
        let num_rows = self.walls.len() / self.width;
        let pixels = if row + 1 == self.first_row {
            self.before
        } else if row == self.first_row + num_rows {
            self.after
        } else {
            let at = row.checked_sub(self.first_row)? * self.width;
            self.walls.get(at..at + self.width)?
        };
        (!pixels.is_empty()).then_some(pixels)
    }
}

/// Inverse depths of a row in ray steps; 0 for a ray that meets no wall. A wall within the first step touches the lens.
/// Pixels outside the outline of a scope's picture have no ray and are no wall's edge: with NaN no comparison holds.
fn inverses(frame: &Frame<'_>, pixels: &[Gathered], row: usize) -> Vec<f32> {
    let mut inverse: Vec<f32> = pixels
        .iter()
        .map(|wall| {
            let near = 1.0 / wall.hit.max(1.0);
            if wall.hit < 0.0 { 0.0 } else { near }
        })
        .collect();
    if let Some(rays) = frame.camera().lens_rays() {
        for (column, inverse) in inverse.iter_mut().enumerate() {
            if rays.direction(column, row) == [0.0; 3] {
                *inverse = f32::NAN;
            }
        }
    }
    inverse
}

/// The pixels (column, row) of some rows that lie on a silhouette.
fn pixels_of(
    frame: &Frame<'_>,
    light: &Lighting,
    rows: &WallRows<'_>,
    wanted: Range<usize>,
) -> Vec<(usize, usize)> {
    let known = |row: Option<usize>| {
        rows.row(row)
            .map(|pixels| inverses(frame, pixels, row.unwrap_or(0)))
    };
    // Where the light that comes back, `exposure / depth^2`, is faint.
    let least = (FAINT / light.exposure.max(1e-9)).sqrt() * light.step_mm;
    let bends = |before: f32, middle: f32, after: f32| {
        let nearest = before.max(middle).max(after);
        nearest > least && (before - 2.0 * middle + after).abs() > BEND * nearest
    };
    let mut found = Vec::new();
    let mut above = known(wanted.start.checked_sub(1));
    let mut here = known(Some(wanted.start));
    for row in wanted {
        let below = known(Some(row + 1));
        let Some(middle) = here else {
            break;
        };
        let mut on = vec![false; middle.len()];
        for (on, three) in on.iter_mut().skip(1).zip(middle.windows(3)) {
            *on = bends(three[0], three[1], three[2]);
        }
        if let (Some(above), Some(below)) = (&above, &below) {
            let three = above.iter().zip(&middle).zip(below);
            for (on, ((&above, &middle), &below)) in on.iter_mut().zip(three) {
                *on |= bends(above, middle, below);
            }
        }
        found.extend(
            on.iter()
                .enumerate()
                .filter_map(|(column, &on)| on.then_some((column, row))),
        );
        (above, here) = (Some(middle), below);
    }
    found
}

/// Casts and lights the two rays of every pixel on a silhouette in the rows that `rgb` holds, from `first_row` on, and
/// shows their mean there. Without packets the scalar casters do so.
pub(crate) fn smooth_silhouettes(
    frame: &Frame<'_>,
    method: Method<'_>,
    light: &Lighting,
    (leaps, simd): (bool, InstructionSet),
    rows: &WallRows<'_>,
    (first_row, rgb): (usize, &mut [u8]),
) -> CastStats {
    let width = rows.width;
    let num_rows = rgb.len() / (3 * width);
    let pixels = pixels_of(frame, light, rows, first_row..first_row + num_rows);
    if pixels.is_empty() {
        return CastStats::default();
    }
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
    let mut round = light.clone();
    round.look.wrap = round.look.wrap.max(EDGE_WRAP);
    light_rows(&listed, &round, simd, 0, &walls, &mut shown);
    for (&(column, row), two) in pixels.iter().zip(shown.chunks_exact(6)) {
        let at = 3 * ((row - first_row) * width + column);
        for c in 0..3 {
            rgb[at + c] = u16::midpoint(u16::from(two[c]), u16::from(two[3 + c]) + 1) as u8;
        }
    }
    // Rays are counted by pixel.
    CastStats {
        num_rays: 0,
        ..stats.with_loads(frame, method).lit(&walls)
    }
}
