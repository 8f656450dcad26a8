"""Outlines in a plane: of the lumen on the sub-voxel wall, and of any mask half-way between its voxels."""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.track.find.result import Airways
from carina.volume.model import Volume


class LumenOutline:
    """Outline of one lumen in arbitrary planes; docs/decisions/0111 defines the position of its lines.

    Creation is cheap: the data for a plane are computed when a plane first passes through a region, and are cached.
    An instance may be used from several threads.

    Parameters
    ----------
    volume
        The CT.
    airways
        Airways with the lumen, which must not be changed while this object exists.
    """

    def __init__(self, volume: Volume, airways: Airways) -> None:
        self._volume = volume
        self._lumen_zyx = airways.lumen_zyx
        self._levels = airways.wall_levels
        self._building = threading.Lock()
        self._surface: _core.LumenSurface | None = None

    def __repr__(self) -> str:
        """Return one line with the volume."""
        return f"LumenOutline({self._volume!r})"

    @property
    def lumen_zyx(self) -> NDArray[np.uint8]:
        """Lumen (nz, ny, nx) that is outlined."""
        return self._lumen_zyx

    def lines(
        self, lps_from_pixel: NDArray[np.float64], width: int, height: int
    ) -> tuple[NDArray[np.float64], ...] | None:
        """Return the outline in a planar picture.

        Parameters
        ----------
        lps_from_pixel
            (4, 4) matrix as in :class:`carina.render.Picture`: (column, row, depth in mm) in corner coordinates to
            LPS.
        width, height
            Size of the picture in pixels. Lines end within a voxel beyond its edges.

        Returns
        -------
        tuple or None
            Lines (n, 2) of columns and rows; a closed line ends at its start. None if the lumen is so ragged that no
            picture can show its outline.

        Raises
        ------
        GeometryError
            If the matrix does not describe a plane.
        """
        lines = self._made().cut(_matrix(lps_from_pixel), width=width, height=height)
        return None if lines is None else tuple(lines)

    def encoded(self, lps_from_pixel: NDArray[np.float64], width: int, height: int) -> bytes | None:
        """Return the outline in the encoding of the wire (protocol/README.md, "Outlines").

        The lines are cut off at the edges of the picture, and points within a quarter of a pixel of one another are
        merged. Returns None if the lumen is too irregular for an outline.
        """
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
    """Outline of one mask in arbitrary planes, half-way between voxels inside and outside.

    An instance may be used from several threads.

    Parameters
    ----------
    mask_zyx
        (nz, ny, nx), must not be changed while this object exists.
    lps_from_ijk
        (4, 4) affine matrix of its grid.
    """

    def __init__(self, mask_zyx: NDArray[np.bool_], lps_from_ijk: NDArray[np.float64]) -> None:
        self._shape = mask_zyx.shape
        mask = np.ascontiguousarray(mask_zyx).view(np.uint8)
        # Without levels the values are not read: zeros, for which no memory is allocated.
        values = np.zeros(mask.shape, dtype=np.int16)
        self._surface = _core.LumenSurface(values, _matrix(lps_from_ijk), mask, levels=None)

    def __repr__(self) -> str:
        """Return one line with the size of the mask."""
        nz, ny, nx = self._shape
        return f"MaskOutline({nx} x {ny} x {nz} voxels)"

    def encoded(self, lps_from_pixel: NDArray[np.float64], width: int, height: int) -> bytes | None:
        """Return the outline in the encoding of the wire, see :meth:`LumenOutline.encoded`."""
        return self._surface.encoded(_matrix(lps_from_pixel), width=width, height=height)


def _matrix(lps_from_pixel: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.ascontiguousarray(lps_from_pixel, dtype=np.float64)
