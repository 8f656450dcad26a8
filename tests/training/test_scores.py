"""Tests of scores on a phantom: the optimal drive, six cheats, all kinds of tasks, mastery and exports."""

from __future__ import annotations

import csv
import io
import json
import uuid
from dataclasses import replace

import numpy as np
import pytest
from scripted_flights import VIEW, Script, optimal, recording_of

from carina.cli.score import score_lines
from carina.errors import NoResultError, VolumeImportError
from carina.scopes import Pose
from carina.track import AirwayTree
from carina.track.names.name_texts import segment_of
from carina.training import (
    REFERENCE_GROUPS,
    SEGMENTS,
    AttemptDoubt,
    ScoredContact,
    Task,
    events_csv,
    find_task,
    flight_frames,
    judge_mastery,
    poses_csv,
    score_flight,
    score_recording,
    scores_csv,
    write_flight_log,
    xapi_statements,
)
from carina.training.openings_in_sight import branch_openings
from carina.training.segments import MIRRORED_SEGMENTS, branches_named
from carina.volume import Note

MIRRORED_NAMES = dict(zip(SEGMENTS, MIRRORED_SEGMENTS, strict=True))
pytestmark = pytest.mark.slow


def scored(chest, poses, *, task="inspect-all", **options):
    chosen = task if isinstance(task, Task) else find_task(task)
    return score_flight(chest.tree, chest.wall, flight_frames(recording_of(poses, chest.volume, **options)), chosen)


def flown(chest, *names, **options):
    script = Script(chest.tree, **options)
    script.start()
    for name in names:
        script.inspect(name)
    return script.poses


def codes(score):
    return [one.code for one in score.doubts]


@pytest.fixture(scope="module")
def best(chest):
    return optimal(chest.tree)


@pytest.fixture(scope="module")
def best_score(chest, best):
    return scored(chest, best)


def test_optimal_drive_has_18_segments_and_18_progressions_under_120_s(best_score):
    assert best_score.diagnostic_completeness == best_score.structured_progress == 18
    assert best_score.procedure_time_s < 120.0
    assert best_score.mean_intersegmental_time_s == pytest.approx(best_score.procedure_time_s / 18)
    assert best_score.segments_revisited == 0
    assert best_score.result.completed
    assert best_score.doubts == ()


def test_function_of_the_package_gives_the_same_score_and_refuses_other_scans(chest, best, best_score):
    recording = recording_of(best, chest.volume)
    score = score_recording(chest.volume, chest.airways, recording, wall=chest.wall, progress=False)
    assert score.to_json() == best_score.to_json()
    other = replace(recording, header=recording.header | {"case": {"shape_zyx": [1, 1, 1], "digest": "0"}})
    with pytest.raises(VolumeImportError, match="belongs to another scan"):
        score_recording(chest.volume, chest.airways, other, wall=chest.wall, progress=False)


# Six cheats.


