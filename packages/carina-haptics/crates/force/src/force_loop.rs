//! Force loop: evaluation of the force law 1,000 times a second on its own thread, without the Python interpreter.
//!
//! Samples arrive from a call of `put`, over binary UDP on loopback, or from a simulated hand. The thread waits until
//! absolute times of the system's clock, so that ticks do not drift; a tick that is not finished a millisecond after
//! its due time is a missed deadline (decision 0143).

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use carina_grid::Affine;

use crate::ForceError;
use crate::device_space::DeviceSpace;
use crate::law::{ForceModel, HandForce, HandSample};
use crate::packet::{FORCE_BYTES, ForcePacket, SAMPLE_BYTES, SamplePacket};
use crate::simulated_hand::SimulatedHand;
use crate::tick_clock;
use crate::tick_statistics::{LoopCounts, LoopFigures, TickTimes};

/// Length of a tick, ns.
const TICK_NS: u64 = 1_000_000;
/// Maximum number of packets that one tick reads, so that a bridge (program that connects a device) that floods the port
/// does not delay the loop.
const MAX_PACKETS: usize = 16;
/// Number of ticks between updates of the statistics, whose histograms take some microseconds to read.
const UPDATE_TICKS: u64 = 50;

struct Shared {
    stop: AtomicBool,
    socket: Option<UdpSocket>,
    device: DeviceSpace,
    /// Latest sample from `put` and the time of that call; `None` after the loop has taken it.
    put: Mutex<Option<(HandSample, Instant)>>,
    felt: Mutex<(HandForce, Option<HandSample>)>,
    /// Timing statistics, at most [`UPDATE_TICKS`] ticks old.
    figures: Mutex<LoopFigures>,
    num_refused: AtomicU64,
    started: Instant,
}

/// State that the loop keeps from one tick to the next; only the loop's thread has access to it.
struct Tick {
    model: ForceModel,
    simulated: Option<WanderingHand>,
    newest: Option<(HandSample, Instant)>,
    last: HandForce,
    counts: LoopCounts,
}

/// Input that has arrived since the previous tick.
#[derive(Default)]
struct TickInput {
    sample: Option<(HandSample, Instant)>,
    /// Sender and content of the latest UDP message with a sample.
    request: Option<(SocketAddr, SamplePacket)>,
}

fn held<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Simulated hand that moves on a curve, for tests and benchmarks.
#[derive(Debug, Clone, Copy)]
pub struct WanderingHand {
    /// Simulated device and hand.
    pub hand: SimulatedHand,
    /// Centre of the curve, LPS mm.
    pub round_lps: [f64; 3],
    /// Radius of the curve, mm.
    pub reach_mm: f64,
    /// Number of turns on the curve per second.
    pub turns_hz: f64,
}

impl WanderingHand {
    /// Advance the hand by a millisecond under a force, and return its sample.
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

/// Running force loop; dropping the value stops the loop's thread.
pub struct ForceLoop {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    port: Option<u16>,
}

/// Sources of the samples of a force loop.
#[derive(Debug, Clone, Copy, Default)]
pub struct LoopOptions {
    /// UDP port on 127.0.0.1 (0: any free port); `None` for no UDP.
    pub udp_port: Option<u16>,
    /// Simulated hand that replaces a device; `None` for none.
    pub simulated: Option<WanderingHand>,
    /// Transform from the space of the device to LPS; `None` if samples are in LPS.
    pub lps_from_device: Option<Affine>,
}

impl ForceLoop {
    /// Start a force loop on a new thread.
    pub fn start(model: ForceModel, options: LoopOptions) -> Result<Self, ForceError> {
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
            .spawn(move || run_ticks(&of_thread, tick))
            .map_err(|e| ForceError {
                reason: format!("its thread could not be started ({e})"),
            })?;
        Ok(Self {
            shared,
            thread: Some(thread),
            port,
        })
    }

    /// Return the UDP port of the loop; `None` without UDP.
    #[must_use]
    pub const fn port(&self) -> Option<u16> {
        self.port
    }

    /// Pass a sample (LPS) to the loop; return false, without any effect, if the sample is not plausible.
    #[must_use]
    pub fn put(&self, sample: HandSample) -> bool {
        if !sample.is_sane() {
            self.shared.num_refused.fetch_add(1, Ordering::Relaxed);
            return false;
        }
        *held(&self.shared.put) = Some((sample, Instant::now()));
        true
    }

    /// Return the latest force, in LPS, and the sample from which it was computed.
    #[must_use]
    pub fn felt(&self) -> (HandForce, Option<HandSample>) {
        *held(&self.shared.felt)
    }

