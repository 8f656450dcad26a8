"""Outlines of parallel slices as a solid: each outline represents a slab, and gaps are interpolated by shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.volume.mask_distances import signed_distance
from carina.volume.mask_parts import numbered_parts

Share = NDArray[np.float32]

SHORT_GAP = 3.0
"""Maximum gap between two outlines, in slices of the CT, that is filled whatever the distances of the other
outlines."""
GAP_STEPS = 2.0
"""Maximum gap between two outlines that is filled, in typical distances of outlines: one omitted outline."""
GAP_DIAMETERS = 1.5
"""Maximum gap between two outlines of one structure, in diameters of the larger outline."""
SHIFTS = 26
"""Number of bisections that find the level at which an interpolated shape has its area: float32 precision."""


@dataclass(frozen=True, slots=True, eq=False)
class _Link:
    """Pair of shapes in neighbouring planes that belong to one structure."""

    below: NDArray[np.float64]
    above: NDArray[np.float64]
    distances: tuple[NDArray[np.float64], NDArray[np.float64]] | None
    """Signed distances in voxels to the boundaries of both shapes; None if one shape is smaller than a voxel."""

    def at(self, part: float) -> NDArray[np.float64]:
        """Return the shape between two outlines, interpolated by signed distance; ``part`` is the position, 0 to 1.

        The area of the shape is interpolated linearly, so that each outline has exactly the volume of its slab.
        """
        area = (1.0 - part) * float(self.below.sum()) + part * float(self.above.sum())
        if self.distances is None:
            return (1.0 - part) * self.below + part * self.above
        field = 0.5 + (1.0 - part) * self.distances[0] + part * self.distances[1]
        reach = float(np.abs(field).max()) + 1.0
        low, high = -reach, reach
        for _ in range(SHIFTS):
            middle = 0.5 * (low + high)
            if float(np.clip(field + middle, 0.0, 1.0).sum()) < area:
                low = middle
            else:
                high = middle
        found: NDArray[np.float64] = np.clip(field + high, 0.0, 1.0)
        return found


class OutlineStack:
    """Structure as a stack of shapes at increasing heights.

    An outline represents the slab half-way to its neighbours. At an end of a structure, the slab extends half the
    typical distance of the outlines beyond the last outline.

    Parameters
    ----------
    heights
        Increasing heights, in slices of the CT.
    shares
        Shares of voxels (rows, columns) at each height, 0 to 1.
    pixel_mm, slice_mm
        Mean width of a voxel in the planes, and the distance of the CT's slices.
    """

    def __init__(self, heights: Sequence[float], shares: Sequence[Share], *, pixel_mm: float, slice_mm: float) -> None:
        self.heights = np.asarray(heights, dtype=np.float64)
        self._shares = tuple(shares)
        gaps = np.diff(self.heights)
        # The lower median ignores one wide gap between two lesions.
        self.step = float(np.sort(gaps)[(len(gaps) - 1) // 2]) if len(gaps) else 1.0
        """Typical distance of two outlines, in slices of the CT."""
        self._links: list[list[_Link]] = []
        self._ends: list[list[Share]] = [[], []]
        parts = [_parts(share) for share in self._shares]
        free_above = [[True] * len(found) for found in parts]
        free_below = [[True] * len(found) for found in parts]
        for n, gap in enumerate(gaps):
            links = []
            for below, above in _groups(parts[n], parts[n + 1]):
                one, other = (np.sum([parts[n + m][k] for k in ks], axis=0) for m, ks in enumerate((below, above)))
                if not self._is_near(float(gap), one, other, pixel_mm / slice_mm):
                    continue
                links.append(_Link(one, other, _distances(one, other)))
                for k in below:
                    free_above[n][k] = False
                for k in above:
                    free_below[n + 1][k] = False
            self._links.append(links)
        self._tops = [_sum(found, free, self._shares[0]) for found, free in zip(parts, free_above, strict=True)]
        self._bottoms = [_sum(found, free, self._shares[0]) for found, free in zip(parts, free_below, strict=True)]

    @property
    def reach(self) -> float:
        """Length by which the structure extends beyond its first and last outline, in slices of the CT."""
        return 0.5 * self.step

    def at(self, height: float) -> NDArray[np.float64]:
        """Return the shape of the structure at a height, in slices of the CT."""
        exact = np.flatnonzero(np.abs(self.heights - height) < 1e-6)
        if exact.size:
            return self._shares[int(exact[0])].astype(np.float64)
        found = np.zeros(self._shares[0].shape)
        above = int(np.searchsorted(self.heights, height))
        if above > 0:
            found += self._end(height - self.heights[above - 1], above - 1, above) * self._tops[above - 1]
        if above < len(self.heights):
            found += self._end(self.heights[above] - height, above - 1, above) * self._bottoms[above]
        if 0 < above < len(self.heights):
            part = float((height - self.heights[above - 1]) / (self.heights[above] - self.heights[above - 1]))
            for link in self._links[above - 1]:
                found += link.at(part)
        inside: NDArray[np.float64] = np.clip(found, 0.0, 1.0)
        return inside

    def _end(self, away: float, below: int, above: int) -> float:
        """Return the share of an end slab at a distance from the last outline: 1 inside, 0 beyond, 0.5 on the face."""
        reach = self.reach
        if below >= 0 and above < len(self.heights):
            reach = min(reach, 0.5 * float(self.heights[above] - self.heights[below]))
        return 0.5 if abs(away - reach) < 1e-6 else float(away < reach)

    def _is_near(self, gap: float, one: NDArray[np.float64], other: NDArray[np.float64], pixel: float) -> bool:
        """Return whether two shapes in neighbouring planes are near enough to belong to one structure."""
        if gap <= 1.0:
            return True
        diameter = 2.0 * float(np.sqrt(max(one.sum(), other.sum()) / np.pi)) * pixel
        return gap <= max(SHORT_GAP, GAP_STEPS * self.step + 1e-6) and gap <= GAP_DIAMETERS * diameter


def _sum(parts: Sequence[Share], free: Sequence[bool], like: Share) -> NDArray[np.float64]:
    total = np.zeros(like.shape)
    for part, is_free in zip(parts, free, strict=True):
        if is_free:
            total += part
    return total


def _parts(share: Share) -> list[Share]:
    """Return the connected parts of a shape."""
    if not (share > 0.0).any():
        return []
    labels = numbered_parts(share > 0.0, corners=True)
    return [np.where(labels == n, share, np.float32(0.0)) for n in range(1, int(labels.max()) + 1)]


def _groups(below: Sequence[Share], above: Sequence[Share]) -> list[tuple[list[int], list[int]]]:
    """Return the groups of parts of two planes that overlap, directly or through other parts."""
    groups: list[tuple[set[int], set[int]]] = []
    for i, one in enumerate(below):
        for j, other in enumerate(above):
            if not np.minimum(one, other).any():
                continue
            joined: tuple[set[int], set[int]] = ({i}, {j})
            rest = []
            for group in groups:
                if i in group[0] or j in group[1]:
                    joined = (joined[0] | group[0], joined[1] | group[1])
                else:
                    rest.append(group)
            groups = [*rest, joined]
    return [(sorted(one), sorted(other)) for one, other in groups]


def _distances(
    one: NDArray[np.float64], other: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    first, second = _signed(one), _signed(other)
    return None if first is None or second is None else (first, second)


def _signed(share: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the signed distance of each voxel to a shape's boundary in voxels, positive inside.

    None if no voxel is inside.
    """
    inside = share >= 0.5
    if not inside.any() or inside.all():
        return None
    found = signed_distance(inside)
    # Distances are measured between voxel centres; the boundary is half a voxel beyond the last centre inside.
    return found + 0.5