def test_flight_through_walls_is_reported_and_sees_nothing_in_tissue(chest):
    ends = [branch_openings(chest.tree, [branches_named(chest.tree, name)[0].id])[0] for name in SEGMENTS]
    here = chest.tree.root.points[len(chest.tree.root.points) // 2]
    poses = [Pose.looking(here, (0, 0, -1)).lps_from_camera]
    inside = 0
    for end in ends:
        # The camera flies straight towards the opening and stops in the tissue beside it.
        across = np.cross(end.dir_lps, (0.0, 0.0, 1.0))
        stop = end.middle_lps + 15.0 * across / np.linalg.norm(across)
        inside += bool(chest.wall.distance_mm(stop)[0] > 0.0)
        start = poses[-1][:3, 3]
        num = int(np.ceil(np.linalg.norm(stop - start) / 8.0))
        for n in range(1, num + 1):
            at = start + (stop - start) * n / num
            poses.append(Pose.looking(at, end.middle_lps - at).lps_from_camera)
        poses += [poses[-1]] * 12
    score = scored(chest, poses)
    assert "left-airways" in codes(score)
    assert score.structured_progress <= inside
    assert score.diagnostic_completeness <= 3 + inside


def test_hop_from_one_segment_into_the_next_through_the_wall_is_reported(chest):
    script = Script(chest.tree)
    script.start()
    script.enter("RB1")
    (branch,) = branches_named(chest.tree, "RB2")
    (opening,) = branch_openings(chest.tree, [branch.id])
    there = Pose.looking(opening.middle_lps + 2.0 * opening.dir_lps, opening.dir_lps).lps_from_camera
    score = scored(chest, [*script.poses, *[there] * 8])
    assert codes(score) == ["jump"]
    assert "through the wall" in score.doubts[0].words


@pytest.mark.parametrize("clock", ["cords", "carina"])
def test_recording_that_starts_inside_a_segment_is_reported(chest, clock):
    script = Script(chest.tree)
    script.start()
    script.enter("RB1")
    inside = [script.poses[-1]] * 8
    assert codes(scored(chest, inside, task=replace(find_task("inspect-all"), clock=clock))) == ["start"]


def test_flight_that_stays_at_one_place_sees_no_segment(chest):
    script = Script(chest.tree)
    script.start(float(chest.tree.root.length_mm) - 15.0)
    script.wait(60.0)
    score = scored(chest, script.poses)
    assert score.diagnostic_completeness == 0
    assert score.structured_progress == 0
    assert score.mean_intersegmental_time_s is None


def test_alternating_views_of_two_segments_add_each_progression_once(chest):
    script = Script(chest.tree)
    script.start()
    script.inspect("RB1")
    targets = [branch_openings(chest.tree, [branches_named(chest.tree, name)[0].id])[0] for name in ("RB2", "RB1")]
    for n in range(12):
        script.look_at(targets[n % 2].middle_lps, 1.2)
    score = scored(chest, script.poses)
    assert score.structured_progress == 2
    assert score.segments_revisited == 0
    assert score.diagnostic_completeness <= 3


# At 8 mm/s the opening of RB3 is in the middle for a second on the way to RB1, so RB3 is visited first.
@pytest.mark.parametrize(("speed_mm_s", "num_steps"), [(8.0, 1), (16.0, 2), (30.0, 2)])
def test_segments_that_the_tip_enters_are_seen_and_visited_at_any_speed(chest, speed_mm_s, num_steps):
    script = Script(chest.tree, speed_mm_s=speed_mm_s, hold_s=0.8)
    script.start(float(chest.tree.root.length_mm) - 15.0)
    for name in ("RB1", "RB2"):
        script.enter(name)
    score = scored(chest, script.poses)
    assert {"RB1", "RB2"} <= set(score.segments_seen)
    assert {"RB1", "RB2"} <= {one.name for one in score.events if one.kind == "visit"}
    assert score.structured_progress == num_steps
    assert score.segments_revisited == 0


def test_only_a_second_entry_is_a_revisit(chest):
    script = Script(chest.tree, hold_s=0.8)
    script.start()
    for _ in range(2):
        script.enter("RB1")
        script.go(0, float(chest.tree.root.length_mm) - 30.0)
        script.wait(0.6)
    score = scored(chest, script.poses)
    assert score.segments_revisited == 1
    assert [(one.kind, one.detail) for one in score.events if one.name == "RB1" and "visit" in one.kind] == [
        ("visit", "entered"),
        ("revisit", "entered"),
    ]
    assert scored(chest, flown(chest, "RB1", "RB2", "RB1")).segments_revisited == 0


def flown_into(chest, *names):
    script = Script(chest.tree, hold_s=0.8)
    script.start()
    for name in names:
        script.enter(name)
    return script.poses


def test_repeated_round_of_three_segments_adds_only_revisits(chest):
    once = scored(chest, flown_into(chest, "RB1", "RB2", "RB3"))
    thrice = scored(chest, flown_into(chest, *("RB1", "RB2", "RB3") * 3))
    for name in ("diagnostic_completeness", "structured_progress"):
        assert getattr(once, name) == getattr(thrice, name) == 3
    assert (once.segments_revisited, thrice.segments_revisited) == (0, 6)


def test_replay_at_four_times_the_speed_loses_the_visits_and_does_not_count(chest, best, best_score):
    fast = scored(chest, best, step_s=0.025)
    assert fast.structured_progress == 0
    assert judge_mastery([best_score, fast]).counted == (True, False)


def test_replay_of_an_earlier_attempt_does_not_count_at_any_speed(chest, best, best_score):
    again = scored(chest, best, step_s=0.08)
    judged = judge_mastery([best_score, again])
    assert judged.counted == (True, False)
    assert judged.reasons[1] == ("the poses repeat those of attempt 1: a replay of its recording",)


def test_wide_lens_does_not_raise_the_score_and_is_reported(chest, best, best_score):
    turned = []
    for pose in best:
        # The openings are 75 degrees from the middle: outside the instrument's picture, inside that of a wide lens.
        a = np.radians(75.0)
        other = pose.copy()
        other[:3, 0], other[:3, 2] = (
            np.cos(a) * pose[:3, 0] - np.sin(a) * pose[:3, 2],
            np.sin(a) * pose[:3, 0] + np.cos(a) * pose[:3, 2],
        )
        turned.append(other)
    instrument = scored(chest, turned)
    wide = scored(chest, turned, view={"scope": None, "fov_deg": 170.0})
    assert wide.segments_seen == instrument.segments_seen
    assert wide.structured_progress == instrument.structured_progress == 0
    assert codes(wide) == ["wide-picture"]
    straight = scored(chest, best, view=VIEW | {"fov_deg": 150.0})
    assert straight.to_json()["published"] == best_score.to_json()["published"]
    assert codes(straight) == ["wide-picture"]


# Tasks.


def test_sequence_is_completed_in_its_order_only(chest):
    done = scored(chest, flown(chest, "RB4", "RB5", "RB6"), task="sequence-rb4-rb6")
    assert done.result.completed
    assert done.result.num_wrong == 0
    assert done.procedure_time_s == done.result.completed_frame / 10 < 26.0
    other = scored(chest, flown(chest, "RB6", "RB5", "RB4"), task="sequence-rb4-rb6")
    assert not other.result.completed
    assert other.result.steps_done == ("RB4",)
    assert other.result.num_wrong == 2


def test_search_counts_the_other_segments_visited_before(chest):
    score = scored(chest, flown(chest, "RB4", "RB6", "RB7"), task="find-rb6")
    assert score.result.completed
    assert score.result.num_wrong == 1
    assert "RB7" not in [one.name for one in score.events if one.kind == "visit"]


def test_turns_are_followed_or_reported_as_wrong(chest):
    target = branches_named(chest.tree, "RB10")[0].id
    script = Script(chest.tree)
    script.start()
    script.go(target, script.fork_mm(target) + 12.0)
    script.wait(0.6)
    assert scored(chest, script.poses, task="turns-to-rb10").result.completed
    wrong = Script(chest.tree)
    wrong.start()
    left = branches_named(chest.tree, "LMB")[0].id
    wrong.go(left, wrong.fork_mm(left) + 30.0)
    wrong.wait(0.6)
    result = scored(chest, wrong.poses, task="turns-to-rb10").result
    assert not result.completed
    assert result.num_wrong == 1
    assert [one.name for one in result.events] == ["LMB"]


def test_task_with_turns_that_are_not_on_one_route_is_refused(chest):
    task = replace(find_task("turns-to-rb10"), branches=("LMB", "RB10"))
    with pytest.raises(NoResultError, match="expected branches in their order on the way Trachea, RMB, BI, RLL"):
        task.check_case(chest.tree)


@pytest.mark.parametrize(("held_s", "completed"), [(4.8, False), (5.4, True)])
def test_hold_task_is_completed_only_after_its_hold_time(chest, held_s, completed):
    branch = branches_named(chest.tree, "RUL")[0]
    script = Script(chest.tree)
    script.start(float(chest.tree.root.length_mm) - 20.0)
    script.go(branch.parent, script.fork_mm(branch.id) - 8.0)
    middle = branch_openings(chest.tree, [branch.id])[0].middle_lps
    script.look_at(middle, held_s)
    score = scored(chest, script.poses, task=replace(find_task("hold-rul"), hold_s=5.3))
    assert score.result.completed is completed


def test_landmarks_of_an_inspection_are_completed_before_its_segments(chest, best):
    script = Script(chest.tree)
    script.start()
    script.go(0, float(chest.tree.root.length_mm) - 15.0)
    script.wait(0.7)
    for name in ("RUL", "BI", "LUL"):
        branch = branches_named(chest.tree, name)[0]
        opening = branch_openings(chest.tree, [branch.id])[0]
        script.go(branch.parent, script.fork_mm(branch.id) - 12.0)
        if name == "LUL":
            other = branch_openings(chest.tree, [branches_named(chest.tree, "LLL")[0].id])[0]
            script.look_at(0.5 * (opening.middle_lps + other.middle_lps), 0.8)
        else:
            script.look_at(opening.middle_lps, 0.8)
    score = scored(chest, script.poses, task="inspect-landmarks")
    assert score.result.steps_done[:4] == (
        "main carina",
        "right upper lobe",
        "bronchus intermedius",
        "left secondary carina",
    )
    assert not score.result.completed
    assert scored(chest, best, task="inspect-landmarks").structured_progress == 18


def test_segments_that_were_seen_but_not_visited_are_named(best_score):
    done = tuple(name for name in SEGMENTS if name != "RB2")
    result = replace(best_score.result, completed_frame=None, steps_done=done)
    line = score_lines(replace(best_score, result=result))[0]
    assert line.endswith("not completed, 17 of 18 steps; seen but not visited: RB2")


def test_time_limit_ends_the_attempt(chest, best):
    score = scored(chest, best, task=replace(find_task("inspect-all"), time_limit_s=10.0))
    assert score.procedure_time_s == 10.0
    assert score.events[-1].name == "time limit"
    assert 0 < score.diagnostic_completeness < 18
    assert not score.result.completed


def test_search_that_is_completed_before_the_time_limit_ends_with_the_attempt(chest):
    script = Script(chest.tree)
    script.start()
    script.inspect("RB6")
    script.wait(20.0)
    score = scored(chest, script.poses, task=replace(find_task("find-rb6"), time_limit_s=15.0))
    assert score.result.completed
    assert score.events[-1].name == "end of the attempt"


def test_contacts_after_the_tenth_are_counted_in_the_text(best_score):
    contact = ScoredContact(1.0, 0.2, "RB1", (0.0, 0.0, 0.0), 3.0)
    assert "and 2 more contacts; --json lists all of them" in score_lines(replace(best_score, contacts=(contact,) * 12))
    assert not any("more contacts" in one for one in score_lines(replace(best_score, contacts=(contact,) * 10)))


def test_text_of_a_search_names_no_verdict(best_score):
    search = replace(best_score, task=find_task("find-rb6"), doubts=(AttemptDoubt("incomplete", "cut off"),))
    assert score_lines(search)[-1] == "doubt about this attempt: cut off"
    inspection = replace(best_score, doubts=search.doubts)
    assert score_lines(inspection)[-1] == "this attempt does not count in a verdict: cut off"


def test_clock_at_the_carina_starts_later_and_keeps_the_segments(chest, best, best_score):
    score = scored(chest, best, task=replace(find_task("inspect-all"), clock="carina"))
    assert 0.0 < score.clock_start_s < 3.0
    assert score.procedure_time_s < best_score.procedure_time_s
    assert score.diagnostic_completeness == 18


def test_flight_that_is_never_in_the_airways_is_refused(chest):
    far = Pose.looking(chest.tree.root.points[0] + [100.0, 0.0, 0.0], (0, 0, -1)).lps_from_camera
    with pytest.raises(NoResultError) as refused:
        scored(chest, [far] * 5)
    assert refused.value.code == "training.not-started"


# The case's own denominator.


def without_segment(tree, name):
    ids = {branch.id for branch in tree.branches if branch.name and segment_of(branch.name) == name}
    return AirwayTree(tuple(replace(one, name=None) if one.id in ids else one for one in tree.branches))


def test_case_that_lacks_a_segment_shows_its_denominator_and_gives_no_mastery(chest):
    poses = flown(chest, *(name for name in SEGMENTS if name != "RB7"))
    frames = flight_frames(recording_of(poses, chest.volume))
    score = score_flight(without_segment(chest.tree, "RB7"), chest.wall, frames, find_task("inspect-all"))
    assert score.num_case_segments == 17
    assert score.diagnostic_completeness == score.structured_progress == 17
    assert score.notes == (
        "this case has 17 of the 18 segments; no branch has the name RB7 (absent, not found or not named)",
    )
    assert "structured progress       17 of 17; " in "\n".join(score_lines(score))
    assert judge_mastery([score]).reasons == (("the case has 17 of 18 segments",),)


def test_note_of_a_mirrored_chest_is_part_of_the_score(chest, best):
    swapped = tuple(
        replace(one, name=one.name and MIRRORED_NAMES.get(one.name, one.name)) for one in chest.tree.branches
    )
    note = Note("track.mirrored", "the airways are mirrored: check the sides", badge=True)
    tree = replace(chest.tree, branches=swapped, notes=(note,))
    score = score_flight(
        tree, chest.wall, flight_frames(recording_of(best[:40], chest.volume)), find_task("inspect-all")
    )
    assert score.num_case_segments == 18
    assert score.notes[0] == note.words
    assert "mirror image" in score.notes[1]


def test_names_that_a_person_gave_are_stated(chest, best):
    named = AirwayTree(
        tuple(replace(one, name_from="person") if one.name == "RB8" else one for one in chest.tree.branches)
    )
    frames = flight_frames(recording_of(best[:40], chest.volume))
    score = score_flight(named, chest.wall, frames, find_task("inspect-all"))
    assert score.notes == ("a person has given or confirmed the names of these branches: RB8",)


def test_uncertain_names_are_reported(chest, best):
    doubtful = AirwayTree(
        tuple(replace(one, name_confidence=0.6) if one.name == "RB8" else one for one in chest.tree.branches)
    )
    frames = flight_frames(recording_of(best[:40], chest.volume))
    score = score_flight(doubtful, chest.wall, frames, find_task("inspect-all"))
    assert codes(score) == ["uncertain-names"]
    assert "RB8 (confidence 0.60)" in score.doubts[0].words


# Mastery.


def attempts(score, *times_s):
    """Return attempts with the scores of one flight, other poses and these procedure times."""
    made = []
    for n, time_s in enumerate(times_s):
        moved = score.frames.recorded_poses + 1e-6 * (n + 1)
        made.append(replace(score, procedure_time_s=time_s, frames=replace(score.frames, recorded_poses=moved)))
    return made


@pytest.mark.parametrize(
    ("times_s", "verdict"),
    [
        ((100,) * 5, None),
        ((100,) * 6, True),
        ((130, 130, 130, 130, 119.9, 119.9), True),
        ((130, 130, 130, 130, 119.9, 120.0), False),
        ((100, 130, 100, 130, 100, 130), False),
    ],
)
def test_mastery_needs_two_passed_attempts_in_a_row_and_a_verdict_needs_six_attempts(best_score, times_s, verdict):
    judged = judge_mastery(attempts(best_score, *times_s))
    assert judged.verdict is verdict
    assert ("no verdict" in judged.words) is (verdict is None)


def test_attempt_that_does_not_count_interrupts_the_row_of_passed_attempts(best_score):
    flown_attempts = attempts(best_score, 130, 130, 130, 130, 100, 100, 100)
    flown_attempts[5] = replace(flown_attempts[5], doubts=(AttemptDoubt("incomplete", "cut off"),))
    judged = judge_mastery(flown_attempts)
    assert judged.num_counted == 6
    assert judged.verdict is False


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"clock": "carina"}, "the clock starts at the main carina, not below the cords"),
        ({"revisit_rule": "ignored"}, "a return to a segment is ignored"),
        ({"hints": ("arrow", "ghost")}, "the task gives hints (arrow, ghost)"),
    ],
)
def test_attempt_under_other_conditions_does_not_count(best_score, changed, reason):
    eased = replace(best_score, task=replace(best_score.task, **changed))
    assert judge_mastery([eased]).reasons == ((f"the conditions differ: {reason}",),)


