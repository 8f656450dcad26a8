"""Choice of the picture quality level that fits a time budget, from learned render costs and with hysteresis.

There is one :class:`FrameBudget` per view. It uses neither a clock nor a renderer: the caller passes times in seconds.
Reasons for the design: ``docs/decisions/0108``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

from carina.render.saved_picture import FULL_STEP_VOX


@dataclass(frozen=True, slots=True)
class Level:
    """Quality level of a picture: its size and its ray step."""

    scale: float
    """Factor on the width and the height of the picture, at most 1."""
    step_vox: float
    """Length of a ray step in voxels; longer steps are faster and coarser."""

    @property
    def work(self) -> float:
        """Expected cost relative to the finest level, before any cost is learned."""
        # Measured on a chest CT: the cost is proportional to the rays; an eighth of it does not depend on the step.
        return self.scale**2 * (0.12 + 0.88 * FULL_STEP_VOX / self.step_vox)


_SCALES = (1.0, 0.92, 0.84, 0.77, 0.71, 0.65, 0.6, 0.55, 0.5, 0.46, 0.42, 0.385, 0.35, 0.325, 0.3, 0.275, 0.25)
PLANAR_LEVELS = tuple(Level(scale, FULL_STEP_VOX) for scale in _SCALES)
AIRWAY_LEVELS = (*PLANAR_LEVELS, *(Level(0.25, step_vox) for step_vox in (0.6, 0.72, 0.86, 1.0, 1.2, 1.4, 1.7, 2.0)))
"""Quality levels of the airway view from fine to coarse: first the resolution falls, then the ray step grows.

Each level costs about 0.85 of the level before, so that a budget is never missed by much.
"""

OVER = 1.0
"""Ratio of a picture's predicted time to its time budget above which a coarser quality level is selected."""
FITS = 0.9
"""Maximum ratio of a picture's predicted time to its time budget at a newly selected quality level.

Levels are a factor of 0.85 apart; between 0.9 and 1 the level does not change (hysteresis).
"""
DWELL_S = 0.4
"""Minimum time in s before a change to the next finer level; it doubles each time a finer level proves too slow."""
MAX_DWELL_S = 2.0
REVOKED_WITHIN_S = 1.5
"""Maximum time in s at a finer quality level that counts as too slow; a longer stay does not double :data:`DWELL_S`."""
SMOOTH_FASTER = 0.35
"""Weight (0..1) of a new lower cost in the estimated cost; a new higher cost replaces the estimate at once."""
BESIDE_AMONG = 16
"""Number of recent pictures from which the fixed time per picture (encoding, header, delivery) is estimated.

The estimate is the lower quartile of their times outside the rays.
"""
WAITS_AMONG = 5
"""Number of recent pictures whose median is the present wait for processor cores that other programs use.

With fewer pictures, a single delay would count as a lasting load.
"""
WAITS_RISE = 1.5
"""Maximum estimate of the present wait for cores, as a multiple of the mean wait of the last 16 pictures."""
RAYS_MATTER = 0.4
"""Minimum ray time, as a share of the time budget, for which a coarser level is selected."""
EACH_S = 0.0005
"""Fixed seconds per picture outside the rays, used if the time of the rays is not measured."""
CLOCK_VARIES = 1.3
"""Maximum assumed ray time of an unmeasured picture, as a multiple of the lower quartile of the last 16 ray times.

The time of a picture above this limit counts as a wait for cores.
"""
SURPRISE = 0.25
"""Share of the prediction error after a change of the quality level that is added to the level's cost."""
MAX_SHAPE = math.log(1.3)
"""Limit (natural logarithm) of the learned correction to the expected cost of a level."""
FORGET = 0.998
"""Factor per picture by which learned corrections of the levels' costs decay, so that an error does not last."""

FINDER_BELOW_PER_S = 5.0
"""Pictures per second at the coarsest level below which the viewfinder replaces the view (paper 3.1)."""
HOPELESS_AMONG = 4
"""Minimum number of pictures after which a large fixed time per picture alone switches to the cut-plane
(viewfinder)."""
RECOVERED = 1.5
"""Minimum ratio of the coarsest level's predicted rate to :data:`FINDER_BELOW_PER_S` at which the airway view
returns."""
PROBE_S = 0.010
"""Intended rendering time in s of a probe: a small picture that measures the speed and is not shown."""
PROBE_EVERY_S = 0.5
PROBE_SHARE = 0.05
"""Maximum share of the elapsed time that is spent on probes."""


