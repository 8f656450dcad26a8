//! Where packets write what their rays have gathered.

use super::{
    lanes::{Lanes, MAX_LANES, each_lane},
    pool::Packet,
};
use crate::composite::Gathered;

/// The pixels of a band.
pub(super) trait Out {
    /// True if first walls are asked for.
    const HITS: bool;

    /// Writes the pixels of some lanes.
    fn write<L: Lanes>(&mut self, l: L, packet: &Packet<L>, lanes: u32);

    /// Notes where the rays of some lanes meet the first wall; once in a ray's life.
    fn note_hits<L: Lanes>(&mut self, l: L, packet: &Packet<L>, lanes: u32, hit: L::F);
}

/// 8-bit colours over a background.
pub(super) struct Rgb8<'a> {
    pub rgb: &'a mut [u8],
    pub background: [f32; 3],
}

impl Out for Rgb8<'_> {
    const HITS: bool = false;

    #[inline(always)]
    fn write<L: Lanes>(&mut self, l: L, packet: &Packet<L>, lanes: u32) {
        // As in `Gathered::to_rgb8`; its cast saturates.
        let mut rgb = [[0; MAX_LANES]; 3];
        for c in 0..3 {
            let v = l.fma(
                packet.transparency,
                l.splat(self.background[c]),
                packet.rgb[c],
            );
            let v = l.fma(v, l.splat(255.0), l.splat(0.5));
            rgb[c] = l.store_i(l.whole(l.min(l.max(v, l.splat(0.0)), l.splat(255.0))));
        }
        let pixel = l.store_i(packet.pixel);
        each_lane(lanes, |n| {
            let at = pixel[n] as usize * 3;
            self.rgb[at..at + 3].copy_from_slice(&[
                rgb[0][n] as u8,
                rgb[1][n] as u8,
                rgb[2][n] as u8,
            ]);
        });
    }

    #[inline(always)]
    fn note_hits<L: Lanes>(&mut self, _: L, _: &Packet<L>, _: u32, _: L::F) {}
}

/// All that is gathered, first walls included. The pixels start as [`Gathered::NOTHING`].
pub(super) struct Walls<'a>(pub &'a mut [Gathered]);

impl Out for Walls<'_> {
    const HITS: bool = true;

    #[inline(always)]
    fn write<L: Lanes>(&mut self, l: L, packet: &Packet<L>, lanes: u32) {
        let pixel = l.store_i(packet.pixel);
        let rgb = [0, 1, 2].map(|c| l.store(packet.rgb[c]));
        let transparency = l.store(packet.transparency);
        each_lane(lanes, |n| {
            let out = &mut self.0[pixel[n] as usize];
            out.rgb = [rgb[0][n], rgb[1][n], rgb[2][n]];
            out.transparency = transparency[n];
        });
    }

    #[inline(always)]
    fn note_hits<L: Lanes>(&mut self, l: L, packet: &Packet<L>, lanes: u32, hit: L::F) {
        let (pixel, hit) = (l.store_i(packet.pixel), l.store(hit));
        each_lane(lanes, |n| self.0[pixel[n] as usize].hit = hit[n]);
    }
}
