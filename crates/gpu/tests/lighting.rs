//! Contract tests of the shading on the GPU: its picture equals that of the CPU within one grey level on 99.9 % of the
//! pixels, for every appearance, and is never left incomplete.
#![cfg(feature = "wgpu")]

mod devices;
#[path = "../../raycast/tests/all/scene.rs"]
mod scene;

use std::sync::Arc;

use carina_gpu::{Gpu, Resident};
use carina_grid::{Camera, FieldShape, Grid, ImageField, Lens, LensRays, Optics, VolumeView};
use carina_isoregion::{cell_map, class_labels};
use carina_raycast::{
    Appearance, CastStats, Decoration, Frame, FrameOptions, InstructionSet, Method, cast_rows,
};
use devices::{gpus, on};
use proptest::{
    strategy::{Strategy, ValueTree},
    test_runner::TestRunner,
};
use scene::{Scene, any_scene, options};

/// Appearance with light only: no texture and no drawn features.
const PLAIN: Appearance = Appearance {
    guides_mm: [[-1.9, -0.5, 0.0], [1.9, -0.5, 0.3]],
    exposure: None,
    ambient: 0.2,
    wrap: 0.25,
    gloss: 0.5,
    shininess_log2: 6,
    paleness: 0.5,
    pale_hu: [0.0, 300.0],
    texture: 0.0,
    vessels: 0.0,
    silhouettes: false,
    specks: 0.0,
    secretions: 0.0,
    fog: 0.0,
    rings: 0.0,
    membrane: 0.0,
    hue: 0.0,
    spurs: 0.0,
};

/// Appearance of a new case, with the drawn features of the shipped transfer function.
const SHIPPED: Appearance = Appearance {
    texture: 1.0,
    vessels: 0.5,
    silhouettes: true,
    specks: 1.0,
    rings: 1.0,
    membrane: 1.0,
    hue: 1.0,
    spurs: 1.0,
    ..PLAIN
};

/// Return appearances that each enable other stages of the shading, with their names.
fn appearances() -> Vec<(&'static str, Appearance)> {
    vec![
        ("plain", PLAIN),
        (
            "given exposure",
            Appearance {
                exposure: Some(90.0),
                ..PLAIN
            },
        ),
        (
            "texture",
            Appearance {
                texture: 1.0,
                ..PLAIN
            },
        ),
        (
            "vessels",
            Appearance {
                texture: 0.6,
                vessels: 1.5,
                ..PLAIN
            },
        ),
        (
            "silhouettes",
            Appearance {
                silhouettes: true,
                ..PLAIN
            },
        ),
        (
            "specks",
            Appearance {
                texture: 1.0,
                specks: 1.5,
                ..PLAIN
            },
        ),
        (
            "secretions",
            Appearance {
                texture: 1.0,
                secretions: 1.0,
                ..PLAIN
            },
        ),
        ("fog", Appearance { fog: 0.7, ..PLAIN }),
        (
            "rings",
            Appearance {
                rings: 1.5,
                ..PLAIN
            },
        ),
        (
            "membrane",
            Appearance {
                membrane: 1.5,
                ..PLAIN
            },
        ),
        (
            "hue and spurs",
            Appearance {
                hue: 1.5,
                spurs: 1.0,
                ..PLAIN
            },
        ),
        ("shipped", SHIPPED),
    ]
}

fn radius(scene: &Scene) -> Vec<u8> {
    let entries = scene.transfer(false).range(-1100, 3100);
    let labels = class_labels(&scene.hu, -1100, &entries, true)
        .unwrap()
        .labels;
    cell_map(&labels, scene.grid.shape_zyx()).unwrap()
}

/// Grid of anatomical data round a scene: ring phases that grow along an oblique axis, and strengths of all drawn
/// features.
struct Anatomy {
    numbers: Vec<f32>,
    shape_zyx: [usize; 3],
    origin_lps: [f32; 3],
    cell_mm: f32,
}

