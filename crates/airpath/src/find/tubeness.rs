//! Enclosure of a voxel by brighter walls, which distinguishes the inside of a small airway from the lung round it.
//!
//! The wall of a bronchus of a few voxels is blurred: its lumen may be as bright as lung, or brighter, and its wall no
//! brighter than a vessel's rim. The shape remains visible: from the middle of the lumen the values rise in all
//! directions but the two along the tube (three at a fork). So rays start at the voxel, each gives the rise of
//! the values along it, and the *enclosure* is the rise that all but a fifth of the rays reach. The enclosure needs no
//! estimate of direction or scale. A voxel beside one vessel, or between two, is enclosed on some sides only.

use carina_grid::{Grid, VolumeView};
use rayon::prelude::*;

/// Length of the rays from a voxel, mm.
///
/// Rays of this length reach the wall of an airway up to 4 mm wide; the two open ends of such an airway take a fifth of
/// the rays.
pub const REACH_MM: f64 = 3.0;

/// Number of rays from a voxel, distributed evenly over all directions.
const NUM_RAYS: usize = 48;
/// Number of rays that may meet no wall in an airway: those to both ends of the tube, or to all three of a fork.
const NUM_OPEN: usize = 10;

/// Return the volume smoothed with a kernel of three voxels on each axis, which removes the finest noise.
///
/// The sigma of the kernel is 0.6 of the smallest spacing. An axis with much longer voxels is not smoothed.
#[must_use]
pub fn smoothed(values: VolumeView<'_, i16>) -> Vec<i16> {
    let grid = values.grid();
    let [nx, ny, nz] = grid.shape_ijk();
    let sigma_mm = 0.6 * grid.min_spacing_mm();
    let side = grid
        .spacing_mm()
        .map(|s| (-0.5 * (s / sigma_mm).powi(2)).exp() as f32);
    let [wx, wy, wz] = side.map(|w| [w / (1.0 + 2.0 * w), 1.0 / (1.0 + 2.0 * w)]);
    let data = values.data();
    let slice = nx * ny;
    let mut out = vec![0i16; data.len()];
    out.par_chunks_mut(slice).enumerate().for_each_init(
        || (vec![0f32; slice], vec![0f32; nx]),
        |(mixed, row), (k, out)| {
            let at = |k: usize| &data[k * slice..(k + 1) * slice];
            let (below, here, above) = (at(k.saturating_sub(1)), at(k), at((k + 1).min(nz - 1)));
            for (n, m) in mixed.iter_mut().enumerate() {
                let sides = f32::from(below[n]) + f32::from(above[n]);
                *m = wz[1] * f32::from(here[n]) + wz[0] * sides;
            }
            for j in 0..ny {
                let line = |j: usize| &mixed[j * nx..(j + 1) * nx];
                let (before, here, after) = (
                    line(j.saturating_sub(1)),
                    line(j),
                    line((j + 1).min(ny - 1)),
                );
                for (n, r) in row.iter_mut().enumerate() {
                    *r = wy[1] * here[n] + wy[0] * (before[n] + after[n]);
                }
                for i in 0..nx {
                    let sides = row[i.saturating_sub(1)] + row[(i + 1).min(nx - 1)];
                    out[j * nx + i] = (wx[1] * row[i] + wx[0] * sides).round() as i16;
                }
            }
        },
    );
    out
}

/// Rays from a voxel on one grid, by which the enclosure is measured.
#[derive(Debug)]
pub struct Enclosure {
    shape: [isize; 3],
    /// Voxels of each ray in order, as offsets (i, j, k) from the ray's origin.
    rays: Vec<Vec<[isize; 3]>>,
    /// Voxels of each ray as memory offsets, for voxels that are not near the volume's faces.
    steps: Vec<Vec<isize>>,
    margin: [isize; 3],
}

