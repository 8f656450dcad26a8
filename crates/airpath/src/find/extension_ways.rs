//! Least-cost paths from the lumen through the reached voxels, and the lumen round the paths that count as airways.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use carina_grid::VolumeView;

use crate::find::extension_levels::{Divided, ExtensionLimits, Followed, LUMEN, Levels, PENDING};
use crate::find::extension_reach::{Faces, Node, places};
use crate::find::extension_verdict::{
    Blur, WAY_WEIGHTS, WAY_WEIGHTS_DIVIDED, log_odds, looks_like_airway, probability_of_way,
};
use crate::find::thin_profile::Profile;
use crate::find::tubeness::{REACH_MM, Section, section};
use carina_leastcost::{TrackError, Watch};

/// Value of a node without a previous node: the node touches the lumen, or no path leads to it.
const NONE: u32 = u32::MAX;
/// Distance from a path, through voxels enclosed by walls, up to which voxels belong to the tube of the path, mm.
const COVER_MM: f32 = 3.0;
/// Maximum distance of an added lumen voxel from its path, as a multiple of the lumen's radius, along steps between
/// face neighbours.
const FILL_RADII: f64 = 1.5;
/// Number of path voxels on each side over whose median the level half-way up the wall is smoothed.
const FILL_NODES: usize = 2;
/// Length of path before and after a voxel over which the direction of the path is measured, mm.
const TANGENT_MM: f64 = 2.0;
/// Length of the first part of a path, mm, that is ignored when the distance of the path from known lumens is measured.
///
/// This first part is beside the airway from which the path branches.
const BEYOND_MM: f64 = 5.0;
/// Upper limit of the measured distance of a path from known lumens, mm.
const CLEAR_MM: f64 = 6.0;
/// Radius round a path of the region in which the share of reached lung voxels is measured, mm.
const AROUND_MM: f64 = 8.0;
/// Maximum gain of a path by one voxel (the amount by which the voxel speaks for an airway), as a multiple of the
/// enclosure threshold.
///
/// The limit prevents that one bright wall compensates for a long part without wall.
const MAX_GAIN: f64 = 3.0;
/// Maximum fall of a path's summed gain below its maximum in divided slices, as a multiple of the enclosure threshold
/// times mm.
///
/// A path ends after a larger fall. The gain is the sum of the evidence of its voxels, which is negative in lung.
/// An airway farther on does not belong to this path (docs/decisions/0112).
const MAX_LOSS_MM: f64 = 12.0;

/// Accepted path of an airway; its nodes are indices in the list of reached voxels.
#[derive(Debug, Clone)]
pub(crate) struct Path {
    nodes: Vec<u32>,
    /// Radius of the lumen at each voxel of the path, mm.
    radius_mm: Vec<f64>,
    length_mm: f64,
    /// Probability that this path and all paths from which it branches are airways.
    probability: f64,
}

impl Path {
    pub(crate) fn report(self, reached: &[Node], levels: Levels) -> Followed {
        let rises: f64 = self
            .nodes
            .iter()
            .map(|n| f64::from(reached[*n as usize].rise))
            .sum();
        Followed {
            contrast: rises / self.nodes.len().max(1) as f64 / f64::from(levels.followed),
            voxels: self
                .nodes
                .iter()
                .map(|n| reached[*n as usize].voxel)
                .collect(),
            length_mm: self.length_mm,
            probability: self.probability,
        }
    }
}

/// Cross-section of a path at one of its voxels, and the direction of the path there.
struct WaySection {
    /// Direction of the path, a unit vector in mm on the grid's axes.
    along: [f64; 3],
    section: Section,
}

/// Search for the least-cost paths from the lumen through the reached voxels.
pub(crate) struct Search<'a> {
    values: VolumeView<'a, i16>,
    smooth: VolumeView<'a, i16>,
    /// State of each voxel of the volume, such as [`LUMEN`] (see [`crate::find::extension_levels`]), or 0.
    states: &'a [u8],
    faces: Faces,
    reached: &'a [Node],
    levels: Levels,
    at: HashMap<u32, u32>,
    before: Vec<u32>,
    along_mm: Vec<f32>,
    /// For each reached voxel, the probability of the accepted path that contains it; 0 if no path contains it.
    accepted: Vec<f64>,
}

