"""Outlines in a plane: of the lumen on the sub-voxel wall, and of any mask half-way between its voxels."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.track.find.found import Airways
from carina.volume.model import Volume

__all__ = ["LumenOutline", "MaskOutline"]


class LumenOutline:
    """Cuts one lumen with planes; docs/decisions/0111 says where its lines lie.

    Cheap to make: what a plane needs is built when a plane first passes there, and kept. Any thread may use it.

    Parameters
    ----------
    volume
        The CT.
    airways
        Their lumen, which must not be written to meanwhile.
    """

    def __init__(self, volume: Volume, airways: Airways) -> None:
        self._volume = volume
        self._lumen_zyx = airways.lumen_zyx
        self._levels = airways.wall_levels
        self._building = threading.Lock()
        self._surface: _core.LumenSurface | None = None

    def __repr__(self) -> str:
        return f"LumenOutline({self._volume!r})"

    @property
    def lumen_zyx(self) -> NDArray[np.uint8]:
        """The lumen that is outlined."""
        return self._lumen_zyx

    def lines(
        self, lps_from_pixel: NDArray[np.float64], width: int, height: int
    ) -> tuple[NDArray[np.float64], ...] | None:
        """The outline in a planar picture.

        Parameters
        ----------
        lps_from_pixel
            4x4, as in :class:`carina.render.Picture`: (column, row, depth in mm) in corner coordinates to LPS.
        width, height
            Of the picture, pixels. Lines end within a voxel beyond its edges.

        Returns
        -------
        tuple or None
            Lines (n, 2) of columns and rows; a closed one ends where it begins. None where the lumen is so ragged that
            no picture can show its outline.

        Raises
        ------
        GeometryError
            If the matrix is no plane's.
        """
        lines = self._made().cut(_matrix(lps_from_pixel), width=width, height=height)
        return None if lines is None else tuple(lines)

    def encoded(self, lps_from_pixel: NDArray[np.float64], width: int, height: int) -> bytes | None:
        """The same as the wire has it (protocol/README.md, "Outlines"): cut off at the picture's edges, points that lie
        within a quarter of a pixel of one another taken together."""
        return self._made().encoded(_matrix(lps_from_pixel), width=width, height=height)

    def _made(self) -> _core.LumenSurface:
        with self._building:
            if self._surface is None:
                volume = self._volume
                self._surface = _core.LumenSurface(
                    volume.hu_zyx, volume.lps_from_ijk, np.ascontiguousarray(self._lumen_zyx), levels=self._levels
                )
            return self._surface


class MaskOutline:
    """Cuts one mask with planes: its lines lie half-way between voxels inside and outside. Any thread may use it.

    Parameters
    ----------
    mask_zyx
        (nz, ny, nx), not to be written to meanwhile.
    lps_from_ijk
        (4, 4) of its grid.
    """

    def __init__(self, mask_zyx: NDArray[np.bool_], lps_from_ijk: NDArray[np.float64]) -> None:
        self._shape = mask_zyx.shape
        mask = np.ascontiguousarray(mask_zyx).view(np.uint8)
        # Values are asked for by nobody without levels: zeros that no memory is taken for.
        values = np.zeros(mask.shape, dtype=np.int16)
        self._surface = _core.LumenSurface(values, _matrix(lps_from_ijk), mask, levels=None)

    def __repr__(self) -> str:
        nz, ny, nx = self._shape
        return f"MaskOutline({nx} x {ny} x {nz} voxels)"

    def encoded(self, lps_from_pixel: NDArray[np.float64], width: int, height: int) -> bytes | None:
        """As :meth:`LumenOutline.encoded`."""
        return self._surface.encoded(_matrix(lps_from_pixel), width=width, height=height)


def _matrix(lps_from_pixel: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.ascontiguousarray(lps_from_pixel, dtype=np.float64)
