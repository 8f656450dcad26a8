//! Python bindings of `carina-gpu`, the graphics devices.
#![allow(
    clippy::needless_pass_by_value,
    reason = "Python hands its arguments over by value"
)]

use std::{
    any::Any,
    ops::Range,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, PoisonError},
};

use carina_gpu::{GpuDecoration, GpuError, GpuMap, GpuVolume, Resident};
use carina_raycast::{CastStats, Decoration, Frame};
use numpy::{
    PyArray3, PyArray4, PyArrayMethods, PyReadonlyArray3, PyReadonlyArray4, PyUntypedArrayMethods,
};
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
            decoration: Arc::default(),
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

/// Grid of anatomical data on a device (for drawn features), with the array from which it was copied.
type UploadedDecoration = (Py<PyArray4<f32>>, Arc<GpuDecoration>);

/// Volume on a graphics device, with the radius map for empty-space skipping if one was uploaded.
#[pyclass(frozen, module = "carina._core")]
pub(crate) struct GpuScene {
    gpu: Arc<carina_gpu::Gpu>,
    volume: Arc<GpuVolume>,
    map: Option<Arc<GpuMap>>,
    /// Anatomical data of the last decorated picture; the reference to their array prevents another array from getting
    /// the same address in memory.
    decoration: Arc<Mutex<Option<UploadedDecoration>>>,
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
            decoration: Arc::clone(&self.decoration),
            values: self.values.clone_ref(py),
        })
    }

    fn __repr__(&self) -> String {
        let leaps = if self.map.is_some() { "leap" } else { "brute" };
        format!("GpuScene({:?}, {leaps})", self.gpu.adapter().name)
    }
}

/// Anatomical data for the decoration of a frame, with the array that contains them.
pub(crate) type DecorationOf<'a, 'py> = (&'a PyReadonlyArray4<'py, f32>, Decoration<'a>);

impl GpuScene {
    /// Cast and shade rows of a picture on the device; return RGB and statistics.
    ///
    /// `hu_zyx` must be the array that was copied to the device. `darken` applies the gains of the lens.
    pub(crate) fn cast(
        &self,
        py: Python<'_>,
        frame: &Frame<'_>,
        hu_zyx: &PyReadonlyArray3<'_, i16>,
        rows: Range<usize>,
        decoration: Option<DecorationOf<'_, '_>>,
        darken: bool,
    ) -> PyResult<(Vec<u8>, CastStats)> {
        if self.values.bind(py).data() != hu_zyx.data() {
            return Err(pyo3::exceptions::PyValueError::new_err(
                "the graphics device holds another volume than hu_zyx",
            ));
        }
        let decoration = match decoration {
            Some(of_frame) if frame.lights_walls() => Some(self.uploaded(py, &of_frame)?),
            _ => None,
        };
        let resident = Resident {
            volume: &self.volume,
            map: self.map.as_deref(),
            decoration: decoration.as_deref(),
        };
        let cast = || self.gpu.cast(frame, resident, rows, darken);
        py.detach(|| guarded(cast)).map_err(IntoPy::into_py)
    }

    /// Return anatomical data on the device; the data of the previous picture are reused if their array is the same.
    fn uploaded(
        &self,
        py: Python<'_>,
        (array, decoration): &DecorationOf<'_, '_>,
    ) -> PyResult<Arc<GpuDecoration>> {
        {
            let cached = self
                .decoration
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            if let Some((of, on_device)) = cached.as_ref()
                && of.bind(py).data() == array.data()
            {
                return Ok(Arc::clone(on_device));
            }
        }
        let upload = || guarded(|| self.gpu.upload_decoration(decoration));
        let on_device = Arc::new(py.detach(upload).map_err(IntoPy::into_py)?);
        let cells = array.as_unbound().clone_ref(py);
        let mut cached = self
            .decoration
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        *cached = Some((cells, Arc::clone(&on_device)));
        Ok(on_device)
    }
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Gpu>()?;
    module.add_class::<GpuScene>()?;
    module.add_function(wrap_pyfunction!(gpu_adapters, module)?)?;
    Ok(())
}
