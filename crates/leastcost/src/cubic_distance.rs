//! Exact Euclidean distance transform of a mask of cubic voxels, with a limit.
//!
//! One pass per axis. The squared distance after a pass is the least sum, over the voxels of a line, of the squared
//! distance before the pass and the squared step along the line. A row of voxels is compared as a whole with its
//! neighbours at increasing steps, until no step can lower its greatest value. In the masks of segmentation this is
//! faster than the lower envelopes of [`crate::distance`], because most voxels are near an edge and rows are processed
//! with vector instructions.

use rayon::prelude::*;

/// Return the squared distance, in voxels, from each inside voxel to the nearest outside voxel.
///
/// The distance is 0 outside, and infinite where no outside voxel is at most `limit` voxels away. Voxels beyond the
/// faces of the grid do not count as outside. Indices run x fastest.
///
/// # Panics
///
/// Panics if `inside` does not have one value per voxel of `shape_ijk`.
#[must_use]
pub fn squared_distances(inside: &[bool], shape_ijk: [usize; 3], limit: f32) -> Vec<f32> {
    let [nx, ny, nz] = shape_ijk;
    assert_eq!(inside.len(), nx * ny * nz, "one value per voxel");
    if inside.is_empty() {
        return Vec::new();
    }
    let mut found = vec![0.0_f32; inside.len()];
    found
        .par_chunks_mut(nx)
        .zip(inside.par_chunks(nx))
        .for_each(|(row, inside)| along_row(row, inside));
    let mut before = found.clone();
    // The rows of one line are `apart` rows apart.
    for (apart, length) in [(1, ny), (ny, nz)] {
        before.copy_from_slice(&found);
        found.par_chunks_mut(nx).enumerate().for_each(|(n, row)| {
            lower(
                row,
                &before,
                n * nx,
                n / apart % length,
                length,
                apart * nx,
                limit,
            );
        });
    }
    let most = limit * limit;
    found
        .par_iter_mut()
        .filter(|value| **value > most)
        .for_each(|value| *value = f32::INFINITY);
    found
}

/// Return the approximate distance in mm from the centre of each inside voxel to the nearest face of an outside voxel.
///
/// The distance is computed as that between the two voxel centres, less half a voxel and at least a quarter of one,
/// rounded to a thousandth of a millimetre. It is 0 outside, and infinite where the distance between the centres
/// exceeds `reach_mm` by more than half a voxel.
///
/// # Panics
///
/// Panics if `inside` does not have one value per voxel of `shape_ijk`.
#[must_use]
pub fn ball_distances_mm(
    inside: &[bool],
    shape_ijk: [usize; 3],
    step_mm: f64,
    reach_mm: f64,
) -> Vec<f32> {
    // The margin includes voxels at exactly this distance, whatever the rounding of the quotient.
    let limit = (reach_mm / step_mm + 0.5 + 1e-3) as f32;
    let mut found = squared_distances(inside, shape_ijk, limit);
    let greatest = found
        .iter()
        .copied()
        .filter(|value| value.is_finite())
        .fold(0.0, f32::max);
    let mm: Vec<f32> = (0..=greatest as u32)
        .map(|squared| {
            let away = (f64::from(squared).sqrt() - 0.5).max(0.25) * step_mm;
            if squared == 0 {
                0.0
            } else {
                ((away * 1e3).round_ties_even() / 1e3) as f32
            }
        })
        .collect();
    found.par_iter_mut().for_each(|value| {
        if value.is_finite() {
            *value = mm[*value as usize];
        }
    });
    found
}

/// Set the squared distances of the voxels along one row.
fn along_row(row: &mut [f32], inside: &[bool]) {
    let mut steps = f32::INFINITY;
    for (value, &is_inside) in row.iter_mut().zip(inside) {
        steps = if is_inside { steps + 1.0 } else { 0.0 };
        *value = steps * steps;
    }
    steps = f32::INFINITY;
    for (value, &is_inside) in row.iter_mut().zip(inside).rev() {
        steps = if is_inside { steps + 1.0 } else { 0.0 };
        *value = value.min(steps * steps);
    }
}

/// Lower each entry of a row to the minimum, over the rows of its line, of an entry plus the squared row distance.
fn lower(
    row: &mut [f32],
    before: &[f32],
    first: usize,
    at: usize,
    length: usize,
    stride: usize,
    limit: f32,
) {
    let mut greatest = row.iter().copied().fold(0.0, f32::max);
    for step in 1..length {
        let squared = (step * step) as f32;
        if squared >= greatest || step as f32 > limit {
            break;
        }
        let mut take = |from: usize| {
            for (value, &other) in row.iter_mut().zip(&before[from..]) {
                let sum = other + squared;
                *value = if sum < *value { sum } else { *value };
            }
        };
        if at >= step {
            take(first - step * stride);
        }
        if at + step < length {
            take(first + step * stride);
        }
        greatest = row.iter().copied().fold(0.0, f32::max);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::distance::{NOWHERE, nearest_outside};
    use proptest::prelude::*;

    const SHAPE: [usize; 3] = [9, 7, 8];

    proptest! {
        #[test]
        fn squared_distances_equal_those_to_the_nearest_outside_voxel_up_to_the_limit(
            share in 0.005..0.3_f64,
            seed in prop::collection::vec(0.0..1.0_f64, SHAPE[0] * SHAPE[1] * SHAPE[2]),
            limit in prop_oneof![Just(f32::INFINITY), 0.5_f32..9.0],
        ) {
            let inside: Vec<bool> = seed.iter().map(|&value| value > share).collect();
            let found = squared_distances(&inside, SHAPE, limit);
            let nearest = nearest_outside(SHAPE, [1.0; 3], |at| !inside[at]);
            let place = |at: usize| [at % SHAPE[0], at / SHAPE[0] % SHAPE[1], at / SHAPE[0] / SHAPE[1]];
            for (at, &value) in found.iter().enumerate() {
                let expected = if nearest[at] == NOWHERE {
                    f32::INFINITY
                } else {
                    let (p, q) = (place(at), place(nearest[at] as usize));
                    (0..3).map(|axis| (p[axis].abs_diff(q[axis]) as f32).powi(2)).sum()
                };
                if expected <= limit * limit {
                    prop_assert_eq!(value, expected);
                } else {
                    prop_assert_eq!(value, f32::INFINITY);
                }
            }
        }
    }

    #[test]
    fn distances_in_mm_end_at_faces_and_at_the_limit() {
        let inside = [false, true, true, true, true];
        let mm = |reach_mm| ball_distances_mm(&inside, [5, 1, 1], 0.8, reach_mm);
        assert_eq!(mm(f64::INFINITY), [0.0, 0.4, 1.2, 2.0, 2.8]);
        assert_eq!(mm(1.2), [0.0, 0.4, 1.2, f32::INFINITY, f32::INFINITY]);
    }

    #[test]
    fn a_grid_without_voxels_has_no_distances() {
        assert!(squared_distances(&[], [0, 3, 4], 5.0).is_empty());
    }
}
