//! How long the threads of a pool have been on a core, read from outside of them: a picture's own cost, whatever else the
//! machine does meanwhile. Where the system does not tell, nothing is said.

use std::sync::{Arc, Mutex, PoisonError};

/// The clocks of a pool's threads. A copy is of the same pool.
///
/// For pools whose threads live as long as their clock is read.
#[derive(Clone)]
pub(crate) struct PoolClock {
    num_threads: usize,
    clocks: Arc<Mutex<Vec<system::Clock>>>,
}

impl PoolClock {
    /// Of a pool of so many threads; each is to call [`PoolClock::add_this_thread`].
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

    /// The mean of all threads; `None` unless all of them can be read.
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
        // SAFETY: the thread asks for its own clock; the call writes to the number that it is given.
        let failed = unsafe { libc::pthread_getcpuclockid(libc::pthread_self(), &raw mut clock) };
        (failed == 0).then_some(clock)
    }

    pub(super) fn read_s(clock: Clock) -> Option<f64> {
        let mut time = libc::timespec {
            tv_sec: 0,
            tv_nsec: 0,
        };
        // SAFETY: the call writes to the struct that it is given; of a thread that has ended it fails.
        let failed = unsafe { libc::clock_gettime(clock, &raw mut time) };
        (failed == 0).then_some(time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64)
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    /// There is none.
    #[derive(Clone, Copy)]
    pub(super) enum Clock {}

    pub(super) fn of_this_thread() -> Option<Clock> {
        None
    }

    pub(super) fn read_s(clock: Clock) -> Option<f64> {
        match clock {}
    }
}
