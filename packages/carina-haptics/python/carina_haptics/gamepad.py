"""Vibration of a gamepad in place of a force device."""

from __future__ import annotations

import math

__all__ = ["rumble"]


def rumble(depth_mm: float) -> tuple[float, float]:
    """Return the strengths (strong, weak) of a gamepad's two motors for a contact of a depth, each from 0 to 1.

    The weak motor signals contact; the strong motor signals how deep the contact is.

    Examples
    --------
    >>> rumble(0.0), rumble(50.0)
    ((0.0, 0.0), (1.0, 1.0))
    """
    if not math.isfinite(depth_mm) or depth_mm <= 0.0:
        return 0.0, 0.0
    return min(depth_mm / 10.0, 1.0), min(0.2 + depth_mm / 4.0, 1.0)
