//! Signed distances of eight points at once: one traversal of the tree of boxes, with a lane for each point.
//!
//! [`Boxes::signed`] is the readable form, with which a property test compares the results. Lanes are plain arrays that
//! the compiler translates to registers. No operation is fused or approximated, so every instruction set gives the same
//! bits.
#![allow(
    clippy::inline_always,
    reason = "operations of lanes must become registers in the function that has them enabled"
)]

use carina_grid::{InstructionSet, cross, dot, unit};

use crate::axis::sub;
use crate::nearest::Boxes;
#[cfg(target_arch = "x86_64")]
use crate::vector8::Avx2;
use crate::vector8::{ArrayVector, LANES, Vector8};

type Point = [f64; 3];
type Lanes = [f32; LANES];

/// Margin of the boxes in mm, larger than the rounding errors of their f32 coordinates relative to the mesh's middle.
const BOX_MM: f32 = 1e-4;

/// Triangle with the precomputed vectors that the distance computation needs.
struct Face {
    corner: Point,
    /// Edges of the triangle from corner to corner, in order.
    edges: [[f32; 3]; 3],
    /// Vectors in the triangle's plane that point outwards across each edge.
    outwards: [[f32; 3]; 3],
    /// 1 / length^2 of each edge; 0 for an edge without length.
    inverse: [f32; 3],
    normal: [f32; 3],
    /// 1 for a triangle without area, for which only the edges count; otherwise 0.
    flat: f32,
}

impl Face {
    fn new([a, b, c]: [Point; 3]) -> Self {
        let normal = unit(cross(sub(b, a), sub(c, a))).unwrap_or([0.0; 3]);
        let single = |v: Point| v.map(|x| x as f32);
        let edges = [sub(b, a), sub(c, b), sub(a, c)];
        let inverse = edges.map(|e| {
            let squared = dot(e, e);
            if squared > 0.0 {
                (1.0 / squared) as f32
            } else {
                0.0
            }
        });
        Self {
            corner: a,
            edges: edges.map(single),
            outwards: edges.map(|e| single(cross(e, normal))),
            // An edge whose squared length underflows in f32 also counts as having no length.
            inverse: inverse.map(|v| if v.is_finite() { v } else { 0.0 }),
            normal: single(normal),
            flat: f32::from(u8::from(normal == [0.0; 3])),
        }
    }
}

/// Mesh that is prepared for queries of eight points at a time.
pub(crate) struct Packets<'a> {
    boxes: &'a Boxes,
    middle: Point,
    /// Low and high corners of the tree nodes' boxes, relative to the mesh's middle, mm.
    spans: Vec<[[f32; 3]; 2]>,
    faces: Vec<Face>,
    simd: InstructionSet,
}

/// Eight points that are near each other.
pub(crate) struct Together {
    /// Origin of the points' coordinates, LPS mm.
    pub(crate) origin: Point,
    /// x, y and z coordinates of the points, mm from the origin.
    pub(crate) at: [Lanes; 3],
}

impl<'a> Packets<'a> {
    pub(crate) fn new(boxes: &'a Boxes, simd: InstructionSet) -> Self {
        let faces = boxes
            .triangles
            .iter()
            .map(|corners| Face::new(*corners))
            .collect();
        let (low, high) = boxes.nodes[0].span();
        let middle = std::array::from_fn(|a| 0.5 * (low[a] + high[a]));
        let single = |p: Point| sub(p, middle).map(|v| v as f32);
        let spans = boxes
            .nodes
            .iter()
            .map(|n| [single(n.span().0), single(n.span().1)])
            .collect();
        Self {
            boxes,
            middle,
            spans,
            faces,
            simd,
        }
    }

