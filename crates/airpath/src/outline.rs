//! Outline of the lumen in a plane: closed lines on the sub-voxel wall, never farther than half a voxel from the mask.
//!
//! The plane cuts the triangles of the lumen's surface (see `mesh`), so lines are equally accurate in an oblique,
//! zoomed picture and in an axial one, and do not depend on the picture's pixels. The surface differs from that of
//! `mesh` in one point: a vertex never leaves the grid edge between the last lumen voxel and the first voxel outside.
//! `mesh` may extend one voxel further, to the beginning of the wall; the outline is for checking the mask itself, so a
//! voxel that was painted or erased must be visible.
//!
//! The triangles of a brick are computed when a plane first crosses it, and are cached. After an edit, only the list of
//! the bricks that contain lumen is computed again.

use std::sync::OnceLock;

use carina_grid::{Affine, VolumeView};
use rayon::prelude::*;

use crate::mesh::{CellRing, EDGES, MARGIN, Reach, cell_rings};
use carina_leastcost::lumen::WallLevels;

/// Number of cells along each side of a brick. Larger bricks contain more triangles that the plane does not cut; with
/// smaller bricks there are too many bricks.
const BRICK: usize = 4;
/// Number of cell corners along each side of a brick.
const SIDE: usize = BRICK + 1;
/// Distance in pixels below which neighbouring points of a line are merged.
///
/// The line moves by at most half of `APART_PX`.
const APART_PX: f64 = 0.25;
/// Maximum number of pieces of an outline.
///
/// A plane through any airways has fewer pieces; more indicate that noise was segmented as lumen.
const MAX_PIECES: usize = 200_000;
/// Number of coordinate steps per pixel in an encoded outline.
pub const PARTS_PER_PX: f64 = 16.0;

/// Point of the picture: column and row, in corner coordinates.
pub type PicturePoint = [f64; 2];

/// Surface of one lumen mask that planes can cut, computed in bricks where a plane crosses it.
///
/// Another mask needs another surface.
#[derive(Debug)]
pub struct LumenSurface {
    /// Number of voxels of the mask along i, j, k.
    shape: [usize; 3],
    /// Low corners, in voxels, of the bricks that contain lumen; the cells of a brick begin at its corner.
    corners: Vec<[i32; 3]>,
    bricks: Vec<OnceLock<Brick>>,
}

#[derive(Debug, Default)]
struct Brick {
    /// Positions of the brick's vertices in voxel coordinates.
    vertices: Vec<[f32; 3]>,
    /// Number of each vertex, which identifies its position on the grid; a neighbouring brick has the same number for
    /// it.
    keys: Vec<u64>,
    triangles: Vec<[u16; 3]>,
}

/// Part of the outline in one triangle, from one crossed edge to another.
///
/// An edge is identified by the numbers of its two vertices.
struct Piece {
    from: u128,
    to: u128,
    start: PicturePoint,
    end: PicturePoint,
}

/// Error for an outline that consists of more than `MAX_PIECES` pieces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooRagged;

impl LumenSurface {
    /// Create the surface of a mask and find the bricks that contain lumen.
    ///
    /// `lumen` is an array `[z, y, x]`, not 0 inside; `shape` is its number of voxels along (i, j, k).
    #[must_use]
    pub fn new(lumen: &[u8], shape: [usize; 3]) -> Self {
        let [nx, ny, _] = shape;
        // The cells begin one voxel before the volume: brick b begins at voxel `BRICK * b - 1`.
        let counts = shape.map(|n| n / BRICK + 1);
        let slices: Vec<Vec<bool>> = lumen
            .par_chunks(nx * ny)
            .map(|slice| {
                let mut held = vec![false; counts[0] * counts[1]];
                for (j, row) in slice.chunks(nx).enumerate() {
                    if row.iter().all(|&v| v == 0) {
                        continue;
                    }
                    for (i, _) in row.iter().enumerate().filter(|(_, v)| **v != 0) {
                        for b in [j / BRICK, (j + 1) / BRICK] {
                            for a in [i / BRICK, (i + 1) / BRICK] {
                                held[b * counts[0] + a] = true;
                            }
                        }
                    }
                }
                held
            })
            .collect();
        let mut corners = Vec::new();
        for c in 0..counts[2] {
            let first = (c * BRICK).saturating_sub(1);
            let last = (c * BRICK + BRICK).min(slices.len());
            let part = slices.get(first..last).unwrap_or(&[]);
            for n in 0..counts[0] * counts[1] {
                if part.iter().any(|slice| slice[n]) {
                    let at = [n % counts[0], n / counts[0], c];
                    corners.push(at.map(|b| (b * BRICK) as i32 - 1));
                }
            }
        }
        let bricks = (0..corners.len()).map(|_| OnceLock::new()).collect();
        Self {
            shape,
            corners,
            bricks,
        }
    }

