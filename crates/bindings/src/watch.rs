//! Periodic checks for Ctrl-C and the caller's `cancel()` during long calls, with reports of progress.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use pyo3::prelude::*;

use crate::errors::IntoPy;

/// Check for Ctrl-C and the caller's `cancel()`, with a call of `progress(fraction)`, at most every 50 ms.
pub(crate) struct PyWatch {
    cancel: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
    state: Mutex<WatchState>,
}

struct WatchState {
    last_check: Instant,
    /// Exception that a callback or Ctrl-C has raised, to be raised again unchanged; `None` without an exception.
    raised: Option<PyErr>,
    stopped: bool,
}

/// Minimum time between two checks whether the user pressed Ctrl-C or `cancel()` returns true.
const CHECK_INTERVAL: Duration = Duration::from_millis(50);

impl PyWatch {
    pub(crate) fn new(cancel: Option<Py<PyAny>>, progress: Option<Py<PyAny>>) -> Self {
        Self {
            cancel,
            progress,
            state: Mutex::new(WatchState {
                last_check: Instant::now(),
                raised: None,
                stopped: false,
            }),
        }
    }

    fn run_callbacks(&self, fraction: f64) -> PyResult<bool> {
        Python::attach(|py| {
            py.check_signals()?;
            if let Some(progress) = &self.progress {
                progress.call1(py, (fraction,))?;
            }
            self.cancel
                .as_ref()
                .map_or(Ok(true), |cancel| Ok(!cancel.call0(py)?.is_truthy(py)?))
        })
    }

    /// Check for a cancellation and report the completed fraction; return false if the call should end.
    ///
    /// Any thread may call this method without the GIL.
    pub(crate) fn should_continue(&self, fraction: f64) -> bool {
        {
            // Another thread is running the check at this moment.
            let Ok(mut state) = self.state.try_lock() else {
                return true;
            };
            if state.stopped {
                return false;
            }
            if state.last_check.elapsed() < CHECK_INTERVAL {
                return true;
            }
            state.last_check = Instant::now();
        }
        // The lock is released before the callbacks run, because a callback may wait for another thread that calls this
        // method.
        let found = self.run_callbacks(fraction);
        let should_continue = matches!(found, Ok(true));
        if !should_continue {
            let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            state.stopped = true;
            state.raised = found.err().or(state.raised.take());
        }
        should_continue
    }

    /// Return the error to raise in Python: the exception of a callback if there is one, otherwise `otherwise`.
    pub(crate) fn error(&self, otherwise: impl IntoPy) -> PyErr {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.raised.take().unwrap_or_else(|| otherwise.into_py())
    }
}
