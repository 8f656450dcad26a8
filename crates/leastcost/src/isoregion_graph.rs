//! Graph without the voxels inside cubes of equal labels (`IsoRegions`; paper 6.1, Figure 12).
//!
//! A voxel with an `IsoRegion` (radius of 1 or more) is pruned if a neighbour's region is larger. The remaining voxels
//! of a region are its centre, or several centres of equal radius, and its voxels at the border to other labels (radius
//! 0). This rule gives the printed Figure 12(b) exactly; a rule that takes the largest region first and prunes the
//! voxels inside it does not.
//!
//! Remaining voxels that are neighbours keep their edge. Each remaining border voxel on the boundary of a cube has one
//! link: to the centre of the largest cube that contains it, and of equal cubes to the nearest centre. The paper links
//! only *some* boundary voxels to a centre, because a link from each would be too many (6.1). So a graph has at most as
//! many links as nodes, and stores one number for each node.
//!
//! One link for each border voxel does not always connect two regions that touch in it. Where the components of the
//! pruned graph differ from those of the unpruned graph, links between centres and the boundaries of their cubes are
//! added, as few as possible. Links from each centre to all remaining voxels on its cube's boundary preserve
//! connectivity: radii are chessboard distances to the nearest voxel of radius 0, so they differ by at most 1 between
//! neighbours, and from a pruned voxel the radii increase, by 1 a step, up to a centre. The voxel h of radius 0 nearest
//! to the pruned voxel is on the boundary of that centre's cube. So a voxel's centres and its nearest h are connected, as
//! are those of two neighbours with different radii. For neighbours of equal radius that share neither centre nor h
//! there is no such proof; tests with random volumes cover this case instead.

use std::sync::atomic::{AtomicU64, Ordering};

use carina_grid::{Grid, length};
use carina_isoregion::MapBuilder;
use rayon::prelude::*;

use crate::box_graph::{BoxGraph, VoxelGraph};
use crate::distance::VoxelBox;
use crate::graph::{Cost, Graph, NO_NODE};
use crate::lumen::{LumenCost, LumenGraph};
use crate::paper_cost::PaperCost;
use crate::{TrackError, Watch};

/// Compute the `IsoRegion` radii of the voxels of a box, without regard to the voxels beyond the box.
///
/// # Errors
///
/// Returns an error if the number of labels is wrong or `watch` stops the computation.
pub fn radii(
    labels: &[u8],
    voxel_box: VoxelBox,
    watch: &impl Watch,
) -> Result<Vec<u8>, TrackError> {
    let [nx, ny, nz] = voxel_box.shape_ijk;
    let mut radius = vec![0; labels.len()];
    let builder = MapBuilder {
        cancelled: Some(&|| watch.report_fraction(0.0).is_err()),
        ..MapBuilder::default()
    };
    builder
        .radius_map(labels, [nz, ny, nx], &mut radius)
        .map_err(|error| match error {
            carina_isoregion::IsoRegionError::Cancelled => TrackError::Cancelled,
            other => TrackError::Argument {
                what: "labels",
                expected: format!("one for each of {} voxels", voxel_box.num_voxels()),
                found: other.to_string(),
            },
        })?;
    Ok(radius)
}

/// Return true if a voxel is pruned: it is in an `IsoRegion`, and a neighbour has a larger radius (paper 6.1).
#[must_use]
pub fn is_cut_away(radius: &[u8], shape_ijk: [usize; 3], ijk: [usize; 3]) -> bool {
    let [nx, ny, _] = shape_ijk;
    let own = radius[(ijk[2] * ny + ijk[1]) * nx + ijk[0]];
    let range = |a: usize| ijk[a].saturating_sub(1)..=(ijk[a] + 1).min(shape_ijk[a] - 1);
    own > 0
        && range(2).any(|k| {
            range(1).any(|j| {
                let row = (k * ny + j) * nx;
                radius[row + range(0).start()..=row + range(0).end()]
                    .iter()
                    .any(|&other| other > own)
            })
        })
}

