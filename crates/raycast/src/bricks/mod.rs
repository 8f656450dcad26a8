//! What pictures of one volume share: numbers at its voxels, worked out where a ray first comes and kept in bricks.
//!
//! A brick holds 4 x 4 x 4 cells. It is filled by the thread that first asks for it and read by all; which bricks exist
//! never shows in a picture.

mod samples;
#[cfg(test)]
mod samples_tests;
mod slopes;
#[cfg(test)]
mod slopes_tests;
mod store;

pub use samples::SampleBricks;
pub use slopes::NormalBricks;
pub(crate) use slopes::{AXIS_AT, AXIS_WEIGHT, CORNER_AT, CORNER_WEIGHT};
pub(crate) use store::{CELLS, Fill, MOST_BRICKS, PER_BRICK, STRIDE};
