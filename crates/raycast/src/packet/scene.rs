//! Parameters that all packets of a picture share, and the choice of leaps.

use carina_isoregion::SegmentTable;

use super::voxels::Voxels;
use crate::{
    Frame,
    leap::{Price, Start},
};

/// Casting without leaps: every sample is read (brute force).
pub(super) const BRUTE: u8 = 0;
/// Casting with leaps over transparent classes only.
pub(super) const TRANSPARENT: u8 = 1;
/// Casting with leaps over all classes; the step table gives the colour of a leap.
pub(super) const CLASSES: u8 = 2;
/// Casting of nearest-voxel samples with leaps over equal values; the step table gives the colour of a leap.
pub(super) const VALUES: u8 = 3;
/// As [`VALUES`]; two packets alternate, and each prefetches its next words while the other is cast.
pub(super) const VALUES_PREFETCHED: u8 = 4;

/// Parameters that all packets of a picture share.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub frame: &'a Frame<'a>,
    pub voxels: Voxels<'a>,
    /// Radius map of the volume; empty for brute force.
    pub radius: &'a [u8],
    /// Label of each voxel; empty, like the step table, unless all classes are leaped.
    pub labels: &'a [u8],
    /// Label and radius of each voxel in one word; empty unless values are leaped.
    pub words: &'a [u16],
    pub segments: &'a SegmentTable,
    /// Distance in voxels by which a leap may exceed the radius of its region.
    pub margin: f32,
    pub start: Start,
    pub price: Price,
}
