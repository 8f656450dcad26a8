"""What the renderer shows beside the volume, and how far it is behind what was decided."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from carina.case.document import Document
from carina.session.derived import Attempt, Derived
from carina.session.jobs import JobRunner
from carina.session.scene import SessionRenderer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from carina.render import TransferFunction
    from carina.track import AirwayTree

__all__ = ["ShownContent"]


@dataclass(frozen=True, slots=True, eq=False)
class Decided:
    """A decision of a person, or of a job, on what is to be shown. Each is another one, also of the same things."""

    number: int
    transfer: TransferFunction
    lumen_zyx: NDArray[np.uint8] | None
    tree: AirwayTree | None
    """Of that lumen: what is fixed to anatomy is drawn by it."""


class ShownContent:
    """The transfer function and the lumen that a renderer shows. A job gives it what is decided, and makes it fast.

    Parameters
    ----------
    renderer
        Shows ``transfer`` and no lumen.
    changed
        Called with the session locked when the renderer has come to something else.
    """

    def __init__(
        self,
        renderer: SessionRenderer,
        transfer: TransferFunction,
        *,
        jobs: JobRunner,
        lock: AbstractContextManager[Any],
        changed: Callable[[], None],
    ) -> None:
        self.renderer = renderer
        self.number = 0
        """Grows with each change of what the renderer shows."""
        self._lock = lock
        self._changed = changed
        self._decided = self._given = Decided(0, transfer, None, None)
        self._is_fast = False
        """It has been prepared with the transfer function and the lumen that it was given last."""
        self._come_to = 0
        """The number of the decision that the renderer shows, or will not come closer to."""
        self._ready: Derived[Decided, bool] = Derived(
            jobs, lock, kind="display", title="preparing fast rendering", make=self._make_ready, settled=self._settled
        )

    @property
    def has_lumen(self) -> bool:
        """The renderer has been given a lumen."""
        return self._given.lumen_zyx is not None

    @property
    def is_newest(self) -> bool:
        """It shows what was decided on, or will not come closer to it; else it is being given that."""
        return self._come_to == self._decided.number

    def prepare(self) -> None:
        """Make the renderer fast with what it shows."""
        with self._lock:
            self._ready.want(self._decided)

    def follow(self, document: Document) -> None:
        """Have the renderer show a document's transfer function and airways, with the session locked."""
        transfer = document.transfer
        airways = document.airways
        lumen_zyx, tree = (None, None) if airways is None else (airways.lumen_zyx, airways.tree)
        # Also once more where a job was stopped or failed before the renderer was given them.
        newest = self._decided if self._ready.standing(self._decided) == "making" else self._given
        if newest.transfer is not transfer or newest.lumen_zyx is not lumen_zyx or newest.tree is not tree:
            self._decided = Decided(self._decided.number + 1, transfer, lumen_zyx, tree)
            self._ready.want(self._decided)

    def discard(self) -> None:
        """Another case is open."""
        self._ready.discard()

    def _make_ready(self, decided: Decided, attempt: Attempt[bool]) -> bool:
        given = self._given
        # A tree with other names has other rings, and nothing that leaps depends on it.
        if decided.transfer is not given.transfer or decided.lumen_zyx is not given.lumen_zyx:
            self._is_fast = False
        if decided.transfer is not given.transfer:
            self.renderer.set_transfer(decided.transfer)
        if decided.lumen_zyx is not given.lumen_zyx or decided.tree is not given.tree:
            self.renderer.set_lumen(decided.lumen_zyx, decided.tree)
        with self._lock:
            self._given = decided
            self._comes_to(decided)
        if not self._is_fast:
            self.renderer.prepare(attempt.progress, attempt.cancel)
            self._is_fast = True
        return True

    def _settled(self) -> None:
        # Where it failed or was stopped, nothing brings the renderer further: what it shows is final.
        self._comes_to(self._decided)

    def _comes_to(self, decided: Decided) -> None:
        """The renderer shows a decision; with the session locked."""
        if self._come_to != decided.number:
            self._come_to = decided.number
            # Also where it was taken back meanwhile: no picture since was sent as final.
            self.number += 1
            self._changed()
