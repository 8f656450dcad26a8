//! The first wall of every ray: how far it is, where it lies, which way it faces.
//!
//! Picking, contact and synthetic data need it, and lighting starts from it.

use std::ops::Range;

use rayon::prelude::*;

use crate::{
    CastStats, Frame, InstructionSet, Interpolation, Method, RaycastError, TransferTable, brute,
    composite::Gathered,
    frame::Ray,
    image::{check, share},
    leap::{self, Start},
    packet::{BAND_ROWS, Packets},
    sampling::Lanes,
};

/// The first wall of a ray: where what shines through falls below one half.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    /// Along the ray from the camera's centre.
    pub depth_mm: f32,
    /// The point.
    pub position_lps: [f64; 3],
    /// Unit normal of the wall, on the camera's side; the way back along the ray in flat tissue, which has no direction.
    pub normal_lps: [f32; 3],
}

/// First walls of `rows` of the picture, `[row, column]`, `None` where a ray meets none.
///
/// Depths and positions are the same for brute force and for leaps over transparent classes, in whole pictures and in
/// strips, on every instruction set. The light of the frame's options has no part in them.
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

/// The first wall at one pixel: one ray, the same numbers as [`cast_surface`] gives for it.
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

/// What the ray of one pixel gathers.
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

/// What the rays of `rows` gather without the light at the tip, first walls included.
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

/// The same for one row, by the scalar casters.
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
        (Method::LeapClasses(map), false) => {
            leap::cast_classes::<false, true>(frame, map, start, ray, stats)
        }
        (Method::LeapClasses(map), true) => {
            leap::cast_classes::<true, true>(frame, map, start, ray, stats)
        }
    }
}

fn hit_of(frame: &Frame<'_>, normals: &Normals, column: usize, row: usize, hit: f32) -> Hit {
    let ray = frame.ray(column, row);
    // In f64: f32 leaves 0.03 um at the far end of a patient, but sums of such positions should not drift either.
    let at: [f64; 3] = std::array::from_fn(|a| {
        f64::from(hit).mul_add(f64::from(ray.delta[a]), frame.origin_ijk[a])
    });
    Hit {
        depth_mm: hit * frame.step_mm,
        position_lps: frame.grid.lps_from_ijk().point(at),
        normal_lps: normals.at(frame, &ray, hit),
    }
}

/// The samples that a wall's normal is taken from lie about this far from it: noise of a CT has this grain, cartilage
/// rings are several times as wide.
const NORMAL_REACH_MM: f64 = 0.9;
/// And at least this many voxels: within one, a value is linear and has no noise that could be smoothed away.
const NORMAL_REACH_VOX: f64 = 0.8;
/// Six samples along the axes and eight at the corners of a box: their places in units of the reach, and the weight of
/// those along the axes. Chosen by trial: on a plane edge blurred by 0.7 voxels the normal is off by 0.2 degrees (0.6 at
/// most), where the corners alone miss by 4 and the axes alone by 2.4.
pub(crate) const AXIS_AT: f32 = 1.2;
pub(crate) const AXIS_WEIGHT: f32 = 0.96;
pub(crate) const CORNER_AT: f32 = 0.7;
pub(crate) const CORNER_WEIGHT: f32 = 0.7;
/// Contrast of air and tissue is twice this.
const HALF_CONTRAST_HU: f32 = 500.0;

/// How normals of walls are found: by a gradient over [`NORMAL_REACH_MM`], which keeps noise from looking like gravel.
///
/// Values are held near the wall's own: what lies far behind it or before it (vessels, bone, noise of the air) has no say
/// in how the wall is inclined.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Normals {
    /// Voxels.
    pub reach: [f32; 3],
    /// Values are held between these.
    pub held: [f32; 2],
    /// `inward = rows . rise`, in LPS: the transposed inverse of the voxel axes, divided by the reach.
    pub rows: [[f32; 3]; 3],
}

