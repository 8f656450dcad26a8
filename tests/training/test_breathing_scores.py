"""Tests of scores of flights in a simulated breathing: those of the moved patient, and no change at amplitude 0."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scripted_flights import Script, recording_text

from carina.breathing import Breathing, ChestFrame, ChestMotion
from carina.errors import VolumeImportError
from carina.navigate.recording import read_recording
from carina.scopes import Pose, WallField
from carina.session.training.live_attempt import LiveAttempt
from carina.training import find_task, flight_frames, score_flight
from carina.training.flight_frames import KnownFrames
from carina.training.handling import CentrelineIndex, tip_places
from carina.training.mastery import judge_mastery
from carina.training.openings_in_sight import BranchOpening, branch_openings, openings_in_sight
from carina.training.segments import segments_of_case


@pytest.fixture(scope="module")
def text(chest):
    """Return the recording of a short flight past two segments."""
    script = Script(chest.tree, speed_mm_s=40.0, hold_s=1.2)
    script.start(float(chest.tree.root.length_mm) - 20.0)
    for name in ("RB1", "RB2"):
        script.inspect(name)
    return recording_text(script.poses, chest.volume)


def with_breathing(text: str, chest, breathing: Breathing | None, *, at_s: float = 0.0, began_s: float = 0.0) -> str:
    """Return a recording with a line that states a breathing, or its end, at a time."""
    motion = None if breathing is None else ChestMotion(breathing, ChestFrame.of_tree(chest.tree), began_s).to_json()
    lines = text.splitlines()
    place = 1 + sum(json.loads(line).get("t", 0.0) < at_s for line in lines[1:-1])
    return "\n".join([*lines[:place], json.dumps({"t": at_s, "breathing": motion}), *lines[place:]]) + "\n"


def read(text: str):
    return read_recording(io.StringIO(text), Path("flight"))


def scored(text: str, chest):
    return score_flight(chest.tree, chest.wall, flight_frames(read(text)), find_task("inspect-all"))


def plain(score) -> dict:
    """Return a score as JSON, without its notes."""
    return {name: value for name, value in score.to_json().items() if name != "notes"}


def test_breathing_of_amplitude_0_changes_no_bit_of_the_score(text, chest):
    without, still = scored(text, chest), scored(with_breathing(text, chest, Breathing.of_movement(0.0, 3.6)), chest)
    assert plain(still) == plain(without)
    assert not without.notes or "breathing" not in " ".join(without.notes)
    assert any("simulated breathing, 0 mm every 3.6 s" in note for note in still.notes)


def test_openings_in_sight_of_a_moved_patient_are_those_of_the_explicitly_moved_airways(text, chest, monkeypatch):
    moved = Breathing.of_movement(40.0, 3.6).at(1.8, ChestFrame.of_tree(chest.tree))
    still = flight_frames(read(text))
    breathing = flight_frames(read(with_breathing(text, chest, Breathing())))
    monkeypatch.setattr(ChestMotion, "at", lambda _motion, _clock_s: moved)
    carried = replace(still, lps_from_tip=breathing.cameras())
    ids = [one.branch_ids[0] for one in segments_of_case(chest.tree)]
    openings = branch_openings(chest.tree, ids, chest.wall)
    matrix = moved.lps_from_rest[:3, :3]
    explicit = []
    for one in openings:
        normal = np.linalg.solve(matrix.T, one.dir_lps)
        # The radius gives the area of the moved opening, whose outline is an ellipse.
        radius_mm = one.radius_mm * np.sqrt(np.linalg.det(matrix) * np.linalg.norm(normal))
        middle = moved.points(one.middle_lps)[0]
        explicit.append(BranchOpening(one.branch_id, one.name, middle, normal / np.linalg.norm(normal), radius_mm))
    limits = {"first": 0, "last": len(still.lps_from_tip) - 1}
    found = openings_in_sight(breathing, openings, chest.wall, **limits)
    true = openings_in_sight(carried, explicit, chest.wall.deformed(moved), **limits)
    assert true.in_sight.sum() > 50
    assert (found.in_sight != true.in_sight).sum() < 0.03 * true.in_sight.sum()
    both = found.in_sight & true.in_sight
    off = np.abs(found.off_middle[both] - true.off_middle[both])
    # Without the map the openings are elsewhere in the picture, so that this test can fail.
    rest = openings_in_sight(still, openings, chest.wall, **limits)
    both = rest.in_sight & true.in_sight
    assert off.mean() < 0.2 * np.abs(rest.off_middle[both] - true.off_middle[both]).mean()
    places, moved_places = (
        tip_places(frames, CentrelineIndex(tree))
        for frames, tree in ((breathing, chest.tree), (carried, chest.tree.deformed(moved)))
    )
    assert np.mean(places.lumen_in_middle == moved_places.lumen_in_middle) > 0.95


@pytest.fixture(scope="module")
def beside_wall(chest):
    """Return a function that returns a pose with a free space of some mm between tip and wall of the trachea."""
    points = chest.tree.root.points
    at = points[len(points) // 2]
    middle = Pose.looking(at, points[len(points) // 2 + 2] - at).lps_from_camera
    reach = np.arange(0.0, 12.0, 0.05)
    space_mm = chest.wall.ball_mm(middle[:3, 3] + reach[:, None] * middle[:3, 0]) - 2.45

    def pose(free_mm: float) -> np.ndarray:
        moved = middle.copy()
        moved[:3, 3] += reach[int(np.argmax(space_mm < free_mm))] * middle[:3, 0]
        return moved

    return pose


COUGH = Breathing(craniocaudal_mm=0.0, anteroposterior_mm=0.0, coughs_s=(1.0,))
"""A cough from 1 to 1.5 s, which narrows the trachea by a third."""


def test_cough_that_moves_the_wall_to_a_resting_tip_is_no_contact_of_the_trainee(chest, beside_wall):
    text = with_breathing(recording_text([beside_wall(0.5)] * 30, chest.volume), chest, COUGH)
    frames = flight_frames(read(text))
    assert (frames.tips_to_wall_mm(chest.wall, ball=True) <= 2.45).any(), "the wall does not reach the tip"
    score = scored(text, chest)
    assert score.contacts == ()
    assert score.contact_time_s == 0.0


def test_touch_by_a_cough_counts_from_the_movement_of_the_tip_during_it(chest, beside_wall):
    poses = [beside_wall(0.5)] * 12 + [beside_wall(0.4)] * 18
    text = recording_text(poses, chest.volume)
    assert scored(text, chest).contacts == ()
    (touch,) = scored(with_breathing(text, chest, COUGH), chest).contacts
    assert 1.15 < touch.time_s < 1.5
    assert touch.duration_s <= 0.3
    # A breathing that begins later on the clock of the recording coughs after the movement, and one that has ended
    # never coughs.
    assert scored(with_breathing(text, chest, COUGH, began_s=0.5), chest).contacts == ()
    ended = with_breathing(with_breathing(text, chest, COUGH), chest, None, at_s=0.5)
    assert scored(ended, chest).contacts == ()


def test_touch_by_the_trainee_counts_until_the_wall_leaves_the_resting_tip(chest, beside_wall):
    poses = [beside_wall(0.5)] * 5 + [beside_wall(0.0)] * 25
    text = recording_text(poses, chest.volume)
    (still,) = scored(text, chest).contacts
    assert still.duration_s > 2.0
    (touch,) = scored(with_breathing(text, chest, COUGH), chest).contacts
    assert (touch.time_s, touch.duration_s) == (still.time_s, still.duration_s)


def test_attempt_in_a_breathing_patient_states_it_and_does_not_count_for_mastery(text, chest):
    score = scored(with_breathing(text, chest, Breathing()), chest)
    (reasons,) = judge_mastery([score]).reasons
    assert "the conditions differ: the patient breathed (simulated breathing)" in reasons


@pytest.mark.parametrize(
    "change",
    [{"began_s": "soon"}, {"top_z_mm": -1e4}, {"breathing": {}}, {"other": 1}],
    ids=lambda one: next(iter(one)),
)
def test_recording_with_an_invalid_breathing_is_refused(text, chest, change):
    document = ChestMotion(Breathing(), ChestFrame.of_tree(chest.tree)).to_json() | change
    lines = text.splitlines()
    broken = "\n".join([lines[0], json.dumps({"t": 0.0, "breathing": document}), *lines[1:]]) + "\n"
    with pytest.raises(VolumeImportError, match="line 2"):
        read(broken)


def test_results_of_known_frames_are_computed_once_and_are_equal_bit_for_bit(text, chest, monkeypatch):
    whole = flight_frames(read(with_breathing(text, chest, Breathing(coughs_s=(1.0,)))))
    num, known, counted, computed = len(whole.lps_from_tip), KnownFrames(), [], []
    deformed = WallField.deformed

    def counting(wall, deformation):
        counted.append(deformation)
        return deformed(wall, deformation)

    def results(frames):
        return [
            frames.tips_to_wall_mm(chest.wall),
            frames.tips_to_wall_mm(chest.wall, ball=True),
            frames.cameras(),
        ]

    monkeypatch.setattr(WallField, "deformed", counting)
    for part in (num // 2, num, num):
        frames = replace(
            whole,
            lps_from_tip=whole.lps_from_tip[:part],
            pose_number=whole.pose_number[:part],
            optics_number=whole.optics_number[:part],
            known=known,
        )
        counted.clear()
        found, num_computed = results(frames), len(counted)
        counted.clear()
        for one, expected in zip(found, results(replace(frames, known=KnownFrames())), strict=True):
            np.testing.assert_array_equal(one, expected)
        computed.append((num_computed, len(counted)))
    (half, half_alone), (rest, all_alone), again = computed
    assert 0 < half == half_alone < all_alone
    assert rest == all_alone - half
    assert again == (0, all_alone)
    # Another pose, another motion and another wall are not known.
    at_s, motion = whole.motions[0]
    moved = whole.lps_from_tip.copy()
    moved[:, 0, 3] += 0.5
    later = replace(motion, breathing=Breathing.of_movement(25.0, 3.0))
    for other in (replace(frames, lps_from_tip=moved), replace(frames, motions=((at_s, later),)), frames):
        for one, expected in zip(results(other), results(replace(other, known=KnownFrames())), strict=True):
            np.testing.assert_array_equal(one, expected)


def test_live_score_in_a_simulated_breathing_computes_new_frames_only(chest, monkeypatch):
    counted = []
    deformed = WallField.deformed
    monkeypatch.setattr(WallField, "deformed", lambda wall, at: counted.append(at) or deformed(wall, at))
    root = chest.tree.root
    pose = Pose.looking(root.points[-1], root.points[-1] - root.points[0])
    airways = SimpleNamespace(tree=chest.tree)
    optics = flight_frames(read(recording_text([pose.lps_from_camera] * 3, chest.volume))).optics[0]
    attempt = LiveAttempt(
        find_task("inspect-all"), airways, chest.wall, optics=optics, flight=1, begun_s=0.0, pose=pose
    )
    attempt.note_breathing(ChestMotion(Breathing(), ChestFrame.of_tree(chest.tree), 0.0), 0.0)
    numbers = []
    for now_s in (3.0, 6.0, 9.0):
        counted.clear()
        attempt.sample(pose, now_s)
        attempt.update_score(now_s)
        numbers.append(len(counted))
    assert numbers[0] > 0
    assert max(numbers) < 1.3 * numbers[0]
