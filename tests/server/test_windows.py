"""Tests of several windows on one session: common state, separate view settings, and independence of each other."""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time

import pytest
from live_server import SHOWN, WAIT_S, open_case, running
from starlette.websockets import WebSocket

from carina.errors import VolumeImportError
from carina.server.hub import MAX_WINDOWS
from carina.server.wire import messages as wire
from carina.session import Session
from small_case import LEFT_TIP, small_volume


@pytest.fixture
def two(live):
    """Return two windows with the same case, which the first has opened."""
    with live.window() as first, live.window() as second:
        for window in (first, second):
            window.send(SHOWN)
        open_case(first)
        second.until_state(lambda s: s.airways == "found")
        yield first, second


def newest(window, kind):
    """Return the newest received message of the class ``kind``, or wait for the first one."""
    return next((m for m in reversed(window.seen) if isinstance(m, kind)), None) or window.until(
        lambda m: isinstance(m, kind)
    )


def settle(window):
    """Wait until the server has handled all messages that the window has sent."""
    window.send(wire.Probe((0.5, 0.0, 0.0)))
    window.until(lambda m: isinstance(m, wire.Value) and m.lps == (0.5, 0.0, 0.0))


def test_case_pose_route_and_history_are_equal_in_all_windows(two):
    first, second = two
    first.send(wire.GoTo(20.0))
    pose = second.until(lambda m: isinstance(m, wire.PoseMessage) and m.path_mm == 20.0)
    assert first.until(lambda m: isinstance(m, wire.PoseMessage) and m.path_mm == 20.0) == pose
    second.send(wire.AddTarget(LEFT_TIP))
    for window in two:
        state = window.until_state(lambda s: len(s.targets) == 1)
        assert state.can_undo is not None
    first.send(wire.Undo())
    for window in two:
        assert window.until_state(lambda s: not s.targets).can_redo is not None
    for window in two:
        settle(window)
    histories = [newest(window, wire.HistoryMessage) for window in two]
    assert histories[0] == histories[1]
    trees = [window.received(lambda m: isinstance(m, wire.Tree) and m.tree is not None) for window in two]
    assert trees[0] == trees[1]


def test_view_settings_of_one_window_are_unchanged_by_another(two, live):
    first, second = two
    num_seen = len(second.seen)
    first.send(wire.SetWindow(400.0, 40.0), wire.SetCrosshair(LEFT_TIP), wire.SetTexture(on=False))
    sight = first.until_state(lambda s: not s.sight.texture).sight
    assert (sight.window.width_hu, sight.crosshair_lps) == (400.0, LEFT_TIP)
    settle(second)
    assert not [m for m in second.seen[num_seen:] if isinstance(m, wire.State)]
    second.send(wire.SetFov(77.0))
    for window in two:
        window.until_state(lambda s: s.look.fov_deg == 77.0)
    assert newest(second, wire.State).sight.texture
    assert newest(first, wire.State).sight == sight
    # The case stores the latest sight; a new window starts with it.
    with live.window() as third:
        assert third.until_state(lambda s: s.case is not None).sight == sight
        second.send(wire.SetSlab(10.0, "max"))
        second.until_state(lambda s: s.sight.slab.thickness_mm == 10.0)
        settle(third)
        assert newest(third, wire.State).sight == sight
    assert live.session.snapshot().sight.slab.thickness_mm == 10.0


def test_pictures_have_the_size_and_settings_of_their_window_and_a_hidden_view_gets_none(two):
    first, second = two
    second.send(wire.Layout((wire.ViewSize("axial", 200, 150),)))
    # A picture of the earlier size that was being rendered is still sent; the new size follows.
    second.until(lambda m: isinstance(m, wire.PictureHeader) and (m.width, m.height) == (200, 150) and m.full)
    begun = len(second.pictures)
    first.send(wire.Steer(1.0, 0.0, 0.0, 0.0))
    picture = second.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "axial" and m.full)
    assert (picture.width, picture.height) == (200, 150)
    assert {p.view for p in second.pictures[begun:]} == {"axial"}
    first.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "airway" and m.pose_id >= picture.pose_id)
    # A change of the first window's view settings requests no picture for the second window.
    second.send(wire.Layout(()))
    settle(second)
    begun = len(second.pictures)
    first.send(wire.SetCrosshair(LEFT_TIP))
    first.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "axial" and m.full)
    settle(second)
    assert len(second.pictures) == begun


