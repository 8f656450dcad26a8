"""Check of a bend by simulated drives with a reduced lever range, if the comparison of angles is inconclusive.

`bend_check` compares the angle that a route requires with the largest angle of the lever. This comparison is stricter
than reality, because the airway's wall also bends a scope. If the comparison is inconclusive within the errors, drives
are simulated with a lever range that is smaller by the possible error. A scope that arrives with the reduced range also
arrives with the full range.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from carina.plan.routes.ranking import BEND_SIGMA_DEG
from carina.plan.verdict.checks import Check, answer_of
from carina.plan.verdict.drive import DrivenRoute
from carina.plan.verdict.drive_route import DriveWay
from carina.plan.verdict.drive_search import arrives_by, search_drive
from carina.scopes import ScopePreset, WallField

SHORTER = ((1.645, 0.95), (0.674, 0.85))
"""Reductions of the lever's range, in standard errors, each with the probability to report if a drive then arrives.

Each probability is the middle of the range between its reduction and the next one.
"""
AS_IT_IS = 0.62
"""Probability to report if a drive arrives with the full lever range but with no reduced range."""


def lever_check(
    way: DriveWay,
    wall: WallField,
    scope: ScopePreset,
    figures: Check,
    driven: DrivenRoute,
    *,
    effort: float,
    cancel: Callable[[], bool] | None = None,
) -> Check:
    """Return the check of a bend, decided by simulated drives if the comparison of angles leaves it open.

    Parameters
    ----------
    way, wall, scope
        The route, the wall of the airways, and the instrument that was driven.
    figures
        Result of `bend_check`.
    driven
        Drive with the full lever. If it did not arrive, or ``figures`` is not *perhaps*, ``figures`` is returned.
    effort, cancel
        Limit and cancellation of each search, as for `search_drive`.

    Raises
    ------
    CancelledError
        If ``cancel()`` returned True.
    """
    if figures.answer != "perhaps" or not driven.arrived or scope.flexion_deg is None:
        return figures
    share, found = AS_IT_IS, "no drive was found"
    less_deg = SHORTER[-1][0] * BEND_SIGMA_DEG
    for sigmas, probability in SHORTER:
        shorter_deg = sigmas * BEND_SIGMA_DEG
        up_deg, down_deg = (max(deg - shorter_deg, 1.0) for deg in scope.flexion_deg)
        shorter = replace(scope, flexion_deg=(up_deg, down_deg))
        if arrives_by(way, wall, shorter, driven.moves) or (
            search_drive(way, wall, shorter, effort=effort, cancel=cancel).arrived
        ):
            share, found, less_deg = probability, "the drive still arrives", shorter_deg
            break
    words = f"{figures.words}; with {less_deg:.0f} degrees less flexion, {found}"
    basis = f"{figures.basis}; the scope's mechanics in the airways' wall (k)"
    return replace(figures, answer=answer_of(share), share=share, words=words, basis=basis)
