//! The threads that pictures are made by: all of the machine's, or one fewer while a force device is on.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Who wants a thread left to them, and the smaller pool while anybody does.
struct Left {
    num_holders: usize,
    pool: Option<Arc<ThreadPool>>,
}

static LEFT: Mutex<Left> = Mutex::new(Left {
    num_holders: 0,
    pool: None,
});

fn left() -> MutexGuard<'static, Left> {
    LEFT.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Leaves a thread until it is dropped.
pub(crate) struct LeftThread(());

impl LeftThread {
    pub(crate) fn new() -> Self {
        let mut left = left();
        left.num_holders += 1;
        if left.pool.is_none() {
            let threads = rayon::current_num_threads().saturating_sub(1).max(1);
            // Without a second pool (no threads to be had) pictures are made as before: slower force, no fault.
            left.pool = ThreadPoolBuilder::new()
                .num_threads(threads)
                .thread_name(|n| format!("carina-picture-{n}"))
                .build()
                .ok()
                .map(Arc::new);
        }
        Self(())
    }
}

impl Drop for LeftThread {
    fn drop(&mut self) {
        let mut left = left();
        left.num_holders -= 1;
        if left.num_holders == 0 {
            left.pool = None;
        }
    }
}

/// Makes a picture without the interpreter's lock, by the threads that are there for it.
pub(crate) fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> T {
    py.detach(|| {
        let pool = left().pool.clone();
        match pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    })
}

/// How many threads a picture is made by now.
#[pyfunction]
fn picture_threads(py: Python<'_>) -> usize {
    detached(py, rayon::current_num_threads)
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(picture_threads, module)?)
}
