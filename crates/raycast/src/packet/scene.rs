//! What all packets of a picture share, and which leaps they take.

use carina_isoregion::SegmentTable;

use super::voxels::Voxels;
use crate::{
    Frame,
    leap::{Price, Start},
};

/// No leaps.
pub(super) const BRUTE: u8 = 0;
/// Leaps over transparent classes.
pub(super) const TRANSPARENT: u8 = 1;
/// Leaps over all classes by the step table.
pub(super) const CLASSES: u8 = 2;

/// What all packets of a picture share.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub frame: &'a Frame<'a>,
    pub voxels: Voxels<'a>,
    /// Empty for brute force.
    pub radius: &'a [u8],
    /// Empty unless all classes are leaped, like the step table.
    pub labels: &'a [u8],
    pub segments: &'a SegmentTable,
    /// What a leap may reach beyond the radius.
    pub margin: f32,
    pub start: Start,
    pub price: Price,
}
