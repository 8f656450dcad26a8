"""Missing slices of a stack: which gaps are filled, and the interpolated slices that fill them.

A gap is filled only if its width is a whole number of slice distances, so that the other slices keep their positions.
Interpolated slices contain no measured values; each result of the scan has a badge that names them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.volume.model import Note

MAX_MISSING_IN_GAP = 3
"""Number of adjacent missing slices up to which they are interpolated."""
MAX_GAP_MM = 10.0
"""Maximum distance in mm between the two slices at a gap that is filled by interpolation."""
MAX_MISSING_SHARE = 0.1
"""Maximum share of a volume's slices that may be interpolated."""
_MAX_NAMED = 6


def fillable_levels(
    gaps_mm: NDArray[np.float64], expected_mm: float, tolerance_mm: float
) -> tuple[NDArray[np.int64] | None, str]:
    """Return the level of each slice in a stack with gaps, or None and the reason why the gaps cannot be filled.

    Parameters
    ----------
    gaps_mm
        Distances of neighbouring slices.
    expected_mm
        Distance of slices in the stack.
    tolerance_mm
        Largest deviation of a distance from a multiple of the expected one.
    """
    steps = np.rint(gaps_mm / expected_mm).astype(np.int64)
    if steps.min() < 1 or np.abs(gaps_mm - steps * expected_mm).max() > tolerance_mm:
        return None, ""
    levels = np.concatenate([[0], np.cumsum(steps)])
    missing = int((steps - 1).sum())
    if steps.max() - 1 > MAX_MISSING_IN_GAP or (gaps_mm[steps > 1] > MAX_GAP_MM + tolerance_mm).any():
        return None, f"gaps of at most {MAX_MISSING_IN_GAP} slices and {MAX_GAP_MM:g} mm are interpolated"
    if missing > MAX_MISSING_SHARE * (levels[-1] + 1):
        return None, f"at most {100 * MAX_MISSING_SHARE:.0f} % of the slices are interpolated"
    return levels, ""


def missing_levels(levels: Sequence[int]) -> tuple[int, ...]:
    """Return the levels between the first and the last that have no slice, ascending."""
    return tuple(sorted(set(range(levels[-1] + 1)) - set(levels)))


def named_slices(levels: Sequence[int]) -> str:
    """Return the numbers of ascending slices, counted from 1, as ranges: "3, 7 to 9"; of many ranges the first six."""
    ranges: list[list[int]] = []
    for level in levels:
        if ranges and ranges[-1][1] == level - 1:
            ranges[-1][1] = level
        else:
            ranges.append([level, level])
    named = [f"{low + 1}" if low == high else f"{low + 1} to {high + 1}" for low, high in ranges]
    return ", ".join(named[:_MAX_NAMED]) + (f" and {len(named) - _MAX_NAMED} more" if len(named) > _MAX_NAMED else "")


def interpolated_note(missing: Sequence[int], num_levels: int) -> Note:
    """Return the badge that names the interpolated slices; slices are counted from 1 at the first slice."""
    count = len(missing)
    verb = "slices is missing and was" if count == 1 else "slices are missing and were"
    words = (
        f"{count} of {num_levels} {verb} interpolated between the neighbours (slice{'s' if count > 1 else ''} "
        f"{named_slices(missing)}, "
        "counted from the first): nothing was measured there, so airways and measurements in them are not reliable"
    )
    return Note("import.slices-interpolated", words, badge=True)


def fill_between(values_zyx: NDArray[np.int16], low: int, high: int) -> None:
    """Fill the slices between two levels by linear interpolation.

    Parameters
    ----------
    values_zyx
        The volume; changed in place.
    low, high
        Levels of the measured slices beside the gap.
    """
    for level in range(low + 1, high):
        weight = np.float32((level - low) / (high - low))
        below, above = values_zyx[low].astype(np.float32), values_zyx[high].astype(np.float32)
        values_zyx[level] = np.rint(below + weight * (above - below)).astype(np.int16)
