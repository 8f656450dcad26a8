"""Captions of a flight's video: time, branch, distance from the main carina, and the next turn with its clock hour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.navigate import FlightPath
from carina.navigate.recording import ReplayedPose
from carina.plan import DistanceOrigin, Turn
from carina.track import AirwayTree, caption_name
from carina.track.tree.branch_at_point import branch_at_point

AHEAD_MM = 40.0
"""Distance to the next turn, mm, up to which the caption names the turn."""


class FilmCaptions:
    """Captions of the frames of a flight.

    Parameters
    ----------
    tree
        The airway tree; None without airways.
    origin
        Origin of the distances; None without airways.
    path, turns
        Path of a flight along a route and its turns; without them the captions name no turn.
    """

    def __init__(
        self,
        tree: AirwayTree | None,
        origin: DistanceOrigin | None,
        *,
        path: FlightPath | None = None,
        turns: Sequence[Turn] = (),
    ) -> None:
        self._tree, self._origin = tree, origin
        self._path = path
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
        turn = self._turn(position, "facing" if frame.view.get("operator") == "facing" else "head")
        return ("  ".join(first), *([turn] if turn else []))

    def _place(self, position: NDArray[np.float64]) -> list[str]:
        """Return name and depth of the branch that contains a point; empty outside the airways."""
        if self._tree is None or self._origin is None:
            return []
        found = branch_at_point(self._tree, position)
        if found is None:
            return []
        branch, index = found
        *before, _ = self._tree.lineage(branch.id)
        steps = np.linalg.norm(np.diff(branch.points[: index + 1], axis=0), axis=1)
        along_mm = sum(one.length_mm for one in before) + float(steps.sum())
        return [caption_name(branch), self._origin.words(self._origin.past_mm(along_mm))]

    def _turn(self, position: NDArray[np.float64], operator: str) -> str | None:
        """Return the text of the next turn on the path; None if it is far or there is none."""
        if self._path is None:
            return None
        at_mm = self._place_mm(position)
        for fork_mm, turn in self._turns:
            ahead_mm = fork_mm - at_mm
            if ahead_mm > 0.0:
                if ahead_mm > AHEAD_MM:
                    return None
                direction = turn.direction("facing" if operator == "facing" else "head").replace("\u2019", "'")
                return f"in {ahead_mm:.0f} mm: {turn.to_branch}, {direction}"
        return None

    def _place_mm(self, point: NDArray[np.float64]) -> float:
        """Return the distance along the path of the path point that is nearest to a point, mm."""
        return float(self._along_mm[int(np.argmin(np.linalg.norm(self._points - point, axis=1)))])
