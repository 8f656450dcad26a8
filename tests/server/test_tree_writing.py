"""A tree that comes while another is written is written, too, before a route through it is sent."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

from carina.server import messages as wire
from carina.server import shared_texts
from carina.server.outbox import Outbox
from carina.server.shared_texts import SharedTexts

TREE_AND_ROUTE = ("tree", "route")


class Writing:
    """Shared texts over a tree that is a word, and what happens while it is written."""

    def __init__(self, monkeypatch) -> None:
        self.newest = "first"
        self.written: list[str] = []
        self.told: list[object] = []
        self.meanwhile = lambda: None
        self.texts = SharedTexts(
            SimpleNamespace(
                snapshot=lambda: SimpleNamespace(document=SimpleNamespace(airways=self.newest, route=None))
            ),
            None,
            self.told.append,
        )
        monkeypatch.setattr(shared_texts, "tree_message", self.write)

    def write(self, airways, _measures):
        self.written.append(airways)
        self.meanwhile()
        return wire.Notice(airways)

    async def end(self):
        while self.texts._writing is not None:
            await self.texts._writing


def test_a_tree_that_comes_as_the_writing_ends_is_written_before_its_route_goes(monkeypatch):
    writing = Writing(monkeypatch)
    outbox = Outbox()
    asked = []

    async def run() -> None:
        loop = asyncio.get_running_loop()
        plain = writing.texts._tree_text

        def tree_text() -> str:
            text = plain()
            asked.append(text)
            if len(asked) == 2:
                # Looked at twice, and only then the next one comes.
                writing.newest = "second"
                loop.call_soon_threadsafe(writing.texts.mark, outbox, *TREE_AND_ROUTE)
            return text

        monkeypatch.setattr(writing.texts, "_tree_text", tree_text)
        writing.texts.mark(outbox, *TREE_AND_ROUTE)
        while writing.texts._writing is not None:
            await writing.texts._writing
            assert writing.texts.tree() is not None or not {*TREE_AND_ROUTE} & {*outbox.take()[0]}
        assert set(outbox.take()[0]) == {*TREE_AND_ROUTE}

    asyncio.run(run())
    assert writing.written == ["first", "second"]


def test_a_route_that_is_asked_for_before_its_tree_is_written_is_held_back_and_goes_with_it(monkeypatch):
    """A mark of the old tree finds the new document: its route would be news once, and never again."""
    writing = Writing(monkeypatch)
    outbox = Outbox()

    async def run() -> None:
        writing.texts.mark(outbox, *TREE_AND_ROUTE)
        await writing.end()
        assert outbox.take()[0] == [*TREE_AND_ROUTE]
        writing.newest = "second"
        writing.texts.mark(outbox, "route")
        assert (outbox.take()[0], writing.texts.tree(), writing.texts.route()) == (["route"], None, None)
        writing.texts.mark(outbox, "tree")
        await writing.end()
        assert outbox.take()[0] == [*TREE_AND_ROUTE]
        assert writing.texts.tree() is not None

    asyncio.run(run())


def test_a_tree_is_written_once_for_all_windows_and_each_waits_for_what_it_asked(monkeypatch):
    writing = Writing(monkeypatch)
    first, second, later = Outbox(), Outbox(), Outbox()

    async def run() -> None:
        writing.texts.mark(first, *TREE_AND_ROUTE, "pose")
        writing.texts.mark(second, "route")
        assert (first.take()[0], second.take()[0]) == (["pose"], [])
        await writing.end()
        assert (first.take()[0], second.take()[0]) == ([*TREE_AND_ROUTE], ["route"])
        writing.texts.mark(later, *TREE_AND_ROUTE)
        assert later.take()[0] == [*TREE_AND_ROUTE]

    asyncio.run(run())
    assert writing.written == ["first"]


def test_a_tree_that_cannot_be_written_is_said_and_holds_nothing_else_back(monkeypatch):
    writing = Writing(monkeypatch)
    outbox = Outbox()

    def fail():
        raise MemoryError

    writing.meanwhile = fail

    async def run() -> None:
        writing.texts.mark(outbox, *TREE_AND_ROUTE)
        await writing.end()
        assert outbox.take()[0] == [*TREE_AND_ROUTE]
        assert writing.texts.tree() is None
        assert writing.texts.route() is not None, "it says where the pose is on the path, with a tree or without"

    asyncio.run(run())
    (error,) = writing.told
    assert "airway tree cannot be shown" in error.message
