//! Tests of the pruned graph: the numbers of Figure 12, connectivity, costs.

use carina_grid::{Affine, Grid, VolumeView};
use carina_isoregion::value_labels;
use proptest::prelude::*;

use crate::Unwatched;
use crate::box_graph::{BoxGraph, VoxelGraph};
use crate::dijkstra::least_costs;
use crate::distance::VoxelBox;
use crate::graph::{Cost, Graph};
use crate::isoregion_graph::{IsoRegionGraph, PrunedCost, count_edges, is_cut_away, radii};
use crate::lumen::{LumenCost, LumenGraph};
use crate::paper_cost::{PaperCost, Reading, greatest_gradient};
use crate::tracker::Tracker;

/// `IsoRegion` map of the paper's Figure 12(a).
const FIGURE_12A: [&str; 7] = [
    "0000000000",
    "0111110000",
    "0122211000",
    "0111121110",
    "0000112210",
    "0000011110",
    "0000000000",
];
/// Remaining voxels after pruning in the paper's Figure 12(b).
const FIGURE_12B: [&str; 7] = [
    "0000000000",
    "0     0000",
    "0 222  000",
    "0    2   0",
    "0000  22 0",
    "00000    0",
    "0000000000",
];

fn grid(shape_zyx: [usize; 3]) -> Grid {
    let (s, c) = 0.3f64.sin_cos();
    let axes = [
        [0.7 * c, 0.7 * s, 0.0],
        [-0.9 * s, 0.9 * c, 0.0],
        [0.0, 0.0, 1.5],
    ];
    Grid::new(
        shape_zyx,
        Affine::from_columns(axes[0], axes[1], axes[2], [3.0, -5.0, 8.0]),
    )
    .unwrap()
}

fn whole(grid: &Grid) -> BoxGraph {
    let voxel_box = VoxelBox {
        first_ijk: [0; 3],
        shape_ijk: grid.shape_ijk(),
    };
    BoxGraph::new(grid, voxel_box).unwrap()
}

fn figure_12() -> IsoRegionGraph<BoxGraph> {
    let radius: Vec<u8> = FIGURE_12A
        .iter()
        .flat_map(|row| row.bytes().map(|b| b - b'0'))
        .collect();
    let grid = grid([1, 7, 10]);
    IsoRegionGraph::build(whole(&grid), &grid, &radius, &Unwatched).unwrap()
}

#[test]
fn pruning_gives_figure_12b() {
    let radius: Vec<u8> = FIGURE_12A
        .iter()
        .flat_map(|row| row.bytes().map(|b| b - b'0'))
        .collect();
    for (j, row) in FIGURE_12B.iter().enumerate() {
        for (i, printed) in row.bytes().enumerate() {
            let cut = is_cut_away(&radius, [10, 7, 1], [i, j, 0]);
            assert_eq!(cut, printed == b' ', "row {j}, column {i}");
        }
    }
}

#[test]
fn links_connect_the_pruned_graph_of_figure_12() {
    let graph = figure_12();
    assert_eq!(graph.num_centres(), 6);
    assert_eq!(components(&graph, 0..graph.num_nodes() as u32), 1);
    for node in 0..graph.num_nodes() as u32 {
        let mut links = Vec::new();
        graph.for_each_edge(node, |other, _| {
            let (a, b) = (graph.voxel(node), graph.voxel(other));
            let distance = (0..3).map(|n| a[n].abs_diff(b[n])).max().unwrap();
            if distance > 1 {
                links.push((other, distance));
            }
        });
        // Every link goes from a centre to the boundary of a cube of radius 2.
        assert!(links.iter().all(|(_, distance)| *distance == 2));
        if graph.radius(node) == 0 {
            assert!(links.len() <= 1);
        }
    }
    // The pruned voxel at row 1, column 1 is represented by the centre at row 2, column 2.
    let stands_for = graph.node_for_voxel([1, 1, 0]).unwrap();
    assert_eq!(graph.voxel(stands_for), [2, 2, 0]);
}

