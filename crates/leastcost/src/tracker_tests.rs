//! Contract tests of the tracker on random graphs.
//!
//! The results equal those of Dijkstra's algorithm with a heap, resumed searches equal fresh ones, and a path's cost is
//! the sum of its edges.

use proptest::prelude::*;

use crate::dijkstra::least_costs;
use crate::graph::{Cost, Graph, Quantum};
use crate::tracker::Tracker;
use crate::{TrackError, Unwatched, Watch};

#[derive(Debug, Clone)]
struct RandomGraph {
    edges: Vec<Vec<(u32, f64)>>,
    weights: Vec<f64>,
}

impl Graph for RandomGraph {
    fn num_nodes(&self) -> usize {
        self.edges.len()
    }

    fn for_each_edge(&self, node: u32, mut visit: impl FnMut(u32, f64)) {
        for &(other, length_mm) in &self.edges[node as usize] {
            visit(other, length_mm);
        }
    }

    fn edge_length_range_mm(&self) -> (f64, f64) {
        (0.4, 3.5)
    }
}

impl Cost for RandomGraph {
    fn weight(&self, u: u32, v: u32) -> f64 {
        0.5 * (self.weights[u as usize] + self.weights[v as usize])
    }

    fn weight_range(&self) -> (f64, f64) {
        (1.0, 500.0)
    }
}

fn random_graph() -> impl Strategy<Value = RandomGraph> {
    (2usize..60).prop_flat_map(|n| {
        let edge = (0..n as u32, 0..n as u32, 0.4f64..3.5);
        (
            prop::collection::vec(edge, 0..4 * n),
            prop::collection::vec(1.0f64..500.0, n),
        )
            .prop_map(move |(list, weights)| {
                let mut edges = vec![Vec::new(); n];
                for (u, v, length_mm) in list {
                    if u != v {
                        edges[u as usize].push((v, length_mm));
                        edges[v as usize].push((u, length_mm));
                    }
                }
                RandomGraph { edges, weights }
            })
    })
}

/// Return the cost in quanta of the cheapest edge between two neighbours.
fn edge_quanta(graph: &RandomGraph, quantum: Quantum, u: u32, v: u32) -> u64 {
    graph.edges[u as usize]
        .iter()
        .filter(|(other, _)| *other == v)
        .map(|(_, length_mm)| u64::from(quantum.edge(graph, u, v, *length_mm)))
        .min()
        .unwrap()
}

proptest! {
    #[test]
    fn costs_of_the_bucket_queue_equal_those_of_the_heap(graph in random_graph()) {
        let mut tracker = Tracker::new(&graph, &graph, 0).unwrap();
        tracker.solve_all(&graph, &graph, &Unwatched).unwrap();
        let truth = least_costs(&graph, &graph, tracker.quantum(), 0);
        for (node, cost) in truth.iter().enumerate() {
            prop_assert_eq!(tracker.cost_quanta(node as u32), *cost);
        }
    }

    #[test]
    fn resumed_searches_equal_fresh_searches(
        graph in random_graph(),
        targets in prop::collection::vec(0usize..60, 1..8),
    ) {
        let n = graph.num_nodes();
        let mut fresh = Tracker::new(&graph, &graph, 0).unwrap();
        fresh.solve_all(&graph, &graph, &Unwatched).unwrap();
        let mut resumed = Tracker::new(&graph, &graph, 0).unwrap();
        for target in targets {
            let target = (target % n) as u32;
            let before = resumed.settled().len();
            let known = resumed.cost_quanta(target).is_some();
            let reached = resumed.solve_to(&graph, &graph, target, &Unwatched).unwrap();
            // No node may be settled for a target that is settled already.
            prop_assert!(!known || resumed.settled().len() == before);
            prop_assert_eq!(reached, fresh.cost_quanta(target).is_some());
            prop_assert_eq!(resumed.path_to(target), fresh.path_to(target));
        }
        resumed.solve_all(&graph, &graph, &Unwatched).unwrap();
        prop_assert_eq!(resumed.settled(), fresh.settled());
    }

    #[test]
    fn a_path_cost_is_the_sum_of_its_edges_and_accurate_within_half_a_percent(graph in random_graph()) {
        let mut tracker = Tracker::new(&graph, &graph, 0).unwrap();
        tracker.solve_all(&graph, &graph, &Unwatched).unwrap();
        for target in 0..graph.num_nodes() as u32 {
            let Some(path) = tracker.path_to(target) else { continue };
            prop_assert_eq!(path[0], 0);
            let quanta: u64 = path.windows(2).map(|e| edge_quanta(&graph, tracker.quantum(), e[0], e[1])).sum();
            prop_assert_eq!(Some(quanta), tracker.cost_quanta(target));
            let exact: f64 = path
                .windows(2)
                .map(|e| {
                    let shortest = graph.edges[e[0] as usize]
                        .iter()
                        .filter(|(v, _)| *v == e[1])
                        .map(|(_, l)| *l)
                        .fold(f64::INFINITY, f64::min);
                    shortest * graph.weight(e[0], e[1])
                })
                .sum();
            let found = tracker.cost(target).unwrap();
            prop_assert!((found - exact).abs() <= 0.005 * exact + 1e-12, "{found} {exact}");
        }
    }
}

/// Observer that stops the search once, at the first check.
struct StopOnce(std::sync::atomic::AtomicBool);

impl Watch for StopOnce {
    fn report_fraction(&self, _fraction: f64) -> Result<(), TrackError> {
        if self.0.swap(false, std::sync::atomic::Ordering::Relaxed) {
            return Err(TrackError::Cancelled);
        }
        Ok(())
    }
}

#[test]
fn a_stopped_tracker_resumes_with_equal_results() {
    // The chain is longer than the number of nodes between two checks.
    let n = 200_000u32;
    let edges = (0..n)
        .map(|u| {
            let mut list = Vec::new();
            if u > 0 {
                list.push((u - 1, 1.0));
            }
            if u + 1 < n {
                list.push((u + 1, 1.0));
            }
            list
        })
        .collect();
    let graph = RandomGraph {
        edges,
        weights: vec![1.0; n as usize],
    };
    let mut tracker = Tracker::new(&graph, &graph, 0).unwrap();
    let watch = StopOnce(true.into());
    assert_eq!(
        tracker.solve_to(&graph, &graph, n - 1, &watch),
        Err(TrackError::Cancelled)
    );
    assert!(tracker.settled().len() < n as usize);
    assert_eq!(tracker.solve_to(&graph, &graph, n - 1, &watch), Ok(true));
    let length = tracker.cost(n - 1).unwrap();
    assert!((length - f64::from(n - 1)).abs() < 1e-6 * length);
}

#[test]
fn a_cost_range_too_wide_for_the_queue_is_rejected() {
    struct Wide(RandomGraph);
    impl Cost for Wide {
        fn weight(&self, u: u32, v: u32) -> f64 {
            self.0.weight(u, v)
        }
        fn weight_range(&self) -> (f64, f64) {
            (1e-6, 1e6)
        }
    }
    let graph = RandomGraph {
        edges: vec![Vec::new()],
        weights: vec![1.0],
    };
    let error = Tracker::new(&graph, &Wide(graph.clone()), 0).unwrap_err();
    assert_eq!(error.code(), "track.cost-range");
    assert_eq!(
        Tracker::new(&graph, &graph, 1).unwrap_err().code(),
        "usage.track"
    );
}
