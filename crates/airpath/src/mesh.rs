//! Surface of the lumen as a closed mesh with vertices on the sub-voxel wall.
//!
//! The method is marching cubes (Lorensen and Cline 1987) over the lumen voxels, with two differences. First, the cases
//! do not come from a printed table: in each face of a cube, one rule that uses only that face joins the crossings of
//! its edges, so that both cubes of a face agree and the mesh has no holes. Second, a vertex is at the wall's
//! half-maximum between the two voxels of its grid edge, which the radii of the tree also use (docs/decisions/0117,
//! 0111).

use std::collections::HashMap;
use std::sync::OnceLock;

use carina_grid::{Ijk, VolumeView};
use rayon::prelude::*;

use crate::tree::smooth::Point;
use carina_leastcost::lumen::WallLevels;
use carina_leastcost::{TrackError, Watch};

/// Closed mesh of triangles, whose vertices are counterclockwise as seen from outside the lumen.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Positions of the vertices, LPS mm.
    pub vertices: Vec<Point>,
    /// Triangles, each as the indices of its three vertices.
    pub triangles: Vec<[u32; 3]>,
}

/// Minimum distance of a vertex from the voxels of its grid edge, as a fraction of the edge, so that no triangle has
/// an area of 0.
pub(crate) const MARGIN: f64 = 0.02;

/// Grid edges of a cube, each as its lower corner and its axis.
///
/// Corner c is at (c & 1, c >> 1 & 1, c >> 2).
pub(crate) const EDGES: [(usize, usize); 12] = [
    (0, 0),
    (2, 0),
    (4, 0),
    (6, 0),
    (0, 1),
    (1, 1),
    (4, 1),
    (5, 1),
    (0, 2),
    (1, 2),
    (2, 2),
    (3, 2),
];

/// Corners of the six faces of a cube, counterclockwise as seen from outside.
const FACES: [[usize; 4]; 6] = [
    [0, 4, 6, 2],
    [1, 3, 7, 5],
    [0, 1, 5, 4],
    [2, 6, 7, 3],
    [0, 2, 3, 1],
    [4, 5, 7, 6],
];

/// Closed rings of grid edges that the surface crosses in a cube, for one set of corners inside the lumen.
type Rings = Vec<Vec<usize>>;

fn edge_between(a: usize, b: usize) -> usize {
    let (low, axis) = (a.min(b), (a ^ b).trailing_zeros() as usize);
    EDGES
        .iter()
        .position(|edge| *edge == (low, axis))
        .unwrap_or_else(|| unreachable!("corners {a} and {b} share an edge"))
}

fn rings_of(inside: u8) -> Rings {
    let holds = |corner: usize| inside >> corner & 1 == 1;
    // On one of its two faces, each crossed edge ends a run of inside corners; on the other it begins one.
    let mut after = [usize::MAX; 12];
    for face in FACES {
        for n in 0..4 {
            if holds(face[n]) || !holds(face[(n + 1) % 4]) {
                continue;
            }
            // If two diagonal corners of a face are inside, the surface separates them. Both cells of a face apply this
            // rule, so the mesh has no hole there.
            let mut last = (n + 1) % 4;
            while holds(face[(last + 1) % 4]) {
                last = (last + 1) % 4;
            }
            let enters = edge_between(face[n], face[(n + 1) % 4]);
            let leaves = edge_between(face[last], face[(last + 1) % 4]);
            after[enters] = leaves;
        }
    }
    let mut rings = Vec::new();
    let mut seen = [false; 12];
    for first in 0..12 {
        if after[first] == usize::MAX || seen[first] {
            continue;
        }
        let mut ring = Vec::new();
        let mut edge = first;
        while !seen[edge] {
            seen[edge] = true;
            ring.push(edge);
            edge = after[edge];
        }
        rings.push(ring);
    }
    rings
}

/// Return true if two crossed grid edges belong to one face; the neighbouring cube might draw the same chord between
/// them.
fn share_face(a: usize, b: usize) -> bool {
    let on = |edge: usize, face: &[usize; 4]| {
        let (corner, axis) = EDGES[edge];
        face.contains(&corner) && face.contains(&(corner | 1 << axis))
    };
    FACES.iter().any(|face| on(a, face) && on(b, face))
}

/// Return a ring rotated so that a triangle fan from its first edge has no chord in a face; `None` if no rotation has
/// this property.
fn rotated_to_fan_apex(ring: &[usize]) -> Option<Vec<usize>> {
    let n = ring.len();
    (0..n)
        .map(|start| (0..n).map(|m| ring[(start + m) % n]).collect::<Vec<_>>())
        .find(|turned| (2..n - 1).all(|m| !share_face(turned[0], turned[m])))
}

