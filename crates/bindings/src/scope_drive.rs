//! Python bindings of the simulated scope: the wall field of a lumen, and the drive of the scope.
#![allow(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arrays over by value"
)]

use std::sync::{Arc, Mutex, PoisonError};

use carina_scope::{Limit, Ridge, ScopeBody, ScopeDrive, ScopeError, ScopeState, WallField};
use numpy::ndarray::Array2;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};

use crate::arrays;
use crate::errors::IntoPy;
use crate::watch::PyWatch;

pub(crate) fn points(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; 3]>> {
    let shape = array.shape();
    if shape[1] != 3 {
        return Err(ScopeError::Path {
            reason: format!("expected points of shape (n, 3), found {shape:?}"),
        }
        .into_py());
    }
    let rows = array.as_array();
    Ok(rows
        .rows()
        .into_iter()
        .map(|r| [r[0], r[1], r[2]])
        .collect())
}

/// Signed distance field of a lumen's wall, in mm, positive in the lumen.
#[pyclass(name = "WallField", frozen, module = "carina._core")]
struct PyWallField(Arc<WallField>);

#[pymethods]
impl PyWallField {
    #[staticmethod]
    fn from_distances(
        py: Python<'_>,
        distance_mm_zyx: PyReadonlyArray3<'_, f32>,
        lps_from_ijk: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Self> {
        let grid = arrays::grid(&distance_mm_zyx, &lps_from_ijk)?;
        let values = arrays::values("distance_mm_zyx", &distance_mm_zyx)?;
        py.detach(|| WallField::from_distances(values, grid.shape_ijk(), grid.lps_from_ijk()))
            .map(|field| Self(Arc::new(field)))
            .map_err(IntoPy::into_py)
    }

    #[staticmethod]
    #[pyo3(signature = (vertices_lps, triangles, spacing_mm, *, cancel=None, progress=None))]
    fn from_mesh(
        py: Python<'_>,
        vertices_lps: PyReadonlyArray2<'_, f64>,
        triangles: PyReadonlyArray2<'_, u32>,
        spacing_mm: f64,
        cancel: Option<Py<PyAny>>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let vertices = points(&vertices_lps)?;
        if triangles.shape()[1] != 3 {
            return Err(ScopeError::Wall {
                reason: format!(
                    "expected triangles of shape (m, 3), found {:?}",
                    triangles.shape()
                ),
            }
            .into_py());
        }
        let rows = triangles.as_array();
        let corners: Vec<[u32; 3]> = rows
            .rows()
            .into_iter()
            .map(|r| [r[0], r[1], r[2]])
            .collect();
        let watch = PyWatch::new(cancel, progress);
        py.detach(|| {
            WallField::from_mesh(&vertices, &corners, spacing_mm, &|share| {
                watch.should_continue(share)
            })
        })
        .map(|field| Self(Arc::new(field)))
        .map_err(|e| watch.error(e))
    }

    fn with_tube(
        &self,
        py: Python<'_>,
        axis_lps: PyReadonlyArray2<'_, f64>,
        radius_mm: Vec<f64>,
        excess_mm: Vec<f64>,
    ) -> PyResult<Self> {
        let axis = points(&axis_lps)?;
        py.detach(|| self.0.with_tube_and_excess(&axis, &radius_mm, &excess_mm))
            .map(|field| Self(Arc::new(field)))
            .map_err(IntoPy::into_py)
    }

    fn deformed(&self, lps_from_rest: PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let map = arrays::affine("lps_from_rest", &lps_from_rest)?;
        self.0
            .deformed(&map)
            .map(|field| Self(Arc::new(field)))
            .map_err(IntoPy::into_py)
    }

    fn with_ridges(
        &self,
        py: Python<'_>,
        plates_lps: PyReadonlyArray3<'_, f64>,
        half_mm: f64,
    ) -> PyResult<Self> {
        let shape = plates_lps.shape();
        if shape[1..] != [3, 3] {
            return Err(ScopeError::Wall {
                reason: format!("expected ridges of shape (n, 3, 3), found {shape:?}"),
            }
            .into_py());
        }
        let rows = plates_lps.as_array();
        let ridges: Vec<Ridge> = (0..shape[0])
            .map(|n| {
                let row = |k: usize| std::array::from_fn(|a| rows[[n, k, a]]);
                Ridge {
                    middle: row(0),
                    sides: [row(1), row(2)],
                    half_mm,
                }
            })
            .collect();
        py.detach(|| self.0.with_ridges(&ridges))
            .map(|field| Self(Arc::new(field)))
            .map_err(IntoPy::into_py)
    }

    #[getter]
    fn is_deformed(&self) -> bool {
        self.0.is_deformed()
    }

    #[getter]
    fn is_sampled(&self) -> bool {
        self.0.is_sampled()
    }

    fn distance_mm<'py>(
        &self,
        py: Python<'py>,
        points_lps: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let all = points(&points_lps)?;
        let found: Vec<f64> = all.iter().map(|&p| self.0.distance_mm(p)).collect();
        Ok(found.into_pyarray(py))
    }

