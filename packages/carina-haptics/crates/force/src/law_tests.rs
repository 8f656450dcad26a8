use std::sync::Arc;

use carina_grid::length;

use crate::law::{
    ForceLaw, ForceModel, HandForce, HandSample, LIMIT_N, MAX_STIFFNESS_N_PER_MM, SLEW_N_PER_MS,
};
use crate::simulated_hand::SimulatedHand;
use crate::test_tube::tube;

use crate::vector::Point;

fn model(law: ForceLaw) -> ForceModel {
    ForceModel::new(tube(), law, vec![[0.0, 0.0, 110.0], [0.0, 0.0, 0.0]]).unwrap()
}

fn hand(at: Point) -> HandSample {
    HandSample {
        at_lps: at,
        velocity_mm_s: [0.0; 3],
        forward_lps: [0.0, 0.0, -1.0],
    }
}

fn settled(model: &mut ForceModel, sample: &HandSample) -> HandForce {
    let mut felt = HandForce::default();
    for _ in 0..200 {
        felt = model.step(Some(sample), 1.0);
    }
    felt
}

#[test]
fn the_force_without_contact_is_0_at_any_speed() {
    let mut model = model(ForceLaw::default());
    for n in 0..500 {
        let turn = f64::from(n) * 0.1;
        let at = [
            5.0 * libm::cos(turn),
            5.0 * libm::sin(turn),
            90.0 - 0.1 * f64::from(n),
        ];
        let felt = model.step(
            Some(&HandSample {
                velocity_mm_s: [500.0, -400.0, 900.0],
                ..hand(at)
            }),
            1.0,
        );
        assert_eq!(
            (felt.force_n, felt.torque_n_mm, felt.touches),
            ([0.0; 3], [0.0; 3], false)
        );
    }
}

#[test]
fn the_force_in_the_wall_is_depth_times_stiffness_towards_the_lumen() {
    let law = ForceLaw {
        friction: 0.0,
        ..ForceLaw::default()
    };
    let mut model = model(law);
    model.step(Some(&hand([0.0, 0.0, 60.0])), 1.0);
    // The tube's radius is 9 mm and the tip's 2.45 mm, so the tip's centre is held at 6.55 mm.
    let felt = settled(&mut model, &hand([8.05, 0.0, 60.0]));
    assert!(felt.touches && !felt.limited);
    // The tolerance of 0.02 is the field's interpolation error times the stiffness.
    assert!(
        (felt.force_n[0] + 1.5 * law.stiffness_n_per_mm).abs() < 0.02,
        "{felt:?}"
    );
    assert!(felt.force_n[1].abs() < 0.02 && felt.force_n[2].abs() < 0.02);
    // The grip is 40 mm above the tip, so the force to -x causes a torque about y.
    assert!(felt.torque_n_mm[1] > 0.0);
}

#[test]
fn force_and_change_of_force_are_limited_for_any_movement() {
    let mut model = model(ForceLaw {
        guidance_n_per_mm: 0.2,
        ..ForceLaw::default()
    });
    let mut random = 77u64;
    let mut next = || {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (random >> 33) as f64 / f64::from(1u32 << 31) - 0.5
    };
    let mut last = [0.0; 3];
    for n in 0..20_000 {
        let at = [30.0 * next(), 20.0 * next(), 60.0 + 60.0 * next()];
        let sample = HandSample {
            velocity_mm_s: [2e4 * next(), 2e4 * next(), 2e4 * next()],
            ..hand(at)
        };
        let felt = model.step(
            (n % 50 < 40).then_some(&sample),
            if n % 7 == 0 { 5.0 } else { 1.0 },
        );
        let change: Point = std::array::from_fn(|a| felt.force_n[a] - last[a]);
        assert!(length(felt.force_n) <= LIMIT_N);
        assert!(length(change) <= SLEW_N_PER_MS + 1e-12);
        last = felt.force_n;
    }
}

#[test]
fn the_force_is_0_after_30_ms_without_a_sample() {
    let mut model = model(ForceLaw::default());
    model.step(Some(&hand([0.0, 0.0, 60.0])), 1.0);
    let felt = settled(&mut model, &hand([14.0, 0.0, 60.0]));
    assert!(length(felt.force_n) > 1.9);
    for _ in 0..30 {
        model.step(None, 1.0);
    }
    let felt = model.step(None, 1.0);
    assert_eq!(felt.force_n, [0.0; 3]);
    assert!(felt.is_silent);
}

