"""Random sequences of edits, undo and redo, from a seed or from values that Hypothesis draws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from edit_case import EditCase, assert_same, edit_case

from carina.errors import NoResultError, UsageError
from carina.track import (
    AddBranch,
    Airways,
    Bridge,
    CutBranch,
    MoveFork,
    MoveRoot,
    PaintLumen,
    RenameBranch,
    SmoothBranch,
    TreeEdit,
    edit_airways,
    rebuild_airways,
)

KINDS = ("add", "cut", "bridge", "root", "fork", "paint", "erase", "smooth", "rename")
PLANES = ("axial", "coronal", "sagittal", "ball")


def some_edit(kind: str, airways: Airways, number: Callable[[int], int], case: EditCase) -> TreeEdit:
    """Return an edit of the kind ``kind``; ``number(n)`` chooses one of n values.

    Most edits are valid, some are refused.
    """
    branches = airways.tree.branches
    branch = branches[number(len(branches))]
    place = branch.points[number(len(branch.points))]
    shift = np.array([number(9) - 4, number(9) - 4, number(9) - 4], dtype=np.float64)

    def point(values: np.ndarray) -> tuple[float, float, float]:
        return float(values[0]), float(values[1]), float(values[2])

    match kind:
        case "add":
            ends = [*case.tips, case.hidden, place + shift]
            return AddBranch(point(ends[number(len(ends))]), even_without_evidence=number(2) == 1)
        case "cut":
            return CutBranch(branch.id, float(number(4)) * branch.length_mm / 4.0)
        case "bridge":
            return Bridge(point((case.hidden, place + shift)[number(2)]))
        case "root":
            return MoveRoot(point(place + 0.25 * shift))
        case "fork":
            return MoveFork(branch.id, point(branch.points[-1] + 0.3 * shift))
        case "paint" | "erase":
            way = (point(place + shift), point(place - 0.5 * shift))
            return PaintLumen(way[: 1 + number(2)], 0.8 * number(5), PLANES[number(4)], kind == "erase")
        case "smooth":
            return SmoothBranch(branch.id)
        case _:
            return RenameBranch(branch.id, (None, "RB3", "mine")[number(3)])


@dataclass
class Editing:
    """Airways that are edited at random, with their undo and redo stacks."""

    case: EditCase = field(default_factory=edit_case)
    done: list[Airways] = field(default_factory=list)
    undone: list[Airways] = field(default_factory=list)
    num_refused: int = 0

    def __post_init__(self) -> None:
        self.done.append(self.case.airways)

    @property
    def airways(self) -> Airways:
        return self.done[-1]

    def edit(self, kind: str, number: Callable[[int], int]) -> None:
        edit = some_edit(kind, self.airways, number, self.case)
        try:
            edited = edit_airways(self.case.volume, self.airways, edit)
        except (NoResultError, UsageError):
            self.num_refused += 1
            return
        self.done.append(edited)
        self.undone.clear()

    def undo(self) -> None:
        if len(self.done) > 1:
            self.undone.append(self.done.pop())

    def redo(self) -> None:
        if self.undone:
            self.done.append(self.undone.pop())

    def check(self, airways: Airways) -> None:
        """Assert that the airways after the edits one by one equal the airways after all edits from scratch."""
        assert_same(airways, rebuild_airways(self.case.volume, self.case.airways, airways.edits))
        for branch in airways.tree.branches:
            assert airways.tracker.inside(branch.points).all(), f"branch {branch.id} leaves the lumen"


def run_sequence(seed: int) -> Editing:
    """Run one random sequence of up to eight edits, undos and redos."""
    rng = np.random.default_rng(seed)
    editing = Editing()
    for _ in range(int(rng.integers(2, 9))):
        what = rng.random()
        if what < 0.15:
            editing.undo()
        elif what < 0.25:
            editing.redo()
        else:
            editing.edit(KINDS[rng.integers(len(KINDS))], lambda n: int(rng.integers(n)))
    return editing
