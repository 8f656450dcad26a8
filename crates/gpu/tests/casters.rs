//! Contract tests of the GPU caster.
//!
//! Its picture equals that of the CPU within one grey level on 99.9 % of the pixels, for any view. A failure gives an
//! error, never a wrong picture.
#![cfg(feature = "wgpu")]

mod devices;
#[path = "../../raycast/tests/all/scene.rs"]
mod scene;

use std::sync::Arc;

use carina_gpu::{Gpu, GpuError};
use carina_grid::{Camera, FieldShape, ImageField, Lens, LensRays, Optics, VolumeView};
use carina_isoregion::{cell_map, class_labels};
use carina_raycast::{CastStats, Frame, InstructionSet, Method, cast_rows, cast_surface};
use devices::{gpus, on};
use proptest::{
    strategy::{Strategy, ValueTree},
    test_runner::TestRunner,
};
use scene::{Scene, any_scene, options};

fn radius(scene: &Scene, nearest: bool) -> Vec<u8> {
    let entries = scene.transfer(nearest).range(-1100, 3100);
    let labels = class_labels(&scene.hu, -1100, &entries, true)
        .unwrap()
        .labels;
    cell_map(&labels, scene.grid.shape_zyx()).unwrap()
}

struct Pair {
    cpu: (Vec<u8>, CastStats),
    gpu: (Vec<u8>, CastStats),
}

fn cast(gpu: &Gpu, scene: &Scene, shaded: bool, nearest: bool, leaps: bool) -> Pair {
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(nearest);
    let frame = Frame::new(
        volume,
        &table,
        scene.camera.clone(),
        options(shaded, nearest),
    )
    .unwrap();
    let rows = 0..scene.camera.height();
    let radius = radius(scene, nearest);
    let method = if leaps {
        Method::LeapTransparent(&radius)
    } else {
        Method::Brute
    };
    let shape = scene.grid.shape_zyx();
    let on_device = gpu.upload_volume(&scene.hu, shape).unwrap();
    let map = leaps.then(|| gpu.upload_map(&radius, shape).unwrap());
    Pair {
        cpu: cast_rows(&frame, method, rows.clone(), InstructionSet::best()).unwrap(),
        gpu: gpu
            .cast(&frame, on(&on_device, map.as_ref()), rows, false)
            .unwrap(),
    }
}

/// Return for each pixel the largest difference between the CPU's and the GPU's channels.
fn differences(pair: &Pair) -> Vec<u8> {
    assert_eq!(pair.cpu.0.len(), pair.gpu.0.len());
    let pixels = pair.cpu.0.chunks(3).zip(pair.gpu.0.chunks(3));
    pixels
        .map(|(a, b)| (0..3).map(|c| a[c].abs_diff(b[c])).max().unwrap())
        .collect()
}

