//! Computation of the values of a phantom's voxels from its shapes.
//!
//! Each brick of the grid has a list of the pieces near it, and only voxels near a surface are sampled in detail.

use carina_grid::{Affine, Grid, dot, length};
use rayon::prelude::*;

use crate::airway_tube::AirwayTube;
use crate::airways::AirwayTree;
use crate::body::{Body, with_solid};
use crate::nodule::Nodule;
use crate::shapes::{Piece, SIGMA_MM, along, cover, direction, mix, smooth_max, smooth_min, sub};

/// Distance from a surface in mm beyond which the blur has no effect ([`cover`] ends at 1.88 sigma).
const BLUR_MM: f64 = 1.88 * SIGMA_MM;
/// Maximum distance between samples within a voxel, mm, for slices up to 3 mm.
const SAMPLE_MM: f64 = 0.6;
/// Approximate edge length of a brick in mm, for any spacing, so that lists stay short on coarse grids.
const BRICK_MM: f64 = 7.0;
/// CT value of air, HU.
const AIR_HU: f64 = -1000.0;
/// CT value of an airway's wall, HU.
const WALL_HU: f64 = 38.0;
/// CT value of a vessel, HU.
const VESSEL_HU: f64 = 46.0;
/// CT value of a nodule, HU.
const NODULE_HU: f64 = 34.0;

/// Distance in radii from the centre to the chord that cuts the back off the trachea's round section (membranous wall).
const CUT: f64 = 0.6;
/// Radius of the circle with the area of the cut section of a trachea of radius 1.
const CUT_EQUIVALENT: f64 = 0.926;
/// Distance in radii by which the centroid of the cut section is in front of the circle's centre.
const CUT_CENTROID: f64 = 0.1267;

struct AirwayPiece {
    branch: u32,
    piece: Piece,
    /// Largest radius of the whole branch, mm.
    widest: f64,
    /// Direction of the membranous wall; `None` for branches other than the trachea.
    behind: Option<[f64; 3]>,
}

/// Lumen that is near a point, with the point's distance from it.
#[derive(Debug, Clone, Copy)]
struct Lumen {
    distance: f64,
    branch: u32,
}

/// Shapes of a phantom from which the values of voxels are computed.
pub(crate) struct Scene<'a> {
    tree: &'a AirwayTree,
    body: &'a Body,
    vessels: &'a [Piece],
    nodule: Option<Nodule>,
    tube: Option<&'a AirwayTube>,
    airways: Vec<AirwayPiece>,
    /// For each branch, the darkness in the middle of its blurred lumen, relative to a flat surface as far away.
    depth: Vec<f64>,
}

/// Lists of the pieces near each brick (cube of voxels), as indices in the scene's list of pieces.
struct Lists {
    start: Vec<u32>,
    items: Vec<u32>,
}

impl Lists {
    fn new(bricks: &Bricks<'_>, bounds: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> Self {
        let num_bricks = bricks.num;
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for (item, (lo, hi)) in bounds.enumerate() {
            let Some((first, last)) = bricks.of(lo, hi) else {
                continue;
            };
            for bz in first[2]..=last[2] {
                for by in first[1]..=last[1] {
                    for bx in first[0]..=last[0] {
                        let brick = (bz * num_bricks[1] + by) * num_bricks[0] + bx;
                        pairs.push((brick as u32, item as u32));
                    }
                }
            }
        }
        pairs.sort_unstable();
        let mut start = vec![0u32; num_bricks.iter().product::<usize>() + 1];
        for &(brick, _) in &pairs {
            start[brick as usize + 1] += 1;
        }
        for n in 1..start.len() {
            start[n] += start[n - 1];
        }
        Self {
            start,
            items: pairs.into_iter().map(|(_, item)| item).collect(),
        }
    }

    fn of(&self, brick: usize) -> &[u32] {
        &self.items[self.start[brick] as usize..self.start[brick + 1] as usize]
    }
}

/// Division of a grid into bricks (cubes of voxels), each of which is computed at once.
struct Bricks<'a> {
    grid: &'a Grid,
    /// Number of voxels of a brick along i, j, k.
    size: [usize; 3],
    /// Number of bricks along i, j, k.
    num: [usize; 3],
}

