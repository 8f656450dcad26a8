//! Evenly distributed sample of the lung's voxels, from which the searches for small airways compute their thresholds.

use rayon::prelude::*;

/// Maximum number of sampled voxels whose surroundings are measured, which limits the time.
const MAX_MEASURED: usize = 20_000;
/// Minimum number of sampled voxels for a quantile; with fewer, the search has no threshold.
const MIN_SAMPLES: usize = 2_000;
/// Distances between sampled voxels in memory, largest first. They are primes, with no factor in common with rows and
/// slices.
const STRIDES: [usize; 6] = [1009, 499, 251, 127, 61, 31];

/// Sample of the voxels of the lung.
pub(crate) struct LungSample {
    /// Indices of the sampled voxels, ascending.
    pub(crate) voxels: Vec<usize>,
    stride: usize,
}

impl LungSample {
    /// Sample the voxels of an array of `num_voxels` for which `is_lung` is true.
    ///
    /// The stride is the largest one that gives enough voxels of lung: with a fixed stride, small volumes and volumes with
    /// little lung would have no threshold.
    pub(crate) fn new(num_voxels: usize, is_lung: impl Fn(usize) -> bool) -> Self {
        let with_stride = |stride: usize| Self {
            voxels: (0..num_voxels)
                .step_by(stride)
                .filter(|at| is_lung(*at))
                .collect(),
            stride,
        };
        let mut sample = with_stride(STRIDES[0]);
        for stride in &STRIDES[1..] {
            if sample.is_sufficient() {
                break;
            }
            sample = with_stride(*stride);
        }
        sample
    }

    fn is_sufficient(&self) -> bool {
        self.voxels.len() >= MIN_SAMPLES
    }

    /// Return `share` times the number of the lung's voxels, as estimated from the sample; `usize::MAX` if the sample
    /// is too small.
    pub(crate) fn num_voxels(&self, share: f64) -> usize {
        if self.is_sufficient() {
            (share * self.voxels.len() as f64 * self.stride as f64) as usize
        } else {
            usize::MAX
        }
    }

    /// Apply `measure` to the sampled voxels; return the results in ascending order, or none if the sample is too
    /// small.
    pub(crate) fn measured(&self, measure: impl Fn(usize) -> i16 + Sync) -> Vec<i16> {
        if !self.is_sufficient() {
            return Vec::new();
        }
        let every = (self.voxels.len() / MAX_MEASURED).max(1);
        let mut results: Vec<i16> = self
            .voxels
            .par_iter()
            .step_by(every)
            .map(|at| measure(*at))
            .collect();
        results.sort_unstable();
        results
    }
}

/// Return the value that `share` of ascending values do not exceed; 0 without values.
pub(crate) fn quantile(ascending: &[i16], share: f64) -> f64 {
    ascending
        .get((ascending.len().saturating_sub(1) as f64 * share) as usize)
        .map_or(0.0, |value| f64::from(*value))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn every_third(at: usize) -> bool {
        at.is_multiple_of(3)
    }

    #[test]
    fn the_stride_decreases_until_the_sample_is_sufficient() {
        for (num_voxels, stride) in [(80_000_000, 1009), (3_500_000, 499), (1_000_000, 127)] {
            let sample = LungSample::new(num_voxels, every_third);
            assert_eq!(sample.stride, stride, "{num_voxels}");
            assert!(sample.voxels.len() >= MIN_SAMPLES);
        }
        // The same array with less lung needs a denser sample.
        let little = LungSample::new(80_000_000, |at| at.is_multiple_of(200));
        assert!(little.stride < 1009 && little.is_sufficient());
    }

    #[test]
    fn a_share_of_the_lung_is_counted_in_voxels_of_the_whole_array() {
        let sample = LungSample::new(3_500_000, every_third);
        let tenth = sample.num_voxels(0.1) as f64;
        assert!(
            (tenth / (0.1 * 3_500_000.0 / 3.0) - 1.0).abs() < 0.01,
            "{tenth}"
        );
    }

    #[test]
    fn too_little_lung_gives_no_limit_and_no_results() {
        let sample = LungSample::new(30_000, every_third);
        assert_eq!(sample.num_voxels(0.1), usize::MAX);
        assert!(sample.measured(|_| 1).is_empty());
        assert!(quantile(&[], 0.98).abs() < f64::EPSILON);
    }

    #[test]
    fn results_are_in_ascending_order() {
        let sample = LungSample::new(80_000_000, every_third);
        let results = sample.measured(|at| (at % 1000) as i16);
        assert!(results.len() >= MAX_MEASURED && results.is_sorted());
        assert!((quantile(&results, 0.5) - 500.0).abs() < 20.0);
    }
}
