//! Slopes (differences of voxel values across walls) read from bricks, lane by lane.

use super::{
    bricks::Reader,
    lanes::{Array, Lanes, MAX_LANES},
};
use crate::{
    Field,
    bricks::{NormalBricks, STRIDE},
};

/// Return the slopes of a volume round positions in voxels, interpolated from the slopes at voxels in the bricks.
///
/// The slopes are per voxel axis, in HU over the reach.
#[inline(always)]
pub(crate) fn rise<L: Lanes>(
    l: L,
    bricks: &NormalBricks,
    field: &Field<'_>,
    p: [L::F; 3],
) -> [L::F; 3] {
    let (mut t, mut ijk) = (p, [l.splat_i(0); 3]);
    for a in 0..3 {
        let held = l.min(l.max(p[a], l.splat(0.0)), l.splat(field.last[a]));
        ijk[a] = l.min_i(l.whole(held), l.splat_i(field.last_cell[a]));
        t[a] = l.sub(held, l.to_f(ijk[a]));
    }
    let all = ((1u64 << L::N) - 1) as u32;
    let unit = l.splat(bricks.unit());
    let mut slope = t;
    if let Some([x, y, z, _]) = Reader::of(field, bricks).between_voxels(l, &ijk, &t, l.mask(all)) {
        for (slope, along) in slope.iter_mut().zip([x, y, z]) {
            *slope = l.mul(along, unit);
        }
        return slope;
    }
    let (mut cells, mut at) = ([[0; MAX_LANES]; 3], [[0.0; MAX_LANES]; 3]);
    for a in 0..3 {
        cells[a] = l.store_i(ijk[a]);
        at[a] = l.store(t[a]);
    }
    let along = one_by_one(bricks, field, &cells, &at);
    for a in 0..3 {
        slope[a] = l.mul(l.fill(unit, all, &along[a]), unit);
    }
    slope
}

/// Return the slopes in the lanes, computed one lane after another, for cells whose bricks cannot all be stored.
///
/// A brick that is not stored is computed again for each lane that needs it.
#[cold]
#[inline(never)]
fn one_by_one(
    bricks: &NormalBricks,
    field: &Field<'_>,
    cells: &[Array<i32>; 3],
    t: &[Array<f32>; 3],
) -> [Array<f32>; 3] {
    let mut along = [[0.0; MAX_LANES]; 3];
    for n in 0..MAX_LANES {
        let (numbers, within) = bricks.brick_of(field, cells.map(|cell| cell[n] as usize));
        let lerp = |a: usize, low: f32, high: f32| t[a][n].mul_add(high - low, low);
        for a in 0..3 {
            let number = |step: usize| f32::from(numbers[within + step + a]);
            let row = |step: usize| lerp(0, number(step), number(step + STRIDE[0]));
            let low = lerp(1, row(0), row(STRIDE[1]));
            let high = lerp(1, row(STRIDE[2]), row(STRIDE[1] + STRIDE[2]));
            along[a][n] = lerp(2, low, high);
        }
    }
    along
}
