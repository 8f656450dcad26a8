//! Resumable tree of least-cost paths (paper 6.3, Algorithm 1) with an integer bucket queue.
//!
//! The root is fixed. [`Tracker::solve_to`] settles nodes in the order of their cost until the target is settled, and
//! stores all results: the search for the next target continues from there, and needs no work if that target is settled
//! already. The back-pointers B(u) of the paper are `predecessor`.
//!
//! The queue is Dial's (1969): edge costs are integers of at most C quanta, so all open costs are in a window of C + 1
//! values, with one bucket each, used in a circle. Settling is exact, as with a heap; [`crate::dijkstra`] is the
//! readable reference.

use crate::graph::{Cost, Graph, NO_NODE, Quantum};
use crate::{TrackError, Watch};

/// Cost of a node that no path has reached.
pub const UNREACHED: u64 = u64::MAX;

/// Number of nodes that are settled between two checks for cancellation.
const NODES_PER_CHECK: usize = 1 << 16;

/// Tree of least-cost paths from one root, which grows on demand.
#[derive(Debug)]
pub struct Tracker {
    root: u32,
    quantum: Quantum,
    // The costs are u64: a sum of 2^31 edges of 2^24 quanta is below 2^55, so no path cost can overflow.
    cost: Vec<u64>,
    predecessor: Vec<u32>,
    settled: Vec<bool>,
    order: Vec<u32>,
    queue: BucketQueue,
    first_of_equals: bool,
}

impl Tracker {
    /// Create a tracker with one root and no settled node.
    ///
    /// # Errors
    ///
    /// Returns an error if the root is not a node or the range of the costs is too wide.
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

    /// Create a tracker in which all nodes with a cost are settled.
    ///
    /// `order` has these nodes, ordered by cost and then by node number. `predecessor` is `NO_NODE` at the root and for
    /// nodes that are not settled.
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

    /// Create a tracker and settle all nodes, with the first of equally cheap paths.
    ///
    /// The tree and its order then depend only on the graph.
    pub(crate) fn solved_in_order(
        graph: &impl Graph,
        cost: &impl Cost,
        root: u32,
        watch: &impl Watch,
    ) -> Result<Self, TrackError> {
        let mut tracker = Self::new(graph, cost, root)?;
        tracker.first_of_equals = true;
        tracker.solve_all(graph, cost, watch)?;
        // The order by cost is already correct; nodes of equal cost are sorted by number.
        let costs = &tracker.cost;
        for equals in tracker
            .order
            .chunk_by_mut(|a, b| costs[*a as usize] == costs[*b as usize])
        {
            equals.sort_unstable();
        }
        Ok(tracker)
    }

    /// Return true if the tree has the first of equally cheap paths everywhere, so that it depends only on the graph.
    pub(crate) const fn first_of_equals(&self) -> bool {
        self.first_of_equals
    }

    /// Return true if every node that a path can reach is settled.
    pub(crate) const fn is_done(&self) -> bool {
        self.queue.num_open == 0
    }

    /// Return the least cost of every node in quanta; [`UNREACHED`] for a node that is not settled.
    pub(crate) fn costs(&self) -> Vec<u64> {
        (0..self.cost.len() as u32)
            .map(|node| self.cost_quanta(node).unwrap_or(UNREACHED))
            .collect()
    }

    /// Settle nodes until the least cost of `target` is known; return true if a path exists.
    ///
    /// `graph` and `cost` must be those with which the tracker was created.
    ///
    /// # Errors
    ///
    /// Returns an error if the target is not a node or `watch` stops the search.
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

    /// Settle every node that a path can reach.
    ///
    /// # Errors
    ///
    /// Returns an error if `watch` stops the search.
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
            // A node is queued once per improvement of its cost; all entries but the last, cheapest one are stale.
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
                    // All neighbours that give a node its least cost are settled before the node, because each has a
                    // lower cost.
                    predecessors[v as usize] = node;
                }
            });
            // The check comes after the node is finished, so that a stop never loses its edges.
            if self.order.len().is_multiple_of(NODES_PER_CHECK) {
                watch.report_fraction(self.order.len() as f64 / num_nodes as f64)?;
            }
        }
        Ok(())
    }

    /// Return the node of the root.
    #[must_use]
    pub const fn root(&self) -> u32 {
        self.root
    }

    /// Return the integer unit of the costs of this search.
    #[must_use]
    pub const fn quantum(&self) -> Quantum {
        self.quantum
    }

    /// Return the nodes settled so far, in the order of their cost: a node comes after its predecessor.
    #[must_use]
    pub fn settled(&self) -> &[u32] {
        &self.order
    }

    /// Return the least cost of a node in quanta; `None` if the node is not settled.
    #[must_use]
    pub fn cost_quanta(&self, node: u32) -> Option<u64> {
        self.settled[node as usize].then(|| self.cost[node as usize])
    }

    /// Return the least cost of a node in weight times mm; `None` if the node is not settled.
    #[must_use]
    pub fn cost(&self, node: u32) -> Option<f64> {
        self.cost_quanta(node)
            .map(|quanta| quanta as f64 * self.quantum.cost)
    }

    /// Return the predecessor of a settled node on its path; `None` at the root and for nodes that are not settled.
    #[must_use]
    pub fn predecessor(&self, node: u32) -> Option<u32> {
        let before = self.predecessor[node as usize];
        (self.settled[node as usize] && before != NO_NODE).then_some(before)
    }

    /// Return the nodes of the path from the root to `target`; `None` if the target is not settled.
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

/// Dial's circular buckets, as linked lists in one pool.
///
/// Within a bucket the last entry comes out first, so the order of the entries is determined.
#[derive(Debug)]
struct BucketQueue {
    heads: Vec<u32>,
    /// One bit per bucket, set if the bucket is not empty, so that 64 empty buckets are skipped at a time.
    filled: Vec<u64>,
    entries: Vec<(u32, u32)>,
    free: u32,
    num_open: usize,
    /// Cost of the nodes in the bucket that is being emptied.
    front: u64,
}

/// Number of an entry that marks the end of a bucket's list.
const END: u32 = u32::MAX;

impl BucketQueue {
    fn new(dearest_edge: u32) -> Self {
        // The number of buckets is a power of two above C, so that a mask gives the index in the circle.
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
