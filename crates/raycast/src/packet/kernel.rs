//! The packet caster, in two stages with rays handed from one to the other, so that the lanes of each do the same thing.
//!
//! *Search*: rays leap and take samples that are surely clear. *Shade*: rays take samples that may be visible, one after
//! the other, until one is clear or the ray ends. A lane whose ray has left takes another ray.

use super::{
    lanes::Lanes,
    out::Out,
    pool::{Packet, Pool, Source},
    voxels::Voxels,
};
use crate::{
    CastStats, Frame,
    frame::STOP_TRANSPARENCY,
    leap::{FAR, MAX_STEPS, WAIT_SAMPLES},
};

/// Rays that wait for shading before it starts: a change of stage saves and loads all lanes.
const SHADE_FROM: usize = 48;

/// What all packets of a picture share.
#[derive(Clone, Copy)]
pub(super) struct Scene<'a> {
    pub frame: &'a Frame<'a>,
    pub voxels: Voxels<'a>,
    /// Empty for brute force.
    pub radius: &'a [u8],
}

/// The state of a band.
struct Band<L: Lanes, O: Out> {
    source: Source,
    searching: Pool,
    shading: Pool,
    search: Packet<L>,
    shade: Packet<L>,
    stats: CastStats,
    /// Sum of the last sample numbers of the rays that have ended.
    sum_of_end: u64,
    out: O,
}

