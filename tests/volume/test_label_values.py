"""Label maps whose labels became fractions in a scaled or a floating-point format."""

from __future__ import annotations

from pathlib import Path

import grid_writers as grids
import numpy as np
import pytest

from carina.errors import VolumeImportError
from carina.volume import MaskLabelError, open_mask, open_volume


@pytest.fixture
def scan(tmp_path):
    folder = tmp_path / "scan"
    folder.mkdir()
    return open_volume(grids.nifti(folder, grids.chest()))


def label_map(top: int) -> np.ndarray:
    """Return a label map with all labels from 0 to ``top``, with many voxels each."""
    return (np.arange(np.prod(grids.SHAPE_ZYX)) % (top + 1)).reshape(grids.SHAPE_ZYX)


def scaled(folder: Path, labels: np.ndarray, kind: str, intercept: float = 0.0, step: float | None = None) -> Path:
    """Write labels as nibabel does: as multiples of a step that spreads them over the range of the integer type."""
    largest = np.iinfo(kind).max
    step = float(np.float32((labels.max() - intercept) / largest)) if step is None else step
    numbers = np.rint((labels - intercept) / step).astype(kind)
    return grids.nifti(folder, numbers, scale=(step, intercept), name="mask.nii")


def check_labels(path: Path, scan, labels: np.ndarray) -> None:
    for label in np.unique(labels[labels != 0]):
        np.testing.assert_array_equal(open_mask(path, scan, label=int(label)).inside_zyx, labels == label)


@pytest.mark.parametrize("kind", ["u1", "<i2", ">i2"])
@pytest.mark.parametrize("top", [1, 3, 4, 7, 12, 25])
def test_mask_labels_stored_in_fractional_steps_are_read_exactly(tmp_path, scan, kind, top):
    check_labels(scaled(tmp_path, label_map(top), kind), scan, label_map(top))


def test_mask_labels_with_a_step_and_an_intercept_are_read_exactly(tmp_path, scan):
    labels = label_map(12)
    check_labels(scaled(tmp_path, labels, "u1", intercept=-0.013), scan, labels)


def test_negative_labels_of_a_mask_are_read_exactly(tmp_path, scan):
    labels = np.where(label_map(5) == 5, -1, label_map(5))
    numbers = np.rint(labels / 0.0478).astype("<i2")
    path = grids.nifti(tmp_path, numbers, scale=(0.0478, 0.0), name="mask.nii")
    np.testing.assert_array_equal(open_mask(path, scan, label=-1).inside_zyx, labels == -1)


@pytest.mark.parametrize("form", ["nrrd", "nrrd gzip", "metaimage", "metaimage compressed", "nifti"])
@pytest.mark.parametrize("kind", ["<f4", "<f8"])
def test_mask_labels_stored_as_floats_are_read_in_every_format(tmp_path, scan, form, kind):
    labels = label_map(12)
    step = 12 / 255
    values = (np.rint(labels / step) * step).astype(kind)
    assert 0.02 < np.abs(values - labels).max() < 0.024
    check_labels(grids.FORMS[form](tmp_path, values), scan, labels)


def test_mask_labels_just_below_an_integer_are_read(tmp_path, scan):
    labels = label_map(1)
    check_labels(grids.nrrd(tmp_path, labels.astype("<f4") * np.float32(0.99999994)), scan, labels)


def probabilities() -> np.ndarray:
    """Return values that are mostly 0 and 1, with fractions at the edge between them."""
    ramp = np.clip(np.linspace(-3, 4, int(np.prod(grids.SHAPE_ZYX))), 0, 1)
    return ramp.reshape(grids.SHAPE_ZYX)


def refused(path: Path, scan) -> str:
    with pytest.raises(VolumeImportError, match="it may be a probability map") as caught:
        open_mask(path, scan)
    assert caught.value.code == "import.mask"
    assert not isinstance(caught.value, MaskLabelError)
    return str(caught.value)


@pytest.mark.parametrize("form", ["nifti", "nrrd", "metaimage"])
def test_probability_map_is_refused_as_mask_in_every_format(tmp_path, scan, form):
    refused(grids.FORMS[form](tmp_path, probabilities().astype("<f4")), scan)


@pytest.mark.parametrize("kind", ["u1", "<i2"])
def test_probability_map_stored_in_integer_steps_is_refused_as_mask(tmp_path, scan, kind):
    text = refused(scaled(tmp_path, probabilities(), kind), scan)
    assert "further from a whole number than half a step" in text


@pytest.mark.parametrize("step", [0.5, 0.25, 1 / 3])
def test_probability_map_of_few_coarse_steps_is_refused_as_mask(tmp_path, scan, step):
    numbers = (label_map(3) % round(1 / step + 1)).astype("<i2")
    refused(grids.nifti(tmp_path, numbers, scale=(step, 0.0), name="mask.nii"), scan)


def test_image_stored_in_steps_above_one_is_refused_as_mask(tmp_path, scan):
    refused(grids.nifti(tmp_path, label_map(200).astype("<i2"), scale=(1.3, 0.0), name="mask.nii"), scan)


def test_probability_map_with_values_near_integers_is_refused_as_mask(tmp_path, scan):
    values = label_map(1) + np.linspace(-0.04, 0.04, label_map(1).size).reshape(label_map(1).shape)
    refused(grids.nrrd(tmp_path, values.astype("<f4")), scan)


@pytest.mark.parametrize(("error", "opens"), [(0.049, True), (0.05, True), (0.051, False)])
def test_mask_label_with_a_single_value_may_differ_from_an_integer_by_a_twentieth(tmp_path, scan, error, opens):
    path = grids.nrrd(tmp_path, label_map(1) * (1 - error))
    if opens:
        check_labels(path, scan, label_map(1))
    else:
        refused(path, scan)


@pytest.mark.parametrize(("steps", "opens"), [(24, False), (25, True), (26, False)])
def test_mask_label_may_differ_from_an_integer_by_half_a_stored_step(tmp_path, scan, steps, opens):
    # In multiples of 0.04, 25 steps are exactly 1; one step more or fewer is off by a whole step.
    path = grids.nifti(tmp_path, (label_map(1) * steps).astype("<i2"), scale=(0.04, 0.0), name="mask.nii")
    if opens:
        check_labels(path, scan, label_map(1))
    else:
        refused(path, scan)


def test_limit_of_half_a_stored_step_separates_accepted_from_refused_mask_labels(tmp_path, scan):
    for intercept, opens in ((0.0499, True), (0.0501, False)):
        path = grids.nifti(tmp_path, (label_map(1) * 10).astype("<i2"), scale=(0.1, intercept), name="mask.nii")
        if opens:
            check_labels(path, scan, label_map(1))
        else:
            refused(path, scan)
