//! Edge costs `paper` and `walls` (paper 6.2), from the gradient and the sign of the Laplacian.
//!
//! `cost(u, v) = |p(u) - p(v)| (w_g f_g(u, v) + w_z f_z(u, v))`, in mm. The printed formula makes *high* gradients
//! cheap, so a path follows edges, including the airway's wall. Section 6.3 states the opposite: "the wall of the airway
//! has such a high cost" that no path goes through it. [`Reading::Printed`] is the printed formula; [`Reading::Walls`]
//! is the intended meaning: the same two functions with the opposite sign. Users of either cost should count the points
//! that leave the lumen.
//!
//! [`gradient`] and [`laplacian`] are the formulas as printed; [`PaperCost::build`] fills a table with equal numbers,
//! row by row.

use carina_grid::{VolumeView, length};
use rayon::prelude::*;

use crate::box_graph::{BoxGraph, VoxelGraph};
use crate::distance::VoxelBox;
use crate::graph::Cost;
use crate::{TrackError, Watch};

/// Weight of the gradient in the cost, `w_g` of paper 6.2.
pub const GRADIENT_WEIGHT: f64 = 0.7;
/// Weight of the Laplacian's zero crossing in the cost, `w_z` of paper 6.2.
pub const ZERO_CROSSING_WEIGHT: f64 = 0.3;

/// Minimum weight of an edge per mm.
///
/// Departure from paper 6.2: the printed weight can be 0, and then the integer costs have no smallest edge that would
/// define an accuracy of 0.5 %. Only edges along which the mean gradient is above 99.4 % of the volume's largest are
/// below this limit.
pub const MIN_WEIGHT: f64 = 1.0 / 256.0;

/// Return G(u), the length of the gradient at a voxel in units of the values per mm, by central differences.
///
/// Beyond the edge of the volume the values of the edge are repeated.
#[must_use]
pub fn gradient(values: VolumeView<'_, i16>, ijk: [usize; 3]) -> f64 {
    let spacing = values.grid().spacing_mm();
    let at = ijk.map(|v| v as isize);
    length(std::array::from_fn(|axis| {
        let beside = |side: isize| {
            let mut beside = at;
            beside[axis] += side;
            f64::from(values.at_clamped(beside))
        };
        (beside(1) - beside(-1)) / (2.0 * spacing[axis])
    }))
}

/// Return 26 times the printed discrete Laplacian at a voxel: 27 V minus the sum over the 27 voxels.
///
/// Beyond the edge of the volume the values of the edge are repeated.
#[must_use]
pub fn laplacian(values: VolumeView<'_, i16>, ijk: [usize; 3]) -> i32 {
    let at = ijk.map(|v| v as isize);
    let sum: i32 = (0..27isize)
        .map(|cell| {
            let offset = [cell % 3 - 1, cell / 3 % 3 - 1, cell / 9 - 1];
            i32::from(values.at_clamped(std::array::from_fn(|a| at[a] + offset[a])))
        })
        .sum();
    27 * i32::from(values.at(ijk)) - sum
}

/// Return the printed weight of an edge per mm, from G / max(G) and the Laplacian at its two ends.
///
/// Departure from paper 6.2: `f_g` is 1 - (G(u) + G(v)) / (2 max(G)), because the printed form without the 2 reaches -1
/// and Dijkstra's algorithm needs weights of at least 0.
#[must_use]
pub fn weight(gradient_share: [f64; 2], laplacian: [i32; 2]) -> f64 {
    let f_g = 1.0 - 0.5 * (gradient_share[0] + gradient_share[1]);
    let f_z = if laplacian[0].signum() * laplacian[1].signum() <= 0 {
        0.0
    } else {
        1.0
    };
    (GRADIENT_WEIGHT * f_g + ZERO_CROSSING_WEIGHT * f_z).max(MIN_WEIGHT)
}

