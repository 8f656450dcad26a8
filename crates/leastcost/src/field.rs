//! Volume of weights as an implicit graph: each voxel has 26 neighbours, and edge costs are computed from the weights.
//!
//! A *cell* is one of the 27 voxels round and including a voxel, numbered in array order; it also stands for the step
//! from the voxel to this neighbour. [`crate::field_tracker`] finds least-cost trees in such a volume; [`least_costs`]
//! is the readable reference.
#![allow(
    clippy::inline_always,
    reason = "small functions of the inner loop: called for each of 26 neighbours of each voxel"
)]

use std::ops::Range;

use carina_grid::{Grid, length};

use crate::TrackError;
use crate::dijkstra::least_costs_by;

/// Index of the voxel itself among the 27 voxels of its 3x3x3 neighbourhood.
pub(crate) const HERE: usize = 13;

/// Number of quanta of the cheapest step with a cost above 0.
///
/// Rounding by half a quantum is 0.4 % of this step, so a sum of such steps is accurate within 0.4 % as well. Path
/// costs are documented as accurate within 0.5 %; the remaining 0.1 % is far more than the rounding of f32 needs.
const CHEAPEST_STEP_QUANTA: f32 = 128.0;
/// Maximum number of quanta of a step; f32 represents all integers up to this number exactly, with one bit to spare.
pub(crate) const MAX_STEP_QUANTA: f32 = 4_194_304.0;

/// Return the offset (di, dj, dk) from a voxel to one of its cells, 0 to 26 in array order.
pub(crate) const fn offset(cell: usize) -> [isize; 3] {
    let c = cell as isize;
    [c % 3 - 1, c / 3 % 3 - 1, c / 9 - 1]
}

/// Weight of each voxel of a grid, with the set of voxels that paths may use.
///
/// A voxel is open if it is in the region and in the mask and its weight is finite; all others are walls.
#[derive(Debug, Clone)]
pub struct VoxelField<'a> {
    values: &'a [f32],
    mask: Option<&'a [u8]>,
    /// Number of voxels of the whole volume along each axis.
    volume_ijk: [usize; 3],
    first_ijk: [usize; 3],
    /// Number of voxels of the search box along each axis.
    shape_ijk: [usize; 3],
    lengths_mm: [f32; 27],
    /// Vectors in mm of a step along i, j and k.
    axes_mm: [[f64; 3]; 3],
}

/// Smallest and largest weight above 0 in a field, and the properties of the weights on which the quantum depends.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Weights {
    least: f32,
    greatest: f32,
    any_zero: bool,
    whole: bool,
    num_open: usize,
}

/// Number of weights that are compared at once in a vector register.
const LANES: usize = 16;
/// Number of weights that are summarised before rare cases among them get a second pass, in the nearest cache.
const PIECE: usize = 4096;

/// Summary of the weights of a row.
#[derive(Debug, Clone, Copy)]
struct Row {
    least: f32,
    greatest: f32,
    negative: bool,
    any_zero: bool,
    whole: bool,
    num_open: usize,
}

/// Return true if a finite weight is an integer.
#[inline(always)]
fn is_whole(weight: f32) -> bool {
    // Every f32 from 2^23 on is an integer. For such a weight the sum may round, but the check of the range rejects it.
    (weight + ROUNDING) - ROUNDING - weight == 0.0
}

impl Row {
    fn of(weights: &[f32], check_whole: bool) -> Self {
        Self::of_positive(weights, check_whole).unwrap_or_else(|| Self::of_any(weights))
    }

    /// Summarise a row of finite weights above 0, the most frequent case; return `None` for any other row.
    ///
    /// Sixteen weights are compared at once, so the function is as fast as reading the volume. Whether all weights are
    /// integers is determined only if `check_whole` is true, because a single fraction decides the result for the
    /// volume.
    fn of_positive(weights: &[f32], check_whole: bool) -> Option<Self> {
        let first = *weights.first()?;
        let (mut low, mut high, mut wall) = ([first; LANES], [first; LANES], [0u32; LANES]);
        let (chunks, rest) = weights.as_chunks::<LANES>();
        for chunk in chunks {
            for lane in 0..LANES {
                let weight = chunk[lane];
                low[lane] = if weight < low[lane] {
                    weight
                } else {
                    low[lane]
                };
                high[lane] = if weight > high[lane] {
                    weight
                } else {
                    high[lane]
                };
                wall[lane] |= if weight < f32::INFINITY { 0 } else { u32::MAX };
            }
        }
        for &weight in rest {
            low[0] = low[0].min(weight);
            high[0] = high[0].max(weight);
            wall[0] |= if weight < f32::INFINITY { 0 } else { u32::MAX };
        }
        let least = low.into_iter().fold(f32::INFINITY, f32::min);
        let greatest = high.into_iter().fold(0.0, f32::max);
        if wall.iter().any(|lane| *lane != 0) || least <= 0.0 {
            return None;
        }
        Some(Self {
            least,
            greatest,
            negative: false,
            any_zero: false,
            whole: check_whole && weights.iter().all(|weight| is_whole(*weight)),
            num_open: weights.len(),
        })
    }

