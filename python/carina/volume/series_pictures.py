"""Small pictures of series for lists: one slice, in a lung window if its values are HU."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from carina.display.png import png_bytes
from carina.errors import CarinaError
from carina.volume.dicom_headers import SliceHeader
from carina.volume.dicom_pixels import read_slice
from carina.volume.progress import Watch

if TYPE_CHECKING:
    from carina.volume.dicom import FoundSeries

__all__ = ["MAX_PICTURES", "PICTURE_PX", "series_pictures", "slice_picture", "window_picture"]

PICTURE_PX = 96
"""Maximum width and height of a picture."""
MAX_PICTURES = 40
"""Maximum number of pictures of one folder; further series are listed without a picture."""
_MAX_PIXELS = 4096 * 4096
_LOW_HU, _WIDTH_HU = -1350.0, 1500.0


def window_picture(numbers: NDArray[np.float64] | NDArray[np.int32], *, is_hu: bool) -> bytes:
    r"""Return a slice as a small grey PNG.

    Parameters
    ----------
    numbers
        (rows, columns), HU or other numbers.
    is_hu
        Whether the numbers are HU; the lung window applies only to HU.

    Examples
    --------
    >>> import numpy as np
    >>> window_picture(np.zeros((200, 300), dtype=np.int32), is_hu=True)[:4]
    b'\x89PNG'
    """
    step = -(-max(numbers.shape) // PICTURE_PX)
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
