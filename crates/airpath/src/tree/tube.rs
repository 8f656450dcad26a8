//! Branch as a tube: its own part, its axis, and sections of the lumen across it.
//!
//! The *own part* of a branch is the length over which the branch is a tube separate from its parent and its siblings.

use carina_grid::{Grid, Ijk, Lps, dot, unit};

use crate::section::rays::{NUM_RAYS, centroid, direction, filled, plane_axes, without_far};
use crate::tree::branch::{self, Branch};
use crate::tree::smooth::{self, Point, cumulative_mm, point_at};
use carina_leastcost::lumen::LumenGraph;

/// Distance in mm between the positions at which two branches are compared.
const COMPARISON_STEP_MM: f64 = 0.25;

/// Distance in radii between the carina and the start of a branch's own part.
pub(crate) const PAST_CARINA_RADII: f64 = 0.3;
/// Distance in radii between the end of a branch's own part and the fork at the branch's end.
pub(crate) const BEFORE_FORK_RADII: f64 = 1.0;

/// Length of the own part, in radii, to which the axis of its end is fitted.
const AXIS_RADII: f64 = 2.0;

/// Weight in the smoothing of points in the centre of their section, relative to points of a voxel path.
pub(crate) const CENTRED_PULL: f64 = 4.0;
/// Number of times that the points of the own part are centred in their sections.
const ROUNDS: usize = 3;

/// Centreline of a branch with its own part, in which it is a tube separate from other branches.
pub(crate) struct Tube {
    pub(crate) points: Vec<Point>,
    pub(crate) along_mm: Vec<f64>,
    /// Median distance from the centreline to the wall, mm.
    pub(crate) radius_mm: f64,
    /// Start of the branch's own part, mm along the branch.
    pub(crate) from_mm: f64,
    /// End of the branch's own part, mm along the branch.
    pub(crate) to_mm: f64,
    /// Points of the own part, each in the centre of its section.
    pub(crate) middle: Vec<Point>,
}

impl Tube {
    pub(crate) fn length_mm(&self) -> f64 {
        self.along_mm[self.along_mm.len() - 1]
    }

    pub(crate) fn at(&self, s: f64) -> Point {
        if self.points.len() < 2 {
            return self.points[0];
        }
        point_at(&self.points, &self.along_mm, s.clamp(0.0, self.length_mm()))
    }

    /// Return the vector between two positions along the branch, given in mm, LPS.
    pub(crate) fn chord(&self, from_mm: f64, to_mm: f64) -> Point {
        sub(self.at(to_mm), self.at(from_mm))
    }

    /// Return the axis at one end of the own part: a point (LPS mm), a unit vector along the branch, and a weight.
    ///
    /// The result is `None` if the branch has no direction, because it has one point.
    pub(crate) fn axis(&self, at_end: bool) -> Option<(Point, Point, f64)> {
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
            // The own part is too short for a fit, so the axis has the direction of the whole branch and a small
            // weight.
            let chord = sub(self.at(self.length_mm()), self.at(0.0));
            return Some((part.first().copied()?, unit(chord)?, 0.1));
        }
        let count = part.len() as f64;
        let mean: Point = std::array::from_fn(|a| part.iter().map(|p| p[a]).sum::<f64>() / count);
        // The axis is a least-squares line: the slope of each coordinate over the distance along the branch.
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
        // The point of the axis that is nearest to the end of the own part.
        let off = dot(sub(end, mean), dir);
        let on_line = std::array::from_fn(|a| mean[a] + off * dir[a]);
        Some((
            on_line,
            dir,
            (total.min(reach_mm) / reach_mm).clamp(0.1, 1.0),
        ))
    }
}

pub(crate) fn sub(a: Point, b: Point) -> Point {
    std::array::from_fn(|i| a[i] - b[i])
}

/// Lumen in which the tubes of branches are measured.
pub(crate) struct View<'a> {
    pub(crate) graph: &'a LumenGraph,
    pub(crate) grid: &'a Grid,
}

impl View<'_> {
    pub(crate) fn tube(&self, branch: &Branch) -> Tube {
        let walls: Vec<f64> = branch
            .points
            .iter()
            .map(|p| branch::radius_mm(self.graph, self.grid, *p))
            .collect();
        self.tube_of(&branch.points, &walls)
    }

    /// Create a tube from the points of a centreline and their distances to the wall in mm; its own part is not set.
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

    pub(crate) fn holds(&self, p: Point) -> bool {
        self.graph.holds(self.grid.to_ijk(Lps(p)).0)
    }

    /// Return the distance in mm from their common fork at which a wall separates two branches; `None` if no
    /// wall does.
    pub(crate) fn parting_mm(&self, one: &Tube, other: &Tube) -> Option<f64> {
        let shorter = one.length_mm().min(other.length_mm());
        (1..=(shorter / COMPARISON_STEP_MM) as usize)
            .map(|n| n as f64 * COMPARISON_STEP_MM)
            .find(|&s| {
                let [p, q] = [one.at(s), other.at(s)].map(|p| self.grid.to_ijk(Lps(p)).0);
                !self.graph.sees(p, q)
            })
    }

    /// Return the points of a tube's own part, each moved to the centre of the lumen's section at the point.
    pub(crate) fn centred(&self, tube: &Tube, step_mm: f64) -> Vec<Point> {
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
                        // A section of a short own part is perpendicular to the direction of the branch around it.
                        let s = place(n);
                        tube.chord(s - tube.radius_mm, s + tube.radius_mm)
                    };
                    unit(chord)
                        .and_then(|normal| self.centre(points[n], normal, tube.radius_mm))
                        .unwrap_or(points[n])
                })
                .collect();
            let pull = vec![CENTRED_PULL * smooth::pull_of(tube.radius_mm); points.len()];
            points = smooth::smoothed_by(&next, &pull, |p| self.holds(p));
        }
        points
    }

    /// Return the distances from a point to the lumen's edge in a plane; `None` if the lumen is not closed there.
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

    /// Return the centroid of the lumen in a plane; `None` if the lumen is not closed there or does not contain the
    /// centroid.
    fn centre(&self, from: Point, normal: Point, radius_mm: f64) -> Option<Point> {
        let axes = plane_axes(normal);
        let [u, v] = centroid(&self.contour(from, axes, radius_mm)?);
        let far_mm = u.hypot(v);
        let share = (0.5 * radius_mm / far_mm.max(1e-9)).min(1.0);
        let centre = std::array::from_fn(|a| from[a] + share * (u * axes.0[a] + v * axes.1[a]));
        self.holds(centre).then_some(centre)
    }

    /// Return the distance in mm at which a ray from a point leaves the lumen.
    ///
    /// The result is the distance to the last voxel in the lumen plus that voxel's distance to the wall. The result is
    /// NaN if the ray is still in the lumen at `reach_mm`.
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
                    let centre = self.grid.to_lps(Ijk(voxel.map(|v| v as f64))).0;
                    dot(sub(centre, from), dir) + self.graph.wall_mm(node)
                });
            };
            last = Some((voxel, node));
        }
        f64::NAN
    }
}
