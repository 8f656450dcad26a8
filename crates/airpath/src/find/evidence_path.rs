//! Search for the path from a lung position to the lumen along which the CT shows most airway wall
//! (docs/decisions/0140).
//!
//! The measure of wall is the enclosure of a voxel ([`crate::find::tubeness`]), which the extension of the lumen uses
//! as well: the rise of the values on all but a fifth of the rays from the voxel. The cost of a step is low where the
//! enclosure is high, and where the values are as dark as the air of a wide airway, which rays of 3 mm do not cross.
//! The cost is high in lung without a wall and higher towards tissue. The enclosure of a voxel does not depend on the
//! start of a search, so it is cached: while the pointer moves, successive searches visit mostly the same voxels.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};
use std::sync::{Mutex, PoisonError};

use carina_grid::{Grid, VolumeView};
use rayon::prelude::*;

use crate::find::tubeness::{Enclosure, REACH_MM, smoothed};
use carina_leastcost::ordered_cost::OrderedCost;
use carina_leastcost::{TrackError, Watch};

/// Voxel values that determine the cost of a step of a path, in the CT's numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WayLevels {
    /// Rise in value from a voxel to the walls round it that most lung voxels do not reach; the cost is lowest at twice
    /// this rise.
    pub enclosed: f64,
    /// Maximum voxel value of the air in a wide airway; such a voxel has a low cost even without a wall.
    pub dark: f64,
    /// Voxel value above which the cost of a step increases with the brightness.
    pub bright: f64,
    /// Voxel value above which a path may not enter a voxel.
    pub closed: f64,
}

/// Cost per mm of a voxel without any wall round it; the middle of an airway costs 1.
const NO_WALL_WEIGHT: f64 = 25.0;
/// Maximum cost per mm of a voxel that is as dark as the air of a wide airway, even if no wall surrounds it.
const DARK_WEIGHT: f64 = 1.5;
/// Additional cost per mm of a voxel that is about as bright as tissue.
const BRIGHT_WEIGHT: f64 = 6.0;
/// Number of voxels after which a search that has met no lumen favours steps towards a given position in the lumen.
const STRAIGHT_AFTER_VOXELS: usize = 25_000;
/// Maximum number of voxels of a search; a search that needs more stops without a result, because tissue separates its
/// start from the lumen.
const MAX_VOXELS: usize = 300_000;
/// Edge length of a block of voxels in the cache of weights, in voxels.
const BLOCK: usize = 8;
/// Number of voxels of one block in the cache of weights.
const BLOCK_VOXELS: usize = BLOCK * BLOCK * BLOCK;
/// Value of a voxel whose enclosure (rise in value to the walls round it) has not been computed.
const UNKNOWN: i16 = i16::MIN;
/// Value of the voxel at which a search starts, to which no step leads.
const NO_STEP: u8 = 255;

/// Lumen voxels at the tips of branches; a path that ends at a tip is preferred to one that ends at a side wall.
#[derive(Debug, Clone, Default)]
pub struct PreferredTips {
    /// Indices of the lumen voxels at the tips of branches.
    pub voxels: HashSet<[usize; 3]>,
    /// Amount by which the cost of a path to a tip may exceed that of the cheapest path to any lumen.
    pub allowance: f64,
}

/// Smoothed copy of a volume, with a cache of its voxels' enclosures (the rise in value to the walls round a voxel).
#[derive(Debug)]
pub struct Enclosures {
    grid: Grid,
    smooth: Vec<i16>,
    enclosure: Enclosure,
    search: Mutex<Search>,
}

/// Least-cost path from the lumen to a position in the lung.
#[derive(Debug, Clone, PartialEq)]
pub struct EvidencePath {
    /// Voxels of the path; the first is in the lumen.
    pub voxels: Vec<[usize; 3]>,
    /// Cost of the path: the sum over its steps of length in mm times weight.
    pub cost: f64,
}

