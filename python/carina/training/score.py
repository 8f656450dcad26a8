"""Score of a recorded flight: the published scores, the measures beside them, and the events of the flight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import check_arguments, file_path, instance, name_or
from carina.display import one_line
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import NoResultError
from carina.navigate import Recording, open_recording
from carina.scopes import WallField
from carina.track import Airways, AirwayTree, wall_field
from carina.track.names.name_texts import MIRRORED
from carina.training.attempt_checks import AttemptDoubt, attempt_doubts
from carina.training.events import FlightEvent
from carina.training.flight_frames import FRAME_HZ, FlightFrames, flight_frames
from carina.training.handling import (
    OUTSIDE_MM,
    CentrelineIndex,
    TipPlaces,
    WallContact,
    hour_text,
    path_length_mm,
    smoothness,
    tip_places,
    wall_contacts,
)
from carina.training.openings_in_sight import OpeningSights, branch_openings, clear_views, openings_in_sight
from carina.training.segment_entries import entries_of, openings_entered, openings_passed
from carina.training.segments import (
    LANDMARKS,
    SEGMENTS,
    CaseSegment,
    is_mirrored,
    needed_branches,
    published_segments,
    segments_of_case,
)
from carina.training.task import Clock, Task
from carina.training.task_file import DEFAULT_TASK, find_task, task_from_json
from carina.training.task_steps import TaskResult, task_result
from carina.training.visits import Visit, places_seen, progress_steps, revisits_of, visits_of
from carina.volume import Volume


@one_line
@dataclass(frozen=True, slots=True)
class ScoredContact:
    """Wall contact of a score."""

    time_s: float
    """Time of the first touch from the start of the recording, s."""
    duration_s: float
    branch: str
    """Name of the branch in which the tip was."""
    place_lps: tuple[float, float, float]
    """Position of the tip at the contact, LPS mm."""
    clock_hour: float
    """Clock hour in the picture of the touched wall, 12 at the top."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """Scores of one attempt; docs/training.md defines each of them and names its source."""

    task: Task
    diagnostic_completeness: int
    """DC: number of segments seen, 0 to 18."""
    case_segments: tuple[str, ...]
    """Published segments that have a named branch in the case; their number is reported beside the maximum of 18."""
    segments_absent: tuple[str, ...]
    """Segments of the 18 without a named branch in the case."""
    structured_progress: int
    """SP: number of moves from one segment to the next in ascending order, 0 to 18."""
    procedure_time_s: float
    """PT: time from the start of the clock to the end of the attempt, s."""
    mean_intersegmental_time_s: float | None
    """MIT: procedure time divided by the number of segments seen, s; None if no segment was seen."""
    segments_revisited: int
    """Number of entries into a segment that the tip had entered and left before."""
    segments_seen: tuple[str, ...]
    """Seen segments, in the order in which they were seen."""
    path_length_mm: float
    smoothness: float | None
    """Minus the logarithm of the dimensionless jerk of the tip's path; larger is smoother."""
    contacts: tuple[ScoredContact, ...] = field(repr=False)
    contact_time_s: float
    """Total duration of the contacts, s."""
    red_out_s: float
    """Time in s during which the lens was so near to the wall that the picture was red."""
    lumen_in_middle: float
    """Share of the procedure time, 0 to 1, with the lumen in the middle of the picture."""
    result: TaskResult
    """Result of the task."""
    doubts: tuple[AttemptDoubt, ...]
    """Reasons why the attempt does not count in a verdict; empty if it counts."""
    notes: tuple[str, ...]
    """Texts on the case and the recording that the user should know."""
    events: tuple[FlightEvent, ...] = field(repr=False)
    """Events of the flight in the order of time."""
    frames: FlightFrames = field(repr=False)
    """Frames of the flight on which the scores were computed."""
    clock_start_s: float
    """Time at which the clock started, from the start of the recording, s."""
    clock_end_s: float

    @property
    def num_case_segments(self) -> int:
        """Number of the published segments that the tree of the case contains."""
        return len(self.case_segments)

    def to_json(self) -> dict[str, Any]:
        """Return the scores and events as plain JSON types."""
        return {
            "format": "carina-score",
            "version": 1,
            "task": self.task.name,
            "published": {
                "diagnostic_completeness": self.diagnostic_completeness,
                "num_segments": len(SEGMENTS),
                "num_case_segments": self.num_case_segments,
                "structured_progress": self.structured_progress,
                "revisit_rule": self.task.revisit_rule,
                "procedure_time_s": self.procedure_time_s,
                "clock": self.task.clock,
                "mean_intersegmental_time_s": self.mean_intersegmental_time_s,
                "segments_revisited": self.segments_revisited,
            },
            "without_mark": {
                "path_length_mm": self.path_length_mm,
                "smoothness": self.smoothness,
                "num_contacts": len(self.contacts),
                "contact_time_s": self.contact_time_s,
                "contact_force_n": None,
                "red_out_s": self.red_out_s,
                "lumen_in_middle": self.lumen_in_middle,
            },
            "segments_seen": list(self.segments_seen),
            "segments_not_seen": [name for name in self.case_segments if name not in self.segments_seen],
            "segments_absent": list(self.segments_absent),
            "contacts": [
                {
                    "time_s": one.time_s,
                    "duration_s": one.duration_s,
                    "branch": one.branch,
                    "place_lps": list(one.place_lps),
                    "clock_hour": one.clock_hour,
                }
                for one in self.contacts
            ],
            "result": self.result.to_json(),
            "counts_in_verdict": not self.doubts,
            "doubts": [one.to_json() for one in self.doubts],
            "notes": list(self.notes),
            "clock_start_s": self.clock_start_s,
            "clock_end_s": self.clock_end_s,
            "events": [one.to_json() for one in self.events],
        }


