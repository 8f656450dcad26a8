"""How fine a picture may be so that it is ready in time: costs learned, levels chosen with hysteresis.

One :class:`FrameBudget` per view. It knows neither clock nor renderer: times are passed in, and tests simulate both.
Why it is as it is: ``docs/decisions/0108``.
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
_SCALES = (1.0, 0.92, 0.84, 0.77, 0.71, 0.65, 0.6, 0.55, 0.5, 0.46, 0.42, 0.385, 0.35, 0.325, 0.3, 0.275, 0.25)
PLANAR_LEVELS = tuple(Level(scale, FULL_STEP_VOX) for scale in _SCALES)
AIRWAY_LEVELS = (*PLANAR_LEVELS, *(Level(0.25, step_vox) for step_vox in (0.6, 0.72, 0.86, 1.0, 1.2, 1.4, 1.7, 2.0)))
"""Resolution first, then the step. A level costs some 0.85 of the one before, so a budget is never missed by much."""

OVER = 1.0
"""A level is left for a coarser one when it takes this many times the budget..."""
FITS = 0.9
"""... for one that takes at most this part of it; and for a finer one only where that is predicted to take no more. The
levels before and after such a change are 0.85 apart, so that between 0.9 and 1 nothing changes."""
DWELL_S = 0.4
"""Time between a change and the next step to a finer level; doubled each time that such a step had to be taken back."""
MAX_DWELL_S = 2.0
REVOKED_WITHIN_S = 1.5
"""A finer level that is left again within this time was a mistake."""
SMOOTH_FASTER = 0.35
"""Weight of a picture that was faster than expected; slower ones count at once."""
BESIDE_AMONG = 16
"""Of so many last pictures: a quarter took no longer beside its rays than what every picture takes (encoding, header,
hand-over)."""
WAITS_AMONG = 5
"""The median of so many last pictures tells what one now waits for cores that other programs have: fewer would take
every hiccup for a neighbour who stays. It is believed up to..."""
WAITS_RISE = 1.5
"""... this many times the mean of the last 16: every other picture's wait is no reason to shrink for a whole one."""
RAYS_MATTER = 0.4
"""No level is left for a coarser one where its rays alone take less than this part of the budget."""
EACH_S = 0.0005
"""What every picture takes besides its rays where the rays are not counted."""
CLOCK_VARIES = 1.3
"""Where they are not counted, a picture that took longer than so many times the quickest quarter of the last 16 is
taken to have waited."""
SURPRISE = 0.25
"""Part of the surprise at a change of level that is put down to the level; the rest is the content's."""
MAX_SHAPE = math.log(1.3)
"""The expected costs of levels are not further off than this; the rest is content, whatever it looks like."""
FORGET = 0.998
"""What was learned about levels fades with every picture: one bad moment must not keep a level out for good."""

