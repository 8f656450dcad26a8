//! Mist on the lens: it lies in the picture, not on the tissue, and hides what is behind it.

use super::{
    lanes::Lanes,
    texture::noise,
    vectors::{scaled, turn},
};
use crate::lighting::Lighting;

/// Patches of the mist across a radian.
const PATCHES: f32 = 2.3;
/// Display colour of the mist, lit by what the wall gives back.
pub(super) const MIST_RGB: [f32; 3] = [0.66, 0.56, 0.53];

/// How much of a pixel's light is the mist's, 0..1, for rays with steps `delta`, in voxels. It follows from the ray's
/// direction to the camera alone.
#[inline(always)]
pub(super) fn mist<L: Lanes>(l: L, light: &Lighting, delta: [L::F; 3]) -> L::F {
    let s = |v: f32| l.splat(v);
    let lps = turn(l, &light.lps_from_ijk, delta);
    let dir = turn(l, &light.camera_from_lps, lps);
    let (patch, _) = noise(l, scaled(l, s(PATCHES / light.step_mm), dir), 71);
    // Thickest where it is thickest, but everywhere some.
    l.mul(l.fma(patch, s(0.22), s(0.62)), s(light.look.fog))
}
