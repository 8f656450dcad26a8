//! Sweep of one tile ([`crate::field_sweep`]): copy it with the voxels round it, relax its rows, write it back.
#![allow(
    clippy::inline_always,
    reason = "small functions of the inner loop, compiled once for each instruction set"
)]

use std::marker::PhantomData;

use carina_grid::InstructionSet;

use crate::field::{HERE, StepCost, VoxelField};
#[cfg(target_arch = "x86_64")]
use crate::field_lanes::Avx512;
use crate::field_lanes::{
    FIRST_VOXEL, LANES, Lanes, Portable, ROW, UNREACHED, open_weight, quanta,
};
use crate::field_layout::prefetch;

/// Number of voxels of a tile along i, j, k.
pub(crate) const TILE: [usize; 3] = [LANES, 8, 8];
/// Number of rows of a tile's buffer along j and along k: the 8 rows of the tile and one row on each side.
pub(crate) const ACROSS: usize = 10;

/// Copy of a tile and of the voxels round it.
#[repr(align(64))]
pub(crate) struct Buffer {
    pub(crate) weights: [[f32; ROW]; ACROSS * ACROSS],
    pub(crate) costs: [[u32; ROW]; ACROSS * ACROSS],
    /// For each row, bits of the voxels whose cost is lower than the stored one: bit 0 is the left neighbour of the
    /// tile, bit 17 the right one.
    pub(crate) decreased: [u32; ACROSS * ACROSS],
}

/// Return the index in the buffer of row `j`, `k` of the tile, each from 0 to 7. The buffer also has the rows around the tile.
const fn row_of(j: usize, k: usize) -> usize {
    (k + 1) * ACROSS + j + 1
}

/// Return a bit set of rows extended by the neighbouring rows.
const fn dilated(rows: u64) -> u64 {
    /// Bits of the rows with j = 0.
    const FIRST: u64 = 0x0101_0101_0101_0101;
    let along_j = rows | (rows & !(FIRST << 7)) << 1 | (rows & !FIRST) >> 1;
    along_j | along_j << 8 | along_j >> 8
}

/// Buffer in which the tiles of a sweep are computed, one after another.
pub(crate) struct SweepBuffer(pub(crate) Box<Buffer>);

impl SweepBuffer {
    pub(crate) fn new() -> Self {
        Self(Box::new(Buffer {
            weights: [[f32::INFINITY; ROW]; ACROSS * ACROSS],
            costs: [[UNREACHED; ROW]; ACROSS * ACROSS],
            decreased: [0; ACROSS * ACROSS],
        }))
    }
}

/// Copy a tile and the voxels round it to the buffer; voxels outside the search box become walls.
#[inline(always)]
fn load<L: Lanes>(
    l: L,
    buffer: &mut Buffer,
    field: &VoxelField<'_>,
    left: &[i32],
    first: [usize; 3],
) {
    let [nx, ny, nz] = field.shape_ijk();
    let (first_value, volume_row, volume_slice) = field.layout();
    let values = field.values();
    let mask = field.mask();
    let low = first[0].max(1) - 1;
    let len = (first[0] + LANES + 1).min(nx) - low;
    let at_low = FIRST_VOXEL + low - first[0];
    buffer.decreased.fill(0);
    for row in 0..ACROSS * ACROSS {
        let (weights, costs) = (&mut buffer.weights[row], &mut buffer.costs[row]);
        let j = (first[1] + row % ACROSS).wrapping_sub(1);
        let k = (first[2] + row / ACROSS).wrapping_sub(1);
        if j >= ny || k >= nz {
            weights.fill(f32::INFINITY);
            costs.fill(UNREACHED);
            continue;
        }
        let value_at = first_value + k * volume_slice + j * volume_row + low;
        let node = (k * ny + j) * nx + low;
        let (from_values, from_left) = (&values[value_at..value_at + len], &left[node..node + len]);
        if len == LANES + 2 {
            // The row is copied as two registers, the second of which begins two lanes farther.
            for at in [0, 2] {
                let part = from_values[at..].first_chunk().expect("a register");
                l.copy_weights(part, weights, FIRST_VOXEL - 1 + at);
                let part = from_left[at..].first_chunk().expect("a register");
                l.store(l.costs_of_left(part), costs, FIRST_VOXEL - 1 + at);
            }
        } else {
            weights.fill(f32::INFINITY);
            costs.fill(UNREACHED);
            for lane in 0..len {
                weights[at_low + lane] = open_weight(from_values[lane]);
                costs[at_low + lane] = UNREACHED - from_left[lane] as u32;
            }
        }
        if let Some(mask) = mask {
            for lane in 0..len {
                if mask[value_at + lane] == 0 {
                    weights[at_low + lane] = f32::INFINITY;
                }
            }
        }
    }
}

