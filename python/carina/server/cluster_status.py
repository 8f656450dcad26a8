"""Polling of the cluster status once a second, with messages to the windows."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from msgspec.structs import replace

from carina.render import ClusterStatus
from carina.server.wire import messages as wire

logger = logging.getLogger(__name__)

EVERY_S = 1.0


class ClusterWatch:
    """Thread that sends the cluster status to the windows, and each notice of the cluster only once.

    Parameters
    ----------
    status
        Function that returns the cluster status.
    send
        Callback for the messages; called from the thread of this object.
    """

    def __init__(self, status: Callable[[], ClusterStatus], send: Callable[[wire.Cluster | wire.Notice], None]) -> None:
        self._status = status
        self._send = send
        self._reported: set[str] = set()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._poll_until_stopped, name="carina-cluster-watch", daemon=True)

    def start(self) -> None:
        """Start the thread that polls the cluster status."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the polling thread and wait for its end."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    def poll(self) -> None:
        """Read the cluster status once, and send it with its new notices to the windows."""
        status = self._status()
        for words in status.notices:
            if words not in self._reported:
                self._reported.add(words)
                self._send(wire.Notice(words))
        self._send(cluster_message(status))

    def _poll_until_stopped(self) -> None:
        while not self._stopping.wait(EVERY_S):
            try:
                self.poll()
            except Exception:
                logger.debug("the cluster did not say how it does", exc_info=True)


def cluster_message(status: ClusterStatus) -> wire.Cluster:
    """Return the wire message of a cluster status, with rounded values and without the console's renderer."""
    return wire.Cluster(
        address=status.address,
        members=tuple(
            replace(
                member,
                share=round(min(1.0, max(0.0, member.share)), 4),
                latency_ms=None if member.latency_ms is None else round(member.latency_ms, 1),
            )
            for member in status.members
            if member.name != "console"
        ),
        alone=status.alone,
        mixed=status.mixed,
        fps=round(status.fps, 1),
        frame_ms=None if status.frame_ms is None else round(status.frame_ms, 1),
    )