/// Ring of crossed grid edges, to be filled by a fan of triangles.
///
/// The apex of the fan is the first edge of the ring, or the centre of the ring if `has_apex` is false.
pub(crate) struct CellRing {
    pub(crate) edges: Vec<usize>,
    pub(crate) has_apex: bool,
}

/// Return the rings of a cube for each of the 256 sets of corners inside the lumen.
pub(crate) fn cell_rings() -> &'static [Vec<CellRing>] {
    /// Rings of each set of corners, computed on first use.
    static CASES: OnceLock<Vec<Vec<CellRing>>> = OnceLock::new();
    CASES.get_or_init(|| {
        (0..=255u8)
            .map(|inside| {
                let rings = rings_of(inside).into_iter();
                rings
                    .map(|ring| match rotated_to_fan_apex(&ring) {
                        Some(edges) => CellRing {
                            edges,
                            has_apex: true,
                        },
                        None => CellRing {
                            edges: ring,
                            has_apex: false,
                        },
                    })
                    .collect()
            })
            .collect()
    })
}

/// Return the surface of the lumen voxels (`lumen` is not 0) as a closed mesh.
///
/// `levels` are the values of air and wall with which the search found the lumen in `values`; with `None` (an imported
/// mask) the surface is half-way between voxels. At the volume's faces, beyond which no values exist, the mesh is closed half a voxel further out.
///
/// # Errors
///
/// Returns an error if `watch` stops the computation.
pub fn lumen_mesh(
    values: VolumeView<'_, i16>,
    lumen: &[u8],
    levels: Option<WallLevels>,
    watch: &impl Watch,
) -> Result<Mesh, TrackError> {
    let shape = values.grid().shape_ijk();
    let reach = Reach::new(values, lumen, levels);
    let Some((low, high)) = reach.extent() else {
        return Err(TrackError::NoResult("the airway lumen is empty".to_owned()));
    };
    let cases: Vec<Rings> = (0..=255u8).map(rings_of).collect();
    // A grid with left-handed axes turns every triangle inside out.
    let mirrored = values.grid().lps_from_ijk().determinant() < 0.0;
    let mut mesh = Mesh::default();
    let mut vertex_at: HashMap<(u64, u8), u32> = HashMap::new();
    let num_layers = (high[2] - low[2] + 2) as f64;
    for k in low[2] - 1..=high[2] {
        watch.report_fraction((k - low[2] + 1) as f64 / num_layers)?;
        for j in low[1] - 1..=high[1] {
            for i in low[0] - 1..=high[0] {
                let at = |corner: usize| {
                    [
                        i + (corner & 1) as isize,
                        j + (corner >> 1 & 1) as isize,
                        k + (corner >> 2) as isize,
                    ]
                };
                let inside = (0..8).fold(0u8, |bits, c| bits | u8::from(reach.holds(at(c))) << c);
                for ring in &cases[usize::from(inside)] {
                    let mut vertex = |edge: usize| {
                        let (corner, axis) = EDGES[edge];
                        let lower = at(corner);
                        // The shape extends by one voxel on each side, so the key is never negative.
                        let key = (0..3).rev().fold(0u64, |key, a| {
                            key * (shape[a] as u64 + 2) + (lower[a] + 1) as u64
                        });
                        *vertex_at.entry((key, axis as u8)).or_insert_with(|| {
                            mesh.vertices.push(reach.crossing_lps(lower, axis));
                            mesh.vertices.len() as u32 - 1
                        })
                    };
                    let (apex, rim) = if let Some(turned) = rotated_to_fan_apex(ring) {
                        let rim: Vec<u32> = turned[1..].iter().map(|e| vertex(*e)).collect();
                        (vertex(turned[0]), rim)
                    } else {
                        let mut rim: Vec<u32> = ring.iter().map(|e| vertex(*e)).collect();
                        let middle = mean(rim.iter().map(|v| mesh.vertices[*v as usize]));
                        mesh.vertices.push(middle);
                        rim.push(rim[0]);
                        (mesh.vertices.len() as u32 - 1, rim)
                    };
                    for pair in rim.windows(2) {
                        let [b, c] = if mirrored {
                            [pair[1], pair[0]]
                        } else {
                            [pair[0], pair[1]]
                        };
                        mesh.triangles.push([apex, b, c]);
                    }
                }
            }
        }
    }
    Ok(mesh)
}

