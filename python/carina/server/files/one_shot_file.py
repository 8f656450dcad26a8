"""HTTP response for a temporary file that is deleted after it was sent."""

from __future__ import annotations

from pathlib import Path
from shutil import rmtree

from starlette.responses import FileResponse
from starlette.types import Receive, Scope, Send

from carina.disk import ScratchFolder, disk_trouble


class OneShotFileResponse(FileResponse):
    """Response with a file from its own temporary folder; both are deleted after the response.

    The folder is also deleted if the requested range is invalid or the client disconnects.
    """

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the response, and delete the folder of the file."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            rmtree(Path(self.path).parent, ignore_errors=True)


def new_folder() -> Path:
    """Create a temporary folder for one file, and return its path.

    Raises
    ------
    DiskError
        If the folder cannot be created, for example on a full disk.
    """
    try:
        return ScratchFolder().path
    except OSError as error:
        raise disk_trouble(error, "the file cannot be created on this machine", None) from error
