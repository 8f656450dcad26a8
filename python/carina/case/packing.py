"""Bytes as a case file stores them: deflated, with their original size and digest."""

from __future__ import annotations

import hashlib
import zlib
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.case.bounds import MAX_NAME_CHARS, cleaned
from carina.case.trouble import damaged
from carina.errors import UsageError

__all__ = [
    "DTYPES",
    "MAX_JSON_BYTES",
    "MAX_PIECE_BYTES",
    "MOST_DEFLATED",
    "as_checked_json",
    "as_json",
    "deflated",
    "digest_of",
    "from_json",
    "inflated",
    "packed_ints",
]

MAX_PIECE_BYTES: Final = 64 << 20
"""Of one piece, inflated; far below what SQLite takes, and what an array of a case never comes near."""
MAX_JSON_BYTES: Final = 16 << 20
MOST_DEFLATED = 1040
"""Deflate makes nothing smaller than by this factor: a piece that claims more is a lie."""
DTYPES: Final = {"f8": "<f8", "f4": "<f4", "i8": "<i8", "i4": "<i4", "u4": "<u4"}


def digest_of(*parts: object) -> bytes:
    """16 bytes that tell one content from another: of texts, numbers, None and bytes."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        content = part if isinstance(part, bytes | memoryview) else repr(part).encode()
        # Lengths too, so that two parts never look like two others.
        digest.update(b"%d:" % len(content))
        digest.update(content)
    return digest.digest()


def deflated(content: bytes | memoryview) -> bytes:
    """Smaller; :func:`inflated` needs the length of what was given."""
    return zlib.compress(content, 6 if len(content) < 1 << 16 else 1)


def inflated(data: object, size: object, where: str) -> bytes:
    """Decompress deflated bytes; use at most as much memory as their declared size, which is bounded.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    if not isinstance(data, bytes) or not isinstance(size, int):
        raise damaged(where, "compressed bytes and their size", f"{type(data).__name__} and {type(size).__name__}")
    most = min(MAX_PIECE_BYTES, MOST_DEFLATED * len(data))
    if not 0 <= size <= most:
        raise damaged(where, f"a decompressed size of 0 to {most} bytes", f"{size}")
    inflater = zlib.decompressobj()
    try:
        content = inflater.decompress(data, size + 1)
    except zlib.error as trouble:
        raise damaged(where, "valid compressed bytes", f"invalid ones ({trouble})") from None
    if len(content) != size or not inflater.eof or inflater.unused_data:
        raise damaged(where, f"{size} bytes", "a different size")
    return content


def packed_ints(values: list[int] | NDArray[np.int32]) -> bytes:
    """Numbers of 0 to 2**31 as deflated 32-bit differences, little-endian: lists of places in a table grow by ones."""
    found = np.asarray(values, dtype="<i4")
    return deflated(np.diff(found, prepend=np.int32(0)).astype("<i4").tobytes())


def unpacked_ints(data: object, count: int, where: str) -> NDArray[np.int32]:
    """Return the numbers that :func:`packed_ints` packed."""
    content = np.frombuffer(inflated(data, 4 * count, where), dtype="<i4")
    return np.cumsum(content, dtype=np.int64).astype(np.int32)


def as_json(value: object) -> bytes:
    """Return a value as JSON with every bit of its numbers; JSON has no numbers that are not finite."""
    return _ENCODER.encode(value)


def as_checked_json(value: object, decoder: msgspec.json.Decoder[Any], what: str) -> str:
    """Return a value as JSON text, after a check that the decoder of the field can read it back.

    Raises
    ------
    UsageError
        ``case.value``: if the value is out of the bounds of its fields.
    """
    try:
        said = as_json(value)
        try:
            decoder.decode(said)
        except msgspec.ValidationError:
            # A long message or a control character in a name must not prevent the save.
            said = as_json(cleaned(msgspec.json.decode(said), MAX_NAME_CHARS))
            decoder.decode(said)
        if len(said) > MAX_JSON_BYTES:
            raise ValueError(f"expected at most {MAX_JSON_BYTES} bytes, found {len(said)}")
        return said.decode()
    except (msgspec.MsgspecError, ValueError, TypeError, RecursionError, OverflowError) as trouble:
        raise UsageError(f"{what} cannot be saved: {trouble}", code="case.value") from trouble


def from_json(content: object, decoder: msgspec.json.Decoder[Any], where: str) -> Any:
    """Decode JSON into a value of the decoder's type.

    Raises
    ------
    CaseFileError
        ``case.damaged``: if it is none.
    """
    if not isinstance(content, bytes | str) or len(content) > MAX_JSON_BYTES:
        raise damaged(where, f"JSON of at most {MAX_JSON_BYTES} bytes", type(content).__name__)
    try:
        return decoder.decode(content)
    except (msgspec.DecodeError, ValueError, RecursionError, OverflowError) as trouble:
        found = f"other content ({str(trouble)[:200]})"
        raise damaged(where, "values as described in docs/case-file.md", found) from None


def _plain(value: Any) -> Any:
    """Numbers of numpy, which some values hold."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"a case file cannot contain {type(value).__name__}")


_ENCODER = msgspec.json.Encoder(enc_hook=_plain)
