//! Tests that compare radiographs with exact line integrals.

use carina_grid::{Affine, Grid, VolumeView, clip_line_to_box, dot};

use crate::InstructionSet;
use crate::drr::{Attenuation, Projector, cast_radiograph};

/// Attenuation of water without bone.
const WATER: Attenuation = Attenuation {
    air: -1000.0,
    bone: 100.0,
    bone_gain: 1.0,
};

/// Return the transform of a detector that looks along `dir`, with pixels of `pitch` mm round `centre`.
fn detector(centre: [f64; 3], dir: [f64; 3], pitch: f64, size: usize) -> Affine {
    let dir = carina_grid::unit(dir).unwrap();
    let side = if dir[0].abs() < 0.9 {
        [1.0, 0.0, 0.0]
    } else {
        [0.0, 1.0, 0.0]
    };
    let right = carina_grid::unit(carina_grid::cross(side, dir)).unwrap();
    let down = carina_grid::cross(dir, right);
    let corner =
        std::array::from_fn(|a| centre[a] - (right[a] + down[a]) * pitch * size as f64 / 2.0);
    Affine::from_columns(
        right.map(|v| v * pitch),
        down.map(|v| v * pitch),
        dir,
        corner,
    )
}

/// Return an oblique grid of anisotropic voxels.
fn oblique(shape_zyx: [usize; 3]) -> Grid {
    let (s, c) = (libm::sin(0.4), libm::cos(0.4));
    let place = Affine::from_columns(
        [0.8 * c, 0.8 * s, 0.0],
        [-0.9 * s, 0.9 * c, 0.0],
        [0.0, 0.0, -1.3],
        [-20.0, 5.0, 40.0],
    );
    Grid::new(shape_zyx, place).unwrap()
}

/// Return the length inside the box of a grid of the ray from `origin` along the unit vector `dir`.
fn length_in_box(grid: &Grid, origin: [f64; 3], dir: [f64; 3]) -> f64 {
    let to = grid.ijk_from_lps();
    let hi = grid.shape_ijk().map(|n| n as f64 - 0.5);
    clip_line_to_box(to.point(origin), to.vector(dir), [-0.5; 3], hi)
        .map_or(0.0, |(a, b)| (b - a.max(0.0)).max(0.0))
}

#[test]
fn a_box_of_water_gives_the_length_of_each_ray_in_it() {
    let grid = oblique([30, 41, 52]);
    let data = vec![0i16; grid.num_voxels()];
    let volume = VolumeView::new(&data, &grid).unwrap();
    let middle = grid.lps_from_ijk().point([25.5, 20.0, 14.5]);
    for dir in [
        [0.3, 1.0, -0.2],
        [1.0, 0.2, 0.9],
        [0.1, -0.3, 1.0],
        [0.0, 0.0, -1.0],
        [1.0, 1.0, 1.0],
    ] {
        let dir = carina_grid::unit(dir).unwrap();
        let far: [f64; 3] = std::array::from_fn(|a| middle[a] + 300.0 * dir[a]);
        let source: [f64; 3] = std::array::from_fn(|a| middle[a] - 500.0 * dir[a]);
        let place = detector(far, dir, 1.9, 50);
        for source_lps in [None, Some(source), Some(middle)] {
            let projector = Projector {
                lps_from_pixel: place,
                source_lps,
            };
            let found =
                cast_radiograph(volume, &projector, WATER, 50, 0..50, InstructionSet::best())
                    .unwrap();
            let mut seen = 0;
            for (n, &mm) in found.iter().enumerate() {
                let pixel = place.point([(n % 50) as f64 + 0.5, (n / 50) as f64 + 0.5, 0.0]);
                let expected = source_lps.map_or_else(
                    || {
                        // Parallel rays start at infinity, so the expected ray starts far outside the box.
                        let from = std::array::from_fn(|a| pixel[a] - 2000.0 * dir[a]);
                        length_in_box(&grid, from, dir)
                    },
                    |s| {
                        let way =
                            carina_grid::unit(std::array::from_fn(|a| pixel[a] - s[a])).unwrap();
                        length_in_box(&grid, s, way)
                    },
                );
                // The tolerance is 1e-4 of a length of up to 80 mm, and 1e-3 mm: coordinates in f32 are accurate to
                // 1e-5 voxels, sums of some 50 slabs to 1e-5.
                assert!(
                    (f64::from(mm) - expected).abs() <= 1e-4 * expected + 1e-3,
                    "{dir:?} {source_lps:?} pixel {n}: {mm} for {expected}"
                );
                seen += usize::from(expected > 1.0);
            }
            assert!(seen > 300, "{seen} rays through the box");
        }
    }
}

