//! Voxel graph of the airway lumen and the cost `lumen` (docs/algorithms.md).
//!
//! Nodes are lumen voxels only. An edge links two of the 26 neighbours by the straight line between their centres. A
//! step along an axis always exists; a diagonal step exists only if the HU interpolated at 1/4, 1/2 and 3/4 of it is
//! still inside, because two lumen voxels can touch at a corner across a wall. The weight per mm falls with the cube of
//! the distance to the wall, so a path stays in the middle of the tube, for any width of the tube.

use carina_grid::{Affine, Grid, VolumeView, dot, length};
use rayon::prelude::*;

use crate::TrackError;
use crate::distance::VoxelBox;
use crate::graph::{Cost, Graph};
use crate::voxel_set::VoxelSet;
use crate::wall_sites::{NO_SITE, nearest_outside_lumen};

/// Value levels that define where the wall of the lumen begins, in the volume's own numbers (HU on a calibrated CT).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WallLevels {
    /// Maximum value of air in the trachea with its noise; a darker voxel is certainly air.
    pub core: f32,
    /// Value half-way between the air of the lumen and soft tissue.
    pub wall: f32,
    /// Largest rise above the brighter end of a diagonal step that is noise; a larger rise on the step is a wall.
    pub rise: f32,
}

impl WallLevels {
    /// Return the value at the true edge of a lumen with the value `air` whose wall has the maximum `peak`.
    ///
    /// The result is `None` if the lumen contains no air.
    #[must_use]
    pub fn edge_level(self, air: f64, peak: f64) -> Option<f64> {
        let tissue = 2.0 * (f64::from(self.wall) - air);
        (tissue > 0.0).then(|| air + tissue * edge_of_shown((peak - air) / tissue))
    }

    /// Return the position of the lumen's end along three successive voxels, in voxels from the first.
    ///
    /// The first voxel is lumen, the second is not. The end is half-way up from the lumen to the wall's tissue. A wall
    /// thinner than the blur has a maximum below that of its tissue, and at its true edge a value slightly below half
    /// of the tissue's; half of its maximum would be well inside the lumen (docs/decisions/0117). The lumen's last
    /// voxel may be before the end, because the flood stops at a lower value.
    fn crossing(self, [low, next, beyond]: [i16; 3]) -> f64 {
        let [low, next, beyond] = [low, next, beyond].map(f64::from);
        let Some(level) = self.edge_level(low, next.max(beyond)) else {
            // The voxel has no air: the user has painted this part of the lumen.
            return 0.5;
        };
        if low < level && level <= next {
            (level - low) / (next - low)
        } else if next < level && level <= beyond {
            1.0 + (level - next) / (beyond - next)
        } else {
            // No wall is visible: the lumen ends here for another reason, such as a closed breach.
            0.5
        }
    }
}

/// Return the value at the true edge of a blurred wall, from the wall's maximum value.
///
/// Both are fractions of the rise from the lumen to the wall's tissue.
///
/// A flat wall of thickness w under a Gaussian blur sigma has a maximum of 2 Phi(w / 2 sigma) - 1 of its tissue, and
/// Phi(w / sigma) - 1/2 at its edge; Phi is the normal distribution. Both depend only on w / sigma, so one follows from
/// the other; here it is tabulated at tenths.
fn edge_of_shown(share: f64) -> f64 {
    /// Values at the wall's true edge, for wall maxima of 0, 0.1, ... 1.
    const EDGE: [f64; 11] = [
        0.0, 0.0992, 0.1938, 0.2795, 0.3529, 0.4113, 0.4538, 0.4809, 0.4948, 0.4995, 0.5,
    ];
    let at = 10.0 * share.clamp(0.0, 1.0);
    let before = (at as usize).min(9);
    EDGE[before] + (at - before as f64) * (EDGE[before + 1] - EDGE[before])
}

/// Graph of the lumen voxels, with edges to the 26 neighbours and the distance of each voxel to the wall.
#[derive(Debug)]
pub struct LumenGraph {
    pub(crate) lumen: VoxelSet,
    /// Voxels of the nodes in array order.
    pub(crate) voxels: Vec<[u16; 3]>,
    pub(crate) edges: Vec<u32>,
    pub(crate) wall_mm: Vec<f32>,
    /// For each node, the nearest voxel outside the lumen, near which the wall was searched.
    pub(crate) sites: Vec<[u16; 3]>,
    steps: [Step; 26],
    lps_from_ijk: Affine,
}