def test_attempt_without_an_instrument_does_not_count(best_score):
    free = tuple(replace(one, is_free_camera=True) for one in best_score.frames.optics)
    flown_free = replace(best_score, frames=replace(best_score.frames, optics=free))
    expected = "the conditions differ: the flight used a camera without an instrument"
    assert judge_mastery([flown_free]).reasons == ((expected,),)


def test_recordings_of_one_pose_do_not_count(chest, best, best_score):
    empty = [scored(chest, [best[n]]) for n in range(4)]
    assert all(one.doubts == () for one in empty)
    judged = judge_mastery([*empty, *attempts(best_score, 100, 100)])
    assert judged.counted == (False,) * 4 + (True, True)
    assert judged.verdict is None
    assert judged.reasons[0] == ("no segment was seen", "the tip did not move")


def test_rule_that_carina_adds_to_the_published_definition_of_mastery_is_stated_as_added(best_score):
    document = judge_mastery([best_score]).to_json()
    assert "in a row" not in document["definition"]
    assert document["added_rule"] == "in a row: Carina's reading; the source states no order"
    assert all("not directly comparable" in one.to_json()["remark"] for one in REFERENCE_GROUPS)


def test_verdict_states_that_the_order_is_that_of_the_user(best_score):
    assert "over the recordings that you gave, in your order" in judge_mastery(attempts(best_score, *(100,) * 6)).words


