"""Tests of the small pictures of series, and of the reason of the likeliest chest CT."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from dicom_writer import chest, packed, series

from carina.display.png import png_pixels
from carina.errors import CancelledError
from carina.volume.dicom import find_series
from carina.volume.dicom_files import read_folder
from carina.volume.progress import Watch
from carina.volume.series_pictures import PICTURE_PX, series_pictures, window_picture

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
