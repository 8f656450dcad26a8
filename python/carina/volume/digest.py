"""Identity of a CT: a digest of its voxels that does not depend on the file format, and the position of the voxels.

DICOM, NIfTI, NRRD and MetaImage files of one CT differ in the order and direction of their axes. Digest and geometry
are therefore computed in *canonical order*: axes permuted and flipped (never resampled) so that they run as nearly as
possible along L, P and S. The voxels are those that Carina shows: int16 after rescale, rounding and clipping
(``volume.hu``).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations, product
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.errors import VolumeImportError
from carina.volume.model import Volume
from carina.volume.progress import Watch

V = TypeVar("V", np.uint8, np.int16)

GEOMETRY_TOLERANCE_MM = 1e-3
"""Maximum difference of a corner of one CT between two files; float32 headers cause about 1e-4 mm."""
_SLAB_BYTES = 8 << 20

# Reference directions for the choice of axes, as rows: L, P and S, rotated by about a degree. For a scan tilted by
# exactly 45 degrees, L and P (or S) would fit an axis equally well, and rounding of the header would decide.
_NEARLY_LPS = np.eye(3) + 0.01 * np.array([[0.0, -1.3, 0.7], [1.3, 0.0, -1.1], [-0.7, 1.1, 0.0]])


class Grid(Protocol):
    """Interface of objects with a grid: a volume, or the description of a CT in a case."""

    @property
    def shape_zyx(self) -> tuple[int, int, int]:
        """Shape (nz, ny, nx) of the array of voxels."""

    @property
    def lps_from_ijk(self) -> NDArray[np.float64]:
        """Transform (4x4) from voxel centres to LPS mm."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Shape and position of a volume's voxels."""

    shape_zyx: tuple[int, int, int]
    lps_from_ijk: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CanonicalAxes:
    """Permutation and flips that make the axes of a grid run along L, P and S."""

    axes_ijk: tuple[int, int, int]
    """Index of the axis i, j, k (0, 1, 2) that runs along x, y, z of LPS."""
    flipped: tuple[bool, bool, bool]
    """Whether the voxel axis that runs along x, y, z of LPS has the opposite direction."""

    @property
    def letters(self) -> str:
        """Directions of i, j and k, one letter each: ``LPS``, ``RAS``, ..."""
        found = ["", "", ""]
        for along, (axis, flip) in enumerate(zip(self.axes_ijk, self.flipped, strict=True)):
            found[axis] = ("LR", "PA", "SI")[along][flip]
        return "".join(found)

    def view(self, values_zyx: NDArray[V]) -> NDArray[V]:
        """Return the array in the order ``[S, P, L]``, without a copy."""
        along_x, along_y, along_z = (2 - axis for axis in self.axes_ijk)
        steps = tuple(slice(None, None, -1 if flip else 1) for flip in reversed(self.flipped))
        return values_zyx.transpose(along_z, along_y, along_x)[steps]


def canonical_axes(lps_from_ijk: NDArray[np.float64]) -> CanonicalAxes:
    """Return the permutation and the flips after which a grid's axes are nearest to L, P and S.

    The permutation has the largest sum of the cosines' magnitudes. The result depends only on the lines along which the
    axes run, not on their order in the file.
    """
    steps = np.asarray(lps_from_ijk, dtype=np.float64)[:3, :3]
    cosines = _NEARLY_LPS @ (steps / np.linalg.norm(steps, axis=0))
    best = max(permutations(range(3)), key=lambda axes: sum(abs(cosines[n, axis]) for n, axis in enumerate(axes)))
    i, j, k = best
    return CanonicalAxes((i, j, k), (bool(cosines[0, i] < 0), bool(cosines[1, j] < 0), bool(cosines[2, k] < 0)))


def canonical_geometry(grid: Grid) -> Geometry:
    """Return the shape and the position of a grid in canonical order."""
    axes = canonical_axes(grid.lps_from_ijk)
    shape_ijk = grid.shape_zyx[::-1]
    sizes = [shape_ijk[axis] for axis in axes.axes_ijk]
    old_from_new = np.zeros((4, 4))
    old_from_new[3, 3] = 1.0
    for new, (axis, flip) in enumerate(zip(axes.axes_ijk, axes.flipped, strict=True)):
        old_from_new[axis, new] = -1.0 if flip else 1.0
        old_from_new[axis, 3] = sizes[new] - 1.0 if flip else 0.0
    nx, ny, nz = sizes
    lps_from_ijk = np.asarray(grid.lps_from_ijk, dtype=np.float64) @ old_from_new
    lps_from_ijk.flags.writeable = False
    return Geometry((nz, ny, nx), lps_from_ijk)


