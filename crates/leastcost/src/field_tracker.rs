//! Resumable tree of least-cost paths over a whole volume, without a graph in memory (paper 6, Algorithm 1).
//!
//! The tracker stores one byte per voxel (the step from its predecessor) and one bit (whether a path may still change
//! the voxel). For costs by the voxel that a step enters no more is needed, because the first step to a voxel has the
//! least cost. For costs by both voxels of a step the tracker also stores the 4 bytes of the least cost so far. Single
//! targets are reached with the queue in [`crate::buckets`], voxel by voxel ([`crate::field_front`]): for a target near
//! the root only the voxels between are settled, and no memory is written where no path has come. All voxels at once
//! are swept in tiles ([`crate::field_sweep`]), which needs 4 bytes per voxel with either cost during the sweep. Of
//! several steps with the same cost the one with the first cell is stored, so that both methods give the same tree.

use carina_grid::InstructionSet;

use crate::buckets::Buckets;
use crate::field::{HERE, Quanta, StepCost, VoxelField};
use crate::field_layout::{Layout, fresh, open_bits};
pub use crate::field_state::FieldTracker;
use crate::field_state::{MAX_QUANTA, Touch};
use crate::field_sweep::Sweep;
use crate::field_tile::SweepBuffer;
use crate::{TrackError, Watch};

/// Approximate number of nodes settled between two checks of the watch.
const NODES_PER_CHECK: usize = 1 << 16;

impl<C: StepCost> FieldTracker<C> {
    /// Create a tracker with one root, a voxel of the volume, and no settled node.
    ///
    /// # Errors
    ///
    /// Returns an error if the root is not open or the weights are not valid.
    pub fn new(field: &VoxelField<'_>, root_ijk: [usize; 3]) -> Result<Self, TrackError> {
        let root = open_root(field, root_ijk)?;
        let quanta = Quanta::<C>::choose(field)?;
        let layout = Layout::new(field);
        let num_nodes = field.num_nodes();
        let open = open_bits(field, &layout, quanta.num_open == num_nodes);
        let left = if C::BY_VOXEL {
            Vec::new()
        } else {
            fresh::<i32>(num_nodes)
        };
        // Costs by the entered voxel need the exact order of the costs; costs by both voxels of a step only require
        // that no step stays within the front bucket.
        let span_log2 = if C::BY_VOXEL {
            0
        } else {
            (quanta.cheapest as u32).max(1).ilog2()
        };
        let mut tracker = Self {
            quanta,
            layout,
            root,
            step_here: fresh::<u8>(num_nodes),
            open,
            left,
            queue: Buckets::new(quanta.dearest as u64, span_log2),
            touched: Vec::new(),
            closing: Vec::new(),
            num_settled: 0,
            done: false,
            sweep: None,
            simd: InstructionSet::best(),
        };
        tracker.step_here[root as usize] = HERE as u8 + 1;
        if C::BY_VOXEL {
            let bit = tracker.layout.bit_left_of(tracker.layout.ijk(root)) + 1;
            tracker.open[bit / 8] &= !(1 << (bit % 8));
        } else {
            tracker.left[root as usize] = MAX_QUANTA;
        }
        tracker.queue.push(0, root);
        Ok(tracker)
    }

    /// Settle nodes until the least cost of the target is known; return true if a path exists.
    ///
    /// `field` must be the field with which the tracker was created.
    ///
    /// # Errors
    ///
    /// Returns an error if an argument is not valid, if a cost is too large, or if `watch` stops the search.
    pub fn solve_to(
        &mut self,
        field: &VoxelField<'_>,
        target: u32,
        watch: &impl Watch,
    ) -> Result<bool, TrackError> {
        self.check(field, Some(target))?;
        // For costs by the entered voxel the queue is still valid, and the search continues from it.
        if self.sweep.is_some() && !C::BY_VOXEL {
            self.sweep_on(field, Some(target), watch)?;
        } else {
            self.settle_until(field, Some(target), watch)?;
        }
        Ok(self.is_known(target))
    }

