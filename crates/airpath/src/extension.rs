//! From the lumen that the flood found on into the airways that it could not follow (DESIGN 4, "Airways").
//!
//! The flood ends where an airway's wall no longer holds a level. What lies beyond is looked for by shape, not by level:
//! voxels that are enclosed by brighter wall ([`crate::tubeness`]) are followed from the lumen's surface, face to face.
//! How enclosed a voxel must be is read off the volume itself: lung away from the airways shows what noise, texture and vessels
//! pretend. At most a fiftieth of it passes, far below the share (31 % of a cubic lattice joined by faces) at which
//! passing voxels would join into ways of any length, so the search cannot run out into the lung; it needs no
//! explosion to notice that it has.
//!
//! Of what was reached, paths are kept: from the lumen, along the most enclosed voxels, to the farthest tips, the longest
//! first, cut where following them no longer pays. A path that is short, or not clearly better than lung, goes. Round a
//! kept path the lumen is what is darker than half-way up to its wall there.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use carina_grid::VolumeView;
use rayon::prelude::*;

use crate::tubeness::{Enclosure, REACH_MM, Section, section, smoothed};
use crate::{TrackError, Watch};

/// What the extension may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExtensionLimits {
    /// Air in the trachea.
    pub air: f64,
    /// Values of lung, the calibration's sample.
    pub lung: (i16, i16),
    /// Brighter than this is no lumen.
    pub brightest: i16,
    /// Least rise from a lumen to its wall, whatever the lung shows.
    pub least_rise: f64,
    /// Voxels that are less enclosed are crossed on at most this way, mm.
    pub gap_mm: f64,
    /// A path must lead at least this far out of the lumen that is known, mm.
    pub min_length_mm: f64,
}

/// One airway that was followed beyond the flood's end.
#[derive(Debug, Clone, PartialEq)]
pub struct Followed {
    /// Voxels of its middle, from the lumen outwards.
    pub voxels: Vec<u32>,
    /// Length, mm.
    pub length_mm: f64,
    /// Mean rise to the wall over what the lung pretends (1 is no better than the darkest fiftieth of lung).
    pub contrast: f64,
}

/// What the extension found.
#[derive(Debug, Clone, PartialEq)]
pub struct Extension {
    /// Kept paths, parents before what leaves them.
    pub followed: Vec<Followed>,
    /// Voxels that joined the lumen.
    pub num_voxels: usize,
    /// How far values must rise round a voxel, in the volume's numbers: what 98 % of the lung does not reach.
    pub enclosed: f64,
}

const LUMEN: u8 = 1;
/// Value of voxels that the extension adds to the lumen.
pub const EXTENDED: u8 = 2;
const PENDING: u8 = 3;
const REFUSED: u8 = 4;
const NONE: u32 = u32::MAX;
/// Share of the lung that is less enclosed than what is followed, and than what a path must be on average.
const FOLLOWED_SHARE: f64 = 0.98;
const KEPT_SHARE: f64 = 0.995;
/// A gap's voxels are at least this share as enclosed.
const GAP_SHARE: f64 = 0.3;
/// Lung voxels looked at for the calibration, and how many it needs.
const NUM_SAMPLES: usize = 20_000;
const MIN_SAMPLES: usize = 2_000;
/// Along an airway the values rise, as its lumen narrows and takes on more of the blur of its wall. A way that rises and falls
/// again by more than this, in thresholds, has stepped over a wall into the lung.
const DROP: f64 = 8.0;
/// The direction of a way is taken over this much of it, to both sides, mm.
const TANGENT_MM: f64 = 2.0;
/// Blur of a scanner with a smooth kernel (sigma): 1.4 mm full width.
const SCANNER_BLUR_MM: f64 = 0.6;
/// Below this many widths of the blur a radius is the blur's own, and says nothing about how dark the lumen should be.
const BLURRED: f64 = 0.75;
/// Share of the sides of a section on which there must be wall; a fork leaves a quarter open.
const MIN_WALLED: f64 = 0.7;
/// What a voxel may give a path, in thresholds: one bright wall must not pay for a long way without.
const MOST_GAIN: f64 = 3.0;

#[derive(Debug, Clone, Copy)]
struct Node {
    voxel: u32,
    rise: i16,
    gap_mm: f32,
}

