//! Ticks that several threads wait for and one of them does.

use std::hint::spin_loop;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, TryLockError};

use crate::realtime::now_ns;

/// The lock is held for copies and sums. Who does not get it in this time waits for a thread that stands still.
const SOON_NS: u64 = 100_000;

/// A state that goes from tick to tick, each done by whichever thread is ready first.
///
/// A core that stands still (another program's, an interrupt's, the host's of a virtual machine) holds up the thread that
/// waits on it or is in the middle of a tick, and seldom all cores stand still at once. So a thread works on a copy of
/// the state, nobody waits for it, and what comes second is thrown away.
pub(crate) struct Turn<S, K> {
    next: AtomicU64,
    kept: Mutex<(S, K)>,
}

/// What became of a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Took<R> {
    /// This thread did it.
    Done(R),
    /// Another one did.
    Past,
    /// Another thread stands still where this one cannot get by.
    Busy,
    /// A thread broke down while it kept what it had found.
    Broken,
}

impl<S: Clone, K> Turn<S, K> {
    /// `state` is what a tick needs of the one before; `counts` is kept beside it and not copied.
    pub(crate) const fn new(state: S, counts: K) -> Self {
        Self {
            next: AtomicU64::new(0),
            kept: Mutex::new((state, counts)),
        }
    }

    /// The number of the tick to come.
    pub(crate) fn next(&self) -> u64 {
        self.next.load(Ordering::Acquire)
    }

    /// Does a tick if it still is to be done. `work` may be done by several threads at once, on copies; `keep` only by
    /// the first that is through, with the lock held. It says how many ticks went by, 1 or more.
    pub(crate) fn take<R>(
        &self,
        tick: u64,
        work: impl FnOnce(&mut S) -> R,
        keep: impl FnOnce(&mut K, &mut R) -> u64,
    ) -> Took<R> {
        let mut state = match self.hold(tick) {
            Ok(kept) => kept.0.clone(),
            Err(took) => return took,
        };
        let mut found = work(&mut state);
        let mut kept = match self.hold(tick) {
            Ok(kept) => kept,
            Err(took) => return took,
        };
        let num = keep(&mut kept.1, &mut found);
        kept.0 = state;
        self.next.store(tick + num, Ordering::Release);
        Took::Done(found)
    }

    /// What is kept, while a tick is still to be done.
    fn hold<R>(&self, tick: u64) -> Result<MutexGuard<'_, (S, K)>, Took<R>> {
        let mut give_up_ns = None;
        loop {
            if self.next() != tick {
                return Err(Took::Past);
            }
            match self.kept.try_lock() {
                // Between the look and the lock another may have done it.
                Ok(_) if self.next() != tick => return Err(Took::Past),
                Ok(kept) => return Ok(kept),
                Err(TryLockError::Poisoned(_)) => return Err(Took::Broken),
                Err(TryLockError::WouldBlock) => {}
            }
            let now_ns = now_ns();
            if now_ns > *give_up_ns.get_or_insert(now_ns + SOON_NS) {
                return Err(Took::Busy);
            }
            spin_loop();
        }
    }

    /// What is kept beside the state, if no thread is at it.
    pub(crate) fn look<R>(&self, look: impl FnOnce(&K) -> R) -> Option<R> {
        self.kept.try_lock().ok().map(|kept| look(&kept.1))
    }
}

/// When a thread that looks `phase_ns` after each begin of a tick looks next: later than now, at most a tick.
pub(crate) fn next_look_ns(now_ns: u64, start_ns: u64, phase_ns: u64, tick_ns: u64) -> u64 {
    let first = start_ns + phase_ns;
    if now_ns < first {
        return first;
    }
    first + ((now_ns - first) / tick_ns + 1) * tick_ns
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::{Took, Turn, next_look_ns};
    use proptest::prelude::*;

    #[test]
    fn each_tick_is_kept_once_and_in_order_by_many_threads() {
        // The state is the number of the tick; what is counted is the state that each tick was made from.
        let turn = Turn::new(0_u64, Vec::new());
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| {
                    loop {
                        let tick = turn.next();
                        if tick >= 20_000 {
                            break;
                        }
                        // Now and then a tick comes so late that others went by.
                        let num = 1 + tick % 3;
                        turn.take(
                            tick,
                            |state| {
                                let before = *state;
                                *state += num;
                                before
                            },
                            |counts, before| {
                                counts.push((tick, *before));
                                num
                            },
                        );
                    }
                });
            }
        });
        let done = turn.look(Clone::clone).unwrap();
        let mut expected = 0;
        for found in done {
            assert_eq!(found, (expected, expected));
            expected += 1 + expected % 3;
        }
        assert!(expected >= 20_000);
    }

    #[test]
    fn a_thread_that_is_held_up_in_a_tick_is_overtaken_and_changes_nothing() {
        let turn = Turn::new(0, Vec::new());
        let (begun, overtaken) = (Barrier::new(2), Barrier::new(2));
        std::thread::scope(|scope| {
            let slow = scope.spawn(|| {
                turn.take(
                    0,
                    |state| {
                        begun.wait();
                        overtaken.wait();
                        *state = 99;
                    },
                    |_, ()| unreachable!("it came second"),
                )
            });
            begun.wait();
            let quick = turn.take(
                0,
                |state| *state += 1,
                |counts, ()| {
                    counts.push("quick");
                    1
                },
            );
            assert_eq!(quick, Took::Done(()));
            overtaken.wait();
            assert_eq!(slow.join().unwrap(), Took::Past);
        });
        assert_eq!(turn.next(), 1);
        assert_eq!(turn.look(Clone::clone).unwrap(), ["quick"]);
        assert_eq!(turn.take(1, |state| *state, |_, _| 1), Took::Done(1));
        assert_eq!(turn.take(1, |state| *state, |_, _| 1), Took::Past);
    }

    #[test]
    fn who_cannot_get_by_gives_up_and_nothing_goes_on_from_what_somebody_broke() {
        let turn = Turn::new((), ());
        let took = turn.take(
            0,
            |()| (),
            |(), ()| {
                std::thread::scope(|scope| {
                    let other = scope.spawn(|| turn.take(0, |()| (), |(), ()| 1));
                    assert_eq!(other.join().unwrap(), Took::Busy);
                });
                1
            },
        );
        assert_eq!(took, Took::Done(()));
        let broke = std::thread::scope(|scope| {
            scope
                .spawn(|| turn.take(1, |()| (), |(), ()| panic!("on purpose")))
                .join()
        });
        assert!(broke.is_err());
        assert_eq!(turn.take(1, |()| (), |(), ()| 1), Took::Broken);
    }

    proptest! {
        #[test]
        fn the_next_look_is_the_first_of_its_phase_after_now(
            now in 0_u64..1 << 40, start in 0_u64..1 << 40, phase in 0_u64..1000, tick in 1000_u64..5000,
        ) {
            let look = next_look_ns(now, start, phase, tick);
            prop_assert!(look > now);
            prop_assert!(look >= start + phase);
            prop_assert_eq!((look - start - phase) % tick, 0);
            prop_assert!(look - tick <= now || look == start + phase);
        }
    }
}
