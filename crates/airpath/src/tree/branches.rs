//! Branches of the airway tree, derived from the tree of least-cost paths.
//!
//! Tips are found as in TEASAR (Sato et al. 2000): the node with the longest path among the uncovered nodes is a tip;
//! its path is traced back to the existing tree; then all nodes within a multiple of the tube's radius are covered.
//! Unlike in TEASAR, the distance is measured inside the lumen, so a neighbouring tube behind a wall keeps its own tip.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use carina_grid::{Grid, Ijk, length};

use crate::tree::branch::{Branch, pulled_inside, radius_mm, smooth_inside};
use crate::tree::centre;
use crate::tree::smooth::{self, Point};
use carina_leastcost::graph::{Graph, NO_NODE};
use carina_leastcost::lumen::LumenGraph;
use carina_leastcost::tracker::Tracker;
use carina_leastcost::{TrackError, Watch};

/// Limits that decide whether a path that leaves a tube is a branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BranchLimits {
    /// Length in mm outside the tube that it leaves below which a path is not a branch.
    pub min_length_mm: f64,
    /// Factor of a tube's radius in the distance within which a path covers nodes (`cover_radii * radius + cover_mm`).
    pub cover_radii: f64,
    /// Constant term in mm of the distance within which a path covers nodes.
    pub cover_mm: f64,
    /// Distance between points along a centreline, mm.
    pub step_mm: f64,
}

impl BranchLimits {
    /// Return the limits for a grid: in thick slices, bumps on a tube are coarser, so a branch must be longer.
    #[must_use]
    pub fn for_grid(grid: &Grid) -> Self {
        let coarsest = grid.spacing_mm().into_iter().fold(0.0, f64::max);
        Self {
            min_length_mm: (1.5 * coarsest).max(3.0),
            cover_radii: 2.0,
            cover_mm: coarsest.max(1.5),
            step_mm: 1.0,
        }
    }
}

/// Return the branches of the tree of all nodes that `tracker` has settled.
///
/// # Errors
///
/// Returns an error if `watch` stops the computation.
pub fn find_branches(
    graph: &LumenGraph,
    tracker: &Tracker,
    grid: &Grid,
    limits: &BranchLimits,
    watch: &impl Watch,
) -> Result<Vec<Branch>, TrackError> {
    let mut tree = NodeTree::new(graph, tracker, grid);
    let mut candidates = tracker.settled().to_vec();
    candidates.sort_by(|a, b| {
        tree.along_mm[*b as usize]
            .total_cmp(&tree.along_mm[*a as usize])
            .then(a.cmp(b))
    });
    let mut cover = Cover::new(graph, limits);
    for (n, &tip) in candidates.iter().enumerate() {
        if n.is_multiple_of(1 << 12) {
            watch.report_fraction(n as f64 / candidates.len() as f64)?;
        }
        if cover.holds(tip) {
            continue;
        }
        let chain = tree.chain_to_tree(tip);
        let join = chain[0];
        let beyond_mm =
            tree.along_mm[tip as usize] - tree.along_mm[join as usize] - graph.wall_mm(join);
        if tree.is_empty() || beyond_mm >= limits.min_length_mm {
            let num_nodes = chain.len() - tree.num_blind_end_nodes(&chain);
            let chain = tree.start_at_fork(&chain[..num_nodes], FORK_RADII);
            tree.add(&chain);
        }
        cover.add(&chain);
    }
    Ok(tree.branches(limits, &[]))
}

