//! Tests of the two rays of a pixel on a silhouette.
//!
//! With these rays a picture is nearer to one of many rays per pixel, and changes only where a wall ends in front of
//! another one. The result is equal in strips, with leaps and from every caster. Depths stay those of the pixel's
//! centre.

use carina_grid::{
    Affine, Camera, FieldShape, Grid, ImageField, Lens, LensRays, Optics, VolumeView,
};
use carina_isoregion::{cell_map, class_labels};
use carina_raycast::{
    Appearance, Frame, FrameOptions, InstructionSet, Method, Transfer, TransferTable, cast_rows,
    cast_rows_scalar, cast_surface,
};

use crate::scene::options;

/// Spacing of the test volume along i, j, k, mm.
const SPACING: [f64; 3] = [0.6, 0.7, 0.65];
/// Number of voxels of the test volume along z, y, x.
const SHAPE_ZYX: [usize; 3] = [70, 90, 100];
/// Width and height of the test pictures, pixels.
const SIZE: usize = 72;

/// Appearance of plain matt walls, because the tests compare only the positions of their edges.
const MATT: Appearance = Appearance {
    guides_mm: [[0.0; 3]; 2],
    exposure: Some(120.0),
    ambient: 0.3,
    // The same wrap lighting as in shading by silhouettes, so that both kinds of shading give one brightness.
    wrap: 0.6,
    gloss: 0.0,
    shininess_log2: 6,
    paleness: 0.0,
    pale_hu: [0.0, 300.0],
    texture: 0.0,
    vessels: 0.0,
    silhouettes: true,
    specks: 0.0,
    secretions: 0.0,
    fog: 0.0,
    rings: 0.0,
    membrane: 0.0,
    hue: 0.0,
    spurs: 0.0,
};

struct Spur {
    grid: Grid,
    hu: Vec<i16>,
    table: TransferTable,
    radius: Vec<u8>,
}

/// Return a volume with a plate 9 mm in front of the camera and a wall 30 mm behind the plate.
///
/// The plate ends along a slanted line.
fn spur() -> Spur {
    let axes = [0, 1, 2].map(|a| std::array::from_fn(|b| if a == b { SPACING[a] } else { 0.0 }));
    let half = [0, 1].map(|a| -SPACING[a] * (SHAPE_ZYX[2 - a] as f64 - 1.0) / 2.0);
    let origin = [half[0], half[1], 0.0];
    let grid = Grid::new(
        SHAPE_ZYX,
        Affine::from_columns(axes[0], axes[1], axes[2], origin),
    )
    .unwrap();
    let hu: Vec<i16> = (0..grid.num_voxels())
        .map(|index| {
            let voxel = grid.voxel(index).map(|v| v as f64);
            let [x, y, z] = grid.lps_from_ijk().point(voxel);
            // The depths into the plate and into the wall, mm; edges are blurred as by a scanner.
            let plate = (z - 9.0).min(12.0 - z).min(0.4 * y - 0.9 * x + 0.7);
            let tissue = (plate.max(z - 39.0) / 0.9 + 0.5).clamp(0.0, 1.0);
            (-1000.0 + 1040.0 * tissue) as i16
        })
        .collect();
    let points = vec![[-700.0, 0.9, 0.6, 0.5, 0.0], [-300.0, 0.9, 0.6, 0.5, 0.97]];
    let transfer = Transfer::new(points, 1.0, 1).unwrap();
    let labels = class_labels(&hu, -1024, &transfer.range(-1024, 3071), true).unwrap();
    let radius = cell_map(&labels.labels, grid.shape_zyx()).unwrap();
    let table = TransferTable::new(&transfer, 0.3, -1024, 100).unwrap();
    Spur {
        grid,
        hu,
        table,
        radius,
    }
}

impl Spur {
    fn frame(&self, camera: Camera, appearance: Appearance) -> Frame<'_> {
        let volume = VolumeView::new(&self.hu, &self.grid).unwrap();
        let options = FrameOptions {
            appearance: Some(appearance),
            ..options(false, false)
        };
        Frame::new(volume, &self.table, camera, options).unwrap()
    }

    fn picture(&self, camera: &Camera, appearance: Appearance) -> Vec<u8> {
        let frame = self.frame(camera.clone(), appearance);
        let rows = 0..camera.height();
        let simd = InstructionSet::best();
        cast_rows(&frame, Method::LeapTransparent(&self.radius), rows, simd)
            .unwrap()
            .0
    }
}

fn pinhole(size: usize) -> Camera {
    let pose = Affine::from_columns([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]);
    Camera::new(pose, 1.2, size, size).unwrap()
}

/// Return a camera with a round outline.
fn scope(size: usize) -> Camera {
    let field = ImageField {
        shape: FieldShape::Round,
        ..ImageField::FULL
    };
    let optics = Optics::new(&Lens::Equidistant, Some(1.6), size, size).unwrap();
    let rays = LensRays::build(optics, &field).unwrap();
    Camera::with_lens(*pinhole(size).lps_from_camera(), rays.into()).unwrap()
}

