//! Softer copy of a CT: the amplification of fine detail by a sharp reconstruction kernel is approximately reversed.

use carina_grid::VolumeView;
use rayon::prelude::*;

use crate::find::extension_reach::Faces;
use crate::find::tubeness::{Enclosure, REACH_MM, smoothed};

/// One of the Gaussian blurs whose weighted sum [`mixed`] computes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blur {
    /// Weight of this Gaussian in the sum of Gaussians.
    pub weight: f64,
    /// Standard deviation of the Gaussian, mm.
    pub sigma_mm: f64,
}

/// Distance in sigmas beyond which a Gaussian is truncated.
const REACH_SIGMAS: f64 = 3.0;
/// Sigma in voxels below which a Gaussian is replaced by no blur, because its weights for the next voxel are
/// negligible.
const NARROWEST_VOX: f64 = 0.25;

/// Return `own` times the volume plus the weighted `blurs` of the volume along the axes that are `blurred`.
///
/// Beyond a face of the volume the values at the face are used.
#[must_use]
pub fn mixed(
    values: VolumeView<'_, i16>,
    own: f64,
    blurs: &[Blur],
    blurred: [bool; 3],
) -> Vec<i16> {
    let grid = values.grid();
    let [nx, ny, nz] = grid.shape_ijk();
    let spacing = grid.spacing_mm();
    let kernels: Vec<[Vec<f32>; 3]> = blurs
        .iter()
        .map(|blur| {
            std::array::from_fn(|a| {
                weights(if blurred[a] {
                    blur.sigma_mm / spacing[a]
                } else {
                    0.0
                })
            })
        })
        .collect();
    let data = values.data();
    let slice = nx * ny;
    let mut out = vec![0i16; data.len()];
    out.par_chunks_mut(slice).enumerate().for_each_init(
        || SliceBuffers::new(nx, ny),
        |buffers, (k, out)| {
            let at = |k: usize| &data[k * slice..(k + 1) * slice];
            for (sum, value) in buffers.sum.iter_mut().zip(at(k)) {
                *sum = own as f32 * f32::from(*value);
            }
            for (blur, [wx, wy, wz]) in blurs.iter().zip(&kernels) {
                for (mean, value) in buffers.across.iter_mut().zip(at(k)) {
                    *mean = wz[0] * f32::from(*value);
                }
                for (n, weight) in wz.iter().enumerate().skip(1) {
                    let (below, above) = (at(k.saturating_sub(n)), at((k + n).min(nz - 1)));
                    for ((mean, low), high) in buffers.across.iter_mut().zip(below).zip(above) {
                        *mean += weight * (f32::from(*low) + f32::from(*high));
                    }
                }
                buffers.blur_slice(blur.weight as f32, wx, wy);
            }
            for (value, sum) in out.iter_mut().zip(&buffers.sum) {
                *value = sum.round() as i16;
            }
        },
    );
    out
}

/// Parameters with which air is restored where the sharp kernel darkened voxels below the lowest value of the CT.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutOff {
    /// Lowest voxel value of the sharp volume, at which darker values were clipped.
    pub floor: i16,
    /// Voxel value of air in the softened volume.
    pub air: i16,
    /// Voxel value of the softened volume up to which a voxel is certainly air.
    pub certain: i16,
    /// Minimum rise in value from a clipped lumen to its wall; a voxel with less rise is not in an airway.
    pub rise: i16,
    /// Width of the dark seam on the lumen side of a wall that a sharp kernel creates, mm.
    pub seam_mm: f64,
}

