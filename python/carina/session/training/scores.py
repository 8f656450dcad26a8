"""Scores of recorded flights as values for the windows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from carina.case.document import Document
from carina.errors import CarinaError
from carina.session.state.training import (
    FlightScore,
    PublishedScores,
    ReferenceScores,
    ScoreMoment,
    SegmentVisit,
    TaskInfo,
    TimelineMark,
    UnmarkedMeasures,
)
from carina.session.training.planned_tasks import planned_task
from carina.track import AirwayTree
from carina.training import (
    REFERENCE_GROUPS,
    CaseSegment,
    FlightComparison,
    FlightEvent,
    FolderTasks,
    Score,
    Task,
    find_task,
    judge_mastery,
    segments_of_case,
    task_names,
)

LEVELS = ("beginner", "intermediate", "advanced")
MAX_MOMENTS = 3
_FAULTS = ("wrong-branch", "wrong-segment", "contact", "revisit")
"""Kinds of faults in a flight, the most serious ones first."""
_TIMELINE: dict[str, Literal["seen", "contact", "wrong", "revisit"]] = {
    "seen": "seen",
    "contact": "contact",
    "wrong-branch": "wrong",
    "wrong-segment": "wrong",
    "revisit": "revisit",
}
"""Kind of mark on the timeline, by kind of event."""
_FAULT_WORDS = {
    "wrong-branch": "wrong branch",
    "wrong-segment": "another segment",
    "contact": "wall contact",
    "revisit": "visited again",
}


def task_infos(document: Document, own: FolderTasks) -> tuple[TaskInfo, ...]:
    """Return the tasks of teachers, then the built-in tasks, the easiest first.

    Each task has the reason why the case is unsuitable for it.
    """
    tree = None if document.airways is None else document.airways.tree
    found = []
    for tasks, is_own in ((own.tasks, True), (tuple(map(find_task, task_names())), False)):
        for task in sorted(tasks, key=lambda task: (LEVELS.index(task.level), task.name)):
            found.append(_task_info(planned_task(task, document), tree, is_own=is_own))
    return tuple(found)


def _task_info(task: Task, tree: AirwayTree | None, *, is_own: bool) -> TaskInfo:
    problem = None if tree is not None else "wait for the airways"
    if tree is not None:
        try:
            task.check_case(tree)
        except CarinaError as error:
            problem = str(error)
        if problem is None and not segments_of_case(tree):
            problem = "no branch of this case has the name of a segment"
    return TaskInfo(
        task.name,
        task.title,
        task.level,
        task.time_limit_s,
        names_shown=task.names_shown,
        tree_shown="tree" in task.hints,
        ghost_shown="ghost" in task.hints,
        problem=problem,
        is_own=is_own,
    )


def flight_score(
    flight: int, score: Score, segments: Sequence[CaseSegment] = (), comparison: FlightComparison | None = None
) -> FlightScore:
    """Return the score of a flight for the windows.

    Parameters
    ----------
    flight
        Number of the flight.
    score
        Its score.
    segments
        Segments of the case, for the map of the tree.
    comparison
        Comparison with the expert's flight; None without one.
    """
    task, result = score.task, score.result
    return FlightScore(
        flight=flight,
        task=task.name,
        task_title=task.title,
        is_inspection=task.kind == "inspect",
        completed=result.completed,
        num_steps_done=len(result.steps_done),
        num_steps=result.num_steps,
        num_wrong=result.num_wrong,
        published=PublishedScores(
            num_seen=score.diagnostic_completeness,
            num_progressions=score.structured_progress,
            time_s=score.procedure_time_s,
            time_per_segment_s=score.mean_intersegmental_time_s,
            num_revisited=score.segments_revisited,
        ),
        unmarked=UnmarkedMeasures(
            path_mm=score.path_length_mm,
            smoothness=score.smoothness,
            num_contacts=len(score.contacts),
            contact_s=score.contact_time_s,
            red_out_s=score.red_out_s,
            middle_share=score.lumen_in_middle,
        ),
        seen=score.segments_seen,
        not_seen=tuple(name for name in score.case_segments if name not in score.segments_seen),
        absent=score.segments_absent,
        doubts=tuple(one.words for one in score.doubts),
        notes=score.notes,
        moments=worst_moments(score),
        segments=_segment_visits(score, segments),
        timeline=tuple(
            TimelineMark(one.time_s, _TIMELINE[one.kind], one.name) for one in score.events if one.kind in _TIMELINE
        ),
        clock_start_s=score.clock_start_s,
        clock_end_s=score.clock_end_s,
        comparison=() if comparison is None else comparison.lines(),
        comparison_moments=() if comparison is None else high_error_moments(comparison),
    )


def _segment_visits(score: Score, segments: Sequence[CaseSegment]) -> tuple[SegmentVisit, ...]:
    """Return when and how each segment of the case was seen."""
    seen = {one.name: one.time_s for one in score.events if one.kind == "seen"}
    entered = {one.name for one in score.events if one.kind in {"visit", "revisit"} and one.detail == "entered"}
    return tuple(
        SegmentVisit(one.name, one.branch_ids, seen.get(one.name), entered=one.name in entered) for one in segments
    )


def worst_moments(score: Score) -> tuple[ScoreMoment, ...]:
    """Return at most three moments to replay, in the order of time: wrong branches first, then long contacts."""
    lasted = {one.time_s: one.duration_s for one in score.contacts}

    def seriousness(event: FlightEvent) -> tuple[int, float]:
        return _FAULTS.index(event.kind), -lasted.get(event.time_s, 0.0)

    faults = sorted((one for one in score.events if one.kind in _FAULTS), key=seriousness)[:MAX_MOMENTS]
    return tuple(
        ScoreMoment(one.time_s, _moment_words(one, lasted)) for one in sorted(faults, key=lambda one: one.time_s)
    )


def _moment_words(event: FlightEvent, lasted: dict[float, float]) -> str:
    words = f"{_FAULT_WORDS[event.kind]}: {event.name}"
    if event.kind == "contact":
        words += f", {event.detail}, {lasted.get(event.time_s, 0.0):.1f} s"
    return words


def high_error_moments(comparison: FlightComparison) -> tuple[ScoreMoment, ...]:
    """Return at most three high-error events to replay, in the order of time: those with the largest deviations."""
    worst = sorted(comparison.high_error_events, key=lambda one: -one.worst_mm)[:MAX_MOMENTS]
    return tuple(
        ScoreMoment(one.start_s, f"high-error event: {one.branch}, up to {one.worst_mm:.1f} mm, {one.duration_s:.1f} s")
        for one in sorted(worst, key=lambda one: one.start_s)
    )


def verdict_words(scores: Sequence[Score]) -> str | None:
    """Return the verdict on mastery over the inspections among scores, in their order; None without one."""
    inspections = [one for one in scores if one.task.kind == "inspect"]
    return judge_mastery(inspections).words if inspections else None


def references() -> tuple[ReferenceScores, ...]:
    """Return the published values of groups, for comparison."""
    return tuple(
        ReferenceScores(
            group=one.group,
            num_seen=float(one.diagnostic_completeness),
            num_progressions=float(one.structured_progress),
            time_s=float(one.procedure_time_s),
            time_per_segment_s=float(one.mean_intersegmental_time_s),
            source=one.source,
        )
        for one in REFERENCE_GROUPS
    )
