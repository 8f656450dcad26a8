"""Checksums of device protocols."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# ECMA-182 as in OpenIGTLink: no bit reflection, initial value 0, no final XOR.
_POLYNOMIAL = 0x42F0E1EBA9EA3693
_MASK = (1 << 64) - 1
# Below this number of bytes the parallel lanes are slower than the plain loop.
_LANES_FROM = 8192
_NUM_LANES = 512


def crc64_bitwise(data: bytes) -> int:
    """Compute the CRC-64 bit by bit; the reference for `crc64`."""
    value = 0
    for byte in data:
        value ^= byte << 56
        for _ in range(8):
            value = (value << 1 & _MASK) ^ (_POLYNOMIAL if value >> 63 else 0)
    return value


_TABLE = tuple(crc64_bitwise(bytes([n])) for n in range(256))
_TABLE_ARRAY = np.array(_TABLE, dtype=np.uint64)


def crc64(data: bytes) -> int:
    """Compute the CRC-64 (ECMA-182) of a message's body.

    A long message is divided into lanes that are computed in parallel. The checksum is linear, so the checksum of the
    whole follows from those of the lanes.
    """
    if len(data) >= _LANES_FROM:
        return _crc64_in_lanes(data)
    value = 0
    for byte in data:
        value = _TABLE[value >> 56 ^ byte] ^ (value << 8 & _MASK)
    return value


def _crc64_in_lanes(data: bytes) -> int:
    length = -(-len(data) // _NUM_LANES)
    # The data are padded with leading zeros, which do not change the checksum, because its initial value is 0.
    padded = np.zeros(length * _NUM_LANES, dtype=np.uint8)
    padded[len(padded) - len(data) :] = np.frombuffer(data, dtype=np.uint8)
    lanes = padded.reshape(_NUM_LANES, length).T
    values = _run(np.zeros(_NUM_LANES, dtype=np.uint64), lanes)
    # Effect of `length` zero bytes on each bit of the checksum of the preceding bytes.
    bits = np.left_shift(np.uint64(1), np.arange(64, dtype=np.uint64))
    shifted = [int(v) for v in _run(bits, np.zeros((length, 64), dtype=np.uint8))]
    total = 0
    for value in values.tolist():
        moved, bit = 0, 0
        while total:
            if total & 1:
                moved ^= shifted[bit]
            total >>= 1
            bit += 1
        total = moved ^ int(value)
    return total


def _run(values: NDArray[np.uint64], columns: NDArray[np.uint8]) -> NDArray[np.uint64]:
    for column in columns:
        values = _TABLE_ARRAY[np.right_shift(values, np.uint64(56)) ^ column] ^ np.left_shift(values, np.uint64(8))
    return values


def crc8(data: bytes) -> int:
    """Compute the CRC-8 with polynomial 0x07 and initial value 0, for a line of the scope handle."""
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value << 1 & 0xFF) ^ (0x07 if value & 0x80 else 0)
    return value
