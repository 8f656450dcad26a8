"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carina.cli.case_ids import path_or_case

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout; messages go to stderr.")]
TokenOption = Annotated[
    Path | None,
    typer.Option("--token-file", help="Cluster token file (default: the one in Carina's settings folder)."),
]
PathArgument = Annotated[
    Path,
    typer.Argument(
        help="Scan to open (DICOM folder or file, NIfTI, NRRD, MetaImage, VTI, or a zip, tar or 7z archive), a case "
        "file (NAME.carina), or the id of a stored case (see `carina case list`).",
        show_default=False,
        callback=path_or_case,
    ),
]
CtOption = Annotated[
    Path | None, typer.Option("--ct", help="Current location of the case's scan, if it is not found automatically.")
]
SeriesOption = Annotated[
    str | None, typer.Option("--series", help="Key of the series to open; `carina info` lists the keys.")
]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Refuse a scan that was corrected or in which the check finds a problem (exit code 3).",
    ),
]