    /// Settle every node that a path can reach.
    ///
    /// # Errors
    ///
    /// Returns an error if an argument is not valid, if a cost is too large, or if `watch` stops the search.
    pub fn solve_all(
        &mut self,
        field: &VoxelField<'_>,
        watch: &impl Watch,
    ) -> Result<(), TrackError> {
        self.check(field, None)?;
        if self.sweep.is_none() && !self.done && self.may_sweep() {
            self.begin_sweep(field);
        }
        if self.sweep.is_none() {
            return self.settle_until(field, None, watch);
        }
        match self.sweep_on(field, None, watch) {
            // For costs by the entered voxel the queue has no limit of the cost and is still valid, so the search
            // continues with it.
            Err(TrackError::CostOverflow { .. }) if C::BY_VOXEL => {
                self.sweep = None;
                self.left = Vec::new();
                self.settle_until(field, None, watch)
            }
            outcome => outcome,
        }
    }

    /// Return true if sweeping tiles gives the same tree as the queue and is faster.
    fn may_sweep(&self) -> bool {
        // For costs by the entered voxel the sweep starts again at the root, and free steps would not determine which
        // of two voxels is the predecessor of the other.
        !C::BY_VOXEL || (self.quanta.cheapest > 0.0 && 2 * self.num_settled < self.quanta.num_open)
    }

    /// Start the sweep of all voxels: move the open nodes from the queue to the tiles.
    fn begin_sweep(&mut self, field: &VoxelField<'_>) {
        let most = (MAX_QUANTA as u32).saturating_sub(2 * self.quanta.dearest as u32);
        let mut sweep = Sweep::new(field.shape_ijk(), &self.quanta, most, self.simd);
        if C::BY_VOXEL {
            self.left = fresh::<i32>(field.num_nodes());
            self.left[self.root as usize] = MAX_QUANTA;
            sweep.mark_decreased(self.layout.ijk(self.root), 0);
        } else {
            while self.queue.advance() {
                while let Some(block) = self.queue.take() {
                    for at in 0..block.len {
                        let node = self.queue.entry(block, at);
                        let ijk = self.layout.ijk(node);
                        if self.layout.is_open(&self.open, ijk) {
                            let cost = MAX_QUANTA - self.left[node as usize];
                            sweep.mark_decreased(ijk, cost as u32);
                        }
                    }
                    self.queue.give_back(block);
                }
            }
            sweep.count(&self.left, self.layout.shape);
            self.release_queue();
        }
        self.sweep = Some(sweep);
    }

    fn release_queue(&mut self) {
        self.queue = Buckets::new(1, 0);
        self.open = Vec::new();
        self.touched = Vec::new();
        self.closing = Vec::new();
    }

    /// Sweep tiles until the cost of `target` is final, or the costs of all nodes if `target` is `None`.
    fn sweep_on(
        &mut self,
        field: &VoxelField<'_>,
        target: Option<u32>,
        watch: &impl Watch,
    ) -> Result<(), TrackError> {
        if self.done || target.is_some_and(|target| self.is_known(target)) {
            return Ok(());
        }
        let Some(mut sweep) = self.sweep.take() else {
            return Ok(());
        };
        let mut buffer = SweepBuffer::new();
        let outcome = self.sweep_with(&mut sweep, &mut buffer, field, target, watch);
        if !C::BY_VOXEL || self.done {
            self.num_settled = sweep.num_reached;
        }
        if C::BY_VOXEL && matches!(outcome, Err(TrackError::CostOverflow { .. })) {
            return outcome;
        }
        // Steps are written for all final costs, also after an error.
        sweep.write_steps::<C>(field, &mut buffer, &self.left, &mut self.step_here);
        if C::BY_VOXEL && self.done {
            self.left = Vec::new();
            self.release_queue();
        } else {
            self.sweep = Some(sweep);
        }
        outcome
    }

