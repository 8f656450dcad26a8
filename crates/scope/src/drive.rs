//! Drive of the scope: motion of its tip and shaft in a lumen by insertion, roll and flexion.
//!
//! The controls change in small steps, and each step is accepted only if tip and shaft stay in the lumen.

use std::sync::Arc;

use carina_grid::{Affine, dot, unit};

use crate::ScopeError;
use crate::axis::{Axis, Controls, along, sub};
use crate::body::{Entry, ScopeBody, Tip, distance};
use crate::feelers::{Feelers, SKIN_MM};
use crate::wall::WallField;

type Point = [f64; 3];

/// Maximum insertion in mm of one simulated step; longer movements are divided.
const STEP_MM: f64 = 0.5;
/// Maximum step of flexion and roll, radians; a bent tip of 50 mm then moves by about as much as in an insertion step.
const STEP_RAD: f64 = 0.02;
/// Distance in mm between tip and wall up to which the tip is in contact with the wall.
const TOUCH_MM: f64 = 0.1;
/// Distance between tip and wall above which contact ends, mm.
///
/// The distance is larger than [`TOUCH_MM`], at which contact begins, so that a tip that slides along a rough wall
/// counts as one contact.
const RELEASE_MM: f64 = 0.3;
/// Distances ahead of a blocked tip at which the width of the airway is measured, mm.
const LOOK_AHEAD_MM: [f64; 4] = [1.0, 2.0, 3.0, 4.0];

/// Reason why the scope did not follow the controls completely.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Limit {
    /// The scope followed the controls completely.
    None,
    /// The requested insertion is less than that of the entry; the scope is withdrawn to the entry.
    Entry,
    /// The tip is pressed against a wall, and the insertion is not reached.
    Wall,
    /// The airway ahead is too narrow.
    Narrow,
    /// The requested insertion is larger than the working length of the scope.
    Length,
    /// The requested flexion exceeds the range of the lever.
    Flexion,
}

/// Contact of the tip with the wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Position of the contact on the wall, LPS mm.
    pub point_lps: Point,
    /// Unit vector away from the wall at this position, LPS.
    pub normal_lps: Point,
    /// Additional distance by which the tip would move into the wall if the wall did not exist, mm.
    pub depth_mm: f64,
}

/// Summary of the contacts of the tip since the scope was placed.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ContactRecord {
    /// Number of contacts of the tip with the wall since the scope was placed.
    pub count: u64,
    /// Total time of contact of the tip, s.
    pub time_s: f64,
    /// Maximum of [`Contact::depth_mm`] since the scope was placed in the lumen, mm.
    pub max_depth_mm: f64,
}

/// State of the scope after its controls were set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScopeState {
    /// Pose of the tip's face: +x right, +y down, +z forward.
    pub lps_from_tip: Affine,
    /// Distance from the start of the path to the tip's face along the scope, mm.
    pub insertion_mm: f64,
    /// Roll in radians, clockwise as the operator sees it.
    pub roll_rad: f64,
    /// Flexion in radians, positive for up.
    pub flexion_rad: f64,
    /// Contact of the tip with the wall; `None` without contact.
    pub contact: Option<Contact>,
    /// Red-out of the picture: 0 for a clear view, 1 if the lens touches the wall.
    pub red_out: f64,
    /// Reason why the scope did not follow the controls completely.
    pub limit: Limit,
    /// Diameter in mm of the widest tip that would pass; `None` unless the limit is [`Limit::Narrow`].
    pub passable_mm: Option<f64>,
    /// Summary of the contacts since the scope was placed.
    pub record: ContactRecord,
}

/// Simulation of a scope in a lumen.
///
/// The states depend only on the sequence of controls: equal sequences give equal states, bit for bit.
#[derive(Debug, Clone)]
pub struct ScopeDrive {
    field: Arc<WallField>,
    body: ScopeBody,
    feelers: Feelers,
    entry: Entry,
    entry_mm: f64,
    first_up: Point,
    axis: Axis,
    controls: Controls,
    /// Requested roll in radians including whole turns; `controls` contains less than one turn.
    requested_roll_rad: f64,
    touches: bool,
    state: ScopeState,
}