/// Return the weight of an edge per mm with expensive gradients and zero crossings (paper 6.3).
///
/// The arguments are those of [`weight`]. Departures: `f_g` is (G(u) + G(v)) / (2 max(G)); a Laplacian of 0 is no
/// crossing, because nothing changes its sign in air without noise; no weight is below [`MIN_WEIGHT`].
#[must_use]
pub fn wall_weight(gradient_share: [f64; 2], laplacian: [i32; 2]) -> f64 {
    let f_g = 0.5 * (gradient_share[0] + gradient_share[1]);
    let f_z = if laplacian[0].signum() * laplacian[1].signum() < 0 {
        1.0
    } else {
        0.0
    };
    (GRADIENT_WEIGHT * f_g + ZERO_CROSSING_WEIGHT * f_z).max(MIN_WEIGHT)
}

/// Interpretation of the paper's cost: cheap or expensive walls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reading {
    /// The formula printed in 6.2: walls are cheap.
    Printed,
    /// The formula with the meaning that 6.3 requires: walls are expensive.
    Walls,
}

/// Quantile of the volume's gradients that replaces max(G) in [`Reading::Walls`].
///
/// Departure from the paper: metal or contrast medium determines the largest gradient of a volume, and relative to it
/// walls would cost nearly nothing.
pub const CLIPPED_SHARE: f64 = 0.999;
/// Number of bins of the histogram from which a quantile of the gradient is computed.
const NUM_BINS: usize = 1 << 14;

impl Reading {
    /// Return the gradient of the volume by which gradients are divided: max(G) or its quantile [`CLIPPED_SHARE`].
    ///
    /// # Errors
    ///
    /// Returns an error if `watch` stops the computation.
    pub fn scale(self, values: VolumeView<'_, i16>, watch: &impl Watch) -> Result<f64, TrackError> {
        let greatest = greatest_gradient(values, watch)?;
        match self {
            Self::Printed => Ok(greatest),
            Self::Walls => clipped_gradient(values, greatest, watch),
        }
    }

    fn weight(self, gradient_share: [f64; 2], laplacian: [i32; 2]) -> f64 {
        match self {
            Self::Printed => weight(gradient_share, laplacian),
            Self::Walls => wall_weight(gradient_share, laplacian),
        }
    }
}

/// Return the quantile [`CLIPPED_SHARE`] of the gradients of the volume's voxels.
///
/// The accuracy is 1 / 16384 of the largest gradient, `greatest`.
fn clipped_gradient(
    values: VolumeView<'_, i16>,
    greatest: f64,
    watch: &impl Watch,
) -> Result<f64, TrackError> {
    if greatest <= 0.0 {
        return Ok(greatest);
    }
    let shape_ijk = values.grid().shape_ijk();
    let whole = VoxelBox {
        first_ijk: [0; 3],
        shape_ijk,
    };
    let counts = (0..shape_ijk[2])
        .into_par_iter()
        .map_init(
            || Rows::new(values, whole),
            |rows, k| {
                watch.report_fraction(0.0)?;
                let mut counts = vec![0u32; NUM_BINS];
                for j in 0..shape_ijk[1] {
                    for squared in rows.squared_gradient(j, k) {
                        let bin = (squared.sqrt() / greatest * NUM_BINS as f64) as usize;
                        counts[bin.min(NUM_BINS - 1)] += 1;
                    }
                }
                Ok(counts)
            },
        )
        .try_reduce(
            || vec![0u32; NUM_BINS],
            |mut sum, counts| {
                for (total, count) in sum.iter_mut().zip(counts) {
                    *total += count;
                }
                Ok(sum)
            },
        )?;
    let most = CLIPPED_SHARE * whole.num_voxels() as f64;
    let mut below = 0.0;
    let bin = counts
        .iter()
        .position(|count| {
            below += f64::from(*count);
            below >= most
        })
        .unwrap_or(NUM_BINS - 1);
    Ok(greatest * (bin + 1) as f64 / NUM_BINS as f64)
}

