//! Reading a volume for a packet of rays: the operations of [`crate::sampling`], lane by lane.

use super::lanes::Lanes;
use crate::Field;

/// The longest axis for which positions and the guard of a leap are what the kernel relies on.
const LONGEST_AXIS: f32 = 65_535.0;

/// A volume whose voxels 32-bit indices reach.
#[derive(Clone, Copy)]
pub(super) struct Voxels<'a> {
    data: &'a [i16],
    last: [f32; 3],
    last_cell: [i32; 3],
    stride: [i32; 3],
}

/// A cell of eight voxels and the place in it, for each lane. Every lane's cell lies in the volume, also that of a lane
/// that is at rest.
#[derive(Clone, Copy)]
pub(super) struct Cells<L: Lanes> {
    ijk: [L::I; 3],
    base: L::I,
    t: [L::F; 3],
}

#[inline(always)]
fn lerp<L: Lanes>(l: L, t: L::F, a: L::F, b: L::F) -> L::F {
    l.fma(t, l.sub(b, a), a)
}

/// Between the two voxels of a pair.
#[inline(always)]
fn lerp_pair<L: Lanes>(l: L, t: L::F, pair: L::I) -> L::F {
    l.fma(t, l.to_f(l.rise(pair)), l.to_f(l.first(pair)))
}

/// Between integers.
#[inline(always)]
fn lerp_ints<L: Lanes>(l: L, t: L::F, a: L::I, b: L::I) -> L::F {
    l.fma(t, l.to_f(l.sub_i(b, a)), l.to_f(a))
}

impl<'a> Voxels<'a> {
    /// `None` for a volume too large for 32-bit indices, or one with a single voxel along x, which has no pairs.
    pub(super) fn of(field: &Field<'a>) -> Option<Self> {
        let [x, y, z, _] = field.last;
        let fits = field.data.len() >= 4
            && field.data.len() < i32::MAX as usize
            && x >= 1.0
            && x.max(y).max(z) <= LONGEST_AXIS;
        fits.then(|| Self {
            data: field.data,
            last: [x, y, z],
            last_cell: [0, 1, 2].map(|a| field.last_cell[a]),
            stride: field.stride.map(|s| s as i32),
        })
    }

    pub(super) fn num_voxels(&self) -> usize {
        self.data.len()
    }

    /// Coordinates held in `0 ..= last`; NaN becomes 0.
    #[inline(always)]
    fn clamp<L: Lanes>(&self, l: L, p: [L::F; 3]) -> [L::F; 3] {
        let mut x = p;
        for a in 0..3 {
            x[a] = l.min(l.max(p[a], l.splat(0.0)), l.splat(self.last[a]));
        }
        x
    }

    #[inline(always)]
    fn index<L: Lanes>(&self, l: L, [i, j, k]: [L::I; 3]) -> L::I {
        let row = l.mul_i(j, l.splat_i(self.stride[1]));
        let slice = l.mul_i(k, l.splat_i(self.stride[2]));
        l.add_i(i, l.add_i(row, slice))
    }

    /// The cells that hold points, clamped to the volume.
    #[inline(always)]
    pub(super) fn cells<L: Lanes>(&self, l: L, p: [L::F; 3]) -> Cells<L> {
        let mut t = self.clamp(l, p);
        let mut ijk = [l.splat_i(0); 3];
        for a in 0..3 {
            ijk[a] = l.min_i(l.whole(t[a]), l.splat_i(self.last_cell[a]));
            t[a] = l.sub(t[a], l.to_f(ijk[a]));
        }
        Cells {
            ijk,
            base: self.index(l, ijk),
            t,
        }
    }

    /// The voxels nearest to points, clamped to the volume: their places in memory and their coordinates.
    #[inline(always)]
    pub(super) fn nearest<L: Lanes>(&self, l: L, p: [L::F; 3]) -> (L::I, [L::F; 3]) {
        let mut v = self.clamp(l, p);
        let mut ijk = [l.splat_i(0); 3];
        for a in 0..3 {
            ijk[a] = l.whole(l.add(v[a], l.splat(0.5)));
            v[a] = l.to_f(ijk[a]);
        }
        (self.index(l, ijk), v)
    }

    /// The four rows of a cell, along x, from its lower corner.
    #[inline(always)]
    fn corners<L: Lanes>(&self, l: L, base: L::I) -> [L::I; 4] {
        let (sy, sz) = (l.splat_i(self.stride[1]), l.splat_i(self.stride[2]));
        let up = l.add_i(base, sz);
        [base, l.add_i(base, sy), up, l.add_i(up, sy)]
    }

