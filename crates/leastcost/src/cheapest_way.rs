//! Least-cost path through the voxels of a small box, from one voxel to the nearest of several goals.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use carina_grid::length;

use crate::graph::NO_NODE;
use crate::ordered_cost::OrderedCost;
use crate::{TrackError, Watch};

/// Least-cost path through a box of voxels.
#[derive(Debug, Clone, PartialEq)]
pub struct Way {
    /// Voxels of the path, from a goal to the start; successive voxels share a face, an edge or a corner.
    pub voxels: Vec<[usize; 3]>,
    /// Cost of the path: sum over its steps of length in mm times weight.
    pub cost: f64,
}

/// Find the least-cost path from `start` to the nearest voxel for which `is_goal` is not 0; return `None` without a
/// path.
///
/// A step costs its length in mm times the mean weight of its two voxels; no path passes a voxel of weight 0. All
/// arrays run x fastest. Of equally cheap paths the first in array order is returned.
///
/// # Errors
///
/// Returns an error if `watch` stops the computation.
pub fn cheapest_way(
    shape_ijk: [usize; 3],
    spacing_mm: [f64; 3],
    weights: &[f32],
    is_goal: &[u8],
    start: [usize; 3],
    watch: &impl Watch,
) -> Result<Option<Way>, TrackError> {
    let [nx, ny, nz] = shape_ijk;
    let index = |v: [usize; 3]| (v[2] * ny + v[1]) * nx + v[0];
    let voxel = |at: usize| [at % nx, at / nx % ny, at / nx / ny];
    let steps: Vec<([isize; 3], f64)> = (0..27isize)
        .filter(|n| *n != 13)
        .map(|n| {
            let offset = [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1];
            let mm = std::array::from_fn(|a| offset[a] as f64 * spacing_mm[a]);
            (offset, length(mm))
        })
        .collect();
    let mut least = vec![f64::INFINITY; nx * ny * nz];
    let mut before = vec![NO_NODE; nx * ny * nz];
    let mut open = BinaryHeap::new();
    least[index(start)] = 0.0;
    open.push(Reverse((OrderedCost(0.0), index(start) as u32)));
    let mut num_popped = 0usize;
    while let Some(Reverse((OrderedCost(here), at))) = open.pop() {
        let at = at as usize;
        if here > least[at] {
            continue;
        }
        num_popped += 1;
        if num_popped.is_multiple_of(1 << 14) {
            watch.report_fraction(0.5)?;
        }
        if is_goal[at] != 0 {
            let mut voxels = vec![voxel(at)];
            let mut next = before[at];
            while next != NO_NODE {
                voxels.push(voxel(next as usize));
                next = before[next as usize];
            }
            return Ok(Some(Way { voxels, cost: here }));
        }
        let from = voxel(at).map(|v| v as isize);
        for (offset, step_mm) in &steps {
            let to: [isize; 3] = std::array::from_fn(|a| from[a] + offset[a]);
            if to[0] < 0 || to[1] < 0 || to[2] < 0 {
                continue;
            }
            let to = to.map(|v| v as usize);
            if to[0] >= nx || to[1] >= ny || to[2] >= nz {
                continue;
            }
            let next = index(to);
            if weights[next] <= 0.0 {
                continue;
            }
            let weight = 0.5 * (f64::from(weights[at]) + f64::from(weights[next]));
            let through = here + step_mm * weight;
            if through < least[next] {
                least[next] = through;
                before[next] = at as u32;
                open.push(Reverse((OrderedCost(through), next as u32)));
            }
        }
    }
    Ok(None)
}
