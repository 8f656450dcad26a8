//! Maximum intensity projections along the three grid axes in one pass (paper 3.1, X-ray views).

use carina_grid::VolumeView;
use rayon::prelude::*;

/// Largest value along each grid axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Projections {
    /// Along i: `[k, j]`.
    pub along_i: Vec<i16>,
    /// Along j: `[k, i]`.
    pub along_j: Vec<i16>,
    /// Along k: `[j, i]`.
    pub along_k: Vec<i16>,
}

/// All three projections; each voxel is read once.
#[must_use]
pub fn maximum_projections(volume: VolumeView<'_, i16>) -> Projections {
    let [ni, nj, nk] = volume.grid().shape_ijk();
    let mut along_i = vec![i16::MIN; nk * nj];
    let mut along_j = vec![i16::MIN; nk * ni];
    let along_k = volume
        .data()
        .par_chunks(nj * ni)
        .zip(along_i.par_chunks_mut(nj))
        .zip(along_j.par_chunks_mut(ni))
        .fold(
            || vec![i16::MIN; nj * ni],
            |mut flat, ((slice, of_row), of_column)| {
                for ((row, flat), most) in slice.chunks(ni).zip(flat.chunks_mut(ni)).zip(of_row) {
                    *most = row.iter().copied().fold(i16::MIN, i16::max);
                    raise(flat, row);
                    raise(of_column, row);
                }
                flat
            },
        )
        .reduce(
            || vec![i16::MIN; nj * ni],
            |mut a, b| {
                raise(&mut a, &b);
                a
            },
        );
    Projections {
        along_i,
        along_j,
        along_k,
    }
}

fn raise(to: &mut [i16], by: &[i16]) {
    for (a, &b) in to.iter_mut().zip(by) {
        *a = (*a).max(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use carina_grid::{Affine, Grid};

    #[test]
    fn each_projection_is_the_largest_value_along_its_axis() {
        let grid = Grid::new([3, 4, 5], Affine::IDENTITY).unwrap();
        let data: Vec<i16> = (0..60).map(|n| (n * 37 % 61 - 30) as i16).collect();
        let volume = VolumeView::new(&data, &grid).unwrap();
        let found = maximum_projections(volume);
        let most = |f: &dyn Fn(usize) -> [usize; 3], n: usize| {
            (0..n).map(|m| volume.at(f(m))).max().unwrap()
        };
        for k in 0..3 {
            for j in 0..4 {
                assert_eq!(found.along_i[k * 4 + j], most(&|i| [i, j, k], 5));
            }
            for i in 0..5 {
                assert_eq!(found.along_j[k * 5 + i], most(&|j| [i, j, k], 4));
            }
        }
        for j in 0..4 {
            for i in 0..5 {
                assert_eq!(found.along_k[j * 5 + i], most(&|k| [i, j, k], 3));
            }
        }
    }
}
