"""Display content of the renderer (transfer function and lumen), and a job that updates it to the document."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from carina.case.document import Document
from carina.session.derived.derived_value import Attempt, Derived
from carina.session.jobs.background_jobs import JobRunner
from carina.session.scene.shown_case import SessionRenderer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from carina.render import TransferFunction
    from carina.track import AirwayTree


@dataclass(frozen=True, slots=True, eq=False)
class ContentRequest:
    """Requested display content of the renderer; every request gets a new number, even if the content is equal."""

    number: int
    transfer: TransferFunction
    lumen_zyx: NDArray[np.uint8] | None
    tree: AirwayTree | None
    """Airway tree of ``lumen_zyx``; the renderer places anatomical annotations by this tree."""


class ShownContent:
    """Updater of the transfer function and the lumen that a renderer shows.

    A job also builds its data for fast rendering.

    Parameters
    ----------
    renderer
        A renderer that shows ``transfer`` and no lumen.
    transfer
        The transfer function that the renderer shows at the start.
    jobs
        Runs the job.
    lock
        Lock of the session; reentrant.
    changed
        Called with the session locked when the renderer shows other content.
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
        """Number that increases with each change of the shown content."""
        self._lock = lock
        self._changed = changed
        self._decided = self._given = ContentRequest(0, transfer, None, None)
        self._is_fast = False
        """Whether the renderer has been prepared for its present transfer function and lumen."""
        self._come_to = 0
        """Number of the last requested content that was shown, or whose update failed or was stopped."""
        self._ready: Derived[ContentRequest, bool] = Derived(
            jobs,
            lock,
            kind="display",
            title="preparing fast rendering",
            make=self._build_content,
            settled=self._update_status,
        )

    @property
    def has_lumen(self) -> bool:
        """Whether the renderer shows a wall round an airway lumen."""
        return self._given.lumen_zyx is not None

    @property
    def is_newest(self) -> bool:
        """Whether the renderer shows the requested content, or the update to this content failed or was stopped."""
        return self._come_to == self._decided.number

    def prepare(self) -> None:
        """Start the job that builds the renderer's data for fast rendering."""
        with self._lock:
            self._ready.want(self._decided)

    def follow(self, document: Document) -> None:
        """Update the renderer to a document's transfer function and airways; the caller holds the session's lock."""
        transfer = document.transfer
        airways = document.airways
        lumen_zyx, tree = (None, None) if airways is None else (airways.lumen_zyx, airways.tree)
        # Also repeats an update whose job was stopped or failed before the renderer received the content.
        newest = self._decided if self._ready.standing(self._decided) == "making" else self._given
        if newest.transfer is not transfer or newest.lumen_zyx is not lumen_zyx or newest.tree is not tree:
            self._decided = ContentRequest(self._decided.number + 1, transfer, lumen_zyx, tree)
            self._ready.want(self._decided)

    def discard(self) -> None:
        """Stop the job, because the case is being closed."""
        self._ready.discard()

    def _build_content(self, decided: ContentRequest, attempt: Attempt[bool]) -> bool:
        given = self._given
        # Other names in a tree change only annotations; the data for fast rendering stay valid.
        if decided.transfer is not given.transfer or decided.lumen_zyx is not given.lumen_zyx:
            self._is_fast = False
        if decided.transfer is not given.transfer:
            self.renderer.set_transfer(decided.transfer)
        if decided.lumen_zyx is not given.lumen_zyx or decided.tree is not given.tree:
            self.renderer.set_lumen(decided.lumen_zyx, decided.tree)
        with self._lock:
            self._given = decided
            self._on_update_end(decided)
        if not self._is_fast:
            self.renderer.prepare(attempt.progress, attempt.cancel)
            self._is_fast = True
        return True

    def _update_status(self) -> None:
        # After a failure or a stop no further update follows, so the shown content is final.
        self._on_update_end(self._decided)

    def _on_update_end(self, decided: ContentRequest) -> None:
        """Record that the update to the given content has ended; the caller holds the session's lock."""
        if self._come_to != decided.number:
            self._come_to = decided.number
            # The number increases even if the content is the former one again, because no picture since then was sent
            # as final.
            self.number += 1
            self._changed()
