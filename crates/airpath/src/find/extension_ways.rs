//! The least-cost ways from the lumen through what was reached, and the lumen round those that are kept.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use carina_grid::VolumeView;

use crate::find::extension_levels::{ExtensionLimits, Followed, LUMEN, Levels};
use crate::find::extension_reach::{Faces, Node, places};
use crate::find::extension_verdict::{Blur, looks_like_airway};
use crate::find::thin_profile::Profile;
use crate::find::tubeness::{REACH_MM, Section, section};
use carina_leastcost::{TrackError, Watch};

const NONE: u32 = u32::MAX;
/// How far a tube's side lies from its middle, through enclosed voxels, mm.
const COVER_MM: f32 = 3.0;
/// A lumen's voxels lie within so many radii of the middle by faces, which is a way round corners.
const FILL_RADII: f64 = 1.5;
/// Half-way up the wall is taken over so many voxels to both sides.
const FILL_NODES: usize = 2;
/// The direction of a way is taken over this much of it, to both sides, mm.
const TANGENT_MM: f64 = 2.0;
/// What a voxel may give a path, in thresholds: one bright wall must not pay for a long way without.
const MOST_GAIN: f64 = 3.0;

/// A kept path, as places in the list of reached voxels.
#[derive(Debug, Clone)]
pub(crate) struct Path {
    nodes: Vec<u32>,
    /// To the wall at each of them, mm.
    radius_mm: Vec<f64>,
    length_mm: f64,
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
        }
    }
}

/// The least-cost ways from the lumen through what was reached.
pub(crate) struct Search<'a> {
    values: VolumeView<'a, i16>,
    smooth: VolumeView<'a, i16>,
    faces: Faces,
    reached: &'a [Node],
    levels: Levels,
    at: HashMap<u32, u32>,
    before: Vec<u32>,
    along_mm: Vec<f32>,
    /// In the tree of kept paths.
    kept: Vec<bool>,
}

impl<'a> Search<'a> {
    pub(crate) fn new(
        values: VolumeView<'a, i16>,
        smooth: VolumeView<'a, i16>,
        lumen: &[u8],
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
        // Micrometres times weight: integers have one order.
        let weight = |node: &Node| {
            let rise = f64::from(node.rise.max(1));
            1.0 + (4.0 * f64::from(levels.followed) / rise).min(20.0).powi(2)
        };
        for (n, node) in reached.iter().enumerate().filter(|(n, _)| is_open[*n]) {
            let mut touches = f32::INFINITY;
            faces.each(node.voxel as usize, |next, step_mm| {
                if lumen[next] == LUMEN {
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
            faces,
            reached,
            levels,
            at,
            before,
            along_mm,
            kept: vec![false; reached.len()],
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
                watch.go_on(0.7 + 0.3 * n as f64 / tips.len() as f64)?;
            }
            if covered[tip as usize] {
                continue;
            }
            let mut way = vec![tip];
            while let Some(last) = way.last().copied()
                && self.before[last as usize] != NONE
                && !self.kept[self.before[last as usize] as usize]
            {
                way.push(self.before[last as usize]);
            }
            way.reverse();
            self.cover(&way, &mut covered);
            if let Some(path) = self.worth(&way, limits) {
                for node in &path.nodes {
                    self.kept[*node as usize] = true;
                }
                paths.push(path);
            }
        }
        Ok(paths)
    }

    /// The part of a way that pays, if that is enough for an airway.
    fn worth(&self, way: &[u32], limits: &ExtensionLimits) -> Option<Path> {
        let threshold = f64::from(self.levels.followed);
        // Two of 100 voxels of lung pass the threshold: two deviations, of which one is allowed for.
        let blur = Blur::on(self.smooth.grid(), 0.5 * threshold);
        let start_mm = self.before[way[0] as usize];
        let start_mm = if start_mm == NONE {
            0.0
        } else {
            self.along_mm[start_mm as usize]
        };
        let (mut gain, mut best, mut last_mm) = (0.0, (0.0, 0, 0.0), start_mm);
        let (mut sum, mut sum_at_best) = (0.0, 0.0);
        let sections = self.sections(way);
        let mut highest = f64::NEG_INFINITY;
        for (n, node) in way.iter().enumerate() {
            let along = self.along_mm[*node as usize];
            let rise = f64::from(self.reached[*node as usize].rise);
            let step = f64::from(along - last_mm);
            last_mm = along;
            let own = f64::from(self.smooth.data()[self.reached[*node as usize].voxel as usize]);
            // Over a wall: what opens behind it is not this airway.
            highest = highest.max(own);
            if own < highest - self.levels.drop {
                break;
            }
            gain += step
                * if looks_like_airway(&sections[n], own, limits.air, blur) {
                    (rise / threshold).min(MOST_GAIN) - 1.0
                } else {
                    1.0 - MOST_GAIN
                };
            sum += step * rise.min(MOST_GAIN * threshold);
            if gain > best.0 {
                best = (gain, n + 1, f64::from(along - start_mm));
                sum_at_best = sum;
            }
        }
        let (_, num, length_mm) = best;
        let straight_mm = self.straight_mm(&way[..num]);
        let is_airway = straight_mm >= limits.min_length_mm
            && sum_at_best >= self.levels.kept * length_mm
            && self.is_round(&way[..num]);
        is_airway.then(|| Path {
            nodes: way[..num].to_vec(),
            radius_mm: sections[..num].iter().map(|s| s.radius_mm).collect(),
            length_mm: straight_mm,
        })
    }

    fn is_round(&self, way: &[u32]) -> bool {
        let voxels: Vec<u32> = way
            .iter()
            .map(|n| self.reached[*n as usize].voxel)
            .collect();
        Profile::of(self.values, &voxels).is_none_or(|profile| profile.is_round())
    }

    /// Length of a way without its steps to and fro between voxels: from one place to the next a slice away.
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

    fn sections(&self, way: &[u32]) -> Vec<Section> {
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
                section(
                    self.smooth,
                    ijk(way[n]),
                    along,
                    f64::from(self.levels.followed),
                    REACH_MM,
                )
            })
            .collect()
    }

    /// Marks what lies in the tube round a way, so that it is no tip of its own.
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

    /// The lumen round the kept paths.
    pub(crate) fn filled(&self, smooth: &[i16], paths: &[Path]) -> Vec<u32> {
        // Half-way up the wall at each place of a path, over some voxels along it.
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
        let mut kept: Vec<u32> = Vec::new();
        while let Some(Reverse((off_um, n, half, reach_um))) = open.pop() {
            if best.get(&n) != Some(&off_um) {
                continue;
            }
            let voxel = self.reached[n as usize].voxel;
            kept.push(voxel);
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
        kept.sort_unstable();
        kept.dedup();
        kept
    }
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
