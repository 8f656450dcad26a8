//! Python bindings of the extension of the lumen beyond the flood (`carina-airpath::find`).
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use carina_airpath::find::extension::{Divided, ExtensionLimits, Followed, extend};
use carina_airpath::find::pieces::{PieceLimits, pieces_of_air};
use carina_airpath::find::soft::{Blur, CutOff, keep_cut_off_air, mixed};
use carina_airpath::find::thin::{ThinLimits, extend_thin};
use carina_grid::{Grid, Ijk, VolumeView};
use carina_leastcost::TrackError;
use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{
    IntoPyArray, PyArray3, PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::arrays;
use crate::errors::IntoPy;
use crate::watch::PyWatch;

/// Extend a lumen into airways beyond the end of the flood; return a dict about the accepted paths.
///
/// `lumen_zyx` (1 inside) is changed in place: added voxels get the value 2.
#[pyfunction]
#[pyo3(signature = (values_zyx, lps_from_ijk, lumen_zyx, *, air, lung, brightest, least_rise, gap_mm, min_length_mm, raised=1.0, most_reached=1.0, least_probability=0.0, divided=None, cancel=None, progress=None))]
fn extend_lumen<'py>(
    py: Python<'py>,
    values_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    mut lumen_zyx: PyReadwriteArray3<'py, u8>,
    air: f64,
    lung: (i16, i16),
    brightest: i16,
    least_rise: f64,
    gap_mm: f64,
    min_length_mm: f64,
    raised: f64,
    most_reached: f64,
    least_probability: f64,
    divided: Option<(usize, f64, f64)>,
    cancel: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
    let data = arrays::values("values_zyx", &values_zyx)?;
    let view = VolumeView::new(data, &grid).map_err(IntoPy::into_py)?;
    let lumen = lumen_of(&mut lumen_zyx, values_zyx.shape())?;
    let limits = ExtensionLimits {
        air,
        lung,
        brightest,
        least_rise,
        gap_mm,
        min_length_mm,
        raised,
        most_reached,
        least_probability,
        divided: divided.map(|(axis, slice_mm, least_odds)| Divided {
            axis,
            slice_mm,
            least_odds,
        }),
    };
    let watch = PyWatch::new(cancel, progress);
    let extension = py
        .detach(|| extend(view, lumen, &limits, &watch))
        .map_err(|e| watch.error(e))?;
    let report = PyDict::new(py);
    report.set_item("num_voxels", extension.num_voxels)?;
    report.set_item("enclosed", extension.enclosed)?;
    report.set_item("num_reached", extension.num_reached)?;
    report.set_item("ran_out", extension.ran_out)?;
    report.set_item("followed", followed_list(py, &grid, extension.followed)?)?;
    Ok(report)
}

/// Extend a lumen into the thinnest airways; return a dict about the accepted paths.
///
/// `lumen_zyx` (1 inside) is changed in place: added voxels get the value 2.
#[pyfunction]
#[pyo3(signature = (values_zyx, lps_from_ijk, lumen_zyx, *, air, lung, brightest, least_wall, least_dip, least_mean_dip, blur_mm, min_length_mm, min_side_mm, most_reached, cancel=None, progress=None))]
fn extend_thin_lumen<'py>(
    py: Python<'py>,
    values_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    mut lumen_zyx: PyReadwriteArray3<'py, u8>,
    air: f64,
    lung: (i16, i16),
    brightest: i16,
    least_wall: f64,
    least_dip: f64,
    least_mean_dip: f64,
    blur_mm: f64,
    min_length_mm: f64,
    min_side_mm: f64,
    most_reached: f64,
    cancel: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
    let data = arrays::values("values_zyx", &values_zyx)?;
    let view = VolumeView::new(data, &grid).map_err(IntoPy::into_py)?;
    let lumen = lumen_of(&mut lumen_zyx, values_zyx.shape())?;
    let limits = ThinLimits {
        air,
        lung,
        brightest,
        least_wall,
        least_dip,
        least_mean_dip,
        blur_mm,
        min_length_mm,
        min_side_mm,
        most_reached,
    };
    let watch = PyWatch::new(cancel, progress);
    let thin = py
        .detach(|| extend_thin(view, lumen, &limits, &watch))
        .map_err(|e| watch.error(e))?;
    let report = PyDict::new(py);
    report.set_item("num_reached", thin.num_reached)?;
    report.set_item("ran_out", thin.ran_out)?;
    report.set_item("followed", followed_list(py, &grid, thin.followed)?)?;
    Ok(report)
}

fn lumen_of<'a>(
    lumen_zyx: &'a mut PyReadwriteArray3<'_, u8>,
    shape_zyx: &[usize],
) -> PyResult<&'a mut [u8]> {
    if lumen_zyx.shape() != shape_zyx {
        return Err(TrackError::Argument {
            what: "lumen_zyx",
            expected: format!("the volume's shape {shape_zyx:?}"),
            found: format!("{:?}", lumen_zyx.shape()),
        }
        .into_py());
    }
    let found = format!("strides {:?}", lumen_zyx.strides());
    lumen_zyx.as_slice_mut().map_err(|_| {
        TrackError::Argument {
            what: "lumen_zyx",
            expected: "a contiguous array".to_owned(),
            found,
        }
        .into_py()
    })
}

