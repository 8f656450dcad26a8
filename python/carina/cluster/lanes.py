"""Lanes, the console's connections to renderers, which render strips (rows of a picture) in order."""

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

from carina.cluster.byte_messages import Counts, Strip
from carina.cluster.renderer_host import bare_picture, counts_of
from carina.cluster.scene_data import Parcel
from carina.display import one_line
from carina.render import CancelToken, Machine, Picture, Renderer, View
from carina.render.scene import Scene
from carina.version import VERSION


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class StripOrder:
    """An order to render rows of a view."""

    task_id: int
    frame_id: int
    content: int
    view: View
    rows: tuple[int, int] | None
    """First row and row after the last; None for the whole picture."""
    view_bytes: bytes = b""
    """Pickled view, equal for all strips of a frame."""
    renderer: Renderer | None = None
    """Local renderer of the frame's content, for a lane in this process; else None."""
    scene: Scene | None = None
    """Scene that the strip shows, for a lane in this process; else None."""
    stop: CancelToken | None = None
    """Token with which the console cancels the rendering, for a lane in this process; None for a lane to another
    machine."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class StripAnswer:
    """The answer to an order; its content is checked against the order before use."""

    frame_id: int
    content: int
    first_row: int
    num_rows: int
    seconds: float
    method: str
    counts: Counts
    picture: Picture | None
    """Picture without pixels; None unless the strip contains the first row of the frame."""
    rgb: NDArray[np.uint8]

    @classmethod
    def of(cls, strip: Strip) -> StripAnswer:
        """Return the answer of a lane from the content that a renderer host returned."""
        return cls(*strip)


class LaneFacts(Machine, frozen=True):
    """Host, processor, memory and process of a lane's machine, with the version of Carina there."""

    version: str
    pid: int | None = None


Answered = Callable[[StripAnswer | BaseException], None]
Loaded = Callable[[BaseException | None], None]


class Lane(Protocol):
    """Interface of a connection to one renderer; strips are answered in the order of submission."""

    name: str

    @property
    def facts(self) -> LaneFacts:
        """Host, processor, memory and versions of the machine of the lane."""

    def load(self, parcel: Parcel, done: Loaded) -> bool:
        """Load new content on the renderer of the lane.

        Parameters
        ----------
        parcel
            The content.
        done
            Called once, from any thread, with an error or None.

        Returns
        -------
        bool
            Whether few data must be sent; strips of the new content may then be submitted at once, because they arrive
            after the content.
        """

    def submit(self, order: StripOrder, done: Answered) -> None:
        """Send a strip order to the renderer of the lane.

        Parameters
        ----------
        order
            The strip.
        done
            Called once, from any thread, with the answer or an error.
        """

    def close(self) -> None:
        """Close the connection to the renderer; the caller submits no more strips."""


class LocalLane:
    """Lane that renders in this process, in its own thread.

    Parameters
    ----------
    renderer
        Another renderer of the same volume, for tests; None uses the renderer of each order. Each order brings its
        scene.
    name
        Name for the user.
    """

    def __init__(self, renderer: Renderer | None = None, *, name: str = "console") -> None:
        self.name = name
        self._renderer = renderer
        self._orders: queue.SimpleQueue[tuple[StripOrder, Answered] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=f"carina-lane-{name}", daemon=True)
        self._thread.start()

    def __repr__(self) -> str:
        """Return the name of the lane."""
        return f"LocalLane({self.name!r})"

    @property
    def facts(self) -> LaneFacts:
        """Facts about this machine, shown to the user."""
        from carina.render import build_info

        info = build_info()
        return LaneFacts(int(info["threads"]), str(info["simd"]), "this machine", VERSION)

    def load(self, parcel: Parcel, done: Loaded) -> bool:
        """Call ``done`` at once and return True: this lane loads no content, because each order has its scene."""
        done(None)
        return True

    def submit(self, order: StripOrder, done: Answered) -> None:
        """Add a strip to the queue of this lane's thread, which renders strips in order of submission."""
        self._orders.put((order, done))

    def close(self) -> None:
        """End the lane's thread after the submitted strips are rendered."""
        self._orders.put(None)

    def _run(self) -> None:
        """Render the submitted strips one after another until the lane is closed."""
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
            except BaseException as error:  # a panic of the compiled module is not a subclass of Exception
                answer = error
            done(answer)


def with_pixels(picture: Picture, rgb: NDArray[np.uint8], **changes: Any) -> Picture:
    """Return a copy of a picture with other pixels."""
    return dataclasses.replace(picture, rgb=rgb, **changes)
