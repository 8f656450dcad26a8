//! Tests that a lumen edited step by step has, bit for bit, the graph and the least-cost tree of the same lumen built
//! from scratch.

use carina_grid::{Affine, Grid, VolumeView};
use proptest::prelude::*;

use crate::Unwatched;
use crate::cheapest_way::cheapest_way;
use crate::graph::Graph;
use crate::lumen::{LumenCost, LumenGraph, WallLevels};
use crate::lumen_edit::{
    as_bytes, costs_after_edit, costs_from_scratch, edit_graph, newly_reached,
};
use crate::tracker::Tracker;

/// Number of voxels of the test volume along i, j, k.
const SHAPE_IJK: [usize; 3] = [14, 12, 16];

fn grid() -> Grid {
    let [nx, ny, nz] = SHAPE_IJK;
    let (x, y, z) = ([0.7, 0.1, 0.0], [-0.1, 0.8, 0.0], [0.0, 0.0, 1.3]);
    Grid::new(
        [nz, ny, nx],
        Affine::from_columns(x, y, z, [3.0, 5.0, -8.0]),
    )
    .unwrap()
}

/// Return a strategy for edits: balls of voxels that are painted or erased.
fn strokes() -> impl Strategy<Value = Vec<([i32; 3], i32, bool)>> {
    let at = (0..14i32, 0..12i32, 0..16i32).prop_map(|(i, j, k)| [i, j, k]);
    prop::collection::vec((at, 0..9i32, any::<bool>()), 1..6)
}

fn ball(centre: [i32; 3], squared: i32) -> Vec<[u16; 3]> {
    let grid = grid();
    (0..grid.num_voxels())
        .map(|at| grid.voxel(at))
        .filter(|v| {
            (0..3)
                .map(|a| (v[a] as i32 - centre[a]).pow(2))
                .sum::<i32>()
                <= squared
        })
        .map(|v| v.map(|x| x as u16))
        .collect()
}

fn same(a: &Tracker, b: &Tracker, num_nodes: usize) -> Result<(), TestCaseError> {
    prop_assert_eq!(a.settled(), b.settled());
    for node in 0..num_nodes as u32 {
        prop_assert_eq!(a.cost_quanta(node), b.cost_quanta(node));
        prop_assert_eq!(a.predecessor(node), b.predecessor(node));
    }
    Ok(())
}