/// Return the mask of the voxels whose centres are inside the surface of [`lumen_mesh`]: 1 inside, 0 outside.
///
/// The flood stops below the wall's half-maximum, so the lumen of the search lacks its outermost voxels. Masks that are
/// exported or shown contain them.
pub fn lumen_mask(
    values: VolumeView<'_, i16>,
    lumen: &[u8],
    levels: Option<WallLevels>,
) -> Vec<u8> {
    let reach = Reach::new(values, lumen, levels);
    let [nx, ny, _] = values.grid().shape_ijk();
    let mut mask: Vec<u8> = lumen.iter().map(|v| u8::from(*v != 0)).collect();
    if levels.is_none() {
        return mask;
    }
    mask.par_chunks_mut(nx * ny)
        .enumerate()
        .for_each(|(k, slice)| {
            // Only voxels beside the lumen can be added, so rows without lumen in or beside them are skipped.
            for (j, row) in slice.chunks_mut(nx).enumerate() {
                if !reach.has_lumen_round(j, k) {
                    continue;
                }
                for (i, voxel) in row.iter_mut().enumerate() {
                    if *voxel == 0 {
                        *voxel = u8::from(reach.holds([i, j, k].map(|v| v as isize)));
                    }
                }
            }
        });
    mask
}

fn mean(points: impl ExactSizeIterator<Item = Point>) -> Point {
    let count = points.len() as f64;
    let sum = points.fold([0.0; 3], |sum: Point, p| {
        std::array::from_fn(|a| sum[a] + p[a])
    });
    sum.map(|v| v / count)
}

/// Lumen that is extended by up to one voxel to the half-maximum of its wall.
///
/// The extension adds the neighbouring voxels whose centre is in front of the half-maximum, because the flood stops at
/// a lower value.
pub(crate) struct Reach<'a> {
    values: VolumeView<'a, i16>,
    lumen: &'a [u8],
    levels: Option<WallLevels>,
    shape: [isize; 3],
}

impl<'a> Reach<'a> {
    pub(crate) fn new(
        values: VolumeView<'a, i16>,
        lumen: &'a [u8],
        levels: Option<WallLevels>,
    ) -> Self {
        Self {
            values,
            lumen,
            levels,
            shape: values.grid().shape_ijk().map(|n| n as isize),
        }
    }

    pub(crate) fn in_volume(&self, at: [isize; 3]) -> bool {
        (0..3).all(|a| (0..self.shape[a]).contains(&at[a]))
    }

    pub(crate) fn in_lumen(&self, at: [isize; 3]) -> bool {
        self.in_volume(at)
            && self.lumen[((at[2] * self.shape[1] + at[1]) * self.shape[0] + at[0]) as usize] != 0
    }

    /// Return the distance from a lumen voxel along a step to the half-maximum of the wall, in steps (0 to 2).
    pub(crate) fn crossing(&self, from: [isize; 3], step: [isize; 3]) -> f64 {
        let Some(levels) = self.levels else {
            return 0.5;
        };
        let place = |n: isize| std::array::from_fn(|a| from[a] + n * step[a]);
        let [here, next, beyond] = [0, 1, 2].map(|n| f64::from(self.values.at_clamped(place(n))));
        // The levels of air and wall come from all neighbours of a voxel, because three voxels along a line that grazes
        // the wall do not reach its maximum.
        let (air, _) = self.range_round(from);
        let (_, wall) = self.range_round(place(1));
        let Some(level) = levels.edge_level(air, wall) else {
            return 0.0;
        };
        if here >= level {
            0.0
        } else if level <= next {
            (level - here) / (next - here)
        } else if level <= beyond {
            1.0 + (level - next) / (beyond - next)
        } else {
            // No wall is visible: the lumen ends here for another reason, such as a closed breach.
            0.5
        }
    }

    /// Return the smallest and the largest value among a voxel and its neighbours.
    fn range_round(&self, at: [isize; 3]) -> (f64, f64) {
        let (mut low, mut high) = (i16::MAX, i16::MIN);
        for cell in 0..27isize {
            let offset = [cell % 3 - 1, cell / 3 % 3 - 1, cell / 9 - 1];
            let value = self
                .values
                .at_clamped(std::array::from_fn(|a| at[a] + offset[a]));
            (low, high) = (low.min(value), high.max(value));
        }
        (f64::from(low), f64::from(high))
    }

