"""Correction of gantry tilt: each slice is moved within its plane, so that the stack has a rectangular grid.

A tilted gantry scans slices that are not at right angles to the movement of the table, so that each slice is displaced
against the one below it. The corrected grid has the directions of the slices and their normal. A voxel of the grid is
read from the slice at its level (backward mapping) by cubic interpolation along rows and columns; slices are not
blended with each other, so that the resolution along the normal stays that of the scan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MAX_TILT_DEG = 35.0
"""Maximum tilt in degrees that is corrected; gantries tilt by up to 30 degrees."""
_AIR_HU = -1024


@dataclass(frozen=True, slots=True, eq=False)
class TiltShifts:
    """Displacement of each slice of a tilted stack within its plane, and the size of the corrected slices."""

    tilt_deg: float
    """Angle between the line through the first pixels and the normal of the slices."""
    column_shifts: NDArray[np.float64]
    """(slices,) column of the corrected grid at which the first column of each slice is."""
    row_shifts: NDArray[np.float64]
    """(slices,) row of the corrected grid at which the first row of each slice is."""
    shape_yx: tuple[int, int]
    """Rows and columns of the corrected slices."""
    first_yx: tuple[int, int]
    """Row and column of the corrected grid's first voxel, counted from the first pixel of the first slice."""
    edge: str = ""
    """Text in brackets that names the edge of the slices nearer to the feet; empty if it is not clear."""

    @classmethod
    def of(
        cls,
        tilt_deg: float,
        offsets_mm: NDArray[np.float64],
        spacing_mm: tuple[float, float],
        shape_yx: tuple[int, int],
        edge: str = "",
    ) -> TiltShifts:
        """Return the shifts of slices, and a size that contains all of them.

        Parameters
        ----------
        tilt_deg
            Tilt in degrees.
        offsets_mm
            (slices, 2) displacement of each slice along its rows and along its columns, mm.
        spacing_mm
            Distance of columns and of rows.
        shape_yx
            Rows and columns of a slice.
        edge
            Text that names the edge of the slices nearer to the feet.
        """
        shifts = offsets_mm / np.array(spacing_mm)
        # Displacements below a hundredth of a pixel are rounding errors of the header, not a second tilt.
        shifts[:, np.ptp(shifts, axis=0) < 0.01] = 0.0
        low = np.floor(shifts.min(axis=0) + 1e-6)
        size = np.ceil((shifts - low).max(axis=0) - 1e-6).astype(int)
        own = shifts - low
        return cls(
            tilt_deg,
            own[:, 0],
            own[:, 1],
            (shape_yx[0] + int(size[1]), shape_yx[1] + int(size[0])),
            (int(low[1]), int(low[0])),
            edge,
        )

    def correct(self, values: NDArray[np.int16], index: int) -> NDArray[np.int16]:
        """Return a slice at its place in the corrected grid; pixels beyond the slice get its smallest value.

        Parameters
        ----------
        values
            (rows, columns) of the slice.
        index
            Index of the slice.
        """
        least = int(values.min())
        wide = _moved(values, float(self.column_shifts[index]), self.shape_yx[1], axis=1, beyond=least)
        return _moved(wide, float(self.row_shifts[index]), self.shape_yx[0], axis=0, beyond=least)

    def fill_beyond(
        self, values_zyx: NDArray[np.int16], sources: Sequence[tuple[int, Sequence[int]]], own_yx: tuple[int, int]
    ) -> None:
        """Set the pixels beyond each slice to the smallest value of the volume, at least that of air.

        Parameters
        ----------
        values_zyx
            The volume; changed in place.
        sources
            Index in the volume of each slice, with the indices of the scanned slices from which it was made.
        own_yx
            Rows and columns of a slice before the correction.
        """
        air = max(min(int(values_zyx[level].min()) for level, _ in sources), _AIR_HU)
        for level, indices in sources:
            one = values_zyx[level]
            for index in indices:
                top, bottom = _covered(float(self.row_shifts[index]), own_yx[0], self.shape_yx[0])
                left, right = _covered(float(self.column_shifts[index]), own_yx[1], self.shape_yx[1])
                one[:top], one[bottom:], one[:, :left], one[:, right:] = air, air, air, air


def _covered(shift: float, count: int, size: int) -> tuple[int, int]:
    """Return the range of the corrected grid that a slice covers, with the outer half of its outer pixels."""
    return max(0, math.ceil(shift - 0.5)), min(size, math.floor(shift + count - 0.5) + 1)


def _moved(values: NDArray[np.int16], shift: float, size: int, *, axis: int, beyond: int) -> NDArray[np.int16]:
    """Return values moved along an axis by a number of pixels, by cubic interpolation (Keys, a = -0.5).

    A result is limited to the range of the four values that it is computed from, so that edges have no overshoot.
    """
    count = values.shape[axis]
    if shift == 0.0 and size == count:
        return values
    shape = list(values.shape)
    shape[axis] = size
    out = np.full(shape, beyond, dtype=np.int16)
    low, end = _covered(shift, count, size)
    whole = math.floor(-shift)
    t = -shift - whole
    places = np.arange(low, end) + whole
    inside: list[slice] = [slice(None), slice(None)]
    inside[axis] = slice(low, end)
    if t < 1e-6:
        out[tuple(inside)] = np.take(values, np.clip(places, 0, count - 1), axis=axis)
        return out
    weights = (
        -0.5 * t + t * t - 0.5 * t**3,
        1.0 - 2.5 * t * t + 1.5 * t**3,
        0.5 * t + 2.0 * t * t - 1.5 * t**3,
        -0.5 * t * t + 0.5 * t**3,
    )
    taps = [np.take(values, np.clip(places + step, 0, count - 1), axis=axis) for step in (-1, 0, 1, 2)]
    total = sum(tap.astype(np.float32) * np.float32(weight) for tap, weight in zip(taps, weights, strict=True))
    least, most = np.minimum.reduce(taps), np.maximum.reduce(taps)
    out[tuple(inside)] = np.clip(np.rint(total), least, most).astype(np.int16)
    return out
