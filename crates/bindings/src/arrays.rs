//! Conversion of `NumPy` arrays, which checks layout and shape and borrows the values without a copy.
#![allow(dead_code, reason = "used as the parts' bindings land")]

use carina_grid::{Affine, Grid, GridError};
use numpy::{
    Element, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::errors::IntoPy;

/// Convert a 4x4 matrix to an affine map; `what` is the name of the matrix in error messages.
pub(crate) fn affine(what: &'static str, matrix: &PyReadonlyArray2<'_, f64>) -> PyResult<Affine> {
    let shape = matrix.shape();
    if shape != [4, 4] {
        return Err(GridError::Transform {
            what,
            reason: format!("expected a 4x4 matrix, found shape {shape:?}"),
        }
        .into_py());
    }
    let view = matrix.as_array();
    let rows: [[f64; 4]; 4] = std::array::from_fn(|r| std::array::from_fn(|c| view[[r, c]]));
    Affine::from_matrix(what, &rows).map_err(IntoPy::into_py)
}

/// Return the grid of a `[z, y, x]` array with the transform `lps_from_ijk`.
pub(crate) fn grid<T: Element>(
    array: &PyReadonlyArray3<'_, T>,
    lps_from_ijk: &PyReadonlyArray2<'_, f64>,
) -> PyResult<Grid> {
    let shape = array.shape();
    Grid::new(
        [shape[0], shape[1], shape[2]],
        affine("lps_from_ijk", lps_from_ijk)?,
    )
    .map_err(IntoPy::into_py)
}

/// Borrow the values of an array without a copy; an array that is not C-contiguous causes an error.
pub(crate) fn values<'a, T: Element>(
    name: &str,
    array: &'a PyReadonlyArray3<'_, T>,
) -> PyResult<&'a [T]> {
    if !array.is_c_contiguous() {
        return Err(pyo3::exceptions::PyValueError::new_err(format!(
            "{name}: expected a C-contiguous [z, y, x] array, found other strides; pass numpy.ascontiguousarray({name})"
        )));
    }
    array
        .as_slice()
        .map_err(|e| pyo3::exceptions::PyValueError::new_err(format!("{name}: {e}")))
}

/// Create a `[z, y, x]` array from the values of a volume, without a copy.
pub(crate) fn volume_array<T: numpy::Element>(
    py: Python<'_>,
    data: Vec<T>,
    shape_zyx: [usize; 3],
) -> PyResult<Bound<'_, PyArray3<T>>> {
    numpy::PyArray1::from_vec(py, data).reshape(shape_zyx)
}