#[test]
fn ellipsoids_of_water_and_bone_give_their_chords() {
    // The object is an ellipsoid of water (0 HU) in air that contains a smaller ellipsoid of bone (700 HU). The chords
    // follow from the quadratic equation; above 100 HU bone attenuates twice as much per HU.
    let n = 96usize;
    let grid = Grid::new(
        [n, n, n],
        Affine::from_columns([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]),
    )
    .unwrap();
    let centre = [47.3, 46.1, 48.9];
    let radii = [[36.0, 22.0, 30.0], [9.0, 11.0, 8.0]];
    // Each voxel is the mean of 4^3 points (partial volume): a scanner reports the mean of the attenuation.
    let data: Vec<i16> = (0..n * n * n)
        .map(|index| {
            let p = grid.voxel(index);
            let mut sum = 0f64;
            for m in 0..64 {
                let q: [f64; 3] = std::array::from_fn(|a| {
                    let part = (m >> (2 * a) & 3) as f64;
                    (p[a] as f64 + (part + 0.5) / 4.0 - 0.5 - centre[a]).abs()
                });
                let inside = |r: [f64; 3]| (0..3).map(|a| (q[a] / r[a]).powi(2)).sum::<f64>() < 1.0;
                sum += if inside(radii[1]) {
                    700.0
                } else if inside(radii[0]) {
                    0.0
                } else {
                    -1000.0
                };
            }
            (sum / 64.0).round() as i16
        })
        .collect();
    let volume = VolumeView::new(&data, &grid).unwrap();
    let chord = |r: [f64; 3], o: [f64; 3], d: [f64; 3]| {
        let o: [f64; 3] = std::array::from_fn(|a| (o[a] - centre[a]) / r[a]);
        let d: [f64; 3] = std::array::from_fn(|a| d[a] / r[a]);
        let (aa, bb, cc) = (dot(d, d), dot(o, d), dot(o, o) - 1.0);
        2.0 * (bb * bb - aa * cc).max(0.0).sqrt() / aa
    };
    for dir in [[0.1, 1.0, 0.05], [1.0, 0.4, -0.3], [0.6, 0.6, 0.6]] {
        let dir = carina_grid::unit(dir).unwrap();
        let far: [f64; 3] = std::array::from_fn(|a| centre[a] + 200.0 * dir[a]);
        let source: [f64; 3] = std::array::from_fn(|a| centre[a] - 400.0 * dir[a]);
        let place = detector(far, dir, 2.0, 64);
        let projector = Projector {
            lps_from_pixel: place,
            source_lps: Some(source),
        };
        let found =
            cast_radiograph(volume, &projector, WATER, 64, 0..64, InstructionSet::best()).unwrap();
        let (mut worst, mut sum, mut num) = (0f64, 0f64, 0);
        for (k, &mm) in found.iter().enumerate() {
            let pixel = place.point([(k % 64) as f64 + 0.5, (k / 64) as f64 + 0.5, 0.0]);
            let way = carina_grid::unit(std::array::from_fn(|a| pixel[a] - source[a])).unwrap();
            let (water, bone) = (chord(radii[0], source, way), chord(radii[1], source, way));
            // Water is 1; bone is 1.7 on the HU scale, plus (700 - 100) / 1000.
            let expected = water + bone * (0.7 + 0.6);
            let near_bone = chord(radii[1].map(|r| r + 1.5), source, way) > 0.0;
            // The rims are excluded, because the chord changes there by more than a millimetre over a voxel.
            if water > 20.0 && (!near_bone || bone > 14.0) {
                let off = f64::from(mm) - expected;
                worst = worst.max(off.abs());
                sum += off;
                num += 1;
            }
        }
        assert!(num > 300, "{num}");
        // A diagonal ray reads a plane every 1.7 mm, and the surfaces in a 1 mm grid are accurate to a fraction of 1.7
        // mm at either end. The mean error has no bias.
        assert!(worst < 1.0, "{dir:?}: {worst} mm");
        assert!(
            (sum / f64::from(num)).abs() < 0.1,
            "{dir:?}: mean {}",
            sum / f64::from(num)
        );
    }
}

