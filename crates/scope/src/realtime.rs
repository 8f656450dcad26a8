//! What the system can do for a thread that must be on time.

/// Asks the system to let this thread go before all others and to wake it when it asked to be woken; true if it does both.
///
/// Without the right to (a desktop session usually has none) the thread still gets short waits.
#[cfg(target_os = "linux")]
pub(crate) fn prefer_this_thread() -> bool {
    // SAFETY: both calls take numbers and a struct that outlives them, and change this thread alone.
    unsafe {
        // Wake-ups are otherwise bundled within 50 us.
        libc::prctl(libc::PR_SET_TIMERSLACK, 1, 0, 0, 0);
        let mut param: libc::sched_param = core::mem::zeroed();
        param.sched_priority = 1;
        libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const param) == 0
    }
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn prefer_this_thread() -> bool {
    false
}

/// Time that this thread has been on a core.
#[cfg(target_os = "linux")]
pub(crate) fn cpu_s_of_this_thread() -> f64 {
    let mut time = libc::timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    // SAFETY: the call writes to the struct that it is given.
    let failed = unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &raw mut time) };
    if failed != 0 {
        return 0.0;
    }
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

#[cfg(not(target_os = "linux"))]
pub(crate) fn cpu_s_of_this_thread() -> f64 {
    0.0
}
