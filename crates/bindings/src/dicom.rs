//! Bindings of the fast readers of DICOM slices.
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use std::path::PathBuf;

use carina_dicom::{Coding, SliceFormat, SliceSource, Wanted};
use numpy::{PyReadonlyArray2, PyReadonlyArray3, PyReadwriteArray3, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use rayon::prelude::*;

use crate::arrays;
use crate::errors::{IntoPy, carina_error};
use crate::watch::PyWatch;

/// The user cancelled the call.
struct Cancelled;

impl IntoPy for Cancelled {
    fn into_py(self) -> PyErr {
        carina_error(
            "CancelledError",
            "cancelled",
            "cancelled while reading the slices",
        )
    }
}

type Elements<'py> = (
    Bound<'py, PyBytes>,
    Vec<Option<Bound<'py, PyBytes>>>,
    Option<u64>,
);

/// Return the elements of each file that is plainly readable: key, single values, and offset of the pixels.
#[pyfunction]
#[pyo3(signature = (paths, *, shared, single, refused, max_inflated))]
fn scan_dicom_headers(
    py: Python<'_>,
    paths: Vec<PathBuf>,
    mut shared: Vec<u32>,
    single: Vec<u32>,
    mut refused: Vec<u32>,
    max_inflated: usize,
) -> PyResult<Vec<Option<Elements<'_>>>> {
    if !single.is_sorted() {
        return Err(PyValueError::new_err("single: expected ascending tags"));
    }
    shared.sort_unstable();
    refused.sort_unstable();
    let wanted = Wanted {
        shared,
        single,
        refused,
        max_inflated,
    };
    let found: Vec<_> = py.detach(|| {
        paths
            .par_iter()
            .with_max_len(4)
            .map(|path| carina_dicom::scan_file(path, &wanted))
            .collect()
    });
    Ok(found
        .into_iter()
        .map(|one| {
            one.map(|elements| {
                let single = elements
                    .single
                    .iter()
                    .map(|value| value.as_ref().map(|v| PyBytes::new(py, v)))
                    .collect();
                (PyBytes::new(py, &elements.key), single, elements.pixels_at)
            })
        })
        .collect())
}