/// Return the number of connected components that contain the given nodes.
fn components(graph: &impl Graph, nodes: impl Iterator<Item = u32>) -> usize {
    let label = component_of(graph);
    let mut found: Vec<u32> = nodes.map(|n| label[n as usize]).collect();
    found.sort_unstable();
    found.dedup();
    found.len()
}

/// Return for each node the first node of its connected component.
fn component_of(graph: &impl Graph) -> Vec<u32> {
    let mut label = vec![u32::MAX; graph.num_nodes()];
    for start in 0..graph.num_nodes() as u32 {
        let mut open = vec![start];
        while let Some(node) = open.pop() {
            if label[node as usize] == u32::MAX {
                label[node as usize] = start;
                graph.for_each_edge(node, |v, _| open.push(v));
            }
        }
    }
    label
}

/// Return a strategy for labels of large regions with scattered islands.
fn labels() -> impl Strategy<Value = ([usize; 3], Vec<u8>)> {
    let island = (any::<[u8; 3]>(), 1usize..5, 0u8..4);
    (
        (1usize..14, 3usize..18, 3usize..18),
        prop::collection::vec(island, 0..12),
    )
        .prop_map(|((nz, ny, nx), islands)| {
            let mut labels = vec![1u8; nz * ny * nx];
            for (at, side, label) in islands {
                let first = [nx, ny, nz].map(|n| n - 1);
                let first: [usize; 3] =
                    std::array::from_fn(|a| usize::from(at[a]) % (first[a] + 1));
                for k in first[2]..(first[2] + side).min(nz) {
                    for j in first[1]..(first[1] + side).min(ny) {
                        for i in first[0]..(first[0] + side).min(nx) {
                            labels[(k * ny + j) * nx + i] = label;
                        }
                    }
                }
            }
            ([nz, ny, nx], labels)
        })
}

fn pruned(grid: &Grid, labels: &[u8]) -> IsoRegionGraph<BoxGraph> {
    let base = whole(grid);
    let radius = radii(labels, base.voxel_box(), &Unwatched).unwrap();
    IsoRegionGraph::build(base, grid, &radius, &Unwatched).unwrap()
}

