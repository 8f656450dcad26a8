//! Smooth field from a mask of the lumen, for the external view of the airway tree.

use rayon::prelude::*;

/// Value of [`smoothed_mask`] at a voxel whose neighbours are all in the mask.
pub(crate) const FULL: i16 = 1024;

/// Blur a mask (0 outside, other values inside) with the weights 1 2 1 along each axis to values in `0 ..= 1024`.
///
/// The surface at half of the largest value is that of the mask, with rounded voxel steps. A branch one voxel thick
/// keeps the value 256, so a surface drawn at a lower value loses no branch.
#[must_use]
pub fn smoothed_mask(mask: &[u8], [nz, ny, nx]: [usize; 3]) -> Vec<i16> {
    let plane = ny * nx;
    let mut out: Vec<i16> = mask
        .par_iter()
        .map(|&m| if m == 0 { 0 } else { FULL / 64 })
        .collect();
    if out.is_empty() {
        return out;
    }
    // The blur is within a slice along x and y, then across slices; the edge voxel is repeated.
    out.par_chunks_mut(plane).for_each(|slice| {
        for row in slice.chunks_mut(nx) {
            blur(row, 1, nx);
        }
        for x in 0..nx {
            blur(&mut slice[x..], nx, ny);
        }
    });
    let flat = out.clone();
    out.par_chunks_mut(plane)
        .enumerate()
        .for_each(|(z, slice)| {
            let (before, after) = (z.saturating_sub(1), (z + 1).min(nz - 1));
            for (n, v) in slice.iter_mut().enumerate() {
                *v = flat[before * plane + n] + 2 * flat[z * plane + n] + flat[after * plane + n];
            }
        });
    out
}

fn blur(line: &mut [i16], stride: usize, count: usize) {
    let mut before = line[0];
    for n in 0..count {
        let here = line[n * stride];
        let after = line[(n + 1).min(count - 1) * stride];
        line[n * stride] = before + 2 * here + after;
        before = here;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_mask_is_full_and_a_single_voxel_has_the_binomial_weights() {
        assert!(
            smoothed_mask(&[1; 60], [3, 4, 5])
                .iter()
                .all(|&v| v == FULL)
        );
        let mut mask = [0u8; 5 * 5 * 5];
        mask[62] = 9;
        let out = smoothed_mask(&mask, [5, 5, 5]);
        assert_eq!(out[62], 128);
        assert_eq!(out[61], 64);
        assert_eq!(out[62 + 25 + 5], 32);
        assert_eq!(out[62 + 25 + 5 + 1], 16);
        assert_eq!(out.iter().map(|&v| i32::from(v)).sum::<i32>(), 1024);
    }

    #[test]
    fn a_branch_one_voxel_thick_has_a_quarter_of_the_full_value() {
        let mut mask = [0u8; 5 * 5 * 5];
        for z in 0..5 {
            mask[z * 25 + 12] = 1;
        }
        assert_eq!(smoothed_mask(&mask, [5, 5, 5])[62], 256);
    }
}
