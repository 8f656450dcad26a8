//! Storage of rays that are in no lane of a register: rays to be searched, and rays that wait for shading.

use super::{
    lanes::{Array, Lanes, MAX_LANES, each_lane},
    setup::Rays,
};
use crate::{composite::NO_HIT, leap::Start};

/// Number of rays in a pool from which no further patch of rays is added; the last patch may add up to 31 more.
pub(super) const BATCH: usize = 64;
/// Capacity of a pool in rays.
///
/// Rays are set up in a batch only if no ray waits to be searched; then fewer than 96 + 32 rays wait for shading and 64
/// are in lanes, so there are never more than 288. A margin of 32 rays allows stores of whole registers.
const CAPACITY: usize = 384;

/// State of rays, one in each lane of an instruction set.
#[derive(Clone, Copy)]
pub(super) struct Packet<L: Lanes> {
    pub delta: [L::F; 3],
    pub rgb: [L::F; 3],
    pub transparency: L::F,
    /// Distance to the first wall, as in [`Gathered`](crate::composite::Gathered); used only if the output needs first
    /// walls.
    pub hit: L::F,
    /// Index of each ray's next sample.
    pub k: L::I,
    pub end: L::I,
    /// Index of the ray's pixel in the band.
    pub pixel: L::I,
    /// Index of the sample at which each ray next reads the radius map of uniform regions.
    pub lookup_at: L::I,
    /// Number of samples between a read of the radius map that does not lead to a leap and the next read (see
    /// [`crate::leap`]).
    pub patience: L::I,
    /// Bit mask of the lanes that hold a ray.
    pub occupied: u32,
}

impl<L: Lanes> Packet<L> {
    #[inline(always)]
    pub(super) fn empty(l: L) -> Self {
        let (zero, none) = (l.splat(0.0), l.splat_i(0));
        Self {
            delta: [zero; 3],
            rgb: [zero; 3],
            transparency: zero,
            hit: zero,
            k: none,
            end: none,
            pixel: none,
            lookup_at: none,
            patience: none,
            occupied: 0,
        }
    }

    #[inline(always)]
    pub(super) fn free(&self) -> u32 {
        !self.occupied & (u32::MAX >> (32 - L::N))
    }

    /// Return the positions of the samples `k` in voxels.
    #[inline(always)]
    pub(super) fn at(&self, l: L, k: L::I, origin: [f32; 3]) -> [L::F; 3] {
        let t = l.add(l.to_f(k), l.splat(0.5));
        let mut p = self.delta;
        for a in 0..3 {
            p[a] = l.fma(t, self.delta[a], l.splat(origin[a]));
        }
        p
    }

    /// Mark lanes whose pixels were written as free; return the sum of the indices of the last samples of their rays.
    #[inline(always)]
    pub(super) fn finish(&mut self, l: L, lanes: u32) -> u64 {
        let k = l.store_i(self.k);
        let mut sum = 0;
        each_lane(lanes, |n| sum += k[n] as u64);
        self.occupied &= !lanes;
        sum
    }
}

/// Stack of rays in memory, with one array for each number of a ray.
pub(super) struct Pool {
    len: usize,
    delta: [[f32; CAPACITY]; 3],
    rgb: [[f32; CAPACITY]; 3],
    transparency: [f32; CAPACITY],
    hit: [f32; CAPACITY],
    k: [i32; CAPACITY],
    end: [i32; CAPACITY],
    pixel: [i32; CAPACITY],
    lookup_at: [i32; CAPACITY],
    patience: [i32; CAPACITY],
}

#[inline(always)]
fn write<T: Copy>(values: &mut [T; CAPACITY], at: usize, lanes: Array<T>) {
    values[at..at + MAX_LANES].copy_from_slice(&lanes);
}

