use std::f64::consts::TAU;

use carina_grid::{Affine, Grid, Ijk, VolumeView};
use proptest::prelude::*;

use crate::mesh::cell_rings;
use crate::outline::{LumenSurface, PARTS_PER_PX, PicturePoint, TooRagged, encoded};
use carina_leastcost::lumen::WallLevels;

/// Value levels of the drawn lumen and wall.
const LEVELS: WallLevels = WallLevels {
    core: -900.0,
    wall: -500.0,
    rise: 25.0,
};

/// Random number generator with a fixed sequence for each seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn direction(&mut self) -> [f64; 3] {
        loop {
            let v = [0, 1, 2].map(|_| 2.0 * self.next() - 1.0);
            let length = dot(v, v).sqrt();
            if (0.1..1.0).contains(&length) {
                return v.map(|c| c / length);
            }
        }
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Return the transform from grid to picture for a plane through the point `middle`, with its size in pixels.
fn plane(normal: [f64; 3], middle: [f64; 3], mm_per_px: f64, size: usize) -> Affine {
    let beside = if normal[0].abs() < 0.7 {
        [1.0, 0.0, 0.0]
    } else {
        [0.0, 1.0, 0.0]
    };
    let across = cross(normal, beside);
    let right = across.map(|v| v / dot(across, across).sqrt());
    let down = cross(normal, right);
    let half = size as f64 / 2.0 * mm_per_px;
    let first = std::array::from_fn(|a| middle[a] - half * (right[a] + down[a]));
    Affine::from_columns(
        right.map(|v| v * mm_per_px),
        down.map(|v| v * mm_per_px),
        normal,
        first,
    )
}

/// Return an oblique, anisotropic grid, either right-handed or mirrored.
fn oblique(shape_zyx: [usize; 3], spacing: [f64; 3], mirrored: bool) -> Grid {
    let (c, s) = (0.3f64.cos(), 0.3f64.sin());
    let x = [c, s, 0.0].map(|v| v * if mirrored { -spacing[0] } else { spacing[0] });
    let y = [-s, c, 0.0].map(|v| v * spacing[1]);
    let place = Affine::from_columns(x, y, [0.0, 0.0, spacing[2]], [11.0, -70.0, 130.0]);
    Grid::new(shape_zyx, place).unwrap()
}

fn lines_of(
    values: VolumeView<'_, i16>,
    lumen: &[u8],
    levels: Option<WallLevels>,
    lps_from_pixel: &Affine,
    size: usize,
) -> Vec<Vec<PicturePoint>> {
    let surface = LumenSurface::new(lumen, values.grid().shape_ijk());
    let pixel_from_lps = lps_from_pixel.inverse().unwrap();
    let pixel_from_ijk = pixel_from_lps.after(values.grid().lps_from_ijk());
    surface
        .cut(values, lumen, levels, &pixel_from_ijk, (size, size))
        .unwrap()
}

