"""Targets as things with a size, and how the way to them is planned."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import Identifier, OwnName
from carina.commands.value import Command, FrozenValue
from carina.value import TEXT

TargetNote = Annotated[str, Meta(max_length=2000, pattern=TEXT)]

TargetRank = Annotated[int, Meta(ge=1, le=9)]


class PlanOptions(FrozenValue, frozen=True):
    """With what a target is to be reached, and what counts against a route."""

    scope: Identifier = "thin"
    """Of the library of instruments."""
    tool: Identifier = "needle-21g"
    vessel_margin_mm: Annotated[float, Meta(ge=0.0, le=50.0)] = 3.0
    """A vessel nearer to the needle than this counts against a route."""
    moved_mm: Annotated[float, Meta(ge=0.0, le=60.0)] | None = None
    """How far the target may have moved since the CT; null goes by the lobe."""
    entry_mm: Annotated[float, Meta(ge=0.0, le=500.0)] | None = None
    """From nose or mouth to where the tree begins; null leaves depths and working lengths open."""


class SetPlanOptions(PlanOptions, Command, frozen=True, kw_only=True):
    """Plan the way to a target anew."""

    target_id: Identifier


class DescribeTarget(Command, frozen=True):
    """Name a target, and say something about it."""

    target_id: Identifier
    called: OwnName
    remark: TargetNote = ""
    rank: TargetRank = 1
    """1 comes first."""


class ChoosePlannedRoute(Command, frozen=True):
    """Take one of the routes that were planned to a target: the flight leads to where the scope stands there."""

    target_id: Identifier
    number: Annotated[int, Meta(ge=1, le=100)] = 1
    """1 is the best."""
