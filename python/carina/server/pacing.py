"""Which view to render next, how fine, and when to wait: the frame pump's judgement, without threads or clocks.

Rules (``protocol/README.md``): the newest pose wins per view; the airway view goes first and the others share what is
left, so that none starves; a few unacknowledged pictures per view at most, so that a slow client gets fewer pictures
and never older ones; coarse while something moves, fine once it is still.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field

__all__ = ["FrameScheduler", "RenderOrder"]

STILL_AFTER_S = 0.150
"""A view counts as moving for this long after its content last changed."""
SETTLED_AFTER_S = 0.600
"""Where the full picture takes long, it is begun only now: a picture under way cannot be stopped, and would hold up a
person who only paused."""
LONG_S = 0.250
"""What is long; between the two times above the picture is as fine as this allows."""
TARGET_S = 0.040
"""Time of one picture while moving: 25 pictures per second."""
OTHERS_SHARE = 0.35
"""Seconds that the other views get for each second spent on the moving airway view."""
MAX_CREDIT_S = 0.25
MAX_IN_FLIGHT = {"airway": 3}

LEVELS = ((1.0, 0.5), (1.0, 1.0), (0.75, 1.0), (0.5, 1.0), (0.375, 1.0), (0.25, 1.0))
"""Scale of the picture's sides, and ray step in voxels, from fine to coarse."""

MOVING, PAUSED, FULL = 0, 1, 2
"""Grades of a picture."""

COSTLY_VIEWS = frozenset({"airway", "tri-plane", "tree"})
"""Cast with perspective rays: the first picture is coarse, since it may take long. The others cost milliseconds."""


@dataclass(frozen=True, slots=True)
class RenderOrder:
    """One picture to render."""

    view: str
    width: int
    height: int
    step_vox: float
    grade: int
    key: Hashable
    full_width: int
    """Width that the client asked for."""
    epoch: int
    """Which client it was made for."""

    @property
    def full(self) -> bool:
        """Final quality for this content."""
        return self.grade == FULL


@dataclass(slots=True)
class _View:
    width: int
    height: int
    seen_key: Hashable = None
    changed_s: float = -math.inf
    sent_key: Hashable = None
    sent_grade: int = -1
    in_flight: set[int] = field(default_factory=set)
    level: int = len(LEVELS) - 1
    unit_cost_s: float | None = None
    """Seconds per ray at one step per voxel, smoothed."""

    def grade(self, now_s: float) -> int:
        """How fine a picture may be now."""
        # The same sums as in next_grade_s: a difference would round to just before the time that was waited for.
        if now_s < self.changed_s + STILL_AFTER_S:
            return MOVING
        if now_s >= self.changed_s + SETTLED_AFTER_S or self.predicted_s(0) <= LONG_S:
            return FULL
        # Finer than while moving, or it would be the same picture again.
        return PAUSED if self.paused_level() < self.level else MOVING

    def paused_level(self) -> int:
        """The finest level that does not take long."""
        return next((n for n in range(len(LEVELS)) if self.predicted_s(n) <= LONG_S), len(LEVELS) - 1)

    def next_grade_s(self, now_s: float) -> float | None:
        """When a finer picture becomes possible by waiting."""
        if self.grade(now_s) == FULL:
            return None
        first_s = self.changed_s + STILL_AFTER_S
        return first_s if now_s < first_s else self.changed_s + SETTLED_AFTER_S

    def predicted_s(self, level: int) -> float:
        scale, step_vox = LEVELS[level]
        return (self.unit_cost_s or 0.0) * self.width * self.height * scale * scale / step_vox


