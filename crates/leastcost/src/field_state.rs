//! What a tracker in a whole volume keeps: [`FieldTracker`], which grows by queue and by tiles.

use carina_grid::InstructionSet;

use crate::buckets::Buckets;
use crate::field::{Quanta, StepCost};
use crate::field_layout::Layout;
use crate::field_sweep::Sweep;

/// Greatest cost in quanta that is kept beside a voxel: 31 bits.
pub(crate) const MOST_QUANTA: i32 = i32::MAX;

/// A voxel that was touched first from its neighbour.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Touch {
    pub(crate) node: u32,
    pub(crate) value_at: u32,
    pub(crate) cell: u8,
}

/// A least-cost tree in a [`crate::field::VoxelField`] that grows as far as it is asked to.
#[derive(Debug)]
pub struct FieldTracker<C: StepCost> {
    pub(crate) quanta: Quanta<C>,
    pub(crate) layout: Layout,
    pub(crate) root: u32,
    /// Cell of the step that led here, plus 1; 0 where no path has come.
    pub(crate) step_here: Vec<u8>,
    /// One bit for each voxel and for a rim round the box, 1 where a path may still come: for the first time where the cost is
    /// by voxel, a cheaper one where it is by both ends.
    pub(crate) open: Vec<u8>,
    /// By both ends: what is left of `MOST_QUANTA` after the least cost so far; 0 where no path has come, so that fresh
    /// memory will do.
    pub(crate) left: Vec<i32>,
    pub(crate) queue: Buckets,
    /// Scratch of the front (`touch`).
    pub(crate) touched: Vec<Touch>,
    /// Nodes first touched from the front bucket: closed when it is done with.
    pub(crate) closing: Vec<u32>,
    pub(crate) num_settled: usize,
    /// Nothing is open any more.
    pub(crate) done: bool,
    /// Once everything was asked for: what is open is in its tiles, no longer in the queue.
    pub(crate) sweep: Option<Sweep>,
    pub(crate) simd: InstructionSet,
}
