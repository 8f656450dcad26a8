//! Third step of the search: the thinnest airways, seen as bright lines with a dark middle (docs/decisions/0112).
//!
//! An airway of one or two voxels is brighter than lung throughout, and its middle is darker than its wall by less than
//! the noise. Its evidence is distributed along it, so the search is along paths: a filter of short straight pieces
//! ([`crate::find::tube_filter`]) gives the voxels that a path may use and their cost, including gaps. For the cheapest
//! paths to the farthest tips, the CT round each path is averaged over 5 mm ([`crate::find::thin_profile`]), and a path
//! is accepted as far as this average looks like an airway.

use carina_grid::{Grid, VolumeView};
use carina_leastcost::{TrackError, Watch};

use crate::find::extension_levels::{EXTENDED, Followed, LUMEN};
use crate::find::lung_sample::{LungSample, quantile};
use crate::find::thin_paths::{Dips, PathTree, Reached};
use crate::find::thin_profile::{Place, Profile, Requirements, length_mm};
use crate::find::tube_filter::{ThinSection, TubeFilter, across, sides};
use crate::find::tubeness::smoothed;

/// Limits of the search for thin airways; values are voxel values of the volume.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThinLimits {
    /// Voxel value of the air in the trachea.
    pub air: f64,
    /// Smallest and largest value of the voxels that count as lung in the sample for the thresholds.
    pub lung: (i16, i16),
    /// Smoothed voxel value above which a voxel cannot be lumen.
    pub brightest: i16,
    /// Minimum voxel value of an airway's wall, which is brighter than lung.
    pub least_wall: f64,
    /// Minimum dip (rise in value from the middle of a thin tube to its second darkest side) of a path's voxels, if the
    /// lung's threshold is lower.
    pub least_dip: f64,
    /// Minimum mean dip along an airway (rise in value from its middle to its second darkest side); airways with a
    /// smaller mean dip are dropped.
    pub least_mean_dip: f64,
    /// Upper limit of the blur of the CT (sigma), mm.
    pub blur_mm: f64,
    /// Minimum length in mm of a path that continues the end of an airway.
    pub min_length_mm: f64,
    /// Minimum length in mm of an airway that leaves from the side of another.
    ///
    /// Shorter paths from a side are strips of lung enclosed by vessels.
    pub min_side_mm: f64,
    /// Maximum share of the lung's voxels that the search may reach; above it the search is cancelled.
    pub most_reached: f64,
}

/// Result of the search for thin airways.
#[derive(Debug, Clone, PartialEq)]
pub struct Thin {
    /// Accepted airways; an airway comes before those that branch off it.
    pub followed: Vec<Followed>,
    /// Number of voxels that the search reached, in accepted and in rejected paths.
    pub num_reached: usize,
    /// Whether the search was cancelled because it reached more of the lung than airways can occupy; then it added
    /// nothing.
    pub ran_out: bool,
}

/// Share of the lung's voxels whose dip (rise in value from a tube's middle to its sides) is smaller than that of a
/// path's voxels.
const FOLLOWED_SHARE: f64 = 0.985;
/// Distance in mm from an accepted path within which no other path may end.
const COVER_MM: f32 = 2.0;
/// Distance in mm from a rejected path within which no other path may end.
const COVER_REFUSED_MM: f32 = 1.0;
/// Maximum gain of a path by one voxel (the amount by which the voxel speaks for an airway), as a multiple of the dip
/// threshold.
///
/// A path whose summed gains are never positive is not examined further.
const MAX_GAIN: f64 = 1.5;
/// Upper limit of the radius within which voxels beside a path are added to the lumen, mm.
const MAX_RADIUS_MM: f64 = 1.0;

/// Number of positions at the start of a path that give its direction.
///
/// The path continues an airway if there is lumen behind its start, and lumen on few sides of these places.
const NUM_START: usize = 7;
/// Distances behind the start of a path at which there must be lumen, mm.
const BEHIND_MM: [f64; 2] = [1.2, 2.4];
/// Distance to the side, mm, of the positions behind a path's start at which voxels are examined for lumen.
const BESIDE_MM: f64 = 2.0;
/// Maximum number of the 8 examined sides with lumen behind a path that continues an airway's end; with more, the path
/// leaves an airway's side.
const MAX_BESIDE: usize = 3;

