"""Requests of a window to a PACS: connections, test, search, series with previews, retrieval, and storage of a plan.

Search results contain names of patients. They are sent to the requesting window only, which must be on this machine,
and are neither stored nor logged. Jobs and folders have names without patient data.
"""

from __future__ import annotations

import base64
import hashlib
import os
import shutil
import threading
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from carina.commands import OpenPath
from carina.config import load_settings
from carina.disk import disk_trouble, make_folder, scratch_folder
from carina.errors import CancelledError, CarinaError, PacsError, UsageError
from carina.server.files.plan_reports import write_archive_files
from carina.server.wire import messages as wire
from carina.session import Session
from carina.session.jobs.background_jobs import Job

# carina.pacs loads pydicom, which takes half a second, so the jobs import it at first use.
if TYPE_CHECKING:
    from carina.pacs import PacsConnection, PacsSeries, SeriesPreview

MAX_LISTED_SERIES = 2000
MAX_PREVIEWS = 24
"""Largest number of series of a study with a preview, for each of which one image is retrieved."""
_NAME = "carina-pacs"
_QUERIES = ("pacs-test", "pacs-search", "pacs-series")


class Asker(Protocol):
    """Window that sends a request and receives its answer."""

    number: int
    at_machine: bool
    """Whether the window is on the machine that runs Carina."""

    def send(self, message: Any) -> None:
        """Send a message to this window; callable from any thread."""


