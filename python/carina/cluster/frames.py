"""A frame under way: what an answer must be, and how the picture is put together from answers."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.cluster.envelope import Counts
from carina.cluster.lanes import StripAnswer, StripOrder, with_pixels
from carina.render import AirwayView, CancelToken, Picture, Renderer, RenderStats, View
from carina.render.scene import Scene
from carina.scopes import PINHOLE

__all__ = ["Content", "Frame", "fail", "what_is_wrong"]


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """What a frame shows, and who can render it here."""

    number: int
    renderer: Renderer
    scene: Scene


@dataclass(slots=True)
class Frame:
    """A picture that somebody waits for."""

    view: View
    content: Content
    future: Future[Picture]
    stop: CancelToken
    wanted_s: float
    view_bytes: bytes = b""
    """The view, pickled once for all its strips."""
    _rgb: NDArray[np.uint8] | None = None
    _first: Picture | None = None
    _counts: Counts = (0, 0, 0, 0, 0, 0, 0)
    _method: str = ""

    def take(self, answer: StripAnswer, rows: tuple[int, int]) -> None:
        """Copy the rows of an answer. Either all of it is taken or, with an error, nothing that counts.

        Raises
        ------
        Exception
            Whatever is wrong with the answer; another of these rows must come.
        """
        first, end = rows
        if self._rgb is None:
            self._rgb = np.empty((self.view.height, self.view.width, 3), np.uint8)
        counts = _plus(self._counts, answer.counts)
        self._rgb[first:end] = answer.rgb
        if first == 0:
            self._first = answer.picture
        self._counts = counts
        self._method = max(self._method, answer.method, key=lambda m: (m.startswith("gpu"), m))

    def deliver(self, now_s: float) -> None:
        """All rows are here: whoever waits gets the picture, or hears why there is none, but never waits on."""
        try:
            picture = self._picture(now_s)
        except Exception as trouble:
            fail(self.future, trouble)
            return
        if self.future.set_running_or_notify_cancel():
            self.future.set_result(picture)

    def _picture(self, now_s: float) -> Picture:
        assert self._rgb is not None and self._first is not None
        view = self.view
        optics = view.optics if isinstance(view, AirwayView) and view.lens != PINHOLE else None
        stats = RenderStats(self._method, view.width, view.height, *self._counts, now_s - self.wanted_s)
        return with_pixels(self._first, self._rgb, stats=stats, optics=optics)


def _plus(a: Counts, b: Counts) -> Counts:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5], a[6] + b[6])


def fail(future: Future[Picture], trouble: BaseException) -> None:
    """Say why there will be no picture, if nothing was said yet."""
    if not future.done() and future.set_running_or_notify_cancel():
        future.set_exception(trouble)


def what_is_wrong(answer: StripAnswer, order: StripOrder) -> str | None:
    """Why an answer is not what was asked for, or None."""
    first, end = order.rows or (0, order.view.height)
    expected = (end - first, order.view.width, 3)
    if answer.frame_id != order.frame_id:
        return f"a strip of frame {answer.frame_id} instead of frame {order.frame_id}"
    if answer.content != order.content:
        return f"a strip with content {answer.content} instead of {order.content}"
    if (answer.first_row, answer.num_rows) != (first, end - first):
        # A frame is cut anew when a renderer leaves: strips of one height may lie elsewhere.
        found = f"{answer.num_rows} rows from row {answer.first_row}"
        return f"a strip of {found} instead of {end - first} from row {first}"
    if not isinstance(answer.rgb, np.ndarray) or answer.rgb.dtype != np.uint8:
        return "not an 8-bit image"
    if order.rows is not None and order.rows[0] > 0 and answer.picture is None:
        pass
    elif not isinstance(answer.picture, Picture):
        return "a first strip without the image's metadata"
    if answer.rgb.shape != expected:
        return f"a strip of shape {answer.rgb.shape} instead of {expected}"
    return None
