"""The hub: the registry of connected windows, and the objects that all windows of a session share."""

from __future__ import annotations

import asyncio
import itertools
import logging
import threading
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, cast

from carina.commands import (
    Command,
    MaskFileNeeded,
    MeasureMovementFromFiles,
    OpenFiles,
    OpenSeries,
    ReadTrainingFiles,
    SeriesFiles,
    TakeKeyFrameFile,
    TakeMask,
    TakeTarget,
)
from carina.errors import CarinaError, ProtocolError, UsageError
from carina.render import Backend, ClusterStatus, build_info
from carina.server.cluster_status import ClusterWatch
from carina.server.devices import DeviceConnections, Phone
from carina.server.files.uploads import Uploads
from carina.server.frames.pacing import DEFAULT_RATE_HZ
from carina.server.observers.page import ObserverPageServer
from carina.server.observers.window import WatchingWindow
from carina.server.pacs_requests import PacsRequests
from carina.server.series_pictures import start_series_pictures, stop_series_pictures
from carina.server.windows.broadcast_cache import SharedTexts
from carina.server.windows.prefetch import PathPrefetcher
from carina.server.windows.window import Window
from carina.server.wire import messages as wire
from carina.session import Changed, Event, JobEnded, Session, log_fault
from carina.volume import Citation

logger = logging.getLogger(__name__)

MAX_WINDOWS = 8
"""Maximum number of connected windows, observers not counted; each window renders its own frames."""
CLASSROOM_S = 3.0
"""Interval in s at which the learners are read again while a teacher watches."""
FLOODED = (
    "an observer sent too many messages and was disconnected. The link for observers has changed; those who are still "
    "connected stay connected"
)
SWITCHED_OFF = "the person at the workstation has stopped sharing the case"


