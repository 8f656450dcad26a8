"""Tests of the command ``carina score``: scores, logs, tasks and refused recordings."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
from scripted_flights import Script, recording_text

import carina as api
from cached_test_data import found_airways
from carina.cli import score as command
from carina.cli.opened import OpenedInput
from carina.training import SEGMENTS, find_task, segments_of_case, task_to_json

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def named_phantom(ct):
    """Return the small phantom of the tests of the command line, and its airways with a user's names of segments."""
    volume = api.open_volume(ct, progress=False)
    airways = found_airways(volume)
    tips = [branch for branch in airways.tree.branches if branch.generation == 3][:2]
    for branch, name in zip(tips, ("RB1", "RB2"), strict=True):
        edit = api.commands.RenameBranch(branch_id=branch.id, name=name)
        airways = api.edit_airways(volume, airways, edit, progress=False)
    return volume, airways


@pytest.fixture
def phantom(named_phantom, monkeypatch):
    monkeypatch.setattr(OpenedInput, "airways", lambda _self, _progress: named_phantom[1])
    return named_phantom


@pytest.fixture
def num_segments(phantom):
    return len(segments_of_case(phantom[1].tree))


@pytest.fixture
def absent(phantom):
    """Return the name of a segment that the phantom lacks."""
    return next(name for name in SEGMENTS if name not in {one.name for one in segments_of_case(phantom[1].tree)})


@pytest.fixture
def flight(phantom, tmp_path):
    """Return the file of a recorded flight to RB1 and RB2."""
    volume, airways = phantom
    script = Script(airways.tree)
    script.start(20.0)
    script.inspect("RB1", back_mm=6.0)
    script.inspect("RB2", back_mm=6.0)
    file = tmp_path / "flight.jsonl"
    file.write_text(recording_text(script.poses, volume))
    return file


def test_score_as_text_and_json_with_the_log(carina, ct, flight, num_segments, tmp_path):
    ended = carina("score", flight, ct, "--json", "--log", tmp_path / "log", "--learner", "learner 7")
    assert ended.code == 0, ended.err
    found = ended.json()
    assert found["format"] == "carina-score"
    assert found["published"]["num_segments"] == 18
    assert found["published"]["num_case_segments"] == num_segments < 18
    assert found["mastery"]["verdict"] is None
    assert f"the case has {num_segments} of 18 segments" in found["mastery"]["reasons"][0]
    assert [one["group"] for one in found["references"]][-1] == "autonomous robot"
    assert sorted(path.name for path in (tmp_path / "log").iterdir()) == [
        "events.csv", "poses.csv", "scores.csv", "xapi.json"
    ]  # fmt: skip
    statements = json.loads((tmp_path / "log" / "xapi.json").read_text())
    assert statements[0]["actor"]["account"]["name"] == "learner 7"
    text = carina("score", flight, ct).out
    assert f"{found['published']['diagnostic_completeness']} of 18 segments; this case has {num_segments}" in text
    assert "no verdict: it needs 6 attempts that count (Konge 2011, Respiration 81:483); found 0" in text
    assert "Source of these values: BronchoBot study on a phantom, Cold 2025; measured with another system" in text
    assert "Respiration, 10.1159/000542045); in a row: Carina's reading; the source states no order" in text


def test_earlier_attempts_are_judged_together(carina, ct, flight):
    found = carina("score", flight, ct, "--earlier", flight, "--json").json()
    assert found["mastery"]["num_attempts"] == 2
    assert "a replay of its recording" in found["mastery"]["reasons"][1][-1]


def test_task_whose_segment_the_case_lacks_is_refused(carina, ct, flight, absent, tmp_path):
    own = tmp_path / "own.json"
    task = {"format": "carina-task", "version": 1, "name": "own", "title": "Own", "kind": "find", "segments": [absent]}
    own.write_text(json.dumps(task))
    ended = carina("score", flight, ct, "--task", own)
    assert ended.code == 4
    assert f"expected a branch named {absent}" in ended.err


def test_unknown_task_and_task_file_with_an_error_are_refused(carina, ct, flight, tmp_path):
    assert "expected one of ebus-landmarks" in carina("score", flight, ct, "--task", "fly").err
    own = tmp_path / "own.json"
    own.write_text('{"format": "carina-task", "version": 1, "name": "own", "title": "Own", "kind": "find"}')
    ended = carina("score", flight, ct, "--task", own)
    assert ended.code == 2
    assert "own.json: segments: expected one segment; found ()" in ended.err


def test_recording_of_another_scan_is_refused(carina, ct, flight):
    header, rest = flight.read_text().split("\n", 1)
    other = json.loads(header)
    other["case"]["digest"] = "0" * 32
    flight.write_text(json.dumps(other) + "\n" + rest)
    ended = carina("score", flight, ct)
    assert ended.code == 3
    assert "belongs to another scan" in ended.err


def test_built_in_tasks_are_listed(carina):
    ended = carina("score", "--list-tasks")
    assert ended.code == 0
    assert "sequence-lb8-lb10" in ended.out


def test_score_is_compared_with_the_flight_of_an_expert(carina, ct, flight):
    text = carina("score", flight, ct, "--expert", flight)
    assert text.code == 0
    assert "Compared with the expert's flight, by place" in text.out
    assert "deviation from the expert's path: mean 0.0 mm" in text.out
    assert "high-error events (over 5 mm for 0.5 s or longer): 0" in text.out
    found = json.loads(carina("score", flight, ct, "--expert", flight, "--json").out)["comparison"]
    assert (found["num_high_error_events"], found["high_error_events"]) == (0, [])
    assert (found["worst_mm"], found["longest_stay"], found["compared_share"]) == (0.0, None, 1.0)


def test_own_tasks_are_listed_after_the_built_in_ones_with_the_files_that_cannot_be_used(carina, tmp_path, monkeypatch):
    own = {**task_to_json(find_task("find-rb6")), "name": "mine", "title": "Find it"}
    (tmp_path / "mine.json").write_text(json.dumps(own))
    (tmp_path / "wrong.json").write_text("{")
    monkeypatch.setattr(command, "load_settings", lambda: SimpleNamespace(tasks_dir=tmp_path))
    ended = carina("score", "--list-tasks")
    assert ended.code == 0
    assert ended.out.splitlines()[-1].split(maxsplit=1) == ["mine", "Find it"]
    assert "wrong.json: expected a JSON file with one task" in ended.err
