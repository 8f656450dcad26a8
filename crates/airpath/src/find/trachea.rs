//! Search for the trachea by its anatomy.
//!
//! A trachea is a tube of air, 7 to 27 mm wide, with a wall of soft tissue, that runs down between the lungs and
//! divides into one branch to the right and one to the left.
//!
//! The search uses the grid's slices that are nearest to transverse, in any order and orientation: only the LPS
//! directions of the grid's axes matter (+z superior, +x left). Arms, the table and the air outside never qualify,
//! because no tissue surrounds them at this size, or they do not divide. Bowel can divide, but has no lung on both
//! sides. A main bronchus can divide with lung on both sides, but has a similar tube beside it.
//!
//! In some patients a part of this is missing: a main bronchus is narrowed or blocked, a lung has collapsed or was
//! removed, the trachea is cropped. Each missing part is recorded as a [`Doubt`] and makes the other criteria stricter.

use carina_grid::{VolumeView, length};
use rayon::prelude::*;

use crate::find::lungs::{MIN_LUNG_MM2, lungs_beside};
pub use crate::find::spots::AirLevels;
use crate::find::spots::{
    Chain, Spot, across_mm, chain_length_mm, chains, spots_of_air, transverse_axis,
};
use carina_leastcost::{TrackError, Watch};

/// Part of the anatomy round a trachea that the search did not find.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Doubt {
    /// The volume begins less than 18 mm above the carina and cuts the trachea off.
    CutOff,
    /// One main bronchus is short or narrow.
    NarrowBronchus,
    /// The trachea continues into one main bronchus only.
    OneBronchus,
    /// There is lung on one side only.
    OneLung,
}

/// Trachea that was found in a CT.
#[derive(Debug, Clone, PartialEq)]
pub struct Trachea {
    /// Voxels inside the trachea, one per slice, from the top down.
    pub voxels: Vec<[usize; 3]>,
    /// Diameter at each voxel of the circle with the area of the trachea in that slice, mm.
    pub diameters_mm: Vec<f64>,
    /// Length of the trachea's part in the volume, mm.
    pub length_mm: f64,
    /// Position of the carina, LPS.
    pub carina_lps: [f64; 3],
    /// Parts of the expected anatomy that were not found, so that the tube may be another structure; empty if all were
    /// found.
    pub doubts: Vec<Doubt>,
}

/// Criteria for the two tubes below a division to be main bronchi.
#[derive(Debug, Clone, Copy)]
struct SplitRule {
    /// Length in mm over which both tubes below a division are followed down.
    follow_mm: f64,
    /// Minimum diameter in mm of the wider of the two tubes.
    wider_mm: f64,
    /// Minimum diameter in mm of the narrower of the two tubes.
    narrower_mm: f64,
    /// Maximum distance between the two tubes from front to back, mm; the oesophagus is farther behind.
    front_back_mm: f64,
}

