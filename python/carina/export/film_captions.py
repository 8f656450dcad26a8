"""Captions of a flight's video: time, branch, distance from the main carina, and the next turn with its clock hour."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from carina.navigate import FlightPath
from carina.navigate.recording import ReplayedPose
from carina.plan import DistanceOrigin, Turn
from carina.track import AirwayTree
from carina.track.tree.branch_at_point import branch_at_point
from carina.track.tree.branch_labels import branch_label

AHEAD_MM = 40.0
"""Maximum distance in mm along the path from the tip to the next turn for the caption to name the turn."""
HOUR_MM = 20.0
"""Maximum distance in mm to a turn whose direction the caption states."""


class FilmCaptions:
    """Captions of the frames of a flight.

    Parameters
    ----------
    tree
        The airway tree; None without airways.
    origin
        Origin of the distances; None without airways.
    path, place
        Path of a flight along a route, and the function that returns a position along it in mm as text; without them
        the distances are those of the airway tree.
    turns
        Turns of the route; without them the captions name no turn.
    """

    def __init__(
        self,
        tree: AirwayTree | None,
        origin: DistanceOrigin | None,
        *,
        path: FlightPath | None = None,
        place: Callable[[float], str] | None = None,
        turns: Sequence[Turn] = (),
    ) -> None:
        self._tree, self._origin = tree, origin
        self._path, self._words = path, place
        self._turns: list[tuple[float, Turn]] = []
        if path is not None:
            self._points = np.asarray(path.points_lps, dtype=np.float64)
            steps = np.linalg.norm(np.diff(self._points, axis=0), axis=1)
            self._along_mm = np.concatenate([[0.0], np.cumsum(steps)])
            self._turns = [(self._place_mm(np.array(turn.fork_lps)), turn) for turn in turns]

    def lines(self, frame: ReplayedPose, time_s: float) -> tuple[str, ...]:
        """Return the lines of a frame at a time of the video: time, branch and depth, then the next turn."""
        position = np.asarray(frame.pose.position_lps, dtype=np.float64)
        first = [f"{int(time_s) // 60}:{int(time_s) % 60:02}", *self._place(position)]
        turn = self._turn(frame, position)
        return ("  ".join(first), *([turn] if turn else []))

    def _place(self, position: NDArray[np.float64]) -> list[str]:
        """Return the branch that contains a point, and the distance of the point along the route or the airways.

        The distance is missing for a point outside the airways if the flight follows no route.
        """
        found = None if self._tree is None else branch_at_point(self._tree, position)
        if self._path is not None and self._words is not None:
            named = [] if found is None else [branch_label(found[0])]
            return [*named, self._words(self._place_mm(position))]
        if found is None or self._tree is None or self._origin is None:
            return []
        branch, index = found
        *before, _ = self._tree.lineage(branch.id)
        steps = np.linalg.norm(np.diff(branch.points[: index + 1], axis=0), axis=1)
        along_mm = sum(one.length_mm for one in before) + float(steps.sum())
        return [branch_label(branch), self._origin.words(self._origin.past_mm(along_mm))]

    def _turn(self, frame: ReplayedPose, position: NDArray[np.float64]) -> str | None:
        """Return the text of the next turn on the path, with its direction in the frame; None if it is far."""
        if self._path is None:
            return None
        at_mm = self._place_mm(position)
        for fork_mm, turn in self._turns:
            ahead_mm = fork_mm - at_mm
            if ahead_mm > 0.0:
                if ahead_mm > AHEAD_MM:
                    return None
                text = f"in {ahead_mm:.0f} mm: {self._label(turn)}"
                if ahead_mm > HOUR_MM:
                    return text
                direction = turn.direction_in(frame.pose, picture_turned=frame.picture_turned)
                return text if direction is None else f"{text}, {direction}".replace("\u2019", "'")
        return None

    def _label(self, turn: Turn) -> str:
        """Return the label of the branch into which a turn leads."""
        branches = () if self._tree is None else self._tree.branches
        branch = next((one for one in branches if one.id == turn.to_branch_id), None)
        return turn.to_branch if branch is None or branch.name != turn.to_branch else branch_label(branch)

    def _place_mm(self, point: NDArray[np.float64]) -> float:
        """Return the distance along the path of the path point that is nearest to a point, mm."""
        return float(self._along_mm[int(np.argmin(np.linalg.norm(self._points - point, axis=1)))])
