//! Branches, read off the tree of least-cost paths.
//!
//! Tips are found as in TEASAR (Sato et al. 2000): the node with the longest path among those not yet covered is a tip; its
//! path is traced back to what is already in the tree; then everything the new piece sees within a multiple of its
//! tube's radius is covered. Unlike there, "covered" needs a free line of sight, so a neighbouring tube behind a wall
//! keeps its own tip.

use carina_grid::{Grid, Ijk, length};

use crate::graph::{Graph, NO_NODE};
use crate::lumen::LumenGraph;
use crate::smooth::{self, Point};
use crate::tracker::Tracker;
use crate::{TrackError, Watch};

/// When a side path is a branch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BranchLimits {
    /// A side path must reach this far beyond the tube it leaves, mm.
    pub min_length_mm: f64,
    /// A path covers what it sees within this multiple of its tube's radius ...
    pub cover_radii: f64,
    /// ... plus this, mm.
    pub cover_mm: f64,
    /// Distance of points along a centreline, mm.
    pub step_mm: f64,
}

impl BranchLimits {
    /// Limits for a grid: coarse slices leave coarser bumps on a tube.
    #[must_use]
    pub fn for_grid(grid: &Grid) -> Self {
        let coarsest = grid.spacing_mm().into_iter().fold(0.0, f64::max);
        Self {
            min_length_mm: (1.5 * coarsest).max(3.0),
            cover_radii: 1.3,
            cover_mm: coarsest.max(1.5),
            step_mm: 1.0,
        }
    }
}

/// A piece of airway between two forks, or between a fork and a tip.
#[derive(Debug, Clone, PartialEq)]
pub struct Branch {
    /// Position of the parent in the list; `None` at the root. Parents come first.
    pub parent: Option<usize>,
    /// Forks passed on the way here.
    pub generation: u32,
    /// Voxel path, root to tip; the first node is the parent's last.
    pub nodes: Vec<u32>,
    /// Smooth centreline, LPS; the first point is the parent's last, bit for bit.
    pub points: Vec<Point>,
    /// Distance to the wall at each point, mm.
    pub radius_mm: Vec<f64>,
}

/// The automatic tree of everything that `tracker` has settled.
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
    let mut covered = vec![false; graph.num_nodes()];
    for (n, &tip) in candidates.iter().enumerate() {
        if n.is_multiple_of(1 << 12) {
            watch.go_on(n as f64 / candidates.len() as f64)?;
        }
        if covered[tip as usize] {
            continue;
        }
        let chain = tree.chain_to_tree(tip);
        let join = chain[0];
        let beyond_mm = tree.along_mm[tip as usize]
            - tree.along_mm[join as usize]
            - graph.wall_mm(join);
        if tree.is_empty() || beyond_mm >= limits.min_length_mm {
            tree.add(&chain);
        }
        for &node in &chain {
            cover(graph, grid, node, limits, &mut covered);
        }
    }
    Ok(tree.branches(limits, &[]))
}

/// The tree of the paths to `targets` only. It forks where they part, and ends a branch where `forks` says that the
/// automatic tree forks, so that generations count the forks of the airway and not only those of the targets.
#[must_use]
pub fn branches_to(
    graph: &LumenGraph,
    tracker: &Tracker,
    grid: &Grid,
    limits: &BranchLimits,
    targets: &[u32],
    forks: &[u32],
) -> Vec<Branch> {
    let mut tree = NodeTree::new(graph, tracker, grid);
    for &target in targets {
        if tracker.cost_quanta(target).is_some() {
            let chain = tree.chain_to_tree(target);
            if chain.len() > 1 || tree.is_empty() {
                tree.add(&chain);
            }
        }
    }
    tree.branches(limits, forks)
}

/// The last node of every branch that has children.
#[must_use]
pub fn forks(branches: &[Branch]) -> Vec<u32> {
    let mut forks: Vec<u32> = branches
        .iter()
        .filter_map(|b| b.parent.map(|_| b.nodes[0]))
        .collect();
    forks.sort_unstable();
    forks.dedup();
    forks
}