    /// Cut the surface with the plane of a picture; return the lines of the outline in picture coordinates.
    ///
    /// The last point of a closed line equals its first. `pixel_from_ijk` gives column, row and the distance from the
    /// plane. `values` and `lumen` must be those of the surface.
    ///
    /// # Errors
    ///
    /// Returns [`TooRagged`] if the outline has too many pieces.
    pub fn cut(
        &self,
        values: VolumeView<'_, i16>,
        lumen: &[u8],
        levels: Option<WallLevels>,
        pixel_from_ijk: &Affine,
        (width, height): (usize, usize),
    ) -> Result<Vec<Vec<PicturePoint>>, TooRagged> {
        let reach = Reach::new(values, lumen, levels);
        let size = [width as f64, height as f64];
        let rows = pixel_from_ijk.rows();
        let spread = rows.map(|r| (r[0].abs() + r[1].abs() + r[2].abs()) * BRICK as f64 / 2.0);
        let mut pieces = Vec::new();
        let mut depths = Vec::new();
        for (corner, brick) in self.corners.iter().zip(&self.bricks) {
            let middle = corner.map(|v| f64::from(v) + BRICK as f64 / 2.0);
            let along = |n: usize| {
                let r = &rows[n];
                r[0] * middle[0] + r[1] * middle[1] + r[2] * middle[2] + r[3]
            };
            // Nearly all bricks are off the plane; this test rejects them first.
            if along(2).abs() > spread[2] {
                continue;
            }
            if (0..2).any(|a| !(-spread[a]..=size[a] + spread[a]).contains(&along(a))) {
                continue;
            }
            let brick = brick.get_or_init(|| Brick::new(&reach, *corner, self.shape));
            brick.cut(pixel_from_ijk, size, &mut depths, &mut pieces);
            if pieces.len() > MAX_PIECES {
                return Err(TooRagged);
            }
        }
        Ok(joined(&pieces))
    }
}

impl Brick {
    fn new(reach: &Reach<'_>, corner: [i32; 3], shape: [usize; 3]) -> Self {
        let low = corner.map(|v| v as isize);
        let mut inside = [false; SIDE * SIDE * SIDE];
        for (n, inside) in inside.iter_mut().enumerate() {
            let at = [n % SIDE, n / SIDE % SIDE, n / (SIDE * SIDE)];
            *inside = reach.in_lumen(std::array::from_fn(|a| low[a] + at[a] as isize));
        }
        let mut brick = Self::default();
        let mut vertex_at = vec![[u16::MAX; 3]; inside.len()];
        for cell in 0..BRICK * BRICK * BRICK {
            let at = [cell % BRICK, cell / BRICK % BRICK, cell / (BRICK * BRICK)];
            let corner_of =
                |c: usize| -> [usize; 3] { std::array::from_fn(|a| at[a] + (c >> a & 1)) };
            let index = |p: [usize; 3]| (p[2] * SIDE + p[1]) * SIDE + p[0];
            let case = (0..8).fold(0u8, |bits, c| {
                bits | u8::from(inside[index(corner_of(c))]) << c
            });
            for CellRing { edges, has_apex } in &cell_rings()[usize::from(case)] {
                let mut vertex = |edge: usize| {
                    let (c, axis) = EDGES[edge];
                    let lower = corner_of(c);
                    let known = &mut vertex_at[index(lower)][axis];
                    if *known == u16::MAX {
                        *known = brick.vertices.len() as u16;
                        let from = inside[index(lower)];
                        let lower: [isize; 3] = std::array::from_fn(|a| low[a] + lower[a] as isize);
                        brick.vertices.push(crossing(reach, lower, axis, from));
                        brick.keys.push(key_of(lower, axis as u64, shape));
                    }
                    *known
                };
                let mut ring: Vec<u16> = edges.iter().map(|edge| vertex(*edge)).collect();
                let apex = if *has_apex {
                    ring.remove(0)
                } else {
                    let count = ring.len() as f32;
                    let middle = ring.iter().fold([0.0f32; 3], |sum, v| {
                        std::array::from_fn(|a| sum[a] + brick.vertices[usize::from(*v)][a])
                    });
                    let lower = std::array::from_fn(|a| low[a] + at[a] as isize);
                    // Two rings of one cell never both need a vertex at their centre, because such a ring has more than
                    // half of the cell's edges.
                    brick.keys.push(key_of(lower, 3, shape));
                    brick.vertices.push(middle.map(|v| v / count));
                    ring.push(ring[0]);
                    brick.vertices.len() as u16 - 1
                };
                for pair in ring.windows(2) {
                    brick.triangles.push([apex, pair[0], pair[1]]);
                }
            }
        }
        brick
    }

