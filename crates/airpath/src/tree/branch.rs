//! A branch of the airway tree, and what its points ask of the lumen.

use carina_grid::{Grid, Ijk, length};

use crate::tree::smooth::{self, Point};
use carina_leastcost::lumen::LumenGraph;

/// A piece of airway between two forks, or between a fork and a tip.
#[derive(Debug, Clone, PartialEq)]
pub struct Branch {
    /// Position of the parent in the list; `None` at the root. Parents come first.
    pub parent: Option<usize>,
    /// Forks passed on the way here.
    pub generation: u32,
    /// Voxel path, root to tip; the first node is the parent's last.
    pub nodes: Vec<u32>,
    /// Smooth centreline in the middle of the lumen, LPS; the first point is the parent's last, bit for bit.
    pub points: Vec<Point>,
    /// Radius of the circle with the area of the lumen across the branch, at each point, mm.
    pub radius_mm: Vec<f64>,
    /// Distance to the wall at each point, mm.
    pub wall_mm: Vec<f64>,
}

/// A chain inside the lumen as even, smooth points inside it, and how far along the chain each one stands, mm.
#[must_use]
pub fn smooth_inside(
    graph: &LumenGraph,
    grid: &Grid,
    chain: &[Point],
    step_mm: f64,
    keep_end: bool,
) -> (Vec<Point>, Vec<f64>) {
    let (mut even, at_mm) = smooth::resampled(chain, step_mm);
    for point in &mut even {
        *point = pulled_inside(graph, grid, *point);
    }
    let radius: Vec<f64> = even.iter().map(|p| radius_mm(graph, grid, *p)).collect();
    let holds = |p: Point| graph.holds(grid.to_ijk(carina_grid::Lps(p)).0);
    (smooth::smoothed(&even, &radius, keep_end, holds), at_mm)
}

pub(crate) fn pulled_inside(graph: &LumenGraph, grid: &Grid, lps: Point) -> Point {
    let ijk = grid.to_ijk(carina_grid::Lps(lps)).0;
    if graph.holds(ijk) {
        return lps;
    }
    grid.to_lps(Ijk(graph.pulled_inside(grid, ijk))).0
}

/// Distance to the wall at a point, mm; 0 outside the lumen.
///
/// From a lumen voxel near the point to its wall and from the point to that voxel is never shorter than the way to the
/// wall, and exactly as long where the voxel lies on that way: the least over the neighbours. (Interpolated between voxels
/// the distance has no sharp ridge: in the middle of a tube it would be half a voxel short.)
#[must_use]
pub fn radius_mm(graph: &LumenGraph, grid: &Grid, lps: Point) -> f64 {
    let ijk = grid.to_ijk(carina_grid::Lps(lps)).0;
    let nearest = ijk.map(|v| (v + 0.5).floor() as isize);
    if graph.node_at_voxel(nearest).is_none() {
        return 0.0;
    }
    let mut best = f64::INFINITY;
    for cell in 0..27isize {
        let offset = [cell % 3 - 1, cell / 3 % 3 - 1, cell / 9 - 1];
        let at: [isize; 3] = std::array::from_fn(|a| nearest[a] + offset[a]);
        if let Some(node) = graph.node_at_voxel(at) {
            let away = std::array::from_fn(|a| at[a] as f64 - ijk[a]);
            best = best.min(graph.wall_mm(node) + length(grid.lps_from_ijk().vector(away)));
        }
    }
    best
}
