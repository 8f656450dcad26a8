//! Interface between trackers and graphs: nodes, edges with a length in mm, and a weight per mm (paper 6, 6.1, 6.2).
//!
//! The tracker uses only these two traits, so it works without change for the pruned `IsoRegion` graph (6.1), for the
//! printed cost (6.2) and for the voxel graph of the lumen.

use crate::TrackError;

/// Node number that marks the absence of a node.
pub const NO_NODE: u32 = u32::MAX;

/// Undirected graph whose edges have a length in mm.
pub trait Graph {
    /// Return the number of nodes, which are `0..num_nodes`.
    fn num_nodes(&self) -> usize;

    /// Call `visit(neighbour, length_mm)` for every edge of `node`, always in the same order.
    fn for_each_edge(&self, node: u32, visit: impl FnMut(u32, f64));

    /// Return a lower and an upper bound of the lengths of all edges, mm.
    fn edge_length_range_mm(&self) -> (f64, f64);
}

/// Weight of the edges of a graph per mm; the cost of an edge is its length times its weight.
pub trait Cost {
    /// Return the weight of the edge between two neighbours; it is symmetric and inside [`Cost::weight_range`].
    fn weight(&self, u: u32, v: u32) -> f64;

    /// Return the smallest and the largest weight of all edges, both above 0.
    fn weight_range(&self) -> (f64, f64);
}

/// Integer unit of the path costs of one search.
///
/// The rounding error of an edge is at most half a quantum. The cheapest possible edge is 100 quanta, so the cost of an
/// edge, and with it the cost of a path, is accurate within 0.5 %.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quantum {
    /// Cost of one quantum, in weight times mm.
    pub cost: f64,
    /// Cost in quanta of the most expensive possible edge, which is the reach of the bucket queue.
    pub dearest_edge: u32,
    /// Number of quanta of a cost of 1, so that an edge needs a multiplication instead of a slower division.
    per_cost: f64,
}

/// Cost of the cheapest edge in quanta; half a quantum of rounding is 0.5 % of it.
const CHEAPEST_EDGE_QUANTA: f64 = 100.0;
/// Maximum cost of an edge in quanta, and so the largest number of buckets of the queue (4 bytes each).
const MAX_EDGE_QUANTA: f64 = 16_777_216.0;

impl Quantum {
    /// Choose the quantum for a graph and a cost.
    ///
    /// # Errors
    ///
    /// Returns an error if the range of the costs is too wide.
    pub fn choose(graph: &impl Graph, cost: &impl Cost) -> Result<Self, TrackError> {
        let (shortest, longest) = graph.edge_length_range_mm();
        let (least, greatest) = cost.weight_range();
        let quantum = shortest * least / CHEAPEST_EDGE_QUANTA;
        let dearest = (longest * greatest / quantum).round();
        if !(quantum > 0.0 && (1.0..MAX_EDGE_QUANTA).contains(&dearest)) {
            return Err(TrackError::CostRange {
                ratio: longest * greatest / (shortest * least),
            });
        }
        Ok(Self {
            cost: quantum,
            dearest_edge: dearest as u32,
            per_cost: 1.0 / quantum,
        })
    }

    /// Return the cost of an edge in quanta, at least 1.
    #[must_use]
    pub fn edge(&self, cost: &impl Cost, u: u32, v: u32, length_mm: f64) -> u32 {
        // Adding 0.5 rounds a positive number to the nearest integer; `round` is a function call if the target has no
        // instruction for it.
        let quanta = length_mm * cost.weight(u, v) * self.per_cost + 0.5;
        (quanta as u32).clamp(1, self.dearest_edge)
    }
}
