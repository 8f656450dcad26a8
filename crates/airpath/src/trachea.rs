//! The trachea from its anatomy: a tube of air, 7 to 27 mm wide, walled by soft tissue, that runs down and splits into
//! one branch to the right and one to the left.
//!
//! Works on the grid's slices that are nearest to transverse, in whatever order and orientation they are stored: only the
//! LPS directions of the grid's axes are used (+z superior, +x left). Arms, the table and the air outside never pass: they
//! are not ringed by tissue at this size, or do not split. Bowel can split; it has no lung on both sides.

use carina_grid::{Grid, Ijk, VolumeView, length};
use rayon::prelude::*;

use crate::{TrackError, Watch};

/// Levels that tell air from tissue.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AirLevels {
    /// Values below are air.
    pub air: i16,
    /// A wall of soft tissue reaches at least this.
    pub tissue: i16,
    /// Lung lies between these; `None` where the values do not show it (a painted mask), then no lung is asked for.
    pub lung: Option<(i16, i16)>,
}

/// The trachea that was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Trachea {
    /// Voxels of its air, one per slice, from the top down.
    pub voxels: Vec<[usize; 3]>,
    /// Equivalent diameter of each, mm.
    pub diameters_mm: Vec<f64>,
    /// Length, mm.
    pub length_mm: f64,
    /// Place of the split, LPS.
    pub carina_lps: [f64; 3],
}

/// One spot of air in one slice.
#[derive(Debug, Clone)]
struct Spot {
    /// A voxel of the spot near its centre.
    voxel: [usize; 3],
    center_lps: [f64; 3],
    area_mm2: f64,
    elongation: f64,
    /// Share of directions in which soft tissue follows.
    ringed: f64,
    /// Its cells in the slice, in order, and the cell of `voxel` among them.
    cells: Vec<u32>,
    middle: u32,
}

const NUM_DIRECTIONS: usize = 24;
const MIN_AREA_MM2: f64 = 12.0;
const MAX_AREA_MM2: f64 = 900.0;
/// Length of trachea that must be in the volume, mm.
const MIN_LENGTH_MM: f64 = 18.0;
/// Both main bronchi must be followed this far down, mm.
const MIN_BRONCHUS_MM: f64 = 6.0;
/// How much the area of a tube may change from slice to slice, as a factor: a bronchus may meet one that leaves it level.
const TRACHEA_CHANGE: f64 = 2.2;
const BRONCHUS_CHANGE: f64 = 5.0;

impl Spot {
    fn diameter_mm(&self) -> f64 {
        2.0 * (self.area_mm2 / std::f64::consts::PI).sqrt()
    }

    fn like_a_trachea(&self) -> bool {
        (7.0..=30.0).contains(&self.diameter_mm()) && self.elongation <= 2.6 && self.ringed >= 0.7
    }

    fn like_a_bronchus(&self) -> bool {
        (4.0..=33.0).contains(&self.diameter_mm()) && self.ringed >= 0.5
    }

    /// The middle of one lies in the other.
    fn overlaps(&self, other: &Self) -> bool {
        self.cells.binary_search(&other.middle).is_ok()
            || other.cells.binary_search(&self.middle).is_ok()
    }
}