    /// Return the signed distances of eight points from the mesh in mm, positive inside, and their nearest triangles.
    ///
    /// `hint` is the number of a triangle that may be near.
    pub(crate) fn signed(&self, points: &Together, hint: u32) -> Found {
        let (mut signed_mm, triangles) = self.nearest(points, hint);
        for n in 0..LANES {
            let p = [0, 1, 2].map(|a| points.origin[a] + f64::from(points.at[a][n]));
            if !self.boxes.is_inside(p, triangles[n] as usize) {
                signed_mm[n] = -signed_mm[n];
            }
        }
        Found {
            signed_mm,
            triangles,
        }
    }

    fn nearest(&self, points: &Together, hint: u32) -> (Lanes, [u32; LANES]) {
        match self.simd {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `self.simd` is one of `InstructionSet::available`, which has tested this machine for the
            // instructions. Measured by `cargo bench -p carina-scope --bench field`.
            InstructionSet::Avx2 | InstructionSet::Avx512 => unsafe {
                self.nearest_avx2(points, hint)
            },
            _ => self.nearest_in::<ArrayVector>(points, hint),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn nearest_avx2(&self, points: &Together, hint: u32) -> (Lanes, [u32; LANES]) {
        self.nearest_in::<Avx2>(points, hint)
    }

    #[inline(always)]
    fn nearest_in<E: Vector8>(&self, points: &Together, hint: u32) -> (Lanes, [u32; LANES]) {
        let at = [
            E::from_array(points.at[0]),
            E::from_array(points.at[1]),
            E::from_array(points.at[2]),
        ];
        let mut nearest = Nearest {
            distance: E::all(1e9),
            which: E::all(0.0),
        };
        nearest.meet(&self.faces[hint as usize], hint, points.origin, at);
        let shift = [
            (points.origin[0] - self.middle[0]) as f32,
            (points.origin[1] - self.middle[1]) as f32,
            (points.origin[2] - self.middle[2]) as f32,
        ];
        let from_middle = [
            at[0].plus(E::all(shift[0])),
            at[1].plus(E::all(shift[1])),
            at[2].plus(E::all(shift[2])),
        ];
        // A box is visited only if it may contain a nearer triangle for some lane. A search for eight near points
        // visits hardly more boxes than a search for one of them.
        let mut bound = nearest.bound();
        let mut stack = [(E::all(0.0), 0u32); 64];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (far, at_node) = stack[depth];
            if !far.any_within(bound) {
                continue;
            }
            let node = &self.boxes.nodes[at_node as usize];
            if node.count > 0 {
                for t in node.first..node.first + node.count {
                    nearest.meet(&self.faces[t as usize], t, points.origin, at);
                }
                bound = nearest.bound();
                continue;
            }
            let one = (self.squared_to_box(at_node + 1, from_middle), at_node + 1);
            let other = (self.squared_to_box(node.first, from_middle), node.first);
            let (near, far) = if one.0.to_array()[0] <= other.0.to_array()[0] {
                (one, other)
            } else {
                (other, one)
            };
            if far.0.any_within(bound) {
                stack[depth] = far;
                depth += 1;
            }
            if near.0.any_within(bound) {
                stack[depth] = near;
                depth += 1;
            }
        }
        (
            nearest.distance.to_array(),
            nearest.which.to_array().map(f32::to_bits),
        )
    }

    #[inline(always)]
    fn squared_to_box<E: Vector8>(&self, node: u32, from: [E; 3]) -> E {
        let [low, high] = &self.spans[node as usize];
        let mut squared = E::all(0.0);
        for a in 0..3 {
            let out = E::all(low[a])
                .minus(from[a])
                .greater(from[a].minus(E::all(high[a])))
                .greater(E::all(0.0));
            squared = squared.plus(out.times(out));
        }
        squared
    }
}

#[inline(always)]
fn inner<E: Vector8>(a: [f32; 3], b: [E; 3]) -> E {
    let xy = E::all(a[0]).times(b[0]).plus(E::all(a[1]).times(b[1]));
    xy.plus(E::all(a[2]).times(b[2]))
}

#[inline(always)]
fn less<E: Vector8>(a: [E; 3], b: [f32; 3]) -> [E; 3] {
    [
        a[0].minus(E::all(b[0])),
        a[1].minus(E::all(b[1])),
        a[2].minus(E::all(b[2])),
    ]
}

#[inline(always)]
fn squared_to_edge<E: Vector8>(from: [E; 3], edge: [f32; 3], inverse: f32) -> E {
    let share = inner(edge, from)
        .times(E::all(inverse))
        .greater(E::all(0.0))
        .lesser(E::all(1.0));
    let x = from[0].minus(share.times(E::all(edge[0])));
    let y = from[1].minus(share.times(E::all(edge[1])));
    let z = from[2].minus(share.times(E::all(edge[2])));
    x.times(x).plus(y.times(y)).plus(z.times(z))
}

/// Nearest triangle that the search has found so far for the point in each lane.
struct Nearest<E> {
    distance: E,
    /// Number of the nearest triangle, stored as the bits of an f32.
    which: E,
}

impl<E: Vector8> Nearest<E> {
    /// Measure the distance from every lane's point to a triangle, and store the triangle where it is nearer.
    #[inline(always)]
    fn meet(&mut self, face: &Face, number: u32, origin: Point, at: [E; 3]) {
        let corner = [
            (face.corner[0] - origin[0]) as f32,
            (face.corner[1] - origin[1]) as f32,
            (face.corner[2] - origin[2]) as f32,
        ];
        let [ab, bc, ca] = face.edges;
        let from_a = less(at, corner);
        let from_b = less(from_a, ab);
        let from_c = less(from_b, bc);
        let over = inner(face.outwards[0], from_a)
            .greater(inner(face.outwards[1], from_b))
            .greater(inner(face.outwards[2], from_c))
            .plus(E::all(face.flat));
        let side = inner(face.normal, from_a);
        let edge = squared_to_edge(from_a, ab, face.inverse[0])
            .lesser(squared_to_edge(from_b, bc, face.inverse[1]))
            .lesser(squared_to_edge(from_c, ca, face.inverse[2]));
        let distance = over.above_zero(edge, side.times(side)).root();
        let nearer = self.distance.minus(distance);
        self.which = nearer.above_zero(E::all(f32::from_bits(number)), self.which);
        self.distance = self.distance.lesser(distance);
    }

