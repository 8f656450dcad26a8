"""Grid in which airways are searched and paths run: the grid of the CT, or a finer one if its slices are thick."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from carina.track.paths.interpolated_slices import with_divided_slices
from carina.track.tree.airway_tree import Branch
from carina.volume.model import Volume
from carina.volume.sparse_mask import empty_mask

PART_MM = 1.0
"""Thickness in mm of the parts into which slices are divided; parts may be up to a quarter thicker."""
THIN_MM = 0.95
"""Minimum thickness in mm of slices that are divided; they are divided into at least two parts."""
THICK = 1.5
"""Ratio of a slice's thickness to the voxel width from which a slice counts as thick."""
MIN_SLICES = 4
MAX_PARTS = 16
MIN_PART_MM = 0.45
"""Minimum thickness in mm of a part of a slice; a case file with thinner parts is damaged."""


class DividedSlices(NamedTuple):
    """Division of thick slices: axis and thickness."""

    axis: int
    """Axis across the slices: 0 is i, 1 is j, 2 is k."""
    slice_mm: float
    """Thickness in mm of the slices before the division."""


class PathGrid:
    """Grid in which the airways of a CT are searched, paths run and edits are made.

    In slices of 3 mm an oblique airway moves by its own width from one slice to the next: the voxels of its lumen
    are not connected, and its wall is not closed. Thick slices are therefore divided by interpolation
    (docs/decisions/0114). Display and export use the grid of the CT, of which each voxel is ``parts`` voxels of this
    grid.

    Parameters
    ----------
    ct
        The CT.
    parts
        Number of parts into which the thickest axis is divided; 1 for the grid of the CT.

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
        """Axis that is divided: 0 is i, 1 is j, 2 is k."""
        self._lock = threading.Lock()
        self._volume: Volume | None = ct if parts == 1 else None

    @classmethod
    def of(cls, ct: Volume) -> PathGrid:
        """Return the grid for a search of a CT: a divided one if the slices are thick, otherwise that of the CT."""
        # Spacings contain rounding errors of headers and matrices, which must not decide at the limit.
        _, width_mm, thick_mm = sorted(round(mm, 3) for mm in ct.spacing_mm)
        num = ct.shape_zyx[2 - int(np.argmax(ct.spacing_mm))]
        if thick_mm < max(THICK * width_mm, THIN_MM) or num < MIN_SLICES:
            return cls(ct)
        return cls(ct, min(max(int(np.ceil(thick_mm / PART_MM - 0.26)), 2), MAX_PARTS))

    @classmethod
    def parts_of(cls, ct: Volume, shape_zyx: tuple[int, int, int]) -> int | None:
        """Return the number of parts per slice for a grid of this shape; None if no division of the CT has it."""
        axis = 2 - int(np.argmax(ct.spacing_mm))
        parts = shape_zyx[axis] // ct.shape_zyx[axis]
        is_possible = parts == 1 or (1 < parts <= MAX_PARTS and ct.spacing_mm[2 - axis] / parts >= MIN_PART_MM)
        return parts if is_possible and cls(ct, parts).shape_zyx == shape_zyx else None

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the constructor and its arguments for a pickle; the interpolated volume is not pickled."""
        return PathGrid, (self.ct, self.parts)

    def __repr__(self) -> str:
        """Return one line with the number of parts and the shape."""
        return f"PathGrid(parts={self.parts}, shape_zyx={self.shape_zyx})"

    @property
    def is_divided(self) -> bool:
        """Whether the grid is finer than that of the CT."""
        return self.parts > 1

    @property
    def divided(self) -> DividedSlices | None:
        """Division of the CT's slices that makes this grid; None if the grid is that of the CT."""
        return DividedSlices(self._axis, self.ct.spacing_mm[self._axis]) if self.is_divided else None

    @property
    def shape_zyx(self) -> tuple[int, int, int]:
        """Number of voxels of the grid along z, y, x."""
        shape = list(self.ct.shape_zyx)
        shape[2 - self._axis] *= self.parts
        return shape[0], shape[1], shape[2]

    @property
    def lps_from_ijk(self) -> NDArray[np.float64]:
        """Affine matrix (4, 4) from the voxels of this grid to LPS in mm."""
        place = self.ct.lps_from_ijk.copy()
        # The first part of the first voxel begins where that voxel begins.
        place[:3, 3] += place[:3, self._axis] * (0.5 / self.parts - 0.5)
        place[:3, self._axis] /= self.parts
        return place

    @property
    def volume(self) -> Volume:
        """CT on this grid; interpolated at first use and cached."""
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
        # Always interpolate in the same direction of the patient: floating-point sums depend on their order.
        is_turned = bool(along[np.argmax(np.abs(along))] < 0.0)
        made = with_divided_slices(stack[::-1] if is_turned else stack, self.parts)
        made = np.moveaxis(made[::-1] if is_turned else made, 0, 2 - self._axis)
        return dataclasses.replace(self.ct, hu_zyx=np.ascontiguousarray(made), lps_from_ijk=self.lps_from_ijk)

    def voxels_in(self, ct_voxels: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Return the (m, 3) voxels of this grid that are in (n, 3) voxels of the CT, both i, j, k, in order."""
        if not self.is_divided:
            return ct_voxels
        finer = np.repeat(ct_voxels.astype(np.int64), self.parts, axis=0)
        finer[:, self._axis] = self.parts * finer[:, self._axis] + np.tile(np.arange(self.parts), len(ct_voxels))
        return np.unique(finer, axis=0).astype(np.uint16)

    def mask_in_parts(self, ct_mask_zyx: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a mask of the CT on this grid; the given array itself if nothing is divided."""
        return np.repeat(ct_mask_zyx, self.parts, axis=2 - self._axis) if self.is_divided else ct_mask_zyx

    def mask_on_ct(self, mask_zyx: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a mask of this grid on the grid of the CT, read-only.

        A voxel is 1 if at least half of its parts are inside.

        Parameters
        ----------
        mask_zyx
            (nz, ny, nx) on this grid, nonzero inside. The result is this array itself if nothing is divided.
        """
        if not self.is_divided:
            return mask_zyx
        made = self._majority_mask(mask_zyx)
        made.flags.writeable = False
        return made

    def lumen_on_ct(self, lumen_zyx: NDArray[np.uint8], branches: Sequence[Branch]) -> NDArray[np.uint8]:
        """Return a lumen of this grid on the grid of the CT, read-only; it contains the centreline of each branch.

        The centrelines are added because an airway that runs within a slice may be thinner than half of the slice.

        Parameters
        ----------
        lumen_zyx
            (nz, ny, nx) on this grid, nonzero inside. The result is this array itself if nothing is divided.
        branches
            The tree in the lumen.
        """
        if not self.is_divided:
            return lumen_zyx
        made = self._majority_mask(lumen_zyx)
        points = np.concatenate([_densified(branch.points) for branch in branches])
        place = np.linalg.inv(self.lps_from_ijk)
        finer = np.floor(points @ place[:3, :3].T + place[:3, 3] + 0.5).astype(np.int64)
        finer = finer[((finer >= 0) & (finer < np.array(self.shape_zyx[::-1]))).all(axis=1)]
        finer = finer[lumen_zyx[finer[:, 2], finer[:, 1], finer[:, 0]] != 0]
        finer[:, self._axis] //= self.parts
        made[finer[:, 2], finer[:, 1], finer[:, 0]] = 1
        made.flags.writeable = False
        return made

    def _majority_mask(self, mask_zyx: NDArray[np.uint8]) -> NDArray[np.uint8]:
        made = empty_mask(self.ct.shape_zyx)
        stack = np.moveaxis(mask_zyx, 2 - self._axis, 0)
        slices = np.moveaxis(made, 2 - self._axis, 0)
        for k, layer in enumerate(slices):
            parts = stack[k * self.parts : (k + 1) * self.parts]
            where = np.argwhere(parts.any(axis=0))
            if len(where):
                # Write only the bounding box of the mask, so that empty pages of memory stay untouched.
                (low_a, low_b), (high_a, high_b) = where.min(axis=0), where.max(axis=0) + 1
                count = (parts[:, low_a:high_a, low_b:high_b] != 0).sum(axis=0)
                np.copyto(layer[low_a:high_a, low_b:high_b], np.uint8(1), where=2 * count >= self.parts)
        return made


def _densified(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points of a line with four interpolated points added between each pair."""
    if len(points) < 2:
        return points
    shares = np.arange(5)[:, None, None] / 5.0
    return np.concatenate([(points[:-1] + shares * np.diff(points, axis=0)).reshape(-1, 3), points[-1:]])
