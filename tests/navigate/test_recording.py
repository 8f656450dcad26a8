"""Tests of recordings of flights: exact replay, and refusal of damaged recordings and of those of other cases."""

from __future__ import annotations

import errno
import io
import itertools
import json
import math
import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carina.breathing import Breathing, ChestFrame, ChestMotion
from carina.commands import (
    Calibrate,
    CloseCase,
    DeviceControls,
    DeviceGone,
    GoTo,
    LevelHorizon,
    RecordFlight,
    SetControls,
    SetFov,
    SetMode,
    SetOperator,
    Steer,
    StopRecording,
)
from carina.errors import CarinaError, UsageError, VolumeImportError
from carina.navigate import (
    AutoFlight,
    AxesSample,
    FlightPath,
    KeyFrame,
    KeyFrameFlight,
    PoseSample,
    open_recording,
)
from carina.navigate import moves as m
from carina.navigate.auto_flight import frame_times_s
from carina.navigate.navigator import Navigator
from carina.navigate.pilot import Pilot
from carina.navigate.recording import Recorder, read_recording
from carina.navigate.rotation import rotation_from_vector, wxyz_from_rotation
from carina.scopes import Pose, WallField
from carina.session import ErrorEvent, Session
from small_case import Clock, session_fixture, small_volume

VOLUME = small_volume()


@pytest.fixture
def flown():
    """Return a session with the small case open, and its clock."""
    fixture = session_fixture()
    fixture.open()
    yield fixture.session, fixture.clock
    fixture.session.close()


