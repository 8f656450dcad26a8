//! Force law: computation of force and torque from the position and velocity of the hand.
//!
//! The *proxy* (Zilles and Salisbury, "A constraint-based god-object method for haptic display", IROS 1995) is a
//! position of the tip that stays in the lumen while the hand may be in the wall. Without contact the proxy has the
//! position of the hand, so the force is exactly 0; in contact the force pulls the hand towards the proxy. Friction
//! lets the proxy stick (Ruspini, Kolarov and Khatib, "The haptic display of complex graphical environments", SIGGRAPH
//! 1997).

use std::sync::Arc;

use carina_grid::{cross, dot, length, unit};
use carina_scope::WallField;

use crate::ForceError;
use crate::vector::{Point, along, distance, sub};

/// Maximum force on the hand, N.
pub const LIMIT_N: f64 = 3.0;
/// Maximum change of the force in a millisecond, N.
pub const SLEW_N_PER_MS: f64 = 0.1;
/// Maximum stiffness of the wall, N per mm, that is stable with a device of at least 50 g.
///
/// The damping must be at least 2 N s/m (`law_tests.rs`).
pub const MAX_STIFFNESS_N_PER_MM: f64 = 0.6;
/// Maximum force of guidance towards the path, N, so that a hand can leave the path.
const GUIDANCE_LIMIT_N: f64 = 1.0;
/// Maximum torque about the grip, N mm.
const TORQUE_LIMIT_N_MM: f64 = 60.0;
/// Maximum change of the torque in a millisecond, N mm.
const TORQUE_SLEW_N_MM_PER_MS: f64 = 2.0;
/// Maximum step of the proxy towards the hand, mm.
const PROXY_STEP_MM: f64 = 0.4;
/// Maximum number of steps of the proxy in one tick.
const PROXY_STEPS: usize = 12;

/// Parameters of the force law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceLaw {
    /// Radius of the tip that touches the wall.
    pub tip_radius_mm: f64,
    /// Distance from the tip back to the hand, mm, which is the lever of the torque.
    pub grip_mm: f64,
    /// Stiffness of the wall, N per mm.
    pub stiffness_n_per_mm: f64,
    /// Damping of movement across the wall, N per mm/s.
    pub damping_ns_per_mm: f64,
    /// Coefficient of friction: ratio of the force along the wall to the force across the wall.
    pub friction: f64,
    /// Stiffness of the pull towards the path, N per mm; 0 switches guidance off.
    pub guidance_n_per_mm: f64,
    /// Time without a sample after which the force is set to 0, ms.
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
    /// Check the parameters and return them unchanged.
    ///
    /// # Errors
    ///
    /// Returns an error if a parameter is not finite or the law would not be stable.
    pub fn checked(self) -> Result<Self, ForceError> {
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
                return Err(ForceError {
                    reason: format!("expected a {what} from {low} to {high}, found {value}"),
                });
            }
        }
        Ok(self)
    }
}

/// Position, velocity and direction of the hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HandSample {
    /// Position of the tip, LPS mm.
    pub at_lps: Point,
    /// Velocity of the tip, mm/s.
    pub velocity_mm_s: Point,
    /// Direction of the tip, a unit vector in LPS.
    pub forward_lps: Point,
}

impl HandSample {
    /// Return whether the numbers are possible for a hand: finite, within 10 km, slower than sound.
    #[must_use]
    pub fn is_sane(&self) -> bool {
        let within = |v: Point, most: f64| v.iter().all(|c| c.abs() <= most);
        within(self.at_lps, 1e7)
            && within(self.velocity_mm_s, 3.4e5)
            && (0.9..=1.1).contains(&length(self.forward_lps))
    }
}

/// Force and torque on the hand.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HandForce {
    /// Force on the hand, N, LPS.
    pub force_n: Point,
    /// Torque about the grip, N mm, LPS.
    pub torque_n_mm: Point,
    /// Whether the tip touches the wall.
    pub touches: bool,
    /// Whether the force limit makes the force smaller than the force with which the wall would push.
    pub limited: bool,
    /// Whether the force is 0 because no sample arrived within the time of the watchdog.
    pub is_silent: bool,
}