/// Return the largest gradient of the whole volume, max(G).
///
/// # Errors
///
/// Returns an error if `watch` stops the computation.
pub fn greatest_gradient(
    values: VolumeView<'_, i16>,
    watch: &impl Watch,
) -> Result<f64, TrackError> {
    let [_, ny, nz] = values.grid().shape_ijk();
    let whole = VoxelBox {
        first_ijk: [0; 3],
        shape_ijk: values.grid().shape_ijk(),
    };
    let greatest: Vec<f64> = (0..nz)
        .into_par_iter()
        .map_init(
            || Rows::new(values, whole),
            |rows, k| {
                watch.report_fraction(0.0)?;
                let mut greatest = 0.0f64;
                for j in 0..ny {
                    let squared = rows.squared_gradient(j, k);
                    greatest = squared.iter().copied().fold(greatest, f64::max);
                }
                Ok(greatest)
            },
        )
        .collect::<Result<_, TrackError>>()?;
    Ok(greatest.into_iter().fold(0.0, f64::max).sqrt())
}

/// Cost of the edges of a [`BoxGraph`], as a table with 5 bytes for each voxel.
#[derive(Debug)]
pub struct PaperCost {
    reading: Reading,
    /// G / max(G) of each voxel, 0 to 1; f32 gives `f_g` an accuracy of 1e-7.
    gradient_share: Vec<f32>,
    /// Sign of the Laplacian of each voxel, from which zero crossings follow.
    laplacian_sign: Vec<i8>,
}

impl PaperCost {
    /// Build the table for the voxels of a graph from the values of the whole volume.
    ///
    /// `greatest_gradient` is the result of [`Reading::scale`] for the volume.
    ///
    /// # Errors
    ///
    /// Returns an error if `watch` stops the computation.
    pub fn build(
        values: VolumeView<'_, i16>,
        graph: &BoxGraph,
        reading: Reading,
        greatest_gradient: f64,
        watch: &impl Watch,
    ) -> Result<Self, TrackError> {
        let voxel_box = graph.voxel_box();
        let [nx, ny, nz] = voxel_box.shape_ijk;
        let mut gradient_share = vec![0.0f32; voxel_box.num_voxels()];
        let mut laplacian_sign = vec![0i8; voxel_box.num_voxels()];
        // A volume with a single value has no gradient anywhere, so f_g is 1.
        let scale = if greatest_gradient > 0.0 {
            1.0 / greatest_gradient
        } else {
            0.0
        };
        gradient_share
            .par_chunks_mut(nx * ny)
            .zip(laplacian_sign.par_chunks_mut(nx * ny))
            .enumerate()
            .try_for_each_init(
                || Rows::new(values, voxel_box),
                |rows, (k, (shares, signs))| {
                    watch.report_fraction(k as f64 / nz as f64)?;
                    for j in 0..ny {
                        let row = j * nx..(j + 1) * nx;
                        let (jj, kk) = (j + voxel_box.first_ijk[1], k + voxel_box.first_ijk[2]);
                        for (share, squared) in shares[row.clone()]
                            .iter_mut()
                            .zip(rows.squared_gradient(jj, kk))
                        {
                            *share = (squared.sqrt() * scale).min(1.0) as f32;
                        }
                        for (sign, laplacian) in signs[row].iter_mut().zip(rows.laplacian(jj, kk)) {
                            *sign = laplacian.signum() as i8;
                        }
                    }
                    Ok(())
                },
            )?;
        Ok(Self {
            reading,
            gradient_share,
            laplacian_sign,
        })
    }
}

impl Cost for PaperCost {
    fn weight(&self, u: u32, v: u32) -> f64 {
        let ends = [u as usize, v as usize];
        self.reading.weight(
            ends.map(|n| f64::from(self.gradient_share[n])),
            ends.map(|n| i32::from(self.laplacian_sign[n])),
        )
    }