/// Finds the trachea.
pub fn find_trachea(
    values: VolumeView<'_, i16>,
    levels: AirLevels,
    watch: &impl Watch,
) -> Result<Trachea, TrackError> {
    let grid = values.grid();
    let axis = transverse_axis(grid);
    let num_slices = grid.shape_ijk()[axis];
    let down = grid.lps_from_ijk().column(axis)[2] < 0.0;
    let in_order: Vec<usize> = if down {
        (0..num_slices).collect()
    } else {
        (0..num_slices).rev().collect()
    };
    // From the top down.
    let slices: Vec<Vec<Spot>> = in_order
        .par_iter()
        .map(|&slice| {
            watch.go_on(0.0)?;
            Ok(spots_of_air(values, levels, axis, slice))
        })
        .collect::<Result<_, TrackError>>()?;
    let step_mm = grid.spacing_mm()[axis];
    let tracheas = chains(&slices, step_mm, TRACHEA_CHANGE, Spot::like_a_trachea);
    let bronchi = chains(&slices, step_mm, BRONCHUS_CHANGE, Spot::like_a_bronchus);
    let mut longest_mm: f64 = 0.0;
    let mut best: Option<(f64, Trachea)> = None;
    for chain in &tracheas {
        let length_mm = chain_length_mm(&slices, chain);
        longest_mm = longest_mm.max(length_mm);
        if length_mm < MIN_LENGTH_MM {
            continue;
        }
        // The chain may go on into a main bronchus: look for the split all along its lower part.
        if let Some((split, ends_at)) = split_below(&slices, chain, &bronchi, step_mm) {
            let above = &chain.spots[..=ends_at];
            let of = |n: usize| &slices[chain.first + n][above[n]];
            let above_mm =
                length([0, 1, 2].map(|a| of(0).center_lps[a] - of(ends_at).center_lps[a]));
            if above_mm < MIN_LENGTH_MM || !lungs_beside(values, levels, split) {
                continue;
            }
            let trachea = Trachea {
                voxels: (0..=ends_at).map(|n| of(n).voxel).collect(),
                diameters_mm: (0..=ends_at).map(|n| of(n).diameter_mm()).collect(),
                length_mm: above_mm,
                carina_lps: split,
            };
            if best.as_ref().is_none_or(|(l, _)| above_mm > *l) {
                best = Some((above_mm, trachea));
            }
        }
    }
    best.map(|(_, trachea)| trachea).ok_or_else(|| {
        TrackError::NoResult(if longest_mm >= MIN_LENGTH_MM {
            format!(
                "no trachea was found: a tube of air {longest_mm:.0} mm long does not split into a right and a left main bronchus; \
                 give a point in the airway (root) if the volume is cropped"
            )
        } else {
            "no trachea was found: no tube of air of 7 to 30 mm, ringed by soft tissue, runs down through the volume; \
             is it a chest CT with the trachea in view? Give a point in the airway (root) if it is cropped"
                .to_owned()
        })
    })
}

/// The grid axis nearest to head-feet.
fn transverse_axis(grid: &Grid) -> usize {
    let share = |axis: usize| {
        let column = grid.lps_from_ijk().column(axis);
        column[2].abs() / length(column)
    };
    (0..3)
        .max_by(|a, b| share(*a).total_cmp(&share(*b)))
        .unwrap_or(2)
}

