"""Undo and redo over immutable documents: one line of steps, and a place on it."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from carina.case.bounds import MAX_LABEL_CHARS, shortened
from carina.commands import Command
from carina.display import one_line

__all__ = ["MAX_STEPS", "History", "Step"]

D = TypeVar("D")

MERGE_WITHIN_S = 1.0
"""Changes of one gesture (a drag of the grey window) that follow each other within this time are one step."""
MAX_STEPS = 1000


@one_line
@dataclass(frozen=True, slots=True)
class Step(Generic[D]):
    """A change that can be taken back."""

    label: str
    """What was done, in words."""
    document: D
    """The document after it."""
    command: Command | None = None
    """What was asked for; None where it names things of this machine, or nobody asked by a command."""
    at_s: float = 0.0
    """When, in seconds since the case was begun."""


class History(Generic[D]):
    """A first document, the steps from there, and how many of them hold now.

    Parameters
    ----------
    document
        What the first step changes.
    steps, position
        Of a history that was kept: the whole line, and how many of its steps are not taken back; all unless told.
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
        return f"History({len(self._steps)} changes, {self._position} of them applied)"

    @property
    def first(self) -> D:
        """The document before all steps that are kept."""
        return self._first

    @property
    def steps(self) -> tuple[Step[D], ...]:
        """The whole line, the oldest first, with what was taken back and can be done again."""
        return tuple(self._steps)

    @property
    def position(self) -> int:
        """How many steps hold; those after are taken back."""
        return self._position

    @property
    def current(self) -> D:
        """The document shown."""
        return self._steps[self._position - 1].document if self._position else self._first

    @property
    def labels(self) -> tuple[str, ...]:
        """Of the steps that can be taken back, the oldest first."""
        return tuple(step.label for step in self._steps[: self._position])

    @property
    def undo_label(self) -> str | None:
        """What :meth:`undo` would take back, in words."""
        return self._steps[self._position - 1].label if self._position else None

    @property
    def redo_label(self) -> str | None:
        """What :meth:`redo` would do again, in words."""
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
        """Make a change that can be undone; changes of one gesture merge. What was taken back is forgotten."""
        merges = gesture is not None and gesture == self._gesture and now_s - self._gesture_s < MERGE_WITHIN_S
        del self._steps[self._position :]
        if merges and self._steps:
            label = self._steps.pop().label
        self._steps.append(Step(shortened(label, MAX_LABEL_CHARS), document, command, at_s))
        while len(self._steps) > MAX_STEPS:
            self._forget_oldest()
        self._position = len(self._steps)
        self._gesture, self._gesture_s = gesture, now_s

    def amend(self, edit: Callable[[D], D]) -> None:
        """Edit the current document and all others without a step: what the machine found by itself.

        The others too, else undoing an earlier change of a person would take the finding away with it.
        """
        self._first = edit(self._first)
        self._steps = [_with(step, edit(step.document)) for step in self._steps]

    def amend_current(self, edit: Callable[[D], D]) -> None:
        """Edit the current document alone, without a step."""
        if not self._position:
            self._first = edit(self._first)
        else:
            step = self._steps[self._position - 1]
            self._steps[self._position - 1] = _with(step, edit(step.document))

    def keep_distinct(self, what: Callable[[D], object], num_kept: int) -> None:
        """Forget the oldest steps until the documents hold at most this many different values of something large."""
        while self._position and len({id(what(document)) for document in self.documents()}) > num_kept:
            self._forget_oldest()
            self._position -= 1

    def fold_far(self, what: Callable[[D], object], num_near: int, fold: Callable[[D], D]) -> None:
        """Fold documents that hold something large and lie far from the current one.

        The nearest ``num_near`` different values of what is large stay as they are, forwards and backwards alike.
        """
        documents = self.documents()
        here = self._position
        near = {id(what(documents[here]))}
        for away in range(1, len(documents)):
            for place in (here - away, here + away):
                if 0 <= place < len(documents) and len(near) < num_near:
                    near.add(id(what(documents[place])))

        def folded(document: D) -> D:
            return document if id(what(document)) in near else fold(document)

        self._first = folded(self._first)
        self._steps = [_with(step, folded(step.document)) for step in self._steps]

    def documents(self) -> list[D]:
        """Return the first document, and the document after each step."""
        return [self._first, *(step.document for step in self._steps)]

    def undo(self) -> str | None:
        """Take back the last change; its label, or None where there is none."""
        label = self.undo_label
        if label is not None:
            self.go_to(self._position - 1)
        return label

    def redo(self) -> str | None:
        """Do the last change taken back again; its label, or None."""
        label = self.redo_label
        if label is not None:
            self.go_to(self._position + 1)
        return label

    def go_to(self, position: int) -> None:
        """Have so many steps hold, from 0 to all.

        Raises
        ------
        IndexError
            If there are not so many.
        """
        if not 0 <= position <= len(self._steps):
            raise IndexError(f"the history has {len(self._steps)} steps; there is no position {position}")
        self._position, self._gesture = position, None

    def _forget_oldest(self) -> None:
        self._first = self._steps.pop(0).document


def _with(step: Step[D], document: D) -> Step[D]:
    return step if document is step.document else replace(step, document=document)
