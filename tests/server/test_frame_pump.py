"""Tests of the frame pump over a session, in steps of one picture in the thread of the test."""

from __future__ import annotations

import numpy as np
import pytest
import simplejpeg

from carina.commands import Cancel, SetCrosshair, SetFov, SetTransfer, Steer
from carina.errors import RenderError, UsageError
from carina.render import AirwayView, SliceView
from carina.server.frames.pump import FramePump, encode_jpeg
from carina.server.wire.messages import Status, parse_picture
from small_case import session_fixture


class Screen:
    """Frame pump with a list of the pictures that it delivered."""

    def __init__(self) -> None:
        self.fixture = session_fixture()
        self.data = []
        self.reported = []
        self.pump = FramePump(
            self.fixture.session.scene,
            self.data.append,
            self.reported.append,
            clock=self.fixture.clock,
            threads=2,
            simd="x",
        )

    @property
    def headers(self):
        return [parse_picture(d)[0] for d in self.data]

    def steer(self, **changes):
        """Move the tip slightly, a sixtieth of a second after the last movement."""
        self.fixture.clock.advance(1 / 60)
        self.fixture.session.do(Steer(changes.get("advance", 0.5), changes.get("yaw", 0.0), 0.0, 0.0))

    def drain(self, *, acknowledge=True):
        while self.pump.step():
            if acknowledge and self.data:
                self.pump.acknowledge(self.headers[-1].frame_id)


@pytest.fixture
def screen():
    screen = Screen()
    screen.fixture.open()
    screen.pump.set_layout({"airway": (320, 240), "axial": (120, 100)})
    return screen


def test_picture_pump_without_a_case_renders_no_picture():
    screen = Screen()
    screen.pump.set_layout({"airway": (320, 240)})
    assert not screen.pump.step()
    assert screen.pump.wait_s() is None


def test_header_of_a_picture_has_its_pose_number_and_geometry(screen):
    screen.drain()
    pose = screen.fixture.session.pose_info()
    airway = next(h for h in screen.headers if h.view == "airway")
    assert airway.pose_id == pose.pose_id
    np.testing.assert_array_equal(airway.lps_from_camera, pose.pose.lps_from_camera.ravel())
    assert airway.lps_from_pixel is None
    axial = next(h for h in screen.headers if h.view == "axial")
    assert axial.lps_from_camera is None
    assert len(axial.lps_from_pixel) == 16


def test_airway_picture_without_visible_content_is_marked_as_empty(screen):
    screen.drain()
    assert not any(h.empty for h in screen.headers)
    screen.fixture.renderers[-1].grey = 0
    screen.data.clear()
    screen.steer()
    screen.drain()
    # A black slice is not marked as empty, because the tip is drawn in the slice.
    assert {h.view: h.empty for h in screen.headers} == {"airway": True, "axial": False}


def test_moving_view_is_coarse_and_becomes_full_at_rest(screen):
    screen.drain()
    screen.fixture.clock.advance(screen.pump.wait_s())
    screen.drain()
    moving, still = [h for h in screen.headers if h.view == "airway"]
    assert (moving.full, moving.quality, moving.width) == (False, 85, 80)
    assert (still.full, still.quality, still.width, still.height) == (True, 95, 320, 240)
    assert screen.pump.wait_s() is None


def final_airway(screen):
    """Render until no picture is due; return whether the last airway picture is marked as final."""
    screen.drain()
    while (wait_s := screen.pump.wait_s()) is not None:
        screen.fixture.clock.advance(wait_s)
        screen.drain()
    return [h.full for h in screen.headers if h.view == "airway"][-1]


@pytest.mark.parametrize("ends", ["shown", "taken back", "stopped", "failed"])
def test_no_picture_is_marked_final_while_another_transfer_function_is_prepared(screen, ends):
    assert final_airway(screen)
    session, renderer = screen.fixture.session, screen.fixture.renderers[-1]

    def fail(_transfer):
        raise MemoryError

    session.do(SetTransfer(preset="ct-grey"))
    # This command requests another picture, with the transfer function that the renderer still has.
    session.do(SetFov(100.0))
    assert not final_airway(screen)
    assert [h.full for h in screen.headers if h.view == "axial"][-1], "a slice does not depend on it"
    if ends == "taken back":
        session.undo()
        session.undo()
    elif ends == "stopped":
        (job,) = session.jobs.running
        session.do(Cancel(job.job_id))
    elif ends == "failed":
        renderer.set_transfer = fail
    screen.fixture.background.run_all()
    assert final_airway(screen)


