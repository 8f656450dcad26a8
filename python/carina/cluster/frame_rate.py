"""Meter of the number of pictures per second and of their duration."""

from __future__ import annotations

from collections import deque


class RateMeter:
    """Meter of the event rate over the last ``over_s`` seconds, and of the median of the last ``keep`` durations."""

    def __init__(self, over_s: float = 1.0, keep: int = 64) -> None:
        self._over_s = over_s
        self._times: deque[float] = deque()
        self._spans: deque[float] = deque(maxlen=keep)

    def note(self, now_s: float, span_s: float) -> None:
        """Add an event at a time, with its duration in seconds."""
        # Old times are removed here too, because rate_hz may never be called.
        self._drop_old_events(now_s)
        self._times.append(now_s)
        self._spans.append(span_s)

    def rate_hz(self, now_s: float) -> float:
        """Return the mean number of events per second over the last ``over_s`` seconds."""
        self._drop_old_events(now_s)
        return len(self._times) / self._over_s

    def _drop_old_events(self, now_s: float) -> None:
        while self._times and self._times[0] < now_s - self._over_s:
            self._times.popleft()

    @property
    def median_s(self) -> float | None:
        """Median of the last durations in seconds; None before the first event."""
        spans = sorted(self._spans)
        return spans[len(spans) // 2] if spans else None
