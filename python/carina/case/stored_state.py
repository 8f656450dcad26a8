"""The complete saved state of a case (class ``Moment``): document, history, view and pose of the tip."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from carina.case.document import Document
from carina.case.history import History, Step
from carina.display import one_line
from carina.render import Sight
from carina.scopes import ScopeHold


@one_line
@dataclass(frozen=True, slots=True)
class Moment:
    """The complete state of a case at one time; its immutable parts are shared with the states at other times."""

    first: Document
    """Document of the case before all steps of the history."""
    steps: tuple[Step[Document], ...]
    """Steps of the history, the oldest first, each with the document after it; steps beyond ``position`` are undone."""
    position: int
    """Number of the history's steps that are not undone."""
    sight: Sight
    tip: dict[str, Any]
    """State of the tip, as plain JSON of :meth:`carina.navigate.Navigator.state`."""
    scope: ScopeHold | None = None
    """Controls of the scope on its route, if a scope was in the lumen; ``tip`` is then the free camera pose."""
    search_status: str = "waiting"
    """State of the airway search: ``none``, ``waiting``, ``found`` or ``failed``."""
    search_words: str | None = None
    person_moved: bool = False
    """Whether the user has moved the scope's tip; if so, newly found airways do not move it."""
    numbers: dict[str, int] = field(default_factory=dict)
    """Last assigned number by kind of object (``target``, ``key``), so that no number is used twice."""
    measures: tuple[tuple[Any, Any], ...] = ()
    """Pairs of the airways of steps and their measures; airways without measures are not listed.

    Airways are :class:`carina.track.Airways` or :class:`carina.track.FoldedAirways`. Measures are
    :class:`carina.track.TreeMeasures`, or :class:`carina.case.StoredMeasures` that a case file contains.
    """

    def history(self) -> History[Document]:
        """Return the steps as a history that supports undo and redo."""
        return History(self.first, self.steps, self.position)
