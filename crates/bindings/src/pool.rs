//! The threads that pictures are made by: all of the machine's, or one fewer while a force device is on.

use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::thread_clock::PoolClock;

/// Who wants a thread left to them, and the smaller pool while anybody does.
struct Left {
    num_holders: usize,
    pool: Option<Arc<Smaller>>,
}

struct Smaller {
    pool: ThreadPool,
    clock: PoolClock,
}

static LEFT: Mutex<Left> = Mutex::new(Left {
    num_holders: 0,
    pool: None,
});

/// The clock of the pool that has all of the machine's threads. Its threads never end.
static ALL: LazyLock<PoolClock> = LazyLock::new(|| {
    let clock = PoolClock::new(rayon::current_num_threads());
    let asked = clock.clone();
    // Without waiting: a thread that is building a map answers when it is done.
    rayon::spawn_broadcast(move |_| asked.add_this_thread());
    clock
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
                .map(|pool| {
                    let clock = PoolClock::new(threads);
                    let asked = clock.clone();
                    pool.spawn_broadcast(move |_| asked.add_this_thread());
                    Arc::new(Smaller { pool, clock })
                });
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
            Some(smaller) => smaller.pool.install(work),
            None => work(),
        }
    })
}

/// Seconds that the threads which make pictures now have been on a core, on the average; `None` where the system does not
/// tell, and until each of them has been asked once.
#[pyfunction]
fn picture_clock_s() -> Option<f64> {
    let smaller = left().pool.clone();
    smaller.map_or_else(|| ALL.read_s(), |smaller| smaller.clock.read_s())
}

/// How many threads a picture is made by now.
#[pyfunction]
fn picture_threads(py: Python<'_>) -> usize {
    detached(py, rayon::current_num_threads)
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(picture_clock_s, module)?)?;
    module.add_function(wrap_pyfunction!(picture_threads, module)?)
}
