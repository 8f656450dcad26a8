"""Tests of the command ``carina fly``: size, length and number of frames of the video, and its pictures."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import carina as api
from carina.cli.along import route_to
from carina.cli.opened import Badges, OpenedInput
from carina.commands import GoTo, OpenVolume, RecordFlight, SetMode, SetScope, Steer, StopRecording
from carina.export.video import even_size
from carina.navigate import AirwayWay, AutoFlight, KeyFrame, KeyFrameFile, case_key
from carina.navigate.recording import ReplayedPose, sampled
from carina.navigate.rotation import rotation_from_vector
from carina.render import AirwayView, read_png_pose
from carina.scopes import DEFAULT_SCOPE, ImageField
from carina.session.flights.tip_commands import place_pose
from small_case import session_fixture

av = pytest.importorskip("av", reason="PyAV is not installed")


@pytest.fixture(scope="module")
def tree(phantom_folder, tmp_path_factory):
    """Write the phantom's exact tree to a file and return its path."""
    file = tmp_path_factory.mktemp("tree") / "tree.json"
    truth = json.loads((phantom_folder / "truth.json").read_text())
    file.write_text(json.dumps({**truth, "format": "carina-tree"}))
    return file


def read_video(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        return frames, stream.codec_context.name, float(stream.average_rate), container.duration / 1e6


def pixel_format(path):
    with av.open(str(path)) as container:
        return container.streams.video[0].codec_context.pix_fmt


def differs(a, b):
    """Return the mean absolute difference of two pictures, 0 to 255."""
    return np.abs(np.asarray(a, dtype=int) - np.asarray(b, dtype=int)).mean()


def still(carina, ct, pose, size, output, *, scope=DEFAULT_SCOPE):
    """Return the picture that ``carina render`` makes from ``pose``."""
    look, up = pose.lps_from_camera[:3, 2], -pose.lps_from_camera[:3, 1]
    ended = carina(
        "render", ct, *(f"--{name}=" + ",".join(repr(float(v)) for v in value)
                        for name, value in (("at", pose.position_lps), ("look", look), ("up", up))),
        "--size", f"{size[0]}x{size[1]}", "--scope", scope, "--step-vox", "1", "-o", output,
    )  # fmt: skip
    assert ended.code == 0, ended.err
    with av.open(str(output)) as container:
        return next(container.decode(video=0)).to_ndarray(format="rgb24")


VIDEOS = [("a.mp4", "h264", (96, 64)), ("odd.mp4", "h264", (81, 63)), ("a.webm", "vp9", (81, 63))]


@pytest.mark.parametrize("video", VIDEOS, ids=lambda video: video[0])
def test_flight_video_along_a_route_has_its_length_size_and_number_of_frames(carina, ct, tree, tmp_path, video):
    name, codec, size = video
    output = tmp_path / name
    ended = carina(
        "fly", ct, "--tree", tree, "--to", "1", "-o", output, "--size", f"{size[0]}x{size[1]}", "--rate", "10",
        "--speed", "100", "--pause", "0.2", "--step-vox", "1", "--json",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    result = ended.json()
    frames, found, rate, seconds = read_video(output)
    assert found in {codec, f"lib{codec}", "libvpx-vp9"}
    assert rate == 10.0
    expected_s = result["path_mm"] / 100.0 + 0.2 * (1 + len(result["stops_mm"]))
    assert len(frames) == result["num_frames"] == int(expected_s * 10 + 0.5)
    assert seconds == pytest.approx(len(frames) / 10.0, abs=0.11)
    even = even_size(*size)
    assert frames[0].shape == (even[1], even[0], 3)
    assert result["size"] == list(even)
    assert pixel_format(output) == "yuv420p"
    assert (f"the video has {even[0]} x {even[1]} pixels instead of" in ended.err) == (even != size)
    # The picture has the contrast of an airway, and the pictures of the flight differ.
    assert frames[0].std() > 10
    assert frames[0][..., 0].mean() > frames[0][..., 2].mean()
    assert differs(frames[0], frames[len(frames) // 2]) > 1
    source = OpenedInput(api.open_volume(ct), Badges())
    first = route_to(source, "1", tree_file=tree, progress=lambda *_: None).path.pose_at(0.0)
    # The first frame shows the start of the route; the codec causes the remaining difference.
    assert differs(frames[0], frames[-1]) > 8
    assert differs(frames[0], still(carina, ct, first, even, tmp_path / "s.png")) < 4


def test_video_of_key_frames_shows_the_poses_of_the_key_frames(carina, ct, tree, tmp_path):
    root = json.loads(tree.read_text())["branches"][0]["points"]
    flight = AutoFlight(api.FlightPath(root), speed_mm_s=50.0, pause_s=0.0)
    poses = {t: flight.pose_at(t).lps_from_camera.copy() for t in (0.0, 0.3, 0.5)}
    # The key frame at 0.3 looks at the wall.
    poses[0.3][:3, :3] @= rotation_from_vector(np.array([0.0, 1.2, 0.0]))
    keys = [{"time_s": t, "lps_from_camera": matrix.tolist()} for t, matrix in poses.items()]
    document = tmp_path / "keys.json"
    document.write_text(json.dumps({"format": "carina-keys", "version": 1, "keys": keys}))
    output = tmp_path / "k.mp4"
    ended = carina("fly", ct, "--keys", document, "-o", output, "--size", "64x64", "--rate", "10", "--step-vox", "1")
    assert ended.code == 0, ended.err
    frames, *_ = read_video(output)
    assert len(frames) == 5
    assert differs(frames[0], frames[3]) > 8
    for n, time_s in ((0, 0.0), (3, 0.3)):
        shown = still(carina, ct, api.Pose(poses[time_s]), (64, 64), tmp_path / "s.png")
        assert differs(frames[n], shown) < 4
    document.write_text('{"format": "carina-keys", "version": 1, "keys": [{"time_s": 0}]}')
    assert carina("fly", ct, "--keys", document, "-o", output).code == 3


def test_video_of_key_frames_from_the_window_has_their_speed_and_view_settings(carina, ct, tree, tmp_path):
    volume = api.open_volume(ct)
    root = api.FlightPath(json.loads(tree.read_text())["branches"][0]["points"])
    poses = [root.pose_at(mm) for mm in (0.0, 20.0, 40.0)]
    way = AirwayWay(root.points_lps[: len(root.points_lps) // 2], 0)
    frames = [KeyFrame(None, poses[0]), KeyFrame(None, poses[1], speed_mm_s=40.0), KeyFrame(None, poses[2], way=way)]
    view = {"scope": None, "mask": "none", "fov_deg": 70.0, "operator": "head"}
    file = KeyFrameFile(tuple(frames), 50.0, "airways", case_key(volume), view)
    document, output = tmp_path / "keys.json", tmp_path / "k.mp4"
    document.write_text(json.dumps(file.to_json()))
    how = ("--size", "64x64", "--rate", "10", "--step-vox", "1")
    ended = carina("fly", ct, "--keys", document, "-o", output, *how, "--json")
    assert ended.code == 0, ended.err
    result, flight = ended.json(), file.flight()
    assert result["key_times_s"] == list(flight.key_times_s)
    pictures, _, _, seconds = read_video(output)
    assert len(pictures) == int(flight.duration_s * 10 + 0.5)
    assert seconds == pytest.approx(flight.duration_s, abs=0.11)
    renderer = api.Renderer(volume)
    airways = api.find_airways(volume)
    renderer.set_lumen(airways.lumen_zyx, airways.tree)
    first = AirwayView(poses[0], fov_deg=70.0, field=ImageField("none"), width=64, height=64, step_vox=1.0)
    assert differs(pictures[0], renderer.render(first).rgb) < 4
    # An instrument that is given on the command line replaces the field of view of the key frames.
    ended = carina("fly", ct, "--keys", document, "-o", output, *how, "--scope", DEFAULT_SCOPE)
    assert ended.code == 0, ended.err
    assert differs(read_video(output)[0][0], still(carina, ct, poses[0], (64, 64), tmp_path / "s.png")) < 4
    other = {**file.to_json(), "case": {**file.case, "digest": "0" * 32}}
    document.write_text(json.dumps(other))
    ended = carina("fly", ct, "--keys", document, "-o", tmp_path / "other.mp4")
    assert ended.code == 3
    assert "another scan" in ended.err
    assert not (tmp_path / "other.mp4").exists()


@pytest.mark.parametrize("option", ["--recording", "--keys"])
def test_missing_scan_is_named_as_the_cause_although_the_recording_is_missing_too(carina, tmp_path, option):
    ended = carina("fly", tmp_path / "MISSING", option, tmp_path / "X", "-o", tmp_path / "r.mp4", "--json")
    assert ended.code == 3
    assert ended.json()["error"]["code"] == "import.not-found"
    assert "reading MISSING: there is no such file or folder" in ended.json()["error"]["message"]
    assert not (tmp_path / "r.mp4").exists()


def test_recording_of_another_case_is_refused_and_writes_nothing(carina, ct, tmp_path):
    fixture = session_fixture()
    fixture.open()
    fixture.session.do(RecordFlight(tmp_path / "r.jsonl"))
    fixture.session.do(Steer(1.0, 0.0, 0.0, 0.0))
    fixture.session.do(StopRecording())
    ended = carina("fly", ct, "--recording", tmp_path / "r.jsonl", "-o", tmp_path / "r.mp4")
    assert ended.code == 3
    assert "another scan" in ended.err
    assert not list(tmp_path.glob("*.mp4"))


def test_video_of_a_recording_has_the_length_of_the_recording(carina, ct, tmp_path):
    fixture = session_fixture()
    volume = api.open_volume(ct)
    fixture.session.do(OpenVolume(volume))
    fixture.background.run_next()
    root = json.loads((ct.parent / "truth.json").read_text())["branches"][0]["points"]
    began = api.Pose.looking(root[0], np.subtract(root[-1], root[0]))
    fixture.session.do(place_pose(began))
    fixture.session._core.case.history.amend_current(lambda d: d.__class__(transfer=api.transfer_preset("endoscopic")))
    fixture.session.do(RecordFlight(tmp_path / "r.jsonl"))
    for _ in range(25):
        fixture.clock.advance(0.1)
        fixture.session.do(Steer(1.0, 0.0, 0.0, 0.02))
    fixture.session.do(StopRecording())
    output = tmp_path / "r.webm"
    ended = carina(
        "fly", ct, "--recording", tmp_path / "r.jsonl", "-o", output, "--size", "72x72", "--rate", "8",
        "--step-vox", "1", "--json",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    result = ended.json()
    assert result["num_different"] == 0
    assert result["complete"]
    frames, *_ = read_video(output)
    assert len(frames) == 20
    assert frames[0].shape == (72, 72, 3)
    assert differs(frames[0], frames[-1]) > 8
    assert differs(frames[0], still(carina, ct, began, (72, 72), tmp_path / "s.png")) < 4


def test_video_frame_shows_the_newest_recorded_pose_that_is_not_later():
    moments = [ReplayedPose(t, api.Pose(np.eye(4)), {"n": n}) for n, t in enumerate((0.0, 0.1, 0.1, 0.3, 0.5))]
    times = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.49, 0.5, 9.0])
    assert [moment.view["n"] for moment in sampled(moments, times)] == [0, 0, 2, 2, 3, 3, 4, 4]
    # A recording that begins after the start of the video is shown from the start.
    assert sampled(moments[3:], np.array([0.0])) == [replace(moments[3], time_s=0.0)]


def test_video_of_a_recording_with_wall_contact_uses_the_recorded_airway_wall(carina, ct, tmp_path):
    def find_airways(volume, *, root_lps, lumen_threshold, progress, cancel):
        return api.find_airways(volume, root_lps=root_lps, progress=progress, cancel=cancel)

    fixture = session_fixture(find_airways=find_airways)
    session = fixture.session
    session.do(OpenVolume(api.open_volume(ct)))
    fixture.background.run_all()
    session._core.case.history.amend_current(lambda d: replace(d, transfer=api.transfer_preset("endoscopic")))
    session.do(SetScope("ultrathin"))
    session.do(GoTo(30.0))
    session.do(SetMode("scope"))
    fixture.background.run_all()
    assert session.snapshot().mode == "scope"
    began = session.pose_info().pose
    session.do(RecordFlight(tmp_path / "r.jsonl"))
    for _ in range(10):
        fixture.clock.advance(0.1)
        session.do(Steer(2.0, 0.0, 0.2, 0.1))
    assert session.pose_info().scope.contact is not None, "the wall stops the scope"
    session.do(StopRecording())
    session.close()
    output = tmp_path / "r.mp4"
    ended = carina(
        "fly", ct, "--recording", tmp_path / "r.jsonl", "-o", output, "--size", "48x48", "--rate", "2",
        "--step-vox", "1", "--json",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    result = ended.json()
    assert result["num_moments"] > 10
    assert result["num_different"] == 0
    frames, *_ = read_video(output)
    assert len(frames) == 2
    assert differs(frames[0], frames[-1]) > 8
    assert differs(frames[0], still(carina, ct, began, (48, 48), tmp_path / "s.png", scope="ultrathin")) < 4


@pytest.mark.parametrize(
    "arguments",
    [["-o", "x.gif", "--to", "1"], ["-o", "x.mp4"], ["-o", "x.mp4", "--to", "1", "--keys", "k.json"],
     ["-o", "x.mp4", "--to", "1", "--speed", "0"], ["-o", "x.mp4", "--to", "1", "--rate", "1000"]],
)  # fmt: skip
def test_inconsistent_arguments_of_the_fly_command_are_refused_before_rendering(
    carina, ct, tmp_path, monkeypatch, arguments
):
    monkeypatch.chdir(tmp_path)
    assert carina("fly", ct, *arguments).code == 2
    assert not list(tmp_path.glob("x.*"))


def test_picture_file_contains_the_pose_of_its_camera(carina, ct, tmp_path):
    output = tmp_path / "p.png"
    ended = carina("render", ct, "--at=0,0,0", "--look=0,0,-1", "--size", "64x48", "-o", output, "--json")
    assert ended.code == 0, ended.err
    place = read_png_pose(output)
    assert place["format"] == "carina-pose"
    assert place["view"] == "airway"
    assert place["lps_from_camera"] == ended.json()["lps_from_camera"]
    assert place["fov_deg"] == ended.json()["fov_deg"]
