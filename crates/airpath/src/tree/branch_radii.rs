//! Width of a branch at each point of its centreline: the radius of the circle with the area of the lumen's
//! cross-section.
//!
//! The distance to the wall is smaller than this radius, because it is the minimum over all directions, and noise of
//! the wall lowers the minimum further. The *own part* of a branch is the part where the branch is a separate tube.
//! Near a fork a section cuts more than one tube. The width at such a point is that of the nearest section in the own
//! part, or of the section at the point itself if that is narrower (a stenosis at the branch's ostium).

use carina_grid::{Grid, unit};
use rayon::prelude::*;

use crate::section::rays::plane_axes;
use crate::tree::branch;
use crate::tree::smooth::Point;
use crate::tree::tube::{BEFORE_FORK_RADII, PAST_CARINA_RADII, Tube, View};
use carina_leastcost::lumen::LumenGraph;

/// Radii of the cross-sections along a branch, and distances to its wall.
#[derive(Debug, Clone, PartialEq)]
pub struct BranchRadii {
    /// Radius at each point, in mm, of the circle with the area of the lumen's cross-section.
    pub section_mm: Vec<f64>,
    /// Distance from each point to the nearest wall, mm.
    pub wall_mm: Vec<f64>,
}

/// Compute the radii of those branches of a tree for which `wanted` is true; the result is `None` for the others.
///
/// `lines` has the points of all branches, and `parents` the index of each branch's parent. The result depends only on
/// the lumen and these lines, so equal trees have equal radii.
#[must_use]
pub fn of_branches(
    graph: &LumenGraph,
    grid: &Grid,
    lines: &[Vec<Point>],
    parents: &[Option<usize>],
    wanted: impl Fn(usize) -> bool + Sync,
) -> Vec<Option<BranchRadii>> {
    let view = View { graph, grid };
    let mut children: Vec<Vec<usize>> = vec![Vec::new(); lines.len()];
    for (b, parent) in parents.iter().enumerate() {
        if let Some(parent) = parent {
            children[*parent].push(b);
        }
    }
    // The start of a branch's own part depends on its siblings at the same fork, so they are needed as well.
    let needed: Vec<bool> = (0..lines.len())
        .map(|b| wanted(b) || parents[b].is_some_and(|p| children[p].iter().any(|c| wanted(*c))))
        .collect();
    let walls: Vec<Vec<f64>> = lines
        .par_iter()
        .zip(&needed)
        .map(|(line, needed)| {
            line.iter()
                .filter(|_| *needed)
                .map(|p| branch::radius_mm(graph, grid, *p))
                .collect()
        })
        .collect();
    let tubes: Vec<Option<Tube>> = lines
        .iter()
        .zip(&walls)
        .map(|(line, wall)| (!wall.is_empty()).then(|| view.tube_of(line, wall)))
        .collect();
    (0..lines.len())
        .into_par_iter()
        .map(|b| {
            if !wanted(b) {
                return None;
            }
            let (tube, wall) = (tubes[b].as_ref()?, &walls[b]);
            let siblings = parents[b].map_or(&[][..], |p| &children[p]);
            let from_mm = siblings
                .iter()
                .filter(|other| **other != b)
                .filter_map(|&other| view.parting_mm(tube, tubes[other].as_ref()?))
                .reduce(f64::max)
                .map_or(0.0, |mm| mm + PAST_CARINA_RADII * tube.radius_mm);
            let before_end = if children[b].len() > 1 {
                BEFORE_FORK_RADII * tube.radius_mm
            } else {
                0.0
            };
            Some(BranchRadii {
                section_mm: sections(&view, tube, wall, from_mm, tube.length_mm() - before_end),
                wall_mm: wall.clone(),
            })
        })
        .collect()
}

/// Return the radius in mm at each point of a tube, from its sections between `from_mm` and `to_mm`.
fn sections(view: &View<'_>, tube: &Tube, wall: &[f64], from_mm: f64, to_mm: f64) -> Vec<f64> {
    let count = tube.points.len();
    let raw: Vec<f64> = (0..count).map(|n| section(view, tube, n)).collect();
    let is_own = |n: usize| {
        let at = tube.along_mm[n];
        raw[n].is_finite() && at >= from_mm - 1e-9 && at <= to_mm + 1e-9
    };
    let own: Vec<usize> = (0..count).filter(|n| is_own(*n)).collect();
    (0..count)
        .map(|n| {
            let after = own.partition_point(|m| *m < n);
            if own.get(after) == Some(&n) {
                return raw[n];
            }
            let held = match (after.checked_sub(1).map(|m| own[m]), own.get(after)) {
                // The radius is interpolated across a gap between two sections.
                (Some(before), Some(&next)) => {
                    let (a, b) = (tube.along_mm[before], tube.along_mm[next]);
                    let share = (tube.along_mm[n] - a) / (b - a).max(1e-9);
                    raw[before] + share * (raw[next] - raw[before])
                }
                (Some(nearest), None) | (None, Some(&nearest)) => raw[nearest],
                (None, None) => wall[n],
            };
            if raw[n].is_finite() {
                held.min(raw[n])
            } else {
                held
            }
        })
        .collect()
}

/// Return the radius in mm of the section at point `n` of a tube; NaN if the lumen is not closed round the point.
fn section(view: &View<'_>, tube: &Tube, n: usize) -> f64 {
    let at = tube.along_mm[n];
    let chord = tube.chord(at - tube.radius_mm, at + tube.radius_mm);
    unit(chord)
        .and_then(|normal| view.contour(tube.points[n], plane_axes(normal), tube.radius_mm))
        .map_or(f64::NAN, |contour| {
            // A sector has the area of its angle times r^2 / 2.
            (contour.iter().map(|r| r * r).sum::<f64>() / contour.len() as f64).sqrt()
        })
}
