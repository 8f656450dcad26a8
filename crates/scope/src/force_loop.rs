//! The force law 1,000 times a second on threads of its own, without the interpreter.
//!
//! A hand comes in process (`put`), over binary UDP on loopback, or is a simulated one. Waiting is by the system's clock
//! to an absolute time, so ticks do not drift; a tick whose work is not done a millisecond after it was due is a missed
//! deadline. Where there are two cores, a second thread looks a moment later whether each tick was done, and does it
//! where the first is held up (decision 0029).

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use carina_grid::Affine;

use crate::ScopeError;
use crate::device_space::DeviceSpace;
use crate::force::{ForceModel, HandForce, HandSample};
use crate::loop_figures::{LoopCounts, LoopFigures, TickTimes};
use crate::packet::{FORCE_BYTES, ForcePacket, SAMPLE_BYTES, SamplePacket};
use crate::realtime::{self, Cores, Scheduling, WaitMeter};
use crate::simulated::SimulatedHand;
use crate::turn::{Took, Turn, next_look_ns};

const TICK_NS: u64 = 1_000_000;
/// The stand-in looks so long after a tick was due: 99 of 100 ticks have begun by then, also under load, and the rest
/// of the millisecond is enough for it.
const STAND_IN_NS: u64 = 150_000;
/// A bridge that floods the port does not hold up the loop.
const MOST_PACKETS: usize = 16;
/// Figures are told so often: their histograms take some microseconds to read.
const TELL_TICKS: u64 = 50;

struct Shared {
    stop: AtomicBool,
    socket: Option<UdpSocket>,
    device: DeviceSpace,
    /// The newest sample in process and when it came; taken by the loop.
    put: Mutex<Option<(HandSample, Instant)>>,
    heard: Mutex<Heard>,
    felt: Mutex<(HandForce, Option<HandSample>)>,
    /// As of at most [`TELL_TICKS`] ago.
    figures: Mutex<LoopFigures>,
    num_refused: AtomicU64,
    /// Of the first thread and of the stand-in.
    cpu_ns: [AtomicU64; 2],
    /// On the system's clock.
    start_ns: u64,
    started: Instant,
    turn: Turn<Tick, LoopCounts>,
}

/// What came from the hand, for whichever thread does the tick.
#[derive(Clone, Copy, Default)]
struct Heard {
    num: u64,
    newest: Option<(HandSample, Instant)>,
    /// The bridge's newest packet, until a tick answers it.
    unanswered: Option<(SocketAddr, SamplePacket)>,
}

/// What goes on from tick to tick.
#[derive(Clone)]
struct Tick {
    model: ForceModel,
    simulated: Option<WanderingHand>,
    newest: Option<(HandSample, Instant)>,
    last: HandForce,
    num_heard: u64,
}

/// What a tick found.
struct Found {
    felt: HandForce,
    last: HandForce,
    fresh: Option<HandSample>,
    arrived: Option<Instant>,
    unanswered: Option<(SocketAddr, SamplePacket)>,
    was_in_queue: bool,
}

fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A hand that moves by itself, for tests and benches.
#[derive(Debug, Clone, Copy)]
pub struct WanderingHand {
    /// The device and the hand.
    pub hand: SimulatedHand,
    /// It circles round this place ...
    pub round_lps: [f64; 3],
    /// ... this far ...
    pub reach_mm: f64,
    /// ... so often in a second.
    pub turns_hz: f64,
}

impl WanderingHand {
    /// Where it is a millisecond later, under the force that it felt.
    fn step(&mut self, felt: &HandForce, now_s: f64) -> HandSample {
        let turn = core::f64::consts::TAU * self.turns_hz * now_s;
        let wanted = [
            self.round_lps[0] + self.reach_mm * libm::cos(turn),
            self.round_lps[1] + self.reach_mm * libm::sin(1.3 * turn),
            self.round_lps[2] + self.reach_mm * libm::sin(0.37 * turn),
        ];
        self.hand.step(wanted, felt, 1e-3);
        self.hand.sample(0.01)
    }
}

