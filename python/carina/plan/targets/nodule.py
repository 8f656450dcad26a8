"""Value class of a nodule: position, size, errors and voxel mask."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.argument_checks import (
    COORDINATE_MM,
    array_of,
    check_arguments,
    check_fields,
    choice,
    each,
    instance,
    lps_point,
    lps_points,
    mask_array,
    number_from,
    text_of,
)
from carina.display import one_line
from carina.errors import UsageError
from carina.plan.cubic_box import surface
from carina.volume.mask_distances import ball_distance

Mask = NDArray[np.bool_]
NoduleKind = Literal["solid", "part-solid", "ground-glass"]

RECORD_VERSION = 1
MAX_VOXELS = 400**3
"""Maximum number of voxels of a stored mask: a box with sides of 20 cm and voxels of 0.5 mm."""
_NUMBERS = (
    "volume_mm3",
    "volume_error_mm3",
    "long_mm",
    "short_mm",
    "diameter_error_mm",
    "solid_mm3",
    "density_hu",
)


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Nodule:
    """Nodule with its position, size and errors.

    Examples
    --------
    >>> import numpy as np
    >>> ball = np.linalg.norm(np.indices((13, 13, 13)) - 6, axis=0) < 5.0
    >>> nodule = Nodule((6.0, 6.0, 6.0), "solid", 515.0, 12.0, 9.8, 9.6, 0.4, 515.0, 30.0, (), ball, np.eye(4))
    >>> nodule.words
    'solid nodule, 9.8 x 9.6 mm, 0.52 ml'
    """

    centre_lps: tuple[float, float, float]
    """Centroid of the nodule, LPS mm."""
    kind: NoduleKind
    volume_mm3: float
    volume_error_mm3: float
    """Half width in mm3 of the interval that contains the true volume with 90 % probability."""
    long_mm: float
    """Longest diameter in the axial plane with the largest cross-section, mm."""
    short_mm: float
    """Longest diameter perpendicular to ``long_mm`` in the same plane, mm."""
    diameter_error_mm: float
    """Half width in mm of the 90 % interval of both diameters."""
    solid_mm3: float
    """Volume of the solid part in mm3; below the whole volume in a nodule with ground glass or a cavity."""
    density_hu: float
    """Mean density of the middle of the nodule, HU."""
    touches: tuple[str, ...]
    """Names of the structures from which the nodule was cut.

    ``pleura`` is chest wall, mediastinum or diaphragm, which the CT does not distinguish; ``vessel`` a vessel;
    ``edge of the CT`` means that the scan ends in the nodule.
    """
    inside_zyx: Mask
    """(nz, ny, nx) mask of the nodule in the box around it."""
    lps_from_ijk: NDArray[np.float64]
    """(4, 4) transform from voxel indices of the mask to LPS mm; cubic voxels."""
    notes: tuple[str, ...] = ()
    """Notes on the boundary for the user, for example that it was edited by hand or that parts were left out."""

    def __post_init__(self) -> None:
        """Raise an error if a field of this `Nodule` has an invalid value."""
        size = number_from(0.0, COORDINATE_MM, unit="mm")
        volume = number_from(0.0, 1e9, unit="mm3")
        check_fields(
            self,
            centre_lps=lps_point(),
            kind=choice(*get_args(NoduleKind)),
            volume_mm3=volume,
            volume_error_mm3=volume,
            long_mm=size,
            short_mm=size,
            diameter_error_mm=size,
            solid_mm3=volume,
            density_hu=number_from(-40_000.0, 40_000.0, unit="HU"),
            touches=each(text_of()),
            inside_zyx=mask_array(),
            lps_from_ijk=array_of(4, 4),
            notes=each(text_of(20_000)),
        )

    @property
    def equivalent_mm(self) -> float:
        """Diameter in mm of the ball with the nodule's volume."""
        return float((6.0 * self.volume_mm3 / np.pi) ** (1.0 / 3.0))

    @property
    def mean_mm(self) -> float:
        """Mean in mm of the two axial diameters, as in guidelines (Fleischner 2017)."""
        return 0.5 * (self.long_mm + self.short_mm)

    @property
    def middle_lps(self) -> tuple[float, float, float]:
        """Centroid of the nodule, LPS mm, or the nearest deep point of its mask if the centroid is in a hollow."""
        if self.contains([self.centre_lps])[0]:
            return self.centre_lps
        depth = ball_distance(self.inside_zyx, 1.0)
        deep = np.argwhere(depth >= 0.7 * depth.max())[:, ::-1] @ self.lps_from_ijk[:3, :3].T + self.lps_from_ijk[:3, 3]
        x, y, z = deep[int(np.argmin(np.linalg.norm(deep - np.array(self.centre_lps), axis=1)))]
        return float(x), float(y), float(z)

    @property
    def words(self) -> str:
        """Kind and size of the nodule as text: ``solid nodule, 12.3 x 10.1 mm, 0.74 ml``."""
        ml = self.volume_mm3 / 1000.0
        return f"{self.kind} nodule, {self.long_mm:.1f} x {self.short_mm:.1f} mm, {ml:.{2 if ml >= 0.1 else 3}f} ml"

    def to_json(self) -> dict[str, Any]:
        """Return the nodule as plain JSON types, without the mask."""
        return {
            "centre_lps": list(self.centre_lps),
            "kind": self.kind,
            "volume_mm3": self.volume_mm3,
            "volume_error_mm3": self.volume_error_mm3,
            "long_mm": self.long_mm,
            "short_mm": self.short_mm,
            "diameter_error_mm": self.diameter_error_mm,
            "solid_mm3": self.solid_mm3,
            "density_hu": self.density_hu,
            "touches": list(self.touches),
            "notes": list(self.notes),
        }

    def to_record(self) -> dict[str, Any]:
        """Return the whole nodule as plain JSON types for a file; `from_record` restores it bit for bit.

        The voxels of the mask are compressed bits: some kB for a nodule, 20 kB for a mass of 5 cm.
        """
        packed = zlib.compress(np.packbits(self.inside_zyx).tobytes(), 6)
        return {
            "version": RECORD_VERSION,
            **self.to_json(),
            "shape_zyx": list(self.inside_zyx.shape),
            "lps_from_ijk": self.lps_from_ijk.tolist(),
            "inside": base64.b64encode(packed).decode("ascii"),
        }

    @classmethod
    @check_arguments(record=instance(Mapping, "take one from Nodule.to_record"))
    def from_record(cls, record: Mapping[str, Any]) -> Nodule:
        """Return the nodule that `to_record` wrote.

        Raises
        ------
        UsageError
            If the record is not valid, or of a newer version (code ``plan.record``).
        """
        try:
            if record["version"] != RECORD_VERSION:
                raise ValueError(f"version {record['version']}, expected {RECORD_VERSION}")
            mask = _unpacked(record["inside"], record["shape_zyx"])
            matrix = np.array(record["lps_from_ijk"], dtype=np.float64).reshape(4, 4)
            x, y, z = (float(value) for value in record["centre_lps"])
            made = cls(
                centre_lps=(x, y, z),
                kind=record["kind"],
                touches=tuple(str(word) for word in record["touches"]),
                inside_zyx=mask,
                lps_from_ijk=matrix,
                notes=tuple(str(word) for word in record["notes"]),
                **{name: float(record[name]) for name in _NUMBERS},
            )
        except (KeyError, TypeError, ValueError, zlib.error) as error:
            raise UsageError(f"reading a nodule: its record is not valid ({error})", code="plan.record") from None
        numbers = [*made.centre_lps, *matrix.reshape(-1), *(getattr(made, name) for name in _NUMBERS)]
        if made.kind not in get_args(NoduleKind) or not np.isfinite(numbers).all() or not _is_cubic(matrix):
            raise UsageError("reading a nodule: its record holds impossible values", code="plan.record")
        return made

    @check_arguments(points_lps=lps_points(or_none=True))
    def distance_mm(self, points_lps: ArrayLike) -> NDArray[np.float64]:
        """Return the distances of points from the nodule's boundary; 0 inside.

        Parameters
        ----------
        points_lps
            (n, 3) LPS mm.

        Returns
        -------
        numpy.ndarray
            (n,) mm, exact to half a voxel of the mask.
        """
        points = np.atleast_2d(np.asarray(points_lps, dtype=np.float64))
        inside = np.argwhere(surface(self.inside_zyx))[:, ::-1] @ self.lps_from_ijk[:3, :3].T + self.lps_from_ijk[:3, 3]
        off = np.array([float(np.min(((inside - point) ** 2).sum(axis=1))) ** 0.5 for point in points])
        half_mm = 0.5 * float(np.linalg.norm(self.lps_from_ijk[:3, 0]))
        return np.where(self.contains(points), 0.0, np.maximum(off - half_mm, 0.0))

    @check_arguments(points_lps=lps_points(or_none=True))
    def contains(self, points_lps: ArrayLike) -> Mask:
        """Return for each of (n, 3) points, LPS mm, whether the nearest voxel of the mask is in the nodule, (n,)."""
        points = np.atleast_2d(np.asarray(points_lps, dtype=np.float64))
        ijk = np.rint((points - self.lps_from_ijk[:3, 3]) @ np.linalg.inv(self.lps_from_ijk[:3, :3]).T).astype(int)
        there = ((ijk >= 0) & (ijk < np.array(self.inside_zyx.shape[::-1]))).all(axis=1)
        found = np.zeros(len(points), dtype=bool)
        found[there] = self.inside_zyx[tuple(ijk[there].T[::-1])]
        return found


