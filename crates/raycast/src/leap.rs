//! Leaping caster (paper 4.3; empty-space skipping), which skips samples whose result follows from a map of uniform
//! regions.
//!
//! # When a ray looks up the map
//!
//! A look-up (read of the radius map) that finds no uniform region costs a memory read and saves nothing. In the open
//! lumen nearly every look-up saves samples; in dense or noisy tissue no look-up does, and leaping must not cost more
//! than brute force there. Each ray therefore has a waiting length, called *patience*. After a look-up that saved
//! nothing, the ray takes this number of samples before the next look-up, and then doubles it, up to [`MAX_PATIENCE`].
//! A leap that saves enough resets the patience. Directly after a sample with opacity a ray makes no look-up, because
//! the next sample nearly always has opacity too. If the camera is in no region, or outside the volume (whose outermost
//! voxels have radius 0), all rays start with [`BLIND_SAMPLES`] samples and a longer patience.
//!
//! The rule depends only on the ray itself and on the camera's voxel, so the result is the same in packets and for each
//! division of the picture. In the worst case (a ray that leaves a region and finds no other) the rule costs about one
//! read more than brute force; over a long ray without regions less than 1 percent (docs/decisions/0104).

use carina_isoregion::{MAX_SEGMENT_SAMPLES, SegmentTable};

use crate::{
    composite::Gathered,
    frame::{Frame, Ray},
    method::{CastStats, ClassMap, Method, ValueMap},
    sampling::Lanes,
};

/// Number of ray steps per voxel along an axis on which a ray does not advance.
///
/// The number is very large, but, unlike infinity, safe to multiply by 0.
pub(crate) const FAR: f32 = 1e30;
/// Upper bound of the number of steps of any ray within a cube of 511 voxels.
pub(crate) const MAX_STEPS: f32 = 1e9;

/// Distance in voxels that a leap may go from the centre of a cell of radius 0; each unit of a cell's radius adds 1.
///
/// The value is negative, because the region with known values ends half a voxel before the cell's radius.
pub(crate) const CELL_REACH: f32 = -0.5;

/// Number of samples that a ray takes after the first read of the radius map that did not lead to a leap.
///
/// With steps of half a voxel, two samples share a voxel.
pub(crate) const MIN_PATIENCE: u32 = 2;
/// Maximum number of samples between two reads of the radius map; a read then costs less than 1 percent of the samples'
/// reads.
pub(crate) const MAX_PATIENCE: u32 = 128;
/// Number of samples before the first read of the radius map, for rays that do not start in a uniform region.
const BLIND_SAMPLES: u32 = 8;

/// Minimum lengths of a leap, in samples, computed from the numbers of memory reads of a sample and of a look-up.
#[derive(Clone, Copy)]
pub(crate) struct Price {
    /// Length of a leap in samples below which reading the radius map costs more time than the skipped samples.
    pub worth: u32,
    /// Minimum length of a leap, in samples, that also compensates for the next few look-ups without a leap.
    ///
    /// Such a leap resets the ray's patience.
    pub pays: u32,
}

impl Price {
    /// Compute the lengths from the numbers of memory reads of a sample and of a look-up in the radius map.
    pub(crate) const fn of(sample_loads: u32, lookup_loads: u32) -> Self {
        Self {
            worth: lookup_loads.div_ceil(sample_loads),
            // With patience 2, 4, 8, ... about three look-ups without result exceed 3 percent of the reads between
            // them.
            pays: (lookup_loads + 3).div_ceil(sample_loads),
        }
    }
}

/// Initial schedule of reads of the radius map, equal for all rays of a picture.
#[derive(Clone, Copy)]
pub(crate) struct Start {
    /// Number of samples that a ray takes before it reads the radius map for the first time.
    pub wait: u32,
    pub patience: u32,
}

impl Start {
    pub(crate) fn of(frame: &Frame<'_>, method: Method<'_>) -> Self {
        let in_region = frame.inside().is_some_and(|p| match method {
            Method::Brute => false,
            Method::LeapTransparent(radius) => radius[frame.field.cell_of(p).0] > 0,
            Method::LeapClasses(map) => map.radius[frame.field.nearest(p).0] > 0,
            // Every step looks up the map.
            Method::LeapValues(_) => true,
        });
        if in_region {
            Self {
                wait: 0,
                patience: MIN_PATIENCE,
            }
        } else {
            Self {
                wait: BLIND_SAMPLES,
                patience: 2 * BLIND_SAMPLES,
            }
        }
    }
}

