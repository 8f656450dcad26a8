//! Clock, waiting and scheduling priority of the force loop's thread.

pub(crate) use system::{cpu_ns_of_this_thread, now_ns, request_priority, sleep_until};

#[cfg(target_os = "linux")]
mod system {
    /// Request exact wake-ups and real-time priority for this thread; return whether the system has granted the priority.
    ///
    /// Without the request the system groups wake-ups within 50 us.
    pub(crate) fn request_priority() -> bool {
        // SAFETY: the calls take numbers and `param`, which outlives them, and change only this thread.
        unsafe {
            libc::prctl(libc::PR_SET_TIMERSLACK, 1, 0, 0, 0);
            let mut param: libc::sched_param = core::mem::zeroed();
            param.sched_priority = 1;
            libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const param) == 0
        }
    }

    /// Return the present time of the clock that [`sleep_until`] uses, ns.
    pub(crate) fn now_ns() -> u64 {
        clock_ns(libc::CLOCK_MONOTONIC)
    }

    fn clock_ns(clock: libc::clockid_t) -> u64 {
        let mut time = libc::timespec {
            tv_sec: 0,
            tv_nsec: 0,
        };
        // SAFETY: the call writes to `time`, which outlives the call.
        let failed = unsafe { libc::clock_gettime(clock, &raw mut time) };
        if failed != 0 {
            return 0;
        }
        time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64
    }

    /// Wait until a time of the clock of [`now_ns`], ns; a signal may end the wait early.
    pub(crate) fn sleep_until(ns: u64) {
        let time = libc::timespec {
            tv_sec: (ns / 1_000_000_000) as libc::time_t,
            tv_nsec: (ns % 1_000_000_000) as libc::c_long,
        };
        // SAFETY: the call reads `time`, which outlives the call.
        unsafe {
            libc::clock_nanosleep(
                libc::CLOCK_MONOTONIC,
                libc::TIMER_ABSTIME,
                &raw const time,
                core::ptr::null_mut(),
            );
        }
    }

    /// Return the processor time that this thread has used, ns.
    pub(crate) fn cpu_ns_of_this_thread() -> u64 {
        clock_ns(libc::CLOCK_THREAD_CPUTIME_ID)
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    use std::sync::LazyLock;
    use std::time::{Duration, Instant};

    /// Origin of the clock.
    static BEGIN: LazyLock<Instant> = LazyLock::new(Instant::now);

    pub(crate) fn request_priority() -> bool {
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