class PacsRequests:
    """Handler of the messages about PACS; each request is a job of the session.

    Parameters
    ----------
    session
        Session that opens a retrieved series, and whose plans are stored.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._settings_lock = threading.Lock()

    def handle(self, message: Any, window: Asker) -> bool:
        """Start the job of a message; return False if the message does not concern a PACS.

        Raises
        ------
        UsageError
            ``pacs.other-machine`` if the window is on another machine.
        """
        start = self._job_of(message, window)
        if start is None:
            return False
        if not window.at_machine:
            raise UsageError(
                "a PACS can be used only in a browser on the machine that runs Carina: open Carina there",
                code="pacs.other-machine",
            )
        start()
        return True

    def _job_of(self, message: Any, window: Asker) -> Callable[[], None] | None:
        match message:
            case wire.AskPacs() | wire.SavePacs() | wire.RemovePacs() | wire.EmptyPacs():
                return lambda: self._start("settings", "reading the PACS connections", message, window, self._settings)
            case wire.TestPacs():
                return lambda: self._start("test", "testing the connection", message, window, self._test)
            case wire.SearchPacs():
                return lambda: self._start("search", "searching the PACS", message, window, self._search)
            case wire.AskPacsSeries():
                return lambda: self._start("series", "listing the series", message, window, self._series)
            case wire.GetPacsSeries():
                return lambda: self._start("get", "retrieving the series", message, window, self._get)
            case wire.SendPlanToPacs():
                return lambda: self._start("send", "sending the plan to the PACS", message, window, self._send)
            case wire.StopPacs():
                return lambda: self._session.jobs.cancel_kinds(*_QUERIES)
        return None

    def _start(
        self,
        task: wire.PacsTask,
        title: str,
        message: Any,
        window: Asker,
        work: Callable[[Any, Asker, Job], None],
    ) -> None:
        """Start a job; its error goes to the window that sent the request, which shows the error beside the request."""

        def run(job: Job) -> None:
            try:
                work(message, window, job)
            except CancelledError:
                raise
            except CarinaError as error:
                window.send(wire.PacsProblemMessage(task, error.code, text_for_window(str(error))))

        self._session.jobs.start(f"pacs-{task}", title, run)

    # ------------------------------------------------------------ connections

    def _settings(self, message: Any, window: Asker, _job: Job) -> None:
        """Change the saved connections or delete retrieved series, and send the result."""
        problem = _missing_packages()
        if problem is not None:
            window.send(wire.PacsConnectionsMessage((), *_retrieved(), problem))
            return
        from carina.pacs import PacsConnections

        saved = PacsConnections()
        with self._settings_lock:
            match message:
                case wire.SavePacs():
                    _save(saved, message)
                case wire.RemovePacs():
                    saved.remove(message.name)
                case wire.EmptyPacs():
                    self._empty()
            connections = tuple(_fields(one) for one in saved.all()[:200])
        window.send(wire.PacsConnectionsMessage(connections, *_retrieved(), None))

    def _empty(self) -> None:
        if self._session.snapshot().case is not None:
            raise UsageError("close the case first, because it may use a retrieved series", code="pacs.in-use")
        folder = retrieved_folder()
        try:
            if folder.exists():
                shutil.rmtree(folder)
        except OSError as error:
            raise disk_trouble(error, "cannot delete the retrieved series", folder) from error

    def _test(self, message: wire.TestPacs, window: Asker, job: Job) -> None:
        from carina.pacs import check_connection

        job.progress("connecting", None)
        check = check_connection(_connection(message.name))
        job.check()
        steps = tuple(wire.PacsStep(step.name, step.passed, text_for_window(step.message)) for step in check.steps)
        window.send(wire.PacsTestMessage(message.name, check.passed, steps))

    # ------------------------------------------------------------ search

    def _search(self, message: wire.SearchPacs, window: Asker, job: Job) -> None:
        from carina.pacs import find_studies

        found = find_studies(
            _connection(message.name),
            patient_name=message.patient_name.strip(),
            patient_id=message.patient_id.strip(),
            date=message.date.strip(),
            progress=job.progress,
            cancel=job.cancel,
        )
        studies = tuple(
            wire.PacsStudyEntry(
                one.uid, one.patient_name, one.patient_id, one.date, one.description, ", ".join(one.modalities),
                one.num_series,
            )
            for one in found
            if one.uid
        )  # fmt: skip
        window.send(wire.PacsStudiesMessage(message.name, studies, found.has_more))

    def _series(self, message: wire.AskPacsSeries, window: Asker, job: Job) -> None:
        """Send the series of a study, then a preview of each image series, and the likeliest chest CT."""
        from carina.pacs import find_series, preview_series

        job.progress("listing the series", None)
        connection = _connection(message.name)
        found = find_series(connection, message.study_uid, cancel=job.cancel)[:MAX_LISTED_SERIES]
        previews: dict[str, SeriesPreview] = {}
        window.send(_series_message(message, found, previews))
        # Enhanced files and scouts have one image; a scout needs no preview, but its picture identifies it.
        shown = [one for one in found if one.modality in ("CT", "MR")][:MAX_PREVIEWS]
        for index, one in enumerate(shown):
            job.progress("making the previews", index / len(shown))
            try:
                preview = previews[one.uid] = preview_series(connection, one, cancel=job.cancel)
            except PacsError:
                continue  # the list without this picture is still useful
            picture = None if preview.picture is None else base64.b64encode(preview.picture).decode()
            window.send(
                wire.PacsPreviewMessage(
                    one.uid,
                    None if preview.info is None else preview.info.thickness_mm,
                    "" if preview.info is None else preview.info.kernel,
                    "" if preview.info is None else preview.info.phase,
                    None if preview.info is None else preview.info.acquired_on,
                    picture,
                )
            )
        if previews:
            window.send(_series_message(message, found, previews))

    # ------------------------------------------------------------ retrieval and storage

    def _get(self, message: wire.GetPacsSeries, window: Asker, job: Job) -> None:
        """Retrieve a series into Carina's folder, unless it is there already, and open it as a case."""
        from carina.pacs import retrieve_series

        folder = retrieved_folder()
        make_folder(folder, what="the retrieved series", private=True)
        # The name depends on PACS and series, so that a repeated request continues, and contains no UID. Another
        # PACS may have a de-identified copy with the same UIDs.
        source = f"{_NAME} {message.name} {message.study_uid} {message.series_uid}"
        mark = hashlib.sha256(source.encode()).hexdigest()[:20]
        case_number = self._session.snapshot().case_number
        place = folder / f"series-{mark}"
        if not place.is_dir():
            retrieve_series(
                _connection(message.name),
                message.study_uid,
                message.series_uid,
                place,
                progress=job.progress,
                cancel=job.cancel,
            )
        job.check()
        if self._session.snapshot().case_number != case_number:
            window.send(
                wire.Notice("The series was retrieved. Another case was opened meanwhile; open the series again.")
            )
            return
        self._session.do(OpenPath(str(place)), window=window.number)

    def _send(self, message: wire.SendPlanToPacs, window: Asker, job: Job) -> None:
        """Write the DICOM files of a plan into a temporary folder, and store them in the PACS."""
        from carina.pacs import store_files

        connection = _connection(message.name)
        suffixes = [f".{kind}.dcm" for kind in dict.fromkeys(message.files)]
        with scratch_folder() as folder:
            # A PACS files a document with its patient only if the document names the patient.
            files = write_archive_files(
                self._session, message.target_id, suffixes, Path(folder), identity="from the CT", job=job
            )
            found = store_files(connection, files, progress=job.progress, cancel=job.cancel)
        refused = tuple(f"{name}: {reason}" for name, reason in found.refused)
        window.send(wire.PacsSentMessage(message.name, found.num_stored, refused))