    fn sweep_with(
        &mut self,
        sweep: &mut Sweep,
        buffer: &mut SweepBuffer,
        field: &VoxelField<'_>,
        target: Option<u32>,
        watch: &impl Watch,
    ) -> Result<(), TrackError> {
        let overflow = TrackError::CostOverflow {
            most: MAX_QUANTA as f64 * self.quanta.unit,
        };
        let mut last_check = sweep.num_reached;
        let mut visits = 0;
        while let Some(front) = sweep.front_cost() {
            if front > sweep.most() {
                return Err(overflow);
            }
            let known = |target: u32| self.left[target as usize] >= MAX_QUANTA - front as i32;
            if target.is_some_and(known) {
                return Ok(());
            }
            sweep.settle_next::<C>(field, buffer, &mut self.left);
            visits += 1;
            if sweep.num_reached >= last_check + NODES_PER_CHECK || visits == 64 {
                visits = 0;
                last_check = sweep.num_reached;
                watch.report_fraction(last_check as f64 / self.quanta.num_open as f64)?;
            }
        }
        if sweep.is_beyond(&self.left) {
            return Err(overflow);
        }
        self.done = true;
        Ok(())
    }

    fn check(&self, field: &VoxelField<'_>, target: Option<u32>) -> Result<(), TrackError> {
        if field.shape_ijk() != self.layout.shape || field.values().len() != self.layout.num_values
        {
            return Err(TrackError::Argument {
                what: "field",
                expected: format!("{:?} voxels, as the tracker's", self.layout.shape),
                found: format!("{:?}", field.shape_ijk()),
            });
        }
        if let Some(target) = target.filter(|t| *t as usize >= self.step_here.len()) {
            return Err(TrackError::Argument {
                what: "target",
                expected: format!("a node below {}", self.step_here.len()),
                found: target.to_string(),
            });
        }
        Ok(())
    }

    /// Return true if the least cost of a node is final.
    fn is_known(&self, node: u32) -> bool {
        if self.step_here[node as usize] == 0 {
            return false;
        }
        if C::BY_VOXEL || self.done {
            return true;
        }
        if let Some(sweep) = &self.sweep {
            // Least costs are unique, so costs that the sweep has passed are final.
            return self.left[node as usize] >= MAX_QUANTA - sweep.known_to() as i32;
        }
        // An open node may become cheaper, but not below the front bucket.
        let cost = (MAX_QUANTA - self.left[node as usize]) as u64;
        self.queue.bucket_of(cost) <= self.queue.bucket_of(self.queue.front_cost())
    }

    fn settle_until(
        &mut self,
        field: &VoxelField<'_>,
        target: Option<u32>,
        watch: &impl Watch,
    ) -> Result<(), TrackError> {
        let mut last_check = self.num_settled;
        while !self.done && target.is_none_or(|t| !self.is_known(t)) {
            if !self.queue.advance() {
                self.done = true;
                break;
            }
            let cost = self.queue.front_cost();
            if !C::BY_VOXEL && cost + 2 * self.quanta.dearest as u64 > MAX_QUANTA as u64 {
                return Err(TrackError::CostOverflow {
                    most: MAX_QUANTA as f64 * self.quanta.unit,
                });
            }
            // For costs by both ends all costs in the front bucket are final, so a target in that bucket is known.
            if !C::BY_VOXEL && target.is_some_and(|t| self.is_known(t)) {
                break;
            }
            while let Some(block) = self.queue.take() {
                self.num_settled += if C::BY_VOXEL {
                    self.touch(field.values(), block, cost)
                } else {
                    self.relax(field.values(), block)
                };
                self.queue.give_back(block);
            }
            self.close_touched();
            if self.num_settled - last_check >= NODES_PER_CHECK {
                last_check = self.num_settled;
                watch.report_fraction(last_check as f64 / self.quanta.num_open as f64)?;
            }
        }
        Ok(())
    }