    fn cut(
        &self,
        pixel_from_ijk: &Affine,
        size: [f64; 2],
        depths: &mut Vec<f64>,
        pieces: &mut Vec<Piece>,
    ) {
        let rows = pixel_from_ijk.rows();
        let along = |row: &[f64; 4], v: &[f32; 3]| {
            row[0] * f64::from(v[0]) + row[1] * f64::from(v[1]) + row[2] * f64::from(v[2]) + row[3]
        };
        depths.clear();
        depths.extend(self.vertices.iter().map(|v| along(&rows[2], v)));
        for triangle in &self.triangles {
            // A vertex in the plane counts as behind the plane in all triangles, so that lines have no gaps and no
            // duplicate parts.
            let behind = triangle.map(|v| depths[usize::from(v)] >= 0.0);
            if behind[0] == behind[1] && behind[1] == behind[2] {
                continue;
            }
            let crossed = |leaves: bool| {
                let n = (0..3)
                    .find(|&n| behind[n] == leaves && behind[(n + 1) % 3] != leaves)
                    .unwrap_or(0);
                let (a, b) = (usize::from(triangle[n]), usize::from(triangle[(n + 1) % 3]));
                // Both triangles of an edge interpolate from the same end, so that their results are equal to the last
                // bit.
                let (a, b) = if self.keys[a] < self.keys[b] {
                    (a, b)
                } else {
                    (b, a)
                };
                let t = depths[a] / (depths[a] - depths[b]);
                let (from, to) = (&self.vertices[a], &self.vertices[b]);
                let point = [0, 1].map(|r| {
                    let start = along(&rows[r], from);
                    start + t * (along(&rows[r], to) - start)
                });
                (
                    u128::from(self.keys[a]) << 64 | u128::from(self.keys[b]),
                    point,
                )
            };
            let ((from, start), (to, end)) = (crossed(true), crossed(false));
            let is_adjacent = (0..2).any(|a| {
                (start[a] < 0.0 && end[a] < 0.0) || (start[a] > size[a] && end[a] > size[a])
            });
            if !is_adjacent {
                pieces.push(Piece {
                    from,
                    to,
                    start,
                    end,
                });
            }
        }
    }
}

fn key_of(lower: [isize; 3], what: u64, shape: [usize; 3]) -> u64 {
    // The shape extends by one voxel on each side, so the number is never negative.
    let place = (0..3).rev().fold(0u64, |key, a| {
        key * (shape[a] as u64 + 2) + (lower[a] + 1) as u64
    });
    4 * place + what
}

/// Return the point where the surface crosses the grid edge from voxel `lower`, one end of which is in the lumen.
fn crossing(reach: &Reach<'_>, lower: [isize; 3], axis: usize, from_lower: bool) -> [f32; 3] {
    let mut upper = lower;
    upper[axis] += 1;
    let (from, to) = if from_lower {
        (lower, upper)
    } else {
        (upper, lower)
    };
    let step: [isize; 3] = std::array::from_fn(|a| to[a] - from[a]);
    let share = if reach.in_volume(to) {
        reach.crossing(from, step).clamp(MARGIN, 1.0 - MARGIN)
    } else {
        0.5
    };
    std::array::from_fn(|a| (from[a] as f64 + share * step[a] as f64) as f32)
}

/// Join the pieces of an outline to lines: the end of one piece is the beginning of the next.
fn joined(pieces: &[Piece]) -> Vec<Vec<PicturePoint>> {
    let table = PieceTable::of(pieces);
    let next: Vec<Option<usize>> = pieces.iter().map(|p| table.get(pieces, p.to)).collect();
    let mut follows = vec![false; pieces.len()];
    for n in next.iter().flatten() {
        follows[*n] = true;
    }
    let mut done = vec![false; pieces.len()];
    let mut lines = Vec::new();
    // Lines that leave the picture are built first; the pieces that remain form rings.
    let begins = (0..pieces.len()).filter(|n| !follows[*n]);
    for first in begins.chain(0..pieces.len()) {
        if done[first] {
            continue;
        }
        let mut line = vec![pieces[first].start];
        let mut here = Some(first);
        while let Some(n) = here.filter(|n| !done[*n]) {
            done[n] = true;
            line.push(pieces[n].end);
            here = next[n];
        }
        lines.push(line);
    }
    lines
}

