//! Tracker for any combination of a cost (`lumen`, `paper`, `walls`) and a graph (`voxel`, `isoregion`).

use carina_grid::{Grid, Ijk, VolumeView, length};
use carina_isoregion::value_labels;

use crate::box_graph::{BoxGraph, VoxelGraph};
use crate::distance::VoxelBox;
use crate::graph::Graph;
use crate::isoregion_graph::{IsoRegionGraph, PrunedCost, count_edges, radii};
use crate::lumen::{LumenCost, LumenGraph, WallLevels};
use crate::paper_cost::{PaperCost, Reading};
use crate::tracker::Tracker;
use crate::{TrackError, Watch};

/// Kind of the labels whose regions of equal values prune the graph.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Labels {
    /// Bins of 16 values (the paper's equal values).
    Bins,
    /// The lumen is one class; voxels outside it have no label and are not pruned.
    Lumen,
}

/// Voxels that paths may use, and the cost of an edge between two of them.
#[derive(Debug, Clone, Copy)]
pub enum Terrain {
    /// All voxels of a box, with the cost `paper` or `walls`.
    Paper(VoxelBox, Reading),
    /// The lumen's voxels, with the cost `lumen`.
    Lumen(Option<WallLevels>),
}

/// Node that represents a point of the volume, and its distance from the voxel of this point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// Number of the graph's node that represents the point.
    pub node: u32,
    /// Voxel of the unpruned graph that contains the point, or the lumen voxel nearest to it.
    pub voxel: [usize; 3],
    /// Distance from `voxel` to the voxel of `node`, mm; above 0 if `voxel` was pruned.
    pub to_node_mm: f64,
}

#[derive(Debug)]
enum Walk {
    Paper(BoxGraph, PaperCost),
    PaperPruned(IsoRegionGraph<BoxGraph>, PaperCost),
    Lumen(LumenGraph),
    LumenPruned(IsoRegionGraph<LumenGraph>, (f64, f64)),
}

/// Macro that evaluates an expression with the graph and the cost of the current [`Walk`].
///
/// The macro is a `match` that runs one arm; the compiler generates one copy of the expression per variant.
macro_rules! with_walk {
    ($walk:expr, |$graph:ident, $cost:ident| $body:expr) => {
        match $walk {
            Walk::Paper($graph, $cost) => $body,
            Walk::PaperPruned($graph, table) => {
                let $cost = &PrunedCost::new($graph, table);
                $body
            }
            Walk::Lumen($graph) => {
                let $cost = &LumenCost($graph);
                $body
            }
            Walk::LumenPruned($graph, range) => {
                let $cost = &PrunedCost::with_range($graph, LumenCost($graph.base()), *range);
                $body
            }
        }
    };
}

/// Tree of least-cost paths from one root, for any combination of graph and cost.
///
/// The search stops at a target and can be resumed.
#[derive(Debug)]
pub struct GraphTracker {
    grid: Grid,
    walk: Walk,
    tracker: Tracker,
}

