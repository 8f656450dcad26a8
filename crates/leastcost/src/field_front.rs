//! Step of [`crate::field_tracker`] that settles a block of the queue: the neighbours of each entry are examined.
#![allow(
    clippy::inline_always,
    reason = "small functions of the inner loop: called for each of 26 neighbours of each voxel"
)]

use crate::buckets::Block;
use crate::field::{HERE, StepCost};
use crate::field_layout::prefetch;
use crate::field_state::{FieldTracker, MAX_QUANTA, Touch};

/// Number of queue entries between the entry that is settled and the entry whose memory is prefetched.
const AHEAD: usize = 6;

/// Flag in the stored step of a node that was first reached from the front bucket (the queue's bucket of least cost).
///
/// While the flag is set, another path of equal cost may still replace the step.
const TOUCHED: u8 = 1 << 7;

impl<C: StepCost> FieldTracker<C> {
    /// Settle a block of nodes of one cost, for costs by the entered voxel; return the number of settled nodes.
    ///
    /// The first step to a node has the least cost.
    pub(crate) fn touch(&mut self, values: &[f32], block: Block, cost: u64) -> usize {
        let Self {
            quanta,
            layout,
            step_here,
            open,
            queue,
            touched,
            closing,
            ..
        } = self;
        // With steps of cost 0 a node may be settled in the bucket from which it was first reached, and could then
        // reach its own predecessor. Such a node is therefore closed at once and keeps the first step found.
        let free = quanta.cheapest == 0.0;
        touched.clear();
        for at in 0..block.len {
            let ahead = queue.entry(block, (at + AHEAD).min(block.len - 1));
            layout.prefetch_bits(open, layout.ijk(ahead));
            let node = queue.entry(block, at);
            let ijk = layout.ijk(node);
            let (byte, shift) = layout.first_bit_around(ijk);
            let mut around = layout.around(open, byte, shift);
            let value_at = layout.value_at(ijk);
            while around != 0 {
                let cell = around.trailing_zeros() as usize;
                around &= around - 1;
                if free {
                    layout.close(open, byte, shift, cell);
                }
                let node = (node as isize + layout.node_step[cell]) as u32;
                let value_at = (value_at as isize + layout.value_step[cell]) as u32;
                prefetch(values, value_at as usize);
                prefetch(step_here, node as usize);
                touched.push(Touch {
                    node,
                    value_at,
                    cell: cell as u8,
                });
            }
        }
        for touch in touched.iter() {
            let step = &mut step_here[touch.node as usize];
            if free {
                *step = touch.cell + 1;
            } else if *step & TOUCHED != 0 {
                // The node was reached before from the front bucket at the same cost. The step with the lower cell
                // number is stored, so that the result does not depend on the order.
                *step = (*step).min((touch.cell + 1) | TOUCHED);
                continue;
            } else {
                *step = (touch.cell + 1) | TOUCHED;
                closing.push(touch.node);
            }
            // For this cost the factor is the same for every cell.
            let into = values[touch.value_at as usize];
            let step = quanta.of_lane(0.0, into, quanta.scale[0][0]);
            queue.push(cost + step as u64, touch.node);
        }
        block.len
    }

    /// Close the nodes that were first reached from the front bucket; to be called when that bucket is empty.
    pub(crate) fn close_touched(&mut self) {
        for node in self.closing.drain(..) {
            self.step_here[node as usize] &= !TOUCHED;
            let bit = self.layout.bit_left_of(self.layout.ijk(node)) + 1;
            self.open[bit / 8] &= !(1 << (bit % 8));
        }
    }

