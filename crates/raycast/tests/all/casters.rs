//! Contract tests of the casters on difficult scenes.
//!
//! The scenes are volumes of a few voxels, single bright voxels, and transfer functions with a jump within one HU.
//!
//! Leaping equals brute force, strips equal the whole picture, instruction sets agree, and the error of brute force
//! stays within a bound, derived for each ray, of the effect of rounding at such a jump. `truth.rs` tests the accuracy
//! with the volumes and transfer functions of a CT: at most one grey level.

use crate::scene::{Scene, any_scene, options, step_table, words};
use carina_grid::{VolumeView, clip_line_to_box};
use carina_isoregion::{SegmentTable, cell_map, class_labels, radius_map, value_labels};
use carina_raycast::{
    CastStats, ClassMap, Frame, InstructionSet, Interpolation, Method, TransferTable, ValueMap,
    cast_rows,
};
use proptest::prelude::*;

fn cast(scene: &Scene, shaded: bool, nearest: bool, method: Method<'_>) -> (Vec<u8>, CastStats) {
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(nearest);
    let frame = Frame::new(
        volume,
        &table,
        scene.camera.clone(),
        options(shaded, nearest),
    )
    .unwrap();
    let height = scene.camera.height();
    cast_rows(&frame, method, 0..height, InstructionSet::best()).unwrap()
}

fn transparent_radius(scene: &Scene, nearest: bool) -> Vec<u8> {
    let entries = scene.transfer(nearest).range(-1100, 3100);
    let labels = class_labels(&scene.hu, -1100, &entries, true)
        .unwrap()
        .labels;
    cell_map(&labels, scene.grid.shape_zyx()).unwrap()
}