impl GraphTracker {
    /// Build the graph and the cost of a volume, with no settled node.
    ///
    /// `pruned` selects the `IsoRegion` graph (paper 6.1). `lumen`, on the volume's grid, is required for the cost
    /// `lumen` and for labels of the lumen. The root is the voxel nearest to `root_ijk`; in a lumen it is the lumen
    /// voxel nearest to that point within `reach_mm`.
    ///
    /// # Errors
    ///
    /// Returns an error if an argument is not valid or `watch` stops the search.
    pub fn build(
        values: VolumeView<'_, i16>,
        terrain: Terrain,
        pruned: Option<Labels>,
        lumen: Option<&[u8]>,
        root_ijk: [f64; 3],
        reach_mm: f64,
        watch: &impl Watch,
    ) -> Result<Self, TrackError> {
        let grid = values.grid().clone();
        let needs_lumen = matches!(terrain, Terrain::Lumen(_)) || pruned == Some(Labels::Lumen);
        let lumen = lumen.unwrap_or_default();
        if needs_lumen && lumen.len() != grid.num_voxels() {
            return Err(TrackError::Argument {
                what: "lumen",
                expected: format!("one value for each of {} voxels", grid.num_voxels()),
                found: lumen.len().to_string(),
            });
        }
        let walk = match terrain {
            Terrain::Paper(voxel_box, reading) => {
                let graph = BoxGraph::new(&grid, voxel_box)?;
                let greatest = reading.scale(values, watch)?;
                let cost = PaperCost::build(values, &graph, reading, greatest, watch)?;
                match pruned {
                    None => Walk::Paper(graph, cost),
                    Some(labels) => {
                        let radius = box_radii(values, lumen, labels, voxel_box, false, watch)?;
                        let graph = IsoRegionGraph::build(graph, &grid, &radius, watch)?;
                        Walk::PaperPruned(graph, cost)
                    }
                }
            }
            Terrain::Lumen(levels) => {
                let graph = LumenGraph::build(values, lumen, levels)?;
                match pruned {
                    None => Walk::Lumen(graph),
                    Some(labels) => {
                        let voxel_box = graph.voxel_box();
                        let radius = box_radii(values, lumen, labels, voxel_box, true, watch)?;
                        let graph = IsoRegionGraph::build(graph, &grid, &radius, watch)?;
                        let range = PrunedCost::new(&graph, LumenCost(graph.base())).range();
                        Walk::LumenPruned(graph, range)
                    }
                }
            }
        };
        let root = place(&walk, &grid, root_ijk, reach_mm).ok_or_else(|| match terrain {
            Terrain::Paper(voxel_box, _) => TrackError::Argument {
                what: "root",
                expected: format!(
                    "a voxel of the box of {:?} voxels from {:?}",
                    voxel_box.shape_ijk, voxel_box.first_ijk
                ),
                found: format!("{root_ijk:?}"),
            },
            Terrain::Lumen(_) => TrackError::NoResult(format!(
                "the root is not within {reach_mm} mm of the airway lumen"
            )),
        })?;
        let tracker = with_walk!(&walk, |graph, cost| Tracker::new(graph, cost, root.node))?;
        Ok(Self {
            grid,
            walk,
            tracker,
        })
    }

    /// Return the graph's node for a point (voxel coordinates); `None` outside the box, or too far from the lumen.
    ///
    /// A point is too far if the nearest lumen voxel is farther than `reach_mm`.
    #[must_use]
    pub fn place(&self, ijk: [f64; 3], reach_mm: f64) -> Option<Place> {
        place(&self.walk, &self.grid, ijk, reach_mm)
    }

    /// Settle nodes until the least cost of the target is known; return true if a path exists.
    ///
    /// # Errors
    ///
    /// Returns an error if `watch` stops the search.
    pub fn solve_to(&mut self, target: u32, watch: &impl Watch) -> Result<bool, TrackError> {
        let Self { walk, tracker, .. } = self;
        with_walk!(&*walk, |graph, cost| tracker
            .solve_to(graph, cost, target, watch))
    }

    /// Return the tree of least-cost paths computed so far.
    #[must_use]
    pub const fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    /// Return the voxel of a node.
    #[must_use]
    pub fn voxel(&self, node: u32) -> [usize; 3] {
        match &self.walk {
            Walk::Paper(graph, _) => graph.voxel_of_node(node),
            Walk::PaperPruned(graph, _) => graph.voxel(node),
            Walk::Lumen(graph) => graph.voxel(node),
            Walk::LumenPruned(graph, _) => graph.voxel(node),
        }
    }

    /// Return the number of nodes of the graph.
    #[must_use]
    pub fn num_nodes(&self) -> usize {
        with_walk!(&self.walk, |graph, _cost| graph.num_nodes())
    }

