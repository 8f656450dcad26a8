//! Contract tests of the packets.
//!
//! On every instruction set of this machine, pictures and statistics equal those of the scalar casters, bit for bit.

use std::ops::Range;

use crate::scene::{Scene, any_scene, options, step_table, words};
use carina_grid::{Affine, Camera, Grid, VolumeView};
use carina_isoregion::{cell_map, class_labels, radius_map, value_labels};
use carina_raycast::{
    CastStats, ClassMap, Frame, InstructionSet, Method, ValueMap, cast_rows, cast_rows_scalar,
};
use proptest::prelude::*;

/// Method of a cast, and interpolation of its samples.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Brute,
    Transparent,
    /// Leaps over all classes, which are never shaded.
    Classes,
    /// Leaps over equal values, only for samples of the nearest voxel.
    Values,
}

#[derive(Debug, Clone)]
struct Case {
    kind: Kind,
    shaded: bool,
    nearest: bool,
    rows: Range<usize>,
}

fn any_kind() -> impl Strategy<Value = (Kind, bool, bool)> {
    prop_oneof![
        (Just(Kind::Brute), any::<bool>(), any::<bool>()),
        (Just(Kind::Transparent), any::<bool>(), any::<bool>()),
        (Just(Kind::Classes), Just(false), Just(false)),
        (Just(Kind::Values), Just(false), Just(true)),
    ]
    .prop_map(|(kind, shaded, nearest)| (kind, shaded, nearest && !shaded))
}

/// Radii and labels of a volume, and one value of each class.
///
/// The radii are those of cells, unless all classes are leaped.
struct Maps {
    radius: Vec<u8>,
    labels: Vec<u8>,
    values: Vec<i32>,
}

fn maps(scene: &Scene, case: &Case) -> Maps {
    let entries = scene.transfer(case.nearest).range(-1100, 3100);
    let by_radius = matches!(case.kind, Kind::Classes | Kind::Values);
    let out = if case.kind == Kind::Values {
        value_labels(&scene.hu, |_, _| false)
    } else {
        class_labels(&scene.hu, -1100, &entries, !by_radius).unwrap()
    };
    let map = if by_radius { radius_map } else { cell_map };
    Maps {
        radius: map(&out.labels, scene.grid.shape_zyx()).unwrap(),
        labels: out.labels,
        values: out.classes.iter().map(|class| class.lo_hu).collect(),
    }
}

type Cast = (Vec<u8>, CastStats);

/// Cast a scene with the scalar casters, and with packets on every instruction set of this machine.
fn cast(scene: &Scene, maps: &Maps, case: &Case) -> (Cast, Vec<(InstructionSet, Cast)>) {
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(case.nearest);
    let settings = options(case.shaded, case.nearest);
    let frame = Frame::new(volume, &table, scene.camera.clone(), settings).unwrap();
    let colours: Vec<_> = maps.values.iter().map(|&v| table.entry(v)).collect();
    let segments = step_table(colours);
    let words = words(&maps.labels, &maps.radius);
    let method = match case.kind {
        Kind::Brute => Method::Brute,
        Kind::Transparent => Method::LeapTransparent(&maps.radius),
        Kind::Classes => Method::LeapClasses(ClassMap {
            labels: &maps.labels,
            radius: &maps.radius,
            segments: &segments,
        }),
        Kind::Values => Method::LeapValues(ValueMap {
            words: &words,
            segments: &segments,
            prefetch: false,
        }),
    };
    let best = InstructionSet::best();
    let truth = cast_rows_scalar(&frame, method, case.rows.clone(), best).unwrap();
    let found = InstructionSet::available()
        .into_iter()
        .flat_map(|simd| {
            let prefetched = match method {
                Method::LeapValues(map) => Method::LeapValues(ValueMap {
                    prefetch: true,
                    ..map
                }),
                _ => method,
            };
            [method, prefetched].map(|method| {
                let out = cast_rows(&frame, method, case.rows.clone(), simd).unwrap();
                (simd, out)
            })
        })
        .collect();
    (truth, found)
}

fn packets_equal_scalar(scene: &Scene, case: &Case) -> Result<(), TestCaseError> {
    packets_equal_scalar_with(scene, &maps(scene, case), case)
}

