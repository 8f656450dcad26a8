"""Segmentation of the tissue round a target: vessels, and tissue too thick to be a vessel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.errors import NoResultError
from carina.plan.cubic_box import Box, lung_median_hu, smoothed
from carina.plan.lungs.fissures import FissureBox
from carina.plan.lungs.vessels import RISE_HU as LINE_RISE_HU
from carina.plan.lungs.vessels import VesselTree, grow_tree, thin_vessels
from carina.plan.targets.grow_nodule import Nodule
from carina.scopes import WallField
from carina.volume import Volume
from carina.volume.mask_distances import ball_distance
from carina.volume.mask_parts import parts_by_size
from carina.volume.resampling import resampled

Mask = NDArray[np.bool_]

SMOOTH_MM = 0.7
RISE_HU = 250.0
"""Rise in HU above the density of lung from which a voxel counts as tissue; a vessel 1 mm wide rises more despite
blur."""
WALL_MM = 1.5
"""Distance in mm from a lumen within which dense tissue counts as the airway's wall and not as a vessel."""
LINE_WALL_MM = 1.0
"""Minimum distance in mm from a lumen of a line-shaped vessel; plates may be wall up to `WALL_MM`."""
BLUR_MM = 1.5
"""Distance in mm from the nodule within which tissue is the nodule's blurred edge."""
THICKEST_VESSEL_MM = 14.0
"""Maximum diameter in mm of a vessel; thicker tissue is mediastinum, chest wall or diaphragm."""
MIN_MM3 = 12.0
"""Minimum volume in mm3 of a connected piece of tissue; smaller pieces are noise."""
SLAB = 48
"""Number of slices for which wall distances are computed between two checks for cancellation."""

OnProgress = Callable[[float], None]


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class NearbyTissue:
    """Tissue in a box round a target; arteries and veins are not distinguished.

    Vessels thinner than about 0.7 mm are not found, and those of the mediastinum are not visible without contrast.
    """

    box: Box
    lung_hu: float
    vessel: Mask
    thick: Mask
    """Mask of tissue too thick for a vessel: mediastinum, chest wall, diaphragm, or a consolidation."""
    vessel_mm: NDArray[np.float32]
    """Distance in mm of each voxel to the nearest vessel; infinite if there is none."""
    thick_mm: NDArray[np.float32]
    sure: NDArray[np.float32]
    """Confidence that a voxel of ``vessel`` is a vessel, 0.5 to 1; 0 elsewhere.

    The confidence is 1 for vessels above the threshold of density.
    """

    fissure: FissureBox | None = None
    """Visible fissures of the whole lungs; None if they were not searched."""

    def vessel_tree(self) -> VesselTree:
        """Compute the vessels as lines with radii; the result is not cached."""
        return grow_tree(self.box, self.vessel, self.sure)

    def read(self, of: NDArray[Any], points_lps: NDArray[np.float64]) -> NDArray[Any]:
        """Return the values of an array of this box at the voxels nearest to points, (n,); undefined outside.

        Parameters
        ----------
        of
            (nz, ny, nx) array of the box.
        points_lps
            (n, 3) LPS mm.
        """
        found: NDArray[Any] = of[tuple(np.clip(self._ijk(points_lps), 0, np.array(of.shape[::-1]) - 1).T[::-1])]
        return found

    def holds(self, points_lps: NDArray[np.float64]) -> Mask:
        """Return for each point whether it is inside both the box and the CT, (n,)."""
        ijk = self._ijk(points_lps)
        inside = ((ijk >= 0) & (ijk < np.array(self.vessel.shape[::-1]))).all(axis=1)
        found: Mask = inside & self.read(self.box.known, points_lps)
        return found

    def _ijk(self, points_lps: NDArray[np.float64]) -> NDArray[np.intp]:
        return np.rint((points_lps - self.box.lps_from_ijk[:3, 3]) / self.box.step_mm).astype(np.intp)

    @property
    def vessels_ml(self) -> float:
        """Volume of the vessels in the box, ml."""
        return float(self.vessel.sum()) * self.box.step_mm**3 / 1000.0


