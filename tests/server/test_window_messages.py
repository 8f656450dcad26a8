"""Tests of messages between a window and the complete server: real sockets, real threads, a small case."""

from __future__ import annotations

import json
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from live_server import SHOWN, WAIT_S, open_case, running

from carina.render import TransferFunction
from carina.server.windows import broadcast_cache
from carina.server.windows import window as a_window
from carina.server.wire import messages as wire
from small_case import BRANCHES_IJK, small_volume


def lps(ijk):
    return tuple(float(v) for v in small_volume().to_lps(ijk))


def test_thousands_of_movements_and_acknowledgements_of_unknown_frames_do_not_block_the_session(live):
    with live.window() as window:
        window.send(SHOWN)
        open_case(window)
        # The 3000 movements of 0.001 mm are those of three minutes of a loop of 16 ms, sent at once.
        window.send(*(wire.Steer(0.001, 0.0, 0.0, 0.0) for _ in range(3000)))
        window.send(*(wire.Ack(10**9 + n) for n in range(1000)))
        window.send(wire.SetFov(77.0))
        window.until_state(lambda s: s.look.fov_deg == 77.0)
        window.until(lambda m: isinstance(m, wire.PictureHeader) and m.full)
        last = live.session.pose_info()
        assert last.path_mm == pytest.approx(3.0)


def test_poses_are_sent_while_a_tree_is_encoded_and_the_route_is_sent_after_the_tree(live, monkeypatch):
    may_end, written = threading.Event(), broadcast_cache.tree_message

    def slowly(airways, measures):
        assert airways is None or may_end.wait(WAIT_S)
        return written(airways, measures)

    monkeypatch.setattr(broadcast_cache, "tree_message", slowly)
    with live.window() as window:
        window.send(SHOWN)
        open_case(window)
        before = len(window.seen)
        window.send(wire.Steer(1.0, 0.0, 0.0, 0.0))
        window.until(lambda m: isinstance(m, wire.PoseMessage) and m.path_mm == pytest.approx(1.0))
        assert not [m for m in window.seen[before:] if isinstance(m, wire.Tree | wire.RouteMessage)]
        may_end.set()
        tree = window.until(lambda m: isinstance(m, wire.Tree | wire.RouteMessage))
        assert isinstance(tree, wire.Tree) and tree.tree is not None
        assert window.until(lambda m: isinstance(m, wire.RouteMessage)).route is not None

    # Another window receives tree and route, although nothing changed.
    with live.window() as window:
        window.until(lambda m: isinstance(m, wire.Tree) and m.tree is not None)
        window.until(lambda m: isinstance(m, wire.RouteMessage) and m.route is not None)


def test_first_messages_to_a_window_contain_all_data_of_the_start_page(live):
    with live.window() as window:
        start = window.until(lambda m: isinstance(m, wire.Start))
        assert not start.notice_accepted
        assert [d.name for d in start.demos] == ["phantom", "patient"]
        state = window.until_state(lambda s: True)
        assert (state.case, state.stage) == (None, "empty")
        window.send(wire.AcceptNotice())
        assert window.until(lambda m: isinstance(m, wire.Start)).notice_accepted


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("not json", 4400),
        ('{"type": "go_to", "path_mm": NaN}', 4400),
        ('{"type": "launch"}', 4400),
        ('{"type": "undo", "twice": true}', 4400),
        (b"\x00\x01", 4400),
    ],
)
def test_malformed_message_closes_the_websocket_with_its_code_and_a_reason(live, text, code):
    with live.window() as window:
        window.socket.send(text)
        closed, reason = window.close_code()
        assert closed == code
        assert len(reason) > 15


def test_window_is_disconnected_if_its_state_message_cannot_be_encoded(live, monkeypatch):
    """Check that no window without updates shows an old state as if it were the present one."""
    monkeypatch.setattr(a_window, "state_message", lambda *_, **__: wire.Value((0.0, 0.0, float("nan")), None))
    with live.window(hello=False) as window:
        window.send(wire.ClientHello(wire.WIRE_VERSION))
        assert window.close_code()[0] == 1011