impl ScopeDrive {
    /// Create a scope that enters a lumen along a path (LPS mm; the trachea's centreline from its start).
    ///
    /// The scope enters at the first position of the path that is wide enough. `up` is the LPS direction that is up in
    /// the picture at a roll of 0; `None` selects anterior, or superior if the path starts along the antero-posterior
    /// axis.
    ///
    /// # Errors
    ///
    /// Returns an error if the dimensions or the path are not valid, or if the scope does not fit.
    pub fn new(
        field: Arc<WallField>,
        body: ScopeBody,
        path: &[Point],
        up: Option<Point>,
    ) -> Result<Self, ScopeError> {
        let body = body.checked()?;
        let line = evenly(path)?;
        let widest = body.tip_radius_mm.max(body.tube_radius_mm);
        let Some(at) = line
            .iter()
            .position(|&p| field.distance_mm(p) >= widest + 0.3)
        else {
            let clearance_mm = line
                .iter()
                .map(|&p| field.distance_mm(p))
                .fold(f64::NEG_INFINITY, f64::max);
            return Err(ScopeError::Scope {
                reason: format!(
                    "it is {:.1} mm wide and the start of the path has room for {:.1} mm",
                    2.0 * widest,
                    2.0 * (clearance_mm - 0.3).max(0.0)
                ),
            });
        };
        let ahead = line[(at + 20).min(line.len() - 1)];
        let behind = line[at.min(line.len() - 2)];
        let Some(into) = unit(sub(ahead, behind)) else {
            return Err(ScopeError::Scope {
                reason: "the start of its path has no direction".to_owned(),
            });
        };
        let first_up = match up {
            Some(up) => up,
            // Anterior, or superior if the view is antero-posterior (head-end position).
            None if into[1].abs() < 0.99 => [0.0, -1.0, 0.0],
            None => [0.0, 0.0, 1.0],
        };
        let Some(first_up) = unit(along(first_up, -dot(first_up, into), into)) else {
            return Err(ScopeError::Up {
                reason: "is parallel to the start of the path",
            });
        };
        let entry = Entry { at: line[at], into };
        let controls = Controls {
            depth_mm: 0.0,
            roll_rad: 0.0,
            flexion_rad: 0.0,
        };
        let axis = Axis::straight(&entry, 0.0);
        let mut drive = Self {
            feelers: Feelers::new(&body),
            state: ScopeState {
                lps_from_tip: Affine::IDENTITY,
                insertion_mm: 0.0,
                roll_rad: 0.0,
                flexion_rad: 0.0,
                contact: None,
                red_out: 0.0,
                limit: Limit::None,
                passable_mm: None,
                record: ContactRecord::default(),
            },
            field,
            body,
            entry,
            entry_mm: at as f64 * PATH_STEP_MM,
            first_up,
            axis,
            controls,
            requested_roll_rad: 0.0,
            touches: false,
        };
        drive.update_state(0.0, Limit::None, 0.0);
        Ok(drive)
    }

    /// Return the current state of the scope.
    #[must_use]
    pub const fn state(&self) -> &ScopeState {
        &self.state
    }

    /// Return the dimensions of the scope.
    #[must_use]
    pub const fn body(&self) -> &ScopeBody {
        &self.body
    }

    /// Return the position of the entry in mm along the path, which is the smallest insertion.
    #[must_use]
    pub const fn entry_mm(&self) -> f64 {
        self.entry_mm
    }

    /// Return the axis of the scope from the entry to the tip's face, LPS mm.
    #[must_use]
    pub fn shaft_lps(&self) -> Vec<Point> {
        let mut points: Vec<Point> = self
            .axis
            .nodes
            .iter()
            .copied()
            .take(self.axis.nodes.len() - 2)
            .collect();
        points.push(self.entry.at);
        points.reverse();
        points
    }

    /// Return the penetration of the wall by tip and shaft in mm, according to the wall field (0 without penetration).
    #[must_use]
    pub fn wall_depths_mm(&self) -> (f64, f64) {
        let ups = self.axis.ups(self.first_up, self.controls.roll_rad);
        self.axis.depths_mm(
            &self.field,
            &self.feelers,
            &self.body,
            &self.entry,
            ups[0],
            self.axis.nodes.len() - 2,
        )
    }