#[test]
fn the_proxy_sticks_inside_the_friction_cone_and_slides_outside() {
    let mut model = model(ForceLaw {
        friction: 0.3,
        ..ForceLaw::default()
    });
    model.step(Some(&hand([0.0, 0.0, 60.0])), 1.0);
    settled(&mut model, &hand([8.55, 0.0, 60.0]));
    // The hand moves by less than the friction cone of 0.3 * 2 mm, so the proxy sticks, and the hand is pulled back.
    let stuck = settled(&mut model, &hand([8.55, 0.0, 59.7]));
    assert!(stuck.force_n[2] > 0.05, "{stuck:?}");
    // Farther along, the proxy slides, and the force along the wall is that of the friction cone.
    let slides = settled(&mut model, &hand([8.55, 0.0, 50.0]));
    let share = slides.force_n[2] / -slides.force_n[0];
    // The tolerance of 0.03 allows for the round wall, because the cone is on the wall's tangent.
    assert!((0.27..=0.33).contains(&share), "{share}");
}

#[test]
fn guidance_pulls_towards_the_path_with_limited_force() {
    let mut model = model(ForceLaw {
        guidance_n_per_mm: 0.1,
        ..ForceLaw::default()
    });
    let felt = settled(&mut model, &hand([4.0, 0.0, 60.0]));
    assert!(
        (felt.force_n[0] + 0.4).abs() < 1e-9 && !felt.touches,
        "{felt:?}"
    );
}

#[test]
fn parameters_of_an_unstable_law_are_rejected() {
    let refused = |law: ForceLaw| law.checked().is_err();
    assert!(refused(ForceLaw {
        stiffness_n_per_mm: 5.0,
        ..ForceLaw::default()
    }));
    assert!(refused(ForceLaw {
        friction: f64::NAN,
        ..ForceLaw::default()
    }));
    assert!(refused(ForceLaw {
        watchdog_ms: 1e9,
        ..ForceLaw::default()
    }));
    assert!(!hand([f64::NAN, 0.0, 0.0]).is_sane() && hand([1.0, 2.0, 3.0]).is_sane());
    let slow = HandSample {
        forward_lps: [0.0; 3],
        ..hand([0.0; 3])
    };
    assert!(!slow.is_sane());
}

/// Return the largest distances from rest, in successive windows of 0.4 s, of a hand that was released into the wall.
fn swings(stiffness: f64, mass_kg: f64, spring: f64, speed_mm_s: f64) -> Vec<f64> {
    let law = ForceLaw {
        stiffness_n_per_mm: stiffness,
        ..ForceLaw::default()
    };
    let mut model = ForceModel::new(Arc::clone(&tube()), law, Vec::new()).unwrap();
    let mut device = SimulatedHand {
        mass_kg,
        spring_n_per_mm: spring,
        damping_ns_per_mm: 0.002,
        velocity_mm_s: [speed_mm_s, 0.0, 0.0],
        ..SimulatedHand::new([0.0, 0.0, 60.0])
    };
    let mut felt = HandForce::default();
    let mut places = Vec::new();
    for _ in 0..4000 {
        // The force is that of the previous sample, one tick late.
        let sample = device.sample(0.01);
        device.step([8.5, 0.0, 60.0], &felt, 1e-3);
        felt = model.step(Some(&sample), 1.0);
        places.push(device.at_lps[0]);
    }
    let rest = places[3500..].iter().sum::<f64>() / 500.0;
    places
        .chunks(400)
        .map(|w| w.iter().fold(0.0f64, |m, p| m.max((p - rest).abs())))
        .collect()
}

#[test]
fn oscillations_do_not_grow_up_to_the_largest_stiffness() {
    for stiffness in [0.1, 0.3, MAX_STIFFNESS_N_PER_MM] {
        for mass_kg in [0.05, 0.1, 0.3] {
            for spring in [0.02, 0.2, 0.5] {
                for speed in [0.0, 50.0, 300.0] {
                    let swings = swings(stiffness, mass_kg, spring, speed);
                    let case = format!(
                        "{stiffness} N/mm, {mass_kg} kg, {spring} N/mm, {speed} mm/s: {swings:?}"
                    );
                    for pair in swings.windows(2).skip(1) {
                        // The tolerance of 0.03 mm allows for a small oscillation that the steps of the encoder cause.
                        assert!(pair[1] <= pair[0] + 0.03, "{case}");
                    }
                    assert!(swings[9] < 0.1, "{case}");
                }
            }
        }
    }
}
