//! Tests of cross-sections of drawn tubes: round and elliptical, any direction, anisotropic voxels, walls thinner than
//! the blur.

use carina_grid::{Affine, Grid, Ijk, VolumeView, cross, dot, unit};
use proptest::prelude::*;

use crate::section::cross_section::{Plane, Section, cast_plane, cast_planes, voxel_in_plane_mm};
use crate::section::deblur::{Blur, half_maximum_mm, true_thickness_mm};
use crate::section::profile::{SectionLevels, value_at};
use crate::section::rays::{Cast, NUM_RAYS, plane_axes};
use crate::tree::smooth::Point;
use carina_leastcost::Unwatched;

/// Value levels of the drawn lumen and wall.
const LEVELS: SectionLevels = SectionLevels {
    min_contrast: 100.0,
    brightest_wall: 100.0,
    wall_rise: 1020.0,
    noise: 5.0,
};
/// Blur of the drawn tubes, as a standard deviation in mm.
const SIGMA_MM: f64 = 0.5;

/// Straight tube with an elliptical lumen and a wall, blurred by a Gaussian.
struct Tube {
    centre: Point,
    axis: Point,
    /// Half widths of the lumen along the two axes of the plane, mm.
    half_mm: [f64; 2],
    wall_mm: f64,
    /// Value behind the wall.
    outside: f64,
    /// Distance from the axis, along the first axis, beyond which there is tissue again (a vessel); infinite for none.
    vessel_mm: f64,
}

/// Size of a pixel of a drawn section, mm.
const PIXEL_MM: f64 = 0.1;
/// Half of the width of a drawn section, mm.
const PICTURE_MM: f64 = 14.0;

impl Tube {
    fn new(axis: Point, half_mm: [f64; 2], wall_mm: f64) -> Self {
        Self {
            centre: [0.3, -0.2, 0.4],
            axis: unit(axis).unwrap(),
            half_mm,
            wall_mm,
            outside: -870.0,
            vessel_mm: f64::INFINITY,
        }
    }

    fn sharp(&self, u: f64, v: f64) -> f64 {
        let [a, b] = self.half_mm;
        // The distance to an ellipse is computed to first order at its edge, which is exact for a circle.
        let k0 = (u / a).hypot(v / b);
        let k1 = (u / (a * a)).hypot(v / (b * b));
        let depth = if k1 < 1e-9 {
            -1.0
        } else {
            k0 * (k0 - 1.0) / k1
        };
        if depth < 0.0 {
            -1000.0
        } else if depth < self.wall_mm || u > self.vessel_mm {
            40.0
        } else {
            self.outside
        }
    }

    /// Return the image of the tube's section, blurred along both axes; a straight tube has the same section
    /// everywhere.
    fn picture(&self) -> Vec<f64> {
        let n = (2.0 * PICTURE_MM / PIXEL_MM) as usize;
        let at = |i: usize| (i as f64 + 0.5) * PIXEL_MM - PICTURE_MM;
        let reach = (4.0 * SIGMA_MM / PIXEL_MM) as isize;
        let kernel: Vec<f64> = (-reach..=reach)
            .map(|d| (-0.5 * (d as f64 * PIXEL_MM / SIGMA_MM).powi(2)).exp())
            .collect();
        let sum: f64 = kernel.iter().sum();
        let blurred = |picture: &[f64], step: (usize, usize)| -> Vec<f64> {
            (0..n * n)
                .map(|p| {
                    let [i, j] = [p % n, p / n];
                    let weighted = kernel.iter().enumerate().map(|(k, w)| {
                        let d = k as isize - reach;
                        let to = |x: usize, s: usize| {
                            (x as isize + d * s as isize).clamp(0, n as isize - 1) as usize
                        };
                        w * picture[to(j, step.1) * n + to(i, step.0)]
                    });
                    weighted.sum::<f64>() / sum
                })
                .collect()
        };
        let sharp: Vec<f64> = (0..n * n)
            .map(|p| self.sharp(at(p % n), at(p / n)))
            .collect();
        blurred(&blurred(&sharp, (1, 0)), (0, 1))
    }
}

