"""Stacks with uneven slice distances: the even grid, and its slices interpolated between the measured ones.

The even slices begin at the first and end at the last measured slice. Each is interpolated from the two measured slices
on each side (backward mapping, cubic with the slopes of parabolas, limited to the range of the four values).
Their distance is that of the coarser slices, because the quality gate, the plans and the measurements use the distance
as the resolution of the CT. Slices that are far from every measured one are listed as interpolated, so that the views
mark them and no airway rests on them alone; a stack with many such slices is refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.volume.missing_slices import (
    MAX_GAP_MM,
    MAX_MISSING_IN_GAP,
    MAX_MISSING_SHARE,
    missing_levels,
    named_slices,
)
from carina.volume.model import Note

MIN_SLICES = 5
"""Minimum number of slices that are resampled: in fewer slices one wrong position cannot be recognised."""
MAX_RATIO = MAX_MISSING_IN_GAP + 1.0
"""Maximum distance of two measured slices, in distances of the even slices."""
MIN_RATIO = 0.2
"""Minimum distance of two measured slices, in distances of the even slices; nearer slices are probably two scans."""
_GAP_RATIO = 1.75
"""Distance, in distances of the even slices, from which slices are missing between two measured slices."""
_NUM_ALTERNATING = 6
_SAME_PLACE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class UnevenSlices:
    """Positions of unevenly spaced slices relative to a grid of evenly spaced slices."""

    places: NDArray[np.float64]
    """(slices,) place of each measured slice, in slices of the even grid; the first is 0, the last a whole number."""
    gaps_mm: NDArray[np.float64]
    """(slices - 1,) distances of neighbouring measured slices."""

    @classmethod
    def of(cls, along_mm: NDArray[np.float64]) -> tuple[UnevenSlices | None, str]:
        """Return the places of slices on an even grid, or None and the reason why they cannot be resampled.

        The even distance is that of the coarser slices, slightly widened so that the last measured slice is on the
        grid.

        Parameters
        ----------
        along_mm
            (slices,) ascending positions along the normal.
        """
        if len(along_mm) < MIN_SLICES:
            return None, f"at least {MIN_SLICES} slices with uneven distances are resampled"
        gaps_mm = np.diff(along_mm)
        height_mm = float(along_mm[-1] - along_mm[0])
        usual_mm = _coarser_mm(gaps_mm)
        # Rounded down, so that the even slices are never nearer than the measured ones.
        num_steps = max(1, math.floor(height_mm / usual_mm + 1e-6))
        even_mm = height_mm / num_steps
        if gaps_mm.max() > min(MAX_RATIO * usual_mm, MAX_GAP_MM) + 1e-6:
            limit = f"{MAX_RATIO:g} times the usual distance of {usual_mm:.2f} mm and {MAX_GAP_MM:g} mm"
            return None, f"slices are resampled if their distances are at most {limit}"
        if gaps_mm.min() < MIN_RATIO * usual_mm:
            return None, f"two slices are only {gaps_mm.min():.2f} mm apart, so they may belong to two scans"
        if _alternates(gaps_mm, usual_mm):
            return None, "two distances alternate, so the slices of two scans may be mixed"
        places = (along_mm - along_mm[0]) / even_mm
        places[-1] = num_steps
        found = cls(places, gaps_mm)
        if len(missing_levels(found.levels.tolist())) > MAX_MISSING_SHARE * (num_steps + 1):
            limit = f"at most {100 * MAX_MISSING_SHARE:.0f} % of the slices are interpolated"
            return None, f"{limit} between slices {usual_mm:.2f} mm apart"
        return found, ""

    @property
    def even_mm(self) -> float:
        """Distance between neighbouring slices of the even grid, mm."""
        return float(self.gaps_mm.sum() / self.places[-1])

    @property
    def levels(self) -> NDArray[np.int64]:
        """Index of the even grid's slice that is nearest to each measured slice."""
        return np.rint(self.places).astype(np.int64)

    @property
    def sources(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the measured slices from which each even slice is interpolated: one, or up to four."""
        found = []
        for level in range(int(self.places[-1]) + 1):
            above = int(np.searchsorted(self.places, level - _SAME_PLACE))
            is_measured = self.places[above] <= level + _SAME_PLACE
            beside = range(max(above - 2, 0), min(above + 2, len(self.places)))
            found.append((above,) if is_measured else tuple(beside))
        return tuple(found)

    def fill(self, values_zyx: NDArray[np.int16], low: int, planes: Mapping[int, NDArray[np.int16]]) -> None:
        """Fill the even grid's slices from one measured slice up to the next.

        Parameters
        ----------
        values_zyx
            The even slices; changed in place.
        low
            Index of the lower measured slice.
        planes
            The measured slices from ``low - 1`` to ``low + 2``, as far as they exist, by their indices.
        """
        at, end = float(self.places[low]), float(self.places[low + 1])
        if low == 0:
            values_zyx[0] = planes[0]
        beside = [planes[low + by].astype(np.float32) if low + by in planes else None for by in (-1, 0, 1, 2)]
        _, below, above, _ = beside
        assert below is not None
        assert above is not None
        rise = (above - below) / np.float32(end - at)
        first, last = rise, rise
        if beside[0] is not None:
            first = _slope(
                (below - beside[0]) / np.float32(at - self.places[low - 1]), rise, at - self.places[low - 1], end - at
            )
        if beside[3] is not None:
            last = _slope(
                rise, (beside[3] - above) / np.float32(self.places[low + 2] - end), end - at, self.places[low + 2] - end
            )
        taps = [one for one in beside if one is not None]
        least, most = np.minimum.reduce(taps), np.maximum.reduce(taps)
        for level in range(math.floor(at + _SAME_PLACE) + 1, math.floor(end + _SAME_PLACE) + 1):
            if end - level < _SAME_PLACE:
                values_zyx[level] = planes[low + 1]
                continue
            t = (level - at) / (end - at)
            h = [
                2 * t**3 - 3 * t**2 + 1,
                (t**3 - 2 * t**2 + t) * (end - at),
                3 * t**2 - 2 * t**3,
                (t**3 - t**2) * (end - at),
            ]
            parts = zip(h, (below, first, above, last), strict=True)
            total = sum(np.float32(weight) * part for weight, part in parts)
            values_zyx[level] = np.clip(np.rint(total), least, most)

    def note(self) -> Note:
        """Return the badge that states the distances, the slices between them, and the interpolated slices."""
        usual_mm = float(np.median(self.gaps_mm))
        odd = np.flatnonzero(np.abs(self.gaps_mm - usual_mm) > max(0.1 * usual_mm, 0.06))
        missing = missing_levels(self.levels.tolist())
        num_levels = int(self.places[-1]) + 1
        words = (
            f"the slices are {self.gaps_mm.min():.2f} to {self.gaps_mm.max():.2f} mm apart, so the {len(self.places)} "
            f"slices were resampled to {num_levels} slices {self.even_mm:.2f} mm apart by interpolation along the stack"
        )
        if odd.size:
            words += f" (usual distance {usual_mm:.2f} mm; another one after slice {named_slices(odd.tolist())})"
        if missing:
            words += (
                f"; nothing was measured near slice{'s' if len(missing) > 1 else ''} {named_slices(missing)} of the "
                "resampled stack, so airways and measurements in them are not reliable"
            )
        return Note("import.slices-resampled", words, badge=True)


def even_part(gaps_mm: NDArray[np.float64]) -> tuple[int, int] | None:
    """Return the first and the last slice of the longest part with even distances, or None.

    The part has at least half of all slices, so that it can replace the stack.

    Parameters
    ----------
    gaps_mm
        (slices - 1,) distances of neighbouring slices.

    Examples
    --------
    >>> even_part(np.array([1.25] * 110 + [5.0] * 40))
    (0, 110)
    """
    first, best = 0, (0, 0)
    for at, gap_mm in enumerate(gaps_mm):
        if abs(gap_mm - gaps_mm[first]) > max(0.1 * gaps_mm[first], 0.06):
            first = at
        if at + 1 - first > best[1] - best[0]:
            best = first, at + 1
    num = best[1] - best[0] + 1
    return best if num >= MIN_SLICES and 2 * num >= len(gaps_mm) + 1 else None


def _slope(
    before: NDArray[np.float32], after: NDArray[np.float32], before_width: float, after_width: float
) -> NDArray[np.float32]:
    """Return the slope of the parabola through three slices at the middle one, from the slopes on its two sides."""
    whole = before_width + after_width
    return before * np.float32(after_width / whole) + after * np.float32(before_width / whole)


def _coarser_mm(gaps_mm: NDArray[np.float64]) -> float:
    """Return the distance of the coarser slices, which at most a tenth of the distances exceeds.

    One distance may always exceed it, so that one displaced slice changes nothing in a small stack. Distances that are
    large enough for a missing slice do not count; the share of interpolated slices limits them.
    """
    usual_mm, before_mm = float(np.median(gaps_mm)), 0.0
    while usual_mm > before_mm:
        before_mm = usual_mm
        narrow_mm = np.sort(gaps_mm[gaps_mm < _GAP_RATIO * usual_mm])
        num_wider = max(1, int(MAX_MISSING_SHARE * len(narrow_mm)))
        usual_mm = max(usual_mm, float(narrow_mm[-1 - num_wider]))
    return usual_mm


def _alternates(gaps_mm: NDArray[np.float64], usual_mm: float) -> bool:
    """Return whether two different distances alternate in a part of the stack, as in the slices of two mixed scans."""
    tolerance_mm = 0.02 * usual_mm + 0.01
    same = np.abs(gaps_mm[2:] - gaps_mm[:-2]) <= tolerance_mm
    differs = np.abs(gaps_mm[2:] - gaps_mm[1:-1]) > 4 * tolerance_mm
    run = 0
    for alternates in same & differs:
        run = run + 1 if alternates else 0
        if run >= _NUM_ALTERNATING - 2:
            return True
    return False