impl<'a> Search<'a> {
    pub(crate) fn new(
        values: VolumeView<'a, i16>,
        smooth: VolumeView<'a, i16>,
        states: &'a [u8],
        reached: &'a [Node],
        is_open: &[bool],
        levels: Levels,
    ) -> Self {
        let faces = Faces::new(smooth);
        let mut at = places(reached);
        at.retain(|_, n| is_open[*n as usize]);
        let mut before = vec![NONE; reached.len()];
        let mut along_mm = vec![f32::INFINITY; reached.len()];
        let mut cost = vec![u64::MAX; reached.len()];
        let mut open = BinaryHeap::new();
        // The cost is length in micrometres times weight, as an integer, because integers have a total order.
        let weight = |node: &Node| {
            let rise = f64::from(node.rise.max(1));
            1.0 + (4.0 * f64::from(levels.followed) / rise).min(20.0).powi(2)
        };
        for (n, node) in reached.iter().enumerate().filter(|(n, _)| is_open[*n]) {
            let mut touches = f32::INFINITY;
            faces.each(node.voxel as usize, |next, step_mm| {
                if states[next] == LUMEN {
                    touches = touches.min(step_mm);
                }
            });
            if touches.is_finite() {
                cost[n] = (1e3 * f64::from(touches) * weight(node)) as u64;
                along_mm[n] = touches;
                open.push(Reverse((cost[n], n as u32)));
            }
        }
        while let Some(Reverse((here, n))) = open.pop() {
            if here != cost[n as usize] {
                continue;
            }
            let own = reached[n as usize];
            faces.each(own.voxel as usize, |next, step_mm| {
                let Some(&m) = at.get(&(next as u32)) else {
                    return;
                };
                let mean = 0.5 * (weight(&own) + weight(&reached[m as usize]));
                let there = here + (1e3 * f64::from(step_mm) * mean) as u64;
                if there < cost[m as usize] {
                    cost[m as usize] = there;
                    before[m as usize] = n;
                    along_mm[m as usize] = along_mm[n as usize] + step_mm;
                    open.push(Reverse((there, m)));
                }
            });
        }
        Self {
            values,
            smooth,
            states,
            faces,
            reached,
            levels,
            at,
            before,
            along_mm,
            accepted: vec![0.0; reached.len()],
        }
    }

    pub(crate) fn follow(
        &mut self,
        limits: &ExtensionLimits,
        watch: &impl Watch,
    ) -> Result<Vec<Path>, TrackError> {
        let mut tips: Vec<u32> = (0..self.reached.len() as u32)
            .filter(|n| {
                let along = f64::from(self.along_mm[*n as usize]);
                along.is_finite()
                    && along >= limits.min_length_mm
                    && self.reached[*n as usize].rise >= self.levels.followed
            })
            .collect();
        tips.sort_by(|a, b| {
            self.along_mm[*b as usize]
                .total_cmp(&self.along_mm[*a as usize])
                .then(a.cmp(b))
        });
        let mut covered = vec![false; self.reached.len()];
        let mut paths = Vec::new();
        for (n, &tip) in tips.iter().enumerate() {
            if n.is_multiple_of(1 << 12) {
                watch.report_fraction(0.7 + 0.3 * n as f64 / tips.len() as f64)?;
            }
            if covered[tip as usize] {
                continue;
            }
            let mut way = vec![tip];
            while let Some(last) = way.last().copied()
                && self.before[last as usize] != NONE
                && self.accepted[self.before[last as usize] as usize] == 0.0
            {
                way.push(self.before[last as usize]);
            }
            way.reverse();
            self.cover(&way, &mut covered);
            if let Some(path) = self.accepted_part(&way, limits) {
                for node in &path.nodes {
                    self.accepted[*node as usize] = path.probability;
                }
                paths.push(path);
            }
        }
        Ok(paths)
    }