impl<'a> Bricks<'a> {
    fn new(grid: &'a Grid) -> Self {
        let size = grid
            .spacing_mm()
            .map(|s| ((BRICK_MM / s).round() as usize).clamp(1, 16));
        let shape = grid.shape_ijk();
        Self {
            grid,
            size,
            num: std::array::from_fn(|a| shape[a].div_ceil(size[a])),
        }
    }

    /// Return the number of the brick that contains the voxel at these indices.
    fn at(&self, ijk: [usize; 3]) -> usize {
        let [x, y, z]: [usize; 3] = std::array::from_fn(|a| ijk[a] / self.size[a]);
        (z * self.num[1] + y) * self.num[0] + x
    }

    /// Return the first and last brick, on each axis, that a box in LPS meets; `None` if the box misses the grid.
    fn of(&self, lo: [f64; 3], hi: [f64; 3]) -> Option<([usize; 3], [usize; 3])> {
        let (grid, num_bricks) = (self.grid, self.num);
        let m = grid.ijk_from_lps();
        let centre = m.point(std::array::from_fn(|a| 0.5 * (lo[a] + hi[a])));
        let mut first = [0; 3];
        let mut last = [0; 3];
        for axis in 0..3 {
            let row = m.rows()[axis];
            let reach: f64 = (0..3).map(|a| 0.5 * (hi[a] - lo[a]) * row[a].abs()).sum();
            let (from, to) = (centre[axis] - reach, centre[axis] + reach);
            let end = grid.shape_ijk()[axis] as f64 - 1.0;
            if to < 0.0 || from > end {
                return None;
            }
            // Samples are relative to a voxel's centre, so a brick ends at the last centre that it contains.
            first[axis] = from.max(0.0) as usize / self.size[axis];
            last[axis] = (to.min(end) as usize / self.size[axis]).min(num_bricks[axis] - 1);
        }
        Some((first, last))
    }

    /// Return the kind of tissue that fills a brick, without regard to vessels and airways near it.
    fn kind(&self, body: &Body, brick: usize) -> Kind {
        let at = [
            brick % self.num[0],
            brick / self.num[0] % self.num[1],
            brick / self.num[0] / self.num[1],
        ];
        let half = self.size.map(|n| (n - 1) as f64 / 2.0);
        let centre = self.grid.lps_from_ijk().point(std::array::from_fn(|a| {
            (at[a] * self.size[a]) as f64 + half[a]
        }));
        let spacing = self.grid.spacing_mm();
        let reach =
            length(std::array::from_fn(|a| spacing[a] * half[a])) + 0.5 * length(spacing) + BLUR_MM;
        let s = body.surfaces(centre);
        // The distances are accurate to some tens of per cent at this range; the factor is the safety margin.
        if s.skin > 1.7 * reach {
            Kind::Air
        } else if s.lung < 0.0 && s.nearest() > 1.7 * reach {
            Kind::Lung
        } else {
            Kind::Mixed
        }
    }
}

impl<'a> Scene<'a> {
    pub(crate) fn new(
        tree: &'a AirwayTree,
        body: &'a Body,
        vessels: &'a [Piece],
        nodule: Option<Nodule>,
    ) -> Self {
        let mut airways = Vec::new();
        for branch in &tree.branches {
            let widest = branch.radius_mm.iter().copied().fold(0.0, f64::max);
            for n in 1..branch.points.len() {
                let mut piece = Piece {
                    start: branch.points[n - 1],
                    end: branch.points[n],
                    start_radius: branch.radius_mm[n - 1],
                    end_radius: branch.radius_mm[n],
                };
                let mut behind = None;
                if branch.parent.is_none() {
                    let axis = direction(sub(piece.end, piece.start));
                    behind = Some(direction(along([0.0, 1.0, 0.0], -axis[1], axis)));
                    if n == 1 && body.neck.is_none() {
                        // The trachea continues upwards beyond the first point of the ground truth, out of the volume.
                        piece.start = along(piece.start, -40.0, axis);
                    }
                }
                airways.push(AirwayPiece {
                    branch: branch.id as u32,
                    piece,
                    widest,
                    behind,
                });
            }
        }
        let depth = tree
            .branches
            .iter()
            .map(|b| {
                let r = b.tip_radius() / SIGMA_MM;
                // A Gaussian blur leaves 1 - exp(-r^2 / 2) in the middle of a cylinder; near a flat surface at that
                // distance it would leave almost everything.
                ((1.0 - libm::exp(-0.5 * r * r)) / cover(-b.tip_radius(), SIGMA_MM)).min(1.0)
            })
            .collect();
        Self {
            tree,
            body,
            vessels,
            nodule,
            tube: None,
            airways,
            depth,
        }
    }

