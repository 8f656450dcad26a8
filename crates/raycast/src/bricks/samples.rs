//! Values and gradients of a volume, kept in bricks: what light at every sample reads.
//!
//! Value and gradient between voxels take 32 voxels in twelve places, of which neighbouring samples take most again. At
//! voxels the gradient is a central difference of integers and exact. Kept beside the value, four int16 for a voxel, a
//! sample is four reads, of two voxels each (docs/decisions/0103).

use super::store::{CELLS, Fill, MOST_BRICKS, Numbers, PER_BRICK, STRIDE, Store, VOXELS};
use crate::Field;

/// Bricks of values and gradients of one volume: at each voxel the value and the differences along i, j and k between the
/// voxels after it and before it.
#[derive(Debug)]
pub struct SampleBricks {
    store: Store,
}

impl SampleBricks {
    /// No brick yet, for a volume of this shape.
    #[must_use]
    pub fn of(shape_ijk: [usize; 3]) -> Self {
        Self::with_room(shape_ijk, MOST_BRICKS)
    }

    /// The same with room for so many bricks.
    #[must_use]
    pub fn with_room(shape_ijk: [usize; 3], most: usize) -> Self {
        Self {
            store: Store::new(shape_ijk, most),
        }
    }

    /// Whether they are of a volume of this shape. That it has the same values is the caller's word.
    #[must_use]
    pub fn fit(&self, shape_ijk: [usize; 3]) -> bool {
        self.store.shape == shape_ijk
    }

    /// Bricks kept.
    #[must_use]
    pub fn len(&self) -> usize {
        self.store.len()
    }

    /// Whether no brick is kept.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether no further brick can be kept: what lies in others is read from the volume.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.store.is_full()
    }
}

impl Fill for SampleBricks {
    fn store(&self) -> &Store {
        &self.store
    }

    /// False, too, where a difference is no int16.
    fn fill(&self, field: &Field<'_>, number: usize) -> bool {
        let brick = self.store.brick(number);
        let filled = || filled(field, brick);
        self.store.fill(number, filled).is_some()
    }
}

fn filled(field: &Field<'_>, brick: [usize; 3]) -> Option<Numbers> {
    // Places in memory of the voxels from the one before the brick to the one after it, held at the edge.
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