    /// Summarise any row of weights, including walls and weights of 0.
    fn of_any(weights: &[f32]) -> Self {
        let (mut low, mut high) = ([f32::INFINITY; LANES], [0.0f32; LANES]);
        let (mut below, mut zero) = ([0u32; LANES], [0u32; LANES]);
        let (mut broken, mut open) = ([0u32; LANES], [0u32; LANES]);
        let mut see = |chunk: &[f32; LANES]| {
            for lane in 0..LANES {
                let weight = chunk[lane];
                let finite = weight < f32::INFINITY;
                let least = if weight > 0.0 { weight } else { f32::INFINITY };
                low[lane] = if least < low[lane] { least } else { low[lane] };
                let most = if finite { weight } else { 0.0 };
                high[lane] = if most > high[lane] { most } else { high[lane] };
                below[lane] |= u32::from(weight < 0.0);
                zero[lane] |= u32::from(weight == 0.0);
                broken[lane] |= u32::from(!is_whole(most));
                open[lane] += u32::from(finite);
            }
        };
        let (chunks, rest) = weights.as_chunks::<LANES>();
        chunks.iter().for_each(&mut see);
        if !rest.is_empty() {
            // The padding has the weight of a wall, which does not change the summary.
            let mut last = [f32::INFINITY; LANES];
            last[..rest.len()].copy_from_slice(rest);
            see(&last);
        }
        Self {
            least: low.into_iter().fold(f32::INFINITY, f32::min),
            greatest: high.into_iter().fold(0.0, f32::max),
            negative: below.iter().any(|lane| *lane != 0),
            any_zero: zero.iter().any(|lane| *lane != 0),
            whole: broken.iter().all(|lane| *lane == 0),
            num_open: open.iter().map(|lane| *lane as usize).sum(),
        }
    }
}

impl<'a> VoxelField<'a> {
    /// Create the field of the weights `values` (x fastest) of a grid.
    ///
    /// `region` is a box of voxels (i, j, k); `None` selects the whole volume. `mask` covers the whole volume and is
    /// not 0 where voxels may be open; `None` opens all voxels of the region.
    ///
    /// # Errors
    ///
    /// Returns an error if an array has the wrong size or the region is not in the volume.
    pub fn new(
        grid: &Grid,
        values: &'a [f32],
        region: Option<[Range<usize>; 3]>,
        mask: Option<&'a [u8]>,
    ) -> Result<Self, TrackError> {
        let volume_ijk = grid.shape_ijk();
        let num_voxels: usize = volume_ijk.iter().product();
        for (what, len) in [
            ("field", Some(values.len())),
            ("mask", mask.map(<[u8]>::len)),
        ] {
            if let Some(len) = len.filter(|len| *len != num_voxels) {
                return Err(TrackError::Argument {
                    what,
                    expected: format!("{num_voxels} voxels"),
                    found: len.to_string(),
                });
            }
        }
        let region = region.unwrap_or_else(|| volume_ijk.map(|n| 0..n));
        for axis in 0..3 {
            let range = &region[axis];
            if range.start >= range.end || range.end > volume_ijk[axis] {
                return Err(TrackError::Argument {
                    what: "region",
                    expected: format!(
                        "a box with voxels, inside 0..{} on axis {axis}",
                        volume_ijk[axis]
                    ),
                    found: format!("{range:?}"),
                });
            }
        }
        let lengths_mm = std::array::from_fn(|cell| {
            length(
                grid.lps_from_ijk()
                    .vector(offset(cell).map(|step| step as f64)),
            ) as f32
        });
        Ok(Self {
            values,
            mask,
            volume_ijk,
            first_ijk: std::array::from_fn(|a| region[a].start),
            shape_ijk: std::array::from_fn(|a| region[a].len()),
            lengths_mm,
            axes_mm: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
                .map(|step| grid.lps_from_ijk().vector(step)),
        })
    }