fn followed_list<'py>(
    py: Python<'py>,
    grid: &Grid,
    followed: Vec<Followed>,
) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for path in followed {
        let points: Vec<[f64; 3]> = path
            .voxels
            .iter()
            .map(|v| {
                let ijk = grid.voxel(*v as usize).map(|x| x as f64);
                grid.to_lps(Ijk(ijk)).0
            })
            .collect();
        let dict = PyDict::new(py);
        let array = Array2::from_shape_fn((points.len(), 3), |(n, a)| points[n][a]);
        dict.set_item("points_lps", array.into_pyarray(py))?;
        dict.set_item("length_mm", path.length_mm)?;
        dict.set_item("contrast", path.contrast)?;
        dict.set_item("probability", path.probability)?;
        list.append(dict)?;
    }
    Ok(list)
}

/// Return `own` times a volume plus its Gaussian blurs (weight, sigma in mm) along the chosen axes.
#[pyfunction]
#[pyo3(signature = (values_zyx, lps_from_ijk, *, own, blurs, axes_ijk))]
fn mix_with_blurs<'py>(
    py: Python<'py>,
    values_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    own: f64,
    blurs: Vec<(f64, f64)>,
    axes_ijk: [bool; 3],
) -> PyResult<Bound<'py, PyArray3<i16>>> {
    let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
    let data = arrays::values("values_zyx", &values_zyx)?;
    let view = VolumeView::new(data, &grid).map_err(IntoPy::into_py)?;
    let blurs: Vec<Blur> = blurs
        .into_iter()
        .map(|(weight, sigma_mm)| Blur { weight, sigma_mm })
        .collect();
    let out = py.detach(|| mixed(view, own, &blurs, axes_ijk));
    let shape = values_zyx.shape();
    Ok(Array3::from_shape_vec((shape[0], shape[1], shape[2]), out)
        .expect("as many values as the volume has")
        .into_pyarray(py))
}

/// Restore the clipped lumen in a softened volume, in place; return the number of changed voxels.
///
/// A voxel is set to the value of air if it belongs to an airway's lumen that the sharp volume has clipped at its
/// lowest value.
#[pyfunction]
#[pyo3(signature = (sharp_zyx, lps_from_ijk, soft_zyx, *, floor, air, certain, rise, seam_mm))]
fn keep_cut_off_air_of<'py>(
    py: Python<'py>,
    sharp_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    mut soft_zyx: PyReadwriteArray3<'py, i16>,
    floor: i16,
    air: i16,
    certain: i16,
    rise: i16,
    seam_mm: f64,
) -> PyResult<usize> {
    let grid = arrays::grid(&sharp_zyx, &lps_from_ijk)?;
    let data = arrays::values("sharp_zyx", &sharp_zyx)?;
    let view = VolumeView::new(data, &grid).map_err(IntoPy::into_py)?;
    let expected = format!("a contiguous array of shape {:?}", sharp_zyx.shape());
    let found = format!(
        "shape {:?}, strides {:?}",
        soft_zyx.shape(),
        soft_zyx.strides()
    );
    let error = || {
        TrackError::Argument {
            what: "soft_zyx",
            expected: expected.clone(),
            found: found.clone(),
        }
        .into_py()
    };
    if soft_zyx.shape() != sharp_zyx.shape() {
        return Err(error());
    }
    let soft = soft_zyx.as_slice_mut().map_err(|_| error())?;
    let cut = CutOff {
        floor,
        air,
        certain,
        rise,
        seam_mm,
    };
    Ok(py.detach(|| keep_cut_off_air(view, soft, &cut)))
}

/// Return the connected pieces of air that share no face with the lumen, the largest first.
///
/// Each piece is the sorted list of its voxels' indices in the flattened volume.
#[pyfunction]
#[pyo3(signature = (values_zyx, lumen_zyx, *, darkest, box_ijk, least_neighbours, voxels, most_air))]
fn find_pieces_of_air<'py>(
    py: Python<'py>,
    values_zyx: PyReadonlyArray3<'py, i16>,
    lumen_zyx: PyReadonlyArray3<'py, u8>,
    darkest: i16,
    box_ijk: ([usize; 3], [usize; 3]),
    least_neighbours: usize,
    voxels: (usize, usize),
    most_air: usize,
) -> PyResult<Bound<'py, PyList>> {
    let values = arrays::values("values_zyx", &values_zyx)?;
    let lumen = arrays::values("lumen_zyx", &lumen_zyx)?;
    let shape_ijk: [usize; 3] = std::array::from_fn(|a| values_zyx.shape()[2 - a]);
    let error = |what, expected, found| {
        Err(TrackError::Argument {
            what,
            expected,
            found,
        }
        .into_py())
    };
    if lumen_zyx.shape() != values_zyx.shape() {
        let expected = format!("the volume's shape {:?}", values_zyx.shape());
        return error("lumen_zyx", expected, format!("{:?}", lumen_zyx.shape()));
    }
    if (0..3).any(|a| box_ijk.1[a] > shape_ijk[a]) {
        let expected = format!("a box in the volume {shape_ijk:?}");
        return error("box_ijk", expected, format!("{box_ijk:?}"));
    }
    let limits = PieceLimits {
        darkest,
        box_ijk,
        least_neighbours,
        voxels,
        most_air,
    };
    let pieces = py.detach(|| pieces_of_air(values, lumen, shape_ijk, &limits));
    let list = PyList::empty(py);
    for piece in pieces {
        list.append(Array1::from_iter(piece.into_iter().map(|at| at as i64)).into_pyarray(py))?;
    }
    Ok(list)
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(extend_lumen, module)?)?;
    module.add_function(wrap_pyfunction!(extend_thin_lumen, module)?)?;
    module.add_function(wrap_pyfunction!(find_pieces_of_air, module)?)?;
    module.add_function(wrap_pyfunction!(mix_with_blurs, module)?)?;
    module.add_function(wrap_pyfunction!(keep_cut_off_air_of, module)?)
}