def test_edits_of_two_windows_form_one_history_and_each_window_undoes_the_last_edit(two):
    first, second = two
    for n in range(5):
        first.send(wire.SetFov(70.0 + n))
        first.until_state(lambda s, n=n: s.look.fov_deg == 70.0 + n)
        second.send(wire.SetOperator("facing" if n % 2 == 0 else "head"))
        second.until_state(lambda s, n=n: s.look.operator == ("facing" if n % 2 == 0 else "head"))
    for window in two:
        settle(window)
    labels = [[step.label for step in newest(window, wire.HistoryMessage).steps] for window in two]
    assert labels[0] == labels[1]
    assert labels[0][-4:] == ["field of view", "operator position"] * 2
    second.send(wire.Undo())
    assert first.until_state(lambda s: s.look.operator == "head").can_redo == "operator position"
    first.send(wire.Undo())
    assert second.until_state(lambda s: s.look.fov_deg == 73.0).can_redo == "field of view"


def test_errors_and_answers_are_sent_only_to_the_requesting_window(two):
    first, second = two
    num_seen = len(second.seen)
    first.send(wire.RemoveTarget("nobody"), wire.Probe(LEFT_TIP))
    first.until(lambda m: isinstance(m, wire.Error))
    first.until(lambda m: isinstance(m, wire.Value) and m.lps == pytest.approx(LEFT_TIP))
    settle(second)
    others = [m for m in second.seen[num_seen:] if isinstance(m, wire.Error) or getattr(m, "lps", None) == LEFT_TIP]
    assert others == []


def test_error_of_a_job_is_sent_to_the_requesting_window_or_to_all_windows_if_it_is_closed(tmp_path):
    may_fail = threading.Event()

    def open_volume(path, progress, cancel):
        if path == "case":
            return small_volume()
        progress("looking", None)
        assert may_fail.wait(WAIT_S)
        raise VolumeImportError("no CT here", code="import.nothing")

    def is_looking(message):
        return isinstance(message, wire.Progress) and message.what == "looking"

    def is_error(message):
        return isinstance(message, wire.Error)

    with running(tmp_path, open_volume=open_volume) as live, live.window() as other:
        with live.window() as asker:
            open_case(other)
            asker.send(wire.OpenPath("nowhere"))
            asker.until(is_looking)
            may_fail.set()
            assert asker.until(is_error).code == "import.nothing"
            other.until(lambda m: isinstance(m, wire.Done))
            settle(other)
            assert not list(filter(is_error, other.seen))
            may_fail.clear()
            asker.send(wire.OpenPath("nowhere"))
            asker.until(is_looking)
        while len(live.session._core.windows) > 1:
            settle(other)
        may_fail.set()
        assert other.until(is_error).code == "import.nothing"


def test_handled_message_is_sent_after_the_results_of_the_command(two):
    first, second = two
    before = newest(first, wire.Handled).number
    assert not [m for m in second.seen if isinstance(m, wire.Handled)]
    first.send(*(wire.SetFov(80.0 + n / 10.0) for n in range(30)), wire.Probe(LEFT_TIP), wire.RemoveTarget("nobody"))
    first.until(lambda m: isinstance(m, wire.Handled) and m.number == before + 31)
    assert newest(first, wire.State).look.fov_deg == pytest.approx(82.9)


