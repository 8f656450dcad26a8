//! Python bindings of `carina-airpath` and of the tracker of the lumen.
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use std::sync::{Arc, Mutex, PoisonError};

use carina_airpath::find::flood::{FloodLimits, flood};
use carina_airpath::find::trachea::{AirLevels, Doubt, find_trachea};
use carina_airpath::tree::branch::{self, Branch};
use carina_airpath::tree::branch_radii;
use carina_airpath::tree::branches::{self, BranchLimits};
use carina_airpath::tree::smooth::Point;
use carina_grid::{Grid, Ijk, Lps, VolumeView};
use carina_leastcost::graph::{Graph, NO_NODE};
use carina_leastcost::lumen::{LumenCost, LumenGraph, WallLevels};
use carina_leastcost::tracker::Tracker;
use carina_leastcost::{TrackError, Watch};
use numpy::ndarray::Array2;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::arrays;
use crate::errors::{IntoPy, carina_error};
use crate::points::points;
use crate::watch::PyWatch;

impl IntoPy for TrackError {
    fn into_py(self) -> PyErr {
        let class = match self {
            Self::Cancelled => "CancelledError",
            Self::NoResult(_) => "NoResultError",
            Self::Argument { .. } => "UsageError",
            Self::CostRange { .. } | Self::CostOverflow { .. } => "TrackingError",
        };
        carina_error(class, self.code(), &self.to_string())
    }
}

impl Watch for PyWatch {
    fn report_fraction(&self, fraction: f64) -> Result<(), TrackError> {
        if self.should_continue(fraction) {
            Ok(())
        } else {
            Err(TrackError::Cancelled)
        }
    }
}

const fn doubt_name(doubt: Doubt) -> &'static str {
    match doubt {
        Doubt::CutOff => "cut-off",
        Doubt::NarrowBronchus => "narrow-bronchus",
        Doubt::OneBronchus => "one-bronchus",
        Doubt::OneLung => "one-lung",
    }
}

/// Find the trachea of a volume; return a dict of `voxels_ijk`, `diameters_mm`, `length_mm`, `carina_lps`, `doubts`.
#[pyfunction]
#[pyo3(signature = (values_zyx, lps_from_ijk, *, air, tissue, lung, cancel=None))]
fn find_trachea_voxels<'py>(
    py: Python<'py>,
    values_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    air: i16,
    tissue: i16,
    lung: Option<(i16, i16)>,
    cancel: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyDict>> {
    let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
    let data = arrays::values("values_zyx", &values_zyx)?;
    let view = VolumeView::new(data, &grid).map_err(IntoPy::into_py)?;
    let watch = PyWatch::new(cancel, None);
    let found = py
        .detach(|| find_trachea(view, AirLevels { air, tissue, lung }, &watch))
        .map_err(|e| watch.error(e))?;
    let dict = PyDict::new(py);
    let voxels: Vec<[f64; 3]> = found.voxels.iter().map(|v| v.map(|x| x as f64)).collect();
    dict.set_item("voxels_ijk", points_array(py, &voxels))?;
    dict.set_item("diameters_mm", found.diameters_mm.into_pyarray(py))?;
    dict.set_item("length_mm", found.length_mm)?;
    dict.set_item("carina_lps", found.carina_lps.to_vec().into_pyarray(py))?;
    let doubts: Vec<&str> = found.doubts.iter().map(|d| doubt_name(*d)).collect();
    dict.set_item("doubts", doubts)?;
    Ok(dict)
}

