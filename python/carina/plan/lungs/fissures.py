"""Detection of the fissures between lobes: thin bright plates near the lobe borders that the airways suggest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.plan.cubic_box import Box, beside, lung_median_hu, smoothed
from carina.plan.lungs.vessels import eigenvalues, second_differences
from carina.volume.mask_distances import ball_distance
from carina.volume.mask_parts import numbered_parts, parts_by_size

Mask = NDArray[np.bool_]
Values = NDArray[np.float32]

SIGMA_MM = 1.2
MIN_HU = 30.0
"""Curvature in HU (second derivative times sigma squared) across a plate below which it is not a fissure."""
TIMES_NOISE = 7.0
"""Minimum curvature of the values across a plate (fissure), as a multiple of the curvature that noise causes."""
EVEN = 0.5
"""Maximum curvature along a plate, as a share of the curvature across it; a line or a ball has a larger share."""
MIN_MM2 = 600.0
"""Minimum area in mm2 of a connected piece of a fissure; smaller pieces may be texture of the lung."""
FROM_BORDER_MM = 30.0
"""Maximum distance in mm of a fissure from the estimated lobe border; a plate farther away is scar or pleura."""
FROM_EDGE_MM = 3.0
"""Minimum distance in mm of a fissure from the chest wall, whose pleura looks like a plate too."""
FAINT = 0.5
"""Minimum curvature of voxels that are connected to a fissure, as a share of the minimum for a fissure alone."""
SLAB = 48


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class FissureBox:
    """Visible fissures on a grid of 1 mm along LPS; a fissure that is not visible may exist, or the lobes are fused."""

    mask: Mask
    """(nz, ny, nx) mask of the visible fissures, plates about 2 mm thick."""
    box: Box

    def crossed(self, points_lps: NDArray[np.float64]) -> Mask:
        """Return for each of (n, 3) points, LPS mm, whether the point is in a visible fissure, (n,)."""
        ijk = np.rint((points_lps - self.box.lps_from_ijk[:3, 3]) / self.box.step_mm).astype(np.intp)
        top = np.array(self.mask.shape[::-1])
        inside = ((ijk >= 0) & (ijk < top)).all(axis=1)
        found: Mask = inside & self.mask[tuple(np.clip(ijk, 0, top - 1).T[::-1])]
        return found

    def on_grid(self, shape: tuple[int, ...], lps_from_ijk: NDArray[np.float64], step_mm: float) -> Mask:
        """Return the mask on a coarser grid; a coarse voxel is true if it contains a voxel of a fissure.

        Parameters
        ----------
        shape, lps_from_ijk
            Shape (nz, ny, nx) and (4, 4) transform of the coarser grid.
        step_mm
            Voxel size of the coarser grid.
        """
        ijk = np.argwhere(self.mask)[:, ::-1] * self.box.step_mm + self.box.lps_from_ijk[:3, 3]
        at = np.rint((ijk - lps_from_ijk[:3, 3]) / step_mm).astype(np.intp)[:, ::-1]
        at = at[((at >= 0) & (at < np.array(shape))).all(axis=1)]
        found = np.zeros(shape, dtype=bool)
        found[tuple(at.T)] = True
        return found


def fissures(
    box: Box,
    label_zyx: NDArray[np.uint8],
    border_mm: Values,
    lps_from_ijk: NDArray[np.float64],
    *,
    on_progress: Callable[[float], None] | None = None,
) -> FissureBox:
    """Find the fissures: plates in the lungs near the borders of the lobes.

    Parameters
    ----------
    box
        Both lungs at 1 mm.
    label_zyx, border_mm, lps_from_ijk
        Labels of the lobes by the airways alone, distances to the lobe borders, and the transform of their grid
        (`carina.plan.lobes`).
    on_progress
        Receives the completed fraction; it may raise CancelledError.
    """

    def report(fraction: float) -> None:
        if on_progress is not None:
            on_progress(fraction)

    near = _near_border(box, label_zyx, border_mm, lps_from_ijk)
    lung_hu = lung_median_hu(box.hu_zyx[::2, ::2, ::2])
    soft = smoothed(box.hu_zyx, SIGMA_MM / box.step_mm)
    report(0.5)
    # Bright voxels are vessels and their blur; they are excluded, because a fissure is never as bright.
    bright = ball_distance(~(box.hu_zyx > lung_hu + 450.0), box.step_mm)
    where = near & box.known & (bright > 1.5) & (soft < lung_hu + 300.0)
    report(0.8)
    strength, noise = _plate_strength(soft, where, SIGMA_MM / box.step_mm)
    least = max(MIN_HU, TIMES_NOISE * noise)
    sheets = _large_sheets(strength > least, box.step_mm)
    return FissureBox(_with_faint_parts(sheets, strength > FAINT * least), box)


def _near_border(box: Box, label_zyx: NDArray[np.uint8], border_mm: Values, lps_from_ijk: NDArray[np.float64]) -> Mask:
    step = float(lps_from_ijk[0, 0])
    depth = ball_distance(label_zyx > 0, step)
    good = (label_zyx > 0) & (border_mm < FROM_BORDER_MM) & (depth > FROM_EDGE_MM)
    every = []
    for axis, num in enumerate(box.hu_zyx.shape):
        start = (box.lps_from_ijk[2 - axis, 3] - lps_from_ijk[2 - axis, 3]) / step
        places = np.rint(start + box.step_mm / step * np.arange(num)).astype(np.intp)
        every.append(np.clip(places, 0, label_zyx.shape[axis] - 1))
    found: Mask = good[np.ix_(*every)]
    return found


def _plate_strength(soft: Values, where: Mask, sigma_vox: float) -> tuple[Values, float]:
    """Return, per voxel, the curvature across plates minus the curvature along them, and the noise's spread of it."""
    found = np.zeros(soft.shape, dtype=np.float32)
    num = soft.shape[0]
    noise = []
    for first in range(0, num, SLAB):
        last = min(first + SLAB, num)
        part = slice(first, last)
        wide = soft[max(first - 1, 0) : min(last + 1, num)]
        pad = (int(first == 0), int(last == num))
        second = second_differences(np.pad(wide, (pad, (1, 1), (1, 1)), mode="edge"))
        least, middle, most = eigenvalues([one[where[part]] for one in second])
        side = np.maximum(np.abs(middle), np.abs(most))
        across = np.where(side <= EVEN * np.abs(least), -least - side, 0.0)
        found[part][where[part]] = sigma_vox**2 * np.maximum(across, 0.0)
        noise.append(sigma_vox**2 * middle[::31])
    spread = np.concatenate(noise)
    if spread.size < 200:
        return found, MIN_HU / TIMES_NOISE
    return found, 1.4826 * float(np.median(np.abs(spread - np.median(spread))))


def _large_sheets(mask: Mask, step_mm: float) -> Mask:
    """Return the pieces of a mask of plates whose area is at least `MIN_MM2`.

    A gap of one voxel does not divide a piece.
    """
    labels = parts_by_size(mask | beside(mask), corners=True, least_voxels=int(3.0 * MIN_MM2 / step_mm**2))
    found: Mask = mask & (labels > 0)
    return found


def _with_faint_parts(sheets: Mask, faint: Mask) -> Mask:
    labels = numbered_parts(faint, corners=True)
    keep = np.zeros(int(labels.max()) + 1, dtype=bool)
    keep[np.unique(labels[sheets])] = True
    keep[0] = False
    found: Mask = keep[labels]
    return found
