//! Dijkstra's algorithm with a binary heap: slow, readable, and the truth that the tracker is tested against.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::graph::{Cost, Graph, Quantum};

/// Least cost in quanta from `root` to every node; `None` where there is no path.
#[must_use]
pub fn least_costs(
    graph: &impl Graph,
    cost: &impl Cost,
    quantum: Quantum,
    root: u32,
) -> Vec<Option<u64>> {
    let mut least = vec![None; graph.num_nodes()];
    let mut open = BinaryHeap::from([Reverse((0u64, root))]);
    while let Some(Reverse((node_cost, node))) = open.pop() {
        if least[node as usize].is_some() {
            continue;
        }
        least[node as usize] = Some(node_cost);
        graph.for_each_edge(node, |v, length_mm| {
            if least[v as usize].is_none() {
                let edge = u64::from(quantum.edge(cost, node, v, length_mm));
                open.push(Reverse((node_cost + edge, v)));
            }
        });
    }
    least
}
