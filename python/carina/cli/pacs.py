"""``carina pacs``: saved connections, connection test, search, retrieval and storage."""

from __future__ import annotations

import getpass
import sys
from pathlib import Path
from typing import Any

from carina.cli.console import print_json, print_note, print_result, progress_printer
from carina.pacs import (
    PacsConnection,
    PacsConnections,
    check_connection,
    find_series,
    find_studies,
    retrieve_series,
    store_files,
)


def add(name: str, values: dict[str, Any], *, as_json: bool) -> int:
    """Save a connection; the password of a user is asked at a terminal, or read from standard input."""
    if values["ca_file"]:
        values = {**values, "ca_file": str(Path(values["ca_file"]).expanduser().absolute())}
    connection = PacsConnection(name, **values)
    if connection.user:
        if sys.stdin.isatty():
            password = getpass.getpass("Password: ", stream=sys.stderr)
        else:
            password = sys.stdin.readline().rstrip("\r\n")
        connection = PacsConnection(name, **values, password=password)
    PacsConnections().save(connection)
    if connection.user and connection.url.startswith("http:"):
        print_note("note: http sends the password and the images without encryption; use https if the PACS offers it")
    if as_json:
        print_json(_connection_json(connection))
    else:
        print_result(f"Saved {name}. Test it with `carina pacs test {name}`.")
    return 0


def list_connections(*, as_json: bool) -> int:
    """List the saved connections to PACS servers."""
    found = PacsConnections().all()
    if as_json:
        print_json({"connections": [_connection_json(one) for one in found]})
        return 0
    for one in found:
        place = one.url if one.is_web else f"{one.host}, port {one.port}, AE title {one.called_ae}"
        print_result(f"{one.name}: {place}")
    if not found:
        print_result("No connection is saved. Add one with `carina pacs add`.")
    return 0


def _connection_json(connection: PacsConnection) -> dict[str, Any]:
    return {
        "name": connection.name, "host": connection.host, "port": connection.port, "url": connection.url,
        "called_ae": connection.called_ae, "calling_ae": connection.calling_ae, "tls": connection.tls,
        "listen_port": connection.listen_port,
    }  # fmt: skip


def remove(name: str, *, as_json: bool) -> int:
    """Delete a saved connection to a PACS server."""
    PacsConnections().remove(name)
    if as_json:
        print_json({"removed": name})
    else:
        print_result(f"Removed {name}.")
    return 0


def test(name: str, *, as_json: bool) -> int:
    """Print each step of the connection test; return 1 if a step failed."""
    check = check_connection(PacsConnections().get(name))
    if as_json:
        print_json(check.to_json())
    else:
        for step in check.steps:
            print_result(f"{step.name}: {'passed' if step.passed else 'failed'}: {step.message}")
    return 0 if check.passed else 1


def search(name: str, *, patient_id: str, patient_name: str, date: str, modality: str, as_json: bool) -> int:
    """Print the studies that were found."""
    found = find_studies(
        PacsConnections().get(name), patient_id=patient_id, patient_name=patient_name, date=date, modality=modality
    )
    if as_json:
        print_json(found.to_json())
        return 0
    for study in found:
        facts = [study.date or "no date", study.patient_name, study.patient_id, study.description]
        series = "" if study.num_series is None else f"{study.num_series} series"
        print_result(f"{', '.join(filter(None, [*facts, series]))}", f"  study {study.uid}")
    if found.has_more:
        print_note(f"the first {len(found)} of more studies; narrow the search, for example by a date")
    else:
        print_note(f"{len(found)} studies found; list the series of one with --study UID")
    return 0


def series_of(name: str, study: str, *, as_json: bool) -> int:
    """Print the series of a study."""
    found = find_series(PacsConnections().get(name), study)
    if as_json:
        print_json({"series": [series.to_json() for series in found]})
        return 0
    for series in found:
        number = "no number" if series.number is None else f"series {series.number}"
        images = "" if series.num_images is None else f"{series.num_images} images"
        print_result(
            ", ".join(filter(None, [number, series.modality, series.description, images])), f"  series {series.uid}"
        )
    return 0


def get(name: str, study: str, series: str, output: Path, *, as_json: bool) -> int:
    """Retrieve a series into a new folder."""
    found = retrieve_series(PacsConnections().get(name), study, series, output, progress=progress_printer())
    if as_json:
        print_json(found.to_json())
        return 0
    resumed = f" ({found.num_resumed} of them earlier)" if found.num_resumed else ""
    print_result(f"{found.num_retrieved} images{resumed} in {found.folder}")
    return 0


def store(name: str, files: list[Path], *, as_json: bool) -> int:
    """Send files; return 1 if the PACS refused one."""
    found = store_files(PacsConnections().get(name), files, progress=progress_printer())
    if as_json:
        print_json(found.to_json())
    else:
        print_result(f"{found.num_stored} files stored in {name}")
    for file, reason in found.refused:
        print_note(f"carina: {file}: {reason}")
    return 1 if found.refused else 0
