"""Tests of the writing of videos: a complete file or none, file permissions, and codec settings."""

from __future__ import annotations

import dataclasses
import errno
import os
import sys

import numpy as np
import pytest

import carina
from carina.breathing import MOVED_TEXT, ChestDeformation
from carina.display.dot_letters import with_text_lines
from carina.errors import UsageError
from carina.export import VideoWriter
from carina.export.video import size_notes
from carina.navigate.auto_flight import frame_times_s
from carina.render.saved_picture import with_decoration_word
from carina.volume.inserted_structures import PICTURE_TEXT, with_inserted

pytest.importorskip("av", reason="PyAV is not installed")

FRAME = np.zeros((32, 48, 3), dtype=np.uint8)


class Full:
    """Video container whose last bytes do not fit on the disk."""

    def __init__(self, container) -> None:
        self._container = container

    def __getattr__(self, name):
        return getattr(self._container, name)

    def close(self) -> None:
        self._container.close()
        raise OSError(errno.ENOSPC, "No space left on device")


def write_to_full_disk(target, *, reason: Exception | None = None) -> None:
    with VideoWriter(target, 48, 32) as video:
        video.add(FRAME)
        video._container = Full(video._container)
        if reason is not None:
            raise reason


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_full_disk_leaves_the_old_video_and_no_draft(tmp_path, suffix):
    target = tmp_path / f"a{suffix}"
    target.write_bytes(b"old")
    with pytest.raises(OSError, match="the disk is full"):
        write_to_full_disk(target)
    assert target.read_bytes() == b"old"
    assert [found.name for found in tmp_path.iterdir()] == [target.name]


def test_cancelled_video_on_a_full_disk_leaves_no_draft_and_raises_the_original_error(tmp_path):
    with pytest.raises(KeyError, match="reason"):
        write_to_full_disk(tmp_path / "a.mp4", reason=KeyError("reason"))
    assert list(tmp_path.iterdir()) == []


def test_video_whose_encoder_cannot_start_leaves_no_draft(tmp_path, monkeypatch):
    monkeypatch.setattr(VideoWriter, "_create_stream", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        VideoWriter(tmp_path / "a.mp4", 48, 32)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such permissions")
@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_video_has_the_permissions_of_a_new_file(tmp_path, mask):
    before = os.umask(mask)
    try:
        with VideoWriter(tmp_path / "a.mp4", 48, 32) as video:
            video.add(FRAME)
    finally:
        os.umask(before)
    assert (tmp_path / "a.mp4").stat().st_mode & 0o777 == 0o666 & ~mask


def facts(path):
    """Return the codec properties of a video and its frames as arrays."""
    import av

    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        codec = stream.codec_context
        return (codec.name, codec.pix_fmt, codec.profile, (codec.width, codec.height)), frames


def picture(width, height, seed):
    """Return a smooth picture whose last row and column are not black, so that a black padding would be visible."""
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([100 + 80 * x / width, 100 + 80 * y / height, np.full(x.shape, 60.0 + seed)], -1).astype(np.uint8)


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
@pytest.mark.parametrize(
    ("width", "height"), [(101, 75), (100, 75), (101, 76), (17, 17), (16, 16), (641, 480), (48, 32)]
)
def test_video_of_any_size_has_an_even_width_and_height_and_a_format_that_players_read(tmp_path, suffix, width, height):
    path = tmp_path / f"a{suffix}"
    with VideoWriter(path, width, height) as video:
        for n in range(3):
            video.add(picture(width, height, n))
        assert video.size_px == (width + width % 2, height + height % 2)
    (name, pix_fmt, profile, size), frames = facts(path)
    assert (pix_fmt, size) == ("yuv420p", video.size_px)
    assert size[0] % 2 == size[1] % 2 == 0
    assert len(frames) == 3
    if suffix == ".mp4":
        assert (name, profile) == ("h264", "Main")
    # The last row and column are repeated instead of a black line; compression changes a few grey levels.
    expected = np.pad(picture(width, height, 2), ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    assert np.abs(frames[2].astype(int) - expected).max() <= 24


@pytest.mark.skipif(not hasattr(os, "pread"), reason="this system cannot read a file at a position")
def test_index_of_an_mp4_precedes_its_pictures(tmp_path):
    noise = np.random.default_rng(1)
    with VideoWriter(tmp_path / "a.mp4", 320, 240) as video:
        for _ in range(30):
            video.add(noise.integers(0, 255, (240, 320, 3)).astype(np.uint8))
    data = (tmp_path / "a.mp4").read_bytes()
    assert len(data) > 500_000
    assert 0 < data.find(b"moov") < data.find(b"mdat")
    assert len(facts(tmp_path / "a.mp4")[1]) == 30
    assert [found.name for found in tmp_path.iterdir()] == ["a.mp4"]


@pytest.mark.parametrize("size", [(1, 1), (15, 480), (640, 15), (1, 480), (8193, 16), (8192, 8192), (0, 0), (-2, 480)])
def test_video_sizes_that_no_player_shows_are_refused_before_a_file_is_made(tmp_path, size):
    with pytest.raises(UsageError, match=r"16 to 8192 pixels|H\.264 .* has no level"):
        VideoWriter(tmp_path / "a.mp4", *size)
    assert list(tmp_path.iterdir()) == []


def test_video_with_a_rate_above_the_highest_codec_level_is_refused():
    with pytest.raises(UsageError, match="has no level for 8192 x 4352 pixels at 240 frames per second"):
        VideoWriter("a.mp4", 8192, 4352, rate_hz=240.0)


def test_notes_of_a_video_state_its_size_and_whether_few_players_show_it():
    assert size_notes("a.mp4", 640, 480, rate_hz=30.0) == ()
    assert size_notes("a.mp4", 4096, 2160, rate_hz=60.0) == ()
    (note,) = size_notes("a.webm", 101, 75, rate_hz=30.0)
    assert note.startswith("the video has 102 x 76 pixels instead of 101 x 75")
    (note,) = size_notes("a.MP4", 4096, 4096, rate_hz=30.0)
    assert note.startswith("many players do not play H.264 videos of 4096 x 4096 pixels")
    assert len(size_notes("a.mp4", 5121, 2881, rate_hz=30.0)) == 2


def test_video_of_a_view_with_an_odd_size_is_rendered_at_an_even_size_with_a_note(tmp_path):
    phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    path = carina.FlightPath([[0.0, 0.0, 0.0], [0.0, 0.0, -10.0]])
    view = carina.render.AirwayView(path.pose_at(0.0), width=65, height=49)
    film = carina.write_film(
        tmp_path / "a.mp4", phantom.volume, path, view=view, rate_hz=2.0, speed_mm_s=10.0, progress=False
    )
    assert film.size_px == (66, 50)
    assert film.notes == ("the video has 66 x 50 pixels instead of 65 x 49: players need even numbers",)
    assert facts(film.path)[0] == ("h264", "yuv420p", "Main", (66, 50))
    assert film.notes[0] in film._repr_html_()


MOVED = ChestDeformation(np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 0.8, -6.0], [0, 0, 0, 1.0]]))