    /// Count the undirected edges of the graph, including the links of pruned regions, one by one.
    #[must_use]
    pub fn num_edges(&self) -> u64 {
        match &self.walk {
            Walk::Paper(graph, _) => count_edges(graph),
            Walk::Lumen(graph) => count_edges(graph),
            Walk::PaperPruned(graph, _) => graph.num_edges(),
            Walk::LumenPruned(graph, _) => graph.num_edges(),
        }
    }

    /// Return the number of centres of `IsoRegion`s; 0 for a graph without pruning.
    #[must_use]
    pub const fn num_centres(&self) -> usize {
        match &self.walk {
            Walk::PaperPruned(graph, _) => graph.num_centres(),
            Walk::LumenPruned(graph, _) => graph.num_centres(),
            Walk::Paper(..) | Walk::Lumen(_) => 0,
        }
    }
}

/// Return the `IsoRegion` radius of each voxel of a box (half the side of the cube of equal labels round it); with
/// `lumen_only`, 0 for voxels outside the lumen.
fn box_radii(
    values: VolumeView<'_, i16>,
    lumen: &[u8],
    labels: Labels,
    voxel_box: VoxelBox,
    lumen_only: bool,
    watch: &impl Watch,
) -> Result<Vec<u8>, TrackError> {
    let [nx, ny, nz] = voxel_box.shape_ijk;
    let rows = (0..ny * nz).map(|row| {
        let [i, j, k] = voxel_box.first_ijk;
        let first = values.grid().index([i, j + row % ny, k + row / ny]);
        first..first + nx
    });
    let labels = match labels {
        Labels::Bins => {
            let boxed: Vec<i16> = rows
                .clone()
                .flat_map(|row| values.data()[row].iter().copied())
                .collect();
            let mut labels = value_labels(&boxed, |_, _| false).labels;
            if lumen_only {
                let inside = rows.flat_map(|row| &lumen[row]);
                for (label, inside) in labels.iter_mut().zip(inside) {
                    *label *= u8::from(*inside != 0);
                }
            }
            labels
        }
        Labels::Lumen => rows
            .flat_map(|row| lumen[row].iter().map(|v| u8::from(*v != 0)))
            .collect(),
    };
    radii(&labels, voxel_box, watch)
}

fn place(walk: &Walk, grid: &Grid, ijk: [f64; 3], reach_mm: f64) -> Option<Place> {
    let nearest = |graph: &LumenGraph| {
        let (node, _) = graph.nearest_node(grid, ijk, reach_mm)?;
        Some(graph.voxel(node))
    };
    let voxel = match walk {
        Walk::Paper(..) | Walk::PaperPruned(..) => grid.voxel_at(Ijk(ijk))?,
        Walk::Lumen(graph) => nearest(graph)?,
        Walk::LumenPruned(graph, _) => nearest(graph.base())?,
    };
    let at = voxel.map(|v| v as isize);
    let (node, stands_at) = match walk {
        Walk::Paper(graph, _) => (graph.node_of_voxel(at)?, voxel),
        Walk::Lumen(graph) => (graph.node_of_voxel(at)?, voxel),
        Walk::PaperPruned(graph, _) => {
            let node = graph.node_for_voxel(at)?;
            (node, graph.voxel(node))
        }
        Walk::LumenPruned(graph, _) => {
            let node = graph.node_for_voxel(at)?;
            (node, graph.voxel(node))
        }
    };
    let offset = std::array::from_fn(|a| stands_at[a] as f64 - voxel[a] as f64);
    Some(Place {
        node,
        voxel,
        to_node_mm: length(grid.lps_from_ijk().vector(offset)),
    })
}

#[cfg(test)]
mod tests {
    use carina_grid::Affine;

    use super::*;
    use crate::Unwatched;