impl Enclosure {
    /// Create rays of length `reach_mm` for a grid.
    #[must_use]
    pub fn new(grid: &Grid, reach_mm: f64) -> Self {
        let spacing = grid.spacing_mm();
        // A ray has at least one voxel on each axis, for any spacing.
        let coarsest = spacing.into_iter().fold(0.0, f64::max);
        let reach_mm = reach_mm.max(1.01 * coarsest);
        let step_mm = 0.5 * grid.min_spacing_mm();
        let rays: Vec<Vec<[isize; 3]>> = directions()
            .map(|along| {
                let mut ray: Vec<[isize; 3]> = Vec::new();
                let num_steps = (reach_mm / step_mm) as usize;
                for s in 1..=num_steps {
                    let offset: [isize; 3] = std::array::from_fn(|a| {
                        (s as f64 * step_mm * along[a] / spacing[a]).round() as isize
                    });
                    if offset != [0; 3] && ray.last() != Some(&offset) {
                        ray.push(offset);
                    }
                }
                ray
            })
            .collect();
        let [nx, ny, nz] = grid.shape_ijk().map(|n| n as isize);
        let steps = rays
            .iter()
            .map(|ray| ray.iter().map(|o| o[0] + nx * (o[1] + ny * o[2])).collect())
            .collect();
        let margin = std::array::from_fn(|a| (reach_mm / spacing[a]).ceil() as isize + 1);
        Self {
            shape: [nx, ny, nz],
            rays,
            steps,
            margin,
        }
    }

    /// Return the enclosure of a voxel: the rise in value that all but a fifth of the rays meet; below 0 on a wall.
    #[must_use]
    pub fn at(&self, smooth: &[i16], voxel: usize) -> i16 {
        let [nx, ny, nz] = self.shape;
        let at = voxel as isize;
        let ijk = [at % nx, at / nx % ny, at / nx / ny];
        let own = smooth[voxel];
        let mut rises = [i16::MIN; NUM_RAYS];
        if (0..3).all(|a| ijk[a] >= self.margin[a] && ijk[a] < self.shape[a] - self.margin[a]) {
            for (rise, ray) in rises.iter_mut().zip(&self.steps) {
                let mut most = i16::MIN;
                for step in ray {
                    most = most.max(smooth[(at + step) as usize]);
                }
                *rise = most.saturating_sub(own);
            }
        } else {
            // Positions outside the volume do not count as wall.
            for (rise, ray) in rises.iter_mut().zip(&self.rays) {
                let mut most = own;
                for offset in ray {
                    let [i, j, k] = std::array::from_fn(|a| ijk[a] + offset[a]);
                    if i < 0 || j < 0 || k < 0 || i >= nx || j >= ny || k >= nz {
                        break;
                    }
                    most = most.max(smooth[(i + nx * (j + ny * k)) as usize]);
                }
                *rise = most.saturating_sub(own);
            }
        }
        *rises.select_nth_unstable(NUM_OPEN).1
    }

    /// Return whether the enclosure of a voxel is `rise` or more.
    ///
    /// The result equals the comparison of [`Enclosure::at`] with `rise`, but is computed faster.
    #[must_use]
    pub fn reaches(&self, smooth: &[i16], voxel: usize, rise: i16) -> bool {
        let [nx, ny, _] = self.shape;
        let at = voxel as isize;
        let ijk = [at % nx, at / nx % ny, at / nx / ny];
        if !(0..3).all(|a| ijk[a] >= self.margin[a] && ijk[a] < self.shape[a] - self.margin[a]) {
            return self.at(smooth, voxel) >= rise;
        }
        let wall = smooth[voxel].saturating_add(rise);
        let mut num_open = 0;
        for ray in &self.steps {
            if !ray.iter().any(|step| smooth[(at + step) as usize] >= wall) {
                num_open += 1;
                if num_open > NUM_OPEN {
                    return false;
                }
            }
        }
        true
    }
}