#[derive(Debug, Clone, Copy)]
struct Step {
    offset_ijk: [isize; 3],
    length_mm: f64,
}

/// Return the 26 steps to the neighbours of a voxel in array order: step `25 - s` is the opposite of step `s`.
fn steps(grid: &Grid) -> [Step; 26] {
    std::array::from_fn(|s| {
        let cell = if s < 13 { s } else { s + 1 } as isize;
        let offset_ijk = [cell % 3 - 1, cell / 3 % 3 - 1, cell / 9 - 1];
        Step {
            offset_ijk,
            length_mm: length(grid.lps_from_ijk().vector(offset_ijk.map(|v| v as f64))),
        }
    })
}

impl LumenGraph {
    /// Build the graph of the voxels of a volume where `lumen` is not 0.
    ///
    /// `levels` is `None` for a lumen that was not found in these values (an imported mask): then all 26 neighbours are
    /// linked and the wall is half-way between voxels.
    ///
    /// # Errors
    ///
    /// Returns an error if the lumen is empty or its array or the volume has an invalid size.
    pub fn build(
        values: VolumeView<'_, i16>,
        lumen: &[u8],
        levels: Option<WallLevels>,
    ) -> Result<Self, TrackError> {
        let grid = values.grid();
        let shape = grid.shape_ijk();
        if shape.iter().any(|&n| n > usize::from(u16::MAX)) {
            return Err(TrackError::Argument {
                what: "volume",
                expected: "at most 65535 voxels on an axis".to_owned(),
                found: format!("{shape:?}"),
            });
        }
        let voxels: Vec<[u16; 3]> = lumen
            .par_chunks(shape[0])
            .enumerate()
            .flat_map_iter(|(row, cells)| {
                let (j, k) = ((row % shape[1]) as u16, (row / shape[1]) as u16);
                cells
                    .iter()
                    .enumerate()
                    .filter(|(_, inside)| **inside != 0)
                    .map(move |(i, _)| [i as u16, j, k])
            })
            .collect();
        if voxels.is_empty() {
            return Err(TrackError::NoResult("the airway lumen is empty".to_owned()));
        }
        let mut graph = Self::unlinked(grid, voxels);
        graph.edges = (0..graph.voxels.len() as u32)
            .into_par_iter()
            .map(|node| graph.links(values, levels, node))
            .collect();
        graph.wall_mm = (0..graph.voxels.len() as u32)
            .into_par_iter()
            .map(|node| graph.wall_from_site(values, levels, node))
            .collect();
        Ok(graph)
    }

    /// Create the graph of voxels in array order, without edges and distances to the wall.
    pub(crate) fn unlinked(grid: &Grid, voxels: Vec<[u16; 3]>) -> Self {
        let shape = grid.shape_ijk();
        let lumen = VoxelSet::new(
            box_around(&voxels, shape),
            voxels.iter().map(|v| v.map(|x| x as isize)),
        );
        let sites = nearest_outside_lumen(&lumen, &voxels, shape, grid.spacing_mm());
        Self {
            lumen,
            voxels,
            edges: Vec::new(),
            wall_mm: Vec::new(),
            sites,
            steps: steps(grid),
            lps_from_ijk: *grid.lps_from_ijk(),
        }
    }

    /// Return the edges of a node as a bit mask: bit s is set if step s leads to a neighbour.
    pub(crate) fn links(
        &self,
        values: VolumeView<'_, i16>,
        levels: Option<WallLevels>,
        node: u32,
    ) -> u32 {
        // Both ends of an edge give the same result, because the positions at 1/4, 1/2 and 3/4 are the same three
        // points.
        let from = self.voxels[node as usize].map(|v| v as isize);
        let mut mask = 0u32;
        for (s, step) in self.steps.iter().enumerate() {
            let to: [isize; 3] = std::array::from_fn(|a| from[a] + step.offset_ijk[a]);
            let linked = self.lumen.holds(to)
                && (step.offset_ijk.iter().filter(|v| **v != 0).count() == 1
                    || levels.is_none_or(|l| line_is_inside(values, from, to, l)));
            mask |= u32::from(linked) << s;
        }
        mask
    }