/// Minimum length in mm, inside the volume, of a tube that is accepted as trachea.
const MIN_LENGTH_MM: f64 = 18.0;
/// Minimum length in mm, inside the volume, of a trachea that begins outside the volume.
const MIN_CUT_OFF_MM: f64 = 8.0;
/// Minimum length of a trachea that lacks one main bronchus or one lung, mm; no other airway is as wide over this
/// length.
const STRICT_LENGTH_MM: f64 = 40.0;
/// Minimum length of a trachea that lacks one main bronchus and one lung, or that has other tubes beside it, mm.
const BEYOND_DOUBT_MM: f64 = 60.0;
/// Minimum median diameter of a trachea that lacks a main bronchus or a lung, mm.
const STRICT_DIAMETER_MM: f64 = 9.0;
/// Minimum share of directions with tissue round a trachea (median over its slices) if it lacks a main bronchus or a
/// lung.
const STRICT_RINGED: f64 = 0.8;
/// Maximum sideways displacement, per mm down, of a trachea that lacks a main bronchus or a lung.
const STRICT_SLANT: f64 = 0.6;
/// Minimum distance by which a single main bronchus leaves the straight line of the trachea, mm.
const ASIDE_MM: f64 = 10.0;
/// Maximum ratio of a trachea's areas in successive slices; beyond it the tube is another structure.
const TRACHEA_CHANGE: f64 = 2.2;
/// Maximum ratio of a bronchus's areas in successive slices, one of which may cut a horizontal branch.
const BRONCHUS_CHANGE: f64 = 5.0;
/// Criteria for two main bronchi of normal width.
const BOTH_BRONCHI: SplitRule = SplitRule {
    follow_mm: 6.0,
    wider_mm: 5.0,
    narrower_mm: 5.0,
    front_back_mm: f64::INFINITY,
};
/// Criteria for two main bronchi of which one is short or narrow.
const NARROW_BRONCHUS: SplitRule = SplitRule {
    follow_mm: 3.0,
    wider_mm: 5.0,
    narrower_mm: 3.9,
    front_back_mm: 12.0,
};
/// Minimum diameter of a twin (a similar tube beside a candidate for the trachea), as a fraction of the candidate's
/// diameter.
const TWIN_DIAMETER: f64 = 0.6;
/// Minimum and maximum distance in mm of a twin (a similar tube beside a candidate for the trachea) from the candidate.
const TWIN_OFF_MM: (f64, f64) = (22.0, 130.0);
/// Minimum length in mm over which a twin (a similar tube) runs beside a candidate for the trachea.
const TWIN_LENGTH_MM: f64 = 12.0;

/// CT with the air spots of its slices from the top down, and the chains of spots that may be bronchi.
struct Scene<'a> {
    values: VolumeView<'a, i16>,
    levels: AirLevels,
    slices: Vec<Vec<Spot>>,
    bronchi: Vec<Chain>,
    step_mm: f64,
}

/// Find the trachea of a chest CT.
///
/// # Errors
///
/// Returns an error if there is no trachea, or if `watch` stops the search.
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
    // The slices are ordered from the top down.
    let slices: Vec<Vec<Spot>> = in_order
        .par_iter()
        .map(|&slice| {
            watch.report_fraction(0.0)?;
            Ok(spots_of_air(values, levels, axis, slice))
        })
        .collect::<Result<_, TrackError>>()?;
    let step_mm = grid.spacing_mm()[axis];
    let tracheas = chains(&slices, step_mm, TRACHEA_CHANGE, Spot::like_a_trachea);
    let bronchi = chains(&slices, step_mm, BRONCHUS_CHANGE, Spot::like_a_bronchus);
    let scene = Scene {
        values,
        levels,
        slices,
        bronchi,
        step_mm,
    };
    let mut longest_mm: f64 = 0.0;
    let mut has_twin = false;
    let mut best: Option<Candidate> = None;
    for chain in &tracheas {
        longest_mm = longest_mm.max(chain_length_mm(&scene.slices, chain));
        let Some(candidate) = scene.candidate(chain) else {
            continue;
        };
        // A candidate longer than `BEYOND_DOUBT_MM` needs no test for twins: pockets of air beside it (a collapsed
        // lung, the gut) are not twins.
        let is_long = candidate.trachea.length_mm >= BEYOND_DOUBT_MM;
        if !(is_long && scene.passes_strictly(chain, &candidate))
            && scene.has_twin(chain, candidate.ends_at)
        {
            has_twin = true;
            continue;
        }
        if best.as_ref().is_none_or(|b| candidate.beats(b)) {
            best = Some(candidate);
        }
    }
    if let Some(candidate) = best {
        return Ok(candidate.trachea);
    }
    Err(TrackError::NoResult(if has_twin {
        "no trachea was found: the tubes of air that split have another one beside them, so they are main or lower bronchi; \
         give a point in the airway (root) if the volume is cropped below the carina"
            .to_owned()
    } else if longest_mm >= MIN_LENGTH_MM {
        format!(
            "no trachea was found: a tube of air {longest_mm:.0} mm long does not split into a right and a left main bronchus \
             between the lungs; give a point in the airway (root) if the volume is cropped"
        )
    } else {
        "no trachea was found: no tube of air of 7 to 30 mm, ringed by soft tissue, runs down through the volume; \
         is it a chest CT with the trachea in view? Give a point in the airway (root) if it is cropped"
            .to_owned()
    }))
}