/// Graph `base` without the voxels inside `IsoRegions`, with links from the centres to the boundaries of their cubes.
#[derive(Debug)]
pub struct IsoRegionGraph<B> {
    base: B,
    grid: Grid,
    /// For each node of this graph, its node in the unpruned graph.
    whole_of: Vec<u32>,
    /// For each node of the unpruned graph, its node in this graph; [`NO_NODE`] for a pruned node.
    node_of: Vec<u32>,
    radius: Vec<u8>,
    /// For each node, the centre to which it is linked; [`NO_NODE`] for centres and for nodes without a link.
    centre_of: Vec<u32>,
    /// Pairs of nodes with an additional link that keeps the graph connected, in both directions, sorted.
    additional_links: Vec<(u32, u32)>,
    num_centres: usize,
    longest_mm: f64,
}

impl<B: VoxelGraph + Sync> IsoRegionGraph<B> {
    /// Prune the graph `base` by the `IsoRegion` radii of the voxels of its box ([`radii`]).
    ///
    /// A label must have the same meaning everywhere, because a straight line between two voxels of one cube becomes an
    /// edge.
    ///
    /// # Errors
    ///
    /// Returns an error if the radius map has the wrong size or if `watch` stops the computation.
    pub fn build(
        base: B,
        grid: &Grid,
        radius: &[u8],
        watch: &impl Watch,
    ) -> Result<Self, TrackError> {
        let voxel_box = base.voxel_box();
        if radius.len() != voxel_box.num_voxels() {
            return Err(TrackError::Argument {
                what: "radius map",
                expected: format!("{} voxels", voxel_box.num_voxels()),
                found: radius.len().to_string(),
            });
        }
        let local = |node: u32| {
            let voxel = base.voxel_of_node(node);
            std::array::from_fn(|a| voxel[a] - voxel_box.first_ijk[a])
        };
        let whole_of: Vec<u32> = (0..base.num_nodes() as u32)
            .into_par_iter()
            .filter(|&node| !is_cut_away(radius, voxel_box.shape_ijk, local(node)))
            .collect();
        watch.report_fraction(0.3)?;
        let mut node_of = vec![NO_NODE; base.num_nodes()];
        for (node, &whole) in whole_of.iter().enumerate() {
            node_of[whole as usize] = node as u32;
        }
        let [nx, ny, _] = voxel_box.shape_ijk;
        let radius: Vec<u8> = whole_of
            .par_iter()
            .map(|&whole| {
                let [i, j, k]: [usize; 3] = local(whole);
                radius[(k * ny + j) * nx + i]
            })
            .collect();
        let mut graph = Self {
            base,
            grid: grid.clone(),
            num_centres: radius.iter().filter(|r| **r > 0).count(),
            whole_of,
            node_of,
            radius,
            centre_of: Vec::new(),
            additional_links: Vec::new(),
            longest_mm: 0.0,
        };
        graph.centre_of = graph.nearest_of_largest(watch)?;
        graph.additional_links = graph.missing_links(watch)?;
        graph.longest_mm = graph.base.edge_length_range_mm().1;
        let mut longest_mm = graph.longest_mm;
        graph.for_each_link(|_, _, mm| longest_mm = longest_mm.max(mm));
        graph.longest_mm = longest_mm;
        Ok(graph)
    }

    /// Return for each node the nearest centre of the largest cube with this node on its boundary.
    ///
    /// Centres themselves have none. Of equally near centres the first in array order is taken.
    fn nearest_of_largest(&self, watch: &impl Watch) -> Result<Vec<u32>, TrackError> {
        let best: Vec<AtomicU64> = self.whole_of.iter().map(|_| AtomicU64::new(0)).collect();
        let centres = self.linked_centres();
        let num_done = AtomicU64::new(0);
        centres.par_chunks(256).try_for_each(|chunk| {
            for &centre in chunk {
                let radius = u64::from(self.radius[centre as usize]);
                self.for_each_boundary_node(centre, |node, offset| {
                    let best = &best[node as usize];
                    // A larger radius counts first, then a shorter link, then a smaller node number.
                    if self.radius[node as usize] == 0
                        && best.load(Ordering::Relaxed) >> 56 <= radius
                    {
                        let mm = self.length_mm(offset) as f32;
                        let nearness = u64::from(!mm.to_bits() >> 8);
                        let key = radius << 56 | nearness << 32 | u64::from(!centre);
                        best.fetch_max(key, Ordering::Relaxed);
                    }
                });
            }
            let done = num_done.fetch_add(chunk.len() as u64, Ordering::Relaxed);
            watch.report_fraction(0.3 + 0.4 * done as f64 / centres.len() as f64)
        })?;
        Ok(best
            .into_iter()
            .map(|key| match key.into_inner() {
                0 => NO_NODE,
                key => !(key as u32),
            })
            .collect())
    }