    /// Return the distance in mm from a node's voxel to the wall, searched near the nearest voxel outside the lumen.
    pub(crate) fn wall_from_site(
        &self,
        values: VolumeView<'_, i16>,
        levels: Option<WallLevels>,
        node: u32,
    ) -> f32 {
        let spacing = values.grid().spacing_mm();
        let (voxel, site) = (self.voxels[node as usize], self.sites[node as usize]);
        if site == NO_SITE {
            // The lumen fills the volume, so its wall is unknown; the distance is half of the volume's diagonal.
            let shape = values.grid().shape_ijk();
            return (0.5 * length(std::array::from_fn(|a| shape[a] as f64 * spacing[a]))) as f32;
        }
        let (from, wall) = (voxel.map(|v| v as isize), site.map(|v| v as isize));
        self.nearest_crossing_mm(values, levels, spacing, from, wall) as f32
    }

    /// Return the smallest distance in mm from a lumen voxel to a threshold crossing near an outside voxel.
    ///
    /// The crossings are searched on the grid edges near the outside voxel `wall`.
    fn nearest_crossing_mm(
        &self,
        values: VolumeView<'_, i16>,
        levels: Option<WallLevels>,
        spacing: [f64; 3],
        from: [isize; 3],
        wall: [isize; 3],
    ) -> f64 {
        let mut best = f64::INFINITY;
        for cell in 0..27isize {
            let offset = [cell % 3 - 1, cell / 3 % 3 - 1, cell / 9 - 1];
            let outside: [isize; 3] = std::array::from_fn(|a| wall[a] + offset[a]);
            if self.lumen.voxel_box().index_of(outside).is_none() || self.lumen.holds(outside) {
                continue;
            }
            for axis in 0..3 {
                for side in [-1isize, 1] {
                    let mut inside = outside;
                    inside[axis] += side;
                    if !self.lumen.holds(inside) {
                        continue;
                    }
                    let mut beyond = outside;
                    beyond[axis] -= side;
                    let share = levels.map_or(0.5, |l| {
                        l.crossing([inside, outside, beyond].map(|at| values.at_clamped(at)))
                    });
                    let distance = length(std::array::from_fn(|a| {
                        let mut at = inside[a] as f64;
                        if a == axis {
                            at -= share * side as f64;
                        }
                        (at - from[a] as f64) * spacing[a]
                    }));
                    best = best.min(distance);
                }
            }
        }
        if best.is_finite() {
            return best;
        }
        // The nearest outside voxel always has a lumen voxel beside it, so this is a fallback for lumens of unusual
        // shape.
        length(std::array::from_fn(|a| {
            (wall[a] - from[a]) as f64 * spacing[a]
        }))
    }

    /// Return the length in mm of an offset between two voxels.
    #[must_use]
    pub fn step_mm(&self, offset_ijk: [isize; 3]) -> f64 {
        length(self.lps_from_ijk.vector(offset_ijk.map(|v| v as f64)))
    }

    /// Return the box that contains the lumen.
    #[must_use]
    pub const fn voxel_box(&self) -> VoxelBox {
        self.lumen.voxel_box()
    }

    /// Return the node of a voxel of the volume; `None` if the voxel is not lumen.
    #[must_use]
    pub fn node_at_voxel(&self, ijk: [isize; 3]) -> Option<u32> {
        self.lumen.place(ijk)
    }

    /// Return the voxel of the volume that a node represents.
    #[must_use]
    pub fn voxel(&self, node: u32) -> [usize; 3] {
        self.voxels[node as usize].map(usize::from)
    }

    /// Return the distance of a node's centre to the wall, mm.
    #[must_use]
    pub fn wall_mm(&self, node: u32) -> f64 {
        f64::from(self.wall_mm[node as usize])
    }

    /// Return true if the straight line between two points (voxel coordinates) stays in the lumen.
    ///
    /// The line is tested every half voxel.
    #[must_use]
    pub fn sees(&self, from_ijk: [f64; 3], to_ijk: [f64; 3]) -> bool {
        let longest = (0..3)
            .map(|a| (to_ijk[a] - from_ijk[a]).abs())
            .fold(0.0, f64::max);
        let num_steps = (longest * 2.0).ceil().max(1.0);
        (0..=num_steps as usize).all(|s| {
            let share = s as f64 / num_steps;
            self.holds(std::array::from_fn(|a| {
                from_ijk[a] + share * (to_ijk[a] - from_ijk[a])
            }))
        })
    }