/// Flood the airways from seed voxels; return the lumen (1 or 0) and a dict about closed leaks and rejected basins.
#[pyfunction]
#[pyo3(signature = (values_zyx, lps_from_ijk, seeds_ijk, *, first_level, core_level, last_level, leak_mm3, small_leak_mm3, closed_radius_mm, min_contrast, cancel=None, progress=None))]
fn flood_lumen<'py>(
    py: Python<'py>,
    values_zyx: PyReadonlyArray3<'py, i16>,
    lps_from_ijk: PyReadonlyArray2<'py, f64>,
    seeds_ijk: Vec<[usize; 3]>,
    first_level: i16,
    core_level: i16,
    last_level: i16,
    leak_mm3: f64,
    small_leak_mm3: f64,
    closed_radius_mm: f64,
    min_contrast: f64,
    cancel: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Bound<'py, PyArray3<u8>>, Bound<'py, PyDict>)> {
    let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
    let data = arrays::values("values_zyx", &values_zyx)?;
    let view = VolumeView::new(data, &grid).map_err(IntoPy::into_py)?;
    let shape = grid.shape_ijk();
    if let Some(seed) = seeds_ijk.iter().find(|s| (0..3).any(|a| s[a] >= shape[a])) {
        return Err(TrackError::Argument {
            what: "seed voxel",
            expected: format!("below {shape:?}"),
            found: format!("{seed:?}"),
        }
        .into_py());
    }
    let limits = FloodLimits {
        first_level,
        core_level,
        last_level,
        leak_mm3,
        small_leak_mm3,
        closed_radius_mm,
        min_contrast,
    };
    let watch = PyWatch::new(cancel, progress);
    let found = py
        .detach(|| flood(view, &seeds_ijk, &limits, &watch))
        .map_err(|e| watch.error(e))?;
    let report = PyDict::new(py);
    report.set_item("num_voxels", found.num_voxels)?;
    report.set_item("num_without_wall", found.num_without_wall)?;
    let leaks = PyList::empty(py);
    for (voxel, level) in found.leaks {
        leaks.append((grid.to_lps(Ijk(voxel.map(|v| v as f64))).0, level))?;
    }
    report.set_item("leaks", leaks)?;
    let [nz, ny, nx] = grid.shape_zyx();
    let lumen = found
        .lumen
        .into_pyarray(py)
        .call_method1("reshape", ((nz, ny, nx),))?
        .cast_into::<PyArray3<u8>>()?;
    Ok((lumen, report))
}

type PointsAndNodes<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<u32>>);

/// Graph of the lumen's voxels, with the tree of least-cost paths from one root.
#[pyclass(frozen, module = "carina._core")]
pub(crate) struct LumenTracker {
    pub(crate) grid: Grid,
    pub(crate) graph: Arc<LumenGraph>,
    pub(crate) tracker: Mutex<Tracker>,
    pub(crate) levels: Option<WallLevels>,
}

#[pymethods]
impl LumenTracker {
    #[new]
    #[pyo3(signature = (values_zyx, lps_from_ijk, lumen_zyx, *, levels, root_lps, reach_mm))]
    fn new(
        py: Python<'_>,
        values_zyx: PyReadonlyArray3<'_, i16>,
        lps_from_ijk: PyReadonlyArray2<'_, f64>,
        lumen_zyx: PyReadonlyArray3<'_, u8>,
        levels: Option<(f32, f32, f32)>,
        root_lps: [f64; 3],
        reach_mm: f64,
    ) -> PyResult<Self> {
        let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
        let data = arrays::values("values_zyx", &values_zyx)?;
        let lumen = arrays::values("lumen_zyx", &lumen_zyx)?;
        if lumen.len() != data.len() || lumen_zyx.shape() != values_zyx.shape() {
            return Err(TrackError::Argument {
                what: "lumen_zyx",
                expected: format!("the volume's shape {:?}", values_zyx.shape()),
                found: format!("{:?}", lumen_zyx.shape()),
            }
            .into_py());
        }
        let levels = levels.map(|(core, wall, rise)| WallLevels { core, wall, rise });
        let (graph, tracker) = py
            .detach(|| {
                let view = VolumeView::new(data, &grid).map_err(|e| TrackError::Argument {
                    what: "volume",
                    expected: "a full array".to_owned(),
                    found: e.to_string(),
                })?;
                let graph = LumenGraph::build(view, lumen, levels)?;
                let root_ijk = grid.to_ijk(Lps(root_lps)).0;
                let (root, _) = graph
                    .nearest_node(&grid, root_ijk, reach_mm)
                    .ok_or_else(|| {
                        TrackError::NoResult(format!(
                            "the root {root_lps:?} is not within {reach_mm} mm of the airway lumen"
                        ))
                    })?;
                let tracker = Tracker::new(&graph, &LumenCost(&graph), root)?;
                Ok((graph, tracker))
            })
            .map_err(TrackError::into_py)?;
        Ok(Self {
            grid,
            graph: Arc::new(graph),
            tracker: Mutex::new(tracker),
            levels,
        })
    }