    fn weight_range(&self) -> (f64, f64) {
        (MIN_WEIGHT, GRADIENT_WEIGHT + ZERO_CROSSING_WEIGHT)
    }
}

impl Cost for &PaperCost {
    fn weight(&self, u: u32, v: u32) -> f64 {
        (**self).weight(u, v)
    }

    fn weight_range(&self) -> (f64, f64) {
        (**self).weight_range()
    }
}

/// Gradient and Laplacian of one row of a box at a time; neighbours outside the box are read from the volume.
struct Rows<'a> {
    values: VolumeView<'a, i16>,
    first_i: usize,
    squared: Vec<f64>,
    /// Sum of nine rows at each i, from one voxel before the box to one voxel after it.
    sums: Vec<i32>,
    laplacian: Vec<i32>,
}

impl<'a> Rows<'a> {
    fn new(values: VolumeView<'a, i16>, voxel_box: VoxelBox) -> Self {
        let nx = voxel_box.shape_ijk[0];
        Self {
            values,
            first_i: voxel_box.first_ijk[0],
            squared: vec![0.0; nx],
            sums: vec![0; nx + 2],
            laplacian: vec![0; nx],
        }
    }

    /// Return the row of the volume at `(j, k)` moved by an offset and clamped to the edge.
    fn row(&self, j: usize, k: usize, [dj, dk]: [isize; 2]) -> &'a [i16] {
        let [nx, ny, nz] = self.values.grid().shape_ijk();
        let j = (j as isize + dj).clamp(0, ny as isize - 1) as usize;
        let k = (k as isize + dk).clamp(0, nz as isize - 1) as usize;
        &self.values.data()[(k * ny + j) * nx..][..nx]
    }

    fn squared_gradient(&mut self, j: usize, k: usize) -> &[f64] {
        let [sx, sy, sz] = self
            .values
            .grid()
            .spacing_mm()
            .map(|s| (0.5 / s) * (0.5 / s));
        let middle = self.row(j, k, [0, 0]);
        let (ahead, behind) = (self.row(j, k, [1, 0]), self.row(j, k, [-1, 0]));
        let (above, below) = (self.row(j, k, [0, 1]), self.row(j, k, [0, -1]));
        let last = middle.len() - 1;
        let difference = |a: i16, b: i16| f64::from(i32::from(a) - i32::from(b));
        for (n, squared) in self.squared.iter_mut().enumerate() {
            let i = self.first_i + n;
            let x = difference(middle[(i + 1).min(last)], middle[i.saturating_sub(1)]);
            let y = difference(ahead[i], behind[i]);
            let z = difference(above[i], below[i]);
            *squared = x * x * sx + y * y * sy + z * z * sz;
        }
        &self.squared
    }

    fn laplacian(&mut self, j: usize, k: usize) -> &[i32] {
        let middle = self.row(j, k, [0, 0]);
        let last = middle.len() - 1;
        let mut sums = std::mem::take(&mut self.sums);
        sums.fill(0);
        let inner = self.first_i..self.first_i + self.laplacian.len();
        let len = sums.len();
        for dk in -1..=1 {
            for dj in -1..=1 {
                let row = self.row(j, k, [dj, dk]);
                sums[0] += i32::from(row[inner.start.saturating_sub(1)]);
                sums[len - 1] += i32::from(row[inner.end.min(last)]);
                for (sum, value) in sums[1..len - 1].iter_mut().zip(&row[inner.clone()]) {
                    *sum += i32::from(*value);
                }
            }
        }
        for (n, laplacian) in self.laplacian.iter_mut().enumerate() {
            let sum = sums[n] + sums[n + 1] + sums[n + 2];
            *laplacian = 27 * i32::from(middle[inner.start + n]) - sum;
        }
        self.sums = sums;
        &self.laplacian
    }
}
