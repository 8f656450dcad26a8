//! The leaping caster (paper 4.3): the brute-force samples, less those that a map shows to be known.

use carina_isoregion::{MAX_SEGMENT_SAMPLES, SegmentTable};

use crate::{
    composite::Gathered,
    frame::{Frame, Ray, STOP_TRANSPARENCY},
    image::CastStats,
};

/// Labels, radii and step table for leaps over every class; only without shading.
#[derive(Debug, Clone, Copy)]
pub struct ClassMap<'a> {
    /// `[z, y, x]`; 0 is never leaped.
    pub labels: &'a [u8],
    /// `[z, y, x]`, from the labels.
    pub radius: &'a [u8],
    /// For one ray step of this picture.
    pub segments: &'a SegmentTable,
}

/// A ray's reach in steps: how far it may go before it leaves a cube.
#[derive(Clone, Copy)]
struct Pace {
    /// Steps per voxel on each axis, with the sign of the direction.
    signed: [f32; 3],
    /// The same without sign.
    plain: [f32; 3],
}

impl Pace {
    #[inline(always)]
    fn of(ray: &Ray) -> Self {
        let mut pace = Self {
            signed: [0.0; 3],
            plain: [0.0; 3],
        };
        for a in 0..3 {
            // An axis along which the ray stands still never ends a leap; 1e30 is far and, unlike infinity, safe to add to.
            let still = ray.delta[a].abs() < 1e-12;
            pace.signed[a] = if still { 0.0 } else { 1.0 / ray.delta[a] };
            pace.plain[a] = if still { 1e30 } else { pace.signed[a].abs() };
        }
        pace
    }

    /// The largest n with `|p + n delta - v| <= reach` on every axis.
    #[inline(always)]
    fn steps(&self, p: [f32; 3], v: [f32; 3], reach: f32) -> u32 {
        let on = |a: usize| reach.mul_add(self.plain[a], (v[a] - p[a]) * self.signed[a]);
        // Only the face ahead counts: p is at most half a voxel from v, so the faces behind hold. The cast takes the floor
        // and turns negative reaches into 0.
        on(0).min(on(1)).min(on(2)) as u32
    }
}

/// Leaps over transparent classes only. Skipped samples would have added nothing, so the picture is brute force's, bit for bit.
///
/// `radius` is the map of the transparent classes, 0 elsewhere.
#[inline(always)]
pub(crate) fn cast_transparent<const SHADED: bool, const NEAREST: bool>(
    frame: &Frame<'_>,
    radius: &[u8],
    ray: &Ray,
    stats: &mut CastStats,
) -> Gathered {
    let mut gathered = Gathered::NOTHING;
    let pace = Pace::of(ray);
    let mut k = ray.first;
    while k < ray.end {
        let p = ray.at(k);
        let (index, v) = frame.field.nearest(p);
        stats.num_lookups += 1;
        let r = radius[index];
        if r > 0 {
            // All corners of this sample and of the next n lie in the cube.
            let n = pace
                .steps(p, v, f32::from(r) - frame.guard_vox)
                .saturating_add(1)
                .min(ray.end - k);
            stats.num_leaps += 1;
            stats.num_skipped += u64::from(n);
            k += n;
            continue;
        }
        frame.add_sample::<SHADED, NEAREST>(ray, k, p, &mut gathered);
        stats.num_samples += 1;
        k += 1;
        if gathered.transparency < STOP_TRANSPARENCY {
            break;
        }
    }
    gathered
}

/// Leaps over every class by the step table. Within one grey level of brute force: a segment's colour is rounded once, its
/// samples' colours one by one. A leap that crosses the stop limit ends at the sample where brute force stops.
#[inline(always)]
pub(crate) fn cast_classes<const NEAREST: bool>(
    frame: &Frame<'_>,
    map: ClassMap<'_>,
    ray: &Ray,
    stats: &mut CastStats,
) -> Gathered {
    let mut gathered = Gathered::NOTHING;
    let pace = Pace::of(ray);
    // A nearest-voxel sample needs its own voxel in the cube, not eight corners: half a voxel more on each side.
    let margin = if NEAREST { 0.5 } else { 0.0 } - frame.guard_vox;
    let mut k = ray.first;
    while k < ray.end {
        let p = ray.at(k);
        let (index, v) = frame.field.nearest(p);
        stats.num_lookups += 1;
        let (label, r) = (map.labels[index], map.radius[index]);
        if label != 0 && (NEAREST || r > 0) {
            let n = pace
                .steps(p, v, f32::from(r) + margin)
                .saturating_add(1)
                .min(ray.end - k)
                .min(MAX_SEGMENT_SAMPLES as u32);
            let n = map.segments.samples_until(
                label,
                n as usize,
                gathered.transparency,
                STOP_TRANSPARENCY,
            );
            gathered.add_segment(map.segments.segment(label, n));
            stats.num_leaps += 1;
            stats.num_skipped += n as u64;
            k += n as u32;
        } else {
            frame.add_sample::<false, NEAREST>(ray, k, p, &mut gathered);
            stats.num_samples += 1;
            k += 1;
        }
        if gathered.transparency < STOP_TRANSPARENCY {
            break;
        }
    }
    gathered
}
