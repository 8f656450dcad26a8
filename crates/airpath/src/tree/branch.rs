//! Branch of the airway tree, and conversion of a line in the lumen to smooth points with wall distances.

use carina_grid::{Grid, Ijk, length};

use crate::tree::smooth::{self, Point};
use carina_leastcost::lumen::LumenGraph;

/// Part of an airway between two forks, or between a fork and a tip.
#[derive(Debug, Clone, PartialEq)]
pub struct Branch {
    /// Index of the parent branch in the list of branches; `None` for the branch at the root.
    ///
    /// A parent comes before its children.
    pub parent: Option<usize>,
    /// Number of forks between the root and this branch.
    pub generation: u32,
    /// Voxel path from the root side to the tip side; the first node is the last node of the parent branch.
    pub nodes: Vec<u32>,
    /// Smooth centreline in the middle of the lumen, LPS mm; the first point equals the parent's last point bit for
    /// bit.
    pub points: Vec<Point>,
    /// Radius at each point, in mm, of the circle with the area of the lumen's cross-section.
    pub radius_mm: Vec<f64>,
    /// Distance from each point to the nearest wall, mm.
    pub wall_mm: Vec<f64>,
}

/// Convert a chain of points in the lumen to evenly spaced, smooth points in the lumen.
///
/// Also return the distance of each point along the chain, mm.
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

/// Return the distance in mm from a point (LPS mm) to the nearest wall; 0 outside the lumen.
///
/// The result is the smallest sum, over the neighbouring lumen voxels, of the distance from the point to the voxel and
/// of the voxel's distance to its wall. The sum is never smaller than the distance to the wall, and equal to it if the
/// voxel is on the shortest line to the wall. (Interpolation of the distance between voxels would flatten the sharp
/// maximum in the middle of a tube: half a voxel too small.)
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
