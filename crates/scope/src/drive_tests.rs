use std::sync::{Arc, OnceLock};

use carina_grid::{Affine, dot};

use crate::body::distance;
use crate::{Limit, ScopeBody, ScopeDrive, WallField};

type Point = [f64; 3];

/// Dimensions of the scope in these tests.
pub(crate) const BODY: ScopeBody = ScopeBody {
    tip_radius_mm: 2.45,
    tube_radius_mm: 2.45,
    rigid_mm: 10.0,
    bending_mm: 40.0,
    up_rad: 3.1,
    down_rad: 2.27,
    length_mm: 600.0,
};

fn capsule(p: Point, a: Point, b: Point, radius: f64) -> f64 {
    let ab: Point = std::array::from_fn(|k| b[k] - a[k]);
    let ap: Point = std::array::from_fn(|k| p[k] - a[k]);
    let t = (dot(ap, ab) / dot(ab, ab)).clamp(0.0, 1.0);
    radius - distance(ap, ab.map(|v| t * v))
}

/// Return the signed distance of a test lumen: a stem of 9 mm radius down to the origin, then two arms.
///
/// The right arm (x below 0) narrows to a radius of 2 mm.
pub(crate) fn lumen(p: Point) -> f64 {
    let right = capsule(p, [0.0, 0.0, 0.0], [-30.0, 0.0, -45.0], 6.0).max(capsule(
        p,
        [-30.0, 0.0, -45.0],
        [-54.0, 0.0, -81.0],
        2.0,
    ));
    let left = capsule(p, [0.0, 0.0, 0.0], [35.0, 0.0, -35.0], 5.0).max(capsule(
        p,
        [35.0, 0.0, -35.0],
        [75.0, 5.0, -50.0],
        4.0,
    ));
    capsule(p, [0.0, 0.0, 120.0], [0.0, 0.0, 0.0], 9.0)
        .max(right)
        .max(left)
}

pub(crate) fn field() -> Arc<WallField> {
    /// Wall field of the test lumen, computed on first use.
    static FIELD: OnceLock<Arc<WallField>> = OnceLock::new();
    FIELD.get_or_init(sampled).clone()
}

fn sampled() -> Arc<WallField> {
    let spacing = 0.5;
    let low = [-60.0, -15.0, -90.0];
    let shape = [290, 60, 440];
    let lps = Affine::from_columns(
        [spacing, 0.0, 0.0],
        [0.0, spacing, 0.0],
        [0.0, 0.0, spacing],
        low,
    );
    let values: Vec<f32> = (0..shape.iter().product::<usize>())
        .map(|n| {
            let at = [n % 290, n / 290 % 60, n / 290 / 60].map(|v| v as f64);
            lumen(lps.point(at)) as f32
        })
        .collect();
    Arc::new(WallField::from_distances(&values, shape, &lps).unwrap())
}

/// Path down the stem of the test lumen, LPS mm.
const TRACHEA: [Point; 2] = [[0.0, 0.0, 110.0], [0.0, 0.0, 0.0]];

fn scope() -> ScopeDrive {
    ScopeDrive::new(field(), BODY, &TRACHEA, None).unwrap()
}

#[test]
fn a_scope_without_flexion_advances_straight_with_anterior_up() {
    let mut scope = scope();
    let state = scope.drive(60.0, 0.0, 0.0, 0.1).unwrap();
    let tip = state.lps_from_tip;
    assert_eq!(state.limit, Limit::None);
    assert!(distance(tip.column(3), [0.0, 0.0, 50.0]) < 1e-6);
    // Seen from the head end, the patient's right (-x) is on the right, and anterior (-y) is up.
    assert!(distance(tip.column(0), [-1.0, 0.0, 0.0]) < 1e-6);
    assert!(distance(tip.column(1), [0.0, 1.0, 0.0]) < 1e-6);
    assert!(state.contact.is_none() && state.red_out == 0.0);
}

