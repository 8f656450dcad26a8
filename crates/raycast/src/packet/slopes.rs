//! Slopes of walls read from bricks, lane by lane.

use super::lanes::{Array, Lanes, MAX_LANES};
use crate::{
    Field,
    bricks::{NormalBricks, PER_BRICK, Place, STRIDE},
};

/// Memory steps from a cell's lower corner to its eight, along i first.
const CORNERS: [i32; 8] = {
    let mut corners = [0; 8];
    let mut n = 0;
    while n < 8 {
        corners[n] = ((n & 1) * STRIDE[0] + (n >> 1 & 1) * STRIDE[1] + (n >> 2) * STRIDE[2]) as i32;
        n += 1;
    }
    corners
};

/// Slopes of a volume round positions in voxels, interpolated from those at voxels: per voxel axis, in HU over the reach.
#[inline(always)]
pub(crate) fn rise<L: Lanes>(
    l: L,
    bricks: &NormalBricks,
    field: &Field<'_>,
    p: [L::F; 3],
) -> [L::F; 3] {
    let mut t = p;
    let mut cell = [[0; MAX_LANES]; 3];
    for a in 0..3 {
        let held = l.min(l.max(p[a], l.splat(0.0)), l.splat(field.last[a]));
        let ijk = l.min_i(l.whole(held), l.splat_i(field.last_cell[a]));
        t[a] = l.sub(held, l.to_f(ijk));
        cell[a] = l.store_i(ijk);
    }
    let mut base = [0; MAX_LANES];
    let mut lent: Vec<(usize, Box<[i16; PER_BRICK]>, usize)> = vec![];
    for n in 0..L::N {
        let (place, within) = bricks.place(
            field,
            [cell[0][n], cell[1][n], cell[2][n]].map(|c| c as usize),
        );
        match place {
            Place::Kept(at) => base[n] = (at + within) as i32,
            Place::Lent(numbers) => lent.push((n, numbers, within)),
        }
    }
    // SAFETY: a place kept is that of a cell's lower corner in a brick, whose eight corners lie in the brick; lanes without
    // one read the first brick, for which there is memory: a volume has at least one. Benchmark: docs/decisions/0080.
    let corners = unsafe { l.quads(bricks.numbers(), l.load_i(&base), CORNERS) };
    let mut slope = t;
    for a in 0..3 {
        let mut v = [t[0]; 8];
        for n in 0..8 {
            let pair = corners[n][a / 2];
            v[n] = l.to_f(if a == 1 {
                l.second(pair)
            } else {
                l.first(pair)
            });
        }
        slope[a] = l.mul(between(l, &t, v), l.splat(bricks.unit()));
    }
    if lent.is_empty() {
        return slope;
    }
    one_by_one(l, bricks, &t, slope, &lent)
}

/// Between the corners of a cell.
#[inline(always)]
fn between<L: Lanes>(l: L, t: &[L::F; 3], v: [L::F; 8]) -> L::F {
    let lerp = |t, a, b| l.fma(t, l.sub(b, a), a);
    let along_i = |n: usize| lerp(t[0], v[n], v[n + 1]);
    let low = lerp(t[1], along_i(0), along_i(2));
    let high = lerp(t[1], along_i(4), along_i(6));
    lerp(t[2], low, high)
}

/// The same in the lanes whose bricks could not be kept.
#[cold]
fn one_by_one<L: Lanes>(
    l: L,
    bricks: &NormalBricks,
    t: &[L::F; 3],
    slope: [L::F; 3],
    lent: &[(usize, Box<[i16; PER_BRICK]>, usize)],
) -> [L::F; 3] {
    let t = t.map(|t| l.store(t));
    let mut slope: [Array<f32>; 3] = slope.map(|slope| l.store(slope));
    for (n, numbers, within) in lent {
        let portable = super::portable::Portable;
        for a in 0..3 {
            let v = CORNERS.map(|c| portable.splat(f32::from(numbers[within + c as usize + a])));
            let at = [0, 1, 2].map(|a| portable.splat(t[a][*n]));
            let v = portable.mul(between(portable, &at, v), portable.splat(bricks.unit()));
            slope[a][*n] = portable.store(v)[0];
        }
    }
    slope.map(|slope| l.fill(l.splat(0.0), ((1u64 << L::N) - 1) as u32, &slope))
}
