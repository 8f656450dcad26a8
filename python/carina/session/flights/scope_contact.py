"""Scope in the lumen: a job computes the airway wall, and the scope is then inserted along the route."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carina import commands as c
from carina.errors import NoResultError
from carina.navigate.moves import LayScope
from carina.scopes import DEFAULT_SCOPE
from carina.session.command_registry import CommandHandlers
from carina.session.open_case.open_case import OpenCase, as_point
from carina.session.state.snapshot import UserMessage

if TYPE_CHECKING:
    from carina.track import Airways


class ScopeContactHandlers(CommandHandlers):
    """Handlers that place the scope along the route, constrained by the airway wall, in mode *scope*."""

    def enter(self, case: OpenCase) -> None:
        """Start the job that computes the airway wall, and lay the scope along the route when the wall is available."""
        airways, route = case.document.airways, case.document.route
        if airways is None or route is None:
            msg = "a scope needs a route: wait for the airways, then choose a branch or a target"
            raise NoResultError(msg, code="navigate.no-path")
        with self.core.lock:
            # A request by the user also repeats a job that was stopped before.
            case.wall.again()
            case.wall.want(airways, then=lambda _: self._lay_if_same_airways(case, airways))

    def resume(self, case: OpenCase) -> None:
        """Restore the scope that was in the lumen when the case was closed, once the wall is computed."""

        def lay(_wall: object) -> None:
            pending, case.scope.pending = case.scope.pending, None
            if pending is not None and self.core.case is case and pending.is_due(case):
                scope = pending.scope
                self.lay(case, scope.insertion_mm)
                case.navigator.hold_scope(scope.insertion_mm, scope.roll_rad, scope.flexion_rad)
                self.core.moved()
                self.core.changed("state", "pose", "views")

        with self.core.lock:
            if case.scope.pending is not None:
                case.wall.want(case.scope.pending.airways, then=lay)

    def _lay_if_same_airways(self, case: OpenCase, airways: Airways) -> None:
        """Lay the scope along the route if the document still has the airways of the wall.

        The caller holds the lock.
        """
        if case.document.airways is airways:
            self.lay(case)

    def lay(self, case: OpenCase, insertion_mm: float | None = None) -> None:
        """Place the scope along the route at the position of the tip, or at the nearest position on the route."""
        route, wall = case.document.route, case.wall.of(case.document.airways)
        if route is None or wall is None:
            return
        case.pilot.wall, case.pilot.wall_made_from = wall.field, wall.made_from
        if insertion_mm is None:
            insertion_mm = case.navigator.path_mm
        if insertion_mm is None:
            insertion_mm = route.path.nearest_mm(case.navigator.pose.position_lps)
        name = case.document.look.scope or DEFAULT_SCOPE
        points = tuple(as_point(point) for point in route.points_lps)
        self.core.fly(LayScope(name, points, float(insertion_mm)))
        case.scope.inserted = name

    def follow(self, case: OpenCase) -> None:
        """Lay the scope again after a change of the instrument; switch to free movement after a change of the lumen."""
        state = case.navigator.scope_state
        if state is None:
            return
        if case.wall.of(case.document.airways) is None:
            self.core.fly(c.SetMode("free"))
            self.core.emit(UserMessage("the airways have changed: reinsert the scope to use the updated airways"))
        elif (case.document.look.scope or DEFAULT_SCOPE) != case.scope.inserted:
            self.lay(case, state.insertion_mm)
