//! Every voxel's least cost at once: the volume in tiles that fit the nearest cache, each swept until nothing gets cheaper.
//!
//! A queue of voxels reaches for a voxel's 26 neighbours all over the front, which is larger than a cache, and does so once
//! for each voxel: it waits for memory. Here the queue holds tiles, the one with the cheapest news first. A tile is copied
//! into a small buffer with the voxels round it ([`crate::field_tile`]); its rows are relaxed sixteen voxels at a time, up and
//! down, until none gets cheaper; what got cheaper is written back, and the tiles round it are told. A tile is swept about
//! twice, which costs less than one wait for each of its voxels.
//!
//! In whatever order, the costs at the end are Dijkstra's: no step lowers any of them, and only the least costs are so
//! (Bellman 1958). No step is free here, so each voxel's predecessor costs less than the voxel. Sweeps in alternating
//! directions: Zhao, Math. Comp. 74 (2005) 603; a queue of tiles: Jeong and Whitaker, SIAM Journal on Scientific
//! Computing 30 (2008) 2512, and Chacon and Vladimirsky, the same 34 (2012) A1433.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::marker::PhantomData;

use carina_grid::InstructionSet;

use crate::field::{Quanta, StepCost, VoxelField};
use crate::field_lanes::{LANES, OWN, UNREACHED};
use crate::field_tile::{ACROSS, Buffer, Settle, Steps, SweepBuffer, TILE, prefetch_tile, run};

/// What is known of a tile.
#[derive(Debug, Clone, Copy)]
struct Tile {
    /// Its own rows in which something got cheaper since it was swept; bit 8 k + j.
    rows: u64,
    /// The least cost among that.
    least: u32,
    /// Voxels of it that were reached when it was last swept.
    num_reached: u16,
    /// Swept since steps were last written.
    stale: bool,
}

/// The tiles that are still to be swept.
#[derive(Debug)]
pub(crate) struct Sweep {
    tiles_ijk: [usize; 3],
    tiles: Vec<Tile>,
    queue: BinaryHeap<Reverse<(u32, u32)>>,
    simd: InstructionSet,
    scale: [f32; 27],
    pub(crate) num_reached: usize,
    /// A cost beyond this may have neighbours that cannot be counted.
    most: u32,
    /// Such a cost was written.
    beyond: bool,
}

impl Sweep {
    pub(crate) fn new<C: StepCost>(
        shape: [usize; 3],
        quanta: &Quanta<C>,
        most: u32,
        simd: InstructionSet,
    ) -> Self {
        let tiles_ijk: [usize; 3] = std::array::from_fn(|a| shape[a].div_ceil(TILE[a]));
        Self {
            tiles_ijk,
            tiles: vec![
                Tile {
                    rows: 0,
                    least: u32::MAX,
                    num_reached: 0,
                    stale: false
                };
                tiles_ijk.iter().product()
            ],
            queue: BinaryHeap::new(),
            simd,
            scale: std::array::from_fn(|cell| quanta.scale[cell / 3][cell % 3]),
            num_reached: 0,
            most,
            beyond: false,
        }
    }

    /// Tells the tile of a voxel that the voxel got cheaper.
    #[inline]
    pub(crate) fn tell(&mut self, [i, j, k]: [usize; 3], cost: u32) {
        let number =
            (k / TILE[2] * self.tiles_ijk[1] + j / TILE[1]) * self.tiles_ijk[0] + i / TILE[0];
        let tile = &mut self.tiles[number];
        tile.rows |= 1 << (8 * (k % TILE[2]) + j % TILE[1]);
        if cost < tile.least {
            tile.least = cost;
            self.queue.push(Reverse((cost, number as u32)));
        }
    }

    /// The least cost that is news to a tile: what costs no more is final. `None` if nothing is news.
    pub(crate) fn front_cost(&mut self) -> Option<u32> {
        while let Some(Reverse((least, number))) = self.queue.peek().copied() {
            if self.tiles[number as usize].least == least {
                return Some(least);
            }
            self.queue.pop();
        }
        None
    }

    /// Sweeps the tile with the cheapest news; `left` holds what is left of `UNREACHED` after each voxel's cost.
    pub(crate) fn settle_next<C: StepCost>(
        &mut self,
        field: &VoxelField<'_>,
        buffer: &mut SweepBuffer,
        left: &mut [i32],
    ) {
        let Some(Reverse((_, number))) = self.queue.pop() else {
            return;
        };
        let number = number as usize;
        let rows = std::mem::take(&mut self.tiles[number].rows);
        self.tiles[number].least = u32::MAX;
        self.tiles[number].stale = true;
        // What is copied next is on its way while this is computed; if other news come before it, little is lost.
        if let Some(Reverse((_, next))) = self.queue.peek() {
            prefetch_tile(field, left, self.first_of(*next as usize));
        }
        let first = self.first_of(number);
        let buffer = &mut *buffer.0;
        let (num_reached, beyond) = run(
            self.simd,
            Settle::<C> {
                buffer,
                field,
                left,
                first,
                scale: &self.scale,
                most: self.most,
                rows,
                cost: PhantomData,
            },
        );
        self.beyond |= beyond;
        let before = std::mem::replace(&mut self.tiles[number].num_reached, num_reached as u16);
        self.num_reached += num_reached as usize - before as usize;
        self.tell_round(buffer, field.shape_ijk(), left, first);
    }

