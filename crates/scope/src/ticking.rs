//! The clock that the force loop waits by, and what it asks the system for.

pub(crate) use system::{be_on_time, cpu_ns_of_this_thread, now_ns, sleep_until};

#[cfg(target_os = "linux")]
mod system {
    /// Asks the system to wake this thread when it asked to be woken (wake-ups are otherwise bundled within 50 us), and
    /// before all threads of ordinary programs; whether the user may have the latter.
    pub(crate) fn be_on_time() -> bool {
        // SAFETY: the calls take numbers and a struct that outlives them, and change this thread alone.
        unsafe {
            libc::prctl(libc::PR_SET_TIMERSLACK, 1, 0, 0, 0);
            let mut param: libc::sched_param = core::mem::zeroed();
            param.sched_priority = 1;
            libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const param) == 0
        }
    }

    /// Nanoseconds of the clock that [`sleep_until`] waits by.
    pub(crate) fn now_ns() -> u64 {
        clock_ns(libc::CLOCK_MONOTONIC)
    }

    fn clock_ns(clock: libc::clockid_t) -> u64 {
        let mut time = libc::timespec {
            tv_sec: 0,
            tv_nsec: 0,
        };
        // SAFETY: the call writes to the struct that it is given.
        let failed = unsafe { libc::clock_gettime(clock, &raw mut time) };
        if failed != 0 {
            return 0;
        }
        time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
    }

    /// Waits; at once if the time is over. A signal may end it early.
    pub(crate) fn sleep_until(ns: u64) {
        let time = libc::timespec {
            tv_sec: (ns / 1_000_000_000) as libc::time_t,
            tv_nsec: (ns % 1_000_000_000) as libc::c_long,
        };
        // SAFETY: the call reads a struct that outlives it.
        unsafe {
            libc::clock_nanosleep(
                libc::CLOCK_MONOTONIC,
                libc::TIMER_ABSTIME,
                &raw const time,
                core::ptr::null_mut(),
            );
        }
    }

    /// Time that this thread has been on a core.
    pub(crate) fn cpu_ns_of_this_thread() -> u64 {
        clock_ns(libc::CLOCK_THREAD_CPUTIME_ID)
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    use std::sync::LazyLock;
    use std::time::{Duration, Instant};

    static BEGIN: LazyLock<Instant> = LazyLock::new(Instant::now);

    pub(crate) fn be_on_time() -> bool {
        false
    }

    pub(crate) fn now_ns() -> u64 {
        u64::try_from(BEGIN.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    pub(crate) fn sleep_until(ns: u64) {
        std::thread::sleep(Duration::from_nanos(ns.saturating_sub(now_ns())));
    }

    pub(crate) fn cpu_ns_of_this_thread() -> u64 {
        0
    }
}
