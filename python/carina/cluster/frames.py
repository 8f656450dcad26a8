"""State of a frame during its rendering: check of the lanes' answers, and assembly of the picture from strips."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.cluster.byte_messages import Counts
from carina.cluster.lanes import StripAnswer, StripOrder, with_pixels
from carina.render import AirwayView, CancelToken, Picture, Renderer, RenderStats, View
from carina.render.scene import Scene
from carina.scopes import PINHOLE


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """Content that a frame shows (volume and scene), with the local renderer that can render it."""

    number: int
    renderer: Renderer
    scene: Scene


@dataclass(slots=True)
class PendingFrame:
    """A requested picture that is not complete yet."""

    view: View
    content: Content
    future: Future[Picture]
    stop: CancelToken
    requested_s: float
    view_bytes: bytes = b""
    """The view, pickled once for all strips."""
    _rgb: NDArray[np.uint8] | None = None
    _first: Picture | None = None
    _counts: Counts = (0, 0, 0, 0, 0, 0, 0)
    _method: str = ""

    def copy_rows(self, answer: StripAnswer, rows: tuple[int, int]) -> None:
        """Copy the rows of an answer into the picture; an answer that raises an error changes nothing.

        Parameters
        ----------
        answer
            The answer of a lane, already checked by :func:`find_mismatch`.
        rows
            First row and row after the last.

        Raises
        ------
        Exception
            Any error caused by the answer; another lane must render the rows.
        """
        first, end = rows
        if self._rgb is None:
            self._rgb = np.empty((self.view.height, self.view.width, 3), np.uint8)
        counts = _sum_counts(self._counts, answer.counts)
        self._rgb[first:end] = answer.rgb
        if first == 0:
            self._first = answer.picture
        self._counts = counts
        self._method = max(self._method, answer.method, key=lambda m: (m.startswith("gpu"), m))

    def complete(self, now_s: float) -> None:
        """Complete the frame's future after the last row: set the picture, or the error of the assembly.

        Parameters
        ----------
        now_s
            Current time in seconds, for the rendering time in the statistics.
        """
        try:
            picture = self._picture(now_s)
        except Exception as error:
            set_failure(self.future, error)
            return
        if self.future.set_running_or_notify_cancel():
            self.future.set_result(picture)

    def _picture(self, now_s: float) -> Picture:
        assert self._rgb is not None and self._first is not None
        view = self.view
        optics = view.optics if isinstance(view, AirwayView) and view.lens != PINHOLE else None
        stats = RenderStats(self._method, view.width, view.height, *self._counts, now_s - self.requested_s)
        return with_pixels(self._first, self._rgb, stats=stats, optics=optics)


def _sum_counts(a: Counts, b: Counts) -> Counts:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5], a[6] + b[6])


def set_failure(future: Future[Picture], trouble: BaseException) -> None:
    """Set an exception as the result of a future that has no result yet."""
    if not future.done() and future.set_running_or_notify_cancel():
        future.set_exception(trouble)


def find_mismatch(answer: StripAnswer, order: StripOrder) -> str | None:
    """Return the difference between a lane's answer and its order as text; None if the answer is valid."""
    first, end = order.rows or (0, order.view.height)
    expected = (end - first, order.view.width, 3)
    if answer.frame_id != order.frame_id:
        return f"a strip of frame {answer.frame_id} instead of frame {order.frame_id}"
    if answer.content != order.content:
        return f"a strip with content {answer.content} instead of {order.content}"
    if (answer.first_row, answer.num_rows) != (first, end - first):
        # The strips of a frame are divided again when a renderer leaves, so a strip of the right height may have wrong
        # rows.
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