impl Enclosures {
    /// Create the smoothed copy of a volume and an empty cache of enclosures.
    #[must_use]
    pub fn new(values: VolumeView<'_, i16>) -> Self {
        let grid = values.grid().clone();
        Self {
            smooth: smoothed(values),
            enclosure: Enclosure::new(&grid, REACH_MM),
            search: Mutex::new(Search::new(&grid)),
            grid,
        }
    }

    /// Return the grid of the volume.
    #[must_use]
    pub const fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Return the smoothed copy of the volume.
    #[must_use]
    pub fn smooth(&self) -> VolumeView<'_, i16> {
        VolumeView::new(&self.smooth, &self.grid).expect("made on this grid")
    }

    /// Return the trilinear value of the smoothed volume at a position; outside the volume, the nearest edge value.
    #[must_use]
    pub fn value_at(&self, ijk: [f64; 3]) -> f32 {
        carina_leastcost::lumen::interpolated(self.smooth(), ijk)
    }

    /// Return the enclosure of a voxel: the rise in value that all but a fifth of the rays from the voxel meet.
    #[must_use]
    pub fn at(&self, voxel: [usize; 3]) -> i16 {
        let [nx, ny, _] = self.grid.shape_ijk();
        self.enclosure
            .at(&self.smooth, voxel[0] + nx * (voxel[1] + ny * voxel[2]))
    }

    /// Return the cost per mm of a voxel with this value and enclosure (`rise`); 0 for a voxel that no path may enter.
    #[must_use]
    pub fn weight(&self, levels: WayLevels, value: f64, rise: f64) -> f64 {
        if value > levels.closed {
            return 0.0;
        }
        let seen = (0.5 * rise / levels.enclosed).clamp(0.0, 1.0);
        let bright = ((value - levels.bright) / (levels.closed - levels.bright)).clamp(0.0, 1.0);
        let weight =
            1.0 + (NO_WALL_WEIGHT - 1.0) * (1.0 - seen).powi(2) + BRIGHT_WEIGHT * bright * bright;
        if value <= levels.dark {
            weight.min(DARK_WEIGHT)
        } else {
            weight
        }
    }

    /// Find the least-cost path from the lumen to `start`; return `None` if there is none.
    ///
    /// A path to one of `tips` is preferred within their allowance, because a branch continues beyond its tip more
    /// often than a fork is missing on its wall.
    ///
    /// If an airway leads to `start`, the search finds it quickly. If the search has met no lumen after `STRAIGHT_AFTER_VOXELS`
    /// voxels, it heads for `toward`, a position in the lumen. The resulting path then follows no airway and need not
    /// be the cheapest of all.
    ///
    /// A step costs its length in mm times the mean weight of its two voxels. Of equally cheap paths the result is the
    /// one whose last voxels come first in array order.
    ///
    /// # Errors
    ///
    /// Returns an error if `watch` stops the search.
    pub fn way(
        &self,
        start: [usize; 3],
        toward: [usize; 3],
        levels: WayLevels,
        is_lumen: impl Fn([usize; 3]) -> bool,
        tips: &PreferredTips,
        watch: &impl Watch,
    ) -> Result<Option<EvidencePath>, TrackError> {
        let mut search = self.search.lock().unwrap_or_else(PoisonError::into_inner);
        self.cheapest(
            &mut search,
            start,
            Some((toward, tips)),
            levels,
            is_lumen,
            watch,
        )
    }

    /// Find for each start the least-cost path to any voxel, lumen or not, at a distance of `away_mm` from the start.
    ///
    /// The costs of these paths show what a path through lung alone costs. Each path begins at its far end. The result
    /// is `None` for a start without such a path.
    ///
    /// # Errors
    ///
    /// Returns an error if `watch` stops the search.
    pub fn runs(
        &self,
        starts: &[[usize; 3]],
        away_mm: f64,
        levels: WayLevels,
        watch: &impl Watch,
    ) -> Result<Vec<Option<EvidencePath>>, TrackError> {
        let spacing = self.grid.spacing_mm();
        starts
            .par_iter()
            .map(|start| {
                let is_far = |voxel: [usize; 3]| {
                    let off: [f64; 3] =
                        std::array::from_fn(|a| (voxel[a] as f64 - start[a] as f64) * spacing[a]);
                    carina_grid::length(off) >= away_mm
                };
                let mut search = Search::new(&self.grid);
                self.cheapest(&mut search, *start, None, levels, is_far, watch)
            })
            .collect()
    }

    fn cheapest(
        &self,
        search: &mut Search,
        start: [usize; 3],
        toward_and_tips: Option<([usize; 3], &PreferredTips)>,
        levels: WayLevels,
        is_lumen: impl Fn([usize; 3]) -> bool,
        watch: &impl Watch,
    ) -> Result<Option<EvidencePath>, TrackError> {
        search.begin();
        let [nx, ny, nz] = self.grid.shape_ijk();
        let spacing = self.grid.spacing_mm();
        let steps: Vec<([isize; 3], f64)> = (0..27isize)
            .map(|n| {
                let offset = [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1];
                let mm = std::array::from_fn(|a| offset[a] as f64 * spacing[a]);
                (offset, carina_grid::length(mm))
            })
            .collect();
        let mut open = BinaryHeap::new();
        search.reach(start, 0.0, NO_STEP);
        let first = self.weight_of(search, start, levels, &is_lumen);
        if first <= 0.0 {
            return Ok(None);
        }
        let voxel_of = |at: u32| {
            [
                at as usize % nx,
                at as usize / nx % ny,
                at as usize / nx / ny,
            ]
        };
        let mut aim: Option<[usize; 3]> = None;
        let left = |aim: Option<[usize; 3]>, voxel: [usize; 3]| {
            aim.map_or(0.0, |aim| {
                let off: [f64; 3] =
                    std::array::from_fn(|a| (aim[a] as f64 - voxel[a] as f64) * spacing[a]);
                NO_WALL_WEIGHT * carina_grid::length(off)
            })
        };
        open.push(Reverse((
            OrderedCost(0.0),
            index(start, nx, ny) as u32,
            OrderedCost(0.0),
        )));
        let mut num_popped = 0usize;
        let mut best: Option<([usize; 3], f64)> = None;
        while let Some(Reverse((_, at, OrderedCost(here)))) = open.pop() {
            let voxel = voxel_of(at);
            if here > search.cost(voxel) {
                continue;
            }
            if let (Some((_, least)), Some((_, tips))) = (best, toward_and_tips)
                && here > least + tips.allowance
            {
                break;
            }
            num_popped += 1;
            if num_popped.is_multiple_of(1 << 13) {
                watch.report_fraction(0.5)?;
            }
            if num_popped > MAX_VOXELS {
                break;
            }
            if num_popped == STRAIGHT_AFTER_VOXELS && toward_and_tips.is_some() && best.is_none() {
                aim = toward_and_tips.map(|(toward, _)| toward);
                open = open
                    .drain()
                    .map(|Reverse((_, at, cost))| {
                        Reverse((OrderedCost(cost.0 + left(aim, voxel_of(at))), at, cost))
                    })
                    .collect();
            }
            let weight = f64::from(search.weight(voxel));
            if weight < 0.0 {
                let is_tip = toward_and_tips
                    .is_none_or(|(_, tips)| tips.voxels.is_empty() || tips.voxels.contains(&voxel));
                if is_tip {
                    best = Some((voxel, here));
                    break;
                }
                best = best.or(Some((voxel, here)));
                continue;
            }
            for (n, (offset, step_mm)) in steps.iter().enumerate() {
                let to: [isize; 3] = std::array::from_fn(|a| voxel[a] as isize + offset[a]);
                if n == 13 || to[0] < 0 || to[1] < 0 || to[2] < 0 {
                    continue;
                }
                let to = to.map(|v| v as usize);
                if to[0] >= nx || to[1] >= ny || to[2] >= nz {
                    continue;
                }
                let (block, cell) = search.block_and_cell(to);
                let known = search.blocks[block].known_cost(cell, search.round);
                if known <= here {
                    continue;
                }
                let there = self.weight_in_block(search, (block, cell), to, levels, &is_lumen);
                if there == 0.0 {
                    continue;
                }
                // A lumen voxel has the weight of an airway's middle, 1.
                let through =
                    here + step_mm * 0.5 * (weight + if there < 0.0 { 1.0 } else { there });
                // Costs are stored as f32 and must be compared as f32, so that each voxel is reached once.
                let through = f64::from(through as f32);
                if through < known {
                    search.reach(to, through, n as u8);
                    open.push(Reverse((
                        OrderedCost(through + left(aim, to)),
                        index(to, nx, ny) as u32,
                        OrderedCost(through),
                    )));
                }
            }
        }
        Ok(best.map(|(voxel, cost)| EvidencePath {
            voxels: search.back(voxel, &steps),
            cost,
        }))
    }

    /// Return the cost per mm of a voxel, computed once per search; a negative number for a voxel of the lumen.
    fn weight_of(
        &self,
        search: &mut Search,
        voxel: [usize; 3],
        levels: WayLevels,
        is_goal: &impl Fn([usize; 3]) -> bool,
    ) -> f64 {
        let (block, cell) = search.block_and_cell(voxel);
        self.weight_in_block(search, (block, cell), voxel, levels, is_goal)
    }

    fn weight_in_block(
        &self,
        search: &mut Search,
        (block, cell): (usize, usize),
        voxel: [usize; 3],
        levels: WayLevels,
        is_goal: &impl Fn([usize; 3]) -> bool,
    ) -> f64 {
        let known = search.blocks[block].weight[cell];
        if search.blocks[block].seen[cell] == search.round {
            return f64::from(known);
        }
        let weight = if is_goal(voxel) {
            -1.0
        } else {
            let [nx, ny, _] = self.grid.shape_ijk();
            let at = index(voxel, nx, ny);
            let value = f64::from(self.smooth[at]);
            let mut rise = search.blocks[block].rise[cell];
            if rise == UNKNOWN && value <= levels.closed {
                rise = self.enclosure.at(&self.smooth, at).max(UNKNOWN + 1);
                search.blocks[block].rise[cell] = rise;
            }
            self.weight(levels, value, f64::from(rise))
        };
        search.blocks[block].seen[cell] = search.round;
        search.blocks[block].weight[cell] = weight as f32;
        weight
    }
}