    /// Return the centres whose cubes have more than 27 voxels, so that their boundary is not next to the centre.
    fn linked_centres(&self) -> Vec<u32> {
        (0..self.whole_of.len() as u32)
            .filter(|node| self.radius[*node as usize] > 1)
            .collect()
    }

    /// Return the links that are missing for the components of the unpruned graph, in both directions, sorted.
    fn missing_links(&self, watch: &impl Watch) -> Result<Vec<(u32, u32)>, TrackError> {
        let mut components = Components::of(self, watch)?;
        let mut links = Vec::new();
        if components.num == 1 || components.num == Components::of(&self.base, watch)?.num {
            return Ok(links);
        }
        // A copy of the roots lets the threads read them; each pair that they find is tested again when it is joined.
        let root_of: Vec<u32> = (0..self.whole_of.len() as u32)
            .map(|node| components.root(node))
            .collect();
        let separate: Vec<(u32, u32)> = self
            .linked_centres()
            .par_iter()
            .flat_map_iter(|&centre| {
                let mut found: Vec<(u32, u32)> = Vec::new();
                self.for_each_boundary_node(centre, |node, _| {
                    let root = root_of[node as usize];
                    if root != root_of[centre as usize]
                        && found
                            .iter()
                            .all(|(_, other)| root_of[*other as usize] != root)
                    {
                        found.push((centre, node));
                    }
                });
                found
            })
            .collect();
        for (centre, node) in separate {
            if components.join(centre, node) {
                links.extend([(centre, node), (node, centre)]);
            }
        }
        links.sort_unstable();
        Ok(links)
    }

    /// Call `visit(centre, node, length_mm)` for each link.
    fn for_each_link(&self, mut visit: impl FnMut(u32, u32, f64)) {
        for (node, &centre) in self.centre_of.iter().enumerate() {
            if centre != NO_NODE {
                visit(centre, node as u32, self.distance_mm(node as u32, centre));
            }
        }
        for &(u, v) in self.additional_links.iter().filter(|(u, v)| u < v) {
            visit(u, v, self.distance_mm(u, v));
        }
    }

    fn distance_mm(&self, u: u32, v: u32) -> f64 {
        let (from, to) = (self.voxel(u), self.voxel(v));
        self.length_mm(std::array::from_fn(|a| to[a] as isize - from[a] as isize))
    }

    /// Call `visit(node, offset)` for the remaining voxels on the boundary of a centre's cube, in array order.
    ///
    /// The cube must have more than 27 voxels; edges to neighbours already cover the boundary of smaller ones.
    fn for_each_boundary_node(&self, centre: u32, mut visit: impl FnMut(u32, [isize; 3])) {
        let r = isize::from(self.radius[centre as usize]);
        let at = self.voxel(centre).map(|v| v as isize);
        let voxel_box = self.base.voxel_box();
        let range = |a: usize| {
            let first = voxel_box.first_ijk[a] as isize;
            let last = first + voxel_box.shape_ijk[a] as isize - 1;
            (at[a] - r).max(first)..=(at[a] + r).min(last)
        };
        for k in range(2) {
            for j in range(1) {
                let mut visit_node = |i: isize, whole: u32| {
                    let node = self.node_of[whole as usize];
                    if node != NO_NODE {
                        visit(node, [i - at[0], j - at[1], k - at[2]]);
                    }
                };
                if (k - at[2]).abs() == r || (j - at[1]).abs() == r {
                    let row = at[0] - r..=at[0] + r;
                    self.base.for_each_node_in_row(row, [j, k], visit_node);
                } else {
                    for i in [at[0] - r, at[0] + r] {
                        if let Some(whole) = self.base.node_of_voxel([i, j, k]) {
                            visit_node(i, whole);
                        }
                    }
                }
            }
        }
    }