impl Normals {
    pub(crate) fn of(frame: &Frame<'_>) -> Self {
        let lps_from_ijk = frame.grid.lps_from_ijk();
        let reach: [f64; 3] = std::array::from_fn(|a| {
            let spacing = carina_grid::length(lps_from_ijk.column(a));
            (NORMAL_REACH_MM / spacing).max(NORMAL_REACH_VOX)
        });
        let ijk_from_lps = frame.grid.ijk_from_lps();
        let rows = ijk_from_lps.rows();
        Self {
            reach: reach.map(|v| v as f32),
            held: held_between(frame.table),
            rows: std::array::from_fn(|x| std::array::from_fn(|a| (rows[a][x] / reach[a]) as f32)),
        }
    }

    /// The unit normal at a hit, on the camera's side.
    pub(crate) fn at(&self, frame: &Frame<'_>, ray: &Ray, hit: f32) -> [f32; 3] {
        let p: Lanes = std::array::from_fn(|a| hit.mul_add(ray.delta[a], ray.origin[a]));
        let [low, high] = self.held;
        let value = |p: Lanes| frame.field.value_in(&frame.field.cell(p));
        let held = |p: Lanes| value(p).max(low).min(high);
        let mut rise = [0.0f32; 3];
        for a in 0..3 {
            let (mut before, mut after) = (p, p);
            before[a] = (-AXIS_AT).mul_add(self.reach[a], p[a]);
            after[a] = AXIS_AT.mul_add(self.reach[a], p[a]);
            rise[a] = AXIS_WEIGHT * (held(after) - held(before));
        }
        for corner in 0..4 {
            // A corner and the one across.
            let side = [1.0, [1.0f32, -1.0][corner & 1], [1.0f32, -1.0][corner >> 1]];
            let (mut before, mut after) = (p, p);
            for a in 0..3 {
                let off = side[a] * CORNER_AT;
                before[a] = (-off).mul_add(self.reach[a], p[a]);
                after[a] = off.mul_add(self.reach[a], p[a]);
            }
            let across = CORNER_WEIGHT * (held(after) - held(before));
            for a in 0..3 {
                rise[a] = side[a].mul_add(across, rise[a]);
            }
        }
        let inward: [f32; 3] = std::array::from_fn(|x| dot(rise, self.rows[x]));
        let lps_from_ijk = frame.grid.lps_from_ijk();
        let along = lps_from_ijk
            .vector([0, 1, 2].map(|a| f64::from(ray.delta[a])))
            .map(|v| v as f32 / frame.step_mm);
        let length = dot(inward, inward).sqrt();
        // A rise of 1e-3 HU over the box is rounding.
        if length <= 1e-3 {
            return along.map(|v| -v);
        }
        let outward = if dot(inward, along) < 0.0 { 1.0 } else { -1.0 } / length;
        inward.map(|v| outward * v)
    }
}

pub(crate) fn dot(u: [f32; 3], v: [f32; 3]) -> f32 {
    u[2].mul_add(v[2], u[1].mul_add(v[1], u[0] * v[0]))
}

/// Values that tell how a wall is inclined: the transfer function's ramp and about half the contrast of an airway to each
/// side of its middle, as far as the volume has so much.
fn held_between(table: &TransferTable) -> [f32; 2] {
    let most = table.entries.iter().map(|e| e[3]).fold(0.0, f32::max);
    let opaque = table.entries.iter().position(|e| e[3] >= 0.9 * most);
    let (clear, opaque) = (table.first_visible, opaque.unwrap_or(0) as i32);
    let middle = table.lo_hu as f32 + 0.5 * (clear + opaque) as f32;
    let window = (0.8 * (opaque - clear) as f32)
        .max(HALF_CONTRAST_HU)
        .min(table.last as f32 / 2.0)
        .max(1.0);
    [middle - window, middle + window]
}
