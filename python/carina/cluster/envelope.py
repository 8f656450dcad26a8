"""Orders and answers as plain bytes, which the transport passes on as they are.

Ray packs each argument and result of another kind as a pickle of its own, at both ends, for each strip of each picture
(docs/decisions/0109).
"""

from __future__ import annotations

import pickle
import struct

import numpy as np
from numpy.typing import NDArray

from carina.errors import ClusterError
from carina.render import Picture

__all__ = ["Counts", "Strip", "open_answer", "open_order", "pack_answer", "pack_order"]

Counts = tuple[int, int, int, int, int, int, int]
"""Rays, samples, look-ups, leaps, skipped, shaded, loads."""
Strip = tuple[int, int, int, int, float, str, Counts, Picture | None, NDArray[np.uint8]]
"""Frame, content, first row and number of rows again, seconds, method, counts; with the first rows the picture without
pixels; and the pixels."""

# Frame, content, first row, row after the last; both rows -1 for the whole picture. The pickled view follows.
_ORDER = struct.Struct("<qqii")
# Frame, content, first row, number of rows, seconds, counts, shape of the pixels, bytes of method and picture; these
# two follow, then the pixels.
_ANSWER = struct.Struct("<qqiid7q3iii")


def pack_order(frame_id: int, content: int, view: bytes, rows: tuple[int, int] | None) -> bytes:
    """What :meth:`carina.cluster.host.RendererHost.strip` takes."""
    return _ORDER.pack(frame_id, content, *(rows or (-1, -1))) + view


def open_order(order: bytes) -> tuple[int, int, bytes, tuple[int, int] | None]:
    """What was packed."""
    frame_id, content, first_row, end_row = _ORDER.unpack_from(order)
    return frame_id, content, order[_ORDER.size :], None if first_row < 0 else (first_row, end_row)


def pack_answer(strip: Strip) -> bytes:
    """What a host answers; pixels are copied once.

    Raises
    ------
    ClusterError
        ``cluster.fault`` if the pixels are not (rows, width, channels) uint8.
    """
    frame_id, content, first_row, num_rows, seconds, method, counts, picture, rgb = strip
    if rgb.dtype != np.uint8 or rgb.ndim != 3:
        msg = f"expected a strip of shape (rows, width, 3) and type uint8; found {rgb.shape} {rgb.dtype}"
        raise ClusterError(msg, code="cluster.fault")
    name = method.encode()
    bare = b"" if picture is None else pickle.dumps(picture, protocol=5)
    head = _ANSWER.pack(
        frame_id, content, first_row, num_rows, seconds, *counts, *rgb.shape, len(name), len(bare)
    )  # fmt: skip
    return b"".join((head, name, bare, np.ascontiguousarray(rgb).data))


def open_answer(answer: bytes) -> Strip:
    """What was packed; the pixels are a read-only view of ``answer``.

    Only for answers of machines that were joined with a token: they hold a pickle.

    Raises
    ------
    ClusterError
        ``cluster.fault`` if these bytes are no answer.
    """
    try:
        frame_id, content, first_row, num_rows, seconds, *rest = _ANSWER.unpack_from(answer)
        counts, shape, (num_name, num_bare) = tuple(rest[:7]), tuple(rest[7:10]), rest[10:]
        at = _ANSWER.size + num_name
        name = answer[_ANSWER.size : at].decode()
        picture = pickle.loads(answer[at : at + num_bare]) if num_bare else None
        if picture is not None and not isinstance(picture, Picture):
            raise ValueError(f"expected an image, found a {type(picture).__name__}")
        rgb = np.frombuffer(answer, np.uint8, offset=at + num_bare).reshape(shape)
    except Exception as nonsense:
        # Whatever it is: bytes that are no pickle raise nearly everything.
        raise ClusterError(f"invalid strip reply: {nonsense}", code="cluster.fault") from nonsense
    return frame_id, content, first_row, num_rows, seconds, name, counts, picture, rgb