@shows_progress
@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    airways=instance(Airways, "get airways from carina.find_airways"),
    recording=file_path(also=Recording),
    task=name_or((Task, Path), "name one of carina.training.task_names", optional=True),
    wall=instance(WallField, "make one with carina.wall_field", optional=True),
)
def score_recording(
    volume: Volume,
    airways: Airways,
    recording: Recording | str | Path,
    *,
    task: Task | str | Path | None = None,
    wall: WallField | None = None,
    progress: ProgressChoice = None,
) -> Score:
    """Score a recorded flight, as the window does.

    Parameters
    ----------
    volume, airways
        The CT of the recording, and its airways with names.
    recording
        Recording of one attempt (`carina.navigate.open_recording`), or its file.
    task
        Task of the attempt: name of a built-in task, file of a task, or `carina.training.Task`. None takes the task
        that the recording states, or else ``inspect-all``.
    wall
        Distance to the wall of the airways; computed if None.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.

    Returns
    -------
    Score
        Published scores, measures without a mark, and the events of the flight.

    Raises
    ------
    UsageError
        ``training.task``: if the task is unknown or its file is invalid.
    VolumeImportError
        ``navigate.recording``: if the recording is invalid or belongs to another scan.
    NoResultError
        ``training.no-branch``: if the case lacks a branch of the task. ``training.no-segments``: if no branch has the
        name of a segment. ``training.not-started``: if the tip is never in the airways.

    Examples
    --------
    >>> import carina
    >>> carina.training.find_task("find-rb6").segments
    ('RB6',)
    >>> score = carina.score_recording(volume, airways, "flight.jsonl", task="find-rb6")  # doctest: +SKIP
    >>> score.procedure_time_s  # doctest: +SKIP
    26.4
    """
    flown = recording if isinstance(recording, Recording) else open_recording(recording)
    chosen = task if isinstance(task, Task) else task_of_flight(flown) if task is None else find_task(task)
    flown.check_scan(volume)
    chosen.check_case(airways.tree)
    field_of_wall = wall_field(volume, airways, progress=progress) if wall is None else wall
    return score_flight(airways.tree, field_of_wall, flight_frames(flown), chosen, progress=progress)


def task_of_flight(recording: Recording) -> Task:
    """Return the task that a recording states, or the inspection of all segments if it states none.

    Raises
    ------
    UsageError
        ``training.task``: if the stated task is invalid.
    """
    stated = recording.task
    return find_task(DEFAULT_TASK) if stated is None else task_from_json(stated, "the recording")