    /// Return the scene with the given tube in its trachea, or without a tube (`None`).
    pub(crate) const fn with_tube(mut self, tube: Option<&'a AirwayTube>) -> Self {
        self.tube = tube;
        self
    }

    /// Return the air near a point, with its signed distance; `None` if no airway is near.
    ///
    /// The upper airway counts as part of the trachea.
    fn lumen(&self, p: [f64; 3], near: &[u32]) -> Option<Lumen> {
        let below = self.tree_lumen(p, near);
        let Some(neck) = &self.body.neck else {
            return below;
        };
        let distance = neck.upper_airway(p);
        if distance >= 8.0 {
            return below;
        }
        let upper = Lumen {
            distance,
            branch: 0,
        };
        Some(below.map_or(upper, |below| {
            if below.branch == 0 {
                Lumen {
                    distance: smooth_min(below.distance, distance, 1.0),
                    branch: 0,
                }
            } else if below.distance < distance {
                below
            } else {
                upper
            }
        }))
    }

    /// Return the lumen of the airway tree near a point, with its signed distance and its branch; `None` if none is
    /// near.
    ///
    /// `near` has the pieces that are examined.
    fn tree_lumen(&self, p: [f64; 3], near: &[u32]) -> Option<Lumen> {
        let far = Lumen {
            distance: f64::INFINITY,
            branch: u32::MAX,
        };
        let (mut best, mut second) = (far, far);
        let mut radii = [1.0f64; 2];
        let mut own = far;
        let mut own_radius = 1.0;
        let mut to_axis = f64::INFINITY;
        let mut take = |own: Lumen, radius: f64| {
            if own.distance < best.distance {
                second = best;
                radii[1] = radii[0];
                best = own;
                radii[0] = radius;
            } else if own.distance < second.distance {
                second = own;
                radii[1] = radius;
            }
        };
        // The pieces of one branch are consecutive.
        for &n in near {
            let airway = &self.airways[n as usize];
            if airway.branch != own.branch {
                take(own, own_radius);
                own = Lumen {
                    distance: f64::INFINITY,
                    branch: airway.branch,
                };
                to_axis = f64::INFINITY;
            }
            // The radius is that of the nearest point of the centreline, so that a section across the branch has
            // exactly the radius of the ground truth; the union of the pieces' balls would be wider where the radius
            // changes quickly.
            let (away, t) = airway.piece.axis_distance(p);
            if away < to_axis {
                to_axis = away;
                (own.distance, own_radius) = airway.distance(p, away, t);
            }
        }
        take(own, own_radius);
        if best.branch == u32::MAX {
            return None;
        }
        if second.branch != u32::MAX
            && self
                .tree
                .joined(best.branch as usize, second.branch as usize)
        {
            // The fillet has half of the smaller radius, because a carina is rounded.
            let k = 0.5 * radii[0].min(radii[1]);
            best.distance = smooth_min(best.distance, second.distance, k);
        }
        Some(best)
    }

    /// Return the shares of a point's blurred neighbourhood inside the airway's outer surface and inside its lumen.
    fn airway_shares(&self, p: [f64; 3], near: &[u32]) -> (f64, f64) {
        let Some(lumen) = self.lumen(p, near) else {
            return (0.0, 0.0);
        };
        let branch = lumen.branch as usize;
        let wall = self.tree.branches[branch].wall_mm;
        (
            cover(lumen.distance - wall, SIGMA_MM),
            cover(lumen.distance, SIGMA_MM) * self.depth[branch],
        )
    }

    /// Convert a distance to all air to a distance to the airway tree alone, which ends at the cricoid.
    fn below_the_cricoid(&self, p: [f64; 3], distance: f64) -> f64 {
        self.body.neck.as_ref().map_or(distance, |neck| {
            distance
                .max(p[2] - neck.cricoid_lps[2])
                .min(5.0f64.max(distance))
        })
    }

