"""Description of the CT of a case in the case file, without patient data."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass, field
from pathlib import PurePosixPath, PureWindowsPath
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from carina.case import json_records as f
from carina.case.bounds import bounded_text, bounded_whole, check_plain
from carina.case.compression import as_checked_json, from_json
from carina.case.error_texts import damage_error
from carina.display import one_line
from carina.errors import UsageError
from carina.volume import Geometry, Volume
from carina.volume.inserted_structures import MAX_INSERTED

V = TypeVar("V", np.uint8, np.int16)
GEOMETRY_MM: Final = 1e-3
"""Maximum distance in mm between corresponding voxels of two grids that count as the same grid."""
MAX_PATH_CHARS: Final = 4096
INSERTED_KIND: Final = "inserted"
"""Value of the column ``kind`` in the table ``extra`` for descriptions of nodules that were inserted into the CT."""
_MAX_TEXT = 200


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class SourceFacts(Geometry):
    """The CT of a case: its grid, digest and path, without patient data."""

    digest: str
    """Digest of the voxels (:func:`carina.volume.ct_digest`), hexadecimal."""
    is_hu: bool = True
    path: str | None = None
    """Path of the scan relative to the case file; None if unknown."""
    choices: dict[str, Any] = field(default_factory=dict)
    """The user's choices at the import of the CT, as plain JSON."""
    inserted: tuple[str, ...] = ()
    """Descriptions of nodules that were inserted into the CT; `read_source` leaves them out (`inserted_structures`)."""

    def __post_init__(self) -> None:
        """Raise an error if the path of the scan is absolute."""
        absolute = self.path is not None and (
            PurePosixPath(self.path).is_absolute() or PureWindowsPath(self.path).anchor != ""
        )
        if absolute:
            raise UsageError("expected a path to the scan that is relative to the case file; found an absolute path")

    @classmethod
    def of(
        cls, volume: Volume, digest: str, *, path: str | None = None, choices: dict[str, Any] | None = None
    ) -> SourceFacts:
        """Return the description of a volume with a known digest."""
        return cls(
            volume.shape_zyx,
            volume.lps_from_ijk,
            digest,
            volume.is_hu,
            path,
            dict(choices or {}),
            volume.source.inserted,
        )


def write_source(connection: sqlite3.Connection, source: SourceFacts) -> None:
    """Write the description of the CT into a case file, in a transaction that the caller opened."""
    nz, ny, nx = source.shape_zyx
    matrix = np.ascontiguousarray(source.lps_from_ijk, dtype="<f8")
    if matrix.shape != (4, 4):
        raise UsageError(f"lps_from_ijk must be a 4x4 matrix; found shape {matrix.shape}")
    connection.execute(
        "INSERT OR REPLACE INTO source (id, digest, nz, ny, nx, lps_from_ijk, is_hu, path, choices) "
        "VALUES (1, ?, ?, ?, ?, ?, ?, ?, ?)",
        (
            source.digest,
            nz,
            ny,
            nx,
            matrix.tobytes(),
            int(source.is_hu),
            source.path,
            as_checked_json(source.choices, f.decoders().choices, "the import choices"),
        ),
    )
    write_inserted(connection, source.inserted)


def write_inserted(connection: sqlite3.Connection, structures: tuple[str, ...]) -> None:
    """Store the descriptions of inserted structures, in a transaction that the caller opened; none change nothing."""
    if structures:
        connection.execute("DELETE FROM extra WHERE kind = ?", (INSERTED_KIND,))
    for n, text in enumerate(structures[:MAX_INSERTED]):
        mark = (INSERTED_KIND, n, as_checked_json(text, f.decoders().extra, INSERTED_KIND))
        connection.execute("INSERT INTO extra (kind, n, json) VALUES (?, ?, ?)", mark)