/// Return the branches of the automatic tree (the result of [`find_branches`]) that lead to `targets`.
///
/// The least-cost path of a target joins the automatic tree. The piece of this path outside the tree belongs to the
/// branch that it joins. Branches end at the forks of the automatic tree, so they equal its branches except for
/// the last ones, which may be shorter.
#[must_use]
pub fn branches_to(
    graph: &LumenGraph,
    tracker: &Tracker,
    grid: &Grid,
    limits: &BranchLimits,
    targets: &[u32],
    automatic: &[Branch],
) -> Vec<Branch> {
    let mut whole = NodeTree::new(graph, tracker, grid);
    let mut before: BTreeMap<u32, u32> = BTreeMap::new();
    for branch in automatic {
        for pair in branch.nodes.windows(2) {
            // Nodes found along a centreline may repeat; a repeated node would become its own predecessor.
            if !whole.in_tree[pair[1] as usize] {
                before.insert(pair[1], pair[0]);
                whole.add(pair);
            }
        }
    }
    let mut used = NodeTree::new(graph, tracker, grid);
    for &target in targets {
        if tracker.cost_quanta(target).is_none() {
            continue;
        }
        // A target at the wall is a whole radius away from the axis, so 1.5 radii are searched for the tube that it
        // belongs to.
        let mut chain = whole.start_at_fork(&whole.chain_to_tree(target), 1.5);
        chain.reverse();
        while !used.in_tree[chain[chain.len() - 1] as usize]
            && let Some(node) = before.get(&chain[chain.len() - 1])
        {
            chain.push(*node);
        }
        chain.reverse();
        if chain.len() > 1 || used.chains.is_empty() {
            // Lengths are measured along this chain, even where it differs from the target's least-cost path.
            used.measure(&chain);
            used.add(&chain);
        }
    }
    let mut forks: Vec<u32> = automatic
        .iter()
        .filter_map(|b| b.parent.map(|_| b.nodes[0]))
        .collect();
    forks.sort_unstable();
    forks.dedup();
    used.branches(limits, &forks)
}

/// Return for every node of the graph the index of the branch whose tube contains the node.
///
/// The branch is the one with the nearest centreline, measured inside the lumen and from the tube's surface: a wide
/// tube reaches farther than a narrow one that leaves it. The result is `NO_NODE` for a node that is connected to no
/// branch.
#[must_use]
pub fn branch_of_nodes(graph: &LumenGraph, branches: &[Branch]) -> Vec<u32> {
    let mut branch_of = vec![NO_NODE; graph.num_nodes()];
    let mut off = vec![u32::MAX; graph.num_nodes()];
    let mut open = BinaryHeap::new();
    // The node at which a branch begins belongs to the parent, which comes before the branch.
    for (b, branch) in branches.iter().enumerate() {
        for &node in &branch.nodes {
            if branch_of[node as usize] == NO_NODE {
                branch_of[node as usize] = b as u32;
                off[node as usize] = ordered((WIDEST_TUBE_MM - graph.wall_mm(node)).max(0.0));
                open.push(Reverse((off[node as usize], node)));
            }
        }
    }
    let is_middle: Vec<bool> = branch_of.iter().map(|b| *b != NO_NODE).collect();
    while let Some(Reverse((here, node))) = open.pop() {
        if here != off[node as usize] {
            continue;
        }
        graph.for_each_edge(node, |next, length_mm| {
            let there = here + ordered(length_mm);
            if there < off[next as usize] && !is_middle[next as usize] {
                off[next as usize] = there;
                branch_of[next as usize] = branch_of[node as usize];
                open.push(Reverse((there, next)));
            }
        });
    }
    branch_of
}

/// Radius in mm that is larger than the radius of any airway.
pub(crate) const WIDEST_TUBE_MM: f64 = 20.0;

/// Set of the nodes near the paths of the tree, with distances measured inside the lumen.
pub(crate) struct Cover<'a> {
    graph: &'a LumenGraph,
    limits: &'a BranchLimits,
    /// Distance in mm by which the covered region extends beyond each node; 0 for a node that is not covered.
    left_mm: Vec<f32>,
    open: BinaryHeap<(OrderedMm, u32)>,
}

/// Length in whole micrometres, because integers have a total order and f64 has none.
pub(crate) type OrderedMm = u32;

pub(crate) fn ordered(mm: f64) -> OrderedMm {
    (mm * 1000.0) as u32
}

impl<'a> Cover<'a> {
    pub(crate) fn new(graph: &'a LumenGraph, limits: &'a BranchLimits) -> Self {
        Self {
            graph,
            limits,
            left_mm: vec![0.0; graph.num_nodes()],
            open: BinaryHeap::new(),
        }
    }

    pub(crate) fn holds(&self, node: u32) -> bool {
        self.left_mm[node as usize] > 0.0
    }

