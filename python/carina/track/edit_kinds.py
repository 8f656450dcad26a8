"""What a person can do to an airway tree: one small value per edit, so that a case can be saved as a list of them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

from carina.display import one_line
from carina.errors import TrackingError, UsageError
from carina.volume.planes import Plane

if TYPE_CHECKING:
    from carina.track.airways import Airways
    from carina.track.tree import AirwayTree

__all__ = [
    "AddBranch",
    "Bridge",
    "BrushPlane",
    "CutBranch",
    "MoveFork",
    "MoveRoot",
    "PaintLumen",
    "RenameBranch",
    "SmoothBranch",
    "TreeEdit",
    "branch_title",
    "edit_words",
    "edits_from_json",
    "edits_to_json",
]

FORMAT = "carina-tree-edits"
VERSION = 1
MAX_BRUSH_MM = 30.0
MAX_STROKE_POINTS = 10_000
MAX_NAME_LENGTH = 80

Point = tuple[float, float, float]
BrushPlane = Literal[Plane, "ball"]


@one_line
@dataclass(frozen=True, slots=True)
class AddBranch:
    """A branch to a point: the least-cost path through the lumen, or the way with the best evidence beyond it."""

    lps: Point
    """Where the branch ends, LPS mm."""
    even_without_evidence: bool = False
    """Whether to draw the branch where the CT shows no wall round the way; it is then ``manual``."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "lps", _point("the end of the branch", self.lps))
        if not isinstance(self.even_without_evidence, bool):
            msg = f"even_without_evidence: expected true or false, found {self.even_without_evidence!r}"
            raise UsageError(msg)


@one_line
@dataclass(frozen=True, slots=True)
class CutBranch:
    """Take a branch away with all that hangs on it, from a place along it."""

    branch_id: int
    at_mm: float = 0.0
    """How far along the branch, mm; 0 takes the whole branch."""

    def __post_init__(self) -> None:
        _whole("branch_id", self.branch_id)
        object.__setattr__(self, "at_mm", _number("at_mm", self.at_mm, 0.0, math.inf))


@one_line
@dataclass(frozen=True, slots=True)
class Bridge:
    """Go on beyond a blockage: from the nearest place of the tree through mucus or tumour to a point in an airway."""

    lps: Point
    """In the airway beyond, LPS mm."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "lps", _point("the point beyond the blockage", self.lps))


@one_line
@dataclass(frozen=True, slots=True)
class MoveRoot:
    """Begin all paths elsewhere; branches that are then flown the other way are turned round."""

    lps: Point
    """The new root, LPS mm."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "lps", _point("the root", self.lps))


@one_line
@dataclass(frozen=True, slots=True)
class MoveFork:
    """Move the point where a branch ends and its children begin; the adjoining centrelines follow."""

    branch_id: int
    lps: Point
    """Where the fork is to be, LPS mm."""

    def __post_init__(self) -> None:
        _whole("branch_id", self.branch_id)
        object.__setattr__(self, "lps", _point("the fork", self.lps))


@one_line
@dataclass(frozen=True, slots=True)
class PaintLumen:
    """A stroke of a brush that makes voxels lumen, or takes lumen away."""

    points_lps: tuple[Point, ...]
    """The way of the brush's centre, LPS mm; straight between points."""
    radius_mm: float
    plane: BrushPlane = "axial"
    """The slice that the brush is a disc in, one voxel thick; ``ball`` paints in all directions."""
    erase: bool = False

    def __post_init__(self) -> None:
        points = self.points_lps
        if isinstance(points, str) or not 1 <= len(points) <= MAX_STROKE_POINTS:
            msg = f"a stroke has 1 to {MAX_STROKE_POINTS} points, found {len(points)}"
            raise UsageError(msg)
        object.__setattr__(self, "points_lps", tuple(_point("a stroke", point) for point in points))
        object.__setattr__(self, "radius_mm", _number("the brush's radius in mm", self.radius_mm, 0.0, MAX_BRUSH_MM))
        if self.plane not in get_args(BrushPlane):
            msg = f"a brush's plane is {', '.join(get_args(BrushPlane))}, found {self.plane!r}"
            raise UsageError(msg)
        if not isinstance(self.erase, bool):
            msg = f"erase: expected true or false, found {self.erase!r}"
            raise UsageError(msg)


@one_line
@dataclass(frozen=True, slots=True)
class SmoothBranch:
    """Make a branch's centreline smoother; its ends stay."""

    branch_id: int

    def __post_init__(self) -> None:
        _whole("branch_id", self.branch_id)


@one_line
@dataclass(frozen=True, slots=True)
class RenameBranch:
    """Give a branch a name of one's own, or the automatic one back."""

    branch_id: int
    name: str | None
    """None: the automatic name."""

    def __post_init__(self) -> None:
        _whole("branch_id", self.branch_id)
        if self.name is None:
            return
        if not isinstance(self.name, str) or not self.name.strip() or len(self.name) > MAX_NAME_LENGTH:
            msg = f"a branch's name has 1 to {MAX_NAME_LENGTH} letters, found {self.name!r}"
            raise UsageError(msg)
        object.__setattr__(self, "name", " ".join(self.name.split()))