    /// Set the three controls, `dt_s` seconds after the previous call, and return the new state.
    ///
    /// The scope moves from its present position towards the controls and stops where it is blocked; the next call
    /// starts there. Roll and flexion always reach their values (a lever can be pressed against a wall); insertion may
    /// not.
    ///
    /// # Errors
    ///
    /// Returns an error if a value is not finite or `dt_s` is negative.
    pub fn drive(
        &mut self,
        insertion_mm: f64,
        roll_rad: f64,
        flexion_rad: f64,
        dt_s: f64,
    ) -> Result<ScopeState, ScopeError> {
        for (what, value) in [
            ("insertion", insertion_mm),
            ("roll", roll_rad),
            ("flexion", flexion_rad),
            ("time", dt_s),
        ] {
            if !value.is_finite() || (what == "time" && value < 0.0) {
                return Err(ScopeError::Scope {
                    reason: format!("expected a {what} that is a number, found {value}"),
                });
            }
        }
        let mut limit = Limit::None;
        let flexion = flexion_rad.clamp(-self.body.down_rad, self.body.up_rad);
        if flexion != flexion_rad {
            limit = Limit::Flexion;
        }
        let wanted_mm = insertion_mm - self.entry_mm;
        let depth_mm = wanted_mm.clamp(0.0, self.body.length_mm);
        if depth_mm > wanted_mm {
            limit = Limit::Entry;
        } else if depth_mm < wanted_mm {
            limit = Limit::Length;
        }
        let start = self.controls;
        // Whole turns have no effect, because the shaft is stiff and does not twist. The remainder of any roll is less
        // than one turn.
        let whole = |rad: f64| libm::remainder(rad, core::f64::consts::TAU);
        let turn = whole(whole(roll_rad) - start.roll_rad);
        let (advance, bend) = (depth_mm - start.depth_mm, flexion - start.flexion_rad);
        let num = (advance.abs() / STEP_MM)
            .max(bend.abs() / STEP_RAD)
            .max(turn.abs() / STEP_RAD)
            .ceil() as usize;
        let mut blocked = false;
        for n in 1..=num {
            let share = n as f64 / num as f64;
            let wanted = Controls {
                depth_mm: if blocked {
                    self.controls.depth_mm
                } else {
                    start.depth_mm + share * advance
                },
                roll_rad: start.roll_rad + share * turn,
                flexion_rad: start.flexion_rad + share * bend,
            };
            blocked |= !self.step(wanted);
        }
        self.controls.roll_rad = whole(roll_rad);
        self.requested_roll_rad = roll_rad;
        if blocked {
            limit = Limit::Wall;
        }
        let further_mm = (depth_mm - self.controls.depth_mm).max(0.0);
        self.update_state(dt_s, limit, further_mm);
        Ok(self.state)
    }

    /// Move the scope by one small step towards the controls `wanted`; return false if the insertion is blocked.
    fn step(&mut self, wanted: Controls) -> bool {
        let before = self.controls;
        let advance = wanted.depth_mm - before.depth_mm;
        // If the whole step does not fit, a part of the insertion may; the last try changes only roll and flexion.
        for share in [1.0, 0.3, 0.0] {
            if share < 1.0 && advance == 0.0 {
                break;
            }
            let part = Controls {
                depth_mm: before.depth_mm + share * advance,
                ..wanted
            };
            if self.moved(part) {
                return share == 1.0;
            }
        }
        if advance < 0.0 {
            // The scope is withdrawn along itself without relaxation, so it has only positions that it had before.
            let mut axis = self.axis.clone();
            axis.shift(&self.entry, wanted.depth_mm, advance);
            let ups = axis.ups(self.first_up, wanted.roll_rad);
            let num = axis.nodes.len() - 2;
            let (tip, shaft) = axis.depths_mm(
                &self.field,
                &self.feelers,
                &self.body,
                &self.entry,
                ups[0],
                num,
            );
            if tip <= 0.05 && shaft <= 0.3 {
                self.axis = axis;
                self.controls = wanted;
                return true;
            }
        }
        // The lever is pressed against a wall: its angle changes, but the tip does not move.
        self.controls = Controls {
            depth_mm: before.depth_mm,
            ..wanted
        };
        advance == 0.0
    }