fn grid(spacing: [f64; 3], half_mm: f64) -> Grid {
    let num = spacing.map(|s| (2.0 * half_mm / s) as usize + 1);
    let (s, c) = 0.3f64.sin_cos();
    let x = [c * spacing[0], s * spacing[0], 0.0];
    let y = [-s * spacing[1], c * spacing[1], 0.0];
    let z = [0.0, 0.0, spacing[2]];
    let middle: Point = std::array::from_fn(|a| {
        -0.5 * (x[a] * (num[0] - 1) as f64
            + y[a] * (num[1] - 1) as f64
            + z[a] * (num[2] - 1) as f64)
    });
    Grid::new(
        [num[2], num[1], num[0]],
        Affine::from_columns(x, y, z, middle),
    )
    .unwrap()
}

fn draw(grid: &Grid, tube: &Tube) -> Vec<i16> {
    let picture = tube.picture();
    let n = (2.0 * PICTURE_MM / PIXEL_MM) as usize;
    let (across, up) = plane_axes(tube.axis);
    (0..grid.num_voxels())
        .map(|at| {
            let p = grid.to_lps(Ijk(grid.voxel(at).map(|v| v as f64))).0;
            let off: Point = std::array::from_fn(|a| p[a] - tube.centre[a]);
            // The image is interpolated linearly between its pixels, which are much smaller than the blur; beyond the
            // image, the value at its border is used.
            let place = |mm: f64| ((mm + PICTURE_MM) / PIXEL_MM - 0.5).clamp(0.0, n as f64 - 1.001);
            let (u, v) = (place(dot(off, across)), place(dot(off, up)));
            let (i, j) = (u as usize, v as usize);
            let (s, t) = (u - i as f64, v - j as f64);
            let row = |j: usize| (1.0 - s) * picture[j * n + i] + s * picture[j * n + i + 1];
            ((1.0 - t) * row(j) + t * row(j + 1)).round() as i16
        })
        .collect()
}

/// Cast a section whose rays start a third of the lumen off its middle, so that the centre must be found.
fn cut(grid: &Grid, values: &[i16], tube: &Tube) -> Cast {
    let (across, _) = plane_axes(tube.axis);
    let least = tube.half_mm[0].min(tube.half_mm[1]);
    let centre = std::array::from_fn(|a| tube.centre[a] + 0.3 * least * across[a]);
    let view = VolumeView::new(values, grid).unwrap();
    let plane = Plane {
        centre,
        normal: tube.axis,
        radius_mm: least,
    };
    cast_plane(view, plane, LEVELS)
}

/// Return the blur of a profile in mm, which includes the interpolation between voxels.
///
/// Interpolation is a triangle as wide as two voxels, with a variance of a sixth of a voxel's square.
/// [`Blur::of_casts`] measures both together.
fn seen_sigma_mm(spacing_mm: f64) -> f64 {
    (SIGMA_MM * SIGMA_MM + spacing_mm * spacing_mm / 12.0).sqrt()
}