/// Prefetch the memory that [`load`] will copy for a tile.
///
/// The voxels round the tile are partly in the same cache lines, so they need no prefetch.
pub(crate) fn prefetch_tile(field: &VoxelField<'_>, left: &[i32], first: [usize; 3]) {
    let [nx, ny, nz] = field.shape_ijk();
    let (first_value, volume_row, volume_slice) = field.layout();
    for k in first[2].max(1) - 1..(first[2] + TILE[2] + 1).min(nz) {
        for j in first[1].max(1) - 1..(first[1] + TILE[1] + 1).min(ny) {
            let value = first_value + k * volume_slice + j * volume_row + first[0];
            let node = (k * ny + j) * nx + first[0];
            prefetch(field.values(), value);
            prefetch(left, node);
        }
    }
}

/// Computation on tiles that is compiled once for each instruction set.
pub(crate) trait Kernel {
    type Out;
    /// Run the computation with the instruction set `l`.
    ///
    /// The method must be inlined, or it is compiled without the instruction set.
    fn run<L: Lanes>(self, l: L) -> Self::Out;
}

pub(crate) fn run<K: Kernel>(simd: InstructionSet, kernel: K) -> K::Out {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn avx512<K: Kernel>(kernel: K) -> K::Out {
            // SAFETY: this function runs only on a machine with the instructions of its target features.
            kernel.run(unsafe { Avx512::new() })
        }
        #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
        fn avx2<K: Kernel>(kernel: K) -> K::Out {
            kernel.run(Portable)
        }
        match simd {
            // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
            // Benchmark: benches/field.rs.
            InstructionSet::Avx512 => return unsafe { avx512(kernel) },
            // SAFETY: an `InstructionSet` value exists only on a machine that has the instructions of that set.
            InstructionSet::Avx2 => return unsafe { avx2(kernel) },
            _ => {}
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = simd;
    kernel.run(Portable)
}

/// Computation that copies a tile, sweeps it until no cost decreases, relaxes the voxels round it and writes it back.
pub(crate) struct Settle<'a, C> {
    pub(crate) buffer: &'a mut Buffer,
    pub(crate) field: &'a VoxelField<'a>,
    pub(crate) left: &'a mut [i32],
    pub(crate) first: [usize; 3],
    pub(crate) scale: &'a [f32; 27],
    pub(crate) most: u32,
    pub(crate) rows: u64,
    pub(crate) cost: PhantomData<C>,
}

impl<C: StepCost> Kernel for Settle<'_, C> {
    /// Number of reached voxels of the tile, and whether a cost above `most` was written.
    type Out = (u32, bool);

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) -> Self::Out {
        let Self {
            buffer,
            field,
            left,
            first,
            scale,
            most,
            rows,
            ..
        } = self;
        load(l, buffer, field, left, first);
        let changed = sweep::<L, C>(l, buffer, scale, rows);
        relax_round::<L, C>(l, buffer, scale, changed);
        write(l, buffer, field.shape_ijk(), left, first, most)
    }
}

