//! Tests of the search for thin airways on drawn chests.
//!
//! The search follows a thread with a dark middle, but neither vessels nor lung.

use carina_grid::{Affine, Grid, VolumeView, cross, dot, length, unit};
use carina_leastcost::{TrackError, Unwatched, Watch};

use crate::find::extension_levels::{EXTENDED, LUMEN};
use crate::find::thin::{Thin, ThinLimits, extend_thin};

/// Limits with which the search runs in these tests.
const LIMITS: ThinLimits = ThinLimits {
    air: -1000.0,
    lung: (-950, -600),
    brightest: -400,
    least_wall: -700.0,
    least_dip: 22.0,
    least_mean_dip: 20.0,
    blur_mm: 0.85,
    min_length_mm: 2.0,
    min_side_mm: 5.0,
    most_reached: 1.0,
};
/// End of the known airway, mm along the grid's axes.
const START_MM: [f64; 3] = [12.0, 12.5, 12.0];
/// Direction in which the airway continues from its known end, along no axis of the grid.
const ALONG: [f64; 3] = [0.86, 0.33, 0.39];
/// Radius of the known airway, mm.
const KNOWN_RADIUS_MM: f64 = 1.9;

struct Drawn {
    grid: Grid,
    values: Vec<i16>,
    lumen: Vec<u8>,
}

/// Return the coordinates of a point relative to the end of the known airway, mm: along the continuation, and along two
/// axes across it.
fn along_and_off(p: [f64; 3]) -> [f64; 3] {
    let along = unit(ALONG).unwrap();
    let across = unit(cross(along, [0.0, 0.0, 1.0])).unwrap();
    let from = std::array::from_fn(|a| p[a] - START_MM[a]);
    [
        dot(from, along),
        dot(from, across),
        dot(from, cross(along, across)),
    ]
}

/// Draw lung with noise of 25 HU and a known airway that ends at `START_MM`, blurred like a CT.
///
/// `drawn_hu` returns the value of the continuation at a point (the coordinates of `along_and_off`), or `None` for
/// lung.
fn drawn(drawn_hu: impl Fn([f64; 3]) -> Option<f64>) -> Drawn {
    let place = Affine::from_columns(
        [0.0, 0.6, 0.0],
        [-0.62, 0.0, 0.0],
        [0.0, 0.0, 0.65],
        [10.0, 20.0, -30.0],
    );
    let grid = Grid::new([52, 52, 64], place).unwrap();
    let spacing = grid.spacing_mm();
    let mm = |at: usize| -> [f64; 3] {
        let v = grid.voxel(at);
        std::array::from_fn(|a| v[a] as f64 * spacing[a])
    };
    let hu = |p: [f64; 3]| {
        let [t, x, y] = along_and_off(p);
        let off = x.hypot(y);
        if t < 0.0 && off < KNOWN_RADIUS_MM {
            -1000.0
        } else if t < 0.0 && off < KNOWN_RADIUS_MM + 0.9 {
            0.0
        } else {
            drawn_hu([t, x, y]).unwrap_or(-865.0)
        }
    };
    let sharp: Vec<f64> = (0..grid.num_voxels())
        .map(|at| {
            let p = mm(at);
            let parts = (0..27).map(|n| {
                let part = [n % 3, n / 3 % 3, n / 9];
                hu(std::array::from_fn(|a| {
                    p[a] + (f64::from(part[a]) - 1.0) / 3.0 * spacing[a]
                }))
            });
            parts.sum::<f64>() / 27.0
        })
        .collect();
    let mut blurred = sharp;
    for axis in 0..3 {
        let last = grid.shape_ijk()[axis] - 1;
        let beside = |at: usize, to: usize| {
            let mut v = grid.voxel(at);
            v[axis] = to;
            grid.index(v)
        };
        blurred = (0..blurred.len())
            .map(|at| {
                let here = grid.voxel(at)[axis];
                let before = beside(at, here.saturating_sub(1));
                let after = beside(at, (here + 1).min(last));
                0.12 * (blurred[before] + blurred[after]) + 0.76 * blurred[at]
            })
            .collect();
    }
    let mut state = 11u64;
    let mut even = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 33) as f64 / f64::from(1u32 << 31)
    };
    let values = blurred.iter().map(|hu| {
        // The sum of twelve uniform random numbers has a standard deviation of 1.
        let noise: f64 = (0..12).map(|_| even()).sum::<f64>() - 6.0;
        (hu + 25.0 * noise).round() as i16
    });
    let lumen = (0..grid.num_voxels()).map(|at| {
        let [t, x, y] = along_and_off(mm(at));
        u8::from(t < -0.5 && x.hypot(y) < KNOWN_RADIUS_MM - 0.3)
    });
    Drawn {
        values: values.collect(),
        lumen: lumen.collect(),
        grid,
    }
}

/// Draw a tube of 0.6 mm radius with a wall of 0.7 mm, up to `ends_mm`; the wall is missing where `gap` is true.
fn thin_tube(ends_mm: f64, gap: impl Fn(f64) -> bool) -> Drawn {
    drawn(move |[t, x, y]| {
        let off = x.hypot(y);
        let is_tube = t < ends_mm && off < 1.3 && !gap(t);
        is_tube.then_some(if off < 0.6 { -1000.0 } else { 20.0 })
    })
}

fn extended(chest: &mut Drawn) -> Thin {
    let view = VolumeView::new(&chest.values, &chest.grid).unwrap();
    extend_thin(view, &mut chest.lumen, &LIMITS, &Unwatched).unwrap()
}

