"""Task of the training: what the trainee shall do, and the conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from carina.argument_checks import check_fields, choice, each, flag, number_from, text_of
from carina.display import one_line
from carina.errors import NoResultError, UsageError
from carina.scopes import scope_presets
from carina.track import AirwayTree
from carina.track.names.name_texts import bare_name
from carina.training.segments import LANDMARKS, SEGMENTS, label_of, needed_branches

TaskKind = Literal["inspect", "find", "sequence", "turns", "hold"]
TaskOrder = Literal["ascending", "landmarks"]
Level = Literal["beginner", "intermediate", "advanced"]
Hint = Literal["tree", "arrow", "ghost"]
Clock = Literal["cords", "carina"]
RevisitRule = Literal["breaks", "ignored"]

MAX_NAMES = 40
MAX_TIME_S = 7200.0
MAX_HOLD_S = 600.0


@one_line
@dataclass(frozen=True, slots=True)
class Task:
    """Task of the training; `task_from_file` reads one from a file, and docs/training.md describes the fields.

    Raises
    ------
    UsageError
        If a field has an impossible value (code ``training.task``).
    """

    name: str
    """Short name of the task, for the command line and exports."""
    title: str
    """Text that describes the task to the trainee."""
    kind: TaskKind
    """``inspect`` all segments, ``find`` one, inspect a ``sequence``, follow ``turns``, or ``hold`` a structure."""
    order: TaskOrder = "ascending"
    """Taught order of the kind ``inspect``."""
    segments: tuple[str, ...] = ()
    """Segments of the kinds ``find`` (one) and ``sequence`` (two or more, in this order)."""
    branches: tuple[str, ...] = ()
    """Names of the branches to enter, in this order, of the kind ``turns``."""
    structure: str | None = None
    """Name of the branch whose opening is held in the middle of the picture, of the kind ``hold``."""
    hold_s: float | None = None
    """Time in s for which ``structure`` is held in the middle."""
    level: Level = "beginner"
    time_limit_s: float | None = None
    """Time in s after which the attempt ends; None for no limit."""
    hints: tuple[Hint, ...] = ()
    """Help in the window during the flight."""
    names_shown: bool = True
    """Whether the window shows the names of branches."""
    scope: str | None = None
    """Instrument of the library with which the task is flown; None for any."""
    clock: Clock = "cords"
    """Start of the procedure time: below the cords (where the tip enters the airways), or at the main carina."""
    revisit_rule: RevisitRule = "breaks"
    """Whether a revisit breaks the sequence of structured progress (`carina.training.visits.progress_steps`)."""

    def __post_init__(self) -> None:
        """Raise an error if a field has an impossible value."""
        check_fields(
            self,
            UsageError,
            "training.task",
            name=text_of(80),
            title=text_of(300),
            kind=choice("inspect", "find", "sequence", "turns", "hold"),
            order=choice("ascending", "landmarks"),
            segments=each(choice(*SEGMENTS), most=MAX_NAMES),
            branches=each(text_of(80), most=MAX_NAMES),
            structure=text_of(80, optional=True),
            hold_s=number_from(0.1, MAX_HOLD_S, optional=True, unit="s"),
            level=choice("beginner", "intermediate", "advanced"),
            time_limit_s=number_from(1.0, MAX_TIME_S, optional=True, unit="s"),
            hints=each(choice("tree", "arrow", "ghost"), most=3),
            names_shown=flag,
            scope=choice(*(one.name for one in scope_presets()), optional=True),
            clock=choice("cords", "carina"),
            revisit_rule=choice("breaks", "ignored"),
        )
        for name, expected, found in self._wrong_combination():
            raise UsageError(f"Task: {name}: expected {expected}; found {found!r}", code="training.task")

    def _wrong_combination(self) -> list[tuple[str, str, object]]:
        """Return the fields that contradict the kind of the task: name, expected and found value."""
        least, most = {"find": (1, 1), "sequence": (2, MAX_NAMES)}.get(self.kind, (0, 0))
        wrong: list[tuple[str, str, object]] = []
        if not least <= len(self.segments) <= most:
            words = {(1, 1): "one segment", (0, 0): f"none for the kind {self.kind}"}.get(
                (least, most), "two segments or more"
            )
            wrong.append(("segments", words, self.segments))
        if len(set(self.segments)) != len(self.segments):
            wrong.append(("segments", "each segment once", self.segments))
        if bool(self.branches) != (self.kind == "turns"):
            words = "one branch or more" if self.kind == "turns" else f"none for the kind {self.kind}"
            wrong.append(("branches", words, self.branches))
        for name, value in (("structure", self.structure), ("hold_s", self.hold_s)):
            if (value is not None) != (self.kind == "hold"):
                words = "a value" if self.kind == "hold" else f"null for the kind {self.kind}"
                wrong.append((name, words, value))
        if self.order != "ascending" and self.kind != "inspect":
            wrong.append(("order", f"ascending for the kind {self.kind}", self.order))
        return wrong

    @property
    def needed_names(self) -> tuple[str, ...]:
        """Names of the branches without which a case cannot be used for the task."""
        landmarks = LANDMARKS if self.order == "landmarks" else ()
        return (
            *self.segments,
            *self.branches,
            *(() if self.structure is None else (self.structure,)),
            *(name for _, names in landmarks for name in names),
        )

    def check_case(self, tree: AirwayTree) -> None:
        """Check that a case has all branches that the task names.

        Raises
        ------
        NoResultError
            ``training.no-branch``: if the tree lacks a branch; the message names it. ``training.turns``: if the
            branches of a list of turns are not on one way.
        """
        needed_branches(tree, self.needed_names, task=self.name)
        if self.kind == "turns":
            names_on_way(tree, self)


def names_on_way(tree: AirwayTree, task: Task) -> list[str]:
    """Return the names of the branches from the root to the last branch of a list of turns.

    Raises
    ------
    NoResultError
        ``training.no-branch``: if the tree lacks a branch. ``training.turns``: if a branch of the list is not on the
        way, or not in the order of the list.
    """
    wanted = needed_branches(tree, task.branches, task=task.name)
    lineage = tree.lineage(wanted[-1].id)
    way = list(dict.fromkeys(label_of(branch) for branch in lineage))
    places = [way.index(name) if name in way else -1 for name in map(bare_name, task.branches)]
    if -1 in places or places != sorted(places):
        raise NoResultError(
            f"task {task.name}: branches: expected branches in their order on the way {', '.join(way)}; found "
            f"{', '.join(task.branches)}; correct the list",
            code="training.turns",
        )
    return way