    fn vessel_distance(&self, p: [f64; 3], near: &[u32]) -> f64 {
        near.iter()
            .map(|&n| self.vessels[n as usize].distance(p).0)
            .fold(f64::INFINITY, f64::min)
    }

    /// Return the signed distances in mm from points in a grid's box to the lumen, negative inside.
    ///
    /// The value is 5 where no airway is near, and beyond the box. The voxels are computed from the same function.
    pub(crate) fn distances_at(&self, grid: &Grid, points: &[[f64; 3]]) -> Vec<f64> {
        let bricks = Bricks::new(grid);
        let margin = BLUR_MM + voxel_diagonal(grid);
        let near = Lists::new(
            &bricks,
            self.airways
                .iter()
                .map(|a| a.piece.axis_bounds(margin + a.reach(2.0))),
        );
        points
            .par_iter()
            .map(|&p| {
                grid.voxel_at(grid.to_ijk(carina_grid::Lps(p)))
                    .and_then(|voxel| self.lumen(p, near.of(bricks.at(voxel))))
                    .map_or(5.0, |lumen| self.below_the_cricoid(p, lumen.distance))
            })
            .collect()
    }

    /// Compute the values of all voxels, some slices at a time in the order of memory; return `None` if `proceed` stops
    /// it.
    pub(crate) fn voxelize(
        &self,
        grid: &Grid,
        noise: (u64, f64),
        with_distance: bool,
        proceed: &mut dyn FnMut(f64) -> bool,
    ) -> Option<Voxels> {
        let margin = BLUR_MM + 0.5 * voxel_diagonal(grid);
        let widest_wall = self
            .tree
            .branches
            .iter()
            .map(|b| b.wall_mm)
            .fold(0.0, f64::max);
        let bricks = Bricks::new(grid);
        let lists = Near {
            airways: Lists::new(
                &bricks,
                self.airways
                    .iter()
                    .map(|a| a.piece.axis_bounds(margin + a.reach(widest_wall))),
            ),
            vessels: Lists::new(&bricks, self.vessels.iter().map(|v| v.bounds(margin))),
            tube: Lists::new(
                &bricks,
                self.tube
                    .iter()
                    .flat_map(|t| t.pieces.iter().map(|piece| piece.bounds(margin))),
            ),
            solids: Lists::new(
                &bricks,
                self.body.solids.iter().map(|s| s.piece.bounds(margin)),
            ),
        };
        let [nx, ny, nz] = grid.shape_ijk();
        let slice_len = nx * ny;
        let mut out = Voxels {
            hu: vec![0; grid.num_voxels()],
            lumen: vec![0; grid.num_voxels()],
            upper: vec![0; self.body.neck.as_ref().map_or(0, |_| grid.num_voxels())],
            distance: with_distance.then(|| vec![0.0; grid.num_voxels()]),
        };
        let bricks_in_plane = bricks.num[0] * bricks.num[1];
        // A layer has whole bricks, and enough slices to keep all cores busy.
        let layer = bricks.size[2] * 24usize.div_ceil(bricks.size[2]);
        let mut values = vec![0f32; layer * slice_len];
        for z0 in (0..nz).step_by(layer) {
            let z1 = (z0 + layer).min(nz);
            let range = z0 * slice_len..z1 * slice_len;
            let values = &mut values[..range.len()];
            let first_brick = z0 / bricks.size[2] * bricks_in_plane;
            let kinds: Vec<Kind> = (first_brick..z1.div_ceil(bricks.size[2]) * bricks_in_plane)
                .into_par_iter()
                .map(|b| bricks.kind(self.body, b))
                .collect();
            let mut nothing: Vec<f32> = Vec::new();
            let distance = out
                .distance
                .as_mut()
                .map_or(&mut nothing[..], |d| &mut d[range.clone()]);
            // Rows are the smallest jobs with contiguous memory.
            let lumen = &mut out.lumen[range.clone()];

            let row = |n: usize, values: &mut [f32], lumen: &mut [u8], distance: &mut [f32]| {
                let (y, z) = (n % ny, z0 + n / ny);
                self.row(
                    &bricks,
                    &lists,
                    &kinds,
                    first_brick,
                    [y, z],
                    values,
                    lumen,
                    distance,
                );
            };
            if distance.is_empty() {
                values
                    .par_chunks_mut(nx)
                    .zip(lumen.par_chunks_mut(nx))
                    .enumerate()
                    .for_each(|(n, (v, l))| row(n, v, l, &mut []));
            } else {
                values
                    .par_chunks_mut(nx)
                    .zip(lumen.par_chunks_mut(nx))
                    .zip(distance.par_chunks_mut(nx))
                    .enumerate()
                    .for_each(|(n, ((v, l), d))| row(n, v, l, d));
            }
            crate::noise::finish(
                values,
                &mut out.hu[range.clone()],
                nx,
                slice_len,
                z0,
                noise.0,
                noise.1,
            );
            if !out.upper.is_empty() {
                for (l, u) in out.lumen[range.clone()]
                    .iter_mut()
                    .zip(&mut out.upper[range.clone()])
                {
                    *u = *l >> 1;
                    *l &= 1;
                }
            }
            if !proceed(z1 as f64 / nz as f64) {
                return None;
            }
        }
        Some(out)
    }

