"""List of turns: the opening and the moves of the hand at each fork of a route (docs/decisions/0124)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from carina.display import one_line
from carina.display.tables import ColumnKind, Columns, Tabular, columns_of
from carina.errors import NoResultError
from carina.plan.hand_moves import Move
from carina.plan.routes.route_width import RouteOpening
from carina.plan.turns.fork_view import (
    AHEAD_DEG,
    HourDoubt,
    Operator,
    hours_of,
    levelled,
    picture_angles,
    turned_hours,
    whole_hour,
)
from carina.plan.turns.texts import hour_words, joined, moves_words, place_words
from carina.scopes import Pose

Zero = Literal["ridge", "axes"]


@one_line
@dataclass(frozen=True, slots=True)
class OtherWay:
    """Opening at a turn that the route does not enter."""

    name: str
    branch_id: int
    hour_head: int | None
    """Whole clock hour of the opening for an operator at the head; None if it is straight ahead or not in view."""
    opening: RouteOpening
    """Width of the opening, and whether the planned scope passes."""
    in_view: bool = True
    """Whether the opening is visible from the camera of the turn."""
    opening_lps: tuple[float, float, float] | None = None
    """Point, LPS mm, on the line of sight to the middle of the opening's outline, as far away as the opening."""
    ahead_deg: float = AHEAD_DEG
    """Largest angle in degrees between opening and line of sight at which the opening counts as straight ahead."""

    @property
    def straight_ahead(self) -> bool:
        """Whether the opening is in the middle of the picture and so has no clock hour."""
        return self.in_view and self.hour_head is None

    def hour(self, operator: Operator) -> int | None:
        """Return the clock hour of the opening for a position of the operator.

        None if the opening is straight ahead or not in view.
        """
        if self.hour_head is None or operator == "head":
            return self.hour_head
        return whole_hour(turned_hours(self.hour_head))

    def direction(self, operator: Operator) -> str:
        """Return the direction of the opening as text: its clock hour, *straight ahead* or *not in view*."""
        return hour_words(self.hour(operator)) if self.in_view else "not in view"

    def to_json(self) -> dict[str, Any]:
        """Return the opening as plain JSON types."""
        return {
            "name": self.name,
            "branch_id": self.branch_id,
            "hour_head": self.hour("head"),
            "hour_facing": self.hour("facing"),
            "opening_mm": self.opening.width.mm,
            "opening": self.opening.to_json(),
            "in_view": self.in_view,
            "opening_lps": None if self.opening_lps is None else list(self.opening_lps),
        }


BEHIND_DEG = 90.0
"""Minimum angle in degrees between an opening and the line of sight at which the camera has passed the opening."""