    fn length_mm(&self, offset: [isize; 3]) -> f64 {
        length(self.grid.lps_from_ijk().vector(offset.map(|v| v as f64)))
    }

    /// Return the unpruned graph.
    pub const fn base(&self) -> &B {
        &self.base
    }

    /// Return the node in the unpruned graph for a node of this graph.
    #[must_use]
    pub fn whole(&self, node: u32) -> u32 {
        self.whole_of[node as usize]
    }

    /// Return the voxel of a node.
    #[must_use]
    pub fn voxel(&self, node: u32) -> [usize; 3] {
        self.base.voxel_of_node(self.whole(node))
    }

    /// Return the radius of the `IsoRegion` at a node: 0 at borders to other labels.
    #[must_use]
    pub fn radius(&self, node: u32) -> u8 {
        self.radius[node as usize]
    }

    /// Return the number of nodes that are the centre of an `IsoRegion`.
    #[must_use]
    pub const fn num_centres(&self) -> usize {
        self.num_centres
    }

    /// Count the undirected edges and links.
    #[must_use]
    pub fn num_edges(&self) -> u64 {
        let ends: u64 = self
            .whole_of
            .par_iter()
            .map(|&whole| {
                let mut degree = 0u64;
                self.base.for_each_edge(whole, |other, _| {
                    degree += u64::from(self.node_of[other as usize] != NO_NODE);
                });
                degree
            })
            .sum();
        let linked = self.centre_of.iter().filter(|c| **c != NO_NODE).count();
        ends / 2 + (linked + self.additional_links.len() / 2) as u64
    }

    /// Return the pairs of nodes with an additional link that keeps the graph connected, in both directions, sorted.
    #[cfg(test)]
    pub(crate) fn additional_links(&self) -> &[(u32, u32)] {
        &self.additional_links
    }

    /// Return the node of a voxel, or the centre that represents a pruned voxel; `None` outside the graph.
    ///
    /// A pruned voxel is inside the cube of the centre that represents it.
    #[must_use]
    pub fn node_for_voxel(&self, ijk: [isize; 3]) -> Option<u32> {
        let whole = self.base.node_of_voxel(ijk)?;
        let node = self.node_of[whole as usize];
        if node != NO_NODE {
            return Some(node);
        }
        // The nearest centre whose cube contains the voxel is chosen; of equally near ones the first in array order.
        let mut best: Option<(f64, u32)> = None;
        for r in 1..=255isize {
            if best.is_some_and(|(mm, _)| mm <= r as f64 * self.grid.min_spacing_mm()) {
                break;
            }
            for_each_on_cube(r, |offset| {
                let to = std::array::from_fn(|a| ijk[a] + offset[a]);
                let Some(whole) = self.base.node_of_voxel(to) else {
                    return;
                };
                let node = self.node_of[whole as usize];
                if node != NO_NODE && isize::from(self.radius[node as usize]) >= r {
                    let mm = self.length_mm(offset);
                    if best.is_none_or(|(least, _)| mm < least) {
                        best = Some((mm, node));
                    }
                }
            });
        }
        best.map(|(_, node)| node)
    }
}

/// Return the chessboard distance of two voxels.
fn chessboard(a: [usize; 3], b: [usize; 3]) -> isize {
    (0..3).map(|n| a[n].abs_diff(b[n])).max().unwrap_or(0) as isize
}

/// Call `visit` for the offsets at chessboard distance `r` from a voxel, in array order.
fn for_each_on_cube(r: isize, mut visit: impl FnMut([isize; 3])) {
    for dk in -r..=r {
        for dj in -r..=r {
            if dk.abs() == r || dj.abs() == r {
                for di in -r..=r {
                    visit([di, dj, dk]);
                }
            } else {
                visit([-r, dj, dk]);
                visit([r, dj, dk]);
            }
        }
    }
}

