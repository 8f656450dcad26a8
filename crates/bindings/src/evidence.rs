//! Python binding of the evidence that the CT shows for an airway along a path.
#![allow(
    clippy::needless_pass_by_value,
    reason = "pyo3 hands arguments over by value"
)]

use carina_airpath::find::evidence_path::{
    Enclosures as Core, EvidencePath, PreferredTips, WayLevels,
};
use carina_grid::{Lps, VolumeView};
use carina_leastcost::{TrackError, Unwatched};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use rayon::prelude::*;

use crate::airpath::LumenTracker;
use crate::arrays;
use crate::errors::IntoPy;
use crate::points::{points, voxels};
use crate::watch::PyWatch;

/// Smoothed volume with the enclosure of its voxels: the rise of the values on all but a fifth of the rays from a
/// voxel.
#[pyclass(frozen, module = "carina._core")]
pub(crate) struct Enclosures {
    core: Core,
}

#[pymethods]
impl Enclosures {
    #[new]
    fn new(
        py: Python<'_>,
        values_zyx: PyReadonlyArray3<'_, i16>,
        lps_from_ijk: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        let grid = arrays::grid(&values_zyx, &lps_from_ijk)?;
        let data = arrays::values("values_zyx", &values_zyx)?;
        let view = VolumeView::new(data, &grid).map_err(IntoPy::into_py)?;
        Ok(Self {
            core: py.detach(|| Core::new(view)),
        })
    }

    fn __repr__(&self) -> String {
        format!("Enclosures(shape_ijk={:?})", self.core.grid().shape_ijk())
    }

    /// Return the enclosure (n,) of each of (n, 3) voxels.
    fn at<'py>(
        &self,
        py: Python<'py>,
        voxels_ijk: PyReadonlyArray2<'py, u16>,
    ) -> PyResult<Bound<'py, PyArray1<i16>>> {
        let given = voxels("voxels_ijk", &voxels_ijk, self.core.grid().shape_ijk())?;
        let found: Vec<i16> = py.detach(|| {
            given
                .par_iter()
                .map(|v| self.core.at(v.map(usize::from)))
                .collect()
        });
        Ok(found.into_pyarray(py))
    }

    /// Return the trilinear values (n,) of the smoothed volume at (n, 3) LPS points.
    ///
    /// Outside the volume the nearest edge value is used.
    fn values_at<'py>(
        &self,
        py: Python<'py>,
        points_lps: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let given = points("points_lps", &points_lps)?;
        let found: Vec<f32> = py.detach(|| {
            given
                .into_iter()
                .map(|p| self.core.value_at(self.core.grid().to_ijk(Lps(p)).0))
                .collect()
        });
        Ok(found.into_pyarray(py))
    }

    /// Find for each of (n, 3) voxels the least-cost path to any voxel at a distance of `away_mm`.
    ///
    /// Each path is an array of (m, 3) voxels, or None if there is no path.
    #[pyo3(signature = (starts_ijk, *, away_mm, enclosed, dark, bright, closed))]
    fn runs<'py>(
        &self,
        py: Python<'py>,
        starts_ijk: PyReadonlyArray2<'py, u16>,
        away_mm: f64,
        enclosed: f64,
        dark: f64,
        bright: f64,
        closed: f64,
    ) -> PyResult<Vec<Option<Bound<'py, PyArray2<u16>>>>> {
        let starts: Vec<[usize; 3]> =
            voxels("starts_ijk", &starts_ijk, self.core.grid().shape_ijk())?
                .into_iter()
                .map(|v| v.map(usize::from))
                .collect();
        let levels = WayLevels {
            enclosed,
            dark,
            bright,
            closed,
        };
        let found = py
            .detach(|| self.core.runs(&starts, away_mm, levels, &Unwatched))
            .map_err(IntoPy::into_py)?;
        Ok(found
            .into_iter()
            .map(|way| way.map(|way| way_array(py, &way)))
            .collect())
    }

    /// Find the least-cost path, with the most wall round it, from the reached lumen of a tracker to a voxel outside.
    ///
    /// Return (n, 3) voxels, or None if there is no path. A search that meets no lumen heads for the voxel
    /// `toward_ijk`. A path that ends at one of the (n, 3) lumen voxels `tips_ijk` is preferred if its cost exceeds that
    /// of the best path by at most `tip_allowance`.
    #[pyo3(signature = (tracker, start_ijk, toward_ijk, tips_ijk, *, tip_allowance, enclosed, dark, bright, closed, cancel=None))]
    fn way<'py>(
        &self,
        py: Python<'py>,
        tracker: &LumenTracker,
        start_ijk: [usize; 3],
        toward_ijk: [usize; 3],
        tips_ijk: PyReadonlyArray2<'py, u16>,
        tip_allowance: f64,
        enclosed: f64,
        dark: f64,
        bright: f64,
        closed: f64,
        cancel: Option<Py<PyAny>>,
    ) -> PyResult<Option<Bound<'py, PyArray2<u16>>>> {
        let shape = self.core.grid().shape_ijk();
        if (0..3).any(|a| start_ijk[a] >= shape[a]) {
            return Err(TrackError::Argument {
                what: "start_ijk",
                expected: format!("below {shape:?}"),
                found: format!("{start_ijk:?}"),
            }
            .into_py());
        }
        let levels = WayLevels {
            enclosed,
            dark,
            bright,
            closed,
        };
        let tips = PreferredTips {
            voxels: voxels("tips_ijk", &tips_ijk, shape)?
                .into_iter()
                .map(|v| v.map(usize::from))
                .collect(),
            allowance: tip_allowance,
        };
        let watch = PyWatch::new(cancel, None);
        let way = py
            .detach(|| {
                let solved = tracker.lock();
                let is_lumen = |voxel: [usize; 3]| {
                    tracker
                        .graph
                        .node_at_voxel(voxel.map(|v| v as isize))
                        .is_some_and(|node| solved.cost_quanta(node).is_some())
                };
                self.core
                    .way(start_ijk, toward_ijk, levels, is_lumen, &tips, &watch)
            })
            .map_err(|e| watch.error(e))?;
        Ok(way.map(|way| way_array(py, &way)))
    }
}

fn way_array<'py>(py: Python<'py>, way: &EvidencePath) -> Bound<'py, PyArray2<u16>> {
    Array2::from_shape_fn((way.voxels.len(), 3), |(n, a)| way.voxels[n][a] as u16).into_pyarray(py)
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Enclosures>()
}
