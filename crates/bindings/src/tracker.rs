//! Python bindings of the tracker for a volume of weights, and timing of path queries in a settled tree.
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use carina_grid::Grid;
use carina_leastcost::TrackError;
use carina_leastcost::field::{EnterCost, MeanCost, VoxelField};
use carina_leastcost::field_a_star::least_path;
use carina_leastcost::field_tracker::FieldTracker as Tracker;
use numpy::ndarray::Array2;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::airpath::LumenTracker;
use crate::arrays;
use crate::errors::IntoPy;
use crate::watch::PyWatch;

/// Tracker of a volume of weights with either of the two costs.
enum AnyTracker {
    Mean(Tracker<MeanCost>),
    Enter(Tracker<EnterCost>),
}

macro_rules! either {
    ($any:expr, $tracker:ident => $do:expr) => {
        match $any {
            AnyTracker::Mean($tracker) => $do,
            AnyTracker::Enter($tracker) => $do,
        }
    };
}

/// Times in ns of path queries, and the numbers of voxels of their paths.
type TimesAndLengths<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i64>>);

/// Result of a search for one path: its voxels, its cost, and the number of settled voxels.
type AimedTuple<'py> = (Bound<'py, PyArray2<i64>>, f64, usize);

type Region = [(usize, usize); 3];

/// Tree of least-cost paths in a volume of weights.
#[pyclass(frozen, module = "carina._core")]
pub(crate) struct FieldTracker {
    grid: Grid,
    field: Py<PyArray3<f32>>,
    mask: Option<Py<PyArray3<u8>>>,
    region: Option<Region>,
    tracker: Mutex<AnyTracker>,
}

#[pymethods]
impl FieldTracker {
    #[new]
    #[pyo3(signature = (field_zyx, lps_from_ijk, root_ijk, *, cost, region_ijk=None, mask_zyx=None))]
    fn new(
        py: Python<'_>,
        field_zyx: PyReadonlyArray3<'_, f32>,
        lps_from_ijk: PyReadonlyArray2<'_, f64>,
        root_ijk: [usize; 3],
        cost: &str,
        region_ijk: Option<Region>,
        mask_zyx: Option<PyReadonlyArray3<'_, u8>>,
    ) -> PyResult<Self> {
        let grid = arrays::grid(&field_zyx, &lps_from_ijk)?;
        let values = arrays::values("field_zyx", &field_zyx)?;
        let mask = mask_values(mask_zyx.as_ref(), &field_zyx)?;
        let by_voxel = is_by_voxel(cost)?;
        let tracker = py
            .detach(|| {
                let field = voxel_field(&grid, values, region_ijk.as_ref(), mask)?;
                Ok(if by_voxel {
                    AnyTracker::Enter(Tracker::new(&field, root_ijk)?)
                } else {
                    AnyTracker::Mean(Tracker::new(&field, root_ijk)?)
                })
            })
            .map_err(TrackError::into_py)?;
        Ok(Self {
            grid,
            field: (*field_zyx).clone().unbind(),
            mask: mask_zyx.map(|mask| (*mask).clone().unbind()),
            region: region_ijk,
            tracker: Mutex::new(tracker),
        })
    }

    #[getter]
    fn num_settled(&self, py: Python<'_>) -> usize {
        py.detach(|| either!(&*self.lock(), t => t.num_settled()))
    }

    /// Number of voxels that a path may use.
    #[getter]
    fn num_open(&self, py: Python<'_>) -> usize {
        py.detach(|| either!(&*self.lock(), t => t.quanta().num_open))
    }

    /// Path cost that one unit (quantum) of the integer costs represents, in the unit of the path costs.
    #[getter]
    fn quantum(&self, py: Python<'_>) -> f64 {
        py.detach(|| either!(&*self.lock(), t => t.quanta().unit))
    }

    /// Memory in bytes that the tracker uses: for the voxels, and for the queue.
    #[getter]
    fn num_bytes(&self, py: Python<'_>) -> (usize, usize) {
        py.detach(|| either!(&*self.lock(), t => t.num_bytes()))
    }

