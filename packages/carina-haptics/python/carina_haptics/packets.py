"""The binary UDP messages between a device's bridge and the force loop, for bridges in Python.

Messages are little-endian and of fixed size: a sample has 96 bytes, a force has 72. The guide contains the table of
bytes.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["ForceReply", "decode_force", "encode_sample"]

# Magic, version, kind, flags or buttons, number, unused, clock of the device in us; then vectors of float64.
_SAMPLE = struct.Struct("<4sBBHIIQ9d")
_FORCE = struct.Struct("<4sBBHIIQ6d")
_MAGIC, _VERSION, _KIND_SAMPLE, _KIND_FORCE = b"CARH", 1, 1, 2


@dataclass(frozen=True, slots=True)
class ForceReply:
    """A force that a bridge receives, in the axes of the device."""

    number: int
    """Number of the sample that the force answers."""
    device_us: int
    """Clock of the device in the sample that the force answers."""
    force_n: tuple[float, float, float]
    torque_n_mm: tuple[float, float, float]
    touches: bool
    limited: bool
    silent: bool


def encode_sample(
    number: int,
    device_us: int,
    position_mm: Sequence[float],
    velocity_mm_s: Sequence[float],
    forward: Sequence[float],
    *,
    buttons: int = 0,
) -> bytes:
    """Encode a sample as 96 bytes; vectors are in the space of the device.

    Examples
    --------
    >>> len(encode_sample(1, 1000, (0, 0, 0), (0, 0, 0), (0, 0, -1)))
    96
    """
    vectors = (*position_mm, *velocity_mm_s, *forward)
    return _SAMPLE.pack(
        _MAGIC,
        _VERSION,
        _KIND_SAMPLE,
        buttons & 0xFFFF,
        number & 0xFFFFFFFF,
        0,
        device_us & 0xFFFFFFFFFFFFFFFF,
        *vectors,
    )


def decode_force(packet: bytes) -> ForceReply | None:
    """Decode a force; return None for bytes that are not a force of this version."""
    if len(packet) != _FORCE.size:
        return None
    magic, version, kind, flags, number, _unused, device_us, *vectors = _FORCE.unpack(packet)
    if magic != _MAGIC or version != _VERSION or kind != _KIND_FORCE or not all(math.isfinite(v) for v in vectors):
        return None
    x, y, z, a, b, c = vectors
    return ForceReply(number, device_us, (x, y, z), (a, b, c), bool(flags & 1), bool(flags & 2), bool(flags & 4))
