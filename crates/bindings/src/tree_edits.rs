//! Python bindings for the edits of an airway tree: updates of the lumen's graph, and queries of the graph.
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use std::sync::Arc;

use carina_airpath::tree::tree_edit;
use carina_grid::{Ijk, Lps, VolumeView};
use carina_leastcost::graph::Graph;
use carina_leastcost::lumen::LumenGraph;
use carina_leastcost::{TrackError, cheapest_way as cheapest, lumen_edit};
use numpy::ndarray::Array2;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use crate::airpath::{LumenTracker, points_array};
use crate::arrays;
use crate::errors::IntoPy;
use crate::points::{points, refused, voxels};
use crate::watch::PyWatch;

type Voxels<'py> = Bound<'py, PyArray2<u16>>;
/// Box of voxels: its first voxel and its shape, both in the order i, j, k.
type Corners = ([usize; 3], [usize; 3]);

fn nodes(tracker: &LumenTracker, array: &PyReadonlyArray1<'_, u32>) -> PyResult<Vec<u32>> {
    let found: Vec<u32> = array.as_array().to_vec();
    for node in &found {
        tracker.check(*node)?;
    }
    Ok(found)
}

fn voxel_array<'py>(py: Python<'py>, voxels: &[[u16; 3]]) -> Voxels<'py> {
    Array2::from_shape_fn((voxels.len(), 3), |(n, a)| voxels[n][a]).into_pyarray(py)
}

fn small(graph: &LumenGraph, node: u32) -> [u16; 3] {
    graph.voxel(node).map(|v| v as u16)
}

/// Create the tracker of a lumen after voxels were added and removed.
///
/// Return the tracker and the box (first voxel, shape) of the changes, or None without changes.
#[pyfunction]
#[pyo3(signature = (tracker, values_zyx, added_ijk, removed_ijk, *, cancel=None))]
fn edit_lumen(
    py: Python<'_>,
    tracker: &LumenTracker,
    values_zyx: PyReadonlyArray3<'_, i16>,
    added_ijk: PyReadonlyArray2<'_, u16>,
    removed_ijk: PyReadonlyArray2<'_, u16>,
    cancel: Option<Py<PyAny>>,
) -> PyResult<(LumenTracker, Option<Corners>)> {
    let shape = tracker.grid.shape_ijk();
    let data = arrays::values("values_zyx", &values_zyx)?;
    let view = VolumeView::new(data, &tracker.grid).map_err(IntoPy::into_py)?;
    let added = voxels("added_ijk", &added_ijk, shape)?;
    let removed = voxels("removed_ijk", &removed_ijk, shape)?;
    let watch = PyWatch::new(cancel, None);
    let (edited, solved) = py
        .detach(|| -> Result<_, TrackError> {
            let edited =
                lumen_edit::edit_graph(&tracker.graph, view, tracker.levels, &added, &removed)?;
            let old = tracker.lock();
            let solved = lumen_edit::costs_after_edit(&tracker.graph, &old, &edited, &watch)?;
            drop(old);
            Ok((edited, solved))
        })
        .map_err(|e| watch.error(e))?;
    let corners = edited.changed_box.map(|b| (b.first_ijk, b.shape_ijk));
    Ok((tracker.with(Arc::new(edited.graph), solved), corners))
}

/// Create the tracker of a whole lumen from scratch, with the wall levels of another tracker and the root at a voxel.
#[pyfunction]
#[pyo3(signature = (tracker, values_zyx, lumen_zyx, root_ijk, *, cancel=None))]
fn fresh_lumen(
    py: Python<'_>,
    tracker: &LumenTracker,
    values_zyx: PyReadonlyArray3<'_, i16>,
    lumen_zyx: PyReadonlyArray3<'_, u8>,
    root_ijk: [isize; 3],
    cancel: Option<Py<PyAny>>,
) -> PyResult<LumenTracker> {
    let data = arrays::values("values_zyx", &values_zyx)?;
    let lumen = arrays::values("lumen_zyx", &lumen_zyx)?;
    let view = VolumeView::new(data, &tracker.grid).map_err(IntoPy::into_py)?;
    if lumen.len() != data.len() {
        let expected = format!("{:?}", values_zyx.shape());
        return Err(refused(
            "lumen_zyx",
            &expected,
            format!("{:?}", lumen_zyx.shape()),
        ));
    }
    let watch = PyWatch::new(cancel, None);
    let (graph, solved) = py
        .detach(|| -> Result<_, TrackError> {
            let graph = LumenGraph::build(view, lumen, tracker.levels)?;
            let root = root_node(&graph, root_ijk)?;
            let solved = lumen_edit::costs_from_scratch(&graph, root, &watch)?;
            Ok((graph, solved))
        })
        .map_err(|e| watch.error(e))?;
    Ok(tracker.with(Arc::new(graph), solved))
}

