//! Reads of the radius map by a packet and the leaps (skipped segments) that follow: the operations of [`crate::leap`],
//! lane by lane.

use carina_isoregion::MAX_SEGMENT_SAMPLES;

use super::{
    lanes::{Lanes, each_lane},
    out::Out,
    pool::Packet,
    scene::Scene,
};
use crate::{
    CastStats,
    leap::{FAR, MAX_PATIENCE, MAX_STEPS, MIN_PATIENCE, Price},
};

/// Ray steps per voxel on each axis, with and without the sign of the direction, for each lane; see `leap::Pace`.
#[derive(Clone, Copy)]
pub(super) struct Pace<L: Lanes> {
    signed: [L::F; 3],
    plain: [L::F; 3],
}

impl<L: Lanes> Pace<L> {
    #[inline(always)]
    pub(super) fn of(l: L, delta: &[L::F; 3]) -> Self {
        let (mut signed, mut plain) = (*delta, *delta);
        for a in 0..3 {
            // An axis along which a ray does not advance never ends a leap.
            let moves = l.less(l.splat(1e-12), l.abs(delta[a]));
            let inverse = l.div(l.splat(1.0), delta[a]);
            signed[a] = l.select(moves, inverse, l.splat(0.0));
            plain[a] = l.select(moves, l.abs(inverse), l.splat(FAR));
        }
        Self { signed, plain }
    }

    /// Return for each lane the number of steps until its ray leaves its cube of equal labels; the operations equal
    /// `leap::Pace::steps`.
    #[inline(always)]
    fn steps(&self, l: L, p: [L::F; 3], v: [L::F; 3], reach: L::F) -> L::I {
        let mut on = v;
        for a in 0..3 {
            let ahead = l.mul(l.sub(v[a], p[a]), self.signed[a]);
            on[a] = l.fma(reach, self.plain[a], ahead);
        }
        let steps = l.min(l.min(on[0], on[1]), l.min(on[2], l.splat(MAX_STEPS)));
        l.whole(l.max(steps, l.splat(0.0)))
    }
}

/// Position of the next sample in voxels, its nearest voxel, and the voxel's index in the map, for each lane.
#[derive(Clone, Copy)]
pub(super) struct NextWord<L: Lanes> {
    p: [L::F; 3],
    v: [L::F; 3],
    index: L::I,
}

