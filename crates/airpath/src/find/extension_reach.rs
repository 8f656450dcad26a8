//! Search for voxels enclosed by walls, from the lumen's surface outwards, without crossing a wall.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use carina_grid::VolumeView;
use rayon::prelude::*;

use crate::find::extension_levels::{ExtensionLimits, LUMEN, Levels, PENDING, REFUSED};
use crate::find::tubeness::Enclosure;
use carina_leastcost::{TrackError, Watch};

/// Voxel that the search has reached from the lumen's surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Node {
    pub(crate) voxel: u32,
    /// Enclosure of the voxel: the rise in value to the walls round it.
    pub(crate) rise: i16,
    /// Length in mm of the last part of the path to this voxel whose voxels have too little wall round them.
    gap_mm: f32,
}

/// Return all voxels that can be reached from the lumen's surface through voxels enclosed by walls, in the order of the
/// search.
///
/// The search ends early if it reaches more than [`Levels::most_reached`] voxels, because it has then leaked into the
/// lung.
pub(crate) fn reach(
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
    // Items are (voxel, length of the gap before the voxel in mm, length of the step to the voxel in mm).
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
    // Voxels, with their enclosures, to which every path found so far leads through a gap that is too long.
    let mut waiting: HashMap<u32, i16> = HashMap::new();
    while !wave.is_empty() && nodes.len() <= levels.most_reached {
        watch.report_fraction(0.3)?;
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
                // Another path may reach this voxel through a shorter gap.
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
        // The shortest gaps come first, so that a voxel is reached by the best of its paths.
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

/// Memory offsets of the six face neighbours of a voxel, and the distances to them in mm.
pub(crate) struct Faces {
    shape: [usize; 3],
    step_mm: [f32; 3],
}

impl Faces {
    pub(crate) fn new(values: VolumeView<'_, i16>) -> Self {
        Self {
            shape: values.grid().shape_ijk(),
            step_mm: values.grid().spacing_mm().map(|s| s as f32),
        }
    }

    pub(crate) fn each(&self, at: usize, mut visit: impl FnMut(usize, f32)) {
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

/// Return for each reached voxel whether a path to it exists along which the values never fall by more than
/// [`Levels::drop`].
///
/// Each voxel is reached by the path with the lowest maximum value (a minimax path); a larger fall after that maximum
/// means that the path has crossed a wall.
pub(crate) fn open_from(
    values: VolumeView<'_, i16>,
    smooth: &[i16],
    lumen: &[u8],
    reached: &[Node],
    levels: Levels,
) -> Vec<bool> {
    let faces = Faces::new(values);
    let at: HashMap<u32, u32> = places(reached);
    let drop = levels.drop as i32;
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

/// Return a map from each reached voxel to its index in `reached`.
pub(crate) fn places(reached: &[Node]) -> HashMap<u32, u32> {
    reached
        .iter()
        .enumerate()
        .map(|(n, node)| (node.voxel, n as u32))
        .collect()
}
