"""Messages from the server about the airway tree: branches, names, measurements, and the path to the cursor."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

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
    """Confidence that the branch is an airway, 0 to 1."""
    name_confidence: Part | None
    """Confidence that the name is correct, 0 to 1; null without a name, and for a name that the user gave."""
    name_from: Literal["anatomy", "person"] | None
    """Origin of the name: the automatic naming (*anatomy*) or the user (*person*); null without a name."""
    variant: Words | None
    """Anatomical variant of the branch; null if there is none."""
    doubtful_mm: float
    """Length in mm without a wall in the CT; above 0 only in branches of kind ``manual``, which the user drew."""


class TreeDocument(FrozenValue, frozen=True, forbid_unknown_fields=False):
    """A ``carina-tree`` document, version 1."""

    format: Literal["carina-tree"]
    version: Literal[1]
    space: Literal["LPS"]
    unit: Literal["mm"]
    root: BranchId
    branches: tuple[TreeBranch, ...]


class BranchMeasuresSummary(FrozenValue, frozen=True):
    """Measurements of a branch without its junctions.

    Lumens are diameters in mm. The true value differs by at most the error in 95 of 100 cases.
    """

    wire_name: ClassVar[str] = "BranchMeasures"

    branch_id: BranchId
    length_mm: float
    by_earlier_method: bool
    """Whether an earlier version measured the branch, with a method that overestimates small diameters."""
    lumen_mm: float | None
    """Median of the diameters that were measured along the branch, mm; null if the lumen could not be measured."""
    lumen_error_mm: float | None
    min_lumen_mm: float | None
    """Diameter of the lumen at the branch's narrowest position, mm; null if it could not be measured."""
    min_lumen_error_mm: float | None
    min_at_mm: float | None
    """Narrowest position, in mm along the branch."""
    max_lumen_mm: float | None
    max_lumen_error_mm: float | None
    wall_mm: float | None
    wall_error_mm: float | None
    taper: float | None
    """Change of the lumen's diameter in mm per mm along the branch; below 0 if the branch narrows."""
    angle_deg: float | None
    """Angle in degrees to the direction of the parent."""
    stenosis_percent: float | None
    """Narrowing in percent of the expected healthy diameter (100: closed); null if it does not exceed its error."""
    stenosis_error_percent: float | None
    stenosis_at_mm: float | None
    """Position of the stenosis, in mm along the branch."""


class BranchTitle(FrozenValue, frozen=True):
    """The long name of a branch, and the lobe that the branch supplies."""

    branch_id: BranchId
    long: Words | None
    lobe: Literal["RUL", "RML", "RLL", "LUL", "LML", "LLL"] | None


class UncertainPlace(Uncertainty, frozen=True, kw_only=True):
    """A place where the automatic airways end too early, with its description."""

    statement: Words
    """Description of the findings at the place; the command line, reports and exports use the same text."""
    explanation: Words | None
    """Possible reasons, the same for all places of one kind; null if the CT gives none."""


class AbsentAirway(FrozenValue, frozen=True):
    """A lobe or a segment without a named bronchus in the tree."""

    name: Words
    """Short and long name, such as RB4 (lateral segment, RML)."""
    reason: Words
    """Description of the findings of the CT there; the command line, reports and exports use the same text."""
    lps: PointLps | None
    """Point where the airway ends, or where the tree should continue to it; null if no such point is known."""


class Tree(ServerMessage, frozen=True):
    """The airway tree and its measurements; sent after each change."""

    tree: TreeDocument | None
    titles: tuple[BranchTitle, ...]
    """Long names and lobes of the branches that have them."""
    measures: tuple[BranchMeasuresSummary, ...] | None
    """Measurements of the branches; null until they are computed."""
    uncertain: tuple[UncertainPlace, ...]
    """Places where an airway could not be followed, the widest first; entries about the whole tree are last."""
    absent: tuple[AbsentAirway, ...]
    """Lobes and segments without a named bronchus, the right lung first."""


class LivePathMessage(ServerMessage, frozen=True):
    """Answer to ``live_path``: the path from the root to the point under the cursor, or a reason for its absence."""

    request_id: Count
    lps: PointLps | None
    """End of the path: the requested point, or a point in the lumen in front of the wall; null if there is none."""
    points_lps: PointsLps
    """Points of the path from the root to the end; empty if there is no path."""
    length_mm: float | None
    min_diameter_mm: float | None
    """Smallest diameter in mm of the lumen along the requested path."""
    confidence: Part | None
    snapped_mm: float | None
    """Distance in mm of the requested point from the lumen."""
    new_mm: float | None
    """Length in mm of the part of the path outside the present tree."""
    joins_branch_id: BranchId | None
    """Branch of the present tree at which this part begins."""
    problem: Words | None
    """Reason why there is no path; null if there is one."""
    from_carina_mm: float | None = None
    """Distance in mm of the end from the main carina along the centrelines; null if the path does not pass it."""


class BranchProfile(FrozenValue, frozen=True):
    """Cross-sections of a branch from its start to its end: parallel lists; null marks a failed measurement."""

    at_mm: Numbers
    """Positions of the cross-sections, in mm along the branch."""
    lumen_mm: MaybeNumbers
    """Diameter in mm of the circle with the area of the cross-section."""
    lumen_error_mm: MaybeNumbers
    min_mm: MaybeNumbers
    """Smallest width in mm of each cross-section through its centre."""
    max_mm: MaybeNumbers
    """Largest width in mm of each cross-section through its centre."""
    wall_mm: MaybeNumbers
    at_junction: tuple[bool, ...]
    """Whether the cross-section cuts a fork or the edge of the scan and therefore gives no airway diameter."""


class BranchDetail(BranchQuestion, ServerMessage, frozen=True):
    """Answer to ``branch_detail``; profile and measurements are null until they are computed."""

    measures: BranchMeasuresSummary | None
    profile: BranchProfile | None