/// Fetch the cache line of a word; no operation on processors for which Rust has no stable intrinsic.
#[inline(always)]
fn prefetch(word: *const u16) {
    #[cfg(target_arch = "x86_64")]
    // SAFETY: a prefetch does not access memory as a read does; an invalid address has no effect. Benchmark:
    // benchmarks/measurements/rendering.md.
    unsafe {
        core::arch::x86_64::_mm_prefetch::<{ core::arch::x86_64::_MM_HINT_T0 }>(word.cast());
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = word;
}

impl Scene<'_> {
    /// Read the radius map in the lanes `looked_up`; return the lanes whose rays skipped samples.
    ///
    /// Lanes with a radius above 0 leap; the patience of the other lanes of `looked_up` grows.
    #[inline(always)]
    pub(super) fn look_up<L: Lanes>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        pace: &Pace<L>,
        looked_up: L::M,
    ) -> L::M {
        let p = packet.at(l, packet.k, self.frame.origin3());
        let (index, v) = self.voxels.cell_of(l, p);
        // SAFETY: the map has as many voxels as the volume, and `cell_of` clamps the index to them in all lanes.
        // Benchmark: benchmarks/measurements/rendering.md.
        let r = unsafe { l.bytes(self.radius.as_ptr(), index) };
        let leaps = l.and(looked_up, l.less_i(l.splat_i(0), r));
        let n = pace.steps(l, p, v, l.add(l.to_f(r), l.splat(self.margin)));
        let left = l.sub_i(packet.end, packet.k);
        let n = l.min_i(l.add_i(n, l.splat_i(1)), left);
        self.settle(l, packet, looked_up, leaps, n);
        leaps
    }

    /// Advance lanes by `n` skipped samples and update the patience of the lanes `looked_up`; see
    /// `leap::LookupSchedule`.
    #[inline(always)]
    fn settle<L: Lanes>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        looked_up: L::M,
        leaps: L::M,
        n: L::I,
    ) {
        let Price { worth, pays } = self.price;
        let mut failed = l.without(looked_up, leaps);
        let mut paid = leaps;
        if worth > 1 {
            let short = l.and(leaps, l.less_i(n, l.splat_i(worth as i32)));
            failed = l.or(failed, short);
        }
        if pays > 1 {
            paid = l.without(leaps, l.less_i(n, l.splat_i(pays as i32)));
        }
        packet.lookup_at = l.select_i(failed, l.add_i(packet.k, packet.patience), packet.lookup_at);
        let twice = l.add_i(packet.patience, packet.patience);
        let more = l.min_i(twice, l.splat_i(MAX_PATIENCE as i32));
        let patience = l.select_i(failed, more, packet.patience);
        packet.patience = l.select_i(paid, l.splat_i(MIN_PATIENCE as i32), patience);
        packet.k = l.select_i(leaps, l.add_i(packet.k, n), packet.k);
    }

    /// Return the colour and transparency of segments of `n` samples, from the rows of the segment table that begin at
    /// `row`.
    ///
    /// The function contains no closure, because a closure would be compiled without the instruction set.
    #[inline(always)]
    fn segments_at<L: Lanes>(&self, l: L, row: L::I, n: L::I) -> [L::F; 4] {
        let segments = self.segments.entries();
        let last = l.splat_i(segments.len() as i32 - 1);
        let at = l.max_i(l.min_i(l.add_i(row, n), last), l.splat_i(0));
        // SAFETY: the index is clamped to the table, which is not empty, in all lanes. Benchmark:
        // benchmarks/measurements/rendering.md.
        unsafe { l.entries(segments.as_ptr(), at) }
    }

    /// Read the map of all classes in the lanes `looked_up`, and add a segment in lanes whose label is not 0; see
    /// `leap::cast_classes`.
    ///
    /// Return the lanes that have leaped and the lanes whose ray is now opaque.
    #[inline(always)]
    pub(super) fn look_up_classes<L: Lanes>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        pace: &Pace<L>,
        looked_up: L::M,
    ) -> (L::M, L::M) {
        let p = packet.at(l, packet.k, self.frame.origin3());
        let (index, v) = self.voxels.nearest(l, p);
        // SAFETY: both maps have as many voxels as the volume, and `nearest` clamps the index to them in all lanes.
        // Benchmark: benchmarks/measurements/rendering.md.
        let (r, label) = unsafe {
            (
                l.bytes(self.radius.as_ptr(), index),
                l.bytes(self.labels.as_ptr(), index),
            )
        };
        let zero = l.splat_i(0);
        let leaps = l.and(looked_up, l.and(l.less_i(zero, r), l.less_i(zero, label)));
        let n = pace.steps(l, p, v, l.add(l.to_f(r), l.splat(self.margin)));
        let left = l.sub_i(packet.end, packet.k);
        let n = l.min_i(l.add_i(n, l.splat_i(1)), left);
        let mut n = l.min_i(n, l.splat_i(MAX_SEGMENT_SAMPLES as i32));
        let row = l.mul_i(
            l.sub_i(label, l.splat_i(1)),
            l.splat_i(MAX_SEGMENT_SAMPLES as i32 + 1),
        );
        self.add_segments(l, packet, leaps, label, row, &mut n);
        self.settle(l, packet, looked_up, leaps, n);
        let limit = l.splat(self.frame.stop);
        (leaps, l.and(leaps, l.less(packet.transparency, limit)))
    }

    /// Add the segments of `n` samples of a label in the lanes `leaps`; `row` is the label's row in the segment table.
    ///
    /// `n` becomes smaller in the lanes whose ray ends within its segment.
    #[inline(always)]
    fn add_segments<L: Lanes>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        leaps: L::M,
        label: L::I,
        row: L::I,
        n: &mut L::I,
    ) {
        let limit = l.splat(self.frame.stop);
        let mut segment = self.segments_at(l, row, *n);
        let faint = l.less(l.mul(packet.transparency, segment[3]), limit);
        let crossing = l.bits(l.and(leaps, faint));
        if crossing != 0 {
            // The sample where brute force would stop is searched; this happens once per ray.
            let (labels, transparency) = (l.store_i(label), l.store(packet.transparency));
            let mut cut = l.store_i(*n);
            each_lane(crossing, |lane| {
                cut[lane] = self.segments.samples_until(
                    labels[lane] as u8,
                    cut[lane] as usize,
                    transparency[lane],
                    self.frame.stop,
                ) as i32;
            });
            *n = l.load_i(&cut);
            segment = self.segments_at(l, row, *n);
        }
        for c in 0..3 {
            let sum = l.fma(packet.transparency, segment[c], packet.rgb[c]);
            packet.rgb[c] = l.select(leaps, sum, packet.rgb[c]);
        }
        let through = l.mul(packet.transparency, segment[3]);
        packet.transparency = l.select(leaps, through, packet.transparency);
    }

    /// Add, in the lanes `walks`, the segment within the cube round the nearest voxel; see `leap::cast_values`. Return
    /// the lanes whose ray goes on.
    #[inline(always)]
    pub(super) fn step_over_values<L: Lanes, O: Out>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        pace: &Pace<L>,
        walks: u32,
        stats: &mut CastStats,
    ) -> u32 {
        let next = self.next_word(l, packet);
        self.step_from_word::<L, O>(l, packet, pace, walks, next, stats)
    }

    /// Return the memory index of the word (label and radius) that each lane reads next.
    #[inline(always)]
    pub(super) fn next_word<L: Lanes>(&self, l: L, packet: &Packet<L>) -> NextWord<L> {
        let p = packet.at(l, packet.k, self.frame.origin3());
        let (index, v) = self.voxels.nearest(l, p);
        NextWord { p, v, index }
    }

    /// Prefetch the words (label and radius) of all lanes into the cache.
    #[inline(always)]
    pub(super) fn prefetch_words<L: Lanes>(&self, l: L, next: &NextWord<L>) {
        let index = l.store_i(next.index);
        for &word in &index[..L::N] {
            prefetch(self.words.as_ptr().wrapping_add(word as usize));
        }
    }

    /// Advance the rays as `step_over_values` does, with words (label and radius) whose memory indices are known.
    #[inline(always)]
    pub(super) fn step_from_word<L: Lanes, O: Out>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        pace: &Pace<L>,
        walks: u32,
        next: NextWord<L>,
        stats: &mut CastStats,
    ) -> u32 {
        let NextWord { p, v, index } = next;
        // SAFETY: the map has as many words as the volume has voxels, and `nearest` clamps the index to them in all
        // lanes. Benchmark: benchmarks/measurements/rendering.md.
        let word = unsafe { l.voxels(self.words.as_ptr().cast(), index) };
        let (label, r) = (l.low_byte(word), l.second_byte(word));
        let n = pace.steps(l, p, v, l.add(l.to_f(r), l.splat(self.margin)));
        let left = l.sub_i(packet.end, packet.k);
        let n = l.min_i(l.add_i(n, l.splat_i(1)), left);
        let mut n = l.min_i(n, l.splat_i(MAX_SEGMENT_SAMPLES as i32));
        let one = l.splat_i(1);
        let unlabelled = l.and(l.mask(walks), l.less_i(label, one));
        let leaps = l.without(l.mask(walks), unlabelled);
        let first_visible = l.splat_i(i32::from(self.segments.first_visible()));
        let visible = l.without(leaps, l.less_i(label, first_visible));
        if l.bits(visible) != 0 {
            let row = l.mul_i(
                l.sub_i(label, one),
                l.splat_i(MAX_SEGMENT_SAMPLES as i32 + 1),
            );
            self.add_segments(l, packet, visible, label, row, &mut n);
        }
        packet.k = l.select_i(leaps, l.add_i(packet.k, n), packet.k);
        let long = l.bits(l.and(leaps, l.less_i(one, n)));
        stats.num_lookups += u64::from(walks.count_ones());
        stats.num_leaps += u64::from(long.count_ones());
        stats.num_samples += u64::from((walks & !long).count_ones());
        let rare = l.bits(unlabelled);
        if rare != 0 {
            stats.num_loads += u64::from(rare.count_ones());
            let at = packet.k;
            self.take_samples::<L, O, false, true>(l, packet, at, unlabelled);
        }
        let faint = l.less(packet.transparency, l.splat(self.frame.stop));
        l.bits(l.without(l.less_i(packet.k, packet.end), faint))
    }
}
