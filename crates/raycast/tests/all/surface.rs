//! Tests of first walls on shapes whose walls are known exactly.
//!
//! The result is equal from every caster, and for single pixels as for all pixels at once.

use crate::scene::{Scene, any_scene, options};
use carina_grid::{Affine, Camera, Grid, VolumeView, dot, length, unit};
use carina_isoregion::{SegmentTable, cell_map, class_labels, radius_map};
use carina_raycast::{
    ClassMap, Frame, Hit, InstructionSet, Method, Transfer, TransferTable, cast_surface, pick,
};
use proptest::prelude::*;

fn transparent_radius(scene: &Scene) -> Vec<u8> {
    let entries = scene.transfer(false).range(-1100, 3100);
    let labels = class_labels(&scene.hu, -1100, &entries, true)
        .unwrap()
        .labels;
    cell_map(&labels, scene.grid.shape_zyx()).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn first_walls_are_equal_for_every_caster_and_in_strips(
        mut scene in any_scene(), size in (1usize..30, 1usize..20), cut in 0.0f64..1.0, shaded in any::<bool>(),
    ) {
        scene.resize(size.0, size.1);
        let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
        let table = scene.table(false);
        // The light must not affect the first walls.
        let frame = Frame::new(volume, &table, scene.camera.clone(), options(shaded, false)).unwrap();
        let radius = transparent_radius(&scene);
        let truth = cast_surface(&frame, Method::Brute, 0..size.1, InstructionSet::Portable).unwrap().0;
        for simd in InstructionSet::available() {
            for method in [Method::Brute, Method::LeapTransparent(&radius)] {
                let rows = (cut * size.1 as f64) as usize;
                let mut found = cast_surface(&frame, method, 0..rows, simd).unwrap().0;
                found.extend(cast_surface(&frame, method, rows..size.1, simd).unwrap().0);
                prop_assert!(found == truth, "{} {method:?}", simd.name());
            }
        }
        // Each pick is a separate cast, so only some pixels of each scene are picked.
        for (n, hit) in truth.iter().enumerate().step_by(11) {
            let (column, row) = (n % size.0, n / size.0);
            prop_assert_eq!(&pick(&frame, Method::LeapTransparent(&radius), column, row).unwrap(), hit);
        }
    }

    #[test]
    fn first_walls_within_leaped_segments_equal_those_of_single_samples(scene in any_scene()) {
        let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
        let table = scene.table(false);
        let frame = Frame::new(volume, &table, scene.camera.clone(), options(false, false)).unwrap();
        let out = class_labels(&scene.hu, -1100, &scene.transfer(false).range(-1100, 3100), false).unwrap();
        let radius = radius_map(&out.labels, scene.grid.shape_zyx()).unwrap();
        let colours: Vec<_> = out.classes.iter().map(|class| table.entry(class.lo_hu)).collect();
        let segments = SegmentTable::new(&colours);
        let map = ClassMap { labels: &out.labels, radius: &radius, segments: &segments };
        let rows = 0..scene.camera.height();
        let brute = cast_surface(&frame, Method::Brute, rows.clone(), InstructionSet::best()).unwrap().0;
        let leap = cast_surface(&frame, Method::LeapClasses(map), rows, InstructionSet::best()).unwrap().0;
        for (a, b) in brute.iter().zip(&leap) {
            // The transparency of a segment is rounded once, that of its samples one by one.
            match (a, b) {
                (Some(a), Some(b)) => prop_assert!((a.depth_mm - b.depth_mm).abs() < 1e-3, "{a:?} {b:?}"),
                (a, b) => prop_assert!(a.is_none() && b.is_none()),
            }
        }
    }
}

/// Return a volume of air and tissue on an oblique, anisotropic grid, with an edge blurred as by a scanner.
///
/// The volume is air where `inside_mm` (the depth below the surface of the air) is positive.
fn phantom(inside_mm: impl Fn([f64; 3]) -> f64) -> (Grid, Vec<i16>) {
    let turn = |axis: usize, angle: f64| {
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut rows = *Affine::IDENTITY.rows();
        (rows[a][a], rows[b][b]) = (angle.cos(), angle.cos());
        (rows[a][b], rows[b][a]) = (-angle.sin(), angle.sin());
        Affine::from_rows(rows)
    };
    let turned = turn(0, 0.4).after(&turn(1, -0.3)).after(&turn(2, 0.7));
    let (spacing, shape) = ([0.7, 0.8, 1.0], [44, 54, 60]);
    let column = |a: usize| turned.column(a).map(|v| v * spacing[a]);
    let half = turned.vector([0, 1, 2].map(|a| -spacing[a] * (shape[2 - a] as f64 - 1.0) / 2.0));
    let grid = Grid::new(
        shape,
        Affine::from_columns(column(0), column(1), column(2), half),
    )
    .unwrap();
    let hu = (0..grid.num_voxels())
        .map(|index| {
            let at = grid
                .lps_from_ijk()
                .point(grid.voxel(index).map(|v| v as f64));
            // The edge is close to the error function of a blur of 0.6 mm, which soft kernels of scanners have.
            let tissue = (0.5 - inside_mm(at) / 2.6).clamp(0.0, 1.0);
            (-1000.0 + 1040.0 * tissue * tissue * (3.0 - 2.0 * tissue)) as i16
        })
        .collect();
    (grid, hu)
}