impl<L: Lanes, O: Out> Band<L, O> {
    #[inline(always)]
    fn finish(&mut self, l: L, packet: &mut Packet<L>, lanes: u32) {
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
    pub(super) fn cast<L: Lanes, O: Out, const SHADED: bool, const LEAP: bool>(
        &self,
        l: L,
        source: Source,
        out: O,
    ) -> CastStats {
        let mut band = Band {
            source,
            searching: Pool::empty(),
            shading: Pool::empty(),
            search: Packet::empty(l),
            shade: Packet::empty(l),
            stats: CastStats::default(),
            sum_of_end: 0,
            out,
        };
        loop {
            self.search::<L, O, SHADED, LEAP>(l, &mut band);
            if band.shading.is_empty() && band.shade.occupied == 0 {
                break;
            }
            self.shade(l, &mut band);
        }
        let walked = band.sum_of_end - band.source.sum_of_first();
        band.stats.num_skipped = walked - band.stats.num_samples;
        band.stats.num_rays = band.source.num_rays() as u64;
        band.stats
    }

    /// Leaps and clear samples, until enough rays wait for shading or none is left to search. Without shading a visible
    /// sample costs no more than a clear one and is taken here.
    #[inline(always)]
    fn search<L: Lanes, O: Out, const SHADED: bool, const LEAP: bool>(
        &self,
        l: L,
        band: &mut Band<L, O>,
    ) {
        let mut packet = band.search;
        let (mut signed, mut plain) = pace(l, &packet.delta);
        let mut active = packet.occupied;
        // Lanes whose next sample may be visible.
        let mut visible = 0;
        loop {
            // Rays come and go several at a time: a change costs about as much as a look-up.
            if L::N - active.count_ones() as usize >= L::N / 4 {
                if visible != 0 {
                    band.shading.take_from(l, &mut packet, visible);
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
                    band.source.set_up(self.frame, &mut band.searching);
                }
                if !band.searching.is_empty() {
                    band.searching.give_to(l, &mut packet);
                    if LEAP {
                        (signed, plain) = pace(l, &packet.delta);
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
            if LEAP {
                let ask = active & l.bits(l.less_i(packet.wait, l.splat_i(1)));
                walk &= !ask;
                if ask.count_ones() >= walk.count_ones() {
                    let p = packet.at(l, self.frame.origin3());
                    let (leaps, n) = self.leap(l, &packet, p, (&signed, &plain));
                    let asked = l.mask(ask);
                    let leaps = l.and(asked, leaps);
                    band.stats.num_lookups += u64::from(ask.count_ones());
                    band.stats.num_leaps += u64::from(l.bits(leaps).count_ones());
                    packet.k = l.select_i(leaps, l.add_i(packet.k, n), packet.k);
                    let waits = l.without(asked, leaps);
                    packet.wait = l.select_i(waits, l.splat_i(WAIT_SAMPLES as i32), packet.wait);
                    active &= l.bits(l.less_i(packet.k, packet.end));
                    continue;
                }
            }
            let walks = l.mask(walk);
            if SHADED {
                let cells = self.voxels.cells(l, packet.at(l, self.frame.origin3()));
                let n = self.entry_of(l, self.voxels.value(l, &cells));
                // All entries before the first visible one have no opacity.
                let clear = l.less_i(n, l.splat_i(self.frame.table.first_visible));
                let clear = l.and(clear, walks);
                let clear_bits = l.bits(clear);
                band.stats.num_samples += u64::from(clear_bits.count_ones());
                packet.k = l.select_i(clear, l.add_i(packet.k, l.splat_i(1)), packet.k);
                packet.wait = l.select_i(clear, l.sub_i(packet.wait, l.splat_i(1)), packet.wait);
                visible |= walk & !clear_bits;
                active &= l.bits(l.less_i(packet.k, packet.end)) & !visible;
            } else {
                band.stats.num_samples += u64::from(walk.count_ones());
                let goes_on = self
                    .take_samples::<L, O, false>(l, &mut packet, walks, &mut band.out)
                    .1;
                active &= goes_on;
            }
        }
        band.search = packet;
    }

    /// Visible samples, until no ray waits for shading and few are left in the lanes.
    #[inline(always)]
    fn shade<L: Lanes, O: Out>(&self, l: L, band: &mut Band<L, O>) {
        let mut packet = band.shade;
        let mut active = packet.occupied;
        // Lanes whose last sample was clear.
        let mut clear = 0;
        loop {
            if L::N - active.count_ones() as usize >= L::N / 8 {
                if clear != 0 {
                    band.searching.take_from(l, &mut packet, clear);
                    clear = 0;
                }
                let ended = packet.occupied & !active;
                if ended != 0 {
                    band.finish(l, &mut packet, ended);
                }
                band.shading.give_to(l, &mut packet);
                active = packet.occupied;
                let least = if band.may_search() { L::N * 3 / 4 } else { 1 };
                if (active.count_ones() as usize) < least {
                    break;
                }
            }
            band.stats.num_samples += u64::from(active.count_ones());
            let take = l.mask(active);
            let (lit, goes_on) =
                self.take_samples::<L, O, true>(l, &mut packet, take, &mut band.out);
            clear |= active & goes_on & !lit;
            active &= goes_on & lit;
        }
        band.shade = packet;
    }

    /// Takes samples and goes on to the next ones. Gives the lanes where a sample added something and those whose ray has
    /// not ended.
    #[inline(always)]
    fn take_samples<L: Lanes, O: Out, const SHADED: bool>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        take: L::M,
        out: &mut O,
    ) -> (u32, u32) {
        let lit = self.add_samples::<L, O, SHADED>(l, packet, take, out);
        packet.k = l.select_i(take, l.add_i(packet.k, l.splat_i(1)), packet.k);
        let wait = l.select_i(lit, l.splat_i(1), l.sub_i(packet.wait, l.splat_i(1)));
        packet.wait = l.select_i(take, wait, packet.wait);
        let faint = l.less(packet.transparency, l.splat(STOP_TRANSPARENCY));
        let opaque = l.and(lit, faint);
        let goes_on = l.without(l.less_i(packet.k, packet.end), opaque);
        (l.bits(lit), l.bits(goes_on))
    }

    /// Asks the map at positions: the lanes that leap, and how far.
    #[inline(always)]
    fn leap<L: Lanes>(
        &self,
        l: L,
        packet: &Packet<L>,
        p: [L::F; 3],
        (signed, plain): (&[L::F; 3], &[L::F; 3]),
    ) -> (L::M, L::I) {
        let (index, v) = self.voxels.nearest(l, p);
        // SAFETY: the map has the volume's voxels, of which there are 4 or more, and `nearest` clamps to them in all
        // lanes. Benchmark: docs/decisions/0003-packets.md.
        let r = unsafe { l.bytes(self.radius.as_ptr(), self.radius.len() as i32 - 4, index) };
        // As in `leap::Pace::steps`.
        let reach = l.sub(l.to_f(r), l.splat(self.frame.guard_vox));
        let mut on = v;
        for a in 0..3 {
            let ahead = l.mul(l.sub(v[a], p[a]), signed[a]);
            on[a] = l.fma(reach, plain[a], ahead);
        }
        let steps = l.min(l.min(on[0], on[1]), l.min(on[2], l.splat(MAX_STEPS)));
        let steps = l.whole(l.max(steps, l.splat(0.0)));
        let left = l.sub_i(packet.end, packet.k);
        (
            l.less_i(l.splat_i(0), r),
            l.min_i(l.add_i(steps, l.splat_i(1)), left),
        )
    }

    /// Entries of the transfer table for sampled values; as in `TransferTable::at`.
    #[inline(always)]
    fn entry_of<L: Lanes>(&self, l: L, value: L::F) -> L::I {
        let table = self.frame.table;
        let hu = l.whole(l.floor(l.add(value, l.splat(0.5))));
        let n = l.sub_i(hu, l.splat_i(table.lo_hu));
        l.max_i(l.min_i(n, l.splat_i(table.last)), l.splat_i(0))
    }

    /// Reads the samples `k` and adds them in the lanes `take`. Gives the lanes where a sample added something.
    #[inline(always)]
    fn add_samples<L: Lanes, O: Out, const SHADED: bool>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        take: L::M,
        out: &mut O,
    ) -> L::M {
        let cells = self.voxels.cells(l, packet.at(l, self.frame.origin3()));
        let (value, gradient) = if SHADED {
            self.voxels.value_and_gradient(l, &cells, take)
        } else {
            (self.voxels.value(l, &cells), packet.delta)
        };
        let n = self.entry_of(l, value);
        // All entries before the first visible one have no opacity. In shading hardly ever all lanes are clear.
        let visible = l.without(take, l.less_i(n, l.splat_i(self.frame.table.first_visible)));
        if !SHADED && l.bits(visible) == 0 {
            return visible;
        }
        // SAFETY: 0 ..= `last` in all lanes; `last` is the last entry. Benchmark: docs/decisions/0003-packets.md.
        let [r, g, b, alpha] = unsafe { l.entries(self.frame.table.entries.as_ptr(), n) };
        let lit = l.and(take, l.less(l.splat(0.0), alpha));
        let mut rgb = [r, g, b];
        if let (true, Some(light)) = (SHADED, &self.frame.options.light) {
            let facing = self.facing(l, &packet.delta, gradient);
            // As in `Light::shares`.
            let mut highlight = facing;
            for _ in 0..light.shininess_log2 {
                highlight = l.mul(highlight, highlight);
            }
            let t = l.add(l.to_f(packet.k), l.splat(0.5));
            let distance = l.mul(t, l.splat(self.frame.step_mm));
            let part = l.div(distance, l.splat(light.reach_mm));
            let left = l.div(l.splat(1.0), l.fma(part, part, l.splat(1.0)));
            let own = l.fma(facing, l.splat(light.diffuse), l.splat(light.ambient));
            let own = l.mul(own, left);
            let white = l.mul(l.mul(l.splat(light.specular), highlight), left);
            let white = l.mul(white, alpha);
            for c in 0..3 {
                rgb[c] = l.fma(own, rgb[c], white);
            }
        }
        for c in 0..3 {
            let sum = l.fma(packet.transparency, rgb[c], packet.rgb[c]);
            packet.rgb[c] = l.select(lit, sum, packet.rgb[c]);
        }
        let through = l.mul(packet.transparency, l.sub(l.splat(1.0), alpha));
        if O::HITS {
            // As in `Gathered::cross`.
            let (half, before) = (l.splat(0.5), packet.transparency);
            let crossed = l.without(l.and(lit, l.less(through, half)), l.less(before, half));
            if l.bits(crossed) != 0 {
                let part = l.div(l.sub(before, half), l.sub(before, through));
                let hit = l.add(l.to_f(packet.k), part);
                out.note_hits(l, packet, l.bits(crossed), hit);
            }
        }
        packet.transparency = l.select(lit, through, packet.transparency);
        lit
    }

    /// Cosines between surface normals and rays, without sign; as in `Frame::facing`.
    #[inline(always)]
    fn facing<L: Lanes>(&self, l: L, delta: &[L::F; 3], g: [L::F; 3]) -> L::F {
        let along = l.fma(g[2], delta[2], l.fma(g[1], delta[1], l.mul(g[0], delta[0])));
        let [xx, yy, zz, xy, xz, yz] = self.frame.metric;
        let s = |v: f32| l.splat(v);
        let x = l.mul(
            l.fma(g[0], s(xx), l.fma(g[1], s(xy), l.mul(g[2], s(xz)))),
            g[0],
        );
        let y = l.mul(l.fma(g[1], s(yy), l.mul(g[2], s(yz))), g[1]);
        let square = l.add(l.add(x, y), l.mul(l.mul(s(zz), g[2]), g[2]));
        let length = l.mul(l.sqrt(l.max(square, s(0.0))), s(self.frame.step_mm));
        l.min(l.div(l.abs(along), l.add(length, s(1e-6))), s(1.0))
    }
}

/// Steps per voxel on each axis, with the sign of the direction and without it; as in `leap::Pace::of`.
#[inline(always)]
fn pace<L: Lanes>(l: L, delta: &[L::F; 3]) -> ([L::F; 3], [L::F; 3]) {
    let (mut signed, mut plain) = (*delta, *delta);
    for a in 0..3 {
        // An axis along which a ray stands still never ends a leap.
        let moves = l.less(l.splat(1e-12), l.abs(delta[a]));
        let inverse = l.div(l.splat(1.0), delta[a]);
        signed[a] = l.select(moves, inverse, l.splat(0.0));
        plain[a] = l.select(moves, l.abs(inverse), l.splat(FAR));
    }
    (signed, plain)
}
