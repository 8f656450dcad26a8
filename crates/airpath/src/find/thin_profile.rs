//! Profile of the CT values round a path, averaged along the path, and the part of a path that is a thin airway.
//!
//! The *dip* at a position is the rise from the middle to the second darkest side. The *crest* is the brightest
//! distance of a side: the top of its wall.

use carina_grid::VolumeView;
use carina_leastcost::lumen::interpolated;

use crate::find::tube_filter::{NUM_SIDES, ROUNDNESS, ThinSection, across, sides};

/// Distance in mm between the examined positions along a path.
pub(crate) const EVERY_MM: f64 = 0.5;
/// Number of positions on each side of a position over which values are averaged: 5 mm of path in total.
const NUM_MEAN: usize = 5;
/// Number of positions on each side over which the zigzag of a path between voxels is smoothed.
const NUM_SMOOTHED: usize = 2;
/// Number of positions before and after a position between which the direction of the path is measured.
const NUM_DIRECTION: usize = 3;
/// Offsets across a path at which a darker position is searched, mm.
const OFFSETS_MM: [f64; 2] = [0.25, 0.5];
/// Number of compared positions: the path itself and eight directions at each distance of `OFFSETS_MM`.
const NUM_OFFSETS: usize = 1 + 8 * OFFSETS_MM.len();
/// Number of rounds in which each position of a path moves to the darkest position near it.
const NUM_CENTRED: usize = 2;
/// Distances from the middle of a path at which the values of its sides are read, mm.
const DISTANCES_MM: [f64; 8] = [0.6, 0.8, 1.0, 1.25, 1.6, 2.1, 2.6, 3.2];
/// Number of values of `DISTANCES_MM`, from the first, at which the crest of a wall is searched.
const NUM_CRESTS: usize = 6;
/// Maximum gain of a path by one position (the amount by which the position speaks for an airway), as a multiple of the
/// dip threshold.
///
/// The limit prevents that one bright wall compensates for a long part without wall.
const MAX_GAIN: f64 = 3.0;
/// Minimum mean dip of an accepted path (rise from its middle to its second darkest side), as a multiple of the dip
/// threshold.
const ACCEPTED_MEAN: f64 = 1.2;
/// Minimum share of the positions of an accepted path that look like an airway.
const ACCEPTED_SHARE: f64 = 0.75;
/// Maximum distance from the middle of a thin airway to the crest of its wall, mm.
const FARTHEST_CREST_MM: f64 = 1.3;
/// Minimum mean number of the 8 sides of a thin airway behind whose wall there is lung; behind the others there may be
/// an artery.
const MIN_THIN: f64 = 4.5;
/// Maximum standard deviation in mm of the radius along the path of a thin airway.
const STEADY_MM: f64 = 0.06;

/// Number of positions at the start of a path whose brightness is compared with the median of the path.
const NUM_FIRST: usize = 4;
/// Maximum difference between the brightest of the first `NUM_FIRST` positions and the median of the path, as a
/// fraction of the median rise to the wall.
const OPENNESS: f64 = 0.65;

/// Minimum rise of the second darkest side, as a fraction of the rise of the median side; the median over a whole path
/// counts.
const ROUND_WAY: f64 = 0.4;
/// Radius in mm above which a CT does not show reliably on how many sides a wall is.
const WIDE_MM: f64 = 1.3;

/// Positions along a path, each with CT values averaged over 5 mm of the path.
#[derive(Debug, Clone)]
pub(crate) struct Profile {
    pub(crate) places: Vec<Place>,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    /// Coordinates in mm along the grid's axes.
    pub(crate) mm: [f64; 3],
    /// HU on the axis of the airway at this position alone.
    unsmoothed: f64,
    /// HU on the axis of the airway at this position, averaged along the path.
    pub(crate) middle: f64,
    /// Rise of HU from the axis to the second darkest side.
    dip: f64,
    /// Rise of HU from the axis to the median side.
    pub(crate) rise: f64,
    /// Distance from the axis at which the median side is half-way up its wall, mm.
    pub(crate) radius_mm: f64,
    /// Distance from the axis at which the median side is brightest, mm.
    crest_mm: f64,
    /// Lowest value of each side beyond the crest of its wall.
    beyond: [f64; NUM_SIDES],
}

/// Requirements for an accepted path along a thin airway.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Requirements {
    pub(crate) section: ThinSection,
    pub(crate) dip: f64,
    pub(crate) length_mm: f64,
}

