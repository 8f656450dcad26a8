//! The resumable tree of least-cost paths (paper 6.3, Algorithm 1) with an integer bucket queue.
//!
//! The root is fixed. [`Tracker::solve_to`] settles nodes in the order of their cost until the target is settled and keeps
//! everything: the next target goes on from there, and costs nothing where it is settled already. The back-pointers
//! B(u) of the paper are `predecessor`.
//!
//! The queue is Dial's (1969): edge costs are whole quanta of at most C, so all open costs lie in a window of C + 1
//! values, one bucket each, reused in a circle. Settling is exact, as with a heap; [`crate::dijkstra`] is the readable
//! reference.

use crate::graph::{Cost, Graph, NO_NODE, Quantum};
use crate::{TrackError, Watch};

/// Cost of a node that no path has reached.
pub const UNREACHED: u64 = u64::MAX;

/// Settled nodes between two looks at the watch.
const NODES_PER_LOOK: usize = 1 << 16;

/// A least-cost tree that grows as far as it is asked to.
#[derive(Debug)]
pub struct Tracker {
    root: u32,
    quantum: Quantum,
    // u64: a sum of 2^31 edges of 2^24 quanta is below 2^55, so no path cost can overflow.
    cost: Vec<u64>,
    predecessor: Vec<u32>,
    settled: Vec<bool>,
    order: Vec<u32>,
    queue: BucketQueue,
    first_of_equals: bool,
}

impl Tracker {
    /// A tracker with one root and nothing settled.
    pub fn new(graph: &impl Graph, cost: &impl Cost, root: u32) -> Result<Self, TrackError> {
        let num_nodes = graph.num_nodes();
        if root as usize >= num_nodes {
            return Err(TrackError::Argument {
                what: "root",
                expected: format!("a node below {num_nodes}"),
                found: root.to_string(),
            });
        }
        let quantum = Quantum::choose(graph, cost)?;
        let mut tracker = Self {
            root,
            quantum,
            cost: vec![UNREACHED; num_nodes],
            predecessor: vec![NO_NODE; num_nodes],
            settled: vec![false; num_nodes],
            order: Vec::new(),
            queue: BucketQueue::new(quantum.dearest_edge),
            first_of_equals: false,
        };
        tracker.cost[root as usize] = 0;
        tracker.queue.push(0, root);
        Ok(tracker)
    }

    /// A tracker that has settled all that has a cost, in the order of cost and then of nodes; `predecessor` is `NO_NODE` at
    /// the root and where nothing is settled.
    pub(crate) fn from_costs(
        root: u32,
        quantum: Quantum,
        cost: Vec<u64>,
        predecessor: Vec<u32>,
        order: Vec<u32>,
        first_of_equals: bool,
    ) -> Self {
        let settled = cost.iter().map(|c| *c != UNREACHED).collect();
        Self {
            root,
            quantum,
            cost,
            predecessor,
            settled,
            order,
            queue: BucketQueue::new(0),
            first_of_equals,
        }
    }

    /// Settles everything, with the first of equally cheap paths: the tree and its order depend on the graph alone.
    pub(crate) fn solved_in_order(
        graph: &impl Graph,
        cost: &impl Cost,
        root: u32,
        watch: &impl Watch,
    ) -> Result<Self, TrackError> {
        let mut tracker = Self::new(graph, cost, root)?;
        tracker.first_of_equals = true;
        tracker.solve_all(graph, cost, watch)?;
        // In the order of cost they are; among equals in that of nodes.
        let costs = &tracker.cost;
        for equals in tracker
            .order
            .chunk_by_mut(|a, b| costs[*a as usize] == costs[*b as usize])
        {
            equals.sort_unstable();
        }
        Ok(tracker)
    }

    /// True if the first of equally cheap paths was taken everywhere, so that the tree depends on the graph alone.
    pub(crate) const fn first_of_equals(&self) -> bool {
        self.first_of_equals
    }

    /// True if nothing is left to be settled.
    pub(crate) const fn is_done(&self) -> bool {
        self.queue.num_open == 0
    }

    /// Least cost of every node in quanta; [`UNREACHED`] where none is known.
    pub(crate) fn costs(&self) -> Vec<u64> {
        (0..self.cost.len() as u32)
            .map(|node| self.cost_quanta(node).unwrap_or(UNREACHED))
            .collect()
    }

    /// Settles what is needed to know the least cost of `target`; true if a path exists.
    ///
    /// `graph` and `cost` must be those the tracker was made with.
    pub fn solve_to(
        &mut self,
        graph: &impl Graph,
        cost: &impl Cost,
        target: u32,
        watch: &impl Watch,
    ) -> Result<bool, TrackError> {
        self.advance(graph, cost, Some(target), watch)?;
        Ok(self.settled[target as usize])
    }

    /// Settles every node that a path can reach.
    pub fn solve_all(
        &mut self,
        graph: &impl Graph,
        cost: &impl Cost,
        watch: &impl Watch,
    ) -> Result<(), TrackError> {
        self.advance(graph, cost, None, watch)
    }

