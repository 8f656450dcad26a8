"""What the server sends about the airway tree: branches, names, measures, and the way to the cursor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from carina.server.wire_codec import Range
from carina.server.wire_fields import BranchId, Count, MaybeNumbers, Numbers, Part, PointLps, PointsLps, Words

__all__ = [
    "BranchDetail",
    "BranchMeasures",
    "BranchProfile",
    "BranchTitle",
    "LivePath",
    "Tree",
    "TreeBranch",
    "TreeDocument",
    "UncertainPlace",
]


@dataclass(frozen=True, slots=True)
class TreeBranch:
    """A branch of a ``carina-tree`` document."""

    extra_keys_allowed: ClassVar[bool] = True
    id: BranchId
    parent: BranchId | None
    children: tuple[BranchId, ...]
    generation: Annotated[int, Range(0, 1000)]
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


@dataclass(frozen=True, slots=True)
class TreeDocument:
    """A ``carina-tree`` document, version 1."""

    extra_keys_allowed: ClassVar[bool] = True
    format: Literal["carina-tree"]
    version: Literal[1]
    space: Literal["LPS"]
    unit: Literal["mm"]
    root: BranchId
    branches: tuple[TreeBranch, ...]


@dataclass(frozen=True, slots=True)
class BranchMeasures:
    """What was measured on a branch, without its junctions. Lumens are diameters; errors hold in 95 of 100 cases."""

    branch_id: BranchId
    length_mm: float
    lumen_mm: float | None
    """Mean."""
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
    """Of the diameter that would be healthy there: 0 is healthy, 100 closed."""
    stenosis_error_percent: float | None
    stenosis_at_mm: float | None


@dataclass(frozen=True, slots=True)
class BranchTitle:
    """What a branch is called in full, and the lobe that it leads to."""

    branch_id: BranchId
    long: Words | None
    lobe: Literal["RUL", "RML", "RLL", "LUL", "LML", "LLL"] | None


@dataclass(frozen=True, slots=True)
class UncertainPlace:
    """What could not be followed."""

    lps: PointLps
    words: Words
    branch_id: BranchId | None


@dataclass(frozen=True, slots=True)
class Tree:
    """The airway tree, when it or its measures changed."""

    wire_type: ClassVar[str] = "tree"
    tree: TreeDocument | None
    titles: tuple[BranchTitle, ...]
    """Of the branches that have any."""
    measures: tuple[BranchMeasures, ...] | None
    """Null until they are ready."""
    uncertain: tuple[UncertainPlace, ...]


@dataclass(frozen=True, slots=True)
class LivePath:
    """Answer to ``live_path``: the way from the root to the place under the cursor, or why there is none."""

    wire_type: ClassVar[str] = "live_path"
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


@dataclass(frozen=True, slots=True)
class BranchProfile:
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


@dataclass(frozen=True, slots=True)
class BranchDetail:
    """Answer to ``branch_detail``; profile and measures are null until they are ready."""

    wire_type: ClassVar[str] = "branch_detail"
    request_id: Count
    branch_id: BranchId
    measures: BranchMeasures | None
    profile: BranchProfile | None
