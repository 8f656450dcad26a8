"""A real Orthanc on loopback for tests, with the plugin of DICOMweb."""

from __future__ import annotations

import contextlib
import json
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

PLUGIN = Path("/usr/share/orthanc/plugins/libOrthancDicomWeb.so")
_START_S = 60.0


def free_port() -> int:
    """Return a port of loopback that is free now."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@dataclass
class Orthanc:
    """A running server."""

    dicom_port: int
    http_port: int
    listen_port: int
    """Port to which the server sends the images of a C-MOVE for the AE title CARINA."""

    @property
    def url(self) -> str:
        """URL of the DICOMweb service."""
        return f"http://127.0.0.1:{self.http_port}/dicom-web"

    def request(self, path: str, data: bytes | None = None, method: str | None = None) -> Any:
        """Call Orthanc's own interface, and return the parsed answer."""
        request = urllib.request.Request(f"http://127.0.0.1:{self.http_port}{path}", data=data, method=method)
        with urllib.request.urlopen(request, timeout=20) as answer:
            return json.loads(answer.read() or b"null")

    def upload(self, folder: Path) -> None:
        """Store all files of a folder by Orthanc's own interface."""
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                self.request("/instances", path.read_bytes())

    def num_instances(self) -> int:
        """Return the number of stored images."""
        return len(self.request("/instances"))


def require_orthanc() -> str:
    """Return the program, or skip the test."""
    program = shutil.which("Orthanc") or shutil.which("Orthanc", path="/usr/sbin")
    if program is None:
        pytest.skip("Orthanc is not installed (Debian packages orthanc and orthanc-dicomweb)")
    return program


@contextlib.contextmanager
def running_orthanc(folder: Path, **changes: Any) -> Iterator[Orthanc]:
    """Start Orthanc with an empty store, and stop it at the end of the block."""
    program = require_orthanc()
    server = Orthanc(free_port(), free_port(), free_port())
    settings: dict[str, Any] = {
        "Name": "CarinaTests",
        "StorageDirectory": str(folder / "store"),
        "IndexDirectory": str(folder / "store"),
        "Plugins": [str(PLUGIN)] if PLUGIN.exists() else [],
        "HttpPort": server.http_port,
        "HttpServerEnabled": True,
        "RemoteAccessAllowed": False,
        "AuthenticationEnabled": False,
        "DicomServerEnabled": True,
        "DicomAet": "ORTHANC",
        "DicomCheckCalledAet": True,
        "DicomAlwaysAllowEcho": False,
        "DicomAlwaysAllowStore": False,
        "DicomPort": server.dicom_port,
        "DicomModalities": {
            "carina": {
                "AET": "CARINA", "Host": "127.0.0.1", "Port": server.listen_port, "AllowGet": True, "AllowMove": True,
            }
        },
        "DicomWeb": {"Enable": True, "Root": "/dicom-web/"},
        "ConcurrentJobs": 1,
        **changes,
    }  # fmt: skip
    (folder / "orthanc.json").write_text(json.dumps(settings))
    with (folder / "orthanc.log").open("wb") as log:
        process = subprocess.Popen([program, str(folder / "orthanc.json")], stdout=log, stderr=log, cwd=folder)
    try:
        _wait(server, process, folder)
        yield server
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(20)


def _wait(server: Orthanc, process: subprocess.Popen[bytes], folder: Path) -> None:
    until = time.monotonic() + _START_S
    while time.monotonic() < until:
        if process.poll() is not None:
            break
        with contextlib.suppress(urllib.error.URLError, OSError):
            server.request("/system")
            return
        time.sleep(0.1)
    text = (folder / "orthanc.log").read_text(errors="replace")
    pytest.fail(f"Orthanc did not start: {text[-2000:]}")