    /// Place the scope along a path with the tip `insertion_mm` along it, and return the new state.
    ///
    /// `path` must have the same start as the path with which the scope was created. Roll and flexion become 0, and the
    /// contact record starts again. If the path is too narrow, the tip ends before the narrow position, and the limit
    /// of the state is set.
    ///
    /// # Errors
    ///
    /// Returns an error if the path or the insertion is not valid.
    pub fn place(&mut self, path: &[Point], insertion_mm: f64) -> Result<ScopeState, ScopeError> {
        let refuse = |reason: String| Err(ScopeError::Scope { reason });
        if !insertion_mm.is_finite() {
            return refuse(format!(
                "expected an insertion that is a number, found {insertion_mm}"
            ));
        }
        let line = evenly(path)?;
        let (mut first, mut off) = (0, f64::INFINITY);
        for (n, &p) in line.iter().enumerate() {
            let far = distance(p, self.entry.at);
            if far < off {
                (first, off) = (n, far);
            }
        }
        if off > 10.0 {
            return refuse(format!(
                "the path passes {off:.0} mm from where the scope enters; it must start as the scope's own does"
            ));
        }
        let remaining_mm = (line.len() - 1 - first) as f64 * PATH_STEP_MM;
        let wanted_mm =
            (insertion_mm - self.entry_mm).clamp(0.0, self.body.length_mm.min(remaining_mm));
        let at = |mm: f64| -> Point {
            let place = first as f64 + mm.max(0.0) / PATH_STEP_MM;
            let n = (place as usize).min(line.len() - 2);
            along(line[n], place - n as f64, sub(line[n + 1], line[n]))
        };
        let mut depth_mm = wanted_mm;
        loop {
            let controls = Controls {
                depth_mm,
                roll_rad: 0.0,
                flexion_rad: 0.0,
            };
            let mut axis = Axis::straight(&self.entry, depth_mm);
            let free = axis.nodes.len() - 2;
            for (n, node) in axis.nodes.iter_mut().take(free).enumerate() {
                *node = at(depth_mm - n as f64 * crate::body::NODE_MM);
            }
            let found = axis.relax(
                &self.field,
                &self.feelers,
                &self.body,
                &self.entry,
                self.first_up,
                controls,
            );
            if found {
                self.axis = axis;
                self.controls = controls;
                self.requested_roll_rad = 0.0;
                break;
            }
            if depth_mm == 0.0 {
                return refuse("it does not fit where it enters".to_owned());
            }
            depth_mm = (depth_mm - 1.0).max(0.0);
        }
        self.touches = false;
        self.state.record = ContactRecord::default();
        let limit = if depth_mm < wanted_mm {
            Limit::Wall
        } else {
            Limit::None
        };
        self.update_state(0.0, limit, 0.0);
        Ok(self.state)
    }

    fn moved(&mut self, wanted: Controls) -> bool {
        let mut axis = self.axis.clone();
        let advance = wanted.depth_mm - self.controls.depth_mm;
        if advance != 0.0 {
            axis.shift(&self.entry, wanted.depth_mm, advance);
        }
        axis.bend(&self.body, self.first_up, self.controls, wanted);
        let found = axis.relax(
            &self.field,
            &self.feelers,
            &self.body,
            &self.entry,
            self.first_up,
            wanted,
        );
        if found {
            self.axis = axis;
            self.controls = wanted;
        }
        found
    }

    fn tip(&self) -> Tip {
        let ups = self.axis.ups(self.first_up, self.controls.roll_rad);
        self.axis.tip(ups[0])
    }