/// Schedule of one ray for its reads of the radius map.
struct LookupSchedule {
    at: u32,
    patience: u32,
}

impl LookupSchedule {
    #[inline(always)]
    fn of(start: Start, ray: &Ray) -> Self {
        Self {
            at: ray.first + start.wait,
            patience: start.patience,
        }
    }

    /// Postpone the next look-up after a look-up at sample `k` that did not lead to a leap.
    #[inline(always)]
    fn failed(&mut self, k: u32) {
        self.at = k + self.patience;
        self.patience = (2 * self.patience).min(MAX_PATIENCE);
    }

    /// Update the schedule after a leap from sample `k` over `n` samples: postpone the next look-up if the leap was too
    /// short to save time, reset the patience if it was long.
    #[inline(always)]
    fn leaped(&mut self, k: u32, n: u32, price: Price) {
        if n < price.worth {
            self.failed(k);
        }
        if n >= price.pays {
            self.patience = MIN_PATIENCE;
        }
    }

    /// Postpone the next look-up after sample `k`, which was not transparent.
    #[inline(always)]
    fn lit(&mut self, k: u32) {
        self.at = self.at.max(k + 2);
    }
}

/// Conversion from voxels to ray steps, for the number of steps that a ray may take before it leaves a cube of voxels.
#[derive(Clone, Copy)]
struct Pace {
    /// Steps per voxel on each axis, with the sign of the direction.
    signed: Lanes,
    /// Steps per voxel on each axis without the sign; [`FAR`] where the ray does not advance.
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
            // An axis along which the ray does not advance never ends a leap.
            if ray.delta[a].abs() > 1e-12 {
                pace.signed[a] = 1.0 / ray.delta[a];
                pace.plain[a] = pace.signed[a].abs();
            }
        }
        pace
    }

    /// Return the largest n with `|p + n delta - v| <= reach` on every axis; `v` is the centre of a voxel or cell.
    #[inline(always)]
    fn steps(&self, p: Lanes, v: Lanes, reach: f32) -> u32 {
        let on: Lanes =
            std::array::from_fn(|a| reach.mul_add(self.plain[a], (v[a] - p[a]) * self.signed[a]));
        // Only the face ahead limits the leap: p is at most half a voxel from v, so the faces behind are not reached.
        let least = |a: f32, b: f32| if a < b { a } else { b };
        let steps = least(least(on[0], on[1]), least(on[2], MAX_STEPS));
        let steps = if steps > 0.0 { steps } else { 0.0 };
        // SAFETY: the value is between 0 and MAX_STEPS, so it fits an i32. The cast rounds down. A checked
        // conversion costs a tenth of the brute-force caster (`whole` in `sampling`).
        let steps: i32 = unsafe { steps.to_int_unchecked() };
        steps as u32
    }
}