    /// Return for each lane the squared distance beyond which a triangle cannot be nearer than the nearest one so far,
    /// with a margin of [`BOX_MM`].
    #[inline(always)]
    fn bound(&self) -> E {
        let far = self.distance.plus(E::all(BOX_MM));
        far.times(far)
    }
}

/// Signed distances and nearest triangles of eight points.
pub(crate) struct Found {
    pub(crate) signed_mm: Lanes,
    pub(crate) triangles: [u32; LANES],
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::nearest::tests::{cube, of_rings};
    use proptest::prelude::*;

    /// Return the mesh of a closed surface round the origin with folds and dents.
    ///
    /// The surface is a sphere of latitudes whose corners have the distances `radii` from the origin.
    fn dented(radii: &[f64]) -> (Vec<Point>, Vec<[u32; 3]>) {
        /// Number of rings of vertices of the mesh.
        const ROWS: usize = 7;
        /// Number of vertices of each ring of the mesh.
        const ROUND: usize = 9;
        let ends = [[0.0, 0.0, 4.0], [0.0, 0.0, -4.0]];
        of_rings(ends, [ROWS, ROUND], |row, n| {
            let polar = std::f64::consts::PI * (row + 1) as f64 / (ROWS + 1) as f64;
            let turn = std::f64::consts::TAU * n as f64 / ROUND as f64;
            let r = radii[(row * ROUND + n) % radii.len()];
            [
                r * libm::sin(polar) * libm::cos(turn),
                r * libm::sin(polar) * libm::sin(turn),
                r * libm::cos(polar),
            ]
        })
    }

    fn together(origin: Point, spread: f32, seed: u32) -> Together {
        let part = |n: usize, a: usize| {
            let hash = (seed + (n * 3 + a) as u32).wrapping_mul(2_654_435_761) >> 8;
            spread * (hash % 1000) as f32 / 1000.0
        };
        Together {
            origin,
            at: std::array::from_fn(|a| std::array::from_fn(|n| part(n, a))),
        }
    }