    fn row(
        &self,
        bricks: &Bricks<'_>,
        lists: &Near,
        kinds: &[Kind],
        first_brick: usize,
        [y, z]: [usize; 2],
        values: &mut [f32],
        lumen: &mut [u8],
        distance: &mut [f32],
    ) {
        let grid = bricks.grid;
        let spacing = grid.spacing_mm();
        let half_diagonal = 0.5 * voxel_diagonal(grid);
        // Surfaces of the body are not sampled within a voxel; their blur is widened by the voxel's box instead.
        let body_sigma = (SIGMA_MM * SIGMA_MM + dot(spacing, spacing) / 36.0).sqrt();
        let offsets = sample_offsets(grid.lps_from_ijk(), spacing);
        let each = 1.0 / offsets.len() as f64;
        let (mut vessels, mut airways) = (Vec::new(), Vec::new());
        for (x, value) in values.iter_mut().enumerate() {
            let brick = bricks.at([x, y, z]);
            let p = grid.lps_from_ijk().point([x as f64, y as f64, z as f64]);
            let mut hu = match kinds[brick - first_brick] {
                Kind::Air => AIR_HU,
                Kind::Lung => self.body.parenchyma_hu(p),
                Kind::Mixed => self.body.hu(p, body_sigma),
            };
            if let Some(neck) = &self.body.neck {
                hu = neck.with_cartilage(hu, p, neck.upper_airway(p), body_sigma);
            }
            for &n in lists.solids.of(brick) {
                hu = with_solid(hu, &self.body.solids[n as usize], p, body_sigma);
            }
            // Only pieces within this distance can affect a sample in the voxel.
            vessels.clear();
            vessels.extend(
                lists
                    .vessels
                    .of(brick)
                    .iter()
                    .filter(|&&n| self.vessels[n as usize].distance(p).0 < BLUR_MM + half_diagonal),
            );
            if !vessels.is_empty() {
                let d = self.vessel_distance(p, &vessels);
                if d < BLUR_MM + half_diagonal {
                    let share = if d < -BLUR_MM - half_diagonal {
                        1.0
                    } else {
                        each * offsets
                            .iter()
                            .map(|&o| {
                                let q = std::array::from_fn(|a| p[a] + o[a]);
                                cover(self.vessel_distance(q, &vessels), SIGMA_MM)
                            })
                            .sum::<f64>()
                    };
                    // Between two tissues of nearly the same HU no edge is drawn.
                    hu = mix(hu, VESSEL_HU.max(hu.min(60.0)), share);
                }
            }
            if let Some(nodule) = self.nodule {
                let d = length(sub(p, nodule.centre_lps)) - nodule.radius_mm;
                hu = mix(hu, NODULE_HU, cover(d, body_sigma));
            }
            let all = lists.airways.of(brick);
            // Far from all lumina only a lower bound of the distance is known.
            let mut to_lumen = 5.0;
            if let Some(near) = self.lumen(p, all) {
                to_lumen = near.distance;
                let wall = self.tree.branches[near.branch as usize].wall_mm;
                let reach = BLUR_MM + half_diagonal;
                if to_lumen < -reach {
                    hu = AIR_HU;
                } else if to_lumen < wall + reach {
                    airways.clear();
                    airways.extend(all.iter().filter(|&&n| {
                        let airway = &self.airways[n as usize];
                        let wall = self.tree.branches[airway.branch as usize].wall_mm;
                        airway.piece.axis_distance(p).0 < reach + airway.reach(wall)
                    }));
                    let (mut outer, mut inner) = (0.0, 0.0);
                    for &o in &offsets {
                        let q = std::array::from_fn(|a| p[a] + o[a]);
                        let (out, inn) = self.airway_shares(q, &airways);
                        outer += each * out;
                        inner += each * inn;
                    }
                    hu = hu * (1.0 - outer) + WALL_HU * (outer - inner) + AIR_HU * inner;
                }
            }
            if let Some(tube) = self.tube {
                hu = tube.lay_over(hu, p, lists.tube.of(brick), &offsets, to_lumen);
            }
            *value = hu as f32;
            let below = self.below_the_cricoid(p, to_lumen);
            // The value 2 marks the upper airway.
            lumen[x] = if to_lumen >= 0.0 {
                0
            } else {
                1 + u8::from(below >= 0.0)
            };
            if let Some(d) = distance.get_mut(x) {
                *d = below as f32;
            }
        }
    }
}