const fn index(voxel: [usize; 3], nx: usize, ny: usize) -> usize {
    voxel[0] + nx * (voxel[1] + ny * voxel[2])
}

/// Costs, weights and enclosures of the voxels that a search has visited.
///
/// Only the enclosures are reused by the next search.
#[derive(Debug)]
struct Search {
    num_blocks: [usize; 3],
    /// For each block of the volume, its index in `blocks` plus one; 0 if the block is not stored.
    block_of: Vec<u32>,
    last: (u32, u32),
    blocks: Vec<Block>,
    round: u32,
}

#[derive(Debug)]
struct Block {
    rise: [i16; BLOCK_VOXELS],
    /// Number of the last search that computed the weight of each voxel.
    seen: [u32; BLOCK_VOXELS],
    /// Number of the last search that reached each voxel.
    met: [u32; BLOCK_VOXELS],
    weight: [f32; BLOCK_VOXELS],
    cost: [f32; BLOCK_VOXELS],
    before: [u8; BLOCK_VOXELS],
}

impl Block {
    fn known_cost(&self, cell: usize, round: u32) -> f64 {
        if self.met[cell] == round {
            f64::from(self.cost[cell])
        } else {
            f64::INFINITY
        }
    }
}

impl Search {
    fn new(grid: &Grid) -> Self {
        let num_blocks = grid.shape_ijk().map(|n| n.div_ceil(BLOCK));
        Self {
            block_of: vec![0; num_blocks.iter().product()],
            num_blocks,
            last: (u32::MAX, 0),
            blocks: Vec::new(),
            round: 0,
        }
    }

