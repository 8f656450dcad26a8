//! Tests of the centrelines and forks of a Y of drawn tubes against the tubes' axes, on an oblique anisotropic
//! grid.

use carina_grid::{Affine, Grid, Ijk, Lps, VolumeView, dot, length};

use crate::tree::branch::Branch;
use crate::tree::branches::{BranchLimits, branches_to, find_branches};
use crate::tree::smooth::Point;
use carina_leastcost::Unwatched;
use carina_leastcost::lumen::{LumenCost, LumenGraph, WallLevels};
use carina_leastcost::tracker::Tracker;

/// Value levels of the drawn lumen and wall.
const LEVELS: WallLevels = WallLevels {
    core: -900.0,
    wall: -500.0,
    rise: 25.0,
};

struct Tube {
    start: Point,
    end: Point,
    radius_mm: f64,
}

fn off(p: Point, tube: &Tube) -> f64 {
    let d: Point = std::array::from_fn(|a| tube.end[a] - tube.start[a]);
    let e: Point = std::array::from_fn(|a| p[a] - tube.start[a]);
    let t = (dot(e, d) / dot(d, d)).clamp(0.0, 1.0);
    length([0, 1, 2].map(|a| e[a] - t * d[a]))
}

fn grid() -> Grid {
    let (s, c) = 0.3f64.sin_cos();
    let x = [0.8 * c, 0.8 * s, 0.0];
    let y = [-0.9 * s, 0.9 * c, 0.0];
    Grid::new(
        [60, 60, 70],
        Affine::from_columns(x, y, [0.0, 0.0, 1.1], [-16.0, -34.0, -36.0]),
    )
    .unwrap()
}

/// Return the tubes of a Y: a trunk, a wide branch that continues nearly straight, and a narrow branch to the side.
fn tubes() -> Vec<Tube> {
    let fork = [0.6, -0.3, 0.2];
    let tube = |start, end, radius_mm| Tube {
        start,
        end,
        radius_mm,
    };
    vec![
        tube([1.0, 2.0, 27.0], fork, 5.0),
        tube(fork, [-7.0, -3.0, -26.0], 4.0),
        tube(fork, [17.0, 3.0, -17.0], 2.8),
    ]
}

fn found(with_levels: bool, step: impl Fn(&LumenGraph, &Tracker, &Grid, &[Branch])) -> Vec<Branch> {
    let (grid, tubes) = (grid(), tubes());
    let depth = |at: usize| {
        let p = grid.to_lps(Ijk(grid.voxel(at).map(|v| v as f64))).0;
        tubes
            .iter()
            .map(|t| off(p, t) - t.radius_mm)
            .fold(f64::INFINITY, f64::min)
    };
    let values: Vec<i16> = (0..grid.num_voxels())
        .map(|at| {
            let inside = (0.5 - depth(at) / 1.2).clamp(0.0, 1.0);
            (40.0 - 1040.0 * inside) as i16
        })
        .collect();
    // The lumen is as the flood finds it, which ends before the half-maximum of the wall.
    let lumen: Vec<u8> = values.iter().map(|v| u8::from(*v < -800)).collect();
    let mask: Vec<u8> = (0..values.len())
        .map(|at| u8::from(depth(at) < 0.0))
        .collect();
    let view = VolumeView::new(&values, &grid).unwrap();
    let graph = if with_levels {
        LumenGraph::build(view, &lumen, Some(LEVELS)).unwrap()
    } else {
        LumenGraph::build(view, &mask, None).unwrap()
    };
    let (root, _) = graph
        .nearest_node(&grid, grid.to_ijk(Lps(tubes[0].start)).0, 3.0)
        .unwrap();
    let cost = LumenCost(&graph);
    let mut tracker = Tracker::new(&graph, &cost, root).unwrap();
    tracker.solve_all(&graph, &cost, &Unwatched).unwrap();
    let limits = BranchLimits::for_grid(&grid);
    let branches = find_branches(&graph, &tracker, &grid, &limits, &Unwatched).unwrap();
    for branch in &branches {
        for p in &branch.points {
            assert!(graph.holds(grid.to_ijk(Lps(*p)).0), "{p:?}");
        }
        if let Some(parent) = branch.parent {
            let last = branches[parent].points[branches[parent].points.len() - 1];
            assert_eq!(branch.points[0].map(f64::to_bits), last.map(f64::to_bits));
        }
    }
    step(&graph, &tracker, &grid, &branches);
    branches
}

