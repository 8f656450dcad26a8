//! Filter for short straight pieces of thin tubes in any direction, by the difference between their sides and their
//! middle.
//!
//! The wall of a lumen of one or two voxels is blurred into the lumen. The result is a bright thread whose middle is a
//! little darker, by less than the noise of a voxel, so that a rule for single voxels ([`crate::find::tubeness`])
//! misses it. Means along the tube have less noise. So values are added along straight pieces, in the middle and on
//! eight sides of it. The *dip* of a piece is the rise of the second darkest side above the middle (one side may open
//! into a branch). A dip counts only if the sides are similar, if they are as bright as a wall can be, and if the
//! middle is as dark as in a tube of this width: lung between vessels is surrounded on some sides, is wide, and too
//! bright for its width.

use carina_grid::{Grid, InstructionSet};

/// Number of directions tested, over half a sphere: every tube is within 12 degrees of one of them.
const NUM_DIRECTIONS: usize = 64;
/// Number of sides, evenly round the axis, on which the wall of a tube is sampled.
pub(crate) const NUM_SIDES: usize = 8;
/// Number of sampled positions along the axis of a tube.
const NUM_ALONG: usize = 7;
/// Distance in mm between the sampled positions along the axis of a tube.
const STEP_MM: f64 = 0.75;
/// Distances from the axis at which the crest of the wall is searched, mm: those of thin blurred lumens.
///
/// A thin lumen has no wall farther out.
const CRESTS_MM: [f64; 3] = [0.65, 0.75, 1.1];
/// Distance from the axis, behind a thin wall, at which there must be lung, mm.
const BEYOND_MM: f64 = 2.4;
/// Minimum number of sides with lung behind the wall; the other sides may have an artery.
const MIN_BEYOND: usize = 4;
/// Distance from the axis at which the value is half-way up the wall of a blurred lumen, as a fraction of the crest's
/// distance.
const HALF_WAY: f64 = 0.5;
/// Minimum rise of the second darkest side, as a fraction of the mean rise of all sides.
pub(crate) const ROUNDNESS: f64 = 0.5;

/// Properties of a thin airway's cross-section, in the volume's numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ThinSection {
    pub(crate) air: f64,
    /// Minimum voxel value of the wall of an airway.
    pub(crate) least_wall: f64,
    /// Blur (sigma) of the CT, mm.
    pub(crate) blur_mm: f64,
    /// Voxel value of the lung round the airways.
    pub(crate) lung: f64,
}

impl ThinSection {
    /// Return the value half-way between lung and a wall; behind the wall, a darker voxel is lung.
    pub(crate) fn beyond(&self, wall: f64) -> f64 {
        0.5 * (wall + self.lung)
    }

    /// Return whether the value `middle` is as dark as the middle of a tube of this radius with this wall.
    ///
    /// Blur leaves `exp(-r^2 / 2 s^2)` of the wall's brightness in the middle of a tube.
    pub(crate) fn is_dark(&self, middle: f64, wall: f64, radius_mm: f64) -> bool {
        middle - self.air <= (-0.5 * (radius_mm / self.blur_mm).powi(2)).exp() * (wall - self.air)
    }
}

/// Filter for thin tubes on the voxels of one grid.
#[derive(Debug)]
pub(crate) struct TubeFilter {
    shape: [isize; 3],
    margin: [isize; 3],
    /// Maximum memory offset, in both directions, of the values that the filter reads round a voxel.
    reach: usize,
    directions: Vec<Direction>,
    section: ThinSection,
}

/// Memory offsets of the values along one line of a piece of tube, relative to the first voxel that the filter reads.
type Steps = [u32; NUM_ALONG];

#[derive(Debug)]
struct Direction {
    middle: Steps,
    crests: Vec<Crest>,
    /// Memory offsets of the values behind the wall on each side.
    beyond: [Steps; NUM_SIDES],
}

#[derive(Debug, Clone)]
struct Crest {
    mm: f64,
    sides: [Steps; NUM_SIDES],
}

/// Sums of the values along the sides of a piece of tube, at one distance of the crest.
#[derive(Debug, Clone, Copy)]
struct Sides {
    /// Sum of the values along the second darkest side of the tube.
    second: i32,
    total: i32,
}

/// Number of voxels, consecutive in memory, that the filter processes at once.
pub(crate) const BLOCK: usize = 8;

