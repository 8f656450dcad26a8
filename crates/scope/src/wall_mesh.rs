//! Signed distance field of the wall from a closed mesh: exact to the nearest triangle at every sample.

use std::sync::atomic::{AtomicUsize, Ordering};

use carina_grid::{Affine, InstructionSet};
use rayon::prelude::*;

use crate::ScopeError;
use crate::nearest::Boxes;
use crate::nearest_packet::{Found, Packets, Together};
use crate::vector8::LANES;
use crate::wall::{Brick, CELLS, INSIDE_MM, OUTSIDE_MM, SAMPLES, WallField, clamped};

type Point = [f64; 3];

impl WallField {
    /// Compute the wall field of a closed mesh, on samples `spacing_mm` apart.
    ///
    /// The triangles must be counterclockwise as seen from outside. `proceed` receives the completed fraction (0 to 1)
    /// of the work and returns false to stop the computation.
    ///
    /// # Errors
    ///
    /// Returns an error if the mesh is not valid or `proceed` returns false.
    pub fn from_mesh(
        vertices: &[Point],
        triangles: &[[u32; 3]],
        spacing_mm: f64,
        proceed: &(impl Fn(f64) -> bool + Sync),
    ) -> Result<Self, ScopeError> {
        let refuse = |reason: String| Err(ScopeError::Wall { reason });
        if !(0.1..=0.6).contains(&spacing_mm) {
            return refuse(format!(
                "its samples must lie 0.1 to 0.6 mm apart, found {spacing_mm}"
            ));
        }
        if triangles.is_empty() || vertices.iter().flatten().any(|v| !v.is_finite()) {
            return refuse("its mesh has no triangles, or corners that are not finite".to_owned());
        }
        if let Some(t) = triangles
            .iter()
            .position(|t| t.iter().any(|&v| v as usize >= vertices.len()))
        {
            return refuse(format!("triangle {t} of its mesh names a missing vertex"));
        }
        let boxes = Boxes::new(vertices, triangles);
        let (least, most) = boxes.nodes[0].span();
        let low = least.map(|v| v - OUTSIDE_MM);
        let shape_ijk: [usize; 3] = std::array::from_fn(|a| {
            let cells = ((most[a] + OUTSIDE_MM - low[a]) / spacing_mm).ceil() as usize;
            cells.div_ceil(CELLS) * CELLS + 1
        });
        let lps = Affine::from_columns(
            [spacing_mm, 0.0, 0.0],
            [0.0, spacing_mm, 0.0],
            [0.0, 0.0, spacing_mm],
            low,
        );
        let num_bricks = shape_ijk.map(|n| (n - 1) / CELLS);
        let steps = Steps {
            done: AtomicUsize::new(0),
            proceed,
        };
        let kinds = brick_kinds(&boxes, &lps, num_bricks, &steps)?;
        let near: Vec<(usize, usize)> = kinds
            .iter()
            .enumerate()
            .filter_map(|(n, kind)| match kind {
                Kind::Near(hint) => Some((n, *hint)),
                _ => None,
            })
            .collect();
        let packets = Packets::new(&boxes, InstructionSet::best());
        let mut slots = vec![usize::MAX; kinds.len()];
        for (slot, &(n, _)) in near.iter().enumerate() {
            slots[n] = slot;
        }
        // The first brick whose check returns false stops all bricks.
        let owned: Option<Vec<Owned>> = near
            .par_iter()
            .map(|&(n, hint)| {
                let first = place_of(n, num_bricks).map(|b| b * CELLS);
                let owned = own_samples(&packets, &lps, first, hint);
                steps.report_bricks(near.len()).then_some(owned)
            })
            .collect();
        let owned = owned.ok_or(ScopeError::Cancelled)?;
        let sample = |at: [usize; 3]| {
            let brick = at.map(|v| v / CELLS);
            if (0..3).any(|a| brick[a] == num_bricks[a]) {
                return -OUTSIDE_MM as f32;
            }
            let n = index_of(brick, num_bricks);
            match kinds[n] {
                Kind::Outside => -OUTSIDE_MM as f32,
                Kind::Inside => INSIDE_MM as f32,
                Kind::Near(_) => {
                    let local: [usize; 3] = std::array::from_fn(|a| at[a] - brick[a] * CELLS);
                    owned[slots[n]][index_of(local, [CELLS; 3])]
                }
            }
        };
        Self::build(shape_ijk, lps, |first| {
            let n = index_of(first.map(|v| v / CELLS), num_bricks);
            match kinds[n] {
                Kind::Outside => Brick::Outside,
                Kind::Inside => Brick::Inside,
                Kind::Near(_) => {
                    let own = &owned[slots[n]];
                    let mut samples = Vec::with_capacity(SAMPLES);
                    for z in 0..=CELLS {
                        for y in 0..=CELLS {
                            let there = |x: usize| [first[0] + x, first[1] + y, first[2] + z];
                            // The samples that the brick owns are contiguous; the other samples come from its
                            // neighbours.
                            let own_row = if y < CELLS && z < CELLS {
                                let row = (z * CELLS + y) * CELLS;
                                &own[row..row + CELLS]
                            } else {
                                &[]
                            };
                            samples.extend_from_slice(own_row);
                            samples.extend((own_row.len()..=CELLS).map(|x| sample(there(x))));
                        }
                    }
                    Brick::of(samples)
                }
            }
        })
    }
}

