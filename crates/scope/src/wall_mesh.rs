//! The wall's signed distance from a closed mesh: exact to the nearest triangle at every sample.

use carina_grid::{Affine, cross, dot, length, unit};
use rayon::prelude::*;

use crate::ScopeError;
use crate::axis::{along, sub};
use crate::wall::{Brick, CELLS, INSIDE_MM, OUTSIDE_MM, SAMPLES, WallField, clamped};

type Point = [f64; 3];

/// Triangles of a leaf.
const LEAF: usize = 4;
/// Two triangles this near to each other are both nearest: an edge or a corner.
const TIE_MM: f64 = 1e-9;

/// Nearest point of a triangle (Ericson, "Real-Time Collision Detection", 5.1.5).
fn nearest_on([a, b, c]: [Point; 3], p: Point) -> Point {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return along(a, d1 / (d1 - d3), ab);
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return along(a, d2 / (d2 - d6), ac);
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return along(b, (d4 - d3) / ((d4 - d3) + (d5 - d6)), sub(c, b));
    }
    let scale = 1.0 / (va + vb + vc);
    along(along(a, vb * scale, ab), vc * scale, ac)
}

struct Node {
    low: Point,
    high: Point,
    /// First triangle and number of them in a leaf; place of the right child and 0 in a fork (the left one follows it).
    first: u32,
    count: u32,
}

/// Triangles in a tree of boxes.
struct Boxes {
    nodes: Vec<Node>,
    triangles: Vec<[Point; 3]>,
    normals: Vec<Point>,
}

impl Boxes {
    fn new(vertices: &[Point], triangles: &[[u32; 3]]) -> Self {
        let mut corners: Vec<[Point; 3]> = triangles
            .iter()
            .map(|t| t.map(|v| vertices[v as usize]))
            .collect();
        let mut nodes = Vec::new();
        let whole = 0..corners.len();
        Self::split(&mut nodes, &mut corners, whole);
        let normals = corners
            .iter()
            .map(|[a, b, c]| unit(cross(sub(*b, *a), sub(*c, *a))).unwrap_or([0.0; 3]))
            .collect();
        Self {
            nodes,
            triangles: corners,
            normals,
        }
    }

    fn split(nodes: &mut Vec<Node>, all: &mut [[Point; 3]], range: std::ops::Range<usize>) {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for p in all[range.clone()].iter().flatten() {
            for a in 0..3 {
                low[a] = low[a].min(p[a]);
                high[a] = high[a].max(p[a]);
            }
        }
        let here = nodes.len();
        nodes.push(Node {
            low,
            high,
            first: range.start as u32,
            count: range.len() as u32,
        });
        if range.len() <= LEAF {
            return;
        }
        let size = sub(high, low);
        let axis = (0..3).fold(0, |best, a| if size[a] > size[best] { a } else { best });
        let middle = range.len() / 2;
        let at = |t: &[Point; 3]| t[0][axis] + t[1][axis] + t[2][axis];
        all[range.clone()].select_nth_unstable_by(middle, |s, t| at(s).total_cmp(&at(t)));
        let middle = range.start + middle;
        Self::split(nodes, all, range.start..middle);
        nodes[here].first = nodes.len() as u32;
        nodes[here].count = 0;
        Self::split(nodes, all, middle..range.end);
    }