def ct_digest(volume: Volume, *, cancel: Callable[[], bool] | None = None) -> str:
    """Return the SHA-256 of a volume's voxels in canonical order, which is the same for one CT in any file format.

    The bytes are little-endian int16, ``[S, P, L]``, L fastest. Shape and position are not part of the digest;
    :func:`same_geometry` compares them. The function needs a buffer of some MB and no second copy of the volume. The
    digest is computed at the first call and stored with the volume.

    Parameters
    ----------
    volume
        Not modified.
    cancel
        Called after every slab; a true result stops the work.

    Returns
    -------
    str
        64 hexadecimal digits, which reveal nothing about the patient.

    Raises
    ------
    CancelledError
        If ``cancel()`` returned true.

    Examples
    --------
    >>> import numpy as np
    >>> import carina
    >>> hu_zyx = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
    >>> flipped = np.diag([-1.0, 1.0, 1.0, 1.0])
    >>> a = ct_digest(carina.Volume(hu_zyx, np.eye(4)))
    >>> a == ct_digest(carina.Volume(np.ascontiguousarray(hu_zyx[:, :, ::-1]), flipped))
    True
    """
    if volume._digest is not None:
        return volume._digest
    watch = Watch(None, cancel)
    values = canonical_axes(volume.lps_from_ijk).view(volume.hu_zyx)
    found = hashlib.sha256()
    # Slabs instead of single slices: if canonical slices cross the slices of the file, a cache line contains voxels of
    # many canonical slices.
    num = max(1, _SLAB_BYTES // max(1, values[0].nbytes))
    for first in range(0, len(values), num):
        watch.step("Identifying the CT")
        found.update(np.ascontiguousarray(values[first : first + num], dtype="<i2").data.cast("B"))
    digest = found.hexdigest()
    object.__setattr__(volume, "_digest", digest)
    return digest


def same_geometry(a: Grid, b: Grid) -> bool:
    """Return whether two grids have their voxels at the same positions, in any order and direction of their axes.

    In canonical order both have the same shape, and no corner of the box differs by more than
    :data:`GEOMETRY_TOLERANCE_MM`.
    """
    return _corner_distance_mm(a, b) <= GEOMETRY_TOLERANCE_MM


def refuse_other_ct(volume: Volume, digest: str, geometry: Grid) -> None:
    """Raise an error if a volume is not the CT with this digest and geometry.

    Parameters
    ----------
    volume
        The opened volume.
    digest, geometry
        Digest and geometry of the CT that a case was made from.

    Raises
    ------
    VolumeImportError
        ``import.other-ct``, or ``import.other-geometry`` if the same voxels are at another position.
    """
    ours, theirs = canonical_geometry(volume), canonical_geometry(geometry)
    advice = "open the CT that the case was made from"
    if ours.shape_zyx != theirs.shape_zyx:
        msg = f"this is a different CT: expected {_sizes(theirs)} voxels, found {_sizes(ours)}; {advice}"
        raise VolumeImportError(msg, code="import.other-ct")
    if ct_digest(volume) != digest:
        msg = f"this is a different CT: its voxel values differ from those of the case; {advice}"
        raise VolumeImportError(msg, code="import.other-ct")
    apart_mm = _corner_distance_mm(ours, theirs)
    if apart_mm > GEOMETRY_TOLERANCE_MM:
        msg = (
            f"this CT has the same voxels as the case, but its position differs by up to {apart_mm:.3g} mm; "
            f"expected at most {GEOMETRY_TOLERANCE_MM:g} mm; {advice}"
        )
        raise VolumeImportError(msg, code="import.other-geometry")


def _sizes(geometry: Geometry) -> str:
    nz, ny, nx = geometry.shape_zyx
    return f"{nx} x {ny} x {nz}"


def _corner_distance_mm(a: Grid, b: Grid) -> float:
    """Return the largest distance of corresponding corners of two boxes in mm; infinite if the shapes differ."""
    one, other = canonical_geometry(a), canonical_geometry(b)
    if one.shape_zyx != other.shape_zyx:
        return float("inf")
    # Outer corners, half a voxel beyond the centres, so that a single slice has a thickness, too.
    ends = [(-0.5, n - 0.5) for n in reversed(one.shape_zyx)]
    corners = np.array([[*corner, 1.0] for corner in product(*ends)])
    return float(np.linalg.norm(corners @ (one.lps_from_ijk - other.lps_from_ijk).T, axis=1).max())
