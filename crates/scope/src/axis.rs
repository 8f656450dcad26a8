//! Axis of the scope: nodes from the tip back to the entry, their frames, and the relaxation.
//!
//! The axis is an elastic rod of nodes [`NODE_MM`] apart (Bergou et al., "Discrete elastic rods", SIGGRAPH 2008: frames
//! transported along the rod without twist, bending energy from the angle at each node). The rod is stiff against twist
//! and stretch, so the roll of the hand arrives at the tip. The rest shape of the bending section has the curvature
//! that the lever sets; elsewhere the rest shape is straight. Walls limit the positions of the nodes.

use carina_grid::{cross, dot, unit};

use crate::body::{Entry, NODE_MM, ScopeBody, Tip};
use crate::feelers::Feelers;
use crate::wall::WallField;

type Point = [f64; 3];

/// Maximum penetration of the wall by the tip with which a movement is accepted, mm; the specified limit is 0.1 mm.
const TIP_TOLERANCE_MM: f64 = 0.02;
/// Maximum penetration of the wall by the shaft with which a movement is accepted, mm; the specified limit is 0.5 mm.
const SHAFT_TOLERANCE_MM: f64 = 0.15;
/// Minimum number of sweeps over the nodes in one relaxation of the scope's axis.
const MIN_SWEEPS: usize = 3;
/// Number of sweeps after which a relaxation of the scope's axis ends, also if nodes still move.
const MAX_SWEEPS: usize = 36;
/// Number of sweeps within which the penetration of the wall must fall by half; otherwise the relaxation ends, because
/// the scope does not fit into the lumen at this position.
const PATIENCE: usize = 8;
/// Number of nodes near the tip that every sweep of a relaxation processes.
///
/// Nodes farther back move little, and only the first sweep processes them.
const NEAR_NODES: usize = 60;

/// Values of the three controls of the scope: insertion, roll and flexion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Controls {
    /// Insertion depth from the entry, mm.
    pub(crate) depth_mm: f64,
    pub(crate) roll_rad: f64,
    pub(crate) flexion_rad: f64,
}

/// Nodes of the scope's axis, the tip's face first.
///
/// The last two nodes are behind the entry and have prescribed positions.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Axis {
    /// Positions of the nodes of the scope's axis, LPS mm.
    pub(crate) nodes: Vec<Point>,
}

pub(crate) fn sub(a: Point, b: Point) -> Point {
    std::array::from_fn(|k| a[k] - b[k])
}

pub(crate) fn along(a: Point, f: f64, b: Point) -> Point {
    std::array::from_fn(|k| a[k] + f * b[k])
}

fn mix(a: Point, b: Point, t: f64) -> Point {
    std::array::from_fn(|k| a[k] + t * (b[k] - a[k]))
}

/// Return `v`, a vector perpendicular to `from`, rotated by the smallest rotation that takes `from` to `to`.
fn transported(v: Point, from: Point, to: Point) -> Point {
    let share = dot(to, v) / (1.0 + dot(from, to)).max(1e-6);
    let turned: Point = std::array::from_fn(|a| v[a] - share * (from[a] + to[a]));
    let slant = dot(turned, to);
    unit(along(turned, -slant, to)).unwrap_or(v)
}

/// Return `v` rotated by an angle in radians about a unit axis.
fn turned(v: Point, axis: Point, angle: f64) -> Point {
    let (s, c) = (libm::sin(angle), libm::cos(angle));
    let (across, part) = (cross(axis, v), dot(axis, v) * (1.0 - c));
    std::array::from_fn(|a| c * v[a] + s * across[a] + part * axis[a])
}

impl Axis {
    /// Return the number of nodes for an insertion depth, from the tip to the second node behind the entry.
    fn num_nodes(depth_mm: f64) -> usize {
        (depth_mm / NODE_MM).ceil() as usize + 2
    }

    /// Create the axis of a straight scope that enters in the entry's direction.
    pub(crate) fn straight(entry: &Entry, depth_mm: f64) -> Self {
        Self {
            nodes: (0..Self::num_nodes(depth_mm))
                .map(|n| along(entry.at, depth_mm - n as f64 * NODE_MM, entry.into))
                .collect(),
        }
    }

