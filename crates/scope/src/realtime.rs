//! What the system can do for a thread that must be on time, and for those that must not be in its way.

use std::fmt;

/// How the system lets the loop's threads go before others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scheduling {
    /// Before all threads of ordinary programs (`SCHED_FIFO`).
    RealTime,
    /// A fair share like any other thread, in slices so short that it is let in at once when it wakes (Linux 6.12).
    ShortSlice,
    /// As any other thread.
    Ordinary,
}

impl Scheduling {
    /// In reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::RealTime => "real-time",
            Self::ShortSlice => "short-slice",
            Self::Ordinary => "ordinary",
        }
    }
}

impl fmt::Display for Scheduling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

pub use system::let_others_go_first;
pub(crate) use system::{
    Cores, WaitMeter, core_halves, cpu_ns_of_this_thread, now_ns, prefer_this_thread, sleep_until,
    stay_on,
};

#[cfg(target_os = "linux")]
mod system {
    use std::fs::File;
    use std::os::unix::fs::FileExt;

    use super::Scheduling;

    /// The shortest that the system grants.
    const SLICE_NS: u64 = 100_000;
    /// A tenth of the weight of an ordinary thread. Not less: where another program keeps the cores busy, pictures
    /// would all but stop.
    const NICE_OF_OTHERS: libc::c_int = 10;

    /// `struct sched_attr` in its first version, which every kernel takes.
    #[repr(C)]
    #[derive(Default)]
    struct SchedAttr {
        size: u32,
        policy: u32,
        flags: u64,
        nice: i32,
        priority: u32,
        runtime_ns: u64,
        deadline_ns: u64,
        period_ns: u64,
    }

    const ATTR_BYTES: u32 = size_of::<SchedAttr>() as u32;

    fn attributes() -> Option<SchedAttr> {
        let mut found = SchedAttr::default();
        // SAFETY: the call writes at most as many bytes as it is told, to a struct of that size.
        let failed =
            unsafe { libc::syscall(libc::SYS_sched_getattr, 0, &raw mut found, ATTR_BYTES, 0) };
        (failed == 0).then_some(found)
    }

