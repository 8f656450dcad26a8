//! Balls that represent the surface of the rigid tip (feelers), and their clearance from the wall.
//!
//! The balls are so dense that a ridge of the wall cannot penetrate between them by more than some hundredths of a
//! millimetre, so a wide tip has hundreds of balls. Most of them are not tested: each group has a leader, and if the
//! clearance of the leader is large enough for its whole group, the other balls of the group need no test.

use crate::body::{Entry, ScopeBody, Tip, distance};
use crate::wall::WallField;

/// Radius of the rounded edge between the face and the side of the tip, mm.
const EDGE_MM: f64 = 0.6;
/// Distance between neighbouring balls of the face, the edge and the side behind the edge, mm.
///
/// A ridge of the wall can penetrate between two neighbouring balls by `APART_MM^2 / (8 EDGE_MM)`.
const APART_MM: f64 = 0.36;
/// Distance between the balls on the axis behind the face, mm.
///
/// A ridge of the wall penetrates between two neighbouring balls by at most 0.03 mm for the thinnest tip.
const AXIS_MM: f64 = 0.4;
/// Gap in mm that the drive leaves between the balls of the tip's surface and the wall.
///
/// At an edge of the wall the interpolated field is some hundredths of a millimetre too large, and a ridge penetrates
/// between balls by as much.
pub(crate) const SKIN_MM: f64 = 0.03;
/// Maximum distance in mm from the leader of a group of test balls to the other balls of the group.
const REACH_MM: f64 = 0.75;
/// Clearance, in addition to the reach of its group, that a leader must have so that its group needs no test, mm.
///
/// Distances change by at most 1 mm per mm, but interpolated values of the field may change a little more, and
/// clearances up to the end of contact must be exact.
const GUARD_MM: f64 = 0.5;

/// Margin in mm for comparisons of clearances, larger than their rounding errors.
const ROUNDING_MM: f64 = 1e-9;

/// Ball of the tip's surface: its centre in the tip's frame and its radius, mm.
///
/// The frame is right, down, forward; its origin is the face's centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Feeler {
    pub(crate) at: [f64; 3],
    pub(crate) radius: f64,
}

/// Group of consecutive balls of the tip's surface; the first ball represents the group.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Group {
    first: usize,
    end: usize,
    /// Distance from the leader's centre to the farthest centre of the group's balls, mm.
    reach_mm: f64,
}

/// All balls of a rigid tip, which is a cylinder with a flat face and a rounded edge.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Feelers {
    balls: Vec<Feeler>,
    groups: Vec<Group>,
    /// Number of groups of the face, the edge and the side near them; the balls of the other groups are on the axis.
    num_front: usize,
    radius_mm: f64,
}

/// Smallest clearance of the tip's balls from the wall, with its position in the tip's frame and in space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Clearance {
    pub(crate) mm: f64,
    pub(crate) at_lps: [f64; 3],
    pub(crate) in_tip: [f64; 3],
}

impl Clearance {
    const fn none(tip: &Tip) -> Self {
        Self {
            mm: f64::INFINITY,
            at_lps: tip.at,
            in_tip: [0.0; 3],
        }
    }
}

impl Feelers {
    pub(crate) fn new(body: &ScopeBody) -> Self {
        let r = body.tip_radius_mm;
        let edge = EDGE_MM.min(0.5 * r);
        let across = r - edge;
        let mut front = Vec::new();
        let mut ring = |across: f64, behind: f64, shift: f64| {
            let num = (core::f64::consts::TAU * across / APART_MM).ceil().max(1.0) as usize;
            for n in 0..num {
                let turn = core::f64::consts::TAU * (n as f64 + shift) / num as f64;
                front.push(Feeler {
                    at: [across * libm::cos(turn), across * libm::sin(turn), -behind],
                    radius: edge,
                });
            }
        };
        let num = (across / APART_MM).ceil() as usize;
        for n in 0..=num {
            ring(across * n as f64 / num as f64, edge, 0.0);
        }
        // Successive rings are staggered by half of the distance between their balls.
        for n in 1..=num {
            let behind = edge + across * n as f64 / (num + 1) as f64;
            ring(across, behind, 0.5 * (n % 2) as f64);
        }
        let mut made = Self {
            balls: Vec::new(),
            groups: Vec::new(),
            num_front: 0,
            radius_mm: r,
        };
        while let Some(&leader) = front.first() {
            let first = made.balls.len();
            let mut reach_mm: f64 = 0.0;
            front.retain(|ball| {
                let off = distance(ball.at, leader.at);
                if off <= REACH_MM {
                    made.balls.push(*ball);
                    reach_mm = reach_mm.max(off);
                }
                off > REACH_MM
            });
            made.groups.push(Group {
                first,
                end: made.balls.len(),
                reach_mm,
            });
        }
        made.num_front = made.groups.len();
        let mut behind = r;
        while behind < body.rigid_mm {
            let first = made.balls.len();
            made.balls.push(Feeler {
                at: [0.0, 0.0, -behind],
                radius: r,
            });
            made.groups.push(Group {
                first,
                end: first + 1,
                reach_mm: 0.0,
            });
            behind += AXIS_MM;
        }
        made
    }

