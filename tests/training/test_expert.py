"""Tests of the comparison of a flight with an expert's flight, aligned by place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scripted_flights import Script, recording_of

from carina.errors import NoResultError
from carina.session.training.scores import high_error_moments
from carina.training import compare_flights, find_task, flight_frames, score_flight
from carina.training.expert import HIGH_ERROR_MM, _high_error_periods
from carina.training.segments import branches_named

TASK = find_task("inspect-all")


def fly(chest, *, speed_mm_s=30.0, offset_mm=0.0, wait_s=0.0, to="BI", touch=False, aside_mm=(), task=TASK):
    """Fly to a branch and score the flight; ``aside_mm`` are distances beside the centreline, one for each frame."""
    script = Script(chest.tree, speed_mm_s=speed_mm_s, offset_mm=offset_mm)
    script.start()
    here, look = script.at(0, 40.0)
    for off_mm in aside_mm:
        script.add(here + off_mm * np.array([1.0, 0.0, 0.0]), look)
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


def periods(*runs, at_mm=HIGH_ERROR_MM + 0.01):
    """Return the first and last frames of the high-error events, for lengths of low and high periods in turn."""
    deviations = np.concatenate([np.full(length, at_mm if n % 2 else 1.0) for n, length in enumerate(runs)])
    return [found[:2] for found in _high_error_periods(deviations)]


def test_high_error_event_needs_more_than_5_mm():
    assert periods(3, 9, 3, at_mm=5.0) == []
    assert periods(3, 9, 3, at_mm=np.nextafter(5.0, 6.0)) == [(3, 11)]


def test_high_error_event_needs_half_a_second():
    assert periods(3, 4, 3) == []
    assert periods(3, 5, 3) == [(3, 7)]


def test_high_error_periods_less_than_half_a_second_apart_are_one_event():
    assert periods(0, 6, 4, 7, 2) == [(0, 16)]
    assert periods(0, 6, 5, 7, 2) == [(0, 5), (11, 17)]


def test_high_error_periods_are_joined_before_their_duration_is_tested():
    assert periods(1, 2, 1, 2) == [(1, 5)], "5 frames with the frame between both periods"
    assert periods(1, 2, 5, 2) == []


def test_high_error_event_contains_no_frame_without_a_deviation():
    deviations = np.array([np.nan] * 3 + [6.0, 7.0, 9.0, 6.0, 6.0] + [np.nan] * 9)
    assert _high_error_periods(deviations) == [(3, 7, 5)]
    assert _high_error_periods(np.full(20, np.nan)) == []
    assert _high_error_periods(np.zeros(0)) == []


def test_high_error_events_have_time_duration_largest_deviation_and_branch(chest, expert):
    aside_mm = [*[6.0] * 6, 7.0, *[6.0] * 3, *[0.0] * 5, *[5.5] * 5]
    own = fly(chest, aside_mm=aside_mm)
    found = compare_flights(chest.tree, own, expert)
    # The first frame is that of the start.
    assert found.num_high_error_events == 2
    first, second = found.high_error_events
    assert (first.start_s, first.duration_s) == pytest.approx((0.1, 1.0))
    assert (second.start_s, second.duration_s) == pytest.approx((1.6, 0.5))
    assert (first.worst_mm, second.worst_mm) == pytest.approx((7.0, 5.5), abs=0.05)
    assert first.worst_s == pytest.approx(0.7)
    assert {first.branch, second.branch} == {chest.tree.root.name}
    assert found.to_json()["num_high_error_events"] == 2
    assert found.to_json()["high_error_events"][0] == first.to_json()
    (line,) = [one for one in found.lines() if one.startswith("high-error events")]
    assert line.startswith("high-error events (over 5 mm for 0.5 s or longer): 2; longest 1.0 s after 0.1 s, ")
    assert line.endswith(f"up to 7.0 mm in {chest.tree.root.name}")


def test_moments_of_a_comparison_are_the_largest_high_error_events_in_the_order_of_time(chest, expert):
    aside_mm = [mm for most in (6.0, 5.2, 7.0, 6.5) for mm in (*[most] * 5, *[0.0] * 5)]
    found = compare_flights(chest.tree, fly(chest, aside_mm=aside_mm), expert)
    assert found.num_high_error_events == 4
    moments = high_error_moments(found)
    assert [one.time_s for one in moments] == pytest.approx([0.1, 2.1, 3.1])
    assert moments[1].words == f"high-error event: {chest.tree.root.name}, up to 7.0 mm, 0.5 s"


def test_flight_without_common_places_has_no_number_of_high_error_events(chest, expert):
    found = compare_flights(chest.tree, expert, expert)
    assert (found.num_high_error_events, found.high_error_events) == (0, ())
    unknown = replace(found, deviation_mm=None)
    assert unknown.num_high_error_events is None
    assert unknown.to_json()["num_high_error_events"] is None
    assert not any("high-error" in line for line in unknown.lines())


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