impl Profile {
    /// Compute the profile of a path through adjacent voxels; return `None` if the path has only one position.
    pub(crate) fn of_path(values: VolumeView<'_, i16>, voxels: &[u32]) -> Option<Self> {
        let curve = evenly(values, voxels);
        (curve.len() > 1).then(|| Self::along(values, &curve))
    }

    /// Move each position of a path to the darkest value near it and compute the profile; return `None` if the path has
    /// only one position.
    pub(crate) fn centred(values: VolumeView<'_, i16>, voxels: &[u32]) -> Option<Self> {
        let curve = evenly(values, voxels);
        let moved = |curve: Vec<[f64; 3]>, _| centred(&curve, |mm| value_at(values, mm));
        (curve.len() > 1).then(|| Self::along(values, &(0..NUM_CENTRED).fold(curve, moved)))
    }

    fn along(values: VolumeView<'_, i16>, curve: &[[f64; 3]]) -> Self {
        let spacing = values.grid().spacing_mm();
        let at = |mm| value_at(values, mm);
        let last = curve.len() - 1;
        let sections: Vec<SideValues> = frames(curve)
            .zip(curve)
            .map(|([first, second], middle)| {
                let sides = sides(first, second, spacing);
                SideValues {
                    middle: at(*middle),
                    walls: DISTANCES_MM.map(|distance| {
                        sides.map(|side| {
                            let out = side.at(distance);
                            at(std::array::from_fn(|a| middle[a] + out[a]))
                        })
                    }),
                }
            })
            .collect();
        let places = (0..curve.len())
            .map(|n| {
                let near = &sections[n.saturating_sub(NUM_MEAN)..=(n + NUM_MEAN).min(last)];
                Place::of_mean(curve[n], sections[n].middle, near)
            })
            .collect();
        Self { places }
    }

    /// Return the number of positions, counted from the first, that qualify as an airway.
    ///
    /// This first part of the path is the one with the largest sum of gains. The result is 0 if that part does not
    /// qualify.
    pub(crate) fn accepted_length(&self, requirements: &Requirements) -> usize {
        let (mut gain, mut most, mut num) = (0.0, 0.0, 0);
        let looks: Vec<bool> = self
            .places
            .iter()
            .map(|p| p.looks_like(requirements))
            .collect();
        for (n, (place, looks)) in self.places.iter().zip(&looks).enumerate() {
            gain += if *looks {
                (place.dip / requirements.dip).min(MAX_GAIN) - 1.0
            } else {
                -1.0
            };
            if gain > most {
                (most, num) = (gain, n + 1);
            }
        }
        if num == 0 || length_mm(num) < requirements.length_mm {
            return 0;
        }
        let sum: f64 = self.places[..num]
            .iter()
            .map(|p| p.dip.min(MAX_GAIN * requirements.dip))
            .sum();
        let alike = looks[..num].iter().filter(|l| **l).count();
        let is_kept = sum >= ACCEPTED_MEAN * requirements.dip * num as f64
            && alike as f64 >= ACCEPTED_SHARE * num as f64;
        if is_kept && self.is_open(num) && self.is_thin_and_steady(num, &requirements.section) {
            num
        } else {
            0
        }
    }

    /// Return whether the first `num` positions have a wall as thin as an airway's and a radius constant along the
    /// path.
    ///
    /// A space between vessels does not satisfy this.
    fn is_thin_and_steady(&self, num: usize, section: &ThinSection) -> bool {
        let places = &self.places[..num];
        let mean =
            |value: &dyn Fn(&Place) -> f64| places.iter().map(value).sum::<f64>() / num as f64;
        let radius_mm = mean(&|p| p.radius_mm);
        let varies_mm = mean(&|p| (p.radius_mm - radius_mm).powi(2)).sqrt();
        median(places, |p| p.crest_mm) <= FARTHEST_CREST_MM
            && mean(&|p| p.num_thin(section)) >= MIN_THIN
            && varies_mm <= STEADY_MM
    }

    /// Return whether the lumen of the path opens into the airway from which the path branches.
    ///
    /// A path whose first positions are much brighter begins in the wall of that airway and leads to lung beside it.
    fn is_open(&self, num: usize) -> bool {
        let places = &self.places[..num];
        let first = &places[..NUM_FIRST.min(num)];
        let brightest = first.iter().map(|p| p.unsmoothed).fold(f64::MIN, f64::max);
        brightest - median(places, |p| p.unsmoothed) <= OPENNESS * median(places, |p| p.rise)
    }

