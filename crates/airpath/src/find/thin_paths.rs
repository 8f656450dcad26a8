//! Search for voxels of thin airways from the lumen outwards, and least-cost paths through these voxels.
//!
//! The *dip* of a voxel is the output of the tube filter ([`crate::find::tube_filter`]): the rise from the middle of a
//! thin tube to its sides. The *allowance* of a path is the length in mm that it may still pass through voxels without
//! a dip.

use carina_grid::{Grid, InstructionSet};
use carina_leastcost::{TrackError, Watch};
use rayon::prelude::*;

use crate::find::extension_levels::LUMEN;
use crate::find::tube_filter::{BLOCK, TubeFilter};

/// Allowance of a path at its start: the length in mm that it may pass through voxels without a dip.
const FIRST_MM: f32 = 1.0;
/// Maximum allowance of a path, mm; each mm of path without a dip (dark middle) reduces the allowance by `PRICE` mm.
const MAX_MM: f32 = 4.0;
/// Factor of (dip / dip threshold - 1) in the change of a path's allowance per mm of path; a mm of path without a dip
/// thus costs `PRICE` mm.
const PRICE: f32 = 2.0;
/// Maximum increase of a path's allowance per mm of path, in mm.
const MAX_GAIN: f32 = 0.5;
/// Minimum increase of a voxel's allowance, in mm, for which the search visits the voxel again.
const BETTER_MM: f32 = 0.05;

/// Voxel that the search has reached from the lumen.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    pub(crate) voxel: u32,
    pub(crate) dip: i16,
    /// Largest allowance with which a path reaches this voxel, mm.
    left_mm: f32,
}

/// All voxels that a search has reached from the lumen.
#[derive(Debug)]
pub(crate) struct Reached {
    pub(crate) nodes: Vec<Node>,
    /// Index of each reached voxel in `nodes`.
    at: VoxelMap,
    around: Neighbours,
}

impl Reached {
    /// Find the voxels that paths from the lumen can reach; the search ends early with more than `most` voxels.
    ///
    /// `dip_threshold` is the threshold of the dip.
    pub(crate) fn from_lumen(
        grid: &Grid,
        lumen: &[u8],
        dips: &mut Dips<'_>,
        dip_threshold: f64,
        most: usize,
        watch: &impl Watch,
    ) -> Result<Self, TrackError> {
        let around = Neighbours::new(grid);
        let mut at = VoxelMap::new(lumen.len());
        let mut nodes: Vec<Node> = Vec::new();
        let mut wave = Wave::new(lumen.len());
        for here in 0..lumen.len() {
            if lumen[here] == LUMEN {
                around.each(here, |next, _| {
                    if lumen[next] != LUMEN {
                        wave.reach(next as u32, FIRST_MM);
                    }
                });
            }
        }
        while !wave.is_empty() && nodes.len() <= most {
            watch.report_fraction(0.0)?;
            let reached = wave.take();
            dips.measure(&reached);
            for (voxel, left_mm) in reached {
                let Some(dip) = dips.dip_at(voxel) else {
                    continue;
                };
                if let Some(n) = at.get(voxel) {
                    let node = &mut nodes[n as usize];
                    if left_mm <= node.left_mm + BETTER_MM {
                        continue;
                    }
                    node.left_mm = left_mm;
                } else {
                    at.set(voxel, nodes.len() as u32);
                    nodes.push(Node {
                        voxel,
                        dip,
                        left_mm,
                    });
                }
                let per_mm = PRICE * (f32::from(dip) / dip_threshold as f32 - 1.0);
                around.each(voxel as usize, |next, step_mm| {
                    let left_mm = (left_mm + step_mm * per_mm.min(MAX_GAIN)).min(MAX_MM);
                    if left_mm >= 0.0
                        && lumen[next] != LUMEN
                        && at
                            .get(next as u32)
                            .is_none_or(|n| left_mm > nodes[n as usize].left_mm + BETTER_MM)
                    {
                        wave.reach(next as u32, left_mm);
                    }
                });
            }
        }
        Ok(Self { nodes, at, around })
    }

    /// Call `visit` with each reached neighbour of a node and its distance in mm.
    pub(crate) fn for_each_neighbour(&self, node: u32, mut visit: impl FnMut(u32, f32)) {
        self.around
            .each(self.nodes[node as usize].voxel as usize, |next, step_mm| {
                if let Some(n) = self.at.get(next as u32) {
                    visit(n, step_mm);
                }
            });
    }

