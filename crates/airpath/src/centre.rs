//! Centrelines in the middle of the lumen, and forks where the axes of the tubes meet.
//!
//! A least-cost path keeps near the middle, but cuts the corner into a branch. Where a branch is a tube by itself its
//! points move to the centre of the lumen's area in the plane across it, between voxels. Near a fork no such centre is the
//! branch's: there the axes of parent and children are carried on as straight lines, and the fork is the point nearest to
//! all of them (least squares; Antiga and Steinman 2004 place a bifurcation's origin likewise from where its tubes begin to
//! be separate). The centreline bends from one tube's axis to the other's with as little curvature as it can.

use carina_grid::{Grid, Ijk, Lps, dot, length, unit};
use rayon::prelude::*;

use crate::caliber;
use crate::cross_section::{NUM_RAYS, centroid, direction, filled, plane_axes, without_far};
use crate::lumen::LumenGraph;
use crate::smooth::{self, Point, cumulative_mm, point_at};
use crate::tree::{self, Branch};

/// Places along two branches are compared at this distance.
const LOOK_MM: f64 = 0.25;
/// A branch is a tube by itself this many radii past the carina, and up to as many before its own fork as the second says.
pub(crate) const PAST_CARINA_RADII: f64 = 0.3;
pub(crate) const BEFORE_FORK_RADII: f64 = 1.0;
/// The lumen closes at a tip: its last part is no tube.
const BEFORE_TIP_RADII: f64 = 0.5;
/// An axis is the line through so many radii of tube.
const AXIS_RADII: f64 = 2.0;
/// How much the fork of the least-cost paths counts against an axis: it decides only where the axes are nearly parallel.
const OLD_FORK_WEIGHT: f64 = 0.05;
/// A fork is not moved farther than this multiple of its tube's radius.
const FARTHEST_RADII: f64 = 2.5;
/// Points that were centred hold their place so much better than those of a voxel path.
const CENTRED_PULL: f64 = 4.0;
/// Points near a fork hardly pull: they only say where the lumen is.
const FORK_PULL: f64 = 1e-3;
const ROUNDS: usize = 3;

/// A branch with the part of it that is a tube by itself.
pub(crate) struct Tube {
    pub(crate) points: Vec<Point>,
    pub(crate) along_mm: Vec<f64>,
    /// Median distance to the wall.
    pub(crate) radius_mm: f64,
    /// The tube's part, mm along the branch.
    from_mm: f64,
    to_mm: f64,
    /// Centred points of that part.
    middle: Vec<Point>,
}

impl Tube {
    pub(crate) fn length_mm(&self) -> f64 {
        self.along_mm[self.along_mm.len() - 1]
    }

    fn at(&self, s: f64) -> Point {
        if self.points.len() < 2 {
            return self.points[0];
        }
        point_at(&self.points, &self.along_mm, s.clamp(0.0, self.length_mm()))
    }

    /// From one place along the branch to another.
    pub(crate) fn chord(&self, from_mm: f64, to_mm: f64) -> Point {
        sub(self.at(to_mm), self.at(from_mm))
    }

    /// The axis at one end of the tube's part: a point and a unit vector along the branch, and how well it is known.
    fn axis(&self, at_end: bool) -> Option<(Point, Point, f64)> {
        let n = self.middle.len();
        let reach_mm = AXIS_RADII * self.radius_mm;
        let along = cumulative_mm(&self.middle);
        let total = along[n - 1];
        let from = if at_end {
            (total - reach_mm).max(0.0)
        } else {
            0.0
        };
        let to = if at_end { total } else { reach_mm.min(total) };
        let part: Vec<Point> = (0..n)
            .filter(|&m| along[m] >= from - 1e-9 && along[m] <= to + 1e-9)
            .map(|m| self.middle[m])
            .collect();
        if part.len() < 3 {
            // Too short for an axis of its own: the whole branch's direction, hardly trusted.
            let chord = sub(self.at(self.length_mm()), self.at(0.0));
            return Some((part.first().copied()?, unit(chord)?, 0.1));
        }
        let count = part.len() as f64;
        let mean: Point = std::array::from_fn(|a| part.iter().map(|p| p[a]).sum::<f64>() / count);
        // Least squares over the way: the slope of each coordinate.
        let middle = (count - 1.0) / 2.0;
        let slope: Point = std::array::from_fn(|a| {
            (0..part.len())
                .map(|m| (m as f64 - middle) * part[m][a])
                .sum::<f64>()
        });
        let end = if at_end {
            part[part.len() - 1]
        } else {
            part[0]
        };
        let dir = unit(slope)?;
        // The point of the line that is nearest to the tube's end.
        let off = dot(sub(end, mean), dir);
        let on_line = std::array::from_fn(|a| mean[a] + off * dir[a]);
        Some((
            on_line,
            dir,
            (total.min(reach_mm) / reach_mm).clamp(0.1, 1.0),
        ))
    }
}