#[test]
fn radiographs_of_tissue_equal_fine_sampling_along_the_ray() {
    let grid = oblique([40, 41, 42]);
    let data: Vec<i16> = (0..grid.num_voxels())
        .map(|n| {
            let [x, y, z] = grid.voxel(n).map(|v| v as f64);
            (-100.0 + 500.0 * libm::sin(0.3 * x + 0.2 * y) + 400.0 * libm::cos(0.25 * z - 0.1 * x))
                as i16
        })
        .collect();
    let volume = VolumeView::new(&data, &grid).unwrap();
    let at = |p: [f64; 3]| {
        let q: [f64; 3] =
            std::array::from_fn(|a| p[a].clamp(0.0, grid.shape_ijk()[a] as f64 - 1.0));
        let low: [usize; 3] = std::array::from_fn(|a| (q[a] as usize).min(grid.shape_ijk()[a] - 2));
        (0..8).fold(0.0, |sum, corner: usize| {
            let bit: [usize; 3] = std::array::from_fn(|a| corner >> a & 1);
            let weight: f64 = (0..3)
                .map(|a| {
                    let t = q[a] - low[a] as f64;
                    if bit[a] == 1 { t } else { 1.0 - t }
                })
                .product();
            sum + weight * f64::from(volume.at(std::array::from_fn(|a| low[a] + bit[a])))
        })
    };
    let middle = grid.lps_from_ijk().point([20.0, 20.0, 20.0]);
    for dir in [[0.3, 1.0, -0.2], [1.0, 0.8, 0.9]] {
        let dir = carina_grid::unit(dir).unwrap();
        let far: [f64; 3] = std::array::from_fn(|a| middle[a] + 300.0 * dir[a]);
        let source: [f64; 3] = std::array::from_fn(|a| middle[a] - 500.0 * dir[a]);
        let place = detector(far, dir, 5.0, 16);
        let projector = Projector {
            lps_from_pixel: place,
            source_lps: Some(source),
        };
        let found =
            cast_radiograph(volume, &projector, WATER, 16, 0..16, InstructionSet::best()).unwrap();
        for (n, &mm) in found.iter().enumerate() {
            let pixel = place.point([(n % 16) as f64 + 0.5, (n / 16) as f64 + 0.5, 0.0]);
            let way = carina_grid::unit(std::array::from_fn(|a| pixel[a] - source[a])).unwrap();
            let to = grid.ijk_from_lps();
            let (o, d) = (to.point(source), to.vector(way));
            let hi = grid.shape_ijk().map(|n| n as f64 - 0.5);
            let Some((t0, t1)) = clip_line_to_box(o, d, [-0.5; 3], hi) else {
                assert!(mm == 0.0);
                continue;
            };
            let num = ((t1 - t0) / 0.02).ceil().max(1.0);
            let step = (t1 - t0) / num;
            let expected: f64 = (0..num as usize)
                .map(|k| {
                    let t = t0 + (k as f64 + 0.5) * step;
                    let v = at(std::array::from_fn(|a| o[a] + t * d[a]));
                    step * ((v + 1000.0).max(0.0) + (v - 100.0).max(0.0)) / 1000.0
                })
                .sum();
            // A plane is read where the ray crosses it and stands for its slab. In tissue that changes by 150 HU per
            // voxel the sum is accurate to 0.2 %, and in the two slabs that the volume cuts to 0.1 mm.
            assert!(
                (f64::from(mm) - expected).abs() < 2e-3 * expected + 0.1,
                "{dir:?} pixel {n}: {mm} for {expected}"
            );
        }
    }
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let grid = oblique([20, 31, 22]);
    let data: Vec<i16> = (0..grid.num_voxels())
        .map(|n| (n * 7919 % 3001) as i16 - 1200)
        .collect();
    let volume = VolumeView::new(&data, &grid).unwrap();
    let middle = grid.lps_from_ijk().point([10.0, 15.0, 10.0]);
    let dir = carina_grid::unit([0.5, 0.6, 0.55]).unwrap();
    let far: [f64; 3] = std::array::from_fn(|a| middle[a] + 20.0 * dir[a]);
    let source: [f64; 3] = std::array::from_fn(|a| middle[a] - 30.0 * dir[a]);
    // The source is so near that packets contain rays with different dominant axes.
    let projector = Projector {
        lps_from_pixel: detector(far, dir, 3.0, 37),
        source_lps: Some(source),
    };
    let cast = |simd| cast_radiograph(volume, &projector, WATER, 37, 0..37, simd).unwrap();
    let reference = cast(InstructionSet::Portable);
    assert!(reference.iter().filter(|&&mm| mm > 1.0).count() > 200);
    for simd in InstructionSet::available() {
        let bits = |image: &[f32]| image.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&cast(simd)), bits(&reference), "{}", simd.name());
        let strip = cast_radiograph(volume, &projector, WATER, 37, 11..29, simd).unwrap();
        assert_eq!(bits(&strip), bits(&reference[11 * 37..29 * 37]));
    }
}

#[test]
fn one_slice_gives_its_length_and_a_nan_attenuation_is_rejected() {
    let grid = Grid::new([1, 5, 6], Affine::IDENTITY).unwrap();
    let data = vec![0i16; 30];
    let volume = VolumeView::new(&data, &grid).unwrap();
    let projector = Projector {
        lps_from_pixel: detector([2.5, 2.0, 9.0], [0.0, 0.0, 1.0], 1.0, 5),
        source_lps: None,
    };
    let found =
        cast_radiograph(volume, &projector, WATER, 5, 0..5, InstructionSet::best()).unwrap();
    assert!((found[12] - 1.0).abs() < 1e-5, "{}", found[12]);
    let broken = Attenuation {
        air: f32::NAN,
        ..WATER
    };
    let refused = cast_radiograph(volume, &projector, broken, 5, 0..5, InstructionSet::best());
    assert_eq!(refused.unwrap_err().code(), "render.setting");
}
