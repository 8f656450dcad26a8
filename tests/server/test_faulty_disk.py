"""Tests of a real workstation on a disk that stalls, is full, fails, is read-only or loses power."""

from __future__ import annotations

import contextlib
import os
import random
import sys
import time
from pathlib import Path

import pytest
from forked_workstations import WAIT_S, Window, Workstations, lost, steps_of
from websockets.exceptions import ConnectionClosed

from carina.case import CaseFile
from faulty_disk import FAULTS, STALL, FaultyDisk, has_compiler

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not sys.platform.startswith("linux") or not has_compiler(), reason="needs Linux and a C compiler"
    ),
]
SOON_S = 0.3
"""Time in s after which these tests treat a disk as not responding (2.5 s in the product)."""
POINTS = int(os.environ.get("CARINA_FAULT_POINTS", "200"))
ROUNDED_S = 0.02
"""Rounding of the times of steps, seconds: they are sent in milliseconds and compared in hundredths of a second."""
ACTS = (
    lambda rng: {"type": "edit_key_frames", "edit": {"kind": "add"}},
    lambda rng: {"type": "set_outline", "outline": rng.choice(["round", "octagon", "none"])},
    lambda rng: {"type": "choose_route", "target_id": None, "branch_id": rng.choice([0, 1, 2])},
    lambda rng: {"type": "set_shading", "on": rng.random() < 0.5},
    lambda rng: {"type": "steer", "advance_mm": 1.0, "yaw_rad": 0.01, "pitch_rad": 0.0, "roll_rad": 0.0},
)


class Faults:
    """Workstations on a faulty disk, one after the other with the same user folders."""

    def __init__(self, folder: Path) -> None:
        self.disk = FaultyDisk(folder)
        self.home, self.elsewhere, self.copies = folder / "home", folder / "elsewhere", folder / "copies"
        for made in (self.home, self.elsewhere, self.copies):
            made.mkdir()
        self.stations = Workstations(self.home, self.disk.environment, SOON_S)
        self.reported_s: list[float] = []
        """Seconds from the beginning of each fault to its message in the window."""

    def start(self) -> tuple[int, Window]:
        pid, window = self.stations.start()
        window.wait_open()
        window.until(lambda: window.pose)
        return pid, window

    def kill(self, pid: int, window: Window) -> None:
        self.stations.kill(pid)
        with contextlib.suppress(ConnectionClosed):
            window.end()

    def work_until(self, window: Window, rng: random.Random, has_ended) -> None:
        """Send changes until ``has_ended`` returns True; each change is handled before the next is sent."""
        end_s = time.monotonic() + WAIT_S
        while not has_ended():
            assert time.monotonic() < end_s, "the disk is not used"
            window.send(rng.choice(ACTS)(rng))
            window.wait_done()

    def end(self) -> None:
        self.disk.heal()
        self.stations.end()


def assert_holds(found: list[tuple[str, float]], must: list[tuple[str, float]]) -> None:
    """Assert that ``found`` contains all steps, except the oldest if the history has its limit of a thousand steps."""
    first_s = found[0][1] if len(found) >= 900 else float("-inf")
    assert {step for step in must if step[1] > first_s} <= set(found)


def change(window: Window) -> None:
    """Add a step to the history in any state of history and outline."""
    for outline in ("round", "octagon"):
        window.send({"type": "set_outline", "outline": outline})


def goes_on(window: Window) -> None:
    """Assert that the workstation executes a command and a movement of the tip."""
    num_steps, pose_id = len(window.history["steps"]), window.pose["pose_id"]
    change(window)
    window.until(lambda: len(window.history["steps"]) > num_steps or len(window.history["steps"]) >= 1000)
    window.send({"type": "steer", "advance_mm": 0.5, "yaw_rad": 0.01, "pitch_rad": 0.0, "roll_rad": 0.0})
    window.until(lambda: window.pose["pose_id"] > pose_id)


def until_saved(window: Window, since_s: float) -> None:
    """Wait until the window reports that all steps up to the time ``since_s`` are saved."""
    end_s = time.monotonic() + WAIT_S
    change(window)
    while (window.state["saving"]["saved_s"] or 0.0) < since_s + ROUNDED_S or window.state["saving"][
        "problem"
    ] is not None:
        assert time.monotonic() < end_s, window.state["saving"]
        # The window receives the save time at least every minute, else only with other changes of the state. A further
        # change ensures that it is sent even if the first step was saved within the rounding of the times.
        change(window)
        window.hear(0.2)


