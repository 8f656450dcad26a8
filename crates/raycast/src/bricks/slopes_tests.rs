//! Tests of the bricks of slopes: they equal their definition, and pictures do not depend on which bricks exist.

use std::sync::Arc;

use crate::{
    Appearance, Frame, FrameOptions, InstructionSet, Interpolation, Method, NormalBricks, Transfer,
    TransferTable,
    bricks::{AXIS_AT, AXIS_WEIGHT, CORNER_AT, CORNER_WEIGHT},
    cast_rows,
    normals::Normals,
    packet::{TestLanes as _, TestSet, test_rise},
};
use carina_grid::{Affine, Camera, Grid, VolumeView};
use proptest::prelude::*;

/// Appearance of the test pictures.
const APPEARANCE: Appearance = Appearance {
    guides_mm: [[-1.9, -0.5, 0.0], [1.9, -0.5, 0.3]],
    exposure: Some(9.0),
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

struct Case {
    grid: Grid,
    hu: Vec<i16>,
    table: TransferTable,
}

impl Case {
    fn new(shape: [usize; 3], spacing: [f64; 3], hu: impl Fn([f64; 3]) -> f64) -> Self {
        let column = |a: usize| std::array::from_fn(|b| if a == b { spacing[a] } else { 0.0 });
        let place = Affine::from_columns(column(0), column(1), column(2), [0.0; 3]);
        let [nx, ny, nz] = shape;
        let grid = Grid::new([nz, ny, nx], place).unwrap();
        let hu = (0..grid.num_voxels())
            .map(|n| hu(grid.voxel(n).map(|v| v as f64)) as i16)
            .collect();
        let wall = vec![[-650.0, 0.9, 0.5, 0.5, 0.0], [-450.0, 0.9, 0.5, 0.5, 0.9]];
        let transfer = Transfer::new(wall, 1.0, 1).unwrap();
        let table = TransferTable::new(&transfer, 0.3, -1024, 3071).unwrap();
        Self { grid, hu, table }
    }

    fn random(shape: [usize; 3], spacing: [f64; 3], seed: u64) -> Self {
        let mut state = seed | 1;
        let noise: Vec<f64> = (0..shape.iter().product())
            .map(|_| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1);
                ((state >> 40) % 2200) as f64 - 1100.0
            })
            .collect();
        let [nx, ny, _] = shape;
        Self::new(shape, spacing, |[x, y, z]| {
            noise[(z as usize * ny + y as usize) * nx + x as usize]
        })
    }

    fn frame(&self) -> Frame<'_> {
        let volume = VolumeView::new(&self.hu, &self.grid).unwrap();
        let middle = self.grid.shape_ijk().map(|n| 0.5 * (n as f64 - 1.0));
        let mut pose = *Affine::IDENTITY.rows();
        let at = self.grid.lps_from_ijk().point(middle);
        for a in 0..3 {
            pose[a][3] = at[a];
        }
        let camera = Camera::new(Affine::from_rows(pose), 1.6, 48, 40).unwrap();
        let options = FrameOptions {
            interpolation: Interpolation::Trilinear,
            light: None,
            appearance: Some(APPEARANCE),
            background: [0.0; 3],
        };
        Frame::new(volume, &self.table, camera, options).unwrap()
    }
}

/// Return the slope at a voxel in f64 by its definition: fourteen samples of clamped values.
fn slope_at(frame: &Frame<'_>, voxel: [usize; 3]) -> [f64; 3] {
    let Normals { reach, held, .. } = Normals::of(frame);
    let last = frame.grid.shape_ijk().map(|n| n as isize - 1);
    let held_at = |ijk: [isize; 3]| {
        let at = |a: usize| ijk[a].clamp(0, last[a]) as usize * frame.field.stride[a];
        f64::from(frame.field.data[at(0) + at(1) + at(2)])
            .clamp(f64::from(held[0]), f64::from(held[1]))
    };
    let sample = |off: [f64; 3]| {
        let p: [f64; 3] = std::array::from_fn(|a| voxel[a] as f64 + off[a] * f64::from(reach[a]));
        let mut sum = 0.0;
        for corner in 0..8 {
            let high = |a: usize| corner >> a & 1;
            let weight: f64 = (0..3)
                .map(|a| p[a] - p[a].floor())
                .enumerate()
                .map(|(a, t)| if high(a) == 1 { t } else { 1.0 - t })
                .product();
            let ijk = std::array::from_fn(|a| p[a].floor() as isize + high(a) as isize);
            sum += weight * held_at(ijk);
        }
        sum
    };
    std::array::from_fn(|a| {
        let axis = |side: f64| {
            let mut off = [0.0; 3];
            off[a] = side * f64::from(AXIS_AT);
            sample(off)
        };
        let corners: f64 = (0..8)
            .map(|n| [0, 1, 2].map(|b| if n >> b & 1 == 1 { 1.0 } else { -1.0 }))
            .map(|side| side[a] * sample(side.map(|s| s * f64::from(CORNER_AT))))
            .sum();
        f64::from(AXIS_WEIGHT) * (axis(1.0) - axis(-1.0)) + f64::from(CORNER_WEIGHT) * corners
    })
}

