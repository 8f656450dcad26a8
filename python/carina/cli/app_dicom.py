"""The command ``carina deidentify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carina.cli.console import exit_codes
from carina.cli.options import JsonOption


def deidentify(
    source: Annotated[
        Path, typer.Argument(help="DICOM folder, file or archive with the images to copy.", show_default=False)
    ],
    folder: Annotated[Path, typer.Argument(help="Folder to create; it must not exist and must be outside of SOURCE.")],
    alias: Annotated[
        str, typer.Option(help="Name and ID of the patient in the copies; further patients get a number.")
    ] = "PATIENT",
    mask: Annotated[
        list[str] | None,
        typer.Option(
            help=(
                "Rectangle x,y,width,height in pixels to blacken in images that may show text, such as 0,0,512,40; "
                "may be repeated. Without it these images are not copied."
            )
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Copy DICOM images without the identity of the patient, staff and institution to a new folder.

    Example: carina deidentify ~/scans/thorax ~/shared/thorax-copy
    """
    with exit_codes(as_json):
        from carina.cli.deidentify import write_copies

        raise SystemExit(write_copies(source, folder, alias=alias, mask=mask or [], as_json=as_json))
