//! State of a tracker in a whole volume: [`FieldTracker`], which grows by a queue and by tiles.

use carina_grid::InstructionSet;

use crate::buckets::Buckets;
use crate::field::{Quanta, StepCost};
use crate::field_layout::Layout;
use crate::field_sweep::Sweep;

/// Largest cost in quanta that a voxel's entry can represent: 31 bits.
pub(crate) const MOST_QUANTA: i32 = i32::MAX;

/// Voxel that was first reached from its neighbour.
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
    /// The value is 1 if a path may still change the voxel: the first path for costs by the entered voxel, a cheaper
    /// one for costs by both ends.
    pub(crate) open: Vec<u8>,
    /// For costs by both ends: `MOST_QUANTA` minus the least cost so far.
    ///
    /// The value is 0 for a voxel that no path has reached, so zeroed memory needs no initialisation.
    pub(crate) left: Vec<i32>,
    pub(crate) queue: Buckets,
    /// Buffer of `touch`.
    pub(crate) touched: Vec<Touch>,
    /// Nodes first reached from the front bucket; they are closed when that bucket is empty.
    pub(crate) closing: Vec<u32>,
    pub(crate) num_settled: usize,
    /// Whether no node is open any more.
    pub(crate) done: bool,
    /// State of the sweeps, after a request for all voxels: open voxels are then in its tiles, not in the queue.
    pub(crate) sweep: Option<Sweep>,
    pub(crate) simd: InstructionSet,
}
