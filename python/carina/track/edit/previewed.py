"""Lines that an edit would draw, as values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.track.edit.tree import Points

__all__ = ["EditPreview", "PreviewLine"]


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PreviewLine:
    """A line that an edit would draw."""

    points_lps: NDArray[np.float64]
    """(n, 3) LPS mm; bit for bit the points of the branch that the edit makes there."""
    doubtful: NDArray[np.bool_]
    """(n-1,) for each segment, whether the CT shows no airway there."""
    drawn: NDArray[np.bool_]
    """(n-1,) for each segment, whether its branch will be one drawn by hand: all segments, if any is doubtful."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class EditPreview:
    """What an edit would make."""

    lines: tuple[PreviewLine, ...]
    """What would be new or elsewhere in the tree; none where there is a problem."""
    has_evidence: bool
    """Whether it is made at once; False where it must be asked for again, or where there is a problem."""
    problem: str | None
    """Why it cannot be made, and what to do."""

    @property
    def length_mm(self) -> float:
        """Length of all lines."""
        return sum(float(_steps_mm(line.points_lps).sum()) for line in self.lines)

    @property
    def doubtful_mm(self) -> float:
        """Length of what the CT does not show."""
        return sum(float(_steps_mm(line.points_lps)[line.doubtful].sum()) for line in self.lines)


def _steps_mm(points: Points) -> NDArray[np.float64]:
    steps: NDArray[np.float64] = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return steps
