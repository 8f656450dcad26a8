"""Start of the workstation: bind, print the link, run until a signal ends it."""

from __future__ import annotations

import contextlib
import signal
import socket
import sys
import threading
import time
import webbrowser
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, cast

import uvicorn

from carina.commands import OpenCaseFile, OpenDemo, OpenPath, OpenRecent
from carina.config import load_settings
from carina.disk import sweep_drafts, sweep_scratch
from carina.errors import UsageError
from carina.render import Backend, ClusterStatus
from carina.render.processor_choice import RECORD_NAME
from carina.server.app import create_app, web_folder
from carina.server.attached_programs import endpoint_of
from carina.server.devices import Phone
from carina.server.files.uploads import Uploads
from carina.server.hub import Hub
from carina.server.network.access_checks import Gate, is_loopback
from carina.server.network.connection_limits import (
    ACCEPT_AT_ONCE,
    WAITING_IN_LINE,
    UnauthenticatedConnections,
    limit_log_rate,
)
from carina.server.network.listening import bind
from carina.server.network.request_timeouts import timeout_protocol
from carina.server.network.shutdown import TimedShutdownServer
from carina.server.unsaved_question import ConsoleTerminal, close_session
from carina.server.wire.codec import MAX_TEXT_BYTES
from carina.session import FORGOTTEN_FOR_S, CaseRecords, LocalStore, RendererFactory, Session, case_files, is_case_file
from carina.training import Course, TaskFolder
from carina.volume import Citation, VolumeCache

__all__ = ["EndSignals", "bind", "make_server", "serve", "start_url"]

CLOSED_TERMINAL = "SIGHUP"
ENDING = ("SIGTERM", CLOSED_TERMINAL)
"""Names of the handled signals; Python and uvicorn handle SIGINT (Ctrl-C)."""


class EndSignals:
    """Handlers of SIGTERM and SIGHUP while the server runs and while the session is closed.

    Without these handlers either signal ends the process at once: SIGHUP in the middle of the work, SIGTERM after the
    server has ended and before the session is closed. A signal that is ignored (``nohup``) stays ignored.

    Parameters
    ----------
    stop
        Callback that makes the server stop; called for the first signal.
    """

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop = stop
        self._former: dict[signal.Signals, Any] = {}
        self._received: list[int] = []
        self._is_closing = False

    @property
    def has_terminal_closed(self) -> bool:
        """Whether the terminal was closed, so that no user can answer."""
        return any(signal.Signals(number).name == CLOSED_TERMINAL for number in self._received)

    def begin_closing(self) -> None:
        """Mark the server as stopped; from now on each signal raises KeyboardInterrupt, as Ctrl-C does."""
        self._is_closing = True

    def __enter__(self) -> EndSignals:
        """Install the signal handlers."""
        # Signals can only be handled in the main thread; in another thread, the caller stops the server.
        if threading.current_thread() is threading.main_thread():
            for name in ENDING:
                number = getattr(signal, name, None)
                if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
                    self._former[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_error: object) -> None:
        """Restore the previous signal handlers."""
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _handle(self, number: int, _frame: FrameType | None) -> None:
        self._received.append(number)
        if self._is_closing:
            raise KeyboardInterrupt
        self._stop()


GRACE_S = 3


def start_url(gate: Gate) -> str:
    """Return a start link with a fresh token; the link works once, and again for the user of this process."""
    host = gate.host
    if host in {"0.0.0.0", "::", ""}:
        host = socket.gethostname()
    shown = f"[{host}]" if ":" in host else host
    return f"http://{shown}:{gate.port}/?token={gate.new_token()}"


class _Server(TimedShutdownServer):
    """Uvicorn server that calls ``on_started`` when it accepts connections."""

    def __init__(
        self, config: uvicorn.Config, unauthenticated: UnauthenticatedConnections, on_started: Callable[[], None]
    ) -> None:
        super().__init__(config, unauthenticated)
        self._on_started = on_started

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets=sockets)
        for sock in sockets or ():
            # uvicorn's backlog sets both the accepts per loop turn and the listen queue; this sets the queue alone.
            sock.listen(WAITING_IN_LINE)
        if self.started and not self.should_exit:
            self._on_started()


