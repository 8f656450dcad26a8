"""Surface of the chest wall, mediastinum or diaphragm beside a nodule, as it would be without the nodule."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.plan.cubic_box import Box, ball_distance, beside, component_at, from_faces, uphill

__all__ = ["SHALLOW_MM", "cut_at_wall"]

Mask = NDArray[np.bool_]

WALL_HU = -400.0
VESSEL_MM = 3.5
"""Radius in mm of the opening that separates vessels from wall.

The opening removes vessels. A remaining part that reaches the faces of the box is wall.
"""
CLOSING_MM = 14.0
"""Radius in mm of the closing of the lung; narrower hollows of the lung's surface (nodules, hila) are filled."""
RING_MM = 16.0
LEAST_POINTS = 60
SHALLOW_MM = 3.0
"""Largest depth in mm inside the first estimate of the wall at which a voxel can still belong to a nodule."""
ROUNDS = 4


def cut_at_wall(box: Box, smooth: NDArray[np.float32], whole: Mask, seed: tuple[int, ...]) -> tuple[Mask, Mask | None]:
    """Return the part of ``whole`` on the lung's side of the wall, and the wall; None if no wall is near.

    The wall's surface is a paraboloid fitted to the lung's boundary round the nodule, without the nodule itself.

    Parameters
    ----------
    box
        Box of the CT.
    smooth
        (nz, ny, nx) smoothed values of the box, HU.
    whole
        (nz, ny, nx) mask of the dense voxels connected to the nodule.
    seed
        Index (z, y, x) of a voxel in the nodule.
    """
    step = box.step_mm
    dense = smooth > WALL_HU
    deep = ball_distance(dense, step) > VESSEL_MM
    wall_core = from_faces(deep)
    if not wall_core.any():
        return whole, None
    # A morphological closing of the lung fills thin or narrow dense structures in the lung.
    lung = ~dense
    filled = ball_distance(~lung, step) <= CLOSING_MM
    closed = ball_distance(filled, step) > CLOSING_MM - 0.5 * step
    closed |= lung
    wall = ~closed
    wall = from_faces(wall)
    if not wall.any():
        return whole, None
    if ball_distance(wall, step)[seed] > SHALLOW_MM:
        return whole & ~wall, wall
    middle = _middle(whole & ~wall, seed, step)
    nearest = ball_distance(~wall, step)[middle]
    if nearest > 2.0 * RING_MM:
        return whole & ~wall, wall
    # The part of the lung's surface that the closing did not change.
    near_wall = ball_distance(~wall, step) <= 1.5 * step
    edge = np.argwhere(dense & near_wall & beside(lung)).astype(float)
    if len(edge) < LEAST_POINTS:
        return whole & ~wall, wall
    here = np.array(middle, dtype=float)
    off = np.linalg.norm(edge - here, axis=1) * step
    ring = edge[off <= nearest + RING_MM]
    if len(ring) < LEAST_POINTS:
        return whole & ~wall, wall
    near_lung = np.argwhere(lung & (box.steps_from(middle) * step <= nearest + RING_MM)).mean(axis=0)
    side = _surface_side(ring, near_lung, box.hu_zyx.shape)
    if side is None:
        return whole & ~wall, wall
    fitted = side > 0.0
    # The paraboloid holds only as far as the points that it was fitted to.
    local = box.steps_from(middle) * step <= nearest + RING_MM
    wall = np.where(local, fitted, wall)
    return whole & ~wall, wall


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
        if keep.sum() < LEAST_POINTS:
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