    /// Compute the least-cost paths from the lumen to all reached voxels; `dip_threshold` is the minimum dip of an
    /// airway.
    pub(crate) fn path_tree(&self, lumen: &[u8], dip_threshold: f64) -> PathTree {
        let num = self.nodes.len();
        let mut paths = PathTree {
            before: vec![None; num],
            along_mm: vec![f32::INFINITY; num],
        };
        // The cost is length in micrometres times weight, as an integer, because integers have a total order.
        let mut found: Vec<Found> = self
            .nodes
            .iter()
            .map(|node| Found {
                cost: u64::MAX,
                weight: 1.0
                    + (2.0 * dip_threshold / f64::from(node.dip.max(1)))
                        .min(4.0)
                        .powi(2),
            })
            .collect();
        let mut open = Buckets::new(1e3 * f64::from(self.around.nearest_mm()));
        for (n, node) in self.nodes.iter().enumerate() {
            let mut from_mm = f32::INFINITY;
            self.around.each(node.voxel as usize, |next, step_mm| {
                if lumen[next] == LUMEN {
                    from_mm = from_mm.min(step_mm);
                }
            });
            if from_mm.is_finite() {
                found[n].cost = (1e3 * f64::from(from_mm) * found[n].weight) as u64;
                paths.along_mm[n] = from_mm;
                open.push(found[n].cost, n as u32);
            }
        }
        while let Some(bucket) = open.pop() {
            for (here, n) in bucket {
                let Found { cost, weight: own } = found[n as usize];
                if here != cost {
                    continue;
                }
                self.for_each_neighbour(n, |m, step_mm| {
                    let neighbour = &mut found[m as usize];
                    if neighbour.cost <= here {
                        return;
                    }
                    let mean = 0.5 * (own + neighbour.weight);
                    let there = here + (1e3 * f64::from(step_mm) * mean) as u64;
                    if there < neighbour.cost {
                        neighbour.cost = there;
                        paths.before[m as usize] = Some(n);
                        paths.along_mm[m as usize] = paths.along_mm[n as usize] + step_mm;
                        open.push(there, m);
                    }
                });
            }
        }
        paths
    }
}

/// Cost of the least-cost path to a node, and the weight of the node.
#[derive(Debug, Clone, Copy)]
struct Found {
    cost: u64,
    /// Cost of the path per mm at this node, 1 or more.
    weight: f64,
}

/// Priority queue by cost, divided into buckets of nodes with similar cost.
///
/// A bucket is so narrow that every step leads to a later bucket. A bucket that is sorted once therefore stays in
/// order.
#[derive(Debug)]
struct Buckets {
    width: u64,
    open: Vec<Vec<(u64, u32)>>,
    front: usize,
}

impl Buckets {
    /// Create an empty queue; `least` is a lower bound of the cost of a step.
    fn new(least: f64) -> Self {
        Self {
            width: (least as u64).max(1),
            open: Vec::new(),
            front: 0,
        }
    }

    fn push(&mut self, cost: u64, node: u32) {
        let bucket = (cost / self.width) as usize;
        if bucket >= self.open.len() {
            self.open.resize_with(bucket + 1, Vec::new);
        }
        self.open[bucket].push((cost, node));
    }

    /// Remove and return the bucket with the lowest costs, as pairs (cost, node number) in ascending order; `None` if
    /// the queue is empty.
    fn pop(&mut self) -> Option<Vec<(u64, u32)>> {
        let ahead = self.open[self.front..].iter().position(|b| !b.is_empty())?;
        self.front += ahead + 1;
        let mut bucket = std::mem::take(&mut self.open[self.front - 1]);
        bucket.sort_unstable();
        Some(bucket)
    }
}

/// Least-cost paths to all nodes, each stored as its previous node and its length.
#[derive(Debug)]
pub(crate) struct PathTree {
    /// Previous node on the path; `None` for a node beside the lumen.
    pub(crate) before: Vec<Option<u32>>,
    /// Length in mm of the path from the lumen to each node.
    pub(crate) along_mm: Vec<f32>,
}

/// Offsets of the neighbours of a voxel by faces, edges and corners, and their distances.
#[derive(Debug)]
pub(crate) struct Neighbours {
    shape: [isize; 3],
    steps: Vec<([isize; 3], f32)>,
    /// Memory offsets and distances of the same neighbours, for voxels that are not at a face of the volume.
    in_memory: Vec<(isize, f32)>,
}

impl Neighbours {
    pub(crate) fn new(grid: &Grid) -> Self {
        let spacing = grid.spacing_mm();
        let shape = grid.shape_ijk().map(|n| n as isize);
        let steps: Vec<([isize; 3], f32)> = (0..27isize)
            .filter(|n| *n != 13)
            .map(|n| {
                let step = [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1];
                let mm = std::array::from_fn(|a| step[a] as f64 * spacing[a]);
                (step, carina_grid::length(mm) as f32)
            })
            .collect();
        let [nx, ny, _] = shape;
        let in_memory = steps
            .iter()
            .map(|([i, j, k], mm)| (i + nx * (j + ny * k), *mm))
            .collect();
        Self {
            shape,
            steps,
            in_memory,
        }
    }

    /// Return the distance of the nearest neighbour in mm.
    fn nearest_mm(&self) -> f32 {
        self.steps
            .iter()
            .fold(f32::INFINITY, |least, (_, mm)| least.min(*mm))
    }

