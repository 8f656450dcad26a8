"""Measurement of the time from a hand's movement to the changed picture, with a client and a server on one machine."""

from __future__ import annotations

import itertools
import json
import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import simplejpeg

from carina.cli.console import print_json, print_note
from carina.config import load_settings
from carina.disk import make_folder, write_whole
from carina.errors import CarinaError
from carina.server.wire import messages as wire
from carina_bench.machine import machine_facts

__all__ = ["report"]

LIMIT_MS = 50.0
"""Maximum of the 95th percentile of the time from a key to its picture in the browser, ms."""
READY_S = 300.0
"""Maximum time in s to wait until the airways are found; the benchmark then fails."""
MIN_PICTURES = 5
"""Minimum number of pictures of a measurement; a software adapter renders about one a second."""
PERIOD_S = 1.0 / 60.0
"""Time between two inputs, s: 60 a second, the rate of a gamepad or a screen."""


def report(*, folder: Path, case: str, size: tuple[int, int], quick: bool, as_json: bool) -> int:
    """Measure, print, and write ``stream.json``; return the exit code."""
    seconds = 4.0 if quick else 20.0
    with _server(case) as (host, token, pid):
        print_note("waiting for the airways")
        with _client(host, token) as client:
            client.open(size)
            rows = {}
            for name, device in (("steer", False), ("device", True)):
                began_s, used_s = time.monotonic(), _used_s(pid)
                rows[name] = client.measure(seconds, device=device)
                if used_s is not None:
                    rows[name]["cores_used"] = ((_used_s(pid) or used_s) - used_s) / (time.monotonic() - began_s)
    facts = {
        "case": case,
        "size": list(size),
        "backend": load_settings().backend,
        "limit_ms": LIMIT_MS,
        "rows": rows,
        "machine": machine_facts(),
    }
    make_folder(folder, what="the measurements")
    text = json.dumps(facts, indent=1, allow_nan=False)
    write_whole(folder / "stream.json", text.encode(), what="the measurements")
    if as_json:
        print_json(facts)
        return 0
    # The sizes of the served pictures are those of squares with equal area.
    whole_px = math.sqrt(size[0] * size[1])
    for name, row in rows.items():
        held = "held" if row["p95_ms"] <= LIMIT_MS else "missed"
        print(
            f"{name}: input to changed picture p50 {row['p50_ms']:.1f} ms, p95 {row['p95_ms']:.1f} ms "
            f"(limit {LIMIT_MS:g}: {held}), {row['pictures_hz']:.0f} pictures/s, {row['num']} inputs"
        )
        finder = "" if row["finder_share"] == 0 else f"; {row['finder_share']:.0%} by the viewfinder (cut-plane)"
        used = "" if "cores_used" not in row else f", {row['cores_used']:.2f} cores used"
        print(
            f"  served at {row['p5_px']:.0f} to {row['p95_px']:.0f} px, median {row['p50_px']:.0f} of {whole_px:.0f}; "
            f"{row['size_changes']} changes of size, {row['num_older']} older poses after newer ones{used}{finder}"
        )
    return 0


