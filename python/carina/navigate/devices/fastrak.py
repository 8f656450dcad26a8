"""Polhemus FASTRAK, the 3D pen of the paper (3.2): its records as bytes, and its setup commands.

Record (manual OPM00PI002, "Data record contents"): ``0``, station ``1`` to ``4``, an error character (blank: no error),
then the requested items. Carina requests position, quaternion, stylus switch, CR LF: ``O1,2,11,16,1``.
"""

from __future__ import annotations

import math
import re
import struct
from collections import Counter
from dataclasses import dataclass

import numpy as np

from carina.navigate.rotation import rotation_from_wxyz, wxyz_from_rotation

RATE_HZ = 120.0
CM = 10.0
MAX_WAITING = 4096
_ASCII = re.compile(rb"0([1-4])([ -~])((?:[ +-]*\d+\.\d+){3})((?:[ +-]*\d+\.\d+){4})\s*([01])")
_NUMBER = re.compile(rb"[+-]?\s*\d+\.\d+")
# Layout of a binary record: a header and 7 floats; the switch and CR LF follow.
_BINARY = struct.Struct("<7f")
_BINARY_BYTES = 3 + _BINARY.size
_TAIL = re.compile(rb" ?([01])\r\n")
# The receiver's x runs along the stylus, y to the right, z down (the tracker's own frame is turned the same way); the
# axes of the pen are right, down, forward.
_RECEIVER_FROM_PEN = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True, slots=True)
class FastrakRecord:
    """One measurement of the FASTRAK: position in mm, and quaternion ``transmitter_from_pen`` (wxyz)."""

    station: int
    position_mm: tuple[float, float, float]
    orientation_wxyz: tuple[float, float, float, float]
    button: bool


def setup_commands(*, station: int = 1, binary: bool = False) -> bytes:
    """Return the commands that set up a FASTRAK: stop, centimetres, items, ASCII or binary, continuous output.

    The tracker's own position and orientation filters are not set up: Carina filters, and shows the delay of its
    filter.
    """
    return b"c" + b"u" + b"O%d,2,11,16,1\r" % station + (b"f" if binary else b"F") + b"C"


class FastrakStream:
    """Parser that turns received bytes into records; incomplete records wait, noise is skipped and counted.

    Parameters
    ----------
    binary
        Whether binary records were requested.
    """

    def __init__(self, *, binary: bool = False) -> None:
        self._binary = binary
        self._buffer = bytearray()
        self.num_bad: Counter[str] = Counter()

    def feed(self, data: bytes) -> list[FastrakRecord]:
        """Return the records that are complete after these bytes, without those that have an error character."""
        self._buffer += data
        found = self._feed_binary() if self._binary else self._feed_ascii()
        if len(self._buffer) > MAX_WAITING:
            self.num_bad["bytes outside any record"] += len(self._buffer)
            self._buffer.clear()
        return found

    def _feed_ascii(self) -> list[FastrakRecord]:
        found: list[FastrakRecord] = []
        while (end := self._buffer.find(b"\n")) >= 0:
            line = bytes(self._buffer[:end]).rstrip(b"\r")
            del self._buffer[: end + 1]
            if not line:
                continue
            # A line may start with a fragment of another line, or with noise.
            match = _ASCII.search(line)
            if match is None or match.end() != len(line):
                self.num_bad["bytes outside any record"] += len(line) + 1
                continue
            numbers = [float(n.replace(b" ", b"")) for n in _NUMBER.findall(match[3] + match[4])]
            if len(numbers) == 7:
                self._add_record(found, int(match[1]), match[2], numbers, match[5] == b"1")
            else:
                self.num_bad["bytes outside any record"] += len(line) + 1
        return found

    def _feed_binary(self) -> list[FastrakRecord]:
        found: list[FastrakRecord] = []
        buffer = self._buffer
        while len(buffer) >= _BINARY_BYTES + 3:
            if not (buffer[0] == ord("0") and ord("1") <= buffer[1] <= ord("4") and 0x20 <= buffer[2] < 0x7F):
                del buffer[0]
                self.num_bad["bytes outside any record"] += 1
                continue
            tail = _TAIL.match(buffer, _BINARY_BYTES)
            if tail is None:
                if len(buffer) < _BINARY_BYTES + 4 and re.match(rb" ?[01]?\r?$", buffer[_BINARY_BYTES:]):
                    return found
                del buffer[0]
                self.num_bad["bytes outside any record"] += 1
                continue
            self._add_record(
                found, buffer[1] - ord("0"), bytes(buffer[2:3]), list(_BINARY.unpack_from(buffer, 3)), tail[1] == b"1"
            )
            del buffer[: tail.end()]
        return found

    def _add_record(
        self, found: list[FastrakRecord], station: int, error: bytes, numbers: list[float], button: bool
    ) -> None:
        if error != b" ":
            # Out of the transmitter's range, or another error: the record is complete, but its position is unreliable.
            self.num_bad["measurements outside the tracker's range"] += 1
            return
        length = math.sqrt(sum(v * v for v in numbers[3:])) if all(map(math.isfinite, numbers)) else 0.0
        if not 0.9 < length < 1.1:
            # The quaternion has four decimals; a length that differs more from 1 is damage that the record check
            # missed.
            self.num_bad["invalid position"] += 1
            return
        receiver = rotation_from_wxyz([v / length for v in numbers[3:]])
        x, y, z = (CM * v for v in numbers[:3])
        found.append(FastrakRecord(station, (x, y, z), wxyz_from_rotation(receiver @ _RECEIVER_FROM_PEN), button))
