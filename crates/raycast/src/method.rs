//! Which caster a picture takes, and what it took.

use carina_isoregion::SegmentTable;

use crate::{Frame, Interpolation, composite::Gathered};

/// Which caster.
#[derive(Debug, Clone, Copy)]
pub enum Method<'a> {
    /// Every sample.
    Brute,
    /// Leaps over transparent classes; the map of the cells between voxels of these classes alone
    /// ([`carina_isoregion::cell_map`]).
    LeapTransparent(&'a [u8]),
    /// Leaps over all classes by the step table; only without shading.
    LeapClasses(ClassMap<'a>),
}

/// Labels, radii and step table for leaps over every class; only without shading.
#[derive(Debug, Clone, Copy)]
pub struct ClassMap<'a> {
    /// `[z, y, x]`; 0 is never leaped.
    pub labels: &'a [u8],
    /// `[z, y, x]`, from the labels.
    pub radius: &'a [u8],
    /// For one ray step of this picture.
    pub segments: &'a SegmentTable,
}

/// What a picture took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CastStats {
    /// Rays cast.
    pub num_rays: u64,
    /// Samples read from the volume.
    pub num_samples: u64,
    /// Look-ups in the radius map.
    pub num_lookups: u64,
    /// Leaps taken.
    pub num_leaps: u64,
    /// Samples that leaps stood for.
    pub num_skipped: u64,
    /// Samples that were lit, for which a gradient was read.
    pub num_shaded: u64,
    /// Reads of the volume and of the maps: see [`CastStats::sample_loads`].
    pub num_loads: u64,
}

impl CastStats {
    /// Reads of a sample: the four rows of its cell, two voxels each; or the nearest voxel.
    pub(crate) const fn sample_loads(nearest: bool) -> u32 {
        if nearest { 1 } else { 4 }
    }

    /// Further reads of a lit sample: its gradient takes the eight rows beside its cell. (The cell's own are then read two
    /// voxels longer.)
    const GRADIENT_LOADS: u64 = 8;

    /// Reads of a lit first wall: slopes at the eight corners of its cell, and one sample beneath it.
    const LIGHTING_LOADS: u64 = 8 + 4;

    /// Counts the reads, which follow from the other counts: of samples and their gradients, one radius for each look-up,
    /// and one label for each leap over a class. Reads of the transfer and step tables are left out: they are small and
    /// stay in the nearest cache, and a leap saves them as well.
    #[must_use]
    pub fn with_loads(self, frame: &Frame<'_>, method: Method<'_>) -> Self {
        let nearest = frame.options.interpolation == Interpolation::Nearest;
        let labels = match method {
            Method::LeapClasses(_) => self.num_leaps,
            Method::Brute | Method::LeapTransparent(_) => 0,
        };
        let samples = u64::from(Self::sample_loads(nearest)) * self.num_samples;
        let gradients = Self::GRADIENT_LOADS * self.num_shaded;
        Self {
            num_loads: samples + gradients + self.num_lookups + labels,
            ..self
        }
    }

    /// Counts the lighting of first walls.
    pub(crate) fn lit(self, walls: &[Gathered]) -> Self {
        let num_lit = walls.iter().filter(|wall| wall.hit >= 0.0).count() as u64;
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
