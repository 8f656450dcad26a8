//! Python bindings of `carina-isoregion`: label volumes, maps and digests.
#![allow(
    clippy::needless_pass_by_value,
    reason = "Python hands its arguments over by value"
)]

use carina_isoregion::{
    ClassLabels, IsoRegionError, MapBuilder, class_labels, value_labels, value_range as range_of,
};
use carina_raycast::Transfer;
use numpy::{PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::pool;
use crate::{
    arrays::{values, volume_array},
    errors::{IntoPy, carina_error},
    raycast::{instruction_set, transfer},
    watch::PyWatch,
};

impl IntoPy for IsoRegionError {
    fn into_py(self) -> PyErr {
        let class = match self {
            Self::EmptyTable => "RenderError",
            Self::Length { .. } => "GeometryError",
            Self::Cancelled => "CancelledError",
        };
        carina_error(class, self.code(), &self.to_string())
    }
}

/// Class of a label as a Python tuple: first HU, last HU, number of voxels, whether it is fully transparent.
type PyClass = (i32, i32, u64, bool);

fn shape_of<T: numpy::Element>(array: &PyReadonlyArray3<'_, T>) -> [usize; 3] {
    let shape = array.shape();
    [shape[0], shape[1], shape[2]]
}

/// Return the labels of voxels by the classes of a transfer function over all int16 values.
fn classes_of(
    hu: &[i16],
    transfer: &Transfer,
    transparent_only: bool,
) -> Result<ClassLabels, IsoRegionError> {
    let (lo, hi) = (i32::from(i16::MIN), i32::from(i16::MAX));
    class_labels(hu, lo, &transfer.range(lo, hi), transparent_only)
}

fn label_arrays(
    py: Python<'_>,
    out: ClassLabels,
    shape_zyx: [usize; 3],
) -> PyResult<(Bound<'_, PyArray3<u8>>, Vec<PyClass>)> {
    let classes = out
        .classes
        .iter()
        .map(|c| (c.lo_hu, c.hi_hu, c.num_voxels, c.transparent))
        .collect();
    Ok((volume_array(py, out.labels, shape_zyx)?, classes))
}

/// Label the voxels of a volume by the classes of a transfer function; return the labels and the classes.
#[pyfunction]
#[pyo3(signature = (hu_zyx, points, *, reference_mm=1.0, bin_hu=1))]
fn label_classes<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
    points: PyReadonlyArray2<'py, f64>,
    reference_mm: f64,
    bin_hu: i32,
) -> PyResult<(Bound<'py, PyArray3<u8>>, Vec<PyClass>)> {
    let transfer = transfer(&points, reference_mm, bin_hu)?;
    let hu = values("hu_zyx", &hu_zyx)?;
    let out = pool::detached(py, || classes_of(hu, &transfer, false)).map_err(IntoPy::into_py)?;
    label_arrays(py, out, shape_of(&hu_zyx))
}

/// Label the voxels of a volume by the paper's 16-HU bins; return the labels and the bins.
#[pyfunction]
fn label_values<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
) -> PyResult<(Bound<'py, PyArray3<u8>>, Vec<PyClass>)> {
    let hu = values("hu_zyx", &hu_zyx)?;
    let out = py.detach(|| value_labels(hu, |_, _| false));
    label_arrays(py, out, shape_of(&hu_zyx))
}

/// Return the transparent runs of a transfer function over all int16 values, as (first, last) values.
///
/// A map of the transparent classes depends only on the volume and on these runs.
#[pyfunction]
#[pyo3(signature = (points, *, reference_mm=1.0, bin_hu=1))]
fn transparent_runs(
    points: PyReadonlyArray2<'_, f64>,
    reference_mm: f64,
    bin_hu: i32,
) -> PyResult<Vec<(i16, i16)>> {
    let transfer = transfer(&points, reference_mm, bin_hu)?;
    let (lo, hi) = (i32::from(i16::MIN), i32::from(i16::MAX));
    carina_isoregion::transparent_runs(lo, &transfer.range(lo, hi)).map_err(IntoPy::into_py)
}

/// Create a `NumPy` array and let `build` write a radius map into it.
///
/// `NumPy` places large arrays in large memory pages; with small pages, page faults take a third of the time.
fn map_array<'py>(
    py: Python<'py>,
    shape_zyx: [usize; 3],
    cancel: Option<Py<PyAny>>,
    simd: Option<&str>,
    num_slabs: Option<usize>,
    build: impl Send + FnOnce(MapBuilder<'_>, &mut [u8]) -> Result<(), IsoRegionError>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let simd = instruction_set(simd)?;
    let watch = PyWatch::new(cancel, None);
    // SAFETY: the array is not initialised, but every byte is a valid u8, and no other code has a reference to the
    // array before all of it is written. Benchmark: benchmarks/isoregion.py.
    let array = unsafe { PyArray3::<u8>::new(py, shape_zyx, false) };
    // SAFETY: the array is new, so it is C-contiguous and this is the only reference to its values.
    let out = unsafe { array.as_slice_mut() }?;
    pool::detached(py, || {
        let cancelled = || !watch.should_continue(0.0);
        let builder = MapBuilder {
            simd,
            cancelled: Some(&cancelled),
            ..MapBuilder::default()
        };
        let num_slabs = num_slabs.unwrap_or(builder.num_slabs);
        build(
            MapBuilder {
                num_slabs,
                ..builder
            },
            out,
        )
    })
    .map_err(|e| watch.error(e))?;
    Ok(array)
}

