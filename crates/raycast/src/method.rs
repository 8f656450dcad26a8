//! Methods by which a picture can be cast, and statistics of a cast.

use carina_isoregion::SegmentTable;

use crate::{Frame, Interpolation, composite::Gathered};

/// Method by which the rays of a picture are cast.
#[derive(Debug, Clone, Copy)]
pub enum Method<'a> {
    /// Brute force: every sample is read.
    Brute,
    /// Skip regions of transparent classes only (empty-space skipping).
    ///
    /// The variant contains the radius map of the cells between voxels of these classes, `[z, y, x]`
    /// ([`carina_isoregion::cell_map`]).
    LeapTransparent(&'a [u8]),
    /// Skip regions of all classes by the segment table, only for pictures without shading whose samples are
    /// interpolated.
    LeapClasses(ClassMap<'a>),
    /// Skip regions of equal values by the segment table, as in the paper, only for samples of the nearest voxel.
    LeapValues(ValueMap<'a>),
}

/// Labels, radii and segment table to skip regions of every class, only for pictures without shading.
#[derive(Debug, Clone, Copy)]
pub struct ClassMap<'a> {
    /// Label of each voxel, `[z, y, x]`; voxels with label 0 are never skipped.
    pub labels: &'a [u8],
    /// Half the side of the largest cube of one class around each voxel, `[z, y, x]`.
    pub radius: &'a [u8],
    /// Colours of skipped segments, computed for the length of the ray steps of this picture.
    pub segments: &'a SegmentTable,
}

/// Label and radius of each voxel in one word, and segment table, to skip regions of equal values.
///
/// One read of a word replaces the reads of the voxel, its label and its radius.
#[derive(Debug, Clone, Copy)]
pub struct ValueMap<'a> {
    /// Label of each voxel plus 256 times the radius of its region, `[z, y, x]`; a voxel with label 0 is never skipped.
    pub words: &'a [u16],
    /// Colours of skipped segments, computed for the length of the ray steps of this picture.
    pub segments: &'a SegmentTable,
    /// Whether the word that a ray reads next is fetched into the cache while other rays are cast.
    ///
    /// Prefetching changes only the time: it saves time where words come from memory, and costs time where the words
    /// are in the cache.
    pub prefetch: bool,
}

impl ValueMap<'_> {
    /// Return the label and the radius in a word.
    #[inline(always)]
    pub(crate) const fn parts(word: u16) -> (u8, u8) {
        let [label, radius] = word.to_le_bytes();
        (label, radius)
    }
}

/// Counts of the work that a cast has done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CastStats {
    /// Number of rays that were cast.
    pub num_rays: u64,
    /// Number of samples read from the volume.
    pub num_samples: u64,
    /// Number of reads of the radius map.
    pub num_lookups: u64,
    /// Number of leaps (skipped segments) of all rays.
    pub num_leaps: u64,
    /// Number of samples that leaps skipped.
    pub num_skipped: u64,
    /// Number of samples that were shaded, for each of which a gradient was read.
    pub num_shaded: u64,
    /// Number of reads of the volume and of the maps; see [`CastStats::with_loads`].
    pub num_loads: u64,
}

impl CastStats {
    /// Return the number of memory reads of a sample: four rows of two voxels of its cell, or one read for the nearest
    /// voxel.
    pub(crate) const fn sample_loads(nearest: bool) -> u32 {
        if nearest { 1 } else { 4 }
    }

    /// Number of additional memory reads of a shaded sample: its gradient needs the eight rows beside its cell.
    ///
    /// The four rows of the cell itself are then read with two more voxels each.
    const GRADIENT_LOADS: u64 = 8;

    /// Number of memory reads of a shaded first wall: gradients at the eight corners of its cell, and one sample
    /// beneath the wall.
    const LIGHTING_LOADS: u64 = 8 + 4;

    /// Return the statistics with the number of memory reads, computed from the other counts.
    ///
    /// Counted are the reads of samples and of their gradients, one read of a radius for each look-up, and one read of
    /// a label for each leap over a class. With leaps over values, a look-up is the only read of a sample, unless the
    /// label of the sample's voxel is 0. Reads of the transfer and segment tables are left out: the tables are small
    /// and stay in the nearest cache, and a leap saves these reads as well.
    #[must_use]
    pub fn with_loads(self, frame: &Frame<'_>, method: Method<'_>) -> Self {
        let nearest = frame.options.interpolation == Interpolation::Nearest;
        let labels = match method {
            Method::LeapClasses(_) => self.num_leaps,
            Method::Brute | Method::LeapTransparent(_) => 0,
            // The casters have counted the samples of voxels without a label.
            Method::LeapValues(_) => {
                return Self {
                    num_loads: self.num_loads + self.num_lookups,
                    ..self
                };
            }
        };
        let samples = u64::from(Self::sample_loads(nearest)) * self.num_samples;
        let gradients = Self::GRADIENT_LOADS * self.num_shaded;
        Self {
            num_loads: samples + gradients + self.num_lookups + labels,
            ..self
        }
    }

    /// Return the statistics with the shading of the first walls `walls` added.
    pub(crate) fn lit(self, walls: &[Gathered]) -> Self {
        self.with_lit_walls(walls.iter().filter(|wall| wall.hit >= 0.0).count() as u64)
    }

    /// Return the statistics with the shading of `num_lit` first walls added.
    #[must_use]
    pub fn with_lit_walls(self, num_lit: u64) -> Self {
        Self {
            num_shaded: num_lit,
            num_loads: self.num_loads + Self::LIGHTING_LOADS * num_lit,
            ..self
        }
    }

    pub(crate) fn plus(self, other: Self) -> Self {
        Self {
            num_rays: self.num_rays + other.num_rays,
            num_samples: self.num_samples + other.num_samples,
            num_lookups: self.num_lookups + other.num_lookups,
            num_leaps: self.num_leaps + other.num_leaps,
            num_skipped: self.num_skipped + other.num_skipped,
            num_shaded: self.num_shaded + other.num_shaded,
            num_loads: self.num_loads + other.num_loads,
        }
    }
}
