"""Steps of a task in a flight: landmarks, segments in order, branches entered, a structure held, stations located."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from carina.display import one_line
from carina.track import AirwayTree
from carina.track.names.name_texts import bare_name
from carina.training.events import FlightEvent
from carina.training.flight_frames import FRAME_HZ, FlightFrames
from carina.training.handling import TipPlaces, WallContact
from carina.training.openings_in_sight import OpeningSights
from carina.training.segment_entries import ENTERED_S
from carina.training.segments import CaseSegment, label_of
from carina.training.task import Task, landmarks_of, names_on_way
from carina.training.visits import MIDDLE, SEEN_S, Visit, first_run, frames_of, run_ends

STATION_MM = 10.0
"""Maximum distance in mm of the tip from the landmark of a station that is located."""
STATION_DEG = 45.0
"""Maximum angle in degrees between the tip's upward direction and the direction of the station."""
STATION_S = 1.0
"""Time in s for which the tip must be near a landmark and see it without interruption for its station to be located."""
REACH_MM = 5.0
"""Maximum distance in mm of the tip from its planned position at which the target counts as reached."""
REACH_DEG = 30.0
"""Maximum angle in degrees between the tip's direction and the line from the tip to the aim in the target."""
REACH_S = 1.0
"""Time in s for which the tip must be at its position and point at the target for the target to count as reached."""
TARGET = "planned target"


