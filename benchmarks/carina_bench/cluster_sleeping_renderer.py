"""Renderer that sleeps instead of rendering, and that fails on request: for tests and benchmarks of the cluster.

A sleeping renderer uses no core, so a computer of two cores can run the scheduler and the transport with eight
renderers.
"""

from __future__ import annotations

import os
import pickle
import time
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.cluster.byte_messages import Strip
from carina.cluster.renderer_host import RendererHost, bare_picture, counts_of
from carina.errors import ClusterError
from carina.render import LEAD_VIEW, Picture, RenderStats, View

__all__ = ["SleepingRenderer", "position_pixels"]


def position_pixels(view: View, rows: tuple[int, int] | None, content: int) -> NDArray[np.uint8]:
    """Return pixels (rows, width, 3) whose values encode their row, their column and the number ``content``."""
    first, end = rows or (0, view.height)
    return _pixels(first, end, view.width, (int(getattr(view, "fov_deg", None) or 0) + content) % 256)


@lru_cache(maxsize=64)
def _pixels(first: int, end: int, width: int, salt: int) -> NDArray[np.uint8]:
    """Return the pixels of rows ``first`` to ``end``; the cache makes repeated calls fast.

    Without the cache eight renderers that compute on two cores would delay each other.
    """
    row = (np.arange(first, end) % 256).astype(np.uint8)[:, None]
    column = (np.arange(width) % 256).astype(np.uint8)[None, :]
    made = np.empty((end - first, width, 3), np.uint8)
    made[..., 0], made[..., 1] = row, column
    made[..., 2] = row * np.uint8(7) + column * np.uint8(3) + np.uint8(salt)
    made.flags.writeable = False
    return made


class SleepingRenderer(RendererHost):
    """Renderer that sleeps ``strip_seconds`` for each strip and ``row_seconds`` for each row.

    Parameters
    ----------
    version
        Reported version in place of Carina's version.
    memory_bytes
        Reported free memory in place of the measured one.
    """

    def __init__(
        self,
        *,
        mixed: bool = False,
        strip_seconds: float = 0.0,
        row_seconds: float = 0.0,
        version: str | None = None,
        memory_bytes: int | None = None,
    ) -> None:
        super().__init__(mixed=mixed)
        self._strip_seconds = strip_seconds
        self._row_seconds = row_seconds
        self._row_costs: tuple[float, ...] | None = None
        self._version = version
        self._memory_bytes = memory_bytes
        self._factor = 1.0
        self._trouble: str | None = None

    def ping(self) -> dict[str, Any]:
        """Return the facts that a real renderer reports, with the version and the memory of this object."""
        facts = super().ping()
        if self._version is not None:
            facts["version"] = self._version
        if self._memory_bytes is not None:
            facts["memory_bytes"] = self._memory_bytes
        return facts

    def misbehave(self, trouble: str | None = None, factor: float = 1.0) -> int:
        """Become ``factor`` times slower, or give wrong answers from now on; return the process ID.

        ``trouble`` is the wrong property of the answers: ``"size"``, ``"frame"`` or ``"rows"``. The pixels of a wrong
        frame and of wrong rows differ from the correct ones.
        """
        self._trouble, self._factor = trouble, factor
        return os.getpid()

    def pace(self, row_seconds: float, row_costs: tuple[float, ...]) -> None:
        """Set the time of each row to ``row_seconds`` times the relative cost of the row."""
        self._row_seconds, self._row_costs = row_seconds, row_costs

    def strip(self, frame_id: int, content: int, view: bytes, rows: tuple[int, int] | None) -> Strip:
        """Sleep for the time of the strip and return pixels that encode their position."""
        began_s = time.perf_counter()
        if self._content != content:
            raise ClusterError(f"the renderer has content {self._content}; expected {content}", code="cluster.lost")
        shown = pickle.loads(view)
        first_row, end_row = rows or (0, shown.height)
        if self._trouble == "rows":
            # Answers with another strip of the same height, as if the frame had been divided differently before.
            first_row, end_row = first_row + 1, end_row + 1
        rgb = position_pixels(shown, (first_row, end_row), content)
        rows_alike = len(rgb) if self._row_costs is None else sum(self._row_costs[first_row:end_row])
        wanted_s = (self._strip_seconds + self._row_seconds * rows_alike) * self._factor
        time.sleep(max(0.0, wanted_s - (time.perf_counter() - began_s)))
        if self._trouble == "size":
            rgb = rgb[:-1]
        if self._trouble == "frame":
            frame_id, rgb = frame_id - 1, 255 - rgb
        stats = RenderStats("stand-in", shown.width, len(rgb), rgb.size // 3, 0, 0, 0, 0, 0, 0, 0.0)
        first = bare_picture(Picture(rgb=rgb, view=LEAD_VIEW, stats=stats)) if rows is None or rows[0] == 0 else None
        seconds, counts = time.perf_counter() - began_s, counts_of(stats)
        return frame_id, content, first_row, end_row - first_row, seconds, "stand-in", counts, first, rgb
