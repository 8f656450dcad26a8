"""Tests of kills of Carina during work: the next start has all work that was reported as saved."""

from __future__ import annotations

import contextlib
import os
import random
import time
from pathlib import Path

import pytest
from forked_workstations import Window, Workstations, lost, steps_of
from websockets.exceptions import ConnectionClosed

ROUNDED_S = 0.02
"""Rounding of the times of steps, seconds: they are sent in milliseconds and compared in hundredths of a second."""
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="workstations are forked")]


def work_until(window: Window, end_s: float, rng: random.Random) -> float:
    """Send changes until ``end_s``; return the time up to which the window reported all changes as saved."""
    saved_s = 0.0
    while time.monotonic() < end_s:
        window.send(
            rng.choice(
                [
                    {"type": "edit_key_frames", "edit": {"kind": "add"}},
                    {"type": "set_outline", "outline": rng.choice(["round", "octagon", "none"])},
                    {"type": "choose_route", "target_id": None, "branch_id": rng.choice([0, 1, 2])},
                    {"type": "set_shading", "on": rng.random() < 0.5},
                    {"type": "steer", "advance_mm": 1.0, "yaw_rad": 0.01, "pitch_rad": 0.0, "roll_rad": 0.0},
                ]
            )
        )
        window.hear_all()
        if window.state:
            saved_s = window.state["saving"]["saved_s"] or saved_s
    return saved_s


def killed_again_and_again(folder: Path, rounds: int) -> list[float]:
    """Kill ``rounds`` workstations one after the other, and return the age of the oldest lost step of each kill, s."""
    rng = random.Random(20001)
    stations, lost_s = Workstations(folder), []
    before: list[tuple[str, float]] = []
    saved_s = killed_s = 0.0
    try:
        for n in range(rounds + 1):
            pid, window = stations.start()
            window.wait_open()
            if n:
                # If the workstation was killed before anything was saved, there are no steps to wait for.
                if any(at_s <= saved_s - ROUNDED_S for _, at_s in before):
                    window.until(lambda observed=window: observed.history["steps"])
                found = steps_of(window)
                # The history contains at most a thousand steps, so the oldest may be missing without a fault.
                first_s = found[0][1] if found else float("-inf")
                must = [step for step in before if first_s <= step[1] <= saved_s - ROUNDED_S]
                assert set(must) <= set(found)
                lost_s.append(lost(before, found, killed_s))
            saved_s = work_until(window, time.monotonic() + rng.uniform(0.05, 2.5), rng)
            before = steps_of(window) if window.history["steps"] else []
            killed_s = time.time()
            stations.kill(pid)
            with contextlib.suppress(ConnectionClosed):
                window.end()
    finally:
        stations.end()
    return lost_s


def test_six_kills_of_the_workstation_lose_no_change_that_was_reported_as_saved(tmp_path):
    killed_again_and_again(tmp_path, 6)


@pytest.mark.soak
def test_two_hundred_kills_of_the_workstation_lose_no_change_that_was_reported_as_saved(tmp_path):
    lost_s = killed_again_and_again(tmp_path, 200)
    print(f"lost: median {sorted(lost_s)[100]:.2f} s, at most {max(lost_s):.2f} s")