    #[getter]
    fn num_nodes(&self) -> usize {
        self.graph.num_nodes()
    }

    #[getter]
    fn num_settled(&self, py: Python<'_>) -> usize {
        self.read(py, |t| t.settled().len())
    }

    /// Path cost that one unit (quantum) of the integer costs represents, in weight times mm.
    #[getter]
    fn quantum(&self, py: Python<'_>) -> f64 {
        self.read(py, |t| t.quantum().cost)
    }

    #[getter]
    fn root(&self, py: Python<'_>) -> u32 {
        self.read(py, Tracker::root)
    }

    /// Return the lumen node nearest to a point (LPS mm) and its distance in mm; None if no node is within `reach_mm`.
    fn nearest(&self, py: Python<'_>, point_lps: [f64; 3], reach_mm: f64) -> Option<(u32, f64)> {
        let ijk = self.grid.to_ijk(Lps(point_lps)).0;
        py.detach(|| self.graph.nearest_node(&self.grid, ijk, reach_mm))
    }

    /// Settle nodes in the order of their cost until the given node is settled; return True if a path from the root
    /// exists.
    #[pyo3(signature = (node, *, cancel=None, progress=None))]
    fn solve_to(
        &self,
        py: Python<'_>,
        node: u32,
        cancel: Option<Py<PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<bool> {
        self.check(node)?;
        let watch = PyWatch::new(cancel, progress);
        py.detach(|| {
            self.lock()
                .solve_to(&*self.graph, &LumenCost(&self.graph), node, &watch)
        })
        .map_err(|e| watch.error(e))
    }

    /// Settle all nodes that a path from the root can reach.
    #[pyo3(signature = (*, cancel=None, progress=None))]
    fn solve_all(
        &self,
        py: Python<'_>,
        cancel: Option<Py<PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<()> {
        let watch = PyWatch::new(cancel, progress);
        py.detach(|| {
            self.lock()
                .solve_all(&*self.graph, &LumenCost(&self.graph), &watch)
        })
        .map_err(|e| watch.error(e))
    }

    /// Return the least cost of a settled node; None for a node that is not settled.
    fn cost(&self, py: Python<'_>, node: u32) -> PyResult<Option<f64>> {
        self.check(node)?;
        Ok(self.read(py, |t| t.cost(node)))
    }

    /// Return the voxel centres (n, 3) LPS from the root to a settled node, and their nodes.
    fn path<'py>(&self, py: Python<'py>, node: u32) -> PyResult<Option<PointsAndNodes<'py>>> {
        self.check(node)?;
        Ok(self.read(py, |t| t.path_to(node)).map(|nodes| {
            let points: Vec<Point> = nodes.iter().map(|n| self.point(*n)).collect();
            (points_array(py, &points), nodes.into_pyarray(py))
        }))
    }

