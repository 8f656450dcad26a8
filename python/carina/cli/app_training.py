"""The commands of training: scores of recorded flights, and nodules that are inserted into a CT."""

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
    add: Annotated[
        bool, typer.Option("--add", help="Add a learner with this pseudonym; do not use a real name.")
    ] = False,
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
    """List the learners of this machine; add one; print, export or delete the attempts of one.

    Example: carina course

    Example: carina course "Blue heron" --add

    Example: carina course "Blue heron" --export blue-heron/
    """
    with exit_codes(as_json):
        from carina.cli.course import report

        raise SystemExit(report(learner, add=add, export=export, delete=delete, yes=yes, as_json=as_json))


def insert(
    path: PathArgument,
    output: Annotated[Path, typer.Option("-o", "--output", help="Marked CT to write: .nii.gz, .nii, .nrrd or .mha.")],
    at: Annotated[
        str, typer.Option("--at", help="Centre of the nodule, x,y,z in mm (LPS), or auto for a free position by seed.")
    ] = "auto",
    kind: Annotated[str, typer.Option("--kind", help="solid, part-solid or ground-glass.")] = "solid",
    diameter_mm: Annotated[
        float, typer.Option("--diameter-mm", help="Diameter of the ball of equal volume, 4 to 30 mm.")
    ] = 10.0,
    core_mm: Annotated[
        float | None,
        typer.Option("--core-mm", help="Diameter of the core of a part-solid nodule (default: half the diameter)."),
    ] = None,
    density_hu: Annotated[
        float | None, typer.Option("--density-hu", help="Density in HU (default: 30 solid, -600 ground glass).")
    ] = None,
    spiculation: Annotated[
        float, typer.Option("--spiculation", help="0 for a ball, up to 1 for lobes and spicules.")
    ] = 0.0,
    seed: Annotated[
        int, typer.Option("--seed", help="Seed of the shape, of the noise and of the free position.", min=0)
    ] = 0,
    through_vessels: Annotated[
        bool, typer.Option("--through-vessels", help="Allow a nodule that overlaps vessels.")
    ] = False,
    truth: Annotated[Path | None, typer.Option("--truth", help="File to write with the exact nodule: .json.")] = None,
    series: SeriesOption = None,
    strict: StrictOption = False,
    ct: CtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Insert a nodule into a CT for training. Every result of the new CT states that it is *inserted*.

    Example: carina insert scan/ -o training.nii.gz --kind part-solid --diameter-mm 14 --seed 3
    """
    with exit_codes(as_json):
        from carina.cli.arguments import parse_point
        from carina.cli.insert import report

        raise SystemExit(
            report(
                path,
                output=output,
                at_lps=None if at == "auto" else parse_point(at, "--at"),
                kind=kind,
                diameter_mm=diameter_mm,
                core_mm=core_mm,
                density_hu=density_hu,
                spiculation=spiculation,
                seed=seed,
                through_vessels=through_vessels,
                truth=truth,
                series=series,
                strict=strict,
                ct=ct,
                as_json=as_json,
            )
        )
