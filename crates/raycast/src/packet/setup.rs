//! Rays of many pixels at once: the operations of [`Frame::ray`] in loops that the compiler turns into vector
//! instructions, since f64 is enough work here to need them (a seventh of a frame when done ray by ray).

use super::lanes::{Array, MAX_LANES};
use crate::Frame;

/// Rays of some pixels: steps in voxels, first samples, ends.
pub(super) struct Rays {
    pub delta: [Array<f32>; 3],
    pub first: Array<i32>,
    pub end: Array<i32>,
}

/// The rays of pixels given by column and row; as in [`Frame::ray`] and `clip_line_to_box`.
#[inline(always)]
pub(super) fn rays_of(frame: &Frame<'_>, column: &Array<i32>, row: &Array<i32>) -> Rays {
    let camera = frame.camera();
    let (half_width, half_height) = (camera.width() as f64 / 2.0, camera.height() as f64 / 2.0);
    let z = camera.focal_px();
    let step_mm = frame.table.step_mm();
    let matrix = frame.ijk_from_camera.rows();
    let shape = frame.grid.shape_ijk();
    let mut scaled = [[0.0; MAX_LANES]; 3];
    // All have a ray but those that a lens or a mask leaves without.
    let mut bare = [false; MAX_LANES];
    if let Some(rays) = camera.lens_rays() {
        for n in 0..MAX_LANES {
            let dir = rays.direction(column[n] as usize, row[n] as usize);
            for a in 0..3 {
                scaled[a][n] = f64::from(dir[a]) * step_mm;
            }
            bare[n] = dir == [0.0; 3];
        }
    } else {
        for n in 0..MAX_LANES {
            let x = (f64::from(column[n]) + 0.5) - half_width;
            let y = (f64::from(row[n]) + 0.5) - half_height;
            let scale = step_mm / (x * x + y * y + z * z).sqrt();
            scaled[0][n] = x * scale;
            scaled[1][n] = y * scale;
            scaled[2][n] = z * scale;
        }
    }
    let mut delta = [[0.0; MAX_LANES]; 3];
    let mut t_out = [f64::INFINITY; MAX_LANES];
    let (mut first, mut end) = ([0; MAX_LANES], [0; MAX_LANES]);
    let box_of = |a: usize| (-0.5, shape[a] as f64 - 0.5);
    let is_inside = (0..3).all(|a| {
        let (lo, hi) = box_of(a);
        (lo..=hi).contains(&frame.origin_ijk[a])
    });
    if is_inside {
        // The nearer face of each axis lies behind the camera, or in it: every ray starts at 0, and one division is enough.
        for a in 0..3 {
            let [mx, my, mz, _] = matrix[a];
            let origin = frame.origin_ijk[a];
            let (lo, hi) = box_of(a);
            let (behind, ahead) = (lo - origin, hi - origin);
            for n in 0..MAX_LANES {
                let d = mx * scaled[0][n] + my * scaled[1][n] + mz * scaled[2][n];
                delta[a][n] = d as f32;
                let far = (if d < 0.0 { behind } else { ahead }) / d;
                let far = if d == 0.0 { f64::INFINITY } else { far };
                t_out[n] = if far < t_out[n] { far } else { t_out[n] };
            }
        }
        for n in 0..MAX_LANES {
            let to = (t_out[n] + 0.5).floor().max(0.0) as i32;
            end[n] = if bare[n] { 0 } else { to };
        }
        return Rays { delta, first, end };
    }
    let mut t_in = [f64::NEG_INFINITY; MAX_LANES];
    for a in 0..3 {
        let [mx, my, mz, _] = matrix[a];
        let origin = frame.origin_ijk[a];
        let (lo, hi) = box_of(a);
        // An axis along which a ray stands still holds it for ever, or never.
        let still = if (lo..=hi).contains(&origin) {
            f64::INFINITY
        } else {
            f64::NEG_INFINITY
        };
        for n in 0..MAX_LANES {
            let d = mx * scaled[0][n] + my * scaled[1][n] + mz * scaled[2][n];
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
        // What lies behind the camera starts at 0. `Packets::of` has checked that no ray has 2^30 steps.
        let hit = t_in[n] <= t_out[n] && !bare[n];
        let from = (t_in[n] - 0.5).ceil().max(0.0) as i32;
        let to = (t_out[n] + 0.5).floor().max(0.0) as i32;
        first[n] = if hit { from } else { 0 };
        end[n] = if hit { to } else { 0 };
    }
    Rays { delta, first, end }
}