/// For every node of the graph the branch its path leaves last; `NO_NODE` where it is not settled.
#[must_use]
pub fn branch_of_nodes(graph: &LumenGraph, tracker: &Tracker, branches: &[Branch]) -> Vec<u32> {
    let mut branch_of = vec![NO_NODE; graph.num_nodes()];
    // Children overwrite nothing of their parent: the shared first node belongs to the parent.
    for (b, branch) in branches.iter().enumerate() {
        let own = usize::from(branch.parent.is_some());
        for &node in &branch.nodes[own.min(branch.nodes.len())..] {
            if branch_of[node as usize] == NO_NODE {
                branch_of[node as usize] = b as u32;
            }
        }
    }
    for &node in tracker.settled() {
        if branch_of[node as usize] == NO_NODE
            && let Some(before) = tracker.predecessor(node)
        {
            branch_of[node as usize] = branch_of[before as usize];
        }
    }
    branch_of
}

fn cover(
    graph: &LumenGraph,
    grid: &Grid,
    node: u32,
    limits: &BranchLimits,
    covered: &mut [bool],
) {
    let center = graph.voxel(node).map(|v| v as isize);
    let reach_mm = limits.cover_radii * graph.wall_mm(node) + limits.cover_mm;
    let spacing = grid.spacing_mm();
    let reach: [isize; 3] = std::array::from_fn(|a| (reach_mm / spacing[a]) as isize);
    let from = center.map(|v| v as f64);
    for k in -reach[2]..=reach[2] {
        for j in -reach[1]..=reach[1] {
            for i in -reach[0]..=reach[0] {
                let at = [center[0] + i, center[1] + j, center[2] + k];
                let Some(other) = graph.node_at_voxel(at) else {
                    continue;
                };
                if covered[other as usize] {
                    continue;
                }
                let off = grid.lps_from_ijk().vector([i as f64, j as f64, k as f64]);
                if length(off) <= reach_mm && graph.sees(from, at.map(|v| v as f64)) {
                    covered[other as usize] = true;
                }
            }
        }
    }
    covered[node as usize] = true;
}

