//! Limits of the search for small airways, thresholds from the lung of a volume, and the states of voxels during the
//! search.

use crate::find::lung_sample::{LungSample, quantile};
use crate::find::tubeness::Enclosure;

/// Limits of the search for airways beyond the lumen of the flood.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExtensionLimits {
    /// Voxel value of the air in the trachea.
    pub air: f64,
    /// Smallest and largest value of the voxels that count as lung.
    pub lung: (i16, i16),
    /// Smoothed voxel value above which a voxel cannot be lumen.
    pub brightest: i16,
    /// Minimum rise in value from a lumen to its wall, used if the threshold from the noise of this lung is lower.
    pub least_rise: f64,
    /// Maximum length of a part of a path whose voxels have too little wall round them, mm; a path with a longer part
    /// is rejected.
    pub gap_mm: f64,
    /// Smallest length by which a path must lead out of the known lumen, mm.
    pub min_length_mm: f64,
    /// Factor of the enclosure threshold that is computed from the volume's lung; normally 1.
    pub raised: f64,
    /// Largest share of the lung that the search may reach before it is cancelled.
    pub most_reached: f64,
    /// Minimum probability that a path and all paths from which it branches are airways; a less probable path is not
    /// added.
    pub least_probability: f64,
    /// Division of thick slices into thinner ones before the search; `None` if the volume has the slices of the CT.
    pub divided: Option<Divided>,
}

impl ExtensionLimits {
    /// Return whether a path of this probability is accepted even if it has no wall on one of its sides.
    ///
    /// Thick slices blur the wall above and below an airway more than the wall beside it. In divided slices a missing
    /// wall is therefore no proof of a groove between a vessel and an airway.
    pub(crate) fn may_be_open(&self, probability: f64) -> bool {
        self.divided.is_some() && probability >= SURE_PROBABILITY
    }
}

/// Parameters with which paths are judged in a volume whose thick slices were divided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Divided {
    /// Grid axis (0, 1 or 2) perpendicular to the slices.
    pub axis: usize,
    /// Thickness of the slices before they were divided, mm.
    pub slice_mm: f64,
    /// Log-odds above which a cross-section of a path counts in favour of an airway.
    pub least_odds: f64,
}

/// Small airway beyond the lumen of the flood, with the probability that it is real.
#[derive(Debug, Clone, PartialEq)]
pub struct Followed {
    /// Voxels of the airway's centreline, from the lumen outwards.
    pub voxels: Vec<u32>,
    /// Length of the airway's centreline, mm.
    pub length_mm: f64,
    /// Probability that this path and all paths from which it branches are airways.
    ///
    /// The value is 1 for the thinnest airways, which are accepted by the tube filter instead.
    pub probability: f64,
    /// Mean rise in value to the wall, divided by the threshold from the lung (the most enclosed 2 % of the lung have 1
    /// or more).
    pub contrast: f64,
}

/// State of a voxel in the lumen that the flood found.
pub(crate) const LUMEN: u8 = 1;
/// State of a voxel that this search adds to the lumen.
pub const EXTENDED: u8 = 2;
/// State of a voxel that the search has reached and that is not part of the lumen yet.
pub(crate) const PENDING: u8 = 3;
/// State of a voxel that is too bright or has too little wall round it to be reached.
pub(crate) const REFUSED: u8 = 4;

/// Quantile of the enclosures (rise in value to the walls round a voxel) in the lung that is the threshold for each
/// voxel of a path, unless the limits require a higher one.
const FOLLOWED_SHARE: f64 = 0.98;
/// Quantile of the enclosures in the lung that the voxels of an accepted path must reach at least on average.
const ACCEPTED_SHARE: f64 = 0.995;

/// Maximum fall in value along a path, as a multiple of the enclosure threshold.
///
/// Along an airway the values rise, because its lumen narrows and the blur of its wall increases. A path whose values
/// rise and then fall by more than this limit has crossed a wall into the lung.
const DROP: f64 = 8.0;
/// Lower limit of [`Levels::drop`], as a fraction of the difference between the values of the brightest lumen and of
/// air.
///
/// The limit applies in volumes with little noise.
const MIN_DROP: f64 = 0.4;

/// Minimum enclosure of a voxel in a gap (part of a path with too little wall), as a fraction of the threshold for
/// other voxels of the path.
const GAP_SHARE: f64 = 0.3;

/// Probability from which a path in divided slices is accepted although one side has no wall.
const SURE_PROBABILITY: f64 = 0.8;

/// Thresholds that were computed from the lung of one volume.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Levels {
    pub(crate) followed: i16,
    pub(crate) accepted: f64,
    pub(crate) gap: i16,
    /// Maximum fall in value along a path after a rise; a path with a larger fall has crossed a wall.
    pub(crate) drop: f64,
    /// Maximum number of voxels that the search may reach. Above it the search has leaked and is cancelled, because
    /// airways beyond the flood are a small part of the lung.
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
        let sample = LungSample::new(smooth.len(), |at| {
            lumen[at] == 0 && (low..=high).contains(&smooth[at])
        });
        let rises = sample.measured(|at| enclosure.at(smooth, at));
        let pretended = quantile(&rises, FOLLOWED_SHARE).max(limits.least_rise);
        let followed = limits.raised * pretended;
        Self {
            drop: (DROP * pretended).max(MIN_DROP * (f64::from(limits.brightest) - limits.air)),
            most_reached: sample.num_voxels(limits.most_reached),
            followed: followed.ceil() as i16,
            accepted: quantile(&rises, ACCEPTED_SHARE).max(1.2 * followed),
            gap: (GAP_SHARE * followed) as i16,
        }
    }
}

/// Limits with which the tests of the search run.
#[cfg(test)]
pub(crate) const TEST_LIMITS: ExtensionLimits = ExtensionLimits {
    air: -1000.0,
    lung: (-950, -700),
    brightest: -500,
    least_rise: 15.0,
    gap_mm: 2.0,
    min_length_mm: 2.0,
    raised: 1.0,
    most_reached: 0.02,
    least_probability: 0.7,
    divided: None,
};
/// Division of the thick slices of a test volume.
#[cfg(test)]
pub(crate) const TEST_DIVIDED: Divided = Divided {
    axis: 2,
    slice_mm: 3.0,
    least_odds: 0.3,
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_may_be_open_on_one_side_only_in_divided_slices_and_if_it_is_probable() {
        let mut limits = TEST_LIMITS;
        assert!(!limits.may_be_open(0.99));
        limits.divided = Some(TEST_DIVIDED);
        assert!(limits.may_be_open(SURE_PROBABILITY));
        assert!(!limits.may_be_open(0.79));
    }
}
