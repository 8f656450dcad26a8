"""Commands on airways: root, edits of the tree, targets and routes."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, get_args

from msgspec import Meta
from msgspec.structs import force_setattr

from carina.commands.fields import BranchId, Identifier, OwnName, PathMm, PointLps
from carina.commands.value import Command, FrozenValue, snake_case
from carina.errors import UsageError
from carina.volume.anatomical_planes import Plane

MAX_BRUSH_MM = 30.0
MAX_STROKE_POINTS = 10_000
MAX_NAME_LENGTH = 80

BrushPlane = Literal[Plane, "ball"]
PathCost = Literal["lumen", "walls", "paper"]


class SetRoot(Command, frozen=True):
    """Find the airways again from this root."""

    lps: PointLps


class SetLumenThreshold(Command, frozen=True):
    """Find the airways again with this threshold; null uses Carina's own."""

    value: Annotated[float, Meta(ge=-32_768.0, le=32_767.0)] | None


class AskedPath(FrozenValue, frozen=True, kw_only=True):
    """Cost function and start point of the path search to a target.

    The cost ``lumen`` keeps the path in the middle of the airways; the target is moved to the lumen within 5 mm, and
    the move is reported. The costs ``walls`` and ``paper`` (paper 6.3 and 6.2) search the whole scan and move no point.
    """

    cost: PathCost = "lumen"
    root_lps: PointLps | None = None
    """Start of the path, for the costs ``walls`` and ``paper``; null is the root of the airways."""

    def choice_problem(self) -> str | None:
        """Return an error text if a path through the lumen has a separate start point."""
        if self.cost == "lumen" and self.root_lps is not None:
            name = snake_case(type(self).__name__)
            return f"{name}: expected the cost walls or paper with a separate start point; found lumen"
        return None


class AddTarget(AskedPath, Command, frozen=True):
    """Add a target, with the path to it."""

    lps: PointLps


class RemoveTarget(Command, frozen=True):
    """Delete a target."""

    target_id: Identifier


class ChooseRoute(Command, frozen=True):
    """Set the route to a target or to the end of a branch; at most one of both, neither for no route."""

    target_id: Identifier | None = None
    branch_id: BranchId | None = None

    def choice_problem(self) -> str | None:
        """Return an error text if a point and a branch are both set as the destination."""
        if self.target_id is not None and self.branch_id is not None:
            return "choose_route: expected a target or a branch; found both"
        return None


def _edit_kind(name: str) -> str:
    """Return the wire name of an edit: ``AddBranch`` gives ``add-branch``."""
    return snake_case(name).replace("_", "-")


class TreeEdit(FrozenValue, frozen=True, tag_field="kind", tag=_edit_kind):
    """One edit of an airway tree. A case can be saved as a list of them, so that their constructors check, too."""

    typescript_prefix: ClassVar[str] = "Edit"


class AddBranch(TreeEdit, frozen=True):
    """Add a branch to a point, by the least-cost path through the lumen or, beyond it, by the best evidence."""

    lps: PointLps
    """End of the branch, LPS mm."""
    even_without_evidence: bool = False
    """Whether to draw the branch even if the CT shows no continuous wall; the branch is then ``manual``.

    Without it such an edit ends with ``no_evidence``.
    """

    def __post_init__(self) -> None:
        """Raise an error if ``lps`` is not three finite numbers or the flag is not a truth value."""
        force_setattr(self, "lps", _point("the end of the branch", self.lps))
        if not isinstance(self.even_without_evidence, bool):
            msg = f"even_without_evidence: expected true or false, found {self.even_without_evidence!r}"
            raise UsageError(msg)


class CutBranch(TreeEdit, frozen=True):
    """Delete a branch with all its descendants, from a position along it."""

    branch_id: BranchId
    at_mm: PathMm = 0.0
    """Position in mm along the branch at which it is cut; 0 removes the whole branch."""

    def __post_init__(self) -> None:
        """Raise an error if the branch's ID or the position is not valid."""
        _whole("branch_id", self.branch_id)
        force_setattr(self, "at_mm", _number("at_mm", self.at_mm, 0.0, math.inf))


class Bridge(TreeEdit, frozen=True):
    """Continue the airways from the nearest tree point through mucus or tumour to a point in air beyond it."""

    lps: PointLps
    """Point in the airway beyond the obstruction, LPS mm."""

    def __post_init__(self) -> None:
        """Raise an error if ``lps`` is not three finite numbers."""
        force_setattr(self, "lps", _point("the point beyond the obstruction", self.lps))