/// Extends `lumen` (1 inside, 0 outside; face-connected) in place: what is added gets [`EXTENDED`].
pub fn extend(
    values: VolumeView<'_, i16>,
    lumen: &mut [u8],
    limits: &ExtensionLimits,
    watch: &impl Watch,
) -> Result<Extension, TrackError> {
    watch.go_on(0.0)?;
    let smooth = smoothed(values);
    let enclosure = Enclosure::new(values.grid(), REACH_MM);
    watch.go_on(0.2)?;
    let levels = Levels::of_lung(&smooth, lumen, &enclosure, limits);
    let reached = reach(values, &smooth, &enclosure, lumen, levels, limits, watch)?;
    watch.go_on(0.7)?;
    let view = VolumeView::new(&smooth, values.grid()).map_err(|e| TrackError::Argument {
        what: "volume",
        expected: "a full array".to_owned(),
        found: e.to_string(),
    })?;
    let open = open_from(values, &smooth, lumen, &reached, levels);
    let mut search = Search::new(view, lumen, &reached, &open, levels);
    let followed = search.follow(limits, watch)?;
    let kept = search.filled(&smooth, &followed);
    for node in &reached {
        lumen[node.voxel as usize] = 0;
    }
    for voxel in &kept {
        lumen[*voxel as usize] = EXTENDED;
    }
    lumen.par_iter_mut().for_each(|v| {
        if *v > EXTENDED {
            *v = 0;
        }
    });
    Ok(Extension {
        num_voxels: kept.len(),
        enclosed: f64::from(levels.followed),
        followed: followed
            .into_iter()
            .map(|path| path.report(&reached, levels))
            .collect(),
    })
}

/// How enclosed voxels must be.
#[derive(Debug, Clone, Copy)]
struct Levels {
    followed: i16,
    kept: f64,
    gap: i16,
}

impl Levels {
    fn of_lung(
        smooth: &[i16],
        lumen: &[u8],
        enclosure: &Enclosure,
        limits: &ExtensionLimits,
    ) -> Self {
        let (low, high) = limits.lung;
        let is_lung = |at: usize| lumen[at] == 0 && (low..=high).contains(&smooth[at]);
        // A stride without a factor in common with rows and slices walks through all of the volume evenly.
        let stride = 1009;
        let sample: Vec<usize> = (0..smooth.len())
            .step_by(stride)
            .filter(|at| is_lung(*at))
            .collect();
        let every = (sample.len() / NUM_SAMPLES).max(1);
        let mut rises: Vec<i16> = sample
            .par_iter()
            .step_by(every)
            .map(|at| enclosure.at(smooth, *at))
            .collect();
        rises.sort_unstable();
        let share = |share: f64| {
            if rises.len() < MIN_SAMPLES {
                0.0
            } else {
                f64::from(rises[((rises.len() - 1) as f64 * share) as usize])
            }
        };
        let followed = share(FOLLOWED_SHARE).max(limits.least_rise);
        Self {
            followed: followed.ceil() as i16,
            kept: share(KEPT_SHARE).max(1.2 * followed),
            gap: (GAP_SHARE * followed) as i16,
        }
    }
}

