"""Complete report of a plan, with the list of turns of its route and their pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from carina.display import one_line
from carina.display.progress import Progress, ProgressChoice, progress_function, shows_progress
from carina.plan.carm import CArmAngles, carm_angles
from carina.plan.report.plan_sheet import PlanSheet, make_sheet
from carina.plan.routes.plan_route import Plan
from carina.plan.turns.clips import TurnClip, turn_clips
from carina.plan.turns.fork_view import Operator
from carina.plan.turns.from_route import turn_list
from carina.plan.turns.pictures import TurnPicture, turn_pictures
from carina.plan.turns.turn_list import TurnList
from carina.plan.verdict.verdict import Verdict
from carina.render import Renderer
from carina.scopes import WallField
from carina.track import Airways
from carina.volume import Volume

PICTURES_SHARE, CLIPS_SHARE = 0.35, 0.35
"""Shares of the report's progress that the pictures, and the clips, of turns take."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PlanMaterials:
    """Inputs of a report: the CT, its airways, the plan and options."""

    volume: Volume
    airways: Airways
    wall: WallField
    plan: Plan
    route_number: int = 1
    """Number of the route that is described in detail, from 1."""
    verdicts: tuple[Verdict, ...] = ()
    """Verdicts of instruments on the route ``route_number``."""
    operator: Operator = "head"
    carina_depth_mm: float | None = None
    """Depth of the main carina at nose or mouth in mm, as measured by the user."""
    notes: tuple[str, ...] = ()
    turns: TurnList | None = None
    """Turns of the route ``route_number`` (`route_turns`); computed for the report if None."""
    carm: CArmAngles | None = None
    """Positions of a C-arm for the route ``route_number``; computed for the report if None."""


def route_turns(materials: PlanMaterials, renderer: Renderer | None = None) -> TurnList | None:
    """Return the turns of the route that a report describes, with the hand moves of the planned scope's drive.

    Parameters
    ----------
    materials
        CT, airways and plan.
    renderer
        Renderer of the CT, with the airways' lumen; created if None.

    Returns
    -------
    TurnList | None
        The turns; None if the plan has no route.
    """
    made, plan = materials, materials.plan
    if not plan.routes or made.turns is not None:
        return made.turns
    driven = next((v.driven for v in made.verdicts if v.scope.name == plan.scope.name), None)
    return turn_list(
        made.airways.tree,
        plan.routes[made.route_number - 1],
        moves=None if driven is None else driven.moves,
        ends_along_mm=None if driven is None else driven.ends_along_mm,
        carina_depth_mm=made.carina_depth_mm,
        renderer=lumen_renderer(made) if renderer is None else renderer,
    )


def lumen_renderer(materials: PlanMaterials) -> Renderer:
    """Return a renderer of the CT with the lumen of the airways."""
    renderer = Renderer(materials.volume)
    renderer.set_lumen(materials.airways.lumen_zyx)
    return renderer


@shows_progress
def whole_sheet(
    materials: PlanMaterials,
    *,
    patient: str | None = None,
    clips: bool = False,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> PlanSheet:
    """Return the contents of a report, with the list of turns of its route and a picture of each turn.

    Parameters
    ----------
    materials
        CT, airways and plan.
    patient
        Name or number to be printed; none if None.
    clips
        Whether to render a short clip of the flight to each turn, which only the HTML page plays.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    PlanSheet
        Contents for `write_report`.

    Raises
    ------
    CancelledError
        If ``cancel()`` returned True.
    """
    made, plan = materials, materials.plan
    turns: TurnList | None = None
    pictures: tuple[TurnPicture, ...] = ()
    stretches: tuple[TurnClip | None, ...] = ()
    done = 0.0

    report = progress_function(progress)

    def part(share: float) -> Progress | None:
        """Return the progress function of the next part of the work; ``share`` is its share of the whole."""
        nonlocal done
        before, done = done, done + share
        if report is None:
            return None
        return lambda what, fraction: report(what, before + (fraction or 0.0) * share)

    if plan.routes:
        route = plan.routes[made.route_number - 1]
        renderer = lumen_renderer(made)
        turns = route_turns(made, renderer)
        assert turns is not None
        pictures = turn_pictures(
            made.volume,
            made.airways,
            turns,
            operator=made.operator,
            renderer=renderer,
            progress=part(PICTURES_SHARE),
            cancel=cancel,
        )
        if clips:
            # The renderer's maps save time only if hundreds of pictures are rendered.
            renderer.prepare()
            stretches = turn_clips(
                made.volume,
                made.airways,
                route,
                turns,
                operator=made.operator,
                renderer=renderer,
                progress=part(CLIPS_SHARE),
                cancel=cancel,
            )
    carm = made.carm
    if carm is None and plan.routes:
        carm = carm_angles(made.volume, made.airways, plan, route_number=made.route_number, cancel=cancel)
    return make_sheet(
        made.volume,
        made.airways,
        plan,
        route_number=made.route_number,
        verdicts=made.verdicts,
        turns=turns,
        turn_pictures=pictures,
        turn_clips=stretches,
        notes=made.notes,
        patient=patient,
        operator=made.operator,
        wall=made.wall,
        carm=carm,
        progress=part(1.0 - done),
        cancel=cancel,
    )
