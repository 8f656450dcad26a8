//! Parameters that all packets of a picture share, and which regions rays skip.

use carina_isoregion::SegmentTable;

use super::voxels::Voxels;
use crate::{
    Frame,
    leap::{Price, Start},
};

/// Casting without leaps: every sample is read (brute force).
pub(super) const BRUTE: u8 = 0;
/// Casting that skips regions of transparent classes only.
pub(super) const TRANSPARENT: u8 = 1;
/// Casting that skips regions of all classes; the segment table gives the colour of a skipped segment.
pub(super) const CLASSES: u8 = 2;
/// Casting of nearest-voxel samples that skips regions of equal values; the segment table gives the colour of a
/// segment.
pub(super) const VALUES: u8 = 3;
/// Casting as with [`VALUES`], in two packets that alternate: each prefetches its next words while the other is cast.
pub(super) const VALUES_PREFETCHED: u8 = 4;

/// Parameters that all packets of a picture share.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub frame: &'a Frame<'a>,
    pub voxels: Voxels<'a>,
    /// Radius of the uniform region at each voxel; empty for brute force.
    pub radius: &'a [u8],
    /// Label of each voxel; empty, like the segment table, unless regions of all classes are skipped.
    pub labels: &'a [u8],
    /// Label and radius of each voxel in one word; empty unless regions of equal values are skipped.
    pub words: &'a [u16],
    pub segments: &'a SegmentTable,
    /// Distance in voxels by which a leap may exceed the stored radius of its region.
    pub margin: f32,
    pub start: Start,
    pub price: Price,
}