    fn begin(&mut self) {
        self.round += 1;
        // A block takes 9 KiB, so the cache is cleared when searches have covered much of a large volume.
        if self.blocks.len() > 10_000 {
            self.blocks.clear();
            self.block_of.fill(0);
            self.last = (u32::MAX, 0);
        }
    }

    fn block_and_cell(&mut self, voxel: [usize; 3]) -> (usize, usize) {
        let [x, y, z] = voxel.map(|v| v / BLOCK);
        let key = (x + self.num_blocks[0] * (y + self.num_blocks[1] * z)) as u32;
        if self.last.0 != key {
            if self.block_of[key as usize] == 0 {
                self.blocks.push(Block {
                    rise: [UNKNOWN; BLOCK_VOXELS],
                    seen: [0; BLOCK_VOXELS],
                    met: [0; BLOCK_VOXELS],
                    weight: [0.0; BLOCK_VOXELS],
                    cost: [0.0; BLOCK_VOXELS],
                    before: [NO_STEP; BLOCK_VOXELS],
                });
                self.block_of[key as usize] = self.blocks.len() as u32;
            }
            let place = self.block_of[key as usize] - 1;
            self.last = (key, place);
        }
        let [i, j, k] = voxel.map(|v| v % BLOCK);
        (self.last.1 as usize, i + BLOCK * (j + BLOCK * k))
    }

