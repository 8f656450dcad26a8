"""Mesh of the lumen with vertices on the sub-voxel wall, and the mask of the voxels inside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.errors import CancelledError
from carina.track.find.growth import HALF_WALL_HU, STEP_RISE_HU
from carina.track.find.result import Airways
from carina.track.intensity_levels import air_scale
from carina.track.progress import Cancel
from carina.volume.model import Volume


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Closed mesh of triangles, the surface of a mask or lumen."""

    vertices_lps: NDArray[np.float64]
    """Vertices (n, 3), LPS in mm."""
    triangles: NDArray[np.uint32]
    """Vertex indices (m, 3) of the triangles, counterclockwise seen from outside."""

    def __repr__(self) -> str:
        """Return one line with the numbers of vertices and triangles."""
        return f"Mesh({len(self.vertices_lps)} vertices, {len(self.triangles)} triangles)"

    @property
    def volume_mm3(self) -> float:
        """Volume inside the mesh, mm3."""
        # Relative to a point nearby: far from the origin of the scanner the terms would cancel badly.
        corners = (self.vertices_lps - self.vertices_lps.mean(axis=0))[self.triangles]
        return float(np.einsum("na,na->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6.0)

    @property
    def area_mm2(self) -> float:
        """Total area of the triangles, mm2."""
        corners = self.vertices_lps[self.triangles]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return float(np.linalg.norm(across, axis=1).sum() / 2.0)


@shows_progress
def lumen_mesh(
    volume: Volume, airways: Airways, *, progress: ProgressChoice = None, cancel: Cancel | None = None
) -> Mesh:
    """Compute the inner wall of the airways as a mesh.

    Parameters
    ----------
    volume
        The CT in which the airways were found.
    airways
        Airways with the lumen. If it was found in the CT, the vertices are at the half-maximum between air and wall;
        for a lumen from external software they are half-way between its voxels and their neighbours.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Function that is called often; the calculation stops when it returns True.

    Returns
    -------
    Mesh
        Closed mesh without holes or doubled edges; it may have several pieces.

    Raises
    ------
    NoResultError
        If the lumen is empty.
    CancelledError
        If ``cancel()`` returned True.

    References
    ----------
    Lorensen and Cline 1987 (marching cubes).
    """
    if cancel is not None and cancel():
        raise CancelledError("stopped while building the surface")
    vertices, triangles = _core.lumen_mesh(
        volume.hu_zyx,
        volume.lps_from_ijk,
        airways.lumen_zyx,
        levels=_levels(volume, airways),
        cancel=cancel,
        progress=fraction_callback(progress_function(progress), "building the surface"),
    )
    return Mesh(vertices, triangles)


def mask_mesh(inside_zyx: NDArray[np.bool_], lps_from_ijk: NDArray[np.float64]) -> Mesh:
    """Compute the surface of a small mask, half-way between its voxels and their neighbours.

    Parameters
    ----------
    inside_zyx
        (nz, ny, nx), True inside; where the mask reaches the faces of the array the surface is closed there.
    lps_from_ijk
        (4, 4) affine matrix of the array, LPS in mm.

    Raises
    ------
    NoResultError
        If the mask is empty.

    References
    ----------
    Lorensen and Cline 1987 (marching cubes).
    """
    lumen = np.pad(np.asarray(inside_zyx, dtype=np.uint8), 1)
    padded = np.array(lps_from_ijk, dtype=np.float64)
    padded[:3, 3] -= padded[:3, :3].sum(axis=1)
    vertices, triangles = _core.lumen_mesh(np.zeros(lumen.shape, np.int16), padded, lumen, levels=None)
    return Mesh(vertices, triangles)


def lumen_mask(volume: Volume, airways: Airways) -> NDArray[np.uint8]:
    """Compute the mask of the voxels whose centres are inside :func:`lumen_mesh`.

    Exported files and volumes in ml use this mask. The search stops where a wall begins to show, before the
    half-maximum at which the lumen ends; so :attr:`Airways.lumen_zyx`, in which paths run, has fewer voxels.

    Parameters
    ----------
    volume
        The CT in which the airways were found.
    airways
        Airways with the lumen. A lumen from external software is returned unchanged.

    Returns
    -------
    numpy.ndarray
        (nz, ny, nx) uint8, 1 inside.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> bool((lumen_mask(phantom.volume, airways) >= airways.lumen_zyx).all())
    True
    """
    return _core.lumen_mask(volume.hu_zyx, volume.lps_from_ijk, airways.lumen_zyx, levels=_levels(volume, airways))


def _levels(volume: Volume, airways: Airways) -> tuple[float, float, float] | None:
    """Return the threshold, the level of the wall and the least rise to the wall.

    None for a lumen from external software.
    """
    if not np.isfinite(airways.threshold):
        return None
    scale = air_scale(volume)
    wall = max(float(scale.level(HALF_WALL_HU)), airways.threshold)
    return airways.threshold, wall, scale.span(STEP_RISE_HU)
