//! Python bindings of `carina-gpu`, the graphics devices.
#![allow(
    clippy::needless_pass_by_value,
    reason = "Python hands its arguments over by value"
)]

use std::{
    any::Any,
    ops::Range,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::Arc,
};

use carina_gpu::{GpuError, GpuMap, GpuVolume};
use carina_raycast::{CastStats, Frame, InstructionSet, Method, light_gathered};
use numpy::{PyArray3, PyArrayMethods, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

use crate::{
    arrays::values,
    errors::{IntoPy, carina_error},
};

impl IntoPy for GpuError {
    fn into_py(self) -> PyErr {
        match self {
            Self::Raycast(e) => e.into_py(),
            e => carina_error("RenderError", e.code(), &e.to_string()),
        }
    }
}

/// Run work on a device; return a panic in a driver's wrapper as an error, so that the CPU can render the picture.
fn guarded<T>(work: impl FnOnce() -> Result<T, GpuError>) -> Result<T, GpuError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let message_of = |panic: &dyn Any| {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            text.or_else(|| panic.downcast_ref::<&str>().copied())
                .unwrap_or("no reason given")
                .to_owned()
        };
        Err(GpuError::Device {
            name: "in use".to_owned(),
            reason: message_of(panic.as_ref()),
        })
    })
}

/// Return name, interface, driver and kind of each graphics adapter, the likely fastest first.
///
/// The result is None in a build without GPU support.
#[pyfunction]
#[allow(
    clippy::unnecessary_wraps,
    reason = "the build without GPU support returns None"
)]
fn gpu_adapters(py: Python<'_>) -> Option<Vec<(String, String, String, &'static str)>> {
    let found = py
        .detach(|| guarded(|| Ok(carina_gpu::adapters())))
        .unwrap_or_default();
    let facts = found.into_iter();
    Some(
        facts
            .map(|a| (a.name, a.api, a.driver, a.kind.name()))
            .collect(),
    )
}

/// Opened graphics device that casts airway views.
#[pyclass(frozen, module = "carina._core")]
struct Gpu {
    inner: Arc<carina_gpu::Gpu>,
}

#[pymethods]
impl Gpu {
    #[new]
    fn new(py: Python<'_>, adapter: usize) -> PyResult<Self> {
        let gpu = py
            .detach(|| guarded(|| carina_gpu::Gpu::open(adapter)))
            .map_err(IntoPy::into_py)?;
        Ok(Self {
            inner: Arc::new(gpu),
        })
    }

    /// Copy a volume to the device, and its radius map if there is one.
    #[pyo3(signature = (hu_zyx, radius_zyx=None))]
    fn upload<'py>(
        &self,
        py: Python<'py>,
        hu_zyx: PyReadonlyArray3<'py, i16>,
        radius_zyx: Option<PyReadonlyArray3<'py, u8>>,
    ) -> PyResult<GpuScene> {
        let hu = values("hu_zyx", &hu_zyx)?;
        let shape: [usize; 3] = std::array::from_fn(|a| hu_zyx.shape()[a]);
        let volume = py
            .detach(|| guarded(|| self.inner.upload_volume(hu, shape)))
            .map_err(IntoPy::into_py)?;
        let bare = GpuScene {
            gpu: Arc::clone(&self.inner),
            volume: Arc::new(volume),
            map: None,
            values: hu_zyx.as_unbound().clone_ref(py),
        };
        bare.with_map(py, radius_zyx)
    }

    /// Mark the device as lost, for tests of the fallback to the CPU.
    fn lose(&self) {
        self.inner.lose();
    }

    fn __repr__(&self) -> String {
        let adapter = self.inner.adapter();
        format!("Gpu({:?}, {})", adapter.name, adapter.api)
    }
}

/// Volume on a graphics device, with or without the radius map that leaps need.
#[pyclass(frozen, module = "carina._core")]
pub(crate) struct GpuScene {
    gpu: Arc<carina_gpu::Gpu>,
    volume: Arc<GpuVolume>,
    map: Option<Arc<GpuMap>>,
    /// Array of the values that were copied to the device.
    ///
    /// The reference prevents another array from getting the same address in memory.
    values: Py<PyArray3<i16>>,
}

#[pymethods]
impl GpuScene {
    /// Return the same volume on the device with another radius map, or without one; the volume is not copied again.
    #[pyo3(signature = (radius_zyx=None))]
    fn with_map<'py>(
        &self,
        py: Python<'py>,
        radius_zyx: Option<PyReadonlyArray3<'py, u8>>,
    ) -> PyResult<Self> {
        let map = match &radius_zyx {
            None => None,
            Some(radius) => {
                let shape: [usize; 3] = std::array::from_fn(|a| radius.shape()[a]);
                let radius = values("radius_zyx", radius)?;
                let upload = || guarded(|| self.gpu.upload_map(radius, shape));
                Some(Arc::new(py.detach(upload).map_err(IntoPy::into_py)?))
            }
        };
        Ok(Self {
            gpu: Arc::clone(&self.gpu),
            volume: Arc::clone(&self.volume),
            map,
            values: self.values.clone_ref(py),
        })
    }

    fn __repr__(&self) -> String {
        let leaps = if self.map.is_some() { "leap" } else { "brute" };
        format!("GpuScene({:?}, {leaps})", self.gpu.adapter().name)
    }
}

impl GpuScene {
    /// Cast rows of a picture on the device; return RGB and statistics.
    ///
    /// `hu_zyx` must be the array that was copied to the device. Walls that are shaded after the cast are shaded on the
    /// CPU, with `method` and `simd`.
    pub(crate) fn cast(
        &self,
        py: Python<'_>,
        frame: &Frame<'_>,
        hu_zyx: &PyReadonlyArray3<'_, i16>,
        rows: Range<usize>,
        method: Method<'_>,
        simd: InstructionSet,
    ) -> PyResult<(Vec<u8>, CastStats)> {
        if self.values.bind(py).data() != hu_zyx.data() {
            return Err(pyo3::exceptions::PyValueError::new_err(
                "the graphics device holds another volume than hu_zyx",
            ));
        }
        let map = self.map.as_deref();
        let cast = || {
            if !frame.lights_walls() {
                return self.gpu.cast(frame, &self.volume, map, rows);
            }
            let (walls, stats) = self
                .gpu
                .cast_walls_to_light(frame, &self.volume, map, &rows)?;
            Ok(light_gathered(frame, method, rows, simd, &walls, stats)?)
        };
        py.detach(|| guarded(cast)).map_err(IntoPy::into_py)
    }
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Gpu>()?;
    module.add_class::<GpuScene>()?;
    module.add_function(wrap_pyfunction!(gpu_adapters, module)?)?;
    Ok(())
}
