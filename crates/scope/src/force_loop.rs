//! The force law 1,000 times a second on a thread of its own, without the interpreter.
//!
//! A hand comes in process (`put`), over binary UDP on loopback, or is a simulated one. Waiting is by the system's clock
//! to an absolute time, so ticks do not drift; a tick whose work is not done a millisecond after it was due is a missed
//! deadline (decision 0125).

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
use crate::simulated::SimulatedHand;
use crate::ticking;

const TICK_NS: u64 = 1_000_000;
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
    felt: Mutex<(HandForce, Option<HandSample>)>,
    /// As of at most [`TELL_TICKS`] ago.
    figures: Mutex<LoopFigures>,
    num_refused: AtomicU64,
    started: Instant,
}

/// What goes on from tick to tick; of the loop's thread alone.
struct Tick {
    model: ForceModel,
    simulated: Option<WanderingHand>,
    newest: Option<(HandSample, Instant)>,
    last: HandForce,
    counts: LoopCounts,
}

/// What came from the hand since the last tick.
#[derive(Default)]
struct Heard {
    sample: Option<(HandSample, Instant)>,
    /// Who asked over UDP, and what.
    asked: Option<(SocketAddr, SamplePacket)>,
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
    thread: Option<JoinHandle<()>>,
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
        let device = options.lps_from_device.map(DeviceSpace::new).transpose()?;
        let socket = options.udp_port.map(open_port).transpose()?;
        let port = socket
            .as_ref()
            .and_then(|s| s.local_addr().ok())
            .map(|a| a.port());
        let tick = Tick {
            model,
            simulated: options.simulated,
            newest: None,
            last: HandForce::default(),
            counts: LoopCounts::new(),
        };
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            socket,
            device: device.unwrap_or(DeviceSpace::LPS),
            put: Mutex::new(None),
            felt: Mutex::new((HandForce::default(), None)),
            figures: Mutex::new(tick.counts.figures()),
            num_refused: AtomicU64::new(0),
            started: Instant::now(),
        });
        let of_thread = shared.clone();
        let thread = std::thread::Builder::new()
            .name("carina-force".to_owned())
            .spawn(move || keep_time(&of_thread, tick))
            .map_err(|e| ScopeError::Force {
                reason: format!("its thread could not be started ({e})"),
            })?;
        Ok(Self {
            shared,
            thread: Some(thread),
            port,
        })
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
        figures
    }

    /// Ends the loop and waits for it.
    pub fn stop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
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

/// The loop's thread.
fn keep_time(shared: &Shared, mut tick: Tick) {
    tick.counts.set_real_time(ticking::be_on_time());
    let start_ns = ticking::now_ns() + TICK_NS;
    let (mut number, mut num_done) = (0_u64, 0_u64);
    while !shared.stop.load(Ordering::Relaxed) {
        let due_ns = start_ns + number * TICK_NS;
        ticking::sleep_until(due_ns);
        let began_ns = ticking::now_ns();
        // A signal woke it.
        if began_ns < due_ns {
            continue;
        }
        number += shared.tick(&mut tick, due_ns, began_ns);
        num_done += 1;
        if num_done.is_multiple_of(TELL_TICKS) {
            shared.tell(&tick.counts);
        }
    }
    shared.tell(&tick.counts);
}

impl Shared {
    /// One tick; says how many were due by its end, itself among them.
    fn tick(&self, tick: &mut Tick, due_ns: u64, began_ns: u64) -> u64 {
        let began = Instant::now();
        let heard = self.listen(began);
        if heard.sample.is_some() {
            tick.newest = heard.sample;
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
        // Never waits for a reader: what it misses now it gets a millisecond later.
        if let Ok(mut out) = self.felt.try_lock() {
            *out = (tick.last, fresh);
        }
        let done_ns = ticking::now_ns();
        let num_due = 1 + done_ns.saturating_sub(due_ns) / TICK_NS;
        let times = TickTimes {
            num_due,
            late_us: began_ns.saturating_sub(due_ns) as f64 * 1e-3,
            work_us: done_ns.saturating_sub(began_ns) as f64 * 1e-3,
            latency_us: heard.sample.map(|(_, at)| at.elapsed().as_secs_f64() * 1e6),
        };
        tick.counts.add(&times, &tick.last, &last);
        self.answer(heard.asked, &tick.last);
        num_due
    }

    fn answer(&self, asked: Option<(SocketAddr, SamplePacket)>, felt: &HandForce) {
        if let Some((socket, (to, packet))) = self.socket.as_ref().zip(asked) {
            let answer = ForcePacket {
                number: packet.number,
                device_us: packet.device_us,
                felt: self.device.to_device(felt),
            };
            let bytes: [u8; FORCE_BYTES] = answer.to_bytes();
            // A bridge that went away is found by the watchdog.
            let _ = socket.send_to(&bytes, to);
        }
    }

    fn listen(&self, now: Instant) -> Heard {
        let mut heard = Heard::default();
        if let Some(socket) = &self.socket {
            // One byte more than a sample, so that a longer packet is told from one.
            let mut bytes = [0; SAMPLE_BYTES + 1];
            for _ in 0..MOST_PACKETS {
                let Ok((num, from)) = socket.recv_from(&mut bytes) else {
                    break;
                };
                match SamplePacket::from_bytes(&bytes[..num]) {
                    Some(packet) => heard.asked = Some((from, packet)),
                    None => {
                        self.num_refused.fetch_add(1, Ordering::Relaxed);
                    }
                }
            }
            heard.sample = heard
                .asked
                .map(|(_, packet)| (self.device.to_lps(&packet.hand), now));
        }
        if let Ok(mut put) = self.put.try_lock()
            && let Some(sample) = put.take()
        {
            heard.sample = Some(sample);
        }
        heard
    }

    fn tell(&self, counts: &LoopCounts) {
        if let Ok(mut told) = self.figures.try_lock() {
            *told = LoopFigures {
                cpu_s: ticking::cpu_ns_of_this_thread() as f64 * 1e-9,
                wall_s: self.started.elapsed().as_secs_f64(),
                ..counts.figures()
            };
        }
    }
}
