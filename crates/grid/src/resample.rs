//! Trilinear values of a volume on the voxels of another grid.

use rayon::prelude::*;

use crate::{Affine, VolumeView};

/// Return the trilinear values of a volume on the voxels of another grid, x fastest.
///
/// A volume extends half a voxel beyond the centres of its outer voxels, where the values of its edge are repeated.
///
/// # Arguments
///
/// * `view` - the volume.
/// * `ijk_from_voxel` - map from the voxels of the other grid to those of the volume.
/// * `shape_ijk` - number of voxels of the other grid on each axis.
/// * `outside` - value outside the volume.
#[must_use]
pub fn resampled(
    view: VolumeView<'_, i16>,
    ijk_from_voxel: &Affine,
    shape_ijk: [usize; 3],
    outside: f32,
) -> Vec<f32> {
    let [num_x, num_y, num_z] = shape_ijk;
    let mut found = vec![outside; num_x * num_y * num_z];
    if !found.is_empty() {
        found
            .par_chunks_mut(num_x)
            .enumerate()
            .for_each(|(row, out)| {
                resample_row(view, ijk_from_voxel, [row % num_y, row / num_y], out);
            });
    }
    found
}

/// Write the values of one row, given by its y and z, inside the volume.
fn resample_row(
    view: VolumeView<'_, i16>,
    ijk_from_voxel: &Affine,
    [y, z]: [usize; 2],
    out: &mut [f32],
) {
    let [nx, ny, nz] = view.grid().shape_ijk();
    let data = view.data();
    for (x, value) in out.iter_mut().enumerate() {
        let point = ijk_from_voxel.point([x as f64, y as f64, z as f64]);
        let (Some(i), Some(j), Some(k)) = (
            between(point[0], nx),
            between(point[1], ny),
            between(point[2], nz),
        ) else {
            continue;
        };
        let row = |k: usize, j: usize| {
            let first = (k * ny + j) * nx;
            i.mixed(
                f64::from(data[first + i.low]),
                f64::from(data[first + i.high]),
            )
        };
        let plane = |k: usize| j.mixed(row(k, j.low), row(k, j.high));
        *value = k.mixed(plane(k.low), plane(k.high)) as f32;
    }
}

/// Position between two neighbouring voxels along one axis.
struct Between {
    low: usize,
    high: usize,
    share: f64,
}

impl Between {
    /// Return the value at this position, interpolated linearly between the values of the two voxels.
    fn mixed(&self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.share
    }
}

/// Return the voxels on both sides of a position; `None` more than half a voxel outside an axis of `num` voxels.
fn between(at: f64, num: usize) -> Option<Between> {
    if !(at >= -0.5 && at <= num as f64 - 0.5) {
        return None;
    }
    let inside = at.clamp(0.0, num as f64 - 1.0);
    let low = inside as usize;
    Some(Between {
        low,
        high: (low + 1).min(num - 1),
        share: inside - low as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Grid;

    #[test]
    fn values_are_linear_inside_repeated_at_the_edge_and_replaced_outside() {
        let data: Vec<i16> = (0..24)
            .map(|n| (n % 4 + 10 * (n / 4 % 3) + 100 * (n / 12)) as i16)
            .collect();
        let grid = Grid::new([2, 3, 4], Affine::IDENTITY).unwrap();
        let view = VolumeView::new(&data, &grid).unwrap();
        // Half steps along x from -1, at y = 0.5 and z = 0.25.
        let map = Affine::from_columns(
            [0.5, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [-1.0, 0.5, 0.25],
        );
        let out = resampled(view, &map, [10, 1, 1], -7.0);
        let base = 5.0 + 25.0;
        let expected = [
            -7.0,
            base,
            base,
            base + 0.5,
            base + 1.0,
            base + 1.5,
            base + 2.0,
            base + 2.5,
            base + 3.0,
            base + 3.0,
        ];
        assert_eq!(out, expected);
    }
}
