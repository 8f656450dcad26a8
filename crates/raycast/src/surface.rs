//! Computation of the first wall of every ray: its depth, position and normal.
//!
//! Picking, contact detection, synthetic data and shading use these walls.

use std::ops::Range;

use rayon::prelude::*;

use crate::{
    CastStats, Frame, InstructionSet, Interpolation, Method, RaycastError, brute,
    composite::Gathered,
    frame::Ray,
    leap::{self, Start},
    normals::Normals,
    packet::{BAND_ROWS, Packets},
    rows::{check, share},
};

/// First wall of a ray: the point where the remaining transparency falls below one half.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Distance in mm of the wall from the camera's centre, along the ray of the pixel.
    pub depth_mm: f32,
    /// Position of the wall, LPS mm.
    pub position_lps: [f64; 3],
    /// Unit normal of the wall (LPS), which points to the camera's side.
    ///
    /// In flat tissue, which has no direction, the normal is the reverse of the ray's direction.
    pub normal_lps: [f32; 3],
}

/// Return the first walls of `rows` of the picture, `[row, column]`; `None` for a ray that meets no wall.
///
/// Depths and positions are the same for brute force and for leaps over transparent classes, in whole pictures and in
/// strips, on every instruction set. The walls do not depend on the light of the frame's options.
///
/// # Errors
///
/// Returns an error if the rows, the instruction set or the maps of `method` are not valid for the frame.
pub fn cast_surface(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: Range<usize>,
    simd: InstructionSet,
) -> Result<(Vec<Option<Hit>>, CastStats), RaycastError> {
    let first_row = rows.start;
    let (walls, stats) = cast_walls(frame, method, rows, simd)?;
    let width = frame.camera().width();
    let normals = Normals::of(frame);
    let hits = walls
        .par_iter()
        .enumerate()
        .with_min_len(256)
        .map(|(n, wall)| {
            let (column, row) = (n % width, first_row + n / width);
            (wall.hit >= 0.0).then(|| hit_of(frame, &normals, column, row, wall.hit))
        })
        .collect();
    Ok((hits, stats))
}

/// Return the first wall at one pixel, equal to that of [`cast_surface`]; `None` if the pixel's ray meets no wall.
///
/// # Errors
///
/// Returns an error if the pixel is outside the picture, or if the maps of `method` are not valid for the frame.
pub fn pick(
    frame: &Frame<'_>,
    method: Method<'_>,
    column: usize,
    row: usize,
) -> Result<Option<Hit>, RaycastError> {
    let camera = frame.camera();
    for (what, n, end) in [
        ("column", column, camera.width()),
        ("row", row, camera.height()),
    ] {
        if n >= end {
            return Err(RaycastError::Setting {
                what,
                expected: format!("0 to {}", end - 1),
                found: n.to_string(),
            });
        }
    }
    check(frame, method, &(row..row + 1), InstructionSet::Portable)?;
    let wall = wall_at(frame, method, column, row);
    let found = wall.hit >= 0.0;
    Ok(found.then(|| hit_of(frame, &Normals::of(frame), column, row, wall.hit)))
}

/// Cast the ray of one pixel, unshaded, and include its first wall in the result.
pub(crate) fn wall_at(
    frame: &Frame<'_>,
    method: Method<'_>,
    column: usize,
    row: usize,
) -> Gathered {
    cast_wall(
        frame,
        method,
        Start::of(frame, method),
        &frame.ray(column, row),
        &mut CastStats::default(),
    )
}

/// Cast the rays of `rows`, unshaded, and include their first walls in the results.
pub(crate) fn cast_walls(
    frame: &Frame<'_>,
    method: Method<'_>,
    rows: Range<usize>,
    simd: InstructionSet,
) -> Result<(Vec<Gathered>, CastStats), RaycastError> {
    check(frame, method, &rows, simd)?;
    let pixels = (Gathered::NOTHING, frame.camera().width());
    if let Some(packets) = Packets::of(frame, method, simd).filter(Packets::find_walls) {
        return Ok(share(&rows, pixels, BAND_ROWS, None, |first, out| {
            packets.cast_walls(first, out).with_loads(frame, method)
        }));
    }
    Ok(share(&rows, pixels, 1, None, |row, out| {
        cast_walls_row(frame, method, row, out).with_loads(frame, method)
    }))
}

/// Cast the rays of one row with the scalar casters, unshaded, and include their first walls in the results.
pub(crate) fn cast_walls_row(
    frame: &Frame<'_>,
    method: Method<'_>,
    row: usize,
    out: &mut [Gathered],
) -> CastStats {
    let (start, mut stats) = (Start::of(frame, method), CastStats::default());
    for (column, pixel) in out.iter_mut().enumerate() {
        *pixel = cast_wall(frame, method, start, &frame.ray(column, row), &mut stats);
    }
    stats.num_rays = out.len() as u64;
    stats
}

fn cast_wall(
    frame: &Frame<'_>,
    method: Method<'_>,
    start: Start,
    ray: &Ray,
    stats: &mut CastStats,
) -> Gathered {
    let nearest = frame.options.interpolation == Interpolation::Nearest;
    match (method, nearest) {
        (Method::Brute, false) => brute::cast::<false, false, true>(frame, ray, stats),
        (Method::Brute, true) => brute::cast::<false, true, true>(frame, ray, stats),
        (Method::LeapTransparent(radius), false) => {
            leap::cast_transparent::<false, false, true>(frame, radius, start, ray, stats)
        }
        (Method::LeapTransparent(radius), true) => {
            leap::cast_transparent::<false, true, true>(frame, radius, start, ray, stats)
        }
        (Method::LeapClasses(map), _) => leap::cast_classes::<true>(frame, map, start, ray, stats),
        (Method::LeapValues(map), _) => leap::cast_values::<true>(frame, map, ray, stats),
    }
}

fn hit_of(frame: &Frame<'_>, normals: &Normals, column: usize, row: usize, hit: f32) -> Hit {
    let ray = frame.ray(column, row);
    // The position is computed in f64, so that sums of such positions do not accumulate rounding errors; f32 would be
    // accurate to 0.03 um at the far end of a patient.
    let at: [f64; 3] = std::array::from_fn(|a| {
        f64::from(hit).mul_add(f64::from(ray.delta[a]), frame.origin_ijk[a])
    });
    Hit {
        depth_mm: hit * frame.step_mm,
        position_lps: frame.grid.lps_from_ijk().point(at),
        normal_lps: normals.at(frame, &ray, hit),
    }
}
