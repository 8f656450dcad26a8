"""The command that scores recorded flights."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carina.cli.console import exit_codes
from carina.cli.options import CtOption, JsonOption, PathArgument, SeriesOption, StrictOption


def _list_tasks(wanted: bool) -> None:
    if wanted:
        from carina.cli.score import print_tasks

        print_tasks()
        raise typer.Exit


def score(
    recording: Annotated[
        Path, typer.Argument(help="Recording of the attempt: a file, or its name or number in the case.")
    ],
    path: PathArgument,
    task: Annotated[
        str | None,
        typer.Option(
            "--task",
            help="Task of the attempt: name of a built-in task, or a task file. Default: the task that the recording "
            "states, or else inspect-all.",
        ),
    ] = None,
    earlier: Annotated[
        list[Path] | None,
        typer.Option(
            "--earlier",
            help="Recording of an earlier attempt, the oldest first; may be given several times. A verdict on mastery "
            "needs six attempts.",
        ),
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(
            "--log", help="Folder for the log: events.csv, poses.csv, scores.csv, and xAPI statements in xapi.json."
        ),
    ] = None,
    learner: Annotated[
        str | None, typer.Option("--learner", help="Pseudonym of the learner in the xAPI statements.")
    ] = None,
    expert: Annotated[
        Path | None,
        typer.Option("--expert", help="Recording of an expert's flight in the same case, to compare with by place."),
    ] = None,
    list_tasks: Annotated[
        bool,
        typer.Option("--list-tasks", help="List the built-in tasks and exit.", callback=_list_tasks, is_eager=True),
    ] = False,
    series: SeriesOption = None,
    strict: StrictOption = False,
    ct: CtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Score a recorded flight by the published measures of training in bronchoscopy.

    Example: carina score flight.jsonl scan/

    Example: carina score flight.jsonl scan/ --task sequence-rb4-rb6 --log flight-log/
    """
    with exit_codes(as_json):
        from carina.cli.score import report

        raise SystemExit(
            report(
                recording,
                path,
                task=task,
                earlier=tuple(earlier or ()),
                log=log,
                learner=learner,
                expert=expert,
                series=series,
                strict=strict,
                ct=ct,
                as_json=as_json,
            )
        )


def course(
    learner: Annotated[
        str | None, typer.Argument(help="Pseudonym of a learner. Default: all learners of this machine.")
    ] = None,
    export: Annotated[
        Path | None,
        typer.Option("--export", help="Folder for the attempts: attempts.csv, and xAPI statements in xapi.json."),
    ] = None,
    delete: Annotated[
        bool, typer.Option("--delete", help="Delete the learner with all attempts, after the export.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation of the deletion.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List the learners of this machine; print, export or delete the attempts of one.

    Example: carina course

    Example: carina course "Blue heron" --export blue-heron/
    """
    with exit_codes(as_json):
        from carina.cli.course import report

        raise SystemExit(report(learner, export=export, delete=delete, yes=yes, as_json=as_json))