/// Return the winding number of closed lines round a point.
fn winding(lines: &[Vec<PicturePoint>], at: PicturePoint) -> i32 {
    let mut turns = 0;
    for pair in lines.iter().flat_map(|line| line.windows(2)) {
        let [a, b] = [pair[0], pair[1]];
        if (a[1] <= at[1]) == (b[1] <= at[1]) {
            continue;
        }
        let x = a[0] + (at[1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
        if x > at[0] {
            turns += if b[1] > a[1] { 1 } else { -1 };
        }
    }
    turns
}

#[test]
fn no_cell_has_two_rings_with_a_vertex_at_the_centre() {
    for (case, rings) in cell_rings().iter().enumerate() {
        let without = rings.iter().filter(|ring| !ring.has_apex).count();
        assert!(without <= 1, "{case:08b}");
    }
}

#[test]
fn the_outline_of_a_ball_is_within_half_a_voxel_of_its_wall_on_any_plane() {
    let (radius, spacing, size) = (7.0, [0.6, 0.7, 1.5], 300);
    let mut random = Random(7);
    for mirrored in [false, true] {
        let grid = oblique([22, 40, 46], spacing, mirrored);
        let middle = grid.to_lps(Ijk([22.3, 19.6, 10.4])).0;
        let from_middle = |n: usize| {
            let at = [n % 46, n / 46 % 40, n / (46 * 40)].map(|v| v as f64);
            let p = grid.to_lps(Ijk(at)).0;
            let offset = std::array::from_fn(|a| p[a] - middle[a]);
            dot(offset, offset).sqrt()
        };
        // The wall is blurred as by a scanner, with the half-maximum at the radius.
        let values: Vec<i16> = (0..grid.num_voxels())
            .map(|n| {
                let up = ((from_middle(n) - radius) / 1.6 + 0.5).clamp(0.0, 1.0);
                (-1000.0 + 1000.0 * up) as i16
            })
            .collect();
        let lumen: Vec<u8> = values.iter().map(|v| u8::from(*v <= -600)).collect();
        let view = VolumeView::new(&values, &grid).unwrap();
        let mut worst: f64 = 0.0;
        for turn in 0..60 {
            let normal = match turn {
                0..3 => std::array::from_fn(|a| if a == turn { 1.0 } else { 0.0 }),
                _ => random.direction(),
            };
            let aside = (random.next() - 0.5) * radius;
            let centre = std::array::from_fn(|a| middle[a] + aside * normal[a]);
            let mm_per_px = 0.06;
            let place = plane(normal, centre, mm_per_px, size);
            let lines = lines_of(view, &lumen, Some(LEVELS), &place, size);
            assert_eq!(lines.len(), 1, "one ring");
            assert_eq!(lines[0].first(), lines[0].last(), "it is closed");
            let mut length = 0.0;
            for pair in lines[0].windows(2) {
                length += (pair[0][0] - pair[1][0]).hypot(pair[0][1] - pair[1][1]) * mm_per_px;
                let p = place.point([pair[0][0], pair[0][1], 0.0]);
                let offset: [f64; 3] = std::array::from_fn(|a| p[a] - middle[a]);
                let off = dot(offset, offset).sqrt() - radius;
                // Half a voxel along the direction to the wall, which is the direction of the radius.
                let along = offset.map(|v| v / dot(offset, offset).sqrt());
                let axes = [0, 1, 2].map(|a| grid.lps_from_ijk().column(a));
                let half = axes
                    .map(|axis| dot(axis, along).abs())
                    .into_iter()
                    .fold(0.0, f64::max)
                    / 2.0;
                assert!(off.abs() <= half, "{off} mm off, half a voxel is {half} mm");
                worst = worst.max(off.abs());
            }
            let round = TAU * (radius * radius - aside * aside).sqrt();
            assert!(
                (length / round - 1.0).abs() < 0.04,
                "{length} mm of {round} mm"
            );
        }
        assert!(
            worst < 0.35,
            "{worst} mm: below the voxel's own half of 0.3 to 0.75 mm"
        );
    }
}

#[test]
fn planes_through_voxel_centres_and_between_them_have_closed_outlines() {
    let grid = Grid::new([9, 20, 20], Affine::IDENTITY).unwrap();
    let values = vec![0i16; grid.num_voxels()];
    let lumen: Vec<u8> = (0..values.len())
        .map(|n| u8::from((5..15).contains(&(n % 20)) && (4..9).contains(&(n / 20 % 20))))
        .collect();
    let view = VolumeView::new(&values, &grid).unwrap();
    for k in [0.0, 3.0, 3.5, 7.9, 8.0] {
        let place = plane([0.0, 0.0, 1.0], [9.5, 9.5, k], 0.1, 200);
        let lines = lines_of(view, &lumen, None, &place, 200);
        assert_eq!(lines.len(), 1, "at {k}");
        let points: Vec<_> = lines[0]
            .iter()
            .map(|p| place.point([p[0], p[1], 0.0]))
            .collect();
        let ends = |a: usize| {
            let all = points.iter().map(|p| p[a]);
            (
                all.clone().fold(f64::MAX, f64::min),
                all.fold(f64::MIN, f64::max),
            )
        };
        // The expected edges are half-way between voxels, because a mask has no information about the wall.
        for ((low, high), (first, last)) in [(ends(0), (4.5, 14.5)), (ends(1), (3.5, 8.5))] {
            assert!(
                (low - first).abs() < 1e-6 && (high - last).abs() < 1e-6,
                "{low} {high} at {k}"
            );
        }
    }
}

#[test]
fn a_lumen_of_noise_is_rejected_as_too_ragged() {
    let grid = Grid::new([3, 600, 600], Affine::IDENTITY).unwrap();
    let values = vec![0i16; grid.num_voxels()];
    let lumen: Vec<u8> = (0..values.len())
        .map(|n| ((n % 600 + n / 600 % 600) % 2) as u8)
        .collect();
    let view = VolumeView::new(&values, &grid).unwrap();
    let surface = LumenSurface::new(&lumen, grid.shape_ijk());
    let place = plane([0.0, 0.0, 1.0], [299.5, 299.5, 1.0], 1.0, 600);
    let pixel_from_ijk = place.inverse().unwrap();
    let found = surface.cut(view, &lumen, None, &pixel_from_ijk, (600, 600));
    assert_eq!(found, Err(TooRagged));
}

fn decoded(bytes: &[u8]) -> Vec<Vec<PicturePoint>> {
    let mut lines = Vec::new();
    let word = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    let mut at = 0;
    while at < bytes.len() {
        let count = usize::from(word(at));
        let point =
            |n: usize| [0, 1].map(|a| f64::from(word(at + 2 + 4 * n + 2 * a)) / PARTS_PER_PX);
        lines.push((0..count).map(point).collect());
        at += 2 + 4 * count;
    }
    lines
}

fn off_segment(at: PicturePoint, a: PicturePoint, b: PicturePoint) -> f64 {
    let (x, y) = (b[0] - a[0], b[1] - a[1]);
    let squared = x * x + y * y;
    let t = if squared > 0.0 {
        (((at[0] - a[0]) * x + (at[1] - a[1]) * y) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (at[0] - a[0] - t * x).hypot(at[1] - a[1] - t * y)
}

fn off_lines(at: PicturePoint, lines: &[Vec<PicturePoint>]) -> f64 {
    let parts = lines.iter().flat_map(|line| line.windows(2));
    parts
        .map(|pair| off_segment(at, pair[0], pair[1]))
        .fold(f64::MAX, f64::min)
}

#[test]
fn encoded_lines_deviate_by_at_most_a_quarter_pixel_and_end_at_the_pictures_edge() {
    let size = (40, 30);
    let ring: Vec<PicturePoint> = (0..=400)
        .map(|n| {
            let turn = f64::from(n) / 400.0 * TAU;
            [30.0 + 18.0 * turn.cos(), 12.0 + 9.0 * turn.sin()]
        })
        .collect();
    let tiny = vec![[5.0, 25.0], [5.1, 25.0], [5.0, 25.1], [5.0, 25.0]];
    let lines = decoded(&encoded(&[ring.clone(), tiny], size));
    assert!(lines.len() >= 2);
    let num_points: usize = lines.iter().map(Vec::len).sum();
    assert!(
        num_points < 300,
        "{num_points}: points nearer than a quarter of a pixel are one"
    );
    for point in lines.iter().flatten() {
        assert!(
            (0.0..=40.0).contains(&point[0]) && (0.0..=30.0).contains(&point[1]),
            "{point:?}"
        );
    }
    for point in &ring {
        if (0.0..=40.0).contains(&point[0]) && (0.0..=30.0).contains(&point[1]) {
            assert!(off_lines(*point, &lines) < 0.25, "{point:?}");
        }
    }
    assert!(
        lines.iter().flatten().any(|p| p[0] == 40.0),
        "cut off at the edge itself"
    );
    assert!(
        off_lines([5.0, 25.0], &lines) < 0.2,
        "a ring below a pixel is still seen"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn the_outline_of_any_mask_separates_the_lumen_to_half_a_voxel_on_any_plane(
        seed: u64,
        values in prop::collection::vec(-1000i16..200, 13 * 12 * 11),
        with_levels: bool,
        mirrored: bool,
    ) {
        let mut random = Random(seed);
        let grid = oblique([13, 12, 11], [0.7, 0.8, 1.6], mirrored);
        // Connected blobs instead of single voxels: a voxel is lumen where the sum of four random waves is high.
        let waves: Vec<([f64; 3], f64)> = (0..4).map(|_| (random.direction(), random.next() * TAU)).collect();
        let lumen: Vec<u8> = (0..values.len())
            .map(|n| {
                let at = [n % 11, n / 11 % 12, n / 132].map(|v| v as f64);
                let sum: f64 = waves.iter().map(|(d, phase)| (dot(at, *d) * 0.9 + phase).sin()).sum();
                u8::from(sum > 0.4)
            })
            .collect();
        let view = VolumeView::new(&values, &grid).unwrap();
        let size = 160;
        let middle = grid.to_lps(Ijk([5.0, 5.5, 6.0])).0;
        let centre = std::array::from_fn(|a| middle[a] + (random.next() - 0.5) * 6.0);
        let place = plane(random.direction(), centre, 0.16, size);
        let lines = lines_of(view, &lumen, with_levels.then_some(LEVELS), &place, size);
        let ijk_from_pixel = grid.ijk_from_lps().after(&place);
        let shape = [11isize, 12, 13];
        let is_lumen = |v: [isize; 3]| {
            (0..3).all(|a| (0..shape[a]).contains(&v[a])) && lumen[((v[2] * 12 + v[1]) * 11 + v[0]) as usize] != 0
        };
        // True if a voxel of this kind is nearer than half a voxel: a voxel's box extends half a voxel round its
        // centre.
        let near = |p: [f64; 3], kind: bool| {
            (0..125).any(|n| {
                let v: [isize; 3] = std::array::from_fn(|a| p[a].round() as isize + [n % 5, n / 5 % 5, n / 25][a] - 2);
                let off: f64 = (0..3).map(|a| ((p[a] - v[a] as f64).abs() - 0.5).max(0.0).powi(2)).sum();
                is_lumen(v) == kind && off.sqrt() <= 0.5
            })
        };
        for pair in lines.iter().flat_map(|line| line.windows(2)) {
            for t in [0.0, 0.5] {
                let at = [0, 1].map(|a| pair[0][a] + t * (pair[1][a] - pair[0][a]));
                let p = ijk_from_pixel.point([at[0], at[1], 0.0]);
                prop_assert!(near(p, true) && near(p, false), "{p:?}");
            }
        }
        for _ in 0..200 {
            let at = [0, 1].map(|_| random.next() * size as f64);
            let p = ijk_from_pixel.point([at[0], at[1], 0.0]);
            let inside = near(p, true);
            if inside && near(p, false) {
                continue;
            }
            // Lines that leave the picture are not closed, so winding numbers near the edge of the picture have no
            // meaning.
            let open = lines.iter().any(|line| line.first() != line.last());
            if !open {
                prop_assert_eq!(winding(&lines, at) != 0, inside, "{:?}", p);
            }
        }
    }
}
