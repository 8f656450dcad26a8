//! The packet caster, in two stages with rays handed from one to the other, so that the lanes of each do the same thing.
//!
//! *Search*: rays leap and take samples that are surely clear. *Shade*: rays take samples that may be visible, one after
//! the other, until one is clear or the ray ends. A lane whose ray has left takes another ray.
//!
//! The stages may have different numbers of lanes. A search waits: each look-up and each sample begins where the last one
//! led to, so that more rays side by side cost little. Shading computes, and has no use for more than fit in registers.

use super::{
    ask::Pace,
    lanes::Lanes,
    out::Out,
    pool::{Packet, Pool},
    scene::{BRUTE, CLASSES, Scene, TRANSPARENT},
    source::Source,
};
use crate::CastStats;

/// Rays that wait for shading before it starts: a change of stage saves and loads all lanes.
const SHADE_FROM: usize = 96;

/// The state of a band, whose rays are searched with in `L` and shaded in `S`.
struct Band<L: Lanes, S: Lanes, O: Out> {
    source: Source,
    searching: Pool,
    shading: Pool,
    search: Packet<L>,
    shade: Packet<S>,
    stats: CastStats,
    /// Sum of the last sample numbers of the rays that have ended.
    sum_of_end: u64,
    out: O,
}

impl<L: Lanes, S: Lanes, O: Out> Band<L, S, O> {
    #[inline(always)]
    fn finish<P: Lanes>(&mut self, l: P, packet: &mut Packet<P>, lanes: u32) {
        self.out.write(l, packet, lanes);
        self.sum_of_end += packet.finish(l, lanes);
    }

    /// True if there are rays to search with.
    #[inline(always)]
    fn may_search(&self) -> bool {
        !(self.searching.is_empty() && self.source.is_empty() && self.search.occupied == 0)
    }
}

impl Scene<'_> {
    /// Casts all rays of a band of rows.
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
            self.search::<L, S, O, NEAREST, LEAP, STAGED>(l, &mut band);
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

    /// Leaps and clear samples, until enough rays wait for shading or none is left to search. Without shading a visible
    /// sample costs no more than a clear one and is taken here.
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
        // Lanes whose next sample may be visible.
        let mut visible = 0;
        loop {
            // Rays come and go many at a time: a change costs about as much as a look-up (docs/decisions/0103).
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
            let mut walk = active;
            if LEAP != BRUTE {
                walk &= l.bits(l.less_i(packet.k, packet.ask_at));
                let ask = active & !walk;
                if ask.count_ones() >= walk.count_ones() {
                    let asked = l.mask(ask);
                    let leaps = if LEAP == CLASSES {
                        let (leaps, opaque) = self.ask_classes(l, &mut packet, &pace, asked);
                        active &= !l.bits(opaque);
                        leaps
                    } else {
                        self.ask(l, &mut packet, &pace, asked)
                    };
                    band.stats.num_lookups += u64::from(ask.count_ones());
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
                    // Not directly after a sample that added something.
                    let next = l.add_i(packet.k, l.splat_i(1));
                    let later = l.max_i(packet.ask_at, next);
                    packet.ask_at = l.select_i(lit, later, packet.ask_at);
                }
                active &= !walk | l.bits(goes_on);
            }
        }
        band.search = packet;
    }

    /// Visible samples, until no ray waits for shading and few are left in the lanes. No ray asks the map here: a sample
    /// follows one that added something, or the map has been asked.
    #[inline(always)]
    fn shade<L: Lanes, S: Lanes, O: Out, const SHADED: bool>(
        &self,
        l: S,
        band: &mut Band<L, S, O>,
    ) {
        let mut packet = band.shade;
        let mut active = packet.occupied;
        // The next sample of the lanes at work. It goes on in the others, too.
        let mut k = packet.k;
        // Lanes whose last sample was clear.
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
