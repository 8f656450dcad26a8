"""Protocol of the scope handle: lines of text with a checksum (``docs/scope-handle.md``)."""

from __future__ import annotations

import math
import re
from collections import Counter

from carina.navigate.devices.crc import crc8
from carina.navigate.samples import HandleSample

MAX_LINE = 80
_LINE = re.compile(
    rb"S,(\d{1,5}),(\d{1,10}),([+-]?\d{1,8}),([+-]?\d{1,8}),([+-]?\d{1,4}),([0-9A-Fa-f]{1,2})\*([0-9A-Fa-f]{2})"
)
_CLOCK = 1 << 32
_NUMBERS = 1 << 16


def format_line(
    number: int, clock_ms: int, insertion_mm: float, *, roll_deg: float = 0.0, lever: float = 0.0, buttons: int = 0
) -> bytes:
    """Return one sample as a line of the protocol, for simulated handles."""
    body = (
        f"S,{number % _NUMBERS},{clock_ms % _CLOCK},{round(100 * insertion_mm)},{round(100 * roll_deg)},"
        f"{round(1000 * lever)},{buttons:X}"
    ).encode()
    return body + b"*%02X\n" % crc8(body)


class HandleStream:
    """Parser that turns received bytes into samples and counts damaged and lost lines.

    Times of samples are the handle's clock in s, continued beyond its overflow.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._number: int | None = None
        self._clock_ms: int | None = None
        self._wraps = 0
        self.num_bad: Counter[str] = Counter()

    def feed(self, data: bytes) -> list[HandleSample]:
        """Return the samples of the lines that are complete after these bytes."""
        self._buffer += data
        found = []
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end]).rstrip(b"\r")
            del self._buffer[: end + 1]
            if line.startswith(b"#") or not line:
                continue  # A line that describes the handle contains no sample.
            taken = self._line(line)
            if taken is None:
                self.num_bad["damaged lines"] += 1
            else:
                found.append(taken)
        if len(self._buffer) > MAX_LINE:
            self._buffer.clear()
            self.num_bad["damaged lines"] += 1
        return found

    def _line(self, line: bytes) -> HandleSample | None:
        match = _LINE.fullmatch(line)
        if match is None or crc8(line[: line.rindex(b"*")]) != int(match[7], 16):
            return None
        number, clock_ms, insertion, roll, lever = (int(match[n]) for n in range(1, 6))
        if abs(lever) > 1000 or clock_ms >= _CLOCK or number >= _NUMBERS:
            return None
        if self._number is not None:
            lost = (number - self._number - 1) % _NUMBERS
            # A large difference means that the handle was restarted and counts from 0 again.
            self.num_bad["lost lines"] += lost if lost < _NUMBERS // 2 else 0
        if self._clock_ms is not None and self._clock_ms - clock_ms > _CLOCK // 2:
            self._wraps += 1
        self._number, self._clock_ms = number, clock_ms
        return HandleSample(
            (clock_ms + self._wraps * _CLOCK) / 1000.0,
            insertion / 100.0,
            math.radians(roll / 100.0),
            lever / 1000.0,
            int(match[6], 16),
        )
