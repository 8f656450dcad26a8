"""Tests of the limits of messages: an observer who sends too many is disconnected, and others are served."""

from __future__ import annotations

import asyncio
import contextlib
import threading

import pytest
from live_server import SHOWN
from observers import page_of, sharing, watching
from websockets.exceptions import ConnectionClosed

from carina.server.observers import window as watching_window
from carina.server.observers.window import WatchingWindow
from carina.server.sockets import rate_limits
from carina.server.sockets.rate_limits import RateLimit
from carina.server.windows.inbox import Inbox
from carina.server.wire import messages as wire

FLOOD = wire.CLOSE_CODES["protocol.flood"]


pytest.importorskip("cryptography")


@pytest.fixture
def shared_case(tmp_path, monkeypatch):
    """Provide a workstation with a shared case; slow observers also have time to read the close reason."""
    monkeypatch.setattr(rate_limits, "DISCARDS_FOR_S", 60.0)
    monkeypatch.setattr(rate_limits, "MAX_DISCARDED_BYTES", 1 << 30)
    monkeypatch.setattr(rate_limits, "QUIET_S", 1.0)
    with sharing(tmp_path, monkeypatch) as shared:
        yield shared


class Clock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


class VirtualLoop(asyncio.SelectorEventLoop):
    """Event loop with virtual time: tasks advance the time by their durations and waits, and the loop never sleeps."""

    now_s = 0.0

    def time(self):
        return self.now_s

    def _run_once(self):
        if not self._ready and self._scheduled:
            self.now_s = max(self.now_s, self._scheduled[0].when())
        super()._run_once()


def test_rate_limit_allows_a_burst_and_then_its_rate():
    clock = Clock()
    limit = RateLimit(10.0, 5.0, clock)
    assert [limit.allow() for _ in range(7)] == [True] * 5 + [False] * 2
    clock.now_s += 0.25
    assert [limit.allow() for _ in range(3)] == [True, True, False]
    clock.now_s += 60.0
    assert limit.allow(5.0)
    assert not limit.allow(0.1)


def test_refused_message_does_not_reduce_the_rate_allowance():
    limit = RateLimit(1.0, 4.0, Clock())
    assert not limit.allow(5.0)
    assert limit.allow(4.0)


@pytest.mark.parametrize("num_observers", [1, 4])
def test_messages_of_observers_use_a_limited_share_of_time_while_the_user_sends(num_observers):
    """Simulate observers and a user.

    Each observer always has a message of 1 ms ready. The user sends a message of 2 ms for each of 120 refreshes of a
    screen.
    """
    loop = VirtualLoop()
    done = {"user": 0, "observers": 0}

    def costs(who, cost_s):
        def handle(_message):
            loop.now_s += cost_s
            done[who] += 1

        return handle

    user = Inbox(costs("user", 0.002))
    observers = [Inbox(costs("observers", 0.001), share=watching_window.INBOX_SHARE) for _ in range(num_observers)]

    async def floods(inbox):
        while True:
            await inbox.put(wire.Pick(1, 1, 1.0, 1.0))
            await asyncio.sleep(0)

    async def run():
        tasks = [asyncio.create_task(task) for one in observers for task in (one.run(), floods(one))]
        tasks.append(asyncio.create_task(user.run()))
        for _ in range(120):
            await user.put(wire.Undo())
            await asyncio.sleep(1.0 / 60.0)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    loop.run_until_complete(run())
    loop.close()
    assert done["user"] == 120
    # The expected value is 5 % of two seconds, plus the messages of the first turn.
    assert 50 * num_observers <= done["observers"] <= 130 * num_observers


def test_dropped_messages_are_not_executed_and_the_inbox_accepts_further_messages():
    done = []

    async def run():
        inbox = Inbox(done.append)
        for _ in range(3):
            await inbox.put(wire.Undo())
        inbox.clear()
        worker = asyncio.create_task(inbox.run())
        await inbox.put(wire.Redo())
        while not done:
            await asyncio.sleep(0)
        worker.cancel()
        await asyncio.gather(worker, return_exceptions=True)

    asyncio.run(run())
    assert done == [wire.Redo()]


