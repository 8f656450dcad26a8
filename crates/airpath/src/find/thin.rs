//! The thinnest airways: from the lumen along bright threads with a dark middle (docs/decisions/0112).
//!
//! An airway of one or two voxels is brighter than lung all through, and its middle is darker than its wall by less than the
//! noise. Its evidence is spread along it, so it is looked for along ways: a filter of short straight pieces
//! ([`crate::find::tube_filter`]) says where a way may lead and at what price, through gaps as well; of the cheapest ways to
//! the farthest tips the CT round each is averaged over 5 mm ([`crate::find::thin_profile`]), and the way is kept as far as
//! that looks like an airway.

use carina_grid::{Grid, VolumeView};
use carina_leastcost::{TrackError, Watch};
use rayon::prelude::*;

use crate::find::extension_levels::{EXTENDED, Followed, LUMEN};
use crate::find::thin_profile::{Asked, Place, Profile, length_mm};
use crate::find::thin_reach::{Dips, Reached, Ways};
use crate::find::tube_filter::{ThinSection, TubeFilter, across, sides};
use crate::find::tubeness::smoothed;

/// What the search may do; values are the volume's own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThinLimits {
    /// Air in the trachea.
    pub air: f64,
    /// Values of lung, the calibration's sample.
    pub lung: (i16, i16),
    /// Brighter than this is no lumen.
    pub brightest: i16,
    /// A wall is at least this bright: brighter than lung.
    pub least_wall: f64,
    /// Ways lead through voxels with a dip of this, or more where the lung pretends it.
    pub least_dip: f64,
    /// Averaged along it, an airway's dip is more than this.
    pub kept_dip: f64,
    /// What blurs the CT is at most so wide (sigma), mm.
    pub blur_mm: f64,
    /// An airway that goes on from an end leads at least this far, mm.
    pub min_length_mm: f64,
    /// And one that leaves from the side of another: shorter ways there are strands of lung that vessels close off.
    pub min_side_mm: f64,
    /// The search is given up once it has reached more than this share of the lung.
    pub most_reached: f64,
}

/// What was found.
#[derive(Debug, Clone, PartialEq)]
pub struct Thin {
    /// Airways, those that others leave from before them.
    pub followed: Vec<Followed>,
    /// Voxels that were reached before ways were judged.
    pub num_reached: usize,
    /// It reached more of the lung than airways can: nothing was added.
    pub ran_out: bool,
}

/// Share of the lung whose voxels have less of a dip than what is followed.
const FOLLOWED_SHARE: f64 = 0.985;
const MIN_SAMPLES: usize = 2_000;
const NUM_SAMPLES: usize = 20_000;
/// Voxels this near to a way are no tips of their own, mm; of one that was not kept, only those beside it.
const COVER_MM: f32 = 2.0;
const COVER_REFUSED_MM: f32 = 1.0;
/// A way whose voxels gain nothing, in thresholds, is not looked at any closer. One voxel gains at most so much.
const MOST_GAIN: f64 = 1.5;
/// Lumen beside a way lies within its radius and this, mm.
const MOST_RADIUS_MM: f64 = 1.0;

/// A way's start is so many places. Behind it there is lumen at these distances, and of 8 sides there at most so many are.
const NUM_START: usize = 7;
const BEHIND_MM: [f64; 2] = [1.2, 2.4];
const BESIDE_MM: f64 = 2.0;
const MOST_BESIDE: usize = 3;

/// Follows thin airways from `lumen` (1 inside, 0 outside) in place: what is added gets [`EXTENDED`].
pub fn extend_thin(
    values: VolumeView<'_, i16>,
    lumen: &mut [u8],
    limits: &ThinLimits,
    watch: &impl Watch,
) -> Result<Thin, TrackError> {
    watch.go_on(0.0)?;
    let grid = values.grid();
    let data = values.data();
    let smooth = smoothed(values);
    // A stride without a factor in common with rows and slices walks through all of the volume evenly.
    let stride = 1009;
    let sample: Vec<usize> = (0..data.len())
        .step_by(stride)
        .filter(|at| lumen[*at] == 0 && (limits.lung.0..=limits.lung.1).contains(&smooth[*at]))
        .collect();
    let most = if sample.len() < MIN_SAMPLES {
        usize::MAX
    } else {
        (limits.most_reached * (sample.len() * stride) as f64) as usize
    };
    let lung = median_lung(&sample, &smooth, limits);
    let section = ThinSection {
        air: limits.air,
        least_wall: limits.least_wall,
        blur_mm: limits.blur_mm,
        lung,
    };
    let filter = TubeFilter::new(grid, section);
    let asked_dip = pretended(&sample, |at| filter.dip(data, at)).max(limits.least_dip);
    let mut dips = Dips::new(&filter, data, &smooth, limits.brightest);
    let reached = Reached::from_lumen(grid, lumen, &mut dips, asked_dip, most, watch)?;
    drop(dips);
    let num_reached = reached.nodes.len();
    if num_reached > most {
        return Ok(Thin {
            followed: Vec::new(),
            num_reached,
            ran_out: true,
        });
    }
    let ways = reached.ways(lumen, asked_dip);
    let asked = Asked {
        section,
        dip: limits.kept_dip,
        length_mm: limits.min_length_mm,
    };
    let goes_on = |places: &[Place]| goes_on(grid, lumen, places);
    let asked_of = |places: &[Place]| Asked {
        length_mm: if goes_on(places) {
            limits.min_length_mm
        } else {
            limits.min_side_mm
        },
        ..asked
    };
    let kept = kept_ways(values, &reached, &ways, asked_dip, &asked, asked_of, watch)?;
    for way in &kept {
        fill(values, lumen, way);
    }
    let followed = kept
        .into_iter()
        .map(|way| Followed {
            length_mm: length_mm(way.places.len()),
            contrast: way.mean_dip / asked.dip,
            probability: 1.0,
            voxels: way.voxels,
        })
        .collect();
    Ok(Thin {
        followed,
        num_reached,
        ran_out: false,
    })
}