    pub(crate) fn each(&self, at: usize, mut visit: impl FnMut(usize, f32)) {
        let [nx, ny, nz] = self.shape;
        let at = at as isize;
        let (i, j, k) = (at % nx, at / nx % ny, at / nx / ny);
        let is_within = |at: isize, num: isize| 0 < at && at < num - 1;
        if is_within(i, nx) && is_within(j, ny) && is_within(k, nz) {
            for (step, step_mm) in &self.in_memory {
                visit((at + step) as usize, *step_mm);
            }
            return;
        }
        for ([di, dj, dk], step_mm) in &self.steps {
            let (x, y, z) = (i + di, j + dj, k + dk);
            if (0..nx).contains(&x) && (0..ny).contains(&y) && (0..nz).contains(&z) {
                visit((x + nx * (y + ny * z)) as usize, *step_mm);
            }
        }
    }
}

/// Cache of the dips (rises in value from a tube's middle to its sides) of voxels that are dark enough for a lumen.
pub(crate) struct Dips<'a> {
    filter: &'a TubeFilter,
    values: &'a [i16],
    smooth: &'a [i16],
    /// Smoothed voxel value above which a voxel cannot be lumen.
    brightest: i16,
    simd: InstructionSet,
    /// Dips in blocks of voxels that are consecutive in memory; the search soon needs the neighbours of a voxel too.
    known: Vec<[i16; BLOCK]>,
    /// Index of each block in `known`.
    at: VoxelMap,
}

impl<'a> Dips<'a> {
    pub(crate) fn new(
        filter: &'a TubeFilter,
        values: &'a [i16],
        smooth: &'a [i16],
        brightest: i16,
    ) -> Self {
        Self {
            filter,
            values,
            smooth,
            brightest,
            simd: InstructionSet::best(),
            known: Vec::new(),
            at: VoxelMap::new(values.len().div_ceil(BLOCK)),
        }
    }

    /// Compute and store the dips of those voxels that are not cached; `voxels` must be in memory order.
    fn measure(&mut self, voxels: &[(u32, f32)]) {
        let is_dark = |voxel: u32| self.smooth[voxel as usize] <= self.brightest;
        let mut blocks: Vec<u32> = voxels
            .iter()
            .filter(|(voxel, _)| is_dark(*voxel))
            .map(|(voxel, _)| voxel / BLOCK as u32)
            .filter(|block| self.at.get(*block).is_none())
            .collect();
        blocks.dedup();
        for (n, block) in (self.known.len() as u32..).zip(&blocks) {
            self.at.set(*block, n);
        }
        let (filter, values, simd) = (self.filter, self.values, self.simd);
        self.known.par_extend(
            blocks
                .par_iter()
                .map(|block| filter.dips(simd, values, *block as usize * BLOCK)),
        );
    }

    /// Return the dip of a measured voxel; `None` if the voxel is too bright for a lumen.
    fn dip_at(&self, voxel: u32) -> Option<i16> {
        let block = self.at.get(voxel / BLOCK as u32)?;
        (self.smooth[voxel as usize] <= self.brightest)
            .then(|| self.known[block as usize][voxel as usize % BLOCK])
    }
}

/// Set of the voxels that the search visits next.
#[derive(Debug)]
struct Wave {
    reached: Vec<(u32, f32)>,
    /// Index of each voxel in the list of this wave.
    at: VoxelMap,
}

impl Wave {
    fn new(num_voxels: usize) -> Self {
        Self {
            reached: Vec::new(),
            at: VoxelMap::new(num_voxels),
        }
    }

    const fn is_empty(&self) -> bool {
        self.reached.is_empty()
    }

    /// Add a voxel with its allowance in mm; a voxel that is already in the set keeps the larger allowance.
    fn reach(&mut self, voxel: u32, left_mm: f32) {
        if let Some(n) = self.at.get(voxel) {
            let best_mm = &mut self.reached[n as usize].1;
            *best_mm = best_mm.max(left_mm);
        } else {
            self.at.set(voxel, self.reached.len() as u32);
            self.reached.push((voxel, left_mm));
        }
    }

    /// Remove and return all voxels with their allowances, in memory order.
    fn take(&mut self) -> Vec<(u32, f32)> {
        let mut reached = std::mem::take(&mut self.reached);
        for (voxel, _) in &reached {
            self.at.set(*voxel, NONE);
        }
        reached.sort_unstable_by_key(|(voxel, _)| *voxel);
        reached
    }
}

/// Number of consecutive voxels of one block of a [`VoxelMap`].
const TILE: usize = 256;
/// Value of an entry whose voxel has no number.
const NONE: u32 = u32::MAX;

/// Map from voxels of a volume to numbers, which uses memory only for the blocks that have entries.
#[derive(Debug)]
struct VoxelMap {
    tiles: Vec<Option<Box<[u32; TILE]>>>,
}

impl VoxelMap {
    fn new(num_voxels: usize) -> Self {
        Self {
            tiles: (0..num_voxels.div_ceil(TILE)).map(|_| None).collect(),
        }
    }

    fn get(&self, voxel: u32) -> Option<u32> {
        let tile = self.tiles[voxel as usize / TILE].as_ref()?;
        let number = tile[voxel as usize % TILE];
        (number != NONE).then_some(number)
    }

    fn set(&mut self, voxel: u32, number: u32) {
        let tile = self.tiles[voxel as usize / TILE].get_or_insert_with(|| Box::new([NONE; TILE]));
        tile[voxel as usize % TILE] = number;
    }
}
