//! The leaping caster (paper 4.3): the brute-force samples, less those that a map shows to be known.
//!
//! # When a ray asks the map
//! A look-up that finds no region has cost a read for nothing. In the open lumen nearly every look-up pays; in dense or
//! noisy tissue none does, and leaping must not cost more than brute force there. So every ray has *patience*: after a
//! look-up that did not pay it takes that many samples before it asks again, and each time twice as many, up to
//! [`MOST_PATIENCE`]. A leap that pays sets the patience back. Directly after a sample that added something no ray asks:
//! the next one nearly always does too. Where the camera stands in no region, or outside the volume (whose outermost
//! voxels have radius 0), all rays start with [`BLIND_SAMPLES`] samples and more patience.
//!
//! The rule looks at nothing but the ray itself and the camera's voxel, so it is the same in packets, and for each
//! split of the picture. In the worst case, a ray that leaves a region behind and never finds another, it costs about
//! one read more than brute force; over a long ray without regions less than 1 percent (docs/decisions/0104).

use carina_isoregion::{MAX_SEGMENT_SAMPLES, SegmentTable};

use crate::{
    composite::Gathered,
    frame::{Frame, Ray},
    method::{CastStats, ClassMap, Method},
    sampling::Lanes,
};

/// Steps per voxel along an axis on which a ray stands still: far and, unlike infinity, safe to multiply by 0.
pub(crate) const FAR: f32 = 1e30;
/// More steps than any ray has within a cube of 511 voxels.
pub(crate) const MAX_STEPS: f32 = 1e9;

/// How far a leap from a cell of radius 0 would reach from the cell's middle: what is known of a cell ends half a voxel before
/// its radius.
pub(crate) const CELL_REACH: f32 = -0.5;

/// Samples after the first look-up that did not pay: at half a voxel a step two samples share a voxel.
pub(crate) const LEAST_PATIENCE: u32 = 2;
/// At most this many samples between look-ups: the price of one is then below 1 percent of the samples' reads.
pub(crate) const MOST_PATIENCE: u32 = 128;
/// Samples before the first look-up of rays that start in no region.
const BLIND_SAMPLES: u32 = 8;

/// Leaps that pay: by the reads that they save and those of a look-up.
#[derive(Clone, Copy)]
pub(crate) struct Price {
    /// Shorter leaps cost more than their samples.
    pub worth: u32,
    /// Leaps this long also pay for the next few look-ups that fail.
    pub pays: u32,
}

impl Price {
    /// For samples and look-ups of so many reads.
    pub(crate) const fn of(sample_loads: u32, lookup_loads: u32) -> Self {
        Self {
            worth: lookup_loads.div_ceil(sample_loads),
            // With patience 2, 4, 8, ... about three failing look-ups exceed 3 percent of the reads between them.
            pays: (lookup_loads + 3).div_ceil(sample_loads),
        }
    }
}

/// How the rays of a picture start to ask.
#[derive(Clone, Copy)]
pub(crate) struct Start {
    /// Samples before the first look-up.
    pub wait: u32,
    pub patience: u32,
}

impl Start {
    pub(crate) fn of(frame: &Frame<'_>, method: Method<'_>) -> Self {
        let in_region = frame.inside().is_some_and(|p| match method {
            Method::Brute => false,
            Method::LeapTransparent(radius) => radius[frame.field.cell_of(p).0] > 0,
            Method::LeapClasses(map) => map.radius[frame.field.nearest(p).0] > 0,
        });
        if in_region {
            Self {
                wait: 0,
                patience: LEAST_PATIENCE,
            }
        } else {
            Self {
                wait: BLIND_SAMPLES,
                patience: 2 * BLIND_SAMPLES,
            }
        }
    }
}

/// When one ray asks next.
struct Asking {
    at: u32,
    patience: u32,
}

impl Asking {
    #[inline(always)]
    fn of(start: Start, ray: &Ray) -> Self {
        Self {
            at: ray.first + start.wait,
            patience: start.patience,
        }
    }

    /// After a look-up for sample `k` that found nothing.
    #[inline(always)]
    fn failed(&mut self, k: u32) {
        self.at = k + self.patience;
        self.patience = (2 * self.patience).min(MOST_PATIENCE);
    }

    /// After a leap from sample `k` over `n` samples.
    #[inline(always)]
    fn leaped(&mut self, k: u32, n: u32, price: Price) {
        if n < price.worth {
            self.failed(k);
        }
        if n >= price.pays {
            self.patience = LEAST_PATIENCE;
        }
    }

