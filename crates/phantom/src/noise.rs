use rayon::prelude::*;

use crate::random::mixed;

/// Weight of the centre in the in-plane 3 x 3 kernel, which smooths slightly, as a soft-tissue reconstruction does.
const CENTRE: f32 = 0.62;
/// Weight of each of the four neighbours by edges in the in-plane 3 x 3 kernel.
const SIDE: f32 = 0.30;
/// Weight of each of the four neighbours by corners in the in-plane 3 x 3 kernel.
const CORNER: f32 = 0.145;

/// Add noise of standard deviation `sigma_hu` to slice `z`; the noise depends only on seed and position.
///
/// The noise is white noise that depends on seed and voxel, made correlated in plane by a kernel.
pub(crate) fn add_noise(slice: &mut [f32], width: usize, z: usize, seed: u64, sigma_hu: f64) {
    if sigma_hu <= 0.0 {
        return;
    }
    let height = slice.len() / width;
    // The noise has one more voxel on each side, so that it has the same statistics at the edge.
    let stride = width + 2;
    let key = mixed(seed ^ mixed(z as u64));
    let white: Vec<f32> = (0..stride * (height + 2))
        .map(|n| white(mixed(key.wrapping_add(n as u64))))
        .collect();
    let power = CENTRE * CENTRE + 4.0 * (SIDE * SIDE + CORNER * CORNER);
    let gain = sigma_hu as f32 / power.sqrt();
    for (y, row) in slice.chunks_mut(width).enumerate() {
        let [above, own, below] = [y, y + 1, y + 2].map(|r| &white[r * stride..(r + 1) * stride]);
        for (x, value) in row.iter_mut().enumerate() {
            let sides = own[x] + own[x + 2] + above[x + 1] + below[x + 1];
            let corners = above[x] + above[x + 2] + below[x] + below[x + 2];
            *value += gain * (CENTRE * own[x + 1] + SIDE * sides + CORNER * corners);
        }
    }
}

/// Return an approximately normal number with variance 1 from 64 random bits.
///
/// The number is the sum of four uniform numbers of 16 bits (Irwin-Hall).
fn white(bits: u64) -> f32 {
    let sum: u64 = (0..4).map(|n| (bits >> (16 * n)) & 0xffff).sum();
    // The sum has mean 2 * 65535 and variance 4 * 65536^2 / 12.
    (sum as f32 - 131_070.0) * (1.0 / 37_837.2)
}

/// Add noise to all slices, and round their values to integer HU within the range of a scanner.
pub(crate) fn finish(
    values: &mut [f32],
    out: &mut [i16],
    width: usize,
    slice_len: usize,
    first_z: usize,
    seed: u64,
    sigma_hu: f64,
) {
    values
        .par_chunks_mut(slice_len)
        .zip(out.par_chunks_mut(slice_len))
        .enumerate()
        .for_each(|(n, (slice, out))| {
            add_noise(slice, width, first_z + n, seed, sigma_hu);
            for (hu, &value) in out.iter_mut().zip(slice.iter()) {
                *hu = (value.clamp(-1024.0, 3071.0) + 0.5).floor() as i16;
            }
        });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_requested_deviation_and_is_correlated_in_plane() {
        let (width, height) = (200, 150);
        let mut slice = vec![0.0f32; width * height];
        add_noise(&mut slice, width, 7, 99, 20.0);
        let n = slice.len() as f32;
        let mean = slice.iter().sum::<f32>() / n;
        let variance = slice.iter().map(|v| (v - mean) * (v - mean)).sum::<f32>() / n;
        // The tolerance is 3 %, for 30 000 samples of which some 8 000 are independent.
        assert!((variance.sqrt() - 20.0).abs() < 0.6, "{}", variance.sqrt());
        assert!(mean.abs() < 1.0, "{mean}");
        let neighbours: f32 = slice
            .chunks(width)
            .flat_map(|row| row.windows(2).map(|w| w[0] * w[1]))
            .sum::<f32>()
            / n;
        assert!(neighbours / variance > 0.3, "{}", neighbours / variance);
    }
}
