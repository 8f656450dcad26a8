"""DICOM series of the corpus whose tags change the meaning of stored numbers: padding and Modality LUT."""
# ruff: noqa: E501 (a table: one input a line)

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from corpus import Input
from dicom_writer import SIDE, chest, packed, series
from pydicom.dataset import Dataset

__all__ = ["MODALITY_LUT", "OUTSIDE", "PADDING", "ringed", "with_lut"]

Make = Callable[[Path], Path]
_Y, _X = np.mgrid[:SIDE, :SIDE]
OUTSIDE = (_X - 15.5) ** 2 + (_Y - 15.5) ** 2 > 17.5**2
"""Mask (rows, columns) of the pixels outside the reconstructed circle."""
METAL = (slice(14, 16), slice(10, 12))
PADDED, LUT = "DICOM: padding", "DICOM: Modality LUT"
LOOK = "Check the edge of the slices."
EXPORT = "Export the series again with a rescale and without a Modality LUT."


def ringed(
    value: int,
    *,
    tag: int | None = None,
    vr: str = "US",
    limit: int | None = None,
    also: int | None = None,
    metal: int | None = None,
    slope: float = 1.0,
    kind: str = "<u2",
    pack: bool = False,
    **tags: Any,
) -> Make:
    """Return a function that writes a series with a ring of the stored value ``value`` around the picture.

    ``also`` is the value of every second pixel of the ring; ``metal`` is a stored value within the body.
    """

    def make(folder: Path) -> Path:
        def edit(dataset: Dataset, index: int) -> None:
            words = np.rint((chest()[index] + 1024.0) / slope).astype(np.int64)
            words[OUTSIDE] = value
            if also is not None:
                words[OUTSIDE & ((_X + _Y) % 2 == 0)] = also
            if metal is not None:
                words[METAL] = metal
            if kind == "<i2":
                words -= 1024 * (words < 1 << 14) * ~OUTSIDE
                dataset.PixelRepresentation, dataset.RescaleIntercept = 1, 0
            dataset.PixelData = words.astype(np.uint16 if kind == "<u2" else np.int16).astype(kind).tobytes()
            dataset.RescaleSlope = slope
            if tag is not None:
                dataset.add_new(0x00280120, vr, tag)
            if limit is not None:
                dataset.add_new(0x00280121, vr, limit)
            for keyword, one in tags.items():
                setattr(dataset, keyword, one)
            if pack:
                packed(dataset, folder, "JPEG2000")

        return series(folder, edit)

    return make


def _air_outside(*, metal: int | None = None, slope: float = 1.0, ring: int | None = None) -> Callable[[], np.ndarray]:
    """Return a function for the expected HU, in which the pixels outside the picture have another value.

    The value is air, the lowest value of each slice, or ``ring``.
    """

    def voxels() -> np.ndarray:
        values = np.rint(np.rint((chest() + 1024.0) / slope) * slope - 1024).astype(np.int16)
        if metal is not None:
            values[:, *METAL] = metal
        for plane in values:
            plane[OUTSIDE] = plane[~OUTSIDE].min() if ring is None else ring
        return values

    return voxels


def _half_slope() -> np.ndarray:
    return _air_outside(slope=0.5)()


def _soft_tissue_marked(dataset: Dataset, index: int) -> None:
    dataset.add_new(0x00280120, "US", 1064)  # 40 HU, the value of muscle


def _two_of_sixteen(dataset: Dataset, index: int) -> None:
    words = (chest()[index] + 1024).astype(np.uint16)
    words[OUTSIDE] = 63536
    dataset.PixelData, dataset.BitsStored, dataset.HighBit = words.tobytes(), 12, 11
    dataset.add_new(0x00280120, "US", 63536)


