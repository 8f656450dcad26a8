"""Frame scheduler: choice of the next view to render, its quality and its time, without threads or clocks.

Rules (``protocol/README.md``): each view shows the latest pose. The airway view has the requested rate; the other views
share the remaining time, so that each of them is rendered. The number of unacknowledged pictures per view is limited,
so that a slow client gets fewer pictures but no outdated ones. Pictures are coarse while their content moves and fine
afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from typing import Literal

from carina.render import LEAD_VIEW, VIEWS
from carina.server.frames.budget import AIRWAY_LEVELS, OVER, PLANAR_LEVELS, FrameBudget

DEFAULT_RATE_HZ = 60.0
"""Default target rate of airway pictures while moving, in pictures per second."""
STILL_AFTER_S = 0.150
"""Time in s after the last change of its content during which a view counts as moving."""
LONG_S = 0.250
"""Render time in s of a full picture above which a picture of medium quality precedes it."""
GAP = 0.97
"""Mean interval between the starts of two airway pictures, as a fraction of the target period (1 / rate).

A little less than 1, so that input that arrives at the same rate with a jitter of 1 ms is rendered without delay.
"""
ALONE_FITS = 0.95
"""Maximum render time of an airway picture while no other view moves, as a fraction of the target period."""
OTHERS_SHARE = 0.35
"""Maximum render time of all other views, per second of render time of the moving airway view."""
OTHERS_MOVE_S = 0.5
"""Time in s after the last change of another view during which the other views count as moving."""
OTHERS_TARGET_S = 0.025
"""Intended render time in s of a picture of another view while the airway view does not move."""
MAX_CREDIT_S = 0.25
MAX_IN_FLIGHT: dict[str, int] = {LEAD_VIEW: 3}
LOST_AFTER_S = 3.0
"""Time in s without acknowledgement after which a picture counts as lost, so that the client gets new pictures."""

FINDER, MOVING, PAUSED, FULL = 0, 1, 2, 3
"""Quality grades of a picture, from coarse (``FINDER``) to final (``FULL``); ``PAUSED`` is medium quality at rest."""


@dataclass(frozen=True, slots=True)
class RenderOrder:
    """Order to render one picture of one view with a given quality."""

    view: str
    """Name of the view in which the picture is shown."""
    width: int
    height: int
    step_vox: float
    grade: int
    key: Hashable
    full_width: int
    full_height: int
    """Full height in pixels that the client requested; ``full_width`` likewise is the requested width."""
    level: int
    purpose: Literal["picture", "finder", "probe"] = "picture"
    """Purpose of the picture: ``finder`` shows the cut-plane in place of the view; ``probe`` is timed and not shown."""
    begun_s: float = 0.0

    @property
    def full(self) -> bool:
        """Whether the picture has the final quality for its content."""
        return self.grade == FULL


@dataclass(slots=True)
class _PacedView:
    width: int
    height: int
    budget: FrameBudget
    seen_key: Hashable = None
    changed_s: float = -math.inf
    sent_key: Hashable = None
    sent_grade: int = -1
    in_flight: dict[int, float] = field(default_factory=dict)
    """Unacknowledged pictures: frame id to time of sending in seconds."""
    was_still: bool = True
    """Whether the view was still before the current movement, so that no moving picture was ordered yet."""

    @property
    def pixels(self) -> int:
        return self.width * self.height

    def is_moving(self, now_s: float) -> bool:
        # The wake-up time is still_s, so this value is compared: a rounded difference could end the movement earlier.
        return now_s < self.still_s

    @property
    def still_s(self) -> float:
        return self.changed_s + STILL_AFTER_S

    def is_size_of(self, order: RenderOrder) -> bool:
        """Return whether an order has the current size of the view, which can change while a picture is rendered."""
        return (order.full_width, order.full_height) == (self.width, self.height)

    def grade(self, now_s: float) -> int:
        """Return the quality grade of this view's next picture at a time in s."""
        if self.is_moving(now_s):
            return FINDER if self.budget.finding else MOVING
        if self.sent_key == self.seen_key and self.sent_grade >= PAUSED:
            return FULL
        if self.budget.predicted_s(0, self.pixels) <= LONG_S:
            return FULL
        # A medium picture must be finer than the moving one; after the viewfinder, any airway picture is new.
        finer = self.budget.finding or self.budget.finest_within(LONG_S, self.pixels) < self.budget.level
        return PAUSED if finer else FULL