class FrameScheduler:
    """State of the visible views; every call passes the time in seconds of one monotonic clock."""

    def __init__(self, *, target_s: float = TARGET_S) -> None:
        self._target_s = target_s
        self._views: dict[str, _View] = {}
        self._credit_s = 0.0
        self._turn: list[str] = []
        self._epoch = 0

    def set_layout(self, views: Mapping[str, tuple[int, int]]) -> None:
        """The visible views and their sizes; a view of the same size keeps what was sent."""
        old = self._views
        self._views = {}
        for name, (width, height) in views.items():
            view = old.get(name)
            if view is None:
                view = _View(width, height)
            elif (view.width, view.height) != (width, height):
                view.width, view.height, view.sent_key = width, height, None
            self._views[name] = view
        self._turn = [name for name in self._turn if name in self._views]
        self._turn += [name for name in self._views if name not in self._turn]

    def forget_sent(self) -> None:
        """A new client: everything is sent again, nothing is in flight, and orders under way are for nobody."""
        self._epoch += 1
        for view in self._views.values():
            view.sent_key, view.sent_grade = None, -1
            view.in_flight.clear()

    def observe(self, keys: Mapping[str, Hashable], now_s: float) -> None:
        """Note what each visible view should show now; equal keys mean equal pictures, None is nothing to show."""
        for name, view in self._views.items():
            key = keys.get(name)
            if key != view.seen_key:
                if key is not None and (view.seen_key is not None or name in COSTLY_VIEWS):
                    view.changed_s = now_s
                view.seen_key = key

    def next_order(self, now_s: float) -> RenderOrder | None:
        """The next picture, or None: all is sent, waits to be acknowledged, or waits to be still."""
        ready = [name for name in self._views if self._wanted(name, now_s)]
        if not ready:
            return None
        others = [name for name in self._turn if name in ready and name != "airway"]
        if "airway" in ready and not (others and self._credit_s > 0.0):
            return self._order("airway", now_s)
        # Round robin: the view served goes to the end of the queue.
        name = others[0]
        self._turn.remove(name)
        self._turn.append(name)
        return self._order(name, now_s)

    def wake_s(self, now_s: float) -> float | None:
        """When to ask again without an event: the moment the first view may become finer."""
        times = [
            view.next_grade_s(now_s)
            for name, view in self._views.items()
            if view.seen_key is not None and view.sent_grade < FULL and self._has_room(name)
        ]
        return min((t for t in times if t is not None), default=None)

    def rendered(self, order: RenderOrder, frame_id: int, seconds: float) -> bool:
        """A picture was rendered; False if it is no longer wanted (another client, or the view is gone)."""
        view = self._views.get(order.view)
        if view is None or order.epoch != self._epoch:
            return False
        view.sent_key, view.sent_grade = order.key, order.grade
        view.in_flight.add(frame_id)
        rays = order.width * order.height / order.step_vox
        cost = seconds / rays
        view.unit_cost_s = cost if view.unit_cost_s is None else 0.6 * view.unit_cost_s + 0.4 * cost
        self._choose_level(view)
        if order.view == "airway":
            self._credit_s = min(MAX_CREDIT_S, self._credit_s + OTHERS_SHARE * seconds)
        else:
            self._credit_s = max(-MAX_CREDIT_S, self._credit_s - seconds)
        return True

    def failed(self, order: RenderOrder) -> None:
        """A picture could not be rendered; it is not asked for again until its content changes."""
        view = self._views.get(order.view)
        if view is not None:
            view.sent_key, view.sent_grade = order.key, FULL

    def acknowledge(self, frame_id: int) -> None:
        """The client has decoded a picture; ids that are not known are of an earlier client."""
        for view in self._views.values():
            view.in_flight.discard(frame_id)

    @property
    def visible(self) -> tuple[str, ...]:
        """The views of the layout."""
        return tuple(self._views)

    def num_in_flight(self, view: str) -> int:
        """Pictures of a view sent and not acknowledged."""
        return len(self._views[view].in_flight) if view in self._views else 0

    def is_moving(self, view: str, now_s: float) -> bool:
        """The view's content changed a moment ago."""
        return view in self._views and now_s - self._views[view].changed_s < STILL_AFTER_S

    def _has_room(self, name: str) -> bool:
        return len(self._views[name].in_flight) < MAX_IN_FLIGHT.get(name, 1)

    def _wanted(self, name: str, now_s: float) -> bool:
        view = self._views[name]
        if view.seen_key is None or not self._has_room(name):
            return False
        return view.sent_key != view.seen_key or view.grade(now_s) > view.sent_grade

    def _order(self, name: str, now_s: float) -> RenderOrder:
        view = self._views[name]
        grade = view.grade(now_s)
        scale, step_vox = LEVELS[(view.level, view.paused_level(), 0)[grade]]
        return RenderOrder(
            name,
            max(16, round(view.width * scale)),
            max(16, round(view.height * scale)),
            step_vox,
            grade=grade,
            key=view.seen_key,
            full_width=view.width,
            epoch=self._epoch,
        )

    def _choose_level(self, view: _View) -> None:
        # Hysteresis, so that the picture does not flicker between two sizes: coarser above 115 % of the target, finer
        # only where the finer picture is predicted below 85 % of it.
        while view.level < len(LEVELS) - 1 and view.predicted_s(view.level) > 1.15 * self._target_s:
            view.level += 1
        while view.level > 0 and view.predicted_s(view.level - 1) < 0.85 * self._target_s:
            view.level -= 1
