//! Set-up of the rays of many pixels at once: the operations of [`Frame::ray`] in loops that the compiler vectorises.
//!
//! The set-up uses f64 and takes a seventh of a frame's time if it is done ray by ray.

use std::ops::Range;

use super::lanes::{Array, MAX_LANES};
use crate::Frame;

/// Rays of some pixels: steps in voxels, index of each ray's first sample, and one more than the index of its last
/// sample.
pub(super) struct Rays {
    pub delta: [Array<f32>; 3],
    pub first: Array<i32>,
    pub end: Array<i32>,
}

/// Steps of rays in camera space, mm, by axis; all 0 for a pixel that the lens or the outline of the picture excludes.
#[derive(Clone, Copy)]
pub(super) struct Directions([[f64; MAX_LANES]; 3]);

/// Rectangle of a picture: range of columns and range of rows.
pub(super) type Patch = (Range<usize>, Range<usize>);

impl Directions {
    /// Compute the directions of the rays of patches, one patch after the other and each row by row.
    ///
    /// There must be at most as many pixels as lanes.
    #[inline(always)]
    pub(super) fn of(frame: &Frame<'_>, patches: impl Iterator<Item = Patch>) -> Self {
        let camera = frame.camera();
        let step_mm = frame.table.step_mm();
        let mut directions = Self([[0.0; MAX_LANES]; 3]);
        let mut lane = 0;
        if let Some(rays) = camera.lens_rays() {
            for (columns, rows) in patches {
                for row in rows {
                    let end = lane + columns.len();
                    let from = rays.directions_of(row);
                    for a in 0..3 {
                        let to = &mut directions.0[a][lane..end];
                        scaled(to, &from[a][columns.clone()], step_mm);
                    }
                    lane = end;
                }
            }
            return directions;
        }
        let (mut column, mut row) = ([0; MAX_LANES], [0; MAX_LANES]);
        for (columns, rows) in patches {
            for in_row in rows {
                let end = lane + columns.len();
                count_up(&mut column[lane..end], columns.start as i32, 1);
                count_up(&mut row[lane..end], in_row as i32, 0);
                lane = end;
            }
        }
        let (half_width, half_height) = (camera.width() as f64 / 2.0, camera.height() as f64 / 2.0);
        let z = camera.focal_px();
        let [to_x, to_y, to_z] = &mut directions.0;
        for n in 0..MAX_LANES {
            let x = (f64::from(column[n]) + 0.5) - half_width;
            let y = (f64::from(row[n]) + 0.5) - half_height;
            let scale = step_mm / (x * x + y * y + z * z).sqrt();
            to_x[n] = x * scale;
            to_y[n] = y * scale;
            to_z[n] = z * scale;
        }
        directions
    }

    /// Return whether no lane holds a ray.
    #[inline(always)]
    pub(super) fn have_no_ray(&self) -> bool {
        self.0.iter().flatten().all(|&d| d == 0.0)
    }

    /// Return the steps of the rays along one axis of the volume, in voxels.
    #[inline(always)]
    fn along(&self, frame: &Frame<'_>, axis: usize) -> [f64; MAX_LANES] {
        let [mx, my, mz, _] = frame.ijk_from_camera.rows()[axis];
        let [x, y, z] = &self.0;
        let mut d = [0.0; MAX_LANES];
        for n in 0..MAX_LANES {
            d[n] = mx * x[n] + my * y[n] + mz * z[n];
        }
        d
    }
}

/// Fill `to` with an arithmetic sequence that starts at `first` and increases by `by`.
///
/// The loop processes four items at a time, like that of [`scaled`].
#[inline(always)]
pub(super) fn count_up(to: &mut [i32], mut first: i32, by: i32) {
    let (fours, rest) = to.as_chunks_mut::<4>();
    for four in fours {
        for n in 0..4 {
            four[n] = first + n as i32 * by;
        }
        first += 4 * by;
    }
    for one in rest {
        *one = first;
        first += by;
    }
}