    /// Return the number of voxels of the search box along i, j, k.
    #[must_use]
    pub const fn shape_ijk(&self) -> [usize; 3] {
        self.shape_ijk
    }

    /// Return the number of voxels of the search box; nodes are `0..num_nodes`, x fastest.
    #[must_use]
    pub fn num_nodes(&self) -> usize {
        self.shape_ijk.iter().product()
    }

    /// Return the node of a voxel of the volume; `None` outside the search box.
    #[must_use]
    pub fn node_at_voxel(&self, ijk: [usize; 3]) -> Option<u32> {
        let at: [usize; 3] = std::array::from_fn(|a| ijk[a].wrapping_sub(self.first_ijk[a]));
        (0..3)
            .all(|a| at[a] < self.shape_ijk[a])
            .then(|| ((at[2] * self.shape_ijk[1] + at[1]) * self.shape_ijk[0] + at[0]) as u32)
    }

    /// Return the voxel of the volume that a node represents.
    #[must_use]
    pub fn voxel(&self, node: u32) -> [usize; 3] {
        let n = node as usize;
        let [nx, ny, _] = self.shape_ijk;
        let at = [n % nx, n / nx % ny, n / (nx * ny)];
        std::array::from_fn(|a| at[a] + self.first_ijk[a])
    }

    /// Return true if a path may use the voxel of a node.
    #[must_use]
    pub fn is_open(&self, node: u32) -> bool {
        let at = self.place(node);
        self.values[at].is_finite() && self.mask.is_none_or(|mask| mask[at] != 0)
    }

    /// Return the weight of a node's voxel.
    #[must_use]
    pub fn value(&self, node: u32) -> f32 {
        self.values[self.place(node)]
    }

    /// Return the index in the volume's arrays of the voxel of a node.
    fn place(&self, node: u32) -> usize {
        let [i, j, k] = self.voxel(node);
        self.row(j, k) + i
    }

    fn row(&self, j: usize, k: usize) -> usize {
        (k * self.volume_ijk[1] + j) * self.volume_ijk[0]
    }

    /// Return the straight-line length of an offset in voxels, mm.
    pub(crate) fn length_mm(&self, ijk: [f64; 3]) -> f64 {
        length(std::array::from_fn(|x| {
            (0..3).map(|axis| ijk[axis] * self.axes_mm[axis][x]).sum()
        }))
    }

    /// Return the weights of the whole volume.
    pub(crate) const fn values(&self) -> &[f32] {
        self.values
    }

    /// Return the index in the volume's arrays of the box's first voxel, and the strides of rows and slices.
    pub(crate) fn layout(&self) -> (usize, usize, usize) {
        let [i, j, k] = self.first_ijk;
        (
            self.row(j, k) + i,
            self.volume_ijk[0],
            self.volume_ijk[0] * self.volume_ijk[1],
        )
    }

    /// Return the mask of the whole volume; `None` if all voxels of the region may be open.
    pub(crate) const fn mask(&self) -> Option<&[u8]> {
        self.mask
    }

    /// Return true if the mask includes the voxel at an index of the volume's arrays, or if there is no mask.
    #[inline(always)]
    pub(crate) fn is_in_mask(&self, at: usize) -> bool {
        self.mask.is_none_or(|mask| mask[at] != 0)
    }

