//! A device with mass and a hand with a spring, in place of a real one: for tests and for the benchmark of `packages/carina-haptics`.

use crate::force::{HandForce, HandSample};

type Point = [f64; 3];

/// A handle of a mass that a hand holds by a spring and moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedHand {
    /// Of the handle, kg.
    pub mass_kg: f64,
    /// Of the hand, N per mm.
    pub spring_n_per_mm: f64,
    /// Of hand and device, N per mm/s.
    pub damping_ns_per_mm: f64,
    /// Where the handle is, LPS mm.
    pub at_lps: Point,
    /// Its velocity, mm/s.
    pub velocity_mm_s: Point,
}

impl SimulatedHand {
    /// A light device in a soft hand.
    #[must_use]
    pub const fn new(at_lps: Point) -> Self {
        Self {
            mass_kg: 0.1,
            spring_n_per_mm: 0.2,
            damping_ns_per_mm: 0.004,
            at_lps,
            velocity_mm_s: [0.0; 3],
        }
    }

    /// Moves on by `dt_s` while the hand wants to be at a place and a force is felt. The device holds the force between
    /// its ticks; the body moves in steps of 1/10 ms.
    pub fn step(&mut self, wanted_lps: Point, felt: &HandForce, dt_s: f64) {
        let num = (dt_s / 1e-4).ceil().max(1.0);
        let dt = dt_s / num;
        for _ in 0..num as usize {
            for a in 0..3 {
                let force_n = felt.force_n[a]
                    + self.spring_n_per_mm * (wanted_lps[a] - self.at_lps[a])
                    - self.damping_ns_per_mm * self.velocity_mm_s[a];
                // 1 N on 1 kg is 1000 mm/s^2.
                self.velocity_mm_s[a] += 1000.0 * force_n / self.mass_kg * dt;
                self.at_lps[a] += self.velocity_mm_s[a] * dt;
            }
        }
    }

    /// What the device reports: places in steps of its encoders, velocity from it.
    #[must_use]
    pub fn sample(&self, encoder_mm: f64) -> HandSample {
        HandSample {
            at_lps: self.at_lps.map(|v| (v / encoder_mm).round() * encoder_mm),
            velocity_mm_s: self.velocity_mm_s,
            forward_lps: [0.0, 0.0, -1.0],
        }
    }
}
