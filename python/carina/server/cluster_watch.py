"""Asks once a second how the machines do that render with this one, and tells the window."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from carina.server import messages as wire

__all__ = ["ClusterWatch", "cluster_message"]

logger = logging.getLogger(__name__)

EVERY_S = 1.0


class ClusterWatch:
    """Hands on a cluster's status, and each of its notices once.

    Parameters
    ----------
    status
        The cluster's status as a dict: ``address``, ``members``, ``alone``, ``mixed``, ``fps``, ``frame_ms``,
        ``notices``.
    tell
        Takes the messages, from the watch's thread.
    """

    def __init__(
        self, status: Callable[[], dict[str, Any]], tell: Callable[[wire.Cluster | wire.Notice], None]
    ) -> None:
        self._status = status
        self._tell = tell
        self._told: set[str] = set()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="carina-cluster-watch", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    def look(self) -> None:
        """Ask once and tell."""
        status = self._status()
        for words in status["notices"]:
            if words not in self._told:
                self._told.add(words)
                self._tell(wire.Notice(words))
        self._tell(cluster_message(status))

    def _run(self) -> None:
        while not self._stopping.wait(EVERY_S):
            try:
                self.look()
            except Exception:
                logger.debug("the cluster did not say how it does", exc_info=True)


def cluster_message(status: dict[str, Any]) -> wire.Cluster:
    """A cluster's status as it is sent."""
    members = tuple(
        wire.ClusterMember(
            name=m["name"],
            host=m["host"],
            threads=m["threads"],
            simd=m["simd"],
            state=m["state"],
            share=round(min(1.0, max(0.0, m["share"])), 4),
            latency_ms=None if m["latency_ms"] is None else round(m["latency_ms"], 1),
            num_late=m["num_late"],
            num_strips=m["num_strips"],
        )
        for m in status["members"]
        if m["name"] != "console"
    )
    frame_ms = status["frame_ms"]
    return wire.Cluster(
        address=status["address"],
        members=members,
        alone=status["alone"],
        mixed=status["mixed"],
        fps=round(status["fps"], 1),
        frame_ms=None if frame_ms is None else round(frame_ms, 1),
    )