    /// Settle voxels until the given voxel is settled; return True if a path from the root exists.
    #[pyo3(signature = (target_ijk, *, cancel=None, progress=None))]
    fn solve_to(
        &self,
        py: Python<'_>,
        target_ijk: [usize; 3],
        cancel: Option<Py<PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<bool> {
        let watch = PyWatch::new(cancel, progress);
        self.with_field(py, |field| {
            let target = node(field, target_ijk)?;
            either!(&mut *self.lock(), t => t.solve_to(field, target, &watch))
        })?
        .map_err(|e| watch.error(e))
    }

    /// Settle all voxels that a path from the root can reach.
    #[pyo3(signature = (*, cancel=None, progress=None))]
    fn solve_all(
        &self,
        py: Python<'_>,
        cancel: Option<Py<PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<()> {
        let watch = PyWatch::new(cancel, progress);
        self.with_field(
            py,
            |field| either!(&mut *self.lock(), t => t.solve_all(field, &watch)),
        )?
        .map_err(|e| watch.error(e))
    }

    /// Return the least cost of a settled voxel; None for a voxel that is not settled.
    fn cost(&self, py: Python<'_>, target_ijk: [usize; 3]) -> PyResult<Option<f64>> {
        self.with_field(py, |field| {
            let target = node(field, target_ijk)?;
            Ok(either!(&*self.lock(), t => t.cost(field, target)))
        })?
        .map_err(TrackError::into_py)
    }

    /// Return the voxels (n, 3) i, j, k from the root to a settled voxel; None for a voxel that is not settled.
    fn path<'py>(
        &self,
        py: Python<'py>,
        target_ijk: [usize; 3],
    ) -> PyResult<Option<Bound<'py, PyArray2<i64>>>> {
        let path = self
            .with_field(py, |field| {
                let target = node(field, target_ijk)?;
                let path = either!(&*self.lock(), t => t.path_to(target));
                Ok(path.map(|nodes| voxels_of(field, &nodes)))
            })?
            .map_err(TrackError::into_py)?;
        Ok(path.map(|voxels| voxels.into_pyarray(py)))
    }

    /// Measure the time in ns of one path query for each target; return the times and the numbers of voxels of the
    /// paths.
    fn time_paths<'py>(
        &self,
        py: Python<'py>,
        targets_ijk: Vec<[usize; 3]>,
    ) -> PyResult<TimesAndLengths<'py>> {
        let times = self
            .with_field(py, |field| {
                let targets: Result<Vec<u32>, _> =
                    targets_ijk.iter().map(|ijk| node(field, *ijk)).collect();
                let targets = targets?;
                Ok(either!(&*self.lock(), t => clocked(&targets, |n| t.path_to(n))))
            })?
            .map_err(TrackError::into_py)?;
        Ok((times.0.into_pyarray(py), times.1.into_pyarray(py)))
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!(
            "FieldTracker(num_open={}, num_settled={})",
            self.num_open(py),
            self.num_settled(py)
        )
    }
}

impl FieldTracker {
    fn lock(&self) -> MutexGuard<'_, AnyTracker> {
        // A stopped search leaves the tracker consistent, because it stops between blocks. A panic is reported
        // elsewhere as a bug, so a poisoned lock is usable.
        self.tracker.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Call a function with the field while the GIL is released.
    fn with_field<T: Send>(
        &self,
        py: Python<'_>,
        read: impl FnOnce(&VoxelField<'_>) -> Result<T, TrackError> + Send,
    ) -> PyResult<Result<T, TrackError>> {
        let array = self.field.bind(py).try_readonly()?;
        let values = arrays::values("field_zyx", &array)?;
        let mask = self
            .mask
            .as_ref()
            .map(|mask| mask.bind(py).try_readonly())
            .transpose()?;
        let mask = mask
            .as_ref()
            .map(|mask| arrays::values("mask_zyx", mask))
            .transpose()?;
        Ok(py.detach(|| {
            read(&voxel_field(
                &self.grid,
                values,
                self.region.as_ref(),
                mask,
            )?)
        }))
    }
}

/// Return the values of a mask, whose shape must equal that of the field; `None` without a mask.
fn mask_values<'a>(
    mask_zyx: Option<&'a PyReadonlyArray3<'_, u8>>,
    field_zyx: &PyReadonlyArray3<'_, f32>,
) -> PyResult<Option<&'a [u8]>> {
    let Some(mask) = mask_zyx else {
        return Ok(None);
    };
    if mask.shape() != field_zyx.shape() {
        return Err(TrackError::Argument {
            what: "mask_zyx",
            expected: format!("the field's shape {:?}", field_zyx.shape()),
            found: format!("{:?}", mask.shape()),
        }
        .into_py());
    }
    arrays::values("mask_zyx", mask).map(Some)
}

