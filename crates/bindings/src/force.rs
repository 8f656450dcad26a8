//! Bindings of the force loop.
#![allow(
    clippy::needless_pass_by_value,
    reason = "PyO3 hands arrays over by value"
)]

use std::sync::{Mutex, PoisonError};

use carina_scope::{
    ForceLaw, ForceLoop, ForceModel, HandSample, LIMIT_N, LoopOptions, MAX_STIFFNESS_N_PER_MM,
    SLEW_N_PER_MS, ScopeError, SimulatedHand, WanderingHand,
};
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays;
use crate::errors::IntoPy;
use crate::pool::LeftThread;
use crate::scope_drive::{PyWallField, points};

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
    .map_err(IntoPy::into_py)
}

/// The force law 1,000 times a second, on a thread of its own, which the renderer leaves to it while it runs.
#[pyclass(name = "ForceLoop", frozen, module = "carina._core")]
struct PyForceLoop {
    force: Mutex<ForceLoop>,
    left: Mutex<Option<LeftThread>>,
}

impl PyForceLoop {
    fn with<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut ForceLoop) -> T + Send) -> T {
        py.detach(|| work(&mut self.force.lock().unwrap_or_else(PoisonError::into_inner)))
    }
}

#[pymethods]
impl PyForceLoop {
    #[new]
    #[pyo3(signature = (field, numbers, path_lps, *, udp_port=None, simulated=None, lps_from_device=None))]
    fn new(
        field: &Bound<'_, PyWallField>,
        numbers: LawNumbers,
        path_lps: PyReadonlyArray2<'_, f64>,
        udp_port: Option<u16>,
        simulated: Option<([f64; 3], f64, f64)>,
        lps_from_device: Option<PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<Self> {
        let lps_from_device = lps_from_device
            .map(|m| arrays::affine("lps_from_device", &m))
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
        ForceModel::new(field.get().0.clone(), law(numbers)?, path)
            .and_then(|model| ForceLoop::start(model, options))
            .map(|force| Self {
                force: Mutex::new(force),
                left: Mutex::new(Some(LeftThread::new())),
            })
            .map_err(IntoPy::into_py)
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
        self.left
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
    }
}

/// Forces (n, 3) of a hand's samples (n, 9), a millisecond each: no thread, no clock. A row that no hand makes is silence.
#[pyfunction]
fn forces_along<'py>(
    py: Python<'py>,
    field: &Bound<'py, PyWallField>,
    numbers: LawNumbers,
    samples: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    if samples.shape()[1] != 9 {
        return Err(ScopeError::Force {
            reason: format!(
                "expected samples of shape (n, 9), found {:?}",
                samples.shape()
            ),
        }
        .into_py());
    }
    let model = ForceModel::new(field.get().0.clone(), law(numbers)?, Vec::new());
    let mut model = model.map_err(IntoPy::into_py)?;
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

/// The limits that the law is built with: N, N per ms, N per mm.
#[pyfunction]
fn force_limits() -> (f64, f64, f64) {
    (LIMIT_N, SLEW_N_PER_MS, MAX_STIFFNESS_N_PER_MM)
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyForceLoop>()?;
    module.add_function(wrap_pyfunction!(forces_along, module)?)?;
    module.add_function(wrap_pyfunction!(force_limits, module)?)
}
