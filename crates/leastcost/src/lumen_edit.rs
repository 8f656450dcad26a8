//! Update of the lumen's graph and of its tree of least-cost paths after the user has edited the lumen.
//!
//! Only the parts that depend on the edit are computed again.
//!
//! The results are exact by construction. An edge depends on its two voxels; a distance to the wall depends on the
//! nearest outside voxel and on the voxels within two steps of the outside voxel. If these voxels are unchanged, the
//! old edge or distance is also the new one. For the tree of least costs: a node whose old path includes no change
//! keeps that path as a candidate; all other nodes are computed again from their neighbours, and decreased costs are
//! propagated (Ramalingam and Reps 1996). Among equally cheap paths the one through the first voxel in array order is
//! taken, so that the tree does not depend on the sequence of edits.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use carina_grid::{Grid, VolumeView};
use rayon::prelude::*;

use crate::distance::VoxelBox;
use crate::graph::{Cost, Graph, NO_NODE, Quantum};
use crate::lumen::{LumenCost, LumenGraph, WallLevels};
use crate::tracker::{Tracker, UNREACHED};
use crate::voxel_set::VoxelSet;
use crate::{TrackError, Watch};

/// Graph of an edited lumen, and its relation to the graph before the edit.
#[derive(Debug)]
pub struct Edited {
    /// Graph after the edit; it equals one that is built from the edited lumen.
    pub graph: LumenGraph,
    /// For each node before the edit, its node after the edit; `NO_NODE` if its voxel was removed.
    pub new_of_old: Vec<u32>,
    /// Nodes of the graph after the edit whose paths must be computed again.
    ///
    /// These nodes are new, or their edges or distance to the wall changed.
    pub dirty: Vec<u32>,
    /// Box round the nodes whose distance to the wall changed and round the added and removed voxels; `None` without
    /// changes.
    pub changed_box: Option<VoxelBox>,
}

/// Build the graph of a lumen after `removed` voxels were removed and `added` voxels were added.
///
/// Added voxels that already exist and removed voxels that do not exist have no effect. `values` and `levels` must be
/// those of the graph.
///
/// # Errors
///
/// Returns an error if the edited lumen is empty.
pub fn edit_graph(
    graph: &LumenGraph,
    values: VolumeView<'_, i16>,
    levels: Option<WallLevels>,
    added: &[[u16; 3]],
    removed: &[[u16; 3]],
) -> Result<Edited, TrackError> {
    let grid = values.grid();
    let mut added: Vec<[u16; 3]> = added
        .iter()
        .copied()
        .filter(|v| !graph.lumen.holds(signed(*v)))
        .collect();
    added.sort_unstable_by_key(|v| [v[2], v[1], v[0]]);
    added.dedup();
    let mut gone = vec![false; graph.num_nodes()];
    for voxel in removed {
        if let Some(node) = graph.lumen.place(signed(*voxel)) {
            gone[node as usize] = true;
        }
    }
    let (voxels, new_of_old) = merged(graph, &added, &gone);
    if voxels.is_empty() {
        return Err(TrackError::NoResult("the airway lumen is empty".to_owned()));
    }
    let changed: Vec<[isize; 3]> = added
        .iter()
        .copied()
        .chain(
            (0..gone.len())
                .filter(|n| gone[*n])
                .map(|n| graph.voxels[n]),
        )
        .map(signed)
        .collect();

    let mut new = LumenGraph::unlinked(grid, voxels);
    let mut old_of_new = vec![NO_NODE; new.num_nodes()];
    for (old, node) in new_of_old.iter().enumerate() {
        if *node != NO_NODE {
            old_of_new[*node as usize] = old as u32;
        }
    }
    let (beside, round_sites) = (dilated(&changed, 1), dilated(&changed, 2));
    let found: Vec<(u32, f32, bool)> = (0..new.num_nodes() as u32)
        .into_par_iter()
        .map(|node| {
            let old = old_of_new[node as usize];
            let voxel = signed(new.voxels[node as usize]);
            if old == NO_NODE {
                let links = new.links(values, levels, node);
                return (links, new.wall_from_site(values, levels, node), true);
            }
            let (old_links, old_wall) = (graph.edges[old as usize], graph.wall_mm[old as usize]);
            let links = if beside.holds(voxel) {
                new.links(values, levels, node)
            } else {
                old_links
            };
            let site = new.sites[node as usize];
            let wall = if site == graph.sites[old as usize] && !round_sites.holds(signed(site)) {
                old_wall
            } else {
                new.wall_from_site(values, levels, node)
            };
            (links, wall, links != old_links || wall != old_wall)
        })
        .collect();
    new.edges = found.iter().map(|f| f.0).collect();
    new.wall_mm = found.iter().map(|f| f.1).collect();
    let dirty: Vec<u32> = (0..found.len())
        .filter(|n| found[*n].2)
        .map(|n| n as u32)
        .collect();
    let changed_box = box_of(
        changed
            .iter()
            .copied()
            .chain(dirty.iter().map(|n| signed(new.voxels[*n as usize]))),
    );
    Ok(Edited {
        graph: new,
        new_of_old,
        dirty,
        changed_box,
    })
}