    /// Return the rows of the search box in the order of their nodes: the weights, and the mask if there is one.
    pub(crate) fn rows(&self) -> impl Iterator<Item = (&'a [f32], Option<&'a [u8]>)> + '_ {
        let [i, first_j, first_k] = self.first_ijk;
        let [nx, ny, nz] = self.shape_ijk;
        (0..nz).flat_map(move |k| {
            (0..ny).map(move |j| {
                let at = self.row(first_j + j, first_k + k) + i;
                (
                    &self.values[at..at + nx],
                    self.mask.map(|mask| &mask[at..at + nx]),
                )
            })
        })
    }

    fn weights(&self) -> Result<Weights, TrackError> {
        let mut all = Weights {
            least: f32::INFINITY,
            greatest: 0.0,
            any_zero: false,
            whole: true,
            num_open: 0,
        };
        let mut negative = false;
        let mut see = |weights: &[f32], mask: Option<&[u8]>| {
            let seen = match mask {
                None => Row::of(weights, all.whole),
                Some(mask) => {
                    let inside = weights.iter().zip(mask).filter(|(_, inside)| **inside != 0);
                    let inside: Vec<f32> = inside.map(|(weight, _)| *weight).collect();
                    Row::of(&inside, all.whole)
                }
            };
            all.least = all.least.min(seen.least);
            all.greatest = all.greatest.max(seen.greatest);
            negative |= seen.negative;
            all.any_zero |= seen.any_zero;
            all.whole &= seen.whole;
            all.num_open += seen.num_open;
        };
        if self.mask.is_none() && self.shape_ijk[..2] == self.volume_ijk[..2] {
            // Whole slices are contiguous in memory, so they are processed in longer pieces than rows.
            let first = self.layout().0;
            let weights = &self.values[first..first + self.num_nodes()];
            weights.chunks(PIECE).for_each(|piece| see(piece, None));
        } else {
            self.rows().for_each(|(row, mask)| see(row, mask));
        }
        if negative {
            return Err(TrackError::Argument {
                what: "field",
                expected: "weights of at least 0".to_owned(),
                found: "a negative one; shift the weights".to_owned(),
            });
        }
        Ok(all)
    }

    /// Call `visit(neighbour, quanta)` for every step from a node to an open neighbour.
    pub fn for_each_step<C: StepCost>(
        &self,
        quanta: &Quanta<C>,
        node: u32,
        mut visit: impl FnMut(u32, u64),
    ) {
        let from = self.voxel(node);
        for cell in (0..27).filter(|cell| *cell != HERE) {
            let step = offset(cell);
            let to = std::array::from_fn(|a| from[a].wrapping_add_signed(step[a]));
            if let Some(neighbour) = self.node_at_voxel(to).filter(|v| self.is_open(*v)) {
                let cost = quanta.of_step(self.value(node), self.value(neighbour), cell);
                visit(neighbour, u64::from(cost));
            }
        }
    }
}

/// Cost of a step between neighbouring voxels, computed from their weights and the length of the step.
pub trait StepCost: Copy + Sync + Send + 'static {
    /// Whether the cost of a step depends only on the voxel that the step enters.
    ///
    /// The first path that reaches a voxel then has the least cost.
    const BY_VOXEL: bool;

    /// Return the part of a step's cost that depends on the weights of its two voxels.
    fn weight(from: f32, into: f32) -> f32;

    /// Return the factor by which the weight of a step with a length in mm is multiplied.
    fn factor(length_mm: f32) -> f64;
}

/// Cost of a step that equals the weight of the voxel that it enters, for any length of the step.
///
/// `dijkstra3d` uses this cost. The root itself costs nothing. Weights must be 0 or more.
#[derive(Debug, Clone, Copy)]
pub struct EnterCost;

/// Cost of a step that equals its length in mm times the mean weight of its two voxels.
///
/// Weights must be above 0.
#[derive(Debug, Clone, Copy)]
pub struct MeanCost;

impl StepCost for EnterCost {
    const BY_VOXEL: bool = true;

    #[inline(always)]
    fn weight(_from: f32, into: f32) -> f32 {
        into
    }

    fn factor(_length_mm: f32) -> f64 {
        1.0
    }
}

impl StepCost for MeanCost {
    const BY_VOXEL: bool = false;

    #[inline(always)]
    fn weight(from: f32, into: f32) -> f32 {
        from + into
    }

    fn factor(length_mm: f32) -> f64 {
        0.5 * f64::from(length_mm)
    }
}

/// Integer unit (quantum) of the costs of one search, which converts the cost of every step to quanta.
#[derive(Debug, Clone, Copy)]
pub struct Quanta<C> {
    /// Path cost that one quantum represents: a weight, or a weight times a length in mm.
    pub unit: f64,
    /// Quanta that a step costs per unit of weight, for each of the 27 voxels of the neighbourhood in rows of three.
    ///
    /// The fourth item of each row is unused: it fills a vector register of four lanes.
    pub(crate) scale: [[f32; 4]; 9],
    pub(crate) cheapest: f32,
    pub(crate) dearest: f32,
    /// Minimum weight above 0 in the field.
    pub(crate) least: f32,
    /// Number of open voxels of the field.
    pub num_open: usize,
    cost: std::marker::PhantomData<C>,
}

