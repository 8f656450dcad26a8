"""Undo and redo over immutable documents: a list of steps, and the current position in it."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from carina.case.bounds import MAX_LABEL_CHARS, shortened_text
from carina.commands import Command
from carina.display import one_line

D = TypeVar("D")

MERGE_WITHIN_S = 1.0
"""Maximum pause in seconds between changes of one gesture, such as a drag of the grey window, that form one step."""
MAX_STEPS = 1000


@one_line
@dataclass(frozen=True, slots=True)
class Step(Generic[D]):
    """Change of a case that can be undone."""

    label: str
    """Description of the change for the user."""
    document: D
    """The case's document after the change."""
    command: Command | None = None
    """The command that caused the change; None if it refers to this machine, or if no command caused the change."""
    at_s: float = 0.0
    """Time of the change in seconds since the creation of the case."""


class History(Generic[D]):
    """Document before all stored steps (changes), these steps, and the number of steps that are not undone.

    Parameters
    ----------
    document
        The document before the first step.
    steps, position
        All steps of a saved history, and the number of steps that are not undone; None means all.
    """

    def __init__(self, document: D, steps: Sequence[Step[D]] = (), position: int | None = None) -> None:
        self._first = document
        self._steps = list(steps)
        self._position = len(self._steps) if position is None else position
        if not 0 <= self._position <= len(self._steps):
            raise ValueError(f"expected a position from 0 to {len(self._steps)} in the history; found {position}")
        self._gesture: Hashable = None
        self._gesture_s = float("-inf")

    def __repr__(self) -> str:
        """Return a text with the number of steps and the number of steps in effect."""
        return f"History({len(self._steps)} changes, {self._position} of them applied)"

    @property
    def first(self) -> D:
        """Document before the first stored step."""
        return self._first

    @property
    def steps(self) -> tuple[Step[D], ...]:
        """All steps, the oldest first, including undone steps that :meth:`redo` can repeat."""
        return tuple(self._steps)

    @property
    def position(self) -> int:
        """Number of steps of the history that are in effect; the user has undone the steps after this number."""
        return self._position

    @property
    def current(self) -> D:
        """Document after the last step that is not undone."""
        return self._steps[self._position - 1].document if self._position else self._first

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the steps that can be undone, the oldest first."""
        return tuple(step.label for step in self._steps[: self._position])

    @property
    def undo_label(self) -> str | None:
        """Label of the step that :meth:`undo` would undo; None if there is none."""
        return self._steps[self._position - 1].label if self._position else None

    @property
    def redo_label(self) -> str | None:
        """Label of the step that :meth:`redo` would repeat; None if there is none."""
        return self._steps[self._position].label if self._position < len(self._steps) else None

    def change(
        self,
        label: str,
        document: D,
        *,
        now_s: float,
        gesture: Hashable = None,
        command: Command | None = None,
        at_s: float = 0.0,
    ) -> None:
        """Add a step, and delete the undone steps; consecutive changes of one gesture become one step.

        Parameters
        ----------
        label
            Description of the change for the user.
        document
            The document after the change.
        now_s
            Current time in seconds on a monotonic clock, to find out whether changes of a gesture follow closely.
        gesture
            Identifies the gesture; None for a change that always becomes its own step.
        command
            The command that caused the change; None if none did.
        at_s
            Time of the change in seconds since the creation of the case.
        """
        merges = gesture is not None and gesture == self._gesture and now_s - self._gesture_s < MERGE_WITHIN_S
        del self._steps[self._position :]
        if merges and self._steps:
            label = self._steps.pop().label
        self._steps.append(Step(shortened_text(label, MAX_LABEL_CHARS), document, command, at_s))
        while len(self._steps) > MAX_STEPS:
            self._forget_oldest()
        self._position = len(self._steps)
        self._gesture, self._gesture_s = gesture, now_s

    def amend(self, edit: Callable[[D], D]) -> None:
        """Apply an edit to all documents without adding a step, for results that Carina computes by itself.

        All documents are edited, because otherwise undoing an earlier change of the user would remove the result.
        """
        self._first = edit(self._first)
        self._steps = [_with_document(step, edit(step.document)) for step in self._steps]

    def amend_current(self, edit: Callable[[D], D]) -> None:
        """Apply an edit to the document at the current position only, without adding a step."""
        if not self._position:
            self._first = edit(self._first)
        else:
            step = self._steps[self._position - 1]
            self._steps[self._position - 1] = _with_document(step, edit(step.document))

    def keep_distinct(self, what: Callable[[D], object], max_distinct: int) -> None:
        """Delete the oldest steps until the documents contain at most ``max_distinct`` different values of ``what``.

        The deletion limits the memory for ``what(document)``, a large part of the document; values are compared by
        identity. The step at the current position is never deleted.

        Parameters
        ----------
        what
            Returns the large part of a document.
        max_distinct
            Largest number of different large parts.
        """
        while self._position and len({id(what(document)) for document in self.documents()}) > max_distinct:
            self._forget_oldest()
            self._position -= 1

    def fold_far(self, what: Callable[[D], object], num_near: int, fold: Callable[[D], D]) -> None:
        """Replace the documents far from the present one by ``fold(document)``, which takes less memory.

        The ``num_near`` different objects ``what(document)`` that are nearest to the current position, in both
        directions, stay unfolded.

        Parameters
        ----------
        what
            Returns the large part of a document.
        num_near
            Number of different large parts that stay unfolded.
        fold
            Returns a document whose large part takes less memory.
        """
        documents = self.documents()
        here = self._position
        near = {id(what(documents[here]))}
        for away in range(1, len(documents)):
            for place in (here - away, here + away):
                if 0 <= place < len(documents) and len(near) < num_near:
                    near.add(id(what(documents[place])))

        def fold_step(document: D) -> D:
            return document if id(what(document)) in near else fold(document)

        self._first = fold_step(self._first)
        self._steps = [_with_document(step, fold_step(step.document)) for step in self._steps]

    def documents(self) -> list[D]:
        """Return the first document, and the document after each step."""
        return [self._first, *(step.document for step in self._steps)]

    def undo(self) -> str | None:
        """Undo the latest step in effect and return its label; None if there is none."""
        label = self.undo_label
        if label is not None:
            self.go_to(self._position - 1)
        return label

    def redo(self) -> str | None:
        """Repeat the step that was undone last and return its label; None if there is none."""
        label = self.redo_label
        if label is not None:
            self.go_to(self._position + 1)
        return label

    def go_to(self, position: int) -> None:
        """Move to a position, which is the number of steps that are then in effect; the later steps are undone.

        Parameters
        ----------
        position
            From 0 to the number of steps.

        Raises
        ------
        IndexError
            If the position is out of this range.
        """
        if not 0 <= position <= len(self._steps):
            raise IndexError(f"the history has {len(self._steps)} steps; there is no position {position}")
        self._position, self._gesture = position, None

    def _forget_oldest(self) -> None:
        self._first = self._steps.pop(0).document


def _with_document(step: Step[D], document: D) -> Step[D]:
    return step if document is step.document else replace(step, document=document)