/// Return unit vectors distributed evenly over the sphere (a Fibonacci lattice).
fn directions() -> impl Iterator<Item = [f64; 3]> {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..NUM_RAYS).map(move |n| {
        let z = 1.0 - (2 * n + 1) as f64 / NUM_RAYS as f64;
        let across = (1.0 - z * z).sqrt();
        let (sin, cos) = (golden * n as f64).sin_cos();
        [across * cos, across * sin, z]
    })
}

/// Section across a tube: the share of its sides with a wall, and the distance of the wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Section {
    /// Share of the directions across the tube in which the values rise enough for a wall, 0 to 1.
    pub walled: f64,
    /// Median distance in mm from the middle of a tube to the place where half of the rise to its wall is reached.
    pub radius_mm: f64,
    /// Median rise of the values from the middle of a tube to its wall.
    pub rise: f64,
}

/// Number of directions, evenly across a tube, in which its section is measured.
const NUM_SIDES: usize = 16;

/// Measure the section at a voxel across a tube in direction `along` (unit vector in mm along the grid's axes).
///
/// `rise` is the smallest rise of the values that counts as wall; `reach_mm` is the largest distance examined.
#[must_use]
pub fn section(
    smooth: VolumeView<'_, i16>,
    voxel: [usize; 3],
    along: [f64; 3],
    rise: f64,
    reach_mm: f64,
) -> Section {
    let grid = smooth.grid();
    let spacing = grid.spacing_mm();
    let step_mm = 0.5 * grid.min_spacing_mm();
    let num_steps = (reach_mm / step_mm) as usize;
    let smallest = (0..3)
        .min_by(|a, b| along[*a].abs().total_cmp(&along[*b].abs()))
        .unwrap_or(0);
    let mut helper = [0.0; 3];
    helper[smallest] = 1.0;
    let across = carina_grid::unit(carina_grid::cross(along, helper)).unwrap_or([1.0, 0.0, 0.0]);
    let up = carina_grid::cross(along, across);
    let own = f64::from(smooth.at(voxel));
    let mut walls = [0.0; NUM_SIDES];
    let mut rises = [0.0; NUM_SIDES];
    let mut num_walls = 0;
    let mut profile = vec![0.0; num_steps + 1];
    for side in 0..NUM_SIDES {
        let (sin, cos) = (std::f64::consts::TAU * side as f64 / NUM_SIDES as f64).sin_cos();
        profile[0] = own;
        for (s, value) in profile.iter_mut().enumerate().skip(1) {
            let off = s as f64 * step_mm;
            let at = std::array::from_fn(|a| {
                voxel[a] as f64 + off * (cos * across[a] + sin * up[a]) / spacing[a]
            });
            *value = f64::from(carina_leastcost::lumen::interpolated(smooth, at));
        }
        // Only the rise up to the first wall counts, because further rises do not belong to this tube.
        let mut peak = 0;
        for s in 1..profile.len() {
            if profile[s] > profile[peak] {
                peak = s;
            } else if profile[peak] - own >= rise && profile[s] < profile[peak] - rise {
                break;
            }
        }
        if profile[peak] - own < rise {
            continue;
        }
        let half = 0.5 * (own + profile[peak]);
        let first = (1..=peak).find(|s| profile[*s] >= half).unwrap_or(peak);
        let (low, high) = (profile[first - 1], profile[first]);
        let share = if high > low {
            ((half - low) / (high - low)).clamp(0.0, 1.0)
        } else {
            1.0
        };
        walls[num_walls] = step_mm * (first as f64 - 1.0 + share);
        rises[num_walls] = profile[peak] - own;
        num_walls += 1;
    }
    let walls = &mut walls[..num_walls];
    walls.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        walls
            .get((share * num_walls.saturating_sub(1) as f64).round() as usize)
            .copied()
            .unwrap_or(0.0)
    };
    Section {
        walled: num_walls as f64 / NUM_SIDES as f64,
        radius_mm: quantile(0.5),
        rise: {
            rises[..num_walls].sort_by(f64::total_cmp);
            rises[..num_walls]
                .get(num_walls / 2)
                .copied()
                .unwrap_or(0.0)
        },
    }
}

