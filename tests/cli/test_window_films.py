"""Tests that videos saved in the window equal those of ``carina fly``, and that a cancelled one leaves no file."""

from __future__ import annotations

import asyncio
import importlib.util
import json
import tempfile
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from carina import commands as c
from carina.cluster import ClusterRenderer, Console, LocalLane
from carina.errors import CancelledError, CarinaError, NoResultError, UsageError
from carina.export import VideoWriter
from carina.installation import extra_command
from carina.navigate.recording import ReplayedPose
from carina.render import AirwayView, Renderer
from carina.server.files.films import Films
from carina.session.flights.film_flights import FilmHandlers, flight_captions, frames_of_flight, replay_recording

av = pytest.importorskip("av", reason="PyAV is not installed")

QUICK = {"width": "64", "height": "48", "rate_hz": "2", "speed_mm_s": "200"}


def start(films, **query):
    return json.loads(films.start(QUICK | query).body)["job_id"]


def film(session, folder, **query):
    """Save a video as the window does, and return its path."""
    films = Films(session)
    job_id = start(films, **query)
    answer = finished(films, job_id)
    assert answer.status_code == 200
    path = folder / Path(answer.path).name
    path.write_bytes(received(answer))
    return path


def received(answer, *, method="GET", headers=(), breaks_after=None):
    """Send a response as a server does, and return the bytes that the client has received.

    After ``breaks_after`` parts of the file the client disconnects.
    """
    parts = []
    broken = asyncio.Event()

    async def receive():
        await broken.wait()
        return {"type": "http.disconnect"}

    async def send(message):
        if message["type"] == "http.response.body":
            if breaks_after is not None and len(parts) >= breaks_after:
                broken.set()
                await asyncio.sleep(3600.0)
            parts.append(message["body"])

    scope = {"type": "http", "method": method, "headers": list(headers), "asgi": {"spec_version": "2.3"}}
    asyncio.run(answer(scope, receive, send))
    return b"".join(parts)


def finished(films, job_id):
    """Return the response to a request for a video, after the video is finished."""
    while (answer := asyncio.run(films.answer(job_id))).status_code == 202:
        pass
    return answer


@pytest.fixture
def stored(tmp_path, monkeypatch):
    """Return the folder in which the server creates the folder of each video."""
    folder = tmp_path / "stored"
    folder.mkdir()

    def new_folder():
        return Path(tempfile.mkdtemp(dir=folder))

    monkeypatch.setattr("carina.server.files.films.new_folder", new_folder)
    return folder


def frames_of(path):
    with av.open(str(path)) as container:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)])


@pytest.mark.parametrize("captions", ["on", "off"])
def test_video_of_a_route_equals_the_file_of_carina_fly(carina, window_case, tmp_path, pictures_of, captions):
    output = tmp_path / "fly.mp4"
    ended = carina(
        "fly", window_case.path, "--to", window_case.to, "--size", "64x48", "--rate", "2", "--speed", "200",
        "-o", output,
        *(["--captions"] if captions == "on" else []),
    )  # fmt: skip
    assert ended.code == 0, ended.err
    saved = film(window_case.session, tmp_path, flight="route", captions=captions)
    assert saved.name == "flight.mp4"
    np.testing.assert_array_equal(pictures_of(saved), pictures_of(output))


def test_video_of_key_frames_equals_the_file_of_carina_fly(carina, window_case, tmp_path, pictures_of):
    case = window_case.opened
    try:
        for mm in (20.0, 60.0, 90.0):
            case.do(c.GoTo(path_mm=mm))
            case.do(c.EditKeyFrames(c.KeyFrameAdd()))
        case.do(c.SetKeyFrameFlight(speed_mm_s=100.0))
        path = case.save(tmp_path / "keys")
        saved = film(window_case.session, tmp_path, flight="key_frames", captions="on")
    finally:
        while window_case.session.snapshot().document.key_frames.frames:
            case.undo()
        # The other tests compare the session with its file.
        case.do(c.GoTo(path_mm=30.0))
    output = tmp_path / "fly.mp4"
    ct = window_case.path.parent / "ct.nii.gz"
    ended = carina(
        "fly", path, "--ct", ct, "--keys", "all", "--size", "64x48", "--rate", "2", "--captions", "-o", output
    )
    assert ended.code == 0, ended.err
    assert saved.name == "key-frames.mp4"
    np.testing.assert_array_equal(pictures_of(saved), pictures_of(output))


