"""Choice between brute force and leaps over equal values, with or without prefetching, by their times in a view."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Literal

import numpy as np

from carina import _core
from carina.render.scene import ValueMaps
from carina.render.transfer_function import TransferFunction
from carina.render.views import AirwayView
from carina.scopes import Pose

MIN_PIXELS = 64 * 64
"""Number of pixels below which a measurement takes longer than it saves; the trial rays decide there."""
PICTURES_BETWEEN = 32
"""Number of pictures along a flight for which one measurement serves."""
NEAR_TURN_RAD = 0.25
"""Turn of the camera beyond which a measurement does not serve."""
NEAR_SHARE = 0.1
"""Share of the volume's diagonal that the camera may move before a measurement does not serve."""
STRIPS = 4
"""Number of strips of a picture that are timed."""
STRIP_ROWS = 4
"""Number of rows of a strip: one band of the caster."""
ROUNDS = 3
"""Number of times that each strip is timed with each method; the least time counts."""
MORE_ROUNDS = 5
"""Number of further rounds if the costs of both methods are close, because other programs may have disturbed a time."""
CLOSE_RATIO = 1.25
"""Ratio of the costs of both methods below which the strips are timed in further rounds."""
MIN_GAIN = 0.02
"""Share of the cost of brute force that leaps must save; a smaller gain is within the error of a measurement."""
MAX_VIEWS = 64
"""Number of views whose choice is stored."""

CastMethod = Literal["brute", "leap", "prefetch"]
"""Method of a cast: brute force, leaps, or leaps whose next reads are prefetched while other rays are cast."""
ALL_METHODS: tuple[CastMethod, ...] = ("brute", "leap", "prefetch")
LEAPING_METHODS: tuple[CastMethod, ...] = ("leap", "prefetch")
"""Methods with leaps; both give the same picture, bit for bit."""
CostOf = Callable[[tuple[int, int], CastMethod], float]
"""Function that returns the cost of rows by a method."""


class LeapChoice:
    """Choice of the fastest method for views of one volume, measured once for views that are near each other.

    All strips of a view and the whole picture have the same choice, so that they fit together bit for bit.

    Parameters
    ----------
    methods
        Methods to choose from.
    """

    def __init__(self, methods: tuple[CastMethod, ...] = ALL_METHODS) -> None:
        self._methods = methods
        self._lock = threading.Lock()
        self._scene: tuple[ValueMaps, TransferFunction] | None = None
        self._chosen: dict[bytes, CastMethod] = {}
        self._measured: Pose | None = None
        self._last: CastMethod = "leap"
        self._pictures = 0

    def method(
        self, scene: tuple[ValueMaps, TransferFunction], view: AirwayView, cost_of: CostOf, *, diagonal_mm: float
    ) -> CastMethod | None:
        """Return the fastest method in a view; None if the picture is too small for a measurement."""
        if view.width * view.height < MIN_PIXELS or view.height < STRIPS * STRIP_ROWS:
            return None
        key = repr((view.width, view.height, view.fov_deg, view.lens)).encode() + view.pose.lps_from_camera.tobytes()
        with self._lock:
            if not self._is_for(scene):
                self._scene, self._chosen, self._measured = scene, {}, None
            chosen = self._chosen.get(key)
            if chosen is None and self._serves(view.pose, diagonal_mm):
                self._pictures += 1
                chosen = self._choose(key, self._last)
        if chosen is not None:
            return chosen
        fastest = fastest_method(view.height, cost_of, self._methods)
        with self._lock:
            if not self._is_for(scene):
                return fastest
            self._measured, self._last, self._pictures = view.pose, fastest, 0
            return self._choose(key, fastest)

    def _is_for(self, scene: tuple[ValueMaps, TransferFunction]) -> bool:
        # The entry holds references to its maps and transfer function, so no others can have their identity.
        return self._scene is not None and self._scene[0] is scene[0] and self._scene[1] is scene[1]

    def _serves(self, pose: Pose, diagonal_mm: float) -> bool:
        """Return whether the last measurement serves for a pose."""
        if self._measured is None or self._pictures >= PICTURES_BETWEEN:
            return False
        before, now = self._measured.lps_from_camera, pose.lps_from_camera
        moved_mm = float(np.linalg.norm(now[:3, 3] - before[:3, 3]))
        turned_rad = float(np.arccos(np.clip(now[:3, 2] @ before[:3, 2], -1.0, 1.0)))
        return moved_mm <= NEAR_SHARE * diagonal_mm and turned_rad <= NEAR_TURN_RAD

    def _choose(self, key: bytes, method: CastMethod) -> CastMethod:
        """Store the choice for a view unless another thread has stored one, and return the stored choice."""
        if len(self._chosen) >= MAX_VIEWS:
            del self._chosen[next(iter(self._chosen))]
        return self._chosen.setdefault(key, method)


def fastest_method(height: int, cost_of: CostOf, methods: tuple[CastMethod, ...] = ALL_METHODS) -> CastMethod:
    """Return the method that costs least in strips that are spread over a picture of ``height`` rows.

    Leaps must save `MIN_GAIN` of the cost of brute force, and prefetching that of leaps without it. If the costs of
    brute force and leaps are close, `MORE_ROUNDS` further rounds are timed.
    """
    firsts = [min((2 * n + 1) * height // (2 * STRIPS), height - STRIP_ROWS) for n in range(STRIPS)]
    strips = [(first, first + STRIP_ROWS) for first in firsts]
    least = {method: dict.fromkeys(strips, math.inf) for method in methods}

    def time_rounds(turns: range, timed: tuple[CastMethod, ...]) -> None:
        for turn in turns:
            # The methods rotate, and all strips lie between two times of one strip, so that a strip is as rarely in the
            # caches as in a whole picture.
            shift = turn % len(timed)
            for method in timed[shift:] + timed[:shift]:
                for rows in strips:
                    least[method][rows] = min(least[method][rows], cost_of(rows, method))

    def cost(method: CastMethod) -> float:
        return sum(least[method].values())

    time_rounds(range(ROUNDS), methods)
    leaping: CastMethod = "prefetch" if cost("prefetch") < (1.0 - MIN_GAIN) * cost("leap") else "leap"
    if "brute" not in methods:
        return leaping
    if max(cost(leaping), cost("brute")) < CLOSE_RATIO * min(cost(leaping), cost("brute")):
        time_rounds(range(MORE_ROUNDS), ("brute", leaping))
    return leaping if cost(leaping) < (1.0 - MIN_GAIN) * cost("brute") else "brute"


def processor_time_of(cast: Callable[[], object]) -> float:
    """Return the processor time of a cast in all its threads, s; the wall time if no thread has a fine clock.

    The calling thread casts a single band of rows itself, without the picture threads.
    """
    pool, own, wall = _core.picture_clock_s(), time.thread_time(), time.perf_counter()
    cast()
    wall, own, pool_after = time.perf_counter() - wall, time.thread_time() - own, _core.picture_clock_s()
    if pool is not None and pool_after is not None and pool_after > pool:
        own += (pool_after - pool) * _core.picture_threads()
    return own if own > 0.0 else wall
