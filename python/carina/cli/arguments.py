"""Arguments as people type them: points, directions, sizes."""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError

__all__ = ["parse_point", "parse_size"]


def parse_point(text: str, what: str) -> NDArray[np.float64]:
    """``x,y,z`` in mm (LPS), each with an optional sign."""
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != 3 or not all(math.isfinite(value) for value in values):
        msg = f"{what}: expected three numbers x,y,z in mm (LPS), such as -12.5,30,41; found {text!r}"
        raise UsageError(msg)
    return np.array(values)


def parse_size(text: str) -> tuple[int, int]:
    """``WxH`` in pixels."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if not match or not all(1 <= int(side) <= 8192 for side in match.groups()):
        raise UsageError(f"--size: expected WxH from 1x1 to 8192x8192 pixels, such as 512x512; found {text!r}")
    return int(match[1]), int(match[2])
