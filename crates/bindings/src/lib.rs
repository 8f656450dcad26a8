//! Compiled module `carina._core` of the Python package.
//!
//! The functions check arrays, release the GIL and map errors. Contracts (shapes, units, errors) are documented in the
//! public Python functions, types in `_core.pyi`, algorithms in the crates.

use pyo3::prelude::*;

mod airpath;
mod arrays;
mod cross_section;
mod cubic_grids;
mod dicom;
mod errors;
mod evidence;
#[cfg_attr(not(feature = "gpu"), path = "gpu_absent.rs")]
mod gpu;
mod growth;
mod isoregion;
mod memory;
mod mesh;
mod optics;
mod outline;
mod paper_tracker;
mod phantom;
mod points;
mod pool;
mod raycast;
mod scope;
mod scope_drive;
mod thread_clock;
mod tracker;
mod tree_edits;
mod views;
mod watch;

/// Return the build settings and capabilities: `profile`, `simd`, `threads`, `target`, `gpu`, `version`.
#[pyfunction]
fn build_info(py: Python<'_>) -> PyResult<Bound<'_, pyo3::types::PyDict>> {
    let info = pyo3::types::PyDict::new(py);
    info.set_item("version", env!("CARGO_PKG_VERSION"))?;
    info.set_item(
        "profile",
        if cfg!(debug_assertions) {
            "debug"
        } else {
            "release"
        },
    )?;
    info.set_item("simd", raycast::best_instruction_set()?)?;
    info.set_item("threads", rayon::current_num_threads())?;
    info.set_item("target", std::env::consts::ARCH)?;
    info.set_item("gpu", cfg!(feature = "gpu"))?;
    Ok(info)
}

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(build_info, module)?)?;
    cubic_grids::register(module)?;
    dicom::register(module)?;
    isoregion::register(module)?;
    optics::register(module)?;
    raycast::register(module)?;
    gpu::register(module)?;
    airpath::register(module)?;
    cross_section::register(module)?;
    paper_tracker::register(module)?;
    mesh::register(module)?;
    outline::register(module)?;
    tracker::register(module)?;
    tree_edits::register(module)?;
    evidence::register(module)?;
    growth::register(module)?;
    phantom::register(module)?;
    scope::register(module)?;
    scope_drive::register(module)?;
    pool::register(module)?;
    views::register(module)?;
    Ok(())
}