def score_flight(
    tree: AirwayTree, wall: WallField, frames: FlightFrames, task: Task, *, progress: ProgressChoice = None
) -> Score:
    """Score the frames of a flight; see `score_recording`."""
    return FlightScorer(tree, wall, task).score(frames, progress=progress)


class FlightScorer:
    """Scorer of a flight, also while it grows: openings in sight and branches are computed once for each frame.

    Parameters
    ----------
    tree, wall
        Airways of the case, and their wall.
    task
        Task of the attempt.

    Raises
    ------
    NoResultError
        ``training.no-branch``, ``training.turns``: if the case is unsuitable for the task. ``training.no-segments``:
        if no branch has the name of a segment.
    """

    def __init__(self, tree: AirwayTree, wall: WallField, task: Task) -> None:
        task.check_case(tree)
        segments = segments_of_case(tree)
        if not segments:
            raise NoResultError(
                f"task {task.name}: the airways of this case: expected branches named RB1 to LB10; found none; choose "
                "another case, or name the segments in the window",
                code="training.no-segments",
            )
        self._tree, self._wall, self._task, self._segments = tree, wall, task, segments
        self._openings = _Openings(tree, wall, task, segments)
        self._known: OpeningSights | None = None
        self._index = CentrelineIndex(tree)
        self._known_places: TipPlaces | None = None

    def __repr__(self) -> str:
        """Return the name of the task and the number of frames whose openings are known."""
        known = 0 if self._known is None else len(self._known.in_sight)
        return f"FlightScorer({self._task.name!r}, {known} frames)"

    def score(self, frames: FlightFrames, *, progress: ProgressChoice = None) -> Score:
        """Score the frames of a flight.

        Parameters
        ----------
        frames
            Frames of the flight. In a second call they must begin with the frames of the call before.
        progress
            As in `score_recording`.

        Raises
        ------
        NoResultError
            ``training.not-started``: if the tip is never in the airways.
        """
        report = progress_function(progress)
        tree, wall, task, segments, openings_of = self._tree, self._wall, self._task, self._segments, self._openings
        places = self._known_places = tip_places(frames, self._index, self._known_places)
        wall_mm = wall.distance_mm(frames.lps_from_tip[:, :3, 3])
        first = clock_start(tree, frames, places, wall_mm, task.clock)
        last = len(wall_mm) - 1
        timed_out = False
        if task.time_limit_s is not None and last - first > task.time_limit_s * FRAME_HZ:
            last, timed_out = first + int(task.time_limit_s * FRAME_HZ), True
        sights = self._sights(frames, first, last, report)
        of_segments = openings_of.openings[: openings_of.num_of_segments]
        passed = openings_passed(frames.lps_from_tip[:, :3, 3], places.branch_ids, tree, of_segments)
        passed[:first] = passed[last + 1 :] = -1
        clear = clear_views(frames, wall)
        place_of = [place for place, openings in enumerate(openings_of.segments) for _ in openings]
        by_opening = entries_of(passed, clear, [[k] for k in range(len(of_segments))])
        # The first entry into each part of a segment whose parts arise separately is not a revisit.
        entries, again = (
            [replace(one, place=place_of[one.place]) for one in found]
            for found in (by_opening, revisits_of(by_opening))
        )
        visits = visits_of(sights, openings_of.segments, entries)
        result = task_result(
            task,
            tree,
            sights=sights,
            task_openings=openings_of.task_openings,
            visits=visits,
            segments=segments,
            places=places,
            frames=frames,
            contacts=wall_contacts(frames, wall, places, first=first, last=last)[0] if task.kind == "pass" else (),
            first=first,
            last=last,
        )
        if result.completed_frame is not None and task.kind != "inspect":
            last, timed_out = result.completed_frame, False
            visits = [visit for visit in visits if visit.frame <= last]
            again = [entry for entry in again if entry.frame <= last]
        contacts, red = wall_contacts(frames, wall, places, first=first, last=last)
        segment_ids = [one for part in segments for one in part.branch_ids]
        doubts = attempt_doubts(
            frames, wall, task, tree, segment_ids, branch_ids=places.branch_ids, first=first, last=last
        )
        seen = [
            (frame, segments[n].name)
            for n, frame in enumerate(
                places_seen(sights, openings_of.segments, openings_entered(passed, clear, len(of_segments)))
            )
            if frame is not None and frame <= last
        ]
        steps = progress_steps(visits, task.revisit_rule)
        time_s = (last - first) / FRAME_HZ
        tips = frames.lps_from_tip[first : last + 1, :3, 3]
        names = {branch.id: branch.name or f"branch {branch.id}" for branch in tree.branches}
        scored = tuple(_scored_contact(one, names) for one in contacts)
        events = [
            FlightEvent(first / FRAME_HZ, "clock-start", task.clock),
            *(FlightEvent(frame / FRAME_HZ, "seen", name) for frame, name in seen),
            *_visit_events(visits, steps, again, segments),
            *(FlightEvent(one.time_s, "contact", one.branch, hour_text(one.clock_hour)) for one in scored),
            *(one for one in result.events if one.time_s <= last / FRAME_HZ),
            *(FlightEvent(one.time_s, "doubt", one.code) for one in doubts if one.time_s is not None),
            FlightEvent(last / FRAME_HZ, "clock-end", "time limit" if timed_out else "end of the attempt"),
        ]
        absent = tuple(name for name in published_segments(tree) if name not in {one.name for one in segments})
        order = {"clock-start": 0, "clock-end": 2}
        return Score(
            task=task,
            diagnostic_completeness=len(seen),
            case_segments=tuple(one.name for one in segments),
            segments_absent=absent,
            structured_progress=len(steps),
            procedure_time_s=time_s,
            mean_intersegmental_time_s=time_s / len(seen) if seen else None,
            segments_revisited=len(again),
            segments_seen=tuple(name for _, name in sorted(seen, key=lambda one: one[0])),
            path_length_mm=path_length_mm(tips),
            smoothness=smoothness(tips),
            contacts=scored,
            contact_time_s=sum(one.duration_s for one in scored),
            red_out_s=int(red[first:last].sum()) / FRAME_HZ,
            lumen_in_middle=float(places.lumen_in_middle[first : last + 1].mean()),
            result=result,
            doubts=doubts,
            notes=(*_case_notes(tree, absent, segment_ids), *_flight_notes(frames, task)),
            events=tuple(sorted(events, key=lambda one: (one.time_s, order.get(one.kind, 1)))),
            frames=frames,
            clock_start_s=first / FRAME_HZ,
            clock_end_s=last / FRAME_HZ,
        )

    def _sights(
        self, frames: FlightFrames, first: int, last: int, report: Callable[[str, float | None], None] | None
    ) -> OpeningSights:
        """Return the openings in sight in frames ``first`` to ``last``; frames of earlier calls are cached."""
        known = self._known
        begin = first if known is None else max(first, len(known.in_sight))
        found = openings_in_sight(
            frames,
            self._openings.openings,
            self._wall,
            first=begin,
            last=last,
            report=None if report is None else lambda share: report("scoring the flight", share),
        )
        if known is not None:
            found.in_sight[: len(known.in_sight)] = known.in_sight
            found.off_middle[: len(known.in_sight)] = known.off_middle
        self._known = found
        return found