    /// Return the node of the root.
    #[must_use]
    pub const fn root(&self) -> u32 {
        self.root
    }

    /// Return the integer unit of the costs of this search.
    #[must_use]
    pub const fn quanta(&self) -> &Quanta<C> {
        &self.quanta
    }

    /// Return the number of nodes whose steps were examined.
    #[must_use]
    pub const fn num_settled(&self) -> usize {
        self.num_settled
    }

    /// Return the memory that the tracker has allocated, in bytes: for the voxels, and for the queue.
    #[must_use]
    pub fn num_bytes(&self) -> (usize, usize) {
        let kept = self.step_here.capacity() + self.open.capacity() + 4 * self.left.capacity();
        let tiles = self.sweep.as_ref().map_or(0, Sweep::num_bytes);
        let queue = self.queue.num_bytes()
            + tiles
            + size_of::<Touch>() * self.touched.capacity()
            + 4 * self.closing.capacity();
        (kept, queue)
    }

    /// Return the cell of the step that led to a node; `None` if no path has reached it.
    fn cell_to(&self, node: u32) -> Option<usize> {
        usize::from(self.step_here[node as usize]).checked_sub(1)
    }

    /// Return the predecessor of a settled node on its path; `None` at the root and for a node whose path is not known.
    #[must_use]
    pub fn predecessor(&self, node: u32) -> Option<u32> {
        let cell = self.cell_to(node)?;
        if cell == HERE || !self.is_known(node) {
            return None;
        }
        Some((node as isize - self.layout.node_step[cell]) as u32)
    }

    /// Return the nodes of the path from the root to `target`; `None` if the target's least cost is not known.
    #[must_use]
    pub fn path_to(&self, target: u32) -> Option<Vec<u32>> {
        if target as usize >= self.step_here.len() || !self.is_known(target) {
            return None;
        }
        // All nodes before a known node on its path are known as well.
        let mut path = vec![target];
        let mut node = target;
        loop {
            let cell = self.cell_to(node)?;
            if cell == HERE {
                path.reverse();
                return Some(path);
            }
            node = (node as isize - self.layout.node_step[cell]) as u32;
            path.push(node);
        }
    }

    /// Return the least cost of a node in quanta, summed along its path; `None` if the least cost is not known.
    #[must_use]
    pub fn cost_quanta(&self, field: &VoxelField<'_>, target: u32) -> Option<u64> {
        let path = self.path_to(target)?;
        Some(
            path.windows(2)
                .map(|step| {
                    let cell = usize::from(self.step_here[step[1] as usize]) - 1;
                    let (from, into) = (field.value(step[0]), field.value(step[1]));
                    u64::from(self.quanta.of_step(from, into, cell))
                })
                .sum(),
        )
    }

    /// Return the least cost of a node, accurate within 0.5 %; `None` if the least cost is not known.
    ///
    /// The cost is exact if the quantum is 1.
    #[must_use]
    pub fn cost(&self, field: &VoxelField<'_>, target: u32) -> Option<f64> {
        self.cost_quanta(field, target)
            .map(|quanta| quanta as f64 * self.quanta.unit)
    }
}

/// Return the node of the root voxel.
///
/// # Errors
///
/// Returns an error if the voxel is not open.
pub(crate) fn open_root(field: &VoxelField<'_>, root_ijk: [usize; 3]) -> Result<u32, TrackError> {
    let root = field
        .node_at_voxel(root_ijk)
        .ok_or_else(|| TrackError::Argument {
            what: "root",
            expected: "a voxel of the region".to_owned(),
            found: format!("{root_ijk:?}"),
        })?;
    if !field.is_open(root) {
        return Err(TrackError::NoResult(format!(
            "the root, voxel {root_ijk:?}, is not open: its weight is not finite or the mask leaves it out; \
             choose a voxel inside"
        )));
    }
    Ok(root)
}
