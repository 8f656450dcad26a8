//! Centrelines in the middle of the lumen, and forks where the axes of the tubes meet.
//!
//! A least-cost path stays near the middle, but cuts the corner into a branch. In the *own part* of a branch, where it
//! is a separate tube, its points move to the centre of the lumen's cross-section, with sub-voxel accuracy. Near a
//! fork the cross-section includes other branches. There the axes of parent and children continue as straight
//! lines, and the fork is the point nearest to all of these lines (least squares; Antiga and Steinman 2004
//! similarly place a bifurcation's origin from where its tubes begin to be separate). The centreline bends from one
//! tube's axis to the other's with the least possible curvature.

use carina_grid::{Grid, Lps, dot, length};
use rayon::prelude::*;

use crate::tree::branch::{self, Branch};
use crate::tree::branch_radii;
use crate::tree::smooth::{self, Point, cumulative_mm};
use crate::tree::tube::{BEFORE_FORK_RADII, CENTRED_PULL, PAST_CARINA_RADII, Tube, View, sub};
use carina_leastcost::lumen::LumenGraph;

/// Distance in radii before a tip at which the own part of the last branch ends, because the lumen closes at the tip.
const BEFORE_TIP_RADII: f64 = 0.5;
/// Weight of the fork of the least-cost paths, relative to the weight of an axis, in the least-squares fit.
///
/// This weight matters only if the axes are nearly parallel.
const OLD_FORK_WEIGHT: f64 = 0.05;
/// Maximum displacement of a fork, in radii of the parent tube; otherwise it stays in place.
const FARTHEST_RADII: f64 = 2.5;
/// Weight in the smoothing of the points near a fork, small because they only show where the lumen is.
const FORK_PULL: f64 = 1e-3;

/// Move the centrelines of branches to the middle of the lumen, and their forks to the intersection of the tubes' axes.
///
/// Every point stays in the lumen, and each child still begins at its parent's last point, bit for bit.
pub(crate) fn refine(graph: &LumenGraph, grid: &Grid, branches: &mut [Branch], step_mm: f64) {
    let view = View { graph, grid };
    let children: Vec<Vec<usize>> = (0..branches.len())
        .map(|b| {
            (0..branches.len())
                .filter(|&c| branches[c].parent == Some(b))
                .collect()
        })
        .collect();
    let mut tubes: Vec<Tube> = branches.iter().map(|b| view.tube(b)).collect();
    for list in &children {
        for &child in list {
            let carina_mm = list
                .iter()
                .filter(|other| **other != child)
                .filter_map(|&other| view.parting_mm(&tubes[child], &tubes[other]))
                .reduce(f64::max);
            tubes[child].from_mm = match (carina_mm, branches[child].parent) {
                (Some(mm), _) => mm + PAST_CARINA_RADII * tubes[child].radius_mm,
                (None, Some(parent)) => tubes[parent].radius_mm,
                (None, None) => 0.0,
            };
        }
    }
    tubes.par_iter_mut().enumerate().for_each(|(b, tube)| {
        let before_end = if children[b].is_empty() {
            BEFORE_TIP_RADII
        } else {
            BEFORE_FORK_RADII
        };
        let length_mm = tube.length_mm();
        tube.to_mm = length_mm - before_end * tube.radius_mm;
        if tube.to_mm - tube.from_mm < step_mm {
            // The branch is too short to be a separate tube; its own part is then a single position in its middle.
            let middle =
                (0.5 * (tube.from_mm + tube.to_mm)).clamp(0.25 * length_mm, 0.75 * length_mm);
            (tube.from_mm, tube.to_mm) = (middle, middle);
        }
        tube.middle = view.centred(tube, step_mm);
    });
    let forks: Vec<Option<Point>> = (0..branches.len())
        .map(|b| (!children[b].is_empty()).then(|| view.fork(&tubes, b, &children[b])))
        .collect();
    let mut starts: Vec<Point> = vec![[0.0; 3]; branches.len()];
    let mut ends: Vec<Point> = vec![[0.0; 3]; branches.len()];
    for b in 0..branches.len() {
        let tube = &tubes[b];
        starts[b] = branches[b].parent.map_or(tube.points[0], |p| ends[p]);
        let old = tube.at(tube.length_mm());
        // If the fork would move behind the start of the branch, it keeps its previous position.
        ends[b] = match forks[b] {
            Some(fork)
                if dot(sub(fork, starts[b]), sub(old, tube.points[0])) > 0.0
                    && length(sub(fork, starts[b])) > 0.3 * tube.length_mm() =>
            {
                fork
            }
            _ => old,
        };
    }
    let drawn: Vec<Vec<Point>> = (0..branches.len())
        .into_par_iter()
        .map(|b| {
            view.drawn(
                &tubes[b],
                starts[b],
                ends[b],
                !children[b].is_empty(),
                step_mm,
            )
        })
        .collect();
    let parents: Vec<Option<usize>> = branches.iter().map(|b| b.parent).collect();
    let radii = branch_radii::of_branches(graph, grid, &drawn, &parents, |_| true);
    for ((branch, points), radii_of_branch) in branches.iter_mut().zip(drawn).zip(radii) {
        branch.points = points;
        if let Some(radii_of_branch) = radii_of_branch {
            branch.radius_mm = radii_of_branch.section_mm;
            branch.wall_mm = radii_of_branch.wall_mm;
        }
    }
}

