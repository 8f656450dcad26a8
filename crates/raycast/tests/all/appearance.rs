//! Tests of the shading of first walls.
//!
//! The result is equal, bit for bit, from every caster, in strips and on every instruction set; the texture stays on
//! the tissue.

use crate::scene::{Scene, any_scene, options};
use carina_grid::{Affine, Camera, Grid, VolumeView, cross, unit};
use carina_isoregion::{cell_map, class_labels};
use carina_raycast::{
    Appearance, Frame, FrameOptions, InstructionSet, Interpolation, Method, Transfer,
    TransferTable, cast_rows, cast_rows_scalar, cast_surface,
};
use proptest::prelude::*;

/// Appearance of the test pictures.
const APPEARANCE: Appearance = Appearance {
    guides_mm: [[-1.9, -0.5, 0.0], [1.9, -0.5, 0.3]],
    exposure: None,
    ambient: 0.2,
    wrap: 0.25,
    gloss: 0.5,
    shininess_log2: 6,
    paleness: 0.5,
    pale_hu: [0.0, 300.0],
    texture: 1.0,
    vessels: 0.0,
    silhouettes: true,
    specks: 1.0,
    secretions: 0.5,
    fog: 0.0,
    rings: 0.0,
    membrane: 0.0,
    hue: 0.0,
    spurs: 0.0,
};

fn lit(appearance: Appearance) -> FrameOptions {
    FrameOptions {
        appearance: Some(appearance),
        ..options(false, false)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn shaded_pictures_are_equal_for_every_caster_and_in_strips(
        mut scene in any_scene(), size in (1usize..36, 1usize..20), cut in 0.0f64..1.0,
        texture in 0.0f32..2.0, vessels in prop_oneof![Just(0.0f32), 0.0f32..2.0], silhouettes: bool,
        wet in prop_oneof![Just([0.0f32; 3]), prop::array::uniform3(0.0f32..1.0)],
    ) {
        scene.resize(size.0, size.1);
        let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
        let table = scene.table(false);
        let [specks, secretions, fog] = wet;
        let appearance = Appearance { texture, vessels, silhouettes, specks, secretions, fog, ..APPEARANCE };
        let frame = Frame::new(volume, &table, scene.camera.clone(), lit(appearance)).unwrap();
        let entries = scene.transfer(false).range(-1100, 3100);
        let labels = class_labels(&scene.hu, -1100, &entries, true).unwrap().labels;
        let radius = cell_map(&labels, scene.grid.shape_zyx()).unwrap();
        let truth = cast_rows_scalar(&frame, Method::Brute, 0..size.1, InstructionSet::Portable).unwrap().0;
        let rows = (cut * size.1 as f64) as usize;
        for simd in InstructionSet::available() {
            for method in [Method::Brute, Method::LeapTransparent(&radius)] {
                let part = |rows| cast_rows(&frame, method, rows, simd).unwrap().0;
                let mut found = part(0..rows);
                found.extend(part(rows..size.1));
                prop_assert!(found == truth, "{} {method:?}", simd.name());
            }
        }
    }
}

#[test]
fn walls_of_a_volume_without_packets_are_shaded() {
    // A volume with one voxel along x has no pairs of voxels, which packets need.
    let mut scene = Scene::fixed([0.0; 3], [0.0, 0.0, 1.0]);
    let shape = [9, 8, 1];
    scene.grid = Grid::new(shape, Affine::IDENTITY).unwrap();
    scene.hu = (0..72)
        .map(|n| if n % 11 < 6 { -1000 } else { 40 })
        .collect();
    let pose = Affine::from_columns(
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0],
        [-6.0, 3.5, 4.0],
    );
    scene.camera = Camera::new(pose, 1.2, 20, 16).unwrap();
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let frame = Frame::new(volume, &table, scene.camera.clone(), lit(APPEARANCE)).unwrap();
    let truth = cast_rows_scalar(&frame, Method::Brute, 0..16, InstructionSet::Portable)
        .unwrap()
        .0;
    assert!(truth.iter().any(|&v| v > 60));
    for simd in InstructionSet::available() {
        assert!(cast_rows(&frame, Method::Brute, 0..16, simd).unwrap().0 == truth);
    }
}

/// Number of voxels of the test volume along i, j, k.
const SHAPE: [usize; 3] = [60, 64, 68];

/// Return a volume with a ball of air of 14 mm in tissue.
fn ball() -> (Grid, Vec<i16>) {
    let spacing = [0.6, 0.55, 0.65];
    let half = [0, 1, 2].map(|a| -spacing[a] * (SHAPE[2 - a] as f64 - 1.0) / 2.0);
    let axes = [0, 1, 2].map(|a| std::array::from_fn(|b| if a == b { spacing[a] } else { 0.0 }));
    let grid = Grid::new(SHAPE, Affine::from_columns(axes[0], axes[1], axes[2], half)).unwrap();
    let hu = (0..grid.num_voxels())
        .map(|index| {
            let at = grid
                .lps_from_ijk()
                .point(grid.voxel(index).map(|v| v as f64));
            let tissue = ((carina_grid::length(at) - 14.0) / 1.5 + 0.5).clamp(0.0, 1.0);
            (-1000.0 + 1040.0 * tissue) as i16
        })
        .collect();
    (grid, hu)
}

fn camera(at: [f64; 3], forward: [f64; 3], up: [f64; 3]) -> Camera {
    let forward = unit(forward).unwrap();
    let right = unit(cross(forward, up)).unwrap();
    let down = cross(forward, right);
    Camera::new(
        Affine::from_columns(right, down, forward, at),
        1.4,
        160,
        160,
    )
    .unwrap()
}

