"""Detection of bronchi that are filled or narrowed (by mucus, for example) but continue beyond the obstruction.

Air beyond an obstruction is an island: it is not connected to the airways that were found. The search starts at the end
of an island and follows the axis of the island through bright tissue back to the found airways. The outer border of the
bronchus against the lung, measured across this gap, gives the calibre from wall to wall. See docs/decisions/0136.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.find.partial_plugs import find_narrowed
from carina.track.find.unreached_air import Island, IslandEnd, find_islands
from carina.track.find.wall_profile import CrossSampler
from carina.track.tree.airway_tree import AirwayTree
from carina.track.tree.uncertainty import Uncertainty, filled_place
from carina.volume.model import Volume

Points = NDArray[np.float64]
Floats = NDArray[np.float64]

DARKEST_HU = -930.0
"""Maximum HU of air in an island (air that no path reaches): half-way between air and lung."""
MIN_RISE_HU = 150.0
"""Minimum rise in HU of a wall above the lumen, if ``NOISE_RISE`` times the noise is less."""
NOISE_RISE = 4.0
"""Minimum rise of a wall above the lumen, as a multiple of the noise."""
MIN_WALLED = 0.85
MIN_IN_LUNG = 0.5
"""Minimum share of the sides of an end of an air island that touch lung; air in the oesophagus has no such end."""
WIDER, WALL_REACH_MM = 1.6, 2.5
"""Maximum distance of an air island's wall from its axis: a multiple of the island's radius, plus a distance in mm."""

EDGE_MM = 2.0
"""Minimum distance in mm of an examined island from the edge of the scan."""

FARTHEST_MM = 45.0
"""Maximum length in mm of the gap between an island of air and the airways across a plug."""
MAX_OFF_DEG = 60.0
"""Maximum angle in degrees between the axis of an island's end and the gap to the airways."""
STEP_MM = 0.4
"""Distance in mm between samples along the gap between an island of air and the airways."""
MIN_GAP_MM = 2.5
"""Minimum length in mm of tissue in a gap that counts as a mucus plug."""
MIN_GAP_VOX = 2.0
"""Minimum length in voxels of tissue in a gap that counts as a mucus plug."""
MAX_DARK = 0.25
"""Maximum share of the gap between an island and the airways that may be as dark as lung."""
MAX_LOOSE_MM = 2.5
"""Maximum length in mm without filling between the filling and the lumen, on either side."""
BRIGHTEST_HU = 250.0
"""Value in HU above which a voxel is bone, calcification or a vessel with contrast medium, and no filling."""
NUM_TRIED = 60
"""Approximate number of airway points that are tried for one end of an island."""
UNFILLED = 4.0
"""Penalty for a gap without tissue: its score (lower is better) is multiplied by 1 plus up to this value."""

USUAL_WALL_MM = 1.2
"""Thickness in mm of the wall of a filled bronchus if it cannot be measured beyond the filling."""
CROSS = (0.25, 0.4, 0.5, 0.6, 0.75)
"""Positions of the examined cross-sections along a filling, as fractions of its length."""
MAX_OUTER_MM = 9.0
"""Maximum distance in mm from the axis of a filled bronchus at which its border is searched."""
MIN_AIR = 0.15
"""Minimum share of air in a filled bronchus that counts as air; less may be fat, noise, or blur."""
MIN_CROSS = 2
"""Minimum number of sections across the filling in which the border of the bronchus must be visible."""
ALIKE = 1.4
"""Maximum ratio between the widths of sections of one lumen; beyond it, a section cuts the end or a fork."""
FINE_MM, FINE_VOX, FINE_SLICES = 2.5, 3.0, 2.0
"""Limits of the calibre below which an airway is not reported as filled: mm, voxels and slices.

The limit is the largest of 2.5 mm, three voxels, and two slices of the CT. An airway that runs along one slice has the
brightness of its lumen and its wall together, as if it were partly filled.
"""