#[test]
fn centrelines_are_on_the_tubes_axes_and_the_bifurcation_is_at_their_intersection() {
    for with_levels in [true, false] {
        let branches = found(with_levels, |_, _, _, _| {});
        let tubes = tubes();
        assert_eq!(branches.len(), 3);
        let fork = branches[0].points[branches[0].points.len() - 1];
        let away = length([0, 1, 2].map(|a| fork[a] - tubes[0].end[a]));
        // The tolerance is one voxel: the axes are straight, so only the voxel size limits the distance between the
        // fork and the intersection of the axes.
        assert!(away < 1.0, "{with_levels} {away}");
        let (mut sum, mut radius_sum, mut num) = (0.0, 0.0, 0.0);
        for branch in &branches {
            let tip = branch.points[branch.points.len() / 2];
            let tube = tubes
                .iter()
                .min_by(|a, b| off(tip, a).total_cmp(&off(tip, b)))
                .unwrap();
            let far_from_fork = |p: &Point| {
                length([0, 1, 2].map(|a| p[a] - fork[a])) > 3.0 * tube.radius_mm
                    && length([0, 1, 2].map(|a| p[a] - tube.start[a])) > tube.radius_mm
                    && length([0, 1, 2].map(|a| p[a] - tube.end[a])) > 2.0 * tube.radius_mm
            };
            for (p, r) in branch.points.iter().zip(&branch.radius_mm) {
                sum += off(*p, tube);
                num += 1.0;
                if far_from_fork(p) {
                    radius_sum += (r - tube.radius_mm).abs();
                    // Crossings of the wall are found on grid edges, 0.8 to 1.1 mm apart, and the nearest crossing
                    // counts; in a mask they are half-way between voxels.
                    let least = if with_levels { 0.45 } else { 0.7 };
                    assert!(
                        (r - tube.radius_mm).abs() < least,
                        "{with_levels} {r} {}",
                        tube.radius_mm
                    );
                }
            }
        }
        // The tolerance is a third of the smallest voxel, including forks and tips.
        assert!(sum / num < 0.28, "{with_levels} {}", sum / num);
        assert!(
            radius_sum / num < 0.15,
            "{with_levels} {}",
            radius_sum / num
        );
    }
}

#[test]
fn a_path_to_the_middle_of_a_branch_begins_at_the_trunks_end() {
    let _ = found(true, |graph, tracker, grid, automatic| {
        let limits = BranchLimits::for_grid(grid);
        let middle = automatic[1].nodes[automatic[1].nodes.len() / 2];
        let part = branches_to(graph, tracker, grid, &limits, &[middle], automatic);
        assert_eq!(part.len(), 2, "trunk and the piece of the branch");
        let last = part[0].points[part[0].points.len() - 1];
        assert_eq!(part[1].points[0].map(f64::to_bits), last.map(f64::to_bits));
        let end = grid.to_lps(Ijk(graph.voxel(middle).map(|v| v as f64))).0;
        let tip = part[1].points[part[1].points.len() - 1];
        assert!(length([0, 1, 2].map(|a| tip[a] - end[a])) < 1.5);
        assert!(
            part.iter()
                .flat_map(|b| &b.points)
                .all(|p| graph.holds(grid.to_ijk(Lps(*p)).0))
        );
    });
}
