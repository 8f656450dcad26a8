//! Least-cost paths through voxels (paper 6): graphs, edge costs, and trackers that can be resumed for every new
//! target.
//!
//! `lumen` turns an airway's lumen into a graph with a cost that favours its middle, `lumen_edit` updates that graph
//! after an edit, and `tracker` grows the tree of least-cost paths from one root. `box_graph`, `paper_cost` and
//! `isoregion_graph` are the graph and the cost as printed in the paper, for the same tracker; `graph_tracker` combines
//! every cost with every graph. `field_tracker` grows the same kind of tree in a whole volume of weights, without a
//! graph in memory; `field_a_star` finds one path in such a volume, `field_sweep` the least costs of all its voxels.
//! `cheapest_way` finds one path in a small box of weights. `ordered_cost` is the key of a queue of paths. `distance`
//! and `cubic_distance` are exact distance transforms.
//!
//! This crate contains no anatomy; `carina-airpath` is based on it.

pub mod box_graph;
mod buckets;
pub mod cheapest_way;
pub mod cubic_distance;
pub mod dijkstra;
pub mod distance;
mod error;
pub mod fast_marching;
pub mod field;
pub mod field_a_star;
mod field_front;
mod field_lanes;
mod field_layout;
mod field_state;
mod field_sweep;
mod field_tile;
pub mod field_tracker;
pub mod graph;
pub mod graph_tracker;
pub mod isoregion_graph;
pub mod lumen;
pub mod lumen_edit;
pub mod mask_components;
pub mod ordered_cost;
pub mod paper_cost;
pub mod tracker;
mod voxel_set;
mod wall_sites;

pub use error::{TrackError, Unwatched, Watch};

#[cfg(test)]
mod field_tests;
#[cfg(test)]
mod isoregion_graph_tests;
#[cfg(test)]
mod lumen_edit_tests;
#[cfg(test)]
mod paper_cost_tests;
#[cfg(test)]
mod tracker_tests;