impl TubeFilter {
    pub(crate) fn new(grid: &Grid, section: ThinSection) -> Self {
        let shape = grid.shape_ijk().map(|n| n as isize);
        let spacing = grid.spacing_mm();
        let [nx, ny, _] = shape;
        let thickest = spacing.into_iter().fold(0.0, f64::max);
        let reach_mm = BEYOND_MM.max(thickest) + 0.5 * (NUM_ALONG - 1) as f64 * STEP_MM;
        let margin = spacing.map(|s| (reach_mm / s).ceil() as isize + 1);
        let reach = margin[0] + nx * (margin[1] + ny * margin[2]);
        let at = |mm: [f64; 3]| {
            let [i, j, k]: [isize; 3] =
                std::array::from_fn(|a| (mm[a] / spacing[a]).round() as isize);
            (reach + i + nx * (j + ny * k)) as u32
        };
        let directions = half_sphere(NUM_DIRECTIONS)
            .map(|along| {
                let (across, up) = across(along);
                let sides = sides(across, up, spacing);
                let place = |n: usize, out: [f64; 3]| {
                    let t = (n as f64 - 0.5 * (NUM_ALONG - 1) as f64) * STEP_MM;
                    at(std::array::from_fn(|a| t * along[a] + out[a]))
                };
                let ring = |mm: f64| {
                    sides.map(|side| {
                        let out = side.at(mm);
                        std::array::from_fn(|n| place(n, out))
                    })
                };
                let mut crests = CRESTS_MM
                    .map(|mm| Crest {
                        mm,
                        sides: ring(mm),
                    })
                    .to_vec();
                // With large voxels two crest distances may use the same voxels. Only the smaller distance is then
                // used, because it permits a brighter tube.
                crests.dedup_by(|next, last| next.sides == last.sides);
                Direction {
                    middle: std::array::from_fn(|n| place(n, [0.0; 3])),
                    crests,
                    beyond: ring(BEYOND_MM),
                }
            })
            .collect();
        Self {
            shape,
            margin,
            reach: reach as usize,
            directions,
            section,
        }
    }

    /// Return the dip at a voxel, the rise in value from a tube's middle to its second darkest side; 0 if there is no
    /// tube or not all values are in memory.
    ///
    /// This function is the definition; [`TubeFilter::dips`] computes the same result for many voxels faster.
    pub(crate) fn dip(&self, values: &[i16], voxel: usize) -> i16 {
        if !self.is_within(voxel) {
            return 0;
        }
        let window = &values[voxel - self.reach..=voxel + self.reach];
        let sum = |steps: &Steps| sum_of(window, steps);
        let mut best = 0;
        for direction in &self.directions {
            let middle = sum(&direction.middle);
            for crest in &direction.crests {
                if let Some(sides) = risen(&crest.sides, sum, middle + best)
                    && self.is_tube(direction, crest.mm, middle, sides, sum)
                {
                    best = sides.second - middle;
                }
            }
        }
        mean_dip(best)
    }

    /// Return the dips (rises in value from middle to sides) of [`BLOCK`] successive voxels, equal to
    /// [`TubeFilter::dip`] bit for bit.
    pub(crate) fn dips(&self, simd: InstructionSet, values: &[i16], first: usize) -> [i16; BLOCK] {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
            fn avx2(filter: &TubeFilter, values: &[i16], first: usize) -> [i16; BLOCK] {
                filter.block(values, first)
            }
            if matches!(simd, InstructionSet::Avx2 | InstructionSet::Avx512) {
                // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
                return unsafe { avx2(self, values, first) };
            }
        }
        let _ = simd;
        self.block(values, first)
    }

    #[expect(
        clippy::inline_always,
        reason = "compiled once for each instruction set"
    )]
    #[inline(always)]
    fn block(&self, values: &[i16], first: usize) -> [i16; BLOCK] {
        if first < self.reach || first + BLOCK + self.reach > values.len() {
            return std::array::from_fn(|lane| {
                let voxel = first + lane;
                if voxel < values.len() {
                    self.dip(values, voxel)
                } else {
                    0
                }
            });
        }
        let is_within: [bool; BLOCK] = std::array::from_fn(|lane| self.is_within(first + lane));
        if !is_within.contains(&true) {
            return [0; BLOCK];
        }
        let window = &values[first - self.reach..first + BLOCK + self.reach];
        let mut best = [0i32; BLOCK];
        for direction in &self.directions {
            let middle = sums_of(window, &direction.middle);
            for crest in &direction.crests {
                let least: [i32; BLOCK] = std::array::from_fn(|lane| {
                    if is_within[lane] {
                        middle[lane] + best[lane]
                    } else {
                        i32::MAX
                    }
                });
                let Some((second, total)) = risen_anywhere(window, &crest.sides, &least) else {
                    continue;
                };
                for lane in 0..BLOCK {
                    let sides = Sides {
                        second: second[lane],
                        total: total[lane],
                    };
                    let sum = |steps: &Steps| sum_of(&window[lane..], steps);
                    if second[lane] > least[lane]
                        && self.is_tube(direction, crest.mm, middle[lane], sides, sum)
                    {
                        best[lane] = second[lane] - middle[lane];
                    }
                }
            }
        }
        best.map(mean_dip)
    }

    /// Return whether all positions that the filter reads round a voxel are in the volume's memory.
    fn is_within(&self, voxel: usize) -> bool {
        let [nx, ny, _] = self.shape;
        let at = voxel as isize;
        let ijk = [at % nx, at / nx % ny, at / nx / ny];
        (0..3).all(|a| ijk[a] >= self.margin[a] && ijk[a] < self.shape[a] - self.margin[a])
    }

    /// Return whether a piece in one direction, whose sides are brighter than its middle, looks like a thin tube.
    fn is_tube(
        &self,
        direction: &Direction,
        crest_mm: f64,
        middle: i32,
        sides: Sides,
        sum: impl Fn(&Steps) -> i32,
    ) -> bool {
        let mean = |sum: i32| f64::from(sum) / NUM_ALONG as f64;
        let wall = mean(sides.total) / NUM_SIDES as f64;
        let is_round = f64::from(sides.second - middle)
            >= ROUNDNESS * NUM_ALONG as f64 * (wall - mean(middle));
        is_round
            && wall >= self.section.least_wall
            && self
                .section
                .is_dark(mean(middle), wall, HALF_WAY * crest_mm)
            && is_thin(
                &direction.beyond,
                sum,
                NUM_ALONG as f64 * self.section.beyond(wall),
            )
    }
}

