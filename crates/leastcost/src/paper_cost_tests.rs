//! Tests of the printed cost and of the cost with expensive walls, on random volumes.
//!
//! The table equals the formulas, weights stay in their range, and the tracker finds the costs of Dijkstra's algorithm.

use carina_grid::{Affine, Grid, VolumeView};
use proptest::prelude::*;

use crate::Unwatched;
use crate::box_graph::{BoxGraph, VoxelGraph};
use crate::dijkstra::least_costs;
use crate::distance::VoxelBox;
use crate::graph::{Cost, Graph};
use crate::paper_cost::{
    MIN_WEIGHT, PaperCost, Reading, gradient, greatest_gradient, laplacian, wall_weight, weight,
};
use crate::tracker::Tracker;

/// Return a grid with three different spacings and a rotation, so that swapped axes cannot pass.
fn grid(shape_zyx: [usize; 3]) -> Grid {
    let (s, c) = 0.3f64.sin_cos();
    let axes = [
        [0.7 * c, 0.7 * s, 0.0],
        [-0.9 * s, 0.9 * c, 0.0],
        [0.0, 0.0, 2.5],
    ];
    Grid::new(
        shape_zyx,
        Affine::from_columns(axes[0], axes[1], axes[2], [3.0, -5.0, 8.0]),
    )
    .unwrap()
}

fn whole(grid: &Grid) -> VoxelBox {
    VoxelBox {
        first_ijk: [0; 3],
        shape_ijk: grid.shape_ijk(),
    }
}

#[derive(Debug, Clone)]
struct Case {
    shape_zyx: [usize; 3],
    values: Vec<i16>,
    part: VoxelBox,
}

/// Return a strategy for a volume and a box in it.
///
/// There are few values, so that gradients and Laplacians of 0 occur, and the extremes of int16.
fn case() -> impl Strategy<Value = Case> {
    (1usize..6, 1usize..7, 1usize..9)
        .prop_flat_map(|(nz, ny, nx)| {
            let value = prop_oneof![
                Just(-1000i16),
                Just(-990),
                Just(40),
                -1024i16..3071,
                Just(i16::MIN),
                Just(i16::MAX)
            ];
            let values = prop::collection::vec(value, nz * ny * nx);
            (
                Just([nz, ny, nx]),
                values,
                [0..nx, 0..ny, 0..nz],
                any::<u64>(),
            )
        })
        .prop_map(|(shape_zyx, values, first_ijk, seed)| {
            let shape = [shape_zyx[2], shape_zyx[1], shape_zyx[0]];
            let shape_ijk = std::array::from_fn(|a| {
                1 + (seed >> (16 * a)) as usize % (shape[a] - first_ijk[a])
            });
            Case {
                shape_zyx,
                values,
                part: VoxelBox {
                    first_ijk,
                    shape_ijk,
                },
            }
        })
}

