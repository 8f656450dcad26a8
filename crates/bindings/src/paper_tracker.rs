//! Python bindings of the tracker for any combination of a cost and a graph (paper 6.1, 6.2).
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use carina_grid::{Grid, Ijk, Lps, VolumeView};
use carina_leastcost::TrackError;
use carina_leastcost::distance::VoxelBox;
use carina_leastcost::graph_tracker::{GraphTracker as Inner, Labels, Terrain};
use carina_leastcost::lumen::WallLevels;
use carina_leastcost::paper_cost::Reading;
use numpy::ndarray::Array2;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::arrays;
use crate::errors::IntoPy;
use crate::watch::PyWatch;

type PointsAndNodes<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<u32>>);

/// Graph with an edge cost, and the tree of least-cost paths from one root.
#[pyclass(frozen, module = "carina._core")]
struct GraphTracker {
    grid: Grid,
    inner: Mutex<Inner>,
    build_s: f64,
}

fn refused(what: &'static str, expected: &str, found: &str) -> PyErr {
    TrackError::Argument {
        what,
        expected: expected.to_owned(),
        found: found.to_owned(),
    }
    .into_py()
}

#[pymethods]
impl GraphTracker {
    #[new]
    #[pyo3(signature = (values_zyx, lps_from_ijk, *, cost, labels, box_ijk, lumen_zyx, levels, root_lps, reach_mm, cancel=None, progress=None))]
    fn new(
        py: Python<'_>,
        values_zyx: PyReadonlyArray3<'_, i16>,
        lps_from_ijk: PyReadonlyArray2<'_, f64>,
        cost: &str,
        labels: Option<&str>,
        box_ijk: ([usize; 3], [usize; 3]),
        lumen_zyx: Option<PyReadonlyArray3<'_, u8>>,
        levels: Option<(f32, f32, f32)>,
        root_lps: [f64; 3],
        reach_mm: f64,
        cancel: Option<Py<PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
        let data = arrays::values("values_zyx", &values_zyx)?;
        let lumen = match &lumen_zyx {
            Some(lumen) if lumen.shape() != values_zyx.shape() => {
                let expected = format!("the volume's shape {:?}", values_zyx.shape());
                return Err(refused(
                    "lumen_zyx",
                    &expected,
                    &format!("{:?}", lumen.shape()),
                ));
            }
            Some(lumen) => Some(arrays::values("lumen_zyx", lumen)?),
            None => None,
        };
        let terrain = match cost {
            "paper" | "walls" => {
                let voxel_box = VoxelBox {
                    first_ijk: box_ijk.0,
                    shape_ijk: box_ijk.1,
                };
                let reading = if cost == "walls" {
                    Reading::Walls
                } else {
                    Reading::Printed
                };
                Terrain::Paper(voxel_box, reading)
            }
            "lumen" => {
                Terrain::Lumen(levels.map(|(core, wall, rise)| WallLevels { core, wall, rise }))
            }
            other => return Err(refused("cost", "lumen, walls or paper", other)),
        };
        let pruned = match labels {
            None => None,
            Some("bins") => Some(Labels::Bins),
            Some("lumen") => Some(Labels::Lumen),
            Some(other) => return Err(refused("labels", "bins, lumen or None", other)),
        };
        let watch = PyWatch::new(cancel, progress);
        let (inner, build_s) = py
            .detach(|| {
                let view = VolumeView::new(data, &grid).map_err(|e| TrackError::Argument {
                    what: "volume",
                    expected: "a full array".to_owned(),
                    found: e.to_string(),
                })?;
                let started = Instant::now();
                let root_ijk = grid.to_ijk(Lps(root_lps)).0;
                let inner = Inner::build(view, terrain, pruned, lumen, root_ijk, reach_mm, &watch)?;
                Ok((inner, started.elapsed().as_secs_f64()))
            })
            .map_err(|e: TrackError| watch.error(e))?;
        Ok(Self {
            grid,
            inner: Mutex::new(inner),
            build_s,
        })
    }

    /// Time that the construction of the graph and the cost took, s.
    #[getter]
    const fn build_s(&self) -> f64 {
        self.build_s
    }

