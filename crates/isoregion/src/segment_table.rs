//! Segment table (IRST, paper 4.3): colour and transparency of a segment of equal samples on a ray.

/// Maximum number of samples of a segment; a ray needs several table entries for a longer segment.
///
/// With this limit the table of 255 classes fits the second cache.
pub const MAX_SEGMENT_SAMPLES: usize = 64;

/// Table of `(C (1 - beta^n), beta^n)` by class and number of samples n; C is the colour, beta the transparency of a
/// sample.
///
/// Departure from paper 4.3: the index is the number of samples, not the radius `d`. A region of radius 0 thus still
/// adds its one sample, and rays that cross a region at an angle or with another step length add their actual number of
/// samples.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentTable {
    entries: Vec<[f32; 4]>,
    /// First label whose class has opacity; the classes of the labels before it are transparent.
    first_visible: u16,
}

impl SegmentTable {
    /// Table without classes, for rays that skip no segments.
    pub const EMPTY: Self = Self {
        entries: Vec::new(),
        first_visible: 1,
    };

    /// Create the table from the premultiplied colour and opacity of *one* sample of each class (`label - 1`).
    #[must_use]
    pub fn new(classes: &[[f32; 4]]) -> Self {
        let mut entries = Vec::with_capacity(classes.len() * (MAX_SEGMENT_SAMPLES + 1));
        for class in classes {
            let [r, g, b, alpha] = class.map(f64::from);
            let beta = 1.0 - alpha;
            let mut through = 1.0;
            for n in 0..=MAX_SEGMENT_SAMPLES {
                // C is the premultiplied colour divided by alpha; a class without opacity adds nothing.
                let share = if alpha > 0.0 {
                    (1.0 - through) / alpha
                } else {
                    n as f64
                };
                entries.push([r * share, g * share, b * share, through].map(|v| v as f32));
                through *= beta;
            }
        }
        let first_visible = classes.iter().take_while(|class| class[3] <= 0.0).count() as u16 + 1;
        Self {
            entries,
            first_visible,
        }
    }

    /// Return the number of labels in the table.
    #[inline]
    #[must_use]
    pub fn num_labels(&self) -> usize {
        self.entries.len() / (MAX_SEGMENT_SAMPLES + 1)
    }

    /// Return the first label whose class has opacity; the classes of labels 1 to the one before it are transparent.
    #[inline]
    #[must_use]
    pub const fn first_visible(&self) -> u16 {
        self.first_visible
    }

    /// Return all entries of the table: [`MAX_SEGMENT_SAMPLES`]` + 1` for each class, by number of samples.
    #[inline]
    #[must_use]
    pub fn entries(&self) -> &[[f32; 4]] {
        &self.entries
    }

    /// Return `[r, g, b, transparency]` of a segment of `num_samples` samples of the class with `label` (1 or more).
    #[inline]
    #[must_use]
    pub fn segment(&self, label: u8, num_samples: usize) -> [f32; 4] {
        self.entries[(usize::from(label) - 1) * (MAX_SEGMENT_SAMPLES + 1) + num_samples]
    }

    /// Return the smallest number of samples of a class after which a ray's transparency falls below `limit`.
    ///
    /// The result is at most `num_samples`; `transparency` is that of the ray before the segment.
    #[must_use]
    pub fn samples_until(
        &self,
        label: u8,
        num_samples: usize,
        transparency: f32,
        limit: f32,
    ) -> usize {
        let start = (usize::from(label) - 1) * (MAX_SEGMENT_SAMPLES + 1);
        let row = &self.entries[start..=start + num_samples];
        row.partition_point(|entry| transparency * entry[3] >= limit)
            .min(num_samples)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_segment_equals_its_samples_composited_one_by_one() {
        let classes = [
            [0.1, 0.02, 0.03, 0.2],
            [0.0, 0.0, 0.0, 0.0],
            [0.5, 0.4, 0.3, 1.0],
        ];
        let table = SegmentTable::new(&classes);
        for (n, class) in classes.iter().enumerate() {
            let (mut colour, mut through) = ([0.0f64; 3], 1.0f64);
            for count in 0..=MAX_SEGMENT_SAMPLES {
                let segment = table.segment(n as u8 + 1, count);
                for c in 0..3 {
                    // The tolerance of 1e-6 allows for the f32 entries of the table.
                    assert!((f64::from(segment[c]) - colour[c]).abs() < 1e-6);
                }
                assert!((f64::from(segment[3]) - through).abs() < 1e-6);
                for c in 0..3 {
                    colour[c] += through * f64::from(class[c]);
                }
                through *= 1.0 - f64::from(class[3]);
            }
        }
    }

    #[test]
    fn a_segment_of_one_sample_adds_this_sample() {
        let table = SegmentTable::new(&[[0.1, 0.2, 0.3, 0.4]]);
        let bits = |entry: [f32; 4]| entry.map(f32::to_bits);
        assert_eq!(bits(table.segment(1, 1)), bits([0.1, 0.2, 0.3, 0.6]));
    }

    #[test]
    fn samples_until_returns_the_sample_at_which_the_ray_becomes_opaque() {
        let table = SegmentTable::new(&[[0.0, 0.0, 0.0, 0.5]]);
        // 0.5^9 = 1/512 is not below the limit; the tenth sample is.
        assert_eq!(table.samples_until(1, 60, 1.0, 1.0 / 512.0), 10);
        assert_eq!(table.samples_until(1, 4, 1.0, 1.0 / 512.0), 4);
    }
}
