//! State of the tracker of a whole volume, [`FieldTracker`], which settles voxels by a queue or by tiles.

use carina_grid::InstructionSet;

use crate::buckets::Buckets;
use crate::field::{Quanta, StepCost};
use crate::field_layout::Layout;
use crate::field_sweep::Sweep;

/// Maximum cost in quanta that the entry of a voxel in `left` can represent: 31 bits.
pub(crate) const MAX_QUANTA: i32 = i32::MAX;

/// Step by which a voxel was first reached: the voxel's node, the index of its weight, and the cell of the step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Touch {
    pub(crate) node: u32,
    pub(crate) value_at: u32,
    pub(crate) cell: u8,
}

/// Tree of least-cost paths in a [`crate::field::VoxelField`] that grows on demand.
#[derive(Debug)]
pub struct FieldTracker<C: StepCost> {
    pub(crate) quanta: Quanta<C>,
    pub(crate) layout: Layout,
    pub(crate) root: u32,
    /// Cell of the step that led to each voxel, plus 1; 0 for a voxel that no path has reached.
    pub(crate) step_here: Vec<u8>,
    /// One bit for each voxel and for a rim round the box.
    ///
    /// The value is 1 if a path may still change the voxel. With costs by the entered voxel, only the first path to a
    /// voxel changes it; with costs by the two voxels of a step, each cheaper path does.
    pub(crate) open: Vec<u8>,
    /// For costs by the two voxels of a step: `MAX_QUANTA` minus the least cost so far of each voxel.
    ///
    /// The value is 0 for a voxel that no path has reached, so zeroed memory needs no initialisation.
    pub(crate) left: Vec<i32>,
    pub(crate) queue: Buckets,
    /// Reused buffer of [`FieldTracker::touch`] for the nodes that it changed.
    pub(crate) touched: Vec<Touch>,
    /// Nodes first reached from the first bucket; they are marked as final when that bucket is empty.
    pub(crate) closing: Vec<u32>,
    pub(crate) num_settled: usize,
    /// Whether every node that a path can reach is settled.
    pub(crate) done: bool,
    /// State of the sweeps after a call of `solve_all`; open voxels are then in the tiles of the sweep, not in the
    /// queue.
    pub(crate) sweep: Option<Sweep>,
    pub(crate) simd: InstructionSet,
}