proptest! {
    #[test]
    fn a_lumen_edited_step_by_step_equals_one_built_from_scratch(
        noise in prop::collection::vec(-1000i16..200, 14 * 12 * 16),
        strokes in strokes(),
        with_levels in any::<bool>(),
    ) {
        let grid = grid();
        let view = VolumeView::new(&noise, &grid).unwrap();
        let levels = with_levels.then_some(WallLevels { core: -900.0, wall: -400.0, rise: 100.0 });
        // The lumen is a tube down the middle, so that parts far from an edit stay unchanged.
        let tube = |at: usize| {
            let v = grid.voxel(at);
            u8::from((5..9).contains(&v[0]) && (4..8).contains(&v[1]))
        };
        let mut lumen: Vec<u8> = (0..grid.num_voxels()).map(tube).collect();
        let root = [6, 6, 15];
        let mut graph = LumenGraph::build(view, &lumen, levels).unwrap();
        let root_node = graph.node_at_voxel(root).unwrap();
        // The first tree is as after the automatic search, where the queue decides between equal costs.
        let cost = LumenCost(&graph);
        let mut tracker = Tracker::new(&graph, &cost, root_node).unwrap();
        tracker.solve_all(&graph, &cost, &Unwatched).unwrap();
        for (centre, squared, erase) in strokes {
            let voxels: Vec<[u16; 3]> = ball(centre, squared)
                .into_iter()
                .filter(|v| !erase || v.map(|x| x as isize) != root)
                .collect();
            let (added, removed) = if erase { (vec![], voxels) } else { (voxels, vec![]) };
            for (voxels, value) in [(&added, 1u8), (&removed, 0u8)] {
                for v in voxels {
                    lumen[grid.index(v.map(usize::from))] = value;
                }
            }
            let step = edit_graph(&graph, view, levels, &added, &removed).unwrap();
            let next = costs_after_edit(&graph, &tracker, &step, &Unwatched).unwrap();
            let whole = LumenGraph::build(view, &lumen, levels).unwrap();
            prop_assert_eq!(&step.graph.voxels, &whole.voxels);
            prop_assert_eq!(&step.graph.edges, &whole.edges);
            prop_assert_eq!(&step.graph.wall_mm, &whole.wall_mm);
            prop_assert_eq!(&as_bytes(&step.graph, &grid), &lumen);
            let fresh = costs_from_scratch(&whole, whole.node_at_voxel(root).unwrap(), &Unwatched).unwrap();
            same(&next, &fresh, whole.num_nodes())?;
            // No voxel outside the returned box may have another distance to the wall.
            for node in 0..graph.num_nodes() as u32 {
                let voxel = graph.voxel(node).map(|v| v as isize);
                let is_in_changed_box = step.changed_box.is_some_and(|b| b.index_of(voxel).is_some());
                if let Some(there) = whole.node_at_voxel(voxel) && !is_in_changed_box {
                    prop_assert_eq!(graph.wall_mm(node).to_bits(), whole.wall_mm(there).to_bits());
                }
            }
            let is_reached = |t: &Tracker, n: usize| (0..n as u32).map(|n| t.cost_quanta(n).is_some()).collect::<Vec<_>>();
            let (new, old) = (is_reached(&next, whole.num_nodes()), is_reached(&tracker, graph.num_nodes()));
            for voxel in newly_reached((&whole, &new), (&graph, &old)) {
                let at = voxel.map(|v| v as isize);
                prop_assert!(next.cost_quanta(whole.node_at_voxel(at).unwrap()).is_some());
                prop_assert!(graph.node_at_voxel(at).is_none_or(|n| tracker.cost_quanta(n).is_none()));
            }
            (graph, tracker) = (step.graph, next);
        }
    }

    #[test]
    fn the_least_cost_path_in_a_box_costs_as_much_as_in_an_exhaustive_search(
        weights in prop::collection::vec(prop_oneof![Just(0.0f32), 0.5f32..9.0], 5 * 4 * 5),
        goal in 0..100usize,
        start in 0..100usize,
    ) {
        let (shape, spacing) = ([5, 4, 5], [0.7, 0.8, 2.0]);
        let mut goals = vec![0u8; 100];
        goals[goal] = 1;
        let voxel = |at: usize| [at % 5, at / 5 % 4, at / 20];
        let found = cheapest_way(shape, spacing, &weights, &goals, voxel(start), &Unwatched).unwrap();
        // Bellman and Ford: all steps are relaxed until no cost changes.
        let step = |a: usize, b: usize| {
            let (p, q) = (voxel(a), voxel(b));
            let off: [f64; 3] = std::array::from_fn(|n| p[n] as f64 - q[n] as f64);
            off.iter().all(|d| d.abs() <= 1.0).then(|| {
                let mm = carina_grid::length(std::array::from_fn(|n| off[n] * spacing[n]));
                mm * 0.5 * (f64::from(weights[a]) + f64::from(weights[b]))
            })
        };
        let mut least = vec![f64::INFINITY; 100];
        least[start] = 0.0;
        let mut is_changing = true;
        while is_changing {
            is_changing = false;
            for a in 0..100 {
                for b in (0..100).filter(|b| *b != a && weights[*b] > 0.0) {
                    if let Some(mm) = step(a, b) && least[a] + mm < least[b] {
                        (least[b], is_changing) = (least[a] + mm, true);
                    }
                }
            }
        }
        match found {
            None => prop_assert!(least[goal].is_infinite()),
            Some(way) => {
                // The tolerance of 1e-9 allows for two sums that add their terms in different orders.
                prop_assert!((way.cost - least[goal]).abs() < 1e-9);
                prop_assert_eq!(way.voxels[0], voxel(goal));
                prop_assert_eq!(way.voxels[way.voxels.len() - 1], voxel(start));
            }
        }
    }
}
