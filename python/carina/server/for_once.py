"""A file that is made to be sent once."""

from __future__ import annotations

from pathlib import Path
from shutil import rmtree

from starlette.responses import FileResponse
from starlette.types import Receive, Scope, Send

from carina.disk import ScratchFolder, disk_trouble

__all__ = ["FileForOnce", "new_folder"]


class FileForOnce(FileResponse):
    """A file in a folder of its own; both go however the answer ends: sent, refused (a range beyond it), broken off."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            rmtree(Path(self.path).parent, ignore_errors=True)


def new_folder() -> Path:
    """For one file alone.

    Raises
    ------
    DiskError
        If the disk takes nothing.
    """
    try:
        return ScratchFolder().path
    except OSError as trouble:
        raise disk_trouble(trouble, "the file cannot be created on this machine", None) from trouble