    fn advance(
        &mut self,
        graph: &impl Graph,
        cost: &impl Cost,
        target: Option<u32>,
        watch: &impl Watch,
    ) -> Result<(), TrackError> {
        let num_nodes = self.cost.len();
        while target.is_none_or(|t| !self.settled[t as usize]) {
            let Some((node_cost, node)) = self.queue.pop() else {
                return Ok(());
            };
            let u = node as usize;
            // A node is queued once per improvement; all but the last, cheapest entry are stale.
            if self.settled[u] || self.cost[u] != node_cost {
                continue;
            }
            self.settled[u] = true;
            self.order.push(node);
            let (costs, predecessors, queue) =
                (&mut self.cost, &mut self.predecessor, &mut self.queue);
            let (quantum, first_of_equals) = (self.quantum, self.first_of_equals);
            graph.for_each_edge(node, |v, length_mm| {
                let through = node_cost + u64::from(quantum.edge(cost, node, v, length_mm));
                let least = costs[v as usize];
                if through < least {
                    costs[v as usize] = through;
                    predecessors[v as usize] = node;
                    queue.push(through, v);
                } else if first_of_equals && through == least && node < predecessors[v as usize] {
                    // All that lead to a node by its least cost are settled before it: each has a lesser cost.
                    predecessors[v as usize] = node;
                }
            });
            // After the node is done, so that a stop never loses its edges.
            if self.order.len().is_multiple_of(NODES_PER_LOOK) {
                watch.go_on(self.order.len() as f64 / num_nodes as f64)?;
            }
        }
        Ok(())
    }

    /// The fixed root.
    #[must_use]
    pub const fn root(&self) -> u32 {
        self.root
    }

    /// The run's integer unit.
    #[must_use]
    pub const fn quantum(&self) -> Quantum {
        self.quantum
    }

    /// Nodes settled so far, in the order of their cost: a node comes after its predecessor.
    #[must_use]
    pub fn settled(&self) -> &[u32] {
        &self.order
    }

    /// Least cost of a settled node in quanta.
    #[must_use]
    pub fn cost_quanta(&self, node: u32) -> Option<u64> {
        self.settled[node as usize].then(|| self.cost[node as usize])
    }

    /// Least cost of a settled node, weight times mm.
    #[must_use]
    pub fn cost(&self, node: u32) -> Option<f64> {
        self.cost_quanta(node)
            .map(|quanta| quanta as f64 * self.quantum.cost)
    }

    /// The node before a settled one on its path, or `None` at the root and where nothing is settled.
    #[must_use]
    pub fn predecessor(&self, node: u32) -> Option<u32> {
        let before = self.predecessor[node as usize];
        (self.settled[node as usize] && before != NO_NODE).then_some(before)
    }

    /// Nodes from the root to `target`, or `None` where it is not settled.
    #[must_use]
    pub fn path_to(&self, target: u32) -> Option<Vec<u32>> {
        if !self.settled[target as usize] {
            return None;
        }
        let mut path = vec![target];
        let mut node = target;
        while let Some(before) = self.predecessor(node) {
            path.push(before);
            node = before;
        }
        path.reverse();
        Some(path)
    }
}

/// Dial's circle of buckets, as linked lists in one pool. Last in, first out within a bucket, so the order is fixed.
#[derive(Debug)]
struct BucketQueue {
    heads: Vec<u32>,
    /// One bit per bucket that holds something: empty stretches are passed 64 buckets at a time.
    filled: Vec<u64>,
    entries: Vec<(u32, u32)>,
    free: u32,
    num_open: usize,
    /// Cost of the bucket that is being emptied.
    front: u64,
}

const END: u32 = u32::MAX;

impl BucketQueue {
    fn new(dearest_edge: u32) -> Self {
        // A power of two above C, so that the place in the circle is a mask.
        let num_buckets = (dearest_edge as usize + 1).next_power_of_two().max(64);
        Self {
            heads: vec![END; num_buckets],
            filled: vec![0; num_buckets / 64],
            entries: Vec::new(),
            free: END,
            num_open: 0,
            front: 0,
        }
    }

    fn push(&mut self, cost: u64, node: u32) {
        debug_assert!(cost >= self.front && cost - self.front < self.heads.len() as u64);
        let bucket = cost as usize & (self.heads.len() - 1);
        let entry = (node, self.heads[bucket]);
        let at = self.free;
        if at == END {
            self.heads[bucket] = self.entries.len() as u32;
            self.entries.push(entry);
        } else {
            self.free = self.entries[at as usize].1;
            self.entries[at as usize] = entry;
            self.heads[bucket] = at;
        }
        self.filled[bucket / 64] |= 1 << (bucket % 64);
        self.num_open += 1;
    }

    fn pop(&mut self) -> Option<(u64, u32)> {
        if self.num_open == 0 {
            return None;
        }
        let mask = self.heads.len() - 1;
        let mut bucket = self.front as usize & mask;
        loop {
            let ahead = self.filled[bucket / 64] >> (bucket % 64);
            if ahead != 0 {
                let skip = ahead.trailing_zeros() as usize;
                self.front += skip as u64;
                bucket += skip;
                break;
            }
            let skip = 64 - bucket % 64;
            self.front += skip as u64;
            bucket = (bucket + skip) & mask;
        }
        let at = self.heads[bucket];
        let (node, next) = self.entries[at as usize];
        self.heads[bucket] = next;
        if next == END {
            self.filled[bucket / 64] &= !(1 << (bucket % 64));
        }
        self.entries[at as usize].1 = self.free;
        self.free = at;
        self.num_open -= 1;
        Some((self.front, node))
    }
}