    #[getter]
    fn num_nodes(&self, py: Python<'_>) -> usize {
        self.read(py, Inner::num_nodes)
    }

    #[getter]
    fn num_centres(&self, py: Python<'_>) -> usize {
        self.read(py, Inner::num_centres)
    }

    #[getter]
    fn num_settled(&self, py: Python<'_>) -> usize {
        self.read(py, |inner| inner.tracker().settled().len())
    }

    /// Path cost that one unit (quantum) of the integer costs represents, in weight times mm.
    #[getter]
    fn quantum(&self, py: Python<'_>) -> f64 {
        self.read(py, |inner| inner.tracker().quantum().cost)
    }

    #[getter]
    fn root(&self, py: Python<'_>) -> u32 {
        self.read(py, |inner| inner.tracker().root())
    }

    /// Count the undirected edges of the graph one by one.
    fn num_edges(&self, py: Python<'_>) -> u64 {
        self.read(py, Inner::num_edges)
    }

    /// Find the node that represents a point (LPS mm).
    ///
    /// Return the node, the centre (LPS) of the voxel chosen for the point, and the distance in mm from that centre to
    /// the node; None if there is no node.
    fn place(
        &self,
        py: Python<'_>,
        point_lps: [f64; 3],
        reach_mm: f64,
    ) -> Option<(u32, [f64; 3], f64)> {
        let ijk = self.grid.to_ijk(Lps(point_lps)).0;
        let place = self.read(py, |inner| inner.place(ijk, reach_mm))?;
        let centre = self.grid.to_lps(Ijk(place.voxel.map(|v| v as f64))).0;
        Some((place.node, centre, place.to_node_mm))
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
        self.check(py, node)?;
        let watch = PyWatch::new(cancel, progress);
        py.detach(|| self.lock().solve_to(node, &watch))
            .map_err(|e| watch.error(e))
    }

    /// Return the least cost of a settled node; None for a node that is not settled.
    fn cost(&self, py: Python<'_>, node: u32) -> PyResult<Option<f64>> {
        self.check(py, node)?;
        Ok(self.read(py, |inner| inner.tracker().cost(node)))
    }

    /// Return the voxel centres (n, 3) LPS from the root to a settled node, and their nodes.
    fn path<'py>(&self, py: Python<'py>, node: u32) -> PyResult<Option<PointsAndNodes<'py>>> {
        self.check(py, node)?;
        let found = self.read(py, |inner| {
            let nodes = inner.tracker().path_to(node)?;
            let voxels: Vec<[usize; 3]> = nodes.iter().map(|n| inner.voxel(*n)).collect();
            Some((voxels, nodes))
        });
        Ok(found.map(|(voxels, nodes)| {
            let points: Vec<[f64; 3]> = voxels
                .into_iter()
                .map(|voxel| self.grid.to_lps(Ijk(voxel.map(|v| v as f64))).0)
                .collect();
            let points = Array2::from_shape_fn((points.len(), 3), |(n, a)| points[n][a]);
            (points.into_pyarray(py), nodes.into_pyarray(py))
        }))
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        format!(
            "GraphTracker(num_nodes={}, num_settled={})",
            self.num_nodes(py),
            self.num_settled(py)
        )
    }
}

impl GraphTracker {
    fn lock(&self) -> std::sync::MutexGuard<'_, Inner> {
        // A stopped search leaves the tracker consistent, because it stops between nodes. A panic is reported elsewhere
        // as a bug, so a poisoned lock is usable.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Call `read` with the locked tracker and return its result.
    ///
    /// The GIL is released before the lock is taken, because the thread that has the lock may wait for the GIL to call
    /// `cancel()`.
    fn read<T: Send>(&self, py: Python<'_>, read: impl FnOnce(&Inner) -> T + Send) -> T {
        py.detach(|| read(&self.lock()))
    }

    fn check(&self, py: Python<'_>, node: u32) -> PyResult<()> {
        let num_nodes = self.num_nodes(py);
        if (node as usize) < num_nodes {
            return Ok(());
        }
        Err(refused(
            "node",
            &format!("below {num_nodes}"),
            &node.to_string(),
        ))
    }
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<GraphTracker>()
}