/// The loop. It ends when it is dropped.
pub struct ForceLoop {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    port: Option<u16>,
}

/// How a loop is fed.
#[derive(Debug, Clone, Copy, Default)]
pub struct LoopOptions {
    /// Listen on this port of 127.0.0.1 (0: any free one).
    pub udp_port: Option<u16>,
    /// A simulated hand in place of a device.
    pub simulated: Option<WanderingHand>,
    /// A device's space: turns, shifts and scales it into LPS; `None` where samples are in LPS.
    pub lps_from_device: Option<Affine>,
}

impl ForceLoop {
    /// Starts the loop.
    pub fn start(model: ForceModel, options: LoopOptions) -> Result<Self, ScopeError> {
        Self::start_with(model, options, places())
    }

    fn start_with(
        model: ForceModel,
        options: LoopOptions,
        places: Vec<Place>,
    ) -> Result<Self, ScopeError> {
        let device = options.lps_from_device.map(DeviceSpace::new).transpose()?;
        let socket = options.udp_port.map(open_port).transpose()?;
        let port = socket
            .as_ref()
            .and_then(|s| s.local_addr().ok())
            .map(|a| a.port());
        let counts = LoopCounts::new();
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            socket,
            device: device.unwrap_or(DeviceSpace::LPS),
            put: Mutex::new(None),
            heard: Mutex::default(),
            felt: Mutex::new((HandForce::default(), None)),
            figures: Mutex::new(counts.figures()),
            num_refused: AtomicU64::new(0),
            cpu_ns: [AtomicU64::new(0), AtomicU64::new(0)],
            // The first tick is due when its threads are there.
            start_ns: realtime::now_ns() + TICK_NS,
            started: Instant::now(),
            turn: Turn::new(
                Tick {
                    model,
                    simulated: options.simulated,
                    newest: None,
                    last: HandForce::default(),
                    num_heard: 0,
                },
                counts,
            ),
        });
        let mut started = Self {
            shared,
            threads: Vec::new(),
            port,
        };
        for place in places {
            let shared = started.shared.clone();
            let spawned = std::thread::Builder::new()
                .name("carina-force".to_owned())
                .spawn(move || keep_time(&shared, &place));
            match spawned {
                Ok(thread) => started.threads.push(thread),
                // The first alone keeps the loop going.
                Err(_) if !started.threads.is_empty() => {}
                Err(e) => {
                    return Err(ScopeError::Force {
                        reason: format!("its thread could not be started ({e})"),
                    });
                }
            }
        }
        Ok(started)
    }

    /// A loop whose first thread is held up for ever.
    #[cfg(test)]
    pub(crate) fn start_stand_in_alone(
        model: ForceModel,
        options: LoopOptions,
    ) -> Result<Self, ScopeError> {
        let place = Place {
            stands_in: true,
            tells: true,
            cores: None,
        };
        Self::start_with(model, options, vec![place])
    }

    /// The UDP port that it listens on.
    #[must_use]
    pub const fn port(&self) -> Option<u16> {
        self.port
    }

    /// Hands over where the hand is now (LPS); false, and nothing is changed, for numbers that no hand makes.
    #[must_use]
    pub fn put(&self, sample: HandSample) -> bool {
        if !sample.is_sane() {
            self.shared.num_refused.fetch_add(1, Ordering::Relaxed);
            return false;
        }
        *held(&self.shared.put) = Some((sample, Instant::now()));
        true
    }

    /// The newest force, in LPS, and the sample that it answers.
    #[must_use]
    pub fn felt(&self) -> (HandForce, Option<HandSample>) {
        *held(&self.shared.felt)
    }

    /// How it keeps time.
    #[must_use]
    pub fn figures(&self) -> LoopFigures {
        let mut figures = held(&self.shared.figures).clone();
        figures.num_refused = self.shared.num_refused.load(Ordering::Relaxed);
        let cpu_ns = self.shared.cpu_ns.each_ref();
        figures.cpu_s = cpu_ns
            .map(|ns| ns.load(Ordering::Relaxed) as f64 * 1e-9)
            .iter()
            .sum();
        figures
    }

    /// Ends the loop and waits for it.
    pub fn stop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A loop that panicked is over as well.
            let _ = thread.join();
        }
        *held(&self.shared.felt) = (HandForce::default(), None);
    }
}