    /// Signed distance, positive inside, with the nearest triangle. `hint` is a triangle that may be near.
    ///
    /// At an edge or a corner several triangles are equally near. The one that the point lies most in front of tells the
    /// side; the others may see it edge on.
    fn signed(&self, p: Point, hint: usize) -> (f64, usize) {
        let measure = |t: usize| {
            let from = sub(p, nearest_on(self.triangles[t], p));
            (length(from), dot(from, self.normals[t]))
        };
        let (mut best, mut side) = measure(hint);
        let mut which = hint;
        let mut stack = [(0.0, 0u32); 64];
        let mut depth = 1;
        // Compared squared, a root is taken only where a triangle is nearer.
        let mut bound = (best + TIE_MM) * (best + TIE_MM);
        while depth > 0 {
            depth -= 1;
            let (far, at) = stack[depth];
            if far > bound {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.count > 0 {
                for t in node.first as usize..(node.first + node.count) as usize {
                    let (far, own_side) = measure(t);
                    if far < best - TIE_MM || (far <= best + TIE_MM && own_side.abs() > side.abs())
                    {
                        best = best.min(far);
                        bound = (best + TIE_MM) * (best + TIE_MM);
                        (side, which) = (own_side, t);
                    }
                }
                continue;
            }
            let (left, right) = (at + 1, node.first);
            let to_left = (squared_box_distance(&self.nodes[left as usize], p), left);
            let to_right = (squared_box_distance(&self.nodes[right as usize], p), right);
            let (near, far) = if to_left.0 <= to_right.0 {
                (to_left, to_right)
            } else {
                (to_right, to_left)
            };
            if far.0 <= bound {
                stack[depth] = far;
                depth += 1;
            }
            if near.0 <= bound {
                stack[depth] = near;
                depth += 1;
            }
        }
        // Normals point out of the lumen.
        (if side > 0.0 { -best } else { best }, which)
    }
}

fn squared_box_distance(node: &Node, p: Point) -> f64 {
    let out: Point =
        std::array::from_fn(|a| (node.low[a] - p[a]).max(p[a] - node.high[a]).max(0.0));
    dot(out, out)
}

impl WallField {
    /// A field from a closed mesh whose triangles are counterclockwise from outside, on samples `spacing_mm` apart.
    ///
    /// `go_on` is told the share done and may end the work.
    pub fn from_mesh(
        vertices: &[Point],
        triangles: &[[u32; 3]],
        spacing_mm: f64,
        go_on: &(impl Fn(f64) -> bool + Sync),
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
        let root = &boxes.nodes[0];
        let low = root.low.map(|v| v - OUTSIDE_MM);
        let shape_ijk: [usize; 3] = std::array::from_fn(|a| {
            let cells = ((root.high[a] + OUTSIDE_MM - low[a]) / spacing_mm).ceil() as usize;
            cells.div_ceil(CELLS) * CELLS + 1
        });
        let lps = Affine::from_columns(
            [spacing_mm, 0.0, 0.0],
            [0.0, spacing_mm, 0.0],
            [0.0, 0.0, spacing_mm],
            low,
        );
        let num_bricks = shape_ijk.map(|n| (n - 1) / CELLS);
        let half = 0.5 * CELLS as f64;
        let reach = half * spacing_mm * libm::sqrt(3.0);
        let is_near = bricks_near(&boxes, low, CELLS as f64 * spacing_mm, num_bricks);
        let is_outside = reached_from_outside(&is_near, num_bricks);
        let done = std::sync::atomic::AtomicUsize::new(0);
        let layer = num_bricks[0] * num_bricks[1];
        // The first layer that may not go on ends them all.
        let made: Option<Vec<Vec<Brick>>> = (0..num_bricks[2])
            .into_par_iter()
            .map(|bz| {
                let mut hint = 0;
                let bricks = (0..layer)
                    .map(|n| {
                        if is_outside[bz * layer + n] {
                            return Brick::Outside;
                        }
                        let first = [n % num_bricks[0], n / num_bricks[0], bz].map(|b| b * CELLS);
                        let middle = lps.point(first.map(|v| v as f64 + half));
                        let (distance, near) = boxes.signed(middle, hint);
                        hint = near;
                        if distance < -(OUTSIDE_MM + reach) {
                            return Brick::Outside;
                        }
                        if distance > INSIDE_MM + reach {
                            return Brick::Inside;
                        }
                        Brick::Near(sampled(&boxes, &lps, first, near))
                    })
                    .collect();
                let finished = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
                go_on(finished as f64 / num_bricks[2] as f64).then_some(bricks)
            })
            .collect();
        let Some(made) = made else {
            return Err(ScopeError::Cancelled);
        };
        let mut bricks = made.into_iter().flatten();
        Self::build(shape_ijk, lps, |_| bricks.next().unwrap_or(Brick::Outside))
    }
}

/// Bricks whose box is within [`OUTSIDE_MM`] of a triangle's box: all others are wholly outside or deep inside.
fn bricks_near(boxes: &Boxes, low: Point, brick_mm: f64, num: [usize; 3]) -> Vec<bool> {
    let mut is_near = vec![false; num.iter().product()];
    for corners in &boxes.triangles {
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
                is_near[row + first[0]..=row + last[0]].fill(true);
            }
        }
    }
    is_near
}

/// Bricks that are reached from the lattice's faces without passing one near a triangle.
fn reached_from_outside(is_near: &[bool], num: [usize; 3]) -> Vec<bool> {
    let mut reached = vec![false; is_near.len()];
    let place = |at: [usize; 3]| (at[2] * num[1] + at[1]) * num[0] + at[0];
    let mut open = Vec::new();
    for n in 0..is_near.len() {
        let at = [n % num[0], n / num[0] % num[1], n / num[0] / num[1]];
        if (0..3).any(|a| at[a] == 0 || at[a] + 1 == num[a]) && !is_near[n] {
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
                let n = place(to);
                if !is_near[n] && !reached[n] {
                    reached[n] = true;
                    open.push(to);
                }
            }
        }
    }
    reached
}

