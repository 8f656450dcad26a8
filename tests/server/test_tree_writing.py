"""A tree that comes while another is written is written, too, before a route through it is sent."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace

from carina.server.hub import Hub, Outbox


def test_a_tree_that_comes_as_the_writing_ends_is_written_before_its_route_goes():
    hub = Hub.__new__(Hub)
    hub._cache, hub._writing_tree, hub._after_tree, hub._outbox = {}, None, set(), Outbox()
    newest = ["first"]
    hub.session = SimpleNamespace(snapshot=lambda: SimpleNamespace(document=SimpleNamespace(airways=newest[0])))
    written = []

    async def run() -> None:
        loop = asyncio.get_running_loop()

        def tree_text() -> str:
            airways = newest[0]
            written.append(airways)
            hub._cache["tree"] = ((airways, None), airways)
            if written == ["first", "first"]:
                # Looked at twice, and only then the next one comes.
                newest[0] = "second"
                loop.call_soon_threadsafe(hub._mark, hub._outbox, "tree", "route")
            return airways

        hub._tree_text = tree_text
        hub._mark(hub._outbox, "tree", "route")
        while hub._writing_tree is not None:
            await hub._writing_tree
            known = hub._is_known("tree", *hub._newest_tree())
            assert known or not {"tree", "route"} & hub._outbox._topics
        assert hub._outbox._topics == {"tree", "route"}

    asyncio.run(run())
    assert written[-1] == "second"
