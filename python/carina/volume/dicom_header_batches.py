"""Fast reading of the headers of many files, of which most differ only in identifier, position and time.

The compiled module reads the stored elements of a batch of files on all cores. The first file of a kind is parsed by
pydicom (``dicom_headers``), which stays the reference; the header of every other file with the same stored elements is
the header of the first file with its own identifier, position and time. Every other file is left to the reference.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from pydicom.tag import Tag

from carina import _core
from carina.volume.dicom_headers import (
    HEADER_TAGS,
    SETTINGS,
    SliceHeader,
    comparable_bytes,
    read_image_headers,
)

MAX_FAST_INFLATED_BYTES = 1 << 25
"""Largest decompressed size of a deflated file for the compiled module, bytes, because each core inflates one file.

The reference inflates larger ones, one after the other.
"""
_BATCH = 64  # files between two reports of the progress
_SINGLE = tuple(sorted(int(Tag(keyword)) for keyword in ("SOPInstanceUID", "AcquisitionTime", "ImagePositionPatient")))
_REFUSED = [
    int(Tag(keyword))
    for keyword in ("ModalityLUTSequence", "PerFrameFunctionalGroupsSequence", "SharedFunctionalGroupsSequence")
]
_SHARED = sorted({int(Tag(keyword)) for keyword in HEADER_TAGS} - {*_SINGLE, *_REFUSED})
_TIME = list(SETTINGS).index("AcquisitionTime")
_UID = re.compile(rb"[0-9.]{1,64}\0?")
_NUMBER = rb" *[-+]?[0-9]{1,12}(?:\.[0-9]{0,16})?(?:[eE][-+]?[0-9]{1,2})? *"
_POSITION = re.compile(_NUMBER + rb"(?:\\" + _NUMBER + rb"){2}")


def headers_in_batches(paths: Sequence[Path]) -> Iterator[tuple[Path, SliceHeader | None]]:
    """Yield each path with the header of its one image, or None if the reference must read the file.

    The header is that of :func:`~carina.volume.dicom_headers.read_image_headers`.
    """
    known: dict[bytes, SliceHeader | None] = {}
    for begin in range(0, len(paths), _BATCH):
        batch = paths[begin : begin + _BATCH]
        scanned = _core.scan_dicom_headers(
            batch, shared=_SHARED, single=_SINGLE, refused=_REFUSED, max_inflated=MAX_FAST_INFLATED_BYTES
        )
        for path, elements in zip(batch, scanned, strict=True):
            if elements is None:
                yield path, None
                continue
            key, single, pixels_at = elements
            if key not in known:
                known[key] = _first_of_its_kind(path, single, pixels_at)
            first = known[key]
            yield path, None if first is None else _with_own_values(first, path, single, pixels_at)


def _first_of_its_kind(path: Path, single: Sequence[bytes | None], pixels_at: int | None) -> SliceHeader | None:
    """Return the header of a file by the reference; None if other headers cannot be made from this one."""
    try:
        headers, _ = read_image_headers(path)
    except (ValueError, OSError):
        return None
    if len(headers) != 1 or headers[0].problem is not None or headers[0].frame is not None:
        return None
    # If the reference reads a value of this file in another way, no other file is read from the stored values.
    return headers[0] if _with_own_values(headers[0], path, single, pixels_at) == headers[0] else None


def _with_own_values(
    first: SliceHeader, path: Path, single: Sequence[bytes | None], pixels_at: int | None
) -> SliceHeader | None:
    """Return a header with the path, identifier, time and position of a file; None for unusual values."""
    uid, time, position = single
    if uid is None or position is None or not _UID.fullmatch(uid) or not _POSITION.fullmatch(position):
        return None
    if time is not None and (not time.isascii() or b"\x1b" in time):
        return None
    settings = (*first.settings[:_TIME], comparable_bytes(time or b""), *first.settings[_TIME + 1 :])
    x, y, z = map(float, position.split(b"\\"))
    return replace(
        first,
        path=path,
        sop_uid=uid.rstrip(b"\0").decode(),
        settings=settings,
        position_lps=(x, y, z),
        pixels_at=pixels_at,
    )
