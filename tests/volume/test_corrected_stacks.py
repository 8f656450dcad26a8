"""Tests of tilted stacks and of stacks with missing slices, which are corrected with a badge."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dicom_writer import GAP_MM, NUM_SLICES, chest, series
from enhanced_writer import chest_frames, enhanced
from pydicom.dataset import Dataset

from carina.errors import VolumeImportError
from carina.volume import badges_of, inspect_path, open_volume
from carina.volume.tilt_correction import TiltShifts

SPACING_MM = (0.7, 0.9)


def refusal(path: Path) -> VolumeImportError:
    with pytest.raises(VolumeImportError) as caught:
        open_volume(path)
    return caught.value


def tubes(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return HU of smooth oblique tubes of air in tissue, as an exact function of the position in mm."""
    share = np.ones_like(x)
    for distance_mm in (np.hypot(x - 0.2 * z + 9.0, y - 0.1 * z), np.hypot(x + 0.3 * z - 9.0, y + 4.0 - 0.25 * z)):
        share *= 1.0 / (1.0 + np.exp(-(distance_mm - 4.0) / 0.8))
    return -1000.0 + 1040.0 * share


def tilted_series(folder: Path, along: tuple[float, float]) -> Path:
    """Write exact samples of ``tubes`` in slices that lean along rows and columns by two tangents."""
    j, i = np.mgrid[:64, :64].astype(np.float64)
    hu = np.empty((NUM_SLICES, 64, 64), dtype=np.int16)
    for k in range(NUM_SLICES):
        x = -22.0 + i * SPACING_MM[0] + along[0] * k * GAP_MM
        y = -28.0 + j * SPACING_MM[1] + along[1] * k * GAP_MM
        hu[k] = np.rint(tubes(x, y, np.full_like(x, k * GAP_MM)))

    def lean(dataset: Dataset, index: int) -> None:
        shift = [-22.0 + along[0] * index * GAP_MM, -28.0 + along[1] * index * GAP_MM]
        dataset.ImagePositionPatient = [round(shift[0], 6), round(shift[1], 6), index * GAP_MM]

    return series(folder, lean, hu=hu)


@pytest.mark.parametrize("tilt_deg", [0.5, 5.0, -16.5, 25.0, 30.0])
@pytest.mark.parametrize("axis", ["rows", "columns", "both"])
def test_tilted_series_has_the_values_of_the_scanned_object_on_a_rectangular_grid(tmp_path, tilt_deg, axis):
    tangent = np.tan(np.radians(tilt_deg))
    along = {"rows": (tangent, 0.0), "columns": (0.0, tangent), "both": (tangent * 0.6, tangent * 0.8)}[axis]
    volume = open_volume(tilted_series(tmp_path / "scan", along))
    columns = volume.lps_from_ijk[:3, :3]
    np.testing.assert_allclose(columns.T @ columns, np.diag(np.square((*SPACING_MM, GAP_MM))), atol=1e-9)
    assert volume.is_hu
    kk, jj, ii = np.indices(volume.shape_zyx)
    x, y, z = np.moveaxis(volume.to_lps(np.stack([ii, jj, kk], axis=-1)), -1, 0)
    expected = tubes(x, y, z)
    # Voxels that a slice contains, without the outermost pixel, whose neighbours are missing.
    inside = (x - along[0] * z > -21.0) & (x - along[0] * z < -22.0 + 62 * SPACING_MM[0])
    inside &= (y - along[1] * z > -27.0) & (y - along[1] * z < -28.0 + 62 * SPACING_MM[1])
    error = np.abs(volume.hu_zyx - expected)[inside]
    gradient = np.hypot(*(np.gradient(expected, axis=a) for a in (1, 2)))[inside]
    steep = gradient > 100.0
    assert steep.sum() > 1000
    # An error of position in voxels is the error of the value divided by its change from voxel to voxel.
    assert float((error[steep] / gradient[steep]).max()) < 0.1
    assert float(error.max()) < 40.0
    outside = (x - along[0] * z < -23.0) | (y - along[1] * z < -29.0)  # air
    assert (volume.hu_zyx[outside] < -900).all()


def test_shift_by_whole_pixels_changes_no_value(tmp_path):
    folder = tmp_path / "scan"
    series(folder, lambda d, k: setattr(d, "ImagePositionPatient", [-11.25, -14.5 + 0.9 * k, GAP_MM * k]))
    volume = open_volume(folder)
    assert volume.shape_zyx == (NUM_SLICES, 32 + NUM_SLICES - 1, 32)
    for k in range(NUM_SLICES):
        np.testing.assert_array_equal(volume.hu_zyx[k, k : k + 32], chest()[k])
    np.testing.assert_allclose(volume.lps_from_ijk[:3, 3], [-11.25, -14.5, 0.0])


@pytest.mark.parametrize("sign", [1, -1])
def test_tilt_is_named_by_a_badge_and_in_the_inspection(tmp_path, sign):
    folder = tilted_series(tmp_path / "scan", (0.0, sign * np.tan(np.radians(12.0))))
    volume = open_volume(folder)
    assert [note.code for note in badges_of(volume)] == ["import.tilt-corrected"]
    assert "12.0 degrees" in badges_of(volume)[0].words
    assert volume.source.tilt_deg == pytest.approx(12.0, abs=0.01)
    found = inspect_path(folder)
    assert [note.code for note in found.notes] == ["import.tilt-corrected"]
    assert found.shape_zyx == volume.shape_zyx
    np.testing.assert_array_equal(found.lps_from_ijk, volume.lps_from_ijk)


