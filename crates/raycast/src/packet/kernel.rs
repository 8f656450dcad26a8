//! Packet caster in two stages, the search for visible samples and their shading; rays move between them, so that lanes
//! are rarely empty.
//!
//! In the *search* stage, rays leap (skip uniform regions) and take samples that are certainly transparent. In the
//! *shade* stage, rays take samples that may be visible, one after the other, until a sample is transparent or the ray
//! ends. A lane whose ray has left the stage takes another ray.
//!
//! The stages may have different numbers of lanes. A search waits for memory: each look-up and each sample starts where
//! the previous one ended, so additional parallel rays cost little. Shading is limited by computation, and more lanes
//! than fit in registers do not help.

use super::{
    lanes::Lanes,
    map_lookup::Pace,
    out::Out,
    pool::{Packet, Pool},
    scene::{BRUTE, CLASSES, Scene, TRANSPARENT, VALUES, VALUES_PREFETCHED},
    source::Source,
};
use crate::CastStats;

/// Number of rays that wait for shading at which the shade stage starts.
///
/// A change of stage is expensive, because it saves and loads all lanes.
const SHADE_FROM: usize = 96;

/// State of a band of rows whose rays are searched in the lanes of `L` and shaded in the lanes of `S`, for the output
/// `O`.
struct Band<L: Lanes, S: Lanes, O: Out> {
    source: Source,
    searching: Pool,
    shading: Pool,
    search: Packet<L>,
    shade: Packet<S>,
    stats: CastStats,
    /// Sum of the indices of the last samples of all rays that have ended.
    sum_of_end: u64,
    out: O,
}

impl<L: Lanes, S: Lanes, O: Out> Band<L, S, O> {
    #[inline(always)]
    fn finish<P: Lanes>(&mut self, l: P, packet: &mut Packet<P>, lanes: u32) {
        self.out.write(l, packet, lanes);
        self.sum_of_end += packet.finish(l, lanes);
    }

    /// Return true if rays remain that the search stage has not finished.
    #[inline(always)]
    fn may_search(&self) -> bool {
        !(self.searching.is_empty() && self.source.is_empty() && self.search.occupied == 0)
    }
}