def test_video_of_a_recording_equals_the_file_of_carina_fly(carina, window_case, tmp_path, monkeypatch, pictures_of):
    case, session = window_case.opened, window_case.session
    case.do(c.RecordFlight(tmp_path / "flight.jsonl"))
    for mm in (34.0, 40.0, 46.0, 30.0):
        time.sleep(0.4)
        case.do(c.GoTo(path_mm=mm))
    case.do(c.StopRecording())
    # A program's case stores no flights, so the text of the recorded file replaces that of a stored flight.
    monkeypatch.setattr("carina.session.flights.film_flights.needed_flight", lambda _case, _number: None)
    text = (tmp_path / "flight.jsonl").read_text()
    handlers = FilmHandlers(session._core, lambda _number: text)
    stored = SimpleNamespace(jobs=session.jobs, ask=handlers.flight_to_film)
    saved = film(stored, tmp_path, flight="recording", number="1", captions="off", rate_hz="4")
    output = tmp_path / "fly.mp4"
    ct = window_case.path.parent / "ct.nii.gz"
    how = ("--size", "64x48", "--rate", "4", "-o", output)
    ended = carina("fly", window_case.path, "--ct", ct, "--recording", tmp_path / "flight.jsonl", *how)
    assert ended.code == 0, ended.err
    assert saved.name == "recording-1.mp4"
    assert len(frames_of(saved)) >= 6
    np.testing.assert_array_equal(pictures_of(saved), pictures_of(output))


def test_video_plays_in_old_players_and_its_index_is_before_its_frames(window_case, tmp_path):
    path = film(window_case.session, tmp_path, flight="route", captions="off")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert stream.profile in {"Main", "Baseline", "Constrained Baseline"}
    data = path.read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat")
    webm = film(window_case.session, tmp_path, flight="route", captions="off", format="webm")
    with av.open(str(webm)) as container:
        assert "vp9" in container.streams.video[0].codec_context.name
    assert len(frames_of(webm)) == len(frames_of(path))


def test_captions_change_the_frames_and_name_the_edited_branch(window_case):
    materials = window_case.session.ask(c.FlightToFilm("route", rate_hz=2.0, speed_mm_s=200.0))
    captions = flight_captions(materials.volume, materials.airways, materials.caption_route, None)
    frames = materials.frames(lambda *_: None, lambda _note: None)
    lines = [captions.lines(frame, 3.0 * n) for n, frame in enumerate(frames)]
    assert lines[0][0].startswith("0:00  ")
    assert "the main carina" in lines[-1][0]
    assert any("Own 1" in " ".join(line) for line in lines)
    assert any(line[1].startswith("in ") for line in lines if len(line) > 1)


def test_cancelled_video_leaves_no_file(window_case, tmp_path, stored, monkeypatch):
    session, under_way, go_on = window_case.session, threading.Event(), threading.Event()
    films = Films(session)
    add = VideoWriter.add

    def slow(self, rgb):
        add(self, rgb)
        under_way.set()
        assert go_on.wait(120.0)

    monkeypatch.setattr(VideoWriter, "add", slow)
    job_id = start(films, flight="route")
    assert under_way.wait(120.0)
    assert list(stored.iterdir())
    with pytest.raises(CarinaError, match="another video"):
        start(films, flight="route")
    assert session.jobs.cancel(job_id)
    go_on.set()
    with pytest.raises(CarinaError) as stopped:
        asyncio.run(films.answer(job_id))
    assert stopped.value.code == "export.video-stopped"
    assert session.jobs.wait_idle(120.0)
    assert not list(stored.iterdir())
    monkeypatch.setattr(VideoWriter, "add", add)
    assert len(frames_of(film(session, tmp_path, flight="route"))) > 1