def inserted_structures(connection: sqlite3.Connection) -> tuple[str, ...]:
    """Return the descriptions of the structures that were inserted into the CT of a case; empty without them.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    rows = connection.execute(
        "SELECT json FROM extra WHERE kind = ? ORDER BY n LIMIT ?", (INSERTED_KIND, MAX_INSERTED + 1)
    ).fetchall()
    where = "the list of inserted structures"
    found = tuple(from_json(text, f.decoders().extra, where) for (text,) in rows)
    if len(found) > MAX_INSERTED or not all(isinstance(one, str) and len(one) <= _MAX_TEXT for one in found):
        raise damage_error(where, f"up to {MAX_INSERTED} short texts", "other values")
    return found


def read_source(connection: sqlite3.Connection) -> SourceFacts:
    """Read the description of the CT from a case file, and raise ``case.damaged`` if it is out of bounds."""
    where = "record of the scan"
    row = connection.execute("SELECT digest, nz, ny, nx, lps_from_ijk, is_hu, path, choices FROM source").fetchone()
    if row is None:
        raise damage_error(where, "one entry", "none")
    digest, nz, ny, nx, matrix, is_hu, path, choices = row
    if not all(isinstance(n, int) and 1 <= n <= 65_535 for n in (nz, ny, nx)):
        raise damage_error(where, "a shape of 1 to 65535 voxels along each axis", f"{(nz, ny, nx)}"[:80])
    if not isinstance(matrix, bytes) or len(matrix) != 128:
        found = f"{len(matrix)} bytes" if isinstance(matrix, bytes) else type(matrix).__name__
        raise damage_error(where, "a matrix of 128 bytes", found)
    places = np.frombuffer(matrix, dtype="<f8").reshape(4, 4)
    if not np.isfinite(places).all() or np.abs(places).max() > 1e6 or abs(np.linalg.det(places[:3, :3])) < 1e-12:
        raise damage_error(where, "an invertible transform", "a matrix that is not invertible")
    if not isinstance(digest, str) or len(digest) > 128 or not (path is None or _is_relative_path(path)):
        raise damage_error(where, "a digest and a relative path", "other values")
    bounded_text(digest, where, 128)
    bounded_whole(is_hu, where, 0, 1)
    facts = from_json(choices, f.decoders().choices, where)
    check_plain(facts, where)
    try:
        return SourceFacts((nz, ny, nx), places, digest, bool(is_hu), path, facts)
    except UsageError:
        raise damage_error(where, "a relative path", "an absolute path") from None


def _is_relative_path(path: object) -> bool:
    # NUL is the only character that no file name contains. The terminal shows names without control characters.
    return isinstance(path, str) and 0 < len(path) <= MAX_PATH_CHARS and "\x00" not in path


@dataclass(frozen=True, slots=True)
class AxisPermutation:
    """Order and direction of the axes of a case relative to those of a volume."""

    axes: tuple[int, int, int]
    """Index of the case's axis (0, 1 or 2) that runs along each axis i, j, k of the volume."""
    flipped: tuple[bool, bool, bool]
    """Whether each axis of the volume runs in the direction opposite to that of the case."""
    shape_zyx: tuple[int, int, int]
    """Numbers of voxels of the case's grid along k, j, i."""

    @property
    def is_identity(self) -> bool:
        """Whether the axes of the case and of the volume have the same order and direction."""
        return self.axes == (0, 1, 2) and not any(self.flipped)

    def array_in_volume_axes(self, array_zyx: NDArray[V]) -> NDArray[V]:
        """Return an array of the case in the axes of the volume; the array itself if both have the same axes."""
        if self.is_identity:
            return array_zyx
        # The axes of arrays are in the order k, j, i.
        order = tuple(2 - axis for axis in self.axes[::-1])
        steps = tuple(slice(None, None, -1 if flip else 1) for flip in self.flipped[::-1])
        array_in_volume_axes = np.ascontiguousarray(array_zyx.transpose(order)[steps])
        array_in_volume_axes.flags.writeable = False
        return array_in_volume_axes

    def voxel(self, ijk: tuple[int, int, int]) -> tuple[int, int, int]:
        """Return the index (i, j, k) in the volume of a voxel of the case's grid."""
        shape = self.shape_zyx[::-1]
        i, j, k = (
            shape[axis] - 1 - ijk[axis] if flip else ijk[axis]
            for axis, flip in zip(self.axes, self.flipped, strict=True)
        )
        return i, j, k


def axis_permutation(source: SourceFacts, volume: Volume) -> AxisPermutation | None:
    """Return the order of the axes between the grids of a case and a volume; None if their voxels do not coincide."""
    steps = np.linalg.inv(volume.lps_from_ijk[:3, :3]) @ source.lps_from_ijk[:3, :3]
    largest = np.abs(steps).argmax(axis=1)
    if sorted(largest) != [0, 1, 2]:
        return None
    a, b, c = (int(axis) for axis in largest)
    p, q, r = (bool(steps[row, axis] < 0.0) for row, axis in enumerate((a, b, c)))
    turn = AxisPermutation((a, b, c), (p, q, r), source.shape_zyx)
    i, j, k = (source.shape_zyx[::-1][axis] for axis in turn.axes)
    if (k, j, i) != volume.shape_zyx:
        return None
    nz, ny, nx = source.shape_zyx
    corners = [(x, y, z) for x in (0, nx - 1) for y in (0, ny - 1) for z in (0, nz - 1)]
    there = np.array(corners, dtype=np.float64) @ source.lps_from_ijk[:3, :3].T + source.lps_from_ijk[:3, 3]
    here = volume.to_lps(np.array([turn.voxel(corner) for corner in corners], dtype=np.float64))
    return turn if float(np.linalg.norm(there - here, axis=1).max()) <= GEOMETRY_MM else None


def grid_text(shape_zyx: tuple[int, int, int]) -> str:
    """Return the shape of a grid as text for messages, in the order x, y, z."""
    nz, ny, nx = shape_zyx
    return f"{nx} x {ny} x {nz}"
