"""How a cluster does, for people and for the wire."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from carina.display import one_line

__all__ = ["ClusterStatus", "MemberStatus", "RateMeter"]


@one_line
@dataclass(frozen=True, slots=True)
class MemberStatus:
    """One renderer."""

    name: str
    host: str
    threads: int
    simd: str
    state: str
    """``ready``, ``late``, ``away`` or ``loading``."""
    share: float
    """Of a frame, 0 to 1."""
    latency_ms: float | None
    """From the order of a strip to its answer, the median of the last; None before the first."""
    num_late: int
    num_strips: int


@one_line
@dataclass(frozen=True, slots=True)
class ClusterStatus:
    """All renderers, and what comes of them."""

    address: str
    members: tuple[MemberStatus, ...]
    alone: bool
    """No other machine is left: the console renders."""
    mixed: bool
    """Pictures may come from graphics devices: within one grey level of the CPU's."""
    fps: float
    """Frames complete in the last second."""
    frame_ms: float | None
    """From wanted to complete, the median of the last frames."""
    notices: tuple[str, ...]
    """What a person should know, oldest first; each is told once."""


class RateMeter:
    """How often, and how long, over the last moments."""

    def __init__(self, over_s: float = 1.0, keep: int = 64) -> None:
        self._over_s = over_s
        self._times: deque[float] = deque()
        self._spans: deque[float] = deque(maxlen=keep)

    def note(self, now_s: float, span_s: float) -> None:
        """One more."""
        # Here as well, since nobody may ask.
        self._forget(now_s)
        self._times.append(now_s)
        self._spans.append(span_s)

    def rate_hz(self, now_s: float) -> float:
        """Per second."""
        self._forget(now_s)
        return len(self._times) / self._over_s

    def _forget(self, now_s: float) -> None:
        while self._times and self._times[0] < now_s - self._over_s:
            self._times.popleft()

    @property
    def median_s(self) -> float | None:
        """Of the last spans."""
        spans = sorted(self._spans)
        return spans[len(spans) // 2] if spans else None