NOTE = {"expected": "opens", "notes": ("import.padding",)}
PADDING = [
    Input("padding 63536 round the picture, with its tag", PADDED, ringed(63536, tag=63536), voxels=_air_outside(), names=("% of the voxels",), **NOTE),
    Input("padding 63536, its tag written as signed -2000", PADDED, ringed(63536, tag=-2000, vr="SS"), voxels=_air_outside(), **NOTE),
    Input("padding 4095, and metal with the same value in the body", PADDED, ringed(4095, tag=4095, metal=4095), voxels=_air_outside(metal=3071), names=("80 voxels",), **NOTE),
    Input("padding 1024 (0 HU), and water with the same value in the body", PADDED, ringed(1024, tag=1024, metal=1024), voxels=_air_outside(metal=0), names=("were not changed",), do=LOOK, **NOTE),
    Input("padding with a range of values", PADDED, ringed(63536, also=61000, tag=63536, limit=60000), voxels=_air_outside(), **NOTE),
    Input("padding with slope 0.5", PADDED, ringed(63536, tag=63536, slope=0.5), voxels=_half_slope, **NOTE),
    Input("padding 30000 in signed values", PADDED, ringed(30000, tag=30000, kind="<i2"), voxels=_air_outside(), **NOTE),
    Input("padding outside the 12 used bits of 16", PADDED, lambda folder: series(folder, _two_of_sixteen), voxels=_air_outside(), do=LOOK, **NOTE),
    Input("padding 63536 in JPEG 2000", PADDED, ringed(63536, tag=63536, pack=True), voxels=_air_outside(), **NOTE),
    Input("padding 4095 without a tag", PADDED, ringed(4095), voxels=_air_outside(), names=("no tag states",), do=LOOK, **NOTE),
    Input("padding 63536 without a tag", PADDED, ringed(63536), voxels=_air_outside(), do=LOOK, **NOTE),
    Input("padding 0, the lowest value", PADDED, ringed(0, tag=0), "opens", voxels=_air_outside(ring=-1024)),
    Input("padding -2000 in signed values, its tag written as unsigned", PADDED, ringed(-2000, tag=63536, kind="<i2"), "opens", voxels=_air_outside(ring=-2000)),
    Input("the value of muscle declared as padding, without padding in the picture", PADDED, lambda folder: series(folder, _soft_tissue_marked), "opens", voxels=chest),
]  # fmt: skip


def with_lut(
    *, at: Callable[[int], bool] = lambda index: True, rescale: bool, unit: str = "HU", damage: bool = False
) -> Make:
    """Return a function that writes a series with stored numbers 4095 - (HU + 1024) and a Modality LUT."""

    def edit(dataset: Dataset, index: int) -> None:
        if not at(index):
            return
        item = Dataset()
        item.add_new(0x00283002, "US", [4096, 0, 16])
        item.add_new(0x00283004, "LO", unit)
        table = np.arange(4096)[::-1].astype("<u2")
        item.add_new(0x00283006, "OW", table[: 1000 if damage else None].tobytes())
        dataset.ModalityLUTSequence = [item]
        dataset.PixelData = (3071 - chest()[index]).astype("<u2").tobytes()
        if not rescale:
            del dataset.RescaleSlope, dataset.RescaleIntercept

    return lambda folder: series(folder, edit)


def _by_table() -> np.ndarray:
    return (chest() + np.int16(1024)).astype(np.int16)


def _by_rescale() -> np.ndarray:
    return (2047 - chest()).astype(np.int16)


TABLE = {"expected": "opens", "notes": ("import.modality-lut",), "is_hu": False, "do": EXPORT}
MODALITY_LUT = [
    Input("a Modality LUT beside a rescale with other values", LUT, with_lut(rescale=True), voxels=_by_rescale, names=("20 of 20", "differ by up to"), **TABLE),
    Input("a Modality LUT without a rescale: HU + 1024", LUT, with_lut(rescale=False), voxels=_by_table, names=("unit: HU",), **TABLE),
    Input("a Modality LUT without a rescale, in another unit", LUT, with_lut(rescale=False, unit="US"), voxels=_by_table, names=("the unit US",), **TABLE),
    Input("all slices except three with a Modality LUT beside the rescale", LUT, with_lut(rescale=True, at=lambda i: i not in (4, 9, 11)), "import.rescale-mixed", names=("ModalityLUTSequence", "3 of its 20"), do=EXPORT),
    Input("a Modality LUT with a table that is too short", LUT, with_lut(rescale=True, damage=True), "import.tags", names=("ModalityLUTSequence",), do=EXPORT),
]  # fmt: skip