/// All voxels that can be followed from the lumen's surface, in the order in which they were met.
fn reach(
    values: VolumeView<'_, i16>,
    smooth: &[i16],
    enclosure: &Enclosure,
    lumen: &mut [u8],
    levels: Levels,
    limits: &ExtensionLimits,
    watch: &impl Watch,
) -> Result<Vec<Node>, TrackError> {
    let faces = Faces::new(values);
    let mut nodes: Vec<Node> = Vec::new();
    // (voxel, gap before it, mm of the step to it)
    let mut wave: Vec<(u32, f32, f32)> = Vec::new();
    for at in 0..lumen.len() {
        if lumen[at] == LUMEN {
            faces.each(at, |next, step_mm| {
                if lumen[next] == 0 {
                    lumen[next] = PENDING;
                    wave.push((next as u32, 0.0, step_mm));
                }
            });
        }
    }
    // Voxels that no short gap has led to yet, and how enclosed they are.
    let mut waiting: HashMap<u32, i16> = HashMap::new();
    while !wave.is_empty() {
        watch.go_on(0.3)?;
        let rises: Vec<i16> = wave
            .par_iter()
            .map(|(at, ..)| {
                waiting
                    .get(at)
                    .copied()
                    .unwrap_or_else(|| enclosure.at(smooth, *at as usize))
            })
            .collect();
        let first = nodes.len();
        for ((voxel, gap_mm, step_mm), rise) in wave.drain(..).zip(rises) {
            let gap_mm = if rise >= levels.followed {
                0.0
            } else {
                gap_mm + step_mm
            };
            if rise < levels.gap || smooth[voxel as usize] > limits.brightest {
                lumen[voxel as usize] = REFUSED;
            } else if f64::from(gap_mm) > limits.gap_mm {
                // Another way may lead here by a shorter gap.
                lumen[voxel as usize] = 0;
                waiting.insert(voxel, rise);
            } else {
                lumen[voxel as usize] = PENDING;
                nodes.push(Node {
                    voxel,
                    rise,
                    gap_mm,
                });
            }
        }
        // The shortest gaps first: a voxel joins by the best of its ways.
        let mut from: Vec<Node> = nodes[first..].to_vec();
        from.sort_by(|a, b| a.gap_mm.total_cmp(&b.gap_mm).then(a.voxel.cmp(&b.voxel)));
        for node in from {
            faces.each(node.voxel as usize, |next, step_mm| {
                if lumen[next] == 0 {
                    lumen[next] = PENDING;
                    wave.push((next as u32, node.gap_mm, step_mm));
                }
            });
        }
    }
    Ok(nodes)
}

/// The neighbours by faces, and how far they are.
struct Faces {
    shape: [usize; 3],
    step_mm: [f32; 3],
}

impl Faces {
    fn new(values: VolumeView<'_, i16>) -> Self {
        Self {
            shape: values.grid().shape_ijk(),
            step_mm: values.grid().spacing_mm().map(|s| s as f32),
        }
    }

    fn each(&self, at: usize, mut visit: impl FnMut(usize, f32)) {
        let [nx, ny, nz] = self.shape;
        let (i, j, k) = (at % nx, at / nx % ny, at / nx / ny);
        let [x, y, z] = self.step_mm;
        if i > 0 {
            visit(at - 1, x);
        }
        if i + 1 < nx {
            visit(at + 1, x);
        }
        if j > 0 {
            visit(at - nx, y);
        }
        if j + 1 < ny {
            visit(at + nx, y);
        }
        if k > 0 {
            visit(at - nx * ny, z);
        }
        if k + 1 < nz {
            visit(at + nx * ny, z);
        }
    }
}

/// Which of the reached voxels can be had without stepping over a sill: see [`DROP`].
///
/// Voxels are met by the lowest way, as water would (a minimax path).
fn open_from(
    values: VolumeView<'_, i16>,
    smooth: &[i16],
    lumen: &[u8],
    reached: &[Node],
    levels: Levels,
) -> Vec<bool> {
    let faces = Faces::new(values);
    let at: HashMap<u32, u32> = places(reached);
    let drop = (DROP * f64::from(levels.followed)) as i32;
    let mut open = vec![false; reached.len()];
    let mut sill = vec![i32::MAX; reached.len()];
    let mut queue = BinaryHeap::new();
    let value = |n: u32| i32::from(smooth[reached[n as usize].voxel as usize]);
    for (n, node) in reached.iter().enumerate() {
        let mut touches = false;
        faces.each(node.voxel as usize, |next, _| {
            touches |= lumen[next] == LUMEN;
        });
        if touches {
            sill[n] = value(n as u32);
            queue.push(Reverse((sill[n], n as u32)));
        }
    }
    while let Some(Reverse((here, n))) = queue.pop() {
        if here != sill[n as usize] || value(n) < here - drop {
            continue;
        }
        open[n as usize] = true;
        faces.each(reached[n as usize].voxel as usize, |next, _| {
            let Some(&m) = at.get(&(next as u32)) else {
                return;
            };
            let there = here.max(value(m));
            if there < sill[m as usize] {
                sill[m as usize] = there;
                queue.push(Reverse((there, m)));
            }
        });
    }
    open
}