    fn check(vertices: &[Point], triangles: &[[u32; 3]], points: &Together, hint: usize) {
        let boxes = Boxes::new(vertices, triangles);
        let mut bits = Vec::new();
        for simd in InstructionSet::available() {
            let hint = (hint % triangles.len()) as u32;
            let found = Packets::new(&boxes, simd).signed(points, hint);
            for n in 0..LANES {
                let p = std::array::from_fn(|a| points.origin[a] + f64::from(points.at[a][n]));
                let (truth, _) = boxes.signed(p, 0);
                // The tolerance allows for the rounding to f32 of coordinates within some 10 mm.
                let one = f64::from(found.signed_mm[n]);
                assert!((one - truth).abs() < 2e-5, "{one} {truth} at {p:?}");
                let triangle = boxes.triangles[found.triangles[n] as usize];
                let away = carina_grid::length(sub(p, crate::nearest::nearest_on(triangle, p).0));
                assert!((away - truth.abs()).abs() < 2e-5, "{away} {truth}");
            }
            bits.push(found.signed_mm.map(f32::to_bits));
        }
        assert!(bits.windows(2).all(|w| w[0] == w[1]));
    }

    /// Return the winding number of a surface round a point: 1 inside, 0 outside.
    ///
    /// The method uses solid angles (van Oosterom and Strackee 1983).
    fn winding(vertices: &[Point], triangles: &[[u32; 3]], p: Point) -> f64 {
        let angles = triangles.iter().map(|t| {
            let [a, b, c] = t.map(|v| sub(vertices[v as usize], p));
            let [la, lb, lc] = [a, b, c].map(carina_grid::length);
            let below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
            libm::atan2(dot(a, cross(b, c)), below)
        });
        angles.sum::<f64>() / std::f64::consts::TAU
    }

    proptest! {
        #[test]
        fn distances_have_the_right_sign_at_every_corner_and_fold(
            radii in prop::collection::vec(2.0..6.0f64, 40..63),
            place in prop::array::uniform3(-6.0..6.0f64),
        ) {
            let (vertices, triangles) = dented(&radii);
            let boxes = Boxes::new(&vertices, &triangles);
            let (found, _) = boxes.signed(place, 0);
            let inside = winding(&vertices, &triangles, place) > 0.5;
            prop_assert!(found.abs() < 1e-6 || (found > 0.0) == inside, "{found} {inside}");
        }

        #[test]
        fn distances_of_a_packet_equal_those_of_single_points(
            radii in prop::collection::vec(2.0..6.0f64, 40..63),
            place in prop::array::uniform3(-6.0..6.0f64),
            spread in 0.0..1.0f32,
            seed in 0u32..1_000_000,
            hint in 0usize..200,
        ) {
            let (vertices, triangles) = dented(&radii);
            check(&vertices, &triangles, &together(place, spread, seed), hint);
        }

        #[test]
        fn packets_beside_faces_edges_and_corners_of_a_cube_have_the_right_sign(
            place in prop::array::uniform3(-8i32..8),
            seed in 0u32..1_000_000,
        ) {
            let (vertices, triangles) = cube();
            check(&vertices, &triangles, &together(place.map(f64::from), 1.0, seed), seed as usize);
        }
    }

    #[test]
    fn triangles_without_area_or_length_do_not_change_distances() {
        let (mut vertices, mut triangles) = cube();
        vertices.push([0.0, 0.0, 5.0]);
        triangles.extend([[8, 8, 8], [0, 0, 1], [8, 1, 8]]);
        // The last two triangles have no area and are on the surface or inside it: only their edges are near, and they
        // do not determine a sign.
        for seed in 0..50 {
            check(
                &vertices,
                &triangles[..13],
                &together([0.0, 0.0, 4.0], 3.0, seed),
                12,
            );
        }
    }
}
