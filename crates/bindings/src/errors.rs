//! Mapping of Rust errors to the classes of `carina.errors`, with their stable codes.
#![allow(dead_code, reason = "used as the parts' bindings land")]

use pyo3::prelude::*;

/// Conversion of the error enum of a crate to Python exceptions.
pub(crate) trait IntoPy {
    /// Convert the error to a Python exception.
    fn into_py(self) -> PyErr;
}

/// Create an exception of class `carina.errors.<class>` with a stable error code.
pub(crate) fn carina_error(class: &str, code: &str, message: &str) -> PyErr {
    Python::attach(|py| {
        let build = || -> PyResult<PyErr> {
            let exception = py
                .import("carina.errors")?
                .getattr(class)?
                .call1((message,))?;
            exception.setattr("code", code)?;
            Ok(PyErr::from_value(exception))
        };
        build().unwrap_or_else(|e| e)
    })
}

impl IntoPy for carina_grid::GridError {
    fn into_py(self) -> PyErr {
        let class = if self.code().starts_with("render") {
            "RenderError"
        } else {
            "GeometryError"
        };
        carina_error(class, self.code(), &self.to_string())
    }
}