def saved_elsewhere(faults: Faults, window: Window, name: str) -> None:
    """During the fault, save the case to a folder on another disk, and assert that the file contains all steps."""
    path = faults.elsewhere / f"{name}.carina"
    steps = [(step["label"], step["at_s"]) for step in window.history["steps"]]
    window.messages.clear()
    window.send({"type": "save_case", "path": str(path), "replace": True})
    window.until(lambda: any(text.startswith("saved as") for text in window.messages))
    with CaseFile.open(path, read_only=True) as case:
        assert_holds([(step.label, round(step.at_s, 3)) for step in case.history()], steps)
    path.unlink()


def fails_at(faults: Faults, kind: str, rng: random.Random, n: int) -> None:
    """Start a fault at a random change, end the fault, and kill the program.

    Assert that the next start has all saved steps.
    """
    disk = faults.disk
    pid, window = faults.start()
    disk.begin(FAULTS[kind], rng.randrange(1, 120), faults.home / "data")
    faults.work_until(window, rng, lambda: disk.is_faulty)
    met_s = time.monotonic()
    goes_on(window)
    window.until(lambda: window.state["saving"]["problem"] is not None)
    faults.reported_s.append(time.monotonic() - met_s)
    goes_on(window)
    if n % 2:
        saved_elsewhere(faults, window, f"{kind}-{n}")
        goes_on(window)
    disk.heal()
    before = steps_of(window)
    until_saved(window, time.time())
    faults.kill(pid, window)
    pid, window = faults.start()
    window.until(lambda: window.history["steps"] or not before)
    assert_holds(steps_of(window), before)
    faults.kill(pid, window)


def loses_power(faults: Faults, rng: random.Random, *, any_part: bool) -> float:
    """Cut the power at a random change, and return the age of the oldest lost step in seconds.

    The power cut loses all changes of files that were not synchronised; with ``any_part`` it loses a random part of
    them.
    """
    disk, data = faults.disk, faults.home / "data"
    disk.heal()
    durable = disk.record(data)
    pid, window = faults.start()
    disk.begin(STALL, rng.randrange(1, 150), data)
    saved_s = 0.0
    end_s = time.monotonic() + WAIT_S
    while not disk.is_stalled:
        assert time.monotonic() < end_s, "the disk is not used"
        window.send(rng.choice(ACTS)(rng))
        window.wait_done()
        if not disk.is_stalled:
            saved_s = window.state["saving"]["saved_s"] or saved_s
    before, cut_s = steps_of(window) if window.history["steps"] else [], time.time()
    faults.kill(pid, window)
    disk.end_record()
    disk.heal()
    durable.read()
    durable.restore(rng if any_part else None)
    pid, window = faults.start()
    if [step for step in before if step[1] <= saved_s - ROUNDED_S]:
        window.until(lambda: window.history["steps"])
    assert not [text for text in window.messages if "could not be read" in text]
    found = steps_of(window) if window.history["steps"] else []
    assert_holds(found, [step for step in before if step[1] <= saved_s - ROUNDED_S])
    faults.kill(pid, window)
    return lost(before, found, cut_s)


@pytest.fixture
def faults(tmp_path):
    made = Faults(tmp_path)
    yield made
    made.end()


@pytest.mark.parametrize("kind", FAULTS)
def test_session_continues_on_a_faulty_disk_and_its_changes_are_saved_when_the_disk_recovers(faults, kind):
    rng = random.Random(7)
    for n in range(2):
        fails_at(faults, kind, rng, n)


def test_changes_reported_as_saved_are_restored_after_a_power_cut(faults):
    rng = random.Random(8)
    for n in range(4):
        loses_power(faults, rng, any_part=n % 2 == 1)


@pytest.mark.soak
@pytest.mark.parametrize("kind", FAULTS)
def test_session_continues_on_a_disk_that_fails_at_two_hundred_points(faults, kind):
    rng = random.Random(20001)
    for n in range(POINTS):
        fails_at(faults, kind, rng, n)
    reported_s = sorted(faults.reported_s)
    print(f"{kind}: reported after {reported_s[POINTS // 2]:.2f} s (median), {reported_s[-1]:.2f} s at most")


@pytest.mark.soak
def test_changes_reported_as_saved_are_restored_after_two_hundred_power_cuts(faults):
    rng = random.Random(20001)
    lost_s = sorted(loses_power(faults, rng, any_part=n % 2 == 1) for n in range(POINTS))
    print(f"power cut: lost {lost_s[POINTS // 2]:.2f} s in the middle, {lost_s[-1]:.2f} s at most")