    /// Return whether a row of voxels or one of the four rows beside it contains lumen.
    fn has_lumen_round(&self, j: usize, k: usize) -> bool {
        let [nx, ny, nz] = self.shape;
        [[0, 0], [-1, 0], [1, 0], [0, -1], [0, 1]]
            .into_iter()
            .map(|[dj, dk]| [j as isize + dj, k as isize + dk])
            .filter(|[j, k]| (0..ny).contains(j) && (0..nz).contains(k))
            .any(|[j, k]| {
                let first = ((k * ny + j) * nx) as usize;
                self.lumen[first..first + nx as usize]
                    .iter()
                    .any(|v| *v != 0)
            })
    }

    fn holds(&self, at: [isize; 3]) -> bool {
        if self.in_lumen(at) {
            return true;
        }
        self.in_volume(at)
            && self.levels.is_some()
            && steps().any(|step| {
                let from = std::array::from_fn(|a| at[a] - step[a]);
                self.in_lumen(from) && self.crossing(from, step) > 1.0
            })
    }

    /// Return the first and the last voxel on each axis that may be inside the surface; `None` for an empty lumen.
    fn extent(&self) -> Option<([isize; 3], [isize; 3])> {
        let (mut low, mut high) = (self.shape, [-1isize; 3]);
        for (row, cells) in self.lumen.chunks(self.shape[0] as usize).enumerate() {
            let Some(first) = cells.iter().position(|v| *v != 0) else {
                continue;
            };
            let last = cells.iter().rposition(|v| *v != 0).unwrap_or(first);
            let (j, k) = (row as isize % self.shape[1], row as isize / self.shape[1]);
            low = [low[0].min(first as isize), low[1].min(j), low[2].min(k)];
            high = [high[0].max(last as isize), high[1].max(j), high[2].max(k)];
        }
        (high[0] >= 0).then(|| {
            (
                low.map(|v| (v - 1).max(0)),
                std::array::from_fn(|a| (high[a] + 1).min(self.shape[a] - 1)),
            )
        })
    }

    /// Return the point where the surface crosses the grid edge from voxel `lower` along an axis.
    ///
    /// Exactly one end of the edge must be inside.
    fn crossing_lps(&self, lower: [isize; 3], axis: usize) -> Point {
        let mut upper = lower;
        upper[axis] += 1;
        let outwards = self.holds(lower);
        let (from, to) = if outwards {
            (lower, upper)
        } else {
            (upper, lower)
        };
        let step: [isize; 3] = std::array::from_fn(|a| to[a] - from[a]);
        let share = if !self.in_volume(to) {
            0.5
        } else if self.in_lumen(from) {
            self.crossing(from, step)
        } else {
            // This voxel is inside only because the lumen is extended. The crossing is computed from the lumen voxel on its
            // other side, if that voxel exists.
            let behind = std::array::from_fn(|a| from[a] - step[a]);
            if self.in_lumen(behind) {
                self.crossing(behind, step) - 1.0
            } else {
                self.crossing(from, step)
            }
        }
        .clamp(MARGIN, 1.0 - MARGIN);
        let ijk = std::array::from_fn(|a| from[a] as f64 + share * step[a] as f64);
        self.values.grid().to_lps(Ijk(ijk)).0
    }
}

