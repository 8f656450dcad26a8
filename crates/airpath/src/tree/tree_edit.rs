//! Queries of the lumen's graph for edits of the tree: the voxels that a cut removes, and the tips of a new piece of
//! lumen.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use carina_grid::{Grid, length};

use crate::tree::branches::{BranchLimits, Cover, WIDEST_TUBE_MM, ordered};
use carina_leastcost::graph::Graph;
use carina_leastcost::lumen::LumenGraph;
use carina_leastcost::tracker::Tracker;
use carina_leastcost::{TrackError, Watch};

/// Maximum distance in mm, from the centreline of a branch that is cut off, at which lumen is removed.
const CUT_REACH_MM: f64 = 25.0;

/// Return the nodes that belong to the tubes of the branches to cut and not to those that remain.
///
/// `cut` and `kept` are the nodes on the centrelines of these branches. Distances are measured inside the lumen from
/// the tubes' surfaces, as in [`crate::tree::branches::branch_of_nodes`]. A node at equal distance from both is not
/// returned. Only the box round `cut` is searched.
#[must_use]
pub fn cut_nodes(graph: &LumenGraph, grid: &Grid, cut: &[u32], kept: &[u32]) -> Vec<u32> {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for node in cut {
        let voxel = graph.voxel(*node);
        for axis in 0..3 {
            let reach = CUT_REACH_MM / grid.spacing_mm()[axis];
            low[axis] = low[axis].min(voxel[axis] as f64 - reach);
            high[axis] = high[axis].max(voxel[axis] as f64 + reach);
        }
    }
    let is_near = |node: u32| {
        let voxel = graph.voxel(node);
        (0..3).all(|a| (low[a]..=high[a]).contains(&(voxel[a] as f64)))
    };
    let mut off = vec![u32::MAX; graph.num_nodes()];
    let mut is_cut = vec![false; graph.num_nodes()];
    let mut is_middle = vec![false; graph.num_nodes()];
    let mut open = BinaryHeap::new();
    // The branches that remain come first, so a node on both centrelines, or at equal distance from both, is not cut.
    for (nodes, of_cut) in [(kept, false), (cut, true)] {
        for &node in nodes {
            if off[node as usize] == u32::MAX && is_near(node) {
                off[node as usize] = ordered((WIDEST_TUBE_MM - graph.wall_mm(node)).max(0.0));
                is_cut[node as usize] = of_cut;
                is_middle[node as usize] = true;
                open.push(Reverse((off[node as usize], of_cut, node)));
            }
        }
    }
    while let Some(Reverse((here, of_cut, node))) = open.pop() {
        if here != off[node as usize] || of_cut != is_cut[node as usize] {
            continue;
        }
        graph.for_each_edge(node, |next, length_mm| {
            let there = here + ordered(length_mm);
            let n = next as usize;
            let is_nearer = there < off[n] || (there == off[n] && is_cut[n] && !of_cut);
            if is_nearer && !is_middle[n] && is_near(next) {
                off[n] = there;
                is_cut[n] = of_cut;
                open.push(Reverse((there, of_cut, next)));
            }
        });
    }
    (0..graph.num_nodes() as u32)
        .filter(|n| is_cut[*n as usize])
        .collect()
}

/// Return the tips of branches in the nodes `candidates` that an existing tree does not cover, longest path first.
///
/// The existing tree has `tree_nodes` on its centrelines. The tips are found as for the automatic tree (see
/// [`crate::tree::branches::find_branches`]), except that the existing tree already covers its surroundings.
///
/// # Errors
///
/// Returns an error if `watch` stops the search.
pub fn more_tips(
    graph: &LumenGraph,
    tracker: &Tracker,
    grid: &Grid,
    tree_nodes: &[u32],
    candidates: &[u32],
    watch: &impl Watch,
) -> Result<Vec<u32>, TrackError> {
    let limits = BranchLimits::for_grid(grid);
    let step_mm = |a: u32, b: u32| {
        let (p, q) = (graph.voxel(a), graph.voxel(b));
        length(
            grid.lps_from_ijk()
                .vector(std::array::from_fn(|n| p[n] as f64 - q[n] as f64)),
        )
    };
    let mut along_mm = vec![0.0; graph.num_nodes()];
    for &node in tracker.settled() {
        if let Some(before) = tracker.predecessor(node) {
            along_mm[node as usize] = along_mm[before as usize] + step_mm(node, before);
        }
    }
    let mut open: Vec<u32> = candidates
        .iter()
        .copied()
        .filter(|n| tracker.cost_quanta(*n).is_some())
        .collect();
    open.sort_unstable_by(|a, b| {
        along_mm[*b as usize]
            .total_cmp(&along_mm[*a as usize])
            .then(a.cmp(b))
    });
    let mut cover = Cover::new(graph, &limits);
    cover.add(tree_nodes);
    let mut tips = Vec::new();
    for (n, &tip) in open.iter().enumerate() {
        if n.is_multiple_of(1 << 12) {
            watch.report_fraction(n as f64 / open.len() as f64)?;
        }
        if cover.holds(tip) {
            continue;
        }
        let mut chain = vec![tip];
        let mut node = tip;
        while !cover.holds(node)
            && let Some(before) = tracker.predecessor(node)
        {
            chain.push(before);
            node = before;
        }
        // The length of a new piece is measured from the surface of the tube that it leaves, but the cover of that tube
        // reaches farther.
        let covered_mm = (limits.cover_radii - 1.0) * graph.wall_mm(node) + limits.cover_mm;
        let beyond_mm = along_mm[tip as usize] - along_mm[node as usize] + covered_mm;
        if beyond_mm >= limits.min_length_mm {
            tips.push(tip);
        }
        cover.add(&chain);
    }
    Ok(tips)
}
