"""Undo and redo over immutable documents."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

__all__ = ["History"]

D = TypeVar("D")

MERGE_WITHIN_S = 1.0
"""Changes of one gesture (a drag of the grey window) that follow each other within this time are one step."""
MAX_STEPS = 200


@dataclass(frozen=True, slots=True)
class _Step(Generic[D]):
    label: str
    document: D
    """The document on the other side of the step."""


class History(Generic[D]):
    """A current document, what led to it, and what was taken back."""

    def __init__(self, document: D) -> None:
        self._current = document
        self._undo: list[_Step[D]] = []
        self._redo: list[_Step[D]] = []
        self._gesture: Hashable = None
        self._gesture_s = float("-inf")

    @property
    def current(self) -> D:
        """The document shown."""
        return self._current

    @property
    def labels(self) -> tuple[str, ...]:
        """Of the steps that can be taken back, the oldest first."""
        return tuple(step.label for step in self._undo)

    @property
    def undo_label(self) -> str | None:
        """What :meth:`undo` would take back, in words."""
        return self._undo[-1].label if self._undo else None

    @property
    def redo_label(self) -> str | None:
        """What :meth:`redo` would do again, in words."""
        return self._redo[-1].label if self._redo else None

    def change(self, label: str, document: D, *, now_s: float, gesture: Hashable = None) -> None:
        """Make a change that can be undone; changes of one gesture merge."""
        merges = gesture is not None and gesture == self._gesture and now_s - self._gesture_s < MERGE_WITHIN_S
        if not (merges and self._undo):
            self._undo.append(_Step(label, self._current))
            del self._undo[:-MAX_STEPS]
        self._redo.clear()
        self._current = document
        self._gesture, self._gesture_s = gesture, now_s

    def amend(self, edit: Callable[[D], D]) -> None:
        """Edit the current document and all others without a step: what the machine found by itself.

        The others too, else undoing an earlier change of a person would take the finding away with it.
        """
        self._current = edit(self._current)
        self._undo = [_Step(step.label, edit(step.document)) for step in self._undo]
        self._redo = [_Step(step.label, edit(step.document)) for step in self._redo]

    def amend_current(self, edit: Callable[[D], D]) -> None:
        """Edit the current document alone, without a step."""
        self._current = edit(self._current)

    def keep_distinct(self, what: Callable[[D], object], num_kept: int) -> None:
        """Forget the oldest steps until the documents hold at most this many different values of something large."""
        while self._undo and len({id(what(d)) for d in self._documents()}) > num_kept:
            del self._undo[0]

    def fold_far(self, what: Callable[[D], object], num_near: int, fold: Callable[[D], D]) -> None:
        """Fold documents that hold something large and lie far from the current one.

        The nearest ``num_near`` different values of what is large stay as they are, forwards and backwards alike.
        """
        near = {id(what(self._current))}
        ways = itertools.zip_longest(reversed(self._undo), reversed(self._redo))
        for step in itertools.chain.from_iterable(ways):
            if step is not None and len(near) < num_near:
                near.add(id(what(step.document)))

        def folded(step: _Step[D]) -> _Step[D]:
            return step if id(what(step.document)) in near else _Step(step.label, fold(step.document))

        self._undo = [folded(step) for step in self._undo]
        self._redo = [folded(step) for step in self._redo]

    def _documents(self) -> list[D]:
        return [self._current, *(step.document for step in self._undo), *(step.document for step in self._redo)]

    def undo(self) -> str | None:
        """Take back the last change; its label, or None where there is none."""
        if not self._undo:
            return None
        step = self._undo.pop()
        self._redo.append(_Step(step.label, self._current))
        self._current, self._gesture = step.document, None
        return step.label

    def redo(self) -> str | None:
        """Do the last change taken back again; its label, or None."""
        if not self._redo:
            return None
        step = self._redo.pop()
        self._undo.append(_Step(step.label, self._current))
        self._current, self._gesture = step.document, None
        return step.label