    /// Return the unit vector from a node to the next node towards the tip.
    fn forward(&self, node: usize) -> Point {
        unit(sub(self.nodes[node - 1], self.nodes[node])).unwrap_or([0.0, 0.0, -1.0])
    }

    /// Return the up direction (unit vector, LPS) of each segment between two nodes of the scope's axis.
    ///
    /// Index 0 is the segment between nodes 1 and 0, at the tip; the last index is the segment behind the entry.
    pub(crate) fn ups(&self, first_up: Point, roll_rad: f64) -> Vec<Point> {
        let last = self.nodes.len() - 1;
        let mut ups = vec![[0.0; 3]; last];
        let mut before = self.forward(last);
        // Roll is clockwise as the operator sees it, about the direction of view.
        let mut up = turned(first_up, before, roll_rad);
        up = unit(along(up, -dot(up, before), before)).unwrap_or(up);
        for node in (1..=last).rev() {
            let forward = self.forward(node);
            up = transported(up, before, forward);
            ups[node - 1] = up;
            before = forward;
        }
        ups
    }

    /// Update the up directions of the segments ([`Axis::ups`]) after a change of the first `num` nodes.
    fn update_ups(&self, ups: &mut [Point], num: usize) {
        let (mut up, mut before) = (ups[num], self.forward(num + 1));
        for node in (1..=num).rev() {
            let forward = self.forward(node);
            up = transported(up, before, forward);
            ups[node - 1] = up;
            before = forward;
        }
    }

    pub(crate) fn tip(&self, up: Point) -> Tip {
        let forward = self.forward(1);
        let down = unit(along(up.map(|v| -v), dot(up, forward), forward)).unwrap_or([0.0; 3]);
        Tip {
            at: self.nodes[0],
            right: cross(down, forward),
            down,
            forward,
        }
    }

    /// Move the axis by `by_mm` along itself: each node moves on the line through the nodes before it.
    pub(crate) fn shift(&mut self, entry: &Entry, depth_mm: f64, by_mm: f64) {
        let share = (by_mm.abs() / NODE_MM).min(1.0);
        let old = &self.nodes;
        let tip_forward = self.forward(1);
        let mut moved: Vec<Point> = if by_mm >= 0.0 {
            let mut all = vec![along(old[0], by_mm, tip_forward)];
            all.extend((1..old.len()).map(|n| mix(old[n], old[n - 1], share)));
            all
        } else {
            (0..old.len() - 1)
                .map(|n| mix(old[n], old[n + 1], share))
                .collect()
        };
        let wanted = Self::num_nodes(depth_mm);
        moved.truncate(wanted);
        while moved.len() < wanted {
            moved.push([0.0; 3]);
        }
        // The nodes behind the entry are on the straight line along the entry's direction.
        for n in wanted - 2..wanted {
            moved[n] = along(entry.at, depth_mm - n as f64 * NODE_MM, entry.into);
        }
        self.nodes = moved;
    }

    /// Apply a change of roll and flexion: rotate the part of the axis in front of each node of the bending section.
    pub(crate) fn bend(
        &mut self,
        body: &ScopeBody,
        first_up: Point,
        before: Controls,
        after: Controls,
    ) {
        if before.flexion_rad == after.flexion_rad && before.roll_rad == after.roll_rad {
            return;
        }
        let (rigid, num) = (body.rigid_nodes(), body.bending_nodes());
        // Nodes with prescribed positions do not bend.
        let last = (rigid + num - 1).min(self.nodes.len().saturating_sub(3));
        if last < rigid {
            return;
        }
        let old_ups = self.ups(first_up, before.roll_rad);
        let forwards: Vec<Point> = (1..=last + 1).map(|n| self.forward(n)).collect();
        let (old_angle, new_angle) = (
            before.flexion_rad / num as f64,
            after.flexion_rad / num as f64,
        );
        let roll = after.roll_rad - before.roll_rad;
        // The part in front of a node is rotated by all nodes behind it, in their order.
        let mut turns: Vec<(Point, f64)> = Vec::with_capacity(2 * num);
        let turned_by = |turns: &[(Point, f64)], v: Point| {
            turns
                .iter()
                .fold(v, |v, &(axis, angle)| turned(v, axis, angle))
        };
        for node in (1..=last).rev() {
            if node >= rigid {
                // The old bend is removed and the new bend applied, both about axes of the segment behind the node.
                let behind = turned_by(&turns, forwards[node]);
                let up = turned_by(&turns, old_ups[node]);
                let new_up = turned(up, behind, roll);
                turns.push((cross(behind, up), -old_angle));
                turns.push((cross(behind, new_up), new_angle));
            }
            let forward = turned_by(&turns, forwards[node - 1]);
            self.nodes[node - 1] = along(self.nodes[node], NODE_MM, forward);
        }
    }

