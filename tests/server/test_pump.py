"""The frame pump over a session: one picture per step, in the test's own thread."""

from __future__ import annotations

import numpy as np
import pytest
import simplejpeg

from carina.errors import RenderError
from carina.render import AirwayView, SliceView
from carina.server.messages import Status, parse_picture
from carina.server.pump import FramePump, encode_jpeg
from small_case import small_bench


class Screen:
    """A pump and what it delivered."""

    def __init__(self) -> None:
        self.bench = small_bench()
        self.data = []
        self.told = []
        self.pump = FramePump(
            self.bench.session.scene, self.data.append, self.told.append, clock=self.bench.clock, threads=2, simd="x"
        )

    @property
    def headers(self):
        return [parse_picture(d)[0] for d in self.data]

    def drain(self, *, acknowledge=True):
        while self.pump.step():
            if acknowledge and self.data:
                self.pump.acknowledge(self.headers[-1].frame_id)


@pytest.fixture
def screen():
    screen = Screen()
    screen.bench.open()
    screen.pump.set_layout({"airway": (320, 240), "axial": (120, 100)})
    return screen


def test_without_a_case_there_is_no_picture():
    screen = Screen()
    screen.pump.set_layout({"airway": (320, 240)})
    assert not screen.pump.step()
    assert screen.pump.wait_s() is None


def test_pictures_carry_the_pose_they_answer_and_their_geometry(screen):
    screen.drain()
    pose = screen.bench.session.pose_info()
    airway = next(h for h in screen.headers if h.view == "airway")
    assert airway.pose_id == pose.pose_id
    np.testing.assert_array_equal(airway.lps_from_camera, pose.pose.lps_from_camera.ravel())
    assert airway.lps_from_pixel is None
    axial = next(h for h in screen.headers if h.view == "axial")
    assert axial.lps_from_camera is None
    assert len(axial.lps_from_pixel) == 16


def test_a_moving_view_is_coarse_and_becomes_full_when_still(screen):
    screen.drain()
    screen.bench.clock.advance(screen.pump.wait_s())
    screen.drain()
    moving, still = [h for h in screen.headers if h.view == "airway"]
    assert (moving.full, moving.quality, moving.width) == (False, 85, 80)
    assert (still.full, still.quality, still.width, still.height) == (True, 95, 320, 240)
    assert screen.pump.wait_s() is None


def test_a_view_never_goes_back_to_an_older_pose(screen):
    screen.bench.renderers[-1].on_render = lambda _view: screen.bench.clock.advance(0.01)
    for _ in range(40):
        screen.bench.session.steer(0.5, 0.01, 0.0, 0.0)
        screen.pump.step()
        if len(screen.data) > 2:
            # The client lags by two pictures.
            screen.pump.acknowledge(screen.headers[-3].frame_id)
    for view in ("airway", "axial"):
        poses = [h.pose_id for h in screen.headers if h.view == view]
        assert len(poses) > 2
        assert poses == sorted(poses)
    frames = [h.frame_id for h in screen.headers]
    assert frames == sorted(set(frames))


def test_no_more_than_three_airway_pictures_are_under_way(screen):
    for _ in range(20):
        screen.bench.session.steer(0.5, 0.0, 0.0, 0.0)
        while screen.pump.step():
            pass
    assert [h.view for h in screen.headers].count("airway") == 3
    assert [h.view for h in screen.headers].count("axial") == 1


def test_only_visible_views_are_rendered(screen):
    screen.pump.set_layout({"axial": (120, 100)})
    screen.drain()
    assert {type(v) for v in screen.bench.renderers[-1].views} == {SliceView}


def test_a_picture_for_a_client_that_is_gone_is_not_delivered(screen):
    screen.bench.renderers[-1].on_render = lambda _view: screen.pump.new_client()
    assert screen.pump.step()
    assert screen.data == []
    assert not screen.pump.step()  # the new client has sent no layout


def test_a_view_that_cannot_be_rendered_is_told_once_and_the_others_go_on(screen):
    def refuse(view):
        if isinstance(view, AirwayView):
            raise RenderError("the camera is out of range", code="render.camera")

    screen.bench.renderers[-1].on_render = refuse
    screen.drain()
    screen.drain()
    assert [t for t in screen.told if isinstance(t, tuple)] == [("render.camera", "the camera is out of range")]
    assert [h.view for h in screen.headers] == ["axial"]


class Panic(BaseException):
    """As a panic of the compiled module arrives: no Exception."""


def test_neither_a_panic_nor_a_picture_that_cannot_be_encoded_ends_the_thread(screen):
    renderer = screen.bench.renderers[-1]
    whole = renderer.render

    def broken(view):
        if isinstance(view, AirwayView):
            raise Panic("index out of bounds")
        picture = whole(view)
        picture.lps_from_pixel = np.full((4, 4), np.nan)
        return picture

    renderer.render = broken
    screen.drain()
    assert screen.headers == []
    assert {words.partition(" could")[0] for _, words in screen.told} == {"the airway view", "the axial view"}
    renderer.render = whole
    screen.bench.session.set_fov(101.0)
    screen.drain()
    assert {h.view for h in screen.headers} >= {"airway"}


def test_a_fault_in_the_renderer_does_not_end_the_pump(screen, caplog):
    def break_down(view):
        raise ZeroDivisionError

    screen.bench.renderers[-1].on_render = break_down
    screen.drain()
    assert screen.told[0][0] == "carina.fault"
    assert "rendering failed" in caplog.text
    screen.bench.renderers[-1].on_render = lambda _view: None
    screen.bench.session.steer(1.0, 0.0, 0.0, 0.0)
    screen.drain()
    assert {h.view for h in screen.headers} == {"airway", "axial"}


def test_status_tells_frames_per_second_and_age(screen):
    clock = screen.bench.clock
    for _ in range(30):
        screen.bench.session.steer(0.2, 0.0, 0.0, 0.0)
        screen.bench.renderers[-1].on_render = lambda _view: clock.advance(0.02)
        while screen.pump.step():
            screen.pump.acknowledge(screen.headers[-1].frame_id)
            if screen.headers[-1].view == "airway":
                break
    status = [s for s in screen.told if isinstance(s, Status)][-1]
    # 20 ms for each picture, and every fourth is a slice.
    assert 35.0 < status.fps <= 50.0
    assert status.age_ms >= 20.0
    assert (status.threads, status.simd, status.method) == (2, "x", "brute")


def test_still_pictures_keep_their_colours_to_a_grey_level_or_two():
    rng = np.random.default_rng(7)
    smooth = np.repeat(np.repeat(rng.integers(0, 255, (6, 8, 3), dtype=np.uint8), 16, axis=0), 16, axis=1)
    data, quality = encode_jpeg(smooth, full=True)
    assert quality == 95
    # JPEG at q95 4:4:4: quantization steps of up to 5 in the coarse coefficients, so a few grey levels at most.
    assert np.abs(simplejpeg.decode_jpeg(data).astype(int) - smooth).max() <= 6