def test_attempts_with_17_of_18_progressions_do_not_give_mastery(best_score):
    lower = [replace(one, structured_progress=17) for one in attempts(best_score, *(100,) * 6)]
    assert judge_mastery(lower).verdict is False


def test_attempts_with_doubts_do_not_count(chest, best, best_score):
    cut = scored(chest, best, complete=False)
    assert codes(cut) == ["incomplete"]
    judged = judge_mastery([*attempts(best_score, *(100,) * 5), cut])
    assert judged.num_counted == 5
    assert judged.verdict is None


# Exports.


def test_csv_files_contain_all_events_poses_and_scores(best_score):
    events = list(csv.DictReader(io.StringIO(events_csv(best_score))))
    assert [(float(one["time_s"]), one["kind"], one["name"]) for one in events] == [
        (one.time_s, one.kind, one.name) for one in best_score.events
    ]
    poses = list(csv.reader(io.StringIO(poses_csv(best_score))))
    assert len(poses) == 1 + len(best_score.frames.lps_from_tip)
    read = np.array(poses[-1][1:], dtype=np.float64).reshape(3, 4)
    np.testing.assert_array_equal(read, best_score.frames.lps_from_tip[-1, :3])
    values = dict(csv.reader(io.StringIO(scores_csv(best_score))))
    assert values["diagnostic_completeness"] == "18"
    assert values["contact_force_n"] == ""


