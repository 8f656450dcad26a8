//! Replacement of the GPU bindings in a build without GPU support: there are no adapters, and no device can be opened.
#![allow(
    clippy::needless_pass_by_value,
    clippy::unused_self,
    clippy::unnecessary_wraps,
    reason = "the signatures are those of the build with GPU support"
)]

use std::{convert::Infallible, ops::Range};

use carina_raycast::{CastStats, Decoration, Frame};
use numpy::{PyReadonlyArray3, PyReadonlyArray4};
use pyo3::prelude::*;

use crate::errors::carina_error;

#[pyfunction]
const fn gpu_adapters() -> Option<Vec<(String, String, String, &'static str)>> {
    None
}

#[pyclass(frozen, module = "carina._core")]
struct Gpu {
    never: Infallible,
}

#[pymethods]
impl Gpu {
    #[new]
    fn new(adapter: usize) -> PyResult<Self> {
        Err(carina_error(
            "RenderError",
            "render.gpu",
            &format!(
                "opening graphics adapter {adapter}: GPU support is not in this build; the wheels have it"
            ),
        ))
    }

    #[pyo3(signature = (hu_zyx, radius_zyx=None))]
    fn upload(
        &self,
        hu_zyx: PyReadonlyArray3<'_, i16>,
        radius_zyx: Option<PyReadonlyArray3<'_, u8>>,
    ) -> PyResult<GpuScene> {
        let _ = (hu_zyx, radius_zyx);
        match self.never {}
    }

    fn lose(&self) {
        match self.never {}
    }
}

#[pyclass(frozen, module = "carina._core")]
pub(crate) struct GpuScene {
    never: Infallible,
}

#[pymethods]
impl GpuScene {
    #[pyo3(signature = (radius_zyx=None))]
    fn with_map(&self, radius_zyx: Option<PyReadonlyArray3<'_, u8>>) -> PyResult<Self> {
        let _ = radius_zyx;
        match self.never {}
    }
}

/// Anatomical data for the decoration of a frame, with the array that contains them.
type DecorationOf<'a, 'py> = (&'a PyReadonlyArray4<'py, f32>, Decoration<'a>);

impl GpuScene {
    pub(crate) fn cast(
        &self,
        _py: Python<'_>,
        _frame: &Frame<'_>,
        _hu_zyx: &PyReadonlyArray3<'_, i16>,
        _rows: Range<usize>,
        _decoration: Option<DecorationOf<'_, '_>>,
        _darken: bool,
    ) -> PyResult<(Vec<u8>, CastStats)> {
        match self.never {}
    }
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Gpu>()?;
    module.add_class::<GpuScene>()?;
    module.add_function(wrap_pyfunction!(gpu_adapters, module)?)?;
    Ok(())
}