@pytest.mark.parametrize(
    ("is_inserted", "deformation", "lines"),
    [
        (False, None, []),
        (False, ChestDeformation(np.eye(4)), []),
        (True, None, [PICTURE_TEXT]),
        (False, MOVED, [MOVED_TEXT]),
        (True, MOVED, [MOVED_TEXT, PICTURE_TEXT]),
    ],
)
def test_frames_of_a_film_have_the_marks_of_the_ct_and_follow_its_deformation(
    tmp_path, monkeypatch, is_inserted, deformation, lines
):
    volume = carina.generate_phantom(spacing_mm=3.0, generations=3).volume
    if is_inserted:
        source = with_inserted(volume.source, ["solid nodule, 8.0 mm, at 0.0 0.0 0.0"])
        volume = dataclasses.replace(volume, source=source)
    path = carina.FlightPath([[0.0, 0.0, 40.0], [0.0, 0.0, 30.0]])
    view = carina.render.AirwayView(path.pose_at(0.0), width=240, height=96, deformation=deformation)
    frames = []
    monkeypatch.setattr(VideoWriter, "add", lambda _self, rgb: frames.append(rgb))
    carina.write_film(tmp_path / "a.mp4", volume, path, view=view, rate_hz=2.0, speed_mm_s=10.0, progress=False)
    renderer = carina.render.Renderer(volume)
    flight = carina.navigate.AutoFlight(path, speed_mm_s=10.0, pause_s=0.0)
    times_s = frame_times_s(flight.duration_s, 2.0)
    assert len(times_s) >= 2
    for frame, time_s in zip(frames, times_s, strict=True):
        pose = flight.pose_at(float(time_s))
        pose = pose if deformation is None else pose.carried_by(deformation)
        picture = with_decoration_word(renderer.render(dataclasses.replace(view, pose=pose)))
        np.testing.assert_array_equal(frame, with_text_lines(picture.rgb, lines))


def test_decorated_frames_of_a_film_contain_the_word_decorated(tmp_path, monkeypatch):
    volume = carina.generate_phantom(spacing_mm=3.0, generations=3).volume
    path = carina.FlightPath([[0.0, 0.0, 40.0], [0.0, 0.0, 30.0]])
    view = carina.render.AirwayView(path.pose_at(0.0), width=240, height=96)
    frames = []
    monkeypatch.setattr(VideoWriter, "add", lambda _self, rgb: frames.append(rgb))
    carina.write_film(tmp_path / "a.mp4", volume, path, view=view, rate_hz=2.0, speed_mm_s=10.0, progress=False)
    picture = carina.render.Renderer(volume).render(view)
    assert picture.decorated
    assert not np.array_equal(frames[0], picture.rgb)
    np.testing.assert_array_equal(frames[0], with_decoration_word(picture).rgb)