fn places(reached: &[Node]) -> HashMap<u32, u32> {
    reached
        .iter()
        .enumerate()
        .map(|(n, node)| (node.voxel, n as u32))
        .collect()
}

/// What stands between a lumen and its values.
#[derive(Debug, Clone, Copy)]
struct Blur {
    /// Of scanner, voxel and smoothing.
    sigma_mm: f64,
    /// In the volume's numbers.
    noise: f64,
}

/// Wall on most sides, and as dark in the middle as a lumen that wide must be.
///
/// Blur leaves `exp(-r^2 / 2 s^2)` of the wall's brightness in the middle of a tube of radius r. A wide tube is as dark as the
/// trachea; a groove between a vessel and an airway's wall is as wide, and as bright as lung.
fn looks_like_airway(section: &Section, own: f64, air: f64, blur: Blur) -> bool {
    let wall = own + section.rise;
    let widths = section.radius_mm / blur.sigma_mm;
    let left = if widths < BLURRED {
        1.0
    } else {
        (-0.5 * widths.powi(2)).exp()
    };
    section.walled >= MIN_WALLED && own <= air + left * (wall - air) + blur.noise
}

/// A kept path, as places in the list of reached voxels.
#[derive(Debug, Clone)]
struct Path {
    nodes: Vec<u32>,
    length_mm: f64,
}

impl Path {
    fn report(self, reached: &[Node], levels: Levels) -> Followed {
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
struct Search<'a> {
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
    fn new(
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

    fn follow(
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
        let blur = self.blur(0.5 * threshold);
        let start_mm = self.before[way[0] as usize];
        let start_mm = if start_mm == NONE {
            0.0
        } else {
            self.along_mm[start_mm as usize]
        };
        let (mut gain, mut best, mut last_mm) = (0.0, (0.0, 0, 0.0), start_mm);
        let (mut sum, mut sum_at_best) = (0.0, 0.0);
        let sections = self.sections(way);
        for (n, node) in way.iter().enumerate() {
            let along = self.along_mm[*node as usize];
            let rise = f64::from(self.reached[*node as usize].rise);
            let step = f64::from(along - last_mm);
            last_mm = along;
            let own = f64::from(self.smooth.data()[self.reached[*node as usize].voxel as usize]);
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
        (length_mm >= limits.min_length_mm && sum_at_best >= self.levels.kept * length_mm).then(
            || Path {
                nodes: way[..num].to_vec(),
                length_mm,
            },
        )
    }

    /// Sigma of everything that blurs: scanner, voxel, smoothing.
    fn blur(&self, noise: f64) -> Blur {
        let voxel_mm = self
            .smooth
            .grid()
            .spacing_mm()
            .iter()
            .product::<f64>()
            .cbrt();
        Blur {
            sigma_mm: SCANNER_BLUR_MM.hypot(0.5 * voxel_mm),
            noise,
        }
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
    fn filled(&self, smooth: &[i16], paths: &[Path]) -> Vec<u32> {
        // Half-way up the wall at each place of a path, over some voxels along it.
        let mut open = BinaryHeap::new();
        let mut best: HashMap<u32, u32> = HashMap::new();
        for path in paths {
            for (p, node) in path.nodes.iter().enumerate() {
                let near = &path.nodes[p.saturating_sub(2)..(p + 3).min(path.nodes.len())];
                let half: f64 = near
                    .iter()
                    .map(|n| {
                        let node = self.reached[*n as usize];
                        f64::from(smooth[node.voxel as usize]) + 0.5 * f64::from(node.rise)
                    })
                    .sum::<f64>()
                    / near.len() as f64;
                best.insert(*node, 0);
                open.push(Reverse((0u32, *node, half as i32)));
            }
        }
        let mut kept: Vec<u32> = Vec::new();
        while let Some(Reverse((off_um, n, half))) = open.pop() {
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
                    && f64::from(there) <= 1e3 * REACH_MM
                    && best.get(&m).is_none_or(|b| there < *b)
                {
                    best.insert(m, there);
                    open.push(Reverse((there, m, half)));
                }
            });
        }
        kept.sort_unstable();
        kept.dedup();
        kept
    }
}

/// How far a tube's side lies from its middle, through enclosed voxels, mm.
const COVER_MM: f32 = 3.0;
