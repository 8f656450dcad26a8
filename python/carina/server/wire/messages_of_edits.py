"""Edits of the airway tree: what a client asks for, what an edit would make, and why one was not made."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.commands.fields import BranchId, Count, Identifier, PointLps, PointsLps, Words
from carina.commands.value import FrozenValue
from carina.server.wire.codec import ClientMessage, ServerMessage
from carina.server.wire.messages_from_client import AskAtPlace

PreviewTool = Literal["add-branch", "bridge", "move-fork"]


class AskEditPreview(AskAtPlace, ClientMessage, frozen=True, tag="preview_edit"):
    """Ask what an edit at a place under the cursor would make; only the newest is answered, by ``edit_preview``.

    Either a point, or a place in an airway picture, as in ``live_path``. A branch is named for ``move-fork`` alone.
    """

    tool: PreviewTool
    branch_id: BranchId | None
    """The branch whose fork is to move."""

    def choice_problem(self) -> str | None:
        """Require either a point or a position in an image, and a branch for one tool."""
        problem = super().choice_problem()
        if problem is None and (self.branch_id is None) == (self.tool == "move-fork"):
            return "preview_edit must name a branch for move-fork, and only for move-fork"
        return problem


class EditLine(FrozenValue, frozen=True):
    """A line that an edit would draw, or was asked to draw."""

    points_lps: PointsLps
    """From the tree on; exactly the points of the branch that the edit makes."""
    doubtful: Annotated[tuple[bool, ...], Meta(max_length=1_000_000)]
    """For each piece between two points, whether the CT shows no airway there; one fewer than points."""
    drawn: Annotated[tuple[bool, ...], Meta(max_length=1_000_000)]
    """For each piece, whether it becomes part of a branch drawn by hand: also what lies behind a doubt."""


class EditPreview(ServerMessage, frozen=True):
    """Answer to ``preview_edit``: the very lines that the edit would make, or why it cannot be made."""

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


class NoEvidence(ServerMessage, frozen=True):
    """An ``add-branch`` was not made, since the CT shows no wall round the whole way; in the place of an ``error``.

    The same edit with ``even_without_evidence`` draws this very way.
    """

    job_id: Identifier
    code: Literal["track.no-evidence"]
    message: Words
    lps: PointLps
    """What was asked for."""
    line: EditLine
    length_mm: float
    doubtful_mm: float