    /// Return the smallest clearance of the tip's balls from the wall.
    ///
    /// If the smallest clearance is far above the limit of contact, the result may be the clearance of another ball,
    /// because groups of balls are skipped.
    pub(crate) fn clearance(&self, field: &WallField, tip: &Tip, entry: &Entry) -> Clearance {
        self.clearance_until(field, tip, entry, f64::NEG_INFINITY)
    }

    /// Return whether some ball penetrates the wall by more than `depth_mm`; the first one that does ends the test.
    pub(crate) fn penetrates(
        &self,
        field: &WallField,
        tip: &Tip,
        entry: &Entry,
        depth_mm: f64,
    ) -> bool {
        self.clearance_until(field, tip, entry, -depth_mm).mm < -depth_mm
    }

    /// Return the minimum distance between wall and tip (its balls), or the first distance found below `end_mm`.
    fn clearance_until(
        &self,
        field: &WallField,
        tip: &Tip,
        entry: &Entry,
        end_mm: f64,
    ) -> Clearance {
        let mut least = Clearance::none(tip);
        // If one ball round the face and the part behind it is free of the wall, no ball of the face can touch the
        // wall.
        let r = self.radius_mm;
        let (free_mm, middle) = (1.2 * r + 1.0, tip.place([0.0, 0.0, -0.5 * r]));
        let is_clear = entry.depth_mm(tip.at) >= 0.0
            && field.distance_up_to(middle, free_mm + ROUNDING_MM) > free_mm;
        let skipped = if is_clear { self.num_front } else { 0 };
        for group in &self.groups[skipped..] {
            let enough_mm = group.reach_mm + GUARD_MM;
            let clearance_mm = self.take(&mut least, group.first, field, tip, entry, enough_mm);
            if least.mm < end_mm {
                return least;
            }
            if clearance_mm <= enough_mm {
                for n in group.first + 1..group.end {
                    self.take(&mut least, n, field, tip, entry, enough_mm);
                    if least.mm < end_mm {
                        return least;
                    }
                }
            }
        }
        least
    }

    /// Return the clearance of ball `n`, and update `least` unless the ball is behind the entry.
    ///
    /// A clearance above both `enough_mm` and `least` may be inexact.
    fn take(
        &self,
        least: &mut Clearance,
        n: usize,
        field: &WallField,
        tip: &Tip,
        entry: &Entry,
        enough_mm: f64,
    ) -> f64 {
        let ball = self.balls[n];
        let p = tip.place(ball.at);
        let limit_mm = least.mm.max(enough_mm) + ball.radius + SKIN_MM + ROUNDING_MM;
        let mm = field.distance_up_to(p, limit_mm) - ball.radius - SKIN_MM;
        if mm < least.mm && entry.depth_mm(p) >= 0.0 {
            *least = Clearance {
                mm,
                at_lps: p,
                in_tip: ball.at,
            };
        }
        mm
    }