fn signed(voxel: [u16; 3]) -> [isize; 3] {
    voxel.map(|v| v as isize)
}

/// Return the voxels of the edited lumen in array order, and for each old voxel its new index or `NO_NODE`.
fn merged(graph: &LumenGraph, added: &[[u16; 3]], gone: &[bool]) -> (Vec<[u16; 3]>, Vec<u32>) {
    let key = |v: [u16; 3]| [v[2], v[1], v[0]];
    let mut voxels = Vec::with_capacity(gone.len() + added.len());
    let mut new_of_old = vec![NO_NODE; gone.len()];
    let mut next = 0;
    for (old, voxel) in graph.voxels.iter().enumerate() {
        while next < added.len() && key(added[next]) < key(*voxel) {
            voxels.push(added[next]);
            next += 1;
        }
        if !gone[old] {
            new_of_old[old] = voxels.len() as u32;
            voxels.push(*voxel);
        }
    }
    voxels.extend(&added[next..]);
    (voxels, new_of_old)
}

/// Return the set of voxels within `reach` steps of the given voxels.
fn dilated(voxels: &[[isize; 3]], reach: isize) -> VoxelSet {
    let around = box_of(voxels.iter().copied()).unwrap_or(VoxelBox {
        first_ijk: [0; 3],
        shape_ijk: [0; 3],
    });
    // Voxels with coordinates below 0 are outside the volume and are not needed.
    let first_ijk = around.first_ijk.map(|f| f.saturating_sub(reach as usize));
    let shape_ijk = std::array::from_fn(|a| {
        (around.first_ijk[a] + around.shape_ijk[a] + reach as usize) - first_ijk[a]
    });
    let span = 2 * reach + 1;
    let members = voxels.iter().flat_map(|v| {
        (0..span * span * span).map(move |n| {
            [
                v[0] + n % span - reach,
                v[1] + n / span % span - reach,
                v[2] + n / span / span - reach,
            ]
        })
    });
    VoxelSet::new(
        VoxelBox {
            first_ijk,
            shape_ijk,
        },
        members,
    )
}

fn box_of(voxels: impl Iterator<Item = [isize; 3]>) -> Option<VoxelBox> {
    let mut ends: Option<([isize; 3], [isize; 3])> = None;
    for voxel in voxels {
        let (low, high) = ends.get_or_insert((voxel, voxel));
        for axis in 0..3 {
            low[axis] = low[axis].min(voxel[axis]);
            high[axis] = high[axis].max(voxel[axis]);
        }
    }
    ends.map(|(low, high)| VoxelBox {
        first_ijk: low.map(|v| v.max(0) as usize),
        shape_ijk: std::array::from_fn(|a| (high[a] - low[a].max(0) + 1) as usize),
    })
}

/// Cost `lumen` with a precomputed factor for each node.
///
/// The weights equal those of [`LumenCost`], but an edge needs no power function.
struct NodeCost(Vec<f64>, (f64, f64));

impl NodeCost {
    fn new(graph: &LumenGraph) -> Self {
        let cost = LumenCost(graph);
        let weights = (0..graph.num_nodes() as u32)
            .map(|node| cost.weight(node, node))
            .collect();
        Self(weights, cost.weight_range())
    }
}

impl Cost for NodeCost {
    #[inline]
    fn weight(&self, u: u32, v: u32) -> f64 {
        0.5 * (self.0[u as usize] + self.0[v as usize])
    }

    fn weight_range(&self) -> (f64, f64) {
        self.1
    }
}

/// Compute the least costs from a root to all nodes from scratch, with the first of equally cheap paths.
///
/// # Errors
///
/// Returns an error if the costs have too wide a range or `watch` stops the search.
pub fn costs_from_scratch(
    graph: &LumenGraph,
    root: u32,
    watch: &impl Watch,
) -> Result<Tracker, TrackError> {
    Tracker::solved_in_order(graph, &NodeCost::new(graph), root, watch)
}

