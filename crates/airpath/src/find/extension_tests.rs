//! Tests of the search for small airways beyond the flood, on drawn tubes.
//!
//! The extension follows a faint tube and crosses a short gap, but enters neither the lung nor a groove.

use carina_grid::{Affine, Grid, VolumeView, length};

use crate::find::extension::{EXTENDED, Extension, ExtensionLimits, extend};
use crate::find::extension_levels::Divided;
use carina_leastcost::Unwatched;

/// Limits with which the search runs in these tests.
const LIMITS: ExtensionLimits = ExtensionLimits {
    air: -1000.0,
    lung: (-950, -600),
    brightest: -500,
    least_rise: 20.0,
    gap_mm: 2.0,
    min_length_mm: 4.0,
    raised: 1.0,
    most_reached: 1.0,
    least_probability: 0.0,
    divided: None,
};

struct Drawn {
    grid: Grid,
    values: Vec<i16>,
    lumen: Vec<u8>,
}

/// Draw noisy lung with a wide dark tube along x up to `known_mm`, which is the known lumen, and a thin faint tube from
/// there up to `ends_mm`.
///
/// `dimmed` is the factor of the wall's brightness at a position.
fn drawn(noise_hu: f64, known_mm: f64, ends_mm: f64, dimmed: impl Fn([f64; 3]) -> f64) -> Drawn {
    let place = Affine::from_columns(
        [0.0, 0.65, 0.0],
        [-0.7, 0.0, 0.0],
        [0.0, 0.0, 0.75],
        [10.0, 20.0, -30.0],
    );
    let grid = Grid::new([40, 46, 100], place).unwrap();
    let mut state = 7u64;
    let mut unit = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 33) as f64 / f64::from(1u32 << 31)
    };
    let spacing = grid.spacing_mm();
    let (mut values, mut lumen) = (Vec::new(), Vec::new());
    for at in 0..grid.num_voxels() {
        let v = grid.voxel(at);
        let p: [f64; 3] = std::array::from_fn(|a| v[a] as f64 * spacing[a]);
        let off = length([0.0, p[1] - 16.0, p[2] - 15.0]);
        let radius = if p[0] < known_mm { 2.2 } else { 0.8 };
        let inside = |r: f64| {
            let beyond = (p[0] - ends_mm).max(0.0);
            1.0 / (1.0 + ((off.hypot(beyond) - r) / 0.28).exp())
        };
        let air = inside(radius);
        let wall = (inside(radius + 0.6) - air) * dimmed(p);
        // The sum of twelve uniform random numbers has a standard deviation of 1.
        let noise: f64 = (0..12).map(|_| unit()).sum::<f64>() - 6.0;
        values.push((-865.0 + 800.0 * wall - 135.0 * air + noise_hu * noise).round() as i16);
        lumen.push(u8::from(off < 2.0 && p[0] < known_mm));
    }
    Drawn {
        grid,
        values,
        lumen,
    }
}

fn extended(drawn: &mut Drawn) -> Extension {
    let view = VolumeView::new(&drawn.values, &drawn.grid).unwrap();
    extend(view, &mut drawn.lumen, &LIMITS, &Unwatched).unwrap()
}

fn farthest_mm(drawn: &Drawn) -> f64 {
    (0..drawn.lumen.len())
        .filter(|at| drawn.lumen[*at] != 0)
        .map(|at| drawn.grid.voxel(at)[0] as f64 * drawn.grid.spacing_mm()[0])
        .fold(0.0, f64::max)
}

#[test]
fn a_faint_tube_is_followed_to_its_end_and_no_farther() {
    for noise in [0.0, 15.0, 30.0] {
        let mut chest = drawn(noise, 20.0, 50.0, |_| 1.0);
        let found = extended(&mut chest);
        let end = farthest_mm(&chest);
        assert!((45.0..=51.5).contains(&end), "noise {noise}: ends at {end}");
        assert_eq!(found.followed.len(), 1, "noise {noise}");
        // No added voxel may be outside the tube's outer wall: 0.8 + 0.6 mm, and half a voxel.
        for (at, _) in chest
            .lumen
            .iter()
            .enumerate()
            .filter(|(_, v)| **v == EXTENDED)
        {
            let v = chest.grid.voxel(at);
            let off = length([
                0.0,
                v[1] as f64 * chest.grid.spacing_mm()[1] - 16.0,
                v[2] as f64 * chest.grid.spacing_mm()[2] - 15.0,
            ]);
            let outer = if v[0] as f64 * chest.grid.spacing_mm()[0] < 21.0 {
                2.8
            } else {
                1.4
            };
            assert!(off < outer + 0.4, "noise {noise}: {off} at {v:?}");
        }
    }
}

#[test]
fn a_short_gap_in_the_wall_is_crossed_and_a_long_gap_ends_the_path() {
    let gap = |long: f64| {
        let mut chest = drawn(10.0, 20.0, 50.0, move |p| {
            if (30.0..30.0 + long).contains(&p[0]) {
                0.0
            } else {
                1.0
            }
        });
        extended(&mut chest);
        farthest_mm(&chest)
    };
    assert!(gap(1.2) > 44.0, "{}", gap(1.2));
    let long = gap(8.0);
    assert!((27.0..34.0).contains(&long), "{long}");
}