/// Compute the radius map of a label volume.
#[pyfunction]
#[pyo3(signature = (labels_zyx, *, cancel=None, simd=None, num_slabs=None))]
fn build_radius_map<'py>(
    py: Python<'py>,
    labels_zyx: PyReadonlyArray3<'py, u8>,
    cancel: Option<Py<PyAny>>,
    simd: Option<&str>,
    num_slabs: Option<usize>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let shape = shape_of(&labels_zyx);
    let labels = values("labels_zyx", &labels_zyx)?;
    map_array(py, shape, cancel, simd, num_slabs, |builder, out| {
        builder.radius_map(labels, shape, out)
    })
}

/// Compute the radius map of cells (of eight voxels each) for classes that are given as intervals of values.
///
/// `runs` are the first and last value of each interval. A cell whose eight values are not in one interval has
/// radius 0.
#[pyfunction]
#[pyo3(signature = (hu_zyx, runs, *, cancel=None, simd=None, num_slabs=None))]
fn build_cell_map<'py>(
    py: Python<'py>,
    hu_zyx: PyReadonlyArray3<'py, i16>,
    runs: Vec<(i16, i16)>,
    cancel: Option<Py<PyAny>>,
    simd: Option<&str>,
    num_slabs: Option<usize>,
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let shape = shape_of(&hu_zyx);
    let hu = values("hu_zyx", &hu_zyx)?;
    map_array(py, shape, cancel, simd, num_slabs, |builder, out| {
        builder.run_cell_map(hu, shape, &runs, out)
    })
}

/// Return the smallest and the largest value of a volume; (0, 0) for an array without voxels.
#[pyfunction]
fn value_range(py: Python<'_>, hu_zyx: PyReadonlyArray3<'_, i16>) -> PyResult<(i16, i16)> {
    let hu = values("hu_zyx", &hu_zyx)?;
    // Only an array without voxels has no range, and a volume always has voxels.
    Ok(py.detach(|| range_of(hu)).unwrap_or((0, 0)))
}

/// Array of a volume or a mask whose digest is computed; the digest identifies a cached map.
#[derive(FromPyObject)]
enum Voxels<'py> {
    Values(PyReadonlyArray3<'py, i16>),
    Labels(PyReadonlyArray3<'py, u8>),
}

/// Number of bytes that are hashed as one piece.
///
/// The digest is the hash of the pieces' digests, so that threads can share the work.
const PIECE_BYTES: usize = 4 << 20;

/// Return the BLAKE3 digest of the bytes of an array, in hexadecimal; the shape is not included.
#[pyfunction]
fn content_digest(py: Python<'_>, voxels: Voxels<'_>) -> PyResult<String> {
    let bytes = match &voxels {
        Voxels::Labels(labels) => values("voxels", labels)?,
        Voxels::Values(hu) => {
            let hu = values("voxels", hu)?;
            // SAFETY: the slice covers exactly the memory of `hu`, which is borrowed for as long as the slice lives;
            // its int16 values are initialised, every byte is a valid u8, and u8 needs no alignment. Benchmark: hashing
            // a copy instead takes twice the time.
            unsafe { std::slice::from_raw_parts(hu.as_ptr().cast::<u8>(), size_of_val(hu)) }
        }
    };
    Ok(py.detach(|| {
        let pieces: Vec<&[u8]> = bytes.chunks(PIECE_BYTES).collect();
        let num_threads = rayon::current_num_threads();
        let part = pieces.len().div_ceil(num_threads).max(1);
        let digests = std::thread::scope(|scope| {
            let hash = |pieces: &[&[u8]]| -> Vec<blake3::Hash> {
                pieces.iter().map(|piece| blake3::hash(piece)).collect()
            };
            let threads: Vec<_> = pieces
                .chunks(part)
                .map(|pieces| scope.spawn(move || hash(pieces)))
                .collect();
            let parts = threads.into_iter().map(|t| t.join().expect("hashing"));
            parts.collect::<Vec<_>>()
        });
        let mut whole = blake3::Hasher::new();
        for digest in digests.iter().flatten() {
            whole.update(digest.as_bytes());
        }
        whole.finalize().to_hex().to_string()
    }))
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(label_classes, module)?)?;
    module.add_function(wrap_pyfunction!(label_values, module)?)?;
    module.add_function(wrap_pyfunction!(transparent_runs, module)?)?;
    module.add_function(wrap_pyfunction!(value_range, module)?)?;
    module.add_function(wrap_pyfunction!(content_digest, module)?)?;
    module.add_function(wrap_pyfunction!(build_radius_map, module)?)?;
    module.add_function(wrap_pyfunction!(build_cell_map, module)?)?;
    Ok(())
}