impl Anatomy {
    fn round(grid: &Grid) -> Self {
        let n = grid.shape_ijk();
        let middle = grid.lps_from_ijk().point(n.map(|n| (n as f64 - 1.0) / 2.0));
        let (shape_zyx, cell_mm) = ([15, 16, 17], 2.5);
        let [nz, ny, nx] = shape_zyx;
        let mut numbers = Vec::new();
        for z in 0..nz {
            for y in 0..ny {
                for x in 0..nx {
                    let p = [x, y, z].map(|v| v as f32);
                    let from = [p[0] - 8.0, p[1] - 7.5, p[2] - 7.0].map(|v| v * cell_mm / 6.0);
                    let part =
                        |a: f32, b: f32| (0.5 + 0.5 * (a * p[0] + b * p[1] + p[2]).sin()).min(1.0);
                    numbers.extend([
                        0.12 * p[0] - 0.35 * p[1] + 0.2 * p[2],
                        from[0],
                        from[1],
                        part(0.7, 0.2),
                        part(0.2, 0.9),
                        part(0.4, 0.5),
                        part(0.9, 0.1),
                        part(0.3, 0.3),
                    ]);
                }
            }
        }
        let half = [nx, ny, nz].map(|n| (n as f32 - 1.0) / 2.0 * cell_mm);
        Self {
            numbers,
            shape_zyx,
            origin_lps: std::array::from_fn(|a| middle[a] as f32 - half[a]),
            cell_mm,
        }
    }

    fn decoration(&self) -> Decoration<'_> {
        Decoration::new(&self.numbers, self.shape_zyx, self.origin_lps, self.cell_mm).unwrap()
    }
}

struct Pair {
    cpu: (Vec<u8>, CastStats),
    gpu: (Vec<u8>, CastStats),
}

impl Pair {
    /// Return for each pixel the largest difference between the CPU's and the GPU's channels.
    fn differences(&self) -> Vec<u8> {
        assert_eq!(self.cpu.0.len(), self.gpu.0.len());
        let pixels = self.cpu.0.chunks(3).zip(self.gpu.0.chunks(3));
        pixels
            .map(|(a, b)| (0..3).map(|c| a[c].abs_diff(b[c])).max().unwrap())
            .collect()
    }
}

/// Statistics of the differences between pictures of the CPU and of the GPU.
#[derive(Debug, Default)]
struct Tally {
    num_off: usize,
    num_pixels: usize,
    num_bright: usize,
    worst: u8,
}

impl Tally {
    fn add(&mut self, pair: &Pair) {
        let found = pair.differences();
        self.num_off += found.iter().filter(|&&d| d > 1).count();
        self.num_pixels += found.len();
        self.num_bright += pair.cpu.0.chunks(3).filter(|p| p[0] > 40).count();
        self.worst = self.worst.max(*found.iter().max().unwrap());
    }

    fn check(&self, what: &str) {
        println!("{what}: {self:?}");
        assert!(
            self.num_bright * 20 > self.num_pixels,
            "{what}: dark pictures would agree with anything"
        );
        assert!(self.num_off * 1000 <= self.num_pixels, "{what}: {self:?}");
    }
}

