"""All of a case that is kept at once: what was decided and how it came to that, what is shown, and where the tip is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from carina.case.document import Document
from carina.case.history import History, Step
from carina.display import one_line
from carina.render import Sight
from carina.scopes import ScopeHold

__all__ = ["Moment"]


@one_line
@dataclass(frozen=True, slots=True)
class Moment:
    """A case at one moment; its parts are immutable and shared with the moments before and after."""

    first: Document
    """Before all steps."""
    steps: tuple[Step[Document], ...]
    """Each with the document after it, the oldest first; those beyond ``position`` were taken back."""
    position: int
    """How many steps hold."""
    sight: Sight
    tip: dict[str, Any]
    """:meth:`carina.navigate.Navigator.state`: plain JSON."""
    scope: ScopeHold | None = None
    """How the scope was held along its route, where one was in the lumen; ``tip`` then is its free pose."""
    search_status: str = "waiting"
    """How the search for the airways stands: ``none``, ``waiting``, ``found`` or ``failed``."""
    search_words: str | None = None
    person_moved: bool = False
    """Whether a person has moved the tip: airways that are found then do not move it."""
    numbers: dict[str, int] = field(default_factory=dict)
    """The last number that was given, by what was numbered (``target``, ``key``): none is given twice."""
    measures: tuple[tuple[Any, Any], ...] = ()
    """Airways of the steps, whole or folded, each with its :class:`carina.track.TreeMeasures`, or with the
    :class:`carina.case.KeptMeasures` of a file; those that were measured."""

    def history(self) -> History[Document]:
        """The steps as they can be undone and done again."""
        return History(self.first, self.steps, self.position)
