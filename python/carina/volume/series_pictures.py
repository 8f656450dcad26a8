"""Small pictures of series, for lists and while a CT is opened: one slice, in a lung window if its values are HU."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from carina.display.png import png_bytes
from carina.errors import CarinaError
from carina.volume.dicom_headers import SliceHeader
from carina.volume.dicom_pixel_bytes import release_pixel_data
from carina.volume.dicom_pixels import decode_slice, read_slice
from carina.volume.hu import judge_dicom
from carina.volume.opening_preview import PreviewSlice
from carina.volume.progress import Watch

if TYPE_CHECKING:
    from carina.volume.dicom import FoundSeries

__all__ = ["MAX_PICTURES", "PICTURE_PX", "preview_slice", "series_pictures", "slice_picture", "window_picture"]

PICTURE_PX = 96
"""Maximum width and height of a picture in a list."""
MAX_PICTURES = 40
"""Maximum number of pictures of one folder; further series are listed without a picture."""
PREVIEW_PX = 256
"""Maximum width and height of the picture of a CT that is being opened."""
_MIN_COSINE = 0.85
"""Minimum cosine of the angle between the axes of an axial slice and those of the patient: 31 degrees."""
_MAX_PIXELS = 4096 * 4096
_LOW_HU, _WIDTH_HU = -1350.0, 1500.0


def window_picture(numbers: NDArray[np.float64] | NDArray[np.int32], *, is_hu: bool, max_px: int = PICTURE_PX) -> bytes:
    r"""Return a slice as a small grey PNG.

    Parameters
    ----------
    numbers
        (rows, columns), HU or other numbers.
    is_hu
        Whether the numbers are HU; the lung window applies only to HU.
    max_px
        Maximum width and height of the picture.

    Examples
    --------
    >>> import numpy as np
    >>> window_picture(np.zeros((200, 300), dtype=np.int32), is_hu=True)[:4]
    b'\x89PNG'
    """
    step = -(-max(numbers.shape) // max_px)
    rows, columns = (max(1, side // step) for side in numbers.shape)
    cut = numbers[: rows * step, : columns * step].astype(np.float64)
    # The mean of each block of pixels; a single pixel would show noise.
    means = cut.reshape(rows, cut.shape[0] // rows, columns, cut.shape[1] // columns).mean(axis=(1, 3))
    low, width = _LOW_HU, _WIDTH_HU
    if not is_hu:
        low, high = (float(value) for value in np.percentile(means, (1, 99)))
        width = max(high - low, 1e-6)
    grey = np.clip((means - low) * (255.0 / width), 0.0, 255.0).astype(np.uint8)
    return png_bytes(np.repeat(grey[:, :, None], 3, axis=2))


def slice_picture(header: SliceHeader) -> bytes | None:
    """Return a picture of a slice as PNG; None if the slice cannot be read."""
    if header.problem is not None or header.rows * header.columns > _MAX_PIXELS:
        return None
    try:
        numbers = read_slice(header)
    except (CarinaError, OSError, ValueError):
        return None
    return window_picture(numbers, is_hu=header.modality == "CT")


def series_pictures(found: Sequence[FoundSeries], watch: Watch) -> Iterator[tuple[str, bytes]]:
    """Yield key and picture of each series that can be shown: its middle slice.

    Parameters
    ----------
    found
        Series of a folder.
    watch
        Progress and cancellation, checked before each slice.
    """
    for index, series in enumerate(found[:MAX_PICTURES]):
        watch.step("Making the thumbnails", index / len(found))
        picture = slice_picture(series.slices[len(series.slices) // 2])
        if picture is not None:
            yield series.info.key, picture


def preview_slice(series: FoundSeries) -> PreviewSlice | None:
    """Decode the middle slice of a series for the window that shows the opening.

    Returns
    -------
    PreviewSlice or None
        None if the slices are not axial, or the slice cannot be decoded without doubts about its values: reading the
        series then states the problem.
    """
    stack = series.stack
    if stack is None:
        return None
    index = len(stack.slices) // 2
    header = stack.slices[index]
    row, column = np.array(header.row_lps), np.array(header.column_lps)
    is_swapped = abs(row[0]) < abs(column[0])
    to_left, to_back = (column, row) if is_swapped else (row, column)
    if min(abs(to_left[0]), abs(to_back[1])) < _MIN_COSINE or header.rows * header.columns > _MAX_PIXELS:
        return None
    try:
        pixels = decode_slice(header)
    except (CarinaError, OSError, ValueError):
        return None
    finally:
        release_pixel_data()
    if pixels.doubts:
        return None
    numbers = pixels.numbers.T if is_swapped else pixels.numbers
    numbers = numbers[:: 1 if to_back[1] > 0 else -1, :: 1 if to_left[0] > 0 else -1]
    verdict = judge_dicom(
        np.clip(np.rint(numbers), -32768, 32767).astype(np.int16),
        modality=header.modality,
        has_rescale=header.has_rescale,
        rescale_type=header.rescale_type,
        bits_stored=header.bits_stored,
    )
    along_row, along_column = header.spacing_mm
    sides_mm = (header.columns * along_row, header.rows * along_column)
    centre_lps = (
        np.array(header.position_lps)
        + row * (along_row * (header.columns - 1) / 2)
        + column * (along_column * (header.rows - 1) / 2)
    )
    return PreviewSlice(
        png=window_picture(numbers, is_hu=verdict.is_hu, max_px=PREVIEW_PX),
        number=index + 1,
        num_slices=len(stack.slices),
        height_lps_mm=round(float(centre_lps[2]), 2),
        size_mm=(sides_mm[1], sides_mm[0]) if is_swapped else sides_mm,
        is_hu=verdict.is_hu,
    )