/// Spots of one slice that are of a size to matter.
fn spots_of_air(
    values: VolumeView<'_, i16>,
    levels: AirLevels,
    axis: usize,
    slice: usize,
) -> Vec<Spot> {
    let grid = values.grid();
    let shape = grid.shape_ijk();
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let (nu, nv) = (shape[u], shape[v]);
    let mut ijk = [0; 3];
    ijk[axis] = slice;
    let stride = |a: usize| match a {
        0 => 1,
        1 => shape[0],
        _ => shape[0] * shape[1],
    };
    let start = grid.index(ijk);
    let value = |p: usize, q: usize| values.data()[start + p * stride(u) + q * stride(v)];
    let (step_u, step_v) = (grid.lps_from_ijk().column(u), grid.lps_from_ijk().column(v));
    let cell_mm2 = length(carina_grid::cross(step_u, step_v));
    let max_cells = (MAX_AREA_MM2 / cell_mm2) as usize;

    let mut seen = vec![false; nu * nv];
    let mut spots = Vec::new();
    let mut cells: Vec<u32> = Vec::new();
    for first in 0..nu * nv {
        if seen[first] || value(first % nu, first / nu) >= levels.air {
            continue;
        }
        cells.clear();
        cells.push(first as u32);
        seen[first] = true;
        let mut next = 0;
        let mut at_border = false;
        while next < cells.len() {
            let (p, q) = (cells[next] as usize % nu, cells[next] as usize / nu);
            next += 1;
            at_border |= p == 0 || q == 0 || p + 1 == nu || q + 1 == nv;
            for (dp, dq) in [(-1isize, 0isize), (1, 0), (0, -1), (0, 1)] {
                let (p, q) = (p as isize + dp, q as isize + dq);
                if p < 0 || q < 0 || p >= nu as isize || q >= nv as isize {
                    continue;
                }
                let at = q as usize * nu + p as usize;
                if !seen[at] && value(p as usize, q as usize) < levels.air {
                    seen[at] = true;
                    cells.push(at as u32);
                }
            }
        }
        let area_mm2 = cells.len() as f64 * cell_mm2;
        if at_border || cells.len() > max_cells || area_mm2 < MIN_AREA_MM2 {
            continue;
        }
        let n = cells.len() as f64;
        let place = |c: u32| ((c as usize % nu) as f64, (c as usize / nu) as f64);
        let (sum_p, sum_q) = cells
            .iter()
            .map(|&c| place(c))
            .fold((0.0, 0.0), |s, c| (s.0 + c.0, s.1 + c.1));
        let (mean_p, mean_q) = (sum_p / n, sum_q / n);
        let (scale_u, scale_v) = (length(step_u), length(step_v));
        let (mut pp, mut qq, mut pq) = (0.0, 0.0, 0.0);
        let mut nearest = (f64::INFINITY, cells[0]);
        for &c in &cells {
            let (p, q) = place(c);
            let (x, y) = ((p - mean_p) * scale_u, (q - mean_q) * scale_v);
            pp += x * x;
            qq += y * y;
            pq += x * y;
            if x * x + y * y < nearest.0 {
                nearest = (x * x + y * y, c);
            }
        }
        // Ratio of the main axes of the ellipse with the same second moments (1/12 cell of its own keeps it finite).
        let own = n * cell_mm2 / 12.0;
        let (mean, half) = (
            f64::midpoint(pp, qq) + own,
            (((pp - qq) / 2.0).powi(2) + pq * pq).sqrt(),
        );
        let elongation = ((mean + half) / (mean - half).max(1e-6)).sqrt();
        let ringed = ringed_share(
            nu,
            nv,
            [scale_u, scale_v],
            nearest.1 as usize,
            levels,
            &value,
        );
        let mut at = [0.0; 3];
        at[axis] = slice as f64;
        at[u] = mean_p;
        at[v] = mean_q;
        let mut voxel = [0; 3];
        voxel[axis] = slice;
        voxel[u] = nearest.1 as usize % nu;
        voxel[v] = nearest.1 as usize / nu;
        let middle = nearest.1;
        let mut cells = cells.clone();
        cells.sort_unstable();
        spots.push(Spot {
            voxel,
            center_lps: grid.to_lps(Ijk(at)).0,
            area_mm2,
            elongation,
            ringed,
            cells,
            middle,
        });
    }
    spots
}

/// Share of directions in which tissue is met within 4 mm behind the edge of the air, at most 30 mm from the centre.
fn ringed_share(
    nu: usize,
    nv: usize,
    scale_mm: [f64; 2],
    center: usize,
    levels: AirLevels,
    value: &impl Fn(usize, usize) -> i16,
) -> f64 {
    let step_mm = 0.5 * scale_mm[0].min(scale_mm[1]);
    let mut num_ringed = 0;
    for direction in 0..NUM_DIRECTIONS {
        let angle = std::f64::consts::TAU * direction as f64 / NUM_DIRECTIONS as f64;
        let (sin, cos) = angle.sin_cos();
        let mut left_air_at = None;
        for s in 1.. {
            let along = f64::from(s) * step_mm;
            let p = (center % nu) as f64 + cos * along / scale_mm[0];
            let q = (center / nu) as f64 + sin * along / scale_mm[1];
            if p < 0.0 || q < 0.0 || p > nu as f64 - 1.0 || q > nv as f64 - 1.0 {
                break;
            }
            let here = value(p.round() as usize, q.round() as usize);
            if left_air_at.is_none() && here >= levels.air {
                left_air_at = Some(along);
            }
            if left_air_at.is_some() && here >= levels.tissue {
                num_ringed += 1;
                break;
            }
            if along > 30.0 || left_air_at.is_some_and(|edge| along > edge + 4.0) {
                break;
            }
        }
    }
    f64::from(num_ringed) / NUM_DIRECTIONS as f64
}

/// Spots of successive slices that follow one another, from `first` down.
#[derive(Debug)]
struct Chain {
    first: usize,
    spots: Vec<usize>,
}