fn steps() -> impl Iterator<Item = [isize; 3]> {
    (0..6).map(|n| {
        std::array::from_fn(|a| {
            if a == n / 2 {
                1 - 2 * (n as isize % 2)
            } else {
                0
            }
        })
    })
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;
    use std::f64::consts::PI;

    use carina_grid::{Affine, Grid, VolumeView};
    use proptest::prelude::*;

    use super::{Mesh, lumen_mesh};
    use carina_leastcost::Unwatched;
    use carina_leastcost::lumen::WallLevels;

    /// Value levels of the drawn lumen and wall.
    const LEVELS: WallLevels = WallLevels {
        core: -900.0,
        wall: -500.0,
        rise: 25.0,
    };

    fn grid(shape_zyx: [usize; 3], spacing: [f64; 3], mirrored: bool) -> Grid {
        let x = if mirrored { -spacing[0] } else { spacing[0] };
        let rows = [
            [x, 0.0, 0.0, 5.0],
            [0.0, spacing[1], 0.0, -7.0],
            [0.0, 0.0, spacing[2], 11.0],
            [0.0, 0.0, 0.0, 1.0],
        ];
        Grid::new(shape_zyx, Affine::from_matrix("test", &rows).unwrap()).unwrap()
    }

    /// Return true if the mesh contains every edge once in each direction.
    fn is_closed(mesh: &Mesh) -> bool {
        let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
        for t in &mesh.triangles {
            for n in 0..3 {
                *edges.entry((t[n], t[(n + 1) % 3])).or_default() += 1;
            }
        }
        edges
            .iter()
            .all(|((a, b), count)| *count == 1 && edges.get(&(*b, *a)) == Some(&1))
    }

    fn volume_mm3(mesh: &Mesh) -> f64 {
        mesh.triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| mesh.vertices[v as usize]);
                (a[0] * (b[1] * c[2] - b[2] * c[1])
                    + a[1] * (b[2] * c[0] - b[0] * c[2])
                    + a[2] * (b[0] * c[1] - b[1] * c[0]))
                    / 6.0
            })
            .sum()
    }

    #[test]
    fn the_mesh_of_a_ball_is_closed_and_has_its_volume_in_right_and_left_handed_grids() {
        let (radius, spacing) = (6.0, [0.7, 0.8, 1.1]);
        for mirrored in [false, true] {
            let grid = grid([24, 28, 30], spacing, mirrored);
            let mut values = vec![0i16; 24 * 28 * 30];
            for (n, value) in values.iter_mut().enumerate() {
                let at = [n % 30, n / 30 % 28, n / 840];
                let from_middle = (0..3)
                    .map(|a| ((at[a] as f64 - [14.6, 13.7, 11.4][a]) * spacing[a]).powi(2))
                    .sum::<f64>()
                    .sqrt();
                // The wall is blurred as by a scanner, with the half-maximum at the radius.
                let up = ((from_middle - radius) / 1.6 + 0.5).clamp(0.0, 1.0);
                *value = (-1000.0 + 1040.0 * up) as i16;
            }
            let lumen: Vec<u8> = values.iter().map(|v| u8::from(*v <= -800)).collect();
            let view = VolumeView::new(&values, &grid).unwrap();
            let mesh = lumen_mesh(view, &lumen, Some(LEVELS), &Unwatched).unwrap();
            assert!(is_closed(&mesh));
            // The wall level of -500 HU is slightly inside the half-maximum, and the chords of a ball are slightly
            // shorter than its arcs.
            let truth = 4.0 / 3.0 * PI * f64::powi(radius - 1.6 * (0.5 - 500.0 / 1040.0), 3);
            let share = volume_mm3(&mesh) / truth;
            assert!((share - 1.0).abs() < 0.02, "volume is {share} of the truth");
            let num_edges = mesh.triangles.len() * 3 / 2;
            assert_eq!(mesh.vertices.len() + mesh.triangles.len(), num_edges + 2);
        }
    }

    #[test]
    fn a_lumen_at_the_volumes_faces_is_closed_half_a_voxel_outside() {
        let grid = grid([3, 3, 3], [1.0; 3], false);
        let values = vec![-1000i16; 27];
        let view = VolumeView::new(&values, &grid).unwrap();
        let mesh = lumen_mesh(view, &[1; 27], Some(LEVELS), &Unwatched).unwrap();
        assert!(is_closed(&mesh));
        let lows = (0..3).map(|a| {
            mesh.vertices
                .iter()
                .map(|v| v[a])
                .fold(f64::INFINITY, f64::min)
        });
        assert_eq!(lows.collect::<Vec<_>>(), [4.5, -7.5, 10.5]);
    }

    #[test]
    fn an_empty_lumen_is_rejected() {
        let grid = grid([2, 2, 2], [1.0; 3], false);
        let values = vec![0i16; 8];
        let view = VolumeView::new(&values, &grid).unwrap();
        assert!(lumen_mesh(view, &[0; 8], None, &Unwatched).is_err());
    }

    proptest! {
        #[test]
        fn the_surface_of_any_set_of_voxels_is_closed(
            lumen in prop::collection::vec(0u8..2, 4 * 4 * 4),
            values in prop::collection::vec(-1000i16..200, 4 * 4 * 4),
            with_levels: bool,
        ) {
            prop_assume!(lumen.contains(&1));
            let grid = grid([4, 4, 4], [1.0, 1.0, 2.0], false);
            let view = VolumeView::new(&values, &grid).unwrap();
            let mesh = lumen_mesh(view, &lumen, with_levels.then_some(LEVELS), &Unwatched).unwrap();
            prop_assert!(is_closed(&mesh));
            prop_assert!(volume_mm3(&mesh) > 0.0);
        }
    }
}
