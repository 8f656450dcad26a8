//! Random volumes on oblique, anisotropic grids, and cameras inside and outside them.

#![allow(
    dead_code,
    reason = "not every test that shares this module uses all of it"
)]

use carina_grid::{Affine, Camera, Grid};
use carina_isoregion::SegmentTable;
use carina_raycast::{FrameOptions, Interpolation, Light, Transfer, TransferTable};
use proptest::prelude::*;

#[derive(Debug, Clone)]
pub(crate) struct Scene {
    pub(crate) grid: Grid,
    pub(crate) hu: Vec<i16>,
    pub(crate) camera: Camera,
    pub(crate) step_vox: f64,
    pub(crate) points: Vec<[f64; 5]>,
}

impl Scene {
    pub(crate) fn transfer(&self, binned: bool) -> Transfer {
        Transfer::new(self.points.clone(), 1.0, if binned { 16 } else { 1 }).unwrap()
    }

    pub(crate) fn table(&self, binned: bool) -> TransferTable {
        let step_mm = self.step_vox * self.grid.min_spacing_mm();
        TransferTable::new(&self.transfer(binned), step_mm, -1024, 3071).unwrap()
    }

    /// Change the size of the viewport.
    pub(crate) fn resize(&mut self, width: usize, height: usize) {
        let pose = *self.camera.lps_from_camera();
        self.camera = Camera::new(pose, 1.5, width, height).unwrap();
    }

    /// Create a scene with a ball of air in tissue and a camera that looks along `look` from `offset_lps` off its
    /// centre.
    pub(crate) fn fixed(offset_lps: [f64; 3], look: [f64; 3]) -> Self {
        build(
            [18, 20, 22],
            [0.3, -0.4, 0.2],
            [0.7, 0.9, 1.6],
            offset_lps,
            look,
            1.4,
            0.5,
            3,
            wall(-700.0, -300.0),
        )
    }
}

pub(crate) fn options(shaded: bool, nearest: bool) -> FrameOptions {
    FrameOptions {
        interpolation: if nearest {
            Interpolation::Nearest
        } else {
            Interpolation::Trilinear
        },
        light: shaded.then_some(Light {
            ambient: 0.1,
            diffuse: 0.8,
            specular: 0.4,
            shininess_log2: 4,
            reach_mm: 25.0,
        }),
        appearance: None,
        background: [0.0; 3],
    }
}

fn wall(clear_hu: f64, opaque_hu: f64) -> Vec<[f64; 5]> {
    vec![
        [clear_hu, 0.9, 0.5, 0.4, 0.0],
        [opaque_hu, 0.9, 0.5, 0.4, 0.9],
        [300.0, 0.9, 0.8, 0.7, 0.9],
    ]
}

/// Return a transfer function of two transparent runs with a thin opaque run between them, and constant sections on
/// either side.
fn shell() -> Vec<[f64; 5]> {
    vec![
        [-600.0, 0.1, 0.9, 0.3, 0.0],
        [-599.0, 0.1, 0.9, 0.3, 0.3],
        [-580.0, 0.1, 0.9, 0.3, 0.3],
        [-579.0, 0.1, 0.9, 0.3, 0.0],
        [0.0, 0.9, 0.2, 0.3, 0.0],
        [1.0, 0.9, 0.2, 0.3, 0.2],
    ]
}

fn rotation(angles: [f64; 3]) -> Affine {
    let turn = |axis: usize, angle: f64| {
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut rows = *Affine::IDENTITY.rows();
        (rows[a][a], rows[b][b]) = (angle.cos(), angle.cos());
        (rows[a][b], rows[b][a]) = (-angle.sin(), angle.sin());
        Affine::from_rows(rows)
    };
    turn(0, angles[0])
        .after(&turn(1, angles[1]))
        .after(&turn(2, angles[2]))
}

fn build(
    shape: [usize; 3],
    oblique: [f64; 3],
    spacing: [f64; 3],
    offset_lps: [f64; 3],
    look: [f64; 3],
    fov_rad: f64,
    step_vox: f64,
    seed: u64,
    points: Vec<[f64; 5]>,
) -> Scene {
    let r = rotation(oblique);
    let column = |a: usize| r.column(a).map(|v| v * spacing[a]);
    let grid = Grid::new(
        shape,
        Affine::from_columns(column(0), column(1), column(2), [40.0, -70.0, 15.0]),
    )
    .unwrap();
    let n = grid.shape_ijk();
    let middle = grid.lps_from_ijk().point(n.map(|n| (n as f64 - 1.0) / 2.0));
    let mut state = seed | 1;
    let mut random = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1u32 << 31)
    };
    // The volume has air pockets in tissue, with noise of 20 HU and a few single voxels: regions are large, small or
    // absent.
    let pockets: Vec<([f64; 3], f64)> = (0..5)
        .map(|_| (n.map(|n| random() * n as f64), 2.0 + 7.0 * random()))
        .collect();
    let hu = (0..grid.num_voxels())
        .map(|index| {
            let v = grid.voxel(index).map(|v| v as f64);
            let air = pockets.iter().any(|(c, radius)| {
                (0..3).map(|a| (v[a] - c[a]).powi(2)).sum::<f64>() < radius * radius
            });
            let grain = random() < 0.004;
            let base = if air { -950.0 } else { 40.0 };
            (if grain { 2000.0 } else { base } + 40.0 * (random() - 0.5)) as i16
        })
        .collect();
    let pose = rotation(look);
    let position = std::array::from_fn(|a| middle[a] + offset_lps[a]);
    let lps_from_camera =
        Affine::from_columns(pose.column(0), pose.column(1), pose.column(2), position);
    Scene {
        grid,
        hu,
        camera: Camera::new(lps_from_camera, fov_rad, 17, 13).unwrap(),
        step_vox,
        points,
    }
}

pub(crate) fn any_scene() -> impl Strategy<Value = Scene> {
    (
        prop::array::uniform3(1usize..26),
        prop::array::uniform3(-3.1f64..3.1),
        prop::array::uniform3(0.4f64..3.0),
        // Half of the cameras are inside the volume, half around it.
        prop_oneof![
            prop::array::uniform3(-8.0f64..8.0),
            prop::array::uniform3(-90.0f64..90.0)
        ],
        prop::array::uniform3(-3.1f64..3.1),
        0.1f64..2.9,
        0.15f64..1.7,
        any::<u64>(),
        prop_oneof![
            Just(wall(-700.0, -300.0)),
            Just(wall(-500.0, -499.0)),
            Just(shell())
        ],
    )
        .prop_map(
            |(shape, oblique, spacing, offset, look, fov, step, seed, points)| {
                build(
                    shape, oblique, spacing, offset, look, fov, step, seed, points,
                )
            },
        )
}

/// Return the words of a map of values: label plus 256 times radius.
pub(crate) fn words(labels: &[u8], radius: &[u8]) -> Vec<u16> {
    let word = |(&label, &radius)| u16::from_le_bytes([label, radius]);
    labels.iter().zip(radius).map(word).collect()
}

/// Return the segment table of all 255 labels; labels without a colour are transparent.
pub(crate) fn step_table(mut colours: Vec<[f32; 4]>) -> SegmentTable {
    colours.resize(255, [0.0; 4]);
    SegmentTable::new(&colours)
}
