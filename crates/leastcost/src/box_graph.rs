//! Graph of all voxels of a box: every voxel is a node with edges to its 26 neighbours (paper 6).
//!
//! The edges are computed when they are needed and not stored.

use std::ops::RangeInclusive;

use carina_grid::{Grid, length};

use crate::TrackError;
use crate::distance::VoxelBox;
use crate::graph::{Graph, NO_NODE};

/// Graph whose nodes are voxels of a box of the volume.
pub trait VoxelGraph: Graph {
    /// Return the box that contains all nodes.
    fn voxel_box(&self) -> VoxelBox;

    /// Return the node of a voxel of the volume; `None` if the voxel is not a node.
    fn node_of_voxel(&self, ijk: [isize; 3]) -> Option<u32>;

    /// Return the voxel of the volume that a node represents.
    fn voxel_of_node(&self, node: u32) -> [usize; 3];

    /// Call `visit(i, node)` for the nodes of a row of voxels along i, whose j and k are in the box of the graph.
    fn for_each_node_in_row(
        &self,
        i: RangeInclusive<isize>,
        jk: [isize; 2],
        mut visit: impl FnMut(isize, u32),
    ) {
        for i in i {
            if let Some(node) = self.node_of_voxel([i, jk[0], jk[1]]) {
                visit(i, node);
            }
        }
    }
}

/// Return the offsets of the 26 neighbours of a voxel in array order: offset `25 - s` is the opposite of offset `s`.
pub(crate) fn neighbour_offsets() -> [[isize; 3]; 26] {
    std::array::from_fn(|s| {
        let cell = if s < 13 { s } else { s + 1 } as isize;
        [cell % 3 - 1, cell / 3 % 3 - 1, cell / 9 - 1]
    })
}

/// Graph of all voxels of a box of the volume; the number of a node is the index of its voxel in the box.
#[derive(Debug, Clone)]
pub struct BoxGraph {
    voxel_box: VoxelBox,
    offsets: [[isize; 3]; 26],
    lengths_mm: [f64; 26],
    /// Difference between the index of each of the 26 neighbours and the index of the node, in the box.
    strides: [isize; 26],
}

impl BoxGraph {
    /// Create the graph of a box.
    ///
    /// # Errors
    ///
    /// Returns an error if the box is not in the grid.
    pub fn new(grid: &Grid, voxel_box: VoxelBox) -> Result<Self, TrackError> {
        let shape = grid.shape_ijk();
        let [nx, ny, _] = voxel_box.shape_ijk;
        let fits = (0..3).all(|a| {
            voxel_box.shape_ijk[a] > 0
                && voxel_box.first_ijk[a] < shape[a]
                && voxel_box.shape_ijk[a] <= shape[a] - voxel_box.first_ijk[a]
        });
        if !fits || voxel_box.num_voxels() >= NO_NODE as usize {
            return Err(TrackError::Argument {
                what: "box",
                expected: format!("a box of voxels inside {shape:?}"),
                found: format!(
                    "{:?} voxels from {:?}",
                    voxel_box.shape_ijk, voxel_box.first_ijk
                ),
            });
        }
        let offsets = neighbour_offsets();
        Ok(Self {
            voxel_box,
            offsets,
            lengths_mm: offsets
                .map(|offset| length(grid.lps_from_ijk().vector(offset.map(|v| v as f64)))),
            strides: offsets.map(|[i, j, k]| (k * ny as isize + j) * nx as isize + i),
        })
    }
}

impl VoxelGraph for BoxGraph {
    fn voxel_box(&self) -> VoxelBox {
        self.voxel_box
    }

    fn node_of_voxel(&self, ijk: [isize; 3]) -> Option<u32> {
        self.voxel_box.index_of(ijk).map(|at| at as u32)
    }

    fn voxel_of_node(&self, node: u32) -> [usize; 3] {
        self.voxel_box.voxel(node as usize)
    }

    fn for_each_node_in_row(
        &self,
        i: RangeInclusive<isize>,
        jk: [isize; 2],
        mut visit: impl FnMut(isize, u32),
    ) {
        let first = self.voxel_box.first_ijk[0] as isize;
        let last = first + self.voxel_box.shape_ijk[0] as isize - 1;
        let (from, to) = ((*i.start()).max(first), (*i.end()).min(last));
        if from <= to
            && let Some(node) = self.node_of_voxel([from, jk[0], jk[1]])
        {
            for i in from..=to {
                visit(i, node + (i - from) as u32);
            }
        }
    }
}

impl Graph for BoxGraph {
    fn num_nodes(&self) -> usize {
        self.voxel_box.num_voxels()
    }

    fn for_each_edge(&self, node: u32, mut visit: impl FnMut(u32, f64)) {
        let [nx, ny, nz] = self.voxel_box.shape_ijk;
        let at = node as usize;
        let local = [at % nx, at / nx % ny, at / nx / ny];
        let inner = local[0] > 0
            && local[1] > 0
            && local[2] > 0
            && local[0] + 1 < nx
            && local[1] + 1 < ny
            && local[2] + 1 < nz;
        for s in 0..26 {
            let exists = inner
                || (0..3).all(|a| {
                    let to = local[a] as isize + self.offsets[s][a];
                    (0..self.voxel_box.shape_ijk[a] as isize).contains(&to)
                });
            if exists {
                visit((at as isize + self.strides[s]) as u32, self.lengths_mm[s]);
            }
        }
    }

    fn edge_length_range_mm(&self) -> (f64, f64) {
        let fold =
            |start, pick: fn(f64, f64) -> f64| self.lengths_mm.iter().copied().fold(start, pick);
        (fold(f64::INFINITY, f64::min), fold(0.0, f64::max))
    }
}