#[test]
fn a_free_tip_bends_to_its_angle_with_the_radius_of_its_bending_section() {
    let mut scope = ScopeDrive::new(
        field(),
        ScopeBody {
            tip_radius_mm: 0.8,
            tube_radius_mm: 0.8,
            bending_mm: 10.0,
            rigid_mm: 2.0,
            ..BODY
        },
        &TRACHEA,
        None,
    )
    .unwrap();
    scope.drive(60.0, 0.0, 0.0, 0.1).unwrap();
    let state = scope.drive(60.0, 0.0, 1.0, 0.1).unwrap();
    let forward = state.lps_from_tip.column(2);
    let angle = libm::acos(-forward[2]);
    // The tolerance of 1e-3 rad is the remaining error of the relaxation.
    assert!((angle - 1.0).abs() < 1e-3, "{angle}");
    // Up is anterior, so the tip moves in that direction.
    assert!(forward[1] < 0.0 && state.lps_from_tip.column(3)[1] < -2.0);
    // After a roll by a quarter turn clockwise, up is the patient's right.
    let state = scope
        .drive(60.0, core::f64::consts::FRAC_PI_2, 1.0, 0.1)
        .unwrap();
    let forward = state.lps_from_tip.column(2);
    assert!(forward[0] < -0.8 && forward[1].abs() < 0.01, "{forward:?}");
    // After the reverse movement the state must not depend on previous positions.
    let state = scope.drive(60.0, 0.0, 0.0, 0.1).unwrap();
    let off = distance(state.lps_from_tip.column(2), [0.0, 0.0, -1.0]);
    assert!(off < 1e-3, "{off}");
}

#[test]
fn upward_and_downward_flexion_stop_at_different_limits() {
    let mut scope = scope();
    scope.drive(60.0, 0.0, 0.0, 0.1).unwrap();
    let up = scope.drive(60.0, 0.0, 9.0, 0.1).unwrap();
    assert_eq!((up.flexion_rad, up.limit), (3.1, Limit::Flexion));
    let down = scope.drive(60.0, 0.0, -9.0, 0.1).unwrap();
    assert_eq!((down.flexion_rad, down.limit), (-2.27, Limit::Flexion));
}

#[test]
fn a_scope_pushed_at_a_carina_stops_with_red_out_and_can_be_withdrawn() {
    let mut scope = scope();
    let state = scope.drive(140.0, 0.0, 0.0, 0.1).unwrap();
    assert!(state.insertion_mm > 90.0, "{}", state.insertion_mm);
    let (tip, shaft) = scope.wall_depths_mm();
    assert!(tip <= 0.1 && shaft <= 0.5, "{tip} {shaft}");
    let state = scope.drive(20.0, 0.0, 0.0, 0.1).unwrap();
    assert_eq!(state.limit, Limit::None);
    assert!((state.insertion_mm - 20.0).abs() < 1e-9);
    assert!(distance(state.lps_from_tip.column(3), [0.0, 0.0, 90.0]) < 0.5);
}

/// Steer the tip towards a point as a hand would: roll until the point is up or down, then flex.
pub(crate) fn steered(scope: &mut ScopeDrive, to: Point, steps: usize) -> crate::ScopeState {
    let mut state = *scope.state();
    for _ in 0..steps {
        let tip = state.lps_from_tip;
        let away: Point = std::array::from_fn(|a| to[a] - tip.column(3)[a]);
        let (x, y, z) = (
            dot(away, tip.column(0)),
            dot(away, tip.column(1)),
            dot(away, tip.column(2)),
        );
        if libm::hypot(libm::hypot(x, y), z) < 3.0 || (z < 1.0 && x * x + y * y < 64.0) {
            break;
        }
        let off = libm::atan2(libm::hypot(x, y), z);
        let turn = libm::atan2(x, -y);
        // Of the two rolls that turn the point up or down, the smaller one is used.
        let (turn, bend) = if turn.abs() > core::f64::consts::FRAC_PI_2 {
            (turn - core::f64::consts::PI.copysign(turn), -off)
        } else {
            (turn, off)
        };
        let ease = libm::sin(off).abs().max(0.1);
        state = scope
            .drive(
                state.insertion_mm + if off < 0.7 { 0.7 } else { 0.1 },
                state.roll_rad + (ease * turn).clamp(-0.06, 0.06),
                state.flexion_rad + (0.3 * bend).clamp(-0.04, 0.04),
                1.0 / 60.0,
            )
            .unwrap();
        let (tip, shaft) = scope.wall_depths_mm();
        assert!(tip <= 0.1 && shaft <= 0.5, "{tip} {shaft}");
    }
    state
}

#[test]
fn a_scope_in_a_narrow_airway_stops_and_reports_the_passable_diameter() {
    let mut scope = scope();
    steered(&mut scope, [0.0, 0.0, 12.0], 400);
    let state = steered(&mut scope, [-28.0, 0.0, -42.0], 400);
    assert!(
        distance(state.lps_from_tip.column(3), [-28.0, 0.0, -42.0]) < 8.0,
        "{state:?}"
    );
    let state = steered(&mut scope, [-50.0, 0.0, -75.0], 400);
    assert_eq!(state.limit, Limit::Narrow, "{state:?}");
    let passable = state.passable_mm.unwrap();
    // The arm is 4 mm wide.
    assert!((passable - 4.0).abs() < 0.5, "{passable}");
}

