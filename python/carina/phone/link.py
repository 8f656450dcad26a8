"""Messages of one connected phone: clock conversion, rate limit, and conversion to pose samples."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from carina.errors import ProtocolError
from carina.navigate import PoseSample
from carina.navigate.pilot import CLUTCH_BUTTON
from carina.server.wire import messages as wire

DEVICE = "phone"
MAX_RATE_HZ = 120.0
"""Maximum message rate; the screens of phones refresh at most at this rate, in Hz."""
BURST = 60.0
MAX_BAD = 50
"""Maximum number of invalid messages of a connection; with more, it is closed. Carina's own page sends none."""


class ClockMap:
    """Conversion of time stamps from the phone's clock to this machine's clock.

    The offset of the clocks is the smallest observed difference between arrival and time stamp, because no delay is
    negative. If the phone's clock is set back, its time stamps stay behind; after ``reset_after_s`` the offset is
    measured again.

    Parameters
    ----------
    reset_after_s
        Time in s during which the clock must stay behind before the offset is measured again.
    behind_s
        Delay in s above which the clock counts as behind; network delays that persist are shorter.
    """

    def __init__(self, *, reset_after_s: float = 0.5, behind_s: float = 1.0) -> None:
        self._reset_after_s = reset_after_s
        self._behind_s = behind_s
        self._offset_s: float | None = None
        self._behind_since_s: float | None = None

    def to_local_s(self, phone_s: float, arrived_s: float) -> float:
        """Return the time of a sample on this machine's clock, in s; never later than its arrival.

        Parameters
        ----------
        phone_s
            Time stamp on the phone's clock.
        arrived_s
            Time of arrival on this machine's clock.
        """
        offset_s = arrived_s - phone_s
        if self._offset_s is None or offset_s < self._offset_s:
            self._offset_s = offset_s
        if offset_s - self._offset_s < self._behind_s:
            self._behind_since_s = None
        elif self._behind_since_s is None:
            self._behind_since_s = arrived_s
        elif arrived_s - self._behind_since_s >= self._reset_after_s:
            self._offset_s, self._behind_since_s = offset_s, None
        # Rounding errors of large time stamps could otherwise give a time after the arrival.
        return min(phone_s + self._offset_s, arrived_s)


class PhoneLink:
    """Parser of the messages of one phone; it reads no clock, because the caller passes the time of arrival.

    Parameters
    ----------
    receive_sample
        Callback for each pose sample; its time is on this machine's clock.
    act
        Callback for a pressed button; it receives the name of the action.
    clutch_held_moves
        Callback that returns whether a pen moves the tip while its clutch is held (``DeviceControls.clutch`` is
        "hold"). A phone moves the tip only while the button on its page is held, whatever the setting for pens.
    """

    def __init__(
        self,
        receive_sample: Callable[[PoseSample], None],
        act: Callable[[str], None],
        *,
        clutch_held_moves: Callable[[], bool],
    ) -> None:
        self._receive_sample = receive_sample
        self._act = act
        self._clutch_held_moves = clutch_held_moves
        self._clock = ClockMap()
        self._allowance = BURST
        self._last_message_s: float | None = None
        self._wxyz = (1.0, 0.0, 0.0, 0.0)
        self._recent: list[float] = []
        self.num_bad: Counter[str] = Counter()

    @property
    def is_broken(self) -> bool:
        """Whether more than :data:`MAX_BAD` messages were invalid; messages above the rate limit do not count."""
        return sum(n for why, n in self.num_bad.items() if why != "too many samples") > MAX_BAD

    def rate_hz(self, now_s: float) -> float:
        """Return the number of samples in the last second, at most 256."""
        return float(sum(now_s - at_s < 1.0 for at_s in self._recent))

    def process_message(self, text: str | bytes | None, now_s: float) -> None:
        """Process one message; count and ignore an invalid one.

        Parameters
        ----------
        text
            The message; None for a binary message.
        now_s
            Time of arrival on this machine's clock, in s.
        """
        passed_s = 0.0 if self._last_message_s is None else max(now_s - self._last_message_s, 0.0)
        self._last_message_s = now_s
        self._allowance = min(BURST, self._allowance + MAX_RATE_HZ * passed_s)
        if self._allowance < 1.0:
            # A message above the rate limit is not parsed.
            self.num_bad["too many samples"] += 1
            return
        self._allowance -= 1.0
        if text is None:
            self.num_bad["a binary message"] += 1
            return
        try:
            message = wire.parse_phone_message(text)
        except ProtocolError as error:
            self.num_bad[error.code] += 1
            return
        match message:
            case wire.PhoneSample():
                self._handle_message(message, now_s)
            case wire.PhoneAct():
                self._act(message.action)
            case _:
                self.num_bad["protocol.order"] += 1

    def _handle_message(self, message: wire.PhoneSample, now_s: float) -> None:
        if message.orientation_wxyz is not None:
            w, x, y, z = message.orientation_wxyz
            self._wxyz = (w, x, y, z)
        # Without an orientation sensor the tip does not turn, but it still moves forward and back.
        turns = message.held and message.orientation_wxyz is not None
        clutch = turns == self._clutch_held_moves()
        self._recent = [*self._recent[-255:], now_s]
        self._receive_sample(
            PoseSample(
                self._clock.to_local_s(message.time_s, now_s),
                None,
                self._wxyz,
                int(clutch) << CLUTCH_BUTTON,
                message.advance,
            )
        )