def test_pictures_of_a_view_never_show_an_older_pose_than_before(screen):
    screen.fixture.renderers[-1].on_render = lambda _view: screen.fixture.clock.advance(0.01)
    for _ in range(40):
        screen.steer(yaw=0.01)
        screen.pump.step()
        if len(screen.data) > 2:
            # The client has not yet acknowledged the last two pictures.
            screen.pump.acknowledge(screen.headers[-3].frame_id)
    for view in ("airway", "axial"):
        poses = [h.pose_id for h in screen.headers if h.view == view]
        assert len(poses) > 2
        assert poses == sorted(poses)
    frames = [h.frame_id for h in screen.headers]
    assert frames == sorted(set(frames))


def test_at_most_three_airway_pictures_are_unacknowledged(screen):
    for _ in range(20):
        screen.steer()
        while screen.pump.step():
            pass
    assert [h.view for h in screen.headers].count("airway") == 3
    assert [h.view for h in screen.headers].count("axial") == 1


def test_only_visible_views_are_rendered(screen):
    screen.pump.set_layout({"axial": (120, 100)})
    screen.drain()
    assert {type(v) for v in screen.fixture.renderers[-1].views} == {SliceView}


def test_picture_of_a_view_hidden_during_rendering_is_not_sent(screen):
    screen.fixture.renderers[-1].on_render = lambda _view: screen.pump.set_layout({})
    assert screen.pump.step()
    assert screen.data == []
    assert not screen.pump.step()


def test_view_that_cannot_be_rendered_is_reported_once_and_other_views_are_rendered(screen):
    def refuse(view):
        if isinstance(view, AirwayView):
            raise RenderError("the camera is out of range", code="render.camera")

    screen.fixture.renderers[-1].on_render = refuse
    screen.drain()
    screen.drain()
    assert [t for t in screen.reported if isinstance(t, tuple)] == [("render.camera", "the camera is out of range")]
    assert [h.view for h in screen.headers] == ["axial"]


class Panic(BaseException):
    """Panic of the compiled module, which is not an ``Exception``."""


def test_picture_pump_continues_after_a_panic_and_after_a_picture_that_cannot_be_encoded(screen):
    renderer = screen.fixture.renderers[-1]
    whole = renderer.render

    def broken(view, *, stop):
        if isinstance(view, AirwayView):
            raise Panic("index out of bounds")
        picture = whole(view)
        picture.lps_from_pixel = np.full((4, 4), np.nan)
        return picture

    renderer.render = broken
    screen.drain()
    assert screen.headers == []
    assert {text.partition(" could")[0] for _, text in screen.reported} == {"the airway view", "the axial view"}
    renderer.render = whole
    screen.fixture.clock.advance(1 / 60)
    screen.fixture.session.do(SetFov(101.0))
    screen.drain()
    assert {h.view for h in screen.headers} >= {"airway"}


def test_picture_pump_continues_after_an_internal_error_in_the_renderer(screen, caplog):
    def break_down(view):
        raise ZeroDivisionError

    screen.fixture.renderers[-1].on_render = break_down
    screen.drain()
    assert screen.reported[0][0] == "carina.fault"
    assert "rendering failed" in caplog.text
    screen.fixture.renderers[-1].on_render = lambda _view: None
    screen.steer()
    screen.drain()
    assert {h.view for h in screen.headers} == {"airway", "axial"}


def test_internal_error_after_rendering_is_reported_once_and_the_picture_is_not_rendered_again(screen, monkeypatch):
    made = []
    screen.fixture.renderers[-1].on_render = made.append
    scheduler = screen.pump._scheduler
    whole = scheduler.rendered

    def broken(order, *more, **others):
        if order.view == "airway":
            raise TypeError("no such field")
        return whole(order, *more, **others)

    monkeypatch.setattr(scheduler, "rendered", broken)
    for _ in range(3):
        screen.steer()
        # A pump that renders without an end fails here instead of blocking the test.
        assert sum(screen.pump.step() for _ in range(20)) < 20
    assert len([view for view in made if isinstance(view, AirwayView)]) == 3
    reported = [t for t in screen.reported if isinstance(t, tuple)]
    assert [code for code, _ in reported] == ["carina.fault"]
    assert "airway view" in reported[0][1] and "TypeError" in reported[0][1]
    assert {h.view for h in screen.headers} == {"axial"}


