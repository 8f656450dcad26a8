//! Samples of a packet: read, classified by the transfer function, shaded and composited as in `Frame::add_sample`,
//! lane by lane.

use super::{lanes::Lanes, out::Out, pool::Packet, scene::Scene};

impl Scene<'_> {
    /// Add the samples `k` of the rays in the lanes `take`, and advance these rays to their next samples.
    ///
    /// Return the lanes whose sample had opacity and the lanes whose ray has not ended.
    ///
    /// In the lanes `take`, `k` must be the packet's next sample. In the other lanes it may be any number; if it does
    /// not depend on the result of the previous samples, the processor can read the next samples while the previous
    /// ones are still being shaded.
    #[inline(always)]
    pub(super) fn take_samples<L: Lanes, O: Out, const SHADED: bool, const NEAREST: bool>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        k: L::I,
        take: L::M,
    ) -> (L::M, L::M) {
        let lit = self.add_samples::<L, O, SHADED, NEAREST>(l, packet, k, take);
        packet.k = l.select_i(take, l.add_i(k, l.splat_i(1)), packet.k);
        let faint = l.less(packet.transparency, l.splat(self.frame.stop));
        let opaque = l.and(lit, faint);
        (lit, l.without(l.less_i(packet.k, packet.end), opaque))
    }

    /// Read the next sample in each lane; return the lanes whose sample certainly has no opacity.
    #[inline(always)]
    pub(super) fn clear_samples<L: Lanes>(&self, l: L, packet: &Packet<L>) -> L::M {
        let cells = self
            .voxels
            .cells(l, packet.at(l, packet.k, self.frame.origin3()));
        let n = self.entry_of(l, self.voxels.value(l, &cells));
        // Entries before the first visible one have no opacity.
        l.less_i(n, l.splat_i(self.frame.table.first_visible))
    }

    /// Return the indices in the transfer table of interpolated values; the operations equal `TransferTable::at`.
    #[inline(always)]
    fn entry_of<L: Lanes>(&self, l: L, value: L::F) -> L::I {
        self.entry_of_hu(l, l.whole(l.floor(l.add(value, l.splat(0.5)))))
    }

    /// Return the indices in the transfer table of integer values; the operations equal `TransferTable::at_hu`.
    #[inline(always)]
    fn entry_of_hu<L: Lanes>(&self, l: L, hu: L::I) -> L::I {
        let table = self.frame.table;
        let n = l.sub_i(hu, l.splat_i(table.lo_hu));
        l.max_i(l.min_i(n, l.splat_i(table.last)), l.splat_i(0))
    }

    /// Read the samples `k` and add them in the lanes `take`; return the lanes whose sample had opacity.
    #[inline(always)]
    fn add_samples<L: Lanes, O: Out, const SHADED: bool, const NEAREST: bool>(
        &self,
        l: L,
        packet: &mut Packet<L>,
        k: L::I,
        take: L::M,
    ) -> L::M {
        let p = packet.at(l, k, self.frame.origin3());
        let mut gradient = packet.delta;
        let n = if NEAREST {
            let voxel = self.voxels.nearest(l, p).0;
            self.entry_of_hu(l, self.voxels.at(l, voxel))
        } else {
            let cells = self.voxels.cells(l, p);
            let value = if SHADED {
                let (value, rise) = self.voxels.value_and_gradient(l, &cells, take);
                gradient = rise;
                value
            } else {
                self.voxels.value(l, &cells)
            };
            self.entry_of(l, value)
        };
        // Entries before the first visible one have no opacity. During shading, the case that all lanes are clear is
        // rare.
        let visible = l.without(take, l.less_i(n, l.splat_i(self.frame.table.first_visible)));
        if !SHADED && l.bits(visible) == 0 {
            return visible;
        }
        // SAFETY: the index is in 0 ..= `last` in all lanes, and `last` is the index of the last entry. Benchmark:
        // benchmarks/measurements/rendering.md.
        let [r, g, b, alpha] = unsafe { l.entries(self.frame.table.entries.as_ptr(), n) };
        let lit = l.and(take, l.less(l.splat(0.0), alpha));
        let mut rgb = [r, g, b];
        if let (true, Some(light)) = (SHADED, &self.frame.options.light) {
            let facing = self.facing(l, &packet.delta, gradient);
            // The computation equals that of `Light::factors`.
            let mut highlight = facing;
            for _ in 0..light.shininess_log2 {
                highlight = l.mul(highlight, highlight);
            }
            let t = l.add(l.to_f(k), l.splat(0.5));
            let distance = l.mul(t, l.splat(self.frame.step_mm));
            let part = l.div(distance, l.splat(light.reach_mm));
            let left = l.div(l.splat(1.0), l.fma(part, part, l.splat(1.0)));
            let diffuse = l.fma(facing, l.splat(light.diffuse), l.splat(light.ambient));
            let diffuse = l.mul(diffuse, left);
            let white = l.mul(l.mul(l.splat(light.specular), highlight), left);
            let white = l.mul(white, alpha);
            for c in 0..3 {
                rgb[c] = l.fma(diffuse, rgb[c], white);
            }
        }
        for c in 0..3 {
            let sum = l.fma(packet.transparency, rgb[c], packet.rgb[c]);
            packet.rgb[c] = l.select(lit, sum, packet.rgb[c]);
        }
        let through = l.mul(packet.transparency, l.sub(l.splat(1.0), alpha));
        if O::HITS {
            // The computation equals that of `Gathered::cross`.
            let (half, before) = (l.splat(0.5), packet.transparency);
            let crossed = l.without(l.and(lit, l.less(through, half)), l.less(before, half));
            // A crossing happens once per ray.
            if l.bits(crossed) != 0 {
                let part = l.div(l.sub(before, half), l.sub(before, through));
                packet.hit = l.select(crossed, l.add(l.to_f(k), part), packet.hit);
            }
        }
        packet.transparency = l.select(lit, through, packet.transparency);
        lit
    }

    /// Return the absolute cosines between surface normals and rays; the operations equal `Frame::facing`.
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
