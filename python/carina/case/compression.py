"""Compressed bytes and JSON of a case file, with checks of size and digest."""

from __future__ import annotations

import hashlib
import zlib
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.case.bounds import MAX_NAME_CHARS, with_shortened_texts
from carina.case.error_texts import damage_error
from carina.errors import UsageError

MAX_PIECE_BYTES: Final = 64 << 20
"""Maximum size of one compressed blob in bytes after decompression, far below the limits of SQLite."""
MAX_JSON_BYTES: Final = 16 << 20
MAX_DEFLATED = 1040
"""Maximum compression ratio that Deflate reaches; a blob with a larger declared ratio is damaged."""
DTYPES: Final = {"f8": "<f8", "f4": "<f4", "i8": "<i8", "i4": "<i4", "u4": "<u4"}


def content_digest(*parts: object) -> bytes:
    """Return a digest, 16 bytes long, of a sequence of texts, numbers, bytes and None."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        content = part if isinstance(part, bytes | memoryview) else repr(part).encode()
        # Each length is part of the digest, so that different divisions of the same bytes give different digests.
        digest.update(b"%d:" % len(content))
        digest.update(content)
    return digest.digest()


def deflate(content: bytes | memoryview) -> bytes:
    """Compress bytes with Deflate; :func:`inflate` needs their original length."""
    return zlib.compress(content, 6 if len(content) < 1 << 16 else 1)


def inflate(data: object, size: object, where: str) -> bytes:
    """Decompress deflated bytes; the memory used is limited by their declared size, which is bounded.

    Parameters
    ----------
    data
        The compressed bytes from the file.
    size
        Declared number of bytes after decompression.
    where
        Name of the data for messages.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    if not isinstance(data, bytes) or not isinstance(size, int):
        raise damage_error(where, "compressed bytes and their size", f"{type(data).__name__} and {type(size).__name__}")
    most = min(MAX_PIECE_BYTES, MAX_DEFLATED * len(data))
    if not 0 <= size <= most:
        raise damage_error(where, f"a decompressed size of 0 to {most} bytes", f"{size}")
    inflater = zlib.decompressobj()
    try:
        content = inflater.decompress(data, size + 1)
    except zlib.error as error:
        raise damage_error(where, "valid compressed bytes", f"invalid ones ({error})") from None
    if len(content) != size or not inflater.eof or inflater.unused_data:
        raise damage_error(where, f"{size} bytes", "a different size")
    return content


def pack_ints(values: list[int] | NDArray[np.int32]) -> bytes:
    """Return integers from 0 to 2**31 as compressed 32-bit differences, little-endian.

    Row numbers in a table are often consecutive, so their differences compress well.
    """
    found = np.asarray(values, dtype="<i4")
    return deflate(np.diff(found, prepend=np.int32(0)).astype("<i4").tobytes())


def unpack_ints(data: object, count: int, where: str) -> NDArray[np.int32]:
    """Return the integers, ``(count,)``, of a blob that :func:`pack_ints` has made.

    Parameters
    ----------
    data
        The compressed bytes from the file.
    count
        Expected number of integers.
    where
        Name of the data for messages.
    """
    content = np.frombuffer(inflate(data, 4 * count, where), dtype="<i4")
    return np.cumsum(content, dtype=np.int64).astype(np.int32)


def as_json(value: object) -> bytes:
    """Return a value as JSON that preserves its numbers exactly; JSON has no infinite numbers and no NaN."""
    return _ENCODER.encode(value)


def as_checked_json(value: object, decoder: msgspec.json.Decoder[Any], what: str) -> str:
    """Return a value as JSON text, after checking that the decoder of the field can read it.

    Parameters
    ----------
    value
        The value to store.
    decoder
        Decoder of the field.
    what
        Name of the value for messages.

    Raises
    ------
    UsageError
        ``case.value``: if the value is out of the bounds of its fields.
    """
    try:
        json_text = as_json(value)
        try:
            decoder.decode(json_text)
        except msgspec.ValidationError:
            # A message that is too long or a control character in a name must not prevent saving.
            json_text = as_json(with_shortened_texts(msgspec.json.decode(json_text), MAX_NAME_CHARS))
            decoder.decode(json_text)
        if len(json_text) > MAX_JSON_BYTES:
            raise ValueError(f"expected at most {MAX_JSON_BYTES} bytes, found {len(json_text)}")
        return json_text.decode()
    except (msgspec.MsgspecError, ValueError, TypeError, RecursionError, OverflowError) as error:
        raise UsageError(f"{what} cannot be saved: {error}", code="case.value") from error


def from_json(content: object, decoder: msgspec.json.Decoder[Any], where: str) -> Any:
    """Decode JSON into a value of the decoder's type.

    Parameters
    ----------
    content
        The JSON from the file.
    decoder
        Decoder of the expected type.
    where
        Name of the value for messages.

    Raises
    ------
    CaseFileError
        ``case.damaged``: if the content is not JSON of this type.
    """
    if not isinstance(content, bytes | str) or len(content) > MAX_JSON_BYTES:
        raise damage_error(where, f"JSON of at most {MAX_JSON_BYTES} bytes", type(content).__name__)
    try:
        return decoder.decode(content)
    except (msgspec.DecodeError, ValueError, RecursionError, OverflowError) as error:
        found = f"other content ({str(error)[:200]})"
        raise damage_error(where, "values as described in docs/case-file.md", found) from None


def _plain_value(value: Any) -> Any:
    """Convert NumPy numbers and arrays to plain Python values for the JSON encoder."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"a case file cannot contain {type(value).__name__}")


_ENCODER = msgspec.json.Encoder(enc_hook=_plain_value)
