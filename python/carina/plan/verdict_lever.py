"""How surely a scope bends round what figures leave open: its drive, once more with less lever.

The angle that a route asks is compared with the lever's by figures (`bend_check`). Where the errors leave that open,
the figures are stricter than the airway: its wall bends a scope as well. So the drive is asked, with a lever shorter by
what the error may come to. What arrives with the shorter one arrives with the longer, as far as a search can tell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from carina.plan.drive import DrivenRoute
from carina.plan.drive_search import arrives_by, search_drive
from carina.plan.drive_way import DriveWay
from carina.plan.verdict_checks import BEND_SIGMA_DEG, Check, answer_of
from carina.scopes import ScopePreset, WallField

__all__ = ["lever_check"]

SHORTER = ((1.645, 0.95), (0.674, 0.85))
"""Standard errors that the lever is shortened by, and the share told where a drive arrives so: the middle of what is
left between this and the next."""
AS_IT_IS = 0.62
"""Told where a drive arrives with the whole lever alone."""


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
    """What figures tell of a bend, settled by drives where they leave it open.

    Parameters
    ----------
    way, wall, scope
        The route, the airways' wall, the instrument as it was driven.
    figures
        What `bend_check` found.
    driven
        The drive with the whole lever. Where it did not arrive, or the figures are sure, they stay what they are.
    effort, cancel
        Of each search, as in `search_drive`.

    Raises
    ------
    CancelledError
        If ``cancel()`` said so.
    """
    if figures.answer != "perhaps" or not driven.arrived or scope.flexion_deg is None:
        return figures
    share, found = AS_IT_IS, "no drive was found"
    less_deg = SHORTER[-1][0] * BEND_SIGMA_DEG
    for sigmas, told in SHORTER:
        shorter_deg = sigmas * BEND_SIGMA_DEG
        up_deg, down_deg = (max(deg - shorter_deg, 1.0) for deg in scope.flexion_deg)
        shorter = replace(scope, flexion_deg=(up_deg, down_deg))
        if arrives_by(way, wall, shorter, driven.moves) or (
            search_drive(way, wall, shorter, effort=effort, cancel=cancel).arrived
        ):
            share, found, less_deg = told, "the drive still arrives", shorter_deg
            break
    words = f"{figures.words}; with {less_deg:.0f} degrees less flexion, {found}"
    basis = f"{figures.basis}; the scope's mechanics in the airways' wall (k)"
    return replace(figures, answer=answer_of(share), share=share, words=words, basis=basis)