/// Return the colour of each class, read at the class's first HU.
fn class_colours(table: &TransferTable, classes: &[carina_isoregion::Class]) -> Vec<[f32; 4]> {
    classes
        .iter()
        .map(|class| table.entry(class.lo_hu))
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn leaping_over_transparent_classes_equals_brute_force_bit_for_bit(
        scene in any_scene(), shaded in any::<bool>(), nearest in any::<bool>(),
    ) {
        let nearest = nearest && !shaded;
        let (brute, all) = cast(&scene, shaded, nearest, Method::Brute);
        let radius = transparent_radius(&scene, nearest);
        let (leap, some) = cast(&scene, shaded, nearest, Method::LeapTransparent(&radius));
        prop_assert!(brute == leap);
        prop_assert!(some.num_samples <= all.num_samples);
        prop_assert!(some.num_samples + some.num_skipped >= all.num_samples);
    }

    #[test]
    fn leaping_over_all_classes_is_within_one_grey_level_of_brute_force(
        scene in any_scene(), nearest in any::<bool>(),
    ) {
        let (brute, all) = cast(&scene, false, nearest, Method::Brute);
        let table = scene.table(nearest);
        let out = if nearest {
            value_labels(&scene.hu, |lo, hi| table.is_transparent(lo, hi))
        } else {
            class_labels(&scene.hu, -1100, &scene.transfer(false).range(-1100, 3100), false).unwrap()
        };
        let radius = radius_map(&out.labels, scene.grid.shape_zyx()).unwrap();
        let segments = step_table(class_colours(&table, &out.classes));
        let words = words(&out.labels, &radius);
        let method = if nearest {
            Method::LeapValues(ValueMap { words: &words, segments: &segments, prefetch: false })
        } else {
            Method::LeapClasses(ClassMap { labels: &out.labels, radius: &radius, segments: &segments })
        };
        let (leap, some) = cast(&scene, false, nearest, method);
        for (a, b) in brute.iter().zip(&leap) {
            // A segment is rounded once, its samples one by one; rounding to 8 bits can then differ by one level.
            prop_assert!(a.abs_diff(*b) <= 1, "{a} {b}");
        }
        // A leap ends where brute force stops. Rounding of the transparency may move that end by one sample on a ray.
        let (lo, hi) = (all.num_samples - all.num_rays.min(all.num_samples), all.num_samples + all.num_rays);
        prop_assert!((lo..=hi).contains(&(some.num_samples + some.num_skipped)));
    }

    #[test]
    fn assembled_strips_equal_the_whole_bit_for_bit(scene in any_scene(), cut in 0.0f64..1.0) {
        let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
        let table = scene.table(false);
        let frame = Frame::new(volume, &table, scene.camera.clone(), options(true, false)).unwrap();
        let radius = transparent_radius(&scene, false);
        let height = scene.camera.height();
        let rows = (cut * height as f64) as usize;
        let part = |rows| cast_rows(&frame, Method::LeapTransparent(&radius), rows, InstructionSet::best()).unwrap().0;
        let mut strips = part(0..rows);
        strips.extend(part(rows..height));
        prop_assert!(strips == part(0..height));
    }

    #[test]
    fn instruction_sets_agree_bit_for_bit(scene in any_scene()) {
        let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
        let table = scene.table(false);
        let frame = Frame::new(volume, &table, scene.camera.clone(), options(true, false)).unwrap();
        let rows = 0..scene.camera.height();
        let portable = cast_rows(&frame, Method::Brute, rows.clone(), InstructionSet::Portable).unwrap();
        prop_assert!(portable == cast_rows(&frame, Method::Brute, rows, InstructionSet::best()).unwrap());
    }

    #[test]
    fn brute_force_at_jumps_within_one_hu_differs_from_f64_by_rounding_only(scene in any_scene()) {
        let (found, _) = cast(&scene, false, false, Method::Brute);
        let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
        let table = scene.table(false);
        let width = scene.camera.width();
        for (n, pixel) in found.chunks(3).enumerate() {
            let (column, row) = (n % width, n / width);
            let (reference, doubt) = f64_ray(&scene, volume, &table, column, row);
            for c in 0..3 {
                // The tolerance is half a level of rounding to 8 bits, half a level for colour behind the stop limit,
                // 0.1 for sums in f32, and the possible effect of rounded positions where the transfer function is
                // steep.
                let error = (f64::from(pixel[c]) - reference[c]).abs();
                prop_assert!(
                    error <= 1.1 + 255.0 * doubt,
                    "{pixel:?} {reference:?} +- {doubt} at {column} {row}"
                );
            }
        }
    }
}

/// Cast one ray in f64, by the formulas of the design and without the crate's kernels.
///
/// Return the ray's colour, and a bound of the change of this colour (1 is white) by rounding. The change occurs
/// because f32 rounds the position of a sample, which may then read a neighbouring entry of the table.
fn f64_ray(
    scene: &Scene,
    volume: VolumeView<'_, i16>,
    table: &TransferTable,
    column: usize,
    row: usize,
) -> ([f64; 3], f64) {
    let (origin, dir) = scene.camera.ray_ijk(&scene.grid, column, row);
    let n = scene.grid.shape_ijk();
    let (lo, hi) = ([-0.5; 3], n.map(|n| n as f64 - 0.5));
    let (mut rgb, mut through, mut doubt) = ([0.0f64; 3], 1.0f64, 0.0f64);
    if let Some((t_in, t_out)) = clip_line_to_box(origin, dir, lo, hi) {
        for k in 0.. {
            let t = (k as f64 + 0.5) * table.step_mm();
            // f32 has a precision of 24 bits: 6e-8 of each term, for a few terms.
            let off_vox: f64 = (0..3)
                .map(|a| 4.0 * 6e-8 * (origin[a].abs() + (t * dir[a]).abs()) + 1e-6)
                .sum();
            let off_mm = 1e-3;
            if t > t_out + off_mm || through < 1.0 / 512.0 {
                break;
            }
            if t < t_in - off_mm {
                continue;
            }
            let point: [f64; 3] = std::array::from_fn(|a| origin[a] + t * dir[a]);
            let value = trilinear(volume, point);
            let off_hu = off_vox * steepest(volume, point) + 0.01;
            let read = |value: f64| table.entry((value + 0.5).floor() as i32).map(f64::from);
            let entry = read(value);
            let (first, last) = (
                (value - off_hu + 0.5).floor(),
                (value + off_hu + 0.5).floor(),
            );
            let mut change: f64 = 0.0;
            let mut hu = first;
            while hu <= last {
                let other = table.entry(hu as i32).map(f64::from);
                // A change of opacity also changes the visibility of all later samples, by at most the same amount.
                let colour = (0..3)
                    .map(|c| (other[c] - entry[c]).abs())
                    .fold(0.0, f64::max);
                change = change.max(colour + (other[3] - entry[3]).abs());
                hu += 1.0;
            }
            if t < t_in + off_mm || t > t_out - off_mm {
                // At the face of the box a sample may be inside or outside, so the whole sample may be missing.
                let colour = entry[..3].iter().copied().fold(0.0, f64::max);
                change = change.max(colour + entry[3]);
            }
            doubt += through * change;
            if (t_in..=t_out).contains(&t) {
                for c in 0..3 {
                    rgb[c] += through * entry[c];
                }
                through *= 1.0 - entry[3];
            }
        }
    }
    (rgb.map(|v| v.min(1.0) * 255.0), doubt)
}

