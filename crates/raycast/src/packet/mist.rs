//! Mist on the lens: it is fixed to the picture, not to the tissue, and hides the scene behind it.

use super::{
    lanes::Lanes,
    texture::noise,
    vectors::{scaled, turn},
};
use crate::{lighting::Lighting, shared_constants::shared_constants};

shared_constants! {
    /// Number of patches of mist per radian of the view.
    const PATCHES: f32 = 2.3;
    /// Display colour of mist that is lit by light from the wall.
    pub(super) const MIST_RGB: [f32; 3] = [0.66, 0.56, 0.53];
    /// Amplitude and mean of the opacity of the mist across its patches.
    const MIST_COVER: [f32; 2] = [0.22, 0.62];
    /// Seed of the noise that places the patches of mist.
    const MIST_SEED: i32 = 71;
}

/// Return the opacity of the mist on the lens, 0 to 1, for rays with steps `delta` in voxels.
///
/// The opacity depends only on the ray's direction relative to the camera.
#[inline(always)]
pub(super) fn mist<L: Lanes>(l: L, light: &Lighting, delta: [L::F; 3]) -> L::F {
    let s = |v: f32| l.splat(v);
    let lps = turn(l, &light.lps_from_ijk, delta);
    let dir = turn(l, &light.camera_from_lps, lps);
    let (patch, _) = noise(l, scaled(l, s(PATCHES / light.step_mm), dir), MIST_SEED);
    // The mist has patches of different opacity, but covers the whole lens.
    l.mul(
        l.fma(patch, s(MIST_COVER[0]), s(MIST_COVER[1])),
        s(light.appearance.fog),
    )
}
