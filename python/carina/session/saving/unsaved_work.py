"""Work on a case that could not be saved: its description, and the path of the last saved state."""

from __future__ import annotations

import contextlib
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from carina.case.document import Document
from carina.case.history import Step
from carina.case.stored_state import Moment
from carina.commands import Command
from carina.display import one_line
from carina.errors import UnsavedWorkError
from carina.session.core import Event
from carina.session.state.snapshot import ErrorEvent

NAMED_FILE_CODES = frozenset({"case.changed", "case.copy"})
"""Codes of messages about a named file without the latest changes, which the live file has."""
Subscribe = Callable[[Callable[[Event], None]], Callable[[], None]]
"""Adds a listener to a session, and returns the function that removes the listener."""

SHOWN_LABELS = 3
"""Maximum number of unsaved changes, the latest ones, that the message at closing lists."""
MAX_LABEL_CHARS = 80


@contextlib.contextmanager
def named_file_messages(subscribe: Subscribe) -> Iterator[list[str]]:
    """Collect the messages about named files without the latest changes while a session is closed.

    Parameters
    ----------
    subscribe
        The method ``subscribe`` of the session.
    """
    messages: list[str] = []

    def note(event: Event) -> None:
        if isinstance(event, ErrorEvent) and event.code in NAMED_FILE_CODES:
            messages.append(event.message)

    unsubscribe = subscribe(note)
    try:
        yield messages
    finally:
        unsubscribe()


@one_line
@dataclass(frozen=True, slots=True)
class UnsavedWork:
    """Work on one case that could not be saved."""

    case_number: int
    """Number of the case in the session."""
    title: str
    """Name of the case that the user gave, else the neutral alias."""
    labels: tuple[str, ...]
    """Labels of the unsaved changes, the oldest first."""
    num_flights: int
    """Number of recorded flights that are not saved completely."""
    problem: str
    """Reason why the work could not be saved."""
    saved_path: Path | None
    """Path of the live case file with the last saved state; None if no state was saved."""
    num_saved: int
    """Number of changes of the case that the live case file contains."""
    copy_path: Path | None = None
    """Path of the named file of the case, whose state may be older; None without a named file."""

    @property
    def amount(self) -> str:
        """Number of changes and recorded flights, for a message."""
        parts = [_count(len(self.labels), "change")] if self.labels else []
        if self.num_flights:
            parts.append(_count(self.num_flights, "recorded flight"))
        return " and ".join(parts)

    @property
    def shown_labels(self) -> str:
        """Labels of the last changes, the newest first, without control characters."""
        newest_first = tuple(reversed(self.labels))
        shown = "; ".join(_printable_text(label) for label in newest_first[:SHOWN_LABELS])
        more = len(newest_first) - SHOWN_LABELS
        return shown if more <= 0 else f"{shown}; and {more} more"

    @property
    def saved_state(self) -> str:
        """Description of the last saved state and its path, for a message."""
        if self.saved_path is None:
            return "nothing of this case has been saved yet"
        copy = "" if self.copy_path is None else f", and an earlier state in {self.copy_path}"
        return f"the last saved state, with {_count(self.num_saved, 'change')}, is in {self.saved_path}{copy}"


def unsaved_labels(saved: Moment | None, moment: Moment, *, renamed: bool = False) -> tuple[str, ...]:
    """Return the labels of the changes to a case since it was saved, the oldest first.

    Parameters
    ----------
    saved
        State of the case that was saved last; None if none was saved.
    moment
        The current state of the case.
    renamed
        Whether the name of the case is unsaved as well.
    """
    known = _KnownSteps(() if saved is None else saved.steps[: saved.position])
    done = [step.label for step in moment.steps[: moment.position] if not known.take(step)]
    undone = [step.label for step in moment.steps[moment.position :] if known.take(step)]
    name = ["name of the case"] if renamed else []
    return (*(f"undo: {label}" for label in undone), *done, *name)


def unsaved_error(lost: Sequence[UnsavedWork]) -> UnsavedWorkError:
    """Return the error that states the lost work, the reason, and the path of the last saved state."""
    sentences = [
        f"{one.amount} of {_printable_text(one.title)} could not be saved"
        f"{f' ({one.shown_labels})' if one.labels else ''}: {one.problem}; {one.saved_state}"
        for one in lost
    ]
    return UnsavedWorkError(". ".join(sentences))


def check_saved(path: Path, why: str, saved: Moment | None, moment: Moment) -> None:
    """Raise an error if the file of a case that is being closed lacks changes of this window or program.

    Parameters
    ----------
    path
        The file of the case.
    why
        Reason why the file cannot be written.
    saved, moment
        State of the case in the file, and its present state.

    Raises
    ------
    UnsavedWorkError
        If a change is in no file. A moved tip or another view is not a change.
    """
    labels = unsaved_labels(saved, moment)
    if labels:
        raise unsaved_error(
            [
                UnsavedWork(
                    case_number=0,
                    title=path.name,
                    labels=labels,
                    num_flights=0,
                    problem=why,
                    saved_path=path,
                    num_saved=0 if saved is None else saved.position,
                )
            ]
        )


class _KnownSteps:
    """Steps in a saved state of a case, with which the steps of another state are compared.

    A step is the same if its label, time and command are equal: a later change of one gesture replaces the step.
    A step without a command is equal to any, because a file does not store every command. Documents are not
    compared, because background jobs change them without a step.
    """

    def __init__(self, steps: Sequence[Step[Document]]) -> None:
        self._commands: defaultdict[tuple[str, float], list[Command | None]] = defaultdict(list)
        for step in steps:
            self._commands[step.label, step.at_s].append(step.command)

    def take(self, step: Step[Document]) -> bool:
        """Remove one equal step, and return whether there was one."""
        commands = self._commands[step.label, step.at_s]
        for n, command in enumerate(commands):
            if command is None or step.command is None or command == step.command:
                del commands[n]
                return True
        return False


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _printable_text(text: str) -> str:
    shown = "".join(char if char.isprintable() else "\ufffd" for char in text)
    return shown if len(shown) <= MAX_LABEL_CHARS else f"{shown[: MAX_LABEL_CHARS - 1]}\u2026"
