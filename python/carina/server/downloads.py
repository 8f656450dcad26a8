"""What a person takes away: the airways of the open case as a file, made when it is asked for."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Callable
from pathlib import Path
from shutil import rmtree
from typing import Any

from starlette.background import BackgroundTask
from starlette.responses import FileResponse, Response

from carina.errors import CarinaError
from carina.export import EXPORT_SUFFIXES, export_airways
from carina.session import Session

__all__ = ["FILE_STEM", "Downloads"]

FILE_STEM = "airways"
"""Of every file: neither the patient nor the case is in its name."""


class Downloads:
    """Makes one file after the other: a surface takes seconds and both cores.

    Parameters
    ----------
    session
        Whose airways.
    export
        Writes a file; another one in tests.
    """

    def __init__(self, session: Session, export: Callable[..., Path] = export_airways) -> None:
        self._session = session
        self._export = export
        self._one_at_a_time = asyncio.Lock()

    async def answer(self, suffix: str) -> Response:
        """The file with this suffix (``.json``, ``.stl``, ...), which is removed once it has been sent.

        Raises
        ------
        CarinaError
            If Carina writes no such file, the case has no airways, or the disk takes nothing.
        """
        if suffix not in EXPORT_SUFFIXES:
            msg = f"Carina writes {', '.join(EXPORT_SUFFIXES)}; asked for {suffix!r}"
            raise CarinaError(msg, code="export.suffix")
        volume, airways = self._session.airways_to_take_away()
        async with self._one_at_a_time:
            path = await asyncio.to_thread(self._make, suffix, volume, airways)
        return FileResponse(
            path,
            filename=path.name,
            headers={"cache-control": "no-store"},
            background=BackgroundTask(rmtree, path.parent, ignore_errors=True),
        )

    def _make(self, suffix: str, volume: Any, airways: Any) -> Path:
        try:
            folder = Path(tempfile.mkdtemp(prefix="carina-download-"))
        except OSError as trouble:
            raise CarinaError(f"no file can be made on this machine: {trouble}", code="export.disk") from trouble
        try:
            return self._export(folder / f"{FILE_STEM}{suffix}", volume, airways)
        except BaseException:
            rmtree(folder, ignore_errors=True)
            raise