/// Samples that a brick owns, x fastest: all but those on its far faces, which its neighbours own.
type Owned = Vec<f32>;

/// Fraction of the work (0 to 1) that is completed when the kind of each brick is known.
const CLASSED: f64 = 0.1;

/// Number of packets of eight samples that a brick owns.
const NUM_PACKETS: usize = (CELLS / 2) * (CELLS / 2) * (CELLS / 2);

/// Progress counter of the computation, with the function that may stop it.
struct Steps<'a, F> {
    done: AtomicUsize,
    proceed: &'a F,
}

impl<F: Fn(f64) -> bool + Sync> Steps<'_, F> {
    /// Count a finished brick, of `num` bricks; return false if the computation must stop.
    fn report_bricks(&self, num: usize) -> bool {
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        (self.proceed)(CLASSED + (1.0 - CLASSED) * done as f64 / num as f64)
    }
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    Outside,
    Inside,
    /// Brick near the wall, with the triangle nearest to the brick's middle, at which every search in the brick starts.
    Near(usize),
}

#[inline]
fn place_of(n: usize, num: [usize; 3]) -> [usize; 3] {
    [n % num[0], n / num[0] % num[1], n / num[0] / num[1]]
}

#[inline]
const fn index_of(at: [usize; 3], num: [usize; 3]) -> usize {
    (at[2] * num[1] + at[1]) * num[0] + at[0]
}

/// Return for each brick whether it is near the wall, outside the lumen or inside.
///
/// Bricks near a triangle's box are `Near`. Other bricks that are connected with the faces of the lattice are
/// `Outside`. For the remaining bricks the signed distance from the brick's centre to the wall determines the kind.
fn brick_kinds<F: Fn(f64) -> bool + Sync>(
    boxes: &Boxes,
    lps: &Affine,
    num: [usize; 3],
    steps: &Steps<'_, F>,
) -> Result<Vec<Kind>, ScopeError> {
    let spacing = carina_grid::length(lps.column(0));
    let half = 0.5 * CELLS as f64;
    let reach = half * spacing * libm::sqrt(3.0);
    let near = triangles_near(boxes, lps.point([0.0; 3]), CELLS as f64 * spacing, num);
    let is_outside = reached_from_outside(&near, num);
    let layer = num[0] * num[1];
    let made: Vec<Vec<Kind>> = (0..num[2])
        .into_par_iter()
        .map(|bz| {
            let mut hint = 0;
            (0..layer)
                .map(|m| {
                    let n = bz * layer + m;
                    if near[n] != NONE {
                        return Kind::Near(near[n] as usize);
                    }
                    if is_outside[n] {
                        return Kind::Outside;
                    }
                    let first = place_of(n, num).map(|b| b * CELLS);
                    let (distance, triangle) =
                        boxes.signed(lps.point(first.map(|v| v as f64 + half)), hint);
                    hint = triangle;
                    if distance < -(OUTSIDE_MM + reach) {
                        Kind::Outside
                    } else if distance > INSIDE_MM + reach {
                        Kind::Inside
                    } else {
                        Kind::Near(triangle)
                    }
                })
                .collect()
        })
        .collect();
    if !(steps.proceed)(CLASSED) {
        return Err(ScopeError::Cancelled);
    }
    Ok(made.concat())
}

