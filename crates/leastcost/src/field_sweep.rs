//! Computation of the least costs of all voxels at once, by sweeps over tiles of the volume.
//!
//! The volume is divided into tiles that fit the nearest cache, and each tile is swept until no cost in it decreases.
//!
//! A queue of voxels accesses the 26 neighbours of voxels all over the front of the search, which is larger than a
//! cache, once for each voxel, and so waits for memory. Here the queue contains tiles, the one with the lowest changed
//! cost first. A tile is copied into a small buffer with the voxels round it ([`crate::field_tile`]); its rows are
//! relaxed sixteen voxels at a time, up and down, until no cost decreases; changed costs are written back and marked in
//! the neighbouring tiles. A tile is swept about twice, which costs less than one memory access for each of its voxels.
//!
//! For any order of the tiles, the final costs are those of Dijkstra's algorithm: no step lowers any of them, and only
//! the least costs have this property (Bellman 1958). No step is free here, so each voxel's predecessor costs less than
//! the voxel. Sweeps in alternating directions: Zhao, Math. Comp. 74 (2005) 603; a queue of tiles: Jeong and Whitaker,
//! SIAM Journal on Scientific Computing 30 (2008) 2512, and Chacon and Vladimirsky, the same 34 (2012) A1433.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::marker::PhantomData;

use carina_grid::InstructionSet;

use crate::field::{Quanta, StepCost, VoxelField};
use crate::field_lanes::{FIRST_VOXEL, LANES, UNREACHED};
use crate::field_tile::{ACROSS, Buffer, Settle, Steps, SweepBuffer, TILE, prefetch_tile, run};

/// State of one tile (cube of voxels) since its costs were last computed.
#[derive(Debug, Clone, Copy)]
struct Tile {
    /// One bit (8 k + j) for each row of the tile, set if a cost in the row has decreased since the last sweep.
    rows: u64,
    /// Lowest of the tile's costs that have decreased since the tile's last sweep, quanta.
    least: u32,
    /// Number of voxels of the tile that had been reached after its last sweep.
    num_reached: u16,
    /// Whether the tile was swept again after the steps to its voxels were written.
    stale: bool,
}

/// State of the sweeps over a volume: its tiles, and the queue of tiles that are still to be swept.
#[derive(Debug)]
pub(crate) struct Sweep {
    tiles_ijk: [usize; 3],
    tiles: Vec<Tile>,
    queue: BinaryHeap<Reverse<(u32, u32)>>,
    simd: InstructionSet,
    scale: [f32; 27],
    pub(crate) num_reached: usize,
    /// Maximum cost in quanta to which the cost of a step can be added without overflow.
    most: u32,
    /// Whether a voxel's cost has exceeded `most`, so that the search fails.
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

    /// Record, in the tile of a voxel, that the cost of the voxel has decreased.
    #[inline]
    pub(crate) fn mark_decreased(&mut self, [i, j, k]: [usize; 3], cost: u32) {
        let number =
            (k / TILE[2] * self.tiles_ijk[1] + j / TILE[1]) * self.tiles_ijk[0] + i / TILE[0];
        let tile = &mut self.tiles[number];
        tile.rows |= 1 << (8 * (k % TILE[2]) + j % TILE[1]);
        if cost < tile.least {
            tile.least = cost;
            self.queue.push(Reverse((cost, number as u32)));
        }
    }

    /// Return the minimum of the decreased costs that no sweep has processed; `None` if there is none.
    ///
    /// All costs up to this cost are final.
    pub(crate) fn front_cost(&mut self) -> Option<u32> {
        while let Some(Reverse((least, number))) = self.queue.peek().copied() {
            if self.tiles[number as usize].least == least {
                return Some(least);
            }
            self.queue.pop();
        }
        None
    }

    /// Sweep the tile with the lowest decreased cost; `left` contains [`UNREACHED`] minus the cost of each voxel.
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
        // The tile that is next in the queue is prefetched. If another tile becomes the next one, little time is lost.
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
        self.mark_decreased_around(buffer, field.shape_ijk(), left, first);
    }

    fn first_of(&self, number: usize) -> [usize; 3] {
        let [nx, ny, _] = self.tiles_ijk;
        [
            number % nx * TILE[0],
            number / nx % ny * TILE[1],
            number / (nx * ny) * TILE[2],
        ]
    }

    /// Write the decreased costs of the voxels round a tile, and record them in the tiles of these voxels.
    fn mark_decreased_around(
        &mut self,
        buffer: &Buffer,
        [nx, ny, _]: [usize; 3],
        left: &mut [i32],
        first: [usize; 3],
    ) {
        for (row, decreased) in buffer.decreased.iter().enumerate() {
            let mut decreased = *decreased;
            if decreased == 0 {
                continue;
            }
            let (j, k) = (first[1] + row % ACROSS - 1, first[2] + row / ACROSS - 1);
            while decreased != 0 {
                let bit = decreased.trailing_zeros() as usize;
                decreased &= decreased - 1;
                let i = first[0] + bit - 1;
                let cost = buffer.costs[row][FIRST_VOXEL - 1 + bit];
                left[(k * ny + j) * nx + i] = (UNREACHED - cost) as i32;
                self.mark_decreased([i, j, k], cost);
            }
        }
    }

    /// Return the largest cost in quanta to which the cost of a further step can be added without overflow.
    pub(crate) const fn most(&self) -> u32 {
        self.most
    }

    /// Return the cost in quanta up to which all costs are final.
    pub(crate) fn known_to(&self) -> u32 {
        // The first entry of the queue is the lowest one or stale; a stale entry is lower than the lowest one.
        self.queue
            .peek()
            .map_or(self.most, |Reverse((least, _))| *least)
    }

    /// Count the voxels of each tile that were reached before the first sweep.
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

    /// Return true if a path may cost more than can be represented, because the final cost of a voxel is above `most`.
    pub(crate) fn is_beyond(&self, left: &[i32]) -> bool {
        self.beyond
            && left
                .iter()
                .any(|left| *left > 0 && UNREACHED - *left as u32 > self.most)
    }

    /// Write to `step_here` the step that led to each voxel, for the tiles that were swept since the last call.
    ///
    /// The step is the first cell for which the neighbour's cost and the cost of the step add up to the voxel's cost.
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
                    // The cell is 0 for the root, for walls and for voxels whose cost is not final; their previous
                    // steps stay.
                    for (step, cell) in steps.iter_mut().zip(&cells[8 * k + j]) {
                        *step = if *cell == 0 { *step } else { *cell };
                    }
                }
            }
            // A tile with costs that are not final is processed again by the next call.
            self.tiles[number].stale = known_to < self.most;
        }
    }

    /// Return the memory that the sweep has allocated, in bytes.
    pub(crate) fn num_bytes(&self) -> usize {
        size_of::<Tile>() * self.tiles.capacity() + 8 * self.queue.capacity()
    }
}