    /// Compute the scope's state from its axis and controls, and update the summary of contacts.
    fn update_state(&mut self, dt_s: f64, limit: Limit, further_mm: f64) {
        let tip = self.tip();
        let least = self.feelers.clearance(&self.field, &tip, &self.entry);
        let mut record = self.state.record;
        let was = self.touches;
        self.touches = least.mm <= if was { RELEASE_MM } else { TOUCH_MM };
        let mut contact = None;
        if self.touches
            && let Some(normal) = self.field.away_from_wall(least.at_lps)
        {
            let free = self
                .axis
                .free_face(&self.body, self.first_up, self.controls, further_mm);
            let depth_mm = dot(sub(tip.at, free), normal).max(0.0);
            contact = Some(Contact {
                point_lps: along(least.at_lps, -self.field.distance_mm(least.at_lps), normal),
                normal_lps: normal,
                depth_mm,
            });
            record.count += u64::from(!was);
            record.time_s += dt_s;
            record.max_depth_mm = record.max_depth_mm.max(depth_mm);
        }
        let (limit, passable_mm) = match limit {
            Limit::Wall => self
                .too_narrow(&tip)
                .map_or((Limit::Wall, None), |mm| (Limit::Narrow, Some(mm))),
            other => (other, None),
        };
        self.state = ScopeState {
            lps_from_tip: Affine::from_columns(tip.right, tip.down, tip.forward, tip.at),
            insertion_mm: self.entry_mm + self.controls.depth_mm,
            roll_rad: self.requested_roll_rad,
            flexion_rad: self.controls.flexion_rad,
            contact,
            red_out: self.red_out(&tip),
            limit,
            passable_mm,
            record,
        };
    }

    /// Return the red-out (0 to 1, how much of the picture the near wall fills) for a pose of the tip.
    ///
    /// A wall beside the tip is one radius away from the lens; only a wall in front of the lens can be nearer.
    fn red_out(&self, tip: &Tip) -> f64 {
        if self.entry.depth_mm(tip.at) < 0.5 {
            return 0.0;
        }
        let r = self.body.tip_radius_mm;
        ((0.6 * r - self.field.distance_mm(tip.at)) / (0.45 * r)).clamp(0.0, 1.0)
    }

    /// Return the diameter of the airway ahead in mm if the airway is too narrow for the tip, otherwise `None`.
    fn too_narrow(&self, tip: &Tip) -> Option<f64> {
        let mut least = f64::INFINITY;
        let mut at = tip.at;
        let mut forward = tip.forward;
        let mut walked = 0.0;
        for ahead in LOOK_AHEAD_MM {
            let mut p = along(at, ahead - walked, forward);
            // The position moves to the middle of the lumen across the direction of advance.
            for _ in 0..40 {
                let Some(away) = self.field.away_from_wall(p) else {
                    break;
                };
                let across = along(away, -dot(away, forward), forward);
                let next = along(p, 0.1, across);
                if self.field.distance_mm(next) <= self.field.distance_mm(p) {
                    break;
                }
                p = next;
            }
            let clearance_mm = self.field.distance_mm(p);
            if clearance_mm < 0.3 {
                // There is no airway ahead, but the wall itself.
                break;
            }
            least = least.min(clearance_mm);
            forward = unit(sub(p, at)).unwrap_or(forward);
            at = p;
            walked = ahead;
        }
        (least < self.body.tip_radius_mm + SKIN_MM + 0.02).then_some(2.0 * least)
    }
}

/// Distance in mm between the points of a resampled path.
const PATH_STEP_MM: f64 = 0.25;
/// Maximum length of a path, mm: eight times the length of a scope. Points of a longer path would only use memory.
const MAX_PATH_MM: f64 = 5_000.0;

/// Return points [`PATH_STEP_MM`] apart along a path.
///
/// # Errors
///
/// Returns an error if the points are not a path.
fn evenly(path: &[Point]) -> Result<Vec<Point>, ScopeError> {
    if path.iter().flatten().any(|v| !v.is_finite()) {
        return Err(ScopeError::Scope {
            reason: "its path contains coordinates that are not finite".to_owned(),
        });
    }
    let path_mm: f64 = path.windows(2).map(|w| distance(w[0], w[1])).sum();
    if path_mm > MAX_PATH_MM {
        return Err(ScopeError::Scope {
            reason: format!(
                "its path is {path_mm:.0} mm long, and no airway is longer than {MAX_PATH_MM} mm"
            ),
        });
    }
    let mut line: Vec<Point> = path.first().copied().into_iter().collect();
    let mut left = PATH_STEP_MM;
    for w in path.windows(2) {
        let far = distance(w[0], w[1]);
        let mut at = left;
        while at <= far {
            line.push(along(w[0], at / far, sub(w[1], w[0])));
            at += PATH_STEP_MM;
        }
        left = at - far;
    }
    if line.len() < 2 {
        return Err(ScopeError::Scope {
            reason: "its path needs two different points".to_owned(),
        });
    }
    Ok(line)
}
