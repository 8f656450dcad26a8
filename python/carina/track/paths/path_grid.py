"""The grid in which airways are searched and paths run: that of the CT, or a finer one where its slices are thick."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carina.track.paths.interpolated import with_divided_slices
from carina.track.tree.airway_tree import Branch
from carina.volume.model import Volume
from carina.volume.sparse_mask import empty_mask

__all__ = ["MOST_PARTS", "DividedSlices", "PathGrid"]

PART_MM = 1.0
"""Slices are divided into parts about so thick; one that is a quarter thicker is left as it is."""
THICK = 1.5
"""A slice is thick if it is so many times as thick as its voxels are wide."""
WIDEST_MM = 1.0
"""Wider voxels do not show the airways that thick slices break."""
LEAST_SLICES = 4
MOST_PARTS = 16
LEAST_PART_MM = 0.5
"""A case file with thinner parts is damaged: its grid would take much memory."""


class DividedSlices(NamedTuple):
    """Thick slices that were divided."""

    axis: int
    """Axis across the slices: 0 is i, 1 is j, 2 is k."""
    slice_mm: float
    """Their thickness."""


class PathGrid:
    """The grid in which the airways of a CT are searched, paths run and edits are made.

    In slices of 3 mm an oblique airway moves by its own width from one slice to the next: the voxels of its lumen are
    not connected, and its wall is not closed. So thick slices are divided by interpolation (docs/decisions/0114).
    What is shown and exported is on the grid of the CT: each of its voxels is ``parts`` voxels of this grid.

    Parameters
    ----------
    ct
        The CT.
    parts
        Into how many parts its thickest axis is divided; 1 is the grid of the CT.

    Examples
    --------
    >>> import numpy as np
    >>> import carina
    >>> ct = carina.Volume(np.zeros((40, 50, 60), dtype=np.int16), np.diag([0.7, 0.7, 3.0, 1.0]))
    >>> grid = PathGrid.of(ct)
    >>> grid.parts, grid.shape_zyx
    (3, (120, 50, 60))
    """

    __slots__ = ("_axis", "_lock", "_volume", "ct", "parts")

    def __init__(self, ct: Volume, parts: int = 1) -> None:
        self.ct = ct
        self.parts = parts
        self._axis = int(np.argmax(ct.spacing_mm))
        """That is divided: 0 is i, 1 is j, 2 is k."""
        self._lock = threading.Lock()
        self._volume: Volume | None = ct if parts == 1 else None

    @classmethod
    def of(cls, ct: Volume) -> PathGrid:
        """Return the grid for a search of a CT; its own grid where its slices are not thick."""
        _, width_mm, thick_mm = sorted(ct.spacing_mm)
        num = ct.shape_zyx[2 - int(np.argmax(ct.spacing_mm))]
        if width_mm > WIDEST_MM or thick_mm < THICK * width_mm or num < LEAST_SLICES:
            return cls(ct)
        parts = int(np.ceil(thick_mm / PART_MM - 0.26))
        return cls(ct, min(max(parts, 1), MOST_PARTS))

    @classmethod
    def parts_of(cls, ct: Volume, shape_zyx: tuple[int, int, int]) -> int | None:
        """Return into how many parts a grid of this shape divides the CT; None if the shape is that of no such grid."""
        axis = 2 - int(np.argmax(ct.spacing_mm))
        parts = shape_zyx[axis] // ct.shape_zyx[axis]
        is_possible = parts == 1 or (1 < parts <= MOST_PARTS and ct.spacing_mm[2 - axis] / parts >= LEAST_PART_MM)
        return parts if is_possible and cls(ct, parts).shape_zyx == shape_zyx else None

    def __reduce__(self) -> tuple[Any, ...]:
        return PathGrid, (self.ct, self.parts)

    def __repr__(self) -> str:
        return f"PathGrid(parts={self.parts}, shape_zyx={self.shape_zyx})"

    @property
    def is_divided(self) -> bool:
        """Whether the grid is finer than that of the CT."""
        return self.parts > 1

    @property
    def divided(self) -> DividedSlices | None:
        """The slices that were divided to make this grid; None where it is that of the CT."""
        return DividedSlices(self._axis, self.ct.spacing_mm[self._axis]) if self.is_divided else None

    @property
    def shape_zyx(self) -> tuple[int, int, int]:
        """Voxels along z, y, x."""
        shape = list(self.ct.shape_zyx)
        shape[2 - self._axis] *= self.parts
        return shape[0], shape[1], shape[2]

    @property
    def lps_from_ijk(self) -> NDArray[np.float64]:
        """4x4, from the voxels of this grid to LPS mm."""
        place = self.ct.lps_from_ijk.copy()
        # The first part of the first voxel begins where that voxel begins.
        place[:3, 3] += place[:3, self._axis] * (0.5 / self.parts - 0.5)
        place[:3, self._axis] /= self.parts
        return place

    @property
    def volume(self) -> Volume:
        """The CT on this grid; interpolated when it is first needed, and kept."""
        made = self._volume
        if made is None:
            with self._lock:
                made = self._volume
                if made is None:
                    made = self._volume = self._interpolated()
        return made

    def _interpolated(self) -> Volume:
        along = self.ct.lps_from_ijk[:3, self._axis]
        stack = np.moveaxis(self.ct.hu_zyx, 2 - self._axis, 0)
        # In one direction of the patient whatever the file's: sums of floats depend on their order.
        is_turned = bool(along[np.argmax(np.abs(along))] < 0.0)
        made = with_divided_slices(stack[::-1] if is_turned else stack, self.parts)
        made = np.moveaxis(made[::-1] if is_turned else made, 0, 2 - self._axis)
        return dataclasses.replace(self.ct, hu_zyx=np.ascontiguousarray(made), lps_from_ijk=self.lps_from_ijk)

    def voxels_in(self, ct_voxels: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return the (m, 3) voxels of this grid that lie in (n, 3) voxels of the CT, both i, j, k, in order."""
        if not self.is_divided:
            return ct_voxels
        finer = np.repeat(ct_voxels.astype(np.int64), self.parts, axis=0)
        finer[:, self._axis] = self.parts * finer[:, self._axis] + np.tile(np.arange(self.parts), len(ct_voxels))
        return np.unique(finer, axis=0).astype(np.uint16)

    def mask_in_parts(self, ct_mask_zyx: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a mask on the grid of the CT on this grid; that array itself where nothing is divided."""
        return np.repeat(ct_mask_zyx, self.parts, axis=2 - self._axis) if self.is_divided else ct_mask_zyx

    def mask_on_ct(self, mask_zyx: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a mask of this grid on the grid of the CT, read-only: 1 where at least half of a voxel's parts are 1.

        Parameters
        ----------
        mask_zyx
            (nz, ny, nx) of this grid, not 0 inside. The result is this array itself where nothing is divided.
        """
        if not self.is_divided:
            return mask_zyx
        made = self._most_of(mask_zyx)
        made.flags.writeable = False
        return made

    def lumen_on_ct(self, lumen_zyx: NDArray[np.uint8], branches: Sequence[Branch]) -> NDArray[np.uint8]:
        """Return a lumen of this grid on the grid of the CT, read-only; it holds each branch's centreline.

        An airway that runs within a slice may be thinner than half of it.

        Parameters
        ----------
        lumen_zyx
            (nz, ny, nx) of this grid, not 0 inside. The result is this array itself where nothing is divided.
        branches
            The tree in the lumen.
        """
        if not self.is_divided:
            return lumen_zyx
        made = self._most_of(lumen_zyx)
        points = np.concatenate([_dense(branch.points) for branch in branches])
        place = np.linalg.inv(self.lps_from_ijk)
        finer = np.floor(points @ place[:3, :3].T + place[:3, 3] + 0.5).astype(np.int64)
        finer = finer[((finer >= 0) & (finer < np.array(self.shape_zyx[::-1]))).all(axis=1)]
        finer = finer[lumen_zyx[finer[:, 2], finer[:, 1], finer[:, 0]] != 0]
        finer[:, self._axis] //= self.parts
        made[finer[:, 2], finer[:, 1], finer[:, 0]] = 1
        made.flags.writeable = False
        return made

    def _most_of(self, mask_zyx: NDArray[np.uint8]) -> NDArray[np.uint8]:
        made = empty_mask(self.ct.shape_zyx)
        stack = np.moveaxis(mask_zyx, 2 - self._axis, 0)
        slices = np.moveaxis(made, 2 - self._axis, 0)
        for k, layer in enumerate(slices):
            parts = stack[k * self.parts : (k + 1) * self.parts]
            where = np.argwhere(parts.any(axis=0))
            if len(where):
                # Only what holds some of it: pages of memory without any are not touched.
                (low_a, low_b), (high_a, high_b) = where.min(axis=0), where.max(axis=0) + 1
                count = (parts[:, low_a:high_a, low_b:high_b] != 0).sum(axis=0)
                np.copyto(layer[low_a:high_a, low_b:high_b], np.uint8(1), where=2 * count >= self.parts)
        return made


def _dense(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points of a line with four between each two of them."""
    if len(points) < 2:
        return points
    shares = np.arange(5)[:, None, None] / 5.0
    return np.concatenate([(points[:-1] + shares * np.diff(points, axis=0)).reshape(-1, 3), points[-1:]])