    /// Return, for each node, the second difference of the node positions in the shape that the scope has without
    /// contact with a wall.
    fn rest(&self, body: &ScopeBody, ups: &[Point], flexion_rad: f64) -> Vec<Point> {
        let (rigid, num) = (body.rigid_nodes(), body.bending_nodes());
        let bow = 2.0 * NODE_MM * libm::sin(0.5 * flexion_rad / num as f64);
        (0..self.nodes.len())
            .map(|n| {
                if n < rigid || n >= rigid + num || n + 2 >= self.nodes.len() {
                    return [0.0; 3];
                }
                let up: Point = std::array::from_fn(|a| ups[n - 1][a] + ups[n][a]);
                unit(up).map_or([0.0; 3], |up| up.map(|v| bow * v))
            })
            .collect()
    }

    /// Move each of the first `num` nodes once to the position with the least bending energy of it and its neighbours.
    fn unbend(&mut self, rest: &[Point], num: usize) {
        let x = &mut self.nodes;
        for n in (0..num).rev() {
            // Second differences at n - 1, n and n + 1 contain node n with factors 1, -2 and 1.
            let mut sum: Point =
                std::array::from_fn(|a| rest[n + 1][a] + 2.0 * x[n + 1][a] - x[n + 2][a]);
            let mut weight = 1.0;
            if n >= 1 {
                let middle: Point =
                    std::array::from_fn(|a| 0.5 * (x[n - 1][a] + x[n + 1][a] - rest[n][a]));
                sum = along(sum, 4.0, middle);
                weight += 4.0;
            }
            if n >= 2 {
                let ahead: Point =
                    std::array::from_fn(|a| rest[n - 1][a] - x[n - 2][a] + 2.0 * x[n - 1][a]);
                sum = along(sum, 1.0, ahead);
                weight += 1.0;
            }
            x[n] = sum.map(|v| v / weight);
        }
    }

    /// Restore the distances between the nodes, from the entry to the tip, and straighten the rigid tip.
    fn stretch(&mut self, body: &ScopeBody, num: usize) {
        let free = self.nodes.len() - 2;
        for n in (0..num).rev() {
            let forward = self.forward(n + 1);
            self.nodes[n] = along(self.nodes[n + 1], NODE_MM, forward);
        }
        let base = body.rigid_nodes();
        if base < free
            && let Some(forward) = unit(sub(self.nodes[0], self.nodes[base]))
        {
            for n in 0..base {
                self.nodes[n] = along(self.nodes[base], (base - n) as f64 * NODE_MM, forward);
            }
        }
    }

    /// Return the positions along the shaft at which the drive maintains a distance to the wall.
    ///
    /// The positions are nodes of the axis and the midpoints between two nodes; each is returned as the pair of nodes
    /// that are moved.
    fn shaft_places(body: &ScopeBody, num: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
        let base = body.rigid_nodes().min(num);
        (base..num).flat_map(move |n| [(n, n), (n, n + 1)])
    }

