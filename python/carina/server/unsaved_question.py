"""The question on the terminal when Carina ends with unsaved work, and the error that is raised if work is lost."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import Protocol

from carina.display.escaped_text import printable
from carina.display.terminal import as_terminal_text
from carina.errors import CarinaError
from carina.session import Session
from carina.session.saving.unsaved_work import UnsavedWork, named_file_messages, unsaved_error

RETRY, QUIT = "r", "q"
HELP = (
    f"Type {RETRY} to try again, the path of another folder or file to save the case there, or {QUIT} to quit and lose "
    "these changes (Ctrl-C also quits)."
)
PROMPT = f"[{RETRY}/PATH/{QUIT}] "


class Terminal(Protocol):
    """Interface of a terminal on which the user answers questions."""

    @property
    def is_interactive(self) -> bool:
        """Whether a user is at the terminal who can answer the question."""

    def say(self, text: str) -> None:
        """Print a line on the terminal."""

    def ask(self, prompt: str) -> str | None:
        """Print a prompt, and return the line that the user types; None at the end of the input."""


class ConsoleTerminal:
    """Terminal that prints on standard error and reads standard input; standard output is reserved for ``--json``.

    Parameters
    ----------
    is_closed
        Whether the terminal was closed.
    """

    def __init__(self, *, is_closed: bool = False) -> None:
        self._is_closed = is_closed

    @property
    def is_interactive(self) -> bool:
        """Whether standard input and standard error are both connected to a terminal."""
        try:
            return not self._is_closed and sys.stdin.isatty() and sys.stderr.isatty()
        except (AttributeError, ValueError):  # closed, or a program without a console
            return False

    def say(self, text: str) -> None:
        """Print a line without the control characters of file names; do nothing if the terminal was closed."""
        with contextlib.suppress(OSError, ValueError):
            print(printable(as_terminal_text(text)), file=sys.stderr, flush=True)

    def ask(self, prompt: str) -> str | None:
        """Return the line that the user types; None at the end of the input or if the terminal was closed."""
        try:
            print(prompt, end="", file=sys.stderr, flush=True)
            line = sys.stdin.readline()
        except (OSError, ValueError):
            return None
        return line.strip() if line else None


def close_session(session: Session, terminal: Terminal) -> None:
    """Close a session; if a user can answer, first ask what to do with unsaved work.

    A user who interrupts quits at once. No window is left, so messages about a named file that could not be updated are
    printed.

    Raises
    ------
    UnsavedWorkError
        If work is lost, or a file to which the user saved the case lacks part of the work.
    """
    quits = False
    with named_file_messages(session.subscribe) as messages:
        try:
            if terminal.is_interactive:
                quits = not _ask_until_saved(session, terminal)
        except KeyboardInterrupt:
            quits = True
        with contextlib.suppress(KeyboardInterrupt):
            if quits:
                # The user has read the problem, so do not wait for the disk again.
                session.close(0.0)
            else:
                session.close()
        lost = session.cases.unsaved()
    for message in messages:
        terminal.say(f"carina: {message}")
    if lost:
        raise unsaved_error(lost)


def _ask_until_saved(session: Session, terminal: Terminal) -> bool:
    """Ask the user at the terminal until no work is unsaved, and return True; return False if the user quits."""
    while work := session.cases.unsaved():
        one = work[0]
        _print_unsaved_work(one, terminal)
        answer = terminal.ask(PROMPT)
        if answer is None or answer.lower() == QUIT:
            return False
        if answer in {"", "?"}:
            continue
        if answer.lower() != RETRY:
            try:
                terminal.say(f"saved as {session.cases.save_elsewhere(one.case_number, Path(answer))}")
            except CarinaError as error:
                terminal.say(f"carina: {error}")
    return True


def _print_unsaved_work(work: UnsavedWork, terminal: Terminal) -> None:
    terminal.say(f"Carina cannot close yet: {work.amount} of {work.title} not saved.")
    if work.labels:
        terminal.say(f"  latest changes: {work.shown_labels}")
    terminal.say(f"  reason: {work.problem}")
    terminal.say(f"  {work.saved_state}")
    terminal.say(HELP)