impl Scene<'_> {
    /// Cast all rays of a band of rows.
    #[inline(always)]
    pub(super) fn cast<
        L: Lanes,
        S: Lanes,
        O: Out,
        const SHADED: bool,
        const NEAREST: bool,
        const LEAP: u8,
        const STAGED: bool,
    >(
        &self,
        (l, s): (L, S),
        source: Source,
        out: O,
    ) -> CastStats {
        let mut band = Band {
            source,
            searching: Pool::empty(),
            shading: Pool::empty(),
            search: Packet::empty(l),
            shade: Packet::empty(s),
            stats: CastStats::default(),
            sum_of_end: 0,
            out,
        };
        loop {
            if LEAP == VALUES_PREFETCHED {
                self.search_alternately(l, &mut band);
            } else {
                self.search::<L, S, O, NEAREST, LEAP, STAGED>(l, &mut band);
            }
            if band.shading.is_empty() && band.shade.occupied == 0 {
                break;
            }
            self.shade::<L, S, O, SHADED>(s, &mut band);
        }
        let walked = band.sum_of_end - band.source.sum_of_first();
        band.stats.num_skipped = walked - band.stats.num_samples;
        band.stats.num_rays = band.source.num_rays() as u64;
        band.stats
    }

    /// Move the rays forward over transparent samples, by leaps and single ray steps, to their next visible sample.
    ///
    /// The search stage ends when enough rays wait for the shading of a visible sample, or when no ray is left to
    /// move. In pictures without shading the search stage also composites the visible samples, which takes no longer
    /// than the samples of transparent voxels.
    #[inline(always)]
    fn search<
        L: Lanes,
        S: Lanes,
        O: Out,
        const NEAREST: bool,
        const LEAP: u8,
        const STAGED: bool,
    >(
        &self,
        l: L,
        band: &mut Band<L, S, O>,
    ) {
        let mut packet = band.search;
        let mut pace = Pace::of(l, &packet.delta);
        let mut active = packet.occupied;
        // Mask of the lanes whose next sample may have opacity.
        let mut visible = 0;
        loop {
            // Rays are exchanged many at a time, because an exchange costs about as much as a look-up
            // (docs/decisions/0103).
            if L::N - active.count_ones() as usize >= L::N / 2 {
                if visible != 0 {
                    band.shading.take_from(l, &mut packet, visible, O::HITS);
                    visible = 0;
                }
                let ended = packet.occupied & !active;
                if ended != 0 {
                    band.finish(l, &mut packet, ended);
                }
                if band.shading.len() >= SHADE_FROM {
                    break;
                }
                if band.searching.is_empty() && !band.source.is_empty() {
                    let Band {
                        source,
                        searching,
                        out,
                        ..
                    } = band;
                    source.set_up(self.frame, self.start, searching, out);
                }
                if !band.searching.is_empty() {
                    band.searching.give_to(l, &mut packet, O::HITS);
                    if LEAP != BRUTE {
                        pace = Pace::of(l, &packet.delta);
                    }
                }
                active = packet.occupied & l.bits(l.less_i(packet.k, packet.end));
                if active == 0 {
                    if packet.occupied == 0 {
                        break;
                    }
                    continue;
                }
            }
            if LEAP == VALUES {
                active &=
                    self.step_over_values::<L, O>(l, &mut packet, &pace, active, &mut band.stats);
                continue;
            }
            let mut walk = active;
            if LEAP != BRUTE {
                walk &= l.bits(l.less_i(packet.k, packet.lookup_at));
                let due = active & !walk;
                if due.count_ones() >= walk.count_ones() {
                    let looked_up = l.mask(due);
                    let leaps = if LEAP == CLASSES {
                        let (leaps, opaque) =
                            self.look_up_classes(l, &mut packet, &pace, looked_up);
                        active &= !l.bits(opaque);
                        leaps
                    } else {
                        self.look_up(l, &mut packet, &pace, looked_up)
                    };
                    band.stats.num_lookups += u64::from(due.count_ones());
                    band.stats.num_leaps += u64::from(l.bits(leaps).count_ones());
                    active &= l.bits(l.less_i(packet.k, packet.end));
                    continue;
                }
            }
            let walks = l.mask(walk);
            if STAGED {
                let clear = l.and(walks, self.clear_samples(l, &packet));
                let clear_bits = l.bits(clear);
                band.stats.num_samples += u64::from(clear_bits.count_ones());
                packet.k = l.select_i(clear, l.add_i(packet.k, l.splat_i(1)), packet.k);
                visible |= walk & !clear_bits;
                active &= l.bits(l.less_i(packet.k, packet.end)) & !visible;
            } else {
                band.stats.num_samples += u64::from(walk.count_ones());
                let at = packet.k;
                let (lit, goes_on) =
                    self.take_samples::<L, O, false, NEAREST>(l, &mut packet, at, walks);
                if LEAP == TRANSPARENT {
                    // The neighbours of a visible sample are seldom transparent, so the next sample is taken without
                    // reading the radius map.
                    let next = l.add_i(packet.k, l.splat_i(1));
                    let later = l.max_i(packet.lookup_at, next);
                    packet.lookup_at = l.select_i(lit, later, packet.lookup_at);
                }
                active &= !walk | l.bits(goes_on);
            }
        }
        band.search = packet;
    }

    /// Cast all rays that skip regions of equal values, in two packets that alternate.
    ///
    /// The address of a ray's next word depends on its last word, so the reads of one packet cannot overlap. Each packet
    /// therefore prefetches its next words and takes its step after the other packet.
    #[inline(always)]
    fn search_alternately<L: Lanes, S: Lanes, O: Out>(&self, l: L, band: &mut Band<L, S, O>) {
        let mut packets = [band.search, Packet::empty(l)];
        // Closures would be compiled without the instruction set.
        let mut pace = [Pace::of(l, &packets[0].delta); 2];
        let mut next = [self.next_word(l, &packets[0]); 2];
        let mut active = [packets[0].occupied, 0];
        let mut ended = [false; 2];
        while !(ended[0] && ended[1]) {
            for n in 0..2 {
                if ended[n] {
                    continue;
                }
                let packet = &mut packets[n];
                if L::N - active[n].count_ones() as usize >= L::N / 2 {
                    let finished = packet.occupied & !active[n];
                    if finished != 0 {
                        band.finish(l, packet, finished);
                    }
                    if band.searching.is_empty() && !band.source.is_empty() {
                        let Band {
                            source,
                            searching,
                            out,
                            ..
                        } = band;
                        source.set_up(self.frame, self.start, searching, out);
                    }
                    if !band.searching.is_empty() {
                        band.searching.give_to(l, packet, O::HITS);
                        pace[n] = Pace::of(l, &packet.delta);
                    }
                    active[n] = packet.occupied & l.bits(l.less_i(packet.k, packet.end));
                    if active[n] == 0 {
                        ended[n] = packet.occupied == 0;
                        continue;
                    }
                    next[n] = self.next_word(l, packet);
                }
                active[n] &= self.step_from_word::<L, O>(
                    l,
                    packet,
                    &pace[n],
                    active[n],
                    next[n],
                    &mut band.stats,
                );
                next[n] = self.next_word(l, packet);
                self.prefetch_words(l, &next[n]);
            }
        }
        band.search = packets[0];
    }

    /// Run the shade stage: shade visible samples until no ray waits for shading and few rays are left in the lanes.
    ///
    /// No ray needs a look-up in this stage: its previous sample had opacity, or the search stage has already looked up
    /// the map.
    #[inline(always)]
    fn shade<L: Lanes, S: Lanes, O: Out, const SHADED: bool>(
        &self,
        l: S,
        band: &mut Band<L, S, O>,
    ) {
        let mut packet = band.shade;
        let mut active = packet.occupied;
        // Number of the next sample in the active lanes; the counter advances in the other lanes, too.
        let mut k = packet.k;
        // Mask of the lanes whose last sample was transparent.
        let mut clear = 0;
        loop {
            if S::N - active.count_ones() as usize >= S::N / 4 {
                if clear != 0 {
                    band.searching.take_from(l, &mut packet, clear, O::HITS);
                    clear = 0;
                }
                let ended = packet.occupied & !active;
                if ended != 0 {
                    band.finish(l, &mut packet, ended);
                }
                band.shading.give_to(l, &mut packet, O::HITS);
                k = packet.k;
                active = packet.occupied;
                let least = if band.may_search() { S::N * 3 / 4 } else { 1 };
                if (active.count_ones() as usize) < least {
                    break;
                }
            }
            band.stats.num_samples += u64::from(active.count_ones());
            let take = l.mask(active);
            let (lit, goes_on) = self.take_samples::<S, O, SHADED, false>(l, &mut packet, k, take);
            k = l.add_i(k, l.splat_i(1));
            let (lit, goes_on) = (l.bits(lit), l.bits(goes_on));
            if SHADED {
                band.stats.num_shaded += u64::from(lit.count_ones());
            }
            clear |= active & goes_on & !lit;
            active &= goes_on & lit;
        }
        band.shade = packet;
    }
}