def make_server(
    session: Session,
    gate: Gate,
    *,
    on_started: Callable[[], None],
    web: Path | None = None,
    uploads: Uploads | None = None,
    patient_citation: Citation | None = None,
    build_info: dict[str, Any] | None = None,
    backend: Backend | None = None,
    is_backend_forced: bool = False,
    phone: Phone | None = None,
    cluster_status: Callable[[], ClusterStatus] | None = None,
    watch_address: str | None = None,
    closes_session: bool = True,
) -> uvicorn.Server:
    """Return the HTTP and WebSocket server of a session.

    ``server.run(sockets=[sock])`` runs the server, and ``server.should_exit = True`` stops it. The server then closes
    the session unless ``closes_session`` is False.
    """
    uploads = uploads or Uploads()
    info = build_info or {}
    hub = Hub(
        session,
        uploads,
        threads=int(info.get("threads", 1)),
        simd=str(info.get("simd", "")),
        backend=backend,
        is_backend_forced=is_backend_forced,
        patient_citation=patient_citation,
        phone=phone,
        cluster_status=cluster_status,
        web=web,
        watch_address=watch_address,
        closes_session=closes_session,
    )
    unauthenticated = UnauthenticatedConnections()
    config = uvicorn.Config(
        create_app(hub, gate, uploads, web=web),
        http=timeout_protocol(unauthenticated, gate.authorised),
        backlog=ACCEPT_AT_ONCE,
        ws="websockets-sansio",
        ws_per_message_deflate=False,  # compression costs 3 ms per frame, and JPEG data do not shrink
        # Carina refuses a message above MAX_TEXT_BYTES with a reason after it has read the message. Only above four
        # times this size does the library close the connection, in the middle of the message and without a reason.
        ws_max_size=4 * MAX_TEXT_BYTES,
        ws_max_queue=1024,
        access_log=False,  # a start URL contains a token
        log_config=None,
        log_level="warning",
        lifespan="on",
        server_header=False,
        timeout_graceful_shutdown=GRACE_S,
    )
    return _Server(config, unauthenticated, on_started)


def serve(
    path: str | None,
    *,
    ct: Path | None = None,
    case_id: str | None = None,
    demo: str | None = None,
    host: str = "127.0.0.1",
    port: int = 0,
    open_browser: bool = True,
    on_ready: Callable[[str, str], None] | None = None,
    phone: bool = False,
    phone_address: str | None = None,
    on_phone: Callable[[str, str], None] | None = None,
    make_phone: Callable[[Session, Path | None, str | None], Phone] | None = None,
    make_renderer: RendererFactory | None = None,
    cluster_status: Callable[[], ClusterStatus] | None = None,
) -> int:
    """Start the workstation, and return after Ctrl-C, SIGTERM or SIGHUP.

    Parameters
    ----------
    path
        CT folder, CT file or case file to open; None shows the start page.
    ct
        Current path of the case file's CT; None searches the paths that the case knows.
    case_id
        ID of a stored case to open instead of ``path``.
    demo
        ``"phantom"`` or ``"patient"``: bundled case to open instead of ``path``.
    host
        Address on which the server listens; any other than loopback opens the case to the network, and a warning is
        printed.
    port
        TCP port of the server; 0 selects a free port.
    open_browser
        Whether to open a start URL with its own token in the browser.
    on_ready
        Called when the server accepts connections, with the start URL, which works once, and again for the user of
        this process, and the token for programs, which works as long as the server runs (``Authorization: Bearer
        TOKEN``, protocol/README.md).
    phone
        Whether to open the phone page at once; otherwise the user can open it under Devices.
    phone_address
        Address on which the phone page listens; None selects this machine's address in the local network.
    on_phone
        Called before ``on_ready`` if ``phone`` is True, with the link of the phone page, which contains its token, and
        the SHA-256 fingerprint of its certificate.
    make_phone
        Creates the switch of the phone page from session, folder of the built client, and address; None offers no phone
        page.
    make_renderer
        Creates the renderer of the views of a volume; None selects the renderer of this machine, which always renders
        videos.
    cluster_status
        Returns the status of the machines that render together with this one, for the windows; None without a cluster.

    Returns
    -------
    int
        0 after Ctrl-C, SIGTERM or SIGHUP with all work saved.

    Raises
    ------
    UsageError
        If both a path and a demo are given, or the demo is unknown.
    VolumeImportError
        If nothing at ``path`` can be opened; no server was started then.
    UnsavedWorkError
        If work is lost. Carina first asks a user at a terminal, who may save the case elsewhere.
    CarinaError
        ``server.port`` if the port is in use; with ``phone`` also ``phone.missing`` or ``server.no-network``.
    """
    if path is not None and demo is not None:
        raise UsageError("expected a path or a demo; found both")
    if demo not in {None, "phantom", "patient"}:
        raise UsageError(f"expected the demo 'phantom' or 'patient'; found {demo!r}")
    settings = load_settings()
    cache = VolumeCache(settings.cache_dir / "volumes", max_bytes=settings.volume_cache_bytes)
    if path is not None:
        _check_path(path, cache)
    sweep_leftovers()
    _disable_core_files(settings.log_level)
    records = CaseRecords(settings.cases_dir, time.time, settings.documents_dir)
    store = LocalStore(settings.config_dir)
    # Titles are removed before a case is opened, because only the owner of an open case may write its record.
    records.remove_titles()
    store.remove_titles()

    def sweep() -> None:
        # The next start sweeps again.
        with contextlib.suppress(OSError):
            cache.sweep()
            records.empty_forgotten(FORGOTTEN_FOR_S)

    course = Course(settings.learners_dir)
    # The files of many learners are read in seconds, and are needed with the first case.
    threading.Thread(target=course.learners, name="carina-learners", daemon=True).start()
    # Old cache files and forgotten cases are deleted while the window opens; unsaved work is never deleted.
    threading.Thread(target=sweep, name="carina-sweep", daemon=True).start()
    with bind(host, port) as sock:
        gate = Gate(host=host, port=sock.getsockname()[1])
        records.endpoint = endpoint_of(gate)
        if not is_loopback(host):
            print(_NETWORK_WARNING.format(host=host), file=sys.stderr, flush=True)
        backend = Backend(settings.backend, record=settings.cache_dir / RECORD_NAME)
        local = _renderer_factory(backend)
        session = Session(
            make_renderer or local,
            job_renderer_factory=local,
            store=store,
            records=records,
            files=case_files(cache, records),
            course=course,
            tasks=TaskFolder(settings.tasks_dir),
        )
        page = None if make_phone is None else make_phone(session, web_folder(), phone_address)

        def ready() -> None:
            if path is not None:
                place = Path(path).absolute()
                session.do(OpenPath(str(place)) if ct is None else OpenCaseFile(place, ct))
            elif case_id is not None:
                session.do(OpenRecent(case_id))
            elif demo is not None:
                session.do(OpenDemo(cast(Any, demo)))
            if on_ready is not None:
                on_ready(start_url(gate), gate.secret)
            if open_browser:
                url = start_url(gate)
                # A thread is needed because some launchers wait until the browser closes.
                threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()
            # pydicom takes 0.7 s of processor time to load, which would be most of the time until the first slice of a
            # series is shown. Therefore a thread loads it while the browser starts.
            threading.Thread(target=_load_dicom_readers, name="carina-dicom", daemon=True).start()

        server = make_server(
            session,
            gate,
            on_started=ready,
            web=web_folder(),
            patient_citation=_patient_citation(),
            build_info=_build_info(),
            backend=backend if make_renderer is None else None,
            is_backend_forced=settings.is_backend_forced,
            phone=page,
            cluster_status=cluster_status,
            # The viewing page listens on the address that the user gave for the phone page.
            watch_address=phone_address,
            # The session is closed at the end of this function, where a user can still decide about unsaved work.
            closes_session=False,
        )

        def stop() -> None:
            server.should_exit = True

        with EndSignals(stop) as signals:
            try:
                if phone and page is not None:
                    opened = page.start()
                    print(_PHONE_WARNING.format(address=opened.address), file=sys.stderr, flush=True)
                    if on_phone is not None:
                        on_phone(opened.url, opened.sha256)
                unquieten = limit_log_rate(time.monotonic)
                try:
                    server.run(sockets=[sock])
                finally:
                    unquieten()
            except KeyboardInterrupt:
                # uvicorn has stopped and raises the signal again; Ctrl-C is the normal way to close the workstation.
                pass
            finally:
                signals.begin_closing()
                try:
                    if page is not None:
                        page.stop()
                finally:
                    close_session(session, ConsoleTerminal(is_closed=signals.has_terminal_closed))
    return 0


