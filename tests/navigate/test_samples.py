"""Tests of the gate that accepts device samples, of the smoothing filter, and of the registration of a pen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec import structs

from carina.commands import DeviceControls
from carina.errors import UsageError
from carina.navigate import (
    AxesSample,
    HandleSample,
    PoseSample,
    SampleFilter,
    SampleGate,
    filter_latency_ms,
    fit_registration,
)
from carina.navigate.rotation import rotation_from_vector, rotation_from_wxyz, wxyz_from_rotation

IDENTITY = (1.0, 0.0, 0.0, 0.0)
REST = (0.0,) * 6


def pen(time_s: float, x: float = 0.0, wxyz: tuple[float, ...] = IDENTITY, buttons: int = 0) -> PoseSample:
    return PoseSample(time_s, (x, 2.0, 3.0), wxyz, buttons)


@pytest.mark.parametrize(
    ("sample", "why"),
    [
        (pen(math.nan), "non-finite numbers"),
        (pen(1.0, math.inf), "non-finite numbers"),
        (pen(1.0, wxyz=(0.0, 0.0, 0.0, 0.0)), "an orientation of length 0"),
        (pen(1.0, wxyz=(math.nan, 0.0, 0.0, 1.0)), "non-finite numbers"),
        (pen(1.0, 1e9), "numbers out of range"),
        (pen(1.0, buttons=-1), "numbers out of range"),
        (PoseSample(1.0, None, IDENTITY, 0, 1.5), "numbers out of range"),
        (PoseSample(1.0, None, IDENTITY, 0, math.nan), "non-finite numbers"),
        (AxesSample(1.0, (2.0, 0.0, 0.0, 0.0, 0.0, 0.0)), "numbers out of range"),
        (HandleSample(1.0, 0.0, 0.0, 7.0), "numbers out of range"),
        (pen(-0.2), "timestamps that run backwards"),
        (pen(0.0001), "too many samples"),
    ],
)
def test_invalid_sample_is_ignored_and_counted_by_its_reason(sample, why):
    gate = SampleGate()
    assert gate.admit("pen", pen(0.0), 0.0) is not None
    assert gate.admit("pen", sample, 0.01) is None
    assert gate.num_ignored("pen") == {why: 1}
    assert gate.admit("pen", pen(1.5), 0.02) is not None


def test_quaternions_of_any_length_become_unit_length():
    for length in (1e-3, 1.0, 1e150):
        admitted = SampleGate().admit("pen", pen(0.0, wxyz=(0.0, 3.0 * length, 0.0, 4.0 * length)), 0.0)
        assert isinstance(admitted, PoseSample)
        assert admitted.orientation_wxyz == pytest.approx((0.0, 0.6, 0.0, 0.8), abs=1e-15)


def test_flood_of_samples_is_limited_with_one_message_in_ten_seconds():
    gate, messages, used = SampleGate(), [], 0
    for n in range(200_000):
        at = n * 1e-4
        used += gate.admit("pen", pen(at), at) is not None
        message = gate.take_message(at)
        if message is not None:
            messages.append(message)
    assert used <= 20.0 / 0.0005 + 1
    assert len(messages) == 2
    assert "too many samples" in messages[1]


def test_samples_of_a_device_whose_clock_was_set_back_are_accepted_after_half_a_second():
    gate = SampleGate()
    gate.admit("pen", pen(100.0), 0.0)
    taken = [gate.admit("pen", pen(n * 0.01), n * 0.01) is not None for n in range(1, 80)]
    assert not any(taken[:49])
    assert all(taken[52:])


def test_first_of_two_devices_controls_the_scope_until_it_sends_nothing():
    gate = SampleGate()
    assert gate.admit("pen", pen(0.0), 0.0) is not None
    assert gate.admit("stick", AxesSample(0.0, (1.0, *REST[1:])), 0.1) is None
    assert gate.num_ignored("stick") == {"another device is moving the scope": 1}
    assert gate.admit("stick", AxesSample(0.1, REST), 0.1) is not None, "a released stick requests no control"
    assert gate.holder == "pen"
    assert gate.admit("stick", AxesSample(0.7, (1.0, *REST[1:])), 0.7) is not None
    assert gate.holder == "stick"


def test_device_that_sends_nothing_loses_control_of_the_scope():
    gate = SampleGate()
    gate.admit("pen", pen(0.0), 0.0)
    gate.take("handle")
    assert gate.holder == "handle"
    taken = [gate.admit("pen", pen(0.01 * n), 10.0 + 0.01 * n) is not None for n in range(1, 80)]
    assert not any(taken[:49])
    assert all(taken[52:])
    assert gate.holder == "pen"


def test_sample_of_a_released_stick_is_accepted_at_any_rate_but_not_in_a_flood():
    gate = SampleGate()
    full = (1.0, *REST[1:])
    assert gate.admit("stick", AxesSample(0.0, full), 0.0) is not None
    assert gate.admit("stick", AxesSample(0.0001, full), 0.0) is None
    assert gate.admit("stick", AxesSample(0.0002, REST), 0.0) is not None
    assert gate.holder is None
    assert gate.admit("stick", AxesSample(0.0003, full), 0.0) is None
    used = sum(
        gate.admit("stick", AxesSample(0.001 + 1e-6 * n, (REST, full)[n % 2]), 0.0) is not None for n in range(10_000)
    )
    assert used <= 2 * 20 + 2, "at most two samples in half a millisecond"


def test_number_of_stored_devices_is_limited_and_the_message_names_three():
    gate = SampleGate()
    gate.admit("pen", pen(0.0), 0.0)
    for n in range(10_000):
        gate.admit(f"stick {n}", AxesSample(0.0, (5.0, *REST[1:])), 0.1)
    # Samples of all these devices are refused; of the stored devices those without a valid sample are removed first.
    assert len(gate._seen) <= 64
    assert len(gate._unreported) <= 66
    assert gate.holder == "pen"
    text = gate.take_message(0.2)
    assert text is not None
    assert "10000 samples from other devices, stick 0, stick 1 and 62 more were ignored" in text
    assert len(text) < 200


def test_device_beyond_the_limit_is_accepted_when_another_sends_nothing():
    gate = SampleGate()
    for n in range(64):
        assert gate.admit(f"stick {n}", AxesSample(1.0, REST), 1.0 + 0.001 * n) is not None
    assert gate.admit("pen", pen(1.0), 1.1) is None
    assert gate.take_message(1.1) == "1 sample from other devices was ignored: too many devices (1)"
    assert gate.admit("pen", pen(2.0), 2.0) is not None
    assert not gate.has_device("stick 0")
    assert gate.has_device("stick 1")


def test_samples_of_a_reconnected_device_with_another_clock_are_accepted():
    gate = SampleGate()
    gate.admit("pen", pen(500.0), 0.0)
    gate.reset_device("pen")
    assert gate.holder is None
    assert gate.admit("pen", pen(0.1), 0.2) is not None


def test_filter_delay_is_at_most_ten_milliseconds_and_equals_the_reported_delay():
    settings = DeviceControls()
    assert filter_latency_ms(settings) <= 10.0
    # The hand moves at 20 mm/s and is sampled at 120 Hz; in the steady state its lag in mm gives the delay.
    smooth, speed, rate = SampleFilter(settings), 20.0, 120.0
    for n in range(600):
        out = smooth.apply(pen(n / rate, speed * n / rate))
    assert isinstance(out, PoseSample)
    assert out.position_mm is not None
    lag_ms = 1000.0 * (speed * 599 / rate - out.position_mm[0]) / speed
    assert lag_ms <= filter_latency_ms(settings)
    # At constant speed the lag is the time constant; the orientation does not change and has a longer delay.
    assert lag_ms == pytest.approx(1000.0 / (2 * math.pi * (20.0 + 0.1 * speed)), rel=1e-3)
    assert smooth.latency_ms == pytest.approx(filter_latency_ms(settings))


def test_filter_with_a_lower_cutoff_reduces_tremor_more():
    rng = np.random.default_rng(7)
    noise = rng.normal(0.0, 0.5, 2000)

    def left(settings: DeviceControls) -> float:
        smooth = SampleFilter(settings)
        out = [smooth.apply(pen(n / 120.0, float(x))).position_mm[0] for n, x in enumerate(noise)]
        return float(np.std(out[200:]))

    steady = left(DeviceControls(min_cutoff_hz=1.0, beta_per_mm=0.0))
    usual = left(DeviceControls())
    assert steady < 0.15 < usual < 0.5
    assert left(DeviceControls(filter_on=False)) == float(np.std(noise[200:]))


def test_filter_smooths_rotations_along_the_shortest_path():
    smooth = SampleFilter(DeviceControls(min_cutoff_hz=3.0))
    for n in range(400):
        turn = rotation_from_vector(np.array([0.0, 0.0, 0.05 * n]))
        wxyz = wxyz_from_rotation(turn)
        flipped = tuple(-v for v in wxyz) if n % 2 else wxyz  # The quaternions q and -q are the same rotation.
        out = smooth.apply(pen(n / 60.0, wxyz=flipped))
        assert math.sqrt(sum(v * v for v in out.orientation_wxyz)) == pytest.approx(1.0, abs=1e-12)
    lag = rotation_from_wxyz(out.orientation_wxyz).T @ turn
    assert 0.0 < math.acos((np.trace(lag) - 1.0) / 2.0) < 0.3


def test_smoothing_filter_restarts_after_a_gap_in_the_samples():
    smooth = SampleFilter(DeviceControls(min_cutoff_hz=1.0, beta_per_mm=0.0))
    smooth.apply(pen(0.0))
    assert smooth.apply(pen(0.01, 10.0)).position_mm[0] < 5.0
    assert smooth.apply(pen(5.0, 80.0)).position_mm[0] == 80.0


def test_filter_settings_out_of_range_are_refused():
    for bad in (
        {"min_cutoff_hz": math.nan},
        {"min_cutoff_hz": 0.01},
        {"beta_per_mm": -1.0},
        {"derivative_cutoff_hz": 2e3},
    ):
        with pytest.raises(UsageError, match=next(iter(bad))):
            SampleFilter(DeviceControls(**bad))


def test_registration_finds_rotation_and_translation_and_reports_the_residual():
    rng = np.random.default_rng(3)
    turn, shift = rotation_from_vector(np.array([0.3, -2.0, 1.1])), np.array([12.0, -300.0, 45.0])
    points = rng.uniform(-80, 80, (6, 3))
    exact = fit_registration(points, points @ turn.T + shift)
    np.testing.assert_allclose(exact.lps_from_tracker[:3, :3], turn, atol=1e-12)
    np.testing.assert_allclose(exact.lps_from_tracker[:3, 3], shift, atol=1e-9)
    assert exact.rms_mm == pytest.approx(0.0, abs=1e-9)
    noisy = fit_registration(points, points @ turn.T + shift + rng.normal(0, 1.0, (6, 3)))
    assert 0.3 < noisy.rms_mm < 2.0
    assert np.linalg.det(noisy.lps_from_tracker[:3, :3]) == pytest.approx(1.0)


def test_registration_from_points_in_a_plane_is_never_mirrored():
    flat = np.array([[0.0, 0, 0], [50, 0, 0], [0, 30, 0], [40, 40, 0]])
    fit = fit_registration(flat, flat * [1, -1, 1])
    assert np.linalg.det(fit.lps_from_tracker[:3, :3]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "points", [[[0, 0, 0], [1, 0, 0]], [[0, 0, 0], [10, 0, 0], [20, 0, 0]], [[0, 0, 0], [np.nan, 0, 0], [0, 9, 0]]]
)
def test_registration_with_too_few_collinear_or_non_finite_points_is_refused(points):
    with pytest.raises(UsageError) as refused:
        fit_registration(points, points)
    assert refused.value.code == "navigate.registration"


def test_samples_of_devices_are_immutable_values():
    assert structs.replace(pen(1.0), buttons=2) == pen(1.0, buttons=2)