/// Return a tracker with the least costs of `tracker` and the first of equally cheap paths.
fn with_first_of_equals(graph: &LumenGraph, tracker: &Tracker) -> Tracker {
    let cost = NodeCost::new(graph);
    let nodes: Vec<u32> = (0..graph.num_nodes() as u32).collect();
    let (root, quantum, costs) = (tracker.root(), tracker.quantum(), tracker.costs());
    let before = first_predecessors(graph, &cost, quantum, root, &costs, &nodes);
    let mut order = tracker.settled().to_vec();
    // The list is nearly sorted already, so this sort is fast.
    order.sort_by_key(|n| (costs[*n as usize], *n));
    Tracker::from_costs(root, quantum, costs, before, order, true)
}

/// Compute the least costs after an edit from those before the edit.
///
/// `tracker` must be that of `old_graph`. The result equals [`costs_from_scratch`] on the edited graph.
///
/// # Errors
///
/// Returns an error if the root was removed or `watch` stops the search.
pub fn costs_after_edit(
    old_graph: &LumenGraph,
    tracker: &Tracker,
    edited: &Edited,
    watch: &impl Watch,
) -> Result<Tracker, TrackError> {
    let graph = &edited.graph;
    let root = edited.new_of_old[tracker.root() as usize];
    if root == NO_NODE {
        return Err(TrackError::NoResult(
            "the root of the paths was taken out of the lumen".to_owned(),
        ));
    }
    let num_nodes = graph.num_nodes();
    // A tracker that was stopped early cannot be updated, and a large edit is faster from scratch.
    if !tracker.is_done() || 2 * edited.dirty.len() > num_nodes {
        return costs_from_scratch(graph, root, watch);
    }
    let (lost, is_dirty_root) = lost_nodes(tracker, edited, root);
    // This test has the same result for any least-cost tree, so it comes before the conversion to the first of equally
    // cheap paths.
    if 2 * lost.iter().filter(|lost| **lost).count() > num_nodes {
        return costs_from_scratch(graph, root, watch);
    }
    let orderly;
    let tracker = if tracker.first_of_equals() {
        tracker
    } else {
        orderly = with_first_of_equals(old_graph, tracker);
        &orderly
    };
    let cost = NodeCost::new(graph);
    let quantum = Quantum::choose(graph, &cost)?;
    let mut costs = vec![UNREACHED; num_nodes];
    let mut before = vec![NO_NODE; num_nodes];
    for (old, &node) in edited.new_of_old.iter().enumerate() {
        if node == NO_NODE {
            continue;
        }
        let old = old as u32;
        if let Some(quanta) = tracker.cost_quanta(old) {
            costs[node as usize] = quanta;
        }
        if let Some(previous) = tracker.predecessor(old) {
            before[node as usize] = edited.new_of_old[previous as usize];
        }
    }
    let again: Vec<u32> = (0..num_nodes as u32)
        .filter(|n| lost[*n as usize])
        .collect();
    for &node in &again {
        costs[node as usize] = UNREACHED;
    }
    let mut open = BinaryHeap::new();
    let mut changed = vec![false; num_nodes];
    for &node in again.iter().chain(is_dirty_root.then_some(&root)) {
        changed[node as usize] = true;
        let mut least = costs[node as usize];
        graph.for_each_edge(node, |u, length_mm| {
            let there = costs[u as usize];
            if there != UNREACHED && !lost[u as usize] {
                least = least.min(there + u64::from(quantum.edge(&cost, u, node, length_mm)));
            }
        });
        if least != UNREACHED {
            costs[node as usize] = least;
            open.push(Reverse((least, node)));
        }
    }
    let mut num_popped = 0usize;
    while let Some(Reverse((here, node))) = open.pop() {
        if here != costs[node as usize] {
            continue;
        }
        num_popped += 1;
        if num_popped.is_multiple_of(1 << 16) {
            watch.report_fraction(0.5)?;
        }
        graph.for_each_edge(node, |v, length_mm| {
            let through = here + u64::from(quantum.edge(&cost, node, v, length_mm));
            if through < costs[v as usize] {
                costs[v as usize] = through;
                changed[v as usize] = true;
                open.push(Reverse((through, v)));
            }
        });
    }
    // The predecessor of a node is chosen again if its cost, an edge or the cost of a neighbour has changed.
    let mut choose = changed.clone();
    for node in (0..num_nodes as u32).filter(|n| changed[*n as usize]) {
        graph.for_each_edge(node, |v, _| choose[v as usize] = true);
    }
    for &node in &edited.dirty {
        choose[node as usize] = true;
        graph.for_each_edge(node, |v, _| choose[v as usize] = true);
    }
    let nodes: Vec<u32> = (0..num_nodes as u32)
        .filter(|n| choose[*n as usize])
        .collect();
    let chosen = first_predecessors(graph, &cost, quantum, root, &costs, &nodes);
    for (node, previous) in nodes.iter().zip(chosen) {
        before[*node as usize] = previous;
    }
    let order = merged_order(tracker, edited, &costs, &changed);
    Ok(Tracker::from_costs(
        root, quantum, costs, before, order, true,
    ))
}

