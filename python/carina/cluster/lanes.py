"""A lane is the console's side of one renderer: it takes strips in order and answers each, in any thread."""

from __future__ import annotations

import dataclasses
import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from carina.cluster.envelope import Counts, Strip
from carina.cluster.host import bare_picture, counts_of
from carina.cluster.parcel import Parcel
from carina.display import one_line
from carina.render import CancelToken, Machine, Picture, Renderer, View
from carina.render.scene import Scene
from carina.version import VERSION

__all__ = ["Answered", "Lane", "LaneFacts", "Loaded", "LocalLane", "StripAnswer", "StripOrder"]


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class StripOrder:
    """Rows of a view of some content."""

    task_id: int
    frame_id: int
    content: int
    view: View
    rows: tuple[int, int] | None
    """None for the whole picture."""
    view_bytes: bytes = b""
    """The view, pickled once for all strips of a frame."""
    renderer: Renderer | None = None
    """This and what follows are for lanes in this process: who can render it,"""
    scene: Scene | None = None
    """the content itself,"""
    stop: CancelToken | None = None
    """and how it is given up."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class StripAnswer:
    """What came back; nothing in it is trusted before it is compared with the order."""

    frame_id: int
    content: int
    first_row: int
    num_rows: int
    seconds: float
    method: str
    counts: Counts
    picture: Picture | None
    """Without pixels; only with the first rows."""
    rgb: NDArray[np.uint8]

    @classmethod
    def of(cls, strip: Strip) -> StripAnswer:
        """What a host said."""
        return cls(*strip)


class LaneFacts(Machine, frozen=True):
    """The machine of a lane, and what runs on it."""

    version: str
    pid: int | None = None


Answered = Callable[[StripAnswer | BaseException], None]
Loaded = Callable[[BaseException | None], None]


class Lane(Protocol):
    """One renderer. Strips are answered in the order they were given, as far as there are answers."""

    name: str

    @property
    def facts(self) -> LaneFacts:
        """The machine."""

    def load(self, parcel: Parcel, done: Loaded) -> bool:
        """Take new content; ``done`` is called once, from any thread.

        Returns
        -------
        bool
            True where little travels: strips of the new content may be given at once, they come after it.
        """

    def submit(self, order: StripOrder, done: Answered) -> None:
        """Render; ``done`` is called once, from any thread."""

    def close(self) -> None:
        """No more strips."""


class LocalLane:
    """A renderer of this process, in a thread of its own.

    Parameters
    ----------
    renderer
        Another renderer of the same volume, for tests; else each order's own. Content comes with each order.
    name
        As shown to people.
    """

    def __init__(self, renderer: Renderer | None = None, *, name: str = "console") -> None:
        self.name = name
        self._renderer = renderer
        self._orders: queue.SimpleQueue[tuple[StripOrder, Answered] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=f"carina-lane-{name}", daemon=True)
        self._thread.start()

    def __repr__(self) -> str:
        return f"LocalLane({self.name!r})"

    @property
    def facts(self) -> LaneFacts:
        """This machine."""
        from carina.render import build_info

        info = build_info()
        return LaneFacts(int(info["threads"]), str(info["simd"]), "this machine", VERSION)

    def load(self, parcel: Parcel, done: Loaded) -> bool:
        """Nothing travels: orders bring their scene."""
        done(None)
        return True

    def submit(self, order: StripOrder, done: Answered) -> None:
        """Render after what was submitted before."""
        self._orders.put((order, done))

    def close(self) -> None:
        """End the thread after what was submitted."""
        self._orders.put(None)

    def _run(self) -> None:
        while (item := self._orders.get()) is not None:
            order, done = item
            answer: StripAnswer | BaseException
            try:
                began_s = time.perf_counter()
                renderer = self._renderer or order.renderer
                assert renderer is not None
                picture = renderer.render(order.view, rows=order.rows, scene=order.scene, stop=order.stop)
                seconds = time.perf_counter() - began_s
                stats = picture.stats
                first_row, end_row = order.rows or (0, order.view.height)
                answer = StripAnswer(
                    order.frame_id,
                    order.content,
                    first_row,
                    end_row - first_row,
                    seconds,
                    stats.method,
                    counts_of(stats),
                    bare_picture(picture),
                    picture.rgb,
                )
            except BaseException as trouble:  # a panic of the compiled module is no Exception
                answer = trouble
            done(answer)


def with_pixels(picture: Picture, rgb: NDArray[np.uint8], **changes: Any) -> Picture:
    """A bare picture with its pixels."""
    return dataclasses.replace(picture, rgb=rgb, **changes)
