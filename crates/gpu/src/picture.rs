//! Picture in progress on the device.

use std::{ops::Range, sync::Arc};

use carina_raycast::Frame;

use crate::{
    light_uniforms::LightUniforms,
    passes::Tables,
    resources::{Resident, Slot},
    slope_store::SlopeStore,
    stages::Variant,
};

/// Number of 32-bit words per pixel in the output of first walls.
pub(crate) const WORDS_OF_A_WALL: usize = 5;

/// Picture in progress: its frame, the number of rows in its buffers, and its resources on the device.
pub(crate) struct Picture<'a> {
    pub(crate) frame: &'a Frame<'a>,
    pub(crate) resident: Resident<'a>,
    pub(crate) variant: Variant,
    pub(crate) all: Range<usize>,
    pub(crate) darken: bool,
    pub(crate) tables: Tables,
    pub(crate) slot: Slot,
    pub(crate) light: Option<(LightUniforms, Arc<SlopeStore>)>,
}