/// Return for each node whether its cost is invalid, because its old path contains a changed node.
///
/// The second result states whether an edge of the root changed.
fn lost_nodes(tracker: &Tracker, edited: &Edited, root: u32) -> (Vec<bool>, bool) {
    let mut lost = vec![false; edited.graph.num_nodes()];
    for &node in &edited.dirty {
        lost[node as usize] = true;
    }
    // The root keeps its cost of 0; nodes that were reached from it over a changed edge do not keep theirs.
    let is_dirty_root = lost[root as usize];
    lost[root as usize] = false;
    // In this order a node comes after its predecessor.
    for &old in tracker.settled() {
        let node = edited.new_of_old[old as usize];
        if node == NO_NODE || node == root {
            continue;
        }
        let previous = tracker
            .predecessor(old)
            .map_or(NO_NODE, |previous| edited.new_of_old[previous as usize]);
        if previous == NO_NODE || lost[previous as usize] || (is_dirty_root && previous == root) {
            lost[node as usize] = true;
        }
    }
    (lost, is_dirty_root)
}

/// Return all nodes with a cost, ordered by cost and then by node number; nodes with unchanged cost keep their order.
fn merged_order(tracker: &Tracker, edited: &Edited, costs: &[u64], changed: &[bool]) -> Vec<u32> {
    let key = |n: u32| (costs[n as usize], n);
    let mut moved: Vec<u32> = (0..costs.len() as u32)
        .filter(|n| changed[*n as usize] && costs[*n as usize] != UNREACHED)
        .collect();
    moved.sort_unstable_by_key(|n| key(*n));
    let mut order = Vec::with_capacity(costs.len());
    let mut next = 0;
    for old in tracker.settled() {
        let node = edited.new_of_old[*old as usize];
        if node == NO_NODE || changed[node as usize] {
            continue;
        }
        while next < moved.len() && key(moved[next]) < key(node) {
            order.push(moved[next]);
            next += 1;
        }
        order.push(node);
    }
    order.extend(&moved[next..]);
    order
}

/// Return for each of `nodes` its first neighbour in array order that gives the node its least cost.
fn first_predecessors(
    graph: &LumenGraph,
    cost: &NodeCost,
    quantum: Quantum,
    root: u32,
    costs: &[u64],
    nodes: &[u32],
) -> Vec<u32> {
    nodes
        .par_iter()
        .map(|&node| {
            let here = costs[node as usize];
            let mut first = NO_NODE;
            if node != root && here != UNREACHED {
                graph.for_each_edge(node, |u, length_mm| {
                    let there = costs[u as usize];
                    if there < here
                        && u < first
                        && there + u64::from(quantum.edge(cost, u, node, length_mm)) == here
                    {
                        first = u;
                    }
                });
            }
            first
        })
        .collect()
}

/// Return the voxels that paths reach in the graph `new` but not in the graph `old`.
///
/// Each graph is given with a flag for each node, true if the node is reached.
#[must_use]
pub fn newly_reached(new: (&LumenGraph, &[bool]), old: (&LumenGraph, &[bool])) -> Vec<[u16; 3]> {
    let was = |voxel| {
        let node = old.0.lumen.place(signed(voxel));
        node.is_some_and(|n| old.1[n as usize])
    };
    let voxels = new.0.voxels.iter().zip(new.1);
    voxels
        .filter(|(voxel, is_reached)| **is_reached && !was(**voxel))
        .map(|(voxel, _)| *voxel)
        .collect()
}

/// Return the mask of a lumen: one byte per voxel of the grid, 1 inside, x fastest.
#[must_use]
pub fn as_bytes(graph: &LumenGraph, grid: &Grid) -> Vec<u8> {
    // The operating system provides zeroed memory: pages without lumen are never written and take no memory.
    let mut bytes = vec![0u8; grid.num_voxels()];
    for voxel in &graph.voxels {
        bytes[grid.index(voxel.map(usize::from))] = 1;
    }
    bytes
}