@one_line
@dataclass(frozen=True, slots=True)
class Turn:
    """Fork of a route, or several forks so close together that they form one turn."""

    from_branch: str
    to_branch: str
    to_branch_id: int
    fork_lps: tuple[float, float, float]
    from_carina_mm: float | None
    """Distance of the turn from the main carina along the route, mm.

    0 at the main carina, below 0 before it, None if the route passes none.
    """
    from_fork_mm: float
    """Distance of the turn from the previous one, mm; for the first turn, from the beginning of the route."""
    clock_head: float | None
    """Clock hour of the opening, 0 < hours <= 12, in the levelled picture of an operator at the patient's head.

    The hour is the direction of the middle of the opening's visible pixels. None if the opening is straight ahead, or
    if the hour is not reliable (``hour_doubt``).
    """
    clock_facing: float | None
    """Clock hour of the opening for an operator who faces the patient; None as for ``clock_head``."""
    angle_deg: float
    """Angle in degrees between the branches before and after the fork."""
    opening: RouteOpening
    """Width of the opening, which is never below that of the whole route, and whether the planned scope passes."""
    moves: tuple[Move, ...] | None
    """Moves of the hand from the previous fork until the tip is past this fork, in the drive of a verdict.

    None if no drive is known.
    """
    doubts: tuple[str, ...]
    """Warnings about the branch to enter after the turn."""
    straight_ahead: bool = False
    """Whether the opening is in the middle of the picture and so has no clock hour."""
    sides: tuple[str, ...] = ()
    """The patient's directions of the opening, the dominant one first; empty if no clock hour is given."""
    others: tuple[OtherWay, ...] = ()
    """Openings that the route does not enter, clockwise from the opening that it enters."""
    through: tuple[str, ...] = ()
    """Names of short branches that are passed within this turn."""
    at_main_carina: bool = False
    opening_lps: tuple[float, float, float] | None = None
    """Point, LPS mm, on the line of sight to the middle of the opening's outline, as far away as the opening."""
    seen_from_lps: tuple[float, float, float] | None = None
    """Position of the camera in whose picture hours are measured, LPS mm, about one diameter before the fork."""
    hour_doubt: HourDoubt | None = None
    """Reason why no clock hour is given; None if an hour is given or the opening is straight ahead."""
    ahead_deg: float = AHEAD_DEG
    """Largest angle in degrees between opening and line of sight at which the opening counts as straight ahead."""
    dots_lps: tuple[tuple[float, float, float], ...] = ()
    """Dots of the route inside the opening as seen by the camera, LPS mm.

    The dots are the middle of the opening and the visible points of the branch's centreline beyond it. Empty if the
    opening is not in view.
    """

    def clock(self, operator: Operator) -> float | None:
        """Return the unrounded clock hour of the opening; None if it is straight ahead or not reliable."""
        return self.clock_head if operator == "head" else self.clock_facing

    def hour(self, operator: Operator) -> int | None:
        """Return the clock hour of the opening, 1 to 12; None if it is straight ahead or not reliable."""
        clock = self.clock(operator)
        return None if clock is None else whole_hour(clock)

    def direction(self, operator: Operator) -> str:
        """Return the direction of the opening as text: its clock hour, *straight ahead* or *no clock hour*."""
        return "no clock hour" if self.hour_doubt is not None else hour_words(self.hour(operator))

    def direction_in(self, camera: Pose, *, picture_turned: bool = False) -> str | None:
        """Return the direction of the opening as text in the picture of another camera, such as a frame of a flight.

        The hours of ``direction`` apply to the levelled camera of the turn alone; a camera that is rolled sees the same
        opening at another hour.

        Parameters
        ----------
        camera
            Pose of the camera.
        picture_turned
            Whether the picture is turned by 180 degrees, for an operator who faces the patient.

        Returns
        -------
        str or None
            The clock hour in this picture, *straight ahead* or *no clock hour*; None for an opening behind the camera.
        """
        if self.hour_doubt is not None or self.opening_lps is None:
            return "no clock hour"
        right, down = picture_angles(camera, np.array(self.opening_lps))
        off_deg = math.degrees(math.hypot(right, down))
        if off_deg >= BEHIND_DEG:
            return None
        if off_deg <= self.ahead_deg:
            return hour_words(None)
        hours = hours_of(right, down)
        return hour_words(whole_hour(turned_hours(hours) if picture_turned else hours))

    @property
    def diameter_mm(self) -> float:
        """Narrowest diameter of the opening, without its error, mm."""
        return self.opening.width.mm

    @property
    def in_view(self) -> bool:
        """Whether the opening is visible from the camera of the turn."""
        return self.hour_doubt is None or self.hour_doubt.code != "turns.hidden"

    @property
    def cautions(self) -> tuple[str, ...]:
        """Texts of all doubts about the turn: the reason why no hour is given, and the warnings about the branch."""
        return self.doubts if self.hour_doubt is None else (self.hour_doubt.words, *self.doubts)

    def camera(self, operator: Operator) -> Pose:
        """Return the camera in whose picture the hours are measured.

        Raises
        ------
        NoResultError
            If the turn has no camera position.
        """
        if self.seen_from_lps is None:
            raise NoResultError(
                f"the turn into {self.to_branch} does not say where it is seen from; make it with turn_list",
                code="plan.turn-view",
            )
        eye = np.array(self.seen_from_lps)
        return levelled(eye, np.array(self.fork_lps) - eye, operator)

    def words(
        self, operator: Operator, *, depth_mm: float | None = None, first: bool = False, moves: bool = True
    ) -> str:
        """Return the turn as one line of instructions.

        Parameters
        ----------
        operator
            Position of the operator for the hours.
        depth_mm
            Depth at nose or mouth, shown as an estimate.
        first
            Whether the turn is the first one of its route.
        moves
            Whether to include the moves of the hand.
        """
        where = place_words(self.from_carina_mm, self.from_fork_mm, depth_mm, first)
        doing = "stay in" if self.to_branch == self.from_branch else "enter"
        stems = [name for name in self.through if name not in {self.from_branch, self.to_branch}]
        passed = f" just past {joined(stems)}" if stems else ""
        sides = " and ".join(self.sides)
        seen = [self.direction(operator), *([sides] if sides else [])]
        seen += [self.opening.words, f"{self.angle_deg:.0f}\u00b0"]
        line = f"{where}, {doing} {self.to_branch}{passed} ({', '.join(seen)})"
        if self.others:
            line += f", not {joined([f'{one.name} ({one.direction(operator)})' for one in self.others])}"
        does = moves_words(self.moves or ()) if moves else ""
        if does:
            line += f": {does}"
        return f"{line}. Caution: {'; '.join(self.cautions)}" if self.cautions else line

    def to_json(self) -> dict[str, Any]:
        """Return the turn as plain JSON types."""
        return {
            "from_branch": self.from_branch,
            "to_branch": self.to_branch,
            "to_branch_id": self.to_branch_id,
            "fork_lps": list(self.fork_lps),
            "from_carina_mm": self.from_carina_mm,
            "from_fork_mm": self.from_fork_mm,
            "clock_head": self.clock_head,
            "clock_facing": self.clock_facing,
            "hour_head": self.hour("head"),
            "hour_facing": self.hour("facing"),
            "straight_ahead": self.straight_ahead,
            "hour_doubt": None if self.hour_doubt is None else self.hour_doubt.to_json(),
            "sides": list(self.sides),
            "angle_deg": self.angle_deg,
            "diameter_mm": self.diameter_mm,
            "opening": self.opening.to_json(),
            "others": [other.to_json() for other in self.others],
            "through": list(self.through),
            "at_main_carina": self.at_main_carina,
            "opening_lps": None if self.opening_lps is None else list(self.opening_lps),
            "seen_from_lps": None if self.seen_from_lps is None else list(self.seen_from_lps),
            "dots_lps": [list(dot) for dot in self.dots_lps],
            "moves": None if self.moves is None else [move.to_json() for move in self.moves],
            "doubts": list(self.doubts),
            "words": {"head": self.words("head"), "facing": self.words("facing")},
        }