    #[getter]
    fn num_bytes(&self) -> usize {
        self.0.num_bytes()
    }

    fn to_bytes<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let mut bytes = Vec::new();
        py.detach(|| self.0.for_each_part(|part| bytes.extend_from_slice(part)));
        PyBytes::new(py, &bytes)
    }

    fn digest(&self, py: Python<'_>) -> String {
        py.detach(|| {
            let mut hasher = blake3::Hasher::new();
            self.0.for_each_part(|bytes| {
                hasher.update(bytes);
            });
            hasher.finalize().to_hex().to_string()
        })
    }

    fn __repr__(&self) -> String {
        format!("WallField(num_bytes={})", self.0.num_bytes())
    }
}

fn word(limit: Limit) -> &'static str {
    match limit {
        Limit::None => "none",
        Limit::Entry => "entry",
        Limit::Wall => "wall",
        Limit::Narrow => "narrow",
        Limit::Length => "length",
        Limit::Flexion => "flexion",
    }
}

fn state_dict<'py>(py: Python<'py>, state: &ScopeState) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let rows = state.lps_from_tip.rows();
    let matrix = Array2::from_shape_fn((4, 4), |(r, c)| {
        if r < 3 {
            rows[r][c]
        } else {
            f64::from(u8::from(c == 3))
        }
    });
    out.set_item("lps_from_tip", matrix.into_pyarray(py))?;
    out.set_item("insertion_mm", state.insertion_mm)?;
    out.set_item("roll_rad", state.roll_rad)?;
    out.set_item("flexion_rad", state.flexion_rad)?;
    out.set_item(
        "contact",
        state
            .contact
            .map(|c| (c.point_lps, c.normal_lps, c.depth_mm)),
    )?;
    out.set_item("red_out", state.red_out)?;
    out.set_item("limit", word(state.limit))?;
    out.set_item("passable_mm", state.passable_mm)?;
    let record = state.record;
    out.set_item("record", (record.count, record.time_s, record.max_depth_mm))?;
    Ok(out)
}

/// Simulation of a scope in a lumen.
#[pyclass(name = "ScopeDrive", frozen, module = "carina._core")]
struct PyScopeDrive(Mutex<ScopeDrive>);

impl PyScopeDrive {
    fn with<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut ScopeDrive) -> T + Send) -> T {
        py.detach(|| work(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

#[pymethods]
impl PyScopeDrive {
    #[new]
    fn new(
        field: &Bound<'_, PyWallField>,
        sizes: (f64, f64, f64, f64, f64, f64, f64),
        path_lps: PyReadonlyArray2<'_, f64>,
        up_lps: Option<[f64; 3]>,
    ) -> PyResult<Self> {
        let body = ScopeBody {
            tip_radius_mm: sizes.0,
            tube_radius_mm: sizes.1,
            rigid_mm: sizes.2,
            bending_mm: sizes.3,
            up_rad: sizes.4,
            down_rad: sizes.5,
            length_mm: sizes.6,
        };
        let path = points(&path_lps)?;
        ScopeDrive::new(field.get().0.clone(), body, &path, up_lps)
            .map(|drive| Self(Mutex::new(drive)))
            .map_err(IntoPy::into_py)
    }

    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let state = self.with(py, |drive| *drive.state());
        state_dict(py, &state)
    }

    #[getter]
    fn entry_mm(&self, py: Python<'_>) -> f64 {
        self.with(py, |drive| drive.entry_mm())
    }

    fn drive<'py>(
        &self,
        py: Python<'py>,
        insertion_mm: f64,
        roll_rad: f64,
        flexion_rad: f64,
        dt_s: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let state = self
            .with(py, |drive| {
                drive.drive(insertion_mm, roll_rad, flexion_rad, dt_s)
            })
            .map_err(IntoPy::into_py)?;
        state_dict(py, &state)
    }

    fn place<'py>(
        &self,
        py: Python<'py>,
        path_lps: PyReadonlyArray2<'py, f64>,
        insertion_mm: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let path = points(&path_lps)?;
        let state = self
            .with(py, |drive| drive.place(&path, insertion_mm))
            .map_err(IntoPy::into_py)?;
        state_dict(py, &state)
    }

    fn copy(&self, py: Python<'_>) -> Self {
        Self(Mutex::new(self.with(py, |drive| drive.clone())))
    }

    fn shaft_lps<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        let shaft = self.with(py, |drive| drive.shaft_lps());
        Array2::from_shape_fn((shaft.len(), 3), |(n, a)| shaft[n][a]).into_pyarray(py)
    }

    fn wall_depths_mm(&self, py: Python<'_>) -> (f64, f64) {
        self.with(py, |drive| drive.wall_depths_mm())
    }
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyWallField>()?;
    module.add_class::<PyScopeDrive>()
}
