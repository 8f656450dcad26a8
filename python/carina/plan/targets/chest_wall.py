"""Surface of the chest wall, mediastinum or diaphragm beside a nodule, as it would be without the nodule."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.plan.cubic_box import Box, beside, component_at, from_faces, uphill
from carina.volume.mask_distances import ball_distance, distance_from
from carina.volume.mask_parts import parts_by_size

Mask = NDArray[np.bool_]

WALL_HU = -400.0
VESSEL_MM = 3.5
"""Radius in mm of the opening that separates vessels from wall.

The opening removes vessels. A remaining part that reaches the faces of the box is wall.
"""
CLOSING_MM = 14.0
"""Radius in mm of the closing of the lung; narrower hollows of the lung's surface (nodules, hila) are filled."""
WIDE_CLOSINGS_MM, CLOSING_SHARE = (23.0, 36.0), 0.64
"""Radii in mm of the closings that are tried for a mass with a wide contact; largest share of half the box's side.

The closings are tried in turn if no surface of the wall can be fitted with smaller closings.
"""
RING_MM = 16.0
BEYOND_MM, WIDEST_MM = 12.0, 50.0
"""Width in mm of the ring of lung surface that is fitted round a mass's contact, and the ring's largest radius."""
LUNGWARD_MM, DEEPEST_MM = 6.0, 14.0
"""Maximum distance in mm between the fitted and the closing's surface, towards the lung and towards the wall."""
MAX_BEHIND = 0.15
"""Maximum share of the lung near the wall that the fitted surface may cut off."""
NARROW_MM, DARK_HU, LUNG_MM3 = 1.5, -945.0, 2000.0
"""Limits for lung among the air of a box: half width in mm, least median density in HU, least volume in mm3."""
MIN_POINTS = 60
SHALLOW_MM = 3.0
"""Maximum depth in mm below the closing's surface at which a voxel can still belong to a nodule."""
DEEP_SEED_MM = 10.0
"""Maximum depth in mm below a wide closing's surface at which a voxel can still belong to a mass."""
ROUNDS = 4
MIN_BULGE_MM = 2.0
"""Minimum depth in mm to which a closing enters a nodule if its surface is only a chord of the contact."""
FIT_OFF = 0.04
"""Minimum uncertainty of the fitted surface at the middle of a contact, as a share of the contact's radius.

The share of lung that the surface cuts off is added, because a large share shows that the real surface is curved.
"""


@dataclass(frozen=True, slots=True)
class WallCut:
    """Chest wall, mediastinum or diaphragm beside a nodule, and the part of the tissue on the lung's side."""

    inside: Mask
    wall: Mask | None
    """(nz, ny, nx) mask of the wall; None if no wall is near."""
    off_mm: float = 0.0
    """Uncertainty in mm of the surface behind the nodule, which grows with the width of the contact."""
    is_chord: bool = False
    """Whether the surface behind the nodule is a flat chord of the contact instead of a continued lung surface."""


class LungSide:
    """Lung, tissue and chest wall of a box; they are the same for every boundary of the nodule.

    Parameters
    ----------
    box
        Box of the CT.
    smooth
        (nz, ny, nx) smoothed values of the box, HU.
    seed
        Index (z, y, x) of a voxel in the nodule.
    """

    def __init__(self, box: Box, smooth: NDArray[np.float32], seed: tuple[int, ...]) -> None:
        self.box, self.seed = box, seed
        self.dense: Mask = smooth > WALL_HU
        self._walls: dict[float, Mask] = {}

    @functools.cached_property
    def has_wall(self) -> bool:
        """Whether the examined box contains tissue wider than a vessel at its faces, such as the chest wall."""
        return bool(from_faces(ball_distance(self.dense, self.box.step_mm, VESSEL_MM) > VESSEL_MM).any())

    @functools.cached_property
    def air(self) -> _LungAir:
        """Air of the box that is lung."""
        return _LungAir(self.box, ~self.dense, self.seed)

    def wall(self, closing_mm: float) -> Mask:
        """Return the wall as the tissue outside a closing of the lung; a wide closing uses only the nearest lung."""
        if closing_mm not in self._walls:
            self._walls[closing_mm] = _outside_closing(self.lung(closing_mm), closing_mm, self.box.step_mm)
        return self._walls[closing_mm]

    def lung(self, closing_mm: float) -> Mask:
        """Return the mask of the lung that a closing with the given radius in mm uses."""
        nearest = self.air.nearest
        return self.air.lungs if closing_mm == CLOSING_MM or nearest is None else nearest


