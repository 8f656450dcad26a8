"""Tests of the small pictures of series, and of the reason of the likeliest chest CT."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from dicom_writer import chest, packed, series

from carina.display.png import png_pixels
from carina.errors import CancelledError
from carina.volume import open_volume
from carina.volume.dicom import find_series
from carina.volume.dicom_files import read_folder
from carina.volume.opening_preview import previews_to
from carina.volume.progress import Watch
from carina.volume.series_pictures import PICTURE_PX, preview_slice, series_pictures, window_picture

QUIET = Watch(None, None)


def found_in(folder):
    return find_series(read_folder(folder, recursive=True, watch=QUIET), QUIET)


def test_picture_shows_the_middle_slice_in_a_lung_window(tmp_path):
    found = found_in(series(tmp_path))
    ((key, png),) = series_pictures(found, QUIET)
    assert key == "3"
    grey = png_pixels(png)[..., 0]
    middle = chest()[10].astype(np.float64)
    expected = np.clip((middle + 1350.0) * (255.0 / 1500.0), 0.0, 255.0)
    assert grey.shape == middle.shape  # a small slice is not enlarged
    assert np.abs(grey - expected).max() <= 1.0


@pytest.mark.parametrize("shape", [(512, 512), (97, 300), (1, 5000), (96, 96)])
def test_picture_has_at_most_96_pixels_and_shows_means(shape):
    numbers = np.full(shape, -600, dtype=np.int32)
    grey = png_pixels(window_picture(numbers, is_hu=True))
    assert max(grey.shape[:2]) <= PICTURE_PX
    assert np.unique(grey).tolist() == [127]


def test_picture_of_other_values_uses_their_own_range():
    numbers = np.linspace(5000.0, 9000.0, 96 * 96).reshape(96, 96)
    grey = png_pixels(window_picture(numbers, is_hu=False))
    assert (grey.min(), grey.max()) == (0, 255)


def test_series_that_cannot_be_read_has_no_picture_and_the_others_have(tmp_path):
    series(tmp_path / "good", number=1)

    def broken(dataset, _index):
        packed(dataset, tmp_path, "JPEG")
        dataset.PixelData = dataset.PixelData[:40] + bytes(len(dataset.PixelData) - 40)

    series(tmp_path / "bad", broken, number=2)
    keys = [key for key, _ in series_pictures(found_in(tmp_path), QUIET)]
    assert keys == ["1"]


def test_pictures_are_made_one_by_one_until_cancelled(tmp_path):
    for number in range(1, 5):
        series(tmp_path / str(number), number=number)
    steps = []
    watch = Watch(lambda what, _share: steps.append(what), lambda: len(steps) >= 2)
    pictures = series_pictures(found_in(tmp_path), watch)
    assert [key for key, _ in itertools.islice(pictures, 2)] == ["1", "2"]
    with pytest.raises(CancelledError):
        next(pictures)


def test_only_the_likeliest_series_states_why(tmp_path):
    series(tmp_path / "long", number=1)
    series(tmp_path / "short", number=2, hu=chest()[:6])
    best, other = found_in(tmp_path)
    assert best.info.key == "1"
    assert best.info.likeliest.startswith("the likeliest chest CT: ")
    assert other.info.likeliest == ""
    assert found_in(tmp_path / "long")[0].info.likeliest == ""


def lung_window(hu):
    return np.clip((hu.astype(np.float64) + 1350.0) * (255.0 / 1500.0), 0.0, 255.0)


@pytest.mark.parametrize(
    "orientation",
    [(1, 0, 0, 0, 1, 0), (-1, 0, 0, 0, 1, 0), (1, 0, 0, 0, -1, 0), (0, 1, 0, 1, 0, 0), (0, 1, 0, -1, 0, 0)],
)
def test_preview_shows_the_patients_right_on_the_left_and_the_front_above(tmp_path, orientation):
    def turned(dataset, _index):
        dataset.ImageOrientationPatient = list(orientation)

    previews = []
    with previews_to(previews.append):
        volume = open_volume(series(tmp_path, turned))
    assert [preview.slice is None for preview in previews] == [True, False], "the list is reported before the slice"
    found = previews[-1].slice
    level = found.number - 1
    # The expected picture is made from the opened volume: each pixel at its place in LPS, sorted along L and P.
    nz, ny, nx = volume.shape_zyx
    j, i = np.mgrid[:ny, :nx]
    ijk = np.stack([i.ravel(), j.ravel(), np.full(i.size, level), np.ones(i.size)])
    lps = volume.lps_from_ijk @ ijk
    order = np.lexsort((np.round(lps[0], 3), np.round(lps[1], 3)))
    expected = lung_window(volume.hu_zyx[level].ravel()[order])
    grey = png_pixels(found.png)[..., 0]
    assert np.abs(grey.ravel() - expected).max() <= 1.0
    assert found.num_slices == nz
    assert found.height_lps_mm == pytest.approx(lps[2].mean(), abs=0.01)
    assert found.size_mm == pytest.approx([np.ptp(lps[axis]) * 32 / 31 for axis in (0, 1)], abs=0.01)
    assert found.is_hu


def sagittal(dataset, index):
    dataset.ImageOrientationPatient = [0, 1, 0, 0, 0, -1]
    dataset.ImagePositionPatient = [index * 2.5, 0, 0]


def truncated(dataset, _index):
    dataset.PixelData = dataset.PixelData[:100]


def swapped_bytes(dataset, _index):
    dataset.PixelData = np.frombuffer(dataset.PixelData, "<u2").byteswap().tobytes()


@pytest.mark.parametrize("edit", [sagittal, truncated, swapped_bytes])
def test_slice_that_is_not_axial_or_is_in_doubt_has_no_preview(tmp_path, edit):
    (found,) = found_in(series(tmp_path, edit))
    assert preview_slice(found) is None


def test_preview_of_values_that_are_not_hu_does_not_state_hu(tmp_path):
    def other_unit(dataset, _index):
        dataset.RescaleType = "US"

    (found,) = found_in(series(tmp_path, other_unit))
    assert preview_slice(found).is_hu is False


def test_preview_of_a_large_slice_shows_means_in_256_pixels(tmp_path):
    (found,) = found_in(series(tmp_path, hu=np.repeat(np.repeat(chest()[:4], 16, axis=1), 16, axis=2)))
    grey = png_pixels(preview_slice(found).png)[..., 0]
    assert grey.shape == (256, 256)
    assert np.abs(grey[::8, ::8] - lung_window(chest()[2])).max() <= 1.0