def surroundings(
    volume: Volume,
    centre_lps: NDArray[np.float64],
    half_mm: float,
    nodule: Nodule | None,
    wall: WallField,
    *,
    fissure: FissureBox | None = None,
) -> NearbyTissue:
    """Segment the tissue in a box round a point, without the nodule and the airways' own walls.

    Parameters
    ----------
    volume
        The CT.
    centre_lps, half_mm
        (3,) centre of the box, LPS mm, and half its side length.
    nodule
        Nodule that is excluded, or None.
    wall
        Wall of the airways.
    fissure
        Visible fissures (`carina.plan.lobes`), stored in the result.
    """
    return replace(_seen(Box.around(volume, centre_lps, half_mm), nodule, wall), fissure=fissure)


@shows_progress
def lung_surroundings(
    volume: Volume, wall: WallField, *, box: Box | None = None, progress: ProgressChoice = None
) -> NearbyTissue:
    """Segment the tissue of both lungs at 1 mm, for the display of vessels, not for the planning of needles.

    Vessels thinner than about 1 mm are incomplete.

    Parameters
    ----------
    volume, wall
        The CT and the wall of its airways.
    box
        `lung_box` of the CT; computed if None.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown. The function may raise CancelledError to stop
        the calculation.

    Raises
    ------
    NoResultError
        If there is no lung in the CT (code ``plan.no_lung``).
    """
    on_progress = fraction_callback(progress_function(progress), "looking for vessels")
    return _seen(lung_box(volume) if box is None else box, None, wall, on_progress or _ignore_progress)


def lung_box(volume: Volume) -> Box:
    """Return both lungs at 1 mm along LPS; only voxels of the lungs, with their vessels and airways, are ``known``.

    Raises
    ------
    NoResultError
        If there is no lung in the CT (code ``plan.no_lung``).
    """
    corners = volume.to_lps(
        np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * (np.array(volume.shape_zyx[::-1]) - 1.0)
    )
    whole_low, whole_high = corners.min(axis=0), corners.max(axis=0)
    inside = _lung(_cut(volume, whole_low, whole_high, 4.0, -1024.0))
    if not inside.any():
        raise NoResultError("the lungs: no lung was found in this CT; it is needed round a target", code="plan.no_lung")
    at = np.argwhere(inside)[:, ::-1] * 4.0 + whole_low
    low, high = np.maximum(at.min(axis=0) - 5.0, whole_low), np.minimum(at.max(axis=0) + 5.0, whole_high)
    values = _cut(volume, low, high, 1.0, OUTSIDE_HU)
    matrix = np.eye(4)
    matrix[:3, 3] = low
    in_ct = values > OUTSIDE_HU + 1.0
    # A morphological closing adds the vessels and airways to the lungs.
    closed = ball_distance(ball_distance(~np.pad(inside, 6), 4.0) < CLOSED_MM, 4.0)[6:-6, 6:-6, 6:-6] >= CLOSED_MM - 2.0
    start = (low - whole_low) / 4.0
    for axis, num in enumerate(values.shape):
        places = np.rint(start[2 - axis] + 0.25 * np.arange(num)).astype(np.intp)
        closed = closed.take(np.clip(places, 0, closed.shape[axis] - 1), axis=axis)
    return Box(np.where(in_ct, values, np.float32(-1024.0)), in_ct & closed, 1.0, matrix)


OUTSIDE_HU = -4096.0
AIR_HU, SIDE_AIR_HU = -980.0, -950.0
"""Median densities in HU below which a dark region is gas or air outside the body.

The second density applies to regions at the sides of the body.
"""
CLOSED_MM = 12.0
"""Radius in mm of the morphological closing that adds vessels and airways to the lungs."""


def _cut(
    volume: Volume, low: NDArray[np.float64], high: NDArray[np.float64], step_mm: float, outside_hu: float
) -> NDArray[np.float32]:
    """Return the values between two corners in LPS mm, on cubic voxels along the axes of LPS."""
    nx, ny, nz = (int(n) for n in np.floor((high - low) / step_mm) + 1)
    matrix = np.diag([step_mm, step_mm, step_mm, 1.0])
    matrix[:3, 3] = low
    return resampled(volume, matrix, (nz, ny, nx), outside=outside_hu)


def _lung(coarse: NDArray[np.float32]) -> Mask:
    """Return the mask of the lungs: large dark regions other than gas and air outside the body."""
    labels = parts_by_size(coarse < -500.0)
    sides = np.unique(np.concatenate([labels[:, 0], labels[:, -1], labels[:, :, 0].T, labels[:, :, -1].T], axis=None))
    sizes = np.bincount(labels.reshape(-1))
    found = np.zeros(labels.shape, dtype=bool)
    for n in np.flatnonzero(sizes * 64.0 / 1000.0 > 100.0):
        if n == 0:
            continue
        piece = labels == n
        if float(np.median(coarse[piece])) > (SIDE_AIR_HU if n in sides else AIR_HU):
            found |= piece
    return found