/// Hash table from the first edge of a piece to the piece, with twice as many slots as pieces and linear probing.
struct PieceTable(Vec<u32>);

impl PieceTable {
    /// Value of an entry of the hash table that contains no piece.
    const FREE: u32 = u32::MAX;

    fn of(pieces: &[Piece]) -> Self {
        let mut table = vec![Self::FREE; (2 * pieces.len()).max(2).next_power_of_two()];
        let mask = table.len() - 1;
        for (n, piece) in pieces.iter().enumerate() {
            let mut at = Self::hash(piece.from) & mask;
            while table[at] != Self::FREE {
                at = (at + 1) & mask;
            }
            table[at] = n as u32;
        }
        Self(table)
    }

    fn get(&self, pieces: &[Piece], key: u128) -> Option<usize> {
        let mask = self.0.len() - 1;
        let mut at = Self::hash(key) & mask;
        while self.0[at] != Self::FREE {
            let n = self.0[at] as usize;
            if pieces[n].from == key {
                return Some(n);
            }
            at = (at + 1) & mask;
        }
        None
    }

    /// Return the hash of an edge; its vertex numbers come from positions, so a multiplication distributes them well
    /// enough.
    fn hash(key: u128) -> usize {
        let (high, low) = ((key >> 64) as u64, key as u64);
        let mixed = (high.rotate_left(29) ^ low).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        (mixed >> 24) as usize
    }
}

/// Encode the lines of an outline as bytes.
///
/// Each line is the number of its points and then column and row of each point, all u16 little-endian, columns and rows
/// in sixteenths of a pixel. Lines are clipped to the picture, and points that are too near to be distinguished are
/// merged.
#[must_use]
pub fn encoded(lines: &[Vec<PicturePoint>], (width, height): (usize, usize)) -> Vec<u8> {
    let size = [width as f64, height as f64];
    let mut bytes = Vec::new();
    for line in lines {
        for run in clipped(line, size) {
            for part in thinned(&run).chunks(usize::from(u16::MAX) - 1) {
                bytes.extend((part.len() as u16).to_le_bytes());
                for v in part.iter().flatten() {
                    // The cast saturates, so values beyond u16 become its largest value.
                    bytes.extend(((v * PARTS_PER_PX).round() as u16).to_le_bytes());
                }
            }
        }
    }
    bytes
}

/// Return the parts of a line inside a picture of the given size.
fn clipped(line: &[PicturePoint], size: [f64; 2]) -> Vec<Vec<PicturePoint>> {
    let holds = |p: &PicturePoint| (0..2).all(|a| (0.0..=size[a]).contains(&p[a]));
    if line.iter().all(holds) {
        return vec![line.to_vec()];
    }
    let mut runs: Vec<Vec<PicturePoint>> = Vec::new();
    let mut open = false;
    for pair in line.windows(2) {
        let [a, b] = [pair[0], pair[1]];
        let (mut from, mut to) = (0.0f64, 1.0f64);
        for axis in 0..2 {
            let step = b[axis] - a[axis];
            if step == 0.0 {
                if !(0.0..=size[axis]).contains(&a[axis]) {
                    to = -1.0;
                }
                continue;
            }
            let (low, high) = (-a[axis] / step, (size[axis] - a[axis]) / step);
            from = from.max(low.min(high));
            to = to.min(low.max(high));
        }
        if from > to {
            open = false;
            continue;
        }
        let at = |t: f64| [0, 1].map(|n| a[n] + t * (b[n] - a[n]));
        match runs.last_mut().filter(|_| open && from == 0.0) {
            Some(run) => run.push(at(to)),
            None => runs.push(vec![at(from), at(to)]),
        }
        open = to == 1.0;
    }
    runs
}

/// Remove the points of a line that are nearer than `APART_PX` to the previous remaining point.
///
/// The ends stay, and a small ring keeps at least two points.
fn thinned(line: &[PicturePoint]) -> Vec<PicturePoint> {
    let far = |a: &PicturePoint, b: &PicturePoint| {
        (a[0] - b[0]).abs().max((a[1] - b[1]).abs()) >= APART_PX
    };
    let mut points: Vec<PicturePoint> = Vec::with_capacity(line.len());
    for point in line {
        if points.last().is_none_or(|last| far(last, point)) {
            points.push(*point);
        }
    }
    let Some(end) = line.last() else {
        return points;
    };
    if points.len() < 2 {
        points.push(*end);
    } else if let Some(last) = points.last_mut() {
        // The last remaining point is the end itself, or a point that cannot be distinguished from the end; the end
        // replaces it.
        *last = *end;
    }
    points
}
