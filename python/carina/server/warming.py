"""What the first question about other airways would wait for is found out before anybody asks."""

from __future__ import annotations

import logging

from carina.commands import LivePathTo
from carina.errors import CarinaError
from carina.server.newest import NewestOnly
from carina.session import Session, log_fault

__all__ = ["Warming"]

logger = logging.getLogger(__name__)


class Warming:
    """Asks for a path through new airways, in a thread of its own: the session then knows the scan's noise.

    Parameters
    ----------
    session
        Who is asked.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._newest = NewestOnly("carina-warming")
        self._warmed: object = None

    def start(self) -> None:
        """Begin."""
        self._newest.start()

    def stop(self) -> None:
        """End."""
        self._newest.stop()

    def airways_changed(self) -> None:
        """Ask about them, unless they are the ones that were asked about last; from any thread."""
        self._newest.ask("root", self._ask_for_the_root)

    def _ask_for_the_root(self) -> None:
        document = self._session.snapshot().document
        if document is None or document.airways is None or document.airways is self._warmed:
            return
        self._warmed = document.airways
        x, y, z = (float(v) for v in document.airways.root_lps)
        try:
            self._session.ask(LivePathTo((x, y, z)))
        except CarinaError as trouble:
            logger.debug("no path to the root: %s", trouble)
        except Exception as trouble:
            log_fault(logger, "could not calculate the live path", trouble)