FOR_WINDOW = (
    ("give the port on which this machine receives images (--listen-port)", "enter the port for images under Edit"),
    ("give it with --ca-file", "enter it under Edit as the certificate file"),
    ("retrieve without --listen-port", "delete the port for images under Edit"),
    ("enter them again with `carina pacs add`", "enter them again under Edit"),
    ("add it with `carina pacs add`", "add it"),
)
"""Actions on the command line, and the same actions in the window."""


def text_for_window(words: str) -> str:
    """Return a message of :mod:`carina.pacs` with the actions of the window instead of those of the command line."""
    for command, action in FOR_WINDOW:
        words = words.replace(command, action)
    return words[:4000]


def retrieved_folder() -> Path:
    """Return the folder of the retrieved series on this machine."""
    return load_settings().retrieved_dir


def _retrieved() -> tuple[int, int, str]:
    """Return number and bytes of the retrieved series, and their folder; incomplete ones count by their bytes only."""
    folder = retrieved_folder()
    count = num_bytes = 0
    if folder.is_dir():
        for place in filter(Path.is_dir, folder.iterdir()):
            count += not place.name.startswith(".")
            num_bytes += sum(entry.stat().st_size for entry in os.scandir(place) if entry.is_file())
    return count, num_bytes, str(folder)


def _missing_packages() -> str | None:
    """Return the reason why a PACS cannot be used, with the remedy; None if it can."""
    try:
        import dicomweb_client  # noqa: F401
        import pynetdicom  # noqa: F401
    except ImportError:
        from carina.pacs.reasons import missing_library

        return str(missing_library())
    return None


def _connection(name: str) -> PacsConnection:
    from carina.pacs import PacsConnections

    return PacsConnections().get(name)


def _fields(connection: PacsConnection) -> wire.PacsFields:
    values = asdict(connection)
    del values["password"]
    return wire.PacsFields(**values)


def _save(saved: Any, message: wire.SavePacs) -> None:
    """Save a new or edited connection; an edited connection without a new password gets the stored one."""
    from carina.pacs import PacsConnection

    fields = {name: getattr(message.connection, name) for name in message.connection.__struct_fields__}
    fields |= {name: value.strip() for name, value in fields.items() if isinstance(value, str)}
    connection = PacsConnection(**fields)
    names = {one.name for one in saved.all()}
    if connection.name in names and connection.name != message.replaces:
        raise UsageError(f"a connection has the name {connection.name} already; choose another name", code="usage.pacs")
    before = message.replaces if message.replaces in names else None
    password = message.password
    if password is None:
        password = "" if before is None else saved.get(before).password
    saved.save(replace(connection, password=password if connection.user else ""))
    if before is not None and before != connection.name:
        saved.remove(before)


def _series_message(
    message: wire.AskPacsSeries, found: tuple[PacsSeries, ...], previews: dict[str, SeriesPreview]
) -> wire.PacsSeriesMessage:
    from carina.pacs import likeliest_series

    chosen, reason = likeliest_series(found, previews)
    entries = tuple(
        wire.PacsSeriesEntry(one.uid, one.modality, one.description, one.number, one.num_images) for one in found
    )
    uid = None if chosen is None else chosen.uid
    return wire.PacsSeriesMessage(message.name, message.study_uid, entries, uid, reason)
