"""Bronchi that go on where their air does not: secretions, or whatever else fills or narrows a lumen.

Air beyond an obstruction lies in the chest like an island: from where it ends its axis leads through something as
bright as tissue back to the airways that were found. What the CT shows across that gap, the bronchus's outer border
against the lung, tells its calibre from wall to wall. docs/decisions/0115.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.find.across import Across
from carina.track.find.islands import Island, IslandEnd, find_islands
from carina.track.find.narrowed import find_narrowed
from carina.track.tree.airway_tree import AirwayTree
from carina.track.tree.uncertain import Uncertainty, filled_place
from carina.volume.model import Volume

__all__ = ["find_filled"]

Points = NDArray[np.float64]
Floats = NDArray[np.float64]

# Air and lung.
DARKEST_HU = -930.0
"""Half-way between air and lung."""
LEAST_RISE_HU = 150.0
NOISE_RISE = 4.0
"""A wall rises so many times the noise, or 150 HU."""
LEAST_WALLED = 0.85
LEAST_IN_LUNG = 0.5
"""Some end of an airway in the lung meets it on so many sides: air in the gullet does not."""
WIDER, WALL_REACH_MM = 1.6, 2.5
"""The wall of a piece of airway is looked for within so many of its radii and so many mm; what lies farther is none."""

EDGE_MM = 2.0
"""Air this near to the edge of the scan may go on outside."""

# The gap.
FARTHEST_MM = 45.0
MOST_OFF_DEG = 60.0
STEP_MM = 0.4
LEAST_GAP_MM = 2.5
LEAST_GAP_VOX = 2.0
MOST_DARK = 0.25
"""Of a gap so much may be as dark as lung: a level of fluid leaves air above it."""
MOST_LOOSE_MM = 2.5
"""What lies between the filling and either lumen is blur."""
BRIGHTEST_HU = 250.0
"""Bone, lime and vessels with contrast medium are no filling."""
NUM_TRIED = 60
UNFILLED = 4.0
"""A way beside a cord is so much worse than one along it."""

# The calibre.
USUAL_WALL_MM = 1.2
CROSS = (0.25, 0.4, 0.5, 0.6, 0.75)
MOST_OUTER_MM = 9.0
"""The border of a filled bronchus is looked for within this distance of its axis."""
LEAST_AIR = 0.15
"""What is less dark may be fat, noise, or blur from outside the wall."""
LEAST_CROSS = 2
"""Sections across the filling in which the border must be seen."""
ALIKE = 1.4
"""Sections of one lumen differ by less; else they cut its end, or a fork."""
FINE_MM, FINE_VOX = 2.5, 3.0
"""Thinner than this is no finding: the CT hardly shows such airways."""


@dataclass(frozen=True, slots=True, eq=False)
class _Gap:
    """A straight way from an island to the airways."""

    end: IslandEnd
    far_lps: Points
    """Where the filling ends, towards the periphery."""
    near_lps: Points
    """Where it begins."""
    lumen_lps: Points
    score: float

    @property
    def length_mm(self) -> float:
        return float(np.linalg.norm(self.far_lps - self.near_lps))


def find_filled(
    volume: Volume,
    tree: AirwayTree,
    lumen_zyx: NDArray[np.uint8],
    noise: float,
    cancel: Callable[[], bool] | None = None,
) -> tuple[Uncertainty, ...]:
    """Where a bronchus is narrowed or filled and yet goes on; nothing is added to the lumen.

    Parameters
    ----------
    volume
        The CT.
    tree, lumen_zyx
        The airways that were found in it.
    noise
        Standard deviation of the values in air.
    cancel
        Asked whether to stop.

    Returns
    -------
    tuple of Uncertainty
        Of kind ``filled``, the widest first.
    """
    look = Across(volume)
    search = _Search(volume, look, tree, lumen_zyx, noise)
    found = list(find_narrowed(look, tree, search.voxel_mm))
    centrelines = np.concatenate([branch.points for branch in tree.branches])
    for island in find_islands(volume, lumen_zyx, centrelines, float(look.scale.level(DARKEST_HU))):
        if cancel is not None and cancel():
            break
        place = search.place_of(island)
        if place is not None:
            found.append(place)
    found.sort(key=lambda one: (-(one.calibre_mm or one.width_mm), one.lps))
    return _each_once(found)


def _each_once(found: Sequence[Uncertainty]) -> tuple[Uncertainty, ...]:
    """Without the narrower of two places in one bronchus: air that is left in it is traced as a thin airway."""
    kept: list[Uncertainty] = []
    for one in found:
        for other in kept:
            reach_mm = 0.5 * ((one.length_mm or 0.0) + (other.length_mm or 0.0))
            if float(np.linalg.norm(np.array(one.lps) - np.array(other.lps))) <= reach_mm:
                break
        else:
            kept.append(one)
    return tuple(kept)


class _Search:
    """From islands of air to the airways."""

    def __init__(
        self, volume: Volume, look: Across, tree: AirwayTree, lumen_zyx: NDArray[np.uint8], noise: float
    ) -> None:
        self._volume, self._look, self._tree, self._lumen = volume, look, tree, lumen_zyx
        self.voxel_mm = float(np.cbrt(np.prod(volume.spacing_mm)))
        self._fine_mm = max(FINE_MM, FINE_VOX * self.voxel_mm)
        self._rise = max(look.scale.span(LEAST_RISE_HU), NOISE_RISE * noise)
        self._points = np.concatenate([branch.points for branch in tree.branches])
        self._radius = np.concatenate([branch.radius for branch in tree.branches])
        self._owner = np.concatenate([np.full(len(branch.points), n) for n, branch in enumerate(tree.branches)])

    def place_of(self, island: Island) -> Uncertainty | None:
        """Return what fills the way from the airways to an island of air; None if the island is not an airway.

        None also for an island that reaches the edge of the scan: its way to the airways may be outside.
        """
        if self._reaches_edge(island):
            return None
        gaps = [gap for end in island.ends for gap in self._gaps(end)]
        if not gaps or not self._lies_in_lung(island):
            return None
        return self._told(min(gaps, key=lambda gap: (gap.score, gap.lumen_lps.tolist())))

    def _reaches_edge(self, island: Island) -> bool:
        ijk = self._volume.to_ijk(island.points_lps)
        last = np.array(self._volume.shape_zyx[::-1]) - 1
        edge_mm = np.minimum(ijk, last - ijk).min(axis=0) * np.array(self._volume.spacing_mm)
        return bool((edge_mm <= EDGE_MM).any())

    def _gaps(self, end: IslandEnd) -> list[_Gap]:
        off = self._points - end.axis_lps
        away = np.linalg.norm(off, axis=1)
        aligned = (off @ end.outward) / np.maximum(away, 1e-9)
        gap = away - self._radius
        chosen = np.flatnonzero((gap <= FARTHEST_MM) & (gap > 0.0) & (aligned >= np.cos(np.radians(MOST_OFF_DEG))))
        if not len(chosen) or not self._is_walled(end):
            return []
        score = np.maximum(gap[chosen], 1.0) / aligned[chosen] ** 2
        order = chosen[np.lexsort((chosen, score))][:: max(1, len(chosen) // NUM_TRIED)]
        tried = [self._gap(end, self._points[n], float(aligned[n])) for n in order]
        return [one for one in tried if one is not None]

    def _gap(self, end: IslandEnd, goal: Points, aligned: float) -> _Gap | None:
        off = goal - end.axis_lps
        length = float(np.linalg.norm(off))
        at = np.arange(0.0, length + STEP_MM, STEP_MM)
        direction = off / length
        places = end.axis_lps + at[:, None] * direction
        is_lumen = self._is_lumen(places)
        if not is_lumen.any():
            return None
        arrives = int(np.argmax(is_lumen))
        values = self._look.along(places[: arrives + 1], direction)
        tissue = np.flatnonzero(values[:arrives] >= self._look.half)
        if not len(tissue):
            return None
        first, last = int(tissue[0]), int(tissue[-1])
        length_mm = (last - first) * STEP_MM
        inside = values[first : last + 1]
        if (
            length_mm < max(LEAST_GAP_MM, LEAST_GAP_VOX * self.voxel_mm)
            or (inside < self._look.half).mean() > MOST_DARK
            or (inside > self._look.scale.level(BRIGHTEST_HU)).mean() > 0.5
            # The axis of a piece is found just inside it: what is farther is separated by lung.
            or first * STEP_MM > MOST_LOOSE_MM + 2.0 * end.radius_mm
            or (arrives - last) * STEP_MM > MOST_LOOSE_MM
        ):
            return None
        inside_lps = places[first : last + 1]
        full = self._look.share_of_tissue(inside_lps[:: max(1, len(inside_lps) // 8)], direction, 0.8 * end.radius_mm)
        score = arrives * STEP_MM / aligned**2 * (1.0 + UNFILLED * (1.0 - full))
        return _Gap(end, places[first], places[last], places[arrives], score)

    def _is_lumen(self, places: Points) -> NDArray[np.bool_]:
        ijk = np.floor(self._volume.to_ijk(places) + 0.5).astype(int)
        i, j, k = np.clip(ijk, 0, np.array(self._volume.shape_zyx[::-1]) - 1).T
        result: NDArray[np.bool_] = self._lumen[k, j, i] != 0
        return result

    def _inner(self, end: IslandEnd, back_mm: float = 0.0) -> tuple[Floats, Floats]:
        """Rays across a piece of airway, some way inside its end, and where each meets the lumen's edge."""
        reach = WIDER * end.radius_mm + WALL_REACH_MM
        rays = self._look.rays(end.axis_lps - back_mm * end.outward, end.outward, reach)
        return rays, self._look.inner_mm(rays, self._rise)

    def _is_walled(self, end: IslandEnd) -> bool:
        """Whether there is a wall round the air of an end."""
        return bool(np.isfinite(self._inner(end)[1]).mean() >= LEAST_WALLED)

    def _lies_in_lung(self, island: Island) -> bool:
        """Whether some end of it has a wall and, close outside it, lung on most sides."""
        return any(self._is_in_lung(end) for end in island.ends)

    def _is_in_lung(self, end: IslandEnd) -> bool:
        _, inner = self._inner(end)
        rays = self._look.rays(end.axis_lps, end.outward, WIDER * end.radius_mm + 2.0 * WALL_REACH_MM + 2.0)
        at = np.arange(rays.shape[1]) * self._look.step_mm
        outside = (at > inner[:, None] + self._look.step_mm) & (at <= inner[:, None] + 4.0)
        # Beyond the wall's peak, not the lumen's own edge.
        risen = np.maximum.accumulate(np.where(at >= inner[:, None], rays, -np.inf), axis=1)
        fallen = outside & (rays <= self._look.lung) & (risen - rays >= 0.5 * self._rise)
        return bool(fallen.any(axis=1).mean() >= LEAST_IN_LUNG)

    def _told(self, gap: _Gap) -> Uncertainty | None:
        branch, _, _ = self._tree.nearest_branch(gap.lumen_lps)
        after = self._calibre_after(gap.end)
        axis, outer = self._followed(gap, after)
        calibre, error = self._calibre(outer, gap.end)
        if (
            calibre if calibre is not None else after if after is not None else 2.0 * gap.end.radius_mm
        ) < self._fine_mm:
            return None
        middle = axis[len(axis) // 2]
        air_mm = self._air_mm(middle, gap.near_lps - gap.far_lps, calibre)
        return filled_place(
            middle,
            branch.id,
            air_mm=air_mm,
            length_mm=gap.length_mm,
            calibre_mm=calibre,
            calibre_error_mm=error,
            beyond_lps=gap.end.axis_lps,
        )

    def _calibre_after(self, end: IslandEnd) -> float | None:
        """Of the lumen beyond; the narrowest of the sections there, since the others cut forks."""
        widths = []
        for back_mm in (0.0, 1.5, 3.0, 4.5):
            _, inner = self._inner(end, back_mm)
            if np.isfinite(inner).mean() >= LEAST_WALLED:
                widths.append(float(np.nanmedian(inner[:16] + inner[16:])))
        return min(widths) if len(widths) > 1 and max(widths) <= ALIKE * min(widths) else None

    def _wall_mm(self, end: IslandEnd) -> float | None:
        """Thickness of the wall beyond, from the lumen's edge to the border as it is measured across the gap."""
        rays, inner = self._inner(end)
        at = np.arange(rays.shape[1]) * self._look.step_mm
        thick = []
        for ray, edge in zip(rays, inner, strict=True):
            if np.isfinite(edge):
                outside = np.flatnonzero((at > edge + self._look.step_mm) & (ray < self._look.half))
                if len(outside):
                    thick.append(float(at[outside[0]] - edge))
        return float(np.median(thick)) if len(thick) >= 8 else None

    def _followed(self, gap: _Gap, after: float | None) -> tuple[Points, list[float]]:
        """Return the axis of a filled stretch, centred between its borders, and the outer widths along it."""
        direction = gap.near_lps - gap.far_lps
        reach = max(MOST_OUTER_MM, 0.9 * (after or 0.0) + 3.0)
        axis = gap.far_lps + np.array(CROSS)[:, None] * direction
        outer: list[float] = []
        for n, start in enumerate(axis):
            found = self._look.middle(start, direction, reach)
            if found is not None:
                axis[n], width = found
                outer.append(width)
        return axis, outer

    def _air_mm(self, centre: Points, direction: Points, calibre: float | None) -> float:
        """Diameter of the circle with the area of the air that is left, from wall to wall."""
        reach = 0.5 * (calibre if calibre is not None else 6.0)
        plane = self._look.plane(centre, direction, reach)
        scale = self._look.scale
        # A crescent thinner than a voxel is nowhere as dark as air, but darkens as much as it holds.
        share = np.clip((scale.level(0.0) - plane.values) / scale.span(1000.0), 0.0, 1.0)
        share[np.hypot(*np.moveaxis(plane.off_mm, -1, 0)) > reach] = 0.0
        share[share < LEAST_AIR] = 0.0
        area = float(share.sum()) * plane.step_mm**2
        return 2.0 * float(np.sqrt(area / np.pi)) if area >= self.voxel_mm**2 else 0.0

    def _calibre(self, outer: list[float], end: IslandEnd) -> tuple[float | None, float | None]:
        """From wall to wall, and its error; None where too little of the outer border is seen.

        The lumen beyond by itself tells too little: what is left of it before its next fork is short.
        """
        wall = self._wall_mm(end)
        if len(outer) < LEAST_CROSS:
            return None, None
        value = float(np.median(outer)) - 2.0 * (USUAL_WALL_MM if wall is None else wall)
        spread = 0.5 * float(np.ptp(np.quantile(outer, [0.2, 0.8])))
        error = max(spread, 0.5 * self.voxel_mm) + (0.5 if wall is None else 0.0)
        return (value, error) if value > 0.0 else (None, None)