/// Add thin airways that start at `lumen` (1 inside, 0 outside) to it in place; added voxels get the value
/// [`EXTENDED`].
///
/// # Errors
///
/// Returns an error if `watch` stops the search.
pub fn extend_thin(
    values: VolumeView<'_, i16>,
    lumen: &mut [u8],
    limits: &ThinLimits,
    watch: &impl Watch,
) -> Result<Thin, TrackError> {
    watch.report_fraction(0.0)?;
    let grid = values.grid();
    let data = values.data();
    let smooth = smoothed(values);
    let sample = LungSample::new(data.len(), |at| {
        lumen[at] == 0 && (limits.lung.0..=limits.lung.1).contains(&smooth[at])
    });
    let most = sample.num_voxels(limits.most_reached);
    let lung = median_lung(&sample.voxels, &smooth, limits);
    let section = ThinSection {
        air: limits.air,
        least_wall: limits.least_wall,
        blur_mm: limits.blur_mm,
        lung,
    };
    let filter = TubeFilter::new(grid, section);
    let dips = sample.measured(|at| filter.dip(data, at));
    let dip_threshold = quantile(&dips, FOLLOWED_SHARE).max(limits.least_dip);
    let mut dips = Dips::new(&filter, data, &smooth, limits.brightest);
    let reached = Reached::from_lumen(grid, lumen, &mut dips, dip_threshold, most, watch)?;
    drop(dips);
    let num_reached = reached.nodes.len();
    if num_reached > most {
        return Ok(Thin {
            followed: Vec::new(),
            num_reached,
            ran_out: true,
        });
    }
    let paths = reached.path_tree(lumen, dip_threshold);
    let requirements = Requirements {
        section,
        dip: limits.least_mean_dip,
        length_mm: limits.min_length_mm,
    };
    let continues_airway = |places: &[Place]| continues_airway(grid, lumen, places);
    let requirements_at = |places: &[Place]| Requirements {
        length_mm: if continues_airway(places) {
            limits.min_length_mm
        } else {
            limits.min_side_mm
        },
        ..requirements
    };
    let accepted = accepted_paths(
        values,
        &reached,
        &paths,
        dip_threshold,
        &requirements,
        requirements_at,
        watch,
    )?;
    for way in &accepted {
        fill(values, lumen, way);
    }
    let followed = accepted
        .into_iter()
        .map(|way| Followed {
            length_mm: length_mm(way.places.len()),
            contrast: way.mean_dip / requirements.dip,
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

/// Return the median value of the sampled lung voxels.
fn median_lung(sample: &[usize], smooth: &[i16], limits: &ThinLimits) -> f64 {
    let mut values: Vec<i16> = sample.iter().map(|at| smooth[*at]).collect();
    values.sort_unstable();
    let middle = 0.5 * (f64::from(limits.lung.0) + f64::from(limits.lung.1));
    values
        .get(values.len() / 2)
        .map_or(middle, |value| f64::from(*value))
}

/// Accepted path along a thin airway: its voxels, its positions and its mean dip (rise in value from middle to sides).
struct AcceptedPath {
    voxels: Vec<u32>,
    places: Vec<Place>,
    mean_dip: f64,
}

/// Examine the paths to all tips, the farthest tip first; return the parts that qualify as airways.
fn accepted_paths(
    values: VolumeView<'_, i16>,
    reached: &Reached,
    paths: &PathTree,
    dip_threshold: f64,
    requirements: &Requirements,
    requirements_at: impl Fn(&[Place]) -> Requirements,
    watch: &impl Watch,
) -> Result<Vec<AcceptedPath>, TrackError> {
    let along_mm = |n: u32| paths.along_mm[n as usize];
    let mut tips: Vec<u32> = (0..reached.nodes.len() as u32)
        .filter(|n| {
            along_mm(*n).is_finite()
                && f64::from(along_mm(*n)) >= requirements.length_mm
                && f64::from(reached.nodes[*n as usize].dip) >= dip_threshold
        })
        .collect();
    tips.sort_by(|a, b| along_mm(*b).total_cmp(&along_mm(*a)).then(a.cmp(b)));
    let mut covered = vec![false; reached.nodes.len()];
    let mut is_kept = vec![false; reached.nodes.len()];
    let mut accepted = Vec::new();
    for (n, tip) in tips.iter().enumerate() {
        if n.is_multiple_of(1 << 10) {
            watch.report_fraction(n as f64 / tips.len() as f64)?;
        }
        if covered[*tip as usize] {
            continue;
        }
        let mut way = vec![*tip];
        while let Some(before) = way.last().and_then(|last| paths.before[*last as usize])
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
        let profile = may_be_accepted(reached, &way, dip_threshold)
            .then(|| Profile::centred(values, &voxels))
            .flatten();
        let num = profile.as_ref().map_or(0, |profile| {
            profile.accepted_length(&requirements_at(&profile.places))
        });
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
        accepted.push(AcceptedPath {
            voxels: voxels[..way.len()].to_vec(),
            places: profile.places,
            mean_dip,
        });
    }
    Ok(accepted)
}

/// Return whether a path continues a thin airway from its end in the same direction.
///
/// There must be lumen behind the start of the path, and little lumen to the sides of the start.
fn continues_airway(grid: &Grid, lumen: &[u8], places: &[Place]) -> bool {
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
    let num_lumen_sides = sides(across, up, spacing)
        .into_iter()
        .filter(|side| {
            let out = side.at(BESIDE_MM);
            is_lumen(std::array::from_fn(|a| behind(BEHIND_MM[0])[a] + out[a]))
        })
        .count();
    BEHIND_MM.into_iter().all(|mm| is_lumen(behind(mm))) && num_lumen_sides <= MAX_BESIDE
}

/// Return whether the gains of the voxels of a path, summed from its start to any voxel, exceed the losses of voxels
/// without a dip.
fn may_be_accepted(reached: &Reached, way: &[u32], dip_threshold: f64) -> bool {
    let mut gain = 0.0;
    way.iter().any(|node| {
        let dip = f64::from(reached.nodes[*node as usize].dip);
        gain += (dip / dip_threshold - 1.0).min(MAX_GAIN);
        gain > 0.0
    })
}

/// Mark the voxels in the tube round a path, in which no other path may end.
fn cover(reached: &Reached, way: &[u32], reach_mm: f32, covered: &mut [bool]) {
    let mut left: std::collections::HashMap<u32, f32> =
        way.iter().map(|n| (*n, reach_mm)).collect();
    let mut open: Vec<u32> = way.to_vec();
    while let Some(n) = open.pop() {
        covered[n as usize] = true;
        let here = left[&n];
        reached.for_each_neighbour(n, |m, step_mm| {
            let there = here - step_mm;
            if there > 0.0 && left.get(&m).is_none_or(|l| there > *l + 1e-3) {
                left.insert(m, there);
                open.push(m);
            }
        });
    }
}

/// Add a path's voxels, connected by faces, to the lumen, and the voxels beside the path that are darker than half-way
/// up the wall.
fn fill(values: VolumeView<'_, i16>, lumen: &mut [u8], way: &AcceptedPath) {
    let grid = values.grid();
    let shape = grid.shape_ijk();
    let spacing = grid.spacing_mm();
    let mark = |lumen: &mut [u8], at: usize| {
        if lumen[at] != LUMEN {
            lumen[at] = EXTENDED;
        }
    };
    // The first voxel touches the lumen, or a previously accepted airway, perhaps only by a corner.
    let first = grid.voxel(way.voxels[0] as usize);
    let mut last = adjacent_lumen_voxel(lumen, first, shape).unwrap_or(first);
    for voxel in &way.voxels {
        let to = grid.voxel(*voxel as usize);
        while last != to {
            // Of the possible face neighbours, use the darkest.
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
        let radius_mm = place.radius_mm.min(MAX_RADIUS_MM);
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

/// Return a lumen voxel adjacent to a voxel: one that shares a face if there is one, else an edge, else a corner.
fn adjacent_lumen_voxel(lumen: &[u8], voxel: [usize; 3], shape: [usize; 3]) -> Option<[usize; 3]> {
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
