//! Simulated force device, moved by a hand that acts as a spring, for tests and for the timing benchmark.

use crate::law::{HandForce, HandSample};
use crate::vector::Point;

/// Handle of a device with mass, which a hand moves by a spring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedHand {
    /// Mass of the handle, kg.
    pub mass_kg: f64,
    /// Stiffness of the hand's spring, N per mm.
    pub spring_n_per_mm: f64,
    /// Damping of hand and device, N per mm/s.
    pub damping_ns_per_mm: f64,
    /// Position of the handle, LPS mm.
    pub at_lps: Point,
    /// Velocity of the handle, mm/s.
    pub velocity_mm_s: Point,
}

impl SimulatedHand {
    /// Create a light device in a soft hand, at rest at a position (LPS mm).
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

    /// Advance the handle by `dt_s` towards `wanted_lps` under a force.
    ///
    /// The device holds the force constant between its ticks; the handle moves in steps of 1/10 ms.
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

    /// Return the sample of the device: the position rounded to steps of its encoder, and the velocity.
    #[must_use]
    pub fn sample(&self, encoder_mm: f64) -> HandSample {
        HandSample {
            at_lps: self.at_lps.map(|v| (v / encoder_mm).round() * encoder_mm),
            velocity_mm_s: self.velocity_mm_s,
            forward_lps: [0.0, 0.0, -1.0],
        }
    }
}