fn trilinear(volume: VolumeView<'_, i16>, point: [f64; 3]) -> f64 {
    let mut value = 0.0;
    for corner in 0..8 {
        let mut weight = 1.0;
        let at = std::array::from_fn(|a| {
            let x = point[a];
            let high = corner >> a & 1;
            let part = x - x.floor();
            weight *= if high == 1 { part } else { 1.0 - part };
            x.floor() as isize + high as isize
        });
        value += weight * f64::from(volume.at_clamped(at));
    }
    value
}

/// Return a bound of the change of the interpolated value per voxel near a point.
///
/// The bound is the range of the 4x4x4 voxels round the point.
fn steepest(volume: VolumeView<'_, i16>, point: [f64; 3]) -> f64 {
    let (mut least, mut most) = (i16::MAX, i16::MIN);
    for n in 0..64isize {
        let step = [n % 4 - 1, n / 4 % 4 - 1, n / 16 - 1];
        let value = volume.at_clamped(std::array::from_fn(|a| point[a].floor() as isize + step[a]));
        least = least.min(value);
        most = most.max(value);
    }
    f64::from(most) - f64::from(least)
}

#[test]
fn a_ray_that_misses_the_volume_shows_the_background() {
    let scene = Scene::fixed([300.0, 0.0, 0.0], [1.0, 0.0, 0.0]);
    let (rgb, stats) = cast(&scene, true, false, Method::Brute);
    assert!(rgb.iter().all(|&v| v == 0));
    assert_eq!(stats.num_samples, 0);
}

#[test]
fn shading_with_nearest_voxels_or_leaps_over_opaque_classes_is_rejected() {
    let scene = Scene::fixed([0.0; 3], [0.0, 0.0, 1.0]);
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let both = carina_raycast::FrameOptions {
        interpolation: Interpolation::Nearest,
        ..options(true, false)
    };
    assert!(Frame::new(volume, &table, scene.camera.clone(), both).is_err());
    let frame = Frame::new(volume, &table, scene.camera.clone(), options(true, false)).unwrap();
    let segments = SegmentTable::new(&[]);
    let zeros = vec![0u8; scene.hu.len()];
    let map = ClassMap {
        labels: &zeros,
        radius: &zeros,
        segments: &segments,
    };
    assert!(
        cast_rows(
            &frame,
            Method::LeapClasses(map),
            0..1,
            InstructionSet::best()
        )
        .is_err()
    );
    let short = Method::LeapTransparent(&zeros[1..]);
    assert!(cast_rows(&frame, short, 0..1, InstructionSet::best()).is_err());
    assert!(cast_rows(&frame, Method::Brute, 0..999, InstructionSet::best()).is_err());
}
