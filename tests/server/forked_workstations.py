"""Workstations in separate processes that a test can kill, and a client that acts as their window."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from websockets.sync.client import connect

from cached_test_data import cached_phantom
from carina.server.wire import messages as wire
from carina.volume import write_grid
from user_folders import environment_in

WAIT_S = 120.0
HERE = Path(__file__).parent


class Workstations:
    """Workstation processes, started one after the other over one CT and the same user folders.

    Parameters
    ----------
    folder
        Folder of the CT and of the user folders.
    environment
        Additional environment variables of the processes.
    soon_s
        Seconds after which a disk counts as silent and is tried again; the value of the product if None.
    """

    def __init__(self, folder: Path, environment: dict[str, str] | None = None, soon_s: float | None = None) -> None:
        self.ct = folder / "ct.nii.gz"
        volume = cached_phantom(spacing_mm=3.0, generations=3).volume
        write_grid(self.ct, volume.hu_zyx, volume.lps_from_ijk, what="the phantom")
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "killed_workstation.py"), *([] if soon_s is None else [str(soon_s)])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**environment_in(folder), **(environment or {})},
        )
        self.running: int | None = None

    def start(self):
        """Start a workstation, and return its process ID and a connected window."""
        self.process.stdin.write(f"{self.ct}\n")
        self.process.stdin.flush()
        self.running = pid = int(self._value_of("pid"))
        url, _, token = self._value_of("url").partition(" ")
        base = url.partition("/?")[0]
        return pid, Window(f"ws{base[4:]}/ws", token)

    def kill(self, pid: int) -> None:
        os.kill(pid, signal.SIGKILL)
        self.running = None
        assert self.process.stdout.readline().strip() == "gone"

    def _value_of(self, what: str) -> str:
        line = self.process.stdout.readline().strip()
        assert line.startswith(f"{what} "), line
        return line.partition(" ")[2]

    def end(self) -> None:
        if self.running is not None:
            os.kill(self.running, signal.SIGKILL)
        self.process.stdin.close()
        self.process.wait(WAIT_S)
        self.process.stdout.close()


class Window:
    """Client of a workstation that stores the state, the history, the pose and the messages that it receives."""

    def __init__(self, url: str, token: str) -> None:
        self._open = contextlib.ExitStack()
        bearer = {"Authorization": f"Bearer {token}"}
        self.socket = self._open.enter_context(
            connect(url, additional_headers=bearer, open_timeout=WAIT_S, close_timeout=1, max_size=1 << 26)
        )
        self.state: dict = {}
        self.history: dict = {"steps": [], "step": 0}
        self.pose: dict = {}
        self.messages: list[str] = []
        """Texts of the received notices and errors."""
        self._num_values = 0
        """Number of received answers to probes."""
        self.send(wire.encode_message(wire.ClientHello(wire.WIRE_VERSION)))

    def send(self, message: str | dict) -> None:
        self.socket.send(message if isinstance(message, str) else json.dumps(message))

    def end(self) -> None:
        self._open.close()

    def hear(self, timeout_s: float) -> bool:
        try:
            text = self.socket.recv(timeout=timeout_s)
        except TimeoutError:
            return False
        if isinstance(text, str):
            message = json.loads(text)
            if message["type"] in {"state", "history", "pose"}:
                setattr(self, message["type"], message)
            elif message["type"] in {"notice", "error"}:
                self.messages.append(message["message"])
            elif message["type"] == "value":
                self._num_values += 1
        return True

    def wait_done(self) -> None:
        """Wait until the server has handled all sent messages: it answers a probe after all earlier messages."""
        wanted = self._num_values + 1
        self.send({"type": "probe", "lps": [0.0, 0.0, 0.0]})
        self.until(lambda: self._num_values >= wanted)

    def hear_all(self) -> None:
        """Read the messages that have arrived, for at most half a second.

        On a busy machine messages may never stop.
        """
        end_s = time.monotonic() + 0.5
        while time.monotonic() < end_s and self.hear(0.01):
            pass

    def until(self, condition) -> None:
        # The total time is limited, because the messages of a running flight do not end.
        end_s = time.monotonic() + WAIT_S
        while not condition():
            assert self.hear(WAIT_S) and time.monotonic() < end_s, (self.state, self.history, self.messages)

    def wait_open(self) -> None:
        """Wait until the case is open, its airways are found and the case has been saved."""
        self.until(lambda: self.state.get("airways") == "found" and self.state["saving"]["keeps"])


def steps_of(window: Window) -> list[tuple[str, float]]:
    """Return the label and the time (seconds since 1970) of each step of the history that was not undone."""
    begun_s = window.state["saving"]["begun_s"]
    steps = window.history["steps"][: window.history["step"]]
    return [(one["label"], round(begun_s + one["at_s"], 2)) for one in steps]


def lost(before: list[tuple[str, float]], found: list[tuple[str, float]], ended_s: float) -> float:
    """Return the age of the oldest step of ``before`` that ``found`` lacks, at the time ``ended_s``, in seconds.

    The history contains at most a thousand steps, so the oldest steps may be missing without a fault.
    """
    first_s = found[0][1] if len(found) >= 900 else float("-inf")
    missing = {step for step in before if step[1] > first_s} - set(found)
    return max([ended_s - at_s for _, at_s in missing], default=0.0)
