//! The contract of the packets: on every instruction set of this machine, pictures and statistics of the scalar casters,
//! bit for bit.

mod scene;

use std::ops::Range;

use carina_grid::{Affine, Camera, Grid, VolumeView};
use carina_isoregion::{class_labels, radius_map};
use carina_raycast::{CastStats, Frame, InstructionSet, Method, cast_rows};
use proptest::prelude::*;
use scene::{Scene, any_scene, options};

struct Case {
    shaded: bool,
    leaps: bool,
    rows: Range<usize>,
}

fn cast(scene: &Scene, radius: &[u8], case: &Case, simd: InstructionSet) -> (Vec<u8>, CastStats) {
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let settings = options(case.shaded, false);
    let frame = Frame::new(volume, &table, scene.camera.clone(), settings).unwrap();
    let method = if case.leaps {
        Method::LeapTransparent(radius)
    } else {
        Method::Brute
    };
    cast_rows(&frame, method, case.rows.clone(), simd).unwrap()
}

fn transparent_radius(scene: &Scene) -> Vec<u8> {
    let entries = scene.transfer(false).range(-1100, 3100);
    let labels = class_labels(&scene.hu, -1100, &entries, true)
        .unwrap()
        .labels;
    radius_map(&labels, scene.grid.shape_zyx()).unwrap()
}

fn packets_equal_scalar(scene: &Scene, case: &Case) -> Result<(), TestCaseError> {
    packets_equal_scalar_with(scene, &transparent_radius(scene), case)
}

fn packets_equal_scalar_with(
    scene: &Scene,
    radius: &[u8],
    case: &Case,
) -> Result<(), TestCaseError> {
    let truth = cast(scene, radius, case, InstructionSet::Portable);
    for simd in InstructionSet::available() {
        let found = cast(scene, radius, case, simd);
        prop_assert_eq!(found.1, truth.1, "{}", simd.name());
        if let Some(at) = found.0.iter().zip(&truth.0).position(|(a, b)| a != b) {
            let (pixel, width) = (at / 3, scene.camera.width());
            return Err(TestCaseError::fail(format!(
                "{}: column {}, row {}: {} for {}",
                simd.name(),
                pixel % width,
                case.rows.start + pixel / width,
                found.0[at],
                truth.0[at],
            )));
        }
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn packets_equal_the_scalar_casters_bit_for_bit(
        mut scene in any_scene(),
        size in (1usize..40, 1usize..24),
        shaded in any::<bool>(),
        leaps in any::<bool>(),
        cut in prop::array::uniform2(0.0f64..1.0),
    ) {
        // Widths and heights that fill no packet, and strips that start and end inside a band.
        scene.resize(size.0, size.1);
        let at = cut.map(|c| (c * (size.1 + 1) as f64) as usize);
        let rows = at[0].min(at[1])..at[0].max(at[1]);
        packets_equal_scalar(&scene, &Case { shaded, leaps, rows })?;
        packets_equal_scalar(&scene, &Case { shaded, leaps, rows: 0..size.1 })?;
    }

    #[test]
    fn packets_read_extreme_values_as_the_scalar_casters_do(
        mut scene in any_scene(), shaded in any::<bool>(), leaps in any::<bool>(), seed in any::<u64>(),
    ) {
        // All of int16, so that differences of voxels need 17 bits and the table is left on both sides.
        let mut state = seed | 1;
        for hu in &mut scene.hu {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            *hu = match state >> 61 {
                0 => i16::MIN,
                1 => i16::MAX,
                2 => (state >> 40) as i16,
                _ => -1000,
            };
        }
        // The map is made for the values that the table holds; others are clamped to them.
        let mut clamped = scene.clone();
        for hu in &mut clamped.hu {
            *hu = (*hu).clamp(-1100, 3100);
        }
        let radius = transparent_radius(&clamped);
        let case = Case { shaded, leaps, rows: 0..scene.camera.height() };
        packets_equal_scalar_with(&scene, &radius, &case)?;
    }

    #[test]
    fn packets_read_every_byte_of_a_map_as_the_scalar_casters_do(
        scene in any_scene(), shaded in any::<bool>(), seed in any::<u64>(),
    ) {
        // No map that belongs to a volume: its border would be 0, and the very last bytes are the ones hard to gather.
        let mut state = seed | 1;
        let radius: Vec<u8> = (0..scene.hu.len())
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                if state >> 63 == 0 { 0 } else { (state >> 40) as u8 }
            })
            .collect();
        let rows = 0..scene.camera.height();
        packets_equal_scalar_with(&scene, &radius, &Case { shaded, leaps: true, rows })?;
    }
}

#[test]
fn rays_that_stand_still_on_an_axis_are_those_of_the_scalar_casters() {
    // Unrotated grid and camera, and an odd size: the middle column and row have steps of exactly 0.
    let shape = [9, 11, 13];
    let grid = Grid::new(shape, Affine::IDENTITY).unwrap();
    let hu = (0..grid.num_voxels())
        .map(|n| (n * 7919 % 1500) as i16 - 1000)
        .collect();
    let mut scene = Scene::fixed([0.0; 3], [0.0; 3]);
    (scene.grid, scene.hu) = (grid, hu);
    // In front of the volume, in it, behind it, and to the side, from where the middle column never meets it.
    for at in [
        [6.0, 5.0, -9.0],
        [6.0, 5.0, 4.0],
        [6.0, 5.0, 30.0],
        [-4.0, 5.0, -9.0],
        [6.0, 40.0, -9.0],
    ] {
        let pose = Affine::from_columns([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], at);
        scene.camera = Camera::new(pose, 1.5, 33, 21).unwrap();
        for (shaded, leaps) in [(true, true), (true, false), (false, true)] {
            let rows = 0..21;
            packets_equal_scalar(
                &scene,
                &Case {
                    shaded,
                    leaps,
                    rows,
                },
            )
            .unwrap();
        }
    }
}

#[test]
fn packets_equal_the_scalar_casters_over_a_whole_picture() {
    // A picture of many bands, threads and refills, from inside a volume and from outside it.
    for offset in [[0.0, 0.5, -0.5], [30.0, -8.0, 4.0]] {
        let mut scene = Scene::fixed(offset, [0.2, -1.1, 0.4]);
        scene.resize(131, 97);
        for (shaded, leaps) in [(true, true), (true, false), (false, true), (false, false)] {
            let rows = 0..97;
            packets_equal_scalar(
                &scene,
                &Case {
                    shaded,
                    leaps,
                    rows,
                },
            )
            .unwrap();
        }
    }
}