def test_failed_video_leaves_no_file_and_reports_the_reason(window_case, tmp_path, stored, monkeypatch):
    monkeypatch.setattr("carina.export.flight_film.MAX_FRAMES", 3)
    films = Films(window_case.session)
    with pytest.raises(CarinaError, match="at most 3 are possible: fly faster"):
        asyncio.run(films.answer(start(films, flight="route")))
    assert window_case.session.jobs.wait_idle(120.0)
    assert not list(stored.iterdir())


class OverlongFlight:
    """Flight whose poses must not be computed, because its video would have too many frames."""

    duration_s = 80_000.0

    def pose_at(self, _time_s):
        raise AssertionError("a pose of a refused video was computed")


def test_video_with_too_many_frames_is_refused_before_its_poses_are_computed(window_case, monkeypatch):
    with pytest.raises(UsageError) as refused:
        frames_of_flight(OverlongFlight(), {}, 240.0, progress=lambda *_: None)
    assert refused.value.code == "export.video-length"
    assert "19200000 frames" in str(refused.value)
    monkeypatch.setattr("carina.navigate.auto_flight.AutoFlight.pose_at", OverlongFlight.pose_at)
    materials = window_case.session.ask(c.FlightToFilm("route", rate_hz=240.0, speed_mm_s=0.1))
    with pytest.raises(UsageError, match="at most 100000 are possible"):
        materials.frames(lambda *_: None, lambda _note: None)


def test_overlong_recording_is_refused_before_its_replay(monkeypatch):
    recorded = SimpleNamespace(length_s=80_000.0, check=lambda *_, **__: None)
    monkeypatch.setattr("carina.session.flights.film_flights.read_recording", lambda *_: recorded)
    question = c.FlightToFilm("recording", number=1, rate_hz=30.0)
    frames = FilmHandlers(None, lambda _number: "")._recorded(question, None, None)
    with pytest.raises(UsageError, match="2400000 frames"):
        frames(lambda *_: None, lambda _note: None)


def test_computation_of_poses_and_replay_can_be_stopped(window_case):
    def stop(_what, _fraction):
        raise CancelledError("stopped")

    materials = window_case.session.ask(c.FlightToFilm("route", rate_hz=2.0, speed_mm_s=200.0))
    with pytest.raises(CancelledError):
        materials.frames(stop, lambda _note: None)
    recorded = SimpleNamespace(
        length_s=1.0, needs_wall=False, replay=lambda *_, **__: iter([(ReplayedPose(0.0, None, {}), True)])
    )
    with pytest.raises(CancelledError):
        replay_recording(recorded, None, None, lambda _note: None, progress=stop)


def test_video_is_stored_until_a_client_has_the_whole_file(window_case, stored):
    films = Films(window_case.session)
    job_id = start(films, flight="route", captions="off")
    whole = Path(finished(films, job_id).path).read_bytes()
    assert received(finished(films, job_id), method="HEAD") == b""
    assert received(finished(films, job_id), headers=[(b"range", b"bytes=0-9")]) == whole[:10]
    assert received(finished(films, job_id), breaks_after=0) == b""
    assert received(finished(films, job_id)) == whole
    assert not list(stored.iterdir())
    with pytest.raises(CarinaError, match="no longer stored"):
        finished(films, job_id)


