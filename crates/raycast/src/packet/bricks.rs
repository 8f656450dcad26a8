//! Reads of cached bricks (cubes of voxels) by packets, lane by lane.

use super::lanes::{Array, Lanes, each_lane};
use crate::{
    Field,
    bricks::{CELLS, Fill, PER_BRICK, STRIDE},
};

const _: () = assert!(CELLS == 4, "`quarters` and `modulo_4` are made for it");

/// Memory offsets in a brick from a cell's lower corner to its four rows along x, in int16 numbers.
const ROWS: [i32; 4] = [
    0,
    STRIDE[1] as i32,
    STRIDE[2] as i32,
    (STRIDE[1] + STRIDE[2]) as i32,
];

/// Reader of the bricks of a volume, which fills bricks that are needed and not yet stored.
pub(super) struct Reader<'a, B> {
    bricks: &'a B,
    field: &'a Field<'a>,
    num_bricks: [i32; 2],
}

impl<B> Clone for Reader<'_, B> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<B> Copy for Reader<'_, B> {}

#[inline(always)]
fn lerp<L: Lanes>(l: L, t: L::F, a: L::F, b: L::F) -> L::F {
    l.fma(t, l.sub(b, a), a)
}

/// Return the linear interpolation between the two int16 of each lane's pair.
#[inline(always)]
fn lerp_pair<L: Lanes>(l: L, t: L::F, pair: L::I) -> L::F {
    l.fma(t, l.to_f(l.rise(pair)), l.to_f(l.first(pair)))
}

impl<'a, B: Fill> Reader<'a, B> {
    #[inline(always)]
    pub(super) fn of(field: &'a Field<'a>, bricks: &'a B) -> Self {
        let [ni, nj, _] = bricks.store().num_bricks();
        Self {
            bricks,
            field,
            num_bricks: [ni as i32, nj as i32],
        }
    }

    /// Return, for each lane, one more than the index of its cell's brick; `None` if a wanted lane has no brick.
    ///
    /// Other lanes without a brick get the first brick, whose memory always exists, because a volume has at least one
    /// brick. The cell of every lane must be in the volume, also in lanes that are not wanted.
    #[inline(always)]
    fn find<L: Lanes>(&self, l: L, ijk: &[L::I; 3], wanted: L::M) -> Option<L::I> {
        let [ni, nj] = [l.splat_i(self.num_bricks[0]), l.splat_i(self.num_bricks[1])];
        let number = l.add_i(l.mul_i(l.quarters(ijk[2]), nj), l.quarters(ijk[1]));
        let number = l.add_i(l.mul_i(number, ni), l.quarters(ijk[0]));
        let table = self.bricks.store().table().as_ptr();
        // SAFETY: cells are in the volume, so the numbers of their bricks are in the table. Benchmark:
        // benchmarks/measurements/rendering.md.
        let mut entry = unsafe { l.links(table, number) };
        let absent = l.bits(l.without(wanted, l.less_i(l.splat_i(0), entry)));
        if absent != 0 {
            if !self.fill(&l.store_i(number), absent) {
                return None;
            }
            // SAFETY: cells are in the volume, so the numbers of their bricks are in the table.
            entry = unsafe { l.links(table, number) };
        }
        Some(l.max_i(entry, l.splat_i(1)))
    }

    /// Fill the bricks of some lanes; return false if one of these bricks cannot be stored.
    #[cold]
    #[inline(never)]
    fn fill(&self, numbers: &Array<i32>, lanes: u32) -> bool {
        let mut all = true;
        each_lane(lanes, |n| {
            all &= self.bricks.fill(self.field, numbers[n] as usize);
        });
        all
    }

    /// Interpolate the four numbers per voxel at position `t` in each lane's cell `ijk`.
    ///
    /// Return `None` if a wanted lane has no brick. The cell of every lane must be in the volume, also in lanes that
    /// are not wanted.
    #[inline(always)]
    pub(super) fn between_voxels<L: Lanes>(
        &self,
        l: L,
        ijk: &[L::I; 3],
        t: &[L::F; 3],
        wanted: L::M,
    ) -> Option<[L::F; 4]> {
        let entry = self.find(l, ijk, wanted)?;
        let mut at = l.mul_i(l.sub_i(entry, l.splat_i(1)), l.splat_i(PER_BRICK as i32));
        for a in 0..3 {
            let steps = l.mul_i(l.modulo_4(ijk[a]), l.splat_i(STRIDE[a] as i32));
            at = l.add_i(at, steps);
        }
        // SAFETY: `at` is the lower corner of a cell in a stored brick, and the brick contains all eight corners of its
        // cells. Benchmark: benchmarks/measurements/rendering.md.
        let rows = unsafe { l.quadruples(self.bricks.store().numbers(), at, ROWS) };
        let mut out = [t[0]; 4];
        for c in 0..4 {
            let low = lerp(
                l,
                t[1],
                lerp_pair(l, t[0], rows[0][c]),
                lerp_pair(l, t[0], rows[1][c]),
            );
            let high = lerp(
                l,
                t[1],
                lerp_pair(l, t[0], rows[2][c]),
                lerp_pair(l, t[0], rows[3][c]),
            );
            out[c] = lerp(l, t[2], low, high);
        }
        Some(out)
    }
}
