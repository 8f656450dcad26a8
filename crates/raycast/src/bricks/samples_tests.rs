//! Tests of the bricks of values and gradients: pictures read from them equal those of the scalar caster.

use std::sync::Arc;

use crate::{
    Frame, FrameOptions, InstructionSet, Interpolation, Light, Method, SampleBricks, Transfer,
    TransferTable, cast_rows, cast_rows_scalar,
};
use carina_grid::{Affine, Camera, Grid, VolumeView};
use proptest::prelude::*;

/// Light at the camera of the test pictures.
const LIGHT: Light = Light {
    ambient: 0.2,
    diffuse: 0.8,
    specular: 0.3,
    shininess_log2: 3,
    reach_mm: 30.0,
};

struct Case {
    grid: Grid,
    values: Vec<i16>,
    table: TransferTable,
    pose: Affine,
}

impl Case {
    /// Create a case with random values between two limits, half of them visible, seen from the middle or from a
    /// corner.
    fn random(shape: [usize; 3], limits: [i16; 2], seed: u64) -> Self {
        let mut state = seed | 1;
        let mut random = |n: i64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as i64 % n
        };
        let [low, high] = limits.map(i64::from);
        let grid = Grid::new(shape, Affine::IDENTITY).unwrap();
        let values = (0..grid.num_voxels())
            .map(|_| (low + random(high - low + 1)) as i16)
            .collect();
        let middle = low.midpoint(high) as f64;
        let points = vec![
            [middle, 0.9, 0.5, 0.4, 0.0],
            [high as f64, 0.8, 0.6, 0.5, 0.4],
        ];
        let transfer = Transfer::new(points, 1.0, 1).unwrap();
        let part = [0.1, 0.5][random(2) as usize];
        let at = shape.map(|n| part * (n as f64 - 1.0));
        let rows = *Affine::IDENTITY.rows();
        Self {
            grid,
            values,
            table: TransferTable::new(&transfer, 0.4, limits[0], limits[1]).unwrap(),
            pose: Affine::from_rows(std::array::from_fn(|a| {
                let [x, y, z, _] = rows[a];
                [x, y, z, at[a]]
            })),
        }
    }

    fn frame(&self) -> Frame<'_> {
        let volume = VolumeView::new(&self.values, &self.grid).unwrap();
        let camera = Camera::new(self.pose, 1.6, 24, 16).unwrap();
        let options = FrameOptions {
            interpolation: Interpolation::Trilinear,
            light: Some(LIGHT),
            appearance: None,
            background: [0.1, 0.2, 0.3],
        };
        Frame::new(volume, &self.table, camera, options).unwrap()
    }

    /// Check that pictures of all instruction sets, cast twice from the same bricks, equal the scalar caster's picture.
    ///
    /// Return the cache of bricks, which stores at most `capacity` bricks.
    fn check(&self, capacity: usize) -> Arc<SampleBricks> {
        let (truth, counts) = cast_rows_scalar(
            &self.frame(),
            Method::Brute,
            0..16,
            InstructionSet::Portable,
        )
        .unwrap();
        let bricks = Arc::new(SampleBricks::with_capacity(
            self.frame().shape_ijk(),
            capacity,
        ));
        for simd in InstructionSet::available() {
            let frame = self.frame().with_samples(Arc::clone(&bricks)).unwrap();
            for _ in 0..2 {
                let (shown, stats) = cast_rows(&frame, Method::Brute, 0..16, simd).unwrap();
                assert!(shown == truth, "{simd:?}, room for {capacity}");
                assert_eq!(stats, counts);
            }
        }
        bricks
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn pictures_from_bricks_equal_those_of_the_scalar_caster(
        shape in prop::array::uniform3(1usize..14), seed in any::<u64>(), capacity in 0usize..40,
    ) {
        let bricks = Case::random(shape, [-1024, 3071], seed).check(capacity);
        prop_assert!(bricks.len() <= capacity);
    }

    #[test]
    fn differences_beyond_int16_are_read_from_the_volume(
        shape in prop::array::uniform3(2usize..10), seed in any::<u64>(),
    ) {
        // Half of the volume has differences that do not fit in the bricks; the other half is stored.
        let mut case = Case::random(shape, [-32_768, 32_767], seed);
        let half = case.values.len() / 2;
        for value in &mut case.values[half..] {
            *value /= 8;
        }
        case.check(1000);
    }
}

#[test]
fn extreme_values_store_no_brick_and_ct_values_fill_the_visible_bricks() {
    let extreme = Case::random([9, 9, 9], [-32_768, 32_767], 5).check(1000);
    assert!(extreme.is_empty() && !extreme.is_full());
    let seen = Case::random([9, 9, 9], [-1024, 3071], 5).check(1000);
    assert!((1..=8).contains(&seen.len()) && !seen.is_full());
    let crowded = Case::random([9, 9, 9], [-1024, 3071], 5).check(3);
    assert!(crowded.is_full() && crowded.len() == 3);
}

#[test]
fn bricks_of_another_shape_are_rejected() {
    let (case, other) = (
        Case::random([8, 8, 8], [0, 100], 1),
        Case::random([8, 8, 9], [0, 100], 1),
    );
    let samples = Arc::new(SampleBricks::of(other.frame().shape_ijk()));
    let error = case.frame().with_samples(samples).unwrap_err();
    assert!(error.to_string().contains("bricks of values"), "{error}");
}