    /// Return the part of a path from its start to the voxel with the largest sum of gains; `None` if this part does
    /// not qualify as an airway.
    ///
    /// In divided slices the sections are first assessed by their log-odds, which require much evidence, and otherwise
    /// in the way that applies to undivided slices.
    fn accepted_part(&self, way: &[u32], limits: &ExtensionLimits) -> Option<Path> {
        let sections = self.sections(way);
        limits
            .divided
            .and_then(|divided| self.part_with_largest_gain(way, &sections, limits, Some(divided)))
            .or_else(|| self.part_with_largest_gain(way, &sections, limits, None))
    }

    fn part_with_largest_gain(
        &self,
        way: &[u32],
        sections: &[WaySection],
        limits: &ExtensionLimits,
        divided: Option<Divided>,
    ) -> Option<Path> {
        let threshold = f64::from(self.levels.followed);
        // Two of 100 voxels of lung pass the threshold, so the threshold is two standard deviations of the noise; half
        // of it is one.
        let blur = Blur::on(self.smooth.grid(), 0.5 * threshold);
        let (start_mm, probability_before) = match self.before[way[0] as usize] {
            NONE => (0.0, 1.0),
            before => (
                self.along_mm[before as usize],
                self.accepted[before as usize],
            ),
        };
        let (mut gain, mut best, mut last_mm) = (0.0, (0.0, 0, 0.0), start_mm);
        let (mut sum, mut sum_at_best) = (0.0, 0.0);
        let (mut evidence, mut evidence_at_best) = (0.0, 0.0);
        let mut highest = f64::NEG_INFINITY;
        for (n, node) in way.iter().enumerate() {
            let along = self.along_mm[*node as usize];
            let rise = f64::from(self.reached[*node as usize].rise);
            let step = f64::from(along - last_mm);
            last_mm = along;
            let own = f64::from(self.smooth.data()[self.reached[*node as usize].voxel as usize]);
            // A fall larger than `drop` means that the path has crossed a wall; a dark part behind that wall is another
            // structure.
            highest = highest.max(own);
            if own < highest - self.levels.drop {
                break;
            }
            let section = &sections[n].section;
            let by_darkness = if looks_like_airway(section, own, limits.air, blur) {
                (rise / threshold).min(MAX_GAIN) - 1.0
            } else {
                1.0 - MAX_GAIN
            };
            let by_odds = divided.map_or(1.0 - MAX_GAIN, |divided| {
                let across = sections[n].along[divided.axis].abs();
                let odds = log_odds(section, own, rise / threshold, across, limits, divided);
                evidence += step * odds.clamp(1.0 - MAX_GAIN, MAX_GAIN - 1.0);
                (odds - divided.least_odds).clamp(1.0 - MAX_GAIN, MAX_GAIN - 1.0)
            });
            gain += step * by_darkness.max(by_odds);
            sum += step * rise.min(MAX_GAIN * threshold);
            if limits.divided.is_some() && best.0 - gain > MAX_LOSS_MM {
                break;
            }
            if gain > best.0 {
                best = (gain, n + 1, f64::from(along - start_mm));
                sum_at_best = sum;
                evidence_at_best = evidence;
            }
        }
        let (most_gain, num, length_mm) = best;
        let way = &way[..num];
        let straight_mm = self.straight_mm(way);
        let (weights, evidence) = if divided.is_some() {
            (WAY_WEIGHTS_DIVIDED, evidence_at_best)
        } else {
            (WAY_WEIGHTS, most_gain)
        };
        let is_long = num > 0 && straight_mm >= limits.min_length_mm;
        let probability = if is_long {
            probability_before * self.way_probability(way, evidence, straight_mm, limits, &weights)
        } else {
            0.0
        };
        let is_airway = is_long
            && probability >= limits.least_probability
            && sum_at_best >= self.levels.accepted * length_mm
            && (limits.may_be_open(probability) || self.is_round(way));
        is_airway.then(|| Path {
            nodes: way.to_vec(),
            radius_mm: sections[..num]
                .iter()
                .map(|s| s.section.radius_mm)
                .collect(),
            length_mm: straight_mm,
            probability,
        })
    }

