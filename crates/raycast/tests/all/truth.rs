//! Accuracy tests of the casters on chests as from a scanner.
//!
//! Every instruction set gives the bits of the scalar casters, and the picture equals that of a ray caster in f64
//! except for rounding to 8 bits. Volumes and transfer functions here are smooth, as in the product. `casters.rs`
//! bounds, for each ray, the effect of rounding at a transfer function that jumps within one HU.

use std::ops::AddAssign;

use crate::anatomy::{Chest, Dice, transfer_functions};
use crate::reference::{Matrix, Shares, View, World, to_8_bit};
use crate::scene::{step_table, words};
use carina_grid::{Affine, Camera, Grid, VolumeView};
use carina_isoregion::{cell_map, class_labels, radius_map, value_labels};
use carina_raycast::{
    CastStats, ClassMap, Frame, FrameOptions, InstructionSet, Interpolation, Light, Method,
    Transfer, TransferTable, ValueMap, cast_rows, cast_rows_scalar,
};
use rayon::prelude::*;

/// Minimum value of the transfer tables, HU.
const LO: i32 = -1100;
/// Maximum value of the transfer tables, HU.
const HI: i32 = 3100;

fn light_of([ambient, diffuse, specular, log2, reach]: Shares) -> Light {
    Light {
        ambient: ambient as f32,
        diffuse: diffuse as f32,
        specular: specular as f32,
        shininess_log2: log2 as u32,
        reach_mm: reach as f32,
    }
}

fn grid_of(shape: [usize; 3], lps_from_ijk: Matrix) -> Grid {
    Grid::new(
        [shape[2], shape[1], shape[0]],
        Affine::from_rows(lps_from_ijk),
    )
    .unwrap()
}

fn camera_of(view: &View) -> Camera {
    let pose = Affine::from_rows(view.lps_from_camera);
    Camera::new(pose, view.fov_rad, view.width, view.height).unwrap()
}

/// Counts of the differences between casters and reference over many pictures.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    pictures: u64,
    pixels: u64,
    /// Number of pixels with a channel that differs from the reference by one level.
    off_by_one: u64,
    off_by_more: u64,
    most: u8,
    /// Number of black pictures whose reference is not black.
    black: u64,
    /// Number of pixels that are not black in the reference.
    lit: u64,
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.pictures += other.pictures;
        self.pixels += other.pixels;
        self.off_by_one += other.off_by_one;
        self.off_by_more += other.off_by_more;
        self.most = self.most.max(other.most);
        self.black += other.black;
        self.lit += other.lit;
    }
}

fn compare(found: &[u8], expected: &[u8]) -> Tally {
    let mut tally = Tally {
        pictures: 1,
        ..Tally::default()
    };
    for (a, b) in found.chunks_exact(3).zip(expected.chunks_exact(3)) {
        let off = (0..3).map(|c| a[c].abs_diff(b[c])).max().unwrap_or(0);
        tally.pixels += 1;
        tally.off_by_one += u64::from(off == 1);
        tally.off_by_more += u64::from(off > 1);
        tally.most = tally.most.max(off);
        tally.lit += u64::from(b.iter().any(|&v| v > 0));
    }
    let dark = |rgb: &[u8]| rgb.iter().all(|&v| v == 0);
    tally.black = u64::from(dark(found) && expected.iter().any(|&v| v > 1));
    tally
}

/// Cast one view with every caster of this machine and compare the pictures with that of the scalar caster.
///
/// Return the scalar caster's picture.
fn every_caster_agrees(frame: &Frame<'_>, radius: &[u8], height: usize) -> Vec<u8> {
    let mut pictures: Vec<Vec<u8>> = Vec::new();
    for method in [Method::Brute, Method::LeapTransparent(radius)] {
        let best = InstructionSet::best();
        let truth: (Vec<u8>, CastStats) = cast_rows_scalar(frame, method, 0..height, best).unwrap();
        for simd in InstructionSet::available() {
            let found = cast_rows(frame, method, 0..height, simd).unwrap();
            assert_eq!(found.1, truth.1, "statistics of {}", simd.name());
            assert!(found.0 == truth.0, "picture of {}", simd.name());
        }
        pictures.push(truth.0);
    }
    assert!(
        pictures[0] == pictures[1],
        "leaps over clear tissue change nothing"
    );
    pictures.swap_remove(0)
}

