//! Python bindings of operations on masks and boxes of cubic voxels: distances, parts, arrival times, resampling.
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use carina_grid::VolumeView;
use carina_leastcost::mask_components::Neighbours;
use carina_leastcost::{cubic_distance, fast_marching, mask_components};
use numpy::{PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::errors::IntoPy;
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

/// Return the squared distance in voxels from each inside voxel to the nearest outside voxel; infinite without one.
///
/// The result is float32 (nz, ny, nx), 0 outside.
#[pyfunction]
fn squared_distances<'py>(
    py: Python<'py>,
    inside_zyx: PyReadonlyArray3<'py, bool>,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let shape: [usize; 3] = std::array::from_fn(|axis| inside_zyx.shape()[axis]);
    let inside = arrays::values("inside_zyx", &inside_zyx)?;
    let [nz, ny, nx] = shape;
    let found = pool::detached(py, || {
        cubic_distance::squared_distances(inside, [nx, ny, nz], f32::INFINITY)
    });
    arrays::volume_array(py, found, shape)
}

/// Return the number, from 1, of the connected part of each voxel of a mask (0 outside), and the number of parts.
#[pyfunction]
#[pyo3(signature = (mask_zyx, *, corners))]
fn numbered_parts<'py>(
    py: Python<'py>,
    mask_zyx: PyReadonlyArray3<'py, bool>,
    corners: bool,
) -> PyResult<(Bound<'py, PyArray3<u32>>, usize)> {
    let shape: [usize; 3] = std::array::from_fn(|axis| mask_zyx.shape()[axis]);
    let mask = arrays::values("mask_zyx", &mask_zyx)?;
    let [nz, ny, nx] = shape;
    let neighbours = if corners {
        Neighbours::All
    } else {
        Neighbours::Faces
    };
    let (numbers, num) = pool::detached(py, || {
        mask_components::numbered_parts(mask, [nx, ny, nz], neighbours)
    });
    Ok((arrays::volume_array(py, numbers, shape)?, num))
}

/// Return the time at which a front from the voxels `starts_ijk` reaches each voxel; infinite where it does not.
#[pyfunction]
fn arrival_times<'py>(
    py: Python<'py>,
    speed_zyx: PyReadonlyArray3<'py, f32>,
    starts_ijk: Vec<[usize; 3]>,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let shape: [usize; 3] = std::array::from_fn(|axis| speed_zyx.shape()[axis]);
    let speed = arrays::values("speed_zyx", &speed_zyx)?;
    let [nz, ny, nx] = shape;
    let shape_ijk = [nx, ny, nz];
    if let Some(start) = starts_ijk
        .iter()
        .find(|start| (0..3).any(|axis| start[axis] >= shape_ijk[axis]))
    {
        return Err(pyo3::exceptions::PyValueError::new_err(format!(
            "starts_ijk: expected voxels inside {shape_ijk:?}, found {start:?}"
        )));
    }
    let found = pool::detached(py, || {
        fast_marching::arrival_times(speed, shape_ijk, &starts_ijk)
    });
    arrays::volume_array(py, found, shape)
}

/// Return the trilinear values of a volume on another grid as float32, `outside` beyond the volume.
#[pyfunction]
#[pyo3(signature = (hu_zyx, lps_from_ijk, *, lps_from_voxel, shape_zyx, outside))]
fn resampled<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    lps_from_voxel: PyReadonlyArray2<'py, f64>,
    shape_zyx: [usize; 3],
    outside: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let grid = arrays::grid(&hu_zyx, &lps_from_ijk)?;
    let data = arrays::values("hu_zyx", &hu_zyx)?;
    let view = VolumeView::new(data, &grid).map_err(IntoPy::into_py)?;
    let map = grid
        .ijk_from_lps()
        .after(&arrays::affine("lps_from_voxel", &lps_from_voxel)?);
    let [nz, ny, nx] = shape_zyx;
    let found = pool::detached(py, || {
        carina_grid::resampled(view, &map, [nx, ny, nz], outside)
    });
    arrays::volume_array(py, found, shape_zyx)
}

/// Add the functions of this file to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(ball_distances, module)?)?;
    module.add_function(wrap_pyfunction!(squared_distances, module)?)?;
    module.add_function(wrap_pyfunction!(numbered_parts, module)?)?;
    module.add_function(wrap_pyfunction!(arrival_times, module)?)?;
    module.add_function(wrap_pyfunction!(resampled, module)?)
}
