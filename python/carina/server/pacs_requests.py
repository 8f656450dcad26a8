"""Requests of a window to a PACS: connections, test, search, series with previews, retrieval, and storage of a plan.

Search results contain names of patients. They are sent to the requesting window only, which must be on this machine,
and are neither stored nor logged. Jobs and folders have names without patient data.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import os
import threading
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from carina.commands import OpenPath, TrainingOf
from carina.config import load_settings
from carina.disk import make_folder, scratch_folder
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
"""Maximum number of series of a study with a preview, for each of which one image is retrieved."""
SENDING = "sending the plan to the PACS"
"""Title of the job that sends a plan; the page disables its button while a job with this title runs."""
_NAME = "carina-pacs"
_QUERIES: tuple[wire.PacsTask, ...] = ("test", "search", "series")
_TASKS: dict[type, wire.PacsTask] = {
    wire.AskPacs: "settings",
    wire.SavePacs: "settings",
    wire.RemovePacs: "settings",
    wire.EmptyPacs: "settings",
    wire.TestPacs: "test",
    wire.SearchPacs: "search",
    wire.AskPacsSeries: "series",
    wire.GetPacsSeries: "get",
    wire.SendPlanToPacs: "send",
}
_OTHER_MACHINE = "a PACS can be used only in a browser on the machine that runs Carina: open Carina there"
_NOT_OPENED = (
    'The series was retrieved, but not opened, because {reason}. To open it, choose it again under "Open from a PACS".'
)


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

        A window on another machine receives a ``pacs_problem`` with the code ``pacs.other-machine``.
        """
        if isinstance(message, wire.StopPacs):
            self.stop_queries(window.number)
            return True
        task = _TASKS.get(type(message))
        if task is None:
            return False
        if not window.at_machine:
            window.send(_problem(task, message, UsageError(_OTHER_MACHINE, code="pacs.other-machine")))
            return True
        match message:
            case wire.TestPacs():
                self._start(task, "testing the connection", message, window, self._test)
            case wire.SearchPacs():
                self._start(task, "searching the PACS", message, window, self._search)
            case wire.AskPacsSeries():
                self._start(task, "listing the series", message, window, self._series)
            case wire.GetPacsSeries():
                self._start_get(message, window)
            case wire.SendPlanToPacs():
                self._start_send(message, window)
            case _:
                self._start(task, "reading the PACS connections", message, window, self._settings)
        return True

    def stop_queries(self, window: int) -> None:
        """Stop connection test, search and previews of a window, because it closed their dialog or has left."""
        self._session.jobs.cancel_kinds(*(_kind(task, window) for task in _QUERIES))

    def _start(
        self,
        task: wire.PacsTask,
        title: str,
        message: Any,
        window: Asker,
        work: Callable[[Any, Asker, Job], None],
        *,
        kind: str | None = None,
        of_case: bool = True,
    ) -> None:
        """Start a job; its error goes to the window that sent the request, which shows the error beside the request."""

        def run(job: Job) -> None:
            try:
                work(message, window, job)
            except CancelledError:
                raise
            except CarinaError as error:
                if task != "settings":
                    job.check()  # a stopped job may raise any error, and no window waits for its answer
                window.send(_problem(task, message, error))

        self._session.jobs.start(kind or _kind(task, window.number), title, run, of_case=of_case)

    def _start_get(self, message: wire.GetPacsSeries, window: Asker) -> None:
        """Start the retrieval of a series in place of another retrieval of this window; a second request is ignored."""
        before = _kind("get", window.number)
        mark = _series_mark(message)
        kind = f"{before}-{mark}"
        if self._is_running(kind):
            return
        for job in self._session.jobs.running:
            if job.kind.startswith(f"{before}-"):
                self._session.jobs.cancel(job.job_id)
        number = self._session.snapshot().case_number
        work = partial(self._get, mark=mark, case_number=number)
        # The series is independent of the open case, so the retrieval continues when the user opens another case.
        self._start("get", "retrieving the series", message, window, work, kind=kind, of_case=False)

    def _start_send(self, message: wire.SendPlanToPacs, window: Asker) -> None:
        """Start to send a plan; a second request of the window is refused, because it would stop the first one."""
        if self._is_running(_kind("send", window.number)):
            error = UsageError("a plan is being sent; wait until it is stored, or cancel it", code="pacs.busy")
            window.send(_problem("send", message, error))
            return
        self._start("send", SENDING, message, window, self._send)

    def _is_running(self, kind: str) -> bool:
        return any(job.kind == kind and not job.cancel() for job in self._session.jobs.running)

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
        from carina.pacs.retrieval_folder import delete_retrieved

        self._refuse_while_used()
        delete_retrieved(retrieved_folder(), self._refuse_while_used)

    def _refuse_while_used(self) -> None:
        """Raise UsageError while the open case, a case being opened, or a retrieval may use a retrieved series."""
        if self._session.snapshot().case is not None:
            raise UsageError("close the case first, because it may use a retrieved series", code="pacs.in-use")
        if any(job.kind == "open" or job.kind.startswith("pacs-get-") for job in self._session.jobs.running):
            raise UsageError(
                "a series is being retrieved or opened: wait until this has ended, or cancel it", code="pacs.in-use"
            )

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
        job.check()
        window.send(wire.PacsStudiesMessage(message.name, studies, found.has_more))

    def _series(self, message: wire.AskPacsSeries, window: Asker, job: Job) -> None:
        """Send the series of a study, then a preview of each image series, and the likeliest chest CT."""
        from carina.pacs import find_series, preview_series

        job.progress("listing the series", None)
        connection = _connection(message.name)
        found = find_series(connection, message.study_uid, cancel=job.cancel)[:MAX_LISTED_SERIES]
        previews: dict[str, SeriesPreview] = {}
        job.check()
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
            job.check()
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
        job.check()
        if previews:
            window.send(_series_message(message, found, previews))

    # ------------------------------------------------------------ retrieval and storage

    def _get(self, message: wire.GetPacsSeries, window: Asker, job: Job, *, mark: str, case_number: int) -> None:
        """Retrieve a series into Carina's folder, unless the same images are there already, and open it as a case.

        The series is not opened if that would close another case than the one at the request (``case_number``), or end
        an attempt of the training.
        """
        from carina.pacs import retrieve_series

        folder = retrieved_folder()
        make_folder(folder, what="the retrieved series", private=True)
        found = retrieve_series(
            _connection(message.name),
            message.study_uid,
            message.series_uid,
            folder / f"series-{mark}",
            reuse=True,
            progress=job.progress,
            cancel=job.cancel,
        )
        job.check()
        reason = self._reason_not_to_open(case_number)
        if reason is None:
            self._session.do(OpenPath(str(found.folder)), window=window.number)
        else:
            window.send(wire.Notice(_NOT_OPENED.format(reason=reason)))

    def _reason_not_to_open(self, case_number: int) -> str | None:
        """Return why a retrieved series must not replace the open case; None if it may."""
        snapshot = self._session.snapshot()
        is_opening = any(job.kind == "open" for job in self._session.jobs.running)
        if is_opening or (snapshot.case is not None and snapshot.case_number != case_number):
            return "another case was opened in the meantime"
        if snapshot.case is None:
            return None
        training = self._session.ask(TrainingOf())
        return None if training.running is None and training.quiz is None else "a task of the training is running"

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
        window.send(wire.PacsSentMessage(message.name, message.target_id, found.num_stored, refused))