def test_websocket_with_another_wire_version_or_without_a_hello_message_is_refused(live):
    with live.window(hello=False) as window:
        window.send(wire.ClientHello(99))
        assert window.close_code()[0] == 4402
    with live.window(hello=False) as window:
        window.send(wire.Undo())
        assert window.close_code()[0] == 4403


def test_second_hello_message_is_answered_with_an_error(live):
    with live.window() as window:
        window.send(wire.ClientHello(wire.WIRE_VERSION))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "protocol.order"


def test_message_over_the_size_limit_closes_the_websocket(live):
    with live.window() as window:
        window.socket.send('{"type": "open_path", "path": "' + "x" * 300_000 + '"}')
        assert window.close_code()[0] in {1009, 4400}


def test_failed_command_is_answered_with_an_error_and_the_websocket_stays_open(live):
    with live.window() as window:
        window.send(wire.NextFork())
        error = window.until(lambda m: isinstance(m, wire.Error))
        assert (error.code, error.message) == ("session.no-case", "no case is open")
        open_case(window)


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ({"type": "set_fov", "fov_deg": 171}, ["170", "171"]),
        ({"type": "set_fov", "fov_deg": 59}, ["60", "59"]),
        ({"type": "layout", "views": [{"view": "airway", "width": 0, "height": 64}]}, ["16", "0"]),
        ({"type": "layout", "views": [{"view": "airway", "width": 8193, "height": 64}]}, ["4096", "8193"]),
    ],
)
def test_value_out_of_range_closes_the_websocket_with_the_value_and_the_range(live, message, words):
    with live.window() as window:
        window.socket.send(json.dumps(message))
        closed, reason = window.close_code()
        assert closed == 4400
        assert all(word in reason for word in words), reason


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([], "at least one point"),
        ([[5, 1, 1, 1, 0], [4, 1, 1, 1, 1]], "found 4 at point 1 after 5"),
        ([[0, 1, 2, 1, 0.5]], "0 to 1; found at point 0"),
    ],
)
def test_invalid_transfer_function_is_refused_and_the_previous_one_stays_in_use(tmp_path, points, words):
    with running(tmp_path, transfer_from_json=TransferFunction.from_json) as live, live.window() as window:
        before = open_case(window)
        document = {"format": "carina-transfer", "version": 1, "points": points}
        window.send(wire.SetTransfer(preset=None, document=document))
        error = window.until(lambda m: isinstance(m, wire.Error))
        assert error.code == "render.transfer"
        assert words in error.message
        window.send(wire.SetShading(on=not before.sight.shading))
        assert window.until_state(lambda s: s.sight.shading is not before.sight.shading).transfer == before.transfer


def test_outline_setting_is_undone_over_the_wire_and_fine_texture_is_not_an_undo_step(live):
    with live.window() as window:
        assert open_case(window).sight.texture
        window.send(wire.SetOutline("octagon"))
        assert window.until_state(lambda s: s.look.outline == "octagon").can_undo == "image outline"
        window.send(wire.SetTexture(on=False))
        assert window.until_state(lambda s: not s.sight.texture).can_undo == "image outline"
        window.send(wire.Undo())
        undone = window.until_state(lambda s: s.look.outline == "round")
        assert (undone.can_undo, undone.can_redo, undone.sight.texture) == (None, "image outline", False)


def test_opening_a_case_sends_state_tree_route_pose_and_pictures_of_all_views(live):
    with live.window() as window:
        window.send(SHOWN)
        state = open_case(window)
        assert state.case.title == live.session.snapshot().neutral_title
        assert state.case.ct_name == "Thorax 1.5", "the user at this machine may read it"
        assert state.case.other_series[0].refused == "too few slices"
        window.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "tree" and m.full)
        tree = window.received(lambda m: isinstance(m, wire.Tree) and m.tree is not None).tree
        assert [b.name for b in tree.branches] == ["Trachea", "RMB", "LMB", None]
        route = window.received(lambda m: isinstance(m, wire.RouteMessage) and m.route is not None).route
        assert route.branch_id == 3
        assert len(route.points_lps) == len(route.cumulative_mm) == len(route.generation) == len(route.radius_mm)
        assert {p.view for p in window.pictures} == {"airway", "axial", "tree"}
        (route,) = [m.route for m in window.seen if isinstance(m, wire.RouteMessage) and m.route is not None][-1:]


