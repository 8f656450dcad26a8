use std::net::UdpSocket;
use std::time::{Duration, Instant};

use carina_grid::{Affine, length};

use crate::force_loop::{ForceLoop, LoopOptions, WanderingHand};
use crate::law::{ForceLaw, ForceModel, HandSample, LIMIT_N, SLEW_N_PER_MS};
use crate::packet::{ForcePacket, SamplePacket};
use crate::simulated_hand::SimulatedHand;
use crate::test_tube::tube;

fn model() -> ForceModel {
    ForceModel::new(tube(), ForceLaw::default(), Vec::new()).unwrap()
}

fn sample(number: u32, at: [f64; 3]) -> SamplePacket {
    SamplePacket {
        number,
        device_us: 11 * u64::from(number),
        buttons: 0,
        hand: HandSample {
            at_lps: at,
            velocity_mm_s: [0.0; 3],
            forward_lps: [0.0, 0.0, -1.0],
        },
    }
}

/// Wait until a condition is true; the timeout is long, because the machine may be loaded.
fn until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !is_so() {
        assert!(begin.elapsed() < Duration::from_secs(20), "{what}");
        std::thread::yield_now();
    }
}

#[test]
fn a_bridge_gets_forces_in_its_axes_until_it_is_silent() {
    // The device's x is the patient's -y, and 1 mm of the hand is half a mm in the lumen.
    let lps_from_device = Affine::from_columns(
        [0.0, -0.5, 0.0],
        [0.5, 0.0, 0.0],
        [0.0, 0.0, 0.5],
        [0.0, 0.0, 60.0],
    );
    let mut force = ForceLoop::start(
        model(),
        LoopOptions {
            udp_port: Some(0),
            lps_from_device: Some(lps_from_device),
            ..LoopOptions::default()
        },
    )
    .unwrap();
    let bridge = UdpSocket::bind("127.0.0.1:0").unwrap();
    bridge
        .connect(("127.0.0.1", force.port().unwrap()))
        .unwrap();
    bridge
        .set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    let mut number = 0;
    let mut felt_at = |at: [f64; 3]| {
        number += 1;
        bridge.send(&sample(number, at).to_bytes()).unwrap();
        let mut bytes = [0; 200];
        let num = bridge.recv(&mut bytes).unwrap();
        let answer = ForcePacket::from_bytes(&bytes[..num]).unwrap();
        assert_eq!(
            (answer.number, answer.device_us),
            (number, 11 * u64::from(number))
        );
        answer.felt
    };
    assert_eq!(felt_at([0.0, 0.0, 0.0]).force_n, [0.0; 3]);
    let mut felt = felt_at([0.0, 16.0, 0.0]);
    for _ in 0..60 {
        felt = felt_at([0.0, 16.0, 0.0]);
    }
    // 8 mm to the patient's left is 1.45 mm into the wall; the force is along the device's -y.
    assert!(felt.touches && felt.force_n[1] < -0.3, "{felt:?}");
    assert!(felt.force_n[0].abs() < 0.1, "{felt:?}");
    bridge.send(b"nonsense").unwrap();
    until("the nonsense is counted", || {
        force.figures().num_refused == 1
    });
    until("the watchdog lets go", || {
        let (felt, sample) = force.felt();
        felt.is_silent && felt.force_n == [0.0; 3] && sample.is_none()
    });
    force.stop();
}

#[test]
fn forces_on_a_simulated_hand_stay_within_the_limits() {
    let force = ForceLoop::start(
        model(),
        LoopOptions {
            simulated: Some(WanderingHand {
                hand: SimulatedHand::new([0.0, 0.0, 60.0]),
                round_lps: [0.0, 0.0, 60.0],
                reach_mm: 12.0,
                turns_hz: 2.0,
            }),
            ..LoopOptions::default()
        },
    )
    .unwrap();
    until("it touches", || force.figures().max_force_n > 0.3);
    let figures = force.figures();
    assert!(figures.max_force_n <= LIMIT_N);
    assert!(figures.max_change_n <= SLEW_N_PER_MS + 1e-12);
}

#[test]
fn samples_in_process_give_forces_and_invalid_samples_are_rejected() {
    let force = ForceLoop::start(model(), LoopOptions::default()).unwrap();
    let hand = sample(0, [0.0, 0.0, 60.0]).hand;
    // A sample expires after 30 ms, so one sample may be lost before a loaded machine runs a tick.
    until("it is heard", || {
        assert!(force.put(hand));
        force.felt().1 == Some(hand)
    });
    assert!(!force.put(HandSample {
        at_lps: [f64::NAN; 3],
        ..hand
    }));
    until("it is felt", || {
        assert!(force.put(HandSample {
            at_lps: [8.5, 0.0, 60.0],
            ..hand
        }));
        length(force.felt().0.force_n) > 0.3
    });
}

#[test]
fn every_tick_is_counted_once() {
    let mut force = ForceLoop::start(model(), LoopOptions::default()).unwrap();
    until("it goes on", || force.figures().num_ticks >= 200);
    force.stop();
    let figures = force.figures();
    // The number of ticks that were due since the start.
    assert!(
        figures.num_ticks as f64 <= 1000.0 * figures.wall_s + 1.0,
        "{figures:?}"
    );
    assert!(figures.num_missed < figures.num_ticks);
}

#[test]
fn a_sheared_or_enlarging_device_space_is_rejected() {
    for scale in [[1.0, 1.0, 0.9], [3.0, 3.0, 3.0], [f64::NAN; 3]] {
        let space = Affine::from_columns(
            [scale[0], 0.0, 0.0],
            [0.0, scale[1], 0.0],
            [0.0, 0.0, scale[2]],
            [0.0; 3],
        );
        let options = LoopOptions {
            lps_from_device: Some(space),
            ..LoopOptions::default()
        };
        assert!(ForceLoop::start(model(), options).is_err());
    }
}

#[test]
fn a_mirrored_device_space_is_rejected_with_a_message() {
    // The matrices are a mirror image (the patient's right for the hand's left), and an exchange of two axes.
    for [x, y] in [
        [[-0.5, 0.0, 0.0], [0.0, 0.5, 0.0]],
        [[0.0, 0.5, 0.0], [0.5, 0.0, 0.0]],
    ] {
        let space = Affine::from_columns(x, y, [0.0, 0.0, 0.5], [0.0; 3]);
        let options = LoopOptions {
            lps_from_device: Some(space),
            ..LoopOptions::default()
        };
        let Err(refused) = ForceLoop::start(model(), options) else {
            panic!("a mirrored space was taken: {x:?} {y:?}");
        };
        assert!(refused.to_string().contains("mirrored"), "{refused}");
    }
}