fn chains(
    slices: &[Vec<Spot>],
    step_mm: f64,
    change: f64,
    suits: impl Fn(&Spot) -> bool,
) -> Vec<Chain> {
    // A tube tilted by 60 degrees moves 1.7 steps per slice; 2 mm for the centre's own noise.
    let reach_mm = 1.8 * step_mm + 2.0;
    // A spot in a chain starts none of its own; two chains may go on in one spot where their tubes meet in a slice.
    let mut taken: Vec<Vec<bool>> = slices.iter().map(|s| vec![false; s.len()]).collect();
    let mut found = Vec::new();
    for first in 0..slices.len() {
        for start in 0..slices[first].len() {
            if taken[first][start] || !suits(&slices[first][start]) {
                continue;
            }
            let mut spots = vec![start];
            let mut last = &slices[first][start];
            for (slice, below) in slices.iter().enumerate().skip(first + 1) {
                let next = below
                    .iter()
                    .enumerate()
                    .filter(|(_, spot)| {
                        let ratio = spot.area_mm2 / last.area_mm2;
                        suits(spot) && (1.0 / change..=change).contains(&ratio)
                    })
                    .map(|(n, spot)| (n, across_mm(spot, last), spot.overlaps(last)))
                    .filter(|(_, off, overlaps)| *overlaps || *off <= reach_mm)
                    .min_by(|a, b| b.2.cmp(&a.2).then(a.1.total_cmp(&b.1)));
                let Some((n, ..)) = next else { break };
                taken[slice][n] = true;
                spots.push(n);
                last = &below[n];
            }
            found.push(Chain { first, spots });
        }
    }
    found
}

/// Distance of two spots across the head-feet axis.
fn across_mm(a: &Spot, b: &Spot) -> f64 {
    (a.center_lps[0] - b.center_lps[0]).hypot(a.center_lps[1] - b.center_lps[1])
}

fn chain_length_mm(slices: &[Vec<Spot>], chain: &Chain) -> f64 {
    let top = slices[chain.first][chain.spots[0]].center_lps;
    let last = chain.spots.len() - 1;
    let bottom = slices[chain.first + last][chain.spots[last]].center_lps;
    length(std::array::from_fn(|a| top[a] - bottom[a]))
}

/// Where the chain splits: the carina's place and the last spot of the chain above it.
///
/// Two tubes in the same slices, one on the right and one on the left of the chain's last undivided spot, that both go on
/// for a while and drift apart. One of them may be the lower part of the chain itself.
fn split_below(
    slices: &[Vec<Spot>],
    chain: &Chain,
    bronchi: &[Chain],
    step_mm: f64,
) -> Option<([f64; 3], usize)> {
    let num_needed = (MIN_BRONCHUS_MM / step_mm).ceil().max(2.0) as usize;
    let num_gap = (20.0 / step_mm).ceil() as usize;
    let min_slices = (MIN_LENGTH_MM / step_mm).ceil() as usize;
    let last = chain.spots.len() - 1;
    for ends_at in min_slices.min(last)..=last {
        let end = &slices[chain.first + ends_at][chain.spots[ends_at]];
        let below = chain.first + ends_at + 1;
        let furthest = if ends_at == last {
            below + num_gap
        } else {
            below
        };
        for start in below..=furthest {
            if start + num_needed > slices.len() {
                break;
            }
            // Tubes present in this slice and for long enough below it, with the place where they are now and then.
            let tubes: Vec<(&Spot, &Spot)> = bronchi
                .iter()
                .filter(|b| b.first <= start && b.first + b.spots.len() >= start + num_needed)
                .map(|b| {
                    let at = |slice: usize| &slices[slice][b.spots[slice - b.first]];
                    (at(start), at(start + num_needed - 1))
                })
                .filter(|(now, _)| across_mm(now, end) <= 28.0)
                .collect();
            // +x is the patient's left.
            for (right, right_then) in &tubes {
                for (left, left_then) in &tubes {
                    let now = left.center_lps[0] - right.center_lps[0];
                    let then = left_then.center_lps[0] - right_then.center_lps[0];
                    let between = right.center_lps[0] - 3.0 < end.center_lps[0]
                        && end.center_lps[0] < left.center_lps[0] + 3.0;
                    let drift = then - now;
                    let wide_enough = left.diameter_mm().min(right.diameter_mm()) >= 5.0;
                    // 1 mm per 3 mm: main bronchi part by at least 30 degrees.
                    if now >= 7.0 && drift >= MIN_BRONCHUS_MM / 3.0 && between && wide_enough {
                        let carina = std::array::from_fn(|a| {
                            0.5 * (left.center_lps[a] + right.center_lps[a])
                        });
                        return Some((carina, ends_at));
                    }
                }
            }
        }
    }
    None
}