    fn cost(&mut self, voxel: [usize; 3]) -> f64 {
        let (block, cell) = self.block_and_cell(voxel);
        self.blocks[block].known_cost(cell, self.round)
    }

    fn weight(&mut self, voxel: [usize; 3]) -> f32 {
        let (block, cell) = self.block_and_cell(voxel);
        self.blocks[block].weight[cell]
    }

    fn reach(&mut self, voxel: [usize; 3], cost: f64, step: u8) {
        let (block, cell) = self.block_and_cell(voxel);
        let round = self.round;
        let block = &mut self.blocks[block];
        block.met[cell] = round;
        block.cost[cell] = cost as f32;
        block.before[cell] = step;
    }

    /// Return the voxels of the path from a voxel back to the start of the search.
    fn back(&mut self, from: [usize; 3], steps: &[([isize; 3], f64)]) -> Vec<[usize; 3]> {
        let mut found = vec![from];
        let mut voxel = from;
        loop {
            let (block, cell) = self.block_and_cell(voxel);
            let step = self.blocks[block].before[cell];
            if step == NO_STEP {
                return found;
            }
            let offset = steps[step as usize].0;
            voxel = std::array::from_fn(|a| (voxel[a] as isize - offset[a]) as usize);
            found.push(voxel);
        }
    }
}

#[cfg(test)]
mod tests {
    use carina_grid::Affine;
    use proptest::prelude::*;

    use super::*;
    use carina_leastcost::Unwatched;