fn root_node(graph: &LumenGraph, root_ijk: [isize; 3]) -> Result<u32, TrackError> {
    graph
        .node_at_voxel(root_ijk)
        .ok_or_else(|| TrackError::NoResult("the root is not in the airway lumen".to_owned()))
}

/// Create the tracker of the same lumen with another root.
#[pyfunction]
#[pyo3(signature = (tracker, root_ijk, *, cancel=None))]
fn reroot_lumen(
    py: Python<'_>,
    tracker: &LumenTracker,
    root_ijk: [isize; 3],
    cancel: Option<Py<PyAny>>,
) -> PyResult<LumenTracker> {
    let watch = PyWatch::new(cancel, None);
    let solved = py
        .detach(|| {
            let root = root_node(&tracker.graph, root_ijk)?;
            lumen_edit::costs_from_scratch(&tracker.graph, root, &watch)
        })
        .map_err(|e| watch.error(e))?;
    Ok(tracker.with(Arc::clone(&tracker.graph), solved))
}

/// Return the mask of a tracker's lumen, (nz, ny, nx), 1 inside.
#[pyfunction]
fn lumen_array<'py>(py: Python<'py>, tracker: &LumenTracker) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let bytes = py.detach(|| lumen_edit::as_bytes(&tracker.graph, &tracker.grid));
    bytes.into_pyarray(py).reshape(tracker.grid.shape_zyx())
}

/// Return the states of the voxels of a box, (nz, ny, nx).
///
/// The states are 0 (no lumen), 1 (lumen that no path reaches) and 2 (lumen that a path reaches).
#[pyfunction]
fn lumen_states<'py>(
    py: Python<'py>,
    tracker: &LumenTracker,
    first_ijk: [usize; 3],
    shape_ijk: [usize; 3],
) -> PyResult<Bound<'py, PyArray3<u8>>> {
    let [nx, ny, nz] = shape_ijk;
    let states: Vec<u8> = py.detach(|| {
        let solved = tracker.lock();
        (0..nx * ny * nz)
            .map(|at| {
                let local = [at % nx, at / nx % ny, at / nx / ny];
                let voxel = std::array::from_fn(|a| (first_ijk[a] + local[a]) as isize);
                tracker
                    .graph
                    .node_at_voxel(voxel)
                    .map_or(0, |node| 1 + u8::from(solved.cost_quanta(node).is_some()))
            })
            .collect()
    });
    states.into_pyarray(py).reshape([nz, ny, nx])
}

/// Return for each of (n, 3) LPS points the node (n,) whose voxel contains the point; -1 outside the lumen.
#[pyfunction]
fn nodes_at<'py>(
    py: Python<'py>,
    tracker: &LumenTracker,
    points_lps: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<i64>>> {
    let found: Vec<i64> = points("points_lps", &points_lps)?
        .into_iter()
        .map(|p| {
            let voxel = tracker
                .grid
                .to_ijk(Lps(p))
                .0
                .map(|v| (v + 0.5).floor() as isize);
            tracker.graph.node_at_voxel(voxel).map_or(-1, i64::from)
        })
        .collect();
    Ok(found.into_pyarray(py))
}

