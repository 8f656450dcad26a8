//! Conversion of points and voxels of an airway from Python arrays.

use carina_leastcost::TrackError;
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;

use crate::errors::IntoPy;

pub(crate) fn refused(what: &'static str, expected: &str, found: String) -> PyErr {
    TrackError::Argument {
        what,
        expected: expected.to_owned(),
        found,
    }
    .into_py()
}

pub(crate) fn voxels(
    what: &'static str,
    array: &PyReadonlyArray2<'_, u16>,
    shape_ijk: [usize; 3],
) -> PyResult<Vec<[u16; 3]>> {
    let view = array.as_array();
    if view.ncols() != 3 {
        return Err(refused(
            what,
            "(n, 3) voxels",
            format!("{:?}", view.shape()),
        ));
    }
    let found: Vec<[u16; 3]> = view
        .rows()
        .into_iter()
        .map(|r| [r[0], r[1], r[2]])
        .collect();
    match found
        .iter()
        .find(|v| (0..3).any(|a| usize::from(v[a]) >= shape_ijk[a]))
    {
        None => Ok(found),
        Some(voxel) => Err(refused(
            what,
            &format!("below {shape_ijk:?}"),
            format!("{voxel:?}"),
        )),
    }
}

pub(crate) fn points(
    what: &'static str,
    array: &PyReadonlyArray2<'_, f64>,
) -> PyResult<Vec<[f64; 3]>> {
    let view = array.as_array();
    if view.ncols() != 3 {
        return Err(refused(
            what,
            "(n, 3) points",
            format!("{:?}", view.shape()),
        ));
    }
    Ok(view
        .rows()
        .into_iter()
        .map(|r| [r[0], r[1], r[2]])
        .collect())
}