fn measure(grid: &Grid, tube: &Tube) -> Section {
    let values = draw(grid, tube);
    let cast = cut(grid, &values, tube);
    let [narrow, middle, wide] = {
        let mut spacing = grid.spacing_mm();
        spacing.sort_by(f64::total_cmp);
        spacing
    };
    let blur = Blur::new(
        grid,
        seen_sigma_mm(0.5 * (narrow + middle)),
        seen_sigma_mm(wide),
    );
    let voxel_mm = voxel_in_plane_mm(grid, plane_axes(tube.axis));
    Section::of_cast(&cast, Some(&blur), voxel_mm, LEVELS)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn a_tube_in_any_direction_is_measured_within_its_stated_error(
        axis in prop::array::uniform3(-1.0f64..1.0).prop_filter("long", |a| unit(*a).is_some() && dot(*a, *a) > 0.1),
        radius in 2.0f64..5.0,
        flat in 0.7f64..1.0,
        wall in 0.7f64..2.5,
        slice in 0.5f64..0.9,
    ) {
        let tube = Tube::new(axis, [radius, flat * radius], wall);
        let section = measure(&grid([0.6, 0.65, slice], radius + 8.0), &tube);
        let truth = 2.0 * radius * flat.sqrt();
        let off = (section.equivalent_mm - truth).abs();
        prop_assert!(off <= section.equivalent_error_mm, "{off} of {}", section.equivalent_error_mm);
        prop_assert!(off < 0.3, "{off}");
        // The tolerance is about half of the blur on each side; the error with the measured blur is much smaller (see
        // the previous assertion).
        prop_assert!(section.equivalent_error_mm < 0.6, "{}", section.equivalent_error_mm);
        let off = (section.min_mm - 2.0 * flat * radius).abs().max((section.max_mm - 2.0 * radius).abs());
        prop_assert!(off <= section.width_error_mm + 0.1, "{off} of {}", section.width_error_mm);
        let off = (section.wall_mm - wall).abs();
        prop_assert!(off <= section.wall_error_mm + 0.1, "{off} of {}", section.wall_error_mm);
        let away: Point = std::array::from_fn(|a| section.centre[a] - tube.centre[a]);
        let along = dot(away, tube.axis);
        let aside = (dot(away, away) - along * along).sqrt();
        prop_assert!(aside < 0.1, "{aside}");
    }

    #[test]
    fn the_value_between_voxels_is_exact_on_voxels_and_for_slopes(
        at in prop::array::uniform3(1.0f64..6.0),
        slope in prop::array::uniform3(-50.0f64..50.0),
    ) {
        let grid = grid([1.0, 1.2, 0.9], 5.0);
        let values: Vec<i16> = (0..grid.num_voxels())
            .map(|n| {
                let v = grid.voxel(n);
                (0..3).map(|a| slope[a].round() * v[a] as f64).sum::<f64>() as i16
            })
            .collect();
        let view = VolumeView::new(&values, &grid).unwrap();
        let expected: f64 = (0..3).map(|a| slope[a].round() * at[a]).sum();
        prop_assert!((f64::from(value_at(view, at)) - expected).abs() < 0.05);
        let voxel = at.map(f64::round);
        let index = voxel.map(|v| v as usize);
        prop_assert!((value_at(view, voxel) - f32::from(view.at(index))).abs() < 1e-2);
    }
}

#[test]
fn without_the_blur_correction_a_thin_wall_is_too_thick_and_its_lumen_too_narrow() {
    let tube = Tube::new([0.2, 0.3, 1.0], [3.0, 3.0], 0.8);
    let grid = grid([0.6; 3], 10.0);
    let values = draw(&grid, &tube);
    let cast = cut(&grid, &values, &tube);
    let raw = Section::of_cast(&cast, None, 0.6, LEVELS);
    assert!(raw.equivalent_mm < 5.8, "{}", raw.equivalent_mm);
    assert!(raw.wall_mm > 1.1, "{} {:?}", raw.wall_mm, &cast.rays[..4]);
    let section = measure(&grid, &tube);
    let off = (section.wall_mm - 0.8).abs();
    assert!(off < section.wall_error_mm && off < 0.25, "{off}");
    // The corrected error must be smaller than half of the raw error.
    let off = (section.equivalent_mm - 6.0).abs();
    assert!(off < section.equivalent_error_mm && off < 0.15, "{off}");
    assert!(section.shift_mm > 0.1);
}

#[test]
fn the_blur_is_measured_from_edges_against_thick_tissue() {
    let mut tube = Tube::new([0.1, 0.2, 1.0], [6.0, 6.0], 1.5);
    tube.outside = 40.0;
    let grid = grid([0.6; 3], 14.0);
    let values = draw(&grid, &tube);
    let view = VolumeView::new(&values, &grid).unwrap();
    let planes: Vec<Plane> = (0..8)
        .map(|n| Plane {
            centre: std::array::from_fn(|a| tube.centre[a] + 0.7 * f64::from(n) * tube.axis[a]),
            normal: tube.axis,
            radius_mm: 6.0,
        })
        .collect();
    let casts = cast_planes(view, &planes, LEVELS, &Unwatched).unwrap();
    let blur = Blur::of_casts(&grid, &casts).unwrap();
    // The interpolation between voxels adds 0.03 mm to the blur.
    assert!((blur.in_plane_mm - SIGMA_MM).abs() < 0.04, "{blur:?}");
    let section = Section::of_cast(&casts[0], Some(&blur), 0.6, LEVELS);
    assert!(section.wall_mm.is_nan(), "no far side");
    assert!(
        (section.equivalent_mm - 12.0).abs() < 0.15,
        "{}",
        section.equivalent_mm
    );
}

