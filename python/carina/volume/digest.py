"""Which CT a volume is: a digest of its voxels that does not depend on the file format, and where they lie.

DICOM, NIfTI, NRRD and MetaImage files of one CT differ in the order and direction of their axes. Digest and geometry
are therefore taken in *canonical order*: axes permuted and flipped (never resampled) so that they run as nearly as
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
from carina.volume.watch import Watch

__all__ = [
    "GEOMETRY_TOLERANCE_MM",
    "CanonicalAxes",
    "Geometry",
    "Grid",
    "canonical_axes",
    "canonical_geometry",
    "ct_digest",
    "refuse_other_ct",
    "same_geometry",
]

V = TypeVar("V", np.uint8, np.int16)

GEOMETRY_TOLERANCE_MM = 1e-3
"""By which a corner of one CT may differ between two files; float32 headers move it by about 1e-4 mm."""
_SLAB_BYTES = 8 << 20

# Directions that stand for L, P and S when axes are chosen, as rows. They are turned by about a degree: where a scan is
# tilted by exactly 45 degrees L and P (or S) fit an axis equally well, and the last bit of a header would decide.
_NEARLY_LPS = np.eye(3) + 0.01 * np.array([[0.0, -1.3, 0.7], [1.3, 0.0, -1.1], [-0.7, 1.1, 0.0]])


class Grid(Protocol):
    """Anything that says how many voxels it has and where they lie: a volume, or what a case keeps of it."""

    @property
    def shape_zyx(self) -> tuple[int, int, int]:
        """Shape of the array."""

    @property
    def lps_from_ijk(self) -> NDArray[np.float64]:
        """4x4, voxel centres to LPS mm."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """Where the voxels of a volume lie."""

    shape_zyx: tuple[int, int, int]
    lps_from_ijk: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CanonicalAxes:
    """How the axes of a grid become L, P and S."""

    axes_ijk: tuple[int, int, int]
    """Which of i, j, k (0, 1, 2) runs along x, y, z of LPS."""
    flipped: tuple[bool, bool, bool]
    """Whether that axis runs the other way, for x, y, z."""

    @property
    def letters(self) -> str:
        """Where i, j and k point, one letter each: ``LPS``, ``RAS``, ..."""
        found = ["", "", ""]
        for along, (axis, flip) in enumerate(zip(self.axes_ijk, self.flipped, strict=True)):
            found[axis] = ("LR", "PA", "SI")[along][flip]
        return "".join(found)

    def view(self, values_zyx: NDArray[V]) -> NDArray[V]:
        """The array ``[S, P, L]``, without a copy."""
        along_x, along_y, along_z = (2 - axis for axis in self.axes_ijk)
        steps = tuple(slice(None, None, -1 if flip else 1) for flip in reversed(self.flipped))
        return values_zyx.transpose(along_z, along_y, along_x)[steps]


def canonical_axes(lps_from_ijk: NDArray[np.float64]) -> CanonicalAxes:
    """The permutation and the flips after which a grid's axes lie nearest to L, P and S.

    The permutation has the largest sum of the cosines' magnitudes. The result depends only on the lines along which the
    axes run, never on their order in the file.
    """
    steps = np.asarray(lps_from_ijk, dtype=np.float64)[:3, :3]
    cosines = _NEARLY_LPS @ (steps / np.linalg.norm(steps, axis=0))
    best = max(permutations(range(3)), key=lambda axes: sum(abs(cosines[n, axis]) for n, axis in enumerate(axes)))
    i, j, k = best
    return CanonicalAxes((i, j, k), (bool(cosines[0, i] < 0), bool(cosines[1, j] < 0), bool(cosines[2, k] < 0)))


def canonical_geometry(grid: Grid) -> Geometry:
    """Shape and place of a grid in canonical order; what is canonical already stays as it is."""
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
    """SHA-256 of a volume's voxels in canonical order: the same for one CT in any file format.

    The bytes are little-endian int16, ``[S, P, L]``, L fastest. Neither shape nor place goes in: they are compared
    beside it (:func:`same_geometry`). Takes a slab of some MB beside the volume, never a second copy. Found when first
    asked for, and kept with the volume.

    Parameters
    ----------
    volume
        Not modified.
    cancel
        Asked after every slab; when it returns true the work stops.

    Returns
    -------
    str
        64 hexadecimal digits. They tell nothing about the patient.

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
    # A slab and not a slice at a time: where slices lie across the file's, a cache line holds voxels of many of them.
    num = max(1, _SLAB_BYTES // max(1, values[0].nbytes))
    for first in range(0, len(values), num):
        watch.step("Identifying the CT")
        found.update(np.ascontiguousarray(values[first : first + num], dtype="<i2").data.cast("B"))
    digest = found.hexdigest()
    object.__setattr__(volume, "_digest", digest)
    return digest


def same_geometry(a: Grid, b: Grid) -> bool:
    """Whether two grids have their voxels at the same places, in whatever order and direction of their axes.

    In canonical order both have the same shape, and none of the corners of the box differs by more than
    :data:`GEOMETRY_TOLERANCE_MM`.
    """
    return _apart_mm(a, b) <= GEOMETRY_TOLERANCE_MM


def refuse_other_ct(volume: Volume, digest: str, geometry: Grid) -> None:
    """Refuse a volume that is not the CT with this digest and geometry.

    Parameters
    ----------
    volume
        What was opened.
    digest, geometry
        Of the CT that a case was made from.

    Raises
    ------
    VolumeImportError
        ``import.other-ct`` or, with the same voxels at another place, ``import.other-geometry``.
    """
    ours, theirs = canonical_geometry(volume), canonical_geometry(geometry)
    advice = "open the CT that the case was made from"
    if ours.shape_zyx != theirs.shape_zyx:
        msg = f"this is a different CT: expected {_sizes(theirs)} voxels, found {_sizes(ours)}; {advice}"
        raise VolumeImportError(msg, code="import.other-ct")
    if ct_digest(volume) != digest:
        msg = f"this is a different CT: its voxel values differ from those of the case; {advice}"
        raise VolumeImportError(msg, code="import.other-ct")
    apart_mm = _apart_mm(ours, theirs)
    if apart_mm > GEOMETRY_TOLERANCE_MM:
        msg = (
            f"this CT has the same voxels as the case, but its position differs by up to {apart_mm:.3g} mm; "
            f"expected at most {GEOMETRY_TOLERANCE_MM:g} mm; {advice}"
        )
        raise VolumeImportError(msg, code="import.other-geometry")


def _sizes(geometry: Geometry) -> str:
    nz, ny, nx = geometry.shape_zyx
    return f"{nx} x {ny} x {nz}"


def _apart_mm(a: Grid, b: Grid) -> float:
    """The largest distance of two boxes' corners; infinite where the shapes differ."""
    one, other = canonical_geometry(a), canonical_geometry(b)
    if one.shape_zyx != other.shape_zyx:
        return float("inf")
    # Outer corners, half a voxel beyond the centres: with these a single slice has a thickness, too.
    ends = [(-0.5, n - 0.5) for n in reversed(one.shape_zyx)]
    corners = np.array([[*corner, 1.0] for corner in product(*ends)])
    return float(np.linalg.norm(corners @ (one.lps_from_ijk - other.lps_from_ijk).T, axis=1).max())