/// Return the mean rise in value from the middle of a piece to its side, from the difference of the two sums.
const fn mean_dip(sum: i32) -> i16 {
    (sum / NUM_ALONG as i32) as i16
}

/// Return the sum of the values along one line of a piece; `window` begins with the first voxel that the filter reads.
fn sum_of(window: &[i16], steps: &Steps) -> i32 {
    steps
        .iter()
        .map(|step| i32::from(window[*step as usize]))
        .sum()
}

/// Return, for voxels that are consecutive in memory, the sums of the values along one line of a piece.
#[expect(
    clippy::inline_always,
    reason = "compiled once for each instruction set"
)]
#[inline(always)]
fn sums_of(window: &[i16], steps: &Steps) -> [i32; BLOCK] {
    let mut sums = [0; BLOCK];
    for step in steps {
        let Some(row) = window[*step as usize..].first_chunk::<BLOCK>() else {
            continue;
        };
        for lane in 0..BLOCK {
            sums[lane] += i32::from(row[lane]);
        }
    }
    sums
}

/// Return the measures of the sides of a piece, as [`risen`] does, for voxels that are consecutive in memory.
///
/// The result is `None` if for no voxel the second darkest side is above its `least`.
#[expect(
    clippy::inline_always,
    reason = "compiled once for each instruction set"
)]
#[inline(always)]
fn risen_anywhere(
    window: &[i16],
    sides: &[Steps; NUM_SIDES],
    least: &[i32; BLOCK],
) -> Option<([i32; BLOCK], [i32; BLOCK])> {
    let (mut darkest, mut second) = ([i32::MAX; BLOCK], [i32::MAX; BLOCK]);
    let mut total = [0; BLOCK];
    for side in sides {
        let side = sums_of(window, side);
        let mut is_above = false;
        for lane in 0..BLOCK {
            total[lane] += side[lane];
            second[lane] = second[lane].min(side[lane].max(darkest[lane]));
            darkest[lane] = darkest[lane].min(side[lane]);
            is_above |= second[lane] > least[lane];
        }
        if !is_above {
            return None;
        }
    }
    Some((second, total))
}

/// Return whether enough sides of a piece of tube are darker than `most` behind the wall.
fn is_thin(sides: &[Steps; NUM_SIDES], sum: impl Fn(&Steps) -> i32, most: f64) -> bool {
    let dark = sides.iter().filter(|side| f64::from(sum(side)) < most);
    dark.count() >= MIN_BEYOND
}

/// Return the measures of the sides of a piece; `None` if the sum of the second darkest side is not above `least`.
fn risen(sides: &[Steps; NUM_SIDES], sum: impl Fn(&Steps) -> i32, least: i32) -> Option<Sides> {
    let (mut darkest, mut second, mut total) = (i32::MAX, i32::MAX, 0);
    for side in sides {
        let side = sum(side);
        total += side;
        if side < darkest {
            (darkest, second) = (side, darkest);
        } else {
            second = second.min(side);
        }
        if second <= least {
            return None;
        }
    }
    Some(Sides { second, total })
}

/// Direction from an axis, across it, in which one side of a tube is read.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Side {
    unit: [f64; 3],
    /// Distance from the axis in mm up to which a position is still in the voxel of the axis.
    least_mm: f64,
}

