"""Tests of key frames in a session: the list with undo, the flight through the key frames, and its file."""

from __future__ import annotations

import json

import numpy as np
import pytest

from carina.commands import (
    ChooseRoute,
    EditKeyFrames,
    FlyKeyFrames,
    GoTo,
    KeyFrameAdd,
    KeyFrameFileQuery,
    KeyFrameMove,
    KeyFrameRemove,
    KeyFrameRename,
    KeyFrameSpeed,
    KeyFrameUpdate,
    LevelHorizon,
    NextFork,
    RecordFlight,
    SetKeyFrameFlight,
    SetLumenThreshold,
    SetMode,
    SetOperator,
    ShowKeyFrame,
    Steer,
    StopRecording,
    TakeKeyFrameFile,
    Undo,
)
from carina.errors import NoResultError, UsageError
from carina.navigate import KeyFrame, KeyFrameFile, open_key_frames
from carina.scopes import Pose
from carina.session import Changed, ErrorEvent
from carina.session.flights.tip_commands import place_pose
from small_case import BRANCHES_IJK, session_fixture, small_volume


def lps(ijk):
    return small_volume().to_lps(np.array(ijk))


LEFT, RIGHT, TOP = lps(BRANCHES_IJK[2][1][1]), lps(BRANCHES_IJK[3][1][1]), lps(BRANCHES_IJK[0][1][0])
OUTSIDE_LUMEN = lps((28.0, 3.0, 30.0))


def looking_down(at) -> Pose:
    return Pose.looking(at, (0.0, 0.0, -1.0))


@pytest.fixture
def fixture():
    made = session_fixture()
    made.open()
    return made


@pytest.fixture
def three(fixture):
    """Add three key frames: at the top of the trachea, in the left and in the right bronchus."""
    for at in (TOP, LEFT, RIGHT):
        fixture.session.do(place_pose(looking_down(at)))
        fixture.session.do(EditKeyFrames(KeyFrameAdd()))
    return fixture


def names(fixture):
    return [key.name for key in fixture.session.key_frames_info().frames]


def pose(fixture):
    return fixture.session.pose_info().pose.lps_from_camera


def test_key_frames_are_named_after_their_branch_until_renamed(three):
    assert names(three) == ["Trachea", "LMB", "generation 2"]
    assert [key.branch_id for key in three.session.key_frames_info().frames] == [0, 2, 3]
    second = three.session.key_frames_info().frames[1].key_id
    three.session.do(EditKeyFrames(KeyFrameRename(second, "  the tumour  ")))
    assert names(three)[1] == "the tumour"
    assert three.session.key_frames_info().frames[1].own_name
    three.session.do(EditKeyFrames(KeyFrameRename(second, None)))
    assert names(three)[1] == "LMB"
    three.session.do(place_pose(looking_down(OUTSIDE_LUMEN)))
    three.session.do(EditKeyFrames(KeyFrameAdd()))
    assert names(three)[3] == "outside the airways"


def test_every_change_of_the_key_frame_list_is_one_undo_step(three):
    session = three.session
    ids = [key.key_id for key in session.key_frames_info().frames]
    steps = [
        ("rename key frame 1", lambda: session.do(EditKeyFrames(KeyFrameRename(ids[0], "start")))),
        ("set the speed up to key frame 2", lambda: session.do(EditKeyFrames(KeyFrameSpeed(ids[1], 5.0)))),
        ("move key frame 3 to 2", lambda: session.do(EditKeyFrames(KeyFrameMove(ids[2], -1)))),
        (
            "update key frame 1",
            lambda: (session.do(place_pose(looking_down(LEFT))), session.do(EditKeyFrames(KeyFrameUpdate(ids[0])))),
        ),
        ("remove key frame 3", lambda: session.do(EditKeyFrames(KeyFrameRemove(ids[1])))),
        ("set the path of the key-frame flight", lambda: session.do(SetKeyFrameFlight(through="space"))),
        ("set the speed of the key-frame flight", lambda: session.do(SetKeyFrameFlight(speed_mm_s=44.0))),
        ("add key frame 3", lambda: session.do(EditKeyFrames(KeyFrameAdd()))),
    ]
    states = [session.key_frames_info()]
    for label, change in steps:
        change()
        assert session.snapshot().undo_label == label
        states.append(session.key_frames_info())
        assert states[-1] != states[-2]
    for state in states[-2::-1]:
        session.undo()
        assert session.key_frames_info() == state
    for state in states[1:]:
        session.redo()
        assert session.key_frames_info() == state


def test_key_frame_changes_without_effect_are_not_undo_steps(three):
    first = three.session.key_frames_info().frames[0].key_id
    before = three.session.snapshot().undo_label
    three.session.do(EditKeyFrames(KeyFrameMove(first, -1)))
    three.session.do(EditKeyFrames(KeyFrameRename(first, None)))
    three.session.do(EditKeyFrames(KeyFrameSpeed(first, None)))
    three.session.do(SetKeyFrameFlight(speed_mm_s=20.0, through="airways"))
    assert three.session.snapshot().undo_label == before


