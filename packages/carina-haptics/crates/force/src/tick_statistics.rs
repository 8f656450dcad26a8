//! Timing statistics of the force loop.

use carina_grid::length;

use crate::law::HandForce;

/// Number of bins of a histogram; each bin is 1 us wide.
const LATE_BINS: usize = 5000;

/// Timing statistics of a force loop since its start.
#[derive(Debug, Clone, PartialEq)]
pub struct LoopFigures {
    /// Number of ticks that were due since the start.
    pub num_ticks: u64,
    /// Number of ticks that were not finished within their millisecond.
    pub num_missed: u64,
    /// Delay of the start of a tick: median, 99th percentile and maximum, us.
    pub late_us: [f64; 3],
    /// Duration of a tick: median, 99th percentile and maximum, us.
    pub work_us: [f64; 3],
    /// Time from a sample (or the arrival of its packet) to its force: median, 99th percentile and maximum, us.
    pub latency_us: [f64; 3],
    /// Processor time of the loop's thread, s.
    pub cpu_s: f64,
    /// Time since the start of the loop, s.
    pub wall_s: f64,
    /// Number of samples that the loop accepted.
    pub num_samples: u64,
    /// Number of samples and packets that the loop rejected.
    pub num_refused: u64,
    /// Whether the loop's thread has real-time priority.
    pub is_real_time: bool,
    /// Largest force since the start, N.
    pub max_force_n: f64,
    /// Largest change of the force in one tick, N.
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

/// Times of one tick that the statistics need.
pub(crate) struct TickTimes {
    /// Number of ticks, this one included, that were due before this tick ended.
    pub(crate) num_due: u64,
    pub(crate) late_us: f64,
    pub(crate) work_us: f64,
    /// Time from the sample of this tick to its force, us; `None` for a tick without a new sample.
    pub(crate) latency_us: Option<f64>,
}

/// Histograms and counters from which the timing statistics of a running loop are computed.
pub(crate) struct LoopCounts {
    late: Histogram,
    work: Histogram,
    latency: Histogram,
    figures: LoopFigures,
}

impl LoopCounts {
    pub(crate) fn new() -> Self {
        Self {
            late: Histogram::new(),
            work: Histogram::new(),
            latency: Histogram::new(),
            figures: LoopFigures {
                num_ticks: 0,
                num_missed: 0,
                late_us: [0.0; 3],
                work_us: [0.0; 3],
                latency_us: [0.0; 3],
                cpu_s: 0.0,
                wall_s: 0.0,
                num_samples: 0,
                num_refused: 0,
                is_real_time: false,
                max_force_n: 0.0,
                max_change_n: 0.0,
            },
        }
    }

    pub(crate) const fn set_real_time(&mut self, is_real_time: bool) {
        self.figures.is_real_time = is_real_time;
    }

    pub(crate) fn add(&mut self, tick: &TickTimes, felt: &HandForce, last: &HandForce) {
        let figures = &mut self.figures;
        // Ticks that were skipped were due, so they count as missed.
        figures.num_ticks += tick.num_due;
        figures.num_missed += tick.num_due - 1;
        self.late.add(tick.late_us);
        self.work.add(tick.work_us);
        if let Some(us) = tick.latency_us {
            figures.num_samples += 1;
            self.latency.add(us);
        }
        let change: [f64; 3] = std::array::from_fn(|a| felt.force_n[a] - last.force_n[a]);
        figures.max_force_n = figures.max_force_n.max(length(felt.force_n));
        figures.max_change_n = figures.max_change_n.max(length(change));
    }

    /// Compute the timing statistics; reading the histograms takes some microseconds.
    pub(crate) fn figures(&self) -> LoopFigures {
        LoopFigures {
            late_us: self.late.summary(),
            work_us: self.work.summary(),
            latency_us: self.latency.summary(),
            ..self.figures.clone()
        }
    }
}