def _load_dicom_readers() -> None:
    """Load the modules that open a DICOM series.

    A failure is ignored, for example when the process has no free file descriptor: the modules are loaded again when a
    series is opened, and an error is then shown to the user.
    """
    with contextlib.suppress(OSError, ImportError):
        import carina.volume.dicom
        import carina.volume.series_pictures  # noqa: F401


def _disable_core_files(log_level: str) -> None:
    """Disable core files, which would contain the patient's images; DEBUG leaves them on for fault analysis."""
    if sys.platform == "win32" or log_level in {"DEBUG", "TRACE"}:
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


def sweep_leftovers() -> None:
    """Delete the uploads and unfinished files that a killed Carina process of this user left behind."""
    settings = load_settings()
    sweep_scratch()
    for folder in (settings.config_dir, settings.state_dir, settings.cache_dir, settings.cache_dir / "maps"):
        sweep_drafts(folder)


_NETWORK_WARNING = (
    "Carina is listening on {host}: anyone on this network who has the link can see and change the open case, and the "
    "traffic is not encrypted. Omit --host to keep it on this machine."
)


_PHONE_WARNING = (
    "Carina's phone page is listening on {address}: anyone on this network who has its link can move the tip, but "
    "cannot see the case. Close it under Devices, or by stopping Carina."
)


def _check_path(path: str, cache: VolumeCache) -> None:
    """Raise the error of a path that cannot be opened, before a window opens."""
    from carina import volume
    from carina.case import CaseFile

    if is_case_file(path):
        CaseFile.open(path, read_only=True).close()
        return
    found = cache.find(path)
    if found is None or found.state != "unchanged":
        volume.inspect_path(path)


def _renderer_factory(backend: Backend) -> Any:
    from carina import render

    cache = load_settings().cache_dir / "maps"

    def make(volume: Any, transfer: Any) -> Any:
        return render.Renderer(volume, transfer=transfer, cache_dir=cache, backend=backend)

    return make


def _patient_citation() -> Citation:
    from carina.volume.demo import CITATION

    return CITATION


def _build_info() -> dict[str, Any]:
    from carina import render

    return render.build_info()
