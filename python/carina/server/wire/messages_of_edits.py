"""Messages about edits of the airway tree: requests for a preview, previews, and edits refused for lack of evidence."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.commands.fields import BranchId, Count, Identifier, PointLps, PointsLps, Words
from carina.commands.value import FrozenValue
from carina.server.wire.codec import ClientMessage, ServerMessage
from carina.server.wire.messages_from_client import AskAtPlace

PreviewTool = Literal["add-branch", "bridge", "move-fork"]


class AskEditPreview(AskAtPlace, ClientMessage, frozen=True, tag="preview_edit"):
    """Request for a preview of an edit under the cursor; the server answers the newest request by ``edit_preview``.

    The place is either a point, or a position in an airway image, as in ``live_path``. Only ``move-fork`` names a
    branch.
    """

    tool: PreviewTool
    branch_id: BranchId | None
    """Branch whose fork will be moved; null for the other tools."""
    with_names: bool
    """Whether the answer lists the branches that the edit would rename, which takes some tenths of a second longer."""

    def choice_problem(self) -> str | None:
        """Require either a point or a position in an image, and a branch for one tool."""
        problem = super().choice_problem()
        if problem is None and (self.branch_id is None) == (self.tool == "move-fork"):
            return "preview_edit must name a branch for move-fork, and only for move-fork"
        return problem


class EditLine(FrozenValue, frozen=True):
    """A line of a previewed or refused edit."""

    points_lps: PointsLps
    """Points from the tree to the end; the edit creates a branch with exactly these points."""
    doubtful: Annotated[tuple[bool, ...], Meta(max_length=1_000_000)]
    """Whether the CT shows no airway, for each segment between two points; one entry fewer than points."""
    drawn: Annotated[tuple[bool, ...], Meta(max_length=1_000_000)]
    """Whether the branch of each segment will be drawn by hand; a new branch is, if any of its segments is doubtful."""


class BranchOrigin(FrozenValue, frozen=True):
    """The place in the tree at which a new branch begins."""

    branch: Words
    """Title of the branch that the new branch leaves, for use in a sentence."""
    extends: bool
    """Whether the new points begin at the tip of that branch, so that no fork is added."""


class EditPreviewMessage(ServerMessage, frozen=True):
    """Answer to ``preview_edit``: the exact lines that the edit would create, or the reason why it is not possible."""

    request_id: Count
    tool: PreviewTool
    lps: PointLps | None
    """Point for the command of the edit; null if nothing is under the cursor."""
    lines: tuple[EditLine, ...]
    length_mm: float | None
    """Length in mm of the previewed branch's lines."""
    doubtful_mm: float | None
    """Length in mm of the previewed path along which the CT shows no airway."""
    has_evidence: bool
    """Whether the command performs the edit at once; false if it needs a confirmation or is not possible."""
    problem: Words | None
    origin: BranchOrigin | None
    """Place at which a new branch begins; null for the other tools, and if there is a problem."""
    renamed: tuple[Words, ...] | None
    """Text for each other branch that the edit would rename; null if not requested, and if there is a problem."""


class NoEvidence(ServerMessage, frozen=True):
    """Report that ``add-branch`` was refused, because the CT does not show an airway wall along the whole path.

    The server sends this message instead of ``error``. The same edit with ``even_without_evidence`` draws exactly this
    path.
    """

    job_id: Identifier
    code: Literal["track.no-evidence"]
    message: Words
    lps: PointLps
    """End point of the path that the client requested, LPS mm."""
    line: EditLine
    length_mm: float
    doubtful_mm: float
