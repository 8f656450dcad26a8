"""Check and decoding of JPEG 2000 slices by FFmpeg (PyAV, extra ``video``), the second decoder beside GDCM.

JPEG 2000 has no checksum. A changed byte moves the arithmetic decoder of its code-block onto wrong bits, and OpenJPEG,
which GDCM and Pillow share, returns the wrong pixels without a message. FFmpeg's own decoder reports a code-block whose
coded data end elsewhere than its decoding: a wrong bit changes the length that all later symbols take.

Two kinds of damage stay unreported: a packet header that scales a code-block by a power of two changes no length, and
FFmpeg does not report a decoder that runs past the end of a code-block. Statistics of neighbouring slices do not
replace the decoder: most errors of 20 to 100 HU are smaller than noise and vessels.

References
----------
ITU-T T.800 C (arithmetic decoder), D (code-blocks).
"""

from __future__ import annotations

import functools
import importlib.util
import os
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.volume.dicom_headers import SliceHeader
from carina.volume.dicom_pixel_bytes import read_stream_bytes
from carina.volume.dicom_streams import Stream, read_stream
from carina.volume.model import Note

_JPEG_2000 = ("1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91")
_REPORTS_DAMAGE = ("End mismatch", "Synthetic End of Stream")
_MAIN_HEADER, _CODING, _COMPONENT_CODING, _TILE_PART = b"\xff\x4f\xff\x51", b"\xff\x52", b"\xff\x53", b"\xff\x90"
_GREY: dict[str, tuple[np.dtype[Any], int]] = {"gray": (np.dtype("u1"), 8), "gray16le": (np.dtype("<u2"), 16)}
"""Type and bits of FFmpeg's grey pixel formats that are read."""
MAX_WORKERS = 4


@functools.cache
def has_second_decoder() -> bool:
    """Return whether PyAV, the second decoder for JPEG 2000, is installed."""
    return importlib.util.find_spec("av") is not None


def is_checkable(header: SliceHeader) -> bool:
    """Return whether the second JPEG 2000 decoder can read the slice."""
    return header.transfer_syntax in _JPEG_2000 and has_second_decoder()


def not_checked_note(slices: Sequence[SliceHeader]) -> Note | None:
    """Return a note if a series needs the second decoder and it is not installed."""
    if has_second_decoder() or not any(header.transfer_syntax in _JPEG_2000 for header in slices):
        return None
    words = (
        "the JPEG 2000 slices were not checked by a second decoder, so that damage of less than about 100 HU may stay "
        "unseen; carina doctor prints the command that installs the decoder (PyAV)"
    )
    return Note("import.not-checked", words)


_lock = threading.Lock()
_users = 0
_before: tuple[int | None, bool] = (None, True)


@contextmanager
def _ffmpeg_warnings() -> Iterator[None]:
    """Let FFmpeg report every warning to Python within the block.

    By default PyAV omits a message that equals the one before, so that the second of two damaged slices, or a damaged
    slice that is opened again, would pass as intact. The settings apply to the whole process, so the users of the block
    are counted.
    """
    import av.logging

    global _users, _before  # noqa: PLW0603
    with _lock:
        if _users == 0:
            _before = av.logging.get_level(), av.logging.get_skip_repeated()
            av.logging.set_level(av.logging.WARNING)
            av.logging.set_skip_repeated(False)
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if _users == 0:
                level, skips_repeated = _before
                av.logging.set_level(level)
                av.logging.set_skip_repeated(skips_repeated)


def j2k_problem(frame: bytes) -> str | None:
    """Return the error that FFmpeg reports for a JPEG 2000 stream; None if it is intact or not supported by FFmpeg."""
    return _decoded(frame)[1]


