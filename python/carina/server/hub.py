"""Between the session and the windows that are connected: who is there, and what they share."""

from __future__ import annotations

import asyncio
import itertools
import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from carina.commands import Command, MaskFileNeeded, OpenFiles, TakeKeyFile, TakeMask
from carina.errors import CarinaError, ProtocolError, UsageError
from carina.render import ClusterStatus
from carina.server import messages as wire
from carina.server.cluster_watch import ClusterWatch
from carina.server.device_desk import DeviceDesk, Phone
from carina.server.pacing import DEFAULT_RATE_HZ
from carina.server.shared_texts import SharedTexts
from carina.server.uploads import Uploads
from carina.server.warming import Warming
from carina.server.window import Machine, Window
from carina.session import Changed, Event, JobEnded, Session
from carina.volume import Citation

__all__ = ["MAX_WINDOWS", "Hub"]

logger = logging.getLogger(__name__)

MAX_WINDOWS = 8
"""Each renders its own pictures."""


class Hub:
    """Owns the windows, and what belongs to none of them alone: uploads, devices, texts that all are sent.

    Parameters
    ----------
    session
        What is driven.
    uploads
        Dropped files.
    """

    def __init__(
        self,
        session: Session,
        uploads: Uploads,
        *,
        clock: Callable[[], float] = time.monotonic,
        threads: int = 1,
        simd: str = "",
        patient_citation: Citation | None = None,
        recordings: Path | None = None,
        phone: Phone | None = None,
        cluster_status: Callable[[], ClusterStatus] | None = None,
    ) -> None:
        self.session = session
        self._uploads = uploads
        self._upload_of_job: dict[str, str] = {}
        self._mask_upload: str | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._machine = Machine(clock, threads, simd, self._in_loop)
        self._windows: dict[int, Window] = {}
        self._numbers = itertools.count(1)
        self._leaving: list[threading.Thread] = []
        self._rate_hz = DEFAULT_RATE_HZ
        self._texts = SharedTexts(session, patient_citation, self._push)
        self._warming = Warming(session)
        self.devices = DeviceDesk(session, self._tell, recordings=recordings, phone=phone)
        self._watch = None if cluster_status is None else ClusterWatch(cluster_status, self._tell)
        self._unsubscribe: Callable[[], None] = lambda: None

    # ------------------------------------------------------------ life

    def start(self) -> None:
        """Begin; from the event loop."""
        self._loop = asyncio.get_running_loop()
        self._unsubscribe = self.session.subscribe(self._on_event)
        self._warming.start()
        self.devices.start()
        if self._watch is not None:
            self._watch.start()

    def stop(self) -> None:
        """End the windows' threads and the session's jobs."""
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
        self.session.close()
        self._uploads.close()

    def attach(self) -> Window:
        """One window more, which gets everything; from the event loop.

        Raises
        ------
        ProtocolError
            ``protocol.too-many-windows``.
        """
        if len(self._windows) >= MAX_WINDOWS:
            msg = f"Carina is already open in {MAX_WINDOWS} windows; close one of them, then connect again"
            raise ProtocolError(msg, code="protocol.too-many-windows")
        window = Window(next(self._numbers), self.session, self._machine, self._texts, self._do, rate_hz=self._rate_hz)
        window.start()
        self._windows[window.number] = window
        self.devices.window_came()
        return window

    def detach(self, window: Window) -> None:
        """A window is gone; from the event loop, which waits for nothing."""
        del self._windows[window.number]
        window.end()
        self.devices.window_went(window.number)
        # A page that is loaded again goes on as it was.
        self._rate_hz = window.pump.rate_hz
        self._leaving = [thread for thread in (*self._leaving, *window.threads) if thread.is_alive()]

    # ------------------------------------------------------------ out

    def with_own_names(self, text: str) -> str:
        """A message in which dropped files have the names by which the person knows them."""
        return self._uploads.names.restored(text)

    def _push(self, message: Any) -> None:
        """Tell all windows; event loop only."""
        for window in self._windows.values():
            window.outbox.push(message)

    def _tell(self, message: Any) -> None:
        """Tell all windows; from any thread."""
        self._in_loop(self._push, message)

    def _mark(self, *topics: str) -> None:
        for window in self._windows.values():
            window.mark(*topics)

    def _in_loop(self, function: Callable[..., None], *arguments: Any) -> None:
        loop = self._loop
        if loop is None or loop.is_closed():
            return
        try:
            loop.call_soon_threadsafe(function, *arguments)
        except RuntimeError:
            # The loop closed between the look and the call: the server is ending.
            logger.debug("an event came after the end")

    def _on_event(self, event: Event) -> None:
        """From any thread, with the session locked: hand on and return."""
        if isinstance(event, Changed) and "tree" in event.topics:
            self._warming.airways_changed()
        self._in_loop(self._discard_uploads, event)

    def _discard_uploads(self, event: Event) -> None:
        """Those that nobody reads any more."""
        if isinstance(event, JobEnded):
            upload_id = self._upload_of_job.pop(event.job_id, None)
            if upload_id is not None:
                self._uploads.discard(upload_id)
        if self._mask_upload is not None and not self.session.ask(MaskFileNeeded()):
            self._uploads.discard(self._mask_upload)
            self._mask_upload = None

    # ------------------------------------------------------------ in

    def _do(self, message: Any, window: Window) -> None:
        """A command is the session's; the rest is about what the windows share."""
        match message:
            case Command():
                self.session.do(message, window=window.number)
                self.devices.done(message)
            case wire.OpenUpload():
                self._keep_for(OpenFiles(str(self._uploads.place(message.upload_id))), message.upload_id, window)
            case wire.OpenKeys():
                self._keep_for(TakeKeyFile(self._uploads.place(message.upload_id)), message.upload_id, window)
            case wire.ImportMask():
                self._import_mask(message.upload_id, window)
            case wire.AcceptNotice():
                if self.session.store is not None:
                    self.session.store.accept_notice()
                self._mark("start")
            case wire.AskStorage():
                window.mark("start")
            case _ if self.devices.handle(message, window.number):
                pass
            case _:
                raise UsageError(
                    f"{type(message).__name__} can only be sent as the first message", code="protocol.order"
                )

    def _keep_for(self, command: Command, upload_id: str, window: Window) -> None:
        """The dropped files stay until the job that reads them has ended."""
        job_id = self.session.do(command, window=window.number)
        assert job_id is not None
        self._upload_of_job[job_id] = upload_id

    def _import_mask(self, upload_id: str, window: Window) -> None:
        """The file is kept until the mask is read, which may take an answer."""
        place = self._uploads.place(upload_id)
        before, self._mask_upload = self._mask_upload, None
        try:
            self.session.do(TakeMask(str(place)), window=window.number)
        except CarinaError:
            self._uploads.discard(upload_id)
            raise
        finally:
            if before is not None and before != upload_id:
                self._uploads.discard(before)
        self._mask_upload = upload_id
