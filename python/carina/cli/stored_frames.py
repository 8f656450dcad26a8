"""Frames of a long job, stored in a folder: a stopped job continues after the last stored frame."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina.disk import make_folder, read_regular_text, write_whole
from carina.display.png import png_pixels
from carina.errors import UsageError, VolumeImportError
from carina.render import Picture

FORMAT = "carina-frames"
JOB = "job.json"


class StoredFrames:
    """Numbered PNG files in a folder, with a description of their job.

    Parameters
    ----------
    folder
        Missing or empty folder, or a folder with frames of the same job.
    job
        Identifier of the job, which must depend on everything that changes a frame.

    Raises
    ------
    UsageError
        If the folder contains other files, or frames of another job.
    """

    def __init__(self, folder: Path, job: str) -> None:
        self._folder = folder
        found = self._found(folder)
        if found is None:
            make_folder(folder, what="the frames")
            document = json.dumps({"format": FORMAT, "version": 1, "job": job}) + "\n"
            write_whole(folder / JOB, document.encode(), what="the file that describes the frames")
        elif found != job:
            raise UsageError(
                f"--keep: the frames in {folder} belong to another flight or case, or were rendered at another size or "
                "by another version of Carina; choose another folder, or delete this one"
            )
        self.num = next(n for n in range(10_000_000) if not self._file(n).exists())
        """Number of frames that are stored without a gap from the first one."""

    @staticmethod
    def _found(folder: Path) -> str | None:
        """Return the description of the job whose frames are in a folder; None for an empty or missing folder."""
        if not folder.exists() or (folder.is_dir() and next(folder.iterdir(), None) is None):
            return None
        try:
            document = json.loads(read_regular_text(folder / JOB, max_bytes=1 << 20))
            if document["format"] == FORMAT and document["version"] == 1:
                return str(document["job"])
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            pass
        raise UsageError(
            f"--keep: expected a new or empty folder, or one with frames of this flight; {folder} contains other files"
        )

    def _file(self, number: int) -> Path:
        return self._folder / f"frame-{number:06}.png"

    def store_frame(self, number: int, picture: Picture) -> None:
        """Write the next frame atomically."""
        picture.save(self._file(number))

    def load(self, number: int, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Return a stored frame, shape (height, width, 3).

        Raises
        ------
        VolumeImportError
            If the file is damaged or has been changed.
        """
        file = self._file(number)
        try:
            rgb = png_pixels(file.read_bytes())
        except (OSError, ValueError) as error:
            msg = f"{file}: this frame cannot be read; delete it and all later frames, then start again"
            raise VolumeImportError(msg, code="fly.kept") from error
        if rgb.shape != (size[1], size[0], 3):
            height, width = rgb.shape[:2]
            msg = (
                f"{file}: expected a frame of {size[0]} x {size[1]} pixels in 8-bit colour, found {width} x {height}; "
                f"delete the kept frames in {self._folder} and render them again"
            )
            raise VolumeImportError(msg, code="fly.kept")
        return rgb