FINDER_BELOW_PER_S = 5.0
"""Below this rate at the coarsest level another picture stands in as view finder (paper 3.1)."""
HOPELESS_AMONG = 4
"""After so many pictures it is believed that no level would be quick enough: the rays are not what takes the time."""
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
    The time of a picture is its rays, what every picture takes beside them, and the wait for cores that other programs
    have. The rays are counted (processor time over threads), so a neighbour does not make them look dear. They cost
    ``speed * work(level) * shape(level)`` times their number at full size. ``speed`` is the content of this moment: the
    median of the last three pictures, so that one hiccup changes nothing and dearer content is believed at its second
    picture. ``shape`` is how far a level is from its expected work; it is learned at each change of level, since from
    one picture to the next the content hardly changes.
    """

    def __init__(self, levels: tuple[Level, ...], *, finder: bool = False) -> None:
        self.levels = levels
        self.level = next(n for n, level in enumerate(levels) if level.scale == levels[-1].scale)
        """Present level while moving; at first the coarsest resolution, since the first picture may take long."""
        self._may_find = finder
        self._speed: float | None = None
        self._recent: deque[float] = deque(maxlen=3)
        self._beside: deque[float] = deque(maxlen=BESIDE_AMONG)
        """What pictures took beyond their rays."""
        self._each_s = EACH_S
        self._clocked: deque[float] = deque(maxlen=BESIDE_AMONG)
        """Speeds by the clock, where rays are not counted."""
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
        """Time of a picture of ``pixels`` pixels at full size; 0 while nothing is known.

        A wait for cores is taken to be as long at every level.
        """
        if self._speed is None:
            return 0.0
        return self._each_s + self._wait_s() + self._rays_s(level, pixels)

    def finest_within(self, seconds: float, pixels: int) -> int:
        """The finest level that is predicted to take at most this long; the coarsest where none does."""
        return self._first(lambda n: self.predicted_s(n, pixels) <= seconds)

    def _first(self, fits: Callable[[int], bool]) -> int:
        levels = range(len(self.levels))
        return next((n for n in levels if fits(n)), len(self.levels) - 1)

    def _rays_s(self, level: int, pixels: int) -> float:
        """What the rays of a level take while nothing else wants a core."""
        assert self._speed is not None
        return math.exp(self._speed + self._shape[level]) * self.levels[level].work * pixels

    def _wait_s(self) -> float:
        """What a picture now waits for cores."""
        now_s = max(0.0, median(list(self._beside)[-WAITS_AMONG:]) - self._each_s)
        return min(now_s, WAITS_RISE * self._usual_wait_s())

    def _usual_wait_s(self) -> float:
        """What the last pictures waited for cores on the average, the longest wait left out: it may be a hiccup's."""
        waits_s = sorted(max(0.0, beside_s - self._each_s) for beside_s in self._beside)
        return sum(waits_s[:-1]) / max(1, len(waits_s) - 1)

    def learn(self, level: int, pixels: int, seconds: float, rays_s: float | None = None) -> None:
        """A picture of a level took so long, ``rays_s`` of it for its rays had they had all threads; None where nobody
        counted."""
        self._learn(level, self.levels[level].work * pixels, seconds, rays_s)
        self._look_for_finder(pixels)

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
        """What of a picture's time its rays took, where nobody counted: not much more than in the quickest quarter."""
        # At least half of the time goes to the rays: a picture quicker than EACH_S must not count as nothing.
        rays_s = max(seconds - EACH_S, 0.5 * seconds, 1e-6)
        self._clocked.append(math.log(rays_s / work) - self._shape[index])
        quiet = sorted(self._clocked)[len(self._clocked) // 4]
        return min(rays_s, CLOCK_VARIES * math.exp(quiet + self._shape[index]) * work)

    def choose(self, budget_s: float, pixels: int, now_s: float, *, begins: bool = False) -> int:
        """The level of the next moving picture; ``begins`` is the first one of a movement, which need not wait."""
        if self._speed is None:
            return self.level
        if self.predicted_s(self.level, pixels) > OVER * budget_s:
            wanted = self._less(budget_s, pixels)
        else:
            # A neighbour who was there a moment ago may come back: a finer level has room for either.
            rest_s = self._each_s + max(self._wait_s(), self._usual_wait_s())
            wanted = min(self.level, self._first(lambda n: rest_s + self._rays_s(n, pixels) <= FITS * budget_s))
        if wanted > self.level:
            if now_s - self._refined_s < REVOKED_WITHIN_S:
                self._dwell_s = min(2.0 * self._dwell_s, MAX_DWELL_S)
            self.level, self._changed_s = wanted, now_s
        elif wanted < self.level and (begins or now_s - self._changed_s >= self._dwell_s):
            if now_s - self._refined_s >= REVOKED_WITHIN_S and now_s - self._changed_s >= 2.0 * self._dwell_s:
                self._dwell_s = DWELL_S
            self.level, self._changed_s, self._refined_s = wanted, now_s, now_s
        return self.level

    def _less(self, budget_s: float, pixels: int) -> int:
        """The level that fits, where the wait for cores is taken to become less with the rays."""
        stretch = 1.0 + self._wait_s() / self._rays_s(self.level, pixels)
        fits = self._first(lambda n: self._each_s + stretch * self._rays_s(n, pixels) <= FITS * budget_s)
        fits = max(self.level, fits)
        # Where the rays are no longer what takes the time, fewer of them would only cost sharpness.
        matter_s = RAYS_MATTER * budget_s
        enough = self._first(lambda n: self._rays_s(n, pixels) <= matter_s)
        if enough >= self.level:
            return min(fits, enough)
        return min(self.level, self._first(lambda n: self._rays_s(n, pixels) <= FITS * matter_s))

    def _look_for_finder(self, pixels: int) -> None:
        last = len(self.levels) - 1
        at_end = self.predicted_s(last, pixels)
        if not self._finding:
            # Only pictures that were really made are proof: one at the coarsest level, or several that took as long
            # beside their rays.
            tried = self.level == last and self._learned == last
            hopeless = len(self._beside) >= HOPELESS_AMONG and self._each_s > 1.0 / FINDER_BELOW_PER_S
            self._finding = self._may_find and at_end > 1.0 / FINDER_BELOW_PER_S and (tried or hopeless)
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

    def learn_probe(self, scale: float, pixels: int, seconds: float, now_s: float, rays_s: float | None = None) -> None:
        """A probe took so long; see :meth:`learn`."""
        work = Level(scale, self.levels[-1].step_vox).work * pixels
        self._learn(len(self.levels), work, seconds, rays_s)
        self._probe_due_s = now_s + max(PROBE_EVERY_S, seconds / PROBE_SHARE)
        self._look_for_finder(pixels)
