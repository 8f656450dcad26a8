"""A second check of JPEG 2000 slices, by FFmpeg's decoder (PyAV, extra ``video``).

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

from carina.volume.dicom_headers import SliceHeader
from carina.volume.dicom_pixel_bytes import read_stream_bytes
from carina.volume.model import Note

_JPEG_2000 = ("1.2.840.10008.1.2.4.90", "1.2.840.10008.1.2.4.91")
_REPORTS_DAMAGE = ("End mismatch", "Synthetic End of Stream")
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


_level_lock = threading.Lock()
_level_users = 0
_level_before: int | None = None
_skipped_before = True


@contextmanager
def _ffmpeg_warnings() -> Iterator[None]:
    """Let FFmpeg report warnings to Python within the block, repeated ones too.

    By default PyAV skips a message equal to the previous one, whatever its stream, so the same damage would be
    reported only once. The settings apply to the whole process, so the users of the block are counted.
    """
    import av.logging

    global _level_users, _level_before, _skipped_before  # noqa: PLW0603
    with _level_lock:
        if _level_users == 0:
            _level_before, _skipped_before = av.logging.get_level(), av.logging.get_skip_repeated()
            av.logging.set_level(av.logging.WARNING)
            av.logging.set_skip_repeated(False)
        _level_users += 1
    try:
        yield
    finally:
        with _level_lock:
            _level_users -= 1
            if _level_users == 0:
                av.logging.set_level(_level_before)
                av.logging.set_skip_repeated(_skipped_before)


def j2k_problem(frame: bytes) -> str | None:
    """Return the error that FFmpeg reports for a JPEG 2000 stream; None if it is intact or not supported by FFmpeg."""
    import av
    import av.logging

    with _ffmpeg_warnings(), av.logging.Capture(local=True) as reports:
        try:
            context = av.CodecContext.create("jpeg2000", "r")
            context.thread_count = 1  # messages are captured only in the thread that decodes
            decoded = context.decode(av.Packet(frame)) or context.decode(None)
        except av.error.InvalidDataError:
            return "a second decoder cannot read it"
        except (av.error.FFmpegError, MemoryError, ValueError):
            return None  # not supported by FFmpeg, which does not mean that the stream is damaged
    if any(report.startswith(_REPORTS_DAMAGE) for _, _, report in reports):
        return "a second decoder found that coded data end too early or too late"
    return None if decoded else "a second decoder finds no image in it"


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
        return None  # the first decoder refuses the slice
    return None if frame is None else j2k_problem(frame)


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