@dataclass(frozen=True, slots=True, eq=False)
class _Gap:
    """Straight line from an island of air to the airways that were found."""

    end: IslandEnd
    far_lps: Points
    """Peripheral end of the filling, LPS in mm."""
    near_lps: Points
    """Central end of the filling, LPS in mm."""
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
    *,
    slice_mm: float,
    cancel: Callable[[], bool] | None = None,
) -> tuple[Uncertainty, ...]:
    """Find the places where a bronchus is narrowed or filled but continues; the lumen is not changed.

    Parameters
    ----------
    volume
        The CT.
    tree, lumen_zyx
        Airways that were found in the CT.
    noise
        Standard deviation of the voxel values of air in the trachea.
    slice_mm
        Effective thickness of the slices of the CT, also if ``volume`` has divided slices.
    cancel
        Function that returns True to stop the search.

    Returns
    -------
    tuple of Uncertainty
        Places of kind ``filled``, the widest first.
    """
    look = CrossSampler(volume)
    search = _GapSearch(volume, look, tree, lumen_zyx, noise, slice_mm=slice_mm)
    found = list(find_narrowed(look, tree, search.voxel_mm, search.fine_mm))
    centrelines = np.concatenate([branch.points for branch in tree.branches])
    for island in find_islands(volume, lumen_zyx, centrelines, float(look.scale.level(DARKEST_HU))):
        if cancel is not None and cancel():
            break
        place = search.filled_place_of(island)
        if place is not None:
            found.append(place)
    found.sort(key=lambda one: (-(one.calibre_mm or one.width_mm), one.lps))
    return _without_duplicates(found)


def _without_duplicates(found: Sequence[Uncertainty]) -> tuple[Uncertainty, ...]:
    """Return the filled places with the narrower of two places in the same bronchus removed.

    Air that remains in a filled bronchus is traced as a separate thin airway.
    """
    distinct: list[Uncertainty] = []
    for one in found:
        for other in distinct:
            reach_mm = 0.5 * ((one.length_mm or 0.0) + (other.length_mm or 0.0))
            if float(np.linalg.norm(np.array(one.lps) - np.array(other.lps))) <= reach_mm:
                break
        else:
            distinct.append(one)
    return tuple(distinct)


