//! Least-cost path to one target in a volume of weights by A* (Hart, Nilsson, Raphael, IEEE Trans. SSC 4 (1968) 100).
//!
//! Voxels are settled in the order of their least cost plus a lower bound of the remaining cost. The bound is an
//! integer number of quanta and consistent (no step lowers it by more than the step costs), so the cost of the path
//! equals that of Dijkstra's algorithm, to the quantum; of several paths with that cost, another may be returned. The
//! search stores nothing for a second target; use [`crate::field_tracker`] for several targets.

use crate::buckets::Buckets;
use crate::field::{HERE, Quanta, StepCost, VoxelField, offset};
use crate::field_layout::Layout;
use crate::field_tracker::open_root;
use crate::{TrackError, Watch};

/// Number of nodes that are settled between two checks for cancellation.
const NODES_PER_CHECK: usize = 1 << 14;

/// Number of low bits of a voxel's state that store the cell of the step that led to the voxel, plus 1.
const CELL_BITS: u32 = 5;
/// Bit of a voxel's state that is set if the voxel is settled; it follows the bits of the cell.
const SETTLED: u64 = 1 << CELL_BITS;
/// Position of the first bit of a voxel's least cost so far, in the voxel's state.
///
/// The state is 0 for a voxel that no path has reached, so zeroed memory needs no initialisation.
const COST_SHIFT: u32 = CELL_BITS + 1;

/// Least-cost path to one target, and the number of nodes that the search examined.
#[derive(Debug, Clone, PartialEq)]
pub struct AimedPath {
    /// Nodes of the path, from the root to the target.
    pub nodes: Vec<u32>,
    /// Cost of the path in quanta of the field.
    pub cost_quanta: u64,
    /// Cost of the path, accurate within 0.5 %; exact if the quantum is 1.
    pub cost: f64,
    /// Number of nodes whose edges were examined.
    pub num_settled: usize,
}

/// Find the least-cost path from voxel `root_ijk` of the volume to a node; return `None` if there is no path.
///
/// The search allocates eight bytes for each voxel of the region; the operating system provides only the memory pages
/// that paths reach.
///
/// # Errors
///
/// Returns an error if the root or the target is not valid, if the weights are not, or if `watch` stops the search.
pub fn least_path<C: StepCost>(
    field: &VoxelField<'_>,
    root_ijk: [usize; 3],
    target: u32,
    watch: &impl Watch,
) -> Result<Option<AimedPath>, TrackError> {
    let root = open_root(field, root_ijk)?;
    if target as usize >= field.num_nodes() {
        return Err(TrackError::Argument {
            what: "target",
            expected: format!("a node below {}", field.num_nodes()),
            found: target.to_string(),
        });
    }
    let quanta = Quanta::<C>::choose(field)?;
    if !field.is_open(target) {
        return Ok(None);
    }
    let layout = Layout::new(field);
    let aim = Aim::new(field, &quanta, layout.ijk(target));
    let from_root = aim.bound(layout.ijk(root));
    let mut reached = vec![0u64; field.num_nodes()];
    reached[root as usize] = HERE as u64 + 1;
    // The queue must accept costs that exceed the lowest one by two of the most expensive steps: such a step adds its
    // cost, and may increase the bound by the same amount. A bucket contains one cost only, because steps straight
    // towards the target do not change the sum of cost and bound.
    let mut queue = Buckets::new(2 * quanta.dearest as u64, 0);
    queue.push(0, root);
    let mut num_settled = 0;
    while queue.advance() {
        // The newest entry comes first, so of many paths with equal cost one is followed to its end.
        while let Some(node) = queue.pop() {
            let state = reached[node as usize];
            if state & SETTLED != 0 {
                continue;
            }
            reached[node as usize] = state | SETTLED;
            num_settled += 1;
            let cost = state >> COST_SHIFT;
            if node == target {
                return Ok(Some(AimedPath {
                    nodes: path_to(&layout, &reached, target),
                    cost_quanta: cost,
                    cost: cost as f64 * quanta.unit,
                    num_settled,
                }));
            }
            if num_settled % NODES_PER_CHECK == 0 {
                watch.report_fraction(num_settled as f64 / quanta.num_open as f64)?;
            }
            let ijk = layout.ijk(node);
            let value_at = layout.value_at(ijk);
            let from = field.values()[value_at];
            let inside = (0..3).all(|a| ijk[a] > 0 && ijk[a] + 1 < layout.shape[a]);
            for cell in (0..27).filter(|cell| *cell != HERE) {
                let step = offset(cell);
                let to: [usize; 3] = std::array::from_fn(|a| ijk[a].wrapping_add_signed(step[a]));
                if !inside && (0..3).any(|a| to[a] >= layout.shape[a]) {
                    continue;
                }
                let neighbour = (node as usize).wrapping_add_signed(layout.node_step[cell]);
                let old = reached[neighbour];
                if old & SETTLED != 0 {
                    continue;
                }
                let place = value_at.wrapping_add_signed(layout.value_step[cell]);
                let into = field.values()[place];
                if !(into < f32::INFINITY && field.is_in_mask(place)) {
                    continue;
                }
                let candidate = cost + u64::from(quanta.of_step(from, into, cell));
                if old == 0 || candidate < old >> COST_SHIFT {
                    reached[neighbour] = candidate << COST_SHIFT | (cell as u64 + 1);
                    queue.push(candidate + aim.bound(to) - from_root, neighbour as u32);
                }
            }
        }
    }
    Ok(None)
}

