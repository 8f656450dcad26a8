"""Packing of strip orders (requests for rows of a picture) and answers as bytes for the transport between machines.

Ray would pickle each argument and result of another type separately, at both ends, for each strip
(docs/decisions/0109).
"""

from __future__ import annotations

import pickle
import struct

import numpy as np
from numpy.typing import NDArray

from carina.errors import ClusterError
from carina.render import Picture

Counts = tuple[int, int, int, int, int, int, int]
"""Type of the counts of a rendered strip (rows of a picture): rays, samples, look-ups, leaps, skipped samples,
shaded samples, loads."""
Strip = tuple[int, int, int, int, float, str, Counts, Picture | None, NDArray[np.uint8]]
"""Type of the values in an answer to a strip order, before they are packed.

The fields are frame, content, first row, number of rows, seconds, method, counts, picture and pixels. The picture has
no pixels, and is None unless the strip contains the first row.
"""

# Frame, content, first row, row after the last; both rows are -1 for the whole picture. The pickled view follows.
_ORDER = struct.Struct("<qqii")
# Frame, content, first row, number of rows, seconds, counts, shape of the pixels, number of bytes of the method and of
# the picture. The method, the picture and the pixels follow.
_ANSWER = struct.Struct("<qqiid7q3iii")


def pack_order(frame_id: int, content: int, view: bytes, rows: tuple[int, int] | None) -> bytes:
    """Return a strip order packed as the bytes that :meth:`carina.cluster.renderer_host.RendererHost.answer` reads.

    Parameters
    ----------
    frame_id, content
        Numbers of the frame and of its content.
    view
        The pickled view.
    rows
        First row and row after the last; None for the whole picture.
    """
    return _ORDER.pack(frame_id, content, *(rows or (-1, -1))) + view


def open_order(order: bytes) -> tuple[int, int, bytes, tuple[int, int] | None]:
    """Return the frame number, the content number, the pickled view and the rows of a packed order."""
    frame_id, content, first_row, end_row = _ORDER.unpack_from(order)
    return frame_id, content, order[_ORDER.size :], None if first_row < 0 else (first_row, end_row)


def pack_answer(strip: Strip) -> bytes:
    """Return a rendered strip packed as bytes; the pixels are copied once.

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
    """Return the rendered strip of a packed answer; its pixels are a read-only view of ``answer``.

    An answer contains a pickle, so only answers of machines that joined with a token may be opened.

    Raises
    ------
    ClusterError
        ``cluster.fault`` if the bytes are not an answer.
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
        # Bytes that are not a pickle can raise almost any exception.
        raise ClusterError(f"invalid strip reply: {nonsense}", code="cluster.fault") from nonsense
    return frame_id, content, first_row, num_rows, seconds, name, counts, picture, rgb
