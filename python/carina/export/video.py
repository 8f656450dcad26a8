"""Flights as video: H.264 in MP4, VP9 in WebM, by PyAV (extra ``video``)."""

from __future__ import annotations

import contextlib
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

__all__ = ["VIDEO_SUFFIXES", "VideoWriter"]

VIDEO_SUFFIXES = (".mp4", ".webm")
# BT.709, as players take it for granted for a film without a label; the label is written as well.
_BT709 = 1
_OPTIONS = {
    ".mp4": ("libx264", {"crf": "18", "preset": "veryfast"}),
    # "realtime" with 6 encodes some ten times faster than the default, for a few percent more bytes.
    ".webm": ("libvpx-vp9", {"crf": "24", "b": "0", "deadline": "realtime", "cpu-used": "6", "row-mt": "1"}),
}
COMMENT = "Made by Carina from a CT. Not a medical device; not for diagnosis."


def _pyav() -> Any:
    try:
        import av
    except ImportError:
        raise CarinaError(
            "videos need PyAV: install Carina with the extra `video` (pip install 'carina[video]')", code="export.video"
        ) from None
    return av


class _Told(io.RawIOBase):
    """The draft for the library, which says of a full disk only that something went wrong."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.trouble: OSError | None = None

    def write(self, data: Any) -> int:
        try:
            return self._file.write(data)
        except OSError as trouble:
            self.trouble = self.trouble or trouble
            raise

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        try:
            return self._file.seek(offset, whence)
        except OSError as trouble:
            self.trouble = self.trouble or trouble
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


class VideoWriter:
    """Writes pictures as frames of a video; a file of the same name is replaced when all is written, or not at all.

    Parameters
    ----------
    path
        Ends in ``.mp4`` or ``.webm``.
    width, height
        Of the pictures, 16 to 8192 px. H.264 halves the colours' resolution on even sizes only; on odd ones it keeps
        all of it, which few players on phones show.
    rate_hz
        Frames per second, 1 to 240.

    Raises
    ------
    UsageError
        If the name, the size or the rate is none of these.
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
        if not (16 <= width <= 8192 and 16 <= height <= 8192 and 1.0 <= rate_hz <= 240.0):
            raise UsageError(
                "a video must have 16 to 8192 pixels on each side and 1 to 240 frames per second; found "
                f"{width} x {height} at "
                f"{rate_hz:g} per second"
            )
        av = _pyav()
        self._av, self._size = av, (width, height)
        self.num_frames = 0
        self._rate = Fraction(rate_hz).limit_denominator(1001)
        self._draft = Draft(self._path, what="the video")
        self._file = _Told(self._draft.file)
        self._container: Any = None
        with self._disk_told():
            self._container = av.open(self._file, "w", format=suffix.removeprefix("."))
            self._stream = self._made_stream(suffix)

    def __repr__(self) -> str:
        width, height = self._size
        return f"VideoWriter({self._path.name!r}, {width}x{height}, num_frames={self.num_frames})"

    def _made_stream(self, suffix: str) -> Any:
        codec, options = _OPTIONS[suffix]
        width, height = self._size
        self._container.metadata["comment"] = COMMENT
        stream = self._container.add_stream(codec, rate=self._rate, options=options)
        stream.width, stream.height = width, height
        odd = width % 2 or height % 2
        stream.pix_fmt = "yuv444p" if odd and suffix == ".mp4" else "yuv420p"
        stream.codec_context.time_base = 1 / self._rate
        for label in ("colorspace", "color_primaries", "color_trc"):
            setattr(stream.codec_context, label, _BT709)
        return stream

    def add(self, rgb: NDArray[np.uint8]) -> None:
        """One more frame, ``(height, width, 3)`` uint8."""
        width, height = self._size
        if rgb.shape != (height, width, 3):
            raise UsageError(f"expected a frame of {(height, width, 3)}; found {rgb.shape}")
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(rgb), format="rgb24")
        frame = frame.reformat(format=self._stream.pix_fmt, dst_colorspace="ITU709")
        frame.pts, frame.time_base = self.num_frames, 1 / self._rate
        with self._disk_told():
            self._container.mux(self._stream.encode(frame))
        self.num_frames += 1

    def close(self) -> None:
        """Write what is left and put the file in its place.

        Raises
        ------
        DiskError
            Where that fails; it is given up then, and a former file stays.
        """
        with self._disk_told():
            self._container.mux(self._stream.encode(None))
            self._container.close()
            self._draft.commit()

    def discard(self) -> None:
        """Give it up."""
        try:
            if self._container is not None:
                # It writes its last bytes, for which there may be no room; they are not wanted. Not only OSError: the
                # library has an error of its own for a file that refused.
                with contextlib.suppress(Exception):
                    self._container.close()
        finally:
            self._draft.discard()

    @contextlib.contextmanager
    def _disk_told(self) -> Iterator[None]:
        """After any error the video is given up; what the disk refused is said in its own words."""
        try:
            yield
        except BaseException as error:
            refused = self._file.trouble or (error if isinstance(error, OSError) else None)
            self.discard()
            if refused is not None:
                raise self._draft.trouble(refused) from error
            raise

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, trouble: BaseException | None, trace: TracebackType | None
    ) -> None:
        if trouble is None and self.num_frames:
            self.close()
        else:
            self.discard()
