"""HTTP responses for temporary files: deleted after the response, or stored until a client has the whole file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from shutil import rmtree

from starlette.responses import FileResponse
from starlette.types import Message, Receive, Scope, Send

from carina.disk import ScratchFolder, disk_trouble


class OneShotFileResponse(FileResponse):
    """Response with a file from its own temporary folder; both are deleted after the response.

    The folder is also deleted if the requested range is invalid or the client disconnects.
    """

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file to the client, and delete its folder."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            rmtree(Path(self.path).parent, ignore_errors=True)


class StoredFileResponse(FileResponse):
    """HTTP response with a stored file, which reports whether the client received the whole file.

    Parameters
    ----------
    path
        Path of the file.
    ended
        Called once at the end of the response, with True if the whole file was sent. A request for the headers, a
        request for a part of the file and a broken connection give False.
    headers
        Further headers.
    """

    def __init__(self, path: Path, *, ended: Callable[[bool], None], headers: dict[str, str]) -> None:
        super().__init__(path, filename=path.name, headers=headers)
        self._ended = ended

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file to the client, and report whether the client received all of it."""
        status, connected, complete = 0, True, False

        async def receive_and_note() -> Message:
            nonlocal connected
            message = await receive()
            connected = connected and message["type"] != "http.disconnect"
            return message

        async def send_and_note(message: Message) -> None:
            nonlocal status, complete
            await send(message)
            status = message.get("status", status)
            # After the last part, servers report a disconnection for every connection.
            if message["type"] == "http.response.body" and not message.get("more_body", False):
                complete = connected and status == 200 and scope["method"] == "GET"

        try:
            await super().__call__(scope, receive_and_note, send_and_note)
        finally:
            self._ended(complete)


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
