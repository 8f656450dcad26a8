"""Conversion of edits of an airway tree (:mod:`carina.commands.tree`) to and from JSON, and titles of branches."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, get_args

from carina.commands.tree import (
    AddBranch,
    AnyTreeEdit,
    Bridge,
    BrushPlane,
    CutBranch,
    MoveFork,
    MoveRoot,
    PaintLumen,
    RenameBranch,
    SmoothBranch,
)
from carina.errors import TrackingError

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
    "edits_from_json",
    "edits_to_json",
]

FORMAT = "carina-tree-edits"
VERSION = 1

Point = tuple[float, float, float]

TreeEdit = AnyTreeEdit

_KINDS: dict[str, type[Any]] = {str(kind.__struct_config__.tag): kind for kind in get_args(AnyTreeEdit)}


def edits_to_json(edits: Sequence[TreeEdit]) -> dict[str, Any]:
    """Return edits as the document ``carina-tree-edits`` version 1 (LPS, mm).

    Examples
    --------
    >>> edits_to_json([CutBranch(3)])["edits"]
    [{'kind': 'cut-branch', 'branch_id': 3, 'at_mm': 0.0}]
    """
    rows = []
    for edit in edits:
        row = {"kind": edit.__struct_config__.tag}
        for name in edit.__struct_fields__:
            row[name] = _plain(getattr(edit, name))
        rows.append(row)
    return {"format": FORMAT, "version": VERSION, "space": "LPS", "unit": "mm", "edits": rows}


def edits_from_json(document: object) -> tuple[TreeEdit, ...]:
    """Read a document ``carina-tree-edits`` version 1; unknown keys are ignored.

    Raises
    ------
    TrackingError
        If the document is not such a list; the message names the edit and the error.
    """
    if not isinstance(document, Mapping):
        raise _refused(f"expected a JSON object, found {type(document).__name__}")
    for key, expected in (("format", FORMAT), ("version", VERSION), ("space", "LPS"), ("unit", "mm")):
        if document.get(key) != expected:
            raise _refused(f"{key} must be {expected!r}, found {document.get(key)!r}")
    rows = document.get("edits")
    if not isinstance(rows, Sequence) or isinstance(rows, str):
        raise _refused("edits must be a list")
    return tuple(_edit_from_row(row, number) for number, row in enumerate(rows))


def _edit_from_row(row: object, number: int) -> TreeEdit:
    if not isinstance(row, Mapping):
        raise _refused(f"edit {number}: expected a JSON object, found {type(row).__name__}")
    kind = _KINDS.get(str(row.get("kind")))
    if kind is None:
        raise _refused(f"edit {number}: kind must be one of {', '.join(_KINDS)}, found {row.get('kind')!r}")
    values = {name: row[name] for name in kind.__struct_fields__ if name in row}
    try:
        edit: TreeEdit = kind(**values)
    except (TypeError, ValueError, OverflowError) as error:
        raise _refused(f"edit {number}: {error}") from None
    return edit


def branch_title(name: str | None, branch_id: int) -> str:
    """Return a branch's name, or a text with its ID if it has none, for use in a sentence."""
    return name or f"branch {branch_id}"


def _plain(value: Any) -> Any:
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def _refused(reason: str) -> TrackingError:
    return TrackingError(f"this is not a usable list of edits: {reason}", code="track.edits-format")
