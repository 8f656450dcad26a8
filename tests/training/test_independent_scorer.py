"""Tests that a second scorer, written from the definitions alone, agrees event for event on scripted flights."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from independent_scorer import independent_score
from scripted_flights import entering, optimal, planned, random_flight, recording_text, wall_hugging

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


@pytest.mark.slow
@pytest.mark.parametrize("driver", DRIVERS)
def test_independent_scorer_agrees_event_for_event(chest, driver):
    text = recording_text(DRIVERS[driver](chest.tree), chest.volume)
    frames = flight_frames(read_recording(io.StringIO(text), Path("flight")))
    score = score_flight(chest.tree, chest.wall, frames, find_task("inspect-all"))
    expected = independent_score(text, chest.tree, chest.wall)
    found = sorted((one.time_s, one.kind, one.name) for one in score.events if one.kind in COMPARED)
    assert found == expected.pop("events")
    values = {**score.to_json()["published"], **score.to_json()["without_mark"]}
    for name, value in expected.items():
        # Sums in another order differ in the last digits.
        assert values[name] == pytest.approx(value, rel=1e-9), name
