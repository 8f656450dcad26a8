//! The leaping caster (paper 4.3): the brute-force samples, less those that a map shows to be known.

use carina_isoregion::{MAX_SEGMENT_SAMPLES, SegmentTable};

use crate::{
    composite::Gathered,
    frame::{Frame, Ray, STOP_TRANSPARENCY},
    image::CastStats,
    sampling::Lanes,
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

/// Steps per voxel along an axis on which a ray stands still: far and, unlike infinity, safe to multiply by 0.
pub(crate) const FAR: f32 = 1e30;
/// More steps than any ray has within a cube of 511 voxels.
pub(crate) const MAX_STEPS: f32 = 1e9;

/// Samples taken after a look-up that found no region: at half a voxel a step two samples share a voxel.
pub(crate) const WAIT_SAMPLES: u32 = 2;

/// A ray's reach in steps: how far it may go before it leaves a cube.
#[derive(Clone, Copy)]
struct Pace {
    /// Steps per voxel on each axis, with the sign of the direction.
    signed: Lanes,
    /// The same without sign.
    plain: Lanes,
}

impl Pace {
    #[inline(always)]
    fn of(ray: &Ray) -> Self {
        let mut pace = Self {
            signed: [0.0; 4],
            plain: [FAR; 4],
        };
        for a in 0..3 {
            // An axis along which the ray stands still never ends a leap.
            if ray.delta[a].abs() > 1e-12 {
                pace.signed[a] = 1.0 / ray.delta[a];
                pace.plain[a] = pace.signed[a].abs();
            }
        }
        pace
    }

    /// The largest n with `|p + n delta - v| <= reach` on every axis.
    #[inline(always)]
    fn steps(&self, p: Lanes, v: Lanes, reach: f32) -> u32 {
        let on: Lanes =
            std::array::from_fn(|a| reach.mul_add(self.plain[a], (v[a] - p[a]) * self.signed[a]));
        // Only the face ahead counts: p is at most half a voxel from v, so the faces behind hold.
        let least = |a: f32, b: f32| if a < b { a } else { b };
        let steps = least(least(on[0], on[1]), least(on[2], MAX_STEPS));
        let steps = if steps > 0.0 { steps } else { 0.0 };
        // SAFETY: between 0 and MAX_STEPS. The cast takes the floor. Benchmark: as in `sampling`.
        let steps: i32 = unsafe { steps.to_int_unchecked() };
        steps as u32
    }
}

/// Leaps over transparent classes only. Skipped samples would have added nothing, so the picture is brute force's, bit
/// for bit.
///
/// `radius` is the map of the transparent classes, 0 elsewhere.
#[inline(always)]
pub(crate) fn cast_transparent<const SHADED: bool, const NEAREST: bool, const HITS: bool>(
    frame: &Frame<'_>,
    radius: &[u8],
    ray: &Ray,
    stats: &mut CastStats,
) -> Gathered {
    let mut gathered = Gathered::NOTHING;
    let pace = Pace::of(ray);
    let mut k = ray.first;
    let mut counts = [0u32; 3];
    // Samples to take before the map is asked again. Where a sample added something, the next one nearly always does
    // too; where the map knew nothing, the next sample is often in the same voxel.
    let mut wait = 0;
    while k < ray.end {
        let p = ray.at(k);
        if wait == 0 {
            let (index, v) = frame.field.nearest(p);
            counts[0] += 1;
            // SAFETY: `cast_rows` has checked that the map has the volume's voxels; `nearest` clamps to them.
            // Benchmark: this is the look-up that decides the speed of a leap.
            let r = unsafe { *radius.get_unchecked(index) };
            if r > 0 {
                // All corners of this sample and of the next n lie in the cube.
                let n = pace
                    .steps(p, v, f32::from(r) - frame.guard_vox)
                    .saturating_add(1)
                    .min(ray.end - k);
                counts[1] += 1;
                counts[2] += n;
                k += n;
                continue;
            }
            wait = WAIT_SAMPLES;
        }
        k += 1;
        if frame.add_sample::<SHADED, NEAREST, HITS>(ray, k - 1, p, &mut gathered) {
            wait = 1;
            if gathered.transparency < STOP_TRANSPARENCY {
                break;
            }
        } else {
            wait -= 1;
        }
    }
    stats.num_lookups += u64::from(counts[0]);
    stats.num_leaps += u64::from(counts[1]);
    stats.num_skipped += u64::from(counts[2]);
    stats.num_samples += u64::from(k - ray.first - counts[2]);
    gathered
}

/// Leaps over every class by the step table. Within one grey level of brute force: a segment's colour is rounded once,
/// its samples' colours one by one. A leap that crosses the stop limit ends at the sample where brute force stops.
#[inline(always)]
pub(crate) fn cast_classes<const NEAREST: bool, const HITS: bool>(
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
            if HITS {
                cross_segment(&mut gathered, map.segments, label, k, n);
            }
            gathered.add_segment(map.segments.segment(label, n));
            stats.num_leaps += 1;
            stats.num_skipped += n as u64;
            k += n as u32;
        } else {
            frame.add_sample::<false, NEAREST, HITS>(ray, k, p, &mut gathered);
            stats.num_samples += 1;
            k += 1;
        }
        if gathered.transparency < STOP_TRANSPARENCY {
            break;
        }
    }
    gathered
}

/// Notes the first wall if it lies within a segment: its samples one by one, as the step table has them.
#[inline(always)]
fn cross_segment(gathered: &mut Gathered, segments: &SegmentTable, label: u8, k: u32, n: usize) {
    let through = |samples| gathered.transparency * segments.segment(label, samples)[3];
    if gathered.transparency < 0.5 || through(n) >= 0.5 {
        return;
    }
    let crossing = segments.samples_until(label, n, gathered.transparency, 0.5);
    let (before, after) = (through(crossing - 1), through(crossing));
    gathered.cross(k + crossing as u32 - 1, before, after);
}