    /// Return the probability that a path is an airway, given that the airway from which it branches is one.
    ///
    /// The probability is computed from features of the whole path ([`WAY_WEIGHTS`]).
    fn way_probability(
        &self,
        way: &[u32],
        evidence: f64,
        straight_mm: f64,
        limits: &ExtensionLimits,
        weights: &[f64; 5],
    ) -> f64 {
        let ijk = |n: u32| {
            self.smooth
                .grid()
                .voxel(self.reached[n as usize].voxel as usize)
        };
        let from_mm = self.along_mm[way[0] as usize];
        let beyond = way
            .iter()
            .filter(|n| f64::from(self.along_mm[**n as usize] - from_mm) > BEYOND_MM)
            .map(|n| self.clearance_at(ijk(*n)));
        let clearance_mm = median(beyond.chain(std::iter::once(CLEAR_MM)));
        let (first, last) = (ijk(way[0]), ijk(way[way.len() - 1]));
        let spacing = self.smooth.grid().spacing_mm();
        let apart_mm = carina_grid::length(std::array::from_fn(|a| {
            (last[a] as f64 - first[a] as f64) * spacing[a]
        }));
        let figures = [
            1.0,
            evidence.max(0.05).ln(),
            clearance_mm,
            self.reached_share(ijk(way[way.len() / 2]), limits),
            apart_mm / straight_mm.max(1e-3),
        ];
        probability_of_way(figures, weights)
    }

    /// Return the distance in mm from a voxel to the lumen that was known before the extension, at most [`CLEAR_MM`].
    fn clearance_at(&self, voxel: [usize; 3]) -> f64 {
        let mut least = CLEAR_MM;
        self.each_within(voxel, CLEAR_MM, |at, off_mm| {
            if self.states[at] == LUMEN {
                least = least.min(off_mm);
            }
        });
        least
    }

    /// Return the share of the lung voxels round a voxel that the search has reached.
    ///
    /// The share is large where the search leaks into the lung.
    fn reached_share(&self, voxel: [usize; 3], limits: &ExtensionLimits) -> f64 {
        let (mut num_lung, mut num_reached) = (0usize, 0usize);
        let lung = limits.lung.0..=limits.lung.1;
        self.each_within(voxel, AROUND_MM, |at, _| {
            if lung.contains(&self.values.data()[at]) {
                num_lung += 1;
                num_reached += usize::from(self.states[at] == PENDING);
            }
        });
        num_reached as f64 / num_lung.max(1) as f64
    }