fn path_to(layout: &Layout, reached: &[u64], target: u32) -> Vec<u32> {
    let mut path = vec![target];
    let mut node = target as usize;
    loop {
        let cell = (reached[node] & (SETTLED - 1)) as usize - 1;
        if cell == HERE {
            path.reverse();
            return path;
        }
        node = node.wrapping_add_signed(-layout.node_step[cell]);
        path.push(node as u32);
    }
}

/// Lower bound of the cost from any voxel to the target.
struct Aim<'a> {
    field: &'a VoxelField<'a>,
    target: [usize; 3],
    /// For costs by the entered voxel ([`StepCost::BY_VOXEL`]): cost in quanta of the cheapest step.
    ///
    /// For costs by the two voxels of a step: smallest cost in quanta of any step, divided by its length in mm.
    quanta_per: f64,
    by_voxel: bool,
}

impl<'a> Aim<'a> {
    fn new<C: StepCost>(field: &'a VoxelField<'a>, quanta: &Quanta<C>, target: [usize; 3]) -> Self {
        let quanta_per = if C::BY_VOXEL {
            f64::from(quanta.cheapest)
        } else {
            let steps = (0..27).filter(|cell| *cell != HERE).map(|cell| {
                let quanta = quanta.of_step(quanta.least, quanta.least, cell);
                f64::from(quanta) / field.length_mm(offset(cell).map(|step| step as f64))
            });
            // The bound is reduced slightly, so that the rounding of a length of 2^31 quanta never makes it too large.
            steps.fold(f64::INFINITY, f64::min) * (1.0 - 1e-6)
        };
        Self {
            field,
            target,
            quanta_per,
            by_voxel: C::BY_VOXEL,
        }
    }

    /// Return a lower bound of the cost from a voxel to the target, in quanta.
    ///
    /// For costs by the entered voxel, the bound counts the least number of steps, which is the largest offset along an
    /// axis; for costs by the two voxels of a step, it uses the length of the straight line. Rounded down, the bound
    /// stays consistent, because steps cost whole quanta.
    #[inline]
    fn bound(&self, ijk: [usize; 3]) -> u64 {
        if self.by_voxel {
            let most = (0..3).map(|a| ijk[a].abs_diff(self.target[a])).max();
            return self.quanta_per as u64 * most.unwrap_or(0) as u64;
        }
        let way = std::array::from_fn(|a| ijk[a] as f64 - self.target[a] as f64);
        (self.quanta_per * self.field.length_mm(way)) as u64
    }
}
