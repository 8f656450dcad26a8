"""Contact sheet of all forks of a route, for the window and the command line."""

from __future__ import annotations

from collections.abc import Callable

from carina import plan
from carina.case.routes import ChosenRoute
from carina.commands.tree import PathCost
from carina.display.png import png_bytes
from carina.errors import NoResultError
from carina.plan.turns.contact_sheet import contact_sheet
from carina.plan.turns.fork_view import Operator
from carina.plan.turns.from_route import branch_turns
from carina.render import Renderer
from carina.track import Airways
from carina.volume import Volume, badges_of

SIDE_PX = 384
"""Width and height in pixels of each picture of a contact sheet."""
TURNS_SHARE = 0.3
"""Share of the progress bar for the search of the forks' openings; the rendering of the pictures takes the rest."""

NOT_IN_AIRWAYS = "this path was not searched in the airways; forks are shown for routes in the lumen"


def check_forks(route: ChosenRoute, cost: PathCost) -> None:
    """Raise an error if a route has no contact sheet.

    Parameters
    ----------
    route
        The route.
    cost
        Edge cost by which the path of the route was searched. The turns come from the airway tree, so they do not
        describe a path that was searched with another cost than ``lumen``.

    Raises
    ------
    NoResultError
        ``plan.no-forks``: if the route passes no fork, or was not searched in the airways.
    """
    if cost != "lumen":
        raise NoResultError(NOT_IN_AIRWAYS, code="plan.no-forks")
    if not route.spans or not route.forks_mm:
        raise NoResultError("this route passes no fork, so there is nothing to show", code="plan.no-forks")


def fork_sheet_png(
    volume: Volume,
    airways: Airways,
    route: ChosenRoute,
    *,
    cost: PathCost,
    operator: Operator = "head",
    progress: Callable[[str, float | None], None] | None = None,
    cancel: Callable[[], bool] | None = None,
) -> bytes:
    """Return the PNG of the contact sheet of a route.

    Parameters
    ----------
    volume, airways
        The CT and its airways, with all edits.
    route
        The route.
    cost
        Edge cost by which the path of the route was searched.
    operator
        Position of the operator, for clock hours and the orientation of the pictures.
    progress
        ``f(what, fraction)``.
    cancel
        Called often; the work stops when it returns True.

    Raises
    ------
    NoResultError
        ``plan.no-forks``: if the route passes no fork, or was not searched in the airways.
    CancelledError
        If ``cancel()`` returned True.
    """
    check_forks(route, cost)
    if progress is not None:
        progress("finding the openings", 0.0)
    renderer = Renderer(volume)
    renderer.set_lumen(airways.lumen_zyx)
    turns = branch_turns(
        airways.tree, route.spans[-1].branch_id, plan.distance_origin(volume, airways), renderer=renderer
    )

    def rendering(what: str, fraction: float | None) -> None:
        if progress is not None:
            progress(what, TURNS_SHARE + (1.0 - TURNS_SHARE) * (fraction or 0.0))

    pictures = plan.turn_pictures(
        volume,
        airways,
        turns,
        operator=operator,
        size_px=SIDE_PX,
        renderer=renderer,
        progress=rendering,
        cancel=cancel,
    )
    badges = dict.fromkeys((*badges_of(volume), *getattr(airways, "badges", ())))
    notes = [*turns.notes, *(badge.words for badge in badges)]
    return png_bytes(contact_sheet(pictures, title=f"All forks on the route to {route.title}", notes=notes), {})
