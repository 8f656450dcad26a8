//! Volumes with exact truth: small analytic ones for tests and benches, and a chest CT.
//!
//! The chest is built in three steps. [`airways`](AirwayTree) grows the tree: named branches down to the segments from a
//! table, subsegments by rule. The tree, its vessels and the body are then signed distances, and a voxel's value follows
//! from those at its own place and at points within it (partial volume). The truth is the tree itself, never something
//! measured in the picture.
//!
//! All random choices come from the seed and the place, never from the order of work: one seed, one case, on any number
//! of threads.

mod airway_tube;
mod airways;
mod analytic;
mod anatomy;
mod body;
mod chest;
mod error;
mod lobectomy;
mod neck;
mod nodule;
mod noise;
mod random;
mod shapes;
mod skeleton;
mod vessels;
mod voxels;

pub use airway_tube::{TubeKind, TubeTruth};
pub use airways::{AirwayTree, Branch};
pub use analytic::{shells, tube, y_junction};
pub use chest::{Chest, ChestOptions, Stenosis};
pub use error::PhantomError;
pub use lobectomy::Lobe;
pub use nodule::Nodule;