#[test]
fn in_divided_slices_a_path_ends_at_long_enclosed_lung_even_if_a_tube_follows() {
    let limits = ExtensionLimits {
        divided: Some(Divided {
            axis: 2,
            slice_mm: 3.0,
            least_odds: 99.0,
        }),
        ..LIMITS
    };
    let over = |long_mm: f64| {
        let mut chest = drawn(10.0, 10.0, 62.0, |_| 1.0);
        let spacing = chest.grid.spacing_mm();
        for at in 0..chest.values.len() {
            let v = chest.grid.voxel(at);
            let p: [f64; 3] = std::array::from_fn(|a| v[a] as f64 * spacing[a]);
            let off = length([0.0, p[1] - 16.0, p[2] - 15.0]);
            if (24.0..24.0 + long_mm).contains(&p[0]) && off < 3.2 {
                // A channel as wide as an airway with dark air, but filled with values of lung.
                chest.values[at] = if off < 2.2 { -860 } else { -100 };
            }
        }
        let view = VolumeView::new(&chest.values, &chest.grid).unwrap();
        extend(view, &mut chest.lumen, &limits, &Unwatched).unwrap();
        farthest_mm(&chest)
    };
    let short = over(3.0);
    assert!(short > 55.0, "{short}");
    let long = over(10.0);
    assert!((20.0..30.0).contains(&long), "{long}");
}

#[test]
fn lung_round_a_tube_that_ends_adds_nothing() {
    for noise in [10.0, 40.0, 60.0] {
        let mut chest = drawn(noise, 40.0, 40.0, |_| 1.0);
        let found = extended(&mut chest);
        assert_eq!(found.followed, vec![], "noise {noise}");
        assert_eq!(found.num_voxels, 0);
        assert!(chest.lumen.iter().all(|v| *v <= 1));
    }
}

#[test]
fn a_straight_tube_is_probable_and_paths_below_the_least_probability_are_rejected() {
    let follow = |least_probability: f64| {
        let mut chest = drawn(30.0, 20.0, 50.0, |_| 1.0);
        let view = VolumeView::new(&chest.values, &chest.grid).unwrap();
        let limits = ExtensionLimits {
            least_probability,
            ..LIMITS
        };
        extend(view, &mut chest.lumen, &limits, &Unwatched).unwrap()
    };
    let found = follow(0.7);
    assert_eq!(found.followed.len(), 1);
    let probability = found.followed[0].probability;
    assert!((0.9..1.0).contains(&probability), "{probability}");
    assert_eq!(follow(probability + 1e-6).followed, vec![]);
}

#[test]
fn a_groove_between_two_vessels_is_not_followed() {
    // Two adjacent bright bars with lung between them, from the end of the known tube on.
    let mut chest = drawn(15.0, 20.0, 20.0, |_| 1.0);
    let spacing = chest.grid.spacing_mm();
    for at in 0..chest.values.len() {
        let v = chest.grid.voxel(at);
        let p: [f64; 3] = std::array::from_fn(|a| v[a] as f64 * spacing[a]);
        for side in [-3.2, 3.2] {
            let off = length([0.0, p[1] - 16.0 - side, p[2] - 15.0]);
            if p[0] > 10.0 && off < 1.9 {
                chest.values[at] = 40;
            }
        }
    }
    let found = extended(&mut chest);
    assert_eq!(found.followed, vec![]);
}

#[test]
fn a_search_that_reaches_too_much_of_the_lung_is_cancelled_and_adds_nothing() {
    // Several copies of a chest side by side, because the lung of one copy is too small for the share.
    let one = drawn(15.0, 20.0, 50.0, |_| 1.0);
    let grid = Grid::new([40 * 14, 46, 100], *one.grid.lps_from_ijk()).unwrap();
    let (values, lumen) = (one.values.repeat(14), one.lumen.repeat(14));
    let view = VolumeView::new(&values, &grid).unwrap();
    let mut given = lumen.clone();
    let found = extend(view, &mut given, &LIMITS, &Unwatched).unwrap();
    assert!(!found.ran_out && found.num_reached > 200 && found.num_voxels > 0);
    let sheets = ExtensionLimits {
        most_reached: 1e-5,
        ..LIMITS
    };
    let mut given = lumen.clone();
    let found = extend(view, &mut given, &sheets, &Unwatched).unwrap();
    assert!(found.ran_out && found.followed.is_empty() && found.num_voxels == 0);
    assert!(given == lumen);
}

#[test]
fn a_higher_enclosure_threshold_follows_less() {
    let follow = |raised: f64| {
        let mut chest = drawn(30.0, 20.0, 50.0, |_| 1.0);
        let view = VolumeView::new(&chest.values, &chest.grid).unwrap();
        let limits = ExtensionLimits { raised, ..LIMITS };
        let found = extend(view, &mut chest.lumen, &limits, &Unwatched).unwrap();
        (found.num_reached, found.enclosed)
    };
    let (low, high) = (follow(1.0), follow(3.0));
    assert!(high.0 < low.0, "{low:?} {high:?}");
    assert!(high.1 > 2.5 * low.1, "{low:?} {high:?}");
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(|| {
                let mut chest = drawn(20.0, 20.0, 50.0, |_| 1.0);
                (extended(&mut chest), chest.lumen)
            })
    };
    assert!(on(1) == on(3));
}

#[test]
fn a_stopped_search_returns_an_error_and_a_lumen_with_marks_is_rejected() {
    struct Never;
    impl carina_leastcost::Watch for Never {
        fn report_fraction(&self, _fraction: f64) -> Result<(), carina_leastcost::TrackError> {
            Err(carina_leastcost::TrackError::Cancelled)
        }
    }
    let chest = drawn(0.0, 20.0, 30.0, |_| 1.0);
    let view = VolumeView::new(&chest.values, &chest.grid).unwrap();
    let mut lumen = chest.lumen.clone();
    assert_eq!(
        extend(view, &mut lumen, &LIMITS, &Never),
        Err(carina_leastcost::TrackError::Cancelled)
    );
}