    /// Return whether the path has wall on all sides; a groove between a vessel and a wall is open on one side.
    ///
    /// The result is always true for a path with a wide lumen.
    pub(crate) fn is_round(&self) -> bool {
        median(&self.places, |p| p.radius_mm) > WIDE_MM
            || median(&self.places, |p| p.dip / p.rise.max(1.0)) >= ROUND_WAY
    }

    /// Return the mean dip (rise from the middle to the second darkest side) of the first `num` positions.
    pub(crate) fn mean_dip(&self, num: usize) -> f64 {
        self.places[..num].iter().map(|p| p.dip).sum::<f64>() / num.max(1) as f64
    }
}

fn median(places: &[Place], value: impl Fn(&Place) -> f64) -> f64 {
    let mut values: Vec<f64> = places.iter().map(value).collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Return the length in mm of a path of `num` positions.
pub(crate) fn length_mm(num: usize) -> f64 {
    EVERY_MM * num as f64
}

fn value_at(values: VolumeView<'_, i16>, mm: [f64; 3]) -> f64 {
    let spacing = values.grid().spacing_mm();
    f64::from(interpolated(
        values,
        std::array::from_fn(|a| mm[a] / spacing[a]),
    ))
}

/// CT values at one position of a path: in the middle, and at several distances on each side.
struct SideValues {
    middle: f64,
    walls: [[f64; NUM_SIDES]; DISTANCES_MM.len()],
}

impl Place {
    fn of_mean(mm: [f64; 3], unsmoothed: f64, near: &[SideValues]) -> Self {
        let mean = |value: &dyn Fn(&SideValues) -> f64| {
            near.iter().map(value).sum::<f64>() / near.len() as f64
        };
        let middle = mean(&|sections| sections.middle);
        let (mut dip, mut rises) = (f64::NEG_INFINITY, [0.0; NUM_CRESTS]);
        let ring: [[f64; NUM_SIDES]; DISTANCES_MM.len()] = std::array::from_fn(|d| {
            std::array::from_fn(|side| mean(&|sections| sections.walls[d][side]) - middle)
        });
        for (d, rise) in rises.iter_mut().enumerate() {
            let mut sides = ring[d];
            sides.sort_by(f64::total_cmp);
            dip = dip.max(sides[1]);
            *rise = 0.5 * (sides[NUM_SIDES / 2 - 1] + sides[NUM_SIDES / 2]);
        }
        let crest = (0..rises.len())
            .max_by(|a, b| rises[*a].total_cmp(&rises[*b]))
            .unwrap_or(0);
        let half = 0.5 * rises[crest];
        let outer = (0..=crest).find(|d| rises[*d] >= half).unwrap_or(crest);
        let (r, rise) = if outer == 0 {
            (0.0, 0.0)
        } else {
            (DISTANCES_MM[outer - 1], rises[outer - 1])
        };
        let share = ((half - rise) / (rises[outer] - rise).max(1e-9)).clamp(0.0, 1.0);
        Self {
            mm,
            unsmoothed,
            middle,
            dip,
            rise: rises[crest],
            radius_mm: r + share * (DISTANCES_MM[outer] - r),
            beyond: std::array::from_fn(|side| {
                ring[crest + 1..]
                    .iter()
                    .map(|r| r[side])
                    .fold(f64::MAX, f64::min)
                    + middle
            }),
            crest_mm: DISTANCES_MM[crest],
        }
    }

    /// Return the number of sides at this position with lung behind the wall.
    fn num_thin(&self, section: &ThinSection) -> f64 {
        let most = section.beyond(self.middle + self.rise);
        self.beyond.iter().filter(|side| **side < most).count() as f64
    }

    fn looks_like(&self, requirements: &Requirements) -> bool {
        let wall = self.middle + self.rise;
        self.rise > 0.0
            && wall >= requirements.section.least_wall
            && self.dip >= ROUNDNESS * self.rise
            && requirements
                .section
                .is_dark(self.middle, wall, self.radius_mm)
    }
}

/// Return at each position of a curve two unit vectors across the curve, rotated as little as possible between
/// positions.
fn frames(curve: &[[f64; 3]]) -> impl Iterator<Item = [[f64; 3]; 2]> {
    let last = curve.len() - 1;
    let mut up = None;
    (0..curve.len()).map(move |n| {
        let (a, b) = (
            n.saturating_sub(NUM_DIRECTION),
            (n + NUM_DIRECTION).min(last),
        );
        let along = carina_grid::unit(std::array::from_fn(|x| curve[b][x] - curve[a][x]))
            .unwrap_or([0.0, 0.0, 1.0]);
        // Each frame is derived from the previous one, without the component along the path, so that sides keep their
        // position round the path.
        let first = up
            .and_then(|before: [f64; 3]| {
                let part = carina_grid::dot(before, along);
                carina_grid::unit(std::array::from_fn(|a| before[a] - part * along[a]))
            })
            .unwrap_or_else(|| across(along).0);
        up = Some(first);
        [first, carina_grid::cross(along, first)]
    })
}

/// Return the curve with each position moved across it to the darkest near value, because a voxel path cuts corners.
fn centred(curve: &[[f64; 3]], at: impl Fn([f64; 3]) -> f64) -> Vec<[f64; 3]> {
    let last = curve.len() - 1;
    let moved = |n: usize, frame: &[[f64; 3]; 2], offset: [f64; 2]| -> [f64; 3] {
        std::array::from_fn(|a| curve[n][a] + offset[0] * frame[0][a] + offset[1] * frame[1][a])
    };
    let frames: Vec<[[f64; 3]; 2]> = frames(curve).collect();
    let sections: Vec<[f64; NUM_OFFSETS]> = (0..=last)
        .map(|n| std::array::from_fn(|o| at(moved(n, &frames[n], offset_mm(o)))))
        .collect();
    let darkest: Vec<[f64; 3]> = (0..=last)
        .map(|n| {
            let near = &sections[n.saturating_sub(NUM_MEAN)..=(n + NUM_MEAN).min(last)];
            let sum = |o: usize| near.iter().map(|values| values[o]).sum::<f64>();
            let best = (0..NUM_OFFSETS)
                .min_by(|a, b| sum(*a).total_cmp(&sum(*b)))
                .unwrap_or(0);
            moved(n, &frames[n], offset_mm(best))
        })
        .collect();
    smoothed(&darkest)
}

/// Return offset `n` across a path in mm: none for 0, then eight directions for each distance of `OFFSETS_MM`.
fn offset_mm(n: usize) -> [f64; 2] {
    let Some(n) = n.checked_sub(1) else {
        return [0.0; 2];
    };
    let (sin, cos) = (std::f64::consts::TAU * (n % 8) as f64 / 8.0).sin_cos();
    let mm = OFFSETS_MM[n / 8];
    [mm * cos, mm * sin]
}

/// Return a curve with each position replaced by the mean of its `NUM_SMOOTHED` neighbours on each side.
fn smoothed(curve: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let last = curve.len().saturating_sub(1);
    (0..curve.len())
        .map(|n| {
            let reach = NUM_SMOOTHED.min(n).min(last - n);
            let near = &curve[n - reach..=n + reach];
            std::array::from_fn(|a| near.iter().map(|p| p[a]).sum::<f64>() / near.len() as f64)
        })
        .collect()
}

/// Return positions at equal distances along a path of voxels, with the zigzag between voxels smoothed.
fn evenly(values: VolumeView<'_, i16>, voxels: &[u32]) -> Vec<[f64; 3]> {
    let grid = values.grid();
    let spacing = grid.spacing_mm();
    let corners: Vec<[f64; 3]> = voxels
        .iter()
        .map(|v| {
            let ijk = grid.voxel(*v as usize);
            std::array::from_fn(|a| ijk[a] as f64 * spacing[a])
        })
        .collect();
    let mut even = Vec::new();
    let mut next_mm = 0.0;
    let mut along_mm = 0.0;
    for pair in corners.windows(2) {
        let step: [f64; 3] = std::array::from_fn(|a| pair[1][a] - pair[0][a]);
        let step_mm = carina_grid::length(step);
        while next_mm <= along_mm + step_mm {
            let share = (next_mm - along_mm) / step_mm;
            even.push(std::array::from_fn(|a| pair[0][a] + share * step[a]));
            next_mm += EVERY_MM;
        }
        along_mm += step_mm;
    }
    smoothed(&even)
}
