//! The force law: where the hand is and how fast, to force and torque.
//!
//! A proxy (Zilles and Salisbury, "A constraint-based god-object method for haptic display", IROS 1995) stays in the lumen
//! while the hand may be in the wall. Without contact it *is* the hand, so the force is exactly 0; in contact the force
//! draws the hand to it. Friction lets the proxy stick (Ruspini, Kolarov and Khatib, "The haptic display of complex
//! graphical environments", SIGGRAPH 1997).

use std::sync::Arc;

use carina_grid::{cross, dot, length, unit};

use crate::ScopeError;
use crate::axis::{along, sub};
use crate::body::distance;
use crate::wall::WallField;

type Point = [f64; 3];

/// The force never exceeds this ...
pub const LIMIT_N: f64 = 3.0;
/// ... and never changes by more than this in a millisecond.
pub const SLEW_N_PER_MS: f64 = 0.1;
/// Walls up to this stiffness are stable with a mass of 50 g and more and damping of 2 N s/m and more (`simulated.rs`).
pub const MAX_STIFFNESS_N_PER_MM: f64 = 0.6;
/// Guidance never draws harder than this: a hand can always leave the path.
const GUIDANCE_LIMIT_N: f64 = 1.0;
const TORQUE_LIMIT_N_MM: f64 = 60.0;
const TORQUE_SLEW_N_MM_PER_MS: f64 = 2.0;
const PROXY_STEP_MM: f64 = 0.4;
const PROXY_STEPS: usize = 12;

/// The numbers of the law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceLaw {
    /// Radius of the tip that feels.
    pub tip_radius_mm: f64,
    /// From the tip back to the hand: the lever of the torque.
    pub grip_mm: f64,
    /// Of the wall, N per mm.
    pub stiffness_n_per_mm: f64,
    /// Of the wall, against movement into or out of it, N per mm/s.
    pub damping_ns_per_mm: f64,
    /// Tangential force per force across the wall.
    pub friction: f64,
    /// Towards the path, N per mm; 0 for none.
    pub guidance_n_per_mm: f64,
    /// A hand that is silent for longer feels nothing.
    pub watchdog_ms: f64,
}

impl Default for ForceLaw {
    fn default() -> Self {
        Self {
            tip_radius_mm: 2.45,
            grip_mm: 40.0,
            stiffness_n_per_mm: 0.4,
            damping_ns_per_mm: 0.001,
            friction: 0.15,
            guidance_n_per_mm: 0.0,
            watchdog_ms: 20.0,
        }
    }
}

impl ForceLaw {
    /// Refuses numbers that are none, or that would not be stable.
    pub fn checked(self) -> Result<Self, ScopeError> {
        for (what, value, low, high) in [
            ("tip radius (mm)", self.tip_radius_mm, 0.5, 3.9),
            ("grip (mm)", self.grip_mm, 0.0, 600.0),
            (
                "stiffness (N/mm)",
                self.stiffness_n_per_mm,
                0.0,
                MAX_STIFFNESS_N_PER_MM,
            ),
            ("damping (N s/mm)", self.damping_ns_per_mm, 0.0, 0.003),
            ("friction", self.friction, 0.0, 1.0),
            ("guidance (N/mm)", self.guidance_n_per_mm, 0.0, 0.2),
            ("watchdog (ms)", self.watchdog_ms, 2.0, 200.0),
        ] {
            if !(low..=high).contains(&value) {
                return Err(ScopeError::Force {
                    reason: format!("expected a {what} from {low} to {high}, found {value}"),
                });
            }
        }
        Ok(self)
    }
}

/// Where the hand is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandSample {
    /// The tip, LPS mm.
    pub at_lps: Point,
    /// Its velocity, mm/s.
    pub velocity_mm_s: Point,
    /// Where it points, unit length.
    pub forward_lps: Point,
}