FOR_WINDOW = (
    ("give the port on which this machine receives images (--listen-port)", "enter the port for images under Edit"),
    ("give it with --ca-file", "enter it under Edit as the certificate file"),
    ("retrieve without --listen-port", "delete the port for images under Edit"),
    ("enter them again with `carina pacs add`", "enter them again under Edit"),
    ("add it with `carina pacs add`", "add it"),
)
"""Texts of actions on the command line, and of the same actions in the window."""


def text_for_window(words: str) -> str:
    """Return a message of :mod:`carina.pacs` with the actions of the window instead of those of the command line."""
    for command, action in FOR_WINDOW:
        words = words.replace(command, action)
    return words[:4000]


def _kind(task: wire.PacsTask, window: int) -> str:
    """Return the kind of a window's PACS job; a new job stops only a job of the same kind."""
    return f"pacs-{task}-{window}"


def _problem(task: wire.PacsTask, message: Any, error: CarinaError) -> wire.PacsProblemMessage:
    target_id = message.target_id if isinstance(message, wire.SendPlanToPacs) else None
    return wire.PacsProblemMessage(task, error.code, text_for_window(str(error)), target_id)


def _series_mark(message: wire.GetPacsSeries) -> str:
    """Return a name of a series in a PACS, so that a repeated request continues; the name contains no UID."""
    parts = (_NAME, message.name, message.study_uid, message.series_uid)
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:20]


def retrieved_folder() -> Path:
    """Return the folder of the retrieved series on this machine."""
    return load_settings().retrieved_dir


def _retrieved() -> tuple[int, int, str]:
    """Return number and bytes of the retrieved series, and their folder; incomplete ones count by their bytes only."""
    folder = retrieved_folder()
    count = num_bytes = 0
    if folder.is_dir():
        for place in filter(Path.is_dir, folder.iterdir()):
            num = _bytes_in(place)
            count += num > 0 and not place.name.startswith(".")
            num_bytes += num
    return count, num_bytes, str(folder)


def _bytes_in(folder: Path) -> int:
    """Return the bytes of a folder's images, without files of the user.

    A retrieval may rename or delete files in the meantime.
    """
    num_bytes = 0
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            with contextlib.suppress(OSError):
                num_bytes += entry.stat().st_size if entry.name.endswith(".dcm") and entry.is_file() else 0
    return num_bytes


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
