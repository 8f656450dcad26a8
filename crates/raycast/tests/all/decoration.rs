//! Tests of the decoration that depends on anatomy.
//!
//! The pictures are equal, bit for bit, from every caster and for any pixels in one register, and the decoration moves
//! no wall.

use crate::scene::{Scene, any_scene, options};
use carina_grid::{Affine, Camera, Grid, VolumeView};
use carina_isoregion::{cell_map, class_labels};
use carina_raycast::{
    Appearance, DECORATION_CHANNELS, Decoration, Frame, FrameOptions, InstructionSet, Method,
    cast_rows, cast_rows_scalar, cast_surface,
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
    vessels: 0.5,
    silhouettes: true,
    specks: 1.0,
    secretions: 0.5,
    fog: 0.0,
    rings: 1.0,
    membrane: 1.0,
    hue: 1.0,
    spurs: 1.0,
};

fn lit(appearance: Appearance) -> FrameOptions {
    FrameOptions {
        appearance: Some(appearance),
        ..options(false, false)
    }
}

/// Number of cells of the decoration's grid along z, y, x.
const SHAPE: [usize; 3] = [4, 3, 5];

/// Return a strategy for cells with random values in the range of an airway.
fn any_cells() -> impl Strategy<Value = Vec<f32>> {
    let cell = (
        -5.0f32..30.0,
        -1.7f32..1.7,
        -1.7f32..1.7,
        proptest::array::uniform5(prop_oneof![Just(0.0f32), Just(1.0), 0.0f32..1.0]),
    )
        .prop_map(|(phase, left, back, parts)| {
            let mut cell = vec![phase, left, back];
            cell.extend(parts);
            cell
        });
    proptest::collection::vec(cell, SHAPE.iter().product::<usize>())
        .prop_map(|cells| cells.concat())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn decorated_pictures_are_equal_for_every_caster_and_in_strips(
        mut scene in any_scene(), cells in any_cells(), size in (1usize..36, 1usize..20), cut in 0.0f64..1.0,
        origin in proptest::array::uniform3(-12.0f32..4.0), cell_mm in 0.5f32..9.0,
        parts in proptest::array::uniform4(prop_oneof![Just(0.0f32), 0.0f32..1.0]), texture in prop_oneof![Just(0.0f32), 0.0f32..2.0],
    ) {
        scene.resize(size.0, size.1);
        let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
        let table = scene.table(false);
        let [rings, membrane, hue, spurs] = parts;
        let appearance = Appearance { rings, membrane, hue, spurs, texture, ..APPEARANCE };
        let field = Decoration::new(&cells, SHAPE, origin, cell_mm).unwrap();
        let frame = Frame::new(volume, &table, scene.camera.clone(), lit(appearance)).unwrap().decorated_by(field);
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
fn decoration_changes_light_and_colour_and_moves_no_wall() {
    let mut scene = Scene::fixed([0.0; 3], [0.2, 0.1, 1.0]);
    scene.resize(60, 50);
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let middle = scene.camera.origin_lps().map(|v| v as f32 - 20.0);
    // Rings run along z everywhere; each cell is at the middle of a wall's circumference.
    let cells: Vec<f32> = (0..5 * 5 * 5)
        .flat_map(|n| {
            let phase = (n / 25) as f32 * 2.0;
            [phase, 0.0, -1.0, 1.0, 1.0, 0.0, 1.0, 1.0]
        })
        .collect();
    let field = Decoration::new(&cells, [5; 3], middle, 10.0).unwrap();
    let plain = Frame::new(volume, &table, scene.camera.clone(), lit(APPEARANCE)).unwrap();
    let decorated = plain.clone().decorated_by(field);
    for simd in InstructionSet::available() {
        let [with, without] = [&decorated, &plain].map(|frame| {
            let walls = cast_surface(frame, Method::Brute, 0..50, simd).unwrap().0;
            (
                cast_rows(frame, Method::Brute, 0..50, simd).unwrap().0,
                walls,
            )
        });
        assert!(with.0 != without.0);
        assert!(with.1 == without.1);
        let bare = APPEARANCE_WITHOUT_ANATOMY;
        let bare = Frame::new(volume, &table, scene.camera.clone(), lit(bare)).unwrap();
        let found = cast_rows(
            &bare.clone().decorated_by(field),
            Method::Brute,
            0..50,
            simd,
        )
        .unwrap();
        assert!(found.0 == cast_rows(&bare, Method::Brute, 0..50, simd).unwrap().0);
    }
}

#[test]
fn folds_do_not_darken_a_wall_that_faces_sideways() {
    // The scene has two walls, to the left and right of a camera that appearances along them. The decoration marks both as
    // the back wall, as can happen in a trachea with corners.
    let grid = Grid::new([48, 24, 24], Affine::IDENTITY).unwrap();
    let hu: Vec<i16> = (0..grid.num_voxels())
        .map(|at| {
            let side = grid.voxel(at)[0].abs_diff(12);
            [40, -950][usize::from(side < 6)]
        })
        .collect();
    let pose = Affine::from_columns(
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [12.0, 12.0, 2.0],
    );
    let scene = Scene {
        camera: Camera::new(pose, 1.5, 96, 64).unwrap(),
        grid,
        hu,
        ..Scene::fixed([0.0; 3], [0.0; 3])
    };
    let cells: Vec<f32> = (0..6 * 4 * 4)
        .flat_map(|n| {
            let (across, along) = (n / 4 % 4, n / 16);
            let [phase, left] = [along as f32 * 1.8, across as f32 * 1.1 - 1.0];
            [phase, left, 1.0, 0.0, 1.0, 0.0, 1.0, 1.0]
        })
        .collect();
    let field = Decoration::new(&cells, [6, 4, 4], [-1.0; 3], 10.0).unwrap();
    let volume = VolumeView::new(&scene.hu, &scene.grid).unwrap();
    let table = scene.table(false);
    let appearance = Appearance {
        texture: 0.0,
        vessels: 0.0,
        specks: 0.0,
        secretions: 0.0,
        gloss: 0.0,
        silhouettes: false,
        exposure: Some(60.0),
        ..APPEARANCE
    };
    let plain = Frame::new(volume, &table, scene.camera.clone(), lit(appearance)).unwrap();
    let [with, without] = [plain.clone().decorated_by(field), plain].map(|frame| {
        let simd = InstructionSet::Portable;
        cast_rows(&frame, Method::Brute, 0..64, simd).unwrap().0
    });
    let darkest = with
        .iter()
        .zip(&without)
        .filter(|(_, plain)| **plain > 100)
        .map(|(with, plain)| f32::from(*with) / f32::from(*plain))
        .fold(1.0, f32::min);
    assert!(with != without);
    assert!(darkest > 0.7, "{darkest}");
}

/// Appearance without the features that depend on anatomy.
const APPEARANCE_WITHOUT_ANATOMY: Appearance = Appearance {
    rings: 0.0,
    membrane: 0.0,
    hue: 0.0,
    spurs: 0.0,
    ..APPEARANCE
};

#[test]
fn invalid_decorations_are_rejected() {
    let cells = vec![0.0; 2 * 3 * 4 * DECORATION_CHANNELS];
    let made = |shape, origin, cell_mm| Decoration::new(&cells, shape, origin, cell_mm);
    assert!(made([2, 3, 4], [0.0; 3], 2.5).is_ok());
    for shape in [[2, 3, 5], [1, 6, 4], [0, 3, 4], [usize::MAX, 3, 4]] {
        assert!(made(shape, [0.0; 3], 2.5).is_err(), "{shape:?}");
    }
    for cell_mm in [0.0, -1.0, f32::NAN, 1e9] {
        assert!(made([2, 3, 4], [0.0; 3], cell_mm).is_err(), "{cell_mm}");
    }
    assert!(made([2, 3, 4], [f32::NAN; 3], 2.5).is_err());
    assert!(Decoration::new(&cells[1..], [2, 3, 4], [0.0; 3], 2.5).is_err());
    let volume = Scene::fixed([0.0; 3], [0.0, 0.0, 1.0]);
    let table = volume.table(false);
    let view = VolumeView::new(&volume.hu, &volume.grid).unwrap();
    for appearance in [
        Appearance {
            rings: -0.1,
            ..APPEARANCE
        },
        Appearance {
            membrane: f32::NAN,
            ..APPEARANCE
        },
        Appearance {
            hue: 2.1,
            ..APPEARANCE
        },
        Appearance {
            spurs: 1.1,
            ..APPEARANCE
        },
    ] {
        assert!(Frame::new(view, &table, volume.camera.clone(), lit(appearance)).is_err());
    }
}