@pytest.mark.parametrize(("tilt_deg", "good"), [(34.9, True), (35.1, False)])
def test_largest_tilt_that_is_corrected(tmp_path, tilt_deg, good):
    folder = tilted_series(tmp_path / "scan", (0.0, np.tan(np.radians(tilt_deg))))
    if good:
        assert open_volume(folder).source.tilt_deg == pytest.approx(tilt_deg, abs=0.01)
    else:
        assert refusal(folder).code == "import.geometry.tilt"


def test_interpolated_edge_has_no_overshoot():
    step = np.where(np.arange(20) < 10, -1000, 60).astype(np.int16)[None, :].repeat(4, axis=0)
    for part in np.linspace(0, 1, 11):
        tilt = TiltShifts.of(10.0, np.array([[0.0, 0.0], [part * 0.7, 0.0]]), SPACING_MM, (4, 20))
        moved = tilt.correct(step, 1)
        assert moved.min() == -1000
        assert moved.max() == 60


def without(folder: Path, *lost: int) -> Path:
    for index in lost:
        (folder / f"IM{index:03d}").unlink()
    return folder


@pytest.mark.parametrize("lost", [(7,), (7, 8), (4, 15)])
def test_few_missing_slices_are_interpolated_and_named(tmp_path, lost):
    whole = open_volume(series(tmp_path / "whole"))
    volume = open_volume(without(series(tmp_path / "scan"), *lost))
    np.testing.assert_array_equal(volume.lps_from_ijk, whole.lps_from_ijk)
    assert volume.shape_zyx == whole.shape_zyx
    measured = [k for k in range(NUM_SLICES) if k not in lost]
    np.testing.assert_array_equal(volume.hu_zyx[measured], whole.hu_zyx[measured])
    assert volume.source.interpolated_slices == lost
    (badge,) = badges_of(volume)
    assert badge.code == "import.slices-interpolated"
    assert f"{len(lost)} of 20" in badge.words
    assert f"{lost[0] + 1}" in badge.words
    below, above = (volume.hu_zyx[k].astype(float) for k in (lost[0] - 1, measured[measured.index(lost[0] - 1) + 1]))
    steps = measured[measured.index(lost[0] - 1) + 1] - (lost[0] - 1)
    np.testing.assert_allclose(volume.hu_zyx[lost[0]], below + (above - below) / steps, atol=0.5)
    assert volume.source.series.num_slices == NUM_SLICES - len(lost)


@pytest.mark.parametrize(
    ("num_slices", "lost", "text"),
    [
        (20, (5, 9, 13), "at most 10 % of the slices"),
        (100, (40, 41, 42, 43), "gaps of at most 3 slices and 10 mm"),
        (100, (40, 41, 42, 43, 44, 45, 46, 47, 48), "9 slices may be missing"),
    ],
)
def test_larger_gap_is_refused_with_the_limit(tmp_path, num_slices, lost, text):
    folder = series(tmp_path / "scan", hu=chest(num_slices))
    error = refusal(without(folder, *lost))
    assert error.code == "import.geometry.irregular"
    assert text in str(error)


def test_gap_beside_slices_on_another_grid_is_refused(tmp_path):
    def other(dataset: Dataset, index: int) -> None:
        if index == 7:
            dataset.PixelSpacing = [0.8, 0.6]

    assert refusal(series(tmp_path / "scan", other)).code == "import.geometry.mixed"


@pytest.mark.parametrize(
    ("keyword", "values", "name"),
    [
        ("ConvolutionKernel", ("B31f", "B70f"), "reconstruction kernel"),
        ("NominalPercentageOfRespiratoryPhase", (0, 50), "respiratory phase"),
        ("AcquisitionNumber", (1, 2), "acquisition number"),
    ],
)
def test_gap_between_two_reconstructions_is_refused(tmp_path, keyword, values, name):
    def change_at(first_changed):
        def change(dataset: Dataset, index: int) -> None:
            setattr(dataset, keyword, values[index >= first_changed])

        return change

    error = refusal(without(series(tmp_path / "at-the-gap", change_at(8)), 7))
    assert error.code == "import.geometry.irregular"
    assert f"differ in {name}" in str(error)
    elsewhere = open_volume(without(series(tmp_path / "elsewhere", change_at(12)), 7))
    assert elsewhere.source.interpolated_slices == (7,)


def test_gap_in_a_series_that_counts_its_slices_is_interpolated(tmp_path):
    def count(dataset: Dataset, index: int) -> None:
        dataset.AcquisitionNumber = index + 1

    assert open_volume(without(series(tmp_path / "scan", count), 7)).source.interpolated_slices == (7,)


def test_tilt_and_gap_are_corrected_together(tmp_path):
    tangent = float(np.tan(np.radians(10.0)))
    whole = open_volume(tilted_series(tmp_path / "whole", (0.0, tangent)))
    volume = open_volume(without(tilted_series(tmp_path / "scan", (0.0, tangent)), 9))
    np.testing.assert_allclose(volume.lps_from_ijk, whole.lps_from_ijk, atol=1e-6)
    np.testing.assert_array_equal(np.delete(volume.hu_zyx, 9, axis=0), np.delete(whole.hu_zyx, 9, axis=0))
    assert [note.code for note in badges_of(volume)] == ["import.tilt-corrected", "import.slices-interpolated"]


def test_missing_frame_of_an_enhanced_file_is_interpolated(tmp_path):
    frames = chest_frames()
    del frames[7]
    volume = open_volume(enhanced(tmp_path / "scan" / "IM1", frames))
    assert volume.source.interpolated_slices == (7,)
