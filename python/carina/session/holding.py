"""A scope in the lumen: its wall, measured by a job, and how it is laid along the route."""

from __future__ import annotations

import math
from typing import Any

from carina import commands as c
from carina.errors import NoResultError
from carina.navigate.moves import LayScope
from carina.scopes import DEFAULT_SCOPE, ForceLaw, WallField, local_contact, scope_preset
from carina.session.case import OpenCase, as_point
from carina.session.jobs import Job
from carina.session.snapshot import NearWall, Said
from carina.session.subject import Subject, answers
from carina.track import edits_to_json

__all__ = ["ScopeHolding"]


class ScopeHolding(Subject):
    """What holds the scope in mode *scope*, and what a hand feels of it."""

    def enter(self, case: OpenCase) -> None:
        """Lay the scope along the route once the wall is known."""
        airways, route = case.document.airways, case.document.route
        if airways is None or route is None:
            msg = "a scope is laid along a route: wait for the airways and choose a branch or a target"
            raise NoResultError(msg, code="navigate.no-path")
        if case.wall_of is airways:
            self.lay(case)
            return
        with self.core.lock:
            case.lays_scope = True
            self._find_wall(case)

    def _find_wall(self, case: OpenCase) -> None:
        """Start the job that measures the wall, unless it runs; with the session locked."""
        airways = case.document.airways
        if airways is None or case.walling_of is airways:
            return

        def work(job: Job) -> None:
            try:
                wall = self.core.parts.wall_field(case.info.volume, airways, progress=job.progress, cancel=job.cancel)
                made_from = _made_from(wall, airways)
                with self.core.lock:
                    job.check()
                    case.pilot.wall, case.wall_of = wall, airways
                    case.pilot.wall_made_from = made_from
                    if self.core.case is case and case.document.airways is airways and case.lays_scope:
                        self.lay(case)
            except BaseException:
                with self.core.lock:
                    # A job that a newer one replaced was stopped by nobody.
                    if case.walling_job == job.job_id:
                        case.unwalled = airways
                raise
            finally:
                with self.core.lock:
                    if case.walling_job == job.job_id:
                        case.walling_of, case.lays_scope = None, False

        case.walling_of = airways
        case.walling_job = self.core.jobs.start("scope", "finding the wall that holds the scope", work)

    def want_wall_again(self) -> None:
        """Forget that measuring the wall was stopped: whoever asks for it now may start it."""
        with self.core.lock:
            if self.core.case is not None:
                self.core.case.unwalled = None

    @answers(c.WallNear)
    def wall_near(self, question: c.WallNear) -> NearWall:
        """As a plane; the first question starts measuring it."""
        lps = question.lps
        with self.core.lock:
            case = self.core.case
            airways = None if case is None else case.document.airways
            if case is None or airways is None:
                return NearWall("none")
            wall = case.pilot.wall
            if case.wall_of is not airways or wall is None:
                if case.unwalled is airways:
                    return NearWall("none")
                self._find_wall(case)
                return NearWall("finding")
            at = as_point(case.navigator.pose.position_lps) if lps is None else lps
            tip_mm = scope_preset(case.document.look.scope or DEFAULT_SCOPE).tip_mm
        return NearWall("ready", at, local_contact(wall, at, ForceLaw(tip_radius_mm=tip_mm / 2.0)))

    def lay(self, case: OpenCase, insertion_mm: float | None = None) -> None:
        """Along the route, to where the tip is, or the place of the route that is nearest to it."""
        route = case.document.route
        if route is None:
            return
        if insertion_mm is None:
            insertion_mm = case.navigator.path_mm
        if insertion_mm is None:
            insertion_mm = route.path.nearest_mm(case.navigator.pose.position_lps)
        name = case.document.look.scope or DEFAULT_SCOPE
        points = tuple(as_point(point) for point in route.points_lps)
        self.core.fly(LayScope(name, points, float(insertion_mm)))
        case.laid_scope = name

    def follow(self, case: OpenCase) -> None:
        """After a change of the document: another scope is laid where the old one was; another lumen ends it."""
        state = case.navigator.scope_state
        if state is None:
            return
        if case.wall_of is not case.document.airways:
            self.core.fly(c.SetMode("free"))
            self.core.emit(Said("the airways have changed: hold the scope again to feel the new wall"))
        elif (case.document.look.scope or DEFAULT_SCOPE) != case.laid_scope:
            self.lay(case, state.insertion_mm)


def _made_from(wall: WallField, airways: Any) -> dict[str, Any]:
    """What a replay makes a wall from again: search, edits, and how to tell that it is the same."""
    found = getattr(airways, "base", None) or airways
    edits = getattr(airways, "edits", ())
    return {
        "digest": wall.digest(),
        "root_lps": [float(v) for v in found.root_lps],
        "lumen_threshold": float(getattr(found, "threshold", math.nan)) if _has_threshold(found) else None,
        "edits": edits_to_json(edits) if edits else None,
    }


def _has_threshold(airways: Any) -> bool:
    return math.isfinite(float(getattr(airways, "threshold", math.nan)))