/// Relax the rows round the changed `rows` of a tile until no cost decreases; return the bit set of all changed rows.
#[inline(always)]
fn sweep<L: Lanes, C: StepCost>(l: L, buffer: &mut Buffer, scale: &[f32; 27], rows: u64) -> u64 {
    let mut dirty = dilated(rows);
    let mut was_changed = rows;
    let mut changed = rows;
    let mut turn = 0;
    while dirty != 0 {
        // The direction of the sweep alternates along k and along j.
        let flip_k = if turn & 1 == 0 { 0 } else { 7 };
        let flip_j = if (turn + 1) & 2 == 0 { 0 } else { 7 };
        turn += 1;
        for at_k in 0..8 {
            let k = at_k ^ flip_k;
            if (dirty >> (8 * k)) as u8 == 0 {
                continue;
            }
            for at_j in 0..8 {
                let j = at_j ^ flip_j;
                let bit = 1u64 << (8 * k + j);
                if dirty & bit == 0 {
                    continue;
                }
                dirty &= !bit;
                let decreased =
                    relax_row::<L, C>(l, buffer, scale, row_of(j, k), was_changed & bit != 0);
                was_changed &= !bit;
                if decreased {
                    changed |= bit;
                    dirty |= dilated(bit) & !bit;
                }
            }
        }
    }
    changed
}

/// Return the index in the buffer of one of the nine rows around and including `row`.
///
/// `block` (0 to 8) numbers these rows in the order of the buffer.
#[inline(always)]
const fn beside(row: usize, block: usize) -> usize {
    row + block / 3 * ACROSS + block % 3 - ACROSS - 1
}

/// Return the least costs of 16 voxels through their three neighbours each in a neighbouring row (`block`).
#[inline(always)]
fn through<L: Lanes, C: StepCost>(
    l: L,
    buffer: &Buffer,
    scale: &[f32; 27],
    here: L::Weights,
    row: usize,
    at: usize,
    block: usize,
) -> L::Costs {
    let other = beside(row, block);
    let (weights, costs) = (&buffer.weights[other], &buffer.costs[other]);
    let mut best = l.all(UNREACHED);
    for lane in 0..3 {
        let at = at + lane - 1;
        let mut cost = l.costs(costs, at);
        if !C::BY_VOXEL {
            let both = l.sum(here, l.weights(weights, at));
            cost = l.plus(cost, l.quanta(both, scale[3 * block + lane]));
        }
        best = l.least(best, cost);
    }
    best
}

/// Relax 16 voxels of a row from the rows round it and along the row; return true if a cost has decreased.
///
/// `was_changed` is true if a cost of the row has changed since its last relaxation, so that the relaxation along the
/// row is needed even if no neighbouring row lowers a cost.
#[inline(always)]
fn relax_row<L: Lanes, C: StepCost>(
    l: L,
    buffer: &mut Buffer,
    scale: &[f32; 27],
    row: usize,
    was_changed: bool,
) -> bool {
    let weights = &buffer.weights[row];
    let own = &buffer.costs[row];
    let here = l.weights(weights, FIRST_VOXEL);
    let old = l.costs(own, FIRST_VOXEL);
    let mut best = l.all(UNREACHED);
    for block in [0, 1, 2, 3, 5, 6, 7, 8] {
        best = l.least(
            best,
            through::<L, C>(l, buffer, scale, here, row, FIRST_VOXEL, block),
        );
    }
    let (before, behind);
    if C::BY_VOXEL {
        before = l.quanta(here, scale[0]);
        behind = before;
        best = l.least(best, l.costs(own, FIRST_VOXEL - 1));
        best = l.least(best, l.costs(own, FIRST_VOXEL + 1));
        best = l.least(old, l.plus(best, before));
    } else {
        before = l.quanta(
            l.sum(here, l.weights(weights, FIRST_VOXEL - 1)),
            scale[HERE - 1],
        );
        behind = l.quanta(
            l.sum(here, l.weights(weights, FIRST_VOXEL + 1)),
            scale[HERE + 1],
        );
        best = l.least(best, l.plus(l.costs(own, FIRST_VOXEL - 1), before));
        best = l.least(best, l.plus(l.costs(own, FIRST_VOXEL + 1), behind));
        best = l.least(old, best);
    }
    if !was_changed && l.less(best, old) == 0 {
        return false;
    }
    // Relax along the row: 1, 2, 4 and 8 steps at once, in both directions.
    let most = l.all(UNREACHED);
    let up1 = l.least(before, most);
    let up2 = l.least(l.plus(up1, l.up::<1>(up1)), most);
    let up4 = l.least(l.plus(up2, l.up::<2>(up2)), most);
    let up8 = l.least(l.plus(up4, l.up::<4>(up4)), most);
    let down1 = l.least(behind, most);
    let down2 = l.least(l.plus(down1, l.down::<1>(down1)), most);
    let down4 = l.least(l.plus(down2, l.down::<2>(down2)), most);
    let down8 = l.least(l.plus(down4, l.down::<4>(down4)), most);
    let mut up = best;
    let mut down = best;
    up = l.least(up, l.plus(l.up::<1>(up), up1));
    down = l.least(down, l.plus(l.down::<1>(down), down1));
    up = l.least(up, l.plus(l.up::<2>(up), up2));
    down = l.least(down, l.plus(l.down::<2>(down), down2));
    up = l.least(up, l.plus(l.up::<4>(up), up4));
    down = l.least(down, l.plus(l.down::<4>(down), down4));
    up = l.least(up, l.plus(l.up::<8>(up), up8));
    down = l.least(down, l.plus(l.down::<8>(down), down8));
    best = l.least(up, down);
    let decreased = l.less(best, old);
    l.store(best, &mut buffer.costs[row], FIRST_VOXEL);
    buffer.decreased[row] |= u32::from(decreased) << 1;
    decreased != 0
}