    fn first_of(&self, number: usize) -> [usize; 3] {
        let [nx, ny, _] = self.tiles_ijk;
        [
            number % nx * TILE[0],
            number / nx % ny * TILE[1],
            number / (nx * ny) * TILE[2],
        ]
    }

    /// Writes what got cheaper round a tile, and tells the tiles there.
    fn tell_round(
        &mut self,
        buffer: &Buffer,
        [nx, ny, _]: [usize; 3],
        left: &mut [i32],
        first: [usize; 3],
    ) {
        for (row, news) in buffer.news.iter().enumerate() {
            let mut news = *news;
            if news == 0 {
                continue;
            }
            let (j, k) = (first[1] + row % ACROSS - 1, first[2] + row / ACROSS - 1);
            while news != 0 {
                let bit = news.trailing_zeros() as usize;
                news &= news - 1;
                let i = first[0] + bit - 1;
                let cost = buffer.costs[row][OWN - 1 + bit];
                left[(k * ny + j) * nx + i] = (UNREACHED - cost) as i32;
                self.tell([i, j, k], cost);
            }
        }
    }

    /// The greatest cost whose neighbours' costs can be counted.
    pub(crate) const fn most(&self) -> u32 {
        self.most
    }

    /// What costs no more than this is final.
    pub(crate) fn known_to(&self) -> u32 {
        // The first entry is the least or stale, and then less than the least.
        self.queue
            .peek()
            .map_or(self.most, |Reverse((least, _))| *least)
    }

    /// Counts what was reached before the first sweep.
    pub(crate) fn count(&mut self, left: &[i32], [nx, ny, _]: [usize; 3]) {
        for (number, row) in left.chunks(nx).enumerate() {
            let (j, k) = (number % ny, number / ny);
            let first = (k / TILE[2] * self.tiles_ijk[1] + j / TILE[1]) * self.tiles_ijk[0];
            for (tile, part) in self.tiles[first..].iter_mut().zip(row.chunks(LANES)) {
                let reached = part.iter().filter(|left| **left != 0).count();
                tile.num_reached += reached as u16;
                self.num_reached += reached;
            }
        }
    }

    /// True if a path may cost more than can be counted: a voxel's cost, no longer news to anyone, is beyond `most`.
    pub(crate) fn is_beyond(&self, left: &[i32]) -> bool {
        self.beyond
            && left
                .iter()
                .any(|left| *left > 0 && UNREACHED - *left as u32 > self.most)
    }

    /// Writes for each voxel of the tiles swept since the last call the step that led to it: the first cell whose cost and
    /// step add up to the voxel's.
    pub(crate) fn write_steps<C: StepCost>(
        &mut self,
        field: &VoxelField<'_>,
        buffer: &mut SweepBuffer,
        left: &[i32],
        step_here: &mut [u8],
    ) {
        let [nx, ny, nz] = field.shape_ijk();
        let buffer = &mut *buffer.0;
        let known_to = self.known_to();
        for number in 0..self.tiles.len() {
            if !std::mem::take(&mut self.tiles[number].stale) {
                continue;
            }
            let first = self.first_of(number);
            if number + 1 < self.tiles.len() {
                prefetch_tile(field, left, self.first_of(number + 1));
            }
            let mut cells = [[0u8; LANES]; TILE[1] * TILE[2]];
            run(
                self.simd,
                Steps::<C> {
                    buffer,
                    field,
                    left,
                    first,
                    scale: &self.scale,
                    known_to,
                    cells: &mut cells,
                    cost: PhantomData,
                },
            );
            let len = LANES.min(nx - first[0]);
            for k in 0..TILE[2].min(nz - first[2]) {
                for j in 0..TILE[1].min(ny - first[1]) {
                    let at = ((first[2] + k) * ny + first[1] + j) * nx + first[0];
                    let steps = &mut step_here[at..at + len];
                    // 0 where nothing is known: the root, walls, and what was stopped at. What was known there stays.
                    for (step, cell) in steps.iter_mut().zip(&cells[8 * k + j]) {
                        *step = if *cell == 0 { *step } else { *cell };
                    }
                }
            }
            // What is not final yet is looked at again.
            self.tiles[number].stale = known_to < self.most;
        }
    }

    /// Bytes held.
    pub(crate) fn num_bytes(&self) -> usize {
        size_of::<Tile>() * self.tiles.capacity() + 8 * self.queue.capacity()
    }
}