    /// After sample `k`, which added something.
    #[inline(always)]
    fn lit(&mut self, k: u32) {
        self.at = self.at.max(k + 2);
    }
}

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

    /// The largest n with `|p + n delta - v| <= reach` on every axis; `v` is a voxel, or a cell's middle.
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
/// `radius` is the map of the transparent classes' cells, 0 elsewhere.
#[inline(always)]
pub(crate) fn cast_transparent<const SHADED: bool, const NEAREST: bool, const HITS: bool>(
    frame: &Frame<'_>,
    radius: &[u8],
    start: Start,
    ray: &Ray,
    stats: &mut CastStats,
) -> Gathered {
    let mut gathered = Gathered::NOTHING;
    let pace = Pace::of(ray);
    let price = const { Price::of(CastStats::sample_loads(NEAREST), 1) };
    let mut k = ray.first;
    let mut counts = [0u32; 4];
    let mut asking = Asking::of(start, ray);
    while k < ray.end {
        let p = ray.at(k);
        if k >= asking.at {
            let (index, v) = frame.field.cell_of(p);
            counts[0] += 1;
            // SAFETY: `cast_rows` has checked that the map has the volume's voxels; `cell_of` clamps to them.
            // Benchmark: this is the look-up that decides the speed of a leap.
            let r = unsafe { *radius.get_unchecked(index) };
            if r > 0 {
                // All corners of this sample and of the next n lie in the cube.
                let n = pace
                    .steps(p, v, f32::from(r) + (CELL_REACH - frame.guard_vox))
                    .saturating_add(1)
                    .min(ray.end - k);
                counts[1] += 1;
                counts[2] += n;
                asking.leaped(k, n, price);
                k += n;
                continue;
            }
            asking.failed(k);
        }
        if frame.add_sample::<SHADED, NEAREST, HITS>(ray, k, p, &mut gathered) {
            counts[3] += 1;
            asking.lit(k);
            if gathered.transparency < frame.stop {
                k += 1;
                break;
            }
        }
        k += 1;
    }
    stats.num_lookups += u64::from(counts[0]);
    stats.num_leaps += u64::from(counts[1]);
    stats.num_skipped += u64::from(counts[2]);
    stats.num_samples += u64::from(k - ray.first - counts[2]);
    stats.num_shaded += if SHADED { u64::from(counts[3]) } else { 0 };
    gathered
}

/// Leaps over every class by the step table. Within one grey level of brute force: a segment's colour is rounded once,
/// its samples' colours one by one. A leap that crosses the stop limit ends at the sample where brute force stops.
#[inline(always)]
pub(crate) fn cast_classes<const NEAREST: bool, const HITS: bool>(
    frame: &Frame<'_>,
    map: ClassMap<'_>,
    start: Start,
    ray: &Ray,
    stats: &mut CastStats,
) -> Gathered {
    let mut gathered = Gathered::NOTHING;
    let pace = Pace::of(ray);
    let price = const { Price::of(CastStats::sample_loads(NEAREST), 2) };
    // A nearest-voxel sample needs its own voxel in the cube, not eight corners: half a voxel more on each side.
    let margin = class_margin(frame, NEAREST);
    let mut k = ray.first;
    let mut asking = Asking::of(start, ray);
    while k < ray.end {
        let p = ray.at(k);
        if k >= asking.at {
            let (index, v) = frame.field.nearest(p);
            stats.num_lookups += 1;
            // The label is read only where it counts; where it is 0, the radius is.
            let r = map.radius[index];
            let label = if r > 0 { map.labels[index] } else { 0 };
            if label != 0 {
                let n = pace
                    .steps(p, v, f32::from(r) + margin)
                    .saturating_add(1)
                    .min(ray.end - k)
                    .min(MAX_SEGMENT_SAMPLES as u32);
                let n = map.segments.samples_until(
                    label,
                    n as usize,
                    gathered.transparency,
                    frame.stop,
                );
                if HITS {
                    cross_segment(&mut gathered, map.segments, label, k, n);
                }
                gathered.add_segment(map.segments.segment(label, n));
                stats.num_leaps += 1;
                stats.num_skipped += n as u64;
                asking.leaped(k, n as u32, price);
                k += n as u32;
                if gathered.transparency < frame.stop {
                    break;
                }
                continue;
            }
            asking.failed(k);
        }
        frame.add_sample::<false, NEAREST, HITS>(ray, k, p, &mut gathered);
        stats.num_samples += 1;
        k += 1;
        if gathered.transparency < frame.stop {
            break;
        }
    }
    gathered
}

/// What a leap over a class may reach beyond the radius.
pub(crate) fn class_margin(frame: &Frame<'_>, nearest: bool) -> f32 {
    if nearest {
        0.5 - frame.guard_vox
    } else {
        -frame.guard_vox
    }
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