class _GapSearch:
    """Search for the filled gaps between islands of air and the found airways."""

    def __init__(
        self,
        volume: Volume,
        look: CrossSampler,
        tree: AirwayTree,
        lumen_zyx: NDArray[np.uint8],
        noise: float,
        *,
        slice_mm: float,
    ) -> None:
        self._volume, self._look, self._tree, self._lumen = volume, look, tree, lumen_zyx
        self.voxel_mm = float(np.cbrt(np.prod(volume.spacing_mm)))
        self.fine_mm = max(FINE_MM, FINE_VOX * self.voxel_mm, FINE_SLICES * slice_mm)
        self._rise = max(look.scale.span(MIN_RISE_HU), NOISE_RISE * noise)
        self._points = np.concatenate([branch.points for branch in tree.branches])
        self._radius = np.concatenate([branch.radius for branch in tree.branches])
        self._owner = np.concatenate([np.full(len(branch.points), n) for n, branch in enumerate(tree.branches)])

    def filled_place_of(self, island: Island) -> Uncertainty | None:
        """Return the filled place between the airways and an island of air, or None if the island is not an airway.

        The result is also None if the island reaches the edge of the scan: its connection to the airways may be
        outside the scan.
        """
        if self._reaches_edge(island):
            return None
        gaps = [gap for end in island.ends for gap in self._gaps(end)]
        if not gaps or not self._lies_in_lung(island):
            return None
        return self._uncertainty(min(gaps, key=lambda gap: (gap.score, gap.lumen_lps.tolist())))

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
        chosen = np.flatnonzero((gap <= FARTHEST_MM) & (gap > 0.0) & (aligned >= np.cos(np.radians(MAX_OFF_DEG))))
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
            length_mm < max(MIN_GAP_MM, MIN_GAP_VOX * self.voxel_mm)
            or (inside < self._look.half).mean() > MAX_DARK
            or (inside > self._look.scale.level(BRIGHTEST_HU)).mean() > 0.5
            # The axis of an island ends just inside the island: tissue farther away is separated from it by lung.
            or first * STEP_MM > MAX_LOOSE_MM + 2.0 * end.radius_mm
            or (arrives - last) * STEP_MM > MAX_LOOSE_MM
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

    def _inner_rays(self, end: IslandEnd, back_mm: float = 0.0) -> tuple[Floats, Floats]:
        """Return rays across an island, ``back_mm`` inside the island's end, and the lumen's edge on each ray in mm."""
        reach = WIDER * end.radius_mm + WALL_REACH_MM
        rays = self._look.rays(end.axis_lps - back_mm * end.outward, end.outward, reach)
        return rays, self._look.inner_mm(rays, self._rise)

    def _is_walled(self, end: IslandEnd) -> bool:
        """Return whether a wall surrounds the air at an end of an island."""
        return bool(np.isfinite(self._inner_rays(end)[1]).mean() >= MIN_WALLED)

    def _lies_in_lung(self, island: Island) -> bool:
        """Return whether some end of an island has a wall and, close outside the wall, lung on most sides."""
        return any(self._is_in_lung(end) for end in island.ends)

    def _is_in_lung(self, end: IslandEnd) -> bool:
        _, inner = self._inner_rays(end)
        rays = self._look.rays(end.axis_lps, end.outward, WIDER * end.radius_mm + 2.0 * WALL_REACH_MM + 2.0)
        at = np.arange(rays.shape[1]) * self._look.step_mm
        outside = (at > inner[:, None] + self._look.step_mm) & (at <= inner[:, None] + 4.0)
        # Compare with the peak of the wall, not with the edge of the lumen.
        risen = np.maximum.accumulate(np.where(at >= inner[:, None], rays, -np.inf), axis=1)
        fallen = outside & (rays <= self._look.lung) & (risen - rays >= 0.5 * self._rise)
        return bool(fallen.any(axis=1).mean() >= MIN_IN_LUNG)

    def _uncertainty(self, gap: _Gap) -> Uncertainty | None:
        branch, _, _ = self._tree.nearest_branch(gap.lumen_lps)
        after = self._calibre_after(gap.end)
        axis, outer = self._follow_axis(gap, after)
        calibre, error = self._calibre(outer, gap.end)
        if (calibre if calibre is not None else after if after is not None else 2.0 * gap.end.radius_mm) < self.fine_mm:
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
        """Return the calibre in mm of the lumen beyond the filling, from its narrowest section; None if unknown."""
        widths = []
        for back_mm in (0.0, 1.5, 3.0, 4.5):
            _, inner = self._inner_rays(end, back_mm)
            if np.isfinite(inner).mean() >= MIN_WALLED:
                widths.append(float(np.nanmedian(inner[:16] + inner[16:])))
        return min(widths) if len(widths) > 1 and max(widths) <= ALIKE * min(widths) else None

    def _wall_mm(self, end: IslandEnd) -> float | None:
        """Return the thickness in mm of the wall beyond the filling, given the same outer border as across the gap."""
        rays, inner = self._inner_rays(end)
        at = np.arange(rays.shape[1]) * self._look.step_mm
        thick = []
        for ray, edge in zip(rays, inner, strict=True):
            if np.isfinite(edge):
                outside = np.flatnonzero((at > edge + self._look.step_mm) & (ray < self._look.half))
                if len(outside):
                    thick.append(float(at[outside[0]] - edge))
        return float(np.median(thick)) if len(thick) >= 8 else None

    def _follow_axis(self, gap: _Gap, after: float | None) -> tuple[Points, list[float]]:
        """Return the axis of the filled part, centred between its borders, and the outer widths (mm) along it."""
        direction = gap.near_lps - gap.far_lps
        reach = max(MAX_OUTER_MM, 0.9 * (after or 0.0) + 3.0)
        axis = gap.far_lps + np.array(CROSS)[:, None] * direction
        outer: list[float] = []
        for n, start in enumerate(axis):
            found = self._look.middle(start, direction, reach)
            if found is not None:
                axis[n], width = found
                outer.append(width)
        return axis, outer

    def _air_mm(self, centre: Points, direction: Points, calibre: float | None) -> float:
        """Return the diameter in mm of the circle with the area of the air that remains in the filled bronchus."""
        reach = 0.5 * (calibre if calibre is not None else 6.0)
        plane = self._look.plane(centre, direction, reach)
        scale = self._look.scale
        # Partial volume: a crescent of air thinner than a voxel is not as dark as air, but darkens in proportion.
        share = np.clip((scale.level(0.0) - plane.values) / scale.span(1000.0), 0.0, 1.0)
        share[np.hypot(*np.moveaxis(plane.off_mm, -1, 0)) > reach] = 0.0
        share[share < MIN_AIR] = 0.0
        area = float(share.sum()) * plane.step_mm**2
        return 2.0 * float(np.sqrt(area / np.pi)) if area >= self.voxel_mm**2 else 0.0

    def _calibre(self, outer: list[float], end: IslandEnd) -> tuple[float | None, float | None]:
        """Return the calibre of a filled bronchus from wall to wall and the calibre's error, in mm.

        The lumen beyond the filling is not sufficient alone: the part before its next fork is short.
        """
        wall = self._wall_mm(end)
        if len(outer) < MIN_CROSS:
            return None, None
        value = float(np.median(outer)) - 2.0 * (USUAL_WALL_MM if wall is None else wall)
        spread = 0.5 * float(np.ptp(np.quantile(outer, [0.2, 0.8])))
        error = max(spread, 0.5 * self.voxel_mm) + (0.5 if wall is None else 0.0)
        return (value, error) if value > 0.0 else (None, None)
