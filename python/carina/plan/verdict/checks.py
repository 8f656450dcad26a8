"""Checks of an instrument on a route without a simulated drive: width, bend, length, and tool in the channel.

Each check lists its data with their basis; a missing datum gives the answer *unknown*, never a default value.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from carina.display import one_line
from carina.plan.instruments.tools import Tool
from carina.plan.routes.ranking import BEND_SIGMA_DEG
from carina.plan.routes.route_width import SURE, Fit, RouteWidth
from carina.plan.verdict.drive_route import DriveWay
from carina.scopes import FIT_MARGIN_MM, ScopePreset

Answer = Literal["yes", "perhaps", "no", "unknown"]

ANSWERS: dict[Fit, Answer] = {"fits": "yes", "may fit": "perhaps", "does not fit": "no"}
"""Answer of the check of the diameter for the fit of a scope, which the table of routes states."""
LONGEST_ENTRY_MM = 250.0
"""Maximum distance in mm from the nose to the upper trachea in an adult (common knowledge)."""
LONGEST_TO_CARINA_MM = 320.0
"""Maximum distance in mm from the nose to the main carina in an adult (common knowledge)."""


@one_line
@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check of an instrument on a route."""

    name: Literal["diameter", "bend", "length", "channel", "drive", "pointing"]
    answer: Answer
    share: float | None
    """Probability of the answer *yes* within the errors; None if it cannot be computed."""
    words: str
    basis: str
    """Basis of the answer: data of the instrument with ``s`` (source) or ``k`` (common knowledge), and measurements."""


def diameter_check(width: RouteWidth, scope: ScopePreset, *, errors: bool) -> Check:
    """Return whether a scope is thinner than the narrowest place of a route.

    Parameters
    ----------
    width
        Narrowest diameter of the route.
    scope
        The instrument.
    errors
        Whether to consider the errors of measurement and instrument data.
    """
    if errors:
        needs, share, answer = scope.fit_mm, width.chance(scope), ANSWERS[width.fit(scope)]
        place, margin = width.place_words, f", and {FIT_MARGIN_MM:g} mm measured excess (s)"
    else:
        needs, margin = max(scope.tip_mm, scope.tube_mm or 0.0), ""
        share = passes(width.mm - needs, 0.0)
        answer = answer_of(share)
        place = f"the narrowest place, {width.origin.words(width.at_mm)}, is {width.mm:.1f} mm wide"
    words = f"needs {needs:.1f} mm; {place}" + ("" if width.why is None else f"; {width.why}")
    lumen = "diameter from sections of the CT" if width.source == "sections" else "largest ball in the lumen found"
    basis = f"tip {scope.tip_mm:g} mm ({_basis(scope)}){margin}; {lumen}"
    return Check("diameter", answer, share, words, basis)


def bend_check(way: DriveWay, scope: ScopePreset, *, errors: bool) -> Check:
    """Return whether the scope's bending section can bend as far as the route does within the section's length.

    Parameters
    ----------
    way
        The route.
    scope
        The instrument.
    errors
        Whether to consider the error of the angle.
    """
    if scope.flexion_deg is None or scope.bending_mm is None:
        words = "its flexion or bending section is not known"
        return Check("bend", "unknown", None, words, "flexion and bending section unknown")
    most = max(scope.flexion_deg)
    section = float(np.mean(scope.bending_mm)) + (scope.rigid_tip_mm or 0.0)
    worst, where = 0.0, 0.0
    for mm in np.arange(section, way.park_mm + 1e-6, 1.0):
        cosine = float(np.clip(way.direction(mm) @ way.direction(mm - section), -1.0, 1.0))
        asked = math.degrees(math.acos(cosine))
        if asked > worst:
            worst, where = asked, float(mm)
    share = passes(most - worst, BEND_SIGMA_DEG if errors else 0.0)
    radius = f" at a radius of {section / math.radians(worst):.0f} mm" if worst >= 10.0 else ""
    needs = f"the bend {way.position_words(where)} requires {worst:.0f} degrees of flexion{radius}"
    words = f"{needs}; this scope has {most:.0f}"
    basis = f"flexion {most:g} degrees, bending section {np.mean(scope.bending_mm):g} mm ({_basis(scope)})"
    return Check("bend", answer_of(share), share, words, basis)


def length_check(way: DriveWay, scope: ScopePreset, origin_depth_mm: float | None) -> Check:
    """Return whether the scope is long enough to reach the end of the route.

    Parameters
    ----------
    way
        The route.
    scope
        The instrument.
    origin_depth_mm
        Insertion depth at nose or mouth when the tip is at the origin of the route's distances (`PlannedRoute.origin`);
        None if it is not known.
    """
    basis = f"working length ({_basis(scope)})"
    if scope.length_mm is None:
        return Check("length", "unknown", None, "its working length is not known", basis)
    park_mm = way.from_origin_mm(way.park_mm)
    spare = scope.length_mm - park_mm
    if origin_depth_mm is None:
        at_origin = "the main carina" if way.origin.is_carina else "that start"
        longest_mm = LONGEST_TO_CARINA_MM if way.origin.is_carina else LONGEST_ENTRY_MM
        words = (
            f"the tip stops {way.origin.words(park_mm)}; a working length of {scope.length_mm:.0f} mm leaves "
            f"{spare:.0f} mm from nose or mouth to {at_origin}"
        )
        return Check("length", "yes" if spare >= longest_mm else "no" if spare < 0 else "perhaps", None, words, basis)
    left = spare - origin_depth_mm
    words = f"needs a working length of {park_mm + origin_depth_mm:.0f} mm; this scope has {scope.length_mm:.0f}"
    return Check("length", "yes" if left >= 0.0 else "no", None, words, basis)


def channel_check(scope: ScopePreset, tool: Tool) -> Check:
    """Return whether the tool slides through the scope's channel."""
    basis = f"channel ({_basis(scope)}), {tool.title} ({tool.basis})"
    if scope.channel_mm is None:
        return Check("channel", "unknown", None, "its working channel is not known", basis)
    words = f"{tool.title} has a diameter of {tool.outer_mm:g} mm; the working channel has {scope.channel_mm:g} mm"
    return Check("channel", "yes" if tool.passes(scope.channel_mm) else "no", None, words, basis)


def answer_of(share: float) -> Answer:
    """Return yes if the probability is at least SURE, no if it is at most 1 - SURE, else perhaps."""
    return "yes" if share >= SURE else "no" if share <= 1.0 - SURE else "perhaps"


def passes(spare: float, sigma: float) -> float:
    """Return the probability that a difference (available size less required size) is above 0.

    Parameters
    ----------
    spare
        The difference.
    sigma
        Standard deviation of its error; 0 for an exact difference.
    """
    if sigma <= 0.0:
        return 1.0 if spare >= 0.0 else 0.0
    return 0.5 * (1.0 + math.erf(spare / sigma / math.sqrt(2.0)))


def _basis(scope: ScopePreset) -> str:
    return scope.basis if len(scope.basis) == 1 else "partly s, partly k"