fn frame_of<T>(scene: &Scene, look: impl FnOnce(&Frame<'_>) -> T) -> T {
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let frame = Frame::new(volume, &table, scene.camera.clone(), options(true, false)).unwrap();
    look(&frame)
}

fn inside() -> Scene {
    Scene::fixed([1.0, -0.5, 0.7], [0.4, 0.2, 0.1])
}

#[test]
fn pictures_of_random_scenes_equal_the_cpus_within_one_grey_level() {
    for gpu in gpus() {
        let mut runner = TestRunner::deterministic();
        let (mut num_off, mut worst, mut num_pixels, mut num_lit) = (0, 0, 0, 0);
        for n in 0..300 {
            let scene = any_scene().new_tree(&mut runner).unwrap().current();
            // All kernels are tested in turn: shaded, nearest, plain; with and without leaps.
            let pair = cast(gpu, &scene, n % 3 == 0, n % 3 == 1, n % 2 == 0);
            let found = differences(&pair);
            num_off += found.iter().filter(|&&d| d > 1).count();
            worst = worst.max(*found.iter().max().unwrap());
            num_pixels += found.len();
            num_lit += pair.gpu.0.chunks(3).filter(|p| p[0] > 40).count();
            let (cpu, gpu) = (pair.cpu.1, pair.gpu.1);
            assert_eq!(cpu.num_rays, gpu.num_rays);
            // The ends of a ray are computed in f32 on the device, so a sample on a face of the box may be inside or
            // outside.
            for (a, b) in [
                (cpu.num_samples, gpu.num_samples),
                (
                    cpu.num_samples + cpu.num_skipped,
                    gpu.num_samples + gpu.num_skipped,
                ),
                (cpu.num_lookups, gpu.num_lookups),
                (cpu.num_leaps, gpu.num_leaps),
                (cpu.num_shaded, gpu.num_shaded),
                (cpu.num_loads, gpu.num_loads),
            ] {
                assert!(a.abs_diff(b) <= 10 + a / 100, "scene {n}: {cpu:?} {gpu:?}");
            }
        }
        println!("{num_off} of {num_pixels} pixels off by more than a level, worst {worst}");
        assert!(
            num_lit * 10 > num_pixels,
            "dark pictures would agree with anything"
        );
        assert!(num_off * 1000 <= num_pixels);
        // Where a table changes from clear to opaque within 1 HU, rounding may move a wall by one sample on a ray, and
        // the pixel keeps the wall's colour. A larger difference is the colour of another structure.
        assert!(worst <= 40, "a pixel is off by {worst}");
    }
}

#[test]
fn assembled_strips_equal_the_whole_picture_bit_for_bit() {
    for gpu in gpus() {
        let mut scene = inside();
        scene.resize(61, 47);
        frame_of(&scene, |frame| {
            let volume = gpu
                .upload_volume(&scene.hu, scene.grid.shape_zyx())
                .unwrap();
            let part = |rows| gpu.cast(frame, on(&volume, None), rows, false).unwrap();
            let (whole, stats) = part(0..47);
            let strips = [part(0..5), part(5..6), part(6..47)];
            assert!(whole == strips.each_ref().map(|(rgb, _)| rgb.clone()).concat());
            let num_samples: u64 = strips.iter().map(|(_, stats)| stats.num_samples).sum();
            assert_eq!(num_samples, stats.num_samples);
            assert!(part(9..9).0.is_empty());
        });
    }
}

#[test]
fn a_picture_through_a_round_lens_equals_the_cpus_picture() {
    for gpu in gpus() {
        let mut scene = inside();
        let mut pictures = Vec::new();
        for fov_rad in [1.2, 2.9] {
            let field = ImageField {
                shape: FieldShape::Round,
                ..ImageField::FULL
            };
            let optics = Optics::new(&Lens::Equidistant, Some(fov_rad), 64, 48).unwrap();
            let lens = LensRays::build(optics, &field).unwrap();
            let pose = *scene.camera.lps_from_camera();
            scene.camera = Camera::with_lens(pose, Arc::new(lens)).unwrap();
            let pair = cast(gpu, &scene, true, false, true);
            assert!(differences(&pair).iter().filter(|&&d| d > 1).count() <= 3);
            assert_eq!(
                pair.gpu.0[..3],
                [0; 3],
                "the corner lies outside the image circle"
            );
            assert!(pair.gpu.0.iter().any(|&v| v > 100));
            pictures.push(pair.gpu.0);
        }
        // Directions are cached on the device; a new lens must not use those of the previous one.
        assert!(pictures[0] != pictures[1]);
    }
}

#[test]
fn first_walls_equal_those_of_the_cpu() {
    for gpu in gpus() {
        let mut runner = TestRunner::deterministic();
        let (mut num_far, mut num_walls) = (0, 0);
        for _ in 0..60 {
            let scene = any_scene().new_tree(&mut runner).unwrap().current();
            frame_of(&scene, |frame| {
                let volume = gpu
                    .upload_volume(&scene.hu, scene.grid.shape_zyx())
                    .unwrap();
                let rows = 0..scene.camera.height();
                let (walls, _) = gpu
                    .cast_walls(frame, on(&volume, None), rows.clone())
                    .unwrap();
                let (expected, _) =
                    cast_surface(frame, Method::Brute, rows, InstructionSet::best()).unwrap();
                let step_mm = frame.parameters().step_mm as f32;
                for (wall, hit) in walls.iter().zip(&expected) {
                    let depth = hit.map_or(-1.0, |hit| hit.depth_mm);
                    let found = if wall.hit < 0.0 {
                        -1.0
                    } else {
                        wall.hit * step_mm
                    };
                    num_walls += usize::from(hit.is_some());
                    // The limit is a hundredth of a step; a neighbouring entry of the table moves the crossing by less.
                    num_far += usize::from((depth - found).abs() > 0.01 * step_mm);
                    assert!((0.0..=1.0).contains(&wall.transparency));
                }
            });
        }
        println!("{num_far} of {num_walls} first walls elsewhere");
        assert!(num_walls > 1000 && num_far * 1000 <= num_walls);
    }
}

#[test]
fn rays_stop_at_the_stop_limit_of_the_frame() {
    for gpu in gpus() {
        let scene = inside();
        frame_of(&scene, |frame| {
            let volume = gpu
                .upload_volume(&scene.hu, scene.grid.shape_zyx())
                .unwrap();
            let rows = 0..scene.camera.height();
            let early = frame.clone().stopping_at(0.25).unwrap();
            let [all, some] = [frame, &early].map(|frame| {
                gpu.cast(frame, on(&volume, None), rows.clone(), false)
                    .unwrap()
                    .1
            });
            assert!(some.num_samples < all.num_samples);
            let simd = InstructionSet::best();
            let (_, expected) = cast_rows(&early, Method::Brute, rows.clone(), simd).unwrap();
            assert!(some.num_samples.abs_diff(expected.num_samples) <= 10);
        });
    }
}

#[test]
fn a_picture_of_several_bands_equals_the_cpus_picture() {
    for gpu in gpus() {
        let mut scene = inside();
        // A picture of more than two million pixels needs two dispatches.
        scene.resize(2048, 1100);
        let pair = cast(gpu, &scene, true, false, true);
        let found = differences(&pair);
        let num_off = found.iter().filter(|&&d| d > 1).count();
        assert!(num_off * 1000 <= found.len(), "{num_off} pixels off");
        assert!(pair.gpu.0.iter().any(|&v| v > 100));
    }
}

#[test]
fn pictures_cast_by_several_threads_at_once_equal_single_casts() {
    for gpu in gpus() {
        let mut scene = inside();
        scene.resize(96, 80);
        let expected = cast(gpu, &scene, true, false, true).gpu;
        std::thread::scope(|scope| {
            let casts: Vec<_> = (0..4)
                .map(|_| {
                    scope.spawn(|| {
                        (0..5)
                            .map(|_| cast(gpu, &scene, true, false, true).gpu)
                            .collect::<Vec<_>>()
                    })
                })
                .collect();
            for found in casts.into_iter().flat_map(|thread| thread.join().unwrap()) {
                assert!(found == expected);
            }
        });
    }
}

#[test]
fn volumes_that_do_not_fit_and_maps_of_other_volumes_are_rejected() {
    for gpu in gpus() {
        let scene = inside();
        let shape = scene.grid.shape_zyx();
        let volume = gpu.upload_volume(&scene.hu, shape).unwrap();
        let long = vec![0i16; 70_000];
        let refused = gpu.upload_volume(&long, [1, 1, 70_000]).unwrap_err();
        assert!(matches!(refused, GpuError::DoesNotFit { .. }), "{refused}");
        assert_eq!(refused.code(), "render.gpu-limit");
        let other = gpu.upload_volume(&scene.hu[1..2], [1, 1, 1]).unwrap();
        let map = gpu.upload_map(&[0], [1, 1, 1]).unwrap();
        frame_of(&scene, |frame| {
            assert!(gpu.cast(frame, on(&other, None), 0..1, false).is_err());
            assert!(
                gpu.cast(frame, on(&volume, Some(&map)), 0..1, false)
                    .is_err()
            );
            let refused = gpu
                .cast(frame, on(&volume, None), 0..999, false)
                .unwrap_err();
            assert_eq!(refused.code(), "render.setting");
        });
    }
    let refused = Gpu::open(9999).unwrap_err();
    assert!(matches!(refused, GpuError::NoAdapter { index: 9999, .. }));
}

#[test]
fn a_lost_device_gives_errors_and_no_pictures() {
    for index in 0..gpus().len() {
        let gpu = Gpu::open(index).unwrap();
        let scene = inside();
        let volume = gpu
            .upload_volume(&scene.hu, scene.grid.shape_zyx())
            .unwrap();
        frame_of(&scene, |frame| {
            assert!(gpu.cast(frame, on(&volume, None), 0..4, false).is_ok());
            gpu.lose();
            for _ in 0..2 {
                let refused = gpu.cast(frame, on(&volume, None), 0..4, false).unwrap_err();
                assert!(matches!(refused, GpuError::Device { .. }), "{refused}");
            }
        });
        assert!(
            gpu.upload_volume(&scene.hu, scene.grid.shape_zyx())
                .is_err()
        );
    }
}
