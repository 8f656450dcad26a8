"""Connection from a program to the process that owns its case: it sends commands and receives their results."""

from __future__ import annotations

import contextlib
import json
import logging
import queue
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from carina.commands import Command
from carina.errors import CarinaError, NoEvidenceError, error_of
from carina.session.attach.messages import Join, Joined, Problem, Settle, Settled
from carina.session.store.attach_endpoint import AttachEndpoint
from carina.typed_reading import read_json
from carina.value import FrozenValue
from carina.version import WIRE_VERSION

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

logger = logging.getLogger(__name__)

ANSWERS_WITHIN_S = 20.0
"""Time limit, in s, for the reply of an owner. If no process listens, the system refuses the connection at once.

An owner on a busy machine replies late."""
MAX_ANSWER_BYTES = 64 << 20
CLOSED_CODES = frozenset({"case.closed", "session.no-case"})
"""Error codes of the replies by which the owner of a case reports that it has closed the case."""


class LinkLostError(CarinaError):
    """Error for a lost owner process, which has ended or closed the case; unconfirmed commands may have been run."""

    code = "case.owner-gone"


class OwnerConnection:
    """Connection to the owner of a case, created by :meth:`connect` and used by one thread at a time.

    Parameters
    ----------
    socket
        Open connection, from which the first message has been read.
    close
        Closes the connection.
    """

    def __init__(self, socket: ClientConnection, close: Callable[[], None]) -> None:
        self._socket = socket
        self._close = close
        self._answers: queue.SimpleQueue[Settled | None] = queue.SimpleQueue()
        self._num_settled = 0
        self._ended = threading.Event()
        threading.Thread(target=self._read, name="carina-owner", daemon=True).start()

    @classmethod
    def connect(cls, endpoint: AttachEndpoint, case_id: str) -> OwnerConnection | None:
        """Connect to the owner of a case; return None if no process replies or the case is no longer open there."""
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        if endpoint.url is None:
            return None
        with contextlib.ExitStack() as opened:
            try:
                socket = opened.enter_context(
                    connect(
                        endpoint.url,
                        additional_headers={"Authorization": f"Bearer {endpoint.token}"},
                        compression=None,
                        # The address is on this machine, so a proxy of the environment must not be used.
                        proxy=None,
                        open_timeout=ANSWERS_WITHIN_S,
                        close_timeout=1.0,
                        max_size=MAX_ANSWER_BYTES,
                    )
                )
                socket.send(_message_text(Join(WIRE_VERSION, case_id)))
                read_json(socket.recv(timeout=ANSWERS_WITHIN_S), Joined)
            except (OSError, WebSocketException, msgspec.MsgspecError) as error:
                logger.debug("no owner answers: %s", type(error).__name__)
                return None
            return cls(socket, opened.pop_all().close)

    def do(self, command: Command) -> Settled:
        """Run a command in the owner's process, and wait for it and its jobs.

        Raises
        ------
        LinkLostError
            If the owner ended before it confirmed the command.
        CarinaError
            The error of the command in the owner's process.
        """
        settled = self.settle(command)
        if settled.problems:
            raise error_from_problem(settled.problems[0])
        return settled

    def settle(self, *commands: Command, all_jobs: bool = False) -> Settled:
        """Send commands, and wait until these and all earlier commands are done and stored on the disk.

        Return the reply.

        With ``all_jobs`` the call also waits for jobs that other programs and windows have started.

        Raises
        ------
        LinkLostError
            If the owner has ended or closed the case.
        """
        from websockets.exceptions import ConnectionClosed

        self._num_settled += 1
        try:
            for message in (*commands, Settle(self._num_settled, all_jobs)):
                self._socket.send(_message_text(message))
        except (OSError, ConnectionClosed) as error:
            raise LinkLostError("the program that had this case open has ended or closed it") from error
        while (settled := self._answers.get()) is not None:
            if settled.settle_id == self._num_settled:
                if any(problem.code in CLOSED_CODES for problem in settled.problems):
                    break
                return settled
        raise LinkLostError("the program that had this case open has ended or closed it")

    def watch(self, lost: Callable[[OwnerConnection], None]) -> None:
        """Call ``lost`` from a separate thread as soon as the connection ends, even while no command waits."""

        def wait() -> None:
            self._ended.wait()
            lost(self)

        threading.Thread(target=wait, name="carina-owner-gone", daemon=True).start()

    def close(self) -> None:
        """Close the connection."""
        self._close()

    def _read(self) -> None:
        """Read the owner's replies into the queue of replies until the connection ends."""
        try:
            for text in self._socket:
                self._answers.put(read_json(text, Settled))
        except (OSError, msgspec.MsgspecError) as error:
            logger.warning("the program that has a case open sent an invalid message: %s", type(error).__name__)
        except Exception as error:  # Any error of the library ends the connection.
            logger.debug("the owner of a case has gone: %s", type(error).__name__)
        finally:
            self._answers.put(None)
            self._ended.set()


def error_from_problem(problem: Problem) -> CarinaError:
    """Return the Carina error of the class and text that the owner process stated in its problem message."""
    if problem.doubtful_mm is not None and problem.way_lps is not None and problem.doubtful is not None:
        return NoEvidenceError(
            problem.message,
            doubtful_mm=problem.doubtful_mm,
            way_lps=np.array(problem.way_lps, dtype=np.float64).reshape(-1, 3),
            doubtful=np.array(problem.doubtful, dtype=np.float64) > 0.5,
        )
    return error_of(problem.kind, problem.message, code=problem.code)


def _message_text(message: FrozenValue) -> str:
    return json.dumps(msgspec.to_builtins(message), allow_nan=False, separators=(",", ":"))
