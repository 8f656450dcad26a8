"""Tests of the encoding of trees: each tree is encoded before a route through it is sent."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

from carina.server.windows import broadcast_cache
from carina.server.windows.broadcast_cache import SharedTexts
from carina.server.windows.outbox import Outbox
from carina.server.wire import messages as wire

TREE_AND_ROUTE = ("tree", "route")


class Writing:
    """Cache of encoded messages with replacements of trees, and with a function that runs while a tree is encoded."""

    def __init__(self, monkeypatch) -> None:
        self.newest = "first"
        self.written: list[str] = []
        self.errors: list[object] = []
        self.meanwhile = lambda: None
        self.texts = SharedTexts(
            SimpleNamespace(
                snapshot=lambda: SimpleNamespace(
                    document=SimpleNamespace(airways=self.newest, route=None, cost_of=lambda _route: "lumen"),
                    route_scale=None,
                )
            ),
            None,
            self.errors.append,
        )
        monkeypatch.setattr(broadcast_cache, "tree_message", self.write)

    def write(self, airways, _measures):
        self.written.append(airways)
        self.meanwhile()
        return wire.Notice(airways)

    async def end(self):
        while self.texts._writing is not None:
            await self.texts._writing


def test_tree_that_changes_at_the_end_of_encoding_is_encoded_before_its_route_is_sent(monkeypatch):
    writing = Writing(monkeypatch)
    outbox = Outbox()
    calls = []

    async def run() -> None:
        loop = asyncio.get_running_loop()
        plain = writing.texts._tree_text

        def tree_text() -> str:
            text = plain()
            calls.append(text)
            if len(calls) == 2:
                # The second tree arrives after the second check.
                writing.newest = "second"
                loop.call_soon_threadsafe(writing.texts.mark, outbox, *TREE_AND_ROUTE)
            return text

        monkeypatch.setattr(writing.texts, "_tree_text", tree_text)
        writing.texts.mark(outbox, *TREE_AND_ROUTE)
        while writing.texts._writing is not None:
            await writing.texts._writing
            assert writing.texts.tree() is not None or not {*TREE_AND_ROUTE} & {*outbox.take_all()[0]}
        assert set(outbox.take_all()[0]) == {*TREE_AND_ROUTE}

    asyncio.run(run())
    assert writing.written == ["first", "second"]


def test_route_requested_while_its_tree_is_not_yet_encoded_is_sent_with_the_tree(monkeypatch):
    """Use a session with a new tree that is not encoded yet, whose route would not be announced a second time."""
    writing = Writing(monkeypatch)
    outbox = Outbox()

    async def run() -> None:
        writing.texts.mark(outbox, *TREE_AND_ROUTE)
        await writing.end()
        assert outbox.take_all()[0] == [*TREE_AND_ROUTE]
        writing.newest = "second"
        writing.texts.mark(outbox, "route")
        assert (outbox.take_all()[0], writing.texts.tree(), writing.texts.route()) == (["route"], None, None)
        writing.texts.mark(outbox, "tree")
        await writing.end()
        assert outbox.take_all()[0] == [*TREE_AND_ROUTE]
        assert writing.texts.tree() is not None

    asyncio.run(run())


def test_tree_is_encoded_once_for_all_windows_and_each_waits_for_the_tree_it_requested(monkeypatch):
    writing = Writing(monkeypatch)
    first, second, later = Outbox(), Outbox(), Outbox()

    async def run() -> None:
        writing.texts.mark(first, *TREE_AND_ROUTE, "pose")
        writing.texts.mark(second, "route")
        assert (first.take_all()[0], second.take_all()[0]) == (["pose"], [])
        await writing.end()
        assert (first.take_all()[0], second.take_all()[0]) == ([*TREE_AND_ROUTE], ["route"])
        writing.texts.mark(later, *TREE_AND_ROUTE)
        assert later.take_all()[0] == [*TREE_AND_ROUTE]

    asyncio.run(run())
    assert writing.written == ["first"]


def test_tree_that_cannot_be_encoded_is_reported_and_delays_no_other_message(monkeypatch):
    writing = Writing(monkeypatch)
    outbox = Outbox()

    def fail():
        raise MemoryError

    writing.meanwhile = fail

    async def run() -> None:
        writing.texts.mark(outbox, *TREE_AND_ROUTE)
        await writing.end()
        assert outbox.take_all()[0] == [*TREE_AND_ROUTE]
        assert writing.texts.tree() is None
        assert writing.texts.route() is not None, "the route is sent with or without a tree"

    asyncio.run(run())
    (error,) = writing.errors
    assert "airway tree cannot be shown" in error.message