class FrameScheduler:
    """Scheduler of the pictures of the visible views; callers pass the time in seconds of one monotonic clock."""

    def __init__(self, *, rate_hz: float = DEFAULT_RATE_HZ) -> None:
        self._period_s = 1.0 / rate_hz
        self._views: dict[str, _PacedView] = {}
        self._budgets: dict[str, FrameBudget] = {}
        self._credit_s = 0.0
        self._turn: list[str] = []
        self._due_s = -math.inf
        """Earliest start of the next airway picture while moving, in seconds of the clock."""
        self._at_rest: Hashable = None
        """Key of the airway view without a simulated breathing."""
        self._moved_s = -math.inf
        """Time in seconds of the clock of the last change of the airway view other than by breathing."""
        self._airway_s = 0.0
        """Render time in seconds of the last moving airway picture."""

    def set_rate(self, rate_hz: float) -> None:
        """Set the target rate of airway pictures while moving, in pictures per second."""
        self._period_s = 1.0 / rate_hz

    def set_layout(self, views: Mapping[str, tuple[int, int]]) -> None:
        """Set the visible views and their sizes in pixels; a view of unchanged size is not sent again."""
        old = self._views
        self._views = {}
        for name, (width, height) in views.items():
            view = old.get(name)
            if view is None:
                # The budget of a view that was visible before still has its learned costs.
                if name not in self._budgets:
                    finder = name == LEAD_VIEW
                    self._budgets[name] = FrameBudget(AIRWAY_LEVELS if finder else PLANAR_LEVELS, finder=finder)
                view = _PacedView(width, height, self._budgets[name])
            elif (view.width, view.height) != (width, height):
                view.width, view.height, view.sent_key = width, height, None
            self._views[name] = view
        self._turn = [name for name in self._turn if name in self._views]
        self._turn += [name for name in self._views if name not in self._turn]

    def observe(self, keys: Mapping[str, Hashable], now_s: float, *, at_rest: Hashable = None) -> None:
        """Record the content key of each visible view; equal keys mean equal pictures, None means no picture.

        ``at_rest`` is the key of the airway view without a simulated breathing; None without a breathing. A breathing
        moves only the airway view and does not end, so the other views do not wait for its end.
        """
        at_rest = keys.get(LEAD_VIEW) if at_rest is None else at_rest
        if at_rest != self._at_rest:
            self._at_rest, self._moved_s = at_rest, now_s
        for name, view in self._views.items():
            key = keys.get(name)
            if key != view.seen_key:
                if key is not None and (view.seen_key is not None or VIEWS[name].costly):
                    view.was_still = view.was_still or not view.is_moving(now_s)
                    view.changed_s = now_s
                view.seen_key = key

    def next_order(self, now_s: float) -> RenderOrder | None:
        """Return the order of the next picture, or None if no picture is due now."""
        ready = [n for n in self._turn if self._is_due(n, now_s) and self._held_until_s(n, now_s) <= now_s]
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
        """Return the time at which a picture can become due without an event; None if there is no such time.

        Such a time is the end of a movement, the start of the next period, or the loss of an unacknowledged picture.
        """
        times: list[float] = []
        for name, view in self._views.items():
            if view.seen_key is None:
                continue
            if self._has_new_content(view, now_s):
                sendable_s = now_s if self._may_send(name, now_s) else min(view.in_flight.values()) + LOST_AFTER_S
                times.append(max(sendable_s, self._held_until_s(name, now_s)))
            elif view.sent_grade < FULL:
                times.append(view.still_s)
        return min(times, default=None)

    def _held_until_s(self, name: str, now_s: float) -> float:
        """Return the time, in s of the clock, before which a view must wait so that the airway view has its rate."""
        airway = self._views.get(LEAD_VIEW)
        if airway is None or not airway.is_moving(now_s):
            return now_s
        if name == LEAD_VIEW:
            return max(self._due_s, now_s)
        expected_s = self._expected_s(name, now_s)
        only_breathes = now_s >= self._moved_s + STILL_AFTER_S
        is_long = expected_s > OVER * self._other_budget_s(now_s)
        if self._views[name].grade(now_s) > MOVING and is_long and not only_breathes:
            # A picture this long would be cancelled by every further movement.
            return airway.still_s
        waits_s = self._due_s - now_s if self._is_due(LEAD_VIEW, now_s) else 0.0
        # Without credit, another view is rendered only in the idle time before the next airway picture.
        return self._due_s if waits_s > 0.0 >= self._credit_s and expected_s > waits_s else now_s

    def rendered(
        self, order: RenderOrder, frame_id: int, seconds: float, now_s: float, *, rays_s: float | None = None
    ) -> bool:
        """Record a rendered picture and return whether it should be sent.

        A probe, and a picture of a view that is no longer visible, are not sent. ``seconds`` is the elapsed render
        time; ``rays_s`` is the processor time of the rays divided by the threads, or None if it was not measured.
        """
        view = self._views.get(order.view)
        self._update_time_credit(order, seconds)
        if view is None:
            return False
        pixels = order.full_width * order.full_height
        if order.purpose == "probe":
            # The real scale, which differs from the ordered one because no picture is smaller than 16 pixels.
            scale = math.sqrt(order.width * order.height / pixels)
            view.budget.learn_probe(scale, pixels, seconds, now_s, rays_s)
            return False
        if order.purpose == "picture":
            view.budget.learn(order.level, pixels, seconds, rays_s)
        if view.is_size_of(order):
            view.sent_key, view.sent_grade = order.key, order.grade
        view.in_flight[frame_id] = now_s
        return True

    def record_cancelled(self, order: RenderOrder, seconds: float) -> None:
        """Record that a picture was cancelled after ``seconds``; the scheduler orders it again if it is still due."""
        self._update_time_credit(order, seconds)

    def _update_time_credit(self, order: RenderOrder, seconds: float) -> None:
        if order.view != LEAD_VIEW:
            self._credit_s = max(-MAX_CREDIT_S, self._credit_s - seconds)
            return
        self._credit_s = min(MAX_CREDIT_S, self._credit_s + OTHERS_SHARE * seconds)
        if order.grade == MOVING:
            self._airway_s = seconds

    def failed(self, order: RenderOrder) -> None:
        """Record that a picture could not be rendered; it is not ordered again until its content changes."""
        view = self._views.get(order.view)
        if view is not None and view.is_size_of(order):
            view.sent_key, view.sent_grade = order.key, FULL

    def acknowledge(self, frame_id: int) -> None:
        """Record that the client has decoded a picture; unknown or lost frame ids are ignored."""
        for view in self._views.values():
            view.in_flight.pop(frame_id, None)

    def should_cancel(
        self, order: RenderOrder, keys: Mapping[str, Hashable], now_s: float, *, at_rest: Hashable = None
    ) -> bool:
        """Return whether the picture in progress should be cancelled, given the current content keys of the views.

        ``at_rest`` is the same as in :meth:`observe`.
        """
        if order.grade <= MOVING:
            # Moving pictures are never cancelled: during a continuous movement none would be finished.
            return False
        has_moved = (keys.get(LEAD_VIEW) if at_rest is None else at_rest) != self._at_rest
        if keys.get(order.view) != order.key or has_moved:
            return True
        # A long picture is also cancelled by a change in another view.
        others_wait = any(keys.get(name) != view.seen_key for name, view in self._views.items() if name != LEAD_VIEW)
        return others_wait and now_s - order.begun_s + self._expected_s(order.view, now_s) > LONG_S

    @property
    def visible(self) -> tuple[str, ...]:
        """Names of the visible views."""
        return tuple(self._views)

    @property
    def finding(self) -> bool:
        """Whether the viewfinder replaces the airway view while the airway view moves."""
        return LEAD_VIEW in self._views and self._views[LEAD_VIEW].budget.finding

    def num_in_flight(self, view: str) -> int:
        """Return the number of pictures of a view that were sent and not acknowledged."""
        return len(self._views[view].in_flight) if view in self._views else 0

    def _may_send(self, name: str, now_s: float) -> bool:
        in_flight = self._views[name].in_flight
        for frame_id in [n for n, sent_s in in_flight.items() if now_s >= sent_s + LOST_AFTER_S]:
            del in_flight[frame_id]
        return len(in_flight) < MAX_IN_FLIGHT.get(name, 1)

    def _has_new_content(self, view: _PacedView, now_s: float) -> bool:
        return view.sent_key != view.seen_key or view.grade(now_s) > view.sent_grade

    def _is_due(self, name: str, now_s: float) -> bool:
        view = self._views[name]
        return view.seen_key is not None and self._may_send(name, now_s) and self._has_new_content(view, now_s)

    def _expected_s(self, name: str, now_s: float) -> float:
        view = self._views[name]
        level = view.budget.level if view.grade(now_s) <= MOVING else 0
        return view.budget.predicted_s(level, view.pixels)

    def _do_others_move(self, now_s: float) -> bool:
        return any(now_s < v.changed_s + OTHERS_MOVE_S for name, v in self._views.items() if name != LEAD_VIEW)

    def _airway_budget_s(self, now_s: float) -> float:
        """Return the time budget in s of a moving airway picture; the other views get their share of each period."""
        return self._period_s * (GAP / (1.0 + OTHERS_SHARE) if self._do_others_move(now_s) else ALONE_FITS)

    def _other_budget_s(self, now_s: float) -> float:
        if LEAD_VIEW not in self._views or not self._views[LEAD_VIEW].is_moving(now_s):
            return OTHERS_TARGET_S
        # If the airway picture takes longer than a period, the share of the others grows with it.
        return max(self._period_s * OTHERS_SHARE / (1.0 + OTHERS_SHARE), self._airway_s * OTHERS_SHARE)

    def _airway_order(self, now_s: float) -> RenderOrder:
        view = self._views[LEAD_VIEW]
        if view.is_moving(now_s):
            gap_s = GAP * self._period_s
            # Start times follow a fixed grid, so that a delay is made up; two starts are at least gap_s / 2 apart.
            self._due_s = max(self._due_s + gap_s, now_s + gap_s / 2)
            if view.budget.probe_due(now_s):
                return self._scaled_order(LEAD_VIEW, now_s, view.budget.probe_scale(view.pixels), "probe")
        return self._order(LEAD_VIEW, now_s)

    def _order(self, name: str, now_s: float) -> RenderOrder:
        view = self._views[name]
        grade = view.grade(now_s)
        if grade == FINDER:
            return self._scaled_order(name, now_s, 1.0, "finder")
        if grade == MOVING:
            limit_s = self._airway_budget_s(now_s) if name == LEAD_VIEW else self._other_budget_s(now_s)
            level = view.budget.choose(limit_s, view.pixels, now_s, begins=view.was_still)
            view.was_still = False
        else:
            level = 0 if grade == FULL else view.budget.finest_within(LONG_S, view.pixels)
            view.was_still = True
        return self._scaled_order(name, now_s, view.budget.levels[level].scale, "picture", level=level)

    def _scaled_order(
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
