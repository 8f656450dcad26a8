//! Anatomy of airways from a chest CT (paper 6; docs/algorithms.md): from the trachea to branches and cross-sections.
//!
//! - [`find`]: the start (`trachea`), the lumen with a limit on leaks (`flood`), airways beyond the end of the flood,
//!   recognised by their shape (`extension`), and the evidence in the CT for a wall round a path (`evidence`).
//! - [`tree`]: branches derived from the tree of least-cost paths, centred and smoothed, their widths, and queries for
//!   edits.
//! - [`section`]: cross-sections, with the scanner's blur removed from their edges.
//! - [`mesh`] and [`outline`]: the lumen's surface, and its outline in a slice.
//!
//! Graphs, costs and trackers are in `carina-leastcost`.

pub mod find;
pub mod mesh;
pub mod outline;
pub mod section;
pub mod tree;

#[cfg(test)]
mod airway_tests;
#[cfg(test)]
mod outline_tests;
