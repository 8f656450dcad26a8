"""How fine a picture may be so that it is ready in time: costs learned, levels chosen with hysteresis.

One :class:`FrameBudget` per view. It knows neither clock nor renderer: times are passed in, and tests simulate both.
Why it is as it is: ``docs/decisions/0010-frame-budget.md``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

__all__ = ["AIRWAY_LEVELS", "FINDER_BELOW_PER_S", "FULL_STEP_VOX", "OVER", "PLANAR_LEVELS", "FrameBudget", "Level"]


@dataclass(frozen=True, slots=True)
class Level:
    """A way to make a picture cheaper."""

    scale: float
    """Of the sides of the picture."""
    step_vox: float
    """Ray step."""

    @property
    def work(self) -> float:
        """Expected cost relative to the finest level, until pictures have shown better."""
        # Measured on a real chest: proportional to the rays, and an eighth of a ray's time does not depend on the step.
        return self.scale**2 * (0.12 + 0.88 * FULL_STEP_VOX / self.step_vox)


FULL_STEP_VOX = 0.5
PLANAR_LEVELS = tuple(Level(scale, FULL_STEP_VOX) for scale in (1.0, 0.84, 0.71, 0.6, 0.5, 0.42, 0.35, 0.3, 0.25))
AIRWAY_LEVELS = (*PLANAR_LEVELS, *(Level(0.25, step_vox) for step_vox in (0.7, 1.0, 1.4, 2.0)))
"""Resolution first, then the step. A level costs some 0.7 of the one before, so a budget is never missed by much."""

OVER = 1.08
"""A level is left for a coarser one when it takes this many times the budget..."""
COARSER_FITS = 0.92
"""... for one that takes at most this part of it, ..."""
FINER_FITS = 0.85
"""... and for a finer one only where that is predicted to take at most this part. In between nothing changes."""
DWELL_S = 0.4
"""Time between a change and the next step to a finer level; doubled each time that such a step had to be taken back."""
MAX_DWELL_S = 2.0
REVOKED_WITHIN_S = 1.5
"""A finer level that is left again within this time was a mistake."""
SMOOTH_FASTER = 0.35
"""Weight of a picture that was faster than expected; slower ones count at once."""
QUIET_AMONG = 16
"""Of so many last pictures a quarter was quicker than what counts as the time of the rays alone. The rest is
waiting for a core that another program has."""
RAYS_MATTER = 0.4
"""No level is left for a coarser one where its rays alone take less than this part of the budget."""
EACH_S = 0.0005
"""What every picture takes besides its rays: encoding, header, hand-over."""
SURPRISE = 0.25
"""Part of the surprise at a change of level that is put down to the level; the rest is the content's."""
MAX_SHAPE = math.log(1.3)
"""The expected costs of levels are not further off than this; the rest is content, whatever it looks like."""
FORGET = 0.998
"""What was learned about levels fades with every picture: one bad moment must not keep a level out for good."""

FINDER_BELOW_PER_S = 5.0
"""Below this rate at the coarsest level another picture stands in as view finder (paper 3.1)."""
RECOVERED = 1.5
"""The view comes back where the coarsest level is predicted to be this much faster than the limit."""
PROBE_S = 0.010
"""Time that a probe may take: a picture so small that it holds up nothing. It is not shown."""
PROBE_EVERY_S = 0.5
PROBE_SHARE = 0.05
"""At most this part of the time goes to probes, also where even the smallest picture takes long."""


