"""Labels of voxels by their values, as in the paper: the value itself, or bins of 16 if there are too many values."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.errors import UsageError
from carina.render.transfer_function import PAPER_BIN_HU

EqualBy = Literal["auto", "values", "bins"]
EQUAL_BY = ("auto", "values", "bins")

MAX_VALUES = 256
"""Maximum number of different values that are each a label (256, as in the paper); more values are grouped in bins."""
BIN_NAME = f"bins of {PAPER_BIN_HU}"
VOXELS_PER_PART = 1 << 22
"""Number of voxels that are counted at once in the histogram; it limits the memory for a large volume."""


def values_in(values_zyx: NDArray[np.int16]) -> NDArray[np.int64] | None:
    """Return the different values of a volume, most frequent first; None if there are more than `MAX_VALUES`."""
    low, high = _core.value_range(values_zyx)
    flat = values_zyx.reshape(-1)
    counts = np.zeros(high - low + 1, dtype=np.int64)
    for first in range(0, flat.size, VOXELS_PER_PART):
        counts += np.bincount(flat[first : first + VOXELS_PER_PART].astype(np.int64) - low, minlength=len(counts))
        if np.count_nonzero(counts) > MAX_VALUES:
            return None
    used = np.flatnonzero(counts)
    return used[np.argsort(-counts[used], kind="stable")] + low


def bin_width(values_zyx: NDArray[np.int16]) -> int:
    """Return the width of the bins in which values are compared: 1 for at most `MAX_VALUES` values, else 16."""
    return PAPER_BIN_HU if values_in(values_zyx) is None else 1


def equal_by_name(values_zyx: NDArray[np.int16], equal_by: EqualBy = "auto") -> str:
    """Return the name of the quantity by which voxels are compared: ``values`` or ``bins of 16``."""
    if equal_by == "auto":
        equal_by = "values" if bin_width(values_zyx) == 1 else "bins"
    return "values" if equal_by == "values" else BIN_NAME


def value_labels(
    values_zyx: NDArray[np.int16], equal_by: EqualBy = "auto"
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Return a label for each voxel, and the lowest value of each label from 1 on.

    Labels have 8 bits, and label 0 marks voxels without one: with 256 values those of the rarest value, with more than
    255 bins those of the rarest bins.

    Parameters
    ----------
    values_zyx
        Values (nz, ny, nx).
    equal_by
        ``values``: voxels with one value have one label. ``bins``: voxels in one bin of 16 have one label. ``auto``:
        values if there are at most 256 of them, else bins.

    Raises
    ------
    UsageError
        If values are requested and there are more than 256.
    """
    found = None if equal_by == "bins" else values_in(values_zyx)
    if found is None:
        if equal_by == "values":
            msg = (
                f"expected at most {MAX_VALUES} different values to compare voxels by value; found more in this "
                f"volume; compare {BIN_NAME} (equal_by=bins) or the classes of a transfer function"
            )
            raise UsageError(msg, code="usage.too-many-values")
        labels, classes = _core.label_values(values_zyx)
        return labels, np.array([low for low, _, _, _ in classes], dtype=np.int64)
    found = found[: MAX_VALUES - 1]
    low = int(values_zyx.min())
    label_of = np.zeros(int(values_zyx.max()) - low + 1, dtype=np.uint8)
    label_of[found - low] = np.arange(1, len(found) + 1)
    labels = np.empty(values_zyx.shape, dtype=np.uint8)
    for z, values in enumerate(values_zyx):
        labels[z] = label_of[values.astype(np.int64) - low]
    return labels, found
