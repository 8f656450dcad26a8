"""Which view to render next, how fine, and when to wait: the frame pump's judgement, without threads or clocks.

Rules (``protocol/README.md``): the newest pose wins per view; the airway view keeps the asked rate and the others share
what is left, so that none starves; a few unacknowledged pictures per view at most, so that a slow client gets fewer
pictures and never older ones; coarse while something moves, fine once it is still.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from carina.render import LEAD_VIEW, VIEWS
from carina.server.budget import AIRWAY_LEVELS, OVER, PLANAR_LEVELS, FrameBudget

__all__ = ["DEFAULT_RATE_HZ", "MOVING", "FrameScheduler", "RenderOrder"]

DEFAULT_RATE_HZ = 60.0
"""Airway pictures per second that are asked for while moving."""
STILL_AFTER_S = 0.150
"""A view counts as moving for this long after its content last changed."""
LONG_S = 0.250
"""A full picture that takes longer has one of middle size before it, as fine as this allows."""
GAP = 0.97
"""Airway pictures begin this part of a period apart, on average. A little less than one: a hand's input that comes at
the same rate, give or take a millisecond, is answered when it comes."""
ALONE_FITS = 0.95
"""Part of the period that the airway picture may take while nothing else moves."""
OTHERS_SHARE = 0.35
"""Seconds that the other views get for each second spent on the moving airway view."""
OTHERS_MOVE_S = 0.5
"""The others count as moving for this long after one of them last changed."""
OTHERS_TARGET_S = 0.025
"""Time of one picture of another view while the airway view rests."""
MAX_CREDIT_S = 0.25
MAX_IN_FLIGHT: dict[str, int] = {LEAD_VIEW: 3}
LOST_AFTER_S = 3.0
"""A picture that is not acknowledged for so long is taken as lost: a client that lost one must not stay without any."""

FINDER, MOVING, PAUSED, FULL = 0, 1, 2, 3
"""Grades of a picture."""


@dataclass(frozen=True, slots=True)
class RenderOrder:
    """One picture to render."""

    view: str
    """The view that it is for."""
    width: int
    height: int
    step_vox: float
    grade: int
    key: Hashable
    full_width: int
    full_height: int
    """Size that the client asked for."""
    level: int
    purpose: Literal["picture", "finder", "probe"] = "picture"
    """A finder picture is the cut-plane in the place of the view; a probe is measured and not shown."""
    begun_s: float = 0.0

    @property
    def full(self) -> bool:
        """Final quality for this content."""
        return self.grade == FULL


@dataclass(slots=True)
class _View:
    width: int
    height: int
    budget: FrameBudget
    seen_key: Hashable = None
    changed_s: float = -math.inf
    sent_key: Hashable = None
    sent_grade: int = -1
    in_flight: dict[int, float] = field(default_factory=dict)
    """Frame ids, and when they were sent."""
    was_still: bool = True
    """No moving picture was ordered since the view last rested."""

    @property
    def pixels(self) -> int:
        return self.width * self.height

    def is_moving(self, now_s: float) -> bool:
        # The same sum as in still_s: a difference would round to just before the time that was waited for.
        return now_s < self.still_s

    @property
    def still_s(self) -> float:
        return self.changed_s + STILL_AFTER_S

    def grade(self, now_s: float) -> int:
        """How fine a picture may be now."""
        if self.is_moving(now_s):
            return FINDER if self.budget.finding else MOVING
        if self.sent_key == self.seen_key and self.sent_grade >= PAUSED:
            return FULL
        if self.budget.predicted_s(0, self.pixels) <= LONG_S:
            return FULL
        # Finer than while moving, or it would be the same picture again. What stood in is no airway picture yet.
        finer = self.budget.finding or self.budget.finest_within(LONG_S, self.pixels) < self.budget.level
        return PAUSED if finer else FULL


class FrameScheduler:
    """State of the visible views; every call passes the time in seconds of one monotonic clock."""

    def __init__(self, *, rate_hz: float = DEFAULT_RATE_HZ) -> None:
        self._period_s = 1.0 / rate_hz
        self._views: dict[str, _View] = {}
        self._budgets: dict[str, FrameBudget] = {}
        self._credit_s = 0.0
        self._turn: list[str] = []
        self._due_s = -math.inf
        """When the next airway picture may begin while moving."""
        self._airway_s = 0.0
        """What the last moving airway picture took."""

    def set_rate(self, rate_hz: float) -> None:
        """Ask for so many airway pictures per second while moving."""
        self._period_s = 1.0 / rate_hz

    def set_layout(self, views: Mapping[str, tuple[int, int]]) -> None:
        """The visible views and their sizes; a view of the same size keeps what was sent."""
        old = self._views
        self._views = {}
        for name, (width, height) in views.items():
            view = old.get(name)
            if view is None:
                # What its pictures cost is still known from when it was last visible.
                if name not in self._budgets:
                    finder = name == LEAD_VIEW
                    self._budgets[name] = FrameBudget(AIRWAY_LEVELS if finder else PLANAR_LEVELS, finder=finder)
                view = _View(width, height, self._budgets[name])
            elif (view.width, view.height) != (width, height):
                view.width, view.height, view.sent_key = width, height, None
            self._views[name] = view
        self._turn = [name for name in self._turn if name in self._views]
        self._turn += [name for name in self._views if name not in self._turn]

    def observe(self, keys: Mapping[str, Hashable], now_s: float) -> None:
        """Note what each visible view should show now; equal keys mean equal pictures, None is nothing to show."""
        for name, view in self._views.items():
            key = keys.get(name)
            if key != view.seen_key:
                if key is not None and (view.seen_key is not None or VIEWS[name].costly):
                    view.was_still = view.was_still or not view.is_moving(now_s)
                    view.changed_s = now_s
                view.seen_key = key

    def next_order(self, now_s: float) -> RenderOrder | None:
        """The next picture, or None: all is sent, waits to be acknowledged, to be still, or for its time."""
        ready = [n for n in self._turn if self._wanted(n, now_s) and self._held_until_s(n, now_s) <= now_s]
        others = [name for name in ready if name != LEAD_VIEW]
        if LEAD_VIEW in ready and not (others and self._credit_s > 0.0):
            return self._airway_order(now_s)
        if not others:
            return None
        # Round robin: the view served goes to the end of the queue.
        name = others[0]
        self._turn.remove(name)
        self._turn.append(name)
        return self._order(name, now_s)

    def wake_s(self, now_s: float) -> float | None:
        """When to ask again without an event: a view may become finer, its time comes, a lost picture is given up."""
        times: list[float] = []
        for name, view in self._views.items():
            if view.seen_key is None:
                continue
            if self._is_news(view, now_s):
                room_s = now_s if self._has_room(name, now_s) else min(view.in_flight.values()) + LOST_AFTER_S
                times.append(max(room_s, self._held_until_s(name, now_s)))
            elif view.sent_grade < FULL:
                times.append(view.still_s)
        return min(times, default=None)

    def _held_until_s(self, name: str, now_s: float) -> float:
        """Until when a view that wants a picture is held back for the sake of the moving airway view's rate."""
        airway = self._views.get(LEAD_VIEW)
        if airway is None or not airway.is_moving(now_s):
            return now_s
        if name == LEAD_VIEW:
            return max(self._due_s, now_s)
        expected_s = self._expected_s(name, now_s)
        if self._views[name].grade(now_s) > MOVING and expected_s > OVER * self._other_budget_s(now_s):
            # It would be given up at the next movement, again and again.
            return airway.still_s
        waits_s = self._due_s - now_s if self._wanted(LEAD_VIEW, now_s) else 0.0
        # Beyond their share, the others only take the time that would be waited anyway.
        return self._due_s if waits_s > 0.0 >= self._credit_s and expected_s > waits_s else now_s

    def rendered(
        self, order: RenderOrder, frame_id: int, seconds: float, now_s: float, *, rays_s: float | None = None
    ) -> bool:
        """A picture was rendered; False if it is not to be sent: a view that is gone, a probe.

        ``rays_s`` is what its rays take where nothing else wants a core; None where nobody counted it.
        """
        view = self._views.get(order.view)
        self._account(order, seconds)
        if view is None:
            return False
        pixels = view.pixels
        if order.purpose == "probe":
            # The scale that it really had: no picture is smaller than 16 pixels.
            scale = math.sqrt(order.width * order.height / pixels)
            view.budget.learn_probe(scale, pixels, seconds, now_s, rays_s)
            return False
        if order.purpose == "picture":
            view.budget.learn(order.level, pixels, seconds, rays_s)
        view.sent_key, view.sent_grade = order.key, order.grade
        view.in_flight[frame_id] = now_s
        return True

    def given_up(self, order: RenderOrder, seconds: float) -> None:
        """A picture was given up for a newer one; it is asked for again if it is still wanted then."""
        self._account(order, seconds)

    def _account(self, order: RenderOrder, seconds: float) -> None:
        if order.view != LEAD_VIEW:
            self._credit_s = max(-MAX_CREDIT_S, self._credit_s - seconds)
            return
        self._credit_s = min(MAX_CREDIT_S, self._credit_s + OTHERS_SHARE * seconds)
        if order.grade == MOVING:
            self._airway_s = seconds

    def failed(self, order: RenderOrder) -> None:
        """A picture could not be rendered; it is not asked for again until its content changes."""
        view = self._views.get(order.view)
        if view is not None:
            view.sent_key, view.sent_grade = order.key, FULL

    def acknowledge(self, frame_id: int) -> None:
        """The client has decoded a picture; ids that are not known were never sent, or count as lost."""
        for view in self._views.values():
            view.in_flight.pop(frame_id, None)

    def gives_way(self, order: RenderOrder, keys: Mapping[str, Hashable], now_s: float) -> bool:
        """Whether a picture under way should be given up, now that the views should show this."""
        if order.grade <= MOVING:
            # What is shown while moving is never given up: under a steady hand nothing would ever be ready.
            return False
        if keys.get(order.view) != order.key or keys.get(LEAD_VIEW) != self._seen(LEAD_VIEW):
            return True
        # A long picture also gives way to what happens in the other views.
        others_wait = any(keys.get(name) != view.seen_key for name, view in self._views.items())
        return others_wait and now_s - order.begun_s + self._expected_s(order.view, now_s) > LONG_S

    @property
    def visible(self) -> tuple[str, ...]:
        """The views of the layout."""
        return tuple(self._views)

    @property
    def finding(self) -> bool:
        """The view finder stands in for the airway view while it moves."""
        return LEAD_VIEW in self._views and self._views[LEAD_VIEW].budget.finding

    def num_in_flight(self, view: str) -> int:
        """Pictures of a view sent and not acknowledged."""
        return len(self._views[view].in_flight) if view in self._views else 0

    def _seen(self, name: str) -> Hashable:
        view = self._views.get(name)
        return None if view is None else view.seen_key

    def _has_room(self, name: str, now_s: float) -> bool:
        in_flight = self._views[name].in_flight
        for frame_id in [n for n, sent_s in in_flight.items() if now_s >= sent_s + LOST_AFTER_S]:
            del in_flight[frame_id]
        return len(in_flight) < MAX_IN_FLIGHT.get(name, 1)

    def _is_news(self, view: _View, now_s: float) -> bool:
        return view.sent_key != view.seen_key or view.grade(now_s) > view.sent_grade

    def _wanted(self, name: str, now_s: float) -> bool:
        view = self._views[name]
        return view.seen_key is not None and self._has_room(name, now_s) and self._is_news(view, now_s)

    def _expected_s(self, name: str, now_s: float) -> float:
        view = self._views[name]
        level = view.budget.level if view.grade(now_s) <= MOVING else 0
        return view.budget.predicted_s(level, view.pixels)

    def _others_move(self, now_s: float) -> bool:
        return any(now_s < v.changed_s + OTHERS_MOVE_S for name, v in self._views.items() if name != LEAD_VIEW)

    def _airway_budget_s(self, now_s: float) -> float:
        """Time of an airway picture while moving, so that one of it and the others' share fit in a period."""
        return self._period_s * (GAP / (1.0 + OTHERS_SHARE) if self._others_move(now_s) else ALONE_FITS)

    def _other_budget_s(self, now_s: float) -> float:
        if LEAD_VIEW not in self._views or not self._views[LEAD_VIEW].is_moving(now_s):
            return OTHERS_TARGET_S
        # Where the airway picture takes longer than a period, the share grows with it.
        return max(self._period_s * OTHERS_SHARE / (1.0 + OTHERS_SHARE), self._airway_s * OTHERS_SHARE)

    def _airway_order(self, now_s: float) -> RenderOrder:
        view = self._views[LEAD_VIEW]
        if view.is_moving(now_s):
            gap_s = GAP * self._period_s
            # On a grid of times, so that a late picture is caught up with; never two in less than half a period.
            self._due_s = max(self._due_s + gap_s, now_s + gap_s / 2)
            if view.budget.probe_due(now_s):
                return self._sized(LEAD_VIEW, now_s, view.budget.probe_scale(view.pixels), "probe")
        return self._order(LEAD_VIEW, now_s)

    def _order(self, name: str, now_s: float) -> RenderOrder:
        view = self._views[name]
        grade = view.grade(now_s)
        if grade == FINDER:
            return self._sized(name, now_s, 1.0, "finder")
        if grade == MOVING:
            limit_s = self._airway_budget_s(now_s) if name == LEAD_VIEW else self._other_budget_s(now_s)
            level = view.budget.choose(limit_s, view.pixels, now_s, begins=view.was_still)
            view.was_still = False
        else:
            level = 0 if grade == FULL else view.budget.finest_within(LONG_S, view.pixels)
            view.was_still = True
        return self._sized(name, now_s, view.budget.levels[level].scale, "picture", level=level)

    def _sized(
        self,
        name: str,
        now_s: float,
        scale: float,
        purpose: Literal["picture", "finder", "probe"],
        *,
        level: int | None = None,
    ) -> RenderOrder:
        view = self._views[name]
        levels = view.budget.levels
        level = len(levels) - 1 if level is None else level
        return RenderOrder(
            name,
            max(16, round(view.width * scale)),
            max(16, round(view.height * scale)),
            levels[level].step_vox,
            grade=FINDER if purpose == "probe" else view.grade(now_s),
            key=view.seen_key,
            full_width=view.width,
            full_height=view.height,
            level=level,
            purpose=purpose,
            begun_s=now_s,
        )
