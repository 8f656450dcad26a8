//! Bricks: cubes of 5 x 5 x 5 voxels whose values and gradients are computed once and shared by all pictures of a
//! volume.
//!
//! A brick has 4 x 4 x 4 cells. The first thread that needs a brick fills it, and all threads read it. The picture does
//! not depend on which bricks exist.

mod samples;
#[cfg(test)]
mod samples_tests;
mod slopes;
#[cfg(test)]
mod slopes_tests;
mod store;

use crate::shared_constants::SharedConstant;
pub use samples::SampleBricks;
pub use slopes::NormalBricks;
pub(crate) use slopes::{AXIS_AT, AXIS_WEIGHT, CORNER_AT, CORNER_WEIGHT};

/// Return names and values of the constants of the brick cache that the GPU's shaders need too.
pub(crate) fn shared() -> Vec<SharedConstant> {
    [slopes::shared(), store::shared()].concat()
}

pub(crate) use store::{CELLS, Fill, MAX_BRICKS, PER_BRICK, STRIDE};