/// Cast a ray that skips regions of transparent classes only.
///
/// The skipped samples would have added nothing, so the picture equals that of brute force bit for bit. `radius` is the
/// map of the transparent classes' cells, with 0 for all other cells.
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
    let mut schedule = LookupSchedule::of(start, ray);
    while k < ray.end {
        let p = ray.at(k);
        if k >= schedule.at {
            let (index, v) = frame.field.cell_of(p);
            counts[0] += 1;
            // SAFETY: `cast_rows` has checked that the map has as many voxels as the volume, and `cell_of` clamps the
            // index to them. Benchmark: this look-up decides the speed of a leap.
            let r = unsafe { *radius.get_unchecked(index) };
            if r > 0 {
                // All corners of this sample and of the next n samples are in the cube.
                let n = pace
                    .steps(p, v, f32::from(r) + (CELL_REACH - frame.guard_vox))
                    .saturating_add(1)
                    .min(ray.end - k);
                counts[1] += 1;
                counts[2] += n;
                schedule.leaped(k, n, price);
                k += n;
                continue;
            }
            schedule.failed(k);
        }
        if frame.add_sample::<SHADED, NEAREST, HITS>(ray, k, p, &mut gathered) {
            counts[3] += 1;
            schedule.lit(k);
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

/// Cast a ray that skips regions of every class, opaque or transparent; the segment table gives a segment's colour.
///
/// The result is within one grey level of brute force: a segment's colour is rounded once, the colours of its samples
/// one by one. A leap that crosses the stop limit ends at the sample where brute force stops.
#[inline(always)]
pub(crate) fn cast_classes<const HITS: bool>(
    frame: &Frame<'_>,
    map: ClassMap<'_>,
    start: Start,
    ray: &Ray,
    stats: &mut CastStats,
) -> Gathered {
    let mut gathered = Gathered::NOTHING;
    let pace = Pace::of(ray);
    let price = const { Price::of(CastStats::sample_loads(false), 2) };
    let mut k = ray.first;
    let mut schedule = LookupSchedule::of(start, ray);
    while k < ray.end {
        let p = ray.at(k);
        if k >= schedule.at {
            let (index, v) = frame.field.nearest(p);
            stats.num_lookups += 1;
            // The label is read only for a radius above 0; a voxel with label 0 has radius 0.
            let r = map.radius[index];
            let label = if r > 0 { map.labels[index] } else { 0 };
            if label != 0 {
                let n = pace
                    .steps(p, v, f32::from(r) + class_margin(frame))
                    .saturating_add(1)
                    .min(ray.end - k)
                    .min(MAX_SEGMENT_SAMPLES as u32);
                let n = add_segment::<HITS>(frame, map.segments, &mut gathered, label, k, n);
                stats.num_leaps += 1;
                stats.num_skipped += u64::from(n);
                schedule.leaped(k, n, price);
                k += n;
                if gathered.transparency < frame.stop {
                    break;
                }
                continue;
            }
            schedule.failed(k);
        }
        frame.add_sample::<false, false, HITS>(ray, k, p, &mut gathered);
        stats.num_samples += 1;
        k += 1;
        if gathered.transparency < frame.stop {
            break;
        }
    }
    gathered
}

/// Cast a ray of nearest-voxel samples that skips regions of equal values (paper 4.3).
///
/// Each step reads one word, which contains the label and the radius of the nearest voxel, and adds the segment of all
/// samples within the cube of that voxel, at least one. There is no schedule of look-ups, because a step without a leap
/// costs no additional read. Departure from paper 4.3: samples of one voxel are one segment also where the radius is 0,
/// if the voxel is longer than a ray step.
///
/// The result is within one grey level of brute force, and a leap ends where brute force stops, as in
/// [`cast_classes`].
#[inline(always)]
pub(crate) fn cast_values<const HITS: bool>(
    frame: &Frame<'_>,
    map: ValueMap<'_>,
    ray: &Ray,
    stats: &mut CastStats,
) -> Gathered {
    let mut gathered = Gathered::NOTHING;
    let pace = Pace::of(ray);
    let mut k = ray.first;
    while k < ray.end {
        let p = ray.at(k);
        let (index, v) = frame.field.nearest(p);
        let (label, r) = ValueMap::parts(map.words[index]);
        stats.num_lookups += 1;
        if label == 0 {
            frame.add_sample::<false, true, HITS>(ray, k, p, &mut gathered);
            stats.num_samples += 1;
            stats.num_loads += 1;
            k += 1;
        } else {
            let n = pace
                .steps(p, v, f32::from(r) + value_margin(frame))
                .saturating_add(1)
                .min(ray.end - k)
                .min(MAX_SEGMENT_SAMPLES as u32);
            let n = add_segment::<HITS>(frame, map.segments, &mut gathered, label, k, n);
            if n > 1 {
                stats.num_leaps += 1;
                stats.num_skipped += u64::from(n);
            } else {
                stats.num_samples += 1;
            }
            k += n;
        }
        if gathered.transparency < frame.stop {
            break;
        }
    }
    gathered
}

/// Add the segment of at most `n` samples in a region of equal labels from sample `k` on, and return its number of
/// samples.
///
/// The segment ends at the sample where brute force stops.
#[inline(always)]
fn add_segment<const HITS: bool>(
    frame: &Frame<'_>,
    segments: &SegmentTable,
    gathered: &mut Gathered,
    label: u8,
    k: u32,
    n: u32,
) -> u32 {
    let n = segments.samples_until(label, n as usize, gathered.transparency, frame.stop);
    if HITS {
        cross_segment(gathered, segments, label, k, n);
    }
    gathered.add_segment(segments.segment(label, n));
    n as u32
}

/// Return the distance in voxels by which a leap over a class may exceed the stored radius of its region.
pub(crate) fn class_margin(frame: &Frame<'_>) -> f32 {
    -frame.guard_vox
}

/// Return the distance in voxels by which a leap over a value may exceed the stored radius of its region.
///
/// A nearest-voxel sample needs only its own voxel in the cube, not eight corners: half a voxel more on each side than
/// an interpolated sample.
pub(crate) fn value_margin(frame: &Frame<'_>) -> f32 {
    0.5 - frame.guard_vox
}

/// Store the first wall of a ray if the wall is within a skipped segment, by stepping through the segment's samples.
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