def fly(session: Session, clock: Clock, *, seed: int = 1) -> None:
    """Record a flight by pen, stick and keys.

    It contains two modes, forks, a change of the view, NaN samples and a lost device.
    """
    rng = random.Random(seed)
    session.do(Calibrate("pen", [(0, 0, 0), (50, 0, 0), (0, 50, 0)], [(1, 2, 3), (51, 2, 3), (1, 52, 3)]))
    turn = np.eye(3)
    at = np.zeros(3)
    for n in range(400):
        clock.advance(rng.choice([0.0, 0.001, 0.004, 0.008, 0.03]))
        turn = turn @ rotation_from_vector(np.array([rng.gauss(0, 0.02) for _ in range(3)]))
        at = at + [rng.gauss(0, 0.5) for _ in range(3)]
        session.devices.receive_sample(
            "pen", PoseSample(clock(), tuple(at.tolist()), wxyz_from_rotation(turn), int(n % 97 == 0))
        )
        if n % 3:
            session.devices.frame()
        if n == 50:
            session.devices.receive_sample("pen", PoseSample(math.nan, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
            session.devices.receive_sample("pen", PoseSample(clock() - 5.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
        if n == 120:
            session.do(SetControls(DeviceControls(gain_mm=2.0, min_cutoff_hz=3.0)))
        if n == 160:
            session.do(GoTo(5.0))
        if n == 200:
            session.do(SetFov(100.0))
            session.do(DeviceGone("pen"))
        if n % 50 == 0:
            session.do(Steer(0.4, 0.1, -0.05, 0.02))
    clock.advance(1.0)
    session.do(SetMode("path"))
    for _ in range(300):
        clock.advance(0.02)
        session.devices.receive_sample("stick", AxesSample(clock(), (1.0, 0.0, 0.0, rng.choice([-1.0, 1.0]), 0.0, 0.0)))
        session.devices.frame()
    session.do(SetOperator("facing"))
    session.do(LevelHorizon())


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_replay_gives_the_recorded_poses_bit_for_bit(flown, tmp_path, seed):
    session, clock = flown
    fly(session, clock, seed=seed + 10)  # This flight before the recording must not affect the replay.
    session.do(RecordFlight(tmp_path / "a.jsonl"))
    fly(session, clock, seed=seed)
    before = session.pose_info().pose
    assert session.devices.recording_path == tmp_path / "a.jsonl"
    session.do(StopRecording())
    recording = open_recording(tmp_path / "a.jsonl")
    recording.check(VOLUME, carina="0.1.0")
    replayed = list(recording.replay(VOLUME))
    assert recording.complete
    assert all(same for _, same in replayed)
    assert len([1 for line in recording.lines if "pose" in line]) > 300
    np.testing.assert_array_equal(replayed[-1][0].pose.lps_from_camera, before.lps_from_camera)
    assert {moment.view["fov_deg"] for moment, _ in replayed if moment.view} >= {100.0}
    assert recording.length_s == pytest.approx(replayed[-1][0].time_s, abs=1e-3)


RECORDINGS = Path(__file__).parent / "recordings"
# Tolerance for recordings of another machine, which adds the products of a matrix multiplication in another order.
ROUNDED_MM = 1e-9


def same_flight(recording, wall=None) -> int:
    """Assert that the replay gives every recorded pose; return the number of poses."""
    replayed = iter([moment for moment, _ in recording.replay(VOLUME, wall=wall)][1:])
    num = 0
    for line in recording.lines:
        if "view" in line or "pose" in line:
            moment = next(replayed)
        if "pose" in line:
            np.testing.assert_allclose(moment.pose.lps_from_camera.ravel(), line["pose"], rtol=0, atol=ROUNDED_MM)
            num += 1
    return num


def test_earlier_recording_with_every_move_replays_with_equal_poses():
    recording = open_recording(RECORDINGS / "every-move-1.jsonl")
    recording.check(VOLUME, carina="0.1.0")
    names = {line["move"]["move"] for line in recording.lines if "move" in line}
    names |= {value["move"] for value in recording.header["begin"]}
    assert names == set(m.MOVES) - {"SetScope"}
    assert same_flight(recording) == 100


def test_earlier_recording_with_a_scope_in_the_lumen_replays_with_equal_poses():
    recording = open_recording(RECORDINGS / "scope-in-a-tube-1.jsonl")
    assert recording.needs_wall
    _, y, x = np.mgrid[0:60, -10:11, -10:11].astype(np.float32)
    place = np.eye(4)
    place[:3, 3] = -10.0, -10.0, -60.0
    assert same_flight(recording, WallField.from_distances(6.0 - np.hypot(x, y), place)) > 40


def test_moves_read_from_earlier_recordings_are_written_unchanged():
    """Assert that a recording that is read and written again is the same text; other programs read these files."""
    for place in sorted(RECORDINGS.glob("*.jsonl")):
        recording = open_recording(place)
        moves = [line["move"] for line in recording.lines if "move" in line] + recording.header["begin"]
        for value in moves:
            assert json.dumps(m.move_to_json(*m.move_from_json(value))) == json.dumps(value)


def test_recording_of_another_volume_or_version_is_refused(flown, tmp_path):
    session, clock = flown
    session.do(RecordFlight(tmp_path / "a.jsonl"))
    clock.advance(1.0)
    session.do(Steer(1.0, 0.0, 0.0, 0.0))
    session.do(StopRecording())
    recording = open_recording(tmp_path / "a.jsonl")
    other = small_volume()
    values = other.hu_zyx.copy()
    values[0, 0, 0] += 1
    with pytest.raises(VolumeImportError, match="another scan"):
        recording.check(replace(other, hu_zyx=values), carina="0.1.0")
    with pytest.raises(VolumeImportError, match=r"made by Carina 0\.1\.0"):
        recording.check(VOLUME, carina="0.2.0")


def test_truncated_recording_is_read_up_to_its_last_complete_line(flown, tmp_path):
    session, clock = flown
    session.do(RecordFlight(tmp_path / "a.jsonl"))
    for _ in range(10):
        clock.advance(0.1)
        session.do(Steer(0.5, 0.0, 0.0, 0.0))
    session.do(StopRecording())
    text = (tmp_path / "a.jsonl").read_text()
    cut = tmp_path / "cut.jsonl"
    cut.write_text(text[: text.rindex('"move"') + 20])
    recording = open_recording(cut)
    assert not recording.complete
    # All lines except the header, the truncated line and the end line.
    assert list(recording.lines) == [json.loads(line) for line in text.splitlines()[1:-2]]
    replayed = list(recording.replay(VOLUME))
    assert len(replayed) > 5
    assert all(same for _, same in replayed)


def bad(lines: list[str], n: int, line: str) -> str:
    return "\n".join([*lines[:n], line, *lines[n + 1 :]]) + "\n"


NO_MOVES = ['{"t":9,"move":[1]}', '{"t":9,"move":"SetScope"}', '{"t":9,"view":3}', '{"t":9,"move":{},"wall":"w"}']


@pytest.mark.parametrize("line", ["[]", "{}", '{"t":-1}', '{"t":NaN}', "{" * 100_000, '{"t":0,"t":', "\x00", *NO_MOVES])
def test_damaged_lines_of_a_recording_are_refused_with_their_number(flown, tmp_path, line):
    session, clock = flown
    session.do(RecordFlight(tmp_path / "a.jsonl"))
    for _ in range(4):
        clock.advance(0.1)
        session.do(Steer(0.5, 0.0, 0.0, 0.0))
    session.do(StopRecording())
    lines = (tmp_path / "a.jsonl").read_text().splitlines()
    (tmp_path / "b.jsonl").write_text(bad(lines, 3, line))
    with pytest.raises(VolumeImportError, match="line 4") as refused:
        open_recording(tmp_path / "b.jsonl")
    assert refused.value.code == "navigate.recording"


@pytest.mark.parametrize(
    "text", ["", "hello", '{"format":"carina-recording","version":3}', '{"format":"carina-tree"}', "\xff"]
)
def test_file_without_the_format_of_a_recording_is_refused(tmp_path, text):
    place = tmp_path / "x.jsonl"
    place.write_bytes(text.encode("latin-1"))
    with pytest.raises(VolumeImportError):
        open_recording(place)


class _OpenText(io.StringIO):
    """Text file whose content stays readable after it is closed."""

    def close(self) -> None:
        """Do nothing."""


def recorded(*motions: ChestMotion | None) -> str:
    """Return a recording of 0.3 s for each breathing, the first of which exists at the start."""
    pilot, file = pilot_at_origin(), _OpenText()
    recorder = Recorder(pilot, file, case={}, carina="0", now_s=5.0, view={}, motion=motions[0])
    for n, motion in enumerate(motions):
        recorder.note_breathing(motion, 5.0 + 0.3 * n)
        recorder.tick(5.3 + 0.3 * n)
        pilot.apply(m.PlacePose(tuple(np.eye(4).ravel().tolist())))
    recorder.close()
    return file.getvalue()


def pilot_at_origin() -> Pilot:
    """Return a pilot with the tip at the origin."""
    return Pilot(Navigator(Pose(np.eye(4))))


MOTION = ChestMotion(Breathing(), ChestFrame(110.0, -130.0), began_s=5.0)


@pytest.mark.parametrize(
    ("motions", "versions", "states"),
    [
        ((None,), [1], []),
        ((MOTION,), [2], [True]),
        ((None, MOTION, None, MOTION), [1, 2], [True, False, True]),
    ],
    ids=["without", "from the start", "later"],
)
def test_recording_with_breathing_has_a_version_that_older_programs_refuse(motions, versions, states):
    text = recorded(*motions)
    lines = [json.loads(line) for line in text.splitlines()]
    assert [line["version"] for line in lines if "version" in line] == versions
    found = read_recording(io.StringIO(text), Path("flight"))
    assert found.complete
    assert [motion is not None for _, motion in found.motions] == states
    if 2 in versions:
        # Earlier versions of Carina read version 1 in the header, and require a time in each other line.
        first = next(line for line in lines if line.get("version") == 2)
        assert lines.index(first) < next(n for n, line in enumerate(lines) if "breathing" in line)
        assert first is lines[0] or not {"t", "end"} & set(first)


def test_earlier_recording_with_breathing_and_version_1_opens():
    lines = recorded(MOTION).splitlines()
    header = json.loads(lines[0]) | {"version": 1}
    earlier = "\n".join([json.dumps(header), *lines[1:]]) + "\n"
    assert read_recording(io.StringIO(earlier), Path("flight")).motions == ((0.0, replace(MOTION, began_s=0.0)),)


def test_recording_with_a_line_of_an_unknown_version_is_refused():
    changed = recorded(None, MOTION).replace('{"version":2}', '{"version":3}')
    with pytest.raises(VolumeImportError, match="version 3"):
        read_recording(io.StringIO(changed), Path("flight"))


def test_invalid_move_in_a_recording_ends_the_replay_with_a_message(flown, tmp_path):
    session, _ = flown
    session.do(RecordFlight(tmp_path / "a.jsonl"))
    session.do(StopRecording())
    lines = (tmp_path / "a.jsonl").read_text().splitlines()
    (tmp_path / "b.jsonl").write_text(bad(lines, 2, json.dumps({"t": 0.0, "move": {"move": "Jump"}})))
    with pytest.raises(VolumeImportError, match="Jump"):
        list(open_recording(tmp_path / "b.jsonl").replay(VOLUME))


def test_only_one_recording_runs_at_a_time_and_ends_with_the_case(flown, tmp_path):
    session, _ = flown
    session.do(RecordFlight(tmp_path / "a.jsonl"))
    with pytest.raises(UsageError, match="already"):
        session.do(RecordFlight(tmp_path / "b.jsonl"))
    session.do(CloseCase())
    assert session.devices.recording_path is None
    assert open_recording(tmp_path / "a.jsonl").complete


def test_recording_of_a_flight_contains_no_patient_data(flown, tmp_path):
    session, clock = flown
    session.do(RecordFlight(tmp_path / "a.jsonl"))
    fly(session, clock)
    session.do(StopRecording())
    text = (tmp_path / "a.jsonl").read_text()
    assert len(text.splitlines()) > 500
    assert VOLUME.source.title not in text
    assert str(tmp_path) not in text


class FullDisk(io.StringIO):
    """A file in memory whose disk can be made full."""

    full = False

    def write(self, text: str) -> int:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(text)

    def flush(self) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")


def full_disk():
    """Open a file on a full disk: /dev/full where the system has it, else a simulation."""
    device = Path("/dev/full")
    if device.exists():
        return device.open("w", encoding="utf-8")
    file = FullDisk()
    file.full = True
    return file


def recorded_to(session: Session, path: Path, file) -> None:
    session.do(RecordFlight(path))
    session._recording._recorder._file.close()
    session._recording._recorder._file = file


def troubles(session: Session) -> list[ErrorEvent]:
    found: list[ErrorEvent] = []
    session.subscribe(lambda event: found.append(event) if isinstance(event, ErrorEvent) else None)
    return found


@pytest.mark.parametrize("made", [full_disk, FullDisk])
def test_full_disk_ends_the_recording_with_one_message_and_the_flight_continues(flown, tmp_path, made):
    session, clock = flown
    reported = troubles(session)
    file = made()
    recorded_to(session, tmp_path / "a.jsonl", file)
    file.full = True
    before = session.pose_info().pose
    fly(session, clock)
    assert session.pose_info().pose is not before
    (error,) = reported
    assert error.code == "disk.full"
    assert "the recording stopped" in error.message
    assert "the disk is full" in error.message
    assert session.devices.recording_path is None
    assert file.closed
    # Another recording can be started afterwards.
    session.do(RecordFlight(tmp_path / "b.jsonl"))
    session.do(StopRecording())
    assert open_recording(tmp_path / "b.jsonl").complete
    assert len(reported) == 1


@pytest.mark.parametrize("end", [StopRecording(), CloseCase()])
def test_full_disk_at_the_end_of_a_recording_is_reported_and_the_session_continues(flown, tmp_path, end):
    session, _ = flown
    reported = troubles(session)
    recorded_to(session, tmp_path / "a.jsonl", full_disk())
    session.do(end)
    assert ["the recording stopped" in error.message for error in reported] == [True]
    assert session.devices.recording_path is None


def test_case_opens_although_the_previous_recording_cannot_be_closed(tmp_path):
    fixture = session_fixture()
    fixture.open()
    before = fixture.session.snapshot().case
    recorded_to(fixture.session, tmp_path / "a.jsonl", full_disk())
    fixture.open()
    assert fixture.session.snapshot().case is not before
    fixture.session.close()


def test_recording_that_cannot_start_is_refused_and_leaves_no_file(flown, tmp_path, monkeypatch):
    session, _ = flown
    file = full_disk()

    def opened(path, *args, **kwargs):
        path.touch()
        return file

    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(CarinaError, match="the disk is full"):
        session.do(RecordFlight(tmp_path / "a.jsonl"))
    assert session.devices.recording_path is None
    assert file.closed
    assert not (tmp_path / "a.jsonl").exists()
    session.do(Steer(1.0, 0.0, 0.0, 0.0))


# Automatic flights

BENT = FlightPath(
    [[0, 0, 0], [0, 0, -40], [20, 0, -70], [20, 10, -110]], forks_mm=[40.0, 76.0], lookouts_mm=[32.0, 70.0]
)


def test_automatic_flight_along_a_route_has_a_constant_speed_and_pauses_at_each_fork():
    flight = AutoFlight(BENT, speed_mm_s=10.0, pause_s=2.0)
    assert flight.duration_s == pytest.approx(BENT.length_mm / 10.0 + 3 * 2.0)
    places = [flight.path_mm(t) for t in np.arange(0.0, flight.duration_s, 0.1)]
    steps = np.diff(places)
    assert steps.max() == pytest.approx(1.0)
    assert (steps >= 0).all()
    for stop_mm in (32.0, 70.0):
        assert sum(abs(place - stop_mm) < 1e-9 for place in places) >= 19


@pytest.mark.parametrize("bad_value", [{"speed_mm_s": 0.0}, {"speed_mm_s": math.nan}, {"pause_s": -1.0}])
def test_automatic_flights_with_an_invalid_speed_are_refused(bad_value):
    with pytest.raises(UsageError):
        AutoFlight(BENT, **bad_value)


def test_flight_with_times_passes_its_key_frames_exactly_and_smoothly():
    rng = np.random.default_rng(4)
    keys = []
    for n in range(6):
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_from_vector(rng.normal(0, 1, 3))
        matrix[:3, 3] = rng.normal(0, 20, 3)
        keys.append(KeyFrame(1.0 + 1.5 * n + 0.3 * (n % 2), Pose(matrix)))
    flight = KeyFrameFlight(keys)
    for key in keys:
        np.testing.assert_array_equal(flight.pose_at(key.time_s - 1.0).lps_from_camera, key.pose.lps_from_camera)
    times = np.arange(0.0, flight.duration_s, 0.001)
    at = np.array([flight.pose_at(t).position_lps for t in times[:2000]])
    speeds = np.diff(at, axis=0) / 0.001
    assert np.abs(np.diff(speeds, axis=0)).max() < 0.5, "the speed changes smoothly, also at a key frame"
    assert flight.pose_at(-5.0) is not None
    np.testing.assert_array_equal(flight.pose_at(1e9).lps_from_camera, keys[-1].pose.lps_from_camera)


def test_interpolated_rotation_has_one_axis_and_a_constant_rate():
    a, b = np.eye(4), np.eye(4)
    b[:3, :3] = rotation_from_vector(np.array([0.0, 2.0, 0.0]))
    flight = KeyFrameFlight([KeyFrame(0.0, Pose(a)), KeyFrame(2.0, Pose(b))])
    half = flight.pose_at(1.0).lps_from_camera
    np.testing.assert_allclose(half[:3, :3], rotation_from_vector(np.array([0.0, 1.0, 0.0])), atol=1e-12)


@pytest.mark.parametrize("times", [[0.0], [0.0, 0.0], [1.0, 0.0], [0.0, math.nan]])
def test_key_frames_without_valid_times_are_refused(times):
    with pytest.raises(UsageError):
        KeyFrameFlight([KeyFrame(t, Pose(np.eye(4))) for t in times])


def test_automatic_flight_longer_than_a_day_is_refused():
    with pytest.raises(UsageError, match="24 hours"):
        KeyFrameFlight([KeyFrame(t, Pose(np.eye(4))) for t in (0.0, 1e12)])
    for duration_s in (1e12, math.inf, math.nan):
        with pytest.raises(UsageError, match="24 hours"):
            frame_times_s(duration_s, 30.0)
    assert KeyFrameFlight([KeyFrame(t, Pose(np.eye(4))) for t in (0.0, 86_400.0)]).duration_s == 86_400.0


def test_number_of_video_frames_is_duration_times_frame_rate():
    assert len(frame_times_s(2.0, 30.0)) == 60
    assert len(frame_times_s(0.0, 30.0)) == 1
    assert all(b > a for a, b in itertools.pairwise(frame_times_s(1.0, 24.0)))
    assert m.move_to_json(m.Frame(0.1)) == {"move": "Frame", "now_s": 0.1}
