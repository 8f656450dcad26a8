//! Bricks (cubes of voxels) with the values and gradients of a volume, for pictures that are shaded at every sample.
//!
//! Without bricks, an interpolated value with its gradient is computed from 32 voxels at twelve addresses, and
//! neighbouring samples read most of these voxels again. A brick stores four int16 per voxel: its value, and the three
//! central differences, which are exact integers. With bricks, a sample takes four reads of two voxels each
//! (docs/decisions/0132).

use super::store::{CELLS, Fill, MAX_BRICKS, Numbers, PER_BRICK, STRIDE, Store, VOXELS};
use crate::Field;

/// Cached bricks of the values and gradients of one volume.
///
/// Each voxel has its value and the differences along i, j and k between the voxels after it and before it.
#[derive(Debug)]
pub struct SampleBricks {
    store: Store,
}

impl SampleBricks {
    /// Create an empty cache for a volume of a given shape.
    #[must_use]
    pub fn of(shape_ijk: [usize; 3]) -> Self {
        Self::with_capacity(shape_ijk, MAX_BRICKS)
    }

    /// Create an empty cache with a capacity of `most` bricks, for a volume of a given shape.
    #[must_use]
    pub fn with_capacity(shape_ijk: [usize; 3], most: usize) -> Self {
        Self {
            store: Store::new(shape_ijk, most),
        }
    }

    /// Return whether the bricks were created for a volume of this shape.
    ///
    /// The caller must ensure that the volume has the same values.
    #[must_use]
    pub fn fit(&self, shape_ijk: [usize; 3]) -> bool {
        self.store.shape == shape_ijk
    }

    /// Return the number of bricks that are in the cache.
    #[must_use]
    pub fn len(&self) -> usize {
        self.store.len()
    }

    /// Return whether no brick is stored.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Return whether the cache is full; cells without a stored brick are then read from the volume.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.store.is_full()
    }
}

impl Fill for SampleBricks {
    fn store(&self) -> &Store {
        &self.store
    }

    /// Compute a brick's values and gradients; return false if the cache is full or a difference does not fit an int16.
    fn fill(&self, field: &Field<'_>, number: usize) -> bool {
        let brick = self.store.brick(number);
        let filled = || filled(field, brick);
        self.store.fill(number, filled).is_some()
    }
}

fn filled(field: &Field<'_>, brick: [usize; 3]) -> Option<Numbers> {
    // Memory offsets along each axis of the voxels from the one before the brick to the one after it, clamped at the
    // edge.
    let places: [[usize; VOXELS + 2]; 3] = std::array::from_fn(|a| {
        std::array::from_fn(|n| {
            let voxel = (brick[a] * CELLS + n).saturating_sub(1);
            voxel.min(field.last[a] as usize) * field.stride[a]
        })
    });
    let at =
        |[i, j, k]: [usize; 3]| i32::from(field.data[places[0][i] + places[1][j] + places[2][k]]);
    let mut numbers = Box::new([0; PER_BRICK]);
    for k in 0..VOXELS {
        for j in 0..VOXELS {
            for i in 0..VOXELS {
                let voxel = [i + 1, j + 1, k + 1];
                let to = i * STRIDE[0] + j * STRIDE[1] + k * STRIDE[2];
                numbers[to] = at(voxel) as i16;
                for a in 0..3 {
                    let (mut before, mut after) = (voxel, voxel);
                    before[a] -= 1;
                    after[a] += 1;
                    numbers[to + 1 + a] = i16::try_from(at(after) - at(before)).ok()?;
                }
            }
        }
    }
    Some(numbers)
}
