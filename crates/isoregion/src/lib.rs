//! `IsoRegion` maps: the radius of the largest cube of equal labels round each voxel (paper 4.1, 4.2), and segment
//! tables (4.3).
//!
//! The radius of a voxel is the largest `d` such that the `(2d+1)^3` cube round it is in the volume and has one label.
//! [`paper_radius_map`] is the paper's slow, readable construction; [`radius_map`] gives the same map and is for
//! general use. [`cell_map`] is the corresponding map for the cells between voxels, which leaps over transparent
//! classes use.

#![allow(
    clippy::inline_always,
    reason = "a kernel is compiled once per instruction set; what it calls must be compiled inside it or loses the set"
)]

mod bytes;
mod error;
mod labels;
mod map;
mod reference;
mod segment_table;
mod sweep;
mod threads;
mod uniform;

pub use error::IsoRegionError;
pub use labels::{
    Class, ClassLabels, Rgba, VALUE_BIN_HU, class_labels, transparent_runs, value_bin,
    value_labels, value_range,
};
pub use map::{MapBuilder, cell_map, radius_map};
pub use reference::{MAX_RADIUS_VOX, paper_radius_map, reference_cell_map};
pub use segment_table::{MAX_SEGMENT_SAMPLES, SegmentTable};