    /// Cover the nodes near a chain of nodes.
    ///
    /// The search starts at all nodes of the chain together, those with the largest reach first, so that each node is
    /// visited about once.
    pub(crate) fn add(&mut self, chain: &[u32]) {
        for &node in chain {
            let reach = self.limits.cover_radii * self.graph.wall_mm(node) + self.limits.cover_mm;
            if reach > f64::from(self.left_mm[node as usize]) {
                self.left_mm[node as usize] = reach as f32;
                self.open.push((ordered(reach), node));
            }
        }
        while let Some((_, node)) = self.open.pop() {
            let here = f64::from(self.left_mm[node as usize]);
            let (left_mm, open) = (&mut self.left_mm, &mut self.open);
            self.graph.for_each_edge(node, |next, length_mm| {
                let left = here - length_mm;
                // The tolerance of 1 micrometre prevents repeated updates between nodes of equal reach.
                if left > f64::from(left_mm[next as usize]) + 1e-3 {
                    left_mm[next as usize] = left as f32;
                    open.push((ordered(left), next));
                }
            });
        }
    }
}

/// Distance from a tube's axis, in radii of the tube, beyond which a path has left the tube.
const FORK_RADII: f64 = 1.0;

/// Distance in radii of the tube below which two forks are merged.
const ONE_FORK_RADII: f64 = 0.9;

/// Tree of paths from the root to which paths can be added.
struct NodeTree<'a> {
    graph: &'a LumenGraph,
    tracker: &'a Tracker,
    grid: &'a Grid,
    /// Length in mm of the path from the root to each settled node.
    along_mm: Vec<f64>,
    in_tree: Vec<bool>,
    /// Paths in the order in which they were added; each begins at a node of an earlier one.
    chains: Vec<Vec<u32>>,
    /// Next nodes of each node of the tree, in the order in which their paths were added.
    children: BTreeMap<u32, Vec<u32>>,
}

impl<'a> NodeTree<'a> {
    fn new(graph: &'a LumenGraph, tracker: &'a Tracker, grid: &'a Grid) -> Self {
        let mut along_mm = vec![0.0; graph.num_nodes()];
        for &node in tracker.settled() {
            if let Some(before) = tracker.predecessor(node) {
                let step: [f64; 3] = std::array::from_fn(|a| {
                    graph.voxel(node)[a] as f64 - graph.voxel(before)[a] as f64
                });
                along_mm[node as usize] =
                    along_mm[before as usize] + length(grid.lps_from_ijk().vector(step));
            }
        }
        Self {
            graph,
            tracker,
            grid,
            along_mm,
            in_tree: vec![false; graph.num_nodes()],
            chains: Vec::new(),
            children: BTreeMap::new(),
        }
    }

    fn is_empty(&self) -> bool {
        self.chains.is_empty()
    }

    /// Return the path to `tip` from the nearest node of the tree, or from the root if the tree is empty.
    fn chain_to_tree(&self, tip: u32) -> Vec<u32> {
        let mut chain = vec![tip];
        let mut node = tip;
        while !self.in_tree[node as usize]
            && let Some(before) = self.tracker.predecessor(node)
        {
            chain.push(before);
            node = before;
        }
        chain.reverse();
        chain
    }

