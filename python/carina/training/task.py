"""Task of the training: what the trainee shall do, and the conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from carina.argument_checks import COORDINATE_MM, bounded, check_fields, choice, each, flag, number_from, text_of
from carina.display import one_line
from carina.errors import NoResultError, UsageError
from carina.plan.ebus import Landmark, ebus_landmarks
from carina.scopes import scope_presets
from carina.track import AirwayTree
from carina.track.names.name_texts import bare_name
from carina.training.segments import LANDMARKS, SEGMENTS, label_of, needed_branches

TaskKind = Literal["inspect", "find", "sequence", "turns", "pass", "hold", "reach", "stations"]
TaskOrder = Literal["ascending", "landmarks"]
Level = Literal["beginner", "intermediate", "advanced"]
Hint = Literal["tree", "arrow", "ghost"]
Clock = Literal["cords", "carina"]
RevisitRule = Literal["breaks", "ignored"]

STATIONS = ("4R", "4L", "7", "10R", "10L", "11R", "11Rs", "11Ri", "11L", "11Ls", "11Li")
"""Lymph node stations that tasks can name (`carina.plan.ebus.ebus_landmarks`)."""
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
    """Kind of the task.

    ``inspect`` all segments, ``find`` one, inspect a ``sequence``, follow ``turns``, ``pass`` into branches without
    touching the wall, ``hold`` a structure, ``reach`` a planned target, or locate the EBUS landmarks of
    ``stations``.
    """
    order: TaskOrder = "ascending"
    """Order of inspection that the task teaches, for the kind ``inspect``."""
    segments: tuple[str, ...] = ()
    """Segments of the kinds ``find`` (one) and ``sequence`` (two or more, in this order)."""
    branches: tuple[str, ...] = ()
    """Names of the branches to enter, in this order, of the kinds ``turns`` and ``pass``."""
    structure: str | None = None
    """Name of the branch whose opening is held in the middle of the picture, of the kind ``hold``."""
    hold_s: float | None = None
    """Time in s for which ``structure`` is held in the middle."""
    stations: tuple[str, ...] = ()
    """Lymph node stations to locate, in any order, of the kind ``stations``."""
    place_lps: tuple[float, ...] = ()
    """Planned place of the tip, LPS mm, of the kind ``reach``; empty: the session takes it from the chosen route."""
    aim_lps: tuple[float, ...] = ()
    """Aim of the needle in the target, LPS mm, of the kind ``reach``; empty: the session takes it from the route."""
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
            kind=choice("inspect", "find", "sequence", "turns", "pass", "hold", "reach", "stations"),
            order=choice("ascending", "landmarks"),
            segments=each(choice(*SEGMENTS), most=MAX_NAMES),
            branches=each(text_of(80), most=MAX_NAMES),
            structure=text_of(80, optional=True),
            hold_s=number_from(0.1, MAX_HOLD_S, optional=True, unit="s"),
            stations=each(choice(*STATIONS), most=MAX_NAMES),
            place_lps=each(bounded(COORDINATE_MM, unit="mm"), most=3),
            aim_lps=each(bounded(COORDINATE_MM, unit="mm"), most=3),
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
        """Return the fields that contradict the kind of the task, each as name, expected value and found value."""
        least, most = {"find": (1, 1), "sequence": (2, MAX_NAMES)}.get(self.kind, (0, 0))
        wrong: list[tuple[str, str, object]] = []
        if not least <= len(self.segments) <= most:
            words = {(1, 1): "one segment", (0, 0): f"none for the kind {self.kind}"}.get(
                (least, most), "two segments or more"
            )
            wrong.append(("segments", words, self.segments))
        if len(set(self.segments)) != len(self.segments):
            wrong.append(("segments", "each segment once", self.segments))
        for name, values, is_needed, words in (
            ("branches", self.branches, self.kind in {"turns", "pass"}, "one branch or more"),
            ("stations", self.stations, self.kind == "stations", "one station or more"),
        ):
            if bool(values) != is_needed:
                wrong.append((name, words if is_needed else f"none for the kind {self.kind}", values))
        if len(set(self.stations)) != len(self.stations):
            wrong.append(("stations", "each station once", self.stations))
        for name, value in (("structure", self.structure), ("hold_s", self.hold_s)):
            if (value is not None) != (self.kind == "hold"):
                words = "a value" if self.kind == "hold" else f"null for the kind {self.kind}"
                wrong.append((name, words, value))
        for name, point in (("place_lps", self.place_lps), ("aim_lps", self.aim_lps)):
            if len(point) not in ({0, 3} if self.kind == "reach" else {0}) or bool(point) != bool(self.place_lps):
                words = "three numbers, with place_lps and aim_lps together"
                wrong.append((name, words if self.kind == "reach" else f"none for the kind {self.kind}", point))
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
            ``training.no-branch``: if the tree lacks a branch or the airways of a station; the message names it.
            ``training.turns``: if the branches of a list of turns are not on one way. ``training.no-plan``: if the
            place of a planned target is unknown.
        """
        if self.kind == "reach" and not self.place_lps:
            raise NoResultError(
                f"task {self.name}: expected a chosen route to a planned target; found none; mark a target in the step "
                "Target and choose one of its routes, or write place_lps and aim_lps into a task file",
                code="training.no-plan",
            )
        needed_branches(tree, self.needed_names, task=self.name)
        if self.branches:
            names_on_way(tree, self)
        if self.stations:
            landmarks_of(tree, self)


def landmarks_of(tree: AirwayTree, task: Task) -> dict[str, tuple[Landmark, ...]]:
    """Return the landmarks of each station of a task; station 7 has one in each main bronchus.

    Raises
    ------
    NoResultError
        ``training.no-branch``: if the tree lacks the airways of a station.
    """
    known: dict[str, tuple[Landmark, ...]] = {}
    for one in ebus_landmarks(tree):
        if one.point_lps is not None:
            known[one.station] = (*known.get(one.station, ()), one)
    missing = [name for name in task.stations if name not in known]
    if missing:
        raise NoResultError(
            f"task {task.name}: the airways of this case: expected the airways next to station {missing[0]}; found "
            f"the stations {', '.join(known) or 'none'}; choose another case or task, or name the bronchi in the "
            "window",
            code="training.no-branch",
        )
    return {name: known[name] for name in task.stations}


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
