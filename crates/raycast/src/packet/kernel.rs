//! The packet caster, in two stages with rays handed from one to the other, so that the lanes of each do the same thing.
//!
//! *Search*: rays leap and take samples that are surely clear. *Shade*: rays take samples that may be visible, one after
//! the other, until one is clear or the ray ends. A lane whose ray has left takes another ray.

use super::{
    lanes::Lanes,
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
struct Band<'a, L: Lanes> {
    source: Source,
    searching: Pool,
    shading: Pool,
    search: Packet<L>,
    /// Of the rays that search: steps per voxel on each axis, with the sign of the direction, and without it.
    signed: [L::F; 3],
    plain: [L::F; 3],
    shade: Packet<L>,
    stats: CastStats,
    /// Sum of the last sample numbers of the rays that have ended.
    sum_of_end: u64,
    out: &'a mut [u8],
}

impl Scene<'_> {
    /// Casts all rays of a band of rows.
    #[inline(always)]
    pub(super) fn cast<L: Lanes, const SHADED: bool, const LEAP: bool>(
        &self,
        l: L,
        source: Source,
        out: &mut [u8],
    ) -> CastStats {
        let mut band = Band {
            source,
            searching: Pool::empty(),
            shading: Pool::empty(),
            search: Packet::empty(l),
            signed: [l.splat(0.0); 3],
            plain: [l.splat(0.0); 3],
            shade: Packet::empty(l),
            stats: CastStats::default(),
            sum_of_end: 0,
            out,
        };
        loop {
            self.search::<L, LEAP>(l, &mut band);
            if band.shading.is_empty() && band.shade.occupied == 0 {
                break;
            }
            self.shade::<L, SHADED>(l, &mut band);
        }
        let walked = band.sum_of_end - band.source.sum_of_first();
        band.stats.num_skipped = walked - band.stats.num_samples;
        band.stats.num_rays = band.source.num_rays() as u64;
        band.stats
    }

    /// Leaps and clear samples, until enough rays wait for shading or none is left to search.
    #[inline(always)]
    fn search<L: Lanes, const LEAP: bool>(&self, l: L, band: &mut Band<'_, L>) {
        let mut packet = band.search;
        while band.shading.len() < SHADE_FROM {
            if packet.num_free() >= L::N / 4 {
                if band.searching.is_empty() && !band.source.is_empty() {
                    band.source.set_up(self.frame, &mut band.searching);
                }
                if !band.searching.is_empty() {
                    band.searching.give_to(l, &mut packet);
                    if LEAP {
                        (band.signed, band.plain) = pace(l, &packet.delta);
                    }
                }
                let live = l.bits(l.less_i(packet.k, packet.end));
                let ended = packet.occupied & !live;
                if ended != 0 {
                    band.sum_of_end +=
                        packet.finish(l, ended, self.frame.options.background, band.out);
                }
                if packet.occupied == 0 {
                    if band.searching.is_empty() && band.source.is_empty() {
                        break;
                    }
                    continue;
                }
            }
            let p = packet.at(l, self.frame.origin3());
            let mut walk = packet.occupied;
            if LEAP {
                let ask = packet.occupied & l.bits(l.less_i(packet.wait, l.splat_i(1)));
                walk &= !ask;
                if ask.count_ones() >= walk.count_ones() {
                    let (leaps, n) = self.leap(l, &packet, p, (&band.signed, &band.plain));
                    let asked = l.mask(ask);
                    let leaps = l.and(asked, leaps);
                    band.stats.num_lookups += u64::from(ask.count_ones());
                    band.stats.num_leaps += u64::from(l.bits(leaps).count_ones());
                    packet.k = l.select_i(leaps, l.add_i(packet.k, n), packet.k);
                    let waits = l.without(asked, leaps);
                    packet.wait = l.select_i(waits, l.splat_i(WAIT_SAMPLES as i32), packet.wait);
                    walk = 0;
                }
            }
            if walk != 0 {
                let cells = self.voxels.cells(l, p);
                let n = self.entry_of(l, self.voxels.value(l, &cells));
                // All entries before the first visible one have no opacity.
                let clear = l.less_i(n, l.splat_i(self.frame.table.first_visible));
                let visible = walk & !l.bits(clear);
                let clear = l.and(clear, l.mask(walk));
                band.stats.num_samples += u64::from(l.bits(clear).count_ones());
                packet.k = l.select_i(clear, l.add_i(packet.k, l.splat_i(1)), packet.k);
                packet.wait = l.select_i(clear, l.sub_i(packet.wait, l.splat_i(1)), packet.wait);
                if visible != 0 {
                    band.shading.take_from(l, &mut packet, visible);
                }
            }
            let ended = packet.occupied & !l.bits(l.less_i(packet.k, packet.end));
            if ended != 0 {
                band.sum_of_end += packet.finish(l, ended, self.frame.options.background, band.out);
            }
        }
        band.search = packet;
    }

    /// Visible samples, until no ray waits for shading and few are left in the lanes.
    #[inline(always)]
    fn shade<L: Lanes, const SHADED: bool>(&self, l: L, band: &mut Band<'_, L>) {
        let mut packet = band.shade;
        loop {
            if packet.num_free() >= L::N / 8 && !band.shading.is_empty() {
                band.shading.give_to(l, &mut packet);
            }
            let more =
                !(band.searching.is_empty() && band.source.is_empty() && band.search.occupied == 0);
            let least = if more { L::N * 3 / 4 } else { 1 };
            if band.shading.is_empty() && L::N - packet.num_free() < least {
                break;
            }
            let take = l.mask(packet.occupied);
            let lit = self.add_samples::<L, SHADED>(l, &mut packet, take);
            band.stats.num_samples += u64::from(packet.occupied.count_ones());
            packet.k = l.add_i(packet.k, l.splat_i(1));
            packet.wait = l.select_i(lit, l.splat_i(1), l.sub_i(packet.wait, l.splat_i(1)));
            let opaque = l.and(lit, l.less(packet.transparency, l.splat(STOP_TRANSPARENCY)));
            let goes_on = l.bits(l.without(l.less_i(packet.k, packet.end), opaque));
            let ended = packet.occupied & !goes_on;
            if ended != 0 {
                band.sum_of_end += packet.finish(l, ended, self.frame.options.background, band.out);
            }
            let left = packet.occupied & !l.bits(lit);
            if left != 0 {
                band.searching.take_from(l, &mut packet, left);
            }
        }
        band.shade = packet;
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
    fn add_samples<L: Lanes, const SHADED: bool>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        take: L::M,
    ) -> L::M {
        let cells = self.voxels.cells(l, packet.at(l, self.frame.origin3()));
        let (value, gradient) = if SHADED {
            self.voxels.value_and_gradient(l, &cells, take)
        } else {
            (self.voxels.value(l, &cells), packet.delta)
        };
        let n = self.entry_of(l, value);
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

/// As in `leap::Pace::of`.
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