def test_poses_of_a_flight_arrive_in_order(live):
    with live.window() as window:
        window.send(SHOWN)
        open_case(window)
        for n in range(1, 31):
            window.send(wire.Steer(0.5, 0.01, 0.0, 0.0))
            last = window.until(lambda m, n=n: isinstance(m, wire.PoseMessage) and m.path_mm == pytest.approx(0.5 * n))
        still = window.until(
            lambda m: isinstance(m, wire.PictureHeader) and m.view == "airway" and m.full and m.pose_id >= last.pose_id
        )
        assert (still.width, still.height) == (160, 120)
        assert still.lps_from_camera == last.lps_from_camera
        for view in ("airway", "axial"):
            poses = [p.pose_id for p in window.pictures if p.view == view]
            assert poses == sorted(poses)
        # A picture contains the number of a pose that was sent before, because pose numbers only increase.
        poses = [m.pose_id for m in window.seen if isinstance(m, wire.PoseMessage)]
        assert poses == sorted(set(poses))


def test_without_acknowledgements_at_most_three_airway_pictures_are_sent(live):
    with live.window() as window:
        window.send(wire.Layout((wire.ViewSize("airway", 160, 120),)))
        window.send(wire.OpenPath("case"))
        window.until(lambda m: isinstance(m, wire.State) and m.airways == "found", acknowledge=False)
        for _ in range(20):
            window.send(wire.Steer(0.5, 0.0, 0.0, 0.0))
            window.until(lambda m: isinstance(m, wire.PoseMessage), acknowledge=False)
        # The answer to this command comes after all earlier messages were handled.
        window.send(wire.SetFov(115.0))
        window.until(lambda m: isinstance(m, wire.State) and m.look.fov_deg == 115.0, acknowledge=False)
        while len(window.pictures) < 3:
            window.next()
        window.send(wire.SetFov(110.0))
        window.until(lambda m: isinstance(m, wire.State) and m.look.fov_deg == 110.0, acknowledge=False)
        assert len(window.pictures) == 3
        window.send(*(wire.Ack(p.frame_id) for p in window.pictures))
        newest = window.until(lambda m: isinstance(m, wire.PictureHeader))
        assert newest.pose_id == [m for m in window.seen if isinstance(m, wire.PoseMessage)][-1].pose_id


def test_click_in_the_airway_view_is_answered_with_the_wall_point(live):
    with live.window() as window:
        window.send(SHOWN)
        open_case(window)
        shown = window.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "airway" and m.full)
        window.send(wire.Pick(pick_id=1, frame_id=shown.frame_id, column=80.5, row=60.5))
        nothing = window.until(lambda m: isinstance(m, wire.Picked))
        assert (nothing.pick_id, nothing.lps, nothing.depth_mm, nothing.voxel_value) == (1, None, None, None)
        # The point is in a voxel of tissue beside the trachea.
        wall = lps((18.2, 14.0, 30.0))
        live.session.scene().renderer.hit = SimpleNamespace(position_lps=np.array(wall), depth_mm=7.126)
        window.send(wire.Pick(pick_id=2, frame_id=shown.frame_id, column=12.0, row=100.0))
        found = window.until(lambda m: isinstance(m, wire.Picked))
        assert found == wire.Picked(2, wall, 7.13, 40, 0, "Trachea", 0)
        view, column, row = live.session.scene().renderer.picks[-1]
        assert (column, row) == (12, 100)
        np.testing.assert_array_equal(view.pose.lps_from_camera.ravel(), shown.lps_from_camera)
        window.send(wire.Pick(pick_id=3, frame_id=10_000_000, column=12.0, row=100.0))
        assert window.until(lambda m: isinstance(m, wire.Error)).code == "session.pick"


def test_changed_frame_rate_is_reported_to_the_window(live):
    with live.window() as window:
        assert window.until_state(lambda s: True).frame_rate_hz == 60.0
        window.send(wire.SetFrameRate(24.0))
        assert window.until_state(lambda s: s.frame_rate_hz != 60.0).frame_rate_hz == 24.0
    with live.window() as later:
        assert later.until_state(lambda s: True).frame_rate_hz == 24.0