/// Return the position (0 or 1 on each axis) of a lane in its packet of 2 x 2 x 2 samples.
#[inline]
const fn bits(lane: usize) -> [usize; 3] {
    [lane & 1, lane >> 1 & 1, lane >> 2 & 1]
}

/// Return the offsets of a packet's samples from its first sample: two on each axis, `apart_mm` apart.
///
/// The lattice is parallel to the LPS axes.
fn two_on_each_axis(apart_mm: f32) -> [[f32; LANES]; 3] {
    let mut at = [[0.0; LANES]; 3];
    for (a, row) in at.iter_mut().enumerate() {
        for (lane, v) in row.iter_mut().enumerate() {
            *v = bits(lane)[a] as f32 * apart_mm;
        }
    }
    at
}

/// Return the signed distances from the samples that a brick owns to the mesh.
fn own_samples(packets: &Packets<'_>, lps: &Affine, first: [usize; 3], hint: usize) -> Owned {
    let mut found = vec![0.0; CELLS * CELLS * CELLS];
    let spacing = carina_grid::length(lps.column(0)) as f32;
    let apart = two_on_each_axis(spacing);
    // The largest distance from any sample of a packet to any sample of the next packet.
    let reach = libm::sqrtf(9.0 + 1.0 + 1.0) * spacing;
    let mut hint = hint as u32;
    let mut before = 0.0f32;
    for n in 0..NUM_PACKETS {
        let at = place_of(n, [CELLS / 2; 3]).map(|v| 2 * v);
        let place = index_of(at, [CELLS; 3]);
        if at[0] > 0 && (before > INSIDE_MM as f32 + reach || before < -(OUTSIDE_MM as f32 + reach))
        {
            // The previous packet is so far from the wall that the values of this packet are at the limit as well; no
            // query is needed.
            for lane in 0..LANES {
                found[place + index_of(bits(lane), [CELLS; 3])] = clamped(before);
            }
            before -= before.signum() * reach;
            continue;
        }
        let points = Together {
            origin: lps.point(std::array::from_fn(|a| (first[a] + at[a]) as f64)),
            at: apart,
        };
        let Found {
            signed_mm,
            triangles,
        } = packets.signed(&points, hint);
        hint = triangles[1];
        before = signed_mm[0];
        for (lane, &distance) in signed_mm.iter().enumerate() {
            found[place + index_of(bits(lane), [CELLS; 3])] = clamped(distance);
        }
    }
    found
}

/// Number that marks the absence of a triangle.
const NONE: u32 = u32::MAX;

/// Return, for each brick, a triangle whose box is within [`OUTSIDE_MM`] of the brick.
///
/// The result is [`NONE`] for a brick without such a triangle: the whole brick is then inside the lumen, or farther
/// outside.
fn triangles_near(boxes: &Boxes, low: Point, brick_mm: f64, num: [usize; 3]) -> Vec<u32> {
    let mut near = vec![NONE; num.iter().product()];
    for (t, corners) in boxes.triangles.iter().enumerate() {
        let mut first = [0; 3];
        let mut last = [0; 3];
        for a in 0..3 {
            let (from, to) = corners.iter().fold((f64::MAX, f64::MIN), |(from, to), c| {
                (from.min(c[a]), to.max(c[a]))
            });
            let place = |v: f64| ((v - low[a]) / brick_mm).max(0.0) as usize;
            first[a] = place(from - OUTSIDE_MM).min(num[a] - 1);
            last[a] = place(to + OUTSIDE_MM).min(num[a] - 1);
        }
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                let row = (z * num[1] + y) * num[0];
                near[row + first[0]..=row + last[0]].fill(t as u32);
            }
        }
    }
    near
}