impl View<'_> {
    /// Return the new position of the fork at the end of branch `parent`: the point nearest to the tubes' axes.
    ///
    /// The result is the previous position if the new one is far away, outside the lumen, or not visible from the
    /// previous one.
    fn fork(&self, tubes: &[Tube], parent: usize, children: &[usize]) -> Point {
        let tube = &tubes[parent];
        let old = tube.at(tube.length_mm());
        // Solve: sum of w (I - t t') F = sum of w (I - t t') p, with a small weight for the previous fork.
        let mut matrix = [[0.0; 3]; 3];
        let mut right = [0.0; 3];
        let mut add = |p: Point, t: Option<Point>, w: f64| {
            for a in 0..3 {
                for b in 0..3 {
                    let part = f64::from(u8::from(a == b)) - t.map_or(0.0, |t| t[a] * t[b]);
                    matrix[a][b] += w * part;
                    right[a] += w * part * p[b];
                }
            }
        };
        if let Some((p, t, w)) = tube.axis(true) {
            add(p, Some(t), 2.0 * w);
        }
        for &child in children {
            if let Some((p, t, w)) = tubes[child].axis(false) {
                add(p, Some(t), w);
            }
        }
        add(old, None, OLD_FORK_WEIGHT);
        let Some(fork) = solve(matrix, right) else {
            return old;
        };
        let near = length(sub(fork, old)) <= FARTHEST_RADII * tube.radius_mm;
        if near && self.holds(fork) && self.sees(fork, old) {
            fork
        } else {
            old
        }
    }

    fn sees(&self, p: Point, q: Point) -> bool {
        let [p, q] = [p, q].map(|p| self.grid.to_ijk(Lps(p)).0);
        self.graph.sees(p, q)
    }

    /// Return the smooth points of a branch from `start` to `end`, through the middle of the lumen in its own part.
    fn drawn(
        &self,
        tube: &Tube,
        start: Point,
        end: Point,
        forks: bool,
        step_mm: f64,
    ) -> Vec<Point> {
        // The forks may have moved, so points of the own part that are not between the two ends are left out.
        let axis = sub(end, start);
        let on_way =
            |p: &&Point| dot(sub(**p, start), axis) > 0.0 && dot(sub(end, **p), axis) > 0.0;
        let middle: Vec<Point> = tube.middle.iter().filter(on_way).copied().collect();
        let mut chain = vec![start];
        chain.extend(&middle);
        chain.push(end);
        let along = cumulative_mm(&chain);
        if along[along.len() - 1] <= 0.0 {
            // A branch of a single voxel has one point.
            return if tube.points.len() == 1 {
                vec![start]
            } else {
                vec![start, end]
            };
        }
        let (from_mm, to_mm) = (along[1], along[along.len() - 2]);
        let (mut points, at_mm) = smooth::resampled(&chain, step_mm);
        let own = CENTRED_PULL * smooth::pull_of(tube.radius_mm);
        let mut pull: Vec<f64> = at_mm
            .iter()
            .map(|s| {
                let is_own = !middle.is_empty() && *s >= from_mm - 1e-9 && *s <= to_mm + 1e-9;
                if is_own { own } else { FORK_PULL }
            })
            .collect();
        let last = points.len() - 1;
        pull[0] = smooth::FIXED;
        pull[last] = if forks { smooth::FIXED } else { 3.0 * own };
        for point in &mut points[1..last] {
            *point = branch::pulled_inside(self.graph, self.grid, *point);
        }
        let mut curve = smooth::smoothed_by(&points, &pull, |p| self.holds(p));
        curve[0] = start;
        if forks {
            curve[last] = end;
        }
        curve
    }
}

/// Solve a symmetric 3 x 3 system by Cramer's rule; return `None` if it has no unique solution.
fn solve(m: [[f64; 3]; 3], r: [f64; 3]) -> Option<Point> {
    let determinant = |c: [[f64; 3]; 3]| {
        c[0][0] * (c[1][1] * c[2][2] - c[1][2] * c[2][1])
            - c[0][1] * (c[1][0] * c[2][2] - c[1][2] * c[2][0])
            + c[0][2] * (c[1][0] * c[2][1] - c[1][1] * c[2][0])
    };
    let whole = determinant(m);
    (whole.abs() > 1e-9).then(|| {
        std::array::from_fn(|column| {
            let mut replaced = m;
            for row in 0..3 {
                replaced[row][column] = r[row];
            }
            determinant(replaced) / whole
        })
    })
}
