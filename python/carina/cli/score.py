"""``carina score``: the published scores of a recorded flight, and the verdict over several attempts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import carina
from carina.cli.arguments import check_needs, check_output_folder
from carina.cli.case import open_case_recording
from carina.cli.console import print_json, print_note, print_result, progress_printer
from carina.cli.opened import check_case_options, check_scan_exists, open_input
from carina.config import load_settings
from carina.training import (
    REFERENCE_GROUPS,
    SEGMENTS,
    Mastery,
    Score,
    Task,
    TaskFolder,
    compare_flights,
    find_task,
    flight_frames,
    judge_mastery,
    score_flight,
    task_names,
    task_of_flight,
    write_flight_log,
)
from carina.training.handling import hour_text
from carina.training.mastery import IN_A_ROW_RULE, MASTERY_SOURCE, NOT_COMPARABLE

MAX_CONTACT_LINES = 10
"""Number of wall contacts that are printed; further contacts are only counted."""


def print_tasks() -> None:
    """Print the name and the title of each built-in task and of each task in the folder of tasks."""
    own = TaskFolder(load_settings().tasks_dir)
    found = own.read()
    tasks = [*map(find_task, task_names()), *found.tasks]
    width = max(len(task.name) for task in tasks)
    print_result(*(f"{task.name:{width}}  {task.title}" for task in tasks))
    print_note(f"your own tasks are files in {own.folder}")
    for problem in found.problems:
        print_note(problem)


def _named_task(wanted: str) -> Task:
    """Return a task of the folder of tasks by its name, or else a built-in task or the task in a file."""
    own = TaskFolder(load_settings().tasks_dir).read().tasks
    return next((task for task in own if task.name == wanted), None) or find_task(wanted)


def report(
    recording: Path,
    path: Path,
    *,
    task: str | None,
    earlier: Sequence[Path],
    log: Path | None,
    learner: str | None,
    expert: Path | None,
    series: str | None,
    strict: bool,
    ct: Path | None,
    as_json: bool,
) -> int:
    """Score the recording and all earlier ones, and print the scores, the verdict and the reference values."""
    check_case_options(path, ct)
    if log is None:
        check_needs("the log (--log)", learner=learner)
    else:
        check_output_folder(log)
    chosen = None if task is None else _named_task(task)
    check_scan_exists(path)
    flights = [open_case_recording(path, one) for one in (*earlier, recording)]
    reference = None if expert is None else open_case_recording(path, expert)
    chosen = task_of_flight(flights[-1]) if chosen is None else chosen
    progress = progress_printer()
    source = open_input(path, series=series, strict=strict, progress=progress, ct=ct)
    for one in flights if reference is None else (*flights, reference):
        one.check_scan(source.volume)
    airways = source.airways(progress)
    chosen.check_case(airways.tree)
    source.badges.add(getattr(airways, "badges", ()))
    wall = carina.wall_field(source.volume, airways, progress=progress)
    scores = [score_flight(airways.tree, wall, flight_frames(one), chosen, progress=progress) for one in flights]
    score, mastery = scores[-1], judge_mastery(scores)
    comparison = None
    if reference is not None:
        other = score_flight(airways.tree, wall, flight_frames(reference), chosen, progress=progress)
        comparison = compare_flights(airways.tree, score, other)
    if log is not None:
        for file in write_flight_log(log, score, learner=learner or "learner"):
            print_note(f"wrote {file}")
    if as_json:
        print_json(
            {
                **score.to_json(),
                "mastery": mastery.to_json(),
                "comparison": None if comparison is None else comparison.to_json(),
                "references": [one.to_json() for one in REFERENCE_GROUPS],
                "badges": source.badges.to_json(),
            }
        )
    else:
        print_result(*score_lines(score), "", *mastery_lines(score, mastery))
        if comparison is not None:
            print_result("", "Compared with the expert's flight, by place", *comparison.lines())
    return 0


def score_lines(score: Score) -> list[str]:
    """Return the scores as lines of text."""
    task, result = score.task, score.result
    mean = score.mean_intersegmental_time_s
    done = "completed" if result.completed else f"not completed, {len(result.steps_done)} of {result.num_steps} steps"
    if task.kind == "inspect" and not result.completed:
        done += _unvisited_text(score)
    missing = [name for name in score.case_segments if name not in score.segments_seen]
    lines = [
        f"task                      {task.title}: {done}",
        f"diagnostic completeness   {score.diagnostic_completeness} of {len(SEGMENTS)} segments; this case has "
        f"{score.num_case_segments}",
        f"structured progress       {score.structured_progress} of {score.num_case_segments}; a return "
        f"{'breaks the sequence' if task.revisit_rule == 'breaks' else 'is ignored'}",
        f"procedure time            {score.procedure_time_s:.1f} s; the clock starts "
        f"{'below the cords' if task.clock == 'cords' else 'at the main carina'}",
        f"mean intersegmental time  {'-' if mean is None else f'{mean:.1f} s'}",
        f"segments revisited        {score.segments_revisited}",
        f"not seen                  {', '.join(missing) or 'none'}",
        "",
        "Without a mark (no threshold is published):",
        f"path of the tip           {score.path_length_mm:.0f} mm",
        f"smoothness of the path    {'-' if score.smoothness is None else f'{score.smoothness:.1f}'} (larger is "
        "smoother)",
        f"wall contacts             {len(score.contacts)}, {score.contact_time_s:.1f} s; recordings contain no force",
        f"red-out                   {score.red_out_s:.1f} s",
        f"lumen in the middle       {100.0 * score.lumen_in_middle:.0f} % of the time",
    ]
    if result.num_wrong:
        lines.insert(1, f"wrong places              {result.num_wrong}")
    lines += [
        f"contact at {one.time_s:6.1f} s       {one.branch}, {hour_text(one.clock_hour)}, {one.duration_s:.1f} s"
        for one in score.contacts[:MAX_CONTACT_LINES]
    ]
    if len(score.contacts) > MAX_CONTACT_LINES:
        lines.append(f"and {len(score.contacts) - MAX_CONTACT_LINES} more contacts; --json lists all of them")
    lines += [f"note: {note}" for note in score.notes]
    doubt = "this attempt does not count in a verdict" if task.kind == "inspect" else "doubt about this attempt"
    lines += [f"{doubt}: {one.words}" for one in score.doubts]
    return lines


def _unvisited_text(score: Score) -> str:
    """Return the text that names the segments that were seen but not visited; empty if there are none."""
    names = [name for name in score.segments_seen if name not in score.result.steps_done]
    after = " after the landmarks" if score.task.order == "landmarks" else ""
    return f"; seen but not visited{after}: {', '.join(names)}" if names else ""


def mastery_lines(score: Score, mastery: Mastery) -> list[str]:
    """Return the verdict and the published reference values as lines of text; none for other tasks."""
    if score.task.kind != "inspect":
        return []
    lines = [mastery.words, f"definition: {mastery.to_json()['definition']} ({MASTERY_SOURCE}); {IN_A_ROW_RULE}", ""]
    lines += [
        f"{one.group:20} {one.diagnostic_completeness:2.0f} segments, {one.structured_progress:2.0f} progressions, "
        f"{one.procedure_time_s:3.0f} s, {one.mean_intersegmental_time_s:2.0f} s per segment"
        for one in REFERENCE_GROUPS
    ]
    return [*lines, f"Source of these values: {REFERENCE_GROUPS[0].source}; {NOT_COMPARABLE}."]
