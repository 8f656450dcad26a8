"""Choice of the faster method in paper mode: leaps or brute force, and leaps with or without prefetching."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from carina import _core
from carina.render.scene import ValueMaps
from carina.render.transfer_function import TransferFunction
from carina.render.views import AirwayView
from carina.scopes import Pose

MIN_PIXELS = 64 * 64
"""Minimum number of pixels of a picture in which leaps and brute force are timed; in smaller ones trial rays decide."""
PICTURES_BETWEEN = 32
"""Number of pictures along a flight after which the times of skipping and of brute force are measured again."""
NEAR_TURN_RAD = 0.25
"""Maximum rotation of the camera since a measurement, in radians, with which its result is still used."""
NEAR_SHARE = 0.1
"""Maximum movement of the camera since a measurement, as a share of the volume's diagonal, with which its result is
used."""
STRIPS = 4
"""Number of strips of a picture in which skipping and brute force are timed."""
STRIP_ROWS = 4
"""Number of rows of a timed strip: one band of the caster."""
ROUNDS = 3
"""Number of times that each strip is timed with each method; the least time counts."""
MORE_ROUNDS = 5
"""Number of further rounds if the costs of both methods are close, because other programs may have disturbed a time."""
CLOSE_RATIO = 1.25
"""Ratio of the costs of both methods below which the strips are timed in further rounds."""
MIN_GAIN = 0.02
"""Minimum share of brute force's time that skipping must save to be chosen; less is within the measurement's error."""
MAX_VIEWS = 64
"""Maximum number of views whose faster method is stored; a further view replaces the oldest one."""
PREFETCH_TRIALS = 4
"""Number of pictures, alternately without and with prefetching, whose times decide whether packets prefetch."""
PREFETCH_RETRY = 32
"""Number of pictures after which the method not in use, with or without prefetches, is timed in one picture again."""

Result = TypeVar("Result")
CostOf = Callable[[tuple[int, int], bool], float]
"""Function that returns the cost of casting rows with empty-space skipping (True) or by brute force (False)."""


class LeapChoice:
    """Choice between leaps (skipped uniform cubes) and brute force for a volume's views, measured once for near views.

    All strips of a view and the whole picture have the same choice, so that they fit together bit for bit.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._scene: tuple[ValueMaps, TransferFunction] | None = None
        self._chosen: dict[bytes, bool] = {}
        self._measured: Pose | None = None
        self._last = True
        self._pictures = 0

    def leaps(
        self, scene: tuple[ValueMaps, TransferFunction], view: AirwayView, cost_of: CostOf, *, diagonal_mm: float
    ) -> bool | None:
        """Return whether leaps are faster than brute force in a view; None if the picture is too small to measure."""
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
        faster = is_faster(view.height, cost_of)
        with self._lock:
            if not self._is_for(scene):
                return faster
            self._measured, self._last, self._pictures = view.pose, faster, 0
            return self._choose(key, faster)

    def _is_for(self, scene: tuple[ValueMaps, TransferFunction]) -> bool:
        # The entry holds references to its maps and transfer function, so no others can have their identity.
        return self._scene is not None and self._scene[0] is scene[0] and self._scene[1] is scene[1]

    def _serves(self, pose: Pose, diagonal_mm: float) -> bool:
        """Return whether the last measurement is near enough to a pose to be used."""
        if self._measured is None or self._pictures >= PICTURES_BETWEEN:
            return False
        return _are_near(self._measured, pose, diagonal_mm)

    def _choose(self, key: bytes, leaps: bool) -> bool:
        """Store the choice for a view unless another thread has stored one, and return the stored choice."""
        if len(self._chosen) >= MAX_VIEWS:
            del self._chosen[next(iter(self._chosen))]
        return self._chosen.setdefault(key, leaps)