def intact_j2k_words(frame: bytes, stream: Stream) -> NDArray[np.uint16] | None:
    """Return the words (rows, columns) of a reversibly compressed JPEG 2000 image in which FFmpeg finds no error.

    None is returned for any other image. Both decoders return the same words for a reversible image: all its steps are
    integer arithmetic (ITU-T T.800 F.3, G). Signed numbers are two's complement of ``stream.bits`` bits.

    Parameters
    ----------
    frame
        The JPEG 2000 stream.
    stream
        Its header, from :func:`~carina.volume.dicom_streams.read_stream`.
    """
    if stream.problem is not None or stream.signed is None or not 1 <= stream.bits <= 16 or not _is_reversible(frame):
        return None
    image, problem = _decoded(frame)
    if image is None or problem is not None or image.format.name not in _GREY:
        return None
    kind, depth = _GREY[image.format.name]
    unused = depth - stream.bits  # FFmpeg moves numbers to the most significant bits and makes them positive
    rows = np.frombuffer(image.planes[0], kind).reshape(image.height, -1)
    if (image.height, image.width) != (stream.rows, stream.columns) or unused < 0:
        return None
    words = rows[:, : image.width].astype(np.uint16) >> np.uint16(unused)
    if stream.signed:
        words = (words - np.uint16(1 << (stream.bits - 1))) & np.uint16((1 << stream.bits) - 1)
    return np.ascontiguousarray(words)


def _is_reversible(frame: bytes) -> bool:
    """Return whether all parts of a JPEG 2000 image are coded by the reversible transform (ITU-T T.800 A.6.1)."""
    at, reversible = frame.find(_MAIN_HEADER, 0, 4096) + 2, False
    if at < 2:
        return False
    while (marker := frame[at : at + 2]) != _TILE_PART:
        if len(marker) < 2 or marker == _COMPONENT_CODING:
            return False
        if marker == _CODING:
            reversible = frame[at + 13 : at + 14] == b"\x01"
        at += 2 + int.from_bytes(frame[at + 2 : at + 4], "big")
    return reversible


def _decoded(frame: bytes) -> tuple[Any, str | None]:
    """Return the image that FFmpeg decodes, or None, and the error that it reports, or None."""
    import av
    import av.logging

    with _ffmpeg_warnings(), av.logging.Capture(local=True) as reports:
        try:
            context = av.CodecContext.create("jpeg2000", "r")
            context.thread_count = 1  # messages are captured only in the thread that decodes
            decoded = context.decode(av.Packet(frame)) or context.decode(None)
        except av.error.InvalidDataError:
            return None, "a second decoder cannot read it"
        except (av.error.FFmpegError, MemoryError, ValueError):
            return None, None  # not supported by FFmpeg, which does not mean that the stream is damaged
    if any(report.startswith(_REPORTS_DAMAGE) for _, _, report in reports):
        return None, "a second decoder found that coded data end too early or too late"
    return (decoded[0], None) if decoded else (None, "a second decoder finds no image in it")


class SecondDecoder:
    """Check of many slices in the background, in the order in which they were submitted."""

    def __init__(self, pool: ThreadPoolExecutor) -> None:
        self._pool = pool
        self._futures: list[tuple[SliceHeader, Future[str | None]]] = []

    def submit(self, slices: Sequence[SliceHeader]) -> None:
        """Start the check of all slices that the second decoder can read."""
        for header in slices:
            if is_checkable(header):
                self._futures.append((header, self._pool.submit(_problem, header)))

    def drop_waiting(self) -> None:
        """Drop the checks that have not started yet."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def __len__(self) -> int:
        """Return the number of slices whose pixels are compared."""
        return len(self._futures)

    def problems(self) -> Iterator[tuple[SliceHeader, str | None]]:
        """Yield each slice with its problem or None, as soon as its check is done."""
        for header, future in self._futures:
            yield header, future.result()


def _problem(header: SliceHeader) -> str | None:
    try:
        frame = read_stream_bytes(header)
    except (ValueError, OSError):
        return None
    stream = None if frame is None else read_stream(frame)
    if frame is None or stream is None or not stream.has_size_of(header.rows, header.columns):
        return None  # the first decoder refuses the slice
    return j2k_problem(frame)


@contextmanager
def second_decoder() -> Iterator[SecondDecoder]:
    """Provide a check in background threads; slices that are not yet checked at the end of the block are dropped."""
    pool = ThreadPoolExecutor(min(MAX_WORKERS, os.cpu_count() or 1), thread_name_prefix="second-decoder")
    check = SecondDecoder(pool)
    try:
        yield check
    finally:
        check.drop_waiting()
        pool.shutdown(wait=True)
