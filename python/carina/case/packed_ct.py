"""The CT in a case file: losslessly compressed, in chunks with checksums."""

from __future__ import annotations

import sqlite3
from typing import Final

import numpy as np
from numpy.typing import NDArray

from carina.case.compression import MAX_DEFLATED, MAX_PIECE_BYTES, content_digest, deflate, inflate
from carina.case.error_texts import damage_error
from carina.case.source import SourceFacts, axis_permutation, inserted_structures, read_source, write_inserted
from carina.errors import UsageError
from carina.volume import Volume, VolumeSource, ct_digest
from carina.volume.inserted_structures import with_inserted

CHUNK_BYTES: Final = 16 << 20
"""Maximum size of the voxels in a chunk in bytes; a chunk has one slice if a slice is larger."""


def write_ct(connection: sqlite3.Connection, volume: Volume) -> None:
    """Store a CT in a case file, in a transaction that the caller opened.

    Parameters
    ----------
    connection
        The case file.
    volume
        The CT; its axes may be in another order than in the case.

    Raises
    ------
    UsageError
        ``case.other-scan``: if the volume is not the CT of the case. ``case.value``: if a slice is too large.
    """
    source = read_source(connection)
    given = SourceFacts.of(volume, source.digest)
    turn = axis_permutation(given, _placeholder_volume(source))
    if turn is None or ct_digest(volume) != source.digest:
        raise UsageError(
            "only the scan that a case was made from can be packed with it; open that scan", code="case.other-scan"
        )
    values = turn.array_in_volume_axes(volume.hu_zyx)
    slice_bytes = 2 * values.shape[1] * values.shape[2]
    if slice_bytes > MAX_PIECE_BYTES:
        raise UsageError(
            f"a slice of this scan has {slice_bytes} bytes; at most {MAX_PIECE_BYTES} can be packed", code="case.value"
        )
    at_once = max(1, CHUNK_BYTES // slice_bytes)
    connection.execute("DELETE FROM ct")
    for n, first in enumerate(range(0, len(values), at_once)):
        slices = np.ascontiguousarray(values[first : first + at_once], dtype="<i2")
        row = (n, first, len(slices), content_digest(slices.tobytes()), deflate(_differences_as_bytes(slices)))
        connection.execute("INSERT INTO ct (n, first_k, num_k, digest, data) VALUES (?, ?, ?, ?, ?)", row)
    write_inserted(connection, volume.source.inserted)


def packed_volume(connection: sqlite3.Connection) -> Volume | None:
    """Return the CT stored in a case file; None if the file contains none.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    source = read_source(connection)
    nz, ny, nx = source.shape_zyx
    pieces = connection.execute("SELECT n, first_k, num_k, length(data) FROM ct ORDER BY n LIMIT 100000").fetchall()
    if not pieces:
        return None
    slice_bytes = 2 * ny * nx
    ahead = 0
    # All declared sizes are checked before memory is allocated.
    for n, first, count, length in pieces:
        size = count * slice_bytes if isinstance(count, int) and count > 0 else -1
        if first != ahead or not 0 < size <= min(MAX_PIECE_BYTES, MAX_DEFLATED * length):
            raise damage_error(
                f"piece {n} of the scan",
                f"slices inside the scan, from slice {ahead} on",
                f"{count} slices from slice {first} on",
            )
        ahead += count
    if ahead != nz:
        raise damage_error("the scan", f"{nz} slices", str(ahead))
    values = np.empty((nz, ny, nx), dtype=np.int16)
    for n, first, count, _ in pieces:
        digest, data = connection.execute("SELECT digest, data FROM ct WHERE n = ?", (n,)).fetchone()
        where = f"piece {n} of the scan"
        slices = _voxels_of_differences(inflate(data, count * slice_bytes, where), (count, ny, nx))
        if content_digest(slices.astype("<i2").tobytes()) != digest:
            raise damage_error(where, "content that matches its digest", "altered content")
        values[first : first + count] = slices
    reason = None if source.is_hu else "the scan was not in Hounsfield units when the case was packed"
    origin = with_inserted(VolumeSource(format="case", title="packed scan"), inserted_structures(connection))
    return Volume(values, source.lps_from_ijk, source.is_hu, reason, origin)


def _differences_as_bytes(slices: NDArray[np.int16]) -> bytes:
    """Return the bytes to compress: differences of voxels along x, all low bytes before all high bytes.

    Neighbouring voxels have similar values, so this order compresses to two thirds of the size.
    """
    steps = np.diff(slices, axis=2, prepend=np.int16(0)).astype("<i2")
    return steps.view(np.uint8).reshape(-1, 2).T.tobytes()


def _voxels_of_differences(content: bytes, shape: tuple[int, int, int]) -> NDArray[np.int16]:
    planes = np.frombuffer(content, dtype=np.uint8).reshape(2, -1)
    steps = np.ascontiguousarray(planes.T).view("<i2").reshape(shape)
    return np.cumsum(steps, axis=2, dtype=np.int16)


def _placeholder_volume(source: SourceFacts) -> Volume:
    # The caller uses only the grid of this volume; unread pages of zeros need no physical memory.
    return Volume(np.zeros(source.shape_zyx, np.int16), source.lps_from_ijk, source.is_hu)
