//! Python binding of the distance transform of a mask of cubic voxels.
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use carina_leastcost::cubic_distance;
use numpy::{PyArray3, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::{arrays, pool};

/// Return the distance in mm from each inside voxel to the nearest outside voxel, less half a voxel.
///
/// The result is float32 (nz, ny, nx), 0 outside and infinite beyond `reach_mm`.
#[pyfunction]
#[pyo3(signature = (inside_zyx, *, step_mm, reach_mm))]
fn ball_distances<'py>(
    py: Python<'py>,
    inside_zyx: PyReadonlyArray3<'py, bool>,
    step_mm: f64,
    reach_mm: f64,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let shape: [usize; 3] = std::array::from_fn(|axis| inside_zyx.shape()[axis]);
    let inside = arrays::values("inside_zyx", &inside_zyx)?;
    let [nz, ny, nx] = shape;
    let found = pool::detached(py, || {
        cubic_distance::ball_distances_mm(inside, [nx, ny, nz], step_mm, reach_mm)
    });
    arrays::volume_array(py, found, shape)
}

/// Add the function of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(ball_distances, module)?)
}