fn packets_equal_scalar_with(scene: &Scene, maps: &Maps, case: &Case) -> Result<(), TestCaseError> {
    let (truth, all) = cast(scene, maps, case);
    for (simd, found) in all {
        prop_assert_eq!(found.1, truth.1, "{} {:?}", simd.name(), case);
        if let Some(at) = found.0.iter().zip(&truth.0).position(|(a, b)| a != b) {
            let (pixel, width) = (at / 3, scene.camera.width());
            return Err(TestCaseError::fail(format!(
                "{} {case:?}: column {}, row {}: {} for {}",
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
        kind in any_kind(),
        cut in prop::array::uniform2(0.0f64..1.0),
    ) {
        // The widths and heights fill no packet, and strips start and end inside a band.
        scene.resize(size.0, size.1);
        let at = cut.map(|c| (c * (size.1 + 1) as f64) as usize);
        let rows = at[0].min(at[1])..at[0].max(at[1]);
        let (kind, shaded, nearest) = kind;
        packets_equal_scalar(&scene, &Case { kind, shaded, nearest, rows })?;
        packets_equal_scalar(&scene, &Case { kind, shaded, nearest, rows: 0..size.1 })?;
    }

    #[test]
    fn packets_read_extreme_values_as_the_scalar_casters_do(
        mut scene in any_scene(), kind in any_kind(), seed in any::<u64>(),
    ) {
        // The values span the whole int16 range, so that differences of voxels need 17 bits and values are beyond both
        // ends of the table.
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
        // The map is made for the values in the table; other values are clamped to them.
        let mut clamped = scene.clone();
        for hu in &mut clamped.hu {
            *hu = (*hu).clamp(-1100, 3100);
        }
        let (kind, shaded, nearest) = kind;
        let case = Case { kind, shaded, nearest, rows: 0..scene.camera.height() };
        packets_equal_scalar_with(&scene, &maps(&clamped, &case), &case)?;
    }

    #[test]
    fn packets_read_every_byte_of_a_map_as_the_scalar_casters_do(
        scene in any_scene(), kind in any_kind(), seed in any::<u64>(),
    ) {
        // The maps are random and do not belong to the volume: a real map is 0 at the border, but the last bytes are
        // those that are difficult to gather.
        let mut state = seed | 1;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            if state >> 63 == 0 { 0 } else { (state >> 40) as u8 }
        };
        let (kind, shaded, nearest) = kind;
        let maps = Maps {
            radius: scene.hu.iter().map(|_| random()).collect(),
            labels: scene.hu.iter().map(|_| random()).collect(),
            values: (0..255).map(|n| n * 16 - 1100).collect(),
        };
        let rows = 0..scene.camera.height();
        packets_equal_scalar_with(&scene, &maps, &Case { kind, shaded, nearest, rows })?;
    }
}

/// Methods that are tested, each with shading and interpolation.
const KINDS: [(Kind, bool, bool); 8] = [
    (Kind::Brute, true, false),
    (Kind::Transparent, true, false),
    (Kind::Brute, false, false),
    (Kind::Transparent, false, false),
    (Kind::Classes, false, false),
    (Kind::Brute, false, true),
    (Kind::Transparent, false, true),
    (Kind::Values, false, true),
];

#[test]
fn rays_without_advance_on_an_axis_equal_the_scalar_casters() {
    // Grid and camera are not rotated, and the size is odd: the middle column and row have steps of exactly 0.
    let shape = [9, 11, 13];
    let grid = Grid::new(shape, Affine::IDENTITY).unwrap();
    let hu = (0..grid.num_voxels())
        .map(|n| (n * 7919 % 1500) as i16 - 1000)
        .collect();
    let mut scene = Scene::fixed([0.0; 3], [0.0; 3]);
    (scene.grid, scene.hu) = (grid, hu);
    // The cameras are in front of the volume, in it, behind it, and to the side, from where the middle column never
    // meets it.
    for at in [
        [6.0, 5.0, -9.0],
        [6.0, 5.0, 4.0],
        [6.0, 5.0, 30.0],
        [-4.0, 5.0, -9.0],
        [6.0, 40.0, -9.0],
    ] {
        let pose = Affine::from_columns([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], at);
        scene.camera = Camera::new(pose, 1.5, 33, 21).unwrap();
        for (kind, shaded, nearest) in KINDS {
            let rows = 0..21;
            let case = Case {
                kind,
                shaded,
                nearest,
                rows,
            };
            packets_equal_scalar(&scene, &case).unwrap();
        }
    }
}

#[test]
fn packets_equal_the_scalar_casters_over_a_whole_picture() {
    // The picture has many bands, threads and refills; the camera is inside the volume and outside it.
    for offset in [[0.0, 0.5, -0.5], [30.0, -8.0, 4.0]] {
        let mut scene = Scene::fixed(offset, [0.2, -1.1, 0.4]);
        scene.resize(131, 97);
        for (kind, shaded, nearest) in KINDS {
            let rows = 0..97;
            let case = Case {
                kind,
                shaded,
                nearest,
                rows,
            };
            packets_equal_scalar(&scene, &case).unwrap();
        }
    }
}