    fn push_off_wall(
        &mut self,
        field: &WallField,
        feelers: &Feelers,
        body: &ScopeBody,
        entry: &Entry,
        up: Point,
        num: usize,
    ) {
        let free = self.nodes.len() - 2;
        for (a, b) in Self::shaft_places(body, num) {
            let p = mix(self.nodes[a], self.nodes[b], 0.5);
            if entry.depth_mm(p) < 0.0 {
                continue;
            }
            let radius = body.radius_mm(0.5 * (a + b) as f64 * NODE_MM);
            let lack = radius - field.distance_up_to(p, radius);
            if lack <= 0.0 {
                continue;
            }
            let Some(away) = field.away_from_wall(p) else {
                continue;
            };
            self.nodes[a] = along(self.nodes[a], lack, away);
            if b != a && b < free {
                self.nodes[b] = along(self.nodes[b], lack, away);
            }
        }
        let base = body.rigid_nodes().min(free);
        if base == 0 {
            return;
        }
        for _ in 0..3 {
            let tip = self.tip(up);
            let least = feelers.clearance(field, &tip, entry);
            if least.mm >= 0.0 {
                break;
            }
            let Some(away) = field.away_from_wall(least.at_lps) else {
                break;
            };
            // The tip acts as a lever: a push between its two ends moves both ends, the nearer one more.
            let share = (-least.in_tip[2] / (base as f64 * NODE_MM)).clamp(0.0, 1.0);
            let norm = share * share + (1.0 - share) * (1.0 - share);
            let (front, back) = ((1.0 - share) / norm, share / norm);
            for n in 0..=base.min(free.saturating_sub(1)) {
                let at = n as f64 / base as f64;
                let part = front + at * (back - front);
                self.nodes[n] = along(self.nodes[n], -least.mm * part, away);
            }
        }
    }

    /// Return the penetration of the wall, in mm, by the tip and by the shaft's first `num` nodes (0 without
    /// penetration).
    pub(crate) fn depths_mm(
        &self,
        field: &WallField,
        feelers: &Feelers,
        body: &ScopeBody,
        entry: &Entry,
        up: Point,
        num: usize,
    ) -> (f64, f64) {
        let tip = feelers.clearance(field, &self.tip(up), entry);
        let mut shaft: f64 = 0.0;
        for (a, b) in Self::shaft_places(body, num) {
            let p = mix(self.nodes[a], self.nodes[b], 0.5);
            if entry.depth_mm(p) >= 0.0 {
                let radius = body.radius_mm(0.5 * (a + b) as f64 * NODE_MM);
                shaft = shaft.max(radius - field.distance_up_to(p, radius));
            }
        }
        ((-tip.mm).max(0.0), shaft)
    }

    /// Return whether the tip and the shaft's first `num` nodes are in the lumen, within the tolerances.
    ///
    /// The result is that of comparing the depths of [`Self::depths_mm`] with the tolerances. It is computed faster,
    /// because the first place that penetrates the wall ends the test.
    fn fits(
        &self,
        field: &WallField,
        feelers: &Feelers,
        body: &ScopeBody,
        entry: &Entry,
        up: Point,
        num: usize,
    ) -> bool {
        !feelers.penetrates(field, &self.tip(up), entry, TIP_TOLERANCE_MM)
            && self.shaft_fits(field, body, entry, 0, num)
    }

    /// Return whether the shaft's nodes from `first` to `num` are in the lumen, within the tolerance.
    fn shaft_fits(
        &self,
        field: &WallField,
        body: &ScopeBody,
        entry: &Entry,
        first: usize,
        num: usize,
    ) -> bool {
        Self::shaft_places(body, num)
            .skip_while(|&(a, _)| a < first)
            .all(|(a, b)| {
                let p = mix(self.nodes[a], self.nodes[b], 0.5);
                let radius = body.radius_mm(0.5 * (a + b) as f64 * NODE_MM);
                if entry.depth_mm(p) >= 0.0 {
                    radius - field.distance_up_to(p, radius) <= SHAFT_TOLERANCE_MM
                } else {
                    true
                }
            })
    }

