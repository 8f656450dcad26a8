"""Measurement of the peak memory of a real server with a large case, its airways and every view."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import SimpleITK as sitk
from websockets.sync.client import connect

from carina.cli.console import print_note, progress_printer
from carina.errors import CarinaError
from carina.server.wire.messages import WIRE_VERSION
from carina_bench.cases import open_case

__all__ = ["server_memory"]

VIEWS = (
    "airway",
    "cut-plane",
    "tri-plane",
    "xray-axial",
    "xray-coronal",
    "xray-sagittal",
    "axial",
    "coronal",
    "sagittal",
    "tree",
)
PATIENCE_S = 400.0
"""Maximum time in s to wait until every view has been received; the benchmark then fails."""
MOVES = 40
"""Number of movements of the tip during which memory is measured."""


def _peak_bytes(process_id: int) -> int | None:
    """Return the peak memory of a process in bytes; None if the system does not report it (only Linux reports it)."""
    try:
        lines = Path(f"/proc/{process_id}/status").read_text(encoding="utf-8").splitlines()
    except OSError:
        return None
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM:")), None)


def server_memory(request: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the peak memory of a server that has opened the case, found its airways and shown every view."""
    rows = []
    for name in request["cases"]:
        volume = open_case(name, poses=2, progress=progress_printer()).volume
        with tempfile.TemporaryDirectory(prefix="carina-bench-") as scratch:
            file = Path(scratch) / "ct.mha"
            image = sitk.GetImageFromArray(volume.hu_zyx)
            image.SetSpacing([float(s) for s in volume.spacing_mm])
            image.SetOrigin([float(v) for v in volume.lps_from_ijk[:3, 3]])
            sitk.WriteImage(image, str(file), useCompression=False)
            del image
            rows.append({"case": name, "volume_bytes": volume.hu_zyx.nbytes, **_drive(file, Path(scratch))})
        row = rows[-1]
        row["times_volume"] = None if row["peak_bytes"] is None else round(row["peak_bytes"] / row["volume_bytes"], 3)
        print_note(f"{name}: {row['times_volume']} times the volume")
    return rows


def _drive(file: Path, home: Path) -> dict[str, Any]:
    # The server gets a temporary home folder, so that it reads no cache and changes no file of the user.
    environment = {
        **os.environ,
        **{f"XDG_{kind}_HOME": str(home / kind.lower()) for kind in ("CONFIG", "STATE", "CACHE", "DATA")},
    }
    command = [sys.executable, "-m", "carina.cli", "open", str(file), "--no-browser", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment)
    try:
        assert process.stdout is not None
        text = ""
        for line in process.stdout:
            text += line
            try:
                access = json.loads(text)
                break
            except json.JSONDecodeError:
                continue
        else:
            raise CarinaError("the server ended before it stated its address", code="machine.benchmark")
        idle = _peak_bytes(process.pid)
        started = time.monotonic()
        seen = _look_at_everything(access)
        return {
            "peak_bytes": _peak_bytes(process.pid),
            "peak_bytes_at_start": idle,
            "views_seen": sorted(seen),
            "seconds": round(time.monotonic() - started, 1),
        }
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(timeout=30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _look_at_everything(access: dict[str, str]) -> set[str]:
    """Receive every view until the airways are found and a short flight is over; return the names of the views.

    Raises
    ------
    CarinaError
        If a view is missing after :data:`PATIENCE_S` seconds.
    """
    address = access["url"].split("?")[0].rstrip("/").replace("http", "ws", 1) + "/ws"
    end = time.monotonic() + PATIENCE_S
    seen: set[str] = set()
    moves = 0
    ready = False
    with connect(address, additional_headers={"Authorization": f"Bearer {access['token']}"}, max_size=None) as socket:

        def send(message: dict[str, Any]) -> None:
            socket.send(json.dumps(message))

        send({"type": "hello", "wire_version": WIRE_VERSION})
        views = [{"view": view, "width": 512, "height": 512} for view in VIEWS]
        send({"type": "layout", "views": views})
        while time.monotonic() < end:
            message = socket.recv(timeout=end - time.monotonic())
            if isinstance(message, bytes):
                length = int.from_bytes(message[:4], "little")
                header = json.loads(message[4 : 4 + length])
                send({"type": "ack", "frame_id": header["frame_id"]})
                if ready:
                    seen.add(header["view"])
                if ready and header["view"] == "airway" and moves < MOVES:
                    moves += 1
                    send({"type": "steer", "advance_mm": 0.5, "yaw_rad": 0.0, "pitch_rad": 0.0, "roll_rad": 0.0})
                if moves >= MOVES and seen.issuperset(VIEWS):
                    return seen
                continue
            document = json.loads(message)
            if document["type"] == "state" and document["stage"] == "ready" and not ready:
                ready = True
                # The server does not send an unchanged picture again, so the client changes the size of every view.
                send({"type": "layout", "views": [{**view, "width": 480} for view in views]})
            if document["type"] == "error":
                raise CarinaError(f"the server refused the case: {document['message']}", code="machine.benchmark")
    raise CarinaError(f"the server showed {sorted(seen)} only in {PATIENCE_S:g} s", code="machine.benchmark")
