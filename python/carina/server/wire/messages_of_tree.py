"""What the server sends about the airway tree: branches, names, measures, and the way to the cursor."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.commands.fields import BranchId, Count, MaybeNumbers, Numbers, Part, PointLps, PointsLps, Words
from carina.commands.value import FrozenValue
from carina.server.wire.codec import ServerMessage
from carina.server.wire.messages_from_client import BranchQuestion
from carina.track import Uncertainty


class TreeBranch(FrozenValue, frozen=True, forbid_unknown_fields=False):
    """A branch of a ``carina-tree`` document."""

    id: BranchId
    parent: BranchId | None
    children: tuple[BranchId, ...]
    generation: Annotated[int, Meta(ge=0, le=1000)]
    name: Words | None
    kind: Literal["tracked", "bridge", "manual"]
    points: PointsLps
    radius: Numbers
    cost: float | None
    confidence: Part | None
    """How sure it is that this is airway."""
    name_confidence: Part | None
    """How sure the name is; null without one, and for a person's."""
    name_from: Literal["anatomy", "person"] | None
    variant: Words | None
    """What is uncommon about the anatomy here."""
    doubtful_mm: float
    """Length along which the CT shows no wall; above 0 in branches of kind ``manual``, drawn by hand."""


class TreeDocument(FrozenValue, frozen=True, forbid_unknown_fields=False):
    """A ``carina-tree`` document, version 1."""

    format: Literal["carina-tree"]
    version: Literal[1]
    space: Literal["LPS"]
    unit: Literal["mm"]
    root: BranchId
    branches: tuple[TreeBranch, ...]


class BranchMeasures(FrozenValue, frozen=True):
    """What was measured on a branch, without its junctions. Lumens are diameters; errors hold in 95 of 100 cases."""

    branch_id: BranchId
    length_mm: float
    by_earlier_method: bool
    """An earlier version measured the branch, by a method that reads small airways too wide."""
    lumen_mm: float | None
    """Median."""
    lumen_error_mm: float | None
    min_lumen_mm: float | None
    """At its narrowest place."""
    min_lumen_error_mm: float | None
    min_at_mm: float | None
    """Along the branch."""
    max_lumen_mm: float | None
    max_lumen_error_mm: float | None
    wall_mm: float | None
    wall_error_mm: float | None
    taper: float | None
    """Change of the lumen per mm of way: below 0 where the branch narrows."""
    angle_deg: float | None
    """To the parent's direction."""
    stenosis_percent: float | None
    """Of the diameter that would be healthy there: 100 is closed. Null where it does not exceed its error."""
    stenosis_error_percent: float | None
    stenosis_at_mm: float | None


class BranchTitle(FrozenValue, frozen=True):
    """What a branch is called in full, and the lobe that it leads to."""

    branch_id: BranchId
    long: Words | None
    lobe: Literal["RUL", "RML", "RLL", "LUL", "LML", "LLL"] | None


class UncertainPlace(Uncertainty, frozen=True, kw_only=True):
    """A place where the automatic airways stop short, with its text."""

    statement: Words
    """What is seen at the place, as the command line, reports and exports state it."""
    explanation: Words | None
    """Possible reasons; the same for all places of one kind, and null where the CT gives none."""


class AbsentAirway(FrozenValue, frozen=True):
    """A lobe or a segment of which no named bronchus was found."""

    name: Words
    """Short and long name, such as RB4 (lateral segment, RML)."""
    reason: Words
    """What the CT shows in its place, as the command line, reports and exports state it."""
    lps: PointLps | None
    """Place where the airway ends, or where the tree should go on to it; null where no place is known."""


class Tree(ServerMessage, frozen=True):
    """The airway tree, when it or its measures changed."""

    tree: TreeDocument | None
    titles: tuple[BranchTitle, ...]
    """Of the branches that have any."""
    measures: tuple[BranchMeasures, ...] | None
    """Null until they are ready."""
    uncertain: tuple[UncertainPlace, ...]
    """What could not be followed, the widest first; what holds for the whole tree last."""
    absent: tuple[AbsentAirway, ...]
    """Lobes and segments that were not found, the right lung first."""


class LivePath(ServerMessage, frozen=True):
    """Answer to ``live_path``: the way from the root to the place under the cursor, or why there is none."""

    request_id: Count
    lps: PointLps | None
    """Where it ends: the point that was asked for, or the lumen in front of the wall; null where there is nothing."""
    points_lps: PointsLps
    """Root to end; empty where there is no path."""
    length_mm: float | None
    min_diameter_mm: float | None
    """Of the lumen along it."""
    confidence: Part | None
    snapped_mm: float | None
    """How far the point was from the lumen."""
    new_mm: float | None
    """Its length outside the present tree."""
    joins_branch_id: BranchId | None
    problem: Words | None


class BranchProfile(FrozenValue, frozen=True):
    """Sections across a branch, from its beginning to its end: parallel lists; null where nothing could be measured."""

    at_mm: Numbers
    lumen_mm: MaybeNumbers
    """Diameter of the circle of the same area."""
    lumen_error_mm: MaybeNumbers
    min_mm: MaybeNumbers
    """Smallest diameter."""
    max_mm: MaybeNumbers
    wall_mm: MaybeNumbers
    at_junction: tuple[bool, ...]
    """The section cuts a fork, or the edge of the scan: what is measured there is no airway's width."""


class BranchDetail(BranchQuestion, ServerMessage, frozen=True):
    """Answer to ``branch_detail``; profile and measures are null until they are ready."""

    measures: BranchMeasures | None
    profile: BranchProfile | None