def _ignore_progress(_fraction: float) -> None:
    """Ignore a progress report; the default for callers without a progress display."""


def _seen(box: Box, nodule: Nodule | None, wall: WallField, on_progress: OnProgress = _ignore_progress) -> NearbyTissue:
    smooth = smoothed(box.hu_zyx, SMOOTH_MM / box.step_mm)
    lung_hu = lung_median_hu(smooth)
    on_progress(0.15)
    # Distances to the wall are computed only near dense voxels, which are a small part of a lung.
    to_wall = _to_wall(
        box, wall, smooth > lung_hu + 0.5 * LINE_RISE_HU, lambda fraction: on_progress(0.15 + 0.3 * fraction)
    )
    dense = (smooth > lung_hu + RISE_HU) & (to_wall < -WALL_MM)
    clear = to_wall < -LINE_WALL_MM
    if nodule is not None:
        away = ball_distance(~_inside(nodule, box), box.step_mm, BLUR_MM) > BLUR_MM
        dense &= away
        clear &= away
    half = 0.5 * THICKEST_VESSEL_MM
    core = ball_distance(dense, box.step_mm, half) > half
    on_progress(0.5)
    thick = (
        dense & (ball_distance(~core, box.step_mm, half + box.step_mm) <= half + box.step_mm)
        if core.any()
        else np.zeros_like(dense)
    )
    wide = _large_pieces(dense & ~thick & box.known, MIN_MM3 / box.step_mm**3)
    on_progress(0.6)
    thin, sure = thin_vessels(
        box, lung_hu, clear & ~thick, on_progress=lambda fraction: on_progress(0.6 + 0.2 * fraction)
    )
    sure[wide] = 1.0
    vessel = wide | thin
    on_progress(0.8)
    vessel_mm = _distance(vessel, box.step_mm)
    on_progress(0.9)
    return NearbyTissue(box, lung_hu, vessel, thick, vessel_mm, _distance(thick, box.step_mm), sure)


def _inside(nodule: Nodule, box: Box) -> Mask:
    """Return the voxels of a box whose centres are in a nodule; only those near its mask are tested."""
    size = np.array(nodule.inside_zyx.shape[::-1], dtype=np.float64)
    ends = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)]) * (size + 1.0) - 1.0
    corners = ends @ nodule.lps_from_ijk[:3, :3].T + nodule.lps_from_ijk[:3, 3]
    shape = np.array(box.hu_zyx.shape[::-1])
    places = (corners - box.lps_from_ijk[:3, 3]) / box.step_mm
    low = np.clip(np.floor(places.min(axis=0)), 0, shape).astype(int)
    high = np.clip(np.ceil(places.max(axis=0)) + 1, 0, shape).astype(int)
    near = np.zeros(box.hu_zyx.shape, dtype=bool)
    near[low[2] : high[2], low[1] : high[1], low[0] : high[0]] = True
    found = np.zeros(near.shape, dtype=bool)
    found[near] = nodule.contains(_centres(box, near))
    return found


def _distance(mask: Mask, step_mm: float) -> NDArray[np.float32]:
    if not mask.any():
        return np.full(mask.shape, np.inf, dtype=np.float32)
    return ball_distance(~mask, step_mm)


def _to_wall(box: Box, wall: WallField, where: Mask, on_progress: OnProgress) -> NDArray[np.float32]:
    """Return the signed distance in mm of the selected voxels to the airways' wall, above 0 in a lumen."""
    found = np.full(where.shape, -np.inf, dtype=np.float32)
    num = len(where)
    for first in range(0, num, SLAB):
        on_progress(first / num)
        part = slice(first, first + SLAB)
        found[part][where[part]] = wall.distance_mm(_centres(box, where[part], first))
    return found


def _centres(box: Box, where: Mask, first: int = 0) -> NDArray[np.float64]:
    """Return the centres (n, 3), LPS mm, of the voxels of a mask; ``first`` is the mask's first slice in the box."""
    k, j, i = np.nonzero(where)
    return np.stack([i, j, k + first], axis=1) * box.step_mm + box.lps_from_ijk[:3, 3]


def _large_pieces(mask: Mask, least_voxels: float) -> Mask:
    found: Mask = parts_by_size(mask, corners=True, least_voxels=max(int(least_voxels), 1)) != 0
    return found