def test_xapi_statements_have_the_required_properties_and_no_verdict(best_score):
    statements = xapi_statements(best_score, learner="learner 7")
    assert len({one["id"] for one in statements}) == len(statements) == 19
    for one in statements:
        uuid.UUID(one["id"])
        assert {"actor", "verb", "object", "version"} <= set(one)
        assert one["actor"]["account"]["name"] == "learner 7"
        assert all(":" in key for key in one["result"].get("extensions", {}))
        assert "success" not in one["result"]
    assert statements[0]["result"]["score"] == {"raw": 18, "min": 0, "max": 18, "scaled": 1.0}
    assert statements[0]["verb"]["id"].endswith("/completed")


def test_exports_state_that_an_attempt_does_not_count(best_score):
    doubts = (AttemptDoubt("incomplete", "cut off"), AttemptDoubt("start", "at the fork"))
    cut = replace(best_score, doubts=doubts, frames=replace(best_score.frames, complete=False))
    values = dict(csv.reader(io.StringIO(scores_csv(cut))))
    assert (values["counts_in_verdict"], values["doubts"]) == ("False", "incomplete start")
    statement = xapi_statements(cut)[0]
    assert statement["result"]["extensions"]["urn:carina:training:counts_in_verdict"] is False
    assert statement["result"]["extensions"]["urn:carina:training:doubts"] == ["incomplete", "start"]
    assert statement["result"]["completion"] is False
    assert statement["verb"]["id"].endswith("/attempted")


def test_xapi_score_of_a_search_counts_its_steps(best_score):
    result = replace(best_score.result, steps_done=("RB6",), num_steps=1)
    search = replace(best_score, task=find_task("find-rb6"), result=result, diagnostic_completeness=1)
    assert xapi_statements(search)[0]["result"]["score"] == {"raw": 1, "min": 0, "max": 1, "scaled": 1.0}


def test_xapi_identifiers_are_percent_encoded(best_score):
    own = replace(best_score, task=replace(best_score.task, name="own task / 50 %"))
    assert xapi_statements(own)[0]["object"]["id"] == "urn:carina:training:task:own%20task%20%2F%2050%20%25"


def test_flight_log_is_written_to_a_new_folder(best_score, tmp_path):
    paths = write_flight_log(tmp_path / "a" / "log", best_score)
    assert [path.name for path in paths] == ["events.csv", "poses.csv", "scores.csv", "xapi.json"]
    assert json.loads(paths[3].read_text()) == xapi_statements(best_score)
