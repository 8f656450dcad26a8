"""Interpolation of slices between the slices of a CT by cubic B-splines."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

POLE = np.sqrt(3.0) - 2.0
"""Pole of the filter that converts values to the coefficients of a cubic B-spline."""
NUM_TERMS = 24
"""Number of terms of the sum for a coefficient at the border of a stack."""
NUM_ROWS = 32
"""Number of rows that are interpolated at a time, so that their coefficients stay in the processor cache."""


def with_divided_slices(slices: NDArray[np.int16], parts: int) -> NDArray[np.int16]:
    """Divide each slice of a stack into parts, with values by interpolating cubic B-splines along the stack.

    The parts cover the slices: the centre of part p of slice k is (p + 1/2) / parts - 1/2 slices from the centre of
    slice k. The stack is mirrored at its first and last slice.

    Parameters
    ----------
    slices
        (n, rows, columns) int16, in any memory layout.
    parts
        Number of parts of each slice, at least 1.

    Returns
    -------
    ndarray
        (n * parts, rows, columns) int16, C-contiguous. No value is outside the range of the values of ``slices``.
        The
        middle part of an odd number of parts has the values of its slice.

    References
    ----------
    Unser, Aldroubi and Eden 1993; docs/decisions/0114.

    Examples
    --------
    >>> import numpy as np
    >>> ramp = np.arange(0, 90, 9, dtype=np.int16).reshape(10, 1, 1)
    >>> with_divided_slices(ramp, 3)[9:15, 0, 0]
    array([24, 27, 30, 33, 36, 39], dtype=int16)
    """
    num, rows, columns = slices.shape
    out = np.empty((num, parts, rows, columns), dtype=np.int16)
    if num == 1 or parts == 1:
        out[:] = slices[:, None]
        return out.reshape(num * parts, rows, columns)
    low, high = float(slices.min()), float(slices.max())
    for first in range(0, rows, NUM_ROWS):
        part = slices[:, first : first + NUM_ROWS]
        coefficients = _coefficients(part.astype(np.float32))
        for p in range(parts):
            shift = (p + 0.5) / parts - 0.5
            if shift == 0.0:
                out[:, p, first : first + NUM_ROWS] = part
                continue
            values = np.zeros_like(coefficients)
            for step in range(-2, 3):
                weight = np.float32(_spline(shift - step))
                if weight > 0.0:
                    values += weight * coefficients[_mirrored(np.arange(num) + step, num)]
            np.clip(np.rint(values, out=values), low, high, out=values)
            out[:, p, first : first + NUM_ROWS] = values
    return out.reshape(num * parts, rows, columns)


def _coefficients(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the coefficients of the cubic B-spline through values along the first axis; changes ``values``."""
    num = len(values)
    pole = np.float32(POLE)
    values *= np.float32((1.0 - POLE) * (1.0 - 1.0 / POLE))
    terms = np.arange(NUM_TERMS)
    # The first coefficient is a sum over the stack, which is mirrored at both ends without end.
    values[0] = np.tensordot((POLE**terms).astype(np.float32), values[_mirrored(terms, num)], axes=1)
    for k in range(1, num):
        values[k] += pole * values[k - 1]
    values[-1] = np.float32(POLE / (POLE * POLE - 1.0)) * (values[-1] + pole * values[-2])
    for k in range(num - 2, -1, -1):
        values[k] = pole * (values[k + 1] - values[k])
    return values


def _spline(x: float) -> float:
    """Return the value of the cubic B-spline at x."""
    x = abs(x)
    if x < 1.0:
        return 2.0 / 3.0 - x * x + 0.5 * x**3
    return (2.0 - x) ** 3 / 6.0 if x < 2.0 else 0.0


def _mirrored(places: NDArray[np.int64], num: int) -> NDArray[np.int64]:
    """Return the indices of positions in a stack that is mirrored at its first and last slice."""
    period = 2 * (num - 1)
    places = np.abs(places) % period
    return np.minimum(places, period - places)