class PrefetchChoice:
    """Choice whether leaps over equal values prefetch their next reads, by the times of earlier pictures.

    The address of a ray's next read depends on its last read. Prefetching casts other rays while a read is on its way:
    it saves time where the map comes from memory, and costs time where the map is in the cache of the core. Both ways
    give the same picture, bit for bit, so each picture can choose again, and the times of the pictures are the only
    measurement. Times of single strips could not decide, because the cache holds their part of the map.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._maps: ValueMaps | None = None
        self._first: Pose | None = None
        self._num_pictures = 0
        self._cost = {False: math.inf, True: math.inf}

    def prefetches(self, maps: ValueMaps, pose: Pose, *, diagonal_mm: float) -> bool:
        """Return whether the next picture prefetches; ``diagonal_mm`` is the length of the volume's diagonal."""
        with self._lock:
            if self._maps is not maps or self._first is None or not _are_near(self._first, pose, diagonal_mm):
                self._maps, self._first, self._num_pictures = maps, pose, 0
            number = self._num_pictures
            self._num_pictures += 1
            if number < PREFETCH_TRIALS:
                return number % 2 == 1
            saves = self._cost[True] < (1.0 - MIN_GAIN) * self._cost[False]
            return not saves if number % PREFETCH_RETRY == 0 else saves

    def add(self, maps: ValueMaps, *, prefetched: bool, cost: float) -> None:
        """Store the cost of one step of a ray in a picture that was cast with or without prefetching."""
        with self._lock:
            if self._maps is maps:
                self._cost[prefetched] = cost


def _are_near(before: Pose, now: Pose, diagonal_mm: float) -> bool:
    """Return whether two poses are so near that the measurement at one is valid for the other."""
    moved_mm = float(np.linalg.norm(now.lps_from_camera[:3, 3] - before.lps_from_camera[:3, 3]))
    turned_rad = float(np.arccos(np.clip(now.lps_from_camera[:3, 2] @ before.lps_from_camera[:3, 2], -1.0, 1.0)))
    return moved_mm <= NEAR_SHARE * diagonal_mm and turned_rad <= NEAR_TURN_RAD


def is_faster(height: int, cost_of: CostOf) -> bool:
    """Return whether leaps cost less than brute force in strips that are spread over a picture of ``height`` rows.

    Leaps must save `MIN_GAIN` of the cost. If the costs are close, `MORE_ROUNDS` further rounds are timed.
    """
    firsts = [min((2 * n + 1) * height // (2 * STRIPS), height - STRIP_ROWS) for n in range(STRIPS)]
    strips = [(first, first + STRIP_ROWS) for first in firsts]
    least = {leaps: dict.fromkeys(strips, math.inf) for leaps in (True, False)}

    def time_rounds(turns: range) -> tuple[float, float]:
        """Time all strips in further rounds, and return the costs with skipping and by brute force."""
        for rows in strips:
            for turn in turns:
                # The first method of a round finds less of the volume in the caches, so the methods alternate.
                for leaps in (turn % 2 == 0, turn % 2 == 1):
                    least[leaps][rows] = min(least[leaps][rows], cost_of(rows, leaps))
        return sum(least[True].values()), sum(least[False].values())

    leaping, brute = time_rounds(range(ROUNDS))
    if max(leaping, brute) < CLOSE_RATIO * min(leaping, brute):
        leaping, brute = time_rounds(range(ROUNDS, ROUNDS + MORE_ROUNDS))
    return leaping < (1.0 - MIN_GAIN) * brute


def processor_time_of(cast: Callable[[], object]) -> float:
    """Return the processor time of a cast in all its threads, s; the wall time if no thread has a fine clock."""
    return timed(cast)[1]


def timed(cast: Callable[[], Result]) -> tuple[Result, float]:
    """Return the result of a cast, and its processor time in all threads, s; the wall time without a fine clock.

    The calling thread casts a single band of rows itself, without the picture threads.
    """
    pool, own, wall = _core.picture_clock_s(), time.thread_time(), time.perf_counter()
    result = cast()
    wall, own, pool_after = time.perf_counter() - wall, time.thread_time() - own, _core.picture_clock_s()
    if pool is not None and pool_after is not None and pool_after > pool:
        own += (pool_after - pool) * _core.picture_threads()
    return result, own if own > 0.0 else wall