/// What lung is like in the sample.
fn median_lung(sample: &[usize], smooth: &[i16], limits: &ThinLimits) -> f64 {
    let mut values: Vec<i16> = sample.iter().map(|at| smooth[*at]).collect();
    values.sort_unstable();
    let middle = 0.5 * (f64::from(limits.lung.0) + f64::from(limits.lung.1));
    values
        .get(values.len() / 2)
        .map_or(middle, |value| f64::from(*value))
}

/// The dip that all but a few of the sampled voxels of lung stay below.
fn pretended(sample: &[usize], dip: impl Fn(usize) -> i16 + Sync) -> f64 {
    if sample.len() < MIN_SAMPLES {
        return 0.0;
    }
    let every = (sample.len() / NUM_SAMPLES).max(1);
    let mut dips: Vec<i16> = sample
        .par_iter()
        .step_by(every)
        .map(|at| dip(*at))
        .collect();
    dips.sort_unstable();
    f64::from(dips[((dips.len() - 1) as f64 * FOLLOWED_SHARE) as usize])
}

/// A way that is an airway.
struct Kept {
    voxels: Vec<u32>,
    places: Vec<Place>,
    mean_dip: f64,
}

/// Of the ways to all tips, the farthest first, what is an airway.
fn kept_ways(
    values: VolumeView<'_, i16>,
    reached: &Reached,
    ways: &Ways,
    asked_dip: f64,
    asked: &Asked,
    asked_of: impl Fn(&[Place]) -> Asked,
    watch: &impl Watch,
) -> Result<Vec<Kept>, TrackError> {
    let along_mm = |n: u32| ways.along_mm[n as usize];
    let mut tips: Vec<u32> = (0..reached.nodes.len() as u32)
        .filter(|n| {
            along_mm(*n).is_finite()
                && f64::from(along_mm(*n)) >= asked.length_mm
                && f64::from(reached.nodes[*n as usize].dip) >= asked_dip
        })
        .collect();
    tips.sort_by(|a, b| along_mm(*b).total_cmp(&along_mm(*a)).then(a.cmp(b)));
    let mut covered = vec![false; reached.nodes.len()];
    let mut is_kept = vec![false; reached.nodes.len()];
    let mut kept = Vec::new();
    for (n, tip) in tips.iter().enumerate() {
        if n.is_multiple_of(1 << 10) {
            watch.go_on(n as f64 / tips.len() as f64)?;
        }
        if covered[*tip as usize] {
            continue;
        }
        let mut way = vec![*tip];
        while let Some(before) = way.last().and_then(|last| ways.before[*last as usize])
            && !is_kept[before as usize]
        {
            way.push(before);
        }
        way.reverse();
        for node in &way {
            covered[*node as usize] = true;
        }
        let voxels: Vec<u32> = way
            .iter()
            .map(|node| reached.nodes[*node as usize].voxel)
            .collect();
        let profile = is_worth_a_look(reached, &way, asked_dip)
            .then(|| Profile::centred(values, &voxels))
            .flatten();
        let num = profile
            .as_ref()
            .map_or(0, |profile| profile.kept(&asked_of(&profile.places)));
        let Some(mut profile) = profile.filter(|_| num > 0) else {
            cover(reached, &way, COVER_REFUSED_MM, &mut covered);
            continue;
        };
        let share = num as f64 / profile.places.len() as f64;
        way.truncate(((share * way.len() as f64).round() as usize).max(1));
        cover(reached, &way, COVER_MM, &mut covered);
        for node in &way {
            is_kept[*node as usize] = true;
        }
        let mean_dip = profile.mean_dip(num);
        profile.places.truncate(num);
        kept.push(Kept {
            voxels: voxels[..way.len()].to_vec(),
            places: profile.places,
            mean_dip,
        });
    }
    Ok(kept)
}

