//! The anatomy of airways, from a chest CT (paper 6; docs/algorithms.md): what the least-cost paths are found for.
//!
//! - [`find`]: where to begin (`trachea`), the lumen with a leak guard (`flood`), what the flood could not follow, by its shape
//!   (`extension`), and whether the CT shows a wall round a way at all (`evidence`).
//! - [`tree`]: branches read off the tree of least-cost paths, centred and smoothed, how wide they are, what edits ask.
//! - [`section`]: cross-sections, with the scanner's blur taken out of their edges.
//! - [`mesh`] and [`outline`]: the lumen's surface, and its outline in a slice.
//!
//! Graphs, costs and trackers are `carina-leastcost`.

pub mod find;
pub mod mesh;
pub mod outline;
pub mod section;
pub mod tree;

#[cfg(test)]
mod airway_tests;
#[cfg(test)]
mod outline_tests;