impl HandSample {
    /// False for numbers that no hand makes: NaN, 10 km away, faster than sound.
    #[must_use]
    pub fn is_sane(&self) -> bool {
        let within = |v: Point, most: f64| v.iter().all(|c| c.abs() <= most);
        within(self.at_lps, 1e7)
            && within(self.velocity_mm_s, 3.4e5)
            && (0.9..=1.1).contains(&length(self.forward_lps))
    }
}

/// What the hand feels.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HandForce {
    /// N.
    pub force_n: Point,
    /// About the grip, N mm.
    pub torque_n_mm: Point,
    /// The tip is at the wall.
    pub touches: bool,
    /// The wall would push harder than the limit lets it.
    pub limited: bool,
    /// No hand was heard of in time.
    pub is_silent: bool,
}

/// The law at work: it remembers the proxy and the force before. Copies are cheap.
#[derive(Debug, Clone)]
pub struct ForceModel {
    field: Arc<WallField>,
    law: ForceLaw,
    path: Arc<[Point]>,
    near: usize,
    proxy: Option<Point>,
    last: HandForce,
}

impl ForceModel {
    /// A law in a lumen, guided along a path (LPS mm) if it has one.
    pub fn new(field: Arc<WallField>, law: ForceLaw, path: Vec<Point>) -> Result<Self, ScopeError> {
        if path.iter().flatten().any(|v| !v.is_finite()) {
            return Err(ScopeError::Force {
                reason: "the path contains coordinates that are not finite".to_owned(),
            });
        }
        Ok(Self {
            field,
            law: law.checked()?,
            path: path.into(),
            near: 0,
            proxy: None,
            last: HandForce::default(),
        })
    }

    /// The law.
    #[must_use]
    pub const fn law(&self) -> &ForceLaw {
        &self.law
    }

    /// The lumen.
    #[must_use]
    pub const fn field(&self) -> &Arc<WallField> {
        &self.field
    }

    /// The force a millisecond (or less: `dt_ms`) after the last one; `None` is a hand that was not heard of in time.
    pub fn step(&mut self, hand: Option<&HandSample>, dt_ms: f64) -> HandForce {
        let mut wanted = HandForce::default();
        if let Some(hand) = hand {
            wanted = self.wanted(hand);
        } else {
            self.proxy = None;
            wanted.is_silent = true;
        }
        // Late ticks do not earn a larger change: a hand that was not asked may have let go.
        let dt = dt_ms.clamp(0.0, 1.0);
        let force_n = towards(self.last.force_n, wanted.force_n, SLEW_N_PER_MS * dt);
        let torque_n_mm = towards(
            self.last.torque_n_mm,
            wanted.torque_n_mm,
            TORQUE_SLEW_N_MM_PER_MS * dt,
        );
        self.last = HandForce {
            force_n: shortened(force_n, LIMIT_N),
            torque_n_mm: shortened(torque_n_mm, TORQUE_LIMIT_N_MM),
            ..wanted
        };
        self.last
    }

    fn wanted(&mut self, hand: &HandSample) -> HandForce {
        let normal = self.follow(hand.at_lps);
        let proxy = self.proxy.unwrap_or(hand.at_lps);
        let mut force = [0.0; 3];
        if let Some(n) = normal {
            let lack = sub(proxy, hand.at_lps);
            force = lack.map(|v| self.law.stiffness_n_per_mm * v);
            // Damping grows with depth, so that it does not jump where the wall begins; the wall never pulls.
            let depth = dot(lack, n).max(0.0);
            let speed = dot(hand.velocity_mm_s, n);
            let damping = self.law.damping_ns_per_mm * (depth / 0.3).min(1.0) * -speed;
            force = along(force, damping.max(-dot(force, n)), n);
        }
        let wall = length(force);
        let mut arm = sub(
            hand.at_lps,
            along(hand.at_lps, -self.law.grip_mm, hand.forward_lps),
        );
        if let Some(n) = normal {
            arm = along(arm, -self.law.tip_radius_mm, n);
        }
        let force = shortened(force, LIMIT_N);
        let guided: Point = {
            let drawn = self.guidance(hand.at_lps);
            std::array::from_fn(|a| force[a] + drawn[a])
        };
        HandForce {
            force_n: shortened(guided, LIMIT_N),
            torque_n_mm: shortened(cross(arm, force), TORQUE_LIMIT_N_MM),
            touches: normal.is_some(),
            limited: wall > LIMIT_N,
            is_silent: false,
        }
    }