    /// Return the timing statistics of the loop.
    #[must_use]
    pub fn figures(&self) -> LoopFigures {
        let mut figures = held(&self.shared.figures).clone();
        figures.num_refused = self.shared.num_refused.load(Ordering::Relaxed);
        figures
    }

    /// Stop the loop and wait for its thread.
    pub fn stop(&mut self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has ended as well, so its error is ignored.
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

fn open_port(port: u16) -> Result<UdpSocket, ForceError> {
    let refuse = |e: std::io::Error| ForceError {
        reason: format!("port {port} of 127.0.0.1 could not be opened ({e})"),
    };
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, port)).map_err(refuse)?;
    socket.set_nonblocking(true).map_err(refuse)?;
    Ok(socket)
}

/// Run ticks at their due times until the loop is stopped (the body of the loop's thread).
fn run_ticks(shared: &Shared, mut tick: Tick) {
    tick.counts.set_real_time(tick_clock::request_priority());
    let start_ns = tick_clock::now_ns() + TICK_NS;
    let (mut number, mut num_done) = (0_u64, 0_u64);
    while !shared.stop.load(Ordering::Relaxed) {
        let due_ns = start_ns + number * TICK_NS;
        tick_clock::sleep_until(due_ns);
        let began_ns = tick_clock::now_ns();
        // A signal has ended the wait early.
        if began_ns < due_ns {
            continue;
        }
        number += shared.tick(&mut tick, due_ns, began_ns);
        num_done += 1;
        if num_done.is_multiple_of(UPDATE_TICKS) {
            shared.update_figures(&tick.counts);
        }
    }
    shared.update_figures(&tick.counts);
}

impl Shared {
    /// Run one tick; return the number of ticks that were due by the end of this one, including this one.
    fn tick(&self, tick: &mut Tick, due_ns: u64, began_ns: u64) -> u64 {
        let began = Instant::now();
        let input = self.read_input(began);
        if input.sample.is_some() {
            tick.newest = input.sample;
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
        // The loop never waits for a reader, which reads the next force a millisecond later.
        if let Ok(mut out) = self.felt.try_lock() {
            *out = (tick.last, fresh);
        }
        let done_ns = tick_clock::now_ns();
        let num_due = 1 + done_ns.saturating_sub(due_ns) / TICK_NS;
        let times = TickTimes {
            num_due,
            late_us: began_ns.saturating_sub(due_ns) as f64 * 1e-3,
            work_us: done_ns.saturating_sub(began_ns) as f64 * 1e-3,
            latency_us: input.sample.map(|(_, at)| at.elapsed().as_secs_f64() * 1e6),
        };
        tick.counts.add(&times, &tick.last, &last);
        self.send_force(input.request, &tick.last);
        num_due
    }

    fn send_force(&self, request: Option<(SocketAddr, SamplePacket)>, felt: &HandForce) {
        if let Some((socket, (to, packet))) = self.socket.as_ref().zip(request) {
            let answer = ForcePacket {
                number: packet.number,
                device_us: packet.device_us,
                felt: self.device.to_device(felt),
            };
            let bytes: [u8; FORCE_BYTES] = answer.to_bytes();
            // Send errors are ignored, because the watchdog detects a bridge that has ended.
            let _ = socket.send_to(&bytes, to);
        }
    }

    fn read_input(&self, now: Instant) -> TickInput {
        let mut input = TickInput::default();
        if let Some(socket) = &self.socket {
            // The buffer has one byte more than a sample, so that a longer packet is detected.
            let mut bytes = [0; SAMPLE_BYTES + 1];
            for _ in 0..MAX_PACKETS {
                let Ok((num, from)) = socket.recv_from(&mut bytes) else {
                    break;
                };
                match SamplePacket::from_bytes(&bytes[..num]) {
                    Some(packet) => input.request = Some((from, packet)),
                    None => {
                        self.num_refused.fetch_add(1, Ordering::Relaxed);
                    }
                }
            }
            input.sample = input
                .request
                .map(|(_, packet)| (self.device.to_lps(&packet.hand), now));
        }
        if let Ok(mut put) = self.put.try_lock()
            && let Some(sample) = put.take()
        {
            input.sample = Some(sample);
        }
        input
    }

    fn update_figures(&self, counts: &LoopCounts) {
        if let Ok(mut figures) = self.figures.try_lock() {
            *figures = LoopFigures {
                cpu_s: tick_clock::cpu_ns_of_this_thread() as f64 * 1e-9,
                wall_s: self.started.elapsed().as_secs_f64(),
                ..counts.figures()
            };
        }
    }
}