#[cfg(test)]
mod tests {
    use carina_grid::Affine;
    use proptest::prelude::*;

    use super::*;

    fn grid(shape_zyx: [usize; 3], spacing: [f64; 3]) -> Grid {
        let [x, y, z] = spacing;
        let place = Affine::from_columns(
            [x, 0.0, 0.0],
            [0.0, y, 0.0],
            [0.0, 0.0, z],
            [3.0, -4.0, 5.0],
        );
        Grid::new(shape_zyx, place).unwrap()
    }

    /// Compute the result of [`smoothed`] from its definition: a product of three weights, neighbours clamped to the
    /// edge.
    fn smoothed_slowly(values: VolumeView<'_, i16>) -> Vec<i16> {
        let grid = values.grid();
        let sigma = 0.6 * grid.min_spacing_mm();
        let side = grid
            .spacing_mm()
            .map(|s| (-0.5 * (s / sigma).powi(2)).exp());
        (0..grid.num_voxels())
            .map(|at| {
                let voxel = grid.voxel(at).map(|v| v as isize);
                let (mut sum, mut weights) = (0.0, 0.0);
                for cell in 0..27isize {
                    let offset = [cell % 3 - 1, cell / 3 % 3 - 1, cell / 9 - 1];
                    let weight: f64 = (0..3)
                        .map(|a| if offset[a] == 0 { 1.0 } else { side[a] })
                        .product();
                    let near = std::array::from_fn(|a| voxel[a] + offset[a]);
                    sum += weight * f64::from(values.at_clamped(near));
                    weights += weight;
                }
                (sum / weights).round() as i16
            })
            .collect()
    }

    /// Compute the enclosure of a voxel without the faster path for voxels away from the faces.
    fn enclosed_slowly(enclosure: &Enclosure, smooth: VolumeView<'_, i16>, voxel: usize) -> i16 {
        let shape = smooth.grid().shape_ijk().map(|n| n as isize);
        let from = smooth.grid().voxel(voxel).map(|v| v as isize);
        let mut rises: Vec<i16> = enclosure
            .rays
            .iter()
            .map(|ray| {
                let seen = ray
                    .iter()
                    .map(|o| std::array::from_fn(|a| from[a] + o[a]))
                    .take_while(|at: &[isize; 3]| (0..3).all(|a| (0..shape[a]).contains(&at[a])))
                    .map(|at| smooth.at_clamped(at));
                let is_inside = (0..3).all(|a| {
                    from[a] >= enclosure.margin[a] && from[a] < shape[a] - enclosure.margin[a]
                });
                let own = smooth.data()[voxel];
                let least = if is_inside { i16::MIN } else { own };
                seen.fold(least, i16::max).saturating_sub(own)
            })
            .collect();
        rises.sort_unstable();
        rises[NUM_OPEN]
    }