#[test]
fn the_texture_of_a_wall_stays_on_it_when_the_scope_moves_and_turns() {
    let (grid, hu) = ball();
    let volume = VolumeView::new(&hu, &grid).unwrap();
    let points = vec![
        [-600.0, 0.9, 0.55, 0.5, 0.0],
        [-400.0, 0.9, 0.55, 0.5, 0.97],
    ];
    let transfer = Transfer::new(points, 1.0, 1).unwrap();
    let table = TransferTable::new(&transfer, 0.3, -1024, 100).unwrap();
    // The difference that texture or vessels make, level by level, without highlights and under a light that hardly
    // depends on the pose.
    let appearance = Appearance {
        exposure: Some(12.0),
        gloss: 0.0,
        specks: 0.0,
        secretions: 0.0,
        silhouettes: false,
        ambient: 4.0,
        guides_mm: [[0.0; 3]; 2],
        ..APPEARANCE
    };
    let change = |camera: &Camera, [texture, vessels]: [f32; 2]| {
        let picture = |texture, vessels| {
            let options = FrameOptions {
                interpolation: Interpolation::Trilinear,
                ..lit(Appearance {
                    texture,
                    vessels,
                    ..appearance
                })
            };
            let frame = Frame::new(volume, &table, camera.clone(), options).unwrap();
            let hits = cast_surface(&frame, Method::Brute, 0..160, InstructionSet::best())
                .unwrap()
                .0;
            (
                cast_rows(&frame, Method::Brute, 0..160, InstructionSet::best())
                    .unwrap()
                    .0,
                hits,
            )
        };
        let ((with, hits), (without, _)) = (picture(texture, vessels), picture(0.0, 0.0));
        let change: Vec<f64> = with
            .iter()
            .zip(&without)
            .map(|(a, b)| f64::from(*a) - f64::from(*b))
            .collect();
        (change, hits)
    };
    let here = camera([0.0, 1.0, 3.0], [0.1, 0.0, 1.0], [0.0, 1.0, 0.0]);
    let there = camera([-1.5, 0.5, 4.0], [0.0, 0.1, 1.0], [0.6, 1.0, 0.0]);
    let correlation = |strengths: [f32; 2], moved: [f64; 3]| {
        let (first, hits) = change(&here, strengths);
        let (second, _) = change(&there, strengths);
        let inverse = there.lps_from_camera().inverse().unwrap();
        let (mut n, mut sums) = (0.0f64, [0.0f64; 5]);
        for (pixel, hit) in hits.iter().enumerate() {
            let Some(hit) = hit else { continue };
            let [x, y, z] = inverse.point(std::array::from_fn(|a| hit.position_lps[a] + moved[a]));
            let (column, row) = (
                80.0 + there.focal_px() * x / z,
                80.0 + there.focal_px() * y / z,
            );
            if !(0.0..160.0).contains(&column) || !(0.0..160.0).contains(&row) {
                continue;
            }
            // The green channel is compared, because vessels and mottling are most visible in it.
            let (a, b) = (
                first[3 * pixel + 1],
                second[3 * (row as usize * 160 + column as usize) + 1],
            );
            n += 1.0;
            for (sum, v) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                *sum += v;
            }
        }
        assert!(n > 5000.0);
        let [a, b, aa, bb, ab] = sums;
        (ab - a * b / n) / ((aa - a * a / n) * (bb - b * b / n)).sqrt()
    };
    for strengths in [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] {
        let (there, beside) = (
            correlation(strengths, [0.0; 3]),
            correlation(strengths, [3.0, 0.0, 0.0]),
        );
        // Half a pixel of displacement, and the finer detail seen from the nearer camera, leave at least this
        // correlation between the two pictures.
        assert!(there > 0.7, "{strengths:?}: {there}");
        // A texture displaced by 3 mm would correlate much less.
        assert!(beside.abs() < 0.4, "{strengths:?}: {beside}");
    }
}

#[test]
fn appearance_values_out_of_range_are_rejected() {
    let bad = [
        Appearance {
            guides_mm: [[f32::NAN; 3]; 2],
            ..APPEARANCE
        },
        Appearance {
            exposure: Some(-1.0),
            ..APPEARANCE
        },
        Appearance {
            ambient: f32::INFINITY,
            ..APPEARANCE
        },
        Appearance {
            wrap: 1.1,
            ..APPEARANCE
        },
        Appearance {
            gloss: -0.1,
            ..APPEARANCE
        },
        Appearance {
            shininess_log2: 11,
            ..APPEARANCE
        },
        Appearance {
            paleness: 2.0,
            ..APPEARANCE
        },
        Appearance {
            pale_hu: [100.0, 100.0],
            ..APPEARANCE
        },
        Appearance {
            texture: f32::NAN,
            ..APPEARANCE
        },
        Appearance {
            vessels: -0.1,
            ..APPEARANCE
        },
        Appearance {
            specks: f32::NAN,
            ..APPEARANCE
        },
        Appearance {
            secretions: 1.1,
            ..APPEARANCE
        },
        Appearance {
            fog: -0.1,
            ..APPEARANCE
        },
    ];
    let scene = Scene::fixed([0.0; 3], [0.0, 0.0, 1.0]);
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let refused = |options| {
        Frame::new(volume, &table, scene.camera.clone(), options)
            .unwrap_err()
            .code()
    };
    for appearance in bad {
        assert_eq!(refused(lit(appearance)), "render.setting", "{appearance:?}");
    }
    // The invalid options are two lights at once, and a shading without a gradient.
    let both = FrameOptions {
        appearance: Some(APPEARANCE),
        ..options(true, false)
    };
    assert_eq!(refused(both), "render.setting");
    let nearest = FrameOptions {
        interpolation: Interpolation::Nearest,
        ..lit(APPEARANCE)
    };
    assert_eq!(refused(nearest), "render.setting");
}
