//! The force law 1,000 times a second on a thread of its own, without the interpreter.
//!
//! A hand comes in process (`put`), over binary UDP on loopback, or is a simulated one. Waiting is by the system's clock
//! to an absolute time, so ticks do not drift; a tick whose work is not done a millisecond after it was due is a missed
//! deadline.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use carina_grid::{Affine, cross, dot, length};

use crate::ScopeError;
use crate::force::{ForceModel, HandForce, HandSample};
use crate::packet::{FORCE_BYTES, ForcePacket, SAMPLE_BYTES, SamplePacket};
use crate::realtime;
use crate::simulated::SimulatedHand;

const TICK: Duration = Duration::from_millis(1);
/// Lateness is counted in bins of 1 us up to here.
const LATE_BINS: usize = 5000;
/// A bridge that floods the port does not hold up the loop.
const MOST_PACKETS: usize = 16;
/// Figures are told so often: their histograms take some microseconds to read.
const TELL_TICKS: u64 = 50;

/// How the loop kept time.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopFigures {
    /// Ticks that were due since the start.
    pub num_ticks: u64,
    /// Of which not done within their millisecond.
    pub num_missed: u64,
    /// How late ticks began: median, 99th percentile and worst, us.
    pub late_us: [f64; 3],
    /// From when a sample was put (or its packet taken) to its force: median, 99th percentile and worst, us.
    pub latency_us: [f64; 3],
    /// Time of the thread on a core.
    pub cpu_s: f64,
    /// Time since the start.
    pub wall_s: f64,
    /// Samples that were taken.
    pub num_samples: u64,
    /// Packets that were no sane samples.
    pub num_refused: u64,
    /// The system lets the thread go before all others.
    pub is_realtime: bool,
    /// The strongest force and the largest change in a tick so far, N.
    pub max_force_n: f64,
    /// See `max_force_n`.
    pub max_change_n: f64,
}

struct Histogram {
    counts: Vec<u32>,
    num: u64,
    worst: f64,
}

impl Histogram {
    fn new() -> Self {
        Self {
            counts: vec![0; LATE_BINS],
            num: 0,
            worst: 0.0,
        }
    }

    fn add(&mut self, us: f64) {
        let bin = (us.max(0.0) as usize).min(LATE_BINS - 1);
        self.counts[bin] += 1;
        self.num += 1;
        self.worst = self.worst.max(us);
    }

    fn summary(&self) -> [f64; 3] {
        let at = |share: f64| {
            let wanted = (share * self.num as f64).ceil() as u64;
            let mut seen = 0;
            for (bin, &count) in self.counts.iter().enumerate() {
                seen += u64::from(count);
                if seen >= wanted && seen > 0 {
                    return bin as f64;
                }
            }
            0.0
        };
        [at(0.5), at(0.99), self.worst]
    }
}

struct Inside {
    late: Histogram,
    latency: Histogram,
    num_ticks: u64,
    num_missed: u64,
    num_samples: u64,
    num_refused: u64,
    started: Instant,
    is_realtime: bool,
    max_force_n: f64,
    max_change_n: f64,
}

struct Shared {
    stop: AtomicBool,
    /// The newest sample in process and when it came; taken by the loop.
    put: Mutex<Option<(HandSample, Instant)>>,
    felt: Mutex<(HandForce, Option<HandSample>)>,
    /// As of at most [`TELL_TICKS`] ago.
    figures: Mutex<LoopFigures>,
    num_put_refused: AtomicU64,
}

impl Inside {
    fn new(is_realtime: bool) -> Self {
        Self {
            late: Histogram::new(),
            latency: Histogram::new(),
            num_ticks: 0,
            num_missed: 0,
            num_samples: 0,
            num_refused: 0,
            started: Instant::now(),
            is_realtime,
            max_force_n: 0.0,
            max_change_n: 0.0,
        }
    }