/// Lung that must be seen on each side of the carina, mm2 in one slice. Chest CTs at hand show 7000 and more, a belly's bowel 330.
const MIN_LUNG_MM2: f64 = 800.0;
/// How far from the carina lung is looked for: sideways, front and back, down; mm.
const LUNG_REACH_MM: [f64; 3] = [130.0, 80.0, 45.0];

/// True if there is lung on both sides of the carina, at its height or below.
///
/// A voxel is lung if it and its four neighbours in the slice are in lung's range (the blurred edges of bowel gas and skin pass
/// through that range within one voxel), with tissue farther out.
fn lungs_beside(values: VolumeView<'_, i16>, levels: AirLevels, carina_lps: [f64; 3]) -> bool {
    let Some((low, high)) = levels.lung else {
        return true;
    };
    let grid = values.grid();
    let axis = transverse_axis(grid);
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let shape = grid.shape_ijk();
    let columns = [0, 1, 2].map(|a| grid.lps_from_ijk().column(a));
    let cell_mm2 = length(carina_grid::cross(columns[u], columns[v]));
    let down = columns[axis][2] < 0.0;
    let first = grid.to_ijk(carina_grid::Lps(carina_lps)).0[axis]
        .round()
        .max(0.0) as usize;
    let num_slices = (LUNG_REACH_MM[2] / length(columns[axis])).ceil() as usize;
    let is_lung = |ijk: [usize; 3]| (low..=high).contains(&values.at(ijk));
    let (mut most_right, mut most_left) = (0usize, 0usize);
    for n in 0..=num_slices {
        let slice = if down {
            first.checked_add(n)
        } else {
            first.checked_sub(n)
        };
        let Some(slice) = slice.filter(|s| *s < shape[axis]) else {
            break;
        };
        // First and last tissue of every line of the slice, to tell lung from the air outside the body.
        let voxel = |p: usize, q: usize| {
            let mut ijk = [0; 3];
            (ijk[axis], ijk[u], ijk[v]) = (slice, p, q);
            ijk
        };
        let mut along_u = vec![(usize::MAX, 0); shape[v]];
        let mut along_v = vec![(usize::MAX, 0); shape[u]];
        for p in 0..shape[u] {
            for q in 0..shape[v] {
                if values.at(voxel(p, q)) >= levels.tissue {
                    along_u[q] = (p.min(along_u[q].0), p.max(along_u[q].1));
                    along_v[p] = (q.min(along_v[p].0), q.max(along_v[p].1));
                }
            }
        }
        let (mut right, mut left) = (0, 0);
        for p in 1..shape[u].max(2) - 1 {
            for q in 1..shape[v].max(2) - 1 {
                let ijk = voxel(p, q);
                let sides = [
                    along_u[q].0 < p,
                    p < along_u[q].1,
                    along_v[p].0 < q,
                    q < along_v[p].1,
                ];
                // Three of four: a crop may have cut the chest wall away on one side.
                if !is_lung(ijk) || sides.iter().filter(|s| **s).count() < 3 {
                    continue;
                }
                let beside = [(u, p - 1), (u, p + 1), (v, q - 1), (v, q + 1)];
                if !beside.iter().all(|(a, at)| {
                    let mut near = ijk;
                    near[*a] = *at;
                    is_lung(near)
                }) {
                    continue;
                }
                let place = grid.to_lps(Ijk(ijk.map(|x| x as f64))).0;
                let off = [0, 1].map(|a| place[a] - carina_lps[a]);
                if off[0].abs() <= LUNG_REACH_MM[0] && off[1].abs() <= LUNG_REACH_MM[1] {
                    // +x is the patient's left.
                    if off[0] < 0.0 { right += 1 } else { left += 1 }
                }
            }
        }
        most_right = most_right.max(right);
        most_left = most_left.max(left);
    }
    most_right.min(most_left) as f64 * cell_mm2 >= MIN_LUNG_MM2
}