/// Return the slope at a point as packets read it from the bricks, in one lane.
fn rise_at(frame: &Frame<'_>, bricks: &NormalBricks, p: [f32; 3]) -> [f32; 3] {
    let l = TestSet;
    let p = [l.splat(p[0]), l.splat(p[1]), l.splat(p[2])];
    let rise = test_rise(l, bricks, &frame.field, p);
    [0, 1, 2].map(|a| l.store(rise[a])[0])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn slopes_equal_their_definition_at_voxels_and_are_interpolated_between_them(
        shape in prop::array::uniform3(1usize..14), spacing in prop::array::uniform3(0.25f64..2.5),
        at in prop::array::uniform3(0.0f32..1.0), seed in any::<u64>(),
    ) {
        let case = Case::random(shape, spacing, seed);
        let frame = case.frame();
        let bricks = NormalBricks::of(&frame);
        let last = shape.map(|n| n as f32 - 1.0);
        let p: [f32; 3] = std::array::from_fn(|a| at[a] * last[a]);
        let found = rise_at(&frame, &bricks, p);
        let mut expected = [0.0; 3];
        for corner in 0..8 {
            let high = |a: usize| corner >> a & 1;
            let lower = |a: usize| (p[a] as usize).min(shape[a].saturating_sub(2));
            let weight: f64 = (0..3)
                .map(|a| f64::from(p[a]) - lower(a) as f64)
                .enumerate()
                .map(|(a, t)| if high(a) == 1 { t } else { 1.0 - t })
                .product();
            let voxel = std::array::from_fn(|a| (lower(a) + high(a)).min(shape[a] - 1));
            let slope = slope_at(&frame, voxel);
            for a in 0..3 {
                expected[a] += weight * slope[a];
            }
        }
        for a in 0..3 {
            // The tolerance is half a unit of the stored numbers.
            let off = (f64::from(found[a]) - expected[a]).abs();
            prop_assert!(off < 0.51 * f64::from(bricks.unit()) + 0.02, "{found:?} {expected:?}");
        }
    }
}

#[test]
fn a_picture_does_not_depend_on_the_stored_bricks_or_the_capacity() {
    let case = Case::new([30, 26, 22], [0.7, 0.8, 1.1], |[x, y, z]| {
        let off = [(x - 14.5) * 0.7, (y - 12.5) * 0.8, (z - 10.5) * 1.1];
        let tissue = (carina_grid::length(off) - 6.0 + (x * y).sin()).clamp(0.0, 1.0);
        -1000.0 + 1040.0 * tissue
    });
    let shown = |frame: &Frame<'_>, simd| cast_rows(frame, Method::Brute, 0..40, simd).unwrap().0;
    let truth = shown(&case.frame(), InstructionSet::Portable);
    for simd in InstructionSet::available() {
        for capacity in [0, 1, 2, 1000] {
            let bricks = Arc::new(NormalBricks::with_capacity(&case.frame(), capacity));
            let frame = case.frame().with_normals(Arc::clone(&bricks)).unwrap();
            for _ in 0..2 {
                assert!(
                    shown(&frame, simd) == truth,
                    "{simd:?}, room for {capacity}"
                );
            }
            assert_eq!(bricks.is_full(), capacity <= 2);
            assert!(bricks.len() <= capacity && bricks.is_empty() == (capacity == 0));
        }
    }
}

#[test]
fn bricks_of_another_transfer_function_are_rejected() {
    let case = Case::random([12, 12, 12], [1.0; 3], 7);
    let steep = vec![[-150.0, 0.9, 0.5, 0.5, 0.0], [200.0, 0.9, 0.5, 0.5, 0.9]];
    let other = Case {
        table: TransferTable::new(&Transfer::new(steep, 1.0, 1).unwrap(), 0.3, -1024, 3071)
            .unwrap(),
        grid: case.grid.clone(),
        hu: case.hu.clone(),
    };
    let bricks = Arc::new(NormalBricks::of(&other.frame()));
    let error = case.frame().with_normals(bricks).unwrap_err();
    assert!(error.to_string().contains("bricks of normals"), "{error}");
}

#[test]
fn slopes_of_a_blurred_plane_are_as_accurate_as_direct_samples() {
    let (mut worst, mut sum, mut sum_of_samples) = (0.0f64, 0.0, 0.0);
    for n in 0..40 {
        let turn = f64::from(n);
        let across = carina_grid::unit([turn.sin(), (1.7 * turn).cos(), (0.6 * turn).sin()])
            .expect("a direction");
        let spacing = [0.7, 0.7, 0.9];
        let case = Case::new([25, 25, 21], spacing, |ijk| {
            let from_middle: [f64; 3] =
                std::array::from_fn(|a| (ijk[a] - [12.0, 12.0, 10.0][a]) * spacing[a]);
            let edge = carina_grid::dot(from_middle, across) / 0.6;
            // The edge is a smooth step, about as blurred as by a scanner.
            -1000.0 + 1040.0 / (1.0 + (-2.4 * edge).exp())
        });
        let frame = case.frame();
        let p = [12.0 + 0.3 * turn.sin() as f32, 12.2, 9.7];
        let off = |normal: [f32; 3]| {
            let normal = carina_grid::unit(normal.map(f64::from)).expect("a slope");
            let cosine = carina_grid::dot(normal, across).abs();
            cosine.min(1.0).acos().to_degrees()
        };
        let normals = Normals::of(&frame);
        let rise = rise_at(&frame, &NormalBricks::of(&frame), p);
        let from_bricks = off(normals.rows.map(|row| crate::normals::dot(rise, row)));
        let ray = crate::frame::Ray {
            origin: [p[0], p[1], p[2], 0.0],
            delta: [0.1, 0.2, 0.3, 0.0],
            first: 0,
            end: 1,
        };
        sum_of_samples += off(normals.at(&frame, &ray, 0.0));
        sum += from_bricks;
        worst = worst.max(from_bricks);
    }
    assert!(worst < 2.0, "{worst} degrees");
    assert!(sum <= sum_of_samples, "{sum} {sum_of_samples}");
}
