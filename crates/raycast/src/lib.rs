//! Ray casters and planes: the paper's four views (3.1) and their acceleration (4.3).
//!
//! [`brute`] is the reference: it reads every sample of every ray. [`leap`] skips samples with an `IsoRegion` map and
//! moves no sample, so the picture is the same. Both use one sampling rule, measured from the camera's centre:
//! `t_k = (k + 1/2) * step`, computed as a product.
//!
//! Kernels use IEEE f32 addition, multiplication, division, square root and explicit fused multiply-add in a fixed
//! order, so the picture depends neither on threads nor on strips nor on the instruction set. The module `packet` casts
//! 8 to 32 rays at once, with the same bits; the scalar casters define the correct result.

#![allow(
    clippy::inline_always,
    reason = "a kernel is compiled once per instruction set; what it calls must be compiled inside it or loses the set"
)]
#![allow(
    clippy::needless_range_loop,
    reason = "the loop variable is an axis or a channel of several short arrays at once"
)]
#![cfg_attr(
    test,
    allow(
        clippy::float_cmp,
        reason = "kernels are deterministic: tests compare bits"
    )
)]

mod appearance;
mod bricks;
mod brute;
mod composite;
mod decoration;
mod defocus;
mod drr;
#[cfg(test)]
mod drr_tests;
mod error;
mod exposure;
mod frame;
mod frame_parameters;
mod image;
mod leap;
mod leap_trial;
mod light;
mod lighting;
mod lines;
mod mask;
mod method;
mod normals;
mod packet;
mod plane;
mod projection;
mod rows;
mod sampling;
mod shaded_walls;
mod shading_constants;
mod shared_constants;
mod silhouette;
mod surface;
mod transfer;
mod triplane;
mod wall;
mod wall_lighting;
mod window;

pub use appearance::Appearance;
pub use bricks::{NormalBricks, SampleBricks};
pub use carina_grid::InstructionSet;
pub use composite::Gathered;
pub use decoration::{CHANNELS as DECORATION_CHANNELS, Decoration};
pub use defocus::{Focus, defocus};
pub use drr::{Attenuation, Projector, cast_radiograph};
pub use error::RaycastError;
pub use frame::{Frame, FrameOptions, Interpolation, STOP_TRANSPARENCY};
pub use frame_parameters::{FrameParameters, paying_leap};
pub use image::{cast_rows, cast_rows_scalar, cast_rows_until};
pub use light::Light;
pub use lines::{PixelLine, Slab, SlabKind, sample_lines};
pub use mask::smoothed_mask;
pub use method::{CastStats, ClassMap, Method, ValueMap};
pub use plane::{PlaneImage, sample_plane, sample_plane_by};
pub use projection::{Projections, maximum_projections, maximum_projections_by};
pub use sampling::Field;
pub use shaded_walls::rows_to_gather;
pub use shading_constants::shading_constants;
pub use shared_constants::{SharedConstant, SharedValue};
pub use surface::{Hit, cast_surface, pick};
pub use transfer::{Transfer, TransferTable};
pub use triplane::{TriPlane, cast_tri_plane};
pub use wall::{BoxZyx, WallHeights, raise_wall};
pub use wall_lighting::{WallDecoration, WallLighting};
pub use window::Window;
