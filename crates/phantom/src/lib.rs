//! Volumes with exact ground truth: small analytic ones for tests and benchmarks, and a chest CT.
//!
//! The chest is built in three steps. [`airways`](AirwayTree) grows the tree: named branches down to the segments from
//! a table, subsegments by rule. Then the tree, its vessels and the body are converted to signed distances. Finally a
//! voxel's value is computed from the distances at its own centre and at points within it (partial volume). The ground
//! truth is the tree itself, never a measurement in the picture.
//!
//! All random choices depend on the seed and the position, never on the order of work: one seed gives the same chest on
//! any number of threads.

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
mod variants;
mod vessels;
mod voxels;

pub use airway_tube::{TubeKind, TubeTruth};
pub use airways::{AirwayTree, Branch};
pub use analytic::{shells, tube, y_junction};
pub use chest::{Chest, ChestOptions, Stenosis};
pub use error::PhantomError;
pub use lobectomy::Lobe;
pub use nodule::Nodule;
pub use variants::{PUBLISHED, VARIANT_NAMES, Variants};
