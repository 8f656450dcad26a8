"""What lies round a target: vessels, and tissue too thick to be one, as far as the CT shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.box import Box, ball_distance, lung_median_hu, smoothed
from carina.plan.nodule import Nodule
from carina.scopes import WallField
from carina.volume import Volume

__all__ = ["Surroundings", "surroundings"]

Mask = NDArray[np.bool_]

SMOOTH_MM = 0.7
RISE_HU = 250.0
"""What stands out of the lung by this much is tissue: a vessel of 1 mm, blurred, still does."""
WALL_MM = 1.5
"""Tissue this near to a lumen is its wall."""
BLUR_MM = 1.5
"""Tissue this near to the nodule is its own edge."""
THICKEST_VESSEL_MM = 14.0
"""Thicker than this it is mediastinum, chest wall or diaphragm."""
LEAST_MM3 = 12.0
"""A smaller piece is noise."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Tissue in a box round a target. Arteries and veins are not told apart.

    Vessels thinner than about 1 mm are not seen, and those of the mediastinum cannot be told from it without contrast.
    """

    box: Box
    lung_hu: float
    vessel: Mask
    thick: Mask
    """Mediastinum, chest wall, diaphragm, or a consolidation."""
    vessel_mm: NDArray[np.float32]
    """Distance to the nearest vessel; infinite where there is none."""
    thick_mm: NDArray[np.float32]

    def read(self, of: NDArray[Any], points_lps: NDArray[np.float64]) -> NDArray[Any]:
        """Values of an array of the box at the nearest voxels, (n,); they mean nothing where it holds no point."""
        found: NDArray[Any] = of[tuple(np.clip(self._ijk(points_lps), 0, np.array(of.shape[::-1]) - 1).T[::-1])]
        return found

    def holds(self, points_lps: NDArray[np.float64]) -> Mask:
        """Whether points lie in the box and in the CT, (n,)."""
        ijk = self._ijk(points_lps)
        inside = ((ijk >= 0) & (ijk < np.array(self.vessel.shape[::-1]))).all(axis=1)
        found: Mask = inside & self.read(self.box.known, points_lps)
        return found

    def _ijk(self, points_lps: NDArray[np.float64]) -> NDArray[np.intp]:
        return np.rint((points_lps - self.box.lps_from_ijk[:3, 3]) / self.box.step_mm).astype(np.intp)

    @property
    def vessels_ml(self) -> float:
        """Volume of the vessels in the box."""
        return float(self.vessel.sum()) * self.box.step_mm**3 / 1000.0


def surroundings(
    volume: Volume, centre_lps: NDArray[np.float64], half_mm: float, nodule: Nodule | None, wall: WallField
) -> Surroundings:
    """The tissue in a box of ``half_mm`` round a point, without the nodule and the airways' own walls."""
    box = Box.around(volume, centre_lps, half_mm)
    smooth = smoothed(box.hu_zyx, SMOOTH_MM / box.step_mm)
    lung_hu = lung_median_hu(smooth)
    points = _centres(box)
    to_wall = wall.distance_mm(points).reshape(smooth.shape)
    dense = (smooth > lung_hu + RISE_HU) & (to_wall < -WALL_MM)
    if nodule is not None:
        inside = nodule.contains(points).reshape(smooth.shape)
        dense &= ball_distance(~inside, box.step_mm) > BLUR_MM
    half = 0.5 * THICKEST_VESSEL_MM
    core = ball_distance(dense, box.step_mm) > half
    thick = dense & (ball_distance(~core, box.step_mm) <= half + box.step_mm) if core.any() else np.zeros_like(dense)
    vessel = _large_pieces(dense & ~thick, LEAST_MM3 / box.step_mm**3)
    return Surroundings(box, lung_hu, vessel, thick, _distance(vessel, box.step_mm), _distance(thick, box.step_mm))


def _distance(mask: Mask, step_mm: float) -> NDArray[np.float32]:
    if not mask.any():
        return np.full(mask.shape, np.inf, dtype=np.float32)
    return ball_distance(~mask, step_mm)


def _centres(box: Box) -> NDArray[np.float64]:
    k, j, i = (axis.reshape(-1) for axis in np.indices(box.hu_zyx.shape))
    return np.stack([i, j, k], axis=1) * box.step_mm + box.lps_from_ijk[:3, 3]


def _large_pieces(mask: Mask, least_voxels: float) -> Mask:
    import SimpleITK as sitk  # slow to load, and most of what is public here does not need it

    pieces = sitk.ConnectedComponent(sitk.GetImageFromArray(mask.astype(np.uint8)), True)
    kept: Any = sitk.RelabelComponent(pieces, minimumObjectSize=max(int(least_voxels), 1))
    found: Mask = sitk.GetArrayFromImage(kept) != 0
    return found