@one_line
@dataclass(frozen=True, slots=True)
class TaskResult:
    """Result of a task."""

    completed_frame: int | None
    """Frame at which the task was completed; None if it was not."""
    steps_done: tuple[str, ...]
    """Steps of the task that were done, in their order."""
    num_steps: int
    num_wrong: int
    """Number of other segments visited, of other branches entered, or of touches of the kind ``pass``.

    Only those before the completion of the task count.
    """
    events: tuple[FlightEvent, ...]

    @property
    def completed(self) -> bool:
        """Whether the task was completed."""
        return self.completed_frame is not None

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain JSON types."""
        return {
            "completed": self.completed,
            "completed_s": None if self.completed_frame is None else self.completed_frame / FRAME_HZ,
            "steps_done": list(self.steps_done),
            "num_steps": self.num_steps,
            "num_wrong": self.num_wrong,
        }


def task_result(
    task: Task,
    tree: AirwayTree,
    *,
    sights: OpeningSights,
    task_openings: Sequence[tuple[str, list[int]]],
    visits: Sequence[Visit],
    segments: Sequence[CaseSegment],
    places: TipPlaces,
    contacts: Sequence[WallContact],
    first: int,
    last: int,
    frames: FlightFrames | None = None,
) -> TaskResult:
    """Return the result of a task between two frames.

    Parameters
    ----------
    task, tree
        The task, and the airways of the case.
    sights
        Openings in the frames of the flight.
    task_openings
        Name and indices of the openings of each landmark, or of the structure to hold.
    visits
        Visits of the segments.
    segments
        Segments of the case.
    places
        Branch of the tip at each frame.
    contacts
        Contacts with the wall.
    first, last
        Frames at which the clock starts and ends.
    frames
        Frames of the flight, for the kinds ``stations`` and ``reach``.
    """
    if task.kind == "stations" and frames is not None:
        return _located_stations(task, tree, frames, first, last)
    if task.kind == "reach" and frames is not None:
        return _reached(task, frames, first, last)
    if task.kind == "inspect":
        return _inspection(task, sights, task_openings, segments, visits)
    if task.kind in {"turns", "pass"}:
        touches = contacts if task.kind == "pass" else ()
        return _turns(task, tree, places, contacts=touches, first=first, last=last)
    if task.kind == "hold":
        name, openings = task_openings[0]
        held = np.any(sights.off_middle[:, openings] <= MIDDLE, axis=1)
        frame = first_run(held, task.hold_s or 0.0)
        events = () if frame is None else (_event(frame, "held", name), _event(frame, "completed", task.name))
        return TaskResult(frame, () if frame is None else (name,), 1, 0, events)
    return _sequence(task, visits, segments)


def _event(frame: int, kind: Any, name: str) -> FlightEvent:
    return FlightEvent(frame / FRAME_HZ, kind, name)


def _inspection(
    task: Task,
    sights: OpeningSights,
    landmarks: Sequence[tuple[str, list[int]]],
    segments: Sequence[CaseSegment],
    visits: Sequence[Visit],
) -> TaskResult:
    """Return the result of an inspection: the landmarks in their order, then all segments of the case visited.

    Visits before the last landmark do not count. The order of the segments is free; structured progress scores it.
    """
    events, done, after = [], [], -1
    for name, openings in landmarks:
        frame = next((at for at in _frames_in_sight(sights, openings) if at > after), None)
        if frame is None:
            break
        after = frame
        done.append(name)
        events.append(_event(frame, "landmark", name))
    visited: dict[int, int] = {}
    for visit in visits:
        if len(done) == len(landmarks) and visit.frame > after:
            visited.setdefault(visit.place, visit.frame)
    done += [segments[place].name for place in visited]
    complete = len(done) == len(landmarks) + len(segments)
    frame = max([after, *visited.values()]) if complete else None
    if frame is not None:
        events.append(_event(frame, "completed", task.name))
    return TaskResult(frame, tuple(done), len(landmarks) + len(segments), 0, tuple(events))


def _frames_in_sight(sights: OpeningSights, openings: Sequence[int]) -> list[int]:
    """Return the frames up to which all openings have been in sight together for :data:`SEEN_S` without a break."""
    together = np.all(sights.in_sight[:, list(openings)], axis=1)
    need = frames_of(SEEN_S)
    num_before = np.concatenate([[0], np.cumsum(together)])
    ends = np.arange(need, len(together) + 1)
    return [int(end) - 1 for end in ends[num_before[ends] - num_before[ends - need] == need]]


def _sequence(task: Task, visits: Sequence[Visit], segments: Sequence[CaseSegment]) -> TaskResult:
    """Return the segments that were visited in the order of the task, and the frame of the last one."""
    events: list[FlightEvent] = []
    done: list[str] = []
    wrong = 0
    for visit in visits:
        name = segments[visit.place].name
        if name == task.segments[len(done)]:
            done.append(name)
        elif name not in done:
            wrong += 1
            events.append(_event(visit.frame, "wrong-segment", name))
        if len(done) == len(task.segments):
            events.append(_event(visit.frame, "completed", task.name))
            return TaskResult(visit.frame, tuple(done), len(done), wrong, tuple(events))
    return TaskResult(None, tuple(done), len(task.segments), wrong, tuple(events))


def _turns(
    task: Task, tree: AirwayTree, places: TipPlaces, *, contacts: Sequence[WallContact], first: int, last: int
) -> TaskResult:
    """Return the result of a list of turns: the branches entered in their order.

    A branch is entered when the tip has been in it, or beyond it on the way to the last branch, for
    :data:`ENTERED_S` without a break. A branch is wrong if it is not on this way. Pieces of a bronchus between which
    only a twig leaves have one name and count as one branch. After a contact all steps must be done again, from the
    root branch on.
    """
    way = names_on_way(tree, task)
    names = {branch.id: label_of(branch) for branch in tree.branches}
    wanted = [bare_name(name) for name in task.branches]
    numbers = {name: n for n, name in enumerate(dict.fromkeys(names.values()))}
    by_number = {n: name for name, n in numbers.items()}
    at = np.array([numbers[names[int(one)]] for one in places.branch_ids[first : last + 1]], dtype=np.int64)
    for one in contacts:
        at[one.first_frame - first : one.last_frame - first + 1] = -1
    touched = [one.first_frame - first for one in contacts]
    events: list[FlightEvent] = []
    done: list[str] = []
    wrong, from_root = 0, True
    for frame, number in run_ends(at, ENTERED_S):
        while touched and touched[0] <= frame:
            touched.pop(0)
            done.clear()
            wrong, from_root = wrong + 1, False
        if number < 0:
            continue
        name = by_number[number]
        from_root = from_root or name == names[tree.root.id]
        if name not in way:
            wrong += 1
            events.append(_event(first + frame, "wrong-branch", name))
            continue
        while from_root and len(done) < len(wanted) and way.index(wanted[len(done)]) <= way.index(name):
            events.append(_event(first + frame, "entered", wanted[len(done)]))
            done.append(wanted[len(done)])
        if len(done) == len(wanted):
            events.append(_event(first + frame, "completed", task.name))
            return TaskResult(first + frame, tuple(done), len(done), wrong, tuple(events))
    return TaskResult(None, tuple(done), len(wanted), wrong, tuple(events))


def _located_stations(task: Task, tree: AirwayTree, frames: FlightFrames, first: int, last: int) -> TaskResult:
    """Return the stations located: tip near the landmark, and its upward direction towards the station.

    The transducer of an EBUS bronchoscope is on the side of upward flexion (general knowledge).
    """
    poses = frames.lps_from_tip[first : last + 1]
    found: list[tuple[int, str]] = []
    for name, landmarks in landmarks_of(tree, task).items():
        at = np.zeros(len(poses), dtype=bool)
        for one in landmarks:
            near = np.linalg.norm(poses[:, :3, 3] - np.array(one.point_lps), axis=1) <= STATION_MM
            at |= near & (-poses[:, :3, 1] @ np.array(one.direction_lps) >= np.cos(np.radians(STATION_DEG)))
        frame = first_run(at, STATION_S)
        if frame is not None:
            found.append((first + frame, name))
    found.sort()
    events = [_event(frame, "station", name) for frame, name in found]
    completed = found[-1][0] if len(found) == len(task.stations) else None
    if completed is not None:
        events.append(_event(completed, "completed", task.name))
    return TaskResult(completed, tuple(name for _, name in found), len(task.stations), 0, tuple(events))


def _reached(task: Task, frames: FlightFrames, first: int, last: int) -> TaskResult:
    """Return whether the tip was at its planned position and pointed at the target."""
    poses = frames.lps_from_tip[first : last + 1]
    ways = np.array(task.aim_lps) - poses[:, :3, 3]
    ahead = (ways * poses[:, :3, 2]).sum(axis=1) >= np.cos(np.radians(REACH_DEG)) * np.linalg.norm(ways, axis=1)
    near = np.linalg.norm(poses[:, :3, 3] - np.array(task.place_lps), axis=1) <= REACH_MM
    run = first_run(near & ahead, REACH_S)
    if run is None:
        return TaskResult(None, (), 1, 0, ())
    frame = first + run
    return TaskResult(frame, (TARGET,), 1, 0, (_event(frame, "reached", TARGET), _event(frame, "completed", task.name)))