    /// Smooth a line of (n, 3) LPS points; every result is in a lumen voxel if every given point is.
    #[pyo3(signature = (points_lps, *, step_mm, keep_end))]
    fn smooth<'py>(
        &self,
        py: Python<'py>,
        points_lps: Vec<[f64; 3]>,
        step_mm: f64,
        keep_end: bool,
    ) -> Bound<'py, PyArray2<f64>> {
        let (curve, _) = py.detach(|| {
            branch::smooth_inside(&self.graph, &self.grid, &points_lps, step_mm, keep_end)
        });
        points_array(py, &curve)
    }

    /// Return the distances (n,) from LPS points (n, 3) to the nearest wall, in mm; 0 outside the lumen.
    fn radius_mm<'py>(
        &self,
        py: Python<'py>,
        points_lps: Vec<[f64; 3]>,
    ) -> Bound<'py, PyArray1<f64>> {
        let radius: Vec<f64> = points_lps.iter().map(|p| self.radius_at(*p)).collect();
        radius.into_pyarray(py)
    }

    /// Return, for each branch whose item of `wanted` is True, the radii in mm of circles with the area of the lumen's
    /// cross-sections along the branch; None for other branches.
    ///
    /// `lines_lps` has the (n, 3) LPS points of all branches, and `parents` the index of each branch's parent in this
    /// list.
    fn section_radii<'py>(
        &self,
        py: Python<'py>,
        lines_lps: Vec<PyReadonlyArray2<'py, f64>>,
        parents: Vec<Option<usize>>,
        wanted: Vec<bool>,
    ) -> PyResult<Vec<Option<Bound<'py, PyArray1<f64>>>>> {
        let count = lines_lps.len();
        let mut lines = Vec::with_capacity(count);
        for line in &lines_lps {
            lines.push(points("lines_lps", line)?);
        }
        let is_parent = |p: &usize| *p < count;
        if parents.len() != count
            || wanted.len() != count
            || !parents.iter().flatten().all(is_parent)
        {
            return Err(TrackError::Argument {
                what: "parents",
                expected: "the place of a branch in the list for each branch".to_owned(),
                found: format!(
                    "{count} branches, {} parents, {} wanted",
                    parents.len(),
                    wanted.len()
                ),
            }
            .into_py());
        }
        let calibres = py.detach(|| {
            branch_radii::of_branches(&self.graph, &self.grid, &lines, &parents, |b| wanted[b])
        });
        Ok(calibres
            .into_iter()
            .map(|c| c.map(|c| c.section_mm.into_pyarray(py)))
            .collect())
    }

    /// Return for each of (n, 3) LPS points whether the voxel that contains it is lumen.
    fn inside<'py>(
        &self,
        py: Python<'py>,
        points_lps: Vec<[f64; 3]>,
    ) -> Bound<'py, PyArray1<bool>> {
        let inside: Vec<bool> = points_lps.iter().map(|p| self.holds(*p)).collect();
        inside.into_pyarray(py)
    }

    /// Return the branches of the automatic tree of all settled nodes: a list of dicts, parents first.
    #[pyo3(signature = (*, cancel=None, progress=None))]
    fn branches<'py>(
        &self,
        py: Python<'py>,
        cancel: Option<Py<PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Bound<'py, PyList>> {
        let watch = PyWatch::new(cancel, progress);
        let limits = BranchLimits::for_grid(&self.grid);
        let branches = py
            .detach(|| {
                branches::find_branches(&self.graph, &self.lock(), &self.grid, &limits, &watch)
            })
            .map_err(|e| watch.error(e))?;
        self.branch_list(py, &branches)
    }

    /// Return the branches of the automatic tree that lead to the given settled nodes.
    ///
    /// `branch_nodes` has the nodes of all branches of the automatic tree.
    fn branches_to<'py>(
        &self,
        py: Python<'py>,
        nodes: Vec<u32>,
        branch_nodes: Vec<Vec<u32>>,
        parents: Vec<Option<usize>>,
    ) -> PyResult<Bound<'py, PyList>> {
        for &node in &nodes {
            self.check(node)?;
        }
        let automatic = self.as_branches(branch_nodes, parents)?;
        let limits = BranchLimits::for_grid(&self.grid);
        let branches = py.detach(|| {
            branches::branches_to(
                &self.graph,
                &self.lock(),
                &self.grid,
                &limits,
                &nodes,
                &automatic,
            )
        });
        self.branch_list(py, &branches)
    }

    /// Return for each lumen node the index of the branch whose tube contains it; -1 if the node is connected to no
    /// branch.
    fn branch_of_nodes<'py>(
        &self,
        py: Python<'py>,
        branch_nodes: Vec<Vec<u32>>,
        parents: Vec<Option<usize>>,
    ) -> PyResult<Bound<'py, PyArray1<i32>>> {
        let branches = self.as_branches(branch_nodes, parents)?;
        let found = py.detach(|| branches::branch_of_nodes(&self.graph, &branches));
        let signed: Vec<i32> = found
            .into_iter()
            .map(|b| if b == NO_NODE { -1 } else { b as i32 })
            .collect();
        Ok(signed.into_pyarray(py))
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!(
            "LumenTracker(num_nodes={}, num_settled={})",
            self.num_nodes(),
            self.num_settled(py)
        )
    }
}

