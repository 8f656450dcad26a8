//! Airway lumen, voxel graph and the resumable least-cost path tracker (paper 6; docs/algorithms.md).
//!
//! `trachea` finds where to begin, `flood` grows the lumen with a leak guard, `extension` follows what the flood could not by
//! its shape (`tubeness`; `extension_reach` says what can be reached, `extension_ways` what is kept of it and
//! `extension_verdict` what looks like an airway), `lumen` turns it into a graph with the cost
//! that keeps to the middle, `tracker` grows the tree of least-cost paths from one root and resumes it for every new
//! target, `tree` reads branches off it. `box_graph`, `paper_cost` and `isoregion_graph` are the graph and the cost as the
//! paper prints them, for the same tracker; `graph_tracker` joins every cost with every graph. `field_tracker` does the
//! same as `tracker` in a whole volume of weights, without a graph in memory; `field_aim` finds one path there,
//! `field_sweep` every voxel's.

pub mod box_graph;
pub mod branch;
mod buckets;
pub mod caliber;
mod centre;
pub mod cross_section;
pub mod deblur;
pub mod dijkstra;
pub mod distance;
mod error;
pub mod evidence;
pub mod extension;
mod extension_levels;
mod extension_reach;
mod extension_verdict;
mod extension_ways;
pub mod field;
pub mod field_aim;
mod field_front;
mod field_lanes;
mod field_layout;
mod field_state;
mod field_sweep;
mod field_tile;
pub mod field_tracker;
pub mod flood;
pub mod graph;
pub mod graph_tracker;
pub mod isoregion_graph;
pub mod lumen;
pub mod lumen_edit;
mod lungs;
pub mod mesh;
pub mod outline;
pub mod paper_cost;
pub mod profile;
pub mod rays;
pub mod smooth;
mod spots;
pub mod trachea;
pub mod tracker;
pub mod tree;
pub mod tree_edit;
mod tube;
pub mod tubeness;
mod voxel_set;
mod wall_sites;

pub use error::{TrackError, Unwatched, Watch};

#[cfg(test)]
mod caliber_tests;
#[cfg(test)]
mod centre_tests;
#[cfg(test)]
mod extension_tests;
#[cfg(test)]
mod field_tests;
#[cfg(test)]
mod isoregion_graph_tests;
#[cfg(test)]
mod lumen_edit_tests;
#[cfg(test)]
mod lumen_tests;
#[cfg(test)]
mod outline_tests;
#[cfg(test)]
mod paper_cost_tests;
#[cfg(test)]
mod section_tests;
#[cfg(test)]
mod tracker_tests;
