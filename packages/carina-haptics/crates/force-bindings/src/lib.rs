//! Compiled module `carina_haptics._force`: the force loop for the Python package.
//!
//! The functions check arrays, release the GIL and map errors.
#![allow(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arrays over by value"
)]

use std::sync::{Arc, Mutex, PoisonError};

use carina_force::{
    ForceError, ForceLaw, ForceLoop, ForceModel, HandSample, LIMIT_N, LoopOptions,
    MAX_STIFFNESS_N_PER_MM, SLEW_N_PER_MS, SimulatedHand, WanderingHand,
};
use carina_grid::Affine;
use carina_scope::WallField;
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

type LawNumbers = (f64, f64, f64, f64, f64, f64, f64);

fn law(numbers: LawNumbers) -> PyResult<ForceLaw> {
    ForceLaw {
        tip_radius_mm: numbers.0,
        grip_mm: numbers.1,
        stiffness_n_per_mm: numbers.2,
        damping_ns_per_mm: numbers.3,
        friction: numbers.4,
        guidance_n_per_mm: numbers.5,
        watchdog_ms: numbers.6,
    }
    .checked()
    .map_err(|e| python_error(&e))
}

/// Create a `carina.errors.UsageError` with a stable error code.
fn usage_error(code: &str, message: &str) -> PyErr {
    Python::attach(|py| {
        let build = || -> PyResult<PyErr> {
            let class = py.import("carina.errors")?.getattr("UsageError")?;
            let exception = class.call1((message,))?;
            exception.setattr("code", code)?;
            Ok(PyErr::from_value(exception))
        };
        build().unwrap_or_else(|e| e)
    })
}

fn python_error(error: &ForceError) -> PyErr {
    usage_error(error.code(), &error.to_string())
}

/// Decode a wall field from the bytes of `carina.scopes.WallField.to_bytes`.
fn wall(py: Python<'_>, bytes: &[u8]) -> PyResult<Arc<WallField>> {
    py.detach(|| WallField::from_bytes(bytes))
        .map(Arc::new)
        .map_err(|e| usage_error(e.code(), &e.to_string()))
}

/// Convert a 4x4 matrix to an affine transform.
fn affine(what: &'static str, matrix: &PyReadonlyArray2<'_, f64>) -> PyResult<Affine> {
    if matrix.shape() != [4, 4] {
        let reason = format!(
            "{what}: expected a 4x4 matrix; found shape {:?}",
            matrix.shape()
        );
        return Err(python_error(&ForceError { reason }));
    }
    let view = matrix.as_array();
    let rows: [[f64; 4]; 4] = std::array::from_fn(|r| std::array::from_fn(|c| view[[r, c]]));
    Affine::from_matrix(what, &rows).map_err(|e| {
        python_error(&ForceError {
            reason: e.to_string(),
        })
    })
}

/// Convert an array of shape (n, 3) to points.
fn points(array: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; 3]>> {
    if array.shape()[1] != 3 {
        let reason = format!("expected points of shape (n, 3); found {:?}", array.shape());
        return Err(python_error(&ForceError { reason }));
    }
    let rows = array.as_array();
    Ok(rows
        .rows()
        .into_iter()
        .map(|r| [r[0], r[1], r[2]])
        .collect())
}

/// Force loop: the force law, evaluated 1,000 times a second on its own thread.
#[pyclass(name = "ForceLoop", frozen, module = "carina_haptics._force")]
struct PyForceLoop(Mutex<ForceLoop>);