def test_flight_between_key_frames_in_airways_follows_the_airways(three):
    info = three.session.key_frames_info()
    assert [key.through_airways for key in info.frames] == [False, True, True]
    branches = {b.id: b for b in three.session.snapshot().document.airways.tree.branches}
    # The path leads up the left bronchus to the carina, then down two branches on the right; smoothing cuts corners.
    way_mm = branches[2].length_mm + branches[1].length_mm + branches[3].length_mm
    assert info.frames[2].leg_mm == pytest.approx(way_mm, rel=0.05)
    assert info.frames[2].leg_mm > 1.2 * np.linalg.norm(LEFT - RIGHT)
    three.session.do(SetKeyFrameFlight(through="space"))
    straight = three.session.key_frames_info()
    assert [key.through_airways for key in straight.frames] == [False, False, False]
    assert straight.duration_s < info.duration_s


def test_flight_is_straight_without_airways_and_outside_airways(fixture):
    for at in (TOP, OUTSIDE_LUMEN):
        fixture.session.do(place_pose(looking_down(at)))
        fixture.session.do(EditKeyFrames(KeyFrameAdd()))
    assert [key.through_airways for key in fixture.session.key_frames_info().frames] == [False, False]


def test_key_frame_flight_moves_the_tip_and_reports_its_time_until_interrupted(three):
    session = three.session
    info = session.key_frames_info()
    for key, at in zip(info.frames, (TOP, LEFT, RIGHT), strict=True):
        session.do(FlyKeyFrames(key.time_s))
        np.testing.assert_array_equal(pose(three), looking_down(at).lps_from_camera)
        assert session.pose_info().key_frames_s == key.time_s
    three.events.clear()
    session.do(FlyKeyFrames(info.duration_s / 2, goes_on=True))
    assert session.pose_info().key_frames_s == info.duration_s / 2
    assert {"pose", "views"} <= set().union(*(e.topics for e in three.of_type(Changed)))
    session.do(Steer(1.0, 0.0, 0.0, 0.0))
    assert session.pose_info().key_frames_s is None
    held = pose(three)
    session.do(FlyKeyFrames(1.0, goes_on=True))
    np.testing.assert_array_equal(pose(three), held)
    session.do(FlyKeyFrames(1.0))
    assert session.pose_info().key_frames_s == 1.0


@pytest.mark.parametrize(
    "take_over",
    [
        GoTo(5.0),
        NextFork(),
        LevelHorizon(),
        SetOperator("facing"),
        ChooseRoute(branch_id=2),
        Undo(),
    ],
)
def test_movement_of_the_tip_or_change_of_the_key_frames_interrupts_the_flight(three, take_over):
    three.session.do(SetMode("path"))
    three.session.do(FlyKeyFrames(1.0))
    three.session.do(take_over)
    three.session.do(FlyKeyFrames(1.1, goes_on=True))
    assert three.session.pose_info().key_frames_s is None


def test_movement_by_a_device_interrupts_the_flight_with_a_message(three):
    from carina.navigate import AxesSample

    session = three.session
    session.do(FlyKeyFrames(1.0))
    session.devices.receive_sample("pad", AxesSample(0.0, (1.0, 0, 0, 0, 0, 0), 0))
    three.clock.advance(0.02)
    session.devices.frame()
    three.clock.advance(0.02)
    session.devices.frame()
    info = session.pose_info()
    assert (info.key_frames_s, info.by_device) == (None, True)
    session.do(Steer(1.0, 0.0, 0.0, 0.0))
    assert not session.pose_info().by_device


def test_tip_moved_to_a_key_frame_has_exactly_the_pose_of_the_key_frame(fixture):
    fixture.session.do(place_pose(looking_down(LEFT)))
    key = fixture.session.do(EditKeyFrames(KeyFrameAdd()))
    fixture.session.do(place_pose(looking_down(RIGHT)))
    fixture.session.do(ShowKeyFrame(key))
    np.testing.assert_array_equal(pose(fixture), looking_down(LEFT).lps_from_camera)
    with pytest.raises(NoResultError, match="at least two key frames"):
        fixture.session.do(FlyKeyFrames(0.0))


def test_commands_for_a_deleted_key_frame_are_refused(three):
    session = three.session
    for command in (
        EditKeyFrames(KeyFrameUpdate("key-99")),
        EditKeyFrames(KeyFrameRemove("key-99")),
        ShowKeyFrame("key-99"),
    ):
        with pytest.raises(UsageError, match="this key frame has been removed"):
            session.do(command)
    with pytest.raises(UsageError, match=r"speed_mm_s must be at least 0\.1; found 0"):
        session.do(EditKeyFrames(KeyFrameSpeed(session.key_frames_info().frames[0].key_id, 0.0)))
    with pytest.raises(UsageError, match="speed_mm_s must be at most 500; found 10000"):
        session.do(SetKeyFrameFlight(speed_mm_s=1e4))


