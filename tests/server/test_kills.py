"""Carina is killed while somebody works through the wire: what it said was saved is there, whole, at the next start."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from carina.server import messages as wire
from carina.volume import write_grid
from made import made_phantom
from own_folders import environment_in

WAIT_S = 120.0
HERE = Path(__file__).parent
ROUNDED_S = 0.02
"""Times of steps are told to the millisecond and compared to the hundredth."""
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="workstations are forked")]


class Workstations:
    """Starts them one after the other over one CT and one home."""

    def __init__(self, folder: Path) -> None:
        self.ct = folder / "ct.nii.gz"
        volume = made_phantom(spacing_mm=3.0, generations=3).volume
        write_grid(self.ct, volume.hu_zyx, volume.lps_from_ijk, what="the phantom")
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "killed_workstation.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment_in(folder),
        )
        self.running: int | None = None

    def start(self):
        """Its number, and the words that its window would get."""
        self.process.stdin.write(f"{self.ct}\n")
        self.process.stdin.flush()
        self.running = pid = int(self._said("pid"))
        url, _, token = self._said("url").partition(" ")
        base = url.partition("/?")[0]
        return pid, Window(f"ws{base[4:]}/ws", token)

    def kill(self, pid: int) -> None:
        os.kill(pid, signal.SIGKILL)
        self.running = None
        assert self.process.stdout.readline().strip() == "gone"

    def _said(self, what: str) -> str:
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
    """What a window is told."""

    def __init__(self, url: str, token: str) -> None:
        self._open = contextlib.ExitStack()
        bearer = {"Authorization": f"Bearer {token}"}
        self.socket = self._open.enter_context(
            connect(url, additional_headers=bearer, open_timeout=WAIT_S, close_timeout=1, max_size=1 << 26)
        )
        self.state: dict = {}
        self.history: dict = {"steps": [], "step": 0}
        self.targets: dict = {}
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
            if message["type"] in {"state", "history"}:
                setattr(self, message["type"], message)
        return True

    def until(self, condition) -> None:
        while not condition():
            assert self.hear(WAIT_S)

    def wait_open(self) -> None:
        """The case is shown with all that was kept."""
        self.until(lambda: self.state.get("airways") == "found" and self.state["saving"]["keeps"])


def steps_of(window: Window) -> list[tuple[str, float]]:
    """What was done, and when (seconds since 1970), but for what was taken back."""
    begun_s = window.state["saving"]["begun_s"]
    steps = window.history["steps"][: window.history["step"]]
    return [(one["label"], round(begun_s + one["at_s"], 2)) for one in steps]


def work_until(window: Window, end_s: float, rng: random.Random) -> float:
    """Change things as fast as they are done; until when everything is on the disk, as the window was told."""
    saved_s = 0.0
    while time.monotonic() < end_s:
        window.send(
            rng.choice(
                [
                    {"type": "edit_keys", "edit": {"kind": "add"}},
                    {"type": "set_outline", "outline": rng.choice(["round", "octagon", "none"])},
                    {"type": "choose_route", "target_id": None, "branch_id": rng.choice([0, 1, 2])},
                    {"type": "set_shading", "on": rng.random() < 0.5},
                    {"type": "steer", "advance_mm": 1.0, "yaw_rad": 0.01, "pitch_rad": 0.0, "roll_rad": 0.0},
                ]
            )
        )
        while window.hear(0.02):
            pass
        if window.state:
            saved_s = window.state["saving"]["saved_s"] or saved_s
    return saved_s


def killed_again_and_again(folder: Path, rounds: int) -> list[float]:
    """How much was lost each time, in seconds."""
    rng = random.Random(20001)
    stations, lost_s = Workstations(folder), []
    before: list[tuple[str, float]] = []
    saved_s = 0.0
    try:
        for n in range(rounds + 1):
            pid, window = stations.start()
            window.wait_open()
            if n:
                if before:
                    window.until(lambda told=window: told.history["steps"])
                found = steps_of(window)
                # The oldest of a thousand steps go in time.
                first_s = found[0][1] if found else float("-inf")
                must = [step for step in before if first_s <= step[1] <= saved_s - ROUNDED_S]
                assert set(must) <= set(found)
                lost_s.append(max([before[-1][1] - found[-1][1], 0.0]) if found and before else 0.0)
            saved_s = work_until(window, time.monotonic() + rng.uniform(0.05, 2.5), rng)
            before = steps_of(window) if window.history["steps"] else []
            stations.kill(pid)
            with contextlib.suppress(ConnectionClosed):
                window.end()
    finally:
        stations.end()
    return lost_s


def test_a_dozen_kills_lose_nothing_that_was_said_to_be_saved(tmp_path):
    killed_again_and_again(tmp_path, 12)


@pytest.mark.soak
def test_two_hundred_kills_lose_nothing_that_was_said_to_be_saved(tmp_path):
    lost_s = killed_again_and_again(tmp_path, 200)
    print(f"lost: median {sorted(lost_s)[100]:.2f} s, at most {max(lost_s):.2f} s")
