//! Set of voxels of a box, numbered in array order: one bit per voxel and one count per 64 voxels.
//!
//! A table with a node number per voxel of the box takes 4 bytes for each voxel, and nearly all of them are not lumen;
//! this set takes 1.5 bits. The number of a voxel is the count of the bits before it (rank, as in succinct bit vectors,
//! Jacobson 1989).

use crate::distance::VoxelBox;

/// Set of voxels of the volume inside a box, which numbers its members in array order.
#[derive(Debug, Clone)]
pub(crate) struct VoxelSet {
    voxel_box: VoxelBox,
    words: Vec<u64>,
    /// Number of members of the set in the 64-bit words before each word.
    before: Vec<u32>,
}

impl VoxelSet {
    /// Create the set of `members`, without those outside the box.
    pub(crate) fn new(voxel_box: VoxelBox, members: impl IntoIterator<Item = [isize; 3]>) -> Self {
        let mut words = vec![0u64; voxel_box.num_voxels().div_ceil(64)];
        for voxel in members {
            if let Some(at) = voxel_box.index_of(voxel) {
                words[at / 64] |= 1 << (at % 64);
            }
        }
        let mut count = 0;
        let before = words
            .iter()
            .map(|word| {
                let here = count;
                count += word.count_ones();
                here
            })
            .collect();
        Self {
            voxel_box,
            words,
            before,
        }
    }

    /// Return the box to which the set is limited.
    pub(crate) const fn voxel_box(&self) -> VoxelBox {
        self.voxel_box
    }

    /// Return the number of a voxel among the members in array order; `None` if the voxel is not a member.
    pub(crate) fn place(&self, ijk: [isize; 3]) -> Option<u32> {
        let at = self.voxel_box.index_of(ijk)?;
        let (word, bit) = (self.words[at / 64], at % 64);
        (word >> bit & 1 == 1)
            .then(|| self.before[at / 64] + (word & ((1 << bit) - 1)).count_ones())
    }

    /// Return the members in a part of a row along i inside the box, in order, each as its i and its number.
    ///
    /// Empty parts are skipped 64 voxels at a time.
    pub(crate) fn in_row(
        &self,
        i: std::ops::RangeInclusive<isize>,
        j: isize,
        k: isize,
    ) -> impl Iterator<Item = (isize, u32)> + '_ {
        let first_i = *i.start();
        let len = (*i.end() - first_i + 1).max(0) as usize;
        let from = self.voxel_box.index_of([first_i, j, k]).unwrap_or(0);
        let end = from + len;
        (from / 64..end.div_ceil(64).max(from / 64)).flat_map(move |number| {
            let word = self.words[number];
            let low = from.saturating_sub(64 * number);
            let high = (end - 64 * number).min(64);
            let mut mine = word & (u64::MAX << low) & (u64::MAX >> (64 - high));
            std::iter::from_fn(move || {
                (mine != 0).then(|| {
                    let bit = mine.trailing_zeros() as usize;
                    mine &= mine - 1;
                    let place = self.before[number] + (word & ((1u64 << bit) - 1)).count_ones();
                    (first_i + (64 * number + bit - from) as isize, place)
                })
            })
        })
    }

    /// Return the members among three voxels in a row along i, and the number of the first member.
    ///
    /// `ijk` is the middle voxel, whose i must be in the box. The result is `None` if the row is outside the box.
    #[inline]
    pub(crate) fn three(&self, ijk: [isize; 3]) -> Option<(u32, [bool; 3])> {
        let VoxelBox {
            first_ijk: first,
            shape_ijk: [nx, ny, nz],
        } = self.voxel_box;
        let [i, j, k]: [isize; 3] = std::array::from_fn(|a| ijk[a] - first[a] as isize);
        if i < 0 || j < 0 || k < 0 {
            return None;
        }
        let [i, j, k] = [i as usize, j as usize, k as usize];
        if i >= nx || j >= ny || k >= nz {
            return None;
        }
        let row = (k * ny + j) * nx;
        let holds = |x: usize| self.words[(row + x) / 64] >> ((row + x) % 64) & 1 == 1;
        let at = row + i.saturating_sub(1);
        let (word, bit) = (self.words[at / 64], at % 64);
        let first = self.before[at / 64] + (word & ((1 << bit) - 1)).count_ones();
        Some((
            first,
            [i > 0 && holds(i - 1), holds(i), i + 1 < nx && holds(i + 1)],
        ))
    }

    /// Return true if a voxel is a member of the set.
    pub(crate) fn holds(&self, ijk: [isize; 3]) -> bool {
        self.voxel_box
            .index_of(ijk)
            .is_some_and(|at| self.words[at / 64] >> (at % 64) & 1 == 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn members_are_numbered_in_array_order(bits in prop::collection::vec(any::<bool>(), 7 * 5 * 6)) {
            let voxel_box = VoxelBox { first_ijk: [3, 1, 2], shape_ijk: [7, 5, 6] };
            let voxel = |at: usize| voxel_box.voxel(at).map(|v| v as isize);
            let members: Vec<[isize; 3]> = (0..bits.len()).filter(|at| bits[*at]).map(voxel).collect();
            // The members are added in reverse, because their order must not matter.
            let set = VoxelSet::new(voxel_box, members.iter().rev().copied());
            for (n, member) in members.iter().enumerate() {
                prop_assert_eq!(set.place(*member), Some(n as u32));
            }
            for at in (0..bits.len()).filter(|at| !bits[*at]) {
                prop_assert_eq!(set.place(voxel(at)), None);
                prop_assert!(!set.holds(voxel(at)));
            }
            prop_assert_eq!(set.place([2, 1, 2]), None);
            for at in 0..bits.len() {
                let middle = voxel(at);
                let beside = |x: isize| set.place([middle[0] + x, middle[1], middle[2]]);
                let (first, are_members) = set.three(middle).unwrap();
                prop_assert_eq!(are_members, [-1, 0, 1].map(|x| beside(x).is_some()));
                if let Some(place) = [-1, 0, 1].into_iter().find_map(beside) {
                    prop_assert_eq!(first, place);
                }
            }
            prop_assert_eq!(set.three([3, 6, 2]), None);
            for (low, high) in [(3, 9), (4, 7), (9, 9), (6, 5)] {
                for (j, k) in [(1, 2), (3, 4), (5, 7)] {
                    let found: Vec<(isize, u32)> = set.in_row(low..=high, j, k).collect();
                    let expected: Vec<(isize, u32)> =
                        (low..=high).filter_map(|i| Some((i, set.place([i, j, k])?))).collect();
                    prop_assert_eq!(found, expected);
                }
            }
        }
    }
}
