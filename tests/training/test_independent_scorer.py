"""Tests that a second scorer, written from the definitions alone, agrees event for event on scripted flights."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from independent_scorer import independent_score
from scripted_flights import Script, at_30_hz, entering, optimal, planned, random_flight, recording_text, wall_hugging

from carina.navigate.recording import read_recording
from carina.training import find_task, flight_frames, score_flight

DRIVERS = {
    "optimal": optimal,
    "planned": planned,
    "entering": entering,
    "wall-hugging": wall_hugging,
    "random 1": lambda tree: random_flight(tree, 1),
    "random 2": lambda tree: random_flight(tree, 2),
}
COMPARED = {"clock-start", "seen", "visit", "revisit", "progress", "contact", "clock-end"}


def agrees(text, tree, wall):
    """Compare the events and values of both scorers."""
    frames = flight_frames(read_recording(io.StringIO(text), Path("flight")))
    score = score_flight(tree, wall, frames, find_task("inspect-all"))
    expected = independent_score(text, tree, wall)
    found = sorted((one.time_s, one.kind, one.name) for one in score.events if one.kind in COMPARED)
    assert found == expected.pop("events")
    values = {**score.to_json()["published"], **score.to_json()["without_mark"]}
    for name, value in expected.items():
        # Sums in another order differ in the last digits.
        assert values[name] == pytest.approx(value, rel=1e-9), name
    return score


def short_flight(tree, *names):
    script = Script(tree, speed_mm_s=30.0, hold_s=1.1)
    script.start(float(tree.root.length_mm) - 10.0)
    for name in names:
        script.inspect(name)
        script.enter(name)
    return script.poses


@pytest.mark.slow
def test_independent_scorer_agrees_on_poses_at_30_hz(chest):
    poses = at_30_hz(short_flight(chest.tree, "RB1", "RB2"))
    agrees(recording_text(poses, chest.volume, step_s=1 / 30), chest.tree, chest.wall)


@pytest.mark.slow
def test_independent_scorer_agrees_on_poses_at_random_times(chest):
    poses = at_30_hz(short_flight(chest.tree, "RB1", "RB2"))
    times_s = np.cumsum(np.random.default_rng(5).uniform(0.005, 0.08, len(poses) - 1)).tolist()
    agrees(recording_text(poses, chest.volume, times_s=times_s), chest.tree, chest.wall)


@pytest.mark.slow
def test_independent_scorer_agrees_on_parts_and_spellings_of_segments(chest):
    spellings = {"LB1+2": None, "LB3": "lb 3", "LB8": "LB7+8"}
    named = tuple(replace(one, name=spellings.get(one.name or "", one.name)) for one in chest.tree.branches)
    tree = replace(chest.tree, branches=named)
    poses = short_flight(tree, "LB1+2a", "LB1+2b", "LB3", "LB1+2a")
    score = agrees(recording_text(poses, chest.volume), tree, chest.wall)
    assert score.num_case_segments == 18
    assert "LB1+2" in score.segments_seen
    assert score.segments_revisited == 1


@pytest.mark.slow
@pytest.mark.parametrize("driver", DRIVERS)
def test_independent_scorer_agrees_event_for_event(chest, driver):
    text = recording_text(DRIVERS[driver](chest.tree), chest.volume)
    agrees(text, chest.tree, chest.wall)