def test_unfinished_full_picture_is_cancelled_when_the_tip_moves(screen):
    screen.fixture.session.subscribe(lambda _event: screen.pump.content_changed())
    screen.drain()
    screen.fixture.clock.advance(screen.pump.wait_s())
    renderer = screen.fixture.renderers[-1]
    before = len(screen.data)

    def move_on(view):
        if isinstance(view, AirwayView) and view.width == 320:
            renderer.on_render = lambda _view: None
            screen.fixture.session.do(Steer(1.0, 0.0, 0.0, 0.0))

    renderer.on_render = move_on
    assert screen.pump.step()
    assert len(screen.data) == before, "the full picture of the pose that was left is not sent"
    screen.fixture.clock.advance(1 / 60)
    screen.drain()
    first = next(h for h in screen.headers[before:] if h.view == "airway")
    assert (first.full, first.pose_id) == (False, screen.fixture.session.pose_info().pose_id)
    screen.fixture.clock.advance(screen.pump.wait_s())
    screen.drain()
    assert [h.full for h in screen.headers if h.view == "airway"][-1]


def test_full_picture_is_not_cancelled_by_changes_that_it_does_not_show(screen):
    screen.fixture.session.subscribe(lambda _event: screen.pump.content_changed())
    screen.drain()
    screen.fixture.clock.advance(screen.pump.wait_s())
    x, y, z = screen.fixture.session.pose_info().pose.position_lps
    screen.fixture.renderers[-1].on_render = lambda _view: screen.fixture.session.do(SetCrosshair((x, y + 1.0, z)))
    assert screen.pump.step()
    assert (screen.headers[-1].view, screen.headers[-1].full) == ("airway", True)


def test_full_picture_shows_a_change_made_just_before_its_rendering_starts(screen):
    screen.drain()
    screen.fixture.clock.advance(screen.pump.wait_s())
    scene, scenes = screen.fixture.session.scene, []

    def moves_after_the_first_look():
        scenes.append(scene())
        if len(scenes) == 1:
            screen.fixture.session.do(Steer(1.0, 0.0, 0.0, 0.0))
        return scenes[-1]

    screen.pump._scene = moves_after_the_first_look
    before = len(screen.data)
    assert screen.pump.step()
    assert len(screen.data) == before
    screen.fixture.clock.advance(1 / 60)
    assert screen.pump.step()
    assert screen.headers[-1].pose_id == scenes[-1].pose_id


def test_cut_plane_replaces_a_slow_airway_view_and_is_labelled(screen):
    def slow(view):
        screen.fixture.clock.advance(0.3 if isinstance(view, AirwayView) else 0.002)

    screen.fixture.renderers[-1].on_render = slow
    for _ in range(12):
        screen.steer()
        screen.drain()
    stand_ins = [h for h in screen.headers if h.stands_for is not None]
    assert {(h.view, h.stands_for, h.full) for h in stand_ins} == {("cut-plane", "airway", False)}
    last = screen.headers[-1] if screen.headers[-1].stands_for else stand_ins[-1]
    assert last.pose_id == screen.fixture.session.pose_info().pose_id
    assert last.lps_from_pixel is not None, "its own geometry, so that marks fit what is shown"
    assert (last.width, last.height) == (320, 240)
    screen.fixture.clock.advance(1.0)
    screen.drain()
    at_rest = [h for h in screen.headers if "airway" in {h.view, h.stands_for}][-1]
    assert (at_rest.view, at_rest.stands_for, at_rest.full) == ("airway", None, True)


def test_click_refers_to_the_picture_that_was_on_the_screen_and_not_to_a_newer_one(screen):
    screen.drain()
    shown = screen.headers[0]
    for _ in range(5):
        screen.steer()
        screen.drain()
    picture = screen.pump.shown(shown.frame_id)
    np.testing.assert_array_equal(picture.view.pose.lps_from_camera.ravel(), shown.lps_from_camera)
    assert (picture.width, picture.height) == (shown.width, shown.height) == (80, 60)
    renderer = screen.fixture.renderers[-1]
    assert picture.wall_at(20.5, 60.0) is None
    # A click in the coarse picture has the precision of the full one of 320 x 240; its lower edge is the last row.
    assert renderer.picks == [(picture.view, 82, 239)]
    with pytest.raises(UsageError, match="outside the image of 80 x 60"):
        picture.wall_at(80.5, 3.0)
    axial = next(h for h in screen.headers if h.view == "axial")
    assert screen.pump.shown(axial.frame_id) is None
    for _ in range(100):
        screen.steer()
        screen.drain()
    assert screen.pump.shown(shown.frame_id) is None, "only the newest pictures are stored"