/// A growing set of root paths.
struct NodeTree<'a> {
    graph: &'a LumenGraph,
    tracker: &'a Tracker,
    grid: &'a Grid,
    /// Length of each settled node's path, mm.
    along_mm: Vec<f64>,
    in_tree: Vec<bool>,
    /// Paths in the order they were added; each begins on an earlier one.
    chains: Vec<Vec<u32>>,
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
        }
    }

    fn is_empty(&self) -> bool {
        self.chains.is_empty()
    }

    /// From the nearest node of the tree (or the root) to `tip`.
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

    fn add(&mut self, chain: &[u32]) {
        for &node in chain {
            self.in_tree[node as usize] = true;
        }
        self.chains.push(chain.to_vec());
    }

    fn point(&self, node: u32) -> Point {
        self.grid
            .to_lps(Ijk(self.graph.voxel(node).map(|v| v as f64)))
            .0
    }

    /// Cuts the paths at their forks.
    fn branches(&self, limits: &BranchLimits, more_forks: &[u32]) -> Vec<Branch> {
        if self.chains.is_empty() {
            return Vec::new();
        }
        // Nodes and edges of the tree, children in the order in which their paths were added.
        let root = self.tracker.root();
        let mut children: std::collections::BTreeMap<u32, Vec<u32>> =
            std::collections::BTreeMap::new();
        for chain in &self.chains {
            for pair in chain.windows(2) {
                children.entry(pair[0]).or_default().push(pair[1]);
            }
        }
        let none = Vec::new();
        let below = |node: u32| children.get(&node).unwrap_or(&none);
        let is_fork = |node: u32| {
            below(node).len() > 1
                || (!below(node).is_empty() && more_forks.binary_search(&node).is_ok())
        };

        // Depth first; a stack of (parent, first node, second node).
        let mut branches: Vec<Branch> = Vec::new();
        let mut open: Vec<(Option<usize>, Vec<u32>)> = vec![(None, vec![root])];
        while let Some((parent, mut nodes)) = open.pop() {
            let mut end = nodes[nodes.len() - 1];
            // At the root itself a fork would leave an empty trunk: pass through.
            while below(end).len() == 1 && (nodes.len() == 1 || !is_fork(end)) {
                end = below(end)[0];
                nodes.push(end);
            }
            // Two forks nearer to each other than half the tube's radius are one fork with more children.
            let run_mm =
                self.along_mm[end as usize] - self.along_mm[nodes[0] as usize];
            let is_one_fork = parent.is_some()
                && below(end).len() > 1
                && run_mm < 0.5 * self.graph.wall_mm(nodes[0]);
            let here = if is_one_fork {
                parent
            } else {
                branches.push(Branch {
                    parent,
                    generation: parent.map_or(0, |p| branches[p].generation + 1),
                    nodes: nodes.clone(),
                    points: Vec::new(),
                    radius_mm: Vec::new(),
                });
                Some(branches.len() - 1)
            };
            for &child in below(end).iter().rev() {
                let mut start = if is_one_fork { nodes.clone() } else { vec![end] };
                start.push(child);
                open.push((here, start));
            }
        }
        self.draw(&mut branches, limits);
        branches
    }

    /// Smooth centrelines. Each root path is smoothed as a whole, longest first, so that it runs evenly through its forks;
    /// a branch takes its piece of the first such path it lies on, and glides into it from its parent's last point.
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
            let (even, at_mm) = smooth::resampled(&chain, limits.step_mm);
            let curve = self.smooth(&even);
            let chain_mm = smooth::cumulative_mm(&chain);
            let mut first = 0;
            for &b in &lineage {
                let last = first + branches[b].nodes.len() - 1;
                if branches[b].points.is_empty() {
                    let start = branches[b]
                        .parent
                        .and_then(|p| branches[p].points.last().copied());
                    let points =
                        self.cut(&curve, &at_mm, chain_mm[first], chain_mm[last], start);
                    branches[b].radius_mm = points.iter().map(|p| self.radius_mm(*p)).collect();
                    branches[b].points = points;
                }
                first = last;
            }
        }
    }

    /// The piece of a curve between two places along it, begun at `start`.
    fn cut(
        &self,
        curve: &[Point],
        at_mm: &[f64],
        from_mm: f64,
        to_mm: f64,
        start: Option<Point>,
    ) -> Vec<Point> {
        let begin = if curve.len() > 1 {
            smooth::point_at(curve, at_mm, from_mm)
        } else {
            curve[0]
        };
        // Points nearer than a tenth of a step to an end would only make a kink.
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
            points.push(smooth::point_at(curve, at_mm, to_mm));
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
                let share = if n == last { 0.0 } else { (1.0 - x) * (1.0 - x) * (1.0 + 2.0 * x) };
                std::array::from_fn(|a| p[a] + share * off[a])
            })
            .collect();
        if glided.iter().all(|p| self.holds(*p)) {
            points = glided;
        }
        points[0] = start;
        points
    }

    fn holds(&self, lps: Point) -> bool {
        self.graph.holds(self.grid.to_ijk(carina_grid::Lps(lps)).0)
    }

    fn smooth(&self, even: &[Point]) -> Vec<Point> {
        let radius: Vec<f64> = even.iter().map(|p| self.radius_mm(*p)).collect();
        smooth::smoothed(even, &radius, |p| self.holds(p))
    }

    fn radius_mm(&self, lps: Point) -> f64 {
        radius_mm(self.graph, self.grid, lps)
    }
}

/// Distance to the wall at a point, mm: interpolated between the lumen voxels round it; 0 outside the lumen.
#[must_use]
pub fn radius_mm(graph: &LumenGraph, grid: &Grid, lps: Point) -> f64 {
    let ijk = grid.to_ijk(carina_grid::Lps(lps)).0;
    let base = ijk.map(|v| v.floor() as isize);
    let (mut sum, mut weights) = (0.0, 0.0);
    for corner in 0..8isize {
        let offset = [corner & 1, corner >> 1 & 1, corner >> 2];
        let at: [isize; 3] = std::array::from_fn(|a| base[a] + offset[a]);
        if let Some(node) = graph.node_at_voxel(at) {
            let weight: f64 = (0..3)
                .map(|a| 1.0 - (ijk[a] - at[a] as f64).abs())
                .product();
            sum += weight * graph.wall_mm(node);
            weights += weight;
        }
    }
    if weights > 0.0 { sum / weights } else { 0.0 }
}