impl PyForceLoop {
    fn with<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut ForceLoop) -> T + Send) -> T {
        py.detach(|| work(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

#[pymethods]
impl PyForceLoop {
    #[new]
    #[pyo3(signature = (wall, numbers, path_lps, *, udp_port=None, simulated=None, lps_from_device=None))]
    fn new(
        py: Python<'_>,
        wall: &[u8],
        numbers: LawNumbers,
        path_lps: PyReadonlyArray2<'_, f64>,
        udp_port: Option<u16>,
        simulated: Option<([f64; 3], f64, f64)>,
        lps_from_device: Option<PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<Self> {
        let lps_from_device = lps_from_device
            .map(|m| affine("lps_from_device", &m))
            .transpose()?;
        let options = LoopOptions {
            udp_port,
            simulated: simulated.map(|(round_lps, reach_mm, turns_hz)| WanderingHand {
                hand: SimulatedHand::new(round_lps),
                round_lps,
                reach_mm,
                turns_hz,
            }),
            lps_from_device,
        };
        let path = points(&path_lps)?;
        ForceModel::new(self::wall(py, wall)?, law(numbers)?, path)
            .and_then(|model| ForceLoop::start(model, options))
            .map(|force| Self(Mutex::new(force)))
            .map_err(|e| python_error(&e))
    }

    #[getter]
    fn port(&self, py: Python<'_>) -> Option<u16> {
        self.with(py, |force| force.port())
    }

    fn put(
        &self,
        py: Python<'_>,
        at_lps: [f64; 3],
        velocity_mm_s: [f64; 3],
        forward_lps: [f64; 3],
    ) -> bool {
        self.with(py, |force| {
            force.put(HandSample {
                at_lps,
                velocity_mm_s,
                forward_lps,
            })
        })
    }

    fn felt<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (felt, sample) = self.with(py, |force| force.felt());
        let out = PyDict::new(py);
        out.set_item("force_n", felt.force_n)?;
        out.set_item("torque_n_mm", felt.torque_n_mm)?;
        out.set_item("touches", felt.touches)?;
        out.set_item("limited", felt.limited)?;
        out.set_item("silent", felt.is_silent)?;
        out.set_item("at_lps", sample.map(|s| s.at_lps))?;
        Ok(out)
    }

    fn figures<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let figures = self.with(py, |force| force.figures());
        let out = PyDict::new(py);
        out.set_item("num_ticks", figures.num_ticks)?;
        out.set_item("num_missed", figures.num_missed)?;
        out.set_item("late_us", figures.late_us)?;
        out.set_item("work_us", figures.work_us)?;
        out.set_item("latency_us", figures.latency_us)?;
        out.set_item("cpu_s", figures.cpu_s)?;
        out.set_item("wall_s", figures.wall_s)?;
        out.set_item("num_samples", figures.num_samples)?;
        out.set_item("num_refused", figures.num_refused)?;
        out.set_item("is_real_time", figures.is_real_time)?;
        out.set_item("max_force_n", figures.max_force_n)?;
        out.set_item("max_change_n", figures.max_change_n)?;
        Ok(out)
    }

    fn stop(&self, py: Python<'_>) {
        self.with(py, ForceLoop::stop);
    }
}

/// Return the forces (n, 3) for samples (n, 9) that are one millisecond apart, without thread and clock.
///
/// An invalid row counts as a missing sample.
#[pyfunction]
fn forces_along<'py>(
    py: Python<'py>,
    wall: &[u8],
    numbers: LawNumbers,
    samples: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    if samples.shape()[1] != 9 {
        let reason = format!(
            "expected samples of shape (n, 9); found {:?}",
            samples.shape()
        );
        return Err(python_error(&ForceError { reason }));
    }
    let model = ForceModel::new(self::wall(py, wall)?, law(numbers)?, Vec::new());
    let mut model = model.map_err(|e| python_error(&e))?;
    let hands: Vec<HandSample> = samples
        .as_array()
        .rows()
        .into_iter()
        .map(|row| HandSample {
            at_lps: [row[0], row[1], row[2]],
            velocity_mm_s: [row[3], row[4], row[5]],
            forward_lps: [row[6], row[7], row[8]],
        })
        .collect();
    let forces: Vec<[f64; 3]> = py.detach(|| {
        hands
            .iter()
            .map(|hand| model.step(hand.is_sane().then_some(hand), 1.0).force_n)
            .collect()
    });
    Ok(Array2::from_shape_fn((forces.len(), 3), |(n, a)| forces[n][a]).into_pyarray(py))
}

/// Return the limits of the force law: largest force in N, largest change in N per ms, largest stiffness in N per mm.
#[pyfunction]
fn force_limits() -> (f64, f64, f64) {
    (LIMIT_N, SLEW_N_PER_MS, MAX_STIFFNESS_N_PER_MM)
}

#[pymodule]
fn _force(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyForceLoop>()?;
    module.add_function(wrap_pyfunction!(forces_along, module)?)?;
    module.add_function(wrap_pyfunction!(force_limits, module)?)
}