class _Openings:
    """Openings of the segments of a case and of the structures of a task."""

    def __init__(self, tree: AirwayTree, wall: WallField, task: Task, segments: tuple[CaseSegment, ...]) -> None:
        ids: list[int] = []

        def index_of(branch_id: int) -> int:
            if branch_id not in ids:
                ids.append(branch_id)
            return ids.index(branch_id)

        self.segments = [[index_of(one) for one in segment.branch_ids] for segment in segments]
        """Indices of the openings of each segment."""
        self.num_of_segments = len(ids)
        """Number of openings of segments; in ``openings`` they precede the openings of the task's structures."""
        self.task_openings: list[tuple[str, list[int]]] = []
        """Names and opening indices of the landmarks, or of the structure to keep in the middle."""
        wanted = LANDMARKS if task.kind == "inspect" and task.order == "landmarks" else ()
        if task.structure is not None:
            wanted = ((task.structure, (task.structure,)),)
        for title, names in wanted:
            branches = needed_branches(tree, names, task=task.name)
            self.task_openings.append((title, [index_of(one.id) for one in branches]))
        self.openings = branch_openings(tree, ids, wall)


def clock_start(
    tree: AirwayTree, frames: FlightFrames, places: TipPlaces, wall_mm: NDArray[np.float64], clock: Clock
) -> int:
    """Return the index of the frame at which the clock starts.

    ``cords``: the first frame with the tip in the airways. ``carina``: the first frame with the tip in the airways and
    less than the trachea's diameter above its end, or beyond it.

    Raises
    ------
    NoResultError
        ``training.not-started``: if there is no such frame.
    """
    inside = wall_mm > OUTSIDE_MM
    if clock == "carina":
        root = tree.root
        reach_mm = 2.0 * float(np.median(root.radius))
        near = np.linalg.norm(frames.lps_from_tip[:, :3, 3] - root.points[-1], axis=1) <= reach_mm
        inside &= near | (places.branch_ids != root.id)
    found = np.flatnonzero(inside)
    if not len(found):
        where = "in the airways" if clock == "cords" else "at the main carina or beyond"
        raise NoResultError(
            f"score: the recording: expected a tip that is {where} at some time; found none; record the flight from "
            "the trachea on, in the case whose airways are scored",
            code="training.not-started",
        )
    return int(found[0])


