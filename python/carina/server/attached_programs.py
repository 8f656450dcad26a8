"""WebSocket endpoint for programs of the user, such as notebooks, that send commands to the open case."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
from concurrent.futures import ThreadPoolExecutor

from starlette.websockets import WebSocket, WebSocketDisconnect

import carina
from carina.commands import Command, KeepNow
from carina.disk import disk_trouble, is_disk_trouble
from carina.errors import CarinaError, NoEvidenceError, ProtocolError, kind_of
from carina.server.network.access_checks import Gate, is_loopback
from carina.server.sockets.close_codes import close_socket
from carina.server.sockets.socket_io import receive_text
from carina.server.wire import messages as wire
from carina.session import AttachEndpoint, Changed, Event, JobGroup, Session, log_fault

logger = logging.getLogger(__name__)

JOIN_PATH = "/join"
_numbers = itertools.count(1)

JOIN_WITHIN_S = 20.0
MAX_WAITING = 64
"""Maximum number of queued messages; while the queue is full, the server reads no further message."""


def endpoint_of(gate: Gate) -> AttachEndpoint:
    """Return the address and secret with which programs of this machine join a server.

    Both fields of the result are None if the server is not reachable by loopback.
    """
    host = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "::1"}.get(gate.host, gate.host)
    if not is_loopback(host):
        return AttachEndpoint()
    shown = f"[{host}]" if ":" in host else host
    return AttachEndpoint(f"ws://{shown}:{gate.port}{JOIN_PATH}", gate.secret)


class JoinedProgram:
    """Executor of the commands of one program on one case; only one thread may use it at a time.

    Parameters
    ----------
    session
        Session in which the case is open.
    case_number
        Number of the case to which the commands apply; they are refused while another case is open.
    window
        Number of the program in the session; errors of its commands are sent to the program and to no window.
    """

    def __init__(self, session: Session, case_number: int, window: int | None = None) -> None:
        self._session = session
        self._case_number = case_number
        self._window = window
        self._job_group = JobGroup(case_number)

    def execute(self, message: Command | wire.Settle) -> wire.Settled | None:
        """Execute a command and return None, or wait for the jobs of the earlier commands and return their result."""
        if isinstance(message, wire.Settle):
            return self._wait_for_jobs(message)
        with self._job_group.doing():
            try:
                self._session.do(message, window=self._window)
            except CarinaError as error:
                self._job_group.failed(error)
            except OSError as error:
                self._job_group.failed(
                    disk_trouble(error, "the command failed", None)
                    if is_disk_trouble(error)
                    else _internal_error(error)
                )
            except Exception as error:
                self._job_group.failed(_internal_error(error))
        return None

    def _wait_for_jobs(self, message: wire.Settle) -> wire.Settled:
        job_group, self._job_group = self._job_group, JobGroup(self._case_number)
        problems = list(job_group.wait())
        if message.all_jobs:
            self._session.jobs.wait_idle(None)
        unsaved: str | None = None
        with self._job_group.doing():
            try:
                self._session.do(KeepNow())
            except CarinaError as error:
                if error.code == "case.not-saved":
                    unsaved = str(error)
                else:
                    problems.append(error)
        return wire.Settled(
            settle_id=message.settle_id,
            problems=tuple(map(problem_message, problems)),
            unsaved=unsaved,
            saving=self._session.snapshot().saving,
        )


def problem_message(error: CarinaError) -> wire.Problem:
    """Return the wire message of an error, from which the attached program raises an error of the same class."""
    problem = wire.Problem(kind_of(error), error.code, str(error))
    if not isinstance(error, NoEvidenceError):
        return problem
    return wire.Problem(
        problem.kind,
        problem.code,
        problem.message,
        doubtful_mm=float(error.doubtful_mm),
        way_lps=tuple((float(x), float(y), float(z)) for x, y, z in error.way_lps),
        doubtful=tuple(float(one) for one in error.doubtful),
    )


def _internal_error(trouble: BaseException) -> CarinaError:
    log_fault(logger, "a command of a program failed", trouble)
    words = f"the command failed: internal error in Carina ({type(trouble).__name__})"
    return CarinaError(words, code="carina.fault")


async def serve_program(websocket: WebSocket, session: Session) -> None:
    """Serve one attached program (such as a notebook) until it disconnects or its case is closed."""
    try:
        async with asyncio.timeout(JOIN_WITHIN_S):
            join = wire.parse_join_message(await receive_text(websocket, who="program"))
        if not isinstance(join, wire.Join):
            raise ProtocolError("the first message must be join", code="protocol.order")
        if join.wire_version != wire.WIRE_VERSION:
            raise ProtocolError(
                f"this program uses protocol version {join.wire_version} and Carina uses version {wire.WIRE_VERSION}; "
                "use the same version of Carina for both",
                code="protocol.version",
            )
        open_case = session.cases.open_case
        if open_case is None or open_case[0] != join.case_id:
            raise ProtocolError("this case is not open here", code="protocol.case-closed")
        await websocket.send_text(wire.encode_message(wire.Joined(carina.__version__)))
        await _run_program(websocket, session, open_case[1])
    except ProtocolError as error:
        await close_socket(websocket, error.code, str(error))
    except TimeoutError:
        await close_socket(websocket, "protocol.order", "the program sent no join message")
    except WebSocketDisconnect:
        pass


async def _run_program(websocket: WebSocket, session: Session, case_number: int) -> None:
    # Programs have negative numbers, because windows have numbers from 1.
    window = -next(_numbers)
    program = JoinedProgram(session, case_number, window)
    waiting: asyncio.Queue[Command | wire.Settle] = asyncio.Queue(MAX_WAITING)
    loop, closed = asyncio.get_running_loop(), asyncio.Event()

    def note_event(event: Event) -> None:
        if isinstance(event, Changed) and "start" in event.topics and session.snapshot().case_number != case_number:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(closed.set)

    async def read() -> None:
        while True:
            message = wire.parse_join_message(await receive_text(websocket, who="program"))
            if isinstance(message, wire.Join):
                raise ProtocolError("join can only be the first message", code="protocol.order")
            await waiting.put(message)

    async def work() -> None:
        while True:
            answer = await loop.run_in_executor(thread, program.execute, await waiting.get())
            if answer is not None:
                await websocket.send_text(wire.encode_message(answer))

    async def end() -> None:
        await closed.wait()
        raise ProtocolError("the case was closed", code="protocol.case-closed")

    # A separate thread, because take() waits until jobs have ended.
    thread = ThreadPoolExecutor(1, thread_name_prefix="carina-joined")
    unsubscribe = session.subscribe(note_event, window=window)
    tasks = [asyncio.create_task(one) for one in (read(), work(), end())]
    try:
        if session.snapshot().case_number != case_number:
            closed.set()
        ended, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in ended:
            task.result()
    finally:
        unsubscribe()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        thread.shutdown(wait=False, cancel_futures=True)