/// Relax the voxels round a tile from the rows of the tile that changed.
#[inline(always)]
fn relax_round<L: Lanes, C: StepCost>(l: L, buffer: &mut Buffer, scale: &[f32; 27], changed: u64) {
    for row in 0..ACROSS * ACROSS {
        let (j, k) = (row % ACROSS, row / ACROSS);
        // Numbers (0 to 8) of those rows of the 3 x 3 neighbourhood that changed and belong to the tile.
        let mut near = [0usize; 9];
        let mut num_near = 0;
        for block in 0..9 {
            let (j, k) = (j + block % 3, k + block / 3);
            let own = (2..10).contains(&j) && (2..10).contains(&k);
            if own && changed >> (8 * (k - 2) + j - 2) & 1 != 0 {
                near[num_near] = block;
                num_near += 1;
            }
        }
        let near = &near[..num_near];
        if near.is_empty() {
            continue;
        }
        if (1..9).contains(&j) && (1..9).contains(&k) {
            // Relax the voxel before and the voxel after the part of the row that belongs to the tile.
            for (lane, cell) in [(FIRST_VOXEL - 1, 2), (FIRST_VOXEL + LANES, 0)] {
                let at = lane + cell - 1;
                let here = buffer.weights[row][lane];
                let old = buffer.costs[row][lane];
                let mut best = UNREACHED;
                for &block in near {
                    let other = beside(row, block);
                    let mut cost = buffer.costs[other][at];
                    if !C::BY_VOXEL {
                        cost += quanta(here + buffer.weights[other][at], scale[3 * block + cell]);
                    }
                    best = best.min(cost);
                }
                if C::BY_VOXEL {
                    best += quanta(here, scale[0]);
                }
                if best < old {
                    buffer.costs[row][lane] = best;
                    buffer.decreased[row] |= 1 << (lane + 1 - FIRST_VOXEL);
                }
            }
            continue;
        }
        for (at, shift) in [(FIRST_VOXEL - 1, 0), (FIRST_VOXEL + 1, 2)] {
            let here = l.weights(&buffer.weights[row], at);
            let old = l.costs(&buffer.costs[row], at);
            let mut best = l.all(UNREACHED);
            for &block in near {
                best = l.least(
                    best,
                    through::<L, C>(l, buffer, scale, here, row, at, block),
                );
            }
            if C::BY_VOXEL {
                best = l.plus(best, l.quanta(here, scale[0]));
            }
            let decreased = l.less(best, old);
            if decreased != 0 {
                l.store(l.least(best, old), &mut buffer.costs[row], at);
                buffer.decreased[row] |= u32::from(decreased) << shift;
            }
        }
    }
}