impl<B: VoxelGraph + Sync> Graph for IsoRegionGraph<B> {
    fn num_nodes(&self) -> usize {
        self.whole_of.len()
    }

    fn for_each_edge(&self, node: u32, mut visit: impl FnMut(u32, f64)) {
        self.base.for_each_edge(self.whole(node), |whole, mm| {
            let other = self.node_of[whole as usize];
            if other != NO_NODE {
                visit(other, mm);
            }
        });
        if self.radius(node) > 1 {
            self.for_each_boundary_node(node, |other, _| {
                if self.centre_of[other as usize] == node {
                    visit(other, self.distance_mm(node, other));
                }
            });
        }
        let centre = self.centre_of[node as usize];
        if centre != NO_NODE {
            visit(centre, self.distance_mm(node, centre));
        }
        let first = self.additional_links.partition_point(|(u, _)| *u < node);
        for &(_, other) in self.additional_links[first..]
            .iter()
            .take_while(|(u, _)| *u == node)
        {
            visit(other, self.distance_mm(node, other));
        }
    }

    fn edge_length_range_mm(&self) -> (f64, f64) {
        (self.base.edge_length_range_mm().0, self.longest_mm)
    }
}

/// Cost of the edges of the unpruned graph that also defines weights for the links of the pruned graph.
pub trait LinkCost<B>: Cost {
    /// Return the weight per mm of a link between two nodes of the unpruned graph.
    fn link_weight(&self, base: &B, u: u32, v: u32) -> f64;

    /// Return two weights that bound the costs of all edges and links of a pruned graph.
    ///
    /// The lower bound of the costs is the first weight times the graph's shortest edge, the upper bound the second
    /// weight times its longest edge.
    fn link_weight_range(&self, graph: &IsoRegionGraph<B>) -> (f64, f64);
}

/// The printed formula depends only on two ends and a distance, so it applies to a link in the same way as to an edge.
impl LinkCost<BoxGraph> for &PaperCost {
    fn link_weight(&self, _base: &BoxGraph, u: u32, v: u32) -> f64 {
        self.weight(u, v)
    }

    fn link_weight_range(&self, _graph: &IsoRegionGraph<BoxGraph>) -> (f64, f64) {
        self.weight_range()
    }
}

/// A link costs as much as the straight line of voxels that it replaces.
///
/// Its two ends alone (the middle and the wall) would not describe the voxels between.
impl LinkCost<LumenGraph> for LumenCost<'_> {
    fn link_weight(&self, base: &LumenGraph, u: u32, v: u32) -> f64 {
        // The line starts at the smaller node number, so that both directions of a link round in the same way.
        let [from, to] = [u.min(v), u.max(v)].map(|n| base.voxel(n).map(|x| x as isize));
        let steps = (0..3).map(|a| (to[a] - from[a]).abs()).max().unwrap_or(0);
        let mut before = u.min(v);
        let (mut cost, mut at) = (0.0, from);
        for step in 1..=steps {
            let share = step as f64 / steps as f64;
            let next: [isize; 3] = std::array::from_fn(|a| {
                from[a] + (share * (to[a] - from[a]) as f64).round() as isize
            });
            let Some(node) = base.node_at_voxel(next) else {
                // A cube of one label contains only lumen, so this case does not occur on a link.
                return f64::INFINITY;
            };
            let offset = std::array::from_fn(|a| next[a] - at[a]);
            cost += base.step_mm(offset) * self.weight(before, node);
            (before, at) = (node, next);
        }
        cost / base.step_mm(std::array::from_fn(|a| to[a] - from[a]))
    }

    fn link_weight_range(&self, graph: &IsoRegionGraph<LumenGraph>) -> (f64, f64) {
        let (least, greatest) = self.weight_range();
        let mut dearest = graph.base.edge_length_range_mm().1 * greatest;
        graph.for_each_link(|centre, node, mm| {
            let weight = self.link_weight(&graph.base, graph.whole(centre), graph.whole(node));
            dearest = dearest.max(mm * weight);
        });
        (least, dearest / graph.longest_mm)
    }
}

