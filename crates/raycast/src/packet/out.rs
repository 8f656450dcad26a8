//! Outputs to which packets write the rays that have ended.

use std::ops::Range;

use super::{
    lanes::{Lanes, MAX_LANES, each_lane},
    pool::Packet,
};
use crate::composite::Gathered;

/// Buffer to which a packet writes the pixels of a band of rows.
pub(super) trait Out {
    /// Whether the output needs the distance of each ray's first wall.
    const HITS: bool;

    /// Write the colours of the rays in the lanes of the bit mask `lanes` to the pixels of these rays.
    fn write<L: Lanes>(&mut self, l: L, packet: &Packet<L>, lanes: u32);

    /// Write a range of pixels that have no ray.
    fn write_nothing(&mut self, pixels: Range<usize>);
}

/// Output of 8-bit colours over a background colour.
pub(super) struct Rgb8<'a> {
    pub rgb: &'a mut [u8],
    pub background: [f32; 3],
}

impl Out for Rgb8<'_> {
    const HITS: bool = false;

    #[inline(always)]
    fn write<L: Lanes>(&mut self, l: L, packet: &Packet<L>, lanes: u32) {
        // The conversion equals that of `Gathered::to_rgb8`, whose cast saturates.
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
    fn write_nothing(&mut self, pixels: Range<usize>) {
        let (rgb, _) = self.rgb.as_chunks_mut::<3>();
        rgb[pixels].fill(Gathered::NOTHING.to_rgb8(self.background));
    }
}

/// Buffer of the complete result of each ray: colour, transparency and first wall.
pub(super) struct Walls<'a>(pub &'a mut [Gathered]);

impl Out for Walls<'_> {
    const HITS: bool = true;

    #[inline(always)]
    fn write<L: Lanes>(&mut self, l: L, packet: &Packet<L>, lanes: u32) {
        let pixel = l.store_i(packet.pixel);
        // The stores are not in a closure, because a closure would be compiled without the instruction set, with a call
        // for each store.
        let mut rgb = [[0.0; MAX_LANES]; 3];
        for c in 0..3 {
            rgb[c] = l.store(packet.rgb[c]);
        }
        let (transparency, hit) = (l.store(packet.transparency), l.store(packet.hit));
        each_lane(lanes, |n| {
            self.0[pixel[n] as usize] = Gathered {
                rgb: [rgb[0][n], rgb[1][n], rgb[2][n]],
                transparency: transparency[n],
                hit: hit[n],
            };
        });
    }

    #[inline(always)]
    fn write_nothing(&mut self, pixels: Range<usize>) {
        self.0[pixels].fill(Gathered::NOTHING);
    }
}

#[cfg(test)]
mod tests {
    use super::{Gathered, Out, Rgb8, Walls};

    #[test]
    fn pixels_without_a_ray_are_overwritten_by_the_background() {
        let mut rgb = [7; 12];
        let background = [0.0, 0.5, 1.0];
        Rgb8 {
            rgb: &mut rgb,
            background,
        }
        .write_nothing(1..3);
        assert_eq!(rgb, [7, 7, 7, 0, 128, 255, 0, 128, 255, 7, 7, 7]);

        let wall = Gathered {
            hit: 3.0,
            ..Gathered::NOTHING
        };
        let mut walls = [wall; 4];
        Walls(&mut walls).write_nothing(1..3);
        let expected = [wall, Gathered::NOTHING, Gathered::NOTHING, wall];
        assert!(walls == expected);
    }
}