/// Appearance in which every pixel has one ray.
const ONE_RAY: Appearance = Appearance {
    silhouettes: false,
    ..MATT
};

#[test]
fn two_rays_per_silhouette_pixel_reduce_the_error_and_change_no_other_pixel() {
    let spur = spur();
    for (name, camera, fine) in [
        ("pinhole", pinhole(SIZE), pinhole(8 * SIZE)),
        ("scope", scope(SIZE), scope(8 * SIZE)),
    ] {
        let fine = spur.picture(&fine, ONE_RAY);
        let (one, two) = (spur.picture(&camera, ONE_RAY), spur.picture(&camera, MATT));
        let (mut num_changed, mut off) = (0usize, [0.0f64; 2]);
        for n in 0..SIZE * SIZE {
            if one[3 * n..3 * n + 3] == two[3 * n..3 * n + 3] {
                continue;
            }
            num_changed += 1;
            let (column, row) = (n % SIZE, n / SIZE);
            let many: usize = (0..64)
                .map(|m| (8 * row + m / 8) * 8 * SIZE + 8 * column + m % 8)
                .map(|m| usize::from(fine[3 * m + 1]))
                .sum();
            for (off, found) in off.iter_mut().zip([&one, &two]) {
                *off += (f64::from(found[3 * n + 1]) - many as f64 / 64.0).abs();
            }
        }
        // The line crosses the picture once: one or two pixels of each row and column that it meets.
        assert!(
            (40..4 * SIZE).contains(&num_changed),
            "{name}: {num_changed}"
        );
        // The two rays remove half of the error of a pixel that the line halves, and none of the error of a neighbour
        // on the silhouette that the line only touches; the measured ratio for both together is 0.76.
        assert!(off[1] < 0.85 * off[0], "{name}: {off:?}");
    }
}

#[test]
fn silhouettes_are_equal_in_strips_with_leaps_and_for_every_caster() {
    let spur = spur();
    for camera in [pinhole(SIZE), scope(SIZE)] {
        let appearance = Appearance {
            exposure: None,
            gloss: 0.5,
            texture: 1.0,
            specks: 1.0,
            secretions: 0.7,
            fog: 0.3,
            ..MATT
        };
        let frame = spur.frame(camera, appearance);
        let scalar = InstructionSet::Portable;
        let truth = cast_rows_scalar(&frame, Method::Brute, 0..SIZE, scalar).unwrap();
        for simd in InstructionSet::available() {
            for method in [Method::Brute, Method::LeapTransparent(&spur.radius)] {
                for cut in [1, 2, 3, 4, 5, 17, 36, SIZE - 1] {
                    let parts = [0..cut, cut..cut + 1, cut + 1..SIZE]
                        .map(|rows| cast_rows(&frame, method, rows, simd).unwrap());
                    let found = parts.each_ref().map(|(rgb, _)| rgb.clone()).concat();
                    assert!(found == truth.0, "{} {method:?} {cut}", simd.name());
                    let num: u64 = parts.iter().map(|(_, stats)| stats.num_rays).sum();
                    assert_eq!(num, (SIZE * SIZE) as u64, "each pixel is counted once");
                    if matches!(method, Method::Brute) {
                        let num: u64 = parts.iter().map(|(_, stats)| stats.num_samples).sum();
                        assert_eq!(num, truth.1.num_samples);
                    }
                }
            }
        }
    }
}

#[test]
fn depths_are_those_of_pixel_centres_and_a_smooth_wall_has_no_silhouette() {
    let spur = spur();
    let depths = |appearance| {
        let frame = spur.frame(pinhole(SIZE), appearance);
        cast_surface(&frame, Method::Brute, 0..SIZE, InstructionSet::best())
            .unwrap()
            .0
    };
    assert!(depths(MATT) == depths(ONE_RAY));
    // The scenes are a wall at normal incidence, and a wall so slanted that the depth doubles from one end of the
    // picture to the other.
    for (at, forward, down, fov_rad) in [
        ([-12.0, 0.0, 20.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], 1.2),
        ([-12.0, -15.0, 34.0], [0.0, 0.8, 0.6], [0.0, 0.6, -0.8], 0.5),
    ] {
        let pose = Affine::from_columns([1.0, 0.0, 0.0], down, forward, at);
        let camera = Camera::new(pose, fov_rad, SIZE, SIZE).unwrap();
        let (one, two) = (spur.picture(&camera, ONE_RAY), spur.picture(&camera, MATT));
        let num_changed = one
            .chunks(3)
            .zip(two.chunks(3))
            .filter(|(a, b)| a != b)
            .count();
        assert!(one.iter().any(|&v| v > 60));
        assert_eq!(num_changed, 0, "{at:?}");
    }
}
