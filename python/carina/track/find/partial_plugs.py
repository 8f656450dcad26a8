"""Detection of airways whose air narrows while the wall does not: a fluid level, or secretions along the wall.

The air of such a branch is narrow along a part of it and wide again beyond. A circle with the calibre before and
beyond is fitted round the narrow air. If material lines or half fills the bronchus, the rest of the circle is
tissue. If the wall narrows too, there is lung inside the circle; the branch is then measured as a stenosis.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.track.find.wall_profile import CrossSampler, Plane
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.track.tree.uncertainty import Uncertainty, filled_place

Points = NDArray[np.float64]
Floats = NDArray[np.float64]

NARROW = 0.88
"""Ratio of the air's width to the calibre before and beyond, below which a part of a branch is examined.

A bronchus that is filled to half its height has 0.71.
"""
MIN_LONG_MM = 4.0
NEAR_MM = 25.0
"""Maximum distance in mm along a branch from narrow air to the next wide air."""
MAX_SHARE = 0.9
"""Quantile of a branch's widths that counts as its largest width; the maximum may be the flare of a fork."""
INNER = 0.85
"""Share of the calibre's radius within which a point is inside the wall despite blur and a bent axis."""
MIN_FILLED, MAX_LUNG = 0.1, 0.1
"""Minimum share of filling, and maximum share of lung, in the circle inside the wall of a filled bronchus."""
ONE_SIDED = 0.15
EACH_MM = 1.0
MIN_STATED = 4
"""Minimum number of sections with material between air and wall for a reported place."""
MAX_SHIFT = 0.9


def find_narrowed(look: CrossSampler, tree: AirwayTree, voxel_mm: float, least_mm: float) -> list[Uncertainty]:
    """Find the parts of branches that have material between the air and the wall.

    Parameters
    ----------
    look
        Sampler of the CT.
    tree
        The airway tree.
    voxel_mm
        Mean edge of a voxel.
    least_mm
        Calibre of the narrowest bronchi that are examined.
    """
    return [place for branch in tree.branches for place in _find_in_branch(look, tree, branch, voxel_mm, least_mm)]