def cut_at_wall(side: LungSide, whole: Mask) -> WallCut:
    """Return the wall near a nodule, and the part of ``whole`` on the lung's side of the wall.

    The wall's surface is a paraboloid fitted to the lung's boundary round the nodule, without the nodule itself.

    Parameters
    ----------
    side
        Lung, tissue and wall of the box.
    whole
        (nz, ny, nx) mask of the dense voxels connected to the nodule.
    """
    box, seed, step = side.box, side.seed, side.box.step_mm
    if not side.has_wall:
        return WallCut(whole, None)
    wall = side.wall(CLOSING_MM)
    if not wall.any():
        return WallCut(whole, None)
    if ball_distance(wall, step, SHALLOW_MM)[seed] <= SHALLOW_MM:
        best = _fitted(side, whole, CLOSING_MM)
        if not best.is_chord:
            return best
    else:
        best = WallCut(whole & ~wall, wall)
    half_mm = 0.5 * (box.hu_zyx.shape[0] - 1) * step
    for closing_mm in WIDE_CLOSINGS_MM:
        if closing_mm > CLOSING_SHARE * half_mm or side.air.nearest is None:
            break
        wall = side.wall(closing_mm)
        if not wall.any() or ball_distance(wall, step, DEEP_SEED_MM)[seed] > DEEP_SEED_MM:
            continue
        found = _fitted(side, whole, closing_mm)
        if not found.is_chord:
            return found
        if not best.is_chord:
            best = found
    return best


def _fitted(side: LungSide, whole: Mask, closing_mm: float) -> WallCut:
    """Return the cut at a paraboloid that continues the lung's surface behind a nodule.

    Parameters
    ----------
    side, whole
        As for `cut_at_wall`.
    closing_mm
        Radius of the closing of the lung from which the fit begins.
    """
    box, seed = side.box, side.seed
    dense, lung, wall = side.dense, side.lung(closing_mm), side.wall(closing_mm)
    step = box.step_mm
    inside = whole & ~wall
    start = seed
    if wall[seed] and inside.any():
        # A closing bulges into a mass; the fitted surface decides whether the place is in the mass or in the wall.
        z, y, x = np.unravel_index(int(np.where(inside, box.steps_from(seed), np.inf).argmin()), wall.shape)
        start = (int(z), int(y), int(x))
    middle = _middle(inside, start, step)
    from_wall = ball_distance(~wall, step, max(2.0 * RING_MM, LUNGWARD_MM))
    nearest_mm = float(from_wall[middle])
    if nearest_mm > 2.0 * RING_MM:
        return WallCut(inside, wall)
    off = box.steps_from(middle) * step
    reach_mm = _reach_mm(inside, from_wall, off, middle, step)
    contact_mm = float(np.sqrt(max(reach_mm**2 - nearest_mm**2, 0.0)))
    ring_mm = nearest_mm + RING_MM
    if closing_mm > CLOSING_MM:
        ring_mm = max(ring_mm, min(reach_mm + BEYOND_MM, WIDEST_MM))
    # The part of the lung's surface that the closing did not change.
    ring = np.argwhere(dense & (from_wall <= 1.5 * step) & beside(lung) & (off <= ring_mm)).astype(float)
    beyond = None
    if len(ring) >= MIN_POINTS:
        beyond = _surface_side(ring, np.argwhere(lung & (off <= ring_mm)).mean(axis=0), box.hu_zyx.shape)
    # The paraboloid holds only as far as the points that it was fitted to.
    here = (off <= ring_mm) & (from_wall <= LUNGWARD_MM) & (ball_distance(wall, step, DEEPEST_MM) <= DEEPEST_MM)
    beside_wall = lung & here
    behind = 1.0 if beyond is None else float((beside_wall & (beyond > 1.0)).sum()) / max(float(beside_wall.sum()), 1.0)
    # The lung's surface may be bent too much for a paraboloid, as in the costophrenic angle.
    if beyond is None or behind > MAX_BEHIND:
        bulge_mm = closing_mm - float(np.sqrt(closing_mm**2 - min(contact_mm, 0.9 * closing_mm) ** 2))
        return WallCut(inside, wall, off_mm=bulge_mm, is_chord=bulge_mm > MIN_BULGE_MM)
    fitted = np.where(here, beyond > 0.0, wall)
    return WallCut(whole & ~fitted, fitted, off_mm=(FIT_OFF + behind) * min(contact_mm, WIDEST_MM))


