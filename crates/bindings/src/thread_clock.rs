//! Processor time of the threads of a pool, read from other threads.
//!
//! The processor time is the cost of a picture without the load of other programs. On systems that do not report it,
//! there is no value.

use std::sync::{Arc, Mutex, PoisonError};

/// Clocks of the threads of a pool.
///
/// A clone refers to the same pool. The pool's threads must live for as long as their clocks are read.
#[derive(Clone)]
pub(crate) struct PoolClock {
    num_threads: usize,
    clocks: Arc<Mutex<Vec<system::Clock>>>,
}

impl PoolClock {
    /// Create the clock of a pool with the given number of threads.
    ///
    /// Each thread must call [`PoolClock::add_this_thread`].
    pub(crate) fn new(num_threads: usize) -> Self {
        Self {
            num_threads,
            clocks: Arc::default(),
        }
    }

    pub(crate) fn add_this_thread(&self) {
        let mut clocks = self.clocks.lock().unwrap_or_else(PoisonError::into_inner);
        clocks.extend(system::of_this_thread());
    }

    /// Return the mean processor time of all threads in s; `None` unless all clocks can be read.
    pub(crate) fn read_s(&self) -> Option<f64> {
        let clocks = self.clocks.lock().unwrap_or_else(PoisonError::into_inner);
        if clocks.len() != self.num_threads {
            return None;
        }
        let sum_s: Option<f64> = clocks.iter().map(|&clock| system::read_s(clock)).sum();
        sum_s.map(|sum_s| sum_s / clocks.len() as f64)
    }
}

#[cfg(target_os = "linux")]
mod system {
    pub(super) type Clock = libc::clockid_t;

    pub(super) fn of_this_thread() -> Option<Clock> {
        let mut clock = 0;
        // SAFETY: `pthread_self` always returns the valid, running calling thread, and the call writes only to `clock`,
        // a local variable that outlives the call.
        let failed = unsafe { libc::pthread_getcpuclockid(libc::pthread_self(), &raw mut clock) };
        (failed == 0).then_some(clock)
    }

    pub(super) fn read_s(clock: Clock) -> Option<f64> {
        let mut time = libc::timespec {
            tv_sec: 0,
            tv_nsec: 0,
        };
        // SAFETY: the call writes only to `time`, a local variable that outlives the call; for the clock of a thread
        // that has ended, the call fails with an error code.
        let failed = unsafe { libc::clock_gettime(clock, &raw mut time) };
        (failed == 0).then_some(time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64)
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    /// Empty type for systems that report no thread clocks.
    #[derive(Clone, Copy)]
    pub(super) enum Clock {}

    pub(super) fn of_this_thread() -> Option<Clock> {
        None
    }

    pub(super) fn read_s(clock: Clock) -> Option<f64> {
        match clock {}
    }
}
