//! Thread pool that renders pictures: all threads of the machine, or one fewer while a thread is reserved.

use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::thread_clock::PoolClock;

/// Number of reservations of threads, and the smaller thread pool that is used while there are any.
struct Reservations {
    num_holders: usize,
    pool: Option<Arc<Smaller>>,
}

struct Smaller {
    pool: ThreadPool,
    clock: PoolClock,
}

/// Reservations of threads by this process.
static RESERVATIONS: Mutex<Reservations> = Mutex::new(Reservations {
    num_holders: 0,
    pool: None,
});

/// Clock of processor time for the pool with all threads of the machine; the threads of this pool never end.
static ALL: LazyLock<PoolClock> = LazyLock::new(|| {
    let clock = PoolClock::new(rayon::current_num_threads());
    let clock_of_thread = clock.clone();
    // `spawn_broadcast` does not wait, so a thread that is busy with a map registers its clock when the map is
    // finished.
    rayon::spawn_broadcast(move |_| clock_of_thread.add_this_thread());
    clock
});

fn reservations() -> MutexGuard<'static, Reservations> {
    RESERVATIONS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reservation of one thread, from construction until `release` or until Python deletes the object.
#[pyclass(frozen, module = "carina._core")]
struct ReservedThread(Mutex<Option<Reservation>>);

#[pymethods]
impl ReservedThread {
    #[new]
    fn new() -> Self {
        Self(Mutex::new(Some(Reservation::new())))
    }

    fn release(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
    }
}

/// Reservation of one thread until the value is dropped.
struct Reservation(());

impl Reservation {
    fn new() -> Self {
        let mut current = reservations();
        current.num_holders += 1;
        if current.pool.is_none() {
            let threads = rayon::current_num_threads().saturating_sub(1).max(1);
            // If the system refuses threads for a second pool, pictures use all threads; this is not an error.
            current.pool = ThreadPoolBuilder::new()
                .num_threads(threads)
                .thread_name(|n| format!("carina-picture-{n}"))
                .build()
                .ok()
                .map(|pool| {
                    let clock = PoolClock::new(threads);
                    let clock_of_thread = clock.clone();
                    pool.spawn_broadcast(move |_| clock_of_thread.add_this_thread());
                    Arc::new(Smaller { pool, clock })
                });
        }
        Self(())
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let mut current = reservations();
        current.num_holders -= 1;
        if current.num_holders == 0 {
            current.pool = None;
        }
    }
}

/// Run `work` on the threads that are not reserved for other work, while the GIL is released.
pub(crate) fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> T {
    py.detach(|| {
        let pool = reservations().pool.clone();
        match pool {
            Some(smaller) => smaller.pool.install(work),
            None => work(),
        }
    })
}

/// Return the mean processor time of the threads that render pictures, s.
///
/// The result is `None` on systems that do not report the time, and until each thread has registered its clock.
#[pyfunction]
fn picture_clock_s() -> Option<f64> {
    let smaller = reservations().pool.clone();
    smaller.map_or_else(|| ALL.read_s(), |smaller| smaller.clock.read_s())
}

/// Return the number of threads that render a picture.
#[pyfunction]
fn picture_threads(py: Python<'_>) -> usize {
    detached(py, rayon::current_num_threads)
}

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<ReservedThread>()?;
    module.add_function(wrap_pyfunction!(picture_clock_s, module)?)?;
    module.add_function(wrap_pyfunction!(picture_threads, module)?)
}