/// Signed distances of a brick's samples.
///
/// Every second sample on each axis, and all near the wall, ask for the nearest of all triangles. What lies between and
/// is farther off takes the nearest of those that its neighbours found: its foot lies among theirs, at most s = 0.2 mm
/// beside one of them, which is s^2 / (2 d) too far, 0.02 mm at most.
fn sampled(boxes: &Boxes, lps: &Affine, first: [usize; 3], near: usize) -> Vec<f32> {
    const NEAR_MM: f32 = 1.2;
    let side = CELLS + 1;
    let mut found = vec![(f32::NAN, 0u32); SAMPLES];
    let index = |at: [usize; 3]| (at[2] * side + at[1]) * side + at[0];
    let place = |at: [usize; 3]| lps.point(std::array::from_fn(|a| (first[a] + at[a]) as f64));
    // The sample before in the same place of a row is as near as the one before in the row, also where a row begins.
    let mut hints = [near; CELLS + 1];
    let every = |step: usize| {
        (0..side).step_by(step).flat_map(move |z| {
            (0..side)
                .step_by(step)
                .flat_map(move |y| (0..side).step_by(step).map(move |x| [x, y, z]))
        })
    };
    for at in every(2) {
        let (distance, near) = boxes.signed(place(at), hints[at[0]]);
        hints[at[0]] = near;
        found[index(at)] = (distance as f32, near as u32);
    }
    for at in every(1) {
        if at.iter().all(|v| v % 2 == 0) {
            continue;
        }
        let p = place(at);
        let (mut best, mut which) = (f64::INFINITY, 0);
        let mut seen = [u32::MAX; 8];
        for corner in 0..8 {
            let beside: [usize; 3] = std::array::from_fn(|a| {
                if at[a] % 2 == 0 {
                    at[a]
                } else {
                    at[a] - 1 + 2 * (corner >> a & 1)
                }
            });
            let candidate = found[index(beside)].1;
            if seen[..corner].contains(&candidate) {
                continue;
            }
            seen[corner] = candidate;
            let far = length(sub(p, nearest_on(boxes.triangles[candidate as usize], p)));
            if far < best {
                (best, which) = (far, candidate);
            }
        }
        let one = found[index(at.map(|v| v & !1))].0;
        let distance = if best < f64::from(NEAR_MM) {
            boxes.signed(p, which as usize).0 as f32
        } else {
            // Farther from the wall than from its neighbour, it lies on the same side.
            (best as f32).copysign(one)
        };
        found[index(at)] = (distance, which);
    }
    found.into_iter().map(|(d, _)| clamped(d)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cube of 10 mm round the origin.
    fn cube() -> (Vec<Point>, Vec<[u32; 3]>) {
        let vertices = (0..8usize)
            .map(|c| std::array::from_fn(|a| if c >> a & 1 == 1 { 5.0 } else { -5.0 }))
            .collect();
        let faces = [
            [0, 4, 6, 2],
            [1, 3, 7, 5],
            [0, 1, 5, 4],
            [2, 6, 7, 3],
            [0, 2, 3, 1],
            [4, 5, 7, 6],
        ];
        let triangles = faces
            .iter()
            .flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]])
            .collect();
        (vertices, triangles)
    }

    #[test]
    fn the_distance_of_a_cube_has_its_sign_beside_faces_edges_and_corners() {
        let (vertices, triangles) = cube();
        let boxes = Boxes::new(&vertices, &triangles);
        let truth = |p: Point| {
            let out = length(p.map(|v| (v.abs() - 5.0).max(0.0)));
            let most = p.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            if out > 0.0 { -out } else { 5.0 - most }
        };
        for n in 0..4000u32 {
            let p = std::array::from_fn(|a| {
                let hash = (n * 3 + a as u32).wrapping_mul(2_654_435_761) >> 8;
                f64::from(hash % 1601) / 100.0 - 8.0
            });
            let (found, _) = boxes.signed(p, (n % 12) as usize);
            assert!((found - truth(p)).abs() < 1e-9, "{p:?} {found}");
        }
    }

    #[test]
    fn the_field_of_a_mesh_is_its_distance_within_what_interpolation_leaves() {
        let (vertices, triangles) = cube();
        let field = WallField::from_mesh(&vertices, &triangles, 0.5, &|_| true).unwrap();
        for (p, truth) in [
            ([4.1, 0.3, 0.2], 0.9),
            ([0.0, -6.0, 1.0], -1.0),
            ([0.0, 0.0, 0.0], INSIDE_MM),
        ] {
            // The ridge in the middle is the one place where a distance is not straight between samples.
            assert!((field.distance_mm(p) - truth).abs() < 0.26, "{p:?}");
        }
        assert_eq!(field.distance_mm([40.0, 0.0, 0.0]), -OUTSIDE_MM);
    }

    #[test]
    fn a_broken_mesh_is_refused_and_work_can_be_stopped() {
        let (vertices, triangles) = cube();
        assert!(WallField::from_mesh(&vertices, &[], 0.5, &|_| true).is_err());
        assert!(WallField::from_mesh(&vertices, &[[0, 1, 99]], 0.5, &|_| true).is_err());
        assert!(WallField::from_mesh(&vertices, &triangles, 0.0, &|_| true).is_err());
        let stopped = WallField::from_mesh(&vertices, &triangles, 0.5, &|_| false);
        assert_eq!(stopped.unwrap_err(), ScopeError::Cancelled);
    }
}
