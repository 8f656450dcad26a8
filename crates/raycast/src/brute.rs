//! Reference caster, which reads every sample of every ray.
//!
//! The code stays readable, because the leaping caster is compared with it.

use crate::{
    composite::Gathered,
    frame::{Frame, Ray},
    method::CastStats,
};

/// Cast one ray by brute force: read evenly spaced samples from front to back until the ray is opaque.
///
/// Paper 4.3 calls this method "ordinary ray casters".
#[inline(always)]
pub(crate) fn cast<const SHADED: bool, const NEAREST: bool, const HITS: bool>(
    frame: &Frame<'_>,
    ray: &Ray,
    stats: &mut CastStats,
) -> Gathered {
    let mut gathered = Gathered::NOTHING;
    let mut num_lit = 0u32;
    let mut k = ray.first;
    while k < ray.end {
        let lit = frame.add_sample::<SHADED, NEAREST, HITS>(ray, k, ray.at(k), &mut gathered);
        num_lit += u32::from(lit);
        k += 1;
        if gathered.transparency < frame.stop {
            break;
        }
    }
    stats.num_samples += u64::from(k - ray.first);
    stats.num_shaded += if SHADED { u64::from(num_lit) } else { 0 };
    gathered
}
