//! Python bindings of the surface of the lumen, as a mesh and as a mask.
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use carina_airpath::mesh;
use carina_grid::{Grid, VolumeView};
use carina_leastcost::lumen::WallLevels;
use numpy::ndarray::{Array2, Array3};
use numpy::{
    IntoPyArray, PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::IntoPy;
use crate::watch::PyWatch;

/// Value levels `(core, wall, rise)` that define the beginning of the wall; see [`WallLevels`].
type Levels = (f32, f32, f32);
type VerticesAndTriangles<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<u32>>);

/// Return the closed mesh of the lumen: vertices (n, 3) LPS mm, and triangles (m, 3), counterclockwise from outside.
#[pyfunction]
#[pyo3(signature = (values_zyx, lps_from_ijk, lumen_zyx, *, levels, cancel=None, progress=None))]
fn lumen_mesh<'py>(
    py: Python<'py>,
    values_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    lumen_zyx: PyReadonlyArray3<'py, u8>,
    levels: Option<Levels>,
    cancel: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<VerticesAndTriangles<'py>> {
    let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
    let (view, lumen, levels) = inputs(&values_zyx, &grid, &lumen_zyx, levels)?;
    let watch = PyWatch::new(cancel, progress);
    let found = py
        .detach(|| mesh::lumen_mesh(view, lumen, levels, &watch))
        .map_err(|e| watch.error(e))?;
    let vertices = Array2::from_shape_fn((found.vertices.len(), 3), |(n, a)| found.vertices[n][a]);
    let triangles =
        Array2::from_shape_fn((found.triangles.len(), 3), |(n, a)| found.triangles[n][a]);
    Ok((vertices.into_pyarray(py), triangles.into_pyarray(py)))
}

/// Return the mask of the voxels whose centres are inside the mesh of the lumen: [z, y, x], 1 inside.
#[pyfunction]
#[pyo3(signature = (values_zyx, lps_from_ijk, lumen_zyx, *, levels))]
fn lumen_mask<'py>(
    py: Python<'py>,
    values_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    lumen_zyx: PyReadonlyArray3<'py, u8>,
    levels: Option<Levels>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
    let (view, lumen, levels) = inputs(&values_zyx, &grid, &lumen_zyx, levels)?;
    let found = py.detach(|| mesh::lumen_mask(view, lumen, levels));
    let [nx, ny, nz] = grid.shape_ijk();
    let mask = Array3::from_shape_vec((nz, ny, nx), found)
        .map_err(|e| pyo3::exceptions::PyValueError::new_err(e.to_string()))?;
    Ok(mask.into_pyarray(py))
}

/// Check and convert the arguments of `lumen_mesh` and `lumen_mask`: the volume, its lumen, and the wall levels.
fn inputs<'a>(
    values_zyx: &'a PyReadonlyArray3<'_, i16>,
    grid: &'a Grid,
    lumen_zyx: &'a PyReadonlyArray3<'_, u8>,
    levels: Option<Levels>,
) -> PyResult<(VolumeView<'a, i16>, &'a [u8], Option<WallLevels>)> {
    let view = VolumeView::new(arrays::values("values_zyx", values_zyx)?, grid)
        .map_err(IntoPy::into_py)?;
    let lumen = arrays::values("lumen_zyx", lumen_zyx)?;
    if lumen_zyx.shape() != values_zyx.shape() {
        return Err(pyo3::exceptions::PyValueError::new_err(format!(
            "lumen_zyx: expected the volume's shape {:?}, found {:?}",
            values_zyx.shape(),
            lumen_zyx.shape()
        )));
    }
    let levels = levels.map(|(core, wall, rise)| WallLevels { core, wall, rise });
    Ok((view, lumen, levels))
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(lumen_mesh, module)?)?;
    module.add_function(wrap_pyfunction!(lumen_mask, module)?)?;
    Ok(())
}