/// Whether a way goes on from the end of a thin airway as that one ran: behind its start there is lumen, and beside that none.
fn goes_on(grid: &Grid, lumen: &[u8], places: &[Place]) -> bool {
    let far = &places[(NUM_START - 1).min(places.len() - 1)];
    let start = places[0].mm;
    let Some(along) = carina_grid::unit(std::array::from_fn(|a| far.mm[a] - start[a])) else {
        return false;
    };
    let spacing = grid.spacing_mm();
    let shape = grid.shape_ijk();
    let is_lumen = |mm: [f64; 3]| {
        let at = std::array::from_fn::<_, 3, _>(|a| (mm[a] / spacing[a]).round());
        (0..3).all(|a| at[a] >= 0.0 && (at[a] as usize) < shape[a])
            && lumen[grid.index(at.map(|v| v as usize))] == LUMEN
    };
    let behind = |mm: f64| std::array::from_fn::<_, 3, _>(|a| start[a] - mm * along[a]);
    let (across, up) = across(along);
    let beside = sides(across, up, spacing)
        .into_iter()
        .filter(|side| {
            let out = side.at(BESIDE_MM);
            is_lumen(std::array::from_fn(|a| behind(BEHIND_MM[0])[a] + out[a]))
        })
        .count();
    BEHIND_MM.into_iter().all(|mm| is_lumen(behind(mm))) && beside <= MOST_BESIDE
}

/// Whether the voxels of a way gain more, up to one of them, than those without a dip cost.
fn is_worth_a_look(reached: &Reached, way: &[u32], asked_dip: f64) -> bool {
    let mut gain = 0.0;
    way.iter().any(|node| {
        let dip = f64::from(reached.nodes[*node as usize].dip);
        gain += (dip / asked_dip - 1.0).min(MOST_GAIN);
        gain > 0.0
    })
}

/// Marks what lies in the tube round a way.
fn cover(reached: &Reached, way: &[u32], reach_mm: f32, covered: &mut [bool]) {
    let mut left: std::collections::HashMap<u32, f32> =
        way.iter().map(|n| (*n, reach_mm)).collect();
    let mut open: Vec<u32> = way.to_vec();
    while let Some(n) = open.pop() {
        covered[n as usize] = true;
        let here = left[&n];
        reached.each_beside(n, |m, step_mm| {
            let there = here - step_mm;
            if there > 0.0 && left.get(&m).is_none_or(|l| there > *l + 1e-3) {
                left.insert(m, there);
                open.push(m);
            }
        });
    }
}

/// Adds a way's voxels to the lumen, joined by faces, and those beside it that are darker than half-way up the wall.
fn fill(values: VolumeView<'_, i16>, lumen: &mut [u8], way: &Kept) {
    let grid = values.grid();
    let shape = grid.shape_ijk();
    let spacing = grid.spacing_mm();
    let mark = |lumen: &mut [u8], at: usize| {
        if lumen[at] != LUMEN {
            lumen[at] = EXTENDED;
        }
    };
    // The first voxel touches the lumen, or an airway that was kept before it, perhaps by a corner.
    let first = grid.voxel(way.voxels[0] as usize);
    let mut last = beside(lumen, first, shape).unwrap_or(first);
    for voxel in &way.voxels {
        let to = grid.voxel(*voxel as usize);
        while last != to {
            // Of the faces on the way the darkest.
            let next = (0..3)
                .filter(|a| last[*a] != to[*a])
                .map(|a| {
                    let mut next = last;
                    next[a] = if to[a] > last[a] {
                        last[a] + 1
                    } else {
                        last[a] - 1
                    };
                    next
                })
                .min_by_key(|next| values.at(*next))
                .unwrap_or(to);
            mark(lumen, grid.index(next));
            last = next;
        }
        mark(lumen, grid.index(to));
    }
    for place in &way.places {
        let radius_mm = place.radius_mm.min(MOST_RADIUS_MM);
        let half = place.middle + 0.5 * place.rise;
        let range = |a: usize| {
            let low = ((place.mm[a] - radius_mm) / spacing[a]).ceil().max(0.0) as usize;
            let high = ((place.mm[a] + radius_mm) / spacing[a]).floor().max(0.0) as usize;
            low..=high.min(shape[a] - 1)
        };
        for k in range(2) {
            for j in range(1) {
                for i in range(0) {
                    let off: [f64; 3] =
                        std::array::from_fn(|a| [i, j, k][a] as f64 * spacing[a] - place.mm[a]);
                    if carina_grid::length(off) <= radius_mm
                        && f64::from(values.at([i, j, k])) <= half
                    {
                        mark(lumen, grid.index([i, j, k]));
                    }
                }
            }
        }
    }
}

/// A voxel of the lumen beside one: the first by faces, edges and corners.
fn beside(lumen: &[u8], voxel: [usize; 3], shape: [usize; 3]) -> Option<[usize; 3]> {
    (0..27isize)
        .map(|n| [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1])
        .filter_map(|step| {
            let at: [isize; 3] = std::array::from_fn(|a| voxel[a] as isize + step[a]);
            let is_inside = (0..3).all(|a| (0..shape[a] as isize).contains(&at[a]));
            is_inside.then(|| (step, at.map(|v| v as usize)))
        })
        .filter(|(_, at)| lumen[at[0] + shape[0] * (at[1] + shape[1] * at[2])] != 0)
        .min_by_key(|(step, _)| step.iter().map(|s| s.abs()).sum::<isize>())
        .map(|(_, at)| at)
}