impl LumenTracker {
    /// Return this tracker's settings with another, solved graph on the same grid with the same wall levels.
    pub(crate) fn with(&self, graph: Arc<LumenGraph>, solved: Tracker) -> Self {
        Self {
            grid: self.grid.clone(),
            graph,
            tracker: Mutex::new(solved),
            levels: self.levels,
        }
    }

    pub(crate) fn lock(&self) -> std::sync::MutexGuard<'_, Tracker> {
        // A stopped search leaves the tracker consistent, because it stops between nodes. A panic is reported elsewhere
        // as a bug, so a poisoned lock is usable.
        self.tracker.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Call `read` with the locked tracker and return its result.
    ///
    /// The GIL is released before the lock is taken, because the thread that has the lock may wait for the GIL to call
    /// `cancel()`.
    pub(crate) fn read<T: Send>(
        &self,
        py: Python<'_>,
        read: impl FnOnce(&Tracker) -> T + Send,
    ) -> T {
        py.detach(|| read(&self.lock()))
    }

    pub(crate) fn check(&self, node: u32) -> PyResult<()> {
        if (node as usize) < self.graph.num_nodes() {
            return Ok(());
        }
        Err(TrackError::Argument {
            what: "node",
            expected: format!("below {}", self.graph.num_nodes()),
            found: node.to_string(),
        }
        .into_py())
    }

    fn as_branches(
        &self,
        branch_nodes: Vec<Vec<u32>>,
        parents: Vec<Option<usize>>,
    ) -> PyResult<Vec<Branch>> {
        for nodes in &branch_nodes {
            if nodes.is_empty() || branch_nodes.len() != parents.len() {
                return Err(TrackError::Argument {
                    what: "branch_nodes",
                    expected: "nodes and a parent for every branch".to_owned(),
                    found: format!("{} branches, {} parents", branch_nodes.len(), parents.len()),
                }
                .into_py());
            }
            for &node in nodes {
                self.check(node)?;
            }
        }
        Ok(branch_nodes
            .into_iter()
            .zip(parents)
            .map(|(nodes, parent)| Branch {
                parent,
                generation: 0,
                nodes,
                points: Vec::new(),
                radius_mm: Vec::new(),
                wall_mm: Vec::new(),
            })
            .collect())
    }

    fn point(&self, node: u32) -> Point {
        self.grid
            .to_lps(Ijk(self.graph.voxel(node).map(|v| v as f64)))
            .0
    }

    fn holds(&self, lps: Point) -> bool {
        self.graph.holds(self.grid.to_ijk(Lps(lps)).0)
    }

    fn radius_at(&self, lps: Point) -> f64 {
        branch::radius_mm(&self.graph, &self.grid, lps)
    }

    fn branch_list<'py>(
        &self,
        py: Python<'py>,
        branches: &[Branch],
    ) -> PyResult<Bound<'py, PyList>> {
        let list = PyList::empty(py);
        let costs: Vec<Option<f64>> = self.read(py, |tracker| {
            branches
                .iter()
                .map(|branch| {
                    let (first, last) = (branch.nodes[0], branch.nodes[branch.nodes.len() - 1]);
                    Some(tracker.cost(last)? - tracker.cost(first)?)
                })
                .collect()
        });
        for (branch, cost) in branches.iter().zip(costs) {
            let dict = PyDict::new(py);
            dict.set_item("parent", branch.parent)?;
            dict.set_item("generation", branch.generation)?;
            dict.set_item("points", points_array(py, &branch.points))?;
            dict.set_item("radius_mm", branch.radius_mm.clone().into_pyarray(py))?;
            dict.set_item("wall_mm", branch.wall_mm.clone().into_pyarray(py))?;
            dict.set_item("cost", cost)?;
            dict.set_item("nodes", branch.nodes.clone().into_pyarray(py))?;
            list.append(dict)?;
        }
        Ok(list)
    }
}

pub(crate) fn points_array<'py>(py: Python<'py>, points: &[Point]) -> Bound<'py, PyArray2<f64>> {
    Array2::from_shape_fn((points.len(), 3), |(n, a)| points[n][a]).into_pyarray(py)
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(find_trachea_voxels, module)?)?;
    module.add_function(wrap_pyfunction!(flood_lumen, module)?)?;
    module.add_class::<LumenTracker>()?;
    Ok(())
}
