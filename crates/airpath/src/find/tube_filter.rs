//! How much darker a short piece of a thin tube is in its middle than on its sides, whatever way the tube runs.
//!
//! The wall of a lumen of one or two voxels is blurred into it. What is left is a bright thread whose middle is a little
//! darker, by less than the noise of a voxel: a rule that looks from one voxel ([`crate::find::tubeness`]) loses it. Means
//! along the tube do not. So values are added up along straight pieces, in the middle and on eight sides of it. The *dip*
//! of a piece is how far the second darkest side rises over the middle (one side may open into a branch). It counts where
//! the sides are alike, where they are as bright as a wall can be, and where the middle is as dark as a tube that wide is:
//! lung between vessels is surrounded on some sides, is wide, and too bright for its width.

use carina_grid::Grid;

/// Directions that are tried, over half a sphere: any tube is within 12 degrees of one.
const NUM_DIRECTIONS: usize = 64;
/// Sides that are looked at round an axis.
pub(crate) const NUM_SIDES: usize = 8;
/// Places along a piece, and how far apart they are, mm.
const NUM_ALONG: usize = 7;
const STEP_MM: f64 = 0.75;
/// The crest of the wall is looked for at these distances, mm: thin lumens, blurred. A wall farther out is not that thin.
const CRESTS_MM: [f64; 3] = [0.65, 0.75, 1.1];
/// A wall that thin has lung behind it, at this distance, on so many sides; an artery lies along the others.
const BEYOND_MM: f64 = 2.4;
const LEAST_BEYOND: usize = 4;
/// A blurred lumen reaches half-way up its wall at this share of the crest's distance.
const HALF_WAY: f64 = 0.5;
/// The second darkest side rises at least this share of the mean rise.
pub(crate) const ROUNDNESS: f64 = 0.5;

/// What a thin airway's section looks like, in the volume's numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ThinSection {
    pub(crate) air: f64,
    /// A wall is at least this bright.
    pub(crate) least_wall: f64,
    /// What blurs (sigma), mm.
    pub(crate) blur_mm: f64,
    /// Lung round the airways.
    pub(crate) lung: f64,
}

impl ThinSection {
    /// Darker than this is lung behind a wall, and no more wall.
    pub(crate) fn beyond(&self, wall: f64) -> f64 {
        0.5 * (wall + self.lung)
    }

    /// Whether a middle is as dark as that of a tube: blur leaves `exp(-r^2 / 2 s^2)` of the wall's brightness in it.
    pub(crate) fn is_dark(&self, middle: f64, wall: f64, radius_mm: f64) -> bool {
        middle - self.air <= (-0.5 * (radius_mm / self.blur_mm).powi(2)).exp() * (wall - self.air)
    }
}

/// The filter on one grid.
#[derive(Debug)]
pub(crate) struct TubeFilter {
    shape: [isize; 3],
    margin: [isize; 3],
    /// How far in memory the pieces of a voxel reach, back and forth.
    reach: usize,
    directions: Vec<Direction>,
    section: ThinSection,
}

/// Where the values of a piece stand in memory, from the first voxel that any piece reaches.
type Steps = [u32; NUM_ALONG];

#[derive(Debug)]
struct Direction {
    middle: Steps,
    /// Each side at each crest.
    crests: [[Steps; NUM_SIDES]; CRESTS_MM.len()],
    /// Each side behind the wall.
    beyond: [Steps; NUM_SIDES],
}

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
                Direction {
                    middle: std::array::from_fn(|n| place(n, [0.0; 3])),
                    crests: CRESTS_MM.map(ring),
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

    /// The dip at a voxel; 0 where there is no tube, or where the volume ends.
    pub(crate) fn dip(&self, values: &[i16], voxel: usize) -> i16 {
        let [nx, ny, _] = self.shape;
        let at = voxel as isize;
        let ijk = [at % nx, at / nx % ny, at / nx / ny];
        if !(0..3).all(|a| ijk[a] >= self.margin[a] && ijk[a] < self.shape[a] - self.margin[a]) {
            return 0;
        }
        let window = &values[voxel - self.reach..=voxel + self.reach];
        let sum = |steps: &Steps| -> i32 {
            steps
                .iter()
                .map(|step| i32::from(window[*step as usize]))
                .sum()
        };
        let mean = |sum: i32| f64::from(sum) / NUM_ALONG as f64;
        let mut best = 0;
        for direction in &self.directions {
            let middle = sum(&direction.middle);
            for (crest, crest_mm) in direction.crests.iter().zip(CRESTS_MM) {
                let Some((second, total)) = risen(crest, sum, middle + best) else {
                    continue;
                };
                let wall = mean(total) / NUM_SIDES as f64;
                let is_round = f64::from(second - middle)
                    >= ROUNDNESS * NUM_ALONG as f64 * (wall - mean(middle));
                if is_round
                    && wall >= self.section.least_wall
                    && self
                        .section
                        .is_dark(mean(middle), wall, HALF_WAY * crest_mm)
                    && is_thin(
                        &direction.beyond,
                        sum,
                        NUM_ALONG as f64 * self.section.beyond(wall),
                    )
                {
                    best = second - middle;
                }
            }
        }
        (best / NUM_ALONG as i32) as i16
    }
}

/// Whether enough sides are darker than `most` behind the wall.
fn is_thin(
    sides: &[Steps; NUM_SIDES],
    sum: impl Fn(&Steps) -> i32,
    most: f64,
) -> bool {
    let dark = sides.iter().filter(|side| f64::from(sum(side)) < most);
    dark.count() >= LEAST_BEYOND
}

/// The second darkest of the sides, and the sum of all; none where it is not above `least`.
fn risen(
    sides: &[Steps; NUM_SIDES],
    sum: impl Fn(&Steps) -> i32,
    least: i32,
) -> Option<(i32, i32)> {
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
    Some((second, total))
}

/// One side of an axis.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Side {
    unit: [f64; 3],
    /// Nearer than this it is the voxel of the axis itself, mm.
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

    /// The place on this side at a distance, mm; in the next voxel at least.
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

/// Two unit vectors across a direction, and across each other.
pub(crate) fn across(along: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let smallest = (0..3)
        .min_by(|a, b| along[*a].abs().total_cmp(&along[*b].abs()))
        .unwrap_or(0);
    let mut helper = [0.0; 3];
    helper[smallest] = 1.0;
    let across = carina_grid::unit(carina_grid::cross(along, helper)).unwrap_or([1.0, 0.0, 0.0]);
    (across, carina_grid::cross(along, across))
}

/// Unit vectors spread evenly over half a sphere (a Fibonacci lattice).
fn half_sphere(num: usize) -> impl Iterator<Item = [f64; 3]> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..num).map(move |n| {
        let z = 1.0 - (n as f64 + 0.5) / num as f64;
        let across = (1.0 - z * z).sqrt();
        let (sin, cos) = (golden * n as f64).sin_cos();
        [across * cos, across * sin, z]
    })
}