/// Compare `num_poses` pictures with the reference in f64, ten poses in each chest.
///
/// Rays stop when the transparency falls below `stop`.
fn against_f64(num_poses: u64, seed: u64, (width, height): (usize, usize), stop: f64) -> Tally {
    (0..num_poses.div_ceil(10))
        .into_par_iter()
        .map(|n| {
            let mut dice = Dice::new(seed + n);
            let chest = Chest::random(&mut dice);
            let grid = grid_of(chest.shape, chest.lps_from_ijk);
            let volume = VolumeView::new(&chest.hu, &grid).unwrap();
            let finest = chest.spacing.into_iter().fold(f64::INFINITY, f64::min);
            let functions = transfer_functions();
            let mut tally = Tally::default();
            for pose in 0..10u64.min(num_poses - 10 * n) {
                let (_, points, shares) = &functions[(n + pose) as usize % functions.len()];
                let step_mm = finest * dice.between(0.3, 1.0);
                let shaded = dice.roll() < 0.8;
                let transfer = Transfer::new(points.clone(), 1.0, 1).unwrap();
                let table = TransferTable::new(&transfer, step_mm, LO as i16, HI as i16).unwrap();
                let labels = class_labels(&chest.hu, LO, &transfer.range(LO, HI), true).unwrap();
                let radius = cell_map(&labels.labels, grid.shape_zyx()).unwrap();
                let view = chest.view(&mut dice, width, height);
                let options = FrameOptions {
                    interpolation: Interpolation::Trilinear,
                    light: shaded.then(|| light_of(*shares)),
                    appearance: None,
                    background: [0.0; 3],
                };
                let frame = Frame::new(volume, &table, camera_of(&view), options).unwrap();
                let frame = frame.stopping_at(stop as f32).unwrap();
                let found = every_caster_agrees(&frame, &radius, height);
                let world = World {
                    shape: chest.shape,
                    hu: &chest.hu,
                    lps_from_ijk: chest.lps_from_ijk,
                    points,
                    light: shaded.then_some(*shares),
                    step_mm,
                    stop,
                };
                tally += compare(&found, &to_8_bit(&world.picture(&view)));
            }
            tally
        })
        .reduce(Tally::default, |mut a, b| {
            a += b;
            a
        })
}

fn check(tally: Tally) {
    println!("{tally:?}");
    assert!(
        3 * tally.lit > tally.pixels,
        "mostly nothing to compare: {tally:?}"
    );
    assert_eq!(tally.black, 0, "black by error: {tally:?}");
    assert_eq!(
        tally.off_by_more, 0,
        "off by more than one level: {tally:?}"
    );
    assert!(
        tally.off_by_one * 1000 <= tally.pixels,
        "more than 0.1 % off: {tally:?}"
    );
}

#[test]
fn pictures_of_hundreds_of_poses_equal_a_ray_caster_in_f64() {
    check(against_f64(300, 1, (32, 24), 1.0 / 512.0));
}

#[test]
fn every_caster_stops_rays_at_another_stop_limit() {
    check(against_f64(100, 9_000, (32, 24), 1.0 / 64.0));
}

#[test]
#[ignore = "a soak: minutes"]
fn pictures_of_twenty_thousand_poses_equal_a_ray_caster_in_f64() {
    check(against_f64(20_000, 1_000_000, (48, 40), 1.0 / 512.0));
}

/// Return transfer functions with sections of constant colour, whose classes can be leaped also where they are opaque.
fn stretches() -> Vec<Vec<[f64; 5]>> {
    vec![
        // A transfer function with nearly transparent lung, wall and tissue.
        vec![
            [-930.0, 0.2, 0.3, 0.9, 0.0],
            [-929.0, 0.2, 0.3, 0.9, 0.02],
            [-600.0, 0.2, 0.3, 0.9, 0.02],
            [-599.0, 0.9, 0.5, 0.4, 0.3],
            [-200.0, 0.9, 0.5, 0.4, 0.3],
            [-199.0, 0.9, 0.8, 0.7, 0.08],
            [3000.0, 0.9, 0.8, 0.7, 0.08],
        ],
        // A transfer function with opaque tissue behind clear air.
        vec![
            [-500.0, 0.9, 0.6, 0.5, 0.0],
            [-499.0, 0.9, 0.6, 0.5, 0.8],
            [3000.0, 0.9, 0.6, 0.5, 0.8],
        ],
        // A transfer function with fog everywhere, in which rays end only after long leaps.
        vec![
            [-800.0, 0.6, 0.6, 0.7, 0.01],
            [-799.0, 0.9, 0.9, 0.8, 0.03],
            [3000.0, 0.9, 0.9, 0.8, 0.03],
        ],
    ]
}