    proptest! {
        #[test]
        fn the_fast_kernels_equal_their_definitions(
            seed in 0u64..1000,
            spacing in proptest::array::uniform3(0.5f64..3.0),
        ) {
            let grid = grid([9, 13, 16], spacing);
            let mut state = seed;
            let values: Vec<i16> = (0..grid.num_voxels())
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    ((state >> 40) % 1200) as i16 - 1000
                })
                .collect();
            let view = VolumeView::new(&values, &grid).unwrap();
            let fast = smoothed(view);
            for (a, b) in fast.iter().zip(smoothed_slowly(view)) {
                // Tolerance: one unit, because f32 and f64 may differ at a rounding tie.
                prop_assert!((i32::from(*a) - i32::from(b)).abs() <= 1);
            }
            let enclosure = Enclosure::new(&grid, REACH_MM);
            let smooth = VolumeView::new(&fast, &grid).unwrap();
            for voxel in 0..grid.num_voxels() {
                let found = enclosure.at(&fast, voxel);
                prop_assert_eq!(found, enclosed_slowly(&enclosure, smooth, voxel));
                for rise in [found - 1, found, found + 1, 100] {
                    prop_assert_eq!(enclosure.reaches(&fast, voxel, rise), found >= rise);
                }
            }
        }
    }

    /// Draw lung at -860 HU with a tube in direction `along`: lumen and wall, both blurred.
    fn tube(grid: &Grid, along: [f64; 3], radius: f64, wall_mm: f64) -> Vec<i16> {
        let middle = grid.shape_ijk().map(|n| n as f64 / 2.0);
        let spacing = grid.spacing_mm();
        (0..grid.num_voxels())
            .map(|at| {
                let v = grid.voxel(at);
                let p: [f64; 3] = std::array::from_fn(|a| (v[a] as f64 - middle[a]) * spacing[a]);
                let off = carina_grid::length(carina_grid::cross(p, along));
                let air = 1.0 / (1.0 + ((off - radius) / 0.25).exp());
                let tissue = 1.0 / (1.0 + ((off - radius - wall_mm) / 0.25).exp()) - air;
                (-860.0 + 800.0 * tissue - 140.0 * air).round() as i16
            })
            .collect()
    }

    #[test]
    fn the_middle_of_a_thin_tube_is_enclosed_and_lung_beside_it_is_not() {
        let grid = grid([41, 45, 49], [0.7, 0.8, 0.9]);
        for along in [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.64, 0.48]] {
            let values = tube(&grid, along, 0.9, 0.6);
            let smooth = smoothed(VolumeView::new(&values, &grid).unwrap());
            let enclosure = Enclosure::new(&grid, REACH_MM);
            let middle = grid.shape_ijk().map(|n| n / 2);
            assert!(enclosure.at(&smooth, grid.index(middle)) > 150, "{along:?}");
            // The voxel `beside` is 2.5 mm from the axis, outside the wall.
            let helper = if along[0] > 0.9 {
                [0.0, 1.0, 0.0]
            } else {
                [1.0, 0.0, 0.0]
            };
            let off = carina_grid::unit(carina_grid::cross(along, helper)).unwrap();
            let beside: [usize; 3] = std::array::from_fn(|a| {
                (middle[a] as f64 + 2.5 * off[a] / grid.spacing_mm()[a]).round() as usize
            });
            assert!(enclosure.at(&smooth, grid.index(beside)) < 40, "{along:?}");
        }
    }

    #[test]
    fn a_section_has_the_tubes_radius_and_the_share_of_its_open_side() {
        let grid = grid([41, 45, 49], [0.5, 0.55, 0.6]);
        let along = [0.6, 0.64, 0.48];
        let mut values = tube(&grid, along, 1.5, 0.9);
        let smooth = smoothed(VolumeView::new(&values, &grid).unwrap());
        let middle = grid.shape_ijk().map(|n| n / 2);
        let closed = section(
            VolumeView::new(&smooth, &grid).unwrap(),
            middle,
            along,
            60.0,
            REACH_MM,
        );
        assert_eq!(closed.walled, 1.0);
        // The drawn wall is blurred to half its height, so its half-way level is 0.2 mm inside the drawn edge. A
        // further 0.15 mm allows for the voxel's centre, which is off the axis.
        assert!((closed.radius_mm - 1.3).abs() < 0.15, "{closed:?}");
        // One half of the tube has no wall, only lung.
        let limit = middle[0] as f64;
        for (at, value) in values.iter_mut().enumerate() {
            if grid.voxel(at)[0] as f64 > limit {
                *value = -1000;
            }
        }
        let smooth = smoothed(VolumeView::new(&values, &grid).unwrap());
        let open = section(
            VolumeView::new(&smooth, &grid).unwrap(),
            middle,
            along,
            60.0,
            REACH_MM,
        );
        assert!((0.3..0.75).contains(&open.walled), "{open:?}");
    }
}