    /// Asks the system to wake this thread when it asked to be woken, and to let it go before others as far as the
    /// user may have that.
    pub(crate) fn prefer_this_thread() -> Scheduling {
        // SAFETY: both calls take numbers and a struct that outlives them, and change this thread alone.
        let is_realtime = unsafe {
            // Wake-ups of ordinary threads are otherwise bundled within 50 us.
            libc::prctl(libc::PR_SET_TIMERSLACK, 1, 0, 0, 0);
            let mut param: libc::sched_param = core::mem::zeroed();
            param.sched_priority = 1;
            libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const param) == 0
        };
        if is_realtime {
            return Scheduling::RealTime;
        }
        // A share of the core that is far from used up and a near deadline: of such threads the system lets the one
        // that wakes in before the other's slice is over. Everybody may ask for that.
        if let Some(mut wanted) = attributes() {
            wanted.size = ATTR_BYTES;
            wanted.runtime_ns = SLICE_NS;
            // SAFETY: the call reads a struct that says its own size, and changes this thread alone.
            unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const wanted, 0) };
        }
        // Older systems take the call and know no slices.
        if attributes().is_some_and(|found| found.runtime_ns == SLICE_NS) {
            Scheduling::ShortSlice
        } else {
            Scheduling::Ordinary
        }
    }

    /// Lets other threads go before this one from now on: a tenth of their share where all want the core, and it does
    /// not push in when it wakes. Without effect where the system refuses.
    pub fn let_others_go_first() {
        // SAFETY: the calls take numbers and a struct that outlives them; on Linux both change this thread alone.
        unsafe {
            let mut param: libc::sched_param = core::mem::zeroed();
            param.sched_priority = 0;
            libc::sched_setscheduler(0, libc::SCHED_BATCH, &raw const param);
            let now = libc::getpriority(libc::PRIO_PROCESS, 0);
            libc::setpriority(libc::PRIO_PROCESS, 0, NICE_OF_OTHERS.max(now));
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

    /// Some of the machine's cores.
    pub(crate) struct Cores(libc::cpu_set_t);

    /// The cores that this process may use, in two halves; none where it may use one only.
    pub(crate) fn core_halves() -> Option<[Cores; 2]> {
        // SAFETY: the set is plain bits, the call writes to it and nothing beyond.
        let (failed, allowed) = unsafe {
            let mut set: libc::cpu_set_t = core::mem::zeroed();
            let failed = libc::sched_getaffinity(0, size_of::<libc::cpu_set_t>(), &raw mut set);
            (failed, set)
        };
        if failed != 0 {
            return None;
        }
        // SAFETY: indices are below the size of the set.
        let cores: Vec<usize> = (0..libc::CPU_SETSIZE as usize)
            .filter(|&core| unsafe { libc::CPU_ISSET(core, &allowed) })
            .collect();
        if cores.len() < 2 {
            return None;
        }
        let (first, second) = cores.split_at(cores.len() / 2);
        Some([first, second].map(|half| {
            // SAFETY: as above.
            unsafe {
                let mut set: libc::cpu_set_t = core::mem::zeroed();
                for &core in half {
                    libc::CPU_SET(core, &mut set);
                }
                Cores(set)
            }
        }))
    }

    /// Keeps this thread on some cores; it stays where it is if the system refuses.
    pub(crate) fn stay_on(cores: &Cores) {
        // SAFETY: the call reads a set that outlives it, and changes this thread alone.
        unsafe {
            libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const cores.0);
        }
    }

    /// How long this thread was ready to run and others had the core.
    pub(crate) struct WaitMeter {
        file: Option<File>,
        seen_ns: u64,
    }

    impl WaitMeter {
        pub(crate) fn of_this_thread() -> Self {
            let file = File::open("/proc/thread-self/schedstat").ok();
            let mut meter = Self { file, seen_ns: 0 };
            meter.since_last_ns();
            meter
        }

        /// Since it was last asked; 0 where the system does not say.
        pub(crate) fn since_last_ns(&mut self) -> u64 {
            let mut text = [0; 96];
            let Some(num) = self
                .file
                .as_ref()
                .and_then(|file| file.read_at(&mut text, 0).ok())
            else {
                return 0;
            };
            let waited_ns = core::str::from_utf8(&text[..num])
                .ok()
                .and_then(|text| text.split_ascii_whitespace().nth(1)?.parse().ok())
                .unwrap_or(self.seen_ns);
            let since_ns = waited_ns.saturating_sub(self.seen_ns);
            self.seen_ns = waited_ns;
            since_ns
        }
    }

    #[cfg(test)]
    mod tests {
        use super::{attributes, core_halves, let_others_go_first, prefer_this_thread};
        use crate::realtime::Scheduling;

        #[test]
        fn what_is_said_of_a_thread_is_what_the_system_says() {
            std::thread::spawn(|| {
                let said = prefer_this_thread();
                let found = attributes().unwrap();
                match said {
                    Scheduling::RealTime => assert_eq!(found.policy, libc::SCHED_FIFO as u32),
                    Scheduling::ShortSlice => assert_eq!(found.runtime_ns, 100_000),
                    Scheduling::Ordinary => assert_ne!(found.policy, libc::SCHED_FIFO as u32),
                }
            })
            .join()
            .unwrap();
        }

        #[test]
        fn a_thread_lets_others_go_first_and_the_others_stay_as_they_are() {
            let before = attributes().unwrap();
            std::thread::spawn(|| {
                let_others_go_first();
                let found = attributes().unwrap();
                assert_eq!(found.policy, libc::SCHED_BATCH as u32);
                assert!(found.nice >= 10);
                // A second time makes it no worse and no better.
                let_others_go_first();
                assert_eq!(attributes().unwrap().nice, found.nice);
            })
            .join()
            .unwrap();
            let after = attributes().unwrap();
            assert_eq!((after.policy, after.nice), (before.policy, before.nice));
        }

        #[test]
        fn halves_share_no_core() {
            let Some([first, second]) = core_halves() else {
                return;
            };
            let of = |set: &libc::cpu_set_t| {
                (0..libc::CPU_SETSIZE as usize)
                    // SAFETY: the index is below the size of the set.
                    .filter(|&core| unsafe { libc::CPU_ISSET(core, set) })
                    .collect::<Vec<_>>()
            };
            let (first, second) = (of(&first.0), of(&second.0));
            assert!(!first.is_empty() && !second.is_empty());
            assert!(first.iter().all(|core| !second.contains(core)));
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    use std::sync::LazyLock;
    use std::time::{Duration, Instant};

    use super::Scheduling;

    static BEGIN: LazyLock<Instant> = LazyLock::new(Instant::now);

    pub(crate) fn prefer_this_thread() -> Scheduling {
        Scheduling::Ordinary
    }

    /// Lets other threads go before this one; not known how on this system.
    pub fn let_others_go_first() {}

    pub(crate) fn now_ns() -> u64 {
        u64::try_from(BEGIN.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    pub(crate) fn sleep_until(ns: u64) {
        std::thread::sleep(Duration::from_nanos(ns.saturating_sub(now_ns())));
    }

    pub(crate) fn cpu_ns_of_this_thread() -> u64 {
        0
    }

    pub(crate) struct Cores;

    pub(crate) fn core_halves() -> Option<[Cores; 2]> {
        None
    }

    pub(crate) fn stay_on(_: &Cores) {}

    pub(crate) struct WaitMeter;

    impl WaitMeter {
        pub(crate) fn of_this_thread() -> Self {
            Self
        }

        #[allow(clippy::unused_self, reason = "as on Linux")]
        pub(crate) fn since_last_ns(&mut self) -> u64 {
            0
        }
    }
}