/// Write the numbers `from` times a factor to `to`.
///
/// The loop processes four items at a time; for fewer, the loop takes longer than its operations.
#[inline(always)]
fn scaled(to: &mut [f64], from: &[f32], factor: f64) {
    let (to, to_rest) = to.as_chunks_mut::<4>();
    let (from, from_rest) = from.as_chunks::<4>();
    for (to, from) in to.iter_mut().zip(from) {
        for n in 0..4 {
            to[n] = f64::from(from[n]) * factor;
        }
    }
    for (to, &from) in to_rest.iter_mut().zip(from_rest) {
        *to = f64::from(from) * factor;
    }
}

/// Return the steps of rays in voxels, in f32.
#[inline(always)]
pub(super) fn deltas_of(frame: &Frame<'_>, directions: &Directions) -> [Array<f32>; 3] {
    let mut delta = [[0.0; MAX_LANES]; 3];
    for a in 0..3 {
        let d = directions.along(frame, a);
        for n in 0..MAX_LANES {
            delta[a][n] = d[n] as f32;
        }
    }
    delta
}

/// Set up rays in the given directions by the operations of [`Frame::ray`] and `clip_line_to_box`.
#[inline(always)]
pub(super) fn rays_of(frame: &Frame<'_>, directions: &Directions) -> Rays {
    let shape = frame.grid.shape_ijk();
    let mut delta = [[0.0; MAX_LANES]; 3];
    let mut t_out = [f64::INFINITY; MAX_LANES];
    let (mut first, mut end) = ([0; MAX_LANES], [0; MAX_LANES]);
    let box_of = |a: usize| (-0.5, shape[a] as f64 - 0.5);
    let is_inside = (0..3).all(|a| {
        let (lo, hi) = box_of(a);
        (lo..=hi).contains(&frame.origin_ijk[a])
    });
    if is_inside {
        // The camera is in the box, so the nearer face of each axis is behind the camera or at it: every ray starts at
        // 0, and one division is enough.
        for a in 0..3 {
            let d = directions.along(frame, a);
            let origin = frame.origin_ijk[a];
            let (lo, hi) = box_of(a);
            let (behind, ahead) = (lo - origin, hi - origin);
            for n in 0..MAX_LANES {
                let d = d[n];
                delta[a][n] = d as f32;
                let far = (if d < 0.0 { behind } else { ahead }) / d;
                let far = if d == 0.0 { f64::INFINITY } else { far };
                t_out[n] = if far < t_out[n] { far } else { t_out[n] };
            }
        }
        for n in 0..MAX_LANES {
            let to = (t_out[n] + 0.5).floor().max(0.0) as i32;
            // A direction that does not advance along any axis is not a ray.
            end[n] = if t_out[n] < f64::INFINITY { to } else { 0 };
        }
        return Rays { delta, first, end };
    }
    let mut t_in = [f64::NEG_INFINITY; MAX_LANES];
    for a in 0..3 {
        let d = directions.along(frame, a);
        let origin = frame.origin_ijk[a];
        let (lo, hi) = box_of(a);
        // On an axis along which a ray does not advance, the ray is always inside the range or never.
        let still = if (lo..=hi).contains(&origin) {
            f64::INFINITY
        } else {
            f64::NEG_INFINITY
        };
        for n in 0..MAX_LANES {
            let d = d[n];
            delta[a][n] = d as f32;
            let (u, v) = ((lo - origin) / d, (hi - origin) / d);
            let near = if u < v { u } else { v };
            let far = if u < v { v } else { u };
            let near = if d == 0.0 { -still } else { near };
            let far = if d == 0.0 { still } else { far };
            t_in[n] = if t_in[n] < near { near } else { t_in[n] };
            t_out[n] = if far < t_out[n] { far } else { t_out[n] };
        }
    }
    for n in 0..MAX_LANES {
        // The part of a ray behind the camera is left out. `Packets::of` has checked that no ray has 2^30 steps.
        let hit = t_in[n] <= t_out[n];
        let from = (t_in[n] - 0.5).ceil().max(0.0) as i32;
        let to = (t_out[n] + 0.5).floor().max(0.0) as i32;
        first[n] = if hit { from } else { 0 };
        end[n] = if hit { to } else { 0 };
    }
    Rays { delta, first, end }
}
