//! Spots of air in the slices of a chest, and chains of spots in successive slices, which are candidates for trachea
//! and bronchi.

use carina_grid::{Grid, Ijk, VolumeView, length};

/// Value levels of a CT that distinguish air, lung and tissue.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AirLevels {
    /// Largest voxel value that counts as air.
    pub air: i16,
    /// Smallest voxel value of a wall of soft tissue.
    pub tissue: i16,
    /// Range of values of lung; `None` if the volume shows no lung (a painted mask), so that the search does not
    /// require lung.
    pub lung: Option<(i16, i16)>,
}

/// Spot of air in one slice.
#[derive(Debug, Clone)]
pub(crate) struct Spot {
    /// Voxel of the spot near its centre.
    pub(crate) voxel: [usize; 3],
    pub(crate) centre_lps: [f64; 3],
    pub(crate) area_mm2: f64,
    elongation: f64,
    /// Share of the directions within the slice in which soft tissue follows the spot's air, 0 to 1.
    pub(crate) ringed: f64,
    /// Pixels of the spot in its slice, as indices in ascending order.
    cells: Vec<u32>,
    /// Index of the spot's middle pixel, which is also `voxel`.
    middle: u32,
}

/// Number of directions in a slice in which tissue is searched round a spot of air.
const NUM_DIRECTIONS: usize = 24;
/// Minimum area in mm2 of a spot of air that may be an airway.
const MIN_AREA_MM2: f64 = 12.0;
/// Maximum area in mm2 of a spot of air that may be an airway.
const MAX_AREA_MM2: f64 = 900.0;

impl Spot {
    pub(crate) fn diameter_mm(&self) -> f64 {
        2.0 * (self.area_mm2 / std::f64::consts::PI).sqrt()
    }

    pub(crate) fn like_a_trachea(&self) -> bool {
        (7.0..=30.0).contains(&self.diameter_mm()) && self.elongation <= 2.6 && self.ringed >= 0.7
    }

    pub(crate) fn like_a_bronchus(&self) -> bool {
        (4.0..=33.0).contains(&self.diameter_mm()) && self.ringed >= 0.5
    }

    /// Return true if the middle of one of the two spots is in the other.
    fn overlaps(&self, other: &Self) -> bool {
        self.cells.binary_search(&other.middle).is_ok()
            || other.cells.binary_search(&self.middle).is_ok()
    }
}

/// Return the grid axis that is nearest to the direction from head to feet.
pub(crate) fn transverse_axis(grid: &Grid) -> usize {
    let share = |axis: usize| {
        let column = grid.lps_from_ijk().column(axis);
        column[2].abs() / length(column)
    };
    (0..3)
        .max_by(|a, b| share(*a).total_cmp(&share(*b)))
        .unwrap_or(2)
}

/// Return the spots of air of one slice whose area is between `MIN_AREA_MM2` and `MAX_AREA_MM2`.
pub(crate) fn spots_of_air(
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
        // Ratio of the main axes of the ellipse with the same second moments (1/12 cell for the size of a cell keeps
        // the ratio finite).
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
            centre_lps: grid.to_lps(Ijk(at)).0,
            area_mm2,
            elongation,
            ringed,
            cells,
            middle,
        });
    }
    spots
}

/// Return the share of directions, 0 to 1, in which tissue follows within 4 mm of the edge of the spot's air.
///
/// Only the first 30 mm from the centre are examined.
fn ringed_share(
    nu: usize,
    nv: usize,
    scale_mm: [f64; 2],
    centre: usize,
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
            let p = (centre % nu) as f64 + cos * along / scale_mm[0];
            let q = (centre / nu) as f64 + sin * along / scale_mm[1];
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

/// Spots in successive slices, from slice `first` down, each overlapping or near the next.
#[derive(Debug)]
pub(crate) struct Chain {
    pub(crate) first: usize,
    pub(crate) spots: Vec<usize>,
}

pub(crate) fn chains(
    slices: &[Vec<Spot>],
    step_mm: f64,
    change: f64,
    suits: impl Fn(&Spot) -> bool,
) -> Vec<Chain> {
    // A tube tilted by 60 degrees moves 1.7 steps per slice; 2 mm allow for the noise of the centre.
    let reach_mm = 1.8 * step_mm + 2.0;
    // A spot in a chain does not start another chain; two chains may share a spot where their tubes meet in a slice.
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

/// Return the distance in mm between the centres of two spots, projected along the axis from head to feet.
pub(crate) fn across_mm(a: &Spot, b: &Spot) -> f64 {
    (a.centre_lps[0] - b.centre_lps[0]).hypot(a.centre_lps[1] - b.centre_lps[1])
}

pub(crate) fn chain_length_mm(slices: &[Vec<Spot>], chain: &Chain) -> f64 {
    let top = slices[chain.first][chain.spots[0]].centre_lps;
    let last = chain.spots.len() - 1;
    let bottom = slices[chain.first + last][chain.spots[last]].centre_lps;
    length(std::array::from_fn(|a| top[a] - bottom[a]))
}

impl Chain {
    /// Return the spot of this chain in a slice; `None` if the chain does not include that slice.
    pub(crate) fn at<'a>(&self, slices: &'a [Vec<Spot>], slice: usize) -> Option<&'a Spot> {
        let n = slice.checked_sub(self.first)?;
        self.spots.get(n).map(|spot| &slices[slice][*spot])
    }

    pub(crate) fn end(&self) -> usize {
        self.first + self.spots.len()
    }
}
