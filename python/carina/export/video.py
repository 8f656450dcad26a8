"""Video files of flights: H.264 in MP4 and VP9 in WebM, by PyAV (extra ``video``)."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from carina.disk import Draft
from carina.errors import CarinaError, UsageError
from carina.installation import extra_command

VIDEO_SUFFIXES = (".mp4", ".webm")
# BT.709 is what players assume for a video without a label. The label is written too.
_BT709 = 1
_OPTIONS = {
    # QuickTime and old phones play the main profile; the default is the high profile.
    ".mp4": ("libx264", {"crf": "18", "preset": "veryfast", "profile": "main"}),
    # "realtime" with cpu-used 6 encodes about ten times faster than the default, with a few percent more bytes.
    ".webm": ("libvpx-vp9", {"crf": "24", "b": "0", "deadline": "realtime", "cpu-used": "6", "row-mt": "1"}),
}
SIZES_PX = (16, 8192)
# Limits of ITU-T H.264 table A-1, in macroblocks of 16 x 16 pixels: for a frame, and for a second.
_LARGEST_LEVEL = (139_264, 16_711_680)
"""H.264 level 6.2, the largest of the standard: macroblocks per frame, and per second."""
_COMMON_LEVEL = (36_864, 2_073_600)
"""H.264 level 5.2 (4096 x 2304), commonly played by phones and browsers: macroblocks per frame, and per second."""
COMMENT = "Made by Carina from a CT. Not a medical device; not for diagnosis."


def video_problem() -> str | None:
    """Return the reason why this installation writes no videos, with the command that changes it; None if it does."""
    if importlib.util.find_spec("av") is not None:
        return None
    return f"videos need PyAV, which is not installed; install it with: {extra_command('video')}"


def _pyav() -> Any:
    try:
        import av
    except ImportError:
        raise CarinaError(
            f"videos need PyAV, which is not installed; install it with: {extra_command('video')}", code="export.video"
        ) from None
    return av


def even_size(width: int, height: int) -> tuple[int, int]:
    """Return the size of a video for pictures of a size: an odd number of pixels becomes the next even number.

    The common 4:2:0 colour format has one colour value for two by two pixels. QuickTime, Safari and Windows do not play
    H.264 in other formats.

    Examples
    --------
    >>> even_size(101, 76)
    (102, 76)
    """
    return width + width % 2, height + height % 2


def size_notes(path: str | os.PathLike[str], width: int, height: int, *, rate_hz: float) -> tuple[str, ...]:
    """Return notes for the user on the size and the rate of a video.

    Parameters
    ----------
    path
        The video file, ``.mp4`` or ``.webm``.

    Raises
    ------
    UsageError
        If `VideoWriter` refuses the size or the rate.
    """
    _check_format(Path(path).suffix.lower(), width, height, rate_hz)
    notes = []
    even = even_size(width, height)
    if even != (width, height):
        notes.append(
            f"the video has {even[0]} x {even[1]} pixels instead of {width} x {height}: players need even numbers"
        )
    if Path(path).suffix.lower() == ".mp4" and not _is_within_level(_COMMON_LEVEL, even, rate_hz):
        notes.append(
            f"many players do not play H.264 videos of {even[0]} x {even[1]} pixels at {rate_hz:g} frames per second; "
            "4096 x 2160 at 60 is a common limit"
        )
    return tuple(notes)


def _check_format(suffix: str, width: int, height: int, rate_hz: float) -> None:
    """Raise an error for a size or a frame rate that no player supports."""
    least, most = SIZES_PX
    if not (least <= width <= most and least <= height <= most and 1.0 <= rate_hz <= 240.0):
        raise UsageError(
            f"a video must have {least} to {most} pixels on each side and 1 to 240 frames per second; found "
            f"{width} x {height} at {rate_hz:g} per second"
        )
    if suffix == ".mp4" and not _is_within_level(_LARGEST_LEVEL, even_size(width, height), rate_hz):
        raise UsageError(
            f"H.264 (.mp4) has no level for {width} x {height} pixels at {rate_hz:g} frames per second; choose at most "
            "8192 x 4352, fewer frames per second, or a .webm file"
        )


def _is_within_level(level: tuple[int, int], size: tuple[int, int], rate_hz: float) -> bool:
    across, down = (-(-n // 16) for n in size)
    frame, second = level
    # The square of a side must be at most eight times the largest frame (A.3.1).
    return across * down <= frame and across * down * rate_hz <= second and max(across, down) ** 2 <= 8 * frame


class _ErrorRecordingFile(io.RawIOBase):
    """Wrapper of the temporary file that stores disk errors, because PyAV does not report their reason."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.trouble: OSError | None = None

    def write(self, data: Any) -> int:
        try:
            return self._file.write(data)
        except OSError as error:
            self.trouble = self.trouble or error
            raise

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        try:
            return self._file.seek(offset, whence)
        except OSError as error:
            self.trouble = self.trouble or error
            raise

    def tell(self) -> int:
        return self._file.tell()

    def read(self, size: int = -1) -> bytes:
        return self._file.read(size)

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True