class FrameBudget:
    """Learned render costs of one view by level, and the choice of the level that fits a time budget.

    Parameters
    ----------
    levels
        Levels from fine to coarse.
    finder
        Whether the viewfinder may replace the view if the coarsest level is too slow.

    Notes
    -----
    The time of a picture is the sum of its ray time, a fixed time per picture, and the wait for cores that other
    programs use. The ray time is processor time divided by threads, so that other programs do not change it. It is
    ``speed * work(level) * shape(level)`` times the number of pixels at full size. ``speed`` depends on the content; it
    is the median of the last three pictures, so that a single outlier has no effect. ``shape`` is the ratio of real to
    expected work of a level; it is learned at each change of level, because the content hardly changes between two
    pictures.
    """

    def __init__(self, levels: tuple[Level, ...], *, finder: bool = False) -> None:
        self.levels = levels
        self.level = next(n for n, level in enumerate(levels) if level.scale == levels[-1].scale)
        """Index of the level for moving pictures; initially the coarsest resolution, as the cost is not known yet."""
        self._may_find = finder
        self._speed: float | None = None
        self._recent: deque[float] = deque(maxlen=3)
        self._beside: deque[float] = deque(maxlen=BESIDE_AMONG)
        """Time in s, except the ray time, of each of the recent pictures."""
        self._each_s = EACH_S
        self._clocked: deque[float] = deque(maxlen=BESIDE_AMONG)
        """Log speeds of the last pictures from elapsed time, for pictures without a measured ray time."""
        self._shape = [0.0] * (len(levels) + 1)
        self._learned: int | None = None
        """Index of the level of the last picture; ``len(levels)`` means a probe."""
        self._changed_s = -math.inf
        self._refined_s = -math.inf
        self._dwell_s = DWELL_S
        self._finding = False
        self._probe_due_s = -math.inf

    @property
    def finding(self) -> bool:
        """Whether the cut-plane (viewfinder) replaces the airway view while the tip moves."""
        return self._finding

    def predicted_s(self, level: int, pixels: int) -> float:
        """Return the predicted seconds of a picture with ``pixels`` pixels at full size; 0 before the first picture.

        The wait for cores is assumed to be equal at every level.
        """
        if self._speed is None:
            return 0.0
        return self._each_s + self._wait_s() + self._rays_s(level, pixels)

    def finest_within(self, seconds: float, pixels: int) -> int:
        """Return the index of the finest level predicted to take at most ``seconds``, or of the coarsest level."""
        return self._first_fitting_level(lambda n: self.predicted_s(n, pixels) <= seconds)

    def _first_fitting_level(self, fits: Callable[[int], bool]) -> int:
        levels = range(len(self.levels))
        return next((n for n in levels if fits(n)), len(self.levels) - 1)

    def _rays_s(self, level: int, pixels: int) -> float:
        """Return the predicted ray time of a level in seconds, without a wait for cores."""
        assert self._speed is not None
        return math.exp(self._speed + self._shape[level]) * self.levels[level].work * pixels

    def _wait_s(self) -> float:
        """Return the current wait for cores per picture in seconds."""
        now_s = max(0.0, median(list(self._beside)[-WAITS_AMONG:]) - self._each_s)
        return min(now_s, WAITS_RISE * self._usual_wait_s())

    def _usual_wait_s(self) -> float:
        """Return the mean wait for cores of the last pictures in seconds, without the longest wait (an outlier)."""
        waits_s = sorted(max(0.0, beside_s - self._each_s) for beside_s in self._beside)
        return sum(waits_s[:-1]) / max(1, len(waits_s) - 1)

    def learn(self, level: int, pixels: int, seconds: float, rays_s: float | None = None) -> None:
        """Update the estimated costs with the times of a rendered picture.

        Parameters
        ----------
        level
            Index of the level of the picture.
        pixels
            Number of pixels at full size.
        seconds
            Elapsed time of the picture.
        rays_s
            Processor time of the rays divided by the threads; None if it was not measured.
        """
        self._learn(level, self.levels[level].work * pixels, seconds, rays_s)
        self._update_view_finder(pixels)

    def _learn(self, index: int, work: float, seconds: float, rays_s: float | None) -> None:
        if rays_s is None:
            rays_s = self._rays_by_clock_s(index, work, seconds)
        self._beside.append(max(0.0, seconds - rays_s))
        self._each_s = sorted(self._beside)[len(self._beside) // 4]
        found = math.log(max(rays_s, 1e-6) / work) - self._shape[index]
        self._shape = [FORGET * shape for shape in self._shape]
        if self._speed is not None and index != self._learned:
            shape = self._shape[index] + SURPRISE * (found - self._speed)
            self._shape[index] = max(-MAX_SHAPE, min(MAX_SHAPE, shape))
            found -= SURPRISE * (found - self._speed)
        self._learned = index
        self._recent.append(found)
        now = median(self._recent)
        if self._speed is None or now > self._speed:
            self._speed = now
        else:
            self._speed += SMOOTH_FASTER * (now - self._speed)

    def _rays_by_clock_s(self, index: int, work: float, seconds: float) -> float:
        """Estimate the ray time of a picture from its elapsed time, limited by the lower quartile of the last ones."""
        # At least half of the time counts as ray time, so that a picture faster than EACH_S has a positive cost.
        rays_s = max(seconds - EACH_S, 0.5 * seconds, 1e-6)
        self._clocked.append(math.log(rays_s / work) - self._shape[index])
        quiet = sorted(self._clocked)[len(self._clocked) // 4]
        return min(rays_s, CLOCK_VARIES * math.exp(quiet + self._shape[index]) * work)

    def choose(self, budget_s: float, pixels: int, now_s: float, *, begins: bool = False) -> int:
        """Choose and return the level index of the next moving picture.

        Parameters
        ----------
        budget_s
            Time in seconds that the picture may take.
        pixels
            Number of pixels at full size.
        now_s
            Current time in seconds.
        begins
            Whether the picture is the first of a movement; a finer level then needs no waiting time.
        """
        if self._speed is None:
            return self.level
        if self.predicted_s(self.level, pixels) > OVER * budget_s:
            wanted = self._coarser_level(budget_s, pixels)
        else:
            # The load of other programs may return, so a finer level must also fit with the usual wait.
            rest_s = self._each_s + max(self._wait_s(), self._usual_wait_s())
            wanted = min(
                self.level, self._first_fitting_level(lambda n: rest_s + self._rays_s(n, pixels) <= FITS * budget_s)
            )
        if wanted > self.level:
            if now_s - self._refined_s < REVOKED_WITHIN_S:
                self._dwell_s = min(2.0 * self._dwell_s, MAX_DWELL_S)
            self.level, self._changed_s = wanted, now_s
        elif wanted < self.level and (begins or now_s - self._changed_s >= self._dwell_s):
            if now_s - self._refined_s >= REVOKED_WITHIN_S and now_s - self._changed_s >= 2.0 * self._dwell_s:
                self._dwell_s = DWELL_S
            self.level, self._changed_s, self._refined_s = wanted, now_s, now_s
        return self.level

    def _coarser_level(self, budget_s: float, pixels: int) -> int:
        """Return the index of the coarser level that fits the budget, if waits for cores shrink with the ray time."""
        stretch = 1.0 + self._wait_s() / self._rays_s(self.level, pixels)
        fits = self._first_fitting_level(lambda n: self._each_s + stretch * self._rays_s(n, pixels) <= FITS * budget_s)
        fits = max(self.level, fits)
        # If the rays take a small share of the picture's time, fewer rays would only reduce the sharpness.
        matter_s = RAYS_MATTER * budget_s
        enough = self._first_fitting_level(lambda n: self._rays_s(n, pixels) <= matter_s)
        if enough >= self.level:
            return min(fits, enough)
        return min(self.level, self._first_fitting_level(lambda n: self._rays_s(n, pixels) <= FITS * matter_s))

    def _update_view_finder(self, pixels: int) -> None:
        last = len(self.levels) - 1
        at_end = self.predicted_s(last, pixels)
        if not self._finding:
            # The switch needs rendered pictures: one at the coarsest level, or several whose fixed time is too long.
            tried = self.level == last and self._learned == last
            hopeless = len(self._beside) >= HOPELESS_AMONG and self._each_s > 1.0 / FINDER_BELOW_PER_S
            self._finding = self._may_find and at_end > 1.0 / FINDER_BELOW_PER_S and (tried or hopeless)
        elif at_end < 1.0 / (RECOVERED * FINDER_BELOW_PER_S):
            self._finding = False
            self.level = last

    # ------------------------------------------------------------ probes while the viewfinder replaces the view

    def probe_due(self, now_s: float) -> bool:
        """Return whether a probe should be rendered now to measure the speed."""
        return self._finding and now_s >= self._probe_due_s

    def probe_scale(self, pixels: int) -> float:
        """Return the ratio of the sides of a probe (a small picture that measures the speed) to the full picture's."""
        last = self.levels[-1]
        expected_s = self.predicted_s(len(self.levels) - 1, pixels)
        return last.scale * min(1.0, math.sqrt(PROBE_S / expected_s)) if expected_s > 0.0 else last.scale

    def learn_probe(self, scale: float, pixels: int, seconds: float, now_s: float, rays_s: float | None = None) -> None:
        """Learn from the time of a probe, and schedule the next probe; the times are those of :meth:`learn`."""
        work = Level(scale, self.levels[-1].step_vox).work * pixels
        self._learn(len(self.levels), work, seconds, rays_s)
        self._probe_due_s = now_s + max(PROBE_EVERY_S, seconds / PROBE_SHARE)
        self._update_view_finder(pixels)