/// Read slices into the volume `out_zyx` in place; return for each whether it was read.
#[pyfunction]
#[pyo3(signature = (sources, out_zyx, *, coding, bits_allocated, bits_stored, high_bit, signed, intercept, padding, max_inflated, cancel=None, progress=None))]
fn decode_dicom_slices(
    py: Python<'_>,
    sources: Vec<(PathBuf, u64, usize)>,
    mut out_zyx: PyReadwriteArray3<'_, i16>,
    coding: &str,
    bits_allocated: u32,
    bits_stored: u32,
    high_bit: u32,
    signed: bool,
    intercept: i32,
    padding: Option<Vec<(i32, i32)>>,
    max_inflated: usize,
    cancel: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Vec<bool>> {
    let coding = match coding {
        "implicit" => Coding::Implicit,
        "little" => Coding::Little,
        "big" => Coding::Big,
        "deflated" => Coding::Deflated,
        "rle" => Coding::Rle,
        "jpeg ls" => Coding::JpegLs,
        "lossless jpeg" => Coding::LosslessJpeg,
        _ => {
            return Err(PyValueError::new_err(format!(
                "coding: expected a known coding, found {coding}"
            )));
        }
    };
    let format = checked(SliceFormat {
        coding,
        rows: out_zyx.shape()[1],
        columns: out_zyx.shape()[2],
        bits_allocated,
        bits_stored,
        high_bit,
        signed,
        intercept,
        padding,
        max_inflated,
    })?;
    let sources: Vec<SliceSource> = sources
        .into_iter()
        .map(|(path, pixels_at, level)| SliceSource {
            path,
            pixels_at,
            level,
        })
        .collect();
    let out = out_zyx
        .as_slice_mut()
        .map_err(|_| PyValueError::new_err("out_zyx: expected a contiguous array"))?;
    let watch = PyWatch::new(cancel, progress);
    let stopped = std::sync::atomic::AtomicBool::new(false);
    let found = py.detach(|| {
        carina_dicom::decode_slices(&sources, &format, out, |share| {
            let goes_on = watch.should_continue(share);
            if !goes_on {
                stopped.store(true, std::sync::atomic::Ordering::Relaxed);
            }
            goes_on
        })
    });
    if stopped.into_inner() {
        return Err(watch.error(Cancelled));
    }
    Ok(found)
}

/// Write decoded words into the slice `level` of the volume in place; return whether nothing about them is remarkable.
#[pyfunction]
#[pyo3(signature = (words_yx, out_zyx, *, level, bits, bits_allocated, bits_stored, high_bit, signed, intercept, padding))]
fn place_dicom_words(
    words_yx: PyReadonlyArray2<'_, u16>,
    mut out_zyx: PyReadwriteArray3<'_, i16>,
    level: usize,
    bits: u32,
    bits_allocated: u32,
    bits_stored: u32,
    high_bit: u32,
    signed: bool,
    intercept: i32,
    padding: Option<Vec<(i32, i32)>>,
) -> PyResult<bool> {
    let shape = out_zyx.shape().to_vec();
    if words_yx.shape() != &shape[1..] || level >= shape[0] || !(1..=16).contains(&bits) {
        return Err(PyValueError::new_err(
            "expected words of at most 16 bits with the size of a slice of the volume",
        ));
    }
    let format = checked(SliceFormat {
        coding: Coding::Little,
        rows: shape[1],
        columns: shape[2],
        bits_allocated,
        bits_stored,
        high_bit,
        signed,
        intercept,
        padding,
        max_inflated: 0,
    })?;
    let size = shape[1] * shape[2];
    let words = words_yx
        .as_slice()
        .map_err(|_| PyValueError::new_err("words_yx: expected a contiguous array"))?;
    let out = out_zyx
        .as_slice_mut()
        .map_err(|_| PyValueError::new_err("out_zyx: expected a contiguous array"))?;
    let plane = &mut out[level * size..(level + 1) * size];
    Ok(carina_dicom::place_words(words, bits, &format, plane))
}

/// Return a format whose words and slices are usable.
fn checked(format: SliceFormat) -> PyResult<SliceFormat> {
    let is_word = matches!(format.bits_allocated, 8 | 16)
        && (1..=format.bits_allocated).contains(&format.bits_stored);
    if !is_word
        || format.high_bit + 1 < format.bits_stored
        || format.high_bit >= format.bits_allocated
        || format.rows == 0
        || format.columns == 0
    {
        return Err(PyValueError::new_err(
            "expected words of 8 or 16 bits and slices with pixels",
        ));
    }
    if format.intercept.unsigned_abs() > 1 << 24 {
        return Err(PyValueError::new_err("intercept: expected at most 24 bits"));
    }
    Ok(format)
}

/// Return the problem of a lossless grey JPEG stream that begins at `start`; None for intact and for other streams.
#[pyfunction]
#[pyo3(signature = (frame, *, start))]
fn lossless_jpeg_problem(frame: &[u8], start: usize) -> PyResult<Option<&'static str>> {
    carina_dicom::lossless_jpeg_problem(frame, start)
        .map_err(|_| PyValueError::new_err("frame: its header is truncated"))
}

/// Return the excess in HU of each slice between two neighbours.
#[pyfunction]
#[pyo3(signature = (values_zyx, *, tile, step, allowed))]
fn slice_excesses(
    py: Python<'_>,
    values_zyx: PyReadonlyArray3<'_, i16>,
    tile: Option<usize>,
    step: usize,
    allowed: f64,
) -> PyResult<Vec<f64>> {
    if tile == Some(0) || step == 0 {
        return Err(PyValueError::new_err("tile, step: expected at least 1"));
    }
    let shape = values_zyx.shape();
    let shape = [shape[0], shape[1], shape[2]];
    let values = arrays::values("values_zyx", &values_zyx)?;
    Ok(py.detach(|| carina_dicom::excesses(values, shape, tile, step, allowed)))
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(scan_dicom_headers, module)?)?;
    module.add_function(wrap_pyfunction!(decode_dicom_slices, module)?)?;
    module.add_function(wrap_pyfunction!(place_dicom_words, module)?)?;
    module.add_function(wrap_pyfunction!(lossless_jpeg_problem, module)?)?;
    module.add_function(wrap_pyfunction!(slice_excesses, module)?)
}
