"""Tests of the comparison of a flight with an expert's flight, aligned by place."""

from __future__ import annotations

import numpy as np
import pytest
from scripted_flights import Script, recording_of

from carina.errors import NoResultError
from carina.training import compare_flights, find_task, flight_frames, score_flight
from carina.training.segments import branches_named

TASK = find_task("inspect-all")


def fly(chest, *, speed_mm_s=30.0, offset_mm=0.0, wait_s=0.0, to="BI", touch=False, task=TASK):
    script = Script(chest.tree, speed_mm_s=speed_mm_s, offset_mm=offset_mm)
    script.start()
    (bronchus,) = branches_named(chest.tree, "RMB")
    middle_mm = script.fork_mm(bronchus.id) + 0.5 * bronchus.length_mm
    script.go(bronchus.id, middle_mm)
    script.wait(wait_s)
    if touch:
        here, look = script.at(bronchus.id, middle_mm)
        for off_mm in np.linspace(0.0, 20.0, 30):
            script.add(here + off_mm * np.array([0.0, 1.0, 0.0]), look)
            if chest.wall.ball_mm(script.poses[-1][None, :3, 3])[0] < 2.4:
                break
    (branch,) = branches_named(chest.tree, to)
    script.go(branch.id, script.fork_mm(branch.id) + 0.7 * branch.length_mm)
    return score_flight(chest.tree, chest.wall, flight_frames(recording_of(script.poses, chest.volume)), task)


@pytest.fixture(scope="module")
def expert(chest):
    return fly(chest)


def test_flight_compared_with_itself_has_no_deviation(chest, expert):
    found = compare_flights(chest.tree, expert, expert)
    assert (found.deviation_mm, found.worst_mm, found.longest_stay) == (0.0, 0.0, None)
    assert found.compared_share == 1.0
    assert (found.touched_only_own, found.entered_only_own, found.entered_only_expert) == ((), (), ())


def test_flight_at_another_speed_deviates_little_because_places_are_compared(chest, expert):
    found = compare_flights(chest.tree, fly(chest, speed_mm_s=12.0), expert)
    assert found.own_time_s > 2.0 * expert.procedure_time_s
    assert found.worst_mm < 1.0
    assert found.compared_share > 0.95


def test_longest_stay_names_the_branch_in_which_the_learner_waited_with_both_times(chest, expert):
    found = compare_flights(chest.tree, fly(chest, wait_s=6.0), expert)
    assert found.longest_stay.name == "RMB"
    assert found.longest_stay.own_s - found.longest_stay.expert_s == pytest.approx(6.0, abs=0.3)
    assert any(line.startswith("longest stay beyond the expert's: 6") and "in RMB" in line for line in found.lines())


def test_deviation_is_the_distance_beside_the_experts_path(chest, expert):
    found = compare_flights(chest.tree, fly(chest, offset_mm=2.0), expert)
    assert found.deviation_mm == pytest.approx(2.0, abs=0.3)
    assert found.deviation_variance_mm2 < 0.5


def test_touch_is_stated_with_its_branch(chest, expert):
    found = compare_flights(chest.tree, fly(chest, touch=True), expert)
    assert (found.num_contacts, found.expert_contacts) == (1, 0)
    assert found.touched_only_own == ("RMB",)


def test_branches_of_only_one_flight_are_stated_and_not_compared(chest, expert):
    found = compare_flights(chest.tree, fly(chest, to="RUL"), expert)
    assert "RUL" in found.entered_only_own
    assert "BI" in found.entered_only_expert
    assert found.compared_share < 1.0
    assert any("only the expert entered BI" in line for line in found.lines())


def test_flights_of_different_tasks_are_refused(chest, expert):
    other = fly(chest, task=find_task("find-rb6"))
    with pytest.raises(NoResultError, match="expected two flights of one task; found find-rb6 and inspect-all"):
        compare_flights(chest.tree, other, expert)
