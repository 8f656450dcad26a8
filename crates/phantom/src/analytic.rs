//! Small volumes with analytic ground truth, on any grid, for tests and benchmarks of the other crates.

use carina_grid::{Grid, dot, length};

use crate::shapes::{Piece, cover, direction, mix, sub};

/// Return the HU of each voxel from a signed distance at its centre.
///
/// The HU is `inside_hu` for distances below 0 and `outside_hu` above, with a soft edge of about a voxel.
fn filled(
    grid: &Grid,
    inside_hu: i16,
    outside_hu: i16,
    distance: impl Fn([f64; 3]) -> f64,
) -> Vec<i16> {
    let sigma_mm = 0.3 * grid.min_spacing_mm();
    (0..grid.num_voxels())
        .map(|n| {
            let p = grid.lps_from_ijk().point(grid.voxel(n).map(|v| v as f64));
            let share = cover(distance(p), sigma_mm);
            (mix(f64::from(outside_hu), f64::from(inside_hu), share) + 0.5).floor() as i16
        })
        .collect()
}

/// Return a volume with an infinite straight tube of air in soft tissue.
///
/// The HU is -1000 within `radius_mm` of the line through `a_lps` and `b_lps`, and 40 outside.
#[must_use]
pub fn tube(grid: &Grid, a_lps: [f64; 3], b_lps: [f64; 3], radius_mm: f64) -> Vec<i16> {
    let axis = direction(sub(b_lps, a_lps));
    filled(grid, -1000, 40, |p| {
        let from = sub(p, a_lps);
        let t = dot(from, axis);
        length(std::array::from_fn(|k| from[k] - t * axis[k])) - radius_mm
    })
}

/// Return a volume with a stem of air in soft tissue that divides into two branches.
///
/// The stem and its branches are three tubes of one radius with round ends that meet in `fork_lps`.
#[must_use]
pub fn y_junction(
    grid: &Grid,
    stem_lps: [f64; 3],
    fork_lps: [f64; 3],
    ends_lps: [[f64; 3]; 2],
    radius_mm: f64,
) -> Vec<i16> {
    let arms = [stem_lps, ends_lps[0], ends_lps[1]].map(|end| Piece {
        start: fork_lps,
        end,
        start_radius: radius_mm,
        end_radius: radius_mm,
    });
    filled(grid, -1000, 40, |p| {
        arms.iter()
            .map(|arm| arm.distance(p).0)
            .fold(f64::INFINITY, f64::min)
    })
}

/// Return a volume of concentric shells without soft edges.
///
/// The value is `values_hu[n]` between the radii `radii_mm[n - 1]` and `radii_mm[n]` (ascending), and the last value
/// outside all of them.
///
/// # Panics
///
/// Panics if there is not exactly one value more than radii.
#[must_use]
pub fn shells(grid: &Grid, centre_lps: [f64; 3], radii_mm: &[f64], values_hu: &[i16]) -> Vec<i16> {
    assert_eq!(
        values_hu.len(),
        radii_mm.len() + 1,
        "shells need one value more than radii"
    );
    (0..grid.num_voxels())
        .map(|n| {
            let p = grid.lps_from_ijk().point(grid.voxel(n).map(|v| v as f64));
            let r = length(sub(p, centre_lps));
            values_hu[radii_mm.iter().take_while(|&&edge| r >= edge).count()]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use carina_grid::Affine;

    fn grid() -> Grid {
        // The grid is anisotropic and rotated by 90 degrees in plane, so that swapped axes cannot pass.
        let m = Affine::from_columns(
            [0.0, 0.7, 0.0],
            [-0.9, 0.0, 0.0],
            [0.0, 0.0, 1.3],
            [20.0, -15.0, -12.0],
        );
        Grid::new([20, 44, 43], m).unwrap()
    }

    #[test]
    fn a_tube_has_its_radius_and_its_half_value_on_the_surface() {
        let g = grid();
        let radius = 4.0;
        let hu = tube(&g, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0], radius);
        let per_slice = g.shape_ijk()[0] * g.shape_ijk()[1];
        let dark = hu[5 * per_slice..6 * per_slice]
            .iter()
            .filter(|&&v| v < -480)
            .count();
        let area = dark as f64 * 0.7 * 0.9;
        let found = (area / core::f64::consts::PI).sqrt();
        // The tolerance is 3 %, for 80 voxels of which some 30 are on the edge.
        assert!((found - radius).abs() < 0.03 * radius, "{found}");
    }

    #[test]
    fn a_y_junction_is_open_from_the_stem_into_both_arms() {
        let g = grid();
        let hu = y_junction(
            &g,
            [0.0, 0.0, 10.0],
            [0.0, 0.0, 0.0],
            [[8.0, 3.0, -10.0], [-8.0, -3.0, -10.0]],
            2.5,
        );
        let at = |p: [f64; 3]| hu[g.index(g.voxel_at(g.to_ijk(carina_grid::Lps(p))).unwrap())];
        for p in [[0.0, 0.0, 9.0], [4.0, 1.5, -5.0], [-4.0, -1.5, -5.0]] {
            assert!(at(p) < -900, "{p:?}");
        }
        assert!(at([0.0, 0.0, -9.0]) > 0);
    }

    #[test]
    fn values_of_shells_follow_from_the_radius() {
        let g = grid();
        let hu = shells(&g, [0.0, 0.0, 0.0], &[4.0, 8.0], &[1, 2, 3]);
        for (n, &v) in hu.iter().enumerate() {
            let r = length(g.lps_from_ijk().point(g.voxel(n).map(|c| c as f64)));
            assert_eq!(
                v,
                if r < 4.0 {
                    1
                } else if r < 8.0 {
                    2
                } else {
                    3
                }
            );
        }
    }
}
