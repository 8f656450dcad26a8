//! Python bindings of the flight curve of `carina-scope`.

use carina_scope::{FlightCurve, ScopeError};
use numpy::{
    PyArray2, PyArray3, PyReadonlyArray2, ToPyArray,
    ndarray::{Array2, Array3},
};
use pyo3::prelude::*;

use crate::errors::{IntoPy, carina_error};

impl IntoPy for ScopeError {
    fn into_py(self) -> PyErr {
        let class = match self {
            Self::Cancelled => "CancelledError",
            _ => "UsageError",
        };
        carina_error(class, self.code(), &self.to_string())
    }
}

/// Smooth curve with camera frames, computed from a polyline.
#[pyclass(name = "FlightCurve", frozen, module = "carina._core")]
struct PyFlightCurve(FlightCurve);

#[pymethods]
impl PyFlightCurve {
    #[new]
    #[allow(
        clippy::needless_pass_by_value,
        reason = "PyO3 hands arrays over by value"
    )]
    fn new(
        points_lps: PyReadonlyArray2<'_, f64>,
        up_lps: Option<[f64; 3]>,
        max_deviation_mm: f64,
    ) -> PyResult<Self> {
        let points = crate::scope_drive::points(&points_lps)?;
        FlightCurve::new(&points, up_lps, max_deviation_mm)
            .map(Self)
            .map_err(IntoPy::into_py)
    }

    #[getter]
    fn length_mm(&self) -> f64 {
        self.0.length_mm()
    }

    fn pose_at<'py>(&self, py: Python<'py>, path_mm: f64) -> Bound<'py, PyArray2<f64>> {
        let pose = self.0.pose_at(path_mm);
        let mut matrix = Array2::eye(4);
        for (r, row) in pose.rows().iter().enumerate() {
            for (c, &value) in row.iter().enumerate() {
                matrix[[r, c]] = value;
            }
        }
        matrix.to_pyarray(py)
    }

    fn nearest(&self, point_lps: [f64; 3]) -> (f64, f64) {
        let found = self.0.nearest(point_lps);
        (found.path_mm, found.distance_mm)
    }

    fn knots_lps<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let mut knots = Array2::zeros((self.0.num_knots(), 3));
        for (n, point) in self.0.knots().enumerate() {
            for (a, &value) in point.iter().enumerate() {
                knots[[n, a]] = value;
            }
        }
        knots.to_pyarray(py)
    }

    fn tangent_frames<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        let frames = self.0.tangent_frames();
        let mut out = Array3::zeros((frames.len(), 4, 4));
        for (n, frame) in frames.iter().enumerate() {
            for (r, row) in frame.rows().iter().enumerate() {
                for (c, &value) in row.iter().enumerate() {
                    out[[n, r, c]] = value;
                }
            }
            out[[n, 3, 3]] = 1.0;
        }
        out.to_pyarray(py)
    }

    fn __repr__(&self) -> String {
        format!(
            "FlightCurve(length_mm={:.1}, num_knots={})",
            self.0.length_mm(),
            self.0.num_knots()
        )
    }
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyFlightCurve>()
}