impl Side {
    pub(crate) fn new(unit: [f64; 3], spacing: [f64; 3]) -> Self {
        let steps: f64 = (0..3).map(|a| (unit[a] / spacing[a]).powi(2)).sum();
        Self {
            unit,
            least_mm: 1.0 / steps.sqrt(),
        }
    }

    /// Return the vector in mm from the axis to this side, of length `distance_mm`, or longer if needed to leave the voxel.
    pub(crate) fn at(&self, distance_mm: f64) -> [f64; 3] {
        self.unit.map(|u| u * distance_mm.max(self.least_mm))
    }
}

pub(crate) fn sides(across: [f64; 3], up: [f64; 3], spacing: [f64; 3]) -> [Side; NUM_SIDES] {
    std::array::from_fn(|n| {
        let (sin, cos) = (std::f64::consts::TAU * n as f64 / NUM_SIDES as f64).sin_cos();
        Side::new(
            std::array::from_fn(|a| cos * across[a] + sin * up[a]),
            spacing,
        )
    })
}

/// Return two unit vectors that are perpendicular to a direction and to each other.
pub(crate) fn across(along: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let smallest = (0..3)
        .min_by(|a, b| along[*a].abs().total_cmp(&along[*b].abs()))
        .unwrap_or(0);
    let mut helper = [0.0; 3];
    helper[smallest] = 1.0;
    let across = carina_grid::unit(carina_grid::cross(along, helper)).unwrap_or([1.0, 0.0, 0.0]);
    (across, carina_grid::cross(along, across))
}

/// Return `num` unit vectors distributed evenly over half a sphere (a Fibonacci lattice).
fn half_sphere(num: usize) -> impl Iterator<Item = [f64; 3]> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..num).map(move |n| {
        let z = 1.0 - (n as f64 + 0.5) / num as f64;
        let across = (1.0 - z * z).sqrt();
        let (sin, cos) = (golden * n as f64).sin_cos();
        [across * cos, across * sin, z]
    })
}

#[cfg(test)]
mod tests {
    use carina_grid::Affine;
    use proptest::prelude::*;

    use super::*;

    /// Properties of a thin airway in the test volume.
    const SECTION: ThinSection = ThinSection {
        air: -1000.0,
        least_wall: -840.0,
        blur_mm: 0.8,
        lung: -870.0,
    };

    /// Draw a volume of noise with a bright thread that has a dark middle, at an angle to all axes.
    fn chest(grid: &Grid, seed: u64, noise: i64) -> Vec<i16> {
        let spacing = grid.spacing_mm();
        let mut state = seed | 1;
        (0..grid.num_voxels())
            .map(|at| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                let p = grid.voxel(at);
                let mm: [f64; 3] = std::array::from_fn(|a| (p[a] as f64 - 13.0) * spacing[a]);
                let along = carina_grid::unit([0.5, 0.3, 0.8]).unwrap();
                let off = carina_grid::length(carina_grid::cross(mm, along));
                let own = match off {
                    off if off < 0.5 => -800,
                    off if off < 1.3 => -620,
                    _ => -870,
                };
                (own + (state >> 33) as i64 % (noise + 1) - noise / 2) as i16
            })
            .collect()
    }

    fn grid(spacing: [f64; 3]) -> Grid {
        let place = Affine::from_columns(
            [spacing[0], 0.0, 0.0],
            [0.0, spacing[1], 0.0],
            [0.0, 0.0, spacing[2]],
            [0.0; 3],
        );
        Grid::new([27, 26, 29], place).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        #[test]
        fn dips_of_many_voxels_equal_the_dip_of_each_voxel(
            seed: u64,
            noise in 0..300i64,
            spacing in prop::array::uniform3(0.45..1.1),
        ) {
            let grid = grid(spacing);
            let values = chest(&grid, seed, noise);
            let filter = TubeFilter::new(&grid, SECTION);
            let alone: Vec<i16> = (0..values.len()).map(|at| filter.dip(&values, at)).collect();
            for simd in InstructionSet::available() {
                for first in (0..values.len()).step_by(BLOCK) {
                    let dips = filter.dips(simd, &values, first);
                    let num = BLOCK.min(values.len() - first);
                    prop_assert_eq!(&dips[..num], &alone[first..first + num], "{} at {}", simd.name(), first);
                }
            }
        }
    }

    #[test]
    fn the_dark_middle_of_a_thread_has_a_dip_and_lung_has_none() {
        let grid = grid([0.6, 0.6, 0.6]);
        let values = chest(&grid, 1, 0);
        let filter = TubeFilter::new(&grid, SECTION);
        assert!(filter.dip(&values, grid.index([13, 13, 13])) > 80);
        assert_eq!(filter.dip(&values, grid.index([10, 17, 13])), 0);
    }
}