/// Set the clipped voxels of airway lumens in `soft` to the value of air; return the number of these voxels.
///
/// A sharp kernel makes the lumen along a wall, and all of a small lumen, darker than air. Files have a lowest value;
/// darker values are lost, and the softened lumen becomes too bright. The dark rims beside vessels and pleura are
/// clipped as well, but they touch no voxel that is certainly air, and have tissue on one side only.
pub fn keep_cut_off_air(sharp: VolumeView<'_, i16>, soft: &mut [i16], cut: &CutOff) -> usize {
    let smooth = smoothed(sharp);
    let enclosure = Enclosure::new(sharp.grid(), REACH_MM);
    let mut clipped_air: Vec<u32> = soft
        .par_iter()
        .zip(sharp.data())
        .enumerate()
        .filter(|(at, (soft, sharp))| {
            **sharp <= cut.floor && **soft > cut.air && enclosure.reaches(&smooth, *at, cut.rise)
        })
        .map(|(at, _)| at as u32)
        .collect();
    // The search starts beside voxels that are certainly air and continues through clipped voxels up to the width of a
    // seam.
    let faces = Faces::new(sharp);
    let is_cut = |at: usize, soft: &[i16]| sharp.data()[at] <= cut.floor && soft[at] > cut.certain;
    // A lung voxel that is dark because of noise does not count as air: air has air or clipped voxels on all sides.
    let is_air = |at: usize| {
        let mut is_inside = soft[at] <= cut.certain;
        if is_inside {
            faces.each(at, |next, _| {
                is_inside &= soft[next] <= cut.certain || sharp.data()[next] <= cut.floor;
            });
        }
        is_inside
    };
    let mut wave: Vec<u32> = (0..soft.len() as u32)
        .into_par_iter()
        .filter(|at| {
            let mut touches_air = false;
            if is_cut(*at as usize, soft) {
                faces.each(*at as usize, |next, _| {
                    touches_air = touches_air || is_air(next);
                });
            }
            touches_air
        })
        .collect();
    let num_steps = (cut.seam_mm / sharp.grid().min_spacing_mm())
        .round()
        .max(1.0) as usize;
    for step in 1..=num_steps {
        for at in &wave {
            soft[*at as usize] = cut.air;
        }
        clipped_air.extend_from_slice(&wave);
        if step < num_steps {
            let mut next_wave = Vec::new();
            for at in &wave {
                faces.each(*at as usize, |next, _| {
                    if is_cut(next, soft) {
                        next_wave.push(next as u32);
                    }
                });
            }
            next_wave.sort_unstable();
            next_wave.dedup();
            wave = next_wave;
        }
    }
    for at in &clipped_air {
        soft[*at as usize] = soft[*at as usize].min(cut.air);
    }
    clipped_air.sort_unstable();
    clipped_air.dedup();
    clipped_air.len()
}

/// Buffers in which one thread blurs one slice along its two axes.
struct SliceBuffers {
    shape: [usize; 2],
    sum: Vec<f32>,
    across: Vec<f32>,
    row: Vec<f32>,
    /// Row of the slice, extended beyond both ends by its edge values.
    wide: Vec<f32>,
}

impl SliceBuffers {
    fn new(nx: usize, ny: usize) -> Self {
        Self {
            shape: [nx, ny],
            sum: vec![0.0; nx * ny],
            across: vec![0.0; nx * ny],
            row: vec![0.0; nx],
            wide: Vec::new(),
        }
    }

    /// Blur `across` along y and x, and add the result times `weight` to `sum`.
    fn blur_slice(&mut self, weight: f32, wx: &[f32], wy: &[f32]) {
        let [nx, ny] = self.shape;
        let reach = wx.len() - 1;
        self.wide.resize(nx + 2 * reach, 0.0);
        for j in 0..ny {
            let line = |j: usize| &self.across[j * nx..(j + 1) * nx];
            for (mean, value) in self.row.iter_mut().zip(line(j)) {
                *mean = wy[0] * value;
            }
            for (n, w) in wy.iter().enumerate().skip(1) {
                let (before, after) = (line(j.saturating_sub(n)), line((j + n).min(ny - 1)));
                for ((mean, low), high) in self.row.iter_mut().zip(before).zip(after) {
                    *mean += w * (low + high);
                }
            }
            self.wide[..reach].fill(self.row[0]);
            self.wide[reach..reach + nx].copy_from_slice(&self.row);
            self.wide[reach + nx..].fill(self.row[nx - 1]);
            let sum = &mut self.sum[j * nx..(j + 1) * nx];
            for (n, w) in wx.iter().enumerate() {
                let w = weight * w * if n == 0 { 0.5 } else { 1.0 };
                let (before, after) = (&self.wide[reach - n..], &self.wide[reach + n..]);
                for ((total, low), high) in sum.iter_mut().zip(before).zip(after) {
                    *total += w * (low + high);
                }
            }
        }
    }
}