class Hub:
    """Registry of the connected windows, with the objects that they share: uploads, devices, broadcast texts.

    Parameters
    ----------
    session
        The session that the windows control.
    uploads
        Storage of files that users drop on a window.
    backend
        Processor of airway views that the user may change; None where another program renders them (a cluster).
    is_backend_forced
        Whether the environment has decided the processor.
    closes_session
        Whether :meth:`stop` closes the session; if False, the owner of the session closes it.
    """

    def __init__(
        self,
        session: Session,
        uploads: Uploads,
        *,
        clock: Callable[[], float] = time.monotonic,
        threads: int = 1,
        simd: str = "",
        backend: Backend | None = None,
        is_backend_forced: bool = False,
        patient_citation: Citation | None = None,
        recordings: Path | None = None,
        phone: Phone | None = None,
        cluster_status: Callable[[], ClusterStatus] | None = None,
        web: Path | None = None,
        watch_address: str | None = None,
        closes_session: bool = True,
    ) -> None:
        self.session = session
        self._closes_session = closes_session
        self.clock = clock
        self.threads = threads
        self.simd = simd
        self._backend = backend
        self._is_backend_forced = is_backend_forced
        if backend is not None:
            backend.subscribe(lambda words: self.in_loop(self._on_device_given_up, words))
        self._uploads = uploads
        self._pacs = PacsRequests(session)
        self._upload_of_job: dict[str, str] = {}
        self._mask_upload: str | None = None
        self._series_upload: str | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._windows: dict[int, Window] = {}
        self._numbers = itertools.count(1)
        self._leaving: list[threading.Thread] = []
        self._rate_hz = DEFAULT_RATE_HZ
        self.texts = SharedTexts(session, patient_citation, self._push_to_windows)
        self._warming = PathPrefetcher(session)
        self.devices = DeviceConnections(session, self._notify_windows, recordings=recordings, phone=phone)
        self._watch = None if cluster_status is None else ClusterWatch(cluster_status, self._notify_windows)
        self._watch_page = ObserverPageServer(
            self._attach_watcher,
            lambda: self._mark_topics("watching"),
            flooded=lambda: self._push_to_windows(wire.Notice(FLOODED)),
            web=web,
            address=watch_address,
        )
        self._watched_case = 0
        self._switching: set[asyncio.Task[None]] = set()
        self._following_classroom: asyncio.Task[None] | None = None
        """Task that reads the learners of the training at intervals; None while observers do not receive them."""
        self._unsubscribe: Callable[[], None] = lambda: None

    # ------------------------------------------------------------ start, stop, and connection of windows

    def start(self) -> None:
        """Subscribe to session events and start the shared services; call this method in the event loop."""
        self._loop = asyncio.get_running_loop()
        self._unsubscribe = self.session.subscribe(self._on_event)
        self._warming.start()
        self.devices.start()
        if self._watch is not None:
            self._watch.start()

    def stop(self) -> None:
        """Stop all windows and shared services, join their threads, and delete the uploads.

        The session is closed too if ``closes_session`` is True.
        """
        self._unsubscribe()
        self._warming.stop()
        self.devices.stop()
        if self._watch is not None:
            self._watch.stop()
        windows = tuple(self._windows.values())
        for window in windows:
            window.end()
        for thread in (*self._leaving, *(t for window in windows for t in window.threads)):
            thread.join()
        if self._closes_session:
            self.session.close()
        self._uploads.close()

    def attach(self, *, at_machine: bool = False) -> Window:
        """Add a window that can send every command, and return it; call this method in the event loop.

        Parameters
        ----------
        at_machine
            Whether the browser of the window runs on this machine.

        Raises
        ------
        ProtocolError
            With code ``protocol.too-many-windows`` if :data:`MAX_WINDOWS` windows are connected.
        """
        if len(self._command_windows) >= MAX_WINDOWS:
            msg = f"Carina is already open in {MAX_WINDOWS} windows; close one of them, then connect again"
            raise ProtocolError(msg, code="protocol.too-many-windows")
        window = Window(next(self._numbers), self, rate_hz=self._rate_hz, at_machine=at_machine)
        window.start()
        self._windows[window.number] = window
        self.devices.add_window()
        return window

    def _attach_watcher(self) -> WatchingWindow:
        """Add the window of an observer; raise UsageError if the observed case has been closed."""
        window = WatchingWindow(next(self._numbers), self)
        window.start()
        self._windows[window.number] = window
        return window

    def detach(self, window: Window) -> None:
        """Remove a disconnected window; call this method in the event loop.

        The method does not wait for the threads of the window.
        """
        del self._windows[window.number]
        window.end()
        if not window.watches:
            self.devices.remove_window(window.number)
            self._pacs.stop_queries(window.number)
            stop_series_pictures(self.session, window.number)
            # A page that the user reloads keeps its frame rate.
            self._rate_hz = window.pump.rate_hz
        self._leaving = [thread for thread in (*self._leaving, *window.threads) if thread.is_alive()]

    # ------------------------------------------------------------ messages to the windows

    @property
    def shares_learners(self) -> bool:
        """Whether observers receive the learners of the training: their pseudonyms, attempts and scores."""
        return self._watch_page.shares_learners

    @property
    def _command_windows(self) -> tuple[Window, ...]:
        """The windows that can send commands; observers are not included."""
        return tuple(window for window in self._windows.values() if not window.watches)

    def with_original_names(self, text: str) -> str:
        """Return a message in which dropped files have the names that the user knows."""
        return self._uploads.names.with_original_names(text)

    def _push_to_windows(self, message: Any) -> None:
        """Send a message to all windows except observers; call this method in the event loop.

        Observers are excluded because messages may contain file names, links and addresses.
        """
        for window in self._command_windows:
            window.outbox.push(message)

    def _notify_windows(self, message: Any) -> None:
        """Send a message to all windows except observers; callable from any thread."""
        self.in_loop(self._push_to_windows, message)

    def _mark_topics(self, *topics: str) -> None:
        for window in self._command_windows:
            window.mark(*topics)

    def watching_text(self) -> str:
        """Return the ``Watching`` message as JSON: the state of the viewing page and its observers."""
        return wire.encode_message(wire.Watching(self._watch_page.info(), self._watch_page.problem))

    def processor_text(self) -> str | None:
        """Return the ``ProcessorChoice`` message as JSON; None if the processor of airway views cannot be chosen."""
        backend = self._backend
        if backend is None:
            return None
        has_graphics = bool(build_info()["gpu"])
        return wire.encode_message(
            wire.ProcessorChoice(cast(Any, backend.mode), self._is_backend_forced, has_graphics, backend.trouble)
        )

    def _on_device_given_up(self, words: str) -> None:
        """Tell the user why pictures come from the CPU; called in the event loop."""
        self._push_to_windows(wire.Notice(words[:1].upper() + words[1:] + "."))
        self._mark_topics("processor")

    def _set_processor(self, choice: str) -> None:
        if self._backend is None:
            raise UsageError(
                "the cluster renders the airway view; there is nothing to choose", code="session.processor"
            )
        if self._is_backend_forced:
            raise UsageError(
                "the environment variable CARINA_BACKEND decides the processor; start Carina without it to choose here",
                code="session.processor",
            )
        self._backend.set_mode(choice)
        if self.session.store is not None:
            self.session.store.set_processor(choice)
        self._mark_topics("processor")
        for window in self._windows.values():
            window.pump.content_changed()

    def in_loop(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call a function in the event loop; callable from any thread."""
        loop = self._loop
        if loop is None or loop.is_closed():
            return
        try:
            loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:
            # The loop was closed after the check above: the server is shutting down.
            logger.debug("an event came after the end")

    def _on_event(self, event: Event) -> None:
        """Forward a session event to the event loop; the session calls this from any thread and holds its lock."""
        if isinstance(event, Changed) and "tree" in event.topics:
            self._warming.airways_changed()
        self.in_loop(self._on_session_event_in_loop, event)

    def _on_session_event_in_loop(self, event: Event) -> None:
        """Close the viewing page after a change of case, and delete uploads that no job needs any more."""
        if self._watch_page.is_open and self.session.snapshot().case_number != self._watched_case:
            self._run_as_task(self.close_watch_page("the case that you were watching was closed"))
        if isinstance(event, JobEnded):
            upload_id = self._upload_of_job.pop(event.job_id, None)
            if upload_id is not None and self._uploads.contains(upload_id, self.session.ask(SeriesFiles())):
                # The user may open another one of the dropped series, as long as a case of them is open.
                before, self._series_upload = self._series_upload, upload_id
                if before is not None and before != upload_id:
                    self._uploads.discard(before)
            elif upload_id is not None:
                self._uploads.discard(upload_id)
        series_upload = self._series_upload
        if series_upload is not None and not self._uploads.contains(series_upload, self.session.ask(SeriesFiles())):
            self._uploads.discard(series_upload)
            self._series_upload = None
        if self._mask_upload is not None and not self.session.ask(MaskFileNeeded()):
            self._uploads.discard(self._mask_upload)
            self._mask_upload = None

    # ------------------------------------------------------------ commands from the windows

    def do(self, message: Any, window: Window) -> None:
        """Pass a command to the session, or handle a message about the objects that the windows share."""
        match message:
            case Command():
                job_id = self.session.do(message, window=window.number)
                if isinstance(message, OpenSeries) and message.job_id in self._upload_of_job and job_id is not None:
                    # The dropped files are still needed: the new job reads another series of them.
                    self._upload_of_job[job_id] = self._upload_of_job.pop(message.job_id)
                self.devices.done(message)
            case wire.OpenUpload():
                self._start_upload_job(
                    OpenFiles(str(self._uploads.place(message.upload_id))), message.upload_id, window
                )
            case wire.OpenKeyFrames():
                self._start_upload_job(
                    TakeKeyFrameFile(self._uploads.place(message.upload_id)), message.upload_id, window
                )
            case wire.ImportMask():
                self._import_mask(message.upload_id, window)
            case wire.ImportTarget():
                place = self._uploads.place(message.upload_id)
                self._start_upload_job(TakeTarget(str(place), message.structure), message.upload_id, window)
            case wire.MeasureUpload():
                place = self._uploads.place(message.upload_id)
                command = MeasureMovementFromFiles(message.target_id, str(place))
                self._start_upload_job(command, message.upload_id, window)
            case wire.AcceptNotice():
                if self.session.store is not None:
                    self.session.store.accept_notice()
                self._mark_topics("start")
            case wire.ReadHints():
                if self.session.store is not None:
                    self.session.store.read_hints()
                self._mark_topics("start")
            case wire.SetProcessor():
                self._set_processor(message.choice)
            case wire.AskStorage():
                window.mark("start")
            case wire.AskSeriesPictures():
                start_series_pictures(self.session, window.number, window.send, message.list_id)
            case wire.StopSeriesPictures():
                stop_series_pictures(self.session, window.number)
            case wire.SetWatchPage():
                self._run_as_task(
                    self._open_watch_page(window, learners=message.learners)
                    if message.on
                    else self.close_watch_page(SWITCHED_OFF)
                )
            case wire.SendAway():
                self._watch_page.disconnect(message.number)
            case _ if self._pacs.handle(message, window) or self.devices.handle(message, window.number):
                pass
            case _:
                raise UsageError(
                    f"{type(message).__name__} can only be sent as the first message", code="protocol.order"
                )

    def _run_as_task(self, switching: Coroutine[Any, Any, None]) -> None:
        """Run a coroutine, which starts or stops the viewing page, as a task, so that windows do not wait for it."""
        task = asyncio.get_running_loop().create_task(switching)
        self._switching.add(task)
        task.add_done_callback(self._switching.discard)

    async def _open_watch_page(self, window: Window, *, learners: bool) -> None:
        try:
            self._watched_case = self.session.snapshot().case_number
            if self._watched_case == 0:
                raise UsageError("open a case first; then others can watch it", code="session.no-case")
            await self._watch_page.start()
            self._share_learners(learners)
        except CarinaError as error:
            window.outbox.push(wire.Error(error.code, str(error), None))
        except Exception as error:
            log_fault(logger, "the page for watchers could not be opened", error)
            words = f"the viewing page failed: internal error in Carina ({type(error).__name__})"
            window.outbox.push(wire.Error("carina.fault", words, None))
        if self.session.snapshot().case_number != self._watched_case:
            # Another case was opened while the viewing page was starting.
            await self.close_watch_page(SWITCHED_OFF)

    def _share_learners(self, learners: bool) -> None:
        """Start or stop sending the learners of the training to observers; the viewing page is open."""
        if self._watch_page.shares_learners == learners or not self._watch_page.is_open:
            return
        self._watch_page.shares_learners = learners
        self._mark_topics("watching")
        for window in self._windows.values():
            if window.watches:
                window.mark("training")
        self._stop_following_classroom()
        if learners:
            self._following_classroom = asyncio.get_running_loop().create_task(self._follow_classroom())

    async def _follow_classroom(self) -> None:
        """Read the learners again at intervals until cancelled: other machines may use the same folder."""
        while True:
            await asyncio.sleep(CLASSROOM_S)
            try:
                await asyncio.to_thread(self.session.do, ReadTrainingFiles())
            except Exception as error:
                # The loop continues, because the next reading may succeed.
                log_fault(logger, "the learners could not be read for the teacher's view", error)

    def _stop_following_classroom(self) -> None:
        task, self._following_classroom = self._following_classroom, None
        if task is not None:
            task.cancel()

    async def close_watch_page(self, words: str) -> None:
        """Stop the viewing page, and send the reason ``words`` to every connected observer."""
        await self._watch_page.stop(words)
        self._stop_following_classroom()

    def _start_upload_job(self, command: Command, upload_id: str, window: Window) -> None:
        """Start a job that reads dropped files, which are deleted after the job has ended or if it is refused.

        Uploads that begin meanwhile do not replace these files. The limit of uploads still bounds the disk, because
        a job replaces the running job of the same kind.
        """
        self._uploads.retain(upload_id)
        try:
            job_id = self.session.do(command, window=window.number)
        except BaseException:
            self._uploads.discard(upload_id)
            raise
        assert job_id is not None
        self._upload_of_job[job_id] = upload_id

    def _import_mask(self, upload_id: str, window: Window) -> None:
        """Import a dropped mask, and store its file until the mask is read.

        The session may first need an answer of the user, so the file can outlive the command.
        """
        place = self._uploads.place(upload_id)
        before, self._mask_upload = self._mask_upload, None
        self._uploads.retain(upload_id)
        try:
            self.session.do(TakeMask(str(place)), window=window.number)
        except BaseException:
            self._uploads.discard(upload_id)
            raise
        finally:
            if before is not None and before != upload_id:
                self._uploads.discard(before)
        self._mask_upload = upload_id