    /// Settle the nodes of a block of the queue's first bucket, for costs by the two voxels of a step; return their
    /// number.
    pub(crate) fn relax(&mut self, values: &[f32], block: Block) -> usize {
        let Self {
            quanta,
            layout,
            step_here,
            open,
            left,
            queue,
            ..
        } = self;
        let mut num_settled = 0;
        for at in 0..block.len {
            // A node is in the queue once for each bucket that its cost has passed, five times and more if steps differ
            // much in length. All entries but the first, cheapest one are stale; for a stale entry only one bit is
            // read.
            let far = queue.entry(block, (at + 2 * AHEAD).min(block.len - 1));
            prefetch(open, layout.bit_left_of(layout.ijk(far)) / 8);
            let near = queue.entry(block, (at + AHEAD).min(block.len - 1));
            let near_ijk = layout.ijk(near);
            if layout.is_open(open, near_ijk) {
                layout.prefetch_bits(open, near_ijk);
                let value_at = layout.value_at(near_ijk);
                for row in 0..9 {
                    let step = layout.node_step[3 * row + 1];
                    prefetch(left, (near as usize).wrapping_add_signed(step));
                    let step = layout.value_step[3 * row + 1];
                    prefetch(values, value_at.wrapping_add_signed(step));
                }
            }

            let node = queue.entry(block, at);
            let ijk = layout.ijk(node);
            if !layout.is_open(open, ijk) {
                continue;
            }
            let (byte, shift) = layout.first_bit_around(ijk);
            layout.close(open, byte, shift, HERE);
            let around = layout.around(open, byte, shift);
            num_settled += 1;
            let here = left[node as usize];
            let value_at = layout.value_at(ijk);
            let from = values[value_at];
            for row in 0..9 {
                let lanes = around >> (3 * row) & 7;
                let middle = 3 * row + 1;
                let n = (node as usize)
                    .wrapping_add_signed(layout.node_step[middle])
                    .wrapping_sub(1);
                let v = value_at
                    .wrapping_add_signed(layout.value_step[middle])
                    .wrapping_sub(1);
                // Three values are read as four; near the ends of the arrays they are read one by one.
                let old = left
                    .get(n..n.wrapping_add(4))
                    .and_then(|x| x.first_chunk::<4>());
                let into = values
                    .get(v..v.wrapping_add(4))
                    .and_then(|x| x.first_chunk::<4>());
                let mut candidates = [0i32; 4];
                if let (Some(old), Some(into)) = (old, into) {
                    let mut any = 0;
                    for lane in 0..4 {
                        candidates[lane] =
                            here - quanta.of_lane(from, into[lane], quanta.scale[row][lane]);
                    }
                    for lane in 0..3 {
                        // The test is by the sign, because both numbers are from 0 to 2^31 - 1. A candidate with equal
                        // cost passes as well, because its cell number may be lower.
                        any |= !(candidates[lane] - old[lane]);
                    }
                    if any >= 0 {
                        continue;
                    }
                } else {
                    for lane in (0..3).filter(|lane| lanes >> lane & 1 != 0) {
                        let into = values[v.wrapping_add(lane)];
                        candidates[lane] =
                            here - quanta.of_lane(from, into, quanta.scale[row][lane]);
                    }
                }
                for lane in (0..3).filter(|lane| lanes >> lane & 1 != 0) {
                    let neighbour = n.wrapping_add(lane);
                    let (old, candidate) = (left[neighbour], candidates[lane]);
                    let cell = (3 * row + lane) as u8 + 1;
                    if candidate <= old {
                        // Of steps with the same cost the one with the lowest cell number is stored, so that the order
                        // of the search does not matter.
                        if candidate == old && cell < step_here[neighbour] {
                            step_here[neighbour] = cell;
                        }
                        continue;
                    }
                    left[neighbour] = candidate;
                    step_here[neighbour] = cell;
                    let cost = (MAX_QUANTA - candidate) as u64;
                    // If the node's bucket stays the same, the existing queue entry suffices.
                    if old == 0
                        || queue.bucket_of((MAX_QUANTA - old) as u64) != queue.bucket_of(cost)
                    {
                        queue.push(cost, neighbour as u32);
                    }
                }
            }
        }
        num_settled
    }
}