def test_handled_message_is_not_sent_before_results_for_any_order_of_sender_and_events(live, monkeypatch):
    do, send_text, held = Session.do, WebSocket.send_text, []

    async def send_when_let(self, text):
        if wire.encode_message(wire.Value(LEFT_TIP, None))[:15] == text[:15]:
            held.append(asyncio.get_running_loop().create_future())
            await held[-1]
        await send_text(self, text)

    def let_send_and_do(self, command, **options):
        if isinstance(command, wire.SetSlab):
            # The sender runs before the events of this command are announced.
            held.pop().set_result(None)
        return do(self, command, **options)

    with live.window() as window:
        open_case(window)
        before = newest(window, wire.Handled).number
        monkeypatch.setattr(WebSocket, "send_text", send_when_let)
        monkeypatch.setattr(Session, "do", let_send_and_do)
        for number, thickness_mm in enumerate((10.0, 5.0, 0.0), before + 1):
            window.send(wire.Probe(LEFT_TIP))
            deadline_s = time.monotonic() + WAIT_S
            while not held and time.monotonic() < deadline_s:
                threading.Event().wait(0.001)
            window.send(wire.SetSlab(thickness_mm=thickness_mm, kind="max"))
            window.until(lambda m, number=number: isinstance(m, wire.Handled) and m.number == number)
            assert newest(window, wire.State).sight.slab.thickness_mm == thickness_mm


def test_window_that_does_not_read_its_messages_delays_no_other_window(two):
    first, second = two
    # The second window acknowledges no picture and reads no message.
    for n in range(200):
        first.send(wire.GoTo(10.0 + n / 10.0))
    pose = first.until(lambda m: isinstance(m, wire.PoseMessage) and m.path_mm == pytest.approx(29.9))
    first.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "airway" and m.pose_id == pose.pose_id)
    # The second window later reads only the newest messages.
    second.until(lambda m: isinstance(m, wire.PoseMessage) and m.pose_id == pose.pose_id)


def test_other_windows_are_unchanged_after_one_is_closed(two, live):
    first, second = two
    first.send(wire.SetWindow(400.0, 40.0))
    first.until_state(lambda s: s.sight.window is not None and s.sight.window.width_hu == 400.0)
    first.socket.close()
    second.send(wire.Steer(1.0, 0.0, 0.0, 0.0))
    pose = second.until(lambda m: isinstance(m, wire.PoseMessage))
    second.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "airway" and m.pose_id >= pose.pose_id)
    second.send(wire.SetShading(on=False))
    assert second.until_state(lambda s: not s.sight.shading).sight.window.width_hu != 400.0


def test_window_beyond_the_limit_is_refused_until_another_window_closes(live):
    with contextlib.ExitStack() as opened:
        windows = [opened.enter_context(live.window()) for _ in range(MAX_WINDOWS)]
        with live.window(hello=False) as refused:
            refused.send(wire.ClientHello(wire.WIRE_VERSION))
            code, reason = refused.close_code()
            assert code == wire.CLOSE_CODES["protocol.too-many-windows"] == 4429
            assert reason == "Carina is already open in 8 windows; close one of them, then connect again"
        windows[0].socket.close()
        with live.window() as another_neutral_path:
            another_neutral_path.until_state(lambda _state: True)
        windows[1].send(wire.AskStorage())


def test_opening_another_case_resets_the_view_settings_of_all_windows(two):
    first, second = two
    begun = newest(second, wire.State).sight
    first.send(wire.SetTexture(on=False))
    first.until_state(lambda s: not s.sight.texture)
    first.send(wire.OpenPath("another"))
    for window in two:
        assert window.until_state(lambda s: s.case is not None and s.case.number == 2).sight == begun


def test_device_list_is_sent_to_all_windows_and_device_values_only_while_a_window_watches(two):
    first, second = two
    for window in two:
        window.send(wire.WatchDevices(on=True))
        window.until(lambda m: isinstance(m, wire.DevicesMessage))
    first.send(wire.WatchDevices(on=False))
    settle(first)
    for _ in range(3):
        second.until(lambda m: isinstance(m, wire.DevicesMessage))