def _find_in_branch(
    look: CrossSampler, tree: AirwayTree, branch: Branch, voxel_mm: float, least_mm: float
) -> list[Uncertainty]:
    if branch.parent is None or len(branch.points) < 4:
        return []
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
    width = 2.0 * branch.radius
    beyond_mm = [_usual_mm(tree.branch(child)) for child in branch.children]
    widest = max([float(np.quantile(width, MAX_SHARE)), *beyond_mm])
    if widest < least_mm:
        return []
    found = []
    for first, last in _runs(_smoothed(width) <= NARROW * widest):
        start_mm, end_mm = at[first], at[last]
        before_mm = _median(width[(at < start_mm) & (at >= start_mm - NEAR_MM)])
        after_mm = _median(width[(at > end_mm) & (at <= end_mm + NEAR_MM)]) or max(beyond_mm, default=None)
        if after_mm is None or end_mm - start_mm < MIN_LONG_MM:
            continue
        calibre = 0.5 * ((before_mm or after_mm) + after_mm)
        inside = float(np.median(width[first : last + 1]))
        if inside > NARROW * min(before_mm or after_mm, after_mm):
            continue
        sampled = np.linspace(start_mm, end_mm, max(3, round((end_mm - start_mm) / EACH_MM) + 1))
        middles = [
            (mm, middle)
            for mm in sampled
            if (middle := _centre_between_walls(look, branch, at, mm, calibre)) is not None
        ]
        if len(middles) < MIN_STATED or middles[-1][0] - middles[0][0] < MIN_LONG_MM:
            continue
        # A calibre from the peripheral side alone may include the flare of a fork, so its error is larger.
        error = max(voxel_mm, ONE_SIDED * after_mm) if before_mm is None else 0.5 * abs(before_mm - after_mm)
        error = max(error, 0.5 * voxel_mm)
        if calibre < least_mm or calibre - inside <= error:
            continue
        found.append(
            filled_place(
                middles[len(middles) // 2][1],
                branch.id,
                air_mm=inside,
                length_mm=float(middles[-1][0] - middles[0][0]),
                calibre_mm=calibre,
                calibre_error_mm=error,
                beyond_lps=None,
            )
        )
    return found


def _usual_mm(branch: Branch) -> float:
    return 2.0 * float(np.median(branch.radius))


def _median(values: Floats) -> float | None:
    return float(np.median(values)) if len(values) else None


def _smoothed(values: Floats) -> Floats:
    """Return the median of each value and its two neighbours, (n,)."""
    padded = np.pad(values, 1, mode="edge")
    result: Floats = np.median(np.stack([padded[:-2], padded[1:-1], padded[2:]]), axis=0)
    return result


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first and last index of each group of consecutive True values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def _centre_between_walls(
    look: CrossSampler, branch: Branch, at: Floats, place_mm: float, calibre_mm: float
) -> Points | None:
    """Return the centre between the walls of a section (LPS, mm); None if no material is between air and wall."""

    def axis_point(mm: float) -> Points:
        return np.array([np.interp(mm, at, branch.points[:, a]) for a in range(3)])

    centre = axis_point(place_mm)
    direction = axis_point(place_mm + 2.0) - axis_point(place_mm - 2.0)
    if not direction.any():
        return None
    radius = 0.5 * calibre_mm
    plane = look.plane(centre, direction, (1.0 + MAX_SHIFT) * radius + 2.0 * look.step_mm)
    # Even thin walls that are darkened by blur separate air from lung at this level.
    dark = plane.values <= look.lung
    air = _connected_to_centre(dark, radius, plane)
    lung = dark & ~air
    tissue = plane.values >= look.half
    best: tuple[float, Floats] | None = None
    for shift in _shifts(radius):
        away = np.hypot(plane.off_mm[..., 0] - shift[0], plane.off_mm[..., 1] - shift[1])
        inside = away <= INNER * radius
        # The best circle has the least air outside and lung inside it; of equal circles the least shifted is used.
        wrong = float((air & (away > radius)).sum() + (lung & inside).sum()) + 1e-3 * float(np.hypot(*shift))
        if best is None or wrong < best[0]:
            best = wrong, shift
    assert best is not None
    away = np.hypot(plane.off_mm[..., 0] - best[1][0], plane.off_mm[..., 1] - best[1][1])
    inside = away <= INNER * radius
    filled = float(tissue[inside].mean())
    if filled < MIN_FILLED or lung[inside].mean() > MAX_LUNG or (air & (away > radius)).sum() > 0.1 * air.sum():
        return None
    middle: Points = centre + best[1] @ plane.across
    return middle


def _shifts(radius: float) -> list[Floats]:
    steps = np.linspace(-MAX_SHIFT * radius, MAX_SHIFT * radius, 13)
    pairs = [np.array([x, y]) for x in steps for y in steps if np.hypot(x, y) <= MAX_SHIFT * radius + 1e-9]
    return sorted(pairs, key=lambda pair: float(np.hypot(*pair)))


def _connected_to_centre(dark: NDArray[np.bool_], radius: float, plane: Plane) -> NDArray[np.bool_]:
    """Return the dark pixels that are connected to the centre of a plane."""
    middle = len(dark) // 2
    near = np.hypot(plane.off_mm[..., 0], plane.off_mm[..., 1]) <= max(0.3 * radius, 1.5 * plane.step_mm)
    found = dark & near
    found[middle, middle] = dark[middle, middle]
    while True:
        grown = found.copy()
        grown[1:] |= found[:-1]
        grown[:-1] |= found[1:]
        grown[:, 1:] |= found[:, :-1]
        grown[:, :-1] |= found[:, 1:]
        grown &= dark
        if grown.sum() == found.sum():
            return found
        found = grown