def flood(socket, texts):
    """Send texts without reading the answers, until the server closes the connection."""

    def send():
        try:
            for text in texts:
                socket.send(text)
        except (ConnectionClosed, OSError):
            pass

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    return thread


@pytest.fixture
def handled(monkeypatch):
    """Return a list that receives the executed messages of observers."""
    done = []
    original = WatchingWindow._do

    def counting(self, message):
        done.append(message)
        original(self, message)

    monkeypatch.setattr(WatchingWindow, "_do", counting)
    return done


def test_observer_that_sends_a_flood_is_disconnected_and_all_messages_of_the_user_are_executed(
    shared_case, handled, monkeypatch
):
    live, window, page = shared_case
    monkeypatch.setattr(watching_window, "MESSAGES_PER_S", 0.0)
    monkeypatch.setattr(watching_window, "MESSAGES_AT_ONCE", 20.0)
    with watching(page.url) as other, watching(page.url) as watcher:
        page_state = page_of(window, lambda page: page is not None and len(page.watchers) == 2)
        before = live.session.pose_info().pose_id
        # The messages are small, so that the limit of bytes is not reached.
        sending = flood(watcher.socket, [wire.encode_message(wire.Probe((0.0, 0.0, 0.0)))] * 600)
        for _ in range(100):
            window.send(wire.Steer(0.01, 0.0, 0.0, 0.0), wire.SetFov(80.0), wire.SetFov(81.0))
        assert watcher.close_code()[0] == FLOOD
        sending.join()
        window.until(lambda m: isinstance(m, wire.Handled) and m.number >= 300)
        assert live.session.pose_info().pose_id > before
        assert len(handled) <= 20, "at most the limit of messages of the observer was executed"
        notice = window.received(lambda m: isinstance(m, wire.Notice))
        assert "disconnected" in notice.message
        left = window.received(
            lambda m: (
                isinstance(m, wire.Watching)
                and m.page is not None
                and m.page.url != page_state.url
                and len(m.page.watchers) == 1
            )
        ).page
        assert left.url != page_state.url, "the same link admits no observer again"
        assert other.until(lambda m: isinstance(m, wire.State)), "another observer stays"
        with watching(page.url, hello=False) as again:
            assert again.close_code()[0] == wire.CLOSE_CODES["protocol.not-authorised"]


def test_connection_with_a_flood_of_bytes_is_closed_before_parsing(shared_case, handled, monkeypatch):
    # The allowance must not grow during the flood, which takes a part of a second on a busy machine, so its clock does
    # not advance.
    monkeypatch.setattr(rate_limits, "RateLimit", lambda per_s, burst, _clock: RateLimit(per_s, burst, Clock()))
    live, window, page = shared_case
    with watching(page.url) as watcher:
        watcher.until_state(lambda s: s.case is not None)
        text = wire.encode_message(wire.Layout(SHOWN.views))
        sending = flood(watcher.socket, [text] * 20_000)
        assert watcher.close_code()[0] == FLOOD
        sending.join()
        assert len(handled) < 65_536 / len(text), "no more than the bytes of one second"
    page_of(window, lambda page: page is not None and not page.watchers)
    assert live.session.snapshot().case is not None


def test_connection_with_a_flood_of_control_frames_is_closed(shared_case):
    _live, _window, page = shared_case
    with watching(page.url) as watcher:
        watcher.until_state(lambda s: s.case is not None)

        def pings():
            with contextlib.suppress(ConnectionClosed, OSError):
                watcher.socket.ping(b"x" * 100, 2000)

        thread = threading.Thread(target=pings, daemon=True)
        thread.start()
        assert watcher.close_code()[0] == FLOOD
        thread.join()


def test_observer_page_that_moves_the_crosshair_on_every_screen_refresh_is_within_the_rate_limits():
    clock = Clock()
    limit = RateLimit(watching_window.MESSAGES_PER_S, watching_window.MESSAGES_AT_ONCE, clock)
    for _ in range(10 * 240):
        clock.now_s += 1.0 / 240.0
        assert limit.allow() and limit.allow()