/// Return true if a cost depends only on the voxel that a step enters; an unknown name causes an error.
fn is_by_voxel(cost: &str) -> PyResult<bool> {
    match cost {
        "mean" => Ok(false),
        "enter" => Ok(true),
        other => Err(TrackError::Argument {
            what: "cost",
            expected: "mean or enter".to_owned(),
            found: other.to_owned(),
        }
        .into_py()),
    }
}

/// Return the voxels (n, 3) i, j, k of a path.
fn voxels_of(field: &VoxelField<'_>, nodes: &[u32]) -> Array2<i64> {
    let voxels = nodes.iter().flat_map(|n| field.voxel(*n).map(|v| v as i64));
    Array2::from_shape_vec((nodes.len(), 3), voxels.collect()).expect("3 a node")
}

/// Find the least-cost path to one target; return its voxels (n, 3) i, j, k, its cost and the number of settled voxels.
///
/// Return None if no path exists.
#[pyfunction]
#[pyo3(signature = (field_zyx, lps_from_ijk, root_ijk, target_ijk, *, cost, region_ijk=None, mask_zyx=None, cancel=None, progress=None))]
#[allow(
    clippy::too_many_arguments,
    reason = "keyword arguments of a Python function"
)]
fn aimed_field_path<'py>(
    py: Python<'py>,
    field_zyx: PyReadonlyArray3<'py, f32>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    root_ijk: [usize; 3],
    target_ijk: [usize; 3],
    cost: &str,
    region_ijk: Option<Region>,
    mask_zyx: Option<PyReadonlyArray3<'py, u8>>,
    cancel: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<Option<AimedTuple<'py>>> {
    let grid = arrays::grid(&field_zyx, &lps_from_ijk)?;
    let values = arrays::values("field_zyx", &field_zyx)?;
    let mask = mask_values(mask_zyx.as_ref(), &field_zyx)?;
    let by_voxel = is_by_voxel(cost)?;
    let watch = PyWatch::new(cancel, progress);
    let found = py
        .detach(|| {
            let field = voxel_field(&grid, values, region_ijk.as_ref(), mask)?;
            let target = node(&field, target_ijk)?;
            let path = if by_voxel {
                least_path::<EnterCost>(&field, root_ijk, target, &watch)?
            } else {
                least_path::<MeanCost>(&field, root_ijk, target, &watch)?
            };
            Ok(path.map(|path| (voxels_of(&field, &path.nodes), path.cost, path.num_settled)))
        })
        .map_err(|e: TrackError| watch.error(e))?;
    Ok(found.map(|(voxels, cost, settled)| (voxels.into_pyarray(py), cost, settled)))
}

fn voxel_field<'a>(
    grid: &Grid,
    values: &'a [f32],
    region: Option<&Region>,
    mask: Option<&'a [u8]>,
) -> Result<VoxelField<'a>, TrackError> {
    VoxelField::new(
        grid,
        values,
        region.map(|r| r.map(|(low, high)| low..high)),
        mask,
    )
}

fn node(field: &VoxelField<'_>, ijk: [usize; 3]) -> Result<u32, TrackError> {
    field
        .node_at_voxel(ijk)
        .ok_or_else(|| TrackError::Argument {
            what: "target",
            expected: "a voxel of the region".to_owned(),
            found: format!("{ijk:?}"),
        })
}

fn clocked(nodes: &[u32], path_to: impl Fn(u32) -> Option<Vec<u32>>) -> (Vec<f64>, Vec<i64>) {
    nodes
        .iter()
        .map(|&node| {
            let started = Instant::now();
            let path = path_to(node);
            let took = started.elapsed().as_nanos() as f64;
            (took, path.map_or(0, |path| path.len() as i64))
        })
        .unzip()
}

/// Measure the time in ns of one path query for each node of a lumen's tracker.
///
/// Return the times and the numbers of voxels of the paths.
#[pyfunction]
fn time_lumen_paths(
    py: Python<'_>,
    tracker: Py<LumenTracker>,
    nodes: Vec<u32>,
) -> PyResult<TimesAndLengths<'_>> {
    let tracker = tracker.get();
    for &node in &nodes {
        tracker.check(node)?;
    }
    let times = tracker.read(py, |t| clocked(&nodes, |n| t.path_to(n)));
    Ok((times.0.into_pyarray(py), times.1.into_pyarray(py)))
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<FieldTracker>()?;
    module.add_function(wrap_pyfunction!(aimed_field_path, module)?)?;
    module.add_function(wrap_pyfunction!(time_lumen_paths, module)?)?;
    Ok(())
}
