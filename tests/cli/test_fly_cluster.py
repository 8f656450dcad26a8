"""Tests of the command ``carina fly`` on several machines and after an interruption.

The video must equal that of one machine, and each picture is rendered once and in order.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import carina as api
from carina.cli import fly
from carina.cli.cluster import OpenCluster
from carina.cli.stored_frames import StoredFrames
from carina.cluster import ClusterRenderer, Console, LocalLane
from carina.export.flight_film import FrameOptions
from carina.navigate import AutoFlight
from carina.navigate.recording import ReplayedPose
from carina.render import Renderer
from carina.scopes import Pose
from carina.volume import Volume
from user_folders import environment_in

av = pytest.importorskip("av", reason="PyAV is not installed")
needs_ray = pytest.mark.skipif(
    not sys.platform.startswith("linux") or importlib.util.find_spec("ray") is None,
    reason="needs Linux and Ray (make setup-tests)",
)
HOW = ["--size", "64x64", "--rate", "10", "--step-vox", "1", "--json"]


@pytest.fixture(scope="module")
def keys(phantom_folder, tmp_path_factory):
    """Return key frames for twelve pictures along the trachea."""
    root = json.loads((phantom_folder / "truth.json").read_text())["branches"][0]["points"]
    flight = AutoFlight(api.FlightPath(root), speed_mm_s=50.0, pause_s=0.0)
    file = tmp_path_factory.mktemp("keys") / "keys.json"
    moments = [{"time_s": t, "lps_from_camera": flight.pose_at(t).lps_from_camera.tolist()} for t in (0.0, 0.6, 1.2)]
    file.write_text(json.dumps({"format": "carina-keys", "version": 1, "keys": moments}))
    return file


def stored_pictures(folder):
    """Return the pictures of a folder of stored frames."""
    pictures = []
    for path in sorted(folder.glob("frame-*.png")):
        with av.open(str(path)) as container:
            pictures.append(next(container.decode(video=0)).to_ndarray(format="rgb24"))
    return pictures


@pytest.fixture
def film(carina, ct, keys):
    """Return a function that renders the flight through the key frames."""
    return lambda output, *more: carina("fly", ct, "--keys", keys, "-o", output, *more)


@pytest.fixture
def whole(film, tmp_path, pictures_of):
    """Return the video that one machine renders without an interruption."""
    ended = film(tmp_path / "whole.mp4", *HOW)
    assert ended.code == 0, ended.err
    frames = pictures_of(tmp_path / "whole.mp4")
    assert len(frames) == 12
    return frames


class DyingLane(LocalLane):
    """Connection to a machine that answers some strips and then no further ones."""

    def __init__(self, name: str, lives: int = 10_000) -> None:
        self.lives = lives
        self.answered: list[int] = []
        super().__init__(name=name)

    def submit(self, order, done):
        """Render the strip unless the machine has died."""
        self.lives -= 1

        def tell(answer):
            if self.lives < 0:
                done(ConnectionError("gone"))
            else:
                self.answered.append(order.frame_id)
                done(answer)

        super().submit(order, tell)


@pytest.fixture
def machines(monkeypatch):
    """Replace the cluster by three machines, of which one dies; return the list of the machines that rendered."""
    lanes = [DyingLane("a"), DyingLane("b", lives=2), DyingLane("c")]

    @contextlib.contextmanager
    def opened(address, *, token, mixed):
        if address is None:
            yield None
            return
        assert address == "10.0.0.5"
        console = Console()
        for lane in lanes:
            console.add_lane(lane)
        try:
            yield OpenCluster(lambda volume, transfer: ClusterRenderer(Renderer(volume), console), console.status)
        finally:
            console.close()

    monkeypatch.setattr(fly, "opened_cluster", opened)
    return lanes


def test_video_rendered_on_three_machines_one_of_which_dies_equals_that_of_one_machine(
    film, tmp_path, whole, machines, pictures_of
):
    output = tmp_path / "many.mp4"
    ended = film(output, *HOW, "--cluster", "10.0.0.5")
    assert ended.code == 0, ended.err
    assert np.array_equal(pictures_of(output), whole)
    assert sum(len(lane.answered) > 0 for lane in machines) >= 2, "the pictures were spread"


def test_interrupted_video_resumes_after_its_last_stored_frame(
    film, tmp_path, whole, machines, *, monkeypatch, pictures_of
):
    folder, output = tmp_path / "kept", tmp_path / "v.mp4"
    arguments = [output, *HOW, "--keep", folder]
    keep = StoredFrames.store_frame
    made = []

    def stopped(self, number, picture):
        if number == 5:
            raise KeyboardInterrupt
        made.append(number)
        keep(self, number, picture)

    monkeypatch.setattr(StoredFrames, "store_frame", stopped)
    assert film(*arguments, "--cluster", "10.0.0.5").code == 130
    assert not output.exists() and made == [0, 1, 2, 3, 4]

    def noted(self, number, picture):
        made.append(number)
        keep(self, number, picture)

    monkeypatch.setattr(StoredFrames, "store_frame", noted)
    # The pictures are equal with and without the cluster.
    ended = film(*arguments)
    assert ended.code == 0, ended.err
    assert ended.json()["num_kept"] == 5
    assert made == list(range(12)), "each once, in order"
    assert np.array_equal(pictures_of(output), whole)
    assert film(*arguments).json()["num_kept"] == 12
    assert made == list(range(12))


def test_stored_frames_of_another_flight_are_not_used(film, tmp_path):
    folder = tmp_path / "kept"
    base = [tmp_path / "v.mp4", *HOW[2:], "--keep", folder]
    assert film(*base, "--size", "48x48").code == 0
    before = sorted(path.name for path in folder.iterdir())
    ended = film(*base, "--size", "64x48")
    assert ended.code == 2 and "another flight" in ended.err
    ended = film(*base, "--size", "48x48", "--scope", "ultrathin")
    assert ended.code == 2 and "another flight" in ended.err
    assert sorted(path.name for path in folder.iterdir()) == before
    (folder / "frame-000003.png").write_bytes(b"no picture")
    ended = film(*base, "--size", "48x48")
    assert ended.code == 3 and "frame-000003.png" in ended.err
    other = tmp_path / "letters"
    other.mkdir()
    (other / "letter.txt").write_text("dear")
    ended = film(*base[:-1], other, "--size", "48x48")
    assert ended.code == 2 and "contains other files" in ended.err
    assert [path.name for path in other.iterdir()] == ["letter.txt"]


def test_fingerprint_of_a_flight_includes_all_inputs_of_its_frames(ct, monkeypatch):
    volume = api.open_volume(ct)
    pose = AutoFlight(api.FlightPath([[0, 0, 1], [0, 0, 0]]), speed_mm_s=10.0, pause_s=0.0).pose_at(0.0)
    frames = [ReplayedPose(0.0, pose, {"shading": True})]
    shown = FrameOptions((64, 48), "generic", 0.5)
    job = fly._job_digest(volume, frames, shown, False)
    assert fly._job_digest(api.open_volume(ct), [ReplayedPose(9.0, pose, {"shading": True})], shown, False) == job

    values = np.array(volume.hu_zyx)
    values[0, 0, 0] += 1
    further = np.array(volume.lps_from_ijk)
    further[0, 3] += 1e-6
    moved = np.array(pose.lps_from_camera)
    moved[2, 3] += 1e-9
    others = {
        "values": fly._job_digest(Volume(values, volume.lps_from_ijk), frames, shown, False),
        "place": fly._job_digest(Volume(np.array(volume.hu_zyx), further), frames, shown, False),
        "pose": fly._job_digest(volume, [ReplayedPose(0.0, Pose(moved), {"shading": True})], shown, False),
        "view": fly._job_digest(volume, [ReplayedPose(0.0, pose, {"shading": False})], shown, False),
        "turned": fly._job_digest(volume, [ReplayedPose(0.0, pose, {"shading": True}, True)], shown, False),
        "more": fly._job_digest(volume, frames * 2, shown, False),
        "size": fly._job_digest(volume, frames, replace(shown, size=(48, 64)), False),
        "scope": fly._job_digest(volume, frames, replace(shown, scope=None), False),
        "step": fly._job_digest(volume, frames, replace(shown, step_vox=0.4), False),
        "mixed": fly._job_digest(volume, frames, shown, True),
    }
    monkeypatch.setattr(api, "__version__", "99.0")
    others["version"] = fly._job_digest(volume, frames, shown, False)
    assert job not in others.values()
    assert len(set(others.values())) == len(others)


@needs_ray
@pytest.mark.ray
@pytest.mark.slow
def test_video_rendered_on_a_real_cluster_equals_that_of_one_machine(ct, keys, tmp_path, whole):
    environment = {**environment_in(tmp_path), "HOME": str(tmp_path)}
    output = tmp_path / "ray.mp4"
    command = [sys.executable, "-m", "carina.cli", "fly", str(ct), "--keys", str(keys), "-o", str(output), *HOW]
    command += ["--cluster", "local", "--keep", str(tmp_path / "kept")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["num_frames"] == 12, "nothing but the result is on standard output"
    assert "raylet" not in done.stderr and "listen_error" not in done.stderr
    assert np.array_equal(stored_pictures(tmp_path / "kept"), whole)