#[test]
fn a_scope_steered_into_the_wide_arm_reaches_its_end() {
    let mut scope = scope();
    steered(&mut scope, [0.0, 0.0, 12.0], 400);
    steered(&mut scope, [34.0, 0.0, -34.0], 400);
    let state = steered(&mut scope, [70.0, 4.5, -48.0], 400);
    assert!(
        distance(state.lps_from_tip.column(3), [70.0, 4.5, -48.0]) < 6.0,
        "{state:?}"
    );
    assert!(state.record.time_s > 0.0);
}

#[test]
fn invalid_samples_are_rejected_without_effect() {
    let mut scope = scope();
    let before = scope.drive(30.0, 0.1, 0.2, 0.1).unwrap();
    for bad in [f64::NAN, f64::INFINITY] {
        assert!(scope.drive(bad, 0.0, 0.0, 0.1).is_err());
        assert!(scope.drive(30.0, bad, 0.0, 0.1).is_err());
        assert!(scope.drive(30.0, 0.0, bad, 0.1).is_err());
        assert!(scope.drive(30.0, 0.0, 0.0, bad).is_err());
    }
    assert_eq!(*scope.state(), before);
    assert!(scope.drive(1e300, 1e300, 1e300, 0.1).is_ok());
    assert!(
        scope
            .state()
            .lps_from_tip
            .rows()
            .iter()
            .flatten()
            .all(|v| v.is_finite())
    );
}

#[test]
fn equal_samples_give_equal_states_bit_for_bit() {
    let run = || {
        let mut scope = scope();
        let mut random = 9u64;
        let mut next = || {
            random = random
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (random >> 33) as f64 / f64::from(1u32 << 31) - 0.5
        };
        (0..200)
            .map(|n| {
                scope
                    .drive(
                        10.0 + 0.7 * f64::from(n),
                        3.0 * next(),
                        2.0 * next(),
                        1.0 / 60.0,
                    )
                    .unwrap()
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(run(), run());
}

#[test]
fn rolls_of_any_size_finish_and_whole_turns_have_no_effect() {
    let mut scope = scope();
    let start = scope.drive(50.0, 0.0, 0.6, 0.1).unwrap();
    // Removing whole turns by a rounded division leaves 2.1e9 rad of this roll, which is 1e11 steps.
    let state = scope.drive(50.0, 1.559e25, 0.6, 0.1).unwrap();
    assert_eq!(state.roll_rad, 1.559e25);
    for roll in [f64::MAX, -f64::MAX, 1e300] {
        let state = scope.drive(50.0, roll, 0.6, 0.1).unwrap();
        assert!(
            state
                .lps_from_tip
                .rows()
                .iter()
                .flatten()
                .all(|v| v.is_finite())
        );
    }
    let mut winding = scope;
    winding.place(&TRACHEA, 50.0).unwrap();
    assert_eq!(winding.state().roll_rad, 0.0);
    winding.drive(50.0, 0.0, 0.6, 0.1).unwrap();
    let turns = 1000.0 * core::f64::consts::TAU;
    let wound = winding.drive(50.0, turns, 0.6, 0.1).unwrap();
    assert_eq!(wound.roll_rad, turns);
    assert!(
        distance(wound.lps_from_tip.column(3), start.lps_from_tip.column(3)) < 0.5,
        "whole turns change nothing: {wound:?}"
    );
}

#[test]
fn a_path_longer_than_any_airway_is_rejected_for_any_point_spacing() {
    let far = |num: usize| -> Vec<Point> {
        (0..=num)
            .map(|n| [0.0, 0.0, 110.0 - 6_000.0 * n as f64 / num as f64])
            .collect()
    };
    for num in [1, 2, 1000] {
        let message = ScopeDrive::new(field(), BODY, &far(num), None)
            .unwrap_err()
            .to_string();
        assert!(message.contains("6000 mm long"), "{message}");
        let message = scope().place(&far(num), 50.0).unwrap_err().to_string();
        assert!(message.contains("6000 mm long"), "{message}");
    }
    assert!(
        ScopeDrive::new(
            field(),
            BODY,
            &[[0.0, 0.0, 110.0], [0.0, 0.0, -4_800.0]],
            None
        )
        .is_ok()
    );
}
