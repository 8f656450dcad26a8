"""Computation of cached values of new airways in advance, so that the first live path is not delayed."""

from __future__ import annotations

import logging

from carina.commands import LivePathTo
from carina.errors import CarinaError
from carina.server.windows.latest_only import LatestTaskRunner
from carina.session import Session, log_fault

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
        self._latest_task_runner = LatestTaskRunner("carina-warming")
        self._warmed: object = None

    def start(self) -> None:
        """Start the thread."""
        self._latest_task_runner.start()

    def stop(self) -> None:
        """Stop the thread and wait for the computation in progress."""
        self._latest_task_runner.stop()

    def airways_changed(self) -> None:
        """Request a path if the airways differ from those of the last request; callable from any thread."""
        self._latest_task_runner.submit("root", self._compute_root_path)

    def _compute_root_path(self) -> None:
        document = self._session.snapshot().document
        if document is None or document.airways is None or document.airways is self._warmed:
            return
        self._warmed = document.airways
        x, y, z = (float(v) for v in document.airways.root_lps)
        try:
            self._session.ask(LivePathTo((x, y, z)))
        except CarinaError as error:
            logger.debug("no path to the root: %s", error)
        except Exception as error:
            log_fault(logger, "could not calculate the live path", error)