class _DraftReader(io.RawIOBase):
    """Second reader of the temporary file while it is being written, with a separate position."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._at = file, 0

    def read(self, size: int = -1) -> bytes:
        self._file.flush()
        wanted = os.fstat(self._file.fileno()).st_size - self._at if size < 0 else size
        data = os.pread(self._file.fileno(), max(wanted, 0), self._at)
        self._at += len(data)
        return data

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        starts = {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: os.fstat(self._file.fileno()).st_size}
        self._at = starts[whence] + offset
        return self._at

    def tell(self) -> int:
        return self._at

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True


class VideoWriter:
    """Writer of a video; an existing file is replaced when the video is complete, or not at all.

    Parameters
    ----------
    path
        Ends in ``.mp4`` or ``.webm``.
    width, height
        Size of the pictures, 16 to 8192 px. The video has an even size (`even_size`), which all players support: the
        last row or column of a picture of an odd size is repeated.
    rate_hz
        Frames per second, 1 to 240.

    Raises
    ------
    UsageError
        If the suffix, the size or the rate is not supported.
    CarinaError
        ``export.video`` without PyAV.
    """

    def __init__(self, path: str | os.PathLike[str], width: int, height: int, *, rate_hz: float = 30.0) -> None:
        self._path = Path(path)
        suffix = self._path.suffix.lower()
        if suffix not in VIDEO_SUFFIXES:
            raise UsageError(
                f"expected a video file name that ends in {' or '.join(VIDEO_SUFFIXES)}; found {self._path.name!r}"
            )
        _check_format(suffix, width, height, rate_hz)
        av = _pyav()
        self._av, self._size = av, (width, height)
        self.num_frames = 0
        self._rate = Fraction(rate_hz).limit_denominator(1001)
        self._draft = Draft(self._path, what="the video")
        self._file = _ErrorRecordingFile(self._draft.file)
        self._container: Any = None
        with self._disk_errors_raised():
            # The index is stored before the frames, so that a browser can play the video while it loads.
            first = suffix == ".mp4" and hasattr(os, "pread")
            options = {"movflags": "+faststart"} if first else {}
            self._container = av.open(
                self._file, "w", format=suffix.removeprefix("."), container_options=options, io_open=self._reader
            )
            self._stream = self._create_stream(suffix)

    def __repr__(self) -> str:
        """Return file name, size and number of frames."""
        width, height = self._size
        return f"VideoWriter({self._path.name!r}, {width}x{height}, num_frames={self.num_frames})"

    def _reader(self, _url: str, _flags: int, _options: dict[str, str]) -> _DraftReader:
        """Open the temporary file a second time for PyAV, which moves the frames behind the index."""
        return _DraftReader(self._draft.file)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the video, both even."""
        return even_size(*self._size)

    @property
    def duration_s(self) -> float:
        """Duration of the frames that were added so far, in seconds."""
        return float(self.num_frames / self._rate)

    def _create_stream(self, suffix: str) -> Any:
        codec, options = _OPTIONS[suffix]
        self._container.metadata["comment"] = COMMENT
        stream = self._container.add_stream(codec, rate=self._rate, options=options)
        stream.width, stream.height = self.size_px
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = 1 / self._rate
        for label in ("colorspace", "color_primaries", "color_trc"):
            setattr(stream.codec_context, label, _BT709)
        return stream

    def add(self, rgb: NDArray[np.uint8]) -> None:
        """Add a frame, ``(height, width, 3)`` uint8, to the end of the video."""
        width, height = self._size
        if rgb.shape != (height, width, 3):
            raise UsageError(f"expected a frame of {(height, width, 3)}; found {rgb.shape}")
        if self.size_px != self._size:
            rgb = np.pad(rgb, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
        frame = frame.reformat(format=self._stream.pix_fmt, dst_colorspace="ITU709")
        frame.pts, frame.time_base = self.num_frames, 1 / self._rate
        with self._disk_errors_raised():
            self._container.mux(self._stream.encode(frame))
        self.num_frames += 1

    def close(self) -> None:
        """Write the remaining frames, and move the complete file to its final name.

        Raises
        ------
        DiskError
            If the disk refuses the file; the video is then discarded, and a former file stays unchanged.
        """
        with self._disk_errors_raised():
            self._container.mux(self._stream.encode(None))
            self._container.close()
            self._draft.commit()

    def discard(self) -> None:
        """Discard the video and its temporary file; a former file at the path stays unchanged."""
        try:
            if self._container is not None:
                # Closing writes the last bytes, which are not needed and for which the disk may have no space. For a
                # refused write PyAV also raises errors other than OSError.
                with contextlib.suppress(Exception):
                    self._container.close()
        finally:
            self._draft.discard()

    @contextlib.contextmanager
    def _disk_errors_raised(self) -> Iterator[None]:
        """Discard the video after any error, and raise the disk's own error if there was one."""
        try:
            yield
        except BaseException as error:
            refused = self._file.trouble or (error if isinstance(error, OSError) else None)
            self.discard()
            if refused is not None:
                raise self._draft.disk_error(refused) from error
            raise

    def __enter__(self) -> VideoWriter:
        """Return the writer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, trouble: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the video; discard it after an error or without frames."""
        if trouble is None and self.num_frames:
            self.close()
        else:
            self.discard()