    fn figures(&self) -> LoopFigures {
        LoopFigures {
            num_ticks: self.num_ticks,
            num_missed: self.num_missed,
            late_us: self.late.summary(),
            latency_us: self.latency.summary(),
            cpu_s: if self.num_ticks == 0 {
                0.0
            } else {
                realtime::cpu_s_of_this_thread()
            },
            wall_s: self.started.elapsed().as_secs_f64(),
            num_samples: self.num_samples,
            num_refused: self.num_refused,
            is_realtime: self.is_realtime,
            max_force_n: self.max_force_n,
            max_change_n: self.max_change_n,
        }
    }
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
        let shared = Arc::new(Shared {
            stop: AtomicBool::new(false),
            put: Mutex::new(None),
            felt: Mutex::new((HandForce::default(), None)),
            figures: Mutex::new(Inside::new(false).figures()),
            num_put_refused: AtomicU64::new(0),
        });
        let mut runner = Runner {
            shared: shared.clone(),
            model,
            socket,
            device: device.unwrap_or(DeviceSpace {
                lps_from_device: Affine::IDENTITY,
                scale: 1.0,
            }),
            simulated: options.simulated,
            newest: None,
        };
        let thread = std::thread::Builder::new()
            .name("carina-force".to_owned())
            .spawn(move || runner.run())
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
            self.shared.num_put_refused.fetch_add(1, Ordering::Relaxed);
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
        figures.num_refused += self.shared.num_put_refused.load(Ordering::Relaxed);
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

/// A rotation, a shift and one scale.
struct DeviceSpace {
    lps_from_device: Affine,
    scale: f64,
}

impl DeviceSpace {
    fn new(lps_from_device: Affine) -> Result<Self, ScopeError> {
        let axes = [0, 1, 2].map(|a| lps_from_device.column(a));
        let scale = length(axes[0]);
        let is_even = axes
            .iter()
            .all(|a| (length(*a) - scale).abs() <= 1e-6 * scale);
        let is_square =
            (0..3).all(|a| dot(axes[a], axes[(a + 1) % 3]).abs() <= 1e-6 * scale * scale);
        // More than 4 would make every tremor a jump; the felt stiffness grows with the scale.
        if !(is_even && is_square && (0.05..=1.0).contains(&scale)) {
            return Err(ScopeError::Force {
                reason: "the device's space must be turned, shifted and scaled alike on all axes, by 0.05 to 1 mm of \
                         the lumen per mm of the hand"
                    .to_owned(),
            });
        }
        if dot(cross(axes[0], axes[1]), axes[2]) <= 0.0 {
            return Err(ScopeError::Force {
                reason: "the device's space is mirrored: the hand's left would be the scope's right; its three axes \
                         must be right-handed"
                    .to_owned(),
            });
        }
        Ok(Self {
            lps_from_device,
            scale,
        })
    }

    fn to_lps(&self, hand: &HandSample) -> HandSample {
        HandSample {
            at_lps: self.lps_from_device.point(hand.at_lps),
            velocity_mm_s: self.lps_from_device.vector(hand.velocity_mm_s),
            forward_lps: self
                .lps_from_device
                .vector(hand.forward_lps)
                .map(|v| v / self.scale),
        }
    }

