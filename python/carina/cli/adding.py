"""``carina airways --add-branch``: addition of branches, and reports of those without evidence in the CT."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.cli.console import print_note
from carina.errors import NoEvidenceError, NoResultError, UsageError
from carina.track import AddBranch, Airways, branch_way, edit_airways, renamed_branches, renaming_texts
from carina.track.progress import Progress
from carina.volume import Volume


@dataclass(frozen=True, slots=True)
class AddedBranches:
    """Airways after all branches that could be added, and the result for each requested point."""

    airways: Airways
    rows: tuple[dict[str, Any], ...]
    """Result for each point: ``lps``, ``branches`` (new branches: id, kind, doubtful_mm) and ``error`` or null."""
    refused: tuple[NoResultError, ...]


def add_branches(
    volume: Volume,
    airways: Airways,
    points_lps: Sequence[NDArray[np.float64]],
    *,
    even_without_evidence: bool,
    progress: Progress | None = None,
) -> AddedBranches:
    """Add branches one after the other; report each branch that cannot be added, and continue with the next.

    Raises
    ------
    UsageError
        If a point lies outside the scan.
    """
    rows, refused = [], []
    for number, lps in enumerate(points_lps, 1):
        x, y, z = (float(v) for v in lps)
        row: dict[str, Any] = {"lps": [x, y, z], "branches": [], "error": None}
        before = airways
        try:
            airways = edit_airways(
                volume, airways, AddBranch((x, y, z), even_without_evidence=even_without_evidence), progress=progress
            )
        except NoResultError as error:
            refused.append(error)
            row["error"] = error_json(error)
            print_note(f"branch {number} to {x:g},{y:g},{z:g}: {error}")
            if isinstance(error, NoEvidenceError):
                print_note("  use --even-without-evidence to add it anyway, labelled as drawn by hand")
        except UsageError as error:
            raise UsageError(f"--add-branch {x:g},{y:g},{z:g}: {error}", code=error.code) from None
        else:
            known = {branch.id for branch in before.tree.branches}
            made = [branch for branch in airways.tree.branches if branch.id not in known]
            row["branches"] = [{"id": b.id, "kind": b.kind, "doubtful_mm": round(b.doubtful_mm, 2)} for b in made]
            way = branch_way(volume, before, (x, y, z))
            row |= {"extends": way.extends, "from": way.parent_title, "length_mm": round(way.length_mm, 2)}
            renamed = renamed_branches(before.tree, airways.tree)
            row["renamed"] = [{"id": b.branch_id, "from": b.before, "to": b.after} for b in renamed]
            origin = f"extends {way.parent_title} by" if way.extends else f"new branch from {way.parent_title},"
            print_note(f"branch {number} to {x:g},{y:g},{z:g}: {origin} {way.length_mm:.0f} mm")
            for text in renaming_texts(renamed):
                print_note(f"  {text}")
        rows.append(row)
    return AddedBranches(airways, tuple(rows), tuple(refused))


def error_json(error: NoResultError) -> dict[str, Any]:
    """Return an error for ``--json``; a lack of evidence includes the path (LPS, mm) and its doubtful points."""
    found: dict[str, Any] = {"code": error.code, "message": str(error)}
    if isinstance(error, NoEvidenceError):
        found |= {
            "doubtful_mm": round(error.doubtful_mm, 2),
            "way": error.way_lps.tolist(),
            "doubtful": error.doubtful.tolist(),
        }
    return found