    /// Return true if the voxel that contains this point (voxel coordinates) is lumen.
    #[must_use]
    pub fn holds(&self, ijk: [f64; 3]) -> bool {
        self.lumen.holds(ijk.map(|v| (v + 0.5).floor() as isize))
    }

    /// Return a point (voxel coordinates) inside the lumen: the given point, or the nearest one that this method finds.
    ///
    /// A given point outside the lumen is replaced by the nearest position inside on the line to the centre of the
    /// nearest lumen voxel. (A straight line between two points inside the lumen can pass the corner of a voxel
    /// outside; this function corrects points on such lines.)
    #[must_use]
    pub fn pulled_inside(&self, grid: &Grid, ijk: [f64; 3]) -> [f64; 3] {
        let reach_mm = length(grid.spacing_mm());
        if self.holds(ijk) {
            return ijk;
        }
        let Some((node, _)) = self.nearest_node(grid, ijk, 2.0 * reach_mm) else {
            return ijk;
        };
        let centre = self.voxel(node).map(|v| v as f64);
        (1..=8)
            .map(|step| {
                let share = f64::from(step) / 8.0;
                std::array::from_fn(|a| ijk[a] + share * (centre[a] - ijk[a]))
            })
            .find(|p| self.holds(*p))
            .unwrap_or(centre)
    }

    /// Find the lumen voxel nearest to a point (voxel coordinates); return its node and the distance in mm.
    ///
    /// The result is `None` if no lumen voxel is within `reach_mm`. Of equally near voxels, the first in array order is
    /// returned.
    #[must_use]
    pub fn nearest_node(&self, grid: &Grid, ijk: [f64; 3], reach_mm: f64) -> Option<(u32, f64)> {
        let spacing = grid.spacing_mm();
        let (mut low, mut high) = ([0isize; 3], [0isize; 3]);
        for axis in 0..3 {
            let reach = reach_mm / spacing[axis] + 1.0;
            let first = self.lumen.voxel_box().first_ijk[axis] as f64;
            let last = first + self.lumen.voxel_box().shape_ijk[axis] as f64 - 1.0;
            low[axis] = (ijk[axis] - reach).floor().max(first) as isize;
            high[axis] = (ijk[axis] + reach).ceil().min(last) as isize;
        }
        if (0..3).any(|axis| low[axis] > high[axis]) {
            return None;
        }
        let along = grid.lps_from_ijk().vector([1.0, 0.0, 0.0]);
        let mut best: Option<(u32, f64)> = None;
        for k in low[2]..=high[2] {
            for j in low[1]..=high[1] {
                // The distance from the point to the line of the row: a row farther away than the best voxel so far
                // contains no nearer voxel.
                let off = [0.0, j as f64 - ijk[1], k as f64 - ijk[2]];
                let off = grid.lps_from_ijk().vector(off);
                let beside = dot(off, off) - dot(off, along).powi(2) / dot(along, along);
                let most = best.map_or(reach_mm, |(_, distance)| distance);
                // The margin ensures that a row at exactly that distance is searched in spite of rounding.
                if beside > most * most * (1.0 + 1e-9) + 1e-9 {
                    continue;
                }
                for (i, node) in self.lumen.in_row(low[0]..=high[0], j, k) {
                    let at = [i as f64, j as f64, k as f64];
                    let distance = length(
                        grid.lps_from_ijk()
                            .vector(std::array::from_fn(|a| at[a] - ijk[a])),
                    );
                    if distance <= reach_mm && best.is_none_or(|(_, d)| distance < d) {
                        best = Some((node, distance));
                    }
                }
            }
        }
        best
    }
}

/// Return the smallest box round voxels with one voxel of margin, clipped to the volume.
fn box_around(voxels: &[[u16; 3]], shape: [usize; 3]) -> VoxelBox {
    let (mut low, mut high) = ([usize::MAX; 3], [0usize; 3]);
    for voxel in voxels {
        for axis in 0..3 {
            low[axis] = low[axis].min(usize::from(voxel[axis]));
            high[axis] = high[axis].max(usize::from(voxel[axis]));
        }
    }
    let first_ijk: [usize; 3] = std::array::from_fn(|a| low[a].saturating_sub(1));
    VoxelBox {
        first_ijk,
        shape_ijk: std::array::from_fn(|a| (high[a] + 2).min(shape[a]) - first_ijk[a]),
    }
}