/// Values and masks of the voxels of a phantom.
pub(crate) struct Voxels {
    pub(crate) hu: Vec<i16>,
    pub(crate) lumen: Vec<u8>,
    /// Mask of the air above the cricoid: 1 inside; empty without a neck.
    pub(crate) upper: Vec<u8>,
    pub(crate) distance: Option<Vec<f32>>,
}

struct Near {
    airways: Lists,
    vessels: Lists,
    solids: Lists,
    tube: Lists,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Air,
    Lung,
    Mixed,
}

impl AirwayPiece {
    /// Return the distance from its axis, in mm, within which a piece can affect the lumen or a wall of `wall` mm.
    ///
    /// The distance includes the branch's largest radius (the nearest piece must be known near any part of the branch)
    /// and the largest fillet.
    fn reach(&self, wall: f64) -> f64 {
        // A cut circle is wider than the circle of equal area.
        let more = if self.behind.is_some() { 2.0 } else { 0.0 };
        1.5 * self.widest + wall + more
    }

    /// Return the signed distance of a point to the lumen, and the lumen's radius, mm.
    ///
    /// The point is `away` from the piece's axis, nearest to the position `t` (0 to 1) along it.
    fn distance(&self, p: [f64; 3], away: f64, t: f64) -> (f64, f64) {
        let radius = mix(self.piece.start_radius, self.piece.end_radius, t);
        let Some(behind) = self.behind else {
            return (away - radius, radius);
        };
        let full = radius / CUT_EQUIVALENT;
        let shift = CUT_CENTROID * full;
        let moved = Piece {
            start: along(self.piece.start, shift, behind),
            end: along(self.piece.end, shift, behind),
            start_radius: self.piece.start_radius / CUT_EQUIVALENT,
            end_radius: self.piece.end_radius / CUT_EQUIVALENT,
        };
        let (circle, t) = moved.distance(p);
        let axis_point = along(moved.start, t, sub(moved.end, moved.start));
        let flat = dot(sub(p, axis_point), behind) - CUT * full;
        (smooth_max(circle, flat, 0.25 * full), radius)
    }
}

fn voxel_diagonal(grid: &Grid) -> f64 {
    length(grid.spacing_mm())
}

/// Return positions that are distributed evenly over a voxel's box, as LPS offsets from its centre.
///
/// The positions are at most [`SAMPLE_MM`] apart, unless this would need more than five per axis.
fn sample_offsets(lps_from_ijk: &Affine, spacing: [f64; 3]) -> Vec<[f64; 3]> {
    let num = spacing.map(|s| ((s / SAMPLE_MM).ceil() as usize).clamp(1, 5));
    let place = |n: usize, i: usize| (i as f64 + 0.5) / n as f64 - 0.5;
    let mut offsets = Vec::with_capacity(num.iter().product());
    for k in 0..num[2] {
        for j in 0..num[1] {
            for i in 0..num[0] {
                offsets.push(lps_from_ijk.vector([
                    place(num[0], i),
                    place(num[1], j),
                    place(num[2], k),
                ]));
            }
        }
    }
    offsets
}
