"""The commands below ``carina case``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carina.cli.case_ids import path_or_case
from carina.cli.console import exit_codes
from carina.cli.options import CtOption, JsonOption

case = typer.Typer(
    help="Manage case files (NAME.carina) and the cases stored on this machine (docs/case-file.md).",
    no_args_is_help=True,
    rich_markup_mode=None,
)

FileArgument = Annotated[
    Path,
    typer.Argument(
        help="Case file (NAME.carina), or the id of a stored case (see `carina case list`).",
        show_default=False,
        callback=path_or_case,
    ),
]
CaseOutput = Annotated[Path, typer.Option("-o", "--output", help="Case file to write; it must not exist yet.")]


@case.command("info")
def case_info(path: FileArgument, as_json: JsonOption = False) -> None:
    """Show what a case file contains; its scan is not needed.

    Example: carina case info NAME.carina
    """
    with exit_codes(as_json):
        from carina.cli.case import info

        raise SystemExit(info(path, as_json=as_json))


@case.command("history")
def case_history(path: FileArgument, as_json: JsonOption = False) -> None:
    """List the changes made in a case, each with the time since the case was started.

    Example: carina case history NAME.carina
    """
    with exit_codes(as_json):
        from carina.cli.case import history

        raise SystemExit(history(path, as_json=as_json))


@case.command("list")
def case_list(as_json: JsonOption = False) -> None:
    """List the cases stored on this machine: id, last use, changes, size, title.

    Example: carina case list
    """
    with exit_codes(as_json):
        from carina.cli.case import list_cases

        raise SystemExit(list_cases(as_json=as_json))


@case.command("forget")
def case_forget(
    name: Annotated[
        str,
        typer.Argument(help="Case id (see `carina case list`), or the file it was saved as.", show_default=False),
    ],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for confirmation.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Remove a case from this machine, with its working file and cached scan. Files saved elsewhere are not deleted.

    Example: carina case forget 3f9a1c
    """
    with exit_codes(as_json):
        from carina.cli.case import forget

        raise SystemExit(forget(name, yes=yes, as_json=as_json))


@case.command("pack")
def case_pack(path: FileArgument, output: CaseOutput, ct: CtOption = None, as_json: JsonOption = False) -> None:
    """Write a case together with its scan to one file, without the scan's DICOM tags.

    Example: carina case pack NAME.carina -o PACKED.carina
    """
    with exit_codes(as_json):
        from carina.cli.case import pack_case

        raise SystemExit(pack_case(path, output=output, ct=ct, as_json=as_json))


@case.command("migrate")
def case_migrate(path: FileArgument, output: CaseOutput, as_json: JsonOption = False) -> None:
    """Convert a case from an older version of Carina to the current format, in a new file.

    Example: carina case migrate OLD.carina -o NEW.carina
    """
    with exit_codes(as_json):
        from carina.cli.case import migrate_case

        raise SystemExit(migrate_case(path, output=output, as_json=as_json))


@case.command("recording")
def case_recording(
    path: FileArgument,
    name: Annotated[str, typer.Argument(help="Name or number of the recording (see `carina case info`).")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Recording file to write (.jsonl); it must not exist yet.")
    ],
    as_json: JsonOption = False,
) -> None:
    """Write a recorded flight of a case to a separate file, for `carina fly --recording`.

    Example: carina case recording NAME.carina "Flight 1" -o flight.jsonl
    """
    with exit_codes(as_json):
        from carina.cli.case import write_recording

        raise SystemExit(write_recording(path, name, output=output, as_json=as_json))


@case.command("rescue")
def case_rescue(path: FileArgument, output: CaseOutput, as_json: JsonOption = False) -> None:
    """Write the intact parts of a damaged case to a new file, and list what was lost.

    Example: carina case rescue DAMAGED.carina -o RESCUED.carina
    """
    with exit_codes(as_json):
        from carina.cli.case import rescue

        raise SystemExit(rescue(path, output=output, as_json=as_json))
