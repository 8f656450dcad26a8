"""The Modality LUT of a DICOM image: a table from stored numbers to values (PS3.3 C.11.1).

An image has either a Modality LUT or a rescale. If an image has both and both give the same values, the values are
certain. If they give different values, it is unknown which are right, and the values are not HU.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class ModalityLut:
    """A table that converts stored numbers to values."""

    first: int
    """Stored number of the first entry; lower numbers get the first entry, numbers above the table get the last."""
    table: NDArray[np.int32] = field(repr=False)
    unit: str
    """ModalityLUTType in capitals, such as ``HU``."""

    def values(self, stored: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the value of each stored number."""
        return np.asarray(self.table[np.clip(stored - self.first, 0, len(self.table) - 1)], dtype=np.int32)


def read_modality_lut(item: Any, *, signed: bool, little_endian: bool) -> ModalityLut:
    """Read the single item of ModalityLUTSequence.

    Parameters
    ----------
    item
        Data set of the item.
    signed
        Whether the stored numbers are signed; the number of the first entry has the same form.
    little_endian
        Byte order of the file.

    Raises
    ------
    ValueError
        If the descriptor or the length of the data is wrong.
    """
    num_entries, first, bits = (int(number) for number in item.LUTDescriptor)
    num_entries = num_entries & 0xFFFF or 1 << 16
    first &= 0xFFFF
    if signed and first >= 1 << 15:
        first -= 1 << 16
    data = item.LUTData
    if isinstance(data, bytes):
        if len(data) >= 2 * num_entries:
            table = np.frombuffer(data, "<u2" if little_endian else ">u2", count=num_entries)
        elif bits == 8 and len(data) >= num_entries:
            table = np.frombuffer(data, np.uint8, count=num_entries)
        else:
            msg = f"{len(data)} bytes for {num_entries} entries"
            raise ValueError(msg)
    else:
        table = np.atleast_1d(np.asarray(data, dtype=np.int64))
        if len(table) != num_entries:
            msg = f"{len(table)} of {num_entries} entries"
            raise ValueError(msg)
        table = table & 0xFFFF
    if not 8 <= bits <= 16:
        msg = f"{bits} bits"
        raise ValueError(msg)
    unit = "".join(c for c in str(item.get("ModalityLUTType") or "") if c.isprintable()).strip().upper()[:16]
    return ModalityLut(first, table.astype(np.int32), unit)
