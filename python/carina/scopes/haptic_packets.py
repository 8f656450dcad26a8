"""The binary messages between a device's bridge and the force loop (`docs/haptics.md`), for bridges in Python.

Little-endian and of fixed size: a sample is 96 bytes, a force 72.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["ForceReply", "decode_force", "encode_sample"]

# Magic, version, kind, flags or buttons, number, unused, the device's clock in us; then vectors of float64.
_SAMPLE = struct.Struct("<4sBBHIIQ9d")
_FORCE = struct.Struct("<4sBBHIIQ6d")
_MAGIC, _VERSION, _KIND_SAMPLE, _KIND_FORCE = b"CARH", 1, 1, 2


@dataclass(frozen=True, slots=True)
class ForceReply:
    """A force as it arrives at the bridge, in the device's axes."""

    number: int
    """Of the sample that it answers."""
    device_us: int
    """The device's clock in that sample."""
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
    """A sample as 96 bytes; vectors are in the device's space.

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
    """A force from its bytes, or None for anything that is no force of this version."""
    if len(packet) != _FORCE.size:
        return None
    magic, version, kind, flags, number, _unused, device_us, *vectors = _FORCE.unpack(packet)
    if magic != _MAGIC or version != _VERSION or kind != _KIND_FORCE or not all(math.isfinite(v) for v in vectors):
        return None
    x, y, z, a, b, c = vectors
    return ForceReply(number, device_us, (x, y, z), (a, b, c), bool(flags & 1), bool(flags & 2), bool(flags & 4))