def _visit_events(
    visits: list[Visit], steps: list[Visit], again: list[Visit], segments: tuple[CaseSegment, ...]
) -> list[FlightEvent]:
    """Return the events of visits, progressions and revisits; a visit that is a revisit has one event."""
    found = []
    for visit in sorted({*visits, *again}, key=lambda one: one.frame):
        at_s, name = visit.frame / FRAME_HZ, segments[visit.place].name
        detail = "entered" if visit.entered else "opening in view"
        found.append(FlightEvent(at_s, "revisit" if visit in again else "visit", name, detail))
        if visit in steps:
            found.append(FlightEvent(at_s, "progress", name))
    return found


def _scored_contact(contact: WallContact, names: dict[int, str]) -> ScoredContact:
    return ScoredContact(
        contact.first_frame / FRAME_HZ,
        (contact.last_frame - contact.first_frame + 1) / FRAME_HZ,
        names[contact.branch_id],
        contact.place_lps,
        contact.clock_hour,
    )


def _case_notes(tree: AirwayTree, absent: tuple[str, ...], segment_ids: list[int]) -> list[str]:
    found = []
    if is_mirrored(tree):
        found += [note.words for note in tree.notes if note.code == MIRRORED]
        found.append(
            "the segments of the scores are the mirror image of the published list: LB1 to LB10, RB1+2 to RB10"
        )
    if absent:
        num = len(SEGMENTS) - len(absent)
        found.append(
            f"this case has {num} of the {len(SEGMENTS)} segments; no branch has the name {' or '.join(absent)} "
            "(absent, not found or not named)"
        )
    by_person = [one.name for one in tree.branches if one.id in segment_ids and one.name_from == "person" and one.name]
    if by_person:
        found.append(f"a person has given or confirmed the names of these branches: {', '.join(by_person)}")
    return found


def _flight_notes(frames: FlightFrames, task: Task) -> tuple[str, ...]:
    found = []
    used = [frames.optics[n] for n in sorted(set(frames.optics_number.tolist()))]
    for one in used:
        if one.is_wider:
            found.append(
                f"the recorded picture was {one.fov_deg:.0f} degrees wide; only the {one.scope.usual_fov_deg:.0f} "
                f"degrees of the instrument {one.scope.name} count"
            )
    breaths = [one.breathing.words for _, one in frames.motions if one is not None]
    found += [f"{words}; positions and movements of the tip are those in the CT at rest" for words in breaths]
    if task.scope is None and any(one.is_free_camera for one in used):
        found.append("the flight used a camera without an instrument; the size of the generic scope counts")
    return tuple(dict.fromkeys(found))