impl Drop for ForceLoop {
    fn drop(&mut self) {
        self.stop();
    }
}

fn open_port(port: u16) -> Result<UdpSocket, ScopeError> {
    let refuse = |e: std::io::Error| ScopeError::Force {
        reason: format!("port {port} of 127.0.0.1 could not be opened ({e})"),
    };
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, port)).map_err(refuse)?;
    socket.set_nonblocking(true).map_err(refuse)?;
    Ok(socket)
}

/// Which of the loop's threads one is.
struct Place {
    stands_in: bool,
    /// It tells the figures: one that has time.
    tells: bool,
    /// Where it stays, so that the two never wait on the same core.
    cores: Option<Cores>,
}

fn places() -> Vec<Place> {
    let Some([first, second]) = realtime::core_halves() else {
        return vec![Place {
            stands_in: false,
            tells: true,
            cores: None,
        }];
    };
    let place = |stands_in, cores| Place {
        stands_in,
        tells: stands_in,
        cores: Some(cores),
    };
    vec![place(false, first), place(true, second)]
}

/// One of the loop's threads.
fn keep_time(shared: &Shared, place: &Place) {
    let scheduling = realtime::prefer_this_thread();
    if let Some(cores) = &place.cores {
        realtime::stay_on(cores);
    }
    let phase_ns = if place.stands_in { STAND_IN_NS } else { 0 };
    let mut waits = WaitMeter::of_this_thread();
    let mut num_looks = 0_u64;
    while !shared.stop.load(Ordering::Relaxed) {
        let tick = shared.turn.next();
        let due_ns = shared.start_ns + tick * TICK_NS;
        realtime::sleep_until(due_ns + phase_ns);
        let began_ns = realtime::now_ns();
        // A signal woke it.
        if began_ns < due_ns {
            continue;
        }
        let took = shared.turn.take(
            tick,
            |state| {
                let mut found = shared.work(state);
                let behind_ns = realtime::now_ns().saturating_sub(due_ns);
                found.was_in_queue = behind_ns > TICK_NS && 2 * waits.since_last_ns() > behind_ns;
                found
            },
            |counts, found| shared.keep(counts, found, due_ns, began_ns, place.stands_in),
        );
        match took {
            Took::Done(found) => shared.answer(&found),
            Took::Past => {}
            Took::Busy => {
                let now_ns = realtime::now_ns();
                let look_ns = next_look_ns(now_ns, shared.start_ns, phase_ns, TICK_NS);
                realtime::sleep_until(look_ns);
            }
            Took::Broken => break,
        }
        num_looks += 1;
        if num_looks.is_multiple_of(TELL_TICKS) {
            waits.since_last_ns();
            shared.tell(place, scheduling);
        }
    }
    shared.tell(place, scheduling);
}

impl Shared {
    /// One tick, on a copy of what the last one left. Another thread may do the same: nothing is told to anybody here.
    fn work(&self, tick: &mut Tick) -> Found {
        let began = Instant::now();
        let heard = self.listen(began);
        let mut arrived = None;
        if let Some(heard) = heard.filter(|h| h.num > tick.num_heard) {
            tick.num_heard = heard.num;
            tick.newest = heard.newest;
            arrived = heard.newest.map(|(_, at)| at);
        }
        if let Some(wander) = &mut tick.simulated {
            let sample = wander.step(&tick.last, began.duration_since(self.started).as_secs_f64());
            tick.newest = Some((sample, began));
        }
        let watchdog = Duration::from_secs_f64(tick.model.law().watchdog_ms / 1000.0);
        let fresh = tick
            .newest
            .filter(|(_, at)| began.saturating_duration_since(*at) <= watchdog)
            .map(|(sample, _)| sample);
        let last = tick.last;
        tick.last = tick.model.step(fresh.as_ref(), 1.0);
        Found {
            felt: tick.last,
            last,
            fresh,
            arrived,
            unanswered: heard.and_then(|h| h.unanswered),
            was_in_queue: false,
        }
    }