/// Return the extent of the added voxels along the airway's continuation, and their largest distance from its axis, mm.
fn added_mm(chest: &Drawn) -> (f64, f64) {
    let spacing = chest.grid.spacing_mm();
    chest
        .lumen
        .iter()
        .enumerate()
        .filter(|(_, value)| **value == EXTENDED)
        .map(|(at, _)| {
            let v = chest.grid.voxel(at);
            along_and_off(std::array::from_fn(|a| v[a] as f64 * spacing[a]))
        })
        .fold((0.0, 0.0), |(far, off), [t, x, y]| {
            (f64::max(far, t), f64::max(off, x.hypot(y)))
        })
}

#[test]
fn a_thin_tube_in_noise_is_followed_to_its_end_and_no_farther() {
    let mut chest = thin_tube(16.0, |_| false);
    let before = chest.lumen.clone();
    let found = extended(&mut chest);
    assert!(!found.followed.is_empty());
    let (far, off) = added_mm(&chest);
    assert!((14.0..=17.5).contains(&far), "ends at {far}");
    // Tolerance: the outer radius of the wall (0.6 + 0.7 mm) and one voxel.
    assert!(off < 1.3 + 0.65, "{off}");
    let total_mm: f64 = found.followed.iter().map(|way| way.length_mm).sum();
    assert!((10.0..=19.0).contains(&total_mm), "{total_mm}");
    let kept = |at: usize| before[at] != LUMEN || chest.lumen[at] == LUMEN;
    assert!(
        (0..before.len()).all(kept),
        "the lumen that was known changed"
    );
}

#[test]
fn a_short_gap_in_a_thin_wall_is_crossed_and_a_long_gap_ends_the_path() {
    let farthest = |long: f64| {
        let mut chest = thin_tube(18.0, |t| (7.0..7.0 + long).contains(&t));
        extended(&mut chest);
        added_mm(&chest).0
    };
    assert!(farthest(1.5) > 15.5, "{}", farthest(1.5));
    let long = farthest(9.0);
    assert!((5.0..11.0).contains(&long), "{long}");
}

#[test]
fn a_vessel_that_continues_the_airway_is_not_followed() {
    for radius_mm in [0.7, 1.0, 1.6] {
        let mut chest = drawn(|[_, x, y]| (x.hypot(y) < radius_mm).then_some(40.0));
        let found = extended(&mut chest);
        assert_eq!(found.followed, vec![], "vessel of {radius_mm} mm");
    }
}

#[test]
fn lung_between_two_or_three_vessels_is_not_followed() {
    // Three vessels that touch each other would enclose a space that a CT cannot distinguish from the lumen of an
    // airway.
    for (vessels, apart_mm) in [(2, 1.8), (2, 2.2), (3, 2.7)] {
        let mut chest = drawn(|[_, x, y]| {
            let is_vessel = (0..vessels).any(|n| {
                let (sin, cos) =
                    (std::f64::consts::TAU * f64::from(n) / f64::from(vessels)).sin_cos();
                (x - apart_mm * cos).hypot(y - apart_mm * sin) < 1.1
            });
            is_vessel.then_some(40.0)
        });
        let found = extended(&mut chest);
        assert_eq!(
            found.followed,
            vec![],
            "{vessels} vessels {apart_mm} mm off"
        );
    }
}

#[test]
fn lung_beyond_an_airway_that_ends_adds_nothing() {
    let mut chest = drawn(|_| None);
    let found = extended(&mut chest);
    assert_eq!(found.followed, vec![]);
    assert!(chest.lumen.iter().all(|value| *value <= LUMEN));
}

#[test]
fn a_search_that_reaches_too_much_of_the_lung_is_cancelled_and_adds_nothing() {
    // Several copies of a chest side by side, because the lung of one copy is too small for the share.
    let one = thin_tube(16.0, |_| false);
    let num = 18;
    let grid = Grid::new([52 * num, 52, 64], *one.grid.lps_from_ijk()).unwrap();
    let (values, lumen) = (one.values.repeat(num), one.lumen.repeat(num));
    let view = VolumeView::new(&values, &grid).unwrap();
    let follow = |most_reached: f64| {
        let mut given = lumen.clone();
        let limits = ThinLimits {
            most_reached,
            ..LIMITS
        };
        let found = extend_thin(view, &mut given, &limits, &Unwatched).unwrap();
        (found, given)
    };
    let (found, _) = follow(1.0);
    assert!(!found.ran_out && found.num_reached > 200 && found.followed.len() >= num / 2);
    let (found, given) = follow(1e-5);
    assert!(found.ran_out && found.followed.is_empty());
    assert!(given == lumen);
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build().unwrap().install(|| {
            let mut chest = thin_tube(16.0, |_| false);
            (extended(&mut chest), chest.lumen)
        })
    };
    assert!(on(1) == on(3));
}

#[test]
fn a_stopped_search_returns_an_error() {
    struct Never;
    impl Watch for Never {
        fn report_fraction(&self, _fraction: f64) -> Result<(), TrackError> {
            Err(TrackError::Cancelled)
        }
    }
    let mut chest = thin_tube(16.0, |_| false);
    let view = VolumeView::new(&chest.values, &chest.grid).unwrap();
    let stopped = extend_thin(view, &mut chest.lumen, &LIMITS, &Never);
    assert_eq!(stopped, Err(TrackError::Cancelled));
}

#[test]
fn coordinates_separate_the_distance_along_the_path_from_that_off_it() {
    let along = unit(ALONG).unwrap();
    let [t, x, y] = along_and_off(std::array::from_fn(|a| START_MM[a] + 3.0 * along[a]));
    assert!((t - 3.0).abs() < 1e-9 && length([x, y, 0.0]) < 1e-9);
}