def _unpacked(text: str, shape: Any) -> Mask:
    """Return the mask that the compressed bits of a record contain.

    Raises
    ------
    ValueError
        If their number does not fit the shape, or no voxel is inside.
    """
    nz, ny, nx = (int(n) for n in shape)
    num = nz * ny * nx
    if min(nz, ny, nx) < 1 or num > MAX_VOXELS:
        raise ValueError(f"a box of {nx} x {ny} x {nz} voxels")
    expected = (num + 7) // 8
    # A wrong size in a record must not exhaust the memory, so the decompression stops at the size of the shape.
    unpacker = zlib.decompressobj()
    data = unpacker.decompress(base64.b64decode(text, validate=True), expected + 1)
    if len(data) != expected:
        raise ValueError(f"{len(data)} bytes of voxels, expected {expected}")
    mask = np.unpackbits(np.frombuffer(data, dtype=np.uint8), count=num).reshape(nz, ny, nx).astype(bool)
    if not mask.any():
        raise ValueError("no voxel inside")
    return mask


def _is_cubic(matrix: NDArray[np.float64]) -> bool:
    lengths = np.linalg.norm(matrix[:3, :3], axis=0)
    is_affine = bool((matrix[3] == [0.0, 0.0, 0.0, 1.0]).all())
    return is_affine and bool(lengths.min() >= 0.05 and lengths.max() <= 20.0 and np.ptp(lengths) <= 1e-6)