fn lit_frame_of<T>(
    scene: &Scene,
    appearance: Appearance,
    use_frame: impl FnOnce(&Frame<'_>) -> T,
) -> T {
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let lit = FrameOptions {
        appearance: Some(appearance),
        background: [0.1, 0.2, 0.3],
        ..options(false, false)
    };
    let anatomy = Anatomy::round(&scene.grid);
    let frame = Frame::new(volume, &table, scene.camera.clone(), lit).unwrap();
    use_frame(&frame.decorated_by(anatomy.decoration()))
}

fn both(gpu: &Gpu, scene: &Scene, appearance: Appearance, leaps: bool) -> Pair {
    let shape = scene.grid.shape_zyx();
    let radius = radius(scene);
    let volume = gpu.upload_volume(&scene.hu, shape).unwrap();
    let map = leaps.then(|| gpu.upload_map(&radius, shape).unwrap());
    let method = if leaps {
        Method::LeapTransparent(&radius)
    } else {
        Method::Brute
    };
    lit_frame_of(scene, appearance, |frame| {
        let rows = 0..scene.camera.height();
        // The CPU leaps also where a trial finds brute force faster, so that its statistics can be compared.
        let leaping = frame.clone().leaping_always();
        let mut cpu = cast_rows(&leaping, method, rows.clone(), InstructionSet::best()).unwrap();
        if let Some(rays) = scene.camera.lens_rays() {
            rays.shade_rows(0, &mut cpu.0);
        }
        let resident = on(&volume, map.as_ref());
        let gpu = gpu.cast(frame, resident, rows, true).unwrap();
        Pair { cpu, gpu }
    })
}

/// Return a scene inside a ball of air, with a viewport of `side` pixels.
fn inside(side: usize) -> Scene {
    let mut scene = Scene::fixed([1.0, -0.5, 0.7], [0.4, 0.2, 0.1]);
    scene.resize(side, side);
    scene
}

#[test]
fn every_look_equals_that_of_the_cpu_within_one_grey_level() {
    for gpu in gpus() {
        for (name, appearance) in appearances() {
            let mut tally = Tally::default();
            for (n, turn) in [[0.4, 0.2, 0.1], [1.3, -0.6, 2.0], [-2.0, 0.9, 0.3]]
                .iter()
                .enumerate()
            {
                let mut scene = Scene::fixed([1.0, -0.5, 0.7], *turn);
                scene.resize(160, 120);
                tally.add(&both(gpu, &scene, appearance, n % 2 == 0));
            }
            tally.check(name);
        }
    }
}

#[test]
fn every_look_changes_the_picture() {
    let scene = inside(96);
    let picture = |appearance: Appearance| {
        lit_frame_of(&scene, appearance, |frame| {
            cast_rows(frame, Method::Brute, 0..96, InstructionSet::best())
                .unwrap()
                .0
        })
    };
    let plain = picture(PLAIN);
    for (name, appearance) in appearances()
        .into_iter()
        .filter(|(_, appearance)| *appearance != PLAIN)
    {
        assert!(
            picture(appearance) != plain,
            "{name} has no effect in the test scene"
        );
    }
}

#[test]
fn random_scenes_equal_those_of_the_cpu_within_one_grey_level() {
    for gpu in gpus() {
        let mut runner = TestRunner::deterministic();
        let appearances = appearances();
        let mut tally = Tally::default();
        for n in 0..300 {
            let mut scene = any_scene().new_tree(&mut runner).unwrap().current();
            scene.resize(256, 256);
            let (name, appearance) = appearances[n % appearances.len()];
            let pair = both(gpu, &scene, appearance, n % 2 == 0);
            tally.add(&pair);
            let (cpu, gpu) = (pair.cpu.1, pair.gpu.1);
            assert_eq!(cpu.num_rays, gpu.num_rays);
            for (a, b) in [
                (cpu.num_samples, gpu.num_samples),
                (cpu.num_skipped, gpu.num_skipped),
                (cpu.num_shaded, gpu.num_shaded),
                (cpu.num_loads, gpu.num_loads),
            ] {
                assert!(
                    a.abs_diff(b) <= 200 + a / 100,
                    "scene {n}, {name}: {cpu:?} {gpu:?}"
                );
            }
        }
        tally.check("random scenes");
    }
}

#[test]
fn every_lens_outline_and_angle_equals_that_of_the_cpu() {
    for gpu in gpus() {
        for lens in [Lens::Pinhole, Lens::Equidistant] {
            for (shape, fov_rad, vignette) in [
                (FieldShape::Full, 1.0, 0.0),
                (FieldShape::Round, 1.6, 0.7),
                (FieldShape::Octagon, 2.4, 1.0),
            ] {
                let field = ImageField {
                    shape,
                    edge_px: 2.5,
                    vignette,
                };
                let optics = Optics::new(&lens, Some(fov_rad), 160, 120).unwrap();
                let rays = LensRays::build(optics, &field).unwrap();
                let mut scene = inside(120);
                let pose = *scene.camera.lps_from_camera();
                scene.camera = Camera::with_lens(pose, Arc::new(rays)).unwrap();
                let pair = both(gpu, &scene, SHIPPED, true);
                let mut tally = Tally::default();
                tally.add(&pair);
                tally.check(&format!("{lens:?} {shape:?} {fov_rad}"));
                if shape != FieldShape::Full {
                    assert_eq!(
                        pair.gpu.0[..3],
                        [0; 3],
                        "the corner lies outside the outline"
                    );
                }
            }
        }
    }
}

#[test]
fn joined_strips_equal_the_whole_picture_bit_for_bit() {
    for gpu in gpus() {
        let mut scene = inside(61);
        scene.resize(61, 47);
        let volume = gpu
            .upload_volume(&scene.hu, scene.grid.shape_zyx())
            .unwrap();
        lit_frame_of(&scene, SHIPPED, |frame| {
            let part = |rows| gpu.cast(frame, on(&volume, None), rows, false).unwrap();
            let (whole, stats) = part(0..47);
            assert!(whole.iter().any(|&v| v > 100));
            let strips = [part(0..5), part(5..6), part(6..47)];
            assert!(whole == strips.each_ref().map(|(rgb, _)| rgb.clone()).concat());
            let num_loads: u64 = strips.iter().map(|(_, stats)| stats.num_loads).sum();
            assert_eq!(num_loads, stats.num_loads);
            assert!(part(9..9).0.is_empty());
        });
    }
}

#[test]
fn pictures_of_several_threads_and_looks_at_once_equal_single_pictures() {
    for gpu in gpus() {
        let scene = inside(80);
        let volume = gpu
            .upload_volume(&scene.hu, scene.grid.shape_zyx())
            .unwrap();
        let picture = |appearance| {
            lit_frame_of(&scene, appearance, |frame| {
                gpu.cast(frame, on(&volume, None), 0..80, false).unwrap().0
            })
        };
        let appearances = [PLAIN, SHIPPED, Appearance { fog: 0.5, ..PLAIN }];
        let expected = appearances.map(picture);
        std::thread::scope(|scope| {
            let casts = appearances.map(|appearance| {
                let picture = &picture;
                scope.spawn(move || (0..4).map(|_| picture(appearance)).collect::<Vec<_>>())
            });
            for (thread, expected) in casts.into_iter().zip(&expected) {
                assert!(thread.join().unwrap().iter().all(|found| found == expected));
            }
        });
    }
}

#[test]
fn a_large_picture_of_several_bands_equals_that_of_the_cpu() {
    for gpu in gpus() {
        let mut scene = inside(64);
        scene.resize(2048, 1100);
        let mut tally = Tally::default();
        tally.add(&both(gpu, &scene, SHIPPED, true));
        tally.check("several bands");
    }
}

#[test]
fn a_device_lost_during_pictures_gives_errors_and_no_wrong_picture() {
    for index in 0..gpus().len() {
        let gpu = Gpu::open(index).unwrap();
        let scene = inside(64);
        let volume = gpu
            .upload_volume(&scene.hu, scene.grid.shape_zyx())
            .unwrap();
        lit_frame_of(&scene, SHIPPED, |frame| {
            let picture = || gpu.cast(frame, on(&volume, None), 0..64, false);
            let expected = picture().unwrap().0;
            std::thread::scope(|scope| {
                let casts: Vec<_> = (0..3)
                    .map(|_| scope.spawn(|| (0..6).map(|_| picture()).collect::<Vec<_>>()))
                    .collect();
                gpu.lose();
                for result in casts.into_iter().flat_map(|cast| cast.join().unwrap()) {
                    match result {
                        Ok((rgb, _)) => assert!(rgb == expected),
                        Err(refused) => assert_eq!(refused.code(), "render.gpu", "{refused}"),
                    }
                }
            });
            assert!(picture().is_err());
        });
    }
}

#[test]
fn decorations_of_another_size_or_device_are_rejected() {
    for gpu in gpus() {
        let scene = inside(16);
        let volume = gpu
            .upload_volume(&scene.hu, scene.grid.shape_zyx())
            .unwrap();
        let anatomy = Anatomy::round(&scene.grid);
        let own = gpu.upload_decoration(&anatomy.decoration()).unwrap();
        let small = Decoration::new(&[0.0; 64], [2, 2, 2], [0.0; 3], 1.0).unwrap();
        let other = gpu.upload_decoration(&small).unwrap();
        lit_frame_of(&scene, SHIPPED, |frame| {
            let picture = |decoration| {
                let resident = Resident {
                    decoration,
                    ..on(&volume, None)
                };
                gpu.cast(frame, resident, 0..16, false)
            };
            let refused = picture(Some(&other)).unwrap_err();
            assert_eq!(refused.code(), "render.setting", "{refused}");
            // Data that are uploaded in advance and data that the picture uploads give the same picture.
            assert!(picture(Some(&own)).unwrap().0 == picture(None).unwrap().0);
        });
    }
}
