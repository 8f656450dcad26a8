"""State of a case from which a saved picture is made, read at one time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from carina.display import one_line

if TYPE_CHECKING:
    from carina.case.document import Document
    from carina.case.routes import ChosenRoute
    from carina.commands.tree import PathCost
    from carina.session.scene.shown_case import ShownCase
    from carina.track import Airways
    from carina.volume import Volume


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PictureState:
    """The CT, the document and the views of a case at one time; all are immutable."""

    volume: Volume
    document: Document
    scene: ShownCase | None
    """What the views of the window show; None if the window may not see this case."""

    @property
    def airways(self) -> Airways | None:
        """The airways with all edits; None without airways."""
        return self.document.airways

    @property
    def route(self) -> ChosenRoute | None:
        """The chosen route; None without a route."""
        return self.document.route

    @property
    def operator(self) -> Literal["head", "facing"]:
        """Position of the operator: at the patient's head, or facing the patient."""
        return self.document.look.operator

    @property
    def cost(self) -> PathCost:
        """Edge cost by which the path of the route was searched (:class:`carina.commands.AddTarget`)."""
        return self.document.cost_of(self.document.route)

    def is_valid_for(self, view: str, other: PictureState) -> bool:
        """Return whether the view shows the same content of the same case at both times."""
        first, second = self.scene, other.scene
        if first is None or second is None or first.case_number != second.case_number:
            return False
        if not (first.can_be_final(view) and second.can_be_final(view)):
            return False
        return not first.is_by_transfer(view) or first.content_number == second.content_number