    /// Relax the axis against the walls; return false if the scope does not fit at this position.
    pub(crate) fn relax(
        &mut self,
        field: &WallField,
        feelers: &Feelers,
        body: &ScopeBody,
        entry: &Entry,
        first_up: Point,
        controls: Controls,
    ) -> bool {
        if self.nodes.len() - 2 <= body.rigid_nodes() {
            // The rigid tip is still in the entry and points in the entry's direction.
            *self = Self::straight(entry, controls.depth_mm);
        }
        let free = self.nodes.len() - 2;
        let is_free = free > body.rigid_nodes();
        let mut last_depth = f64::INFINITY;
        let mut ups = Vec::new();
        // Number of nodes that the previous sweep may have moved.
        let mut num_moved = free;
        for sweep in 0..MAX_SWEEPS {
            let num = if sweep == 0 {
                free
            } else {
                free.min(NEAR_NODES)
            };
            if ups.is_empty() || num_moved == free {
                ups = self.ups(first_up, controls.roll_rad);
            } else {
                self.update_ups(&mut ups, num_moved);
            }
            num_moved = num;
            if is_free {
                let rest = self.rest(body, &ups, controls.flexion_rad);
                self.unbend(&rest, num);
                self.push_off_wall(field, feelers, body, entry, ups[0], num);
                self.stretch(body, num);
            }
            if sweep + 1 < MIN_SWEEPS {
                continue;
            }
            let inside = self.fits(field, feelers, body, entry, ups[0], num);
            if inside && free > num && !self.shaft_fits(field, body, entry, num, free) {
                // The shaft penetrates the wall far back, where only sweeps over all nodes have an effect.
                self.push_off_wall(field, feelers, body, entry, ups[0], free);
                self.stretch(body, free);
                num_moved = free;
                continue;
            }
            if inside {
                return self.nodes.iter().flatten().all(|v| v.is_finite());
            }
            if !is_free {
                return false;
            }
            if sweep % PATIENCE == PATIENCE - 1 {
                let (tip, shaft) = self.depths_mm(field, feelers, body, entry, ups[0], num);
                let depth = tip.max(shaft - SHAFT_TOLERANCE_MM);
                if depth > 0.5 * last_depth {
                    return false;
                }
                last_depth = depth;
            }
        }
        false
    }

    /// Return the position that the tip's face would have if no wall touched the part in front of the bending section's
    /// base.
    pub(crate) fn free_face(
        &self,
        body: &ScopeBody,
        first_up: Point,
        controls: Controls,
        further_mm: f64,
    ) -> Point {
        let (rigid, num) = (body.rigid_nodes(), body.bending_nodes());
        let last = (rigid + num - 1).min(self.nodes.len().saturating_sub(3));
        if last < rigid {
            return along(self.nodes[0], further_mm, self.forward(1));
        }
        let ups = self.ups(first_up, controls.roll_rad);
        let angle = controls.flexion_rad / num as f64;
        let (mut forward, mut up) = (self.forward(last + 1), ups[last]);
        let mut at = self.nodes[last];
        for node in (1..=last).rev() {
            if node >= rigid {
                let axis = cross(forward, up);
                forward = turned(forward, axis, angle);
                up = turned(up, axis, angle);
            }
            at = along(at, NODE_MM, forward);
        }
        along(at, further_mm, forward)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::drive_tests::{BODY, field};

    proptest! {
        #[test]
        fn an_axis_fits_exactly_if_its_depths_are_within_the_tolerances(
            lean in -0.3f64..0.3,
            depth_mm in 30.0f64..180.0,
            curve in -0.02f64..0.02,
            num in 1usize..80,
        ) {
            let field = field();
            let entry = Entry { at: [0.0, 0.0, 112.0], into: [0.0, 0.0, -1.0] };
            let feelers = Feelers::new(&BODY);
            let mut axis = Axis::straight(&entry, depth_mm);
            let free = axis.nodes.len() - 2;
            for n in (0..free).rev() {
                let angle = lean * 0.05 + curve * (free - n) as f64;
                let step = [NODE_MM * libm::sin(angle), 0.0, -NODE_MM * libm::cos(angle)];
                axis.nodes[n] = along(axis.nodes[n + 1], 1.0, step);
            }
            let up = axis.ups([0.0, -1.0, 0.0], 0.4)[0];
            let num = num.min(free);
            let inside = |num| {
                let (tip, shaft) = axis.depths_mm(&field, &feelers, &BODY, &entry, up, num);
                tip <= TIP_TOLERANCE_MM && shaft <= SHAFT_TOLERANCE_MM
            };
            prop_assert_eq!(axis.fits(&field, &feelers, &BODY, &entry, up, num), inside(num));
            if inside(num) {
                prop_assert_eq!(axis.shaft_fits(&field, &BODY, &entry, num, free), inside(free));
            }
        }
    }
}