    /// Return a tube of air along k with a half-width of three voxels, in tissue.
    ///
    /// Every third slice is one grey value brighter.
    fn tube() -> (Grid, Vec<i16>, Vec<u8>) {
        let axes =
            Affine::from_columns([0.8, 0.0, 0.0], [0.0, 0.9, 0.0], [0.0, 0.0, 1.5], [0.0; 3]);
        let grid = Grid::new([24, 15, 17], axes).unwrap();
        let lumen: Vec<u8> = (0..grid.num_voxels())
            .map(|n| {
                let [i, j, _] = grid.voxel(n);
                u8::from(i.abs_diff(8) <= 3 && j.abs_diff(7) <= 3)
            })
            .collect();
        let values = lumen
            .iter()
            .enumerate()
            .map(|(n, l)| {
                if *l == 1 {
                    -1000 + i16::from(grid.voxel(n)[2].is_multiple_of(3))
                } else {
                    40
                }
            })
            .collect();
        (grid, values, lumen)
    }

    #[test]
    fn all_combinations_of_graph_and_cost_find_the_path_through_a_tube() {
        let (grid, values, lumen) = tube();
        let view = VolumeView::new(&values, &grid).unwrap();
        let whole = VoxelBox {
            first_ijk: [0; 3],
            shape_ijk: grid.shape_ijk(),
        };
        for terrain in [
            Terrain::Paper(whole, Reading::Printed),
            Terrain::Paper(whole, Reading::Walls),
            Terrain::Lumen(None),
        ] {
            let build = |pruned| {
                let root = [8.2, 7.0, 1.0];
                GraphTracker::build(view, terrain, pruned, Some(&lumen), root, 3.0, &Unwatched)
                    .unwrap()
            };
            let mut full = build(None);
            for labels in [None, Some(Labels::Bins), Some(Labels::Lumen)] {
                let mut tracker = build(labels);
                let target = tracker.place([8.0, 7.0, 22.0], 3.0).unwrap();
                assert_eq!(target.voxel, [8, 7, 22]);
                assert!(tracker.solve_to(target.node, &Unwatched).unwrap());
                let path = tracker.tracker().path_to(target.node).unwrap();
                assert_eq!(path[path.len() - 1], target.node);
                if labels.is_none() {
                    assert_eq!(tracker.num_centres(), 0);
                    assert_eq!(target.to_node_mm, 0.0);
                } else {
                    assert!(tracker.num_centres() > 0);
                    assert!(tracker.num_nodes() < full.num_nodes());
                    // The bins of 16 HU and the class of the lumen have the same regions here.
                    assert!(tracker.num_edges() < full.num_edges());
                }
                if matches!(terrain, Terrain::Lumen(_)) {
                    let last = full.place([8.0, 7.0, 22.0], 3.0).unwrap().node;
                    assert!(full.solve_to(last, &Unwatched).unwrap());
                    for node in path {
                        let at = tracker.voxel(node);
                        assert_eq!(lumen[grid.index(at)], 1);
                    }
                }
            }
        }
    }

    #[test]
    fn a_root_outside_the_lumen_and_a_missing_lumen_are_rejected() {
        let (grid, values, lumen) = tube();
        let view = VolumeView::new(&values, &grid).unwrap();
        let half = VoxelBox {
            first_ijk: [0; 3],
            shape_ijk: [17, 15, 12],
        };
        let build = |terrain, lumen, root| {
            GraphTracker::build(
                view,
                terrain,
                Some(Labels::Lumen),
                lumen,
                root,
                2.0,
                &Unwatched,
            )
            .map(|_| ())
        };
        let outside = [8.0, 7.0, 20.0];
        let refused = build(
            Terrain::Paper(half, Reading::Printed),
            Some(&lumen[..]),
            outside,
        )
        .unwrap_err();
        assert_eq!(refused.code(), "usage.track");
        let refused = build(
            Terrain::Paper(half, Reading::Printed),
            None,
            [8.0, 7.0, 2.0],
        )
        .unwrap_err();
        assert_eq!(refused.code(), "usage.track");
        let refused = build(Terrain::Lumen(None), Some(&lumen[..]), [0.0; 3]).unwrap_err();
        assert_eq!(refused.code(), "track.no-result");
    }
}
