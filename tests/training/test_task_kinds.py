"""Tests of the task kinds pass, stations and reach, of pauses, and of the quiz with three slices."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scripted_flights import STEP_S, Script, recording_of, recording_text

from carina.errors import NoResultError, UsageError, VolumeImportError
from carina.navigate.recording import read_recording
from carina.scopes import Pose
from carina.training import Task, find_task, flight_frames, quiz_questions, score_flight
from carina.training.openings_in_sight import branch_openings
from carina.training.segments import branches_named
from carina.training.task import landmarks_of


def scored(chest, poses, task):
    return score_flight(chest.tree, chest.wall, flight_frames(recording_of(poses, chest.volume)), task)


def kinds(score):
    return [one.kind for one in score.events]


def into_right_main_bronchus(chest, *, touch=False, again=False):
    """Return the poses of a flight past the carina, which touches the wall behind it, and is flown again."""
    script = Script(chest.tree, speed_mm_s=30.0)
    script.start()
    (branch,) = branches_named(chest.tree, "RMB")
    end_mm = script.fork_mm(branch.id) + 0.7 * branch.length_mm
    if touch:
        touch_mm = script.fork_mm(branch.id) - 1.0
        script.go(branch.id, touch_mm)
        here, look = script.at(branch.id, touch_mm)
        for off_mm in np.linspace(0.0, 20.0, 15):
            beside = here + off_mm * np.array([0.0, 1.0, 0.0])
            script.add(beside, look)
            if chest.wall.ball_mm(beside[None])[0] < 2.4:
                break
    script.go(branch.id, end_mm)
    script.wait(0.8)
    if again:
        script.go(0, 50.0)
        script.wait(0.8)
        script.go(branch.id, end_mm)
        script.wait(0.8)
    return script.poses


@pytest.mark.parametrize(
    ("touch", "again", "completed", "wrong"), [(False, False, True, 0), (True, False, False, 1), (True, True, True, 1)]
)
def test_carina_is_passed_only_without_a_touch_since_the_trachea(chest, touch, again, completed, wrong):
    score = scored(chest, into_right_main_bronchus(chest, touch=touch, again=again), find_task("pass-carina"))
    assert (score.result.completed, score.result.num_wrong) == (completed, wrong)
    assert len(score.contacts) == wrong


@pytest.mark.parametrize(
    ("off_mm", "turn_deg", "seconds", "located"),
    [(9.5, 44.0, 1.1, True), (10.5, 0.0, 1.1, False), (0.0, 46.0, 1.1, False), (0.0, 0.0, 0.8, False)],
)
def test_station_is_located_near_its_landmark_with_the_upper_side_towards_it(chest, off_mm, turn_deg, seconds, located):
    task = replace(find_task("ebus-landmarks"), stations=("4R",))
    (landmark,) = landmarks_of(chest.tree, task)["4R"]
    ahead = chest.tree.root.points[-1] - chest.tree.root.points[0]
    up = np.array(landmark.direction_lps)
    forward = ahead - (ahead @ up) * up
    forward /= np.linalg.norm(forward)
    angle = np.radians(turn_deg)
    turned = np.cos(angle) * up + np.sin(angle) * np.cross(up, forward)
    near = np.eye(4)
    near[:3, :3] = np.stack([np.cross(-turned, forward), -turned, forward], axis=1)
    near[:3, 3] = np.array(landmark.point_lps) - off_mm * forward
    away = near.copy()
    away[:3, :3] = near[:3, :3] @ np.diag([-1.0, -1.0, 1.0])
    poses = [away] * 5 + [near] * round(seconds / STEP_S + 1) + [away] * 5
    score = scored(chest, poses, task)
    assert score.result.completed == located
    assert ("station" in kinds(score)) == located


@pytest.mark.parametrize(("off_mm", "turn_deg", "reached"), [(4.5, 28.0, True), (5.5, 0.0, False), (0.0, 32.0, False)])
def test_target_is_reached_at_the_planned_place_with_the_aim_ahead(chest, off_mm, turn_deg, reached):
    script = Script(chest.tree)
    place, look = script.at(0, 60.0)
    aim = place + 40.0 * look
    task = replace(find_task("reach-target"), place_lps=tuple(place), aim_lps=tuple(aim))
    here = place - off_mm * look
    side = np.cross(look, [0.0, 1.0, 0.0])
    angle = np.radians(turn_deg)
    pose = Pose.looking(here, np.cos(angle) * look + np.sin(angle) * side / np.linalg.norm(side)).lps_from_camera
    score = scored(chest, [Pose.looking(here - 20.0 * look, look).lps_from_camera] * 3 + [pose] * 15, task)
    assert score.result.completed == reached
    assert ("reached" in kinds(score)) == reached


def test_case_without_the_structure_of_a_task_is_refused(chest):
    with pytest.raises(NoResultError, match="expected a chosen route to a planned target; found none") as refused:
        find_task("reach-target").check_case(chest.tree)
    assert refused.value.code == "training.no-plan"
    missing = replace(find_task("ebus-landmarks"), stations=("4R", "11Ls"))
    with pytest.raises(
        NoResultError, match="expected the airways next to station 11Ls; found the stations 4R"
    ) as refused:
        missing.check_case(chest.tree)
    assert refused.value.code == "training.no-branch"


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "pass"}, "branches: expected one branch or more"),
        ({"kind": "stations"}, "stations: expected one station or more"),
        ({"kind": "stations", "stations": ("4R", "4R")}, "stations: expected each station once"),
        ({"kind": "stations", "stations": ("5",)}, r"stations\[0\]: expected one of 4R"),
        ({"kind": "find", "segments": ("RB6",), "place_lps": (0.0, 0.0, 0.0)}, "place_lps: expected none for the kind"),
        ({"kind": "reach", "place_lps": (0.0, 0.0, 0.0)}, "aim_lps: expected three numbers"),
    ],
)
def test_task_with_contradicting_fields_is_refused(values, message):
    with pytest.raises(UsageError, match=message):
        Task("own", "Own task", **values)


def test_paused_flight_excludes_the_pause_and_does_not_count(chest):
    script = Script(chest.tree)
    script.start()
    script.go(0, 70.0)
    lines = recording_text(script.poses, chest.volume).splitlines()
    pause = ['{"t":0.0,"paused":true}', '{"t":0.0,"paused":false,"pause_s":12.5}']
    begin = next(n for n, line in enumerate(lines) if line.startswith('{"t"') and '"move"' in line)

    def score_of(extra):
        text = "\n".join([*lines[:begin], *extra, *lines[begin:]]) + "\n"
        return score_flight(
            chest.tree, chest.wall, flight_frames(read_recording(io.StringIO(text), Path("flight"))),
            find_task("inspect-all"),
        )  # fmt: skip

    plain, paused = score_of([]), score_of(pause)
    assert plain.doubts == ()
    assert [one.words for one in paused.doubts] == ["the attempt was paused once, for 12 s in total"]
    assert paused.procedure_time_s == plain.procedure_time_s
    with pytest.raises(VolumeImportError, match="contains an invalid pause"):
        score_of([json.dumps({"t": 0.0, "paused": False, "pause_s": -1})])


def test_three_slices_meet_beyond_the_opening_of_the_right_answer(chest):
    questions = quiz_questions(chest.tree, chest.wall, "slices", num=6, seed=3)
    assert len(questions) >= 3
    for question in questions:
        branch = chest.tree.nearest_branch(question.place_lps)[0]
        (opening,) = branch_openings(chest.tree, [branch.id])
        way = question.pose.lps_from_camera[:3, :3].T @ (opening.middle_lps - question.pose.position_lps)
        hour = round(np.degrees(np.arctan2(way[0], -way[1])) / 30.0) % 12 or 12
        assert question.answer == f"{hour} o'clock"
        assert question.answer in question.choices
        assert len(set(question.choices)) == len(chest.tree.branch(branch.parent).children)
    assert questions[0].choices == quiz_questions(chest.tree, chest.wall, "slices", num=1, seed=3)[0].choices