def _outside_closing(lung: Mask, closing_mm: float, step: float) -> Mask:
    """Return the tissue outside the morphological closing of the lung that is connected to the faces of the box.

    The closing fills thin or narrow dense structures in the lung, and hollows of its surface.
    """
    filled = ball_distance(~lung, step, closing_mm) <= closing_mm
    closed = ball_distance(filled, step, closing_mm) > closing_mm - 0.5 * step
    return from_faces(~(closed | lung))


class _LungAir:
    """Air of a box that is lung.

    Parameters
    ----------
    box
        Box of the CT.
    air
        (nz, ny, nx) mask of all voxels that are not tissue.
    seed
        Index (z, y, x) of a voxel in the nodule.
    """

    def __init__(self, box: Box, air: Mask, seed: tuple[int, ...]) -> None:
        # Thin connections, as between the bronchi and the lung, do not count.
        cores = ball_distance(air, box.step_mm, NARROW_MM) > NARROW_MM
        labels = parts_by_size(cores)
        off = box.steps_from(seed)
        back_mm = NARROW_MM + 0.5 * box.step_mm
        self.nearest: Mask | None = None
        """Lung next to the seed without the other lung, because a closing of both would fill the mediastinum."""
        self.lungs = air
        """Both lungs: the air without the trachea and the air round the body."""
        least, dark = np.inf, np.zeros_like(air)
        least_dark = np.inf
        for number in range(1, int(labels.max()) + 1):
            part = labels == number
            if float(part.sum()) * box.step_mm**3 < LUNG_MM3:
                break
            away = float(off[part].min())
            if float(np.median(box.hu_zyx[part])) < DARK_HU:
                dark |= part
                least_dark = min(least_dark, away)
            elif away < least:
                least = away
                self.nearest = air & (distance_from(part, box.step_mm, back_mm) <= back_mm)
        if least < least_dark:
            self.lungs = air & ~(distance_from(dark, box.step_mm, back_mm) <= back_mm)


def _reach_mm(
    part: Mask, from_wall: NDArray[np.float32], off: NDArray[np.float64], middle: tuple[int, ...], step: float
) -> float:
    """Return the distance in mm from the middle of a mass to the edge of its contact with the wall."""
    contact = part & (from_wall <= 1.5 * step)
    if not part[middle] or not contact.any():
        return 0.0
    contact &= component_at(part, middle)
    return float(np.percentile(off[contact], 95.0)) if contact.any() else 0.0


def _surface_side(
    ring: NDArray[np.float64], lung: NDArray[np.float64], shape: tuple[int, ...]
) -> NDArray[np.float64] | None:
    """Return the signed distance of each voxel to the paraboloid through the ring; below 0 on the lung's side.

    The distance is measured along the normal, in voxels.
    """
    centre = ring.mean(axis=0)
    _, _, axes = np.linalg.svd(ring - centre, full_matrices=False)
    normal = axes[2] if (centre - lung) @ axes[2] >= 0.0 else -axes[2]
    u, v = axes[0], axes[1]
    rel = ring - centre
    a, b, w = rel @ u, rel @ v, rel @ normal
    # The centres of wall voxels lie half a voxel beyond the surface.
    w = w - 0.5
    keep = np.ones(len(ring), dtype=bool)
    fit = np.zeros(6)
    terms = np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], axis=1)
    for _ in range(ROUNDS):
        if keep.sum() < MIN_POINTS:
            return None
        fit, *_ = np.linalg.lstsq(terms[keep], w[keep], rcond=None)
        miss = w - terms @ fit
        spread = max(1.4826 * float(np.median(np.abs(miss[keep]))), 0.4)
        keep = np.abs(miss) <= 2.5 * spread
    z, y, x = (np.arange(n, dtype=float)[s] - c for n, c, s in zip(shape, centre, _SLOTS, strict=True))
    au = z * u[0] + y * u[1] + x * u[2]
    av = z * v[0] + y * v[1] + x * v[2]
    aw = z * normal[0] + y * normal[1] + x * normal[2]
    bowl = fit[0] + fit[1] * au + fit[2] * av + fit[3] * au**2 + fit[4] * au * av + fit[5] * av**2
    side: NDArray[np.float64] = aw - bowl
    return side


_SLOTS = ((slice(None), None, None), (None, slice(None), None), (None, None, slice(None)))


def _middle(mask: Mask, seed: tuple[int, ...], step_mm: float) -> tuple[int, ...]:
    if not mask[seed]:
        return seed
    return uphill(ball_distance(component_at(mask, seed), step_mm), seed)
