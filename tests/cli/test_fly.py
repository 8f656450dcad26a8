"""``carina fly`` as a person runs it: the video has the right size, length and number of frames."""

from __future__ import annotations

import json

import numpy as np
import pytest

import carina as api
from carina.navigate import AutoFlight
from carina.render import read_png_pose
from small_case import small_bench

av = pytest.importorskip("av", reason="PyAV is not installed")


@pytest.fixture(scope="module")
def tree(phantom_folder, tmp_path_factory):
    """The phantom's exact tree as a file."""
    file = tmp_path_factory.mktemp("tree") / "tree.json"
    truth = json.loads((phantom_folder / "truth.json").read_text())
    file.write_text(json.dumps({**truth, "format": "carina-tree"}))
    return file


def read_video(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        return frames, stream.codec_context.name, float(stream.average_rate), container.duration / 1e6


VIDEOS = [("a.mp4", "h264", (96, 64)), ("odd.mp4", "h264", (81, 63)), ("a.webm", "vp9", (81, 63))]


@pytest.mark.parametrize("video", VIDEOS, ids=lambda video: video[0])
def test_a_flight_along_a_route_has_its_length_size_and_number_of_frames(carina, ct, tree, tmp_path, video):
    name, codec, size = video
    output = tmp_path / name
    ended = carina(
        "fly", ct, "--tree", tree, "--to", "1", "-o", output, "--size", f"{size[0]}x{size[1]}", "--rate", "10",
        "--speed", "100", "--pause", "0.2", "--step-vox", "1", "--json",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    said = ended.json()
    frames, found, rate, seconds = read_video(output)
    assert found in {codec, f"lib{codec}", "libvpx-vp9"}
    assert rate == 10.0
    expected_s = said["path_mm"] / 100.0 + 0.2 * (1 + len(said["stops_mm"]))
    assert len(frames) == said["num_frames"] == int(expected_s * 10 + 0.5)
    assert seconds == pytest.approx(len(frames) / 10.0, abs=0.11)
    assert frames[0].shape == (size[1], size[0], 3)
    # It is a picture of an airway, in its colours, and it changes.
    assert frames[0].std() > 10
    assert frames[0][..., 0].mean() > frames[0][..., 2].mean()
    assert np.abs(frames[0].astype(int) - frames[len(frames) // 2]).mean() > 1


def test_key_frames_are_flown(carina, ct, tree, tmp_path):
    root = json.loads(tree.read_text())["branches"][0]["points"]
    flight = AutoFlight(api.FlightPath(root), speed_mm_s=50.0, pause_s=0.0)
    keys = [{"time_s": t, "lps_from_camera": flight.pose_at(t).lps_from_camera.tolist()} for t in (0.0, 0.3, 0.5)]
    document = tmp_path / "keys.json"
    document.write_text(json.dumps({"format": "carina-keys", "version": 1, "keys": keys}))
    output = tmp_path / "k.mp4"
    ended = carina("fly", ct, "--keys", document, "-o", output, "--size", "64x64", "--rate", "10", "--step-vox", "1")
    assert ended.code == 0, ended.err
    assert len(read_video(output)[0]) == 5
    document.write_text('{"format": "carina-keys", "version": 1, "keys": [{"time_s": 0}]}')
    assert carina("fly", ct, "--keys", document, "-o", output).code == 3


def test_a_recording_of_another_case_is_refused_and_writes_nothing(carina, ct, tmp_path):
    bench = small_bench()
    bench.open()
    bench.session.start_recording(tmp_path / "r.jsonl")
    bench.session.steer(1.0, 0.0, 0.0, 0.0)
    bench.session.stop_recording()
    ended = carina("fly", ct, "--recording", tmp_path / "r.jsonl", "-o", tmp_path / "r.mp4")
    assert ended.code == 3
    assert "another case" in ended.err
    assert not list(tmp_path.glob("*.mp4"))


def test_a_recording_of_this_case_becomes_a_video_of_its_length(carina, ct, tmp_path):
    bench = small_bench()
    volume = api.open_volume(ct)
    bench.session.open_volume(volume)
    bench.background.run_next()
    root = json.loads((ct.parent / "truth.json").read_text())["branches"][0]["points"]
    bench.session.place_pose(api.Pose.looking(root[0], np.subtract(root[-1], root[0])))
    bench.session._case.history.amend_current(lambda d: d.__class__(transfer=api.transfer_preset("endoscopic")))
    bench.session.start_recording(tmp_path / "r.jsonl")
    for _ in range(25):
        bench.clock.advance(0.1)
        bench.session.steer(1.0, 0.0, 0.0, 0.02)
    bench.session.stop_recording()
    output = tmp_path / "r.webm"
    ended = carina(
        "fly", ct, "--recording", tmp_path / "r.jsonl", "-o", output, "--size", "72x72", "--rate", "8",
        "--step-vox", "1", "--json",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    said = ended.json()
    assert said["num_different"] == 0
    assert said["complete"]
    frames, *_ = read_video(output)
    assert len(frames) == 20
    assert frames[0].shape == (72, 72, 3)


@pytest.mark.parametrize(
    "arguments",
    [["-o", "x.gif", "--to", "1"], ["-o", "x.mp4"], ["-o", "x.mp4", "--to", "1", "--keys", "k.json"],
     ["-o", "x.mp4", "--to", "1", "--speed", "0"], ["-o", "x.mp4", "--to", "1", "--rate", "1000"]],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_before_the_work(carina, ct, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    assert carina("fly", ct, *arguments).code == 2
    assert not list(tmp_path.glob("x.*"))


def test_a_still_picture_says_where_its_camera_was(carina, ct, tmp_path):
    output = tmp_path / "p.png"
    ended = carina("render", ct, "--at=0,0,0", "--look=0,0,-1", "--size", "64x48", "-o", output, "--json")
    assert ended.code == 0, ended.err
    place = read_png_pose(output)
    assert place["format"] == "carina-pose"
    assert place["view"] == "airway"
    assert place["lps_from_camera"] == ended.json()["lps_from_camera"]
    assert place["fov_deg"] == ended.json()["fov_deg"]