    /// Move the start of a new chain to the point where the chain leaves the tube that it shares with the tree.
    ///
    /// Two least-cost paths separate well before their tubes do, because each cuts the corner. A node still belongs to
    /// the shared tube while it sees a node of the tree below the current start at a distance of at most `radii` radii.
    fn start_at_fork(&self, chain: &[u32], radii: f64) -> Vec<u32> {
        // Nodes of the tree beyond the current start of the chain.
        let mut below = vec![chain[0]];
        let mut next = 0;
        while next < below.len() {
            if let Some(children) = self.children.get(&below[next]) {
                below.extend(children);
            }
            next += 1;
        }
        let ijk = |node: u32| self.graph.voxel(node).map(|v| v as f64);
        let mut fork = (0, chain[0]);
        // The last node stays in the chain, because it is the tip.
        for (n, &node) in chain.iter().enumerate().take(chain.len() - 1).skip(1) {
            let point = self.point(node);
            let near = below
                .iter()
                .map(|&other| {
                    let at = self.point(other);
                    (length(std::array::from_fn(|a| at[a] - point[a])), other)
                })
                .filter(|(off, other)| {
                    *off <= radii * self.graph.wall_mm(*other)
                        && self.graph.sees(ijk(node), ijk(*other))
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((_, other)) = near else { break };
            fork = (n, other);
        }
        let mut lower = vec![fork.1];
        lower.extend(&chain[fork.0 + 1..]);
        lower
    }

    /// Return the number of nodes at a chain's tip that lead into the blind end of the tube.
    ///
    /// In the blind end the wall comes nearer with every step. The nodes are at most 4 mm and a third of the chain.
    fn num_blind_end_nodes(&self, chain: &[u32]) -> usize {
        let tip = chain.len() - 1;
        let mut num_cut = 0;
        while num_cut < tip / 3 {
            let (here, before) = (chain[tip - num_cut], chain[tip - num_cut - 1]);
            let cut_mm = self.along_mm[chain[tip] as usize] - self.along_mm[before as usize];
            if cut_mm > 4.0 || self.graph.wall_mm(before) < 1.1 * self.graph.wall_mm(here) {
                break;
            }
            num_cut += 1;
        }
        num_cut
    }

    /// Set the lengths of nodes along a chain that is attached to the tree, even if the chain is not their least-cost
    /// path.
    fn measure(&mut self, chain: &[u32]) {
        for pair in chain.windows(2) {
            let (p, q) = (self.point(pair[0]), self.point(pair[1]));
            self.along_mm[pair[1] as usize] =
                self.along_mm[pair[0] as usize] + length([0, 1, 2].map(|a| p[a] - q[a]));
        }
    }

    fn add(&mut self, chain: &[u32]) {
        for &node in chain {
            self.in_tree[node as usize] = true;
        }
        for pair in chain.windows(2) {
            self.children.entry(pair[0]).or_default().push(pair[1]);
        }
        self.chains.push(chain.to_vec());
    }

    fn point(&self, node: u32) -> Point {
        self.grid
            .to_lps(Ijk(self.graph.voxel(node).map(|v| v as f64)))
            .0
    }

    /// Divide the paths of the tree into branches at their forks and at the nodes `more_forks`.
    fn branches(&self, limits: &BranchLimits, more_forks: &[u32]) -> Vec<Branch> {
        if self.chains.is_empty() {
            return Vec::new();
        }
        let root = self.tracker.root();
        let none = Vec::new();
        let below = |node: u32| self.children.get(&node).unwrap_or(&none);
        let is_fork = |node: u32| {
            below(node).len() > 1
                || (!below(node).is_empty() && more_forks.binary_search(&node).is_ok())
        };

        // Depth-first search with a stack of (parent, [first node, second node]).
        let mut branches: Vec<Branch> = Vec::new();
        let mut open: Vec<(Option<usize>, Vec<u32>)> = vec![(None, vec![root])];
        while let Some((parent, mut nodes)) = open.pop() {
            let mut end = nodes[nodes.len() - 1];
            // A fork at the root itself would give an empty trunk, so such a fork is skipped.
            while below(end).len() == 1 && (nodes.len() == 1 || !is_fork(end)) {
                end = below(end)[0];
                nodes.push(end);
            }
            // Two forks near each other count as one fork with more children.
            let run_mm = self.along_mm[end as usize] - self.along_mm[nodes[0] as usize];
            let is_one_fork = parent.is_some()
                && below(end).len() > 1
                && run_mm < ONE_FORK_RADII * self.graph.wall_mm(nodes[0]);
            let here = if is_one_fork {
                parent
            } else {
                branches.push(Branch {
                    parent,
                    generation: parent.map_or(0, |p| branches[p].generation + 1),
                    nodes: nodes.clone(),
                    points: Vec::new(),
                    radius_mm: Vec::new(),
                    wall_mm: Vec::new(),
                });
                Some(branches.len() - 1)
            };
            for &child in below(end).iter().rev() {
                let mut start = if is_one_fork {
                    nodes.clone()
                } else {
                    vec![end]
                };
                start.push(child);
                open.push((here, start));
            }
        }
        self.draw(&mut branches, limits);
        centre::refine(self.graph, self.grid, &mut branches, limits.step_mm);
        branches
    }

    /// Compute the smooth centrelines of branches.
    ///
    /// Each path from the root is smoothed as a whole, the longest first, so that it runs evenly through its
    /// forks. A branch takes its part of the first such path that contains it. The start of that part is moved
    /// gradually to the last point of the parent.
    fn draw(&self, branches: &mut [Branch], limits: &BranchLimits) {
        let mut leaves: Vec<usize> = (0..branches.len())
            .filter(|b| !branches.iter().any(|other| other.parent == Some(*b)))
            .collect();
        leaves.sort_by(|a, b| {
            let tip = |b: usize| {
                let nodes = &branches[b].nodes;
                self.along_mm[nodes[nodes.len() - 1] as usize]
            };
            tip(*b).total_cmp(&tip(*a)).then(a.cmp(b))
        });
        for leaf in leaves {
            let mut lineage = vec![leaf];
            while let Some(parent) = branches[lineage[lineage.len() - 1]].parent {
                lineage.push(parent);
            }
            lineage.reverse();
            let mut nodes: Vec<u32> = Vec::new();
            for &b in &lineage {
                nodes.extend(&branches[b].nodes[usize::from(!nodes.is_empty())..]);
            }
            let chain: Vec<Point> = nodes.iter().map(|n| self.point(*n)).collect();
            let (curve, at_mm) =
                smooth_inside(self.graph, self.grid, &chain, limits.step_mm, false);
            let chain_mm = smooth::cumulative_mm(&chain);
            let mut first = 0;
            for &b in &lineage {
                let last = first + branches[b].nodes.len() - 1;
                if branches[b].points.is_empty() {
                    let start = branches[b]
                        .parent
                        .and_then(|p| branches[p].points.last().copied());
                    let points = self.cut(&curve, &at_mm, chain_mm[first], chain_mm[last], start);
                    branches[b].points = points;
                }
                first = last;
            }
        }
    }

    /// Return the part of a smooth curve between two positions along it, moved so that it begins at `start`.
    fn cut(
        &self,
        curve: &[Point],
        at_mm: &[f64],
        from_mm: f64,
        to_mm: f64,
        start: Option<Point>,
    ) -> Vec<Point> {
        let place = |s: f64| {
            if curve.len() > 1 {
                pulled_inside(self.graph, self.grid, smooth::point_at(curve, at_mm, s))
            } else {
                curve[0]
            }
        };
        let begin = place(from_mm);
        // Points nearer than a tenth of a step to an end would only cause a kink.
        let margin = 0.1 * (at_mm[at_mm.len() - 1] / at_mm.len() as f64);
        let mut points = vec![begin];
        points.extend(
            at_mm
                .iter()
                .zip(curve)
                .filter(|(s, _)| **s > from_mm + margin && **s < to_mm - margin)
                .map(|(_, p)| *p),
        );
        if to_mm > from_mm {
            points.push(place(to_mm));
        }
        let Some(start) = start else { return points };
        let off: Point = std::array::from_fn(|a| start[a] - begin[a]);
        let glide_mm = (2.0 * self.radius_mm(start)).clamp(2.0, 10.0);
        let along = smooth::cumulative_mm(&points);
        let last = points.len() - 1;
        let glided: Vec<Point> = points
            .iter()
            .zip(&along)
            .enumerate()
            .map(|(n, (p, s))| {
                let x = (s / glide_mm).min(1.0);
                let share = if n == last {
                    0.0
                } else {
                    (1.0 - x) * (1.0 - x) * (1.0 + 2.0 * x)
                };
                let there = std::array::from_fn(|a| p[a] + share * off[a]);
                pulled_inside(self.graph, self.grid, there)
            })
            .collect();
        points = glided;
        points[0] = start;
        points
    }

    fn radius_mm(&self, lps: Point) -> f64 {
        radius_mm(self.graph, self.grid, lps)
    }
}
