"""Lines that an edit of the tree would draw, as values."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.track.edit.tree_changes import Points
from carina.track.names.renaming import RenamedBranch


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PreviewLine:
    """Line that an edit would draw."""

    points_lps: NDArray[np.float64]
    """Points (n, 3), LPS in mm; bit for bit the points of the branch that the edit creates there."""
    doubtful: NDArray[np.bool_]
    """Flags (n-1,): whether the CT shows no airway at each segment."""
    drawn: NDArray[np.bool_]
    """Flags (n-1,): whether the branch of each segment counts as drawn by hand; all True if any segment is doubtful."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class EditPreview:
    """Result that an edit would have."""

    lines: tuple[PreviewLine, ...]
    """Lines that would be new or moved in the tree; empty if there is a problem."""
    has_evidence: bool
    """Whether the CT shows an airway along the lines; if False, the edit needs a confirmation or there is a problem."""
    problem: str | None
    """Text that states why the edit is impossible and what to do; None if it is possible."""
    renamed: tuple[RenamedBranch, ...] | None = field(default=None, kw_only=True)
    """Other branches that the edit would rename; None if the names were not determined."""

    @property
    def length_mm(self) -> float:
        """Total length of the new lines, mm."""
        return sum(float(_steps_mm(line.points_lps).sum()) for line in self.lines)

    @property
    def doubtful_mm(self) -> float:
        """Total length of the segments at which the CT shows no airway, mm."""
        return sum(float(_steps_mm(line.points_lps)[line.doubtful].sum()) for line in self.lines)


def _steps_mm(points: Points) -> NDArray[np.float64]:
    steps: NDArray[np.float64] = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return steps