    /// Moves the proxy after the hand; the wall's normal if it is held.
    fn follow(&mut self, hand: Point) -> Option<Point> {
        let r = self.law.tip_radius_mm;
        let field = &self.field;
        let Some(mut proxy) = self.proxy.or_else(|| field.freed(hand, r)) else {
            // Nowhere near is room: a hand far outside the lumen feels nothing.
            return None;
        };
        // The way back is far: the hand was set down elsewhere.
        if distance(proxy, hand) > 30.0 {
            self.proxy = None;
            return None;
        }
        let start = proxy;
        let mut normal = None;
        for _ in 0..PROXY_STEPS {
            let far = distance(proxy, hand);
            if far < 1e-9 {
                break;
            }
            let step = (PROXY_STEP_MM / far).min(1.0);
            let mut next = along(proxy, step, sub(hand, proxy));
            let mut held = None;
            for _ in 0..3 {
                let lack = r - field.distance_mm(next);
                if lack <= 1e-6 {
                    break;
                }
                held = field.away_from_wall(next).or(held);
                let Some(n) = held else { break };
                next = along(next, lack, n);
            }
            if field.distance_mm(next) < r - 0.05 {
                // No room to go on: it stays, held by what is before it.
                normal = held.or_else(|| unit(sub(proxy, hand)));
                break;
            }
            normal = held;
            let moved = distance(next, proxy);
            proxy = next;
            if moved < 1e-4 {
                break;
            }
        }
        if let Some(n) = normal {
            // Friction: the proxy slides only as far as the cone of what it held before lets it.
            let depth = dot(sub(proxy, hand), n).max(0.0);
            let slid = sub(proxy, start);
            let across = along(slid, -dot(slid, n), n);
            let far = length(across);
            let kept = self.law.friction * depth;
            if far > 1e-9 && self.proxy.is_some() {
                let back = (kept / far).min(1.0);
                let stuck = along(proxy, -back, across);
                // The wall may bend away from the tangent.
                proxy = field.freed(stuck, r).unwrap_or(proxy);
            }
        }
        self.proxy = Some(proxy);
        normal
    }

    fn guidance(&mut self, at: Point) -> Point {
        if self.law.guidance_n_per_mm == 0.0 || self.path.len() < 2 {
            return [0.0; 3];
        }
        // The hand moves little in a millisecond: the nearest place is near the last one.
        let nearest_in = |range: std::ops::Range<usize>| {
            range
                .map(|n| (distance(self.path[n], at), n))
                .fold((f64::INFINITY, 0), |a, b| if b.0 < a.0 { b } else { a })
        };
        let window = self.near.saturating_sub(30)..(self.near + 30).min(self.path.len());
        let mut found = nearest_in(window);
        if found.0 > 15.0 {
            found = nearest_in(0..self.path.len());
        }
        self.near = found.1;
        let before = self.path[found.1.saturating_sub(1)];
        let after = self.path[(found.1 + 1).min(self.path.len() - 1)];
        let Some(tangent) = unit(sub(after, before)) else {
            return [0.0; 3];
        };
        let off = sub(self.path[found.1], at);
        let across = along(off, -dot(off, tangent), tangent);
        shortened(
            across.map(|v| self.law.guidance_n_per_mm * v),
            GUIDANCE_LIMIT_N,
        )
    }
}

fn shortened(v: Point, most: f64) -> Point {
    let long = length(v);
    if long <= most {
        return v;
    }
    // A hair less, so that rounding does not exceed it.
    v.map(|c| c * (most * (1.0 - 1e-12) / long))
}

fn towards(from: Point, to: Point, most: f64) -> Point {
    let change = shortened(sub(to, from), most);
    std::array::from_fn(|a| from[a] + change[a])
}