impl Pool {
    pub(super) fn empty() -> Self {
        Self {
            len: 0,
            delta: [[0.0; CAPACITY]; 3],
            rgb: [[0.0; CAPACITY]; 3],
            transparency: [0.0; CAPACITY],
            hit: [0.0; CAPACITY],
            k: [0; CAPACITY],
            end: [0; CAPACITY],
            pixel: [0; CAPACITY],
            lookup_at: [0; CAPACITY],
            patience: [0; CAPACITY],
        }
    }

    #[inline(always)]
    pub(super) fn len(&self) -> usize {
        self.len
    }

    #[inline(always)]
    pub(super) fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Add the first `count` of `rays`, at their first samples, to the pool.
    #[inline(always)]
    pub(super) fn add(&mut self, rays: &Rays, pixel: &Array<i32>, count: usize, start: Start) {
        let at = self.len;
        for a in 0..3 {
            write(&mut self.delta[a], at, rays.delta[a]);
            write(&mut self.rgb[a], at, [0.0; MAX_LANES]);
        }
        write(&mut self.transparency, at, [1.0; MAX_LANES]);
        write(&mut self.hit, at, [NO_HIT; MAX_LANES]);
        write(&mut self.k, at, rays.first);
        write(&mut self.end, at, rays.end);
        write(&mut self.pixel, at, *pixel);
        write(
            &mut self.lookup_at,
            at,
            rays.first.map(|first| first + start.wait as i32),
        );
        write(&mut self.patience, at, [start.patience as i32; MAX_LANES]);
        self.len += count;
    }

    /// Move rays from some lanes to the pool and mark these lanes as free; `hits` selects whether first walls are
    /// moved, too.
    #[inline(always)]
    pub(super) fn take_from<L: Lanes>(
        &mut self,
        l: L,
        packet: &mut Packet<L>,
        lanes: u32,
        hits: bool,
    ) {
        let at = self.len;
        for a in 0..3 {
            l.put(packet.delta[a], lanes, &mut self.delta[a][at..]);
            l.put(packet.rgb[a], lanes, &mut self.rgb[a][at..]);
        }
        l.put(packet.transparency, lanes, &mut self.transparency[at..]);
        if hits {
            l.put(packet.hit, lanes, &mut self.hit[at..]);
        }
        l.put_i(packet.k, lanes, &mut self.k[at..]);
        l.put_i(packet.end, lanes, &mut self.end[at..]);
        l.put_i(packet.pixel, lanes, &mut self.pixel[at..]);
        l.put_i(packet.lookup_at, lanes, &mut self.lookup_at[at..]);
        l.put_i(packet.patience, lanes, &mut self.patience[at..]);
        self.len += lanes.count_ones() as usize;
        packet.occupied &= !lanes;
    }

    /// Move rays from the pool to the free lanes of a packet, until the pool is empty or all lanes are occupied.
    #[inline(always)]
    pub(super) fn give_to<L: Lanes>(&mut self, l: L, packet: &mut Packet<L>, hits: bool) {
        let mut lanes = packet.free();
        // If fewer rays than free lanes are left, the lowest free lanes take them.
        while lanes.count_ones() as usize > self.len {
            lanes &= !(1 << lanes.ilog2());
        }
        self.len -= lanes.count_ones() as usize;
        let at = self.len;
        for a in 0..3 {
            packet.delta[a] = l.fill(packet.delta[a], lanes, &self.delta[a][at..]);
            packet.rgb[a] = l.fill(packet.rgb[a], lanes, &self.rgb[a][at..]);
        }
        packet.transparency = l.fill(packet.transparency, lanes, &self.transparency[at..]);
        if hits {
            packet.hit = l.fill(packet.hit, lanes, &self.hit[at..]);
        }
        packet.k = l.fill_i(packet.k, lanes, &self.k[at..]);
        packet.end = l.fill_i(packet.end, lanes, &self.end[at..]);
        packet.pixel = l.fill_i(packet.pixel, lanes, &self.pixel[at..]);
        packet.lookup_at = l.fill_i(packet.lookup_at, lanes, &self.lookup_at[at..]);
        packet.patience = l.fill_i(packet.patience, lanes, &self.patience[at..]);
        packet.occupied |= lanes;
    }
}