TreeEdit = AddBranch | CutBranch | Bridge | MoveRoot | MoveFork | PaintLumen | SmoothBranch | RenameBranch

_KINDS: dict[str, type[Any]] = {
    "add-branch": AddBranch,
    "cut-branch": CutBranch,
    "bridge": Bridge,
    "move-root": MoveRoot,
    "move-fork": MoveFork,
    "paint-lumen": PaintLumen,
    "smooth-branch": SmoothBranch,
    "rename-branch": RenameBranch,
}
_KIND_OF = {kind: name for name, kind in _KINDS.items()}


def edits_to_json(edits: Sequence[TreeEdit]) -> dict[str, Any]:
    """Edits as the document ``carina-tree-edits`` version 1 (LPS mm).

    Examples
    --------
    >>> edits_to_json([CutBranch(3)])["edits"]
    [{'kind': 'cut-branch', 'branch_id': 3, 'at_mm': 0.0}]
    """
    rows = []
    for edit in edits:
        row = {"kind": _KIND_OF[type(edit)]}
        for key in dataclasses.fields(edit):
            row[key.name] = _plain(getattr(edit, key.name))
        rows.append(row)
    return {"format": FORMAT, "version": VERSION, "space": "LPS", "unit": "mm", "edits": rows}


def edits_from_json(document: object) -> tuple[TreeEdit, ...]:
    """Read a document ``carina-tree-edits`` version 1; keys it does not know are ignored.

    Raises
    ------
    TrackingError
        If the document is not such a list; says which edit and what is wrong with it.
    """
    if not isinstance(document, Mapping):
        raise _refused(f"expected an object, found {type(document).__name__}")
    for key, expected in (("format", FORMAT), ("version", VERSION), ("space", "LPS"), ("unit", "mm")):
        if document.get(key) != expected:
            raise _refused(f"{key}: expected {expected!r}, found {document.get(key)!r}")
    rows = document.get("edits")
    if not isinstance(rows, Sequence) or isinstance(rows, str):
        raise _refused("edits: expected a list")
    return tuple(_edit_from_row(row, number) for number, row in enumerate(rows))


def _edit_from_row(row: object, number: int) -> TreeEdit:
    if not isinstance(row, Mapping):
        raise _refused(f"edit {number}: expected an object, found {type(row).__name__}")
    kind = _KINDS.get(str(row.get("kind")))
    if kind is None:
        raise _refused(f"edit {number}: kind must be one of {', '.join(_KINDS)}, found {row.get('kind')!r}")
    values = {field.name: row[field.name] for field in dataclasses.fields(kind) if field.name in row}
    try:
        edit: TreeEdit = kind(**values)
    except (TypeError, ValueError, OverflowError) as error:
        raise _refused(f"edit {number}: {error}") from None
    return edit


def edit_words(edit: TreeEdit, airways: Airways) -> str:
    """An edit in words, for the list of what can be undone: ``cut RB3``.

    Parameters
    ----------
    airways
        What the edit is made to: it has the names.
    """
    tree = airways.tree
    match edit:
        case AddBranch(lps, even_without_evidence):
            what = "draw" if even_without_evidence else "add"
            return f"{what} a branch beyond {_nearest_title(tree, lps)}"
        case CutBranch(branch_id, at_mm):
            return f"cut {_title(tree, branch_id)}" if at_mm <= 0.0 else f"shorten {_title(tree, branch_id)}"
        case Bridge(lps):
            return f"bridge beyond {_nearest_title(tree, lps)}"
        case MoveRoot():
            return "move the root"
        case MoveFork(branch_id):
            return f"move the fork of {_title(tree, branch_id)}"
        case PaintLumen(erase=erase):
            return "erase lumen" if erase else "paint lumen"
        case SmoothBranch(branch_id):
            return f"smooth {_title(tree, branch_id)}"
        case RenameBranch(branch_id, name):
            title = _title(tree, branch_id)
            return f"automatic name for {title}" if name is None else f"call {title} {name}"


def branch_title(name: str | None, branch_id: int) -> str:
    """What a branch is called in a sentence."""
    return name or f"branch {branch_id}"


def _title(tree: AirwayTree, branch_id: int) -> str:
    name = next((branch.name for branch in tree.branches if branch.id == branch_id), None)
    return branch_title(name, branch_id)


def _nearest_title(tree: AirwayTree, lps: Point) -> str:
    branch, _, _ = tree.nearest_branch(lps)
    return branch_title(branch.name, branch.id)


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _point(what: str, value: Any) -> Point:
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


def _refused(reason: str) -> TrackingError:
    return TrackingError(f"this is not a usable list of edits: {reason}", code="track.edits-format")