    /// What is done once for each tick, while no other thread can; says how many ticks were due by now.
    fn keep(
        &self,
        counts: &mut LoopCounts,
        found: &mut Found,
        due_ns: u64,
        began_ns: u64,
        stands_in: bool,
    ) -> u64 {
        // Never waits for a reader: what it misses now it gets a millisecond later.
        if let Ok(mut out) = self.felt.try_lock() {
            *out = (found.felt, found.fresh);
        }
        // Whose answer it is, is settled here, too: a packet is answered once, by the tick that felt it.
        found.unanswered = found.unanswered.filter(|(_, packet)| {
            self.heard.try_lock().is_ok_and(|mut heard| {
                heard
                    .unanswered
                    .take_if(|(_, newest)| newest.number == packet.number)
                    .is_some()
            })
        });
        let done_ns = realtime::now_ns();
        let num_due = 1 + done_ns.saturating_sub(due_ns) / TICK_NS;
        let times = TickTimes {
            num_due,
            late_us: began_ns.saturating_sub(due_ns) as f64 * 1e-3,
            work_us: done_ns.saturating_sub(began_ns) as f64 * 1e-3,
            latency_us: found.arrived.map(|at| at.elapsed().as_secs_f64() * 1e6),
            was_in_queue: found.was_in_queue,
            stood_in: stands_in,
        };
        counts.add(&times, &found.felt, &found.last);
        num_due
    }

    fn answer(&self, found: &Found) {
        if let Some((socket, (to, packet))) = self.socket.as_ref().zip(found.unanswered) {
            let answer = ForcePacket {
                number: packet.number,
                device_us: packet.device_us,
                felt: self.device.to_device(&found.felt),
            };
            let bytes: [u8; FORCE_BYTES] = answer.to_bytes();
            // A bridge that went away is found by the watchdog.
            let _ = socket.send_to(&bytes, to);
        }
    }

    /// What came from the hand up to now; none where another thread is at it.
    fn listen(&self, now: Instant) -> Option<Heard> {
        let mut heard = self.heard.try_lock().ok()?;
        if let Some(socket) = &self.socket {
            // One byte more than a sample, so that a longer packet is told from one.
            let mut bytes = [0; SAMPLE_BYTES + 1];
            let mut came = None;
            for _ in 0..MOST_PACKETS {
                let Ok((num, from)) = socket.recv_from(&mut bytes) else {
                    break;
                };
                match SamplePacket::from_bytes(&bytes[..num]) {
                    Some(packet) => came = Some((from, packet)),
                    None => {
                        self.num_refused.fetch_add(1, Ordering::Relaxed);
                    }
                }
            }
            if let Some((_, packet)) = &came {
                heard.num += 1;
                heard.newest = Some((self.device.to_lps(&packet.hand), now));
                heard.unanswered = came;
            }
        }
        if let Ok(mut put) = self.put.try_lock()
            && let Some(sample) = put.take()
        {
            heard.num += 1;
            heard.newest = Some(sample);
        }
        Some(*heard)
    }

    fn tell(&self, place: &Place, scheduling: Scheduling) {
        let ns = realtime::cpu_ns_of_this_thread();
        self.cpu_ns[usize::from(place.stands_in)].store(ns, Ordering::Relaxed);
        if place.tells
            && let Some(figures) = self.turn.look(LoopCounts::figures)
            && let Ok(mut told) = self.figures.try_lock()
        {
            *told = LoopFigures {
                wall_s: self.started.elapsed().as_secs_f64(),
                scheduling,
                ..figures
            };
        }
    }
}
