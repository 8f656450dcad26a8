"""Tests of transfer functions: presets, the JSON format and histograms."""

from __future__ import annotations

import json

import numpy as np
import pytest

from carina.errors import RenderError, UsageError
from carina.render import PRESETS, TransferFunction, transfer_from_histogram, transfer_preset
from carina.volume import Volume


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_transfer_function_presets_are_restored_from_their_json(name):
    preset = transfer_preset(name)
    text = json.dumps(preset.to_json(), allow_nan=False)
    back = TransferFunction.from_json_text(text)
    assert back.name == name
    assert back.to_json() == preset.to_json()
    np.testing.assert_array_equal(back.points, preset.points)


def test_minimal_document_of_a_transfer_function_is_valid_and_unknown_keys_are_ignored():
    points = [[0, 1, 1, 1, 0.5]]
    document = {"format": "carina-transfer", "version": 1, "unit": "HU", "reference_mm": 1, "points": points}
    transfer = TransferFunction.from_json({**document, "note": "from a friend"})
    assert transfer.points.shape == (1, 5)
    assert not transfer.wall


@pytest.mark.parametrize(
    "change",
    [
        {"format": "itk"},
        {"version": 2},
        {"points": []},
        {"points": [[0, 2, 0, 0, 0]]},
        {"points": [[5, 0, 0, 0, 0], [4, 0, 0, 0, 0]]},
        {"points": [[float("nan"), 0, 0, 0, 0]]},
        {"points": "all"},
        {"points": [[0, 1, 1, 1]]},
        {"reference_mm": 0},
        {"unit": "kg"},
        {"light": {"ambient": -1}},
        {"light": {"reach_mm": "far"}},
    ],
)
def test_invalid_documents_of_a_transfer_function_are_refused(change):
    document = {"format": "carina-transfer", "version": 1, "points": [[0, 1, 1, 1, 0.5]]}
    with pytest.raises(RenderError) as refused:
        TransferFunction.from_json({**document, **change})
    assert refused.value.exit_code == 2


def test_transfer_function_from_text_that_is_not_a_json_object_is_refused():
    for text in ("{", "[1]"):
        with pytest.raises(RenderError):
            TransferFunction.from_json_text(text)


def test_unknown_transfer_function_preset_is_a_usage_error_that_lists_the_known_ones():
    with pytest.raises(UsageError, match="endoscopic"):
        transfer_preset("rainbow")


@pytest.mark.parametrize(("dark", "bright", "noise"), [(20, 180, 6), (-950, 40, 25), (300, 1400, 60)])
def test_threshold_from_the_histogram_is_between_the_dark_and_the_bright_peak(dark, bright, noise):
    rng = np.random.default_rng(3)
    shape = (20, 22, 24)
    air = rng.random(shape) < 0.3
    values = np.where(air, dark, bright) + rng.normal(0, noise, shape)
    volume = Volume(np.rint(values).astype(np.int16), np.eye(4), is_hu=False, not_hu_reason="test")
    transfer, threshold = transfer_from_histogram(volume)
    # Both peaks are at least 8 standard deviations from the middle, and Otsu's threshold is between them.
    assert dark + 3 * noise < threshold < bright - 3 * noise
    assert ((volume.hu_zyx < threshold) == air).mean() > 0.999
    assert transfer.unit == "raw"
    clear = transfer.points[0]
    assert dark + noise < clear[0] < threshold
    assert clear[4] == 0.0


def test_histogram_of_a_volume_with_one_value_is_refused():
    with pytest.raises(RenderError, match="nothing to distinguish"):
        transfer_from_histogram(Volume(np.full((3, 4, 5), 7, dtype=np.int16), np.eye(4)))