/// Return one half of a Gaussian's weights, from the middle outwards; together with their mirror image they sum to 1.
fn weights(sigma_vox: f64) -> Vec<f32> {
    if sigma_vox < NARROWEST_VOX {
        return vec![1.0];
    }
    let reach = (REACH_SIGMAS * sigma_vox).ceil() as usize;
    let half: Vec<f64> = (0..=reach)
        .map(|n| (-0.5 * (n as f64 / sigma_vox).powi(2)).exp())
        .collect();
    let total = 2.0 * half.iter().sum::<f64>() - half[0];
    half.iter().map(|w| (w / total) as f32).collect()
}

#[cfg(test)]
mod tests {
    use carina_grid::{Affine, Grid};
    use proptest::prelude::*;

    use super::*;

    /// Compute the result of [`mixed`] directly from its definition: each blur is a sum over all voxels within its
    /// radius.
    fn mixed_slowly(
        values: VolumeView<'_, i16>,
        own: f64,
        blurs: &[Blur],
        blurred: [bool; 3],
    ) -> Vec<f64> {
        let grid = values.grid();
        let spacing = grid.spacing_mm();
        (0..grid.num_voxels())
            .map(|at| {
                let voxel = grid.voxel(at).map(|v| v as isize);
                let near = |offset: [isize; 3]| {
                    f64::from(values.at_clamped(std::array::from_fn(|a| voxel[a] + offset[a])))
                };
                let mut sum = own * near([0; 3]);
                for blur in blurs {
                    let half: [Vec<f64>; 3] = std::array::from_fn(|a| {
                        let sigma = if blurred[a] {
                            blur.sigma_mm / spacing[a]
                        } else {
                            0.0
                        };
                        weights(sigma).iter().map(|w| f64::from(*w)).collect()
                    });
                    let [x, y, z] = std::array::from_fn(|a| half[a].len() as isize - 1);
                    for i in -x..=x {
                        for j in -y..=y {
                            for k in -z..=z {
                                let weight = half[0][i.unsigned_abs()]
                                    * half[1][j.unsigned_abs()]
                                    * half[2][k.unsigned_abs()];
                                sum += blur.weight * weight * near([i, j, k]);
                            }
                        }
                    }
                }
                sum
            })
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_separable_blurs_equal_the_sums_of_their_definition(
            seed in 0u64..1000,
            spacing in proptest::array::uniform3(0.5f64..3.0),
            sigma_mm in 0.3f64..1.6,
            blurred in proptest::array::uniform3(any::<bool>()),
        ) {
            let place = Affine::from_columns(
                [spacing[0], 0.0, 0.0],
                [0.0, spacing[1], 0.0],
                [0.0, 0.0, spacing[2]],
                [3.0, -4.0, 5.0],
            );
            let grid = Grid::new([5, 7, 9], place).unwrap();
            let mut state = seed;
            let values: Vec<i16> = (0..grid.num_voxels())
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    ((state >> 40) % 1200) as i16 - 1000
                })
                .collect();
            let view = VolumeView::new(&values, &grid).unwrap();
            let blurs = [Blur { weight: 0.4, sigma_mm }, Blur { weight: 0.25, sigma_mm: 1.5 * sigma_mm }];
            let fast = mixed(view, 0.35, &blurs, blurred);
            for (a, b) in fast.iter().zip(mixed_slowly(view, 0.35, &blurs, blurred)) {
                // The tolerance is half a unit of rounding plus the difference between f32 and f64.
                prop_assert!((f64::from(*a) - b).abs() <= 0.51);
            }
        }
    }

    #[test]
    fn a_clipped_lumen_becomes_air_and_a_clipped_rim_beside_tissue_does_not() {
        let place =
            Affine::from_columns([0.7, 0.0, 0.0], [0.0, 0.7, 0.0], [0.0, 0.0, 0.7], [0.0; 3]);
        let grid = Grid::new([24, 32, 40], place).unwrap();
        let values: Vec<i16> = (0..grid.num_voxels())
            .map(|at| {
                let [i, j, _] = grid.voxel(at);
                let (x, y) = (i as f64 - 12.0, j as f64 - 16.0);
                let off = x.hypot(y);
                match i {
                    // The volume has tissue from i = 30 on, and in front of the tissue a dark rim two voxels wide.
                    30.. => 40,
                    28..30 => -1024,
                    _ if off <= 1.2 => -1024,
                    _ if off <= 3.2 => -300,
                    _ => -870,
                }
            })
            .collect();
        let mut soft = vec![-800i16; values.len()];
        let found = keep_cut_off_air(VolumeView::new(&values, &grid).unwrap(), &mut soft, &CUT);
        let at = |i, j| soft[grid.index([i, j, 12])];
        assert_eq!(
            (at(12, 16), at(29, 16), at(28, 5), at(5, 5)),
            (-1000, -800, -800, -800)
        );
        assert!(found >= 12 * 5);
    }

    /// Parameters of the restoration of clipped air in these tests.
    const CUT: CutOff = CutOff {
        floor: -1024,
        air: -1000,
        certain: -950,
        rise: 250,
        seam_mm: 1.4,
    };

    #[test]
    fn clipped_voxels_along_the_wall_of_a_wide_airway_become_air_up_to_the_seam_width() {
        let place =
            Affine::from_columns([0.7, 0.0, 0.0], [0.0, 0.7, 0.0], [0.0, 0.0, 0.7], [0.0; 3]);
        let grid = Grid::new([12, 12, 60], place).unwrap();
        // The first part has wide air with a dark seam and a wall; the second has lung with an equally dark seam of
        // tissue alone.
        let sharp: Vec<i16> = (0..grid.num_voxels())
            .map(|at| match grid.voxel(at)[0] {
                0..20 => -1005,
                20..24 | 50..54 => -1024,
                28..50 => -870,
                _ => 40,
            })
            .collect();
        let mut soft: Vec<i16> = sharp
            .iter()
            .map(|v| if *v == -1024 { -860 } else { *v })
            .collect();
        let found = keep_cut_off_air(VolumeView::new(&sharp, &grid).unwrap(), &mut soft, &CUT);
        let at = |i| soft[grid.index([i, 6, 6])];
        assert_eq!(
            [20, 21, 22, 23, 51].map(at),
            [-1000, -1000, -860, -860, -860]
        );
        assert_eq!(found, 2 * 12 * 12);
    }

    #[test]
    fn weights_that_sum_to_one_do_not_change_a_uniform_volume() {
        let grid = Grid::new(
            [4, 5, 6],
            Affine::from_columns([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]),
        )
        .unwrap();
        let values = vec![-873i16; grid.num_voxels()];
        let blurs = [
            Blur {
                weight: 0.3,
                sigma_mm: 0.8,
            },
            Blur {
                weight: 0.2,
                sigma_mm: 1.4,
            },
        ];
        let found = mixed(
            VolumeView::new(&values, &grid).unwrap(),
            0.5,
            &blurs,
            [true; 3],
        );
        assert_eq!(found, values);
    }
}
