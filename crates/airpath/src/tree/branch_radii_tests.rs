//! Tests of the radii of drawn tubes against circles of equal area, on an oblique anisotropic grid.

use carina_grid::{Affine, Grid, Ijk, VolumeView};

use crate::tree::branch_radii::of_branches;
use crate::tree::smooth::Point;
use carina_leastcost::lumen::{LumenGraph, WallLevels};

/// Value levels of the drawn lumen and wall.
const LEVELS: WallLevels = WallLevels {
    core: -900.0,
    wall: -500.0,
    rise: 25.0,
};

fn grid() -> Grid {
    let (s, c) = 0.3f64.sin_cos();
    let x = [0.8 * c, 0.8 * s, 0.0];
    let y = [-0.9 * s, 0.9 * c, 0.0];
    Grid::new(
        [60, 60, 60],
        Affine::from_columns(x, y, [0.0, 0.0, 1.1], [-16.0, -34.0, -30.0]),
    )
    .unwrap()
}

/// Return the graph of a lumen where `depth` (mm, 0 at the wall) is negative, with an edge blurred over 1.2 mm.
fn graph(grid: &Grid, depth: impl Fn(Point) -> f64) -> LumenGraph {
    let values: Vec<i16> = (0..grid.num_voxels())
        .map(|at| {
            let p = grid.to_lps(Ijk(grid.voxel(at).map(|v| v as f64))).0;
            (40.0 - 1040.0 * (0.5 - depth(p) / 1.2).clamp(0.0, 1.0)) as i16
        })
        .collect();
    let lumen: Vec<u8> = values.iter().map(|v| u8::from(*v < -800)).collect();
    LumenGraph::build(
        VolumeView::new(&values, grid).unwrap(),
        &lumen,
        Some(LEVELS),
    )
    .unwrap()
}

fn line(from: Point, to: Point) -> Vec<Point> {
    (0..=40)
        .map(|n| std::array::from_fn(|a| from[a] + (to[a] - from[a]) * f64::from(n) / 40.0))
        .collect()
}

#[test]
fn the_radius_of_a_flat_lumen_is_that_of_the_circle_with_its_area() {
    let grid = grid();
    let (long, short) = (6.0, 3.0);
    let graph = graph(&grid, |[x, y, _]| {
        // Near the wall, the ellipse's function divided by its gradient is the distance.
        let f = (x / long).hypot(y / short);
        let slope = (x / long / long).hypot(y / short / short) / f.max(1e-6);
        (f - 1.0) / slope.max(1e-6)
    });
    let lines = [line([0.0, 0.0, 25.0], [0.0, 0.0, -25.0])];
    let found = of_branches(&graph, &grid, &lines, &[None], |_| true)
        .remove(0)
        .unwrap();
    let circle = f64::sqrt(long * short);
    for n in 5..35 {
        // The tolerance is a twentieth: between voxels the edge is accurate to about a tenth of a voxel, and 64 rays
        // meet it.
        assert!(
            (found.section_mm[n] / circle - 1.0).abs() < 0.05,
            "{}",
            found.section_mm[n]
        );
        assert!(
            (found.wall_mm[n] / short - 1.0).abs() < 0.15,
            "{}",
            found.wall_mm[n]
        );
    }
}

fn fork() -> ([Vec<Point>; 3], [Option<usize>; 3], [f64; 3]) {
    let at = [0.0, 0.0, 0.0];
    let lines = [
        line([0.0, 0.0, 24.0], at),
        line(at, [-9.0, 0.0, -22.0]),
        line(at, [9.0, 0.0, -22.0]),
    ];
    (lines, [None, Some(0), Some(0)], [4.5, 3.5, 2.5])
}

fn off(p: Point, line: &[Point]) -> (f64, f64) {
    line.iter()
        .enumerate()
        .map(|(n, q)| {
            (
                carina_grid::length([0, 1, 2].map(|a| p[a] - q[a])),
                n as f64,
            )
        })
        .fold((f64::INFINITY, 0.0), |a, b| if b.0 < a.0 { b } else { a })
}

#[test]
fn the_width_of_a_branch_near_its_bifurcation_is_that_of_its_own_part() {
    let grid = grid();
    let (lines, parents, radii) = fork();
    let graph = graph(&grid, |p| {
        (0..3)
            .map(|b| off(p, &lines[b]).0 - radii[b])
            .fold(f64::INFINITY, f64::min)
    });
    let all = of_branches(&graph, &grid, &lines, &parents, |_| true);
    for (b, found) in all.iter().enumerate() {
        let found = found.as_ref().unwrap();
        for r in &found.section_mm[..36] {
            // The tolerance is half a voxel; the distance to the wall would be wrong by the parent's radius here.
            assert!((r - radii[b]).abs() < 0.4, "branch {b}: {r}");
        }
    }
    let child = all[2].as_ref().unwrap();
    assert!(
        child.wall_mm[0] > radii[2] + 1.0,
        "at the fork the wall is the trunk's"
    );
    for b in 0..3 {
        let one = of_branches(&graph, &grid, &lines, &parents, |other| other == b);
        assert_eq!(one[b], all[b], "one branch alone is measured as among all");
        assert_eq!(one.iter().flatten().count(), 1);
    }
}

#[test]
fn a_narrow_ostium_at_a_bifurcation_is_measured() {
    let grid = grid();
    let (lines, parents, radii) = fork();
    let graph = graph(&grid, |p| {
        (0..3)
            .map(|b| {
                let (away, n) = off(p, &lines[b]);
                // The wider child is constricted where its own part begins.
                let pinch = if b == 1 {
                    2.0 * (-((n - 13.0) / 4.0).powi(2)).exp()
                } else {
                    0.0
                };
                away - (radii[b] - pinch)
            })
            .fold(f64::INFINITY, f64::min)
    });
    let found = of_branches(&graph, &grid, &lines, &parents, |_| true);
    let narrow = found[1].as_ref().unwrap().section_mm[8..18]
        .iter()
        .copied()
        .fold(f64::INFINITY, f64::min);
    assert!(narrow < 2.2, "{narrow} mm where 1.5 mm are left of 3.5");
}