/// Return the voxels (n, 3) of nodes (n,).
#[pyfunction]
fn voxels_of<'py>(
    py: Python<'py>,
    tracker: &LumenTracker,
    nodes_of: PyReadonlyArray1<'py, u32>,
) -> PyResult<Voxels<'py>> {
    let found: Vec<[u16; 3]> = nodes(tracker, &nodes_of)?
        .into_iter()
        .map(|n| small(&tracker.graph, n))
        .collect();
    Ok(voxel_array(py, &found))
}

/// Return for each of (n,) nodes whether a path reaches it.
#[pyfunction]
fn reached<'py>(
    py: Python<'py>,
    tracker: &LumenTracker,
    nodes_of: PyReadonlyArray1<'py, u32>,
) -> PyResult<Bound<'py, PyArray1<bool>>> {
    let given = nodes(tracker, &nodes_of)?;
    let found: Vec<bool> = py.detach(|| {
        let solved = tracker.lock();
        given
            .iter()
            .map(|n| solved.cost_quanta(*n).is_some())
            .collect()
    });
    Ok(found.into_pyarray(py))
}

/// Return for each pair of (n, 3) LPS points whether the straight line between them stays in lumen voxels.
#[pyfunction]
fn sees<'py>(
    py: Python<'py>,
    tracker: &LumenTracker,
    from_lps: PyReadonlyArray2<'py, f64>,
    to_lps: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray1<bool>>> {
    let (from, to) = (points("from_lps", &from_lps)?, points("to_lps", &to_lps)?);
    if from.len() != to.len() {
        let expected = format!("{} points", from.len());
        return Err(refused("to_lps", &expected, to.len().to_string()));
    }
    let ijk = |p: [f64; 3]| tracker.grid.to_ijk(Lps(p)).0;
    let found: Vec<bool> = from
        .iter()
        .zip(&to)
        .map(|(p, q)| tracker.graph.sees(ijk(*p), ijk(*q)))
        .collect();
    Ok(found.into_pyarray(py))
}

/// Return (n, 3) LPS points with each point outside the lumen moved to the nearest position inside.
#[pyfunction]
fn pulled_inside<'py>(
    py: Python<'py>,
    tracker: &LumenTracker,
    points_lps: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let found: Vec<[f64; 3]> = points("points_lps", &points_lps)?
        .into_iter()
        .map(|p| {
            let ijk = tracker.grid.to_ijk(Lps(p)).0;
            if tracker.graph.holds(ijk) {
                return p;
            }
            let inside = tracker.graph.pulled_inside(&tracker.grid, ijk);
            tracker.grid.to_lps(Ijk(inside)).0
        })
        .collect();
    Ok(points_array(py, &found))
}

/// Return the voxels (n, 3) that paths reach in `tracker` but not in `other`.
#[pyfunction]
fn newly_reached<'py>(
    py: Python<'py>,
    tracker: &LumenTracker,
    other: &LumenTracker,
) -> Voxels<'py> {
    let found = py.detach(|| {
        // The two trackers are read one after the other, because holding both locks at once could deadlock.
        let is_reached = |t: &LumenTracker| -> Vec<bool> {
            let solved = t.lock();
            (0..t.graph.num_nodes() as u32)
                .map(|n| solved.cost_quanta(n).is_some())
                .collect()
        };
        let (new, old) = (is_reached(tracker), is_reached(other));
        lumen_edit::newly_reached((&tracker.graph, &new), (&other.graph, &old))
    });
    voxel_array(py, &found)
}

/// Return the voxels (n, 3) that belong to the tubes of the branches to cut and not to those that remain.
///
/// `cut` and `kept` are the nodes on the centrelines of these branches.
#[pyfunction]
fn cut_voxels<'py>(
    py: Python<'py>,
    tracker: &LumenTracker,
    cut: PyReadonlyArray1<'py, u32>,
    kept: PyReadonlyArray1<'py, u32>,
) -> PyResult<Voxels<'py>> {
    let (cut, kept) = (nodes(tracker, &cut)?, nodes(tracker, &kept)?);
    let found: Vec<[u16; 3]> = py.detach(|| {
        tree_edit::cut_nodes(&tracker.graph, &tracker.grid, &cut, &kept)
            .into_iter()
            .map(|n| small(&tracker.graph, n))
            .collect()
    });
    Ok(voxel_array(py, &found))
}