/// Check depths and normals of first walls, seen by a camera in the air, and return the number of walls checked.
///
/// `true_hit` returns the distance along a ray to the wall, and the wall's normal.
fn check_against(
    (grid, hu): &(Grid, Vec<i16>),
    camera: &Camera,
    true_hit: impl Fn([f64; 3], [f64; 3]) -> Option<(f64, [f64; 3])>,
) -> usize {
    let volume = VolumeView::new(hu, grid).unwrap();
    // The transfer function becomes opaque at the half-maximum of the edge, -480 HU.
    let points = vec![[-560.0, 0.9, 0.5, 0.4, 0.0], [-400.0, 0.9, 0.5, 0.4, 0.99]];
    let transfer = Transfer::new(points, 1.0, 1).unwrap();
    let table = TransferTable::new(&transfer, 0.25 * grid.min_spacing_mm(), -1024, 100).unwrap();
    let frame = Frame::new(volume, &table, camera.clone(), options(false, false)).unwrap();
    let (hits, _) = cast_surface(
        &frame,
        Method::Brute,
        0..camera.height(),
        InstructionSet::best(),
    )
    .unwrap();
    let (mut checked, mut sum_of_error) = (0, 0.0);
    for (n, hit) in hits.iter().enumerate() {
        let ray = camera.ray(n % camera.width(), n / camera.width());
        let Some((depth, normal)) = true_hit(ray.origin_lps, ray.dir_lps) else {
            continue;
        };
        let Hit {
            depth_mm,
            position_lps,
            normal_lps,
        } = hit.expect("a wall");
        let slant = -dot(normal, ray.dir_lps);
        // The tolerance is half of the smallest voxel, across the wall; the caster finds the wall where half of the
        // light is left, slightly behind the edge.
        let error = (f64::from(depth_mm) - depth) * slant;
        assert!(
            (-0.1..0.35).contains(&error),
            "{depth_mm} for {depth}, slant {slant}"
        );
        sum_of_error += error;
        let along: f64 = (0..3)
            .map(|a| (position_lps[a] - ray.origin_lps[a]) * ray.dir_lps[a])
            .sum();
        assert!((along - f64::from(depth_mm)).abs() < 1e-3);
        // The normals may differ by 2 degrees.
        let cosine = dot(normal_lps.map(f64::from), normal);
        assert!(
            cosine > 2f64.to_radians().cos(),
            "{} degrees",
            cosine.acos().to_degrees()
        );
        assert!((length(normal_lps.map(f64::from)) - 1.0).abs() < 1e-5);
        checked += 1;
    }
    println!(
        "{checked} walls, on average {:.3} mm behind the half-maximum",
        sum_of_error / checked as f64
    );
    checked
}

fn camera(at: [f64; 3], forward: [f64; 3]) -> Camera {
    let forward = unit(forward).unwrap();
    let right = unit(carina_grid::cross(forward, [0.3, -0.2, 0.9])).unwrap();
    let down = carina_grid::cross(forward, right);
    Camera::new(Affine::from_columns(right, down, forward, at), 1.7, 61, 47).unwrap()
}

#[test]
fn the_first_wall_of_a_sphere_has_its_true_depth_and_normal() {
    let (middle, radius) = ([1.0, -2.0, 0.5], 13.0);
    let from = |p: [f64; 3]| std::array::from_fn::<f64, 3, _>(|a| p[a] - middle[a]);
    let volume = phantom(|p| radius - length(from(p)));
    let checked = check_against(
        &volume,
        &camera([4.0, 1.0, -3.0], [-0.4, 0.2, 1.0]),
        |origin, dir| {
            let (o, b) = (from(origin), dot(from(origin), dir));
            let depth = -b + (b * b - dot(o, o) + radius * radius).sqrt();
            let wall = from(std::array::from_fn(|a| origin[a] + depth * dir[a]));
            Some((depth, wall.map(|v| -v / radius)))
        },
    );
    assert_eq!(checked, 61 * 47);
}

#[test]
fn the_first_wall_of_a_tube_has_its_true_depth_and_normal() {
    let (axis, radius) = (unit([0.2, 0.5, 1.0]).unwrap(), 6.0);
    let off = |p: [f64; 3]| std::array::from_fn::<f64, 3, _>(|a| p[a] - dot(p, axis) * axis[a]);
    let volume = phantom(|p| radius - length(off(p)));
    let checked = check_against(&volume, &camera([1.0, 0.0, 0.5], axis), |origin, dir| {
        let (o, d) = (off(origin), off(dir));
        let (a, b) = (dot(d, d), dot(o, d));
        let depth = (-b + (b * b - a * (dot(o, o) - radius * radius)).sqrt()) / a;
        let wall = off(std::array::from_fn(|a| origin[a] + depth * dir[a]));
        // Far along the tube a ray meets the wall at so small an angle that one ray step passes the blurred edge.
        // Far walls beyond 15 mm are left out, because the volume ends.
        let normal = wall.map(|v| -v / radius);
        (depth < 15.0 && -dot(normal, dir) > 0.25).then_some((depth, normal))
    });
    assert!(checked > 1000, "{checked}");
}

#[test]
fn a_pixel_outside_the_picture_cannot_be_picked() {
    let scene = Scene::fixed([0.0; 3], [0.0, 0.0, 1.0]);
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let frame = Frame::new(volume, &table, scene.camera.clone(), options(false, false)).unwrap();
    let (width, height) = (scene.camera.width(), scene.camera.height());
    for (column, row) in [(width, 0), (0, height)] {
        assert_eq!(
            pick(&frame, Method::Brute, column, row).unwrap_err().code(),
            "render.setting"
        );
    }
    assert!(pick(&frame, Method::Brute, width - 1, height - 1).is_ok());
}