    /// Return the smallest clearance after testing every ball, as a reference for [`Self::clearance`].
    #[cfg(test)]
    fn clearance_of_all(&self, field: &WallField, tip: &Tip, entry: &Entry) -> Clearance {
        let mut least = Clearance::none(tip);
        for n in 0..self.balls.len() {
            self.take(&mut least, n, field, tip, entry, f64::INFINITY);
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::drive_tests::{BODY, field};

    fn tip_of(radius: f64) -> Feelers {
        Feelers::new(&ScopeBody {
            tip_radius_mm: radius,
            ..BODY
        })
    }

    /// Return a point of the tip's surface in the tip's frame.
    ///
    /// `along` is the position on the profile of the tip from the face's centre (0) to the rear end of the rigid tip
    /// (1), `turn` the angle round the axis.
    fn on_surface(radius: f64, along: f64, turn: f64) -> [f64; 3] {
        let edge = EDGE_MM.min(0.5 * radius);
        let (flat, round) = (radius - edge, 0.5 * core::f64::consts::PI * edge);
        // The last ball extends to the rigid end.
        let mm = along * (flat + round + BODY.rigid_mm - edge - AXIS_MM);
        let (across, behind) = if mm < flat {
            (mm, 0.0)
        } else if mm < flat + round {
            let a = (mm - flat) / edge;
            (flat + edge * libm::sin(a), edge - edge * libm::cos(a))
        } else {
            (radius, edge + mm - flat - round)
        };
        [across * libm::cos(turn), across * libm::sin(turn), -behind]
    }

    proptest! {
        #[test]
        fn the_balls_cover_the_tips_surface_and_do_not_protrude(
            radius in 0.7f64..3.9,
            along in 0.0f64..1.0,
            turn in 0.0f64..6.3,
        ) {
            let tip = tip_of(radius);
            for f in &tip.balls {
                prop_assert!(libm::hypot(f.at[0], f.at[1]) + f.radius <= radius + 1e-12);
                prop_assert!(f.at[2] + f.radius <= 1e-12);
            }
            let p = on_surface(radius, along, turn);
            let gap = tip
                .balls
                .iter()
                .map(|f| distance(p, f.at) - f.radius)
                .fold(f64::INFINITY, f64::min);
            // `gap` is the depth to which a spike of the wall could penetrate undetected; a ridge could penetrate half as deep.
            prop_assert!(gap < if radius < 1.2 { 0.12 } else { 0.065 }, "{gap} at {p:?}");
        }

        #[test]
        fn the_clearance_of_a_tip_does_not_depend_on_its_roll(
            radius in 0.7f64..3.9,
            lean in 0.0f64..3.2,
            roll in 0.0f64..6.3,
        ) {
            // The tip is pressed against the ridge between two arms, which would penetrate between balls that are too
            // far apart.
            let forward = [libm::sin(lean), 0.0, -libm::cos(lean)];
            let entry = Entry { at: [0.0, 0.0, 112.0], into: [0.0, 0.0, -1.0] };
            let feelers = tip_of(radius);
            let field = field();
            let of = |turn: f64, at: [f64; 3]| {
                let (across, up) = ([0.0, 1.0, 0.0], carina_grid::cross(forward, [0.0, 1.0, 0.0]));
                let right = std::array::from_fn(|a| libm::cos(turn) * across[a] + libm::sin(turn) * up[a]);
                Tip { at, right, down: carina_grid::cross(forward, right), forward }
            };
            let mut at = [1.0, 0.0, 20.0];
            for _ in 0..20 {
                let found = feelers.clearance(&field, &of(0.0, at), &entry);
                at[2] -= (found.mm + 0.1).clamp(-1.0, 1.0);
            }
            let (before, after) = (
                feelers.clearance(&field, &of(0.0, at), &entry),
                feelers.clearance(&field, &of(roll, at), &entry),
            );
            prop_assert!((before.mm - after.mm).abs() < 0.06, "{} {}", before.mm, after.mm);
        }

        #[test]
        fn the_clearance_by_leaders_equals_that_of_all_balls_near_contact(
            radius in 0.7f64..3.9,
            at in prop::array::uniform3(0.0f64..1.0),
            look in prop::array::uniform3(-1.0f64..1.0),
        ) {
            let field = field();
            let at = [110.0 * at[0] - 50.0, 24.0 * at[1] - 12.0, 190.0 * at[2] - 85.0];
            let Some(forward) = carina_grid::unit(look) else { return Ok(()) };
            let Some(right) = carina_grid::unit(carina_grid::cross(forward, [0.31, 0.9, -0.2])) else {
                return Ok(())
            };
            let mut tip = Tip { at, right, down: carina_grid::cross(forward, right), forward };
            let entry = Entry { at: [0.0, 0.0, 112.0], into: [0.0, 0.0, -1.0] };
            let feelers = tip_of(radius);
            // The tip moves from a free position to contact, and some way into the wall.
            for _ in 0..12 {
                let all = feelers.clearance_of_all(&field, &tip, &entry);
                let led = feelers.clearance(&field, &tip, &entry);
                prop_assert!(led.mm >= all.mm);
                if all.mm <= 0.3 {
                    prop_assert_eq!(led, all);
                } else {
                    prop_assert!(led.mm > 0.3);
                }
                let Some(away) = field.away_from_wall(all.at_lps) else { break };
                tip.at = std::array::from_fn(|a| tip.at[a] - 0.6 * (all.mm - 0.1) * away[a]);
            }
        }
    }
}