    /// Compute the least cost to reach any goal, by relaxing every step until no cost changes.
    fn least_cost(
        found: &Enclosures,
        start: [usize; 3],
        levels: WayLevels,
        is_goal: impl Fn([usize; 3]) -> bool,
        is_closed: impl Fn([usize; 3]) -> bool,
    ) -> f64 {
        let grid = found.grid();
        let [nx, ny, _] = grid.shape_ijk();
        let spacing = grid.spacing_mm();
        let weights: Vec<f64> = (0..grid.num_voxels())
            .map(|at| {
                let voxel = grid.voxel(at);
                if is_goal(voxel) {
                    return 1.0;
                }
                if is_closed(voxel) {
                    return 0.0;
                }
                let value = f64::from(found.smooth().at(voxel));
                found.weight(levels, value, f64::from(found.at(voxel)))
            })
            .collect();
        let mut cost = vec![f64::INFINITY; weights.len()];
        cost[index(start, nx, ny)] = 0.0;
        loop {
            let mut changed = false;
            for a in 0..cost.len() {
                if cost[a].is_infinite() || is_goal(grid.voxel(a)) {
                    continue;
                }
                for b in 0..cost.len() {
                    let (u, v) = (grid.voxel(a), grid.voxel(b));
                    let off: [isize; 3] = std::array::from_fn(|x| v[x] as isize - u[x] as isize);
                    if a == b || weights[b] <= 0.0 || off.iter().any(|o| o.abs() > 1) {
                        continue;
                    }
                    let mm = std::array::from_fn(|x| off[x] as f64 * spacing[x]);
                    let through =
                        cost[a] + carina_grid::length(mm) * 0.5 * (weights[a] + weights[b]);
                    if through < cost[b] - 1e-9 {
                        cost[b] = through;
                        changed = true;
                    }
                }
            }
            if !changed {
                break;
            }
        }
        (0..cost.len())
            .filter(|n| is_goal(grid.voxel(*n)))
            .map(|n| cost[n])
            .fold(f64::INFINITY, f64::min)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_path_with_most_wall_costs_as_much_as_in_an_exhaustive_search_also_to_a_preferred_tip(
            seed in 0u64..1000,
            spacing in proptest::array::uniform3(0.5f64..3.0),
            allowance in 0.0f64..60.0,
        ) {
            let [x, y, z] = spacing;
            let place = Affine::from_columns(
                [x, 0.0, 0.0],
                [0.0, y, 0.0],
                [0.0, 0.0, z],
                [3.0, -4.0, 5.0],
            );
            let grid = Grid::new([5, 6, 7], place).unwrap();
            let mut state = seed;
            let values: Vec<i16> = (0..grid.num_voxels())
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    ((state >> 40) % 900) as i16 - 1000
                })
                .collect();
            let found = Enclosures::new(VolumeView::new(&values, &grid).unwrap());
            let levels = WayLevels { enclosed: 60.0, dark: -950.0, bright: -800.0, closed: -300.0 };
            let is_goal = |voxel: [usize; 3]| voxel[0] == 0;
            let start = [6, 3, 2];
            let is_tip = |voxel: [usize; 3]| voxel[0] == 0 && voxel[1] >= 4;
            let tips = PreferredTips {
                voxels: (0..grid.num_voxels()).map(|at| grid.voxel(at)).filter(|v| is_tip(*v)).collect(),
                allowance,
            };
            let to_lumen = least_cost(&found, start, levels, is_goal, |_| false);
            let to_tip = least_cost(&found, start, levels, is_tip, is_goal);
            let slow = if to_tip <= to_lumen + allowance { to_tip } else { to_lumen };
            // The sums of the two searches are rounded differently.
            prop_assume!((to_tip - to_lumen - allowance).abs() > 1e-3 || to_tip.is_infinite());
            // Two searches, because the data that the first one leaves must not change the result of the second.
            for _ in 0..2 {
                match found.way(start, [0, 3, 2], levels, is_goal, &tips, &Unwatched).unwrap() {
                    Some(way) => {
                        prop_assert!((way.cost - slow).abs() <= 1e-4 * slow, "{} {slow}", way.cost);
                        prop_assert!(is_goal(way.voxels[0]));
                        prop_assert_eq!(*way.voxels.last().unwrap(), start);
                        for pair in way.voxels.windows(2) {
                            prop_assert!((0..3).all(|a| pair[0][a].abs_diff(pair[1][a]) <= 1));
                        }
                    }
                    None => prop_assert!(
                        slow.is_infinite() || f64::from(found.smooth().at(start)) > levels.closed
                    ),
                }
            }
        }
    }
}