proptest! {
    #[test]
    fn the_table_equals_the_printed_formulas(case in case()) {
        let grid = grid(case.shape_zyx);
        let view = VolumeView::new(&case.values, &grid).unwrap();
        let greatest = (0..grid.num_voxels())
            .map(|n| gradient(view, grid.voxel(n)))
            .fold(0.0, f64::max);
        let found = greatest_gradient(view, &Unwatched).unwrap();
        // The tolerance is needed because the table adds the three squares in another order.
        prop_assert!((found - greatest).abs() <= 1e-12 * greatest);
        let graph = BoxGraph::new(&grid, case.part).unwrap();
        for reading in [Reading::Printed, Reading::Walls] {
        let formula = if reading == Reading::Walls { wall_weight } else { weight };
        let cost = PaperCost::build(view, &graph, reading, found, &Unwatched).unwrap();
        for node in 0..graph.num_nodes() as u32 {
            let u = graph.voxel_of_node(node);
            let mut worst: f64 = 0.0;
            let mut range = true;
            graph.for_each_edge(node, |other, _| {
                let v = graph.voxel_of_node(other);
                let share = [u, v].map(|at| if found > 0.0 { gradient(view, at) / found } else { 0.0 });
                let printed = formula(share, [u, v].map(|at| laplacian(view, at)));
                let table = cost.weight(node, other);
                worst = worst.max((table - printed).abs());
                range &= (MIN_WEIGHT..=1.0).contains(&table) && table == cost.weight(other, node);
            });
            // The tolerance is needed because the table is in f32.
            prop_assert!(worst < 1e-6, "{worst}");
            prop_assert!(range);
        }
        }
    }

    #[test]
    fn resumed_costs_equal_dijkstra(
        case in case(),
        targets in prop::collection::vec(any::<u32>(), 1..6),
        walls in any::<bool>(),
    ) {
        let grid = grid(case.shape_zyx);
        let view = VolumeView::new(&case.values, &grid).unwrap();
        let graph = BoxGraph::new(&grid, case.part).unwrap();
        let reading = if walls { Reading::Walls } else { Reading::Printed };
        let greatest = reading.scale(view, &Unwatched).unwrap();
        let cost = PaperCost::build(view, &graph, reading, greatest, &Unwatched).unwrap();
        let mut tracker = Tracker::new(&graph, &cost, 0).unwrap();
        let truth = least_costs(&graph, &cost, tracker.quantum(), 0);
        for target in targets {
            let target = target % graph.num_nodes() as u32;
            prop_assert!(tracker.solve_to(&graph, &cost, target, &Unwatched).unwrap());
            prop_assert_eq!(tracker.cost_quanta(target), truth[target as usize]);
            let path = tracker.path_to(target).unwrap();
            let printed: f64 = path
                .windows(2)
                .map(|e| {
                    let mut length = 0.0;
                    graph.for_each_edge(e[0], |v, mm| if v == e[1] { length = mm });
                    length * cost.weight(e[0], e[1])
                })
                .sum();
            prop_assert!((tracker.cost(target).unwrap() - printed).abs() <= 0.005 * printed + 1e-12);
        }
    }
}

#[test]
fn a_step_edge_gives_the_printed_numbers() {
    // Columns of -1000 and 0 HU along i, 0.7 mm apart, far from every other edge.
    let grid = grid([5, 5, 8]);
    let values: Vec<i16> = (0..grid.num_voxels())
        .map(|n| if grid.voxel(n)[0] < 4 { -1000 } else { 0 })
        .collect();
    let view = VolumeView::new(&values, &grid).unwrap();
    // Central differences see the step from both sides of it, but not from one voxel farther away.
    for (i, expected) in [(2, 0.0), (3, 1000.0 / 1.4), (4, 1000.0 / 1.4), (5, 0.0)] {
        assert!((gradient(view, [i, 2, 2]) - expected).abs() < 1e-9);
    }
    // Nine of the 27 voxels are across the step: (27 * -1000 + 18 * 1000) / 26 before the step, the negative behind it.
    for (i, expected) in [(2, 0), (3, -9000), (4, 9000), (5, 0)] {
        assert_eq!(laplacian(view, [i, 2, 2]), expected);
    }
    // At the volume's face the edge is repeated, so there is no gradient across it.
    assert_eq!(gradient(view, [0, 0, 0]), 0.0);
    assert_eq!(laplacian(view, [0, 0, 0]), 0);

    let graph = BoxGraph::new(&grid, whole(&grid)).unwrap();
    let greatest = greatest_gradient(view, &Unwatched).unwrap();
    assert!((greatest - 1000.0 / 1.4).abs() < 1e-9);
    let cost = PaperCost::build(view, &graph, Reading::Printed, greatest, &Unwatched).unwrap();
    let node = |i| graph.node_of_voxel([i, 2, 2]).unwrap();
    // Across the step: largest gradient at both ends and a zero crossing, so the printed weight is 0.
    assert!((cost.weight(node(3), node(4)) - MIN_WEIGHT).abs() < 1e-9);
    // Into the step: half the gradient, and a Laplacian of 0 counts as a zero crossing.
    assert!((cost.weight(node(2), node(3)) - 0.35).abs() < 1e-6);
    // In uniform air: no gradient; 0 times 0 is a zero crossing as printed.
    assert!((cost.weight(node(1), node(2)) - 0.7).abs() < 1e-9);
    // Along the step, on one side of it: full gradient, equal sign.
    let beside = graph.node_of_voxel([3, 3, 2]).unwrap();
    assert!((cost.weight(node(3), beside) - 0.3).abs() < 1e-6);
}

