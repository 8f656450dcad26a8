"""Reasons why an attempt does not count in a verdict: incomplete, impossible or doubtful flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.scopes import WallField
from carina.track import AirwayTree
from carina.training.flight_frames import FRAME_HZ, FlightFrames
from carina.training.handling import JUMP_MM_S, OUTSIDE_MM
from carina.training.segments import doubtful_names
from carina.training.task import Task

MOVE_STEP_MM = 0.5
"""Distance in mm between the points of a movement at which the wall is checked."""
MOVES_AT_ONCE = 4096
"""Number of movements of the tip that are checked together, which limits the memory."""


@one_line
@dataclass(frozen=True, slots=True)
class AttemptDoubt:
    """Reason why an attempt does not count towards mastery."""

    code: Literal[
        "incomplete", "paused", "left-airways", "start", "jump", "instrument", "wide-picture", "uncertain-names"
    ]
    words: str
    """Reason as a text for the user."""
    time_s: float | None = None
    """Time of the first such moment from the start of the recording, s; None if the reason has no time."""

    def to_json(self) -> dict[str, Any]:
        """Return the reason as plain JSON types."""
        return {"code": self.code, "words": self.words, "time_s": self.time_s}


def attempt_doubts(
    frames: FlightFrames,
    wall: WallField,
    task: Task,
    tree: AirwayTree,
    segment_ids: Sequence[int],
    *,
    branch_ids: Sequence[int] | NDArray[np.int64],
    first: int,
    last: int,
) -> tuple[AttemptDoubt, ...]:
    """Return all reasons why an attempt does not count in a verdict.

    Parameters
    ----------
    frames
        Frames of the flight.
    wall
        Wall of the airways.
    task, tree
        The task, and the airways of the case.
    segment_ids
        Branches of the segments.
    branch_ids
        (n,) branch of the tip at each frame.
    first, last
        Frames at which the clock starts and ends.
    """
    found = []
    if not frames.complete:
        found.append(AttemptDoubt("incomplete", "the recording or the attempt was cut off before its end"))
    # The trainee can look at the picture during a pause, before the first segment and between two segments.
    pauses = [(at_s, length_s) for at_s, length_s in frames.pauses if at_s <= last / FRAME_HZ + 1e-6]
    if pauses:
        times = "once" if len(pauses) == 1 else f"{len(pauses)} times"
        words = f"the attempt was paused {times}, for {sum(length_s for _, length_s in pauses):.0f} s in total"
        found.append(AttemptDoubt("paused", words, pauses[0][0]))
    inside = np.flatnonzero(wall.distance_mm(frames.lps_from_tip[: last + 1, :3, 3]) > OUTSIDE_MM)
    if len(inside) and branch_ids[inside[0]] != tree.root.id:
        at_s = float(inside[0]) / FRAME_HZ
        found.append(AttemptDoubt("start", "the recording does not start in the trachea", at_s))
    shown = slice(int(frames.pose_number[first]), int(frames.pose_number[last]) + 1)
    tips, times_s = frames.recorded_poses[shown, :3, 3], frames.recorded_times_s[shown]
    outside = wall.distance_mm(tips) < OUTSIDE_MM
    if outside.any():
        at_s = float(times_s[np.argmax(outside)])
        found.append(AttemptDoubt("left-airways", f"the tip left the airways after {at_s:.1f} s", at_s))
    through = moves_through_wall(tips, wall) & ~outside[1:] & ~outside[:-1]
    if through.any():
        at_s = float(times_s[1 + np.argmax(through)])
        words = f"the tip went through the wall of the airways after {at_s:.1f} s, between two recorded positions"
        found.append(AttemptDoubt("jump", words, at_s))
    moved = np.linalg.norm(np.diff(frames.lps_from_tip[first : last + 1, :3, 3], axis=0), axis=1) * FRAME_HZ
    jumps = first + 1 + np.flatnonzero(moved > JUMP_MM_S)
    if len(jumps):
        at_s = float(jumps[0]) / FRAME_HZ
        words = f"the tip moved faster than Carina's limit of {JUMP_MM_S:.0f} mm/s after {at_s:.1f} s"
        found.append(AttemptDoubt("jump", words, at_s))
    used = [frames.optics[n] for n in sorted(set(frames.optics_number[first : last + 1].tolist()))]
    if task.scope is not None:
        other = [one for one in used if one.is_free_camera or one.scope.name != task.scope]
        if other:
            name = "a camera without an instrument" if other[0].is_free_camera else other[0].scope.name
            found.append(AttemptDoubt("instrument", f"the task requires the instrument {task.scope}; found {name}"))
    wide = [one for one in used if one.is_wider]
    if wide:
        words = f"the picture was {wide[0].fov_deg:.0f} degrees wide, wider than that of the instrument"
        found.append(AttemptDoubt("wide-picture", words))
    names = doubtful_names(tree, segment_ids)
    if names:
        words = f"the names of these branches are uncertain: {', '.join(names)}; confirm them in the window"
        found.append(AttemptDoubt("uncertain-names", words))
    return tuple(found)


def moves_through_wall(tips: NDArray[np.float64], wall: WallField) -> NDArray[np.bool_]:
    """Return (n - 1,) whether the line from each recorded position to the next one leaves the airways.

    Lines longer than the way of :data:`JUMP_MM_S` in one frame are jumps by their speed, and are not checked.
    """
    ways = np.diff(tips, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    found = np.zeros(len(ways), dtype=bool)
    checked = np.flatnonzero((lengths > MOVE_STEP_MM) & (lengths <= JUMP_MM_S / FRAME_HZ))
    for start in range(0, len(checked), MOVES_AT_ONCE):
        part = checked[start : start + MOVES_AT_ONCE]
        num = np.ceil(lengths[part] / MOVE_STEP_MM).astype(np.int64)
        move = np.repeat(part, num)
        step = np.arange(len(move)) - np.repeat(np.cumsum(num) - num, num)
        points = tips[move] + (step / np.repeat(num, num))[:, None] * ways[move]
        found[move[wall.distance_mm(points) < OUTSIDE_MM]] = True
    return found
