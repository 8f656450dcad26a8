"""Computation of cached values of new airways in advance, so that the first live path is not delayed."""

from __future__ import annotations

import logging

from carina.commands import LivePathTo
from carina.errors import CarinaError
from carina.server.windows.latest_only import LatestTaskRunner
from carina.session import Session, log_fault

__all__ = ["PathPrefetcher"]

logger = logging.getLogger(__name__)


class PathPrefetcher:
    """Thread that computes one path in new airways in advance.

    The noise of the scan, which paths need, is then already cached when the user chooses the first path.

    Parameters
    ----------
    session
        Session that computes the path.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._newest = LatestTaskRunner("carina-warming")
        self._warmed: object = None

    def start(self) -> None:
        """Start the thread."""
        self._newest.start()

    def stop(self) -> None:
        """Stop the thread and wait for the computation in progress."""
        self._newest.stop()

    def airways_changed(self) -> None:
        """Request a path if the airways differ from those of the last request; callable from any thread."""
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