/// Cost of the edges and links of a pruned graph, derived from the cost of the unpruned graph.
#[derive(Debug)]
pub struct PrunedCost<'a, B, C> {
    graph: &'a IsoRegionGraph<B>,
    cost: C,
    range: (f64, f64),
}

impl<'a, B: VoxelGraph + Sync, C: LinkCost<B>> PrunedCost<'a, B, C> {
    /// Create the cost for a pruned graph; the range of the weights is computed from all links if the cost requires it.
    pub fn new(graph: &'a IsoRegionGraph<B>, cost: C) -> Self {
        let range = cost.link_weight_range(graph);
        Self::with_range(graph, cost, range)
    }

    /// Create the cost for a pruned graph with a known range of weights, which may be slow to compute.
    pub const fn with_range(graph: &'a IsoRegionGraph<B>, cost: C, range: (f64, f64)) -> Self {
        Self { graph, cost, range }
    }

    /// Return the smallest and the largest weight.
    pub const fn range(&self) -> (f64, f64) {
        self.range
    }
}

impl<B: VoxelGraph + Sync, C: LinkCost<B>> Cost for PrunedCost<'_, B, C> {
    fn weight(&self, u: u32, v: u32) -> f64 {
        // A link has a centre of radius 2 or more at one end; most edges do not.
        let may_be_link = self.graph.radius(u).max(self.graph.radius(v)) > 1;
        let is_link = may_be_link && chessboard(self.graph.voxel(u), self.graph.voxel(v)) > 1;
        let [u, v] = [u, v].map(|n| self.graph.whole(n));
        if is_link {
            self.cost.link_weight(&self.graph.base, u, v)
        } else {
            self.cost.weight(u, v)
        }
    }

    fn weight_range(&self) -> (f64, f64) {
        self.range
    }
}

impl VoxelGraph for LumenGraph {
    fn voxel_box(&self) -> VoxelBox {
        Self::voxel_box(self)
    }

    fn node_of_voxel(&self, ijk: [isize; 3]) -> Option<u32> {
        self.node_at_voxel(ijk)
    }

    fn voxel_of_node(&self, node: u32) -> [usize; 3] {
        self.voxel(node)
    }
}

/// Connected components of a graph, as a forest in which each node leads to a node of its component.
struct Components {
    next: Vec<u32>,
    num: usize,
}

impl Components {
    fn of(graph: &impl Graph, watch: &impl Watch) -> Result<Self, TrackError> {
        let num = graph.num_nodes();
        let mut components = Self {
            next: (0..num as u32).collect(),
            num,
        };
        for node in 0..num as u32 {
            if node.is_multiple_of(1 << 16) {
                watch.report_fraction(0.7 + 0.3 * f64::from(node) / num as f64)?;
            }
            graph.for_each_edge(node, |other, _| {
                if other < node {
                    components.join(node, other);
                }
            });
        }
        Ok(components)
    }

    /// Return the node that represents the connected component of a node.
    fn root(&mut self, mut node: u32) -> u32 {
        while self.next[node as usize] != node {
            let skipped = self.next[self.next[node as usize] as usize];
            self.next[node as usize] = skipped;
            node = skipped;
        }
        node
    }

    /// Join the connected components of two nodes; return false if they were already joined.
    fn join(&mut self, u: u32, v: u32) -> bool {
        let (u, v) = (self.root(u), self.root(v));
        // The smaller number becomes the root, so that the result does not depend on the order of the nodes.
        self.next[u.max(v) as usize] = u.min(v);
        self.num -= usize::from(u != v);
        u != v
    }
}

/// Count the undirected edges of a graph.
pub fn count_edges(graph: &(impl Graph + Sync)) -> u64 {
    let ends: u64 = (0..graph.num_nodes() as u32)
        .into_par_iter()
        .map(|node| {
            let mut degree = 0u64;
            graph.for_each_edge(node, |_, _| degree += 1);
            degree
        })
        .sum();
    ends / 2
}
