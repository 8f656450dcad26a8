"""The commands below ``carina pacs``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carina.cli.console import exit_codes
from carina.cli.options import JsonOption

pacs = typer.Typer(
    help="Search a PACS, retrieve series and store plans (docs/dicom.md); needs the extra dicom.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

NameArgument = Annotated[
    str, typer.Argument(help="Name of a saved connection (see `carina pacs list`).", show_default=False)
]


@pacs.command("add")
def pacs_add(
    name: Annotated[str, typer.Argument(help="Name of the connection; a connection of this name is replaced.")],
    host: Annotated[str, typer.Option(help="Host name or address of the PACS.")] = "",
    port: Annotated[int, typer.Option(help="Port of the PACS.", min=1, max=65535)] = 104,
    ae: Annotated[str, typer.Option("--ae", help="AE title of the PACS.")] = "ANY-SCP",
    own_ae: Annotated[
        str, typer.Option("--own-ae", help="AE title of this machine, as the administrator of the PACS entered it.")
    ] = "CARINA",
    listen_port: Annotated[
        int | None,
        typer.Option(
            "--listen-port",
            help="Port on which this machine receives images (C-MOVE); without it the PACS sends them through the "
            "connection of the request (C-GET).",
            min=1,
            max=65535,
        ),
    ] = None,
    listen_host: Annotated[
        str,
        typer.Option(
            "--listen-host", help="Address to receive images on (default: the one from which it reaches the PACS)."
        ),
    ] = "",
    tls: Annotated[bool, typer.Option("--tls", help="Encrypt the connection, and check the certificate.")] = False,
    ca_file: Annotated[
        str, typer.Option("--ca-file", help="Certificate file (PEM) of the PACS or of its authority.")
    ] = "",
    url: Annotated[str, typer.Option(help="URL of a DICOMweb service, instead of host and port.")] = "",
    user: Annotated[
        str, typer.Option(help="User of the DICOMweb service; the password is asked, or read from standard input.")
    ] = "",
    as_json: JsonOption = False,
) -> None:
    """Save the connection to a PACS.

    Example: carina pacs add hospital --host pacs.example.org --port 104 --ae PACS
    """
    with exit_codes(as_json):
        from carina.cli.pacs import add

        values = {
            "host": host, "port": port, "called_ae": ae, "calling_ae": own_ae, "listen_port": listen_port,
            "listen_host": listen_host, "tls": tls, "ca_file": ca_file, "url": url, "user": user,
        }  # fmt: skip
        raise SystemExit(add(name, values, as_json=as_json))


@pacs.command("list")
def pacs_list(as_json: JsonOption = False) -> None:
    """List the saved connections.

    Example: carina pacs list
    """
    with exit_codes(as_json):
        from carina.cli.pacs import list_connections

        raise SystemExit(list_connections(as_json=as_json))


@pacs.command("remove")
def pacs_remove(name: NameArgument, as_json: JsonOption = False) -> None:
    """Delete a saved connection and its password.

    Example: carina pacs remove hospital
    """
    with exit_codes(as_json):
        from carina.cli.pacs import remove

        raise SystemExit(remove(name, as_json=as_json))


@pacs.command("test")
def pacs_test(name: NameArgument, as_json: JsonOption = False) -> None:
    """Test a connection step by step; a failure states the reason and what to do.

    Example: carina pacs test hospital
    """
    with exit_codes(as_json):
        from carina.cli.pacs import test

        raise SystemExit(test(name, as_json=as_json))


@pacs.command("search")
def pacs_search(
    name: NameArgument,
    patient_id: Annotated[
        str, typer.Option("--patient-id", help="ID of the patient; * stands for any characters.")
    ] = "",
    patient_name: Annotated[
        str, typer.Option("--patient-name", help="Beginning of the name of the patient (FAMILY^GIVEN).")
    ] = "",
    date: Annotated[str, typer.Option(help="Date 2026-11-30, or range 2026-11-01..2026-11-30.")] = "",
    modality: Annotated[str, typer.Option(help="Modality of the studies, or all.")] = "CT",
    study: Annotated[str, typer.Option(help="UID of a study: list its series.")] = "",
    as_json: JsonOption = False,
) -> None:
    """List the studies of a patient or a date, or the series of a study. Results are not stored.

    Example: carina pacs search hospital --date 2026-11-30
    """
    with exit_codes(as_json):
        from carina.cli.pacs import search, series_of

        if study:
            raise SystemExit(series_of(name, study, as_json=as_json))
        wanted = "" if modality == "all" else modality
        raise SystemExit(
            search(name, patient_id=patient_id, patient_name=patient_name, date=date, modality=wanted, as_json=as_json)
        )


@pacs.command("get")
def pacs_get(
    name: NameArgument,
    study: Annotated[str, typer.Argument(help="UID of the study (see `carina pacs search`).", show_default=False)],
    series: Annotated[str, typer.Argument(help="UID of the series.", show_default=False)],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder to create; it then opens like every scan.")],
    as_json: JsonOption = False,
) -> None:
    """Retrieve a series. After an interruption, the same command continues with the missing images.

    Example: carina pacs get hospital 1.2.840.1 1.2.840.1.3 -o ~/scans/thorax
    """
    with exit_codes(as_json):
        from carina.cli.pacs import get

        raise SystemExit(get(name, study, series, output, as_json=as_json))


@pacs.command("store")
def pacs_store(
    name: NameArgument,
    files: Annotated[
        list[Path],
        typer.Argument(help="DICOM files or folders, such as SEG, SR and PDF of a plan.", show_default=False),
    ],
    as_json: JsonOption = False,
) -> None:
    """Send DICOM files to a PACS.

    Example: carina pacs store hospital plan-seg.dcm plan-report.dcm
    """
    with exit_codes(as_json):
        from carina.cli.pacs import store

        raise SystemExit(store(name, files, as_json=as_json))