class MoveRoot(TreeEdit, frozen=True):
    """Set another root of all paths; branches whose direction changes are reversed."""

    lps: PointLps
    """Position of the new root, LPS mm."""

    def __post_init__(self) -> None:
        """Raise an error if ``lps`` is not three finite numbers."""
        force_setattr(self, "lps", _point("the start", self.lps))


class MoveFork(TreeEdit, frozen=True):
    """Move the point where a branch ends and its children start; the adjoining centrelines follow."""

    branch_id: BranchId
    lps: PointLps
    """New position of the fork, LPS mm."""

    def __post_init__(self) -> None:
        """Raise an error if the branch's ID is not valid or the point is not three finite numbers."""
        _whole("branch_id", self.branch_id)
        force_setattr(self, "lps", _point("the fork", self.lps))


class PaintLumen(TreeEdit, frozen=True):
    """Add voxels to the lumen, or remove them, by a stroke of a brush."""

    points_lps: Annotated[tuple[PointLps, ...], Meta(min_length=1, max_length=2000)]
    """Path of the brush's centre, LPS mm; straight between points."""
    radius_mm: Annotated[float, Meta(ge=0.1, le=MAX_BRUSH_MM)]
    plane: BrushPlane = "axial"
    """Slice in which the brush is a disc of one voxel thickness; ``ball`` paints in all directions."""
    erase: bool = False

    def __post_init__(self) -> None:
        """Raise an error if the points, the radius or the plane are not valid."""
        points = self.points_lps
        if isinstance(points, str) or not 1 <= len(points) <= MAX_STROKE_POINTS:
            msg = f"stroke: expected 1 to {MAX_STROKE_POINTS} points, found {len(points)}"
            raise UsageError(msg)
        force_setattr(self, "points_lps", tuple(_point("stroke", point) for point in points))
        force_setattr(self, "radius_mm", _number("brush radius in mm", self.radius_mm, 0.0, MAX_BRUSH_MM))
        if self.plane not in get_args(BrushPlane):
            msg = f"brush plane: expected one of {', '.join(get_args(BrushPlane))}, found {self.plane!r}"
            raise UsageError(msg)
        if not isinstance(self.erase, bool):
            msg = f"erase: expected true or false, found {self.erase!r}"
            raise UsageError(msg)


class SmoothBranch(TreeEdit, frozen=True):
    """Smooth a branch's centreline between its fixed ends."""

    branch_id: BranchId

    def __post_init__(self) -> None:
        """Raise an error if the branch's ID is not valid."""
        _whole("branch_id", self.branch_id)


class RenameBranch(TreeEdit, frozen=True):
    """Rename a branch, or restore its automatic name."""

    branch_id: BranchId
    name: OwnName | None
    """New name; None restores the automatic name."""

    def __post_init__(self) -> None:
        """Raise an error if the branch's ID is not valid or the name has no letter."""
        _whole("branch_id", self.branch_id)
        if self.name is None:
            return
        if not isinstance(self.name, str) or not self.name.strip() or len(self.name) > MAX_NAME_LENGTH:
            msg = f"branch name: expected 1 to {MAX_NAME_LENGTH} characters, found {self.name!r}"
            raise UsageError(msg)
        force_setattr(self, "name", " ".join(self.name.split()))


AnyTreeEdit: TypeAlias = AddBranch | CutBranch | Bridge | MoveRoot | MoveFork | PaintLumen | SmoothBranch | RenameBranch


class EditTree(Command, frozen=True):
    """Edit the airway tree: a job, and one step of undo."""

    edit: AnyTreeEdit


def _point(what: str, value: Any) -> tuple[float, float, float]:
    try:
        x, y, z = (float(item) for item in value)
    except (TypeError, ValueError):
        msg = f"{what}: expected a point x,y,z in LPS mm, found {value!r}"
        raise UsageError(msg) from None
    if not all(math.isfinite(item) for item in (x, y, z)):
        msg = f"{what}: expected finite numbers, found {value!r}"
        raise UsageError(msg)
    return x, y, z


def _whole(what: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        msg = f"{what}: expected a whole number of at least 0, found {value!r}"
        raise UsageError(msg)


def _number(what: str, value: Any, low: float, high: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high or math.isinf(value):
        limits = f"of at least {low:g}" if math.isinf(high) else f"between {low:g} and {high:g}"
        msg = f"{what}: expected a number {limits}, found {value!r}"
        raise UsageError(msg)
    return float(value)