/// Compare pictures with leaps over every class with brute force, without shading.
///
/// Return the counts of the differences and the number of samples that leaps skipped.
fn leaps_over_opaque_classes(num_poses: u64, seed: u64, nearest: bool) -> (Tally, u64) {
    (0..num_poses.div_ceil(10))
        .into_par_iter()
        .map(|n| {
            let mut dice = Dice::new(seed + n);
            // Rays leap only over neighbouring voxels of equal value. The noise of 0.5 leaves many of them equal, as
            // in the paper's data; a noisy CT would test no leap.
            let chest = if nearest {
                Chest::with_noise(&mut dice, 0.5)
            } else {
                Chest::random(&mut dice)
            };
            let grid = grid_of(chest.shape, chest.lps_from_ijk);
            let volume = VolumeView::new(&chest.hu, &grid).unwrap();
            let finest = chest.spacing.into_iter().fold(f64::INFINITY, f64::min);
            let points = &stretches()[n as usize % 3];
            let transfer =
                Transfer::new(points.clone(), 1.0, if nearest { 16 } else { 1 }).unwrap();
            let out = if nearest {
                value_labels(&chest.hu, |lo, hi| {
                    (lo..=hi).all(|hu| transfer.at(hu)[3] == 0.0)
                })
            } else {
                class_labels(&chest.hu, LO, &transfer.range(LO, HI), false).unwrap()
            };
            let radius = radius_map(&out.labels, grid.shape_zyx()).unwrap();
            let words = words(&out.labels, &radius);
            let (mut tally, mut skipped) = (Tally::default(), 0);
            for _ in 0..10u64.min(num_poses - 10 * n) {
                let step_mm = if nearest {
                    finest
                } else {
                    finest * dice.between(0.3, 1.0)
                };
                let table = TransferTable::new(&transfer, step_mm, LO as i16, HI as i16).unwrap();
                let colours: Vec<_> = out.classes.iter().map(|c| table.entry(c.lo_hu)).collect();
                let segments = step_table(colours);
                let leaps = if nearest {
                    Method::LeapValues(ValueMap {
                        words: &words,
                        segments: &segments,
                        prefetch: false,
                    })
                } else {
                    Method::LeapClasses(ClassMap {
                        labels: &out.labels,
                        radius: &radius,
                        segments: &segments,
                    })
                };
                let view = chest.view(&mut dice, 40, 30);
                let options = FrameOptions {
                    interpolation: if nearest {
                        Interpolation::Nearest
                    } else {
                        Interpolation::Trilinear
                    },
                    light: None,
                    appearance: None,
                    background: [0.0; 3],
                };
                let frame = Frame::new(volume, &table, camera_of(&view), options).unwrap();
                let best = InstructionSet::best();
                let brute = cast_rows_scalar(&frame, Method::Brute, 0..30, best).unwrap();
                let leap = cast_rows_scalar(&frame, leaps, 0..30, best).unwrap();
                for simd in InstructionSet::available() {
                    for (method, truth) in [(Method::Brute, &brute), (leaps, &leap)] {
                        let found = cast_rows(&frame, method, 0..30, simd).unwrap();
                        assert!(found == *truth, "{}", simd.name());
                    }
                }
                skipped += leap.1.num_skipped;
                tally += compare(&leap.0, &brute.0);
            }
            (tally, skipped)
        })
        .reduce(
            || (Tally::default(), 0),
            |mut a, b| {
                a.0 += b.0;
                (a.0, a.1 + b.1)
            },
        )
}

fn check_leaps((tally, skipped): (Tally, u64)) {
    println!("{tally:?}, {skipped} samples skipped");
    assert_eq!(tally.black, 0);
    assert_eq!(
        tally.off_by_more, 0,
        "off by more than one level: {tally:?}"
    );
    assert!(
        tally.off_by_one * 10_000 <= tally.pixels,
        "more than 0.01 % off: {tally:?}"
    );
    assert!(
        skipped > 5 * tally.pixels,
        "hardly a leap: {skipped} samples for {tally:?}"
    );
}

#[test]
fn leaps_through_opaque_classes_move_one_level_on_one_pixel_in_ten_thousand() {
    check_leaps(leaps_over_opaque_classes(200, 5_000, false));
}

#[test]
fn leaps_of_the_papers_mode_move_one_level_on_one_pixel_in_ten_thousand() {
    check_leaps(leaps_over_opaque_classes(200, 6_000, true));
}

#[test]
#[ignore = "a soak: minutes"]
fn leaps_in_thousands_of_poses_move_one_level_on_one_pixel_in_ten_thousand() {
    check_leaps(leaps_over_opaque_classes(3000, 50_000, false));
    check_leaps(leaps_over_opaque_classes(3000, 60_000, true));
}

