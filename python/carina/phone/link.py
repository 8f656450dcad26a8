"""What one phone says: its token, its clock, how much of it is taken, and the samples that it becomes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from carina.errors import ProtocolError
from carina.navigate import PoseSample
from carina.navigate.pilot import CLUTCH_BUTTON
from carina.server import messages as wire

__all__ = ["DEVICE", "MAX_BAD", "ClockMap", "PhoneLink"]

DEVICE = "phone"
MAX_RATE_HZ = 120.0
"""Screens of phones refresh so often at most."""
BURST = 60.0
MAX_BAD = 50
"""A page of ours says nothing bad; something else on the link is cut off."""


class ClockMap:
    """From a phone's clock to ours, by the message that was least delayed.

    Messages are delayed by nothing at least, so the smallest difference of arrival and time stamp is the clocks' own. A
    clock that is set back stays behind, and its samples are refused for as long; then the map begins anew.

    Parameters
    ----------
    reset_after_s
        A clock that is behind for so long has been set back.
    behind_s
        No network delays a sample by so much and goes on.
    """

    def __init__(self, *, reset_after_s: float = 0.5, behind_s: float = 1.0) -> None:
        self._reset_after_s = reset_after_s
        self._behind_s = behind_s
        self._offset_s: float | None = None
        self._behind_since_s: float | None = None

    def ours(self, phone_s: float, arrived_s: float) -> float:
        """When a sample was measured, on our clock; never later than it arrived."""
        offset_s = arrived_s - phone_s
        if self._offset_s is None or offset_s < self._offset_s:
            self._offset_s = offset_s
        if offset_s - self._offset_s < self._behind_s:
            self._behind_since_s = None
        elif self._behind_since_s is None:
            self._behind_since_s = arrived_s
        elif arrived_s - self._behind_since_s >= self._reset_after_s:
            self._offset_s, self._behind_since_s = offset_s, None
        # Of huge numbers and a small difference, rounding makes the future.
        return min(phone_s + self._offset_s, arrived_s)


class PhoneLink:
    """Reads the messages of one phone. Pure: the moment of arrival is passed in.

    Parameters
    ----------
    said
        Gets each sample, on our clock.
    act
        Gets the name of a button that was pressed.
    clutch_held_moves
        Whether a pen moves the tip while its clutch is held (``DeviceControls.clutch`` is "hold") or while it is not: a
        phone moves it only while its own button is held, whatever is set for pens.
    """

    def __init__(
        self,
        said: Callable[[PoseSample], None],
        act: Callable[[str], None],
        *,
        clutch_held_moves: Callable[[], bool],
    ) -> None:
        self._said = said
        self._act = act
        self._clutch_held_moves = clutch_held_moves
        self._clock = ClockMap()
        self._allowance = BURST
        self._heard_s: float | None = None
        self._wxyz = (1.0, 0.0, 0.0, 0.0)
        self._recent: list[float] = []
        self.num_bad: Counter[str] = Counter()

    @property
    def is_broken(self) -> bool:
        """So much of it was bad that it is no page of ours."""
        return sum(n for why, n in self.num_bad.items() if why != "too many samples") > MAX_BAD

    def rate_hz(self, now_s: float) -> float:
        """Samples in the last second."""
        return float(sum(now_s - at_s < 1.0 for at_s in self._recent))

    def hear(self, text: str | bytes | None, now_s: float) -> None:
        """One message; what is bad is counted and ignored."""
        passed_s = 0.0 if self._heard_s is None else max(now_s - self._heard_s, 0.0)
        self._heard_s = now_s
        self._allowance = min(BURST, self._allowance + MAX_RATE_HZ * passed_s)
        if self._allowance < 1.0:
            # Not even read.
            self.num_bad["too many samples"] += 1
            return
        self._allowance -= 1.0
        if text is None:
            self.num_bad["a binary message"] += 1
            return
        try:
            message = wire.parse_phone_message(text)
        except ProtocolError as trouble:
            self.num_bad[trouble.code] += 1
            return
        match message:
            case wire.PhoneSample():
                self._take(message, now_s)
            case wire.PhoneAct():
                self._act(message.action)
            case _:
                self.num_bad["protocol.order"] += 1

    def _take(self, message: wire.PhoneSample, now_s: float) -> None:
        if message.orientation_wxyz is not None:
            w, x, y, z = message.orientation_wxyz
            self._wxyz = (w, x, y, z)
        # Without a sensor nothing turns, and forward and back still go.
        turns = message.held and message.orientation_wxyz is not None
        clutch = turns == self._clutch_held_moves()
        self._recent = [*self._recent[-255:], now_s]
        self._said(
            PoseSample(
                self._clock.ours(message.time_s, now_s),
                None,
                self._wxyz,
                int(clutch) << CLUTCH_BUTTON,
                message.advance,
            )
        )
