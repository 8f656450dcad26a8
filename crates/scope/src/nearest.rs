//! Search for the triangle of a mesh that is nearest to a point, for one point at a time.
//!
//! The module is the readable reference of [`crate::nearest_packet`], which processes eight points at a time.

use std::collections::HashMap;

use carina_grid::{cross, dot, length, unit};

use crate::axis::{along, sub};

type Point = [f64; 3];

/// Maximum number of triangles in a leaf of the tree of boxes.
const LEAF: usize = 4;

/// Return the nearest point of a triangle, and the feature of the triangle that contains this point.
///
/// The method is from Ericson, "Real-Time Collision Detection", 5.1.5. The feature is 0 to 2 for a corner, 3 to 5 for
/// the edge from corner (feature - 3) to the next, and 6 for the face.
pub(crate) fn nearest_on([a, b, c]: [Point; 3], p: Point) -> (Point, usize) {
    let (ab, ac, ap) = (sub(b, a), sub(c, a), sub(p, a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (a, 0);
    }
    let bp = sub(p, b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (b, 1);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (along(a, d1 / (d1 - d3), ab), 3);
    }
    let cp = sub(p, c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (c, 2);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (along(a, d2 / (d2 - d6), ac), 5);
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        let share = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return (along(b, share, sub(c, b)), 4);
    }
    let scale = 1.0 / (va + vb + vc);
    (along(along(a, vb * scale, ab), vc * scale, ac), 6)
}

pub(crate) struct Node {
    low: Point,
    high: Point,
    /// For a leaf, the number of its first triangle; for an inner node, the index of its right child.
    ///
    /// The left child of an inner node follows the node.
    pub(crate) first: u32,
    /// Number of triangles in the leaf; 0 for an inner node.
    pub(crate) count: u32,
}

impl Node {
    pub(crate) const fn span(&self) -> (Point, Point) {
        (self.low, self.high)
    }
}

/// Triangles of a closed mesh in a tree of bounding boxes.
pub(crate) struct Boxes {
    pub(crate) nodes: Vec<Node>,
    pub(crate) triangles: Vec<[Point; 3]>,
    /// Normals, out of the lumen, of each triangle's corners, edges and face (see [`nearest_on`]).
    ///
    /// The sign of the distance follows from the normal of the nearest feature, whichever of several equally near
    /// triangles was found (Baerentzen and Aanaes, "Signed distance computation using the angle weighted pseudonormal",
    /// 2005). The normal of the triangle that faces the point most would give the wrong sign at some corners.
    normals: Vec<[Point; 7]>,
}

impl Boxes {
    pub(crate) fn new(vertices: &[Point], triangles: &[[u32; 3]]) -> Self {
        let mut order = triangles.to_vec();
        let mut nodes = Vec::new();
        let whole = 0..order.len();
        Self::split(&mut nodes, vertices, &mut order, whole);
        let corners: Vec<[Point; 3]> = order
            .iter()
            .map(|t| t.map(|v| vertices[v as usize]))
            .collect();
        Self {
            nodes,
            normals: normals(vertices.len(), &order, &corners),
            triangles: corners,
        }
    }

    fn split(
        nodes: &mut Vec<Node>,
        vertices: &[Point],
        all: &mut [[u32; 3]],
        range: std::ops::Range<usize>,
    ) {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for &v in all[range.clone()].iter().flatten() {
            let p = vertices[v as usize];
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
        let at = |t: &[u32; 3]| -> f64 { t.iter().map(|&v| vertices[v as usize][axis]).sum() };
        all[range.clone()].select_nth_unstable_by(middle, |s, t| at(s).total_cmp(&at(t)));
        let middle = range.start + middle;
        Self::split(nodes, vertices, all, range.start..middle);
        nodes[here].first = nodes.len() as u32;
        nodes[here].count = 0;
        Self::split(nodes, vertices, all, middle..range.end);
    }

    /// Return whether a point, whose nearest triangle is `triangle`, is in the lumen or on the wall.
    pub(crate) fn is_inside(&self, p: Point, triangle: usize) -> bool {
        let (foot, part) = nearest_on(self.triangles[triangle], p);
        dot(sub(p, foot), self.normals[triangle][part]) <= 0.0
    }

    /// Return the signed distance from a point to the mesh in mm, positive inside, and the nearest triangle.
    ///
    /// `hint` is the number of a triangle that may be near.
    pub(crate) fn signed(&self, p: Point, hint: usize) -> (f64, usize) {
        let measure = |t: usize| {
            let away = sub(p, nearest_on(self.triangles[t], p).0);
            dot(away, away)
        };
        // Squared distances are compared.
        let (mut best, mut which) = (measure(hint), hint);
        let mut stack = [(0.0, 0u32); 64];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (far, at) = stack[depth];
            if far > best {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.count > 0 {
                for t in node.first as usize..(node.first + node.count) as usize {
                    let far = measure(t);
                    if far < best {
                        (best, which) = (far, t);
                    }
                }
                continue;
            }
            let (left, right) = (at + 1, node.first);
            let to = |n: u32| (squared_box_distance(&self.nodes[n as usize], p), n);
            let (to_left, to_right) = (to(left), to(right));
            let (near, far) = if to_left.0 <= to_right.0 {
                (to_left, to_right)
            } else {
                (to_right, to_left)
            };
            for (distance, n) in [far, near] {
                if distance <= best {
                    stack[depth] = (distance, n);
                    depth += 1;
                }
            }
        }
        let distance = best.sqrt();
        let inside = self.is_inside(p, which);
        (if inside { distance } else { -distance }, which)
    }
}

/// Compute the normals of the corners, edges and face of each triangle.
///
/// The normal of a corner is the sum of its faces' normals weighted by angle, that of an edge the sum of those of its
/// two faces.
fn normals(num_vertices: usize, order: &[[u32; 3]], corners: &[[Point; 3]]) -> Vec<[Point; 7]> {
    let add = |to: &mut Point, share: f64, n: Point| *to = along(*to, share, n);
    let mut of_corner = vec![[0.0; 3]; num_vertices];
    let mut of_edge = HashMap::with_capacity(order.len() * 3 / 2);
    let edge = |t: &[u32; 3], k: usize| (t[k].min(t[(k + 1) % 3]), t[k].max(t[(k + 1) % 3]));
    let faces: Vec<Point> = corners
        .iter()
        .map(|[a, b, c]| unit(cross(sub(*b, *a), sub(*c, *a))).unwrap_or([0.0; 3]))
        .collect();
    for ((t, at), &face) in order.iter().zip(corners).zip(&faces) {
        for k in 0..3 {
            let (to, from) = (sub(at[(k + 1) % 3], at[k]), sub(at[(k + 2) % 3], at[k]));
            let angle = libm::atan2(length(cross(to, from)), dot(to, from));
            add(&mut of_corner[t[k] as usize], angle, face);
            add(of_edge.entry(edge(t, k)).or_insert([0.0; 3]), 1.0, face);
        }
    }
    order
        .iter()
        .zip(faces)
        .map(|(t, face)| {
            let corner = |k: usize| of_corner[t[k] as usize];
            let side = |k: usize| of_edge[&edge(t, k)];
            [
                corner(0),
                corner(1),
                corner(2),
                side(0),
                side(1),
                side(2),
                face,
            ]
        })
        .collect()
}

fn squared_box_distance(node: &Node, p: Point) -> f64 {
    let out: Point =
        std::array::from_fn(|a| (node.low[a] - p[a]).max(p[a] - node.high[a]).max(0.0));
    dot(out, out)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Return the vertices and triangles of a cube of 10 mm round the origin.
    pub(crate) fn cube() -> (Vec<Point>, Vec<[u32; 3]>) {
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

    /// Return the mesh of a closed surface of `rows` rings of `round` points between two ends, the upper one first.
    pub(crate) fn of_rings(
        [top, bottom]: [Point; 2],
        [rows, round]: [usize; 2],
        point: impl Fn(usize, usize) -> Point,
    ) -> (Vec<Point>, Vec<[u32; 3]>) {
        let mut vertices = vec![top, bottom];
        for row in 0..rows {
            vertices.extend((0..round).map(|n| point(row, n)));
        }
        let at = |row: usize, n: usize| (2 + row * round + n % round) as u32;
        let mut triangles = Vec::new();
        for n in 0..round {
            triangles.push([0, at(0, n), at(0, n + 1)]);
            triangles.push([1, at(rows - 1, n + 1), at(rows - 1, n)]);
            for row in 0..rows - 1 {
                triangles.push([at(row, n), at(row + 1, n), at(row + 1, n + 1)]);
                triangles.push([at(row, n), at(row + 1, n + 1), at(row, n + 1)]);
            }
        }
        (vertices, triangles)
    }

    #[test]
    fn the_distance_to_a_cube_has_the_right_sign_beside_faces_edges_and_corners() {
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
}