/// Create a chest on an upright grid with the given spacing, so that positions on a face are exactly on that face.
fn upright(seed: u64, spacing: [f64; 3]) -> Chest {
    let mut chest = Chest::random(&mut Dice::new(seed));
    chest.lps_from_ijk = [
        [spacing[0], 0.0, 0.0, 0.0],
        [0.0, spacing[1], 0.0, 0.0],
        [0.0, 0.0, spacing[2], 0.0],
    ];
    chest.spacing = spacing;
    chest
}

#[test]
fn pictures_on_voxel_faces_and_along_axes_equal_a_ray_caster_in_f64() {
    let mut tally = Tally::default();
    for (seed, spacing) in [(71, [1.0; 3]), (72, [0.5, 1.0, 2.0]), (73, [0.7, 0.9, 1.3])] {
        let chest = upright(seed, spacing);
        let grid = grid_of(chest.shape, chest.lps_from_ijk);
        let volume = VolumeView::new(&chest.hu, &grid).unwrap();
        let half = chest.shape.map(|n| (n / 2) as f64);
        let n = chest.shape.map(|n| n as f64);
        // The positions are a voxel's centre, a face, an edge, a corner, the box's own faces and corners, and positions
        // outside.
        let places = [
            half,
            [half[0] + 0.5, half[1], half[2]],
            [half[0] + 0.5, half[1] - 0.5, half[2]],
            half.map(|h| h + 0.5),
            [-0.5, half[1], half[2]],
            [n[0] - 0.5, half[1] + 0.5, half[2]],
            [-0.5; 3],
            n.map(|n| n - 0.5),
            [0.0; 3],
            [-20.0, half[1] + 0.5, half[2]],
            [half[0], half[1], n[2] + 30.0],
            [half[0] + 0.5, -40.0, half[2] + 0.5],
        ];
        for (which, (_, points, shares)) in transfer_functions().iter().enumerate() {
            let transfer = Transfer::new(points.clone(), 1.0, 1).unwrap();
            let step_mm = 0.5 * spacing.into_iter().fold(f64::INFINITY, f64::min);
            let table = TransferTable::new(&transfer, step_mm, LO as i16, HI as i16).unwrap();
            let labels = class_labels(&chest.hu, LO, &transfer.range(LO, HI), true).unwrap();
            let radius = cell_map(&labels.labels, grid.shape_zyx()).unwrap();
            for (at, place) in places.iter().enumerate() {
                for axis in 0..3 {
                    for sign in [1.0, -1.0] {
                        let mut axes = [[0.0; 3]; 3];
                        axes[2][axis] = sign;
                        axes[1][(axis + 2) % 3] = 1.0;
                        axes[0][(axis + 1) % 3] = sign;
                        // A picture of odd size has a middle pixel, whose ray runs along the axis; a picture of even
                        // size has none.
                        let (width, height) = if (at + axis) % 2 == 0 {
                            (15, 11)
                        } else {
                            (14, 12)
                        };
                        // A camera must satisfy right = down x forward.
                        let handed =
                            axes[1][(axis + 2) % 3] * axes[2][axis] * axes[0][(axis + 1) % 3];
                        assert!(handed > 0.0);
                        let view = View {
                            lps_from_camera: std::array::from_fn(|r| {
                                [axes[0][r], axes[1][r], axes[2][r], place[r] * spacing[r]]
                            }),
                            fov_rad: [60.0f64, 90.0, 150.0][which].to_radians(),
                            width,
                            height,
                        };
                        let shaded = at % 2 == 0;
                        let options = FrameOptions {
                            interpolation: Interpolation::Trilinear,
                            light: shaded.then(|| light_of(*shares)),
                            appearance: None,
                            background: [0.0; 3],
                        };
                        let frame = Frame::new(volume, &table, camera_of(&view), options).unwrap();
                        let found = every_caster_agrees(&frame, &radius, height);
                        let world = World {
                            shape: chest.shape,
                            hu: &chest.hu,
                            lps_from_ijk: chest.lps_from_ijk,
                            points,
                            light: shaded.then_some(*shares),
                            step_mm,
                            stop: 1.0 / 512.0,
                        };
                        let expected = to_8_bit(&world.picture(&view));
                        let one = compare(&found, &expected);
                        assert_eq!(
                            one.off_by_more, 0,
                            "at {place:?}, axis {axis}, sign {sign}, spacing {spacing:?}: {one:?}"
                        );
                        tally += one;
                    }
                }
            }
        }
    }
    println!("{tally:?}");
    assert_eq!(tally.black, 0);
    assert!(3 * tally.lit > tally.pixels);
}
