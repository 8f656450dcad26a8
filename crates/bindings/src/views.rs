//! Python bindings of radiographs and of pictures whose rows are lines through the volume.
#![allow(
    clippy::needless_pass_by_value,
    reason = "Python hands its arguments over by value"
)]

use carina_grid::VolumeView;
use carina_raycast::{
    Attenuation, PixelLine, Projector, RaycastError, Slab, SlabKind, Window, cast_radiograph,
    sample_lines,
};
use numpy::{
    PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::{exceptions::PyValueError, prelude::*};

use crate::pool;
use crate::{
    arrays::{affine, grid, values},
    errors::IntoPy,
    raycast::{instruction_set, rows_of},
};

/// Return the water-equivalent length in mm of the ray of each pixel in some rows of a radiograph, (rows, width)
/// float32.
#[pyfunction]
#[pyo3(signature = (
    hu_zyx, lps_from_ijk, lps_from_pixel, *, width, height, rows=None, source_lps=None, air=-1000.0, bone=100.0, bone_gain=1.0,
    simd=None
))]
fn radiograph<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    lps_from_pixel: PyReadonlyArray2<'py, f64>,
    width: usize,
    height: usize,
    rows: Option<(usize, usize)>,
    source_lps: Option<[f64; 3]>,
    air: f32,
    bone: f32,
    bone_gain: f32,
    simd: Option<&str>,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let grid = grid(&hu_zyx, &lps_from_ijk)?;
    let volume = VolumeView::new(values("hu_zyx", &hu_zyx)?, &grid).map_err(IntoPy::into_py)?;
    let projector = Projector {
        lps_from_pixel: affine("lps_from_pixel", &lps_from_pixel)?,
        source_lps,
    };
    let attenuation = Attenuation {
        air,
        bone,
        bone_gain,
    };
    let simd = instruction_set(simd)?;
    let rows = rows_of(rows, height)?;
    let num_rows = rows.len();
    let lengths = pool::detached(py, || {
        cast_radiograph(volume, &projector, attenuation, width, rows, simd)
    })
    .map_err(IntoPy::into_py)?;
    PyArray1::from_vec(py, lengths).reshape([num_rows, width])
}

type GreyAndInside<'py> = (Bound<'py, PyArray2<u8>>, Bound<'py, PyArray2<u8>>);

/// Sample a picture whose rows are lines through the volume.
///
/// Return grey levels and a mask of the pixels inside the volume, both (rows, width) uint8. A row of `lines` contains
/// the start, the step and the direction through the picture (LPS).
#[pyfunction(name = "sample_lines")]
#[pyo3(signature = (hu_zyx, lps_from_ijk, lines, *, width, window_hu, slab=None))]
fn lines_of<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    lines: PyReadonlyArray2<'py, f64>,
    width: usize,
    window_hu: (f64, f64),
    slab: Option<(f64, String)>,
) -> PyResult<GreyAndInside<'py>> {
    let grid = grid(&hu_zyx, &lps_from_ijk)?;
    let volume = VolumeView::new(values("hu_zyx", &hu_zyx)?, &grid).map_err(IntoPy::into_py)?;
    if lines.shape()[1] != 9 {
        return Err(PyValueError::new_err(format!(
            "lines: expected rows of start, step and through (9 numbers), found shape {:?}",
            lines.shape()
        )));
    }
    let rows: Vec<PixelLine> = lines
        .as_array()
        .rows()
        .into_iter()
        .map(|r| PixelLine {
            start_lps: [r[0], r[1], r[2]],
            step_lps: [r[3], r[4], r[5]],
            through_lps: [r[6], r[7], r[8]],
        })
        .collect();
    let window = Window::new(window_hu.0, window_hu.1).map_err(IntoPy::into_py)?;
    let slab = slab
        .map(|(thickness_mm, kind)| {
            let kind = match kind.as_str() {
                "max" => SlabKind::Maximum,
                "min" => SlabKind::Minimum,
                "mean" => SlabKind::Mean,
                _ => {
                    return Err(RaycastError::Setting {
                        what: "slab",
                        expected: "max, min or mean".to_owned(),
                        found: kind,
                    }
                    .into_py());
                }
            };
            Ok(Slab { thickness_mm, kind })
        })
        .transpose()?;
    let height = rows.len();
    let image = pool::detached(py, || sample_lines(volume, &rows, width, window, slab))
        .map_err(IntoPy::into_py)?;
    let array = |data: Vec<u8>| PyArray1::from_vec(py, data).reshape([height, width]);
    Ok((array(image.grey)?, array(image.inside)?))
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(radiograph, module)?)?;
    module.add_function(wrap_pyfunction!(lines_of, module)?)?;
    Ok(())
}
