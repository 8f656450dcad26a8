//! Parameters that all packets of a picture share, and the kinds of leaps.

use carina_isoregion::SegmentTable;

use super::voxels::Voxels;
use crate::{
    Frame,
    leap::{Price, Start},
};

/// Kind of leaps: none (brute force).
pub(super) const BRUTE: u8 = 0;
/// Kind of leaps: over transparent classes only.
pub(super) const TRANSPARENT: u8 = 1;
/// Kind of leaps: over all classes by the step table.
pub(super) const CLASSES: u8 = 2;

/// Parameters that all packets of a picture share.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub frame: &'a Frame<'a>,
    pub voxels: Voxels<'a>,
    /// Radius map of the volume's regions; empty for brute force.
    pub radius: &'a [u8],
    /// Label of each voxel; empty, like the step table, unless all classes are leaped.
    pub labels: &'a [u8],
    pub segments: &'a SegmentTable,
    /// Distance in voxels by which a leap may exceed the radius of its region.
    pub margin: f32,
    pub start: Start,
    pub price: Price,
}