    fn to_device(&self, felt: &HandForce) -> HandForce {
        let turned = |v: [f64; 3]| {
            std::array::from_fn(|a| dot(self.lps_from_device.column(a), v) / self.scale)
        };
        HandForce {
            force_n: turned(felt.force_n),
            torque_n_mm: turned(felt.torque_n_mm),
            ..*felt
        }
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

struct Runner {
    shared: Arc<Shared>,
    model: ForceModel,
    socket: Option<UdpSocket>,
    device: DeviceSpace,
    simulated: Option<WanderingHand>,
    newest: Option<(HandSample, Instant)>,
}

impl Runner {
    fn run(&mut self) {
        let is_realtime = realtime::prefer_this_thread();
        let mut inside = Inside::new(is_realtime);
        let start = inside.started;
        let mut due = start + TICK;
        let mut last = HandForce::default();
        while !self.shared.stop.load(Ordering::Relaxed) {
            let now = Instant::now();
            if now < due {
                std::thread::sleep(due - now);
            }
            let began = Instant::now();
            let late = began.saturating_duration_since(due);
            let (peer, arrived, refused) = self.listen(began);
            self.simulate(&last, began.duration_since(start).as_secs_f64());
            let watchdog = Duration::from_secs_f64(self.model.law().watchdog_ms / 1000.0);
            let fresh = self
                .newest
                .filter(|(_, at)| began.saturating_duration_since(*at) <= watchdog);
            let felt = self.model.step(fresh.as_ref().map(|(s, _)| s), 1.0);
            if let Some((socket, (to, packet))) = self.socket.as_ref().zip(peer) {
                let answer = ForcePacket {
                    number: packet.number,
                    device_us: packet.device_us,
                    felt: self.device.to_device(&felt),
                };
                let bytes: [u8; FORCE_BYTES] = answer.to_bytes();
                // A bridge that went away is found by the watchdog.
                let _ = socket.send_to(&bytes, to);
            }
            // Never waits for a reader: what it misses now it gets a millisecond later.
            if let Ok(mut out) = self.shared.felt.try_lock() {
                *out = (felt, fresh.map(|(s, _)| s));
            }
            let done = Instant::now();
            // Skipped ticks were due as well, and are missed.
            let behind = done.saturating_duration_since(due);
            let skipped = u64::try_from(behind.as_micros() / TICK.as_micros()).unwrap_or(0);
            inside.late.add(late.as_secs_f64() * 1e6);
            if let Some(at) = arrived {
                inside.num_samples += 1;
                inside
                    .latency
                    .add(done.saturating_duration_since(at).as_secs_f64() * 1e6);
            }
            let told = inside.num_ticks / TELL_TICKS;
            inside.num_ticks += 1 + skipped;
            inside.num_missed += skipped;
            inside.num_refused += refused;
            let change: [f64; 3] = std::array::from_fn(|a| felt.force_n[a] - last.force_n[a]);
            inside.max_force_n = inside.max_force_n.max(length(felt.force_n));
            inside.max_change_n = inside.max_change_n.max(length(change));
            if inside.num_ticks / TELL_TICKS != told
                && let Ok(mut figures) = self.shared.figures.try_lock()
            {
                *figures = inside.figures();
            }
            last = felt;
            due += TICK * (1 + skipped as u32);
        }
        *held(&self.shared.figures) = inside.figures();
    }

    /// Takes the newest sample; the bridge to answer, when a sample came, and how many packets were none.
    fn listen(
        &mut self,
        now: Instant,
    ) -> (Option<(SocketAddr, SamplePacket)>, Option<Instant>, u64) {
        let (mut peer, mut arrived, mut refused) = (None, None, 0);
        if let Some(socket) = &self.socket {
            // One byte more than a sample, so that a longer packet is told from one.
            let mut bytes = [0; SAMPLE_BYTES + 1];
            for _ in 0..MOST_PACKETS {
                let Ok((num, from)) = socket.recv_from(&mut bytes) else {
                    break;
                };
                match SamplePacket::from_bytes(&bytes[..num]) {
                    Some(packet) => peer = Some((from, packet)),
                    None => refused += 1,
                }
            }
            if let Some((_, packet)) = &peer {
                self.newest = Some((self.device.to_lps(&packet.hand), now));
                arrived = Some(now);
            }
        }
        if let Ok(mut put) = self.shared.put.try_lock()
            && let Some(sample) = put.take()
        {
            arrived = Some(sample.1);
            self.newest = Some(sample);
        }
        (peer, arrived, refused)
    }

    fn simulate(&mut self, last: &HandForce, now_s: f64) {
        let Some(wander) = &mut self.simulated else {
            return;
        };
        let turn = core::f64::consts::TAU * wander.turns_hz * now_s;
        let wanted = [
            wander.round_lps[0] + wander.reach_mm * libm::cos(turn),
            wander.round_lps[1] + wander.reach_mm * libm::sin(1.3 * turn),
            wander.round_lps[2] + wander.reach_mm * libm::sin(0.37 * turn),
        ];
        wander.hand.step(wanted, last, 1e-3);
        self.newest = Some((wander.hand.sample(0.01), Instant::now()));
    }
}
