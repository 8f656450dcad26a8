"""Tests of tilted stacks and of stacks with missing slices, which are corrected with a badge."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dicom_writer import GAP_MM, NUM_SLICES, chest, series
from enhanced_writer import chest_frames, enhanced
from pydicom.dataset import Dataset

from carina.errors import VolumeImportError
from carina.volume import badges_of, inspect_path, open_volume, quality_gate
from carina.volume.missing_slices import missing_levels
from carina.volume.tilt_correction import TiltShifts
from carina.volume.uneven_slices import UnevenSlices

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


def tilted_series(
    folder: Path, along: tuple[float, float], change: Callable[[Dataset], None] = lambda _dataset: None
) -> Path:
    """Write exact samples of ``tubes`` in slices that lean along rows and columns by two tangents.

    ``change`` changes each data set before it is written.
    """
    j, i = np.mgrid[:64, :64].astype(np.float64)
    hu = np.empty((NUM_SLICES, 64, 64), dtype=np.int16)
    for k in range(NUM_SLICES):
        x = -22.0 + i * SPACING_MM[0] + along[0] * k * GAP_MM
        y = -28.0 + j * SPACING_MM[1] + along[1] * k * GAP_MM
        hu[k] = np.rint(tubes(x, y, np.full_like(x, k * GAP_MM)))

    def lean(dataset: Dataset, index: int) -> None:
        shift = [-22.0 + along[0] * index * GAP_MM, -28.0 + along[1] * index * GAP_MM]
        dataset.ImagePositionPatient = [round(shift[0], 6), round(shift[1], 6), index * GAP_MM]
        change(dataset)

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


@pytest.mark.parametrize(
    ("along", "edge"),
    [
        pytest.param((0.0, 0.2), "anterior", id="posterior edge first"),
        pytest.param((0.0, -0.2), "posterior", id="anterior edge first"),
        pytest.param((0.2, 0.05), "right", id="left edge first"),
        pytest.param((-0.2, 0.05), "left", id="right edge first"),
        pytest.param((0.2, 0.2), None, id="corner first"),
    ],
)
@pytest.mark.parametrize("is_flipped", [False, True])
def test_note_of_a_tilt_names_the_edge_nearer_to_the_feet(tmp_path, along, edge, is_flipped):
    # The same slices with rows from bottom to top have a normal towards the feet.
    def flip(dataset: Dataset) -> None:
        if is_flipped:
            x, y, z = (float(mm) for mm in dataset.ImagePositionPatient)
            dataset.ImagePositionPatient = [x, round(y + 63 * SPACING_MM[1], 6), z]
            dataset.ImageOrientationPatient = [1, 0, 0, 0, -1, 0]
            dataset.PixelData = dataset.pixel_array[::-1].tobytes()

    words = badges_of(open_volume(tilted_series(tmp_path / "scan", along, flip)))[0].words
    assert ("edge of the slices" in words) is (edge is not None)
    if edge is not None:
        assert f"(the {edge} edge of the slices is nearer to the feet)" in words


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


UNEVEN = {
    "two distances": [2.5] * 10 + [1.5] * 12,
    "three distances and a wide one": [1.5] * 8 + [2.0] * 4 + [2.5] * 4 + [3.5] + [1.5] * 8,
    "growing": [1.2 + 0.06 * n for n in range(24)],
    "random": np.random.default_rng(4).uniform(1.2, 2.4, 24).tolist(),
}


def uneven_series(folder: Path, gaps_mm: list[float], along: tuple[float, float] = (0.0, 0.0)) -> Path:
    """Write exact samples of ``tubes`` in slices with these distances, which may lean along rows and columns."""
    heights_mm = np.round(np.concatenate([[0.0], np.cumsum(gaps_mm)]), 6)
    j, i = np.mgrid[:64, :64].astype(np.float64)
    hu = np.empty((len(heights_mm), 64, 64), dtype=np.int16)
    for k, z in enumerate(heights_mm):
        x, y = -22.0 + i * SPACING_MM[0] + along[0] * z, -28.0 + j * SPACING_MM[1] + along[1] * z
        hu[k] = np.rint(tubes(x, y, np.full_like(x, z)))

    def place(dataset: Dataset, index: int) -> None:
        z = float(heights_mm[index])
        dataset.ImagePositionPatient = [round(-22.0 + along[0] * z, 6), round(-28.0 + along[1] * z, 6), z]

    return series(folder, place, hu=hu)


@pytest.mark.parametrize("along", [(0.0, 0.0), (0.0, 0.2)], ids=["straight", "tilted"])
@pytest.mark.parametrize("name", UNEVEN)
def test_uneven_slices_have_the_values_of_the_scanned_object_on_an_even_grid(tmp_path, name, along):
    gaps_mm = UNEVEN[name]
    volume = open_volume(uneven_series(tmp_path / "scan", gaps_mm, along))
    assert volume.is_hu
    columns = volume.lps_from_ijk[:3, :3]
    sx, sy, sz = volume.spacing_mm
    np.testing.assert_allclose(columns.T @ columns, np.diag(np.square((*SPACING_MM, sz))), atol=1e-9)
    assert (sx, sy) == pytest.approx(SPACING_MM)
    assert volume.shape_zyx[0] * sz == pytest.approx(sum(gaps_mm) + sz)
    kk, jj, ii = np.indices(volume.shape_zyx)
    x, y, z = np.moveaxis(volume.to_lps(np.stack([ii, jj, kk], axis=-1)), -1, 0)
    expected = tubes(x, y, z)
    inside = (y - along[1] * z > -27.0) & (y - along[1] * z < -28.0 + 62 * SPACING_MM[1])
    error = np.abs(volume.hu_zyx - expected)[inside]
    gradient = np.hypot(*(np.gradient(expected, axis=a) for a in (1, 2)))[inside]
    steep = gradient > 100.0
    assert steep.sum() > 1000
    # An error of position in voxels is the error of the value divided by its change from voxel to voxel.
    assert float((error[steep] / gradient[steep]).max()) < 0.1


def test_even_slices_follow_a_cubic_course_and_equal_measured_slices_at_their_positions(tmp_path):
    """A parabola along the stack is reproduced by parabolic slopes; at the ends the slopes are those of lines."""
    heights_mm = np.concatenate([1.3 * np.arange(31), 39.0 + 2.6 * np.arange(1, 4), 47.2 + np.arange(6)])
    curve = 2.0 * (heights_mm - 38.0) ** 2 - 500.0
    texture = np.random.default_rng(2).integers(-300, 300, (32, 32))
    hu = np.rint(curve[:, None, None] + texture).astype(np.int16)
    folder = series(
        tmp_path / "scan",
        lambda d, k: setattr(d, "ImagePositionPatient", [-11.25, -14.5, round(float(heights_mm[k]), 6)]),
        hu=hu,
    )
    volume = open_volume(folder)
    at_mm = volume.to_lps(np.array([[0, 0, k] for k in range(volume.shape_zyx[0])]))[:, 2]
    assert at_mm[0] == pytest.approx(heights_mm[0])
    assert at_mm[-1] == pytest.approx(heights_mm[-1])
    inside = (at_mm > heights_mm[1]) & (at_mm < heights_mm[-2])
    expected = 2.0 * (at_mm - 38.0) ** 2 - 500.0
    # Rounding of the stored values to whole numbers, and the limit to the range of the neighbours at the turning point.
    np.testing.assert_allclose((volume.hu_zyx - texture)[inside], np.broadcast_to(
        expected[inside][:, None, None], (inside.sum(), 32, 32)), atol=3.6)  # fmt: skip
    np.testing.assert_array_equal(volume.hu_zyx[[0, -1]], hu[[0, -1]])
    away_mm = np.abs(at_mm[:, None] - heights_mm).min(axis=1)
    interpolated = np.isin(np.arange(len(at_mm)), volume.source.interpolated_slices)
    assert interpolated.sum() >= 3
    assert away_mm[interpolated].min() > 0.49 * volume.spacing_mm[2]
    assert away_mm[~interpolated].max() < 0.51 * volume.spacing_mm[2]


def test_resampling_is_named_by_a_badge_with_numbers_and_in_the_inspection(tmp_path):
    folder = uneven_series(tmp_path / "scan", [2.5] * 2 + [1.0] * 34)
    (badge,) = badges_of(open_volume(folder))
    assert badge.code == "import.slices-resampled"
    for text in ("1.00 to 2.50 mm apart", "the 37 slices", "after slice 1 to 2", "near slices 2, 4 to 5"):
        assert text in badge.words
    found = inspect_path(folder)
    assert [note.code for note in found.notes] == ["import.slices-resampled"]
    assert found.shape_zyx == open_volume(folder).shape_zyx


@pytest.mark.parametrize(
    ("gaps_mm", "text"),
    [
        ([1.0] * 30 + [1.3] * 3 + [4.5], "at most 4 times the usual distance of 1.00 mm and 10 mm"),
        ([4.0] * 12 + [5.5] * 3 + [10.5] * 3, "at most 4 times the usual distance of 5.50 mm and 10 mm"),
        ([1.0] * 12 + [1.3] * 3 + [4.5] * 3, "at most 10 % of the slices are interpolated"),
        ([1.0] * 12 + [1.4, 0.15, 1.0, 1.0], "only 0.15 mm apart"),
        ([1.7, 0.8] * 10, "two distances alternate"),
        ([1.0, 1.0, 1.6], "at least 5 slices"),
        ([1.0, 9.9], "at least 5 slices"),
    ],
)
def test_uneven_slices_that_are_not_resampled_are_refused_with_the_limit(tmp_path, gaps_mm, text):
    error = refusal(uneven_series(tmp_path / "scan", gaps_mm))
    assert error.code == "import.geometry.irregular"
    assert text in str(error)


@pytest.mark.parametrize(
    ("parts", "spacing_mm"),
    [
        ([(60, 1.0), (150, 2.9)], 2.9),
        ([(150, 2.9), (60, 1.0)], 2.9),
        ([(80, 0.7), (100, 2.6)], 2.6),
        ([(80, 1.0), (25, 1.4)], 1.4),
        ([(50, 1.0), (50, 2.9)], 2.9),
    ],
)
def test_even_distance_is_that_of_the_coarser_slices(parts, spacing_mm):
    gaps_mm = np.concatenate([np.full(count, gap_mm) for count, gap_mm in parts])
    uneven, reason = UnevenSlices.of(np.concatenate([[0.0], np.cumsum(gaps_mm)]))
    assert reason == ""
    # The last slice is on the grid, so the distance is wider by up to one part of the number of slices.
    assert spacing_mm - 1e-6 <= uneven.even_mm < spacing_mm * (1.0 + 1.0 / (len(uneven.sources) - 1))
    assert missing_levels(uneven.levels.tolist()) == ()


@pytest.mark.parametrize(("num_even", "good"), [(84, True), (83, False)])
def test_uneven_slices_are_resampled_up_to_a_tenth_of_interpolated_slices(num_even, good):
    # Ten slices are interpolated: three in each distance of 4 mm, and one beside the slice between two even ones.
    gaps_mm = [1.0] * num_even + [1.5] * 2 + [4.0] * 3
    uneven, reason = UnevenSlices.of(np.concatenate([[0.0], np.cumsum(gaps_mm)]))
    assert (uneven is not None) is good
    if uneven is None:
        assert "at most 10 % of the slices are interpolated" in reason
    else:
        assert uneven.even_mm == pytest.approx(1.0)
        assert len(missing_levels(uneven.levels.tolist())) == 10


def test_resampled_stack_states_no_finer_distance_than_nine_tenths_of_its_slices():
    num_resampled = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        parts = [np.full(rng.integers(5, 60), rng.uniform(0.6, 3.0)) for _ in range(rng.integers(2, 5))]
        gaps_mm = np.concatenate(parts)
        uneven, _ = UnevenSlices.of(np.concatenate([[0.0], np.cumsum(gaps_mm)]))
        if uneven is None:
            continue
        num_resampled += 1
        assert len(missing_levels(uneven.levels.tolist())) <= 0.1 * len(uneven.sources)
        # Wider distances than these miss slices, which are listed as interpolated.
        narrow_mm = gaps_mm[gaps_mm < 1.7 * uneven.even_mm]
        assert (narrow_mm > uneven.even_mm * (1.0 + 1e-6)).mean() <= 0.1, (seed, uneven.even_mm)
    assert num_resampled >= 20


@pytest.mark.parametrize("thick_mm", [5.0, 4.8], ids=["multiple", "no multiple"])
def test_thin_slices_with_thick_ones_are_refused_and_the_named_even_part_opens(tmp_path, thick_mm):
    folder = uneven_series(tmp_path / "scan", [1.25] * 110 + [thick_mm] * 40)
    error = refusal(folder)
    assert error.code == "import.geometry.irregular"
    assert "at most 10 % of the slices are interpolated" in str(error)
    assert "copy only slices 1 to 111 (IM000 to IM110), which are 1.25 mm apart, to a new folder" in str(error)
    volume = open_volume(without(folder, *range(111, 151)))
    assert volume.spacing_mm[2] == pytest.approx(1.25)
    assert volume.shape_zyx[0] == 111
    assert badges_of(volume) == ()


def test_quality_gate_names_the_distance_of_the_coarser_slices(tmp_path):
    volume = open_volume(uneven_series(tmp_path / "scan", [1.0] * 60 + [2.9] * 150))
    assert volume.spacing_mm[2] == pytest.approx(2.9, rel=0.01)
    assert volume.source.interpolated_slices == ()
    (finding,) = (one for one in quality_gate(volume).findings if one.code == "spacing")
    assert "slices are 2.9 mm apart" in finding.words


def test_uneven_slices_of_two_reconstructions_with_equal_distances_between_them_are_refused(tmp_path):
    heights_mm = np.concatenate([[0.0], np.cumsum([2.5] * 12 + [1.5] * 7)])

    def change(dataset: Dataset, index: int) -> None:
        # The kernel changes between two slices with the usual distance.
        dataset.ConvolutionKernel = ("B31f", "B70f")[index >= 6]
        dataset.ImagePositionPatient = [-11.25, -14.5, float(heights_mm[index])]

    error = refusal(series(tmp_path / "scan", change))
    assert error.code == "import.geometry.irregular"
    assert "neighbouring slices differ in reconstruction kernel" in str(error)


def test_uneven_distance_between_two_reconstructions_is_refused(tmp_path):
    def change(dataset: Dataset, index: int) -> None:
        dataset.ConvolutionKernel = ("B31f", "B70f")[index >= 8]
        dataset.ImagePositionPatient = [-11.25, -14.5, 2.5 * index + (1.2 if index >= 8 else 0.0)]

    error = refusal(series(tmp_path / "scan", change))
    assert error.code == "import.geometry.irregular"
    assert "differ in reconstruction kernel" in str(error)


def test_uneven_frames_of_an_enhanced_file_are_resampled(tmp_path):
    frames = chest_frames()
    for frame in frames[12:]:
        frame.z_mm += 1.1
    assert [n.code for n in open_volume(enhanced(tmp_path / "scan" / "IM1", frames)).source.notes] == [
        "import.slices-resampled"
    ]
