//! Floating-point path cost for a priority queue.

use std::cmp::Ordering;

/// Finite path cost with a total order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrderedCost(pub f64);

impl Eq for OrderedCost {}

impl PartialOrd for OrderedCost {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for OrderedCost {
    fn cmp(&self, other: &Self) -> Ordering {
        self.0.total_cmp(&other.0)
    }
}
