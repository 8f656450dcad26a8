"""Decision whether voxel values are Hounsfield units, and conversion of other values to int16."""

from __future__ import annotations

import numpy as np
import pytest

from carina.volume.hu import judge_dicom, judge_values, to_int16


def chest(rng: np.random.Generator) -> np.ndarray:
    """Return noisy values: a fifth outside air, a fifth lung, the rest tissue with some bone."""
    means = rng.choice([-1000, -850, -80, 40, 400], p=[0.2, 0.2, 0.2, 0.35, 0.05], size=(20, 30, 40))
    return (means + rng.normal(0, 25, means.shape)).round().astype(np.int16)


def test_values_of_a_noisy_chest_are_recognised_as_hu(rng):
    assert judge_values(chest(rng)).is_hu


def test_crop_without_outside_air_and_with_padding_is_recognised_as_hu(rng):
    values = chest(rng)
    values[values < -950] = -850
    values[:2] = -2000
    assert judge_values(values).is_hu


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("missing offset", "offset of 1024"),
        ("eight bits", "8 bits"),
        ("inverted", "air near -1000"),
        ("uniform phase", "do not cluster"),
        ("mask", "8 bits"),
    ],
)
def test_values_on_another_scale_are_reported_as_not_hu_with_the_reason(rng, name, text):
    values = chest(rng)
    values = {
        "missing offset": np.clip(values, -1024, None) + 1024,
        "eight bits": np.interp(values, [-1350, 150], [0, 255]).astype(np.int16),
        "inverted": -values - 300,
        "uniform phase": rng.integers(-4096, 4096, values.shape, dtype=np.int16),
        "mask": (values < -500).astype(np.int16),
    }[name]
    verdict = judge_values(values)
    assert not verdict.is_hu
    assert text in (verdict.reason or "")


def test_ct_without_air_is_hu_if_its_tags_state_it():
    values = np.linspace(-80, 400, 5000).astype(np.int16).reshape(10, 20, 25)
    assert judge_dicom(values, modality="CT", has_rescale=True, rescale_type="HU", bits_stored=12).is_hu
    assert not judge_dicom(values, modality="CT", has_rescale=True, rescale_type="US", bits_stored=12).is_hu
    assert not judge_dicom(values, modality="CT", has_rescale=True, rescale_type="", bits_stored=8).is_hu
    assert not judge_dicom(values, modality="PT", has_rescale=True, rescale_type="HU", bits_stored=12).is_hu


def test_integer_hu_values_within_int16_are_unchanged(rng):
    values = chest(rng)
    for kind in (np.int16, np.int32, np.float32, np.float64):
        converted = to_int16(values.astype(kind))
        np.testing.assert_array_equal(converted.values, values)
        assert converted.stretched is None


def test_fractional_hu_values_are_rounded(rng):
    values = chest(rng) + 0.3
    converted = to_int16(values)
    np.testing.assert_array_equal(converted.values, np.rint(values))
    assert converted.stretched is None


def test_hu_with_metal_outside_int16_is_clipped_with_a_note(rng):
    values = chest(rng).astype(np.int32)
    values[0, 0, 0] = 70_000
    converted = to_int16(values)
    assert converted.values[0, 0, 0] == 32767
    assert "1 voxels lie outside" in converted.notes[0].words


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.5, 4.25), (0.0, 60_000.0)])
def test_values_that_are_not_hu_are_scaled_to_0_to_4095_in_their_order(low, high):
    values = np.linspace(low, high, 1000).reshape(10, 10, 10)
    converted = to_int16(values)
    assert converted.stretched is not None
    assert (int(converted.values.min()), int(converted.values.max())) == (0, 4095)
    assert (np.diff(converted.values.reshape(-1)) >= 0).all()
    # The tolerance is half a step of the 4095: rounding only.
    np.testing.assert_allclose(
        converted.values / 4095 * (high - low) + low, values, rtol=0, atol=0.51 * (high - low) / 4095
    )
