//! What the extension may do, what it calls an airway in this volume's lung, and the marks that it leaves on voxels.

use rayon::prelude::*;

use crate::find::tubeness::Enclosure;

/// What the extension may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExtensionLimits {
    /// Air in the trachea.
    pub air: f64,
    /// Values of lung, the calibration's sample.
    pub lung: (i16, i16),
    /// Brighter than this is no lumen.
    pub brightest: i16,
    /// Least rise from a lumen to its wall, whatever the lung shows.
    pub least_rise: f64,
    /// Voxels that are less enclosed are crossed on at most this way, mm.
    pub gap_mm: f64,
    /// A path must lead at least this far out of the lumen that is known, mm.
    pub min_length_mm: f64,
    /// A voxel must be so many times as enclosed as this volume's lung asks for; 1 as a rule.
    pub raised: f64,
    /// The search is given up once it has reached more than this share of the lung.
    pub most_reached: f64,
    /// The least probability of a way and all that it leaves.
    pub least_probability: f64,
    /// Where thick slices were divided; None where voxels have the CT's own size.
    pub divided: Option<Divided>,
}

impl ExtensionLimits {
    /// Share of the lung at which the search is given up.
    fn most_reached_at_all(&self) -> f64 {
        if self.divided.is_some() {
            self.most_reached.max(MOST_REACHED_DIVIDED)
        } else {
            self.most_reached
        }
    }

    /// Least probability of a way if the search reached `num_reached` voxels.
    pub(crate) fn least_probability(&self, levels: Levels, num_reached: usize) -> f64 {
        let usual = levels.most_reached as f64 * self.most_reached / self.most_reached_at_all();
        if num_reached as f64 > usual {
            self.least_probability.max(SURE_PROBABILITY)
        } else {
            self.least_probability
        }
    }

    /// Whether a way of this probability may be open on one side.
    ///
    /// Thick slices blur the wall above and below an airway more than the wall beside it. In divided slices a missing
    /// wall is therefore no proof of a groove between a vessel and an airway.
    pub(crate) fn may_be_open(&self, probability: f64) -> bool {
        self.divided.is_some() && probability >= SURE_PROBABILITY
    }
}

/// How ways are judged where thick slices were divided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Divided {
    /// Axis of the grid across the slices.
    pub axis: usize,
    /// Thickness of the slices before they were divided, mm.
    pub slice_mm: f64,
    /// A section pays by how much its log-odds exceed this.
    pub least_odds: f64,
}

/// One airway that was followed beyond the flood's end.
#[derive(Debug, Clone, PartialEq)]
pub struct Followed {
    /// Voxels of its middle, from the lumen outwards.
    pub voxels: Vec<u32>,
    /// Length, mm.
    pub length_mm: f64,
    /// That it and all that it leaves are airways; 1 for the thinnest airways, which are judged in another way.
    pub probability: f64,
    /// Mean rise to the wall over what the lung pretends (1 is no better than the darkest fiftieth of lung).
    pub contrast: f64,
}

pub(crate) const LUMEN: u8 = 1;
/// Value of voxels that the extension adds to the lumen.
pub const EXTENDED: u8 = 2;
pub(crate) const PENDING: u8 = 3;
pub(crate) const REFUSED: u8 = 4;

/// Share of the lung that is less enclosed than what is followed, and than what a path must be on average.
const FOLLOWED_SHARE: f64 = 0.98;
const KEPT_SHARE: f64 = 0.995;

/// Along an airway the values rise, as its lumen narrows and takes on more of the blur of its wall. A way that rises and falls
/// again by more than this, in thresholds, has stepped over a wall into the lung; less than this share of the way from air
/// to half a wall is none, however little noise there is.
const DROP: f64 = 8.0;
const LEAST_DROP: f64 = 0.4;

/// A gap's voxels are at least this share as enclosed.
const GAP_SHARE: f64 = 0.3;

/// Number of lung voxels that the calibration uses at most, and needs at least.
const NUM_SAMPLES: usize = 20_000;
const MIN_SAMPLES: usize = 2_000;
/// Strides of the sample, largest first. They are primes, so that they have no factor in common with rows and slices.
const STRIDES: [usize; 6] = [1009, 499, 251, 127, 61, 31];
/// In divided slices the search is given up only once it has reached more than this share of the lung, because
/// interpolation joins the values of neighbouring slices (docs/decisions/0112).
const MOST_REACHED_DIVIDED: f64 = 0.04;
/// Least probability of a way in divided slices without the usual evidence: if the search reached more of the lung than
/// [`ExtensionLimits::most_reached`], or if the way has no wall on one side.
const SURE_PROBABILITY: f64 = 0.8;

/// How enclosed voxels must be.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Levels {
    pub(crate) followed: i16,
    pub(crate) kept: f64,
    pub(crate) gap: i16,
    /// A way that rises and falls again by more than this has stepped over a wall.
    pub(crate) drop: f64,
    /// Voxels; airways beyond the flood are a small part of the lung.
    pub(crate) most_reached: usize,
}

impl Levels {
    pub(crate) fn of_lung(
        smooth: &[i16],
        lumen: &[u8],
        enclosure: &Enclosure,
        limits: &ExtensionLimits,
    ) -> Self {
        let (low, high) = limits.lung;
        let is_lung = |at: usize| lumen[at] == 0 && (low..=high).contains(&smooth[at]);
        let stride = sample_stride(smooth.len());
        let sample: Vec<usize> = (0..smooth.len())
            .step_by(stride)
            .filter(|at| is_lung(*at))
            .collect();
        let every = (sample.len() / NUM_SAMPLES).max(1);
        let mut rises: Vec<i16> = sample
            .par_iter()
            .step_by(every)
            .map(|at| enclosure.at(smooth, *at))
            .collect();
        rises.sort_unstable();
        let share = |share: f64| {
            if rises.len() < MIN_SAMPLES {
                0.0
            } else {
                f64::from(rises[((rises.len() - 1) as f64 * share) as usize])
            }
        };
        let pretended = share(FOLLOWED_SHARE).max(limits.least_rise);
        let followed = limits.raised * pretended;
        Self {
            drop: (DROP * pretended).max(LEAST_DROP * (f64::from(limits.brightest) - limits.air)),
            most_reached: if sample.len() < MIN_SAMPLES {
                usize::MAX
            } else {
                (limits.most_reached_at_all() * sample.len() as f64 * stride as f64) as usize
            },
            followed: followed.ceil() as i16,
            kept: share(KEPT_SHARE).max(1.2 * followed),
            gap: (GAP_SHARE * followed) as i16,
        }
    }
}

/// Return the largest stride that gives more voxels than the calibration uses.
fn sample_stride(num_voxels: usize) -> usize {
    let is_enough = |stride: &&usize| num_voxels / **stride >= NUM_SAMPLES;
    *STRIDES
        .iter()
        .find(is_enough)
        .unwrap_or(&STRIDES[STRIDES.len() - 1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_small_volume_is_sampled_more_densely() {
        assert_eq!(sample_stride(80_000_000), 1009);
        assert_eq!(sample_stride(20_180_000), 1009);
        assert_eq!(sample_stride(5_100_000), 251);
        assert_eq!(sample_stride(1000), 31);
    }
}