/// State of the force law: the proxy and the previous force.
///
/// A clone shares the wall field.
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
    /// Create the state of the force law in a lumen.
    ///
    /// `path` (LPS mm) is the path of the guidance; an empty path gives no guidance.
    pub fn new(field: Arc<WallField>, law: ForceLaw, path: Vec<Point>) -> Result<Self, ForceError> {
        if path.iter().flatten().any(|v| !v.is_finite()) {
            return Err(ForceError {
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

    /// Return the parameters of the force law.
    #[must_use]
    pub const fn law(&self) -> &ForceLaw {
        &self.law
    }

    /// Return the wall field of the lumen.
    #[must_use]
    pub const fn field(&self) -> &Arc<WallField> {
        &self.field
    }

    /// Compute the force for a sample, `dt_ms` (at most 1 ms) after the previous force.
    ///
    /// `hand` is `None` if no sample arrived in time.
    pub fn step(&mut self, hand: Option<&HandSample>, dt_ms: f64) -> HandForce {
        let mut wanted = HandForce::default();
        if let Some(hand) = hand {
            wanted = self.wanted(hand);
        } else {
            self.proxy = None;
            wanted.is_silent = true;
        }
        // A late tick may not change the force by more than a punctual tick, because the user may have released the
        // device.
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
            // Damping grows with the depth, so that the force does not jump where the wall begins; the wall never
            // pulls.
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

    /// Move the proxy towards the hand; return the normal of the wall if the wall stops the proxy, otherwise `None`.
    fn follow(&mut self, hand: Point) -> Option<Point> {
        let r = self.law.tip_radius_mm;
        let field = &self.field;
        let Some(mut proxy) = self.proxy.or_else(|| free_position(field, hand, r)) else {
            // There is no free position nearby: a hand far outside the lumen feels no force.
            return None;
        };
        // A distance this large means that the user moved the device without a sample.
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
                // The proxy cannot move on and stays; the normal is that of the wall ahead.
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
            // With friction, the proxy slides only as far as the hand is outside the friction cone.
            let depth = dot(sub(proxy, hand), n).max(0.0);
            let slid = sub(proxy, start);
            let across = along(slid, -dot(slid, n), n);
            let far = length(across);
            let cone_mm = self.law.friction * depth;
            if far > 1e-9 && self.proxy.is_some() {
                let back = (cone_mm / far).min(1.0);
                let stuck = along(proxy, -back, across);
                // The wall may curve away from the tangent, so a free position is searched again.
                proxy = free_position(field, stuck, r).unwrap_or(proxy);
            }
        }
        self.proxy = Some(proxy);
        normal
    }

    fn guidance(&mut self, at: Point) -> Point {
        if self.law.guidance_n_per_mm == 0.0 || self.path.len() < 2 {
            return [0.0; 3];
        }
        // The hand moves little in a millisecond, so the nearest point is near the previous one.
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

/// Return a position at least `clearance_mm` from the wall, found by steps away from the wall that start at `from_lps`.
///
/// The result is `None` if 64 steps reach no such position.
fn free_position(field: &WallField, from_lps: Point, clearance_mm: f64) -> Option<Point> {
    let mut p = from_lps;
    for _ in 0..64 {
        let lack = clearance_mm - field.distance_mm(p);
        if lack <= 0.0 {
            return Some(p);
        }
        let away = field.away_from_wall(p)?;
        p = std::array::from_fn(|a| p[a] + lack.max(0.05) * away[a]);
    }
    None
}

fn shortened(v: Point, most: f64) -> Point {
    let long = length(v);
    if long <= most {
        return v;
    }
    // The factor is slightly less than 1, so that rounding does not exceed the limit.
    v.map(|c| c * (most * (1.0 - 1e-12) / long))
}

fn towards(from: Point, to: Point, most: f64) -> Point {
    let change = shortened(sub(to, from), most);
    std::array::from_fn(|a| from[a] + change[a])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_tube::tube;

    #[test]
    fn a_position_in_the_wall_is_moved_into_the_lumen_if_the_tip_fits() {
        let field = tube();
        let free = free_position(&field, [9.8, 0.5, 60.0], 2.0).unwrap();
        assert!(field.distance_mm(free) >= 2.0);
        assert!(free_position(&field, [9.8, 0.5, 60.0], 9.5).is_none());
    }
}