@one_line
@dataclass(frozen=True, slots=True)
class TurnList(Tabular):
    """All turns of a route in order, and the final position of the scope.

    As a table (``to_pandas``, ``to_arrow``, ``to_columns``) it has a row for each turn: its number from 1,
    ``from_branch``, ``to_branch``, ``to_branch_id``, ``from_carina_mm``, ``from_fork_mm``, ``depth_estimate_mm``,
    ``hour_head``, ``hour_facing``, ``angle_deg``, ``diameter_mm``.
    """

    turns: tuple[Turn, ...]
    park_from_carina_mm: float | None
    park_from_fork_mm: float
    carina_depth_mm: float | None
    """Depth of the main carina at nose or mouth in mm, as set by the user (an estimate); None if not set."""
    park_moves: tuple[Move, ...] | None = None
    """Moves of the hand from the last fork to the final position of the scope; None if no drive is known."""
    zero: Zero | None = None
    """Origin of distances: the visible ridge of the main carina, or the point where the axes of the main bronchi meet.

    The point of the axes is about one radius of the trachea above the ridge, and is used if no ridge was found. None if
    the route passes no main carina.
    """
    notes: tuple[str, ...] = ()
    """Notes on the distances and depths."""

    def _columns(self) -> Columns:
        own: dict[str, ColumnKind] = {
            "from_branch": "text",
            "to_branch": "text",
            "to_branch_id": "int",
            "from_carina_mm": "float",
            "from_fork_mm": "float",
            "angle_deg": "float",
            "diameter_mm": "float",
        }
        return columns_of(
            (
                {
                    "turn": number,
                    **{name: getattr(turn, name) for name in own},
                    "depth_estimate_mm": self.depth_mm(turn.from_carina_mm),
                    "hour_head": turn.hour("head"),
                    "hour_facing": turn.hour("facing"),
                }
                for number, turn in enumerate(self.turns, start=1)
            ),
            {"turn": "int", **own, "depth_estimate_mm": "float", "hour_head": "int", "hour_facing": "int"},
        )

    @property
    def park_depth_estimate_mm(self) -> float | None:
        """Estimated depth of the final position at nose or mouth in mm; None if no depth of the carina was set."""
        return self.depth_mm(self.park_from_carina_mm)

    def depth_mm(self, from_carina_mm: float | None) -> float | None:
        """Return the estimated depth at nose or mouth in mm; None if no depth of the carina was set."""
        if self.carina_depth_mm is None or from_carina_mm is None:
            return None
        return self.carina_depth_mm + from_carina_mm

    def words(self, operator: Operator) -> tuple[str, ...]:
        """Return the list as lines: each turn, then the final position."""
        lines = []
        for n, turn in enumerate(self.turns):
            lines.append(turn.words(operator, depth_mm=self.depth_mm(turn.from_carina_mm), first=n == 0))
        where = place_words(
            self.park_from_carina_mm, self.park_from_fork_mm, self.park_depth_estimate_mm, not self.turns
        )
        counted = self.turns and self.park_from_carina_mm is not None and self.park_from_fork_mm >= 0.0
        beyond = f", {self.park_from_fork_mm:.0f} mm past the last fork" if counted else ""
        doing = moves_words(self.park_moves or ())
        return (*lines, f"{where}{beyond}, stop" + (f": {doing}" if doing else ""))

    def to_json(self) -> dict[str, Any]:
        """Return the list as plain JSON types."""
        return {
            "turns": [
                {**turn.to_json(), "depth_estimate_mm": self.depth_mm(turn.from_carina_mm)} for turn in self.turns
            ],
            "park_from_carina_mm": self.park_from_carina_mm,
            "park_from_fork_mm": self.park_from_fork_mm,
            "park_depth_estimate_mm": self.park_depth_estimate_mm,
            "park_moves": None if self.park_moves is None else [move.to_json() for move in self.park_moves],
            "carina_depth_mm": self.carina_depth_mm,
            "zero": self.zero,
            "notes": list(self.notes),
            "words": {"head": list(self.words("head")), "facing": list(self.words("facing"))},
        }