@contextmanager
def _server(case: str) -> Iterator[tuple[str, str, int]]:
    """Run a server for a case; yield its address, its access token and its process ID."""
    arguments = ["demo", case] if case in {"phantom", "patient"} else ["open", case]
    command = [sys.executable, "-m", "carina.cli", *arguments, "--no-browser", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            text = ""
            while not text.rstrip().endswith("}"):
                line = process.stdout.readline()
                if not line:
                    raise CarinaError("the server that was to be measured did not start", code="machine")
                text += line
            message = json.loads(text)
            yield str(message["url"]).split("//")[1].split("/")[0], str(message["token"]), process.pid
        finally:
            process.terminate()


def _used_s(pid: int) -> float | None:
    """Return the CPU time of a process, s; None if the system does not report the time in /proc."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    except OSError:
        return None
    # Of the fields after the process's name, the 12th and 13th are user and system time (proc(5): utime, stime).
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


class _Client:
    """Client of a server that uses the protocol of the window and decodes the pictures."""

    def __init__(self, socket: Any) -> None:
        self._socket = socket
        self._pose_id = 0

    def _send(self, message: Any) -> None:
        self._socket.send(wire.encode_message(message))

    def _receive(self, timeout_s: float) -> Any:
        data = self._socket.recv(timeout=timeout_s)
        if isinstance(data, bytes):
            header, payload = wire.parse_picture(data)
            if header.codec == "jpeg":
                simplejpeg.decode_jpeg(payload, colorspace="RGB")
            self._send(wire.Ack(header.frame_id))
            return header
        message = wire.parse_server_message(data)
        if isinstance(message, wire.PoseMessage):
            self._pose_id = message.pose_id
        return message

    def open(self, size: tuple[int, int]) -> None:
        """Open the connection, and wait until the airways are found and the maps are built.

        Only then pictures have their full rate. ``size`` is the width and height of the airway view, pixels.
        """
        self._send(wire.ClientHello(wire.WIRE_VERSION))
        view = wire.ViewSize("airway", *size)
        self._send(wire.Layout((view,)))
        end_s, ready = time.monotonic() + READY_S, False
        jobs: set[str] = set()
        while time.monotonic() < end_s:
            try:
                message = self._receive(2.0)
            except TimeoutError:
                if ready and not jobs:
                    return
                continue
            if isinstance(message, wire.State) and message.stage == "ready":
                ready = True
            elif isinstance(message, wire.Progress):
                jobs.add(message.job_id)
            elif isinstance(message, wire.Done):
                jobs.discard(message.job_id)
        raise CarinaError("the server was not ready in time", code="machine")

    def measure(self, seconds: float, *, device: bool) -> dict[str, Any]:
        """Fly back and forth for ``seconds``; return the times from each input to the first picture that shows it.

        Each input is sent at its scheduled time, even if the picture of the previous input has not arrived, as by a
        hand. So several inputs may wait for one late picture.
        """
        sent: list[tuple[float, int]] = []
        latencies_ms: list[float] = []
        sizes_px: list[int] = []
        newest_id, num_older, num_finder = -1, 0, 0
        began_s = now_s = time.monotonic()
        n, due_s = 0, began_s
        while now_s - began_s < seconds:
            forward = 1.0 if (n // 90) % 2 == 0 else -1.0
            if device:
                self._send(
                    wire.DeviceSampleMessage(
                        device="bench",
                        time_s=now_s,
                        position_mm=None,
                        orientation_wxyz=None,
                        axes=(forward, 0.0, 0.0, 0.0, 0.0, 0.0),
                        buttons=0,
                        handle=None,
                        advance=0.0,
                    )
                )
            else:
                self._send(wire.Steer(0.4 * forward, 0.0, 0.0, 0.0))
            sent.append((time.monotonic(), self._pose_id))
            n += 1
            # If the client is late, it reads all pending messages and skips the inputs that are overdue.
            due_s = max(due_s + PERIOD_S, time.monotonic())
            while True:
                try:
                    message = self._receive(max(0.0, due_s - time.monotonic()))
                except TimeoutError:
                    break
                # Where airway views are slow, the cut-plane stands for the airway view while the tip moves.
                if isinstance(message, wire.PictureHeader) and "airway" in (message.view, message.stands_for):
                    num_finder += message.stands_for is not None
                    # The value is the side of a square with the area of the picture.
                    sizes_px.append(round(math.sqrt(message.width * message.height)))
                    num_older += message.pose_id < newest_id
                    newest_id = max(newest_id, message.pose_id)
                    arrived_s = time.monotonic()
                    # A picture shows an input if the pose in it is newer than the latest pose at the time of the input.
                    shown = [at for at, pose_id in sent if message.pose_id > pose_id]
                    latencies_ms += [1000.0 * (arrived_s - at) for at in shown]
                    sent = [(at, pose_id) for at, pose_id in sent if message.pose_id <= pose_id]
            now_s = time.monotonic()
        if device:
            self._send(
                wire.DeviceSampleMessage(
                    device="bench",
                    time_s=now_s,
                    position_mm=None,
                    orientation_wxyz=None,
                    axes=(0.0,) * 6,
                    buttons=0,
                    handle=None,
                    advance=0.0,
                )
            )
            self._send(wire.DeviceGone("bench"))
        if min(len(latencies_ms), len(sizes_px)) < MIN_PICTURES:
            words = f"{len(sizes_px)} pictures arrived in {seconds:g} s; at least {MIN_PICTURES} are needed"
            raise CarinaError(words, code="machine")
        quantiles = statistics.quantiles(latencies_ms, n=20)
        by_size_px = statistics.quantiles(sizes_px, n=20)
        return {
            "num": len(latencies_ms),
            "p50_ms": statistics.median(latencies_ms),
            "p95_ms": quantiles[-1],
            "max_ms": max(latencies_ms),
            "pictures_hz": len(sizes_px) / seconds,
            "finder_share": num_finder / len(sizes_px),
            "p5_px": by_size_px[0],
            "p50_px": statistics.median(sizes_px),
            "p95_px": by_size_px[-1],
            "size_changes": sum(a != b for a, b in itertools.pairwise(sizes_px)),
            "num_older": num_older,
        }


@contextmanager
def _client(host: str, token: str) -> Iterator[_Client]:
    from websockets.sync.client import connect

    headers = {"Authorization": f"Bearer {token}"}
    with connect(f"ws://{host}/ws", additional_headers=headers, max_size=64 << 20, compression=None) as socket:
        yield _Client(socket)