def test_new_video_replaces_one_whose_connection_broke_but_not_one_that_is_being_sent(window_case, stored):
    films = Films(window_case.session)
    job_id = start(films, flight="route", captions="off")
    sending = finished(films, job_id)
    second = start(films, flight="route", captions="off")
    assert Path(sending.path).exists()
    assert received(sending, breaks_after=0) == b""
    finished(films, second)
    third = start(films, flight="route", captions="off")
    assert not Path(sending.path).exists()
    finished(films, third)
    films.close()
    assert not list(stored.iterdir())


def test_cancelled_request_for_a_finished_video_does_not_delete_it(window_case, stored):
    films = Films(window_case.session)
    job_id = start(films, flight="route", captions="off")
    assert window_case.session.jobs.wait_idle(300.0)

    async def cancelled():
        request = asyncio.ensure_future(films.answer(job_id))
        await asyncio.sleep(0)
        request.cancel()
        with pytest.raises(asyncio.CancelledError):
            await request

    asyncio.run(cancelled())
    assert finished(films, job_id).status_code == 200
    films.close()
    assert not list(stored.iterdir())


def test_unread_video_is_deleted_when_the_server_stops(window_case, tmp_path, stored, monkeypatch):
    films = Films(window_case.session)
    job_id = start(films, flight="route")
    assert window_case.session.jobs.wait_idle(300.0)
    assert list(stored.rglob("flight.mp4"))
    films.close()
    assert not list(stored.iterdir())
    with pytest.raises(CarinaError, match="no longer stored"):
        asyncio.run(films.answer(job_id))


@pytest.mark.parametrize(
    "wrong",
    [{"format": "avi"}, {"width": "9000"}, {"width": "nan"}, {"rate_hz": "1000"}, {"speed_mm_s": "0"}, {"flight": "x"},
     {"flight": "recording"}, {"flight": "recording", "number": "9"}],
)  # fmt: skip
def test_video_with_invalid_options_is_refused_before_its_job(window_case, wrong):
    with pytest.raises(UsageError):
        start(Films(window_case.session), **({"flight": "route"} | wrong))
    assert not window_case.session.jobs.running


def test_video_without_key_frames_is_refused(window_case):
    with pytest.raises(NoResultError):
        start(Films(window_case.session), flight="key_frames")


def test_video_without_pyav_names_the_command_that_installs_it(window_case, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *more: None if name == "av" else find(name, *more))
    with pytest.raises(CarinaError) as missing:
        start(Films(window_case.session), flight="route")
    assert extra_command("video") in str(missing.value)


class CountingLane(LocalLane):
    """Connection to a machine that counts its loads and its rendered strips."""

    def __init__(self):
        self.num_loads = self.num_strips = 0
        super().__init__(name="other")

    def load(self, *arguments, **options):
        self.num_loads += 1
        return super().load(*arguments, **options)

    def submit(self, order, done):
        self.num_strips += 1
        super().submit(order, done)


def test_views_are_rendered_on_the_cluster_during_and_after_a_video(window_case, tmp_path, monkeypatch):
    console, lane, core = Console(), CountingLane(), window_case.session._core
    try:
        console.add_lane(lane)
        volume, pose = window_case.opened.volume, window_case.session.scene(None).pose
        live = ClusterRenderer(Renderer(volume), console, spread_all=True)
        view = AirwayView(pose, width=64, height=48)

        def num_rendered():
            before = lane.num_strips
            live.render(view)
            return lane.num_strips - before

        live.request(view)[1].result(timeout=120.0)
        assert wait_for(lambda: console.has_renderers)
        assert num_rendered() > 0
        num_loads = lane.num_loads
        monkeypatch.setattr(core, "renderer_factory", lambda v, _t: ClusterRenderer(Renderer(v), console))
        film(window_case.session, tmp_path, flight="route", captions="off")
        assert num_rendered() > 0
        assert lane.num_loads == num_loads
    finally:
        console.close()


def wait_for(reached):
    end_s = time.monotonic() + 120.0
    while not reached() and time.monotonic() < end_s:
        time.sleep(0.01)
    return reached()
