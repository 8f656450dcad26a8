"""Tests of flights through key frames, in space and along airways, and of files of key frames."""

from __future__ import annotations

import itertools
import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carina.errors import UsageError, VolumeImportError
from carina.navigate import AirwayWay, KeyFrame, KeyFrameFile, KeyFrameFlight, case_key, open_key_frames
from carina.navigate.rotation import rotation_from_vector
from carina.scopes import Pose, upright
from small_case import small_volume


def pose(at, look=(0.0, 0.0, -1.0), up=None) -> Pose:
    return Pose.looking(at, look, up)


def flown(flight: KeyFrameFlight, step_s: float = 0.002) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(0.0, flight.duration_s, step_s)
    return times, np.array([flight.pose_at(t).position_lps for t in times])


def speeds_mm_s(flight: KeyFrameFlight, step_s: float = 0.002) -> np.ndarray:
    return np.linalg.norm(np.diff(flown(flight, step_s)[1], axis=0), axis=1) / step_s


LINE = [pose((0, 0, -40.0 * n)) for n in range(4)]
numbers = st.floats(-60, 60)
places = st.lists(st.tuples(numbers, numbers, numbers), min_size=2, max_size=7)


def test_flight_between_key_frames_has_its_speed_and_the_duration_of_its_length_and_accelerations():
    frames = [
        KeyFrame(None, LINE[0]),
        KeyFrame(None, LINE[1]),
        KeyFrame(None, LINE[2], speed_mm_s=5.0),
        KeyFrame(None, LINE[3]),
    ]
    flight = KeyFrameFlight(frames, speed_mm_s=20.0)
    a, b, c, d = flight.key_times_s
    # From rest, 20 mm/s is reached after 0.5 s and 5 mm; from 5 mm/s after 0.375 s and 4.6875 mm. Braking
    # takes the same times and distances.
    assert b - a == pytest.approx(0.5 + 30.3125 / 20.0 + 0.375)
    assert c - b == pytest.approx(40.0 / 5.0)
    assert d - c == pytest.approx(b - a)
    speed = speeds_mm_s(flight)
    assert speed.max() == pytest.approx(20.0, abs=1e-6)
    assert speed[int((b + c) / 2 / 0.002)] == pytest.approx(5.0, abs=1e-6)
    # The speed has no jump: it changes by 15 mm/s in 0.375 s, which is 0.08 mm/s in 2 ms.
    assert np.abs(np.diff(speed)).max() < 0.1


@settings(max_examples=25, deadline=None)
@given(places, st.floats(1.0, 100.0), st.integers(0, 2**31))
def test_flight_passes_key_frames_exactly_and_never_exceeds_its_speed(points, speed, seed):
    rng = np.random.default_rng(seed)
    poses = []
    for at in points:
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_from_vector(rng.normal(0, 1.5, 3))
        matrix[:3, 3] = at
        poses.append(Pose(matrix))
    flight = KeyFrameFlight([KeyFrame(None, one) for one in poses], speed_mm_s=speed)
    for one, time_s in zip(poses, flight.key_times_s, strict=True):
        np.testing.assert_array_equal(flight.pose_at(time_s).lps_from_camera, one.lps_from_camera)
    assert all(later > earlier for earlier, later in itertools.pairwise(flight.key_times_s))
    times = np.linspace(0.0, flight.duration_s, 400)
    flown_at = [flight.pose_at(t) for t in times]
    at = np.array([one.position_lps for one in flown_at])
    step_s = times[1] - times[0]
    # 2 % and 1e-3 mm of tolerance: the speed is defined along chords between samples of the path, and at the sharpest
    # bend the cubic is 0.1 % longer than its chord.
    assert np.linalg.norm(np.diff(at, axis=0), axis=1).max() <= speed * step_s * 1.02 + 1e-3


@settings(max_examples=25, deadline=None)
@given(places)
def test_curve_between_key_frames_stays_near_their_chords_without_turning_back(points):
    at = np.array(points)
    flight = KeyFrameFlight([KeyFrame(None, pose(p)) for p in points], speed_mm_s=50.0)
    for n, (start, end) in enumerate(itertools.pairwise(at)):
        chord = np.linalg.norm(end - start)
        for t in np.linspace(flight.key_times_s[n], flight.key_times_s[n + 1], 20):
            here = flight.pose_at(t).position_lps
            along = 0.0 if chord < 1e-9 else np.clip((here - start) @ (end - start) / chord**2, 0, 1)
            # On a centripetal curve the control points are within a third of a chord, plus the effect of the
            # neighbours' bend.
            assert np.linalg.norm(here - (start + along * (end - start))) <= 0.34 * chord + 1e-6