/// Write the costs of a tile back; return the number of its reached voxels, and whether one costs more than `most`.
///
/// Afterwards `decreased` contains only the decreased costs of the voxels round the tile.
#[inline(always)]
fn write<L: Lanes>(
    l: L,
    buffer: &mut Buffer,
    [nx, ny, _]: [usize; 3],
    left: &mut [i32],
    first: [usize; 3],
    most: u32,
) -> (u32, bool) {
    /// Bits in `decreased` of the voxels that belong to the tile.
    const TILE_LANES: u32 = 0x1_FFFE;
    let len = LANES.min(nx - first[0]);
    let (mut num_reached, mut beyond) = (0, 0);
    for at in 0..TILE[1] * TILE[2] {
        let (j, k) = (at % 8, at / 8);
        let row = row_of(j, k);
        let costs = l.costs(&buffer.costs[row], FIRST_VOXEL);
        let reached = l.less(costs, l.all(UNREACHED));
        num_reached += reached.count_ones();
        if buffer.decreased[row] & TILE_LANES == 0 {
            continue;
        }
        buffer.decreased[row] &= !TILE_LANES;
        beyond |= reached & l.less(l.all(most), costs);
        let node = ((first[2] + k) * ny + first[1] + j) * nx + first[0];
        if let Some(left) = left[node..node + len].first_chunk_mut() {
            l.store_left(costs, left);
        } else {
            for lane in 0..len {
                left[node + lane] = (UNREACHED - buffer.costs[row][FIRST_VOXEL + lane]) as i32;
            }
        }
    }
    (num_reached, beyond != 0)
}

/// Computation that finds the first cell that led to each voxel with a cost up to `known_to`, plus 1.
///
/// The result is 0 for the other voxels.
pub(crate) struct Steps<'a, C> {
    pub(crate) buffer: &'a mut Buffer,
    pub(crate) field: &'a VoxelField<'a>,
    pub(crate) left: &'a [i32],
    pub(crate) first: [usize; 3],
    pub(crate) scale: &'a [f32; 27],
    pub(crate) known_to: u32,
    pub(crate) cells: &'a mut [[u8; LANES]; TILE[1] * TILE[2]],
    pub(crate) cost: PhantomData<C>,
}

impl<C: StepCost> Kernel for Steps<'_, C> {
    type Out = ();

    #[inline(always)]
    fn run<L: Lanes>(self, l: L) {
        let Self {
            buffer,
            field,
            left,
            first,
            scale,
            known_to,
            cells,
            ..
        } = self;
        load(l, buffer, field, left, first);
        for (at, cells) in cells.iter_mut().enumerate() {
            let row = row_of(at % 8, at / 8);
            let here = l.weights(&buffer.weights[row], FIRST_VOXEL);
            let own = l.costs(&buffer.costs[row], FIRST_VOXEL);
            let known = l.less(own, l.all(known_to + 1));
            let step = l.quanta(here, scale[0]);
            let mut steps = l.all(0);
            // A step from a neighbour to this voxel has the opposite cell of the neighbour's, so the first cell comes
            // last.
            for block in 0..9 {
                let other = beside(row, block);
                let (weights, costs) = (&buffer.weights[other], &buffer.costs[other]);
                for lane in 0..3 {
                    let (cell, at) = (3 * block + lane, FIRST_VOXEL + lane - 1);
                    if cell == HERE {
                        continue;
                    }
                    let step = if C::BY_VOXEL {
                        step
                    } else {
                        l.quanta(l.sum(here, l.weights(weights, at)), scale[cell])
                    };
                    let found = l.equal(l.plus(l.costs(costs, at), step), own) & known;
                    steps = l.select(found, l.all(27 - cell as u32), steps);
                }
            }
            l.store_bytes(steps, cells);
        }
    }
}