    /// A voxel and the next one along x.
    #[inline(always)]
    fn pair<L: Lanes>(&self, l: L, index: L::I) -> L::I {
        // SAFETY: every index is a sum over the axes of (0 ..= n - 1) * stride with at most n - 2 along x: `cells` clamps
        // the lower corner to last_cell, and `value_and_gradient` steps further only where the neighbour exists. That
        // holds in lanes at rest as well. Benchmark: docs/decisions/0003-packets.md.
        unsafe { l.pairs(self.data.as_ptr(), index) }
    }

    /// Interpolated values.
    #[inline(always)]
    pub(super) fn value<L: Lanes>(&self, l: L, cells: &Cells<L>) -> L::F {
        let [tx, ty, tz] = cells.t;
        let mut r = [tx; 4];
        let corners = self.corners(l, cells.base);
        for n in 0..4 {
            r[n] = lerp_pair(l, tx, self.pair(l, corners[n]));
        }
        lerp(l, tz, lerp(l, ty, r[0], r[1]), lerp(l, ty, r[2], r[3]))
    }

    /// Interpolated values and interpolated central differences per voxel. The four rows of the cell are read once, with
    /// a voxel more on each side.
    #[inline(always)]
    pub(super) fn value_and_gradient<L: Lanes>(
        &self,
        l: L,
        cells: &Cells<L>,
        wanted: L::M,
    ) -> (L::F, [L::F; 3]) {
        let [tx, ty, tz] = cells.t;
        // Lanes with a voxel before the cell and one after it, and memory steps from the lower corner to these, held at
        // the edge.
        let zero = l.splat_i(0);
        let (mut has_before, mut has_after) = ([wanted; 3], [wanted; 3]);
        let (mut before, mut after) = ([zero; 3], [zero; 3]);
        for a in 0..3 {
            let s = self.stride[a];
            has_before[a] = l.less_i(zero, cells.ijk[a]);
            has_after[a] = l.less_i(cells.ijk[a], l.splat_i(self.last_cell[a]));
            before[a] = l.select_i(has_before[a], l.splat_i(s), zero);
            after[a] = l.select_i(has_after[a], l.splat_i(2 * s), l.splat_i(s));
        }
        let corners = self.corners(l, cells.base);
        let (mut r, mut dx) = ([tx; 4], [tx; 4]);
        let at_edge = l.bits(l.without(wanted, l.and(has_before[0], has_after[0]))) != 0;
        for n in 0..4 {
            // Four voxels along x.
            let [v0, v1, v2, v3] = if at_edge {
                let first = self.pair(l, l.sub_i(corners[n], before[0]));
                let second = self.pair(l, l.add_i(corners[n], l.sub_i(after[0], l.splat_i(1))));
                [
                    l.first(first),
                    l.select_i(has_before[0], l.second(first), l.first(first)),
                    l.select_i(has_after[0], l.first(second), l.second(second)),
                    l.second(second),
                ]
            } else {
                let last = l.splat_i(self.data.len() as i32 - 4);
                let start = l.sub_i(corners[n], l.splat_i(1));
                let start = l.max_i(l.min_i(start, last), zero);
                // SAFETY: 0 ..= number of voxels less 4; a wanted lane has all four in its row. Benchmark: as in `pair`.
                let [first, second] = unsafe { l.quads(self.data.as_ptr(), start) };
                [
                    l.first(first),
                    l.second(first),
                    l.first(second),
                    l.second(second),
                ]
            };
            r[n] = lerp_ints(l, tx, v1, v2);
            dx[n] = lerp_ints(l, tx, l.sub_i(v2, v0), l.sub_i(v3, v1));
        }
        let row = |index: L::I| lerp_pair(l, tx, self.pair(l, index));
        let [b00, b10, b01, _] = corners;
        let y00 = row(l.sub_i(b00, before[1]));
        let y10 = row(l.add_i(b00, after[1]));
        let y01 = row(l.sub_i(b01, before[1]));
        let y11 = row(l.add_i(b01, after[1]));
        let z00 = row(l.sub_i(b00, before[2]));
        let z01 = row(l.add_i(b00, after[2]));
        let z10 = row(l.sub_i(b10, before[2]));
        let z11 = row(l.add_i(b10, after[2]));
        let [r00, r10, r01, r11] = r;
        let dx = lerp(l, tz, lerp(l, ty, dx[0], dx[1]), lerp(l, ty, dx[2], dx[3]));
        let dy = lerp(
            l,
            tz,
            lerp(l, ty, l.sub(r10, y00), l.sub(y10, r00)),
            lerp(l, ty, l.sub(r11, y01), l.sub(y11, r01)),
        );
        let dz = lerp(
            l,
            ty,
            lerp(l, tz, l.sub(r01, z00), l.sub(z01, r00)),
            lerp(l, tz, l.sub(r11, z10), l.sub(z11, r10)),
        );
        let value = lerp(l, tz, lerp(l, ty, r00, r10), lerp(l, ty, r01, r11));
        let half = l.splat(0.5);
        (value, [l.mul(dx, half), l.mul(dy, half), l.mul(dz, half)])
    }
}
