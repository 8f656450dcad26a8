"""The way from a program to the process that owns its case: commands there, and how they ended back."""

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
from carina.session.doors import Door
from carina.session.join_messages import Join, Joined, Problem, Settle, Settled
from carina.typed_reading import read_json
from carina.value import FrozenValue
from carina.version import WIRE_VERSION

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

__all__ = ["LinkLostError", "OwnerLink"]

logger = logging.getLogger(__name__)

ANSWERS_WITHIN_S = 20.0
"""A process on this machine that does not take a program within this time has no door. Where nobody listens any more
the system refuses at once; an owner on a busy machine answers late."""
MAX_ANSWER_BYTES = 64 << 20
CLOSED_CODES = frozenset({"case.closed", "session.no-case"})
"""What an owner says that has let the case go."""


class LinkLostError(CarinaError):
    """The owner has gone, or has let the case go; what was not confirmed may have been done."""

    code = "case.owner-gone"


class OwnerLink:
    """A connection with the owner of a case: :meth:`connect` makes one. Used from one thread at a time.

    Parameters
    ----------
    socket
        Open, the first message taken.
    close
        Closes it.
    """

    def __init__(self, socket: ClientConnection, close: Callable[[], None]) -> None:
        self._socket = socket
        self._close = close
        self._answers: queue.SimpleQueue[Settled | None] = queue.SimpleQueue()
        self._num_settled = 0
        self._ended = threading.Event()
        threading.Thread(target=self._read, name="carina-owner", daemon=True).start()

    @classmethod
    def connect(cls, door: Door, case_id: str) -> OwnerLink | None:
        """None where nobody answers, or the case is not open there any more."""
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        if door.url is None:
            return None
        with contextlib.ExitStack() as opened:
            try:
                socket = opened.enter_context(
                    connect(
                        door.url,
                        additional_headers={"Authorization": f"Bearer {door.token}"},
                        compression=None,
                        # To this machine, whatever the environment says of the way to others.
                        proxy=None,
                        open_timeout=ANSWERS_WITHIN_S,
                        close_timeout=1.0,
                        max_size=MAX_ANSWER_BYTES,
                    )
                )
                socket.send(_text(Join(WIRE_VERSION, case_id)))
                read_json(socket.recv(timeout=ANSWERS_WITHIN_S), Joined)
            except (OSError, WebSocketException, msgspec.MsgspecError) as trouble:
                logger.debug("no owner answers: %s", type(trouble).__name__)
                return None
            return cls(socket, opened.pop_all().close)

    def do(self, command: Command) -> Settled:
        """Have a command done, and wait for what goes on with it.

        Raises
        ------
        LinkLostError
            If the owner has gone before it said that it is done.
        CarinaError
            As the command ended there.
        """
        settled = self.settle(command)
        if settled.problems:
            raise raised(settled.problems[0])
        return settled

    def settle(self, *commands: Command, all_jobs: bool = False) -> Settled:
        """Wait until all that was asked for is done and on the disk, with ``all_jobs`` also what others have started.

        Raises
        ------
        LinkLostError
            If the owner has gone.
        """
        from websockets.exceptions import ConnectionClosed

        self._num_settled += 1
        try:
            for message in (*commands, Settle(self._num_settled, all_jobs)):
                self._socket.send(_text(message))
        except (OSError, ConnectionClosed) as trouble:
            raise LinkLostError("the program that had this case open has ended or closed it") from trouble
        while (settled := self._answers.get()) is not None:
            if settled.settle_id == self._num_settled:
                if any(problem.code in CLOSED_CODES for problem in settled.problems):
                    break
                return settled
        raise LinkLostError("the program that had this case open has ended or closed it")

    def watch(self, lost: Callable[[OwnerLink], None]) -> None:
        """Have somebody told, from a thread of their own, when the owner has gone: also while nothing is asked."""

        def wait() -> None:
            self._ended.wait()
            lost(self)

        threading.Thread(target=wait, name="carina-owner-gone", daemon=True).start()

    def close(self) -> None:
        """Leave."""
        self._close()

    def _read(self) -> None:
        """Until the connection ends."""
        try:
            for text in self._socket:
                self._answers.put(read_json(text, Settled))
        except (OSError, msgspec.MsgspecError) as trouble:
            logger.warning("the program that has a case open sent an invalid message: %s", type(trouble).__name__)
        except Exception as trouble:  # of the library: the connection is at its end, however it came to it
            logger.debug("the owner of a case has gone: %s", type(trouble).__name__)
        finally:
            self._answers.put(None)
            self._ended.set()


def raised(problem: Problem) -> CarinaError:
    """The error that the owner told of."""
    if problem.doubtful_mm is not None and problem.way_lps is not None and problem.doubtful is not None:
        return NoEvidenceError(
            problem.message,
            doubtful_mm=problem.doubtful_mm,
            way_lps=np.array(problem.way_lps, dtype=np.float64).reshape(-1, 3),
            doubtful=np.array(problem.doubtful, dtype=np.float64) > 0.5,
        )
    return error_of(problem.kind, problem.message, code=problem.code)


def _text(message: FrozenValue) -> str:
    return json.dumps(msgspec.to_builtins(message), allow_nan=False, separators=(",", ":"))