/// Return the centre of the largest cube with a border voxel on its boundary, the nearest of equal ones, by trying all.
fn centre_by_trial(graph: &IsoRegionGraph<BoxGraph>, node: u32) -> Option<u32> {
    let at = |n: u32| graph.voxel(n).map(|v| v as isize);
    let offset = |n: u32| -> [isize; 3] { std::array::from_fn(|a| at(n)[a] - at(node)[a]) };
    let length_mm = |n: u32| {
        let axes = grid([20; 3]);
        carina_grid::length(axes.lps_from_ijk().vector(offset(n).map(|v| v as f64)))
    };
    (0..graph.num_nodes() as u32)
        .filter(|&n| {
            let radius = isize::from(graph.radius(n));
            radius > 1 && offset(n).iter().map(|v| v.abs()).max() == Some(radius)
        })
        .min_by(|&a, &b| {
            let radii = graph.radius(b).cmp(&graph.radius(a));
            radii
                .then(length_mm(a).total_cmp(&length_mm(b)))
                .then(a.cmp(&b))
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn border_voxels_are_linked_once_to_the_nearest_centre_of_the_largest_cube((shape, labels) in labels()) {
        let grid = grid(shape);
        let graph = pruned(&grid, &labels);
        let mut num_others = 0;
        for node in 0..graph.num_nodes() as u32 {
            let mut links = Vec::new();
            graph.for_each_edge(node, |other, _| {
                let (a, b) = (graph.voxel(node), graph.voxel(other));
                if (0..3).any(|n| a[n].abs_diff(b[n]) > 1) {
                    links.push(other);
                }
            });
            if graph.radius(node) == 0 {
                let wanted = centre_by_trial(&graph, node);
                prop_assert_eq!(links.first().copied(), wanted);
                num_others += links.len() - usize::from(wanted.is_some());
            }
        }
        prop_assert_eq!(num_others, graph.additional_links().len() / 2);
    }

    #[test]
    fn the_pruned_graph_has_the_components_of_the_whole_graph((shape, labels) in labels()) {
        let grid = grid(shape);
        let graph = pruned(&grid, &labels);
        prop_assert_eq!(components(&graph, 0..graph.num_nodes() as u32), 1);
        // Every voxel must have a node that represents it.
        for n in 0..grid.num_voxels() {
            let voxel = grid.voxel(n).map(|v| v as isize);
            let node = graph.node_for_voxel(voxel).unwrap();
            let centre = graph.voxel(node).map(|v| v as isize);
            let distance = (0..3).map(|a| (voxel[a] - centre[a]).abs()).max().unwrap();
            prop_assert!(distance <= isize::from(graph.radius(node)));
        }
    }

    #[test]
    fn edges_are_symmetric_and_unique_and_links_stay_in_one_label((shape, labels) in labels()) {
        let grid = grid(shape);
        let graph = pruned(&grid, &labels);
        let mut edges = Vec::new();
        for node in 0..graph.num_nodes() as u32 {
            graph.for_each_edge(node, |other, mm| edges.push((node, other, mm.to_bits())));
        }
        edges.sort_unstable();
        let before = edges.len();
        edges.dedup();
        prop_assert_eq!(edges.len(), before);
        prop_assert_eq!(count_edges(&graph), before as u64 / 2);
        prop_assert_eq!(graph.num_edges(), before as u64 / 2);
        let (shortest, longest) = graph.edge_length_range_mm();
        for &(u, v, mm) in &edges {
            prop_assert!(edges.binary_search(&(v, u, mm)).is_ok());
            let mm = f64::from_bits(mm);
            prop_assert!(shortest - 1e-9 <= mm && mm <= longest + 1e-9);
            let (a, b) = (graph.voxel(u), graph.voxel(v));
            let distance = (0..3).map(|n| a[n].abs_diff(b[n])).max().unwrap();
            let radius = [u, v].map(|n| usize::from(graph.radius(n)));
            prop_assert!(distance == 1 || radius.contains(&distance));
            prop_assert!(distance == 1 || labels[grid.index(a)] == labels[grid.index(b)]);
        }
    }

    #[test]
    fn the_pruned_lumen_graph_has_the_components_of_the_lumen((shape, labels) in labels()) {
        let grid = grid(shape);
        let lumen: Vec<u8> = labels.iter().map(|l| u8::from(*l == 1)).collect();
        prop_assume!(lumen.contains(&1));
        let values: Vec<i16> = lumen.iter().map(|l| if *l == 1 { -1000 } else { 0 }).collect();
        let view = VolumeView::new(&values, &grid).unwrap();
        let whole = LumenGraph::build(view, &lumen, None).unwrap();
        let graph = pruned_lumen(&grid, &lumen, view);
        let (whole_labels, pruned_labels) = (component_of(&whole), component_of(&graph));
        let mut pairs: Vec<(u32, u32)> = (0..graph.num_nodes() as u32)
            .map(|n| (whole_labels[graph.whole(n) as usize], pruned_labels[n as usize]))
            .collect();
        pairs.sort_unstable();
        pairs.dedup();
        // The pruned graph must have one component for each component of the unpruned graph.
        let mut whole_labels = whole_labels;
        whole_labels.sort_unstable();
        whole_labels.dedup();
        prop_assert_eq!(pairs.len(), whole_labels.len());

        // No path over links may be cheaper than the path of voxels that it replaces.
        let cost = PrunedCost::new(&graph, LumenCost(graph.base()));
        let mut pruned_tracker = Tracker::new(&graph, &cost, 0).unwrap();
        pruned_tracker.solve_all(&graph, &cost, &Unwatched).unwrap();
        let whole_cost = LumenCost(&whole);
        let mut tracker = Tracker::new(&whole, &whole_cost, graph.whole(0)).unwrap();
        tracker.solve_all(&whole, &whole_cost, &Unwatched).unwrap();
        for node in 0..graph.num_nodes() as u32 {
            if let Some(found) = pruned_tracker.cost(node) {
                let least = tracker.cost(graph.whole(node)).unwrap();
                // The tolerance is 0.5 % for the quantum of each of the two graphs.
                prop_assert!(found >= 0.99 * least, "{found} {least}");
            }
        }
        let (cheapest, dearest) = edge_costs(&graph, &cost);
        let (lengths, weights) = (graph.edge_length_range_mm(), cost.weight_range());
        prop_assert!(cheapest >= lengths.0 * weights.0 * 0.999);
        prop_assert!(dearest <= lengths.1 * weights.1 * 1.001);
    }

    #[test]
    fn resumed_costs_on_the_pruned_graph_equal_dijkstra(
        (shape, labels) in labels(),
        noise in any::<u64>(),
        targets in prop::collection::vec(any::<u32>(), 1..6),
    ) {
        let grid = grid(shape);
        let values: Vec<i16> = labels
            .iter()
            .enumerate()
            .map(|(n, l)| i16::from(*l) * 300 - 1000 + (noise.rotate_left(n as u32) % 5) as i16)
            .collect();
        let view = VolumeView::new(&values, &grid).unwrap();
        let binned = value_labels(&values, |_, _| false).labels;
        let graph = pruned(&grid, &binned);
        let greatest = greatest_gradient(view, &Unwatched).unwrap();
        let table = PaperCost::build(view, graph.base(), Reading::Printed, greatest, &Unwatched).unwrap();
        let cost = PrunedCost::new(&graph, &table);
        let root = targets[0] % graph.num_nodes() as u32;
        let mut tracker = Tracker::new(&graph, &cost, root).unwrap();
        let truth = least_costs(&graph, &cost, tracker.quantum(), root);
        for target in targets {
            let target = target % graph.num_nodes() as u32;
            prop_assert!(tracker.solve_to(&graph, &cost, target, &Unwatched).unwrap());
            prop_assert_eq!(tracker.cost_quanta(target), truth[target as usize]);
        }
    }
}

fn pruned_lumen(
    grid: &Grid,
    lumen: &[u8],
    view: VolumeView<'_, i16>,
) -> IsoRegionGraph<LumenGraph> {
    let base = LumenGraph::build(view, lumen, None).unwrap();
    let voxel_box = base.voxel_box();
    let labels: Vec<u8> = (0..voxel_box.num_voxels())
        .map(|at| lumen[grid.index(voxel_box.voxel(at))])
        .collect();
    let radius = radii(&labels, voxel_box, &Unwatched).unwrap();
    IsoRegionGraph::build(base, grid, &radius, &Unwatched).unwrap()
}

fn edge_costs(graph: &impl Graph, cost: &impl Cost) -> (f64, f64) {
    let mut range = (f64::INFINITY, 0.0f64);
    for node in 0..graph.num_nodes() as u32 {
        graph.for_each_edge(node, |other, mm| {
            let edge = mm * cost.weight(node, other);
            range = (range.0.min(edge), range.1.max(edge));
        });
    }
    range
}

#[test]
fn pruning_a_large_cube_leaves_its_faces_and_its_centre() {
    let grid = grid([21, 21, 21]);
    let graph = pruned(&grid, &vec![1u8; grid.num_voxels()]);
    // The remaining nodes are the faces, and the one voxel in the middle that is farthest from all of them.
    assert_eq!(graph.num_centres(), 1);
    assert_eq!(graph.num_nodes(), 21usize.pow(3) - 19usize.pow(3) + 1);
    let middle = graph.node_for_voxel([10, 10, 10]).unwrap();
    let mut num_links = 0;
    graph.for_each_edge(middle, |_, _| num_links += 1);
    assert_eq!(num_links, 21usize.pow(3) - 19usize.pow(3));
}
