//! Airway lumen, voxel graph and the resumable least-cost path tracker (paper 6; DESIGN 4 "Path tracker", "Airways").
//!
//! `trachea` finds where to begin, `flood` grows the lumen with a leak guard, `lumen` turns it into a graph with the cost
//! that keeps to the middle, `tracker` grows the tree of least-cost paths from one root and resumes it for every new
//! target, `tree` reads branches off it.

pub mod cross_section;
pub mod deblur;
pub mod dijkstra;
pub mod distance;
mod error;
pub mod flood;
pub mod graph;
pub mod lumen;
mod lungs;
pub mod profile;
pub mod smooth;
mod spots;
pub mod trachea;
pub mod tracker;
pub mod tree;

pub use error::{TrackError, Unwatched, Watch};

#[cfg(test)]
mod lumen_tests;
#[cfg(test)]
mod section_tests;
#[cfg(test)]
mod tracker_tests;