def test_velocity_is_continuous_at_a_key_frame_in_a_bend():
    bend = [(0, 0, 0), (0, 0, -30), (12, 0, -55), (35, 10, -70)]
    flight = KeyFrameFlight([KeyFrame(None, pose(p)) for p in bend], speed_mm_s=20.0)
    _, at = flown(flight, 0.001)
    velocity = np.diff(at, axis=0) / 0.001
    # At 20 mm/s in a bend of 5 mm radius the acceleration is 80 mm/s^2, and that of the ramp 40 mm/s^2, so the velocity
    # changes by less than 0.2 mm/s in 1 ms.
    assert np.abs(np.diff(velocity, axis=0)).max() < 0.2


def test_flight_stops_at_a_key_frame_where_the_path_turns_back():
    there_and_back = [(0, 0, 0), (0, 0, -30), (0, 0, -2)]
    flight = KeyFrameFlight([KeyFrame(None, pose(p)) for p in there_and_back], speed_mm_s=20.0)
    turn_s = flight.key_times_s[1]
    speed = speeds_mm_s(flight)
    assert speed[int(turn_s / 0.002) - 1 : int(turn_s / 0.002) + 1].max() < 1.0
    assert speed.max() == pytest.approx(20.0, rel=1e-3)


def test_rotation_without_translation_takes_time_and_preserves_the_horizon():
    at = (3.0, 4.0, 5.0)
    flight = KeyFrameFlight([KeyFrame(None, pose(at, (0, 0, -1))), KeyFrame(None, pose(at, (1, 0, -0.2)))])
    angle = math.acos(np.array([0, 0, -1]) @ (np.array([1, 0, -0.2]) / math.hypot(1, 0.2)))
    assert flight.duration_s == pytest.approx(angle / math.radians(40.0))
    for t in np.linspace(0, flight.duration_s, 30):
        matrix = flight.pose_at(t).lps_from_camera
        np.testing.assert_allclose(matrix[:3, 3], at, atol=1e-12)
        np.testing.assert_allclose(-matrix[:3, 1], upright(matrix[:3, 2]), atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(st.tuples(numbers, numbers, numbers), st.tuples(numbers, numbers, numbers))
def test_picture_stays_level_between_two_level_poses(one, other):
    looks = [np.array(v) / max(np.linalg.norm(v), 1e-9) for v in (one, other)]
    if any(np.linalg.norm(v) < 0.5 for v in looks) or looks[0] @ looks[1] < -0.9:
        return
    # A view along the anterior axis has no horizon.
    middle = (looks[0] + looks[1]) / np.linalg.norm(looks[0] + looks[1])
    if max(abs(v[1]) for v in (*looks, middle)) > 0.8:
        return
    flight = KeyFrameFlight([KeyFrame(None, pose((0, 0, 0), looks[0])), KeyFrame(None, pose((0, 9, 0), looks[1]))])
    for t in np.linspace(0, flight.duration_s, 15):
        matrix = flight.pose_at(t).lps_from_camera
        np.testing.assert_allclose(-matrix[:3, 1], upright(matrix[:3, 2]), atol=1e-6)


# Flights along airways


def fork_way() -> AirwayWay:
    """Return a path up one bronchus, over the carina and down the other bronchus; their axes are 60 degrees apart."""
    up = [(-20.0 + n, 0.0, -35.0 + 1.7 * n) for n in range(21)]
    down = [(float(n), 0.0, -1.0 - 1.7 * n) for n in range(1, 21)]
    return AirwayWay(np.array(up + down), 20)


def distance_to(points, polyline) -> np.ndarray:
    a, b = polyline[:-1], polyline[1:]
    along = np.clip(((points[:, None] - a) * (b - a)).sum(-1) / np.square(b - a).sum(-1), 0, 1)
    return np.linalg.norm(points[:, None] - (a + along[..., None] * (b - a)), axis=-1).min(axis=1)


def test_flight_along_airways_follows_centrelines_where_a_straight_line_would_leave_the_lumen():
    way = fork_way()
    start, end = way.points_lps[0] + (1.0, 0.5, 0.0), way.points_lps[-1] - (0.0, 0.0, 0.0)
    frames = [KeyFrame(None, pose(start, (-0.5, 0, -0.85))), KeyFrame(None, pose(end, (0.5, 0, -0.85)), way=way)]
    flight = KeyFrameFlight(frames, speed_mm_s=20.0)
    assert flight.through_airways == (True,)
    _, at = flown(flight, 0.01)
    away = distance_to(at, way.points_lps)
    # The curve smooths by at most 0.5 mm; the key frame is 1.1 mm off the centreline, and this offset decreases
    # gradually.
    assert away.max() < 1.7
    assert away[len(away) // 4 :].max() < 0.6
    chord = start + np.linspace(0, 1, 50)[:, None] * (end - start)
    assert distance_to(chord, way.points_lps).max() > 10.0
    speed = speeds_mm_s(flight)
    assert speed.max() == pytest.approx(20.0, rel=0.01)


def test_camera_looks_distally_along_airways_and_rotates_at_the_fork():
    way = fork_way()
    left, right = np.array([-0.507, 0, -0.862]), np.array([0.507, 0, -0.862])
    frames = [KeyFrame(None, pose(way.points_lps[0], left)), KeyFrame(None, pose(way.points_lps[-1], right), way=way)]
    flight = KeyFrameFlight(frames, speed_mm_s=20.0)
    looks = np.array([flight.pose_at(t).forward_lps for t in np.linspace(0, flight.duration_s, 400)])
    # During withdrawal the camera looks down the bronchus that it leaves, not at a wall and not backwards.
    assert looks[60] @ left > 0.99
    assert looks[340] @ right > 0.99
    assert (looks[:, 2] < -0.8).all()
    # The view turns slowly: 50 degrees within 16 mm at 20 mm/s.
    turns = np.degrees(np.arccos(np.clip((looks[1:] * looks[:-1]).sum(axis=1), -1, 1))) / (flight.duration_s / 399)
    assert turns.max() < 140.0


def test_flight_does_not_stop_at_key_frames_along_one_airway():
    points = np.array([(0.3 * math.sin(n / 9), 0.0, -float(n)) for n in range(121)])
    poses = [pose(points[n] + (0.5, 0, 0)) for n in (0, 40, 80, 120)]
    ways = [None, *(AirwayWay(points[n : n + 41], 0) for n in (0, 40, 80))]
    flight = KeyFrameFlight([KeyFrame(None, p, way=w) for p, w in zip(poses, ways, strict=True)], speed_mm_s=20.0)
    speed = speeds_mm_s(flight, 0.01)
    assert speed[80:-80].min() > 19.5
    _, at = flown(flight, 0.001)
    assert np.abs(np.diff(np.diff(at, axis=0) / 0.001, axis=0)).max() < 0.5


def test_key_frames_at_nearly_the_same_airway_position_are_joined_by_a_straight_line():
    way = AirwayWay(np.array([(0.0, 0, 0), (0.0, 0, -1.0)]), 0)
    flight = KeyFrameFlight([KeyFrame(None, pose((-4, 0, 0))), KeyFrame(None, pose((4, 0, -1)), way=way)])
    assert flight.through_airways == (False,)
    assert flight.leg_mm[0] == pytest.approx(math.hypot(8, 1))


# Refused arguments


@pytest.mark.parametrize("speed", [0.0, -1.0, 501.0, math.nan, math.inf])
def test_key_frame_speeds_out_of_range_are_refused(speed):
    with pytest.raises(UsageError, match="mm/s"):
        KeyFrameFlight([KeyFrame(None, LINE[0]), KeyFrame(None, LINE[1])], speed_mm_s=speed)
    with pytest.raises(UsageError, match="mm/s"):
        KeyFrameFlight([KeyFrame(None, LINE[0]), KeyFrame(None, LINE[1], speed_mm_s=speed)])


def test_flight_that_mixes_times_and_speeds_or_has_one_key_frame_is_refused():
    with pytest.raises(UsageError, match="all key frames must have times"):
        KeyFrameFlight([KeyFrame(0.0, LINE[0]), KeyFrame(None, LINE[1])])
    with pytest.raises(UsageError, match="at least two"):
        KeyFrameFlight([KeyFrame(None, LINE[0])])
    way = AirwayWay(np.array([(0.0, 0, 0), (0.0, 0, -40.0)]), 0)
    with pytest.raises(UsageError, match="through space"):
        KeyFrameFlight([KeyFrame(0.0, LINE[0]), KeyFrame(1.0, LINE[1], way=way)])


@pytest.mark.parametrize("points", [[(0.0, 0, 0)], [(0.0, 0), (1.0, 0)], [(0.0, 0, math.nan), (0, 0, 1)]])
def test_key_frame_with_an_invalid_airway_path_is_refused(points):
    with pytest.raises(UsageError, match="at least two points"):
        AirwayWay(np.array(points), 0)


# Files of key frames


def inside(volume, *ijk) -> Pose:
    return pose(volume.to_lps(np.array(ijk, dtype=float)))


def written(path, file: KeyFrameFile):
    path.write_text(json.dumps(file.to_json()))
    return path


def test_flight_read_from_its_file_is_equal_bit_for_bit(tmp_path):
    volume = small_volume()
    way = AirwayWay(np.array([volume.to_lps(np.array((16.0, 14.0, k))) for k in (30.0, 25.0, 20.0)]), 2)
    frames = (
        KeyFrame(None, inside(volume, 16, 14, 30), "start"),
        KeyFrame(None, inside(volume, 16, 14, 20), speed_mm_s=7.0, way=way),
        KeyFrame(None, inside(volume, 10, 13, 15)),
    )
    file = KeyFrameFile(frames, 15.0, "airways", case_key(volume), {"scope": None})
    read = open_key_frames(written(tmp_path / "k.json", file))
    read.check(volume)
    assert (read.speed_mm_s, read.through, read.view) == (15.0, "airways", {"scope": None})
    assert [frame.name for frame in read.frames] == ["start", "", ""]
    one, other = file.flight(), read.flight()
    assert one.key_times_s == other.key_times_s
    for t in np.linspace(0, one.duration_s, 50):
        np.testing.assert_array_equal(one.pose_at(t).lps_from_camera, other.pose_at(t).lps_from_camera)


def test_key_frames_of_another_case_are_refused_with_the_name_of_that_case(tmp_path):
    volume, other = small_volume(), small_volume(is_hu=False)
    frames = (KeyFrame(None, inside(volume, 16, 14, 30)), KeyFrame(None, inside(volume, 16, 14, 20)))
    file = open_key_frames(written(tmp_path / "k.json", KeyFrameFile(frames, case=case_key(volume))))
    file.check(volume)
    with pytest.raises(VolumeImportError, match="another scan"):
        file.check(other)
    far = KeyFrameFile((frames[0], KeyFrame(None, pose((9000, 0, 0)))))
    with pytest.raises(VolumeImportError, match="key frame 2 lies outside"):
        far.check(volume)


@pytest.mark.parametrize(
    "change",
    [
        {"version": 3},
        {"format": "carina-tree"},
        {"keys": []},
        {"keys": [{}]},
        {"keys": 5},
        {"through": "walls"},
        {"speed_mm_s": None},
        {"speed_mm_s": 0.0},
        {"case": 7},
        {"view": []},
    ],
)
def test_key_frame_files_with_invalid_fields_are_refused(tmp_path, change):
    volume = small_volume()
    frames = (KeyFrame(None, inside(volume, 16, 14, 30)), KeyFrame(None, inside(volume, 16, 14, 20)))
    document = KeyFrameFile(frames, case=case_key(volume)).to_json() | change
    path = tmp_path / "k.json"
    path.write_text(json.dumps(document))
    with pytest.raises(VolumeImportError, match=r"k\.json: not a key-frame file"):
        open_key_frames(path)


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "[" * 100_000, "\ud800".encode("utf-8", "surrogatepass").decode("latin1")]
)
def test_key_frame_files_that_are_not_json_are_refused(tmp_path, text):
    path = tmp_path / "k.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(VolumeImportError):
        open_key_frames(path)
    with pytest.raises(VolumeImportError, match="cannot be read"):
        open_key_frames(tmp_path / "none.json")