/// Return for each brick whether a path of bricks without near triangles connects it with a face of the lattice.
fn reached_from_outside(near: &[u32], num: [usize; 3]) -> Vec<bool> {
    let mut reached = vec![false; near.len()];
    let mut open = Vec::new();
    for n in 0..near.len() {
        let at = place_of(n, num);
        if (0..3).any(|a| at[a] == 0 || at[a] + 1 == num[a]) && near[n] == NONE {
            reached[n] = true;
            open.push(at);
        }
    }
    while let Some(at) = open.pop() {
        for a in 0..3 {
            for next in [at[a].wrapping_sub(1), at[a] + 1] {
                if next >= num[a] {
                    continue;
                }
                let mut to = at;
                to[a] = next;
                let n = index_of(to, num);
                if near[n] == NONE && !reached[n] {
                    reached[n] = true;
                    open.push(to);
                }
            }
        }
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nearest::tests::{cube, of_rings};

    #[test]
    fn the_field_of_a_mesh_equals_its_distance_within_the_interpolation_error() {
        let (vertices, triangles) = cube();
        let field = WallField::from_mesh(&vertices, &triangles, 0.5, &|_| true).unwrap();
        for (p, truth) in [
            ([4.1, 0.3, 0.2], 0.9),
            ([0.0, -6.0, 1.0], -1.0),
            ([0.0, 0.0, 0.0], INSIDE_MM),
        ] {
            // The tolerance is large because of the ridge in the middle, the only position where the distance is not
            // linear between samples.
            assert!((field.distance_mm(p) - truth).abs() < 0.26, "{p:?}");
        }
        assert_eq!(field.distance_mm([40.0, 0.0, 0.0]), -OUTSIDE_MM);
    }

    #[test]
    fn an_invalid_mesh_is_rejected_and_the_computation_can_be_stopped() {
        let (vertices, triangles) = cube();
        assert!(WallField::from_mesh(&vertices, &[], 0.5, &|_| true).is_err());
        assert!(WallField::from_mesh(&vertices, &[[0, 1, 99]], 0.5, &|_| true).is_err());
        assert!(WallField::from_mesh(&vertices, &triangles, 0.0, &|_| true).is_err());
        let stopped = WallField::from_mesh(&vertices, &triangles, 0.5, &|_| false);
        assert_eq!(stopped.unwrap_err(), ScopeError::Cancelled);
    }

    /// Return the mesh of a sphere of 7 mm radius with a tube attached, in triangles of some mm.
    fn bulb() -> (Vec<Point>, Vec<[u32; 3]>) {
        /// Number of rings of vertices of the mesh.
        const ROWS: usize = 40;
        /// Number of vertices of each ring of the mesh.
        const ROUND: usize = 24;
        let ends = [[0.0, 0.0, 7.0], [0.3, -0.2, -21.0]];
        of_rings(ends, [ROWS - 1, ROUND], |row, n| {
            let z = 7.0 - 28.0 * (row + 1) as f64 / ROWS as f64;
            let radius = libm::sqrt((49.0 - z * z).max(0.0)).max(2.2);
            let turn = std::f64::consts::TAU * n as f64 / ROUND as f64;
            [radius * libm::cos(turn), radius * libm::sin(turn), z]
        })
    }

    #[test]
    fn every_sample_of_a_field_equals_the_reference_search_also_on_faces_of_bricks() {
        let (vertices, triangles) = bulb();
        let spacing = 0.37;
        let field = WallField::from_mesh(&vertices, &triangles, spacing, &|_| true).unwrap();
        let boxes = Boxes::new(&vertices, &triangles);
        let mut num_in_band = 0;
        for z in 0..90 {
            for y in 0..52 {
                for x in 0..52 {
                    let at = [x, y, z].map(f64::from);
                    let p = field.lps_from_lattice().point(at);
                    let (truth, _) = boxes.signed(p, 0);
                    let wanted = truth.clamp(-OUTSIDE_MM, INSIDE_MM);
                    num_in_band += u32::from(wanted == truth);
                    // The tolerance allows for rounding to f32, and for interpolation at a position that rounding moves
                    // slightly off a sample.
                    let found = field.distance_mm(p);
                    assert!((found - wanted).abs() < 5e-5, "{found} {wanted} at {p:?}");
                }
            }
        }
        assert!(num_in_band > 50_000, "{num_in_band}");
    }
}