#[test]
fn in_the_walls_cost_a_step_edge_is_expensive_and_uniform_values_are_cheap() {
    let grid = grid([5, 5, 8]);
    let values: Vec<i16> = (0..grid.num_voxels())
        .map(|n| if grid.voxel(n)[0] < 4 { -1000 } else { 0 })
        .collect();
    let view = VolumeView::new(&values, &grid).unwrap();
    let graph = BoxGraph::new(&grid, whole(&grid)).unwrap();
    let scale = Reading::Walls.scale(view, &Unwatched).unwrap();
    // There is no metal here, so the step itself is the largest gradient.
    assert!((scale - 1000.0 / 1.4).abs() < 0.1);
    let cost = PaperCost::build(view, &graph, Reading::Walls, scale, &Unwatched).unwrap();
    let node = |i| graph.node_of_voxel([i, 2, 2]).unwrap();
    assert!((cost.weight(node(3), node(4)) - 1.0).abs() < 1e-4);
    assert!((cost.weight(node(2), node(3)) - 0.35).abs() < 1e-4);
    assert!((cost.weight(node(1), node(2)) - MIN_WEIGHT).abs() < 1e-9);
    let beside = graph.node_of_voxel([3, 3, 2]).unwrap();
    assert!((cost.weight(node(3), beside) - 0.7).abs() < 1e-4);
}

#[test]
fn metal_does_not_make_walls_cheap_in_the_walls_cost() {
    let grid = grid([20, 20, 20]);
    let mut values: Vec<i16> = (0..grid.num_voxels())
        .map(|n| if grid.voxel(n)[0] < 10 { -1000 } else { 0 })
        .collect();
    let view = VolumeView::new(&values, &grid).unwrap();
    let without = Reading::Walls.scale(view, &Unwatched).unwrap();
    // One voxel of metal touches six others.
    values[grid.index([15, 10, 10])] = 30_000;
    let view = VolumeView::new(&values, &grid).unwrap();
    let printed = Reading::Printed.scale(view, &Unwatched).unwrap();
    assert!(printed > 20.0 * without);
    assert!((Reading::Walls.scale(view, &Unwatched).unwrap() - without).abs() < 2.0);
}

#[test]
fn a_volume_with_one_value_has_the_weight_of_a_zero_gradient() {
    let grid = grid([3, 3, 4]);
    let values = vec![17; grid.num_voxels()];
    let view = VolumeView::new(&values, &grid).unwrap();
    let graph = BoxGraph::new(&grid, whole(&grid)).unwrap();
    let cost = PaperCost::build(view, &graph, Reading::Printed, 0.0, &Unwatched).unwrap();
    assert!((cost.weight(0, 1) - 0.7).abs() < 1e-12);
}

#[test]
fn a_box_outside_the_volume_is_rejected() {
    let grid = grid([3, 3, 4]);
    for (first_ijk, shape_ijk) in [
        ([0, 0, 0], [5, 3, 3]),
        ([4, 0, 0], [1, 1, 1]),
        ([0, 0, 0], [0, 3, 3]),
        ([usize::MAX, 0, 0], [2, 1, 1]),
    ] {
        let part = VoxelBox {
            first_ijk,
            shape_ijk,
        };
        assert_eq!(
            BoxGraph::new(&grid, part).unwrap_err().code(),
            "usage.track"
        );
    }
}