/// Return the nodes (n,) at the tips of branches in the candidate voxels that a tree does not contain, longest path
/// first.
///
/// `tree_nodes` are the nodes on the centrelines of the tree.
#[pyfunction]
#[pyo3(signature = (tracker, tree_nodes, candidates_ijk, *, cancel=None))]
fn more_tips<'py>(
    py: Python<'py>,
    tracker: &LumenTracker,
    tree_nodes: PyReadonlyArray1<'py, u32>,
    candidates_ijk: PyReadonlyArray2<'py, u16>,
    cancel: Option<Py<PyAny>>,
) -> PyResult<Bound<'py, PyArray1<u32>>> {
    let tree_nodes = nodes(tracker, &tree_nodes)?;
    let candidates: Vec<u32> = voxels("candidates_ijk", &candidates_ijk, tracker.grid.shape_ijk())?
        .into_iter()
        .filter_map(|v| tracker.graph.node_at_voxel(v.map(|x| x as isize)))
        .collect();
    let watch = PyWatch::new(cancel, None);
    let tips = py
        .detach(|| {
            let solved = tracker.lock();
            tree_edit::more_tips(
                &tracker.graph,
                &solved,
                &tracker.grid,
                &tree_nodes,
                &candidates,
                &watch,
            )
        })
        .map_err(|e| watch.error(e))?;
    Ok(tips.into_pyarray(py))
}

/// Return the voxels (n, 3) of the least-cost path in a box from the nearest goal to a start; None if no path exists.
#[pyfunction]
#[pyo3(signature = (weights_zyx, goals_zyx, spacing_mm, start_ijk, *, cancel=None))]
fn cheapest_way<'py>(
    py: Python<'py>,
    weights_zyx: PyReadonlyArray3<'py, f32>,
    goals_zyx: PyReadonlyArray3<'py, u8>,
    spacing_mm: [f64; 3],
    start_ijk: [usize; 3],
    cancel: Option<Py<PyAny>>,
) -> PyResult<Option<Voxels<'py>>> {
    let weights = arrays::values("weights_zyx", &weights_zyx)?;
    let goals = arrays::values("goals_zyx", &goals_zyx)?;
    let shape = weights_zyx.shape();
    let shape_ijk = [shape[2], shape[1], shape[0]];
    if goals_zyx.shape() != shape || (0..3).any(|a| start_ijk[a] >= shape_ijk[a]) {
        let found = format!("goals {:?}, start {start_ijk:?}", goals_zyx.shape());
        return Err(refused(
            "goals_zyx, start_ijk",
            &format!("inside {shape:?}"),
            found,
        ));
    }
    let watch = PyWatch::new(cancel, None);
    let way = py
        .detach(|| cheapest::cheapest_way(shape_ijk, spacing_mm, weights, goals, start_ijk, &watch))
        .map_err(|e| watch.error(e))?;
    Ok(way.map(|way| {
        let found: Vec<[u16; 3]> = way.voxels.iter().map(|v| v.map(|x| x as u16)).collect();
        voxel_array(py, &found)
    }))
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    for function in [
        wrap_pyfunction!(edit_lumen, module)?,
        wrap_pyfunction!(fresh_lumen, module)?,
        wrap_pyfunction!(reroot_lumen, module)?,
        wrap_pyfunction!(lumen_array, module)?,
        wrap_pyfunction!(lumen_states, module)?,
        wrap_pyfunction!(nodes_at, module)?,
        wrap_pyfunction!(voxels_of, module)?,
        wrap_pyfunction!(reached, module)?,
        wrap_pyfunction!(sees, module)?,
        wrap_pyfunction!(pulled_inside, module)?,
        wrap_pyfunction!(newly_reached, module)?,
        wrap_pyfunction!(cut_voxels, module)?,
        wrap_pyfunction!(more_tips, module)?,
        wrap_pyfunction!(cheapest_way, module)?,
    ] {
        module.add_function(function)?;
    }
    Ok(())
}