/// Number that, added to an f32 below 2^22, rounds it to an integer (ties to even), which is then in the low bits.
const ROUNDING: f32 = 8_388_608.0;

/// Return the integer nearest to an f32 from 0 to 2^22.
#[inline(always)]
pub(crate) fn rounded(x: f32) -> i32 {
    (x + ROUNDING).to_bits() as i32 - ROUNDING.to_bits() as i32
}

impl<C: StepCost> Quanta<C> {
    /// Choose the quantum for a field: 1 if all costs are integers, otherwise 1/128 of the cheapest step.
    ///
    /// # Errors
    ///
    /// Returns an error if no voxel is open, if a weight is not allowed for this cost, or if the range of the costs is
    /// too wide.
    pub fn choose(field: &VoxelField<'_>) -> Result<Self, TrackError> {
        let weights = field.weights()?;
        if weights.num_open == 0 {
            return Err(TrackError::NoResult(
                "no voxel of the region is open".to_owned(),
            ));
        }
        if weights.any_zero && !C::BY_VOXEL {
            return Err(TrackError::Argument {
                what: "field",
                expected: "weights above 0".to_owned(),
                found: "a weight of 0; add a small number to the weights".to_owned(),
            });
        }
        let steps = (0..27).filter(|cell| *cell != HERE);
        let factors = steps.map(|cell| C::factor(field.lengths_mm[cell]));
        let (shortest, longest) = factors.fold((f64::INFINITY, 0.0f64), |(low, high), f| {
            (low.min(f), high.max(f))
        });
        // If all weights are 0, any quantum is correct.
        let least = if weights.least.is_finite() {
            weights.least
        } else {
            1.0
        };
        let cheapest = f64::from(C::weight(least, least)) * shortest;
        let dearest = f64::from(C::weight(weights.greatest, weights.greatest)) * longest;
        let whole = C::BY_VOXEL && weights.whole && dearest < f64::from(MAX_STEP_QUANTA);
        let unit = if whole {
            1.0
        } else {
            cheapest / f64::from(CHEAPEST_STEP_QUANTA)
        };
        let most = (dearest / unit).ceil();
        if !(unit > 0.0 && most < f64::from(MAX_STEP_QUANTA)) {
            return Err(TrackError::CostRange {
                ratio: dearest / cheapest,
            });
        }
        let scale: [[f32; 4]; 9] = std::array::from_fn(|row| {
            std::array::from_fn(|lane| {
                let cell = 3 * row + lane;
                if lane == 3 || cell == HERE {
                    return 0.0;
                }
                (C::factor(field.lengths_mm[cell]) / unit) as f32
            })
        });
        // The limit is computed in f32 like the steps, so that no step between open voxels is clipped.
        let longest = scale.as_flattened().iter().copied().fold(0.0, f32::max);
        let most = most.max(f64::from(rounded(
            C::weight(weights.greatest, weights.greatest) * longest,
        )));
        Ok(Self {
            unit,
            scale,
            cheapest: if weights.any_zero {
                0.0
            } else {
                (cheapest / unit).round() as f32
            },
            dearest: most.max(1.0) as f32,
            least,
            num_open: weights.num_open,
            cost: std::marker::PhantomData,
        })
    }

    /// Return the cost in quanta of a step in the direction of `cell`, from the weights of its two voxels.
    #[inline(always)]
    #[must_use]
    pub(crate) fn of_step(&self, from: f32, into: f32, cell: usize) -> u32 {
        self.of_lane(from, into, self.scale[cell / 3][cell % 3]) as u32
    }

    #[inline(always)]
    pub(crate) fn of_lane(&self, from: f32, into: f32, scale: f32) -> i32 {
        let x = C::weight(from, into) * scale;
        // The order of the comparison gives a NaN weight the largest cost.
        let x = if x < self.dearest { x } else { self.dearest };
        rounded(if x > self.cheapest { x } else { self.cheapest })
    }
}

/// Return the least cost in quanta from `root` to every node of the field; `None` for a node that no path reaches.
///
/// The function is the reference for the trackers: Dijkstra's algorithm with a heap.
#[must_use]
pub fn least_costs<C: StepCost>(
    field: &VoxelField<'_>,
    quanta: &Quanta<C>,
    root: u32,
) -> Vec<Option<u64>> {
    least_costs_by(field.num_nodes(), root, |node, visit| {
        field.for_each_step(quanta, node, visit);
    })
}