def test_flight_longer_than_24_hours_is_reported_and_not_flown(fixture):
    for n in range(200):
        fixture.session.do(place_pose(looking_down(LEFT if n % 2 else RIGHT)))
        fixture.session.do(EditKeyFrames(KeyFrameAdd()))
    with pytest.raises(UsageError, match="at most 200 key frames"):
        fixture.session.do(EditKeyFrames(KeyFrameAdd()))
    fixture.session.do(SetKeyFrameFlight(speed_mm_s=0.1))
    info = fixture.session.key_frames_info()
    assert "24 hours" in info.problem
    assert info.duration_s == 0.0
    with pytest.raises(NoResultError, match="24 hours"):
        fixture.session.do(FlyKeyFrames(1.0))


def test_new_airways_are_used_for_the_path_between_key_frames(three):
    before = three.session.key_frames_info()
    three.session.do(SetLumenThreshold(-850.0))
    three.background.run_all()
    assert three.session.key_frames_info().frames == before.frames
    assert three.session.snapshot().document.key_frames.frames


def test_saved_key_frame_flight_is_restored_in_one_undo_step(three, tmp_path):
    session = three.session
    session.do(EditKeyFrames(KeyFrameSpeed(session.key_frames_info().frames[2].key_id, 7.5)))
    session.do(EditKeyFrames(KeyFrameRename(session.key_frames_info().frames[0].key_id, "start")))
    info = session.key_frames_info()
    path = tmp_path / "k.json"
    path.write_text(json.dumps(session.ask(KeyFrameFileQuery()).to_json(), allow_nan=False))
    flight = open_key_frames(path).flight()
    for t in np.linspace(0.0, info.duration_s, 40):
        session.do(FlyKeyFrames(float(t)))
        np.testing.assert_array_equal(pose(three), flight.pose_at(float(t)).lps_from_camera)
    for _ in range(5):
        session.undo()
    assert session.key_frames_info().frames == ()
    session.do(TakeKeyFrameFile(path))
    three.background.run_all()
    opened = session.key_frames_info()
    for key, old in zip(opened.frames, info.frames, strict=True):
        # All values except the IDs are equal bit for bit.
        assert (key.name, key.speed_mm_s, key.time_s, key.leg_mm) == (old.name, old.speed_mm_s, old.time_s, old.leg_mm)
    assert session.snapshot().undo_label == "open key frames"
    session.undo()
    assert session.key_frames_info().frames == ()


def test_key_frames_of_another_case_are_refused_and_change_nothing(three, tmp_path):
    path = tmp_path / "k.json"
    path.write_text(json.dumps(three.session.ask(KeyFrameFileQuery()).to_json()))
    other = session_fixture()
    other.open("raw")
    other.session.do(TakeKeyFrameFile(path))
    other.background.run_all()
    (error,) = other.of_type(ErrorEvent)
    assert "another scan" in error.message
    assert other.session.key_frames_info().frames == ()


def test_times_in_a_key_frame_file_are_converted_to_speeds(fixture, tmp_path):
    path = tmp_path / "k.json"
    keys = [
        {"time_s": t, "lps_from_camera": looking_down(at).lps_from_camera.tolist()} for t, at in ((0, TOP), (4, LEFT))
    ]
    path.write_text(json.dumps({"format": "carina-keys", "version": 1, "keys": keys}))
    fixture.session.do(TakeKeyFrameFile(path))
    fixture.background.run_all()
    info = fixture.session.key_frames_info()
    assert info.through == "space"
    assert info.frames[1].speed_mm_s == pytest.approx(np.linalg.norm(TOP - LEFT) / 4.0)


def test_export_without_key_frames_and_too_many_key_frames_are_refused(fixture, tmp_path):
    with pytest.raises(NoResultError, match="no key frames"):
        fixture.session.ask(KeyFrameFileQuery())
    frames = tuple(KeyFrame(None, looking_down(TOP - np.array([0, 0, 0.05 * n]))) for n in range(201))
    path = tmp_path / "k.json"
    path.write_text(json.dumps(KeyFrameFile(frames).to_json()))
    fixture.session.do(TakeKeyFrameFile(path))
    fixture.background.run_all()
    (error,) = fixture.of_type(ErrorEvent)
    assert error.message == "the file has 201 key frames; at most 200 can be opened"


def test_recording_of_a_key_frame_flight_replays_with_equal_poses(three, tmp_path):
    from carina.navigate import open_recording

    session = three.session
    session.do(RecordFlight(tmp_path / "r.jsonl"))
    for t in np.linspace(0.0, 2.0, 9):
        session.do(FlyKeyFrames(float(t)))
        three.clock.advance(0.25)
    session.do(StopRecording())
    replayed = list(open_recording(tmp_path / "r.jsonl").replay(small_volume()))
    assert all(same for _, same in replayed)
    np.testing.assert_array_equal(replayed[-1][0].pose.lps_from_camera, pose(three))