    fn each_within(&self, voxel: [usize; 3], reach_mm: f64, mut visit: impl FnMut(usize, f64)) {
        let grid = self.smooth.grid();
        let (shape, spacing) = (grid.shape_ijk(), grid.spacing_mm());
        let reach = spacing.map(|s| (reach_mm / s) as usize);
        let low: [usize; 3] = std::array::from_fn(|a| voxel[a].saturating_sub(reach[a]));
        let high: [usize; 3] = std::array::from_fn(|a| (voxel[a] + reach[a]).min(shape[a] - 1));
        let [i, j, k] = voxel.map(|v| v as f64);
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                for x in low[0]..=high[0] {
                    let off_mm = carina_grid::length([
                        (x as f64 - i) * spacing[0],
                        (y as f64 - j) * spacing[1],
                        (z as f64 - k) * spacing[2],
                    ]);
                    if off_mm <= reach_mm {
                        visit(x + shape[0] * (y + shape[1] * z), off_mm);
                    }
                }
            }
        }
    }

    fn is_round(&self, way: &[u32]) -> bool {
        let voxels: Vec<u32> = way
            .iter()
            .map(|n| self.reached[*n as usize].voxel)
            .collect();
        Profile::of_path(self.values, &voxels).is_none_or(|profile| profile.is_round())
    }

    /// Return the length of a path in mm, measured without its zigzag between voxels.
    ///
    /// The length is measured between positions that are about one slice apart.
    fn straight_mm(&self, way: &[u32]) -> f64 {
        let grid = self.smooth.grid();
        let spacing = grid.spacing_mm();
        let every = (spacing.into_iter().fold(TANGENT_MM, f64::max) / grid.min_spacing_mm()).ceil()
            as usize;
        let ijk = |n: u32| grid.voxel(self.reached[n as usize].voxel as usize);
        let mut knots: Vec<[usize; 3]> = way.iter().step_by(every).map(|n| ijk(*n)).collect();
        knots.extend(way.last().map(|n| ijk(*n)));
        knots
            .windows(2)
            .map(|pair| {
                carina_grid::length(std::array::from_fn(|a| {
                    (pair[1][a] as f64 - pair[0][a] as f64) * spacing[a]
                }))
            })
            .sum()
    }

    fn sections(&self, way: &[u32]) -> Vec<WaySection> {
        let grid = self.smooth.grid();
        let spacing = grid.spacing_mm();
        let ijk = |n: u32| grid.voxel(self.reached[n as usize].voxel as usize);
        let reach = ((TANGENT_MM / grid.min_spacing_mm()).ceil() as usize).max(2);
        (0..way.len())
            .map(|n| {
                let (a, b) = (
                    ijk(way[n.saturating_sub(reach)]),
                    ijk(way[(n + reach).min(way.len() - 1)]),
                );
                let along = carina_grid::unit(std::array::from_fn(|x| {
                    (b[x] as f64 - a[x] as f64) * spacing[x]
                }))
                .unwrap_or([0.0, 0.0, 1.0]);
                let threshold = f64::from(self.levels.followed);
                WaySection {
                    along,
                    section: section(self.smooth, ijk(way[n]), along, threshold, REACH_MM),
                }
            })
            .collect()
    }

    /// Mark the voxels in the tube round a path, in which no other path may end.
    fn cover(&self, way: &[u32], covered: &mut [bool]) {
        let mut left: HashMap<u32, f32> = way.iter().map(|n| (*n, COVER_MM)).collect();
        let mut open: Vec<u32> = way.to_vec();
        while let Some(n) = open.pop() {
            covered[n as usize] = true;
            let here = left[&n];
            self.faces
                .each(self.reached[n as usize].voxel as usize, |next, step_mm| {
                    let Some(&m) = self.at.get(&(next as u32)) else {
                        return;
                    };
                    let there = here - step_mm;
                    if there > 0.0 && left.get(&m).is_none_or(|l| there > *l + 1e-3) {
                        left.insert(m, there);
                        open.push(m);
                    }
                });
        }
    }

    /// Return the voxels of the lumen round the accepted paths.
    pub(crate) fn filled(&self, smooth: &[i16], paths: &[Path]) -> Vec<u32> {
        // The limit of each position is the level half-way up the wall, as the median over some voxels of the path.
        let mut open = BinaryHeap::new();
        let mut best: HashMap<u32, u32> = HashMap::new();
        for path in paths {
            for (p, node) in path.nodes.iter().enumerate() {
                let near = p.saturating_sub(FILL_NODES)..(p + FILL_NODES + 1).min(path.nodes.len());
                let half = median(path.nodes[near.clone()].iter().map(|n| {
                    let node = self.reached[*n as usize];
                    f64::from(smooth[node.voxel as usize]) + 0.5 * f64::from(node.rise)
                }));
                let reach_mm = FILL_RADII * median(path.radius_mm[near].iter().copied())
                    + 0.5 * self.smooth.grid().min_spacing_mm();
                let reach_um = (1e3 * reach_mm.min(REACH_MM)) as u32;
                best.insert(*node, 0);
                open.push(Reverse((0u32, *node, half as i32, reach_um)));
            }
        }
        let mut added: Vec<u32> = Vec::new();
        while let Some(Reverse((off_um, n, half, reach_um))) = open.pop() {
            if best.get(&n) != Some(&off_um) {
                continue;
            }
            let voxel = self.reached[n as usize].voxel;
            added.push(voxel);
            self.faces.each(voxel as usize, |next, step_mm| {
                let Some(&m) = self.at.get(&(next as u32)) else {
                    return;
                };
                let there = off_um + (1e3 * step_mm) as u32;
                if i32::from(smooth[next]) <= half
                    && there <= reach_um
                    && best.get(&m).is_none_or(|b| there < *b)
                {
                    best.insert(m, there);
                    open.push(Reverse((there, m, half, reach_um)));
                }
            });
        }
        added.sort_unstable();
        added.dedup();
        added
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