fn line_is_inside(
    values: VolumeView<'_, i16>,
    from: [isize; 3],
    to: [isize; 3],
    levels: WallLevels,
) -> bool {
    let ends = f32::from(values.at_clamped(from).max(values.at_clamped(to)));
    let limit = (ends + levels.rise)
        .max(levels.core)
        .min(levels.wall.max(ends));
    [0.25, 0.5, 0.75].into_iter().all(|share| {
        let at = std::array::from_fn(|a| from[a] as f64 + share * (to[a] - from[a]) as f64);
        interpolated(values, at) <= limit
    })
}

/// Return the trilinear value of a volume at a point (voxel coordinates); outside, the nearest edge value is used.
#[must_use]
pub fn interpolated(values: VolumeView<'_, i16>, ijk: [f64; 3]) -> f32 {
    let base = ijk.map(|v| v.floor() as isize);
    let share: [f32; 3] = std::array::from_fn(|a| (ijk[a] - base[a] as f64) as f32);
    let mut sum = 0.0;
    for corner in 0..8isize {
        let offset = [corner & 1, corner >> 1 & 1, corner >> 2];
        let weight: f32 = (0..3)
            .map(|a| {
                if offset[a] == 1 {
                    share[a]
                } else {
                    1.0 - share[a]
                }
            })
            .product();
        if weight > 0.0 {
            let at = std::array::from_fn(|a| base[a] + offset[a]);
            sum += weight * f32::from(values.at_clamped(at));
        }
    }
    sum
}

impl Graph for LumenGraph {
    fn num_nodes(&self) -> usize {
        self.voxels.len()
    }

    fn for_each_edge(&self, node: u32, mut visit: impl FnMut(u32, f64)) {
        let from = self.voxels[node as usize].map(|v| v as isize);
        let mask = self.edges[node as usize];
        // The neighbours are in nine rows of three voxels; one count of lumen voxels gives the node numbers of a whole
        // row.
        for row in 0..9usize {
            // The middle row does not contain the voxel itself, so it has two steps.
            let first_step = if row < 5 { 3 * row } else { 3 * row - 1 };
            let is_middle = row == 4;
            if mask >> first_step & if is_middle { 0b11 } else { 0b111 } == 0 {
                continue;
            }
            let to = [
                from[0],
                from[1] + (row % 3) as isize - 1,
                from[2] + (row / 3) as isize - 1,
            ];
            let Some((mut neighbour, are_members)) = self.lumen.three(to) else {
                continue;
            };
            let mut step = first_step;
            for (x, is_member) in are_members.into_iter().enumerate() {
                if !(is_middle && x == 1) {
                    if mask >> step & 1 == 1 {
                        visit(neighbour, self.steps[step].length_mm);
                    }
                    step += 1;
                }
                neighbour += u32::from(is_member);
            }
        }
    }

    fn edge_length_range_mm(&self) -> (f64, f64) {
        let lengths = self.steps.map(|s| s.length_mm);
        (
            lengths.into_iter().fold(f64::INFINITY, f64::min),
            lengths.into_iter().fold(0.0, f64::max),
        )
    }
}

/// Cost `lumen`: weight per mm = (10 mm / distance to the wall)^3, with the distance limited to 0.4 to 10 mm.
///
/// A power of the distance has no scale, so a path stays in the middle of a trachea and of a small bronchus alike. The
/// exponent is 3, because with 2 a path to one main bronchus leaves the middle of the trachea 3 cm above the carina.
#[derive(Debug, Clone, Copy)]
pub struct LumenCost<'a>(pub &'a LumenGraph);

/// Upper limit of the distance to the wall, larger than any trachea's radius, mm.
const WIDEST_MM: f64 = 10.0;
/// Lower limit of the distance to the wall, about half a voxel, mm.
const NARROWEST_MM: f64 = 0.4;

impl LumenCost<'_> {
    fn of_node(self, node: u32) -> f64 {
        let distance = self.0.wall_mm(node).clamp(NARROWEST_MM, WIDEST_MM);
        (WIDEST_MM / distance).powi(3)
    }
}

impl Cost for LumenCost<'_> {
    fn weight(&self, u: u32, v: u32) -> f64 {
        0.5 * (self.of_node(u) + self.of_node(v))
    }

    fn weight_range(&self) -> (f64, f64) {
        (1.0, (WIDEST_MM / NARROWEST_MM).powi(3))
    }
}
