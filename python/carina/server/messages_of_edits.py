"""Edits of the airway tree: what a client asks for, what an edit would make, and why one was not made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from carina.server.wire_codec import Length, Range
from carina.server.wire_fields import BranchId, Count, Key, PointLps, PointsLps, Words
from carina.track.edit_kinds import BrushPlane

__all__ = [
    "AskEditPreview",
    "EditAddBranch",
    "EditBridge",
    "EditCutBranch",
    "EditLine",
    "EditMoveFork",
    "EditMoveRoot",
    "EditPaintLumen",
    "EditPreview",
    "EditRenameBranch",
    "EditSmoothBranch",
    "EditTree",
    "NoEvidence",
]

PreviewTool = Literal["add-branch", "bridge", "move-fork"]


@dataclass(frozen=True, slots=True)
class EditAddBranch:
    """A branch to a point."""

    may_lack: ClassVar[frozenset[str]] = frozenset({"even_without_evidence"})
    kind: Literal["add-branch"]
    lps: PointLps
    even_without_evidence: bool = False
    """Draw it also where the CT shows no wall round the way; else such an edit ends with ``no_evidence``."""


@dataclass(frozen=True, slots=True)
class EditCutBranch:
    """Take a branch away from a place along it, with all that hangs on it; 0 takes the whole branch."""

    kind: Literal["cut-branch"]
    branch_id: BranchId
    at_mm: Annotated[float, Range(0.0, 1e5)]


@dataclass(frozen=True, slots=True)
class EditBridge:
    """Over a blockage to a point in an airway beyond."""

    kind: Literal["bridge"]
    lps: PointLps


@dataclass(frozen=True, slots=True)
class EditMoveRoot:
    """Begin all paths elsewhere."""

    kind: Literal["move-root"]
    lps: PointLps


@dataclass(frozen=True, slots=True)
class EditMoveFork:
    """Move the point where a branch ends and its children begin."""

    kind: Literal["move-fork"]
    branch_id: BranchId
    lps: PointLps


@dataclass(frozen=True, slots=True)
class EditPaintLumen:
    """A stroke of a brush that makes voxels lumen, or takes lumen away; ``ball`` paints in all directions."""

    kind: Literal["paint-lumen"]
    points_lps: Annotated[tuple[PointLps, ...], Length(1, 2000)]
    radius_mm: Annotated[float, Range(0.1, 30.0)]
    plane: BrushPlane
    erase: bool


@dataclass(frozen=True, slots=True)
class EditSmoothBranch:
    """Make a centreline smoother."""

    kind: Literal["smooth-branch"]
    branch_id: BranchId


@dataclass(frozen=True, slots=True)
class EditRenameBranch:
    """A name of one's own; null gives the automatic one back."""

    kind: Literal["rename-branch"]
    branch_id: BranchId
    name: Annotated[str, Length(1, 80)] | None


@dataclass(frozen=True, slots=True)
class EditTree:
    """One edit of the airway tree: a job, and one step of undo."""

    wire_type: ClassVar[str] = "edit_tree"
    edit: (
        EditAddBranch
        | EditCutBranch
        | EditBridge
        | EditMoveRoot
        | EditMoveFork
        | EditPaintLumen
        | EditSmoothBranch
        | EditRenameBranch
    )


@dataclass(frozen=True, slots=True)
class AskEditPreview:
    """Ask what an edit at a place under the cursor would make; only the newest is answered, by ``edit_preview``.

    Either a point, or a place in an airway picture, as in ``live_path``. A branch is named for ``move-fork`` alone.
    """

    wire_type: ClassVar[str] = "preview_edit"
    request_id: Count
    """Named by the answer."""
    tool: PreviewTool
    branch_id: BranchId | None
    """The branch whose fork is to move."""
    lps: PointLps | None
    frame_id: Count | None
    column: Annotated[float, Range(0.0, 4096.0)] | None
    row: Annotated[float, Range(0.0, 4096.0)] | None


@dataclass(frozen=True, slots=True)
class EditLine:
    """A line that an edit would draw, or was asked to draw."""

    points_lps: PointsLps
    """From the tree on; exactly the points of the branch that the edit makes."""
    doubtful: Annotated[tuple[bool, ...], Length(0, 1_000_000)]
    """For each piece between two points, whether the CT shows no airway there; one fewer than points."""
    drawn: Annotated[tuple[bool, ...], Length(0, 1_000_000)]
    """For each piece, whether it becomes part of a branch drawn by hand: also what lies behind a doubt."""


@dataclass(frozen=True, slots=True)
class EditPreview:
    """Answer to ``preview_edit``: the very lines that the edit would make, or why it cannot be made."""

    wire_type: ClassVar[str] = "edit_preview"
    request_id: Count
    tool: PreviewTool
    lps: PointLps | None
    """The point that the edit would be asked with; null where there is nothing under the cursor."""
    lines: tuple[EditLine, ...]
    length_mm: float | None
    doubtful_mm: float | None
    has_evidence: bool
    """Whether the edit is made at once; false where it must be asked for again, or cannot be made."""
    problem: Words | None


@dataclass(frozen=True, slots=True)
class NoEvidence:
    """An ``add-branch`` was not made, since the CT shows no wall round the whole way; in the place of an ``error``.

    The same edit with ``even_without_evidence`` draws this very way.
    """

    wire_type: ClassVar[str] = "no_evidence"
    job_id: Key
    code: Literal["track.no-evidence"]
    message: Words
    lps: PointLps
    """What was asked for."""
    line: EditLine
    length_mm: float
    doubtful_mm: float
