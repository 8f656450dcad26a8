"""A flood of movements makes nobody wait, and loses none of them."""

from __future__ import annotations

import asyncio
import contextlib
import math
import threading
import time

import numpy as np
import pytest
from live_server import open_case
from websockets.exceptions import ConnectionClosed

from carina.server import messages as wire
from carina.server.inbox import MAX_WAITING, Inbox
from carina.session import Session


def steer(advance_mm=0.0, yaw_rad=0.0, pitch_rad=0.0, roll_rad=0.0):
    return wire.Steer(advance_mm, yaw_rad, pitch_rad, roll_rad)


def done(*messages):
    """What is done of messages that come faster than anything is done."""
    did = []

    async def run():
        inbox = Inbox(did.append)
        for message in messages:
            await inbox.put(message)
        inbox.finish()

    asyncio.run(run())
    return did


def test_movements_that_follow_each_other_add_up():
    [one] = done(steer(1.0, roll_rad=0.1), steer(-0.25, 0.5), steer(pitch_rad=2.0))
    assert one == steer(0.75, 0.5, 2.0, 0.1)


def test_what_comes_between_movements_stays_between_them():
    messages = [steer(1.0), steer(1.0), wire.ToggleMode(), steer(2.0), wire.NextFork(), wire.NextFork(), steer(3.0)]
    assert done(*messages) == [steer(2.0), *messages[2:]]


def test_of_wishes_the_newest_counts_for_each_view_and_others_all_count():
    def orbit(view, azimuth_deg):
        return wire.SetOrbit(view=view, azimuth_deg=azimuth_deg, elevation_deg=0.0)

    messages = [orbit("tree", 1.0), orbit("tree", 2.0), orbit("tri-plane", 3.0), wire.Undo(), wire.Undo(), wire.Undo()]
    assert done(*messages) == messages[1:]
    assert done(wire.GoTo(1.0), wire.GoTo(2.0)) == [wire.GoTo(2.0)]
    assert done(wire.SetFov(90.0), wire.SetFov(91.0), wire.SetShading(True)) == [
        wire.SetFov(91.0),
        wire.SetShading(True),
    ]


def test_no_sum_is_more_than_one_message_may_say_and_none_is_lost():
    did = done(*[steer(400.0)] * 10)
    assert sum(message.advance_mm for message in did) == 4000.0
    assert all(abs(message.advance_mm) <= 1000.0 for message in did)


def test_more_than_is_done_is_not_read():
    async def run():
        inbox = Inbox(lambda _message: None)
        for n in range(MAX_WAITING):
            await inbox.put(wire.Undo() if n % 2 else wire.Redo())
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(inbox.put(wire.Undo()), 0.05)
        worker = asyncio.create_task(inbox.work())
        await inbox.put(wire.Undo())
        while inbox.num_waiting:
            await asyncio.sleep(0)
        worker.cancel()

    asyncio.run(run())


def test_a_message_that_cannot_be_done_at_all_ends_the_work_and_blocks_nobody():
    def broken(_message):
        raise SystemError

    async def run():
        inbox = Inbox(broken)
        worker = asyncio.create_task(inbox.work())
        await inbox.put(wire.Undo())
        with pytest.raises(SystemError):
            await worker
        for _ in range(3 * MAX_WAITING):
            inbox._waiting.clear()
            await inbox.put(wire.Undo())

    asyncio.run(run())


def flooded(live, window, calls, *, num_sent, rate_hz=1000):
    """How many movements were done, sorted, while each request of others waited for its answer, as a script steered."""
    stop = threading.Event()

    def flood():
        began, sent = time.perf_counter(), 0
        while sent < num_sent:
            for _ in range(min(int((time.perf_counter() - began) * rate_hz), num_sent) - sent):
                window.send(steer(roll_rad=1e-4))
                sent += 1
            stop.wait(0.002)

    def read():
        # It ends with the window, whose last message it may be waiting for.
        with contextlib.suppress(ConnectionClosed):
            while not stop.is_set():
                window.next()

    threads = [threading.Thread(target=flood), threading.Thread(target=read, daemon=True)]
    waited = []
    with live.http(authorization=f"Bearer {live.gate.secret}") as http:
        for thread in threads:
            thread.start()
        while threads[0].is_alive():
            before = len(calls)
            assert http.get("/api/key-frames.json").status_code == 409
            waited.append(len(calls) - before)
        stop.set()
    return sorted(waited)


@pytest.mark.parametrize("num_sent", [pytest.param(2000), pytest.param(30_000, marks=pytest.mark.soak)])
def test_others_do_not_wait_for_a_script_that_steers_a_thousand_times_a_second(live, monkeypatch, num_sent):
    plain, calls = Session.do, []

    def slow(self, command, **options):
        if not isinstance(command, wire.Steer):
            return plain(self, command, **options)
        calls.append(command.roll_rad)
        until_s = time.perf_counter() + 0.003  # as in a patient's lumen
        while time.perf_counter() < until_s:
            pass
        return plain(self, command, **options)

    with live.window() as window:
        open_case(window)
        window.send(wire.SetMode("free"))
        window.until_state(lambda s: s.mode == "free")
        monkeypatch.setattr(Session, "do", slow)
        before = live.session.pose_info().pose.lps_from_camera[:3, :3]
        waited = flooded(live, window, calls, num_sent=num_sent)
        # Every movement has come in: the last of them is answered behind the others.
        total = num_sent * 1e-4
        deadline_s = time.monotonic() + 60.0
        while abs(sum(calls) - total) > 1e-9 and time.monotonic() < deadline_s:
            threading.Event().wait(0.01)
    p95 = waited[len(waited) * 95 // 100]
    print(f"{num_sent} steers, {len(calls)} done; while others waited: p95 {p95}, worst {waited[-1]}")
    assert math.isclose(sum(calls), total, rel_tol=1e-9)
    after = live.session.pose_info().pose.lps_from_camera[:3, :3]
    turned = math.acos(np.clip((np.trace(before.T @ after) - 1.0) / 2.0, -1.0, 1.0))
    assert turned == pytest.approx(math.acos(math.cos(total)), abs=1e-6)
    assert len(calls) < num_sent / 2
    # Counted in movements done meanwhile, 3 ms each, so that a busy machine tells nothing else: more than a thousand
    # without the inbox, 30 to 45 with it.
    assert p95 < 150
