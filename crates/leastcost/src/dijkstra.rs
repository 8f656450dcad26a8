//! Dijkstra's algorithm with a binary heap: a slow, readable reference with which tests compare the tracker.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::graph::{Cost, Graph, Quantum};

/// Return the least cost in quanta from `root` to every node of a graph; `None` for a node that no path reaches.
#[must_use]
pub fn least_costs(
    graph: &impl Graph,
    cost: &impl Cost,
    quantum: Quantum,
    root: u32,
) -> Vec<Option<u64>> {
    least_costs_by(graph.num_nodes(), root, |node, visit| {
        graph.for_each_edge(node, |v, length_mm| {
            visit(v, u64::from(quantum.edge(cost, node, v, length_mm)));
        });
    })
}

/// Return the least cost in quanta from `root` to every node; `None` for a node that no path reaches.
///
/// `for_each_edge(node, visit)` must call `visit(neighbour, quanta)` for every edge of a node.
#[must_use]
pub fn least_costs_by(
    num_nodes: usize,
    root: u32,
    for_each_edge: impl Fn(u32, &mut dyn FnMut(u32, u64)),
) -> Vec<Option<u64>> {
    let mut least = vec![None; num_nodes];
    let mut open = BinaryHeap::from([Reverse((0u64, root))]);
    while let Some(Reverse((node_cost, node))) = open.pop() {
        if least[node as usize].is_some() {
            continue;
        }
        least[node as usize] = Some(node_cost);
        for_each_edge(node, &mut |v, edge| {
            if least[v as usize].is_none() {
                open.push(Reverse((node_cost + edge, v)));
            }
        });
    }
    least
}