/// Chain of air spots that qualifies as a trachea.
struct Candidate {
    trachea: Trachea,
    ends_at: usize,
    top_z_mm: f64,
    bottom_z_mm: f64,
    volume_mm3: f64,
}

impl Candidate {
    fn is_strict(&self) -> bool {
        let doubts = &self.trachea.doubts;
        doubts.contains(&Doubt::OneBronchus) || doubts.contains(&Doubt::OneLung)
    }

    /// Return whether this candidate is better than `other`: in general, whether it has the larger volume.
    ///
    /// A candidate that lacks a main bronchus or a lung is better only if it is also above the other, because the colon
    /// is below the lungs.
    fn beats(&self, other: &Self) -> bool {
        let above = |a: &Self, b: &Self| a.bottom_z_mm >= b.top_z_mm - 15.0;
        match (self.is_strict(), other.is_strict()) {
            (true, false) => above(self, other) && self.volume_mm3 > other.volume_mm3,
            (false, true) => !above(other, self) || self.volume_mm3 > other.volume_mm3,
            _ => self.volume_mm3 > other.volume_mm3,
        }
    }
}

impl Scene<'_> {
    fn spot(&self, chain: &Chain, n: usize) -> &Spot {
        &self.slices[chain.first + n][chain.spots[n]]
    }

    /// Return the chain as a candidate, with its doubts; `None` if the chain does not qualify as a trachea.
    fn candidate(&self, chain: &Chain) -> Option<Candidate> {
        // Part of the scanner's first slice may be padding.
        let cut_off = chain.first <= 1;
        let least_mm = if cut_off {
            MIN_CUT_OFF_MM
        } else {
            MIN_LENGTH_MM
        };
        if chain_length_mm(&self.slices, chain) < least_mm {
            return None;
        }
        let mut doubts = Vec::new();
        // The chain may continue into a main bronchus, so the division is searched along its whole lower part.
        let (carina_lps, ends_at) =
            if let Some(split) = self.split_below(chain, BOTH_BRONCHI, least_mm) {
                split
            } else if let Some(split) = self.split_below(chain, NARROW_BRONCHUS, MIN_LENGTH_MM) {
                doubts.push(Doubt::NarrowBronchus);
                split
            } else {
                doubts.push(Doubt::OneBronchus);
                self.turn_aside(chain)?
            };
        let top = self.spot(chain, 0);
        let bottom = self.spot(chain, ends_at);
        let length_mm = length([0, 1, 2].map(|a| top.centre_lps[a] - bottom.centre_lps[a]));
        let diameters_mm: Vec<f64> = (0..=ends_at)
            .map(|n| self.spot(chain, n).diameter_mm())
            .collect();
        if length_mm < least_mm {
            return None;
        }
        if length_mm < MIN_LENGTH_MM {
            // A piece of trachea shorter than `MIN_LENGTH_MM` must be wide.
            if median(&diameters_mm) < STRICT_DIAMETER_MM {
                return None;
            }
            doubts.push(Doubt::CutOff);
        }
        let lungs = lungs_beside(self.values, self.levels, carina_lps);
        if lungs[0].max(lungs[1]) < MIN_LUNG_MM2 {
            return None;
        }
        if lungs[0].min(lungs[1]) < MIN_LUNG_MM2 {
            doubts.push(Doubt::OneLung);
        }
        let volume_mm3 = (0..=ends_at)
            .map(|n| self.spot(chain, n).area_mm2 * self.step_mm)
            .sum();
        let candidate = Candidate {
            top_z_mm: top.centre_lps[2],
            bottom_z_mm: bottom.centre_lps[2],
            volume_mm3,
            ends_at,
            trachea: Trachea {
                voxels: (0..=ends_at).map(|n| self.spot(chain, n).voxel).collect(),
                diameters_mm,
                length_mm,
                carina_lps,
                doubts,
            },
        };
        (!candidate.is_strict() || self.passes_strictly(chain, &candidate)).then_some(candidate)
    }

    /// Return true if a candidate is long, wide, upright and surrounded by tissue throughout.
    ///
    /// Such a candidate needs no second main bronchus or lung.
    fn passes_strictly(&self, chain: &Chain, candidate: &Candidate) -> bool {
        let trachea = &candidate.trachea;
        let ringed: Vec<f64> = (0..=candidate.ends_at)
            .map(|n| self.spot(chain, n).ringed)
            .collect();
        let aside = across_mm(self.spot(chain, 0), self.spot(chain, candidate.ends_at));
        let lacks_both = [Doubt::OneBronchus, Doubt::OneLung]
            .iter()
            .all(|doubt| trachea.doubts.contains(doubt));
        let least_mm = if lacks_both {
            BEYOND_DOUBT_MM
        } else {
            STRICT_LENGTH_MM
        };
        trachea.length_mm >= least_mm
            && median(&trachea.diameters_mm) >= STRICT_DIAMETER_MM
            && median(&ringed) >= STRICT_RINGED
            && aside <= STRICT_SLANT * (candidate.top_z_mm - candidate.bottom_z_mm)
    }

    /// Find two main bronchi below a chain; return the carina's position (LPS mm) and the index of the chain's last
    /// spot above it.
    ///
    /// The two tubes are in the same slices, one on the right and one on the left of the chain's last undivided spot.
    /// Both continue for the length of the rule and diverge. One of them may be the lower part of the chain itself. The
    /// result is `None` if the chain does not divide.
    fn split_below(
        &self,
        chain: &Chain,
        rule: SplitRule,
        least_mm: f64,
    ) -> Option<([f64; 3], usize)> {
        let num_needed = (rule.follow_mm / self.step_mm).ceil().max(2.0) as usize;
        let num_gap = (20.0 / self.step_mm).ceil() as usize;
        let min_slices = (least_mm / self.step_mm).ceil() as usize;
        let last = chain.spots.len() - 1;
        for ends_at in min_slices.min(last)..=last {
            let end = self.spot(chain, ends_at);
            let below = chain.first + ends_at + 1;
            let furthest = if ends_at == last {
                below + num_gap
            } else {
                below
            };
            for start in below..=furthest {
                let stop = start + num_needed - 1;
                // Tubes that cross the first slice of the followed length and its last slice, with their spots in these
                // two slices.
                let tubes: Vec<(&Spot, &Spot)> = self
                    .bronchi
                    .iter()
                    .filter_map(|b| b.at(&self.slices, start).zip(b.at(&self.slices, stop)))
                    .filter(|(now, _)| across_mm(now, end) <= 28.0)
                    .collect();
                // +x is the patient's left.
                for (right, right_then) in &tubes {
                    for (left, left_then) in &tubes {
                        let now = left.centre_lps[0] - right.centre_lps[0];
                        let then = left_then.centre_lps[0] - right_then.centre_lps[0];
                        let between = right.centre_lps[0] - 3.0 < end.centre_lps[0]
                            && end.centre_lps[0] < left.centre_lps[0] + 3.0;
                        let (one, two) = (left.diameter_mm(), right.diameter_mm());
                        let wide_enough =
                            one.max(two) >= rule.wider_mm && one.min(two) >= rule.narrower_mm;
                        let front_back = (left.centre_lps[1] - right.centre_lps[1]).abs();
                        // 1 mm per 3 mm: main bronchi diverge by at least 30 degrees.
                        if now >= 7.0
                            && then - now >= rule.follow_mm / 3.0
                            && between
                            && wide_enough
                            && front_back <= rule.front_back_mm
                        {
                            let carina = std::array::from_fn(|a| {
                                0.5 * (left.centre_lps[a] + right.centre_lps[a])
                            });
                            return Some((carina, ends_at));
                        }
                    }
                }
            }
        }
        None
    }

    /// Find where the tube leaves the straight line of its chain to one side, as where only one main bronchus is open.
    ///
    /// Return the position (LPS mm) and the index of the chain's last spot before it. If one main bronchus is closed, this
    /// position is the carina. The result is `None` if the chain stays on its line.
    fn turn_aside(&self, chain: &Chain) -> Option<([f64; 3], usize)> {
        let last = chain.spots.len() - 1;
        let end = self.spot(chain, last);
        let top = self.spot(chain, 0);
        // The straight line goes through the upper part of the chain: from its top to 60 % of its length.
        let upper = self.spot(chain, last * 3 / 5);
        let down = top.centre_lps[2] - upper.centre_lps[2];
        if down < STRICT_LENGTH_MM / 2.0 {
            return None;
        }
        let slope = (upper.centre_lps[0] - top.centre_lps[0]) / down;
        let aside = |spot: &Spot| {
            let on_line = top.centre_lps[0] + slope * (top.centre_lps[2] - spot.centre_lps[2]);
            (spot.centre_lps[0] - on_line).abs()
        };
        let num_gap = (20.0 / self.step_mm).ceil() as usize;
        let below = chain.first + last + 1;
        let turns = (0..=last).any(|n| aside(self.spot(chain, n)) >= ASIDE_MM)
            || self.bronchi.iter().any(|b| {
                let from = b.first.max(below);
                from < b.end().min(below + num_gap)
                    && b.at(&self.slices, from)
                        .is_some_and(|spot| across_mm(spot, end) <= 28.0)
                    && (from..b.end()).any(|slice| {
                        b.at(&self.slices, slice)
                            .is_some_and(|spot| aside(spot) >= ASIDE_MM)
                    })
            });
        if !turns {
            return None;
        }
        // The trachea ends where the bend begins.
        let ends_at = (0..=last)
            .rev()
            .find(|n| aside(self.spot(chain, *n)) < 0.5 * ASIDE_MM)?;
        Some((self.spot(chain, ends_at).centre_lps, ends_at))
    }

    /// Return true if another tube of similar width runs beside the chain, to the right or to the left.
    fn has_twin(&self, chain: &Chain, ends_at: usize) -> bool {
        let min_slices = (TWIN_LENGTH_MM / self.step_mm).ceil().max(2.0) as usize;
        // The tubes of a division may begin a little above the chain's last spot, so no twin is searched in the slices
        // there.
        let num_near = (6.0 / self.step_mm).ceil() as usize;
        let stop = chain.first + (ends_at + 1).saturating_sub(num_near);
        self.bronchi.iter().any(|other| {
            let num_adjacent = (other.first.max(chain.first)..other.end().min(stop))
                .filter(|slice| {
                    let (Some(mine), Some(its)) = (
                        chain.at(&self.slices, *slice),
                        other.at(&self.slices, *slice),
                    ) else {
                        return false;
                    };
                    let off = (its.centre_lps[0] - mine.centre_lps[0]).abs();
                    (TWIN_OFF_MM.0..=TWIN_OFF_MM.1).contains(&off)
                        && its.diameter_mm() >= TWIN_DIAMETER * mine.diameter_mm()
                        && its.ringed >= 0.7
                })
                .count();
            num_adjacent >= min_slices
        })
    }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}