class Network:
    """Client over an unreliable network: random delays of pictures and acks, lost acks, and interrupted sockets.

    The class also simulates the check of the client (``web/src/net/pictures.ts``): a picture that is older than the
    shown one is not drawn.
    """

    def __init__(self, screen, rng) -> None:
        self.screen, self.rng = screen, rng
        self.line = []
        self.shown = {}
        self.drawn = []
        self.due_s = 0.0
        screen.pump._deliver = self.deliver

    def deliver(self, data):
        header = parse_picture(data)[0]
        # A socket keeps the order of its messages.
        self.due_s = max(self.due_s, self.screen.fixture.clock() + self.rng.exponential(0.03))
        self.line.append((self.due_s, header))

    def arrive(self):
        now_s = self.screen.fixture.clock()
        while self.line and self.line[0][0] <= now_s:
            _, header = self.line.pop(0)
            place = header.stands_for or header.view
            order = (header.pose_id, header.frame_id)
            if order > self.shown.get(place, (-1, -1)):
                self.shown[place] = order
                self.drawn.append((place, header.pose_id))
            if self.rng.random() > 0.05:
                self.screen.pump.acknowledge(header.frame_id)

    def hide_and_show(self):
        self.line.clear()
        self.shown.clear()
        self.drawn.append(("hidden", 0))
        self.screen.pump.set_layout({})
        self.screen.pump.set_layout({"airway": (320, 240), "axial": (120, 100)})


@pytest.mark.parametrize("seed", range(8))
def test_poses_arrive_in_order_and_the_newest_pose_arrives_over_an_unreliable_network(screen, seed):
    rng = np.random.default_rng(seed)
    network = Network(screen, rng)
    clock = screen.fixture.clock
    slow = rng.random() < 0.5
    screen.fixture.renderers[-1].on_render = lambda view: clock.advance(
        float(rng.exponential(0.4 if slow and isinstance(view, AirwayView) else 0.01))
    )
    for _ in range(400):
        if rng.random() < 0.7:
            screen.fixture.session.do(Steer(float(rng.normal(0.0, 0.3)), 0.01, 0.0, 0.0))
        if rng.random() < 0.01:
            network.hide_and_show()
        clock.advance(float(rng.exponential(0.01)))
        screen.pump.step()
        network.arrive()
    # The hand rests: lost pictures time out, and then the full picture of the newest pose arrives.
    screen.fixture.renderers[-1].on_render = lambda _view: clock.advance(0.01)
    for _ in range(400):
        while screen.pump.step():
            network.arrive()
        clock.advance(0.05)
        network.arrive()
    sessions = [[]]
    for place, pose_id in network.drawn:
        if place == "hidden":
            sessions.append([])
        else:
            sessions[-1].append((place, pose_id))
    for drawn in sessions:
        for view in ("airway", "axial"):
            poses = [pose_id for place, pose_id in drawn if place == view]
            assert poses == sorted(poses)
    newest = screen.fixture.session.pose_info().pose_id
    assert network.shown["airway"][0] == newest


def test_status_reports_frames_per_second_and_age_of_the_picture(screen):
    clock = screen.fixture.clock
    for _ in range(30):
        screen.steer(advance=0.2)
        screen.fixture.renderers[-1].on_render = lambda _view: clock.advance(0.002)
        while screen.pump.step():
            screen.pump.acknowledge(screen.headers[-1].frame_id)
            if screen.headers[-1].view == "airway":
                break
    status = [s for s in screen.reported if isinstance(s, Status)][-1]
    # The hand moves every 17 ms, and a picture takes 2 ms.
    assert 45.0 < status.fps <= 60.0
    assert status.age_ms >= 2.0
    assert (status.threads, status.simd, status.method) == (2, "x", "brute")


def test_colours_of_full_pictures_are_encoded_within_six_grey_levels():
    rng = np.random.default_rng(7)
    smooth = np.repeat(np.repeat(rng.integers(0, 255, (6, 8, 3), dtype=np.uint8), 16, axis=0), 16, axis=1)
    data, quality = encode_jpeg(smooth, full=True)
    assert quality == 95
    # At q95 and 4:4:4, JPEG has quantisation steps of up to 5 in the coarse coefficients, so errors of a few grey
    # levels.
    assert np.abs(simplejpeg.decode_jpeg(data).astype(int) - smooth).max() <= 6


def test_rendering_time_without_waits_determines_the_picture_size(screen):
    screen.drain()
    renderer = screen.fixture.renderers[-1]

    def width_of_a_flight(rays_s):
        renderer.rays_s = rays_s
        for _ in range(80):
            screen.steer()
            screen.drain()
        return [h.width for h in screen.headers if h.view == "airway"][-1]

    # Each picture takes 40 ms of elapsed time, of which nearly all or nearly none is used for rays.
    renderer.on_render = lambda _view: screen.fixture.clock.advance(0.040)
    assert width_of_a_flight(0.038) < 0.5 * 320
    assert width_of_a_flight(0.001) > 0.8 * 320