def test_unreadable_file_leaves_the_session_unchanged_and_the_window_receives_the_reason(live):
    with live.window() as window:
        before = open_case(window)
        window.send(wire.OpenPath("/scans/bad"))
        error = window.until(lambda m: isinstance(m, wire.Error))
        assert error.message == "/scans/bad holds no images: choose a DICOM folder"
        assert window.until(lambda m: isinstance(m, wire.Done) and m.outcome == "failed")
        window.send(wire.SetFov(100.0))
        assert window.until_state(lambda s: s.look.fov_deg == 100.0).case == before.case


def test_targets_are_undone_and_redone_over_the_wire(live):
    left = lps(BRANCHES_IJK[2][1][1])
    with live.window() as window:
        open_case(window)
        window.send(wire.AddTarget(left))
        added = window.until_state(lambda s: len(s.targets) == 1)
        assert (added.can_undo, added.route_id) == ("add Target 1", "target-1")
        window.received(
            lambda m: isinstance(m, wire.RouteMessage) and m.route is not None and m.route.target_id == "target-1"
        )
        window.send(wire.Undo())
        undone = window.until_state(lambda s: not s.targets)
        assert (undone.can_redo, undone.route_id) == ("add Target 1", "branch-3")
        window.send(wire.Redo())
        assert window.until_state(lambda s: len(s.targets) == 1).targets == added.targets


def test_tree_and_route_are_not_sent_again_after_a_change_of_other_state(live):
    with live.window() as window:
        open_case(window)

        window.received(lambda m: isinstance(m, wire.Tree) and m.tree is not None)
        window.received(lambda m: isinstance(m, wire.RouteMessage) and m.route is not None)
        # Answers come in order, so after this answer no message of the opening is pending.
        window.send(wire.SetFov(95.0))
        window.until_state(lambda s: s.look.fov_deg == 95.0)
        window.seen.clear()
        for fov_deg in (100.0, 110.0, 120.0):
            window.send(wire.SetFov(fov_deg))
            window.until_state(lambda s, fov_deg=fov_deg: s.look.fov_deg == fov_deg)
        assert not [m for m in window.seen if isinstance(m, wire.Tree | wire.RouteMessage | wire.PoseMessage)]


def test_airway_search_can_be_cancelled_without_losing_the_pictures(tmp_path):
    reached, stopped = threading.Event(), threading.Event()

    def find_airways(volume, *, progress, cancel, **_options):
        progress("growing the lumen", 0.3)
        reached.set()
        while not cancel():
            stopped.wait(0.001)  # A real search checks for cancellation as often.
        progress("growing the lumen", 0.4)

    with running(tmp_path, find_airways=find_airways) as live, live.window() as window:
        window.send(SHOWN, wire.OpenPath("case"))
        job = window.until(lambda m: isinstance(m, wire.Progress) and m.what == "growing the lumen")
        assert (job.title, job.fraction) == ("segmenting the airways", 0.3)
        assert reached.wait(WAIT_S)
        window.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "airway")
        window.send(wire.Cancel(job.job_id))
        done = window.until(lambda m: isinstance(m, wire.Done) and m.job_id == job.job_id)
        assert done.outcome == "cancelled"
        window.send(wire.Steer(1.0, 0.0, 0.0, 0.0))
        pose = window.until(lambda m: isinstance(m, wire.PoseMessage))
        window.until(lambda m: isinstance(m, wire.PictureHeader) and m.pose_id >= pose.pose_id and m.view == "airway")


def test_reloaded_window_receives_the_complete_state_and_new_pictures(live):
    with live.window() as window:
        window.send(SHOWN)
        before = open_case(window)
        window.send(wire.GoTo(20.0))
        pose = window.until(lambda m: isinstance(m, wire.PoseMessage) and m.path_mm == 20.0)
    with live.window() as window:
        assert window.until_state(lambda s: True).case == before.case
        assert window.received(lambda m: isinstance(m, wire.Tree) and m.tree is not None)
        assert window.received(lambda m: isinstance(m, wire.RouteMessage) and m.route is not None)
        assert window.received(lambda m: isinstance(m, wire.PoseMessage)) == pose
        window.send(SHOWN)
        for view in ("airway", "axial", "tree"):
            if view not in {p.view for p in window.pictures}:
                window.until(lambda m, view=view: isinstance(m, wire.PictureHeader) and m.view == view)