fn sub(a: Point, b: Point) -> Point {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Moves the drawn branches into the middle and their forks to where their axes meet.
///
/// Every point stays in the lumen, and a child still begins at its parent's last point, bit for bit.
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
            // All of it belongs to its forks: only its middle is its own.
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
        // A fork that would come to lie before the one above it stays where it was.
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
    let calibers = caliber::of_branches(graph, grid, &drawn, &parents, |_| true);
    for ((branch, points), caliber) in branches.iter_mut().zip(drawn).zip(calibers) {
        branch.points = points;
        if let Some(caliber) = caliber {
            branch.radius_mm = caliber.section_mm;
            branch.wall_mm = caliber.wall_mm;
        }
    }
}

pub(crate) struct View<'a> {
    pub(crate) graph: &'a LumenGraph,
    pub(crate) grid: &'a Grid,
}

impl View<'_> {
    fn tube(&self, branch: &Branch) -> Tube {
        let walls: Vec<f64> = branch
            .points
            .iter()
            .map(|p| tree::radius_mm(self.graph, self.grid, *p))
            .collect();
        self.tube_of(&branch.points, &walls)
    }

    /// A line with its distances to the wall.
    pub(crate) fn tube_of(&self, points: &[Point], walls_mm: &[f64]) -> Tube {
        let mut radii = walls_mm.to_vec();
        radii.sort_by(f64::total_cmp);
        Tube {
            along_mm: cumulative_mm(points),
            points: points.to_vec(),
            radius_mm: radii[radii.len() / 2].max(self.grid.min_spacing_mm()),
            from_mm: 0.0,
            to_mm: 0.0,
            middle: Vec::new(),
        }
    }

    fn holds(&self, p: Point) -> bool {
        self.graph.holds(self.grid.to_ijk(Lps(p)).0)
    }

    /// How far from their common fork a wall comes between two branches.
    pub(crate) fn parting_mm(&self, one: &Tube, other: &Tube) -> Option<f64> {
        let shorter = one.length_mm().min(other.length_mm());
        (1..=(shorter / LOOK_MM) as usize)
            .map(|n| n as f64 * LOOK_MM)
            .find(|&s| {
                let [p, q] = [one.at(s), other.at(s)].map(|p| self.grid.to_ijk(Lps(p)).0);
                !self.graph.sees(p, q)
            })
    }

    /// The points of a tube's own part, each in the centre of its section.
    fn centred(&self, tube: &Tube, step_mm: f64) -> Vec<Point> {
        let num_steps = ((tube.to_mm - tube.from_mm) / step_mm).round().max(0.0) as usize;
        let place = |n: usize| {
            if num_steps == 0 {
                return tube.from_mm;
            }
            tube.from_mm + (tube.to_mm - tube.from_mm) * n as f64 / num_steps as f64
        };
        let mut points: Vec<Point> = (0..=num_steps).map(|n| tube.at(place(n))).collect();
        let reach = (tube.radius_mm / step_mm).round().max(1.0) as usize;
        for _ in 0..ROUNDS {
            let next: Vec<Point> = (0..points.len())
                .map(|n| {
                    let (a, b) = (n.saturating_sub(reach), (n + reach).min(points.len() - 1));
                    let chord = if b - a >= 2 {
                        sub(points[b], points[a])
                    } else {
                        // A short part has its branch's direction.
                        let s = place(n);
                        tube.chord(s - tube.radius_mm, s + tube.radius_mm)
                    };
                    unit(chord)
                        .and_then(|normal| self.center(points[n], normal, tube.radius_mm))
                        .unwrap_or(points[n])
                })
                .collect();
            let pull = vec![CENTRED_PULL * smooth::pull_of(tube.radius_mm); points.len()];
            points = smooth::smoothed_by(&next, &pull, |p| self.holds(p));
        }
        points
    }

    /// The lumen's edge in a plane, if it is closed there.
    pub(crate) fn contour(
        &self,
        from: Point,
        axes: (Point, Point),
        radius_mm: f64,
    ) -> Option<[f64; NUM_RAYS]> {
        let reach_mm = 2.5 * radius_mm + 2.0 * self.grid.min_spacing_mm();
        let met = std::array::from_fn(|n| self.ray_mm(from, direction(axes, n), reach_mm));
        filled(&without_far(&met))
    }

    /// Centre of the lumen's area in a plane, if it is closed there and the centre lies in it.
    fn center(&self, from: Point, normal: Point, radius_mm: f64) -> Option<Point> {
        let axes = plane_axes(normal);
        let [u, v] = centroid(&self.contour(from, axes, radius_mm)?);
        let far_mm = u.hypot(v);
        let share = (0.5 * radius_mm / far_mm.max(1e-9)).min(1.0);
        let center = std::array::from_fn(|a| from[a] + share * (u * axes.0[a] + v * axes.1[a]));
        self.holds(center).then_some(center)
    }

    /// Where a ray leaves the lumen: the last voxel on it, and how far that one's wall is. NaN beyond the reach.
    fn ray_mm(&self, from: Point, dir: Point, reach_mm: f64) -> f64 {
        let step_mm = 0.5 * self.grid.min_spacing_mm();
        let first = self.grid.to_ijk(Lps(from)).0;
        let step = self.grid.ijk_from_lps().vector(dir).map(|v| v * step_mm);
        let mut last = None;
        for n in 0..=(reach_mm / step_mm) as usize {
            let voxel: [isize; 3] =
                std::array::from_fn(|a| (first[a] + n as f64 * step[a] + 0.5).floor() as isize);
            let Some(node) = self.graph.node_at_voxel(voxel) else {
                return last.map_or(f64::NAN, |(voxel, node): ([isize; 3], u32)| {
                    let center = self.grid.to_lps(Ijk(voxel.map(|v| v as f64))).0;
                    dot(sub(center, from), dir) + self.graph.wall_mm(node)
                });
            };
            last = Some((voxel, node));
        }
        f64::NAN
    }

    /// The point nearest to the axes of a branch and of its children.
    fn fork(&self, tubes: &[Tube], parent: usize, children: &[usize]) -> Point {
        let tube = &tubes[parent];
        let old = tube.at(tube.length_mm());
        // Sum of w (I - t t') F = sum of w (I - t t') p, and the old fork with a small weight.
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

    /// The whole branch from its first point to its last, through the middle of its own part.
    fn drawn(
        &self,
        tube: &Tube,
        start: Point,
        end: Point,
        forks: bool,
        step_mm: f64,
    ) -> Vec<Point> {
        // What lies behind the fork's plane is not on the way: a fork may have moved.
        let axis = sub(end, start);
        let on_way =
            |p: &&Point| dot(sub(**p, start), axis) > 0.0 && dot(sub(end, **p), axis) > 0.0;
        let middle: Vec<Point> = tube.middle.iter().filter(on_way).copied().collect();
        let mut chain = vec![start];
        chain.extend(&middle);
        chain.push(end);
        let along = cumulative_mm(&chain);
        if along[along.len() - 1] <= 0.0 {
            // A single voxel.
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
            *point = tree::pulled_inside(self.graph, self.grid, *point);
        }
        let mut curve = smooth::smoothed_by(&points, &pull, |p| self.holds(p));
        curve[0] = start;
        if forks {
            curve[last] = end;
        }
        curve
    }
}

/// Solves a symmetric 3 x 3 system by Cramer's rule; `None` where it has no one answer.
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
