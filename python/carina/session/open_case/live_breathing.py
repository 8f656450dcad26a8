"""Simulated breathing of the open case, on a clock that pauses with the attempt at a task."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from carina.breathing import Breathing, ChestFrame, ChestMotion
from carina.errors import GeometryError
from carina.session.derived.derived_value import Cached
from carina.track import AirwayTree

TICK_S = 1.0 / 30.0
"""Time between two positions of the chest, s: a breath of 12 mm moves it by less than 0.5 mm meanwhile."""
MAX_COUGHS = 1000
"""Largest number of coughs that are stored; older ones, which are over, are removed."""


def _frame_of(tree: AirwayTree) -> ChestFrame | None:
    try:
        return ChestFrame.of_tree(tree)
    except GeometryError:
        return None


@dataclass(slots=True)
class LiveBreathing:
    """Settings of the breathing and its clock; guarded by the session's lock.

    At time 0 of the clock the chest is at rest, as the CT shows it.
    """

    breathing: Breathing | None = None
    """The breathing with its coughs, on a clock that starts with the breathing; None if it is off."""
    last: Breathing | None = None
    """The last breathing that was on, whose settings a window offers while the breathing is off."""
    began_s: float = 0.0
    """Time of the session's clock at time 0 of the breathing."""
    _paused_s: float | None = None
    _frames: Cached[AirwayTree, ChestFrame | None] = field(default_factory=lambda: Cached(_frame_of))

    def begin(self, breathing: Breathing | None, now_s: float) -> None:
        """Breathe from rest, or end the breathing with None."""
        # During a pause the breathing begins on the paused clock, as recording and attempt store it.
        self.breathing, self.began_s = breathing, self.clock_s(now_s)
        self.last = breathing or self.last

    def restart(self, now_s: float) -> None:
        """Begin the same breathing again from rest, without its coughs."""
        self.begin(None if self.breathing is None else replace(self.breathing, coughs_s=()), now_s)

    def cough(self, now_s: float) -> None:
        """Add a cough that starts now; do nothing without breathing."""
        if self.breathing is not None:
            coughs = (*self.breathing.coughs_s, self.at_s(now_s))[-MAX_COUGHS:]
            self.breathing = replace(self.breathing, coughs_s=coughs)

    def pause(self, now_s: float) -> None:
        """Stop the clock."""
        if self._paused_s is None:
            self._paused_s = now_s

    def resume(self, now_s: float) -> None:
        """Continue the clock after a pause."""
        if self._paused_s is not None:
            self.began_s += max(now_s - self._paused_s, 0.0)
            self._paused_s = None

    @property
    def is_moving(self) -> bool:
        """Whether the chest moves: the breathing is on and not paused."""
        return self.breathing is not None and self._paused_s is None

    def clock_s(self, now_s: float) -> float:
        """Return the time of the session's clock at which the chest has its present state."""
        return now_s if self._paused_s is None else self._paused_s

    def at_s(self, now_s: float) -> float:
        """Return the time since the beginning of the breathing, without pauses, s."""
        return max(self.clock_s(now_s) - self.began_s, 0.0)

    def motion(self, tree: AirwayTree | None) -> ChestMotion | None:
        """Return the breathing of the chest with these airways on the session's clock.

        None without breathing, without airways, and for airways that are too low for a breathing.
        """
        chest = None if tree is None or self.breathing is None else self._frames.of(tree)
        if chest is None or self.breathing is None:
            return None
        return ChestMotion(self.breathing, chest, self.began_s)