class FrameBudget:
    """Costs of one view's pictures by level, and the level that keeps a time.

    Parameters
    ----------
    levels
        From fine to coarse.
    finder
        Whether another picture may stand in where the coarsest level is too slow.

    Notes
    -----
    The cost of a picture is modelled as ``speed * work(level) * shape(level)`` times its rays at full size, and a
    little for every picture. ``speed`` is the content and the machine of this moment: the median of the last three
    pictures, so that one hiccup changes nothing and a slow-down is believed at its second picture. ``shape`` is how far
    a level is from its expected work; it is learned at each change of level, since from one picture to the next the
    content hardly changes.
    """

    def __init__(self, levels: tuple[Level, ...], *, finder: bool = False) -> None:
        self.levels = levels
        self.level = next(n for n, level in enumerate(levels) if level.scale == levels[-1].scale)
        """Present level while moving; at first the coarsest resolution, since the first picture may take long."""
        self._may_find = finder
        self._speed: float | None = None
        self._recent: deque[float] = deque(maxlen=QUIET_AMONG)
        self._quiet = 0.0
        self._shape = [0.0] * (len(levels) + 1)
        self._learned: int | None = None
        """Level of the last picture; ``len(levels)`` is a probe."""
        self._changed_s = -math.inf
        self._refined_s = -math.inf
        self._dwell_s = DWELL_S
        self._finding = False
        self._probe_due_s = -math.inf

    @property
    def finding(self) -> bool:
        """The view finder stands in while moving."""
        return self._finding

    def predicted_s(self, level: int, pixels: int) -> float:
        """Time of a picture of ``pixels`` pixels at full size; 0 while nothing is known."""
        if self._speed is None:
            return 0.0
        return EACH_S + math.exp(self._speed + self._shape[level]) * self.levels[level].work * pixels

    def finest_within(self, seconds: float, pixels: int) -> int:
        """The finest level that is predicted to take at most this long; the coarsest where none does."""
        return self._first(lambda n: self.predicted_s(n, pixels) <= seconds)

    def _first(self, fits: Callable[[int], bool]) -> int:
        levels = range(len(self.levels))
        return next((n for n in levels if fits(n)), len(self.levels) - 1)

    def _rays_s(self, level: int, pixels: int) -> float:
        """What the rays of a level take while nothing else wants a core."""
        return math.exp(self._quiet + self._shape[level]) * self.levels[level].work * pixels

    def learn(self, level: int, pixels: int, seconds: float) -> None:
        """A picture of a level took so long."""
        self._learn(level, self.levels[level].work * pixels, seconds)
        self._look_for_finder(pixels)

    def _learn(self, index: int, work: float, seconds: float) -> None:
        # At least half of the time goes to the rays: a picture quicker than EACH_S must not count as nothing.
        found = math.log(max(seconds - EACH_S, 0.5 * seconds, 1e-6) / work) - self._shape[index]
        self._shape = [FORGET * shape for shape in self._shape]
        if self._speed is not None and index != self._learned:
            shape = self._shape[index] + SURPRISE * (found - self._speed)
            self._shape[index] = max(-MAX_SHAPE, min(MAX_SHAPE, shape))
            found -= SURPRISE * (found - self._speed)
        self._learned = index
        self._recent.append(found)
        self._quiet = sorted(self._recent)[len(self._recent) // 4]
        now = median(list(self._recent)[-3:])
        if self._speed is None or now > self._speed:
            self._speed = now
        else:
            self._speed += SMOOTH_FASTER * (now - self._speed)

    def choose(self, budget_s: float, pixels: int, now_s: float, *, begins: bool = False) -> int:
        """The level of the next moving picture; ``begins`` is the first one of a movement, which need not wait."""
        if self._speed is None:
            return self.level
        now_takes_s = self.predicted_s(self.level, pixels)
        if now_takes_s > OVER * budget_s:
            coarser = self.finest_within(COARSER_FITS * budget_s, pixels)
            # Where the rays are no longer what takes the time, fewer of them would only cost sharpness.
            enough = self._first(lambda n: self._rays_s(n, pixels) <= RAYS_MATTER * budget_s)
            coarser = max(self.level, min(coarser, enough))
            if coarser != self.level:
                if now_s - self._refined_s < REVOKED_WITHIN_S:
                    self._dwell_s = min(2.0 * self._dwell_s, MAX_DWELL_S)
                self.level, self._changed_s = coarser, now_s
        else:
            # The wait for a core stays what it is; only the rays become more.
            rest_s = now_takes_s - self._rays_s(self.level, pixels)
            finer = self._first(lambda n: rest_s + self._rays_s(n, pixels) <= FINER_FITS * budget_s)
            if finer < self.level and (begins or now_s - self._changed_s >= self._dwell_s):
                if now_s - self._refined_s >= REVOKED_WITHIN_S and now_s - self._changed_s >= 2.0 * self._dwell_s:
                    self._dwell_s = DWELL_S
                self.level, self._changed_s, self._refined_s = finer, now_s, now_s
        return self.level

    def _look_for_finder(self, pixels: int) -> None:
        last = len(self.levels) - 1
        at_end = self.predicted_s(last, pixels)
        if not self._finding:
            # Only a picture that was really made at the coarsest level is proof that it is too slow.
            self._finding = (
                self._may_find and self.level == last and self._learned == last and at_end > 1.0 / FINDER_BELOW_PER_S
            )
        elif at_end < 1.0 / (RECOVERED * FINDER_BELOW_PER_S):
            self._finding = False
            self.level = last

    # ------------------------------------------------------------ probes while the view finder stands in

    def probe_due(self, now_s: float) -> bool:
        """Whether to look how fast pictures are now."""
        return self._finding and now_s >= self._probe_due_s

    def probe_scale(self, pixels: int) -> float:
        """Scale of the sides of a probe, at the coarsest step."""
        last = self.levels[-1]
        expected_s = self.predicted_s(len(self.levels) - 1, pixels)
        return last.scale * min(1.0, math.sqrt(PROBE_S / expected_s)) if expected_s > 0.0 else last.scale

    def learn_probe(self, scale: float, pixels: int, seconds: float, now_s: float) -> None:
        """A probe took so long."""
        work = Level(scale, self.levels[-1].step_vox).work * pixels
        self._learn(len(self.levels), work, seconds)
        self._probe_due_s = now_s + max(PROBE_EVERY_S, seconds / PROBE_SHARE)
        self._look_for_finder(pixels)