#[test]
fn rays_towards_a_vessel_at_the_wall_do_not_change_the_wall_thickness() {
    let mut tube = Tube::new([0.0, 0.1, 1.0], [3.0, 3.0], 1.2);
    tube.vessel_mm = 4.2;
    let section = measure(&grid([0.6; 3], 11.0), &tube);
    assert!(section.wall_share < 0.95, "{}", section.wall_share);
    assert!((section.wall_mm - 1.2).abs() < 0.15, "{}", section.wall_mm);
    assert!((section.equivalent_mm - 6.0).abs() < section.equivalent_error_mm);
}

#[test]
fn rays_that_leave_the_volume_are_reported_and_give_no_edges() {
    let tube = Tube::new([0.0, 0.0, 1.0], [4.0, 4.0], 1.2);
    // The volume ends 1 mm beside the axis.
    let whole = grid([0.6; 3], 4.0);
    let first: Point = std::array::from_fn(|a| whole.lps_from_ijk().rows()[a][3]);
    let [x, y, z] = [0, 1, 2].map(|a| whole.lps_from_ijk().column(a));
    let shifted: Point = std::array::from_fn(|a| first[a] - 3.0 * unit(x).unwrap()[a]);
    let [n, m, k] = whole.shape_zyx();
    let grid = Grid::new([n, m, k], Affine::from_columns(x, y, z, shifted)).unwrap();
    let section = measure(&grid, &tube);
    assert!(section.left_share > 0.3, "{}", section.left_share);
    assert!(!section.is_measured());
    assert!(section.wall_mm.is_nan());
}

#[test]
fn a_plane_in_solid_tissue_or_in_open_air_has_no_section() {
    let grid = grid([1.0; 3], 8.0);
    for fill in [40i16, -1000] {
        let values = vec![fill; grid.num_voxels()];
        let view = VolumeView::new(&values, &grid).unwrap();
        let plane = Plane {
            centre: [0.0; 3],
            normal: [0.0, 0.0, 1.0],
            radius_mm: 2.0,
        };
        let section = Section::of_cast(&cast_plane(view, plane, LEVELS), None, 1.0, LEVELS);
        assert!(!section.is_measured());
    }
}

#[test]
fn sections_do_not_depend_on_the_number_of_threads() {
    let tube = Tube::new([0.4, 0.3, 1.0], [3.0, 2.5], 1.0);
    let grid = grid([0.7, 0.7, 1.0], 10.0);
    let values = draw(&grid, &tube);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let view = VolumeView::new(&values, &grid).unwrap();
            let plane = |n: usize| Plane {
                centre: std::array::from_fn(|a| tube.centre[a] + 0.01 * n as f64 * tube.axis[a]),
                normal: tube.axis,
                radius_mm: 2.5,
            };
            let planes: Vec<Plane> = (0..100).map(plane).collect();
            let casts = cast_planes(view, &planes, LEVELS, &Unwatched).unwrap();
            format!(
                "{:?}",
                casts
                    .iter()
                    .map(|c| c.rays.map(|r| r.inner_mm))
                    .collect::<Vec<_>>()
            )
        })
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn true_and_half_maximum_thickness_are_inverse_and_the_axes_are_right_handed() {
    for wall in [0.5, 0.8, 1.3, 2.0, 4.0] {
        let found = true_thickness_mm(half_maximum_mm(wall, 0.6), 0.6);
        assert!((found - wall).abs() < 5e-3, "{wall} {found}");
    }
    // The half-maximum thickness of a thin wall is that of the blur itself, 2.355 sigma.
    assert!((half_maximum_mm(1e-3, 1.0) - 2.3548).abs() < 2e-3);
    for normal in [[0.0, 0.0, 1.0], [0.6, -0.8, 0.0], [-0.48, 0.6, -0.64]] {
        let (across, up) = plane_axes(normal);
        let back = cross(across, up);
        assert!((0..3).all(|a| (back[a] - normal[a]).abs() < 1e-12));
    }
    assert_eq!(NUM_RAYS % 2, 0, "widths add opposite rays");
}
