"""Location of a target: lung, pleura, airway, mediastinum or chest wall, or outside the body."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carina.plan.cubic_box import Box, smoothed
from carina.plan.targets.boundary import SMOOTH_MM
from carina.plan.targets.nodule import Nodule
from carina.scopes import WallField
from carina.volume import Volume, canonical_geometry
from carina.volume.digest import canonical_axes
from carina.volume.mask_distances import ball_distance

Whereabouts = Literal["lung", "beside pleura", "mediastinum or chest wall", "in an airway", "outside the body"]

WHERE_WORDS: dict[Whereabouts, str] = {
    "lung": "in the lung",
    "beside pleura": "beside the pleura",
    "mediastinum or chest wall": "in the mediastinum or the chest wall",
    "in an airway": "in an airway",
    "outside the body": "outside the body",
}

TISSUE_HU, OUTER_AIR_HU = -300.0, -940.0
"""Minimum density in HU of tissue, and maximum density in HU of the air outside the body.

At least 90 % of the voxels of a region must be darker than the second value for the region to be outside the body. Lung
is brighter, also at full inspiration (about -860 HU) and with most emphysema.
"""
WALL_HU = -400.0
THICK_MM = 3.5
"""Radius in mm of the opening that removes vessels from tissue; chest wall, mediastinum and diaphragm remain."""
MARGIN_MM = 12.0
"""Distance in mm from a target's edge up to which the tissue determines the region (lung, pleura, mediastinum)."""
SHELL_MM = (2.0, 4.0)
"""Range of distances in mm of the shell round a target; the blur of the target's edge ends before the shell."""
BURIED, BESIDE = 0.6, 0.06
"""Minimum shares of thick tissue round a target that is in the mediastinum, and round one beside the pleura.

The shares are measured in the shell of `SHELL_MM`.
"""
IN_LUMEN = 0.3
"""Minimum share of lumen among the voxels within 2 mm of the boundary for a target in an airway."""


def whereabouts(volume: Volume, nodule: Nodule, *, wall: WallField | None = None) -> Whereabouts:
    """Return the location of a target.

    Parameters
    ----------
    volume, nodule
        The CT and the target. *Pleura* includes mediastinum and diaphragm, which a CT without contrast does not
        distinguish.
    wall
        Wall of the airways; without it a target in an airway is not recognised.
    """
    step = float(np.linalg.norm(nodule.lps_from_ijk[:3, 0]))
    pad = int(np.ceil(MARGIN_MM / step))
    inside = np.pad(nodule.inside_zyx, pad)
    matrix = nodule.lps_from_ijk.copy()
    matrix[:3, 3] -= matrix[:3, :3] @ np.full(3, float(pad))
    if is_outside_body(volume, np.array(nodule.middle_lps), radius_mm=0.5 * nodule.long_mm + 2.0):
        return "outside the body"
    away = ball_distance(~inside, step)
    if wall is not None:
        near = np.argwhere((away <= SHELL_MM[0]) & (ball_distance(inside, step, SHELL_MM[0]) <= SHELL_MM[0]))
        to_wall = wall.distance_mm(near[:, ::-1] @ matrix[:3, :3].T + matrix[:3, 3])
        if float((to_wall > 0.0).mean()) >= IN_LUMEN:
            return "in an airway"
    box = Box.at(volume, matrix, inside.shape)
    dense = (smoothed(box.hu_zyx, SMOOTH_MM / step) > WALL_HU) & ~inside & box.known
    core = ball_distance(dense, step, THICK_MM) > THICK_MM
    thick = (
        dense & (ball_distance(~core, step, THICK_MM + step) <= THICK_MM + step) if core.any() else np.zeros_like(dense)
    )
    shell = (away > SHELL_MM[0]) & (away <= SHELL_MM[1]) & box.known
    share = float(thick[shell].mean()) if shell.any() else 0.0
    if share >= BURIED:
        return "mediastinum or chest wall"
    return "beside pleura" if share >= BESIDE or "pleura" in nodule.touches else "lung"


def is_outside_body(volume: Volume, point_lps: NDArray[np.float64], *, radius_mm: float = 2.0) -> bool:
    """Return whether at least two of the four directions from a point in its axial slice contain only outer air.

    In a CT cropped to a part of the chest the rows end in lung, and the result is False.

    Parameters
    ----------
    volume
        The CT.
    point_lps
        (3,) LPS mm.
    radius_mm
        Distance from the point that is ignored, because the object itself is there.
    """
    axes = canonical_axes(volume.lps_from_ijk)
    geometry = canonical_geometry(volume)
    values = axes.view(volume.hu_zyx)
    to_ijk = np.linalg.inv(geometry.lps_from_ijk)
    top = np.array(values.shape[::-1]) - 1
    i, j, k = np.clip(np.rint(to_ijk[:3, :3] @ point_lps + to_ijk[:3, 3]).astype(int), 0, top)
    skip_i, skip_j, _ = (int(np.ceil(radius_mm / s)) for s in np.linalg.norm(geometry.lps_from_ijk[:3, :3], axis=0))
    row, column = values[k, j], values[k, :, i]
    sides = (row[: max(i - skip_i, 0)], row[i + 1 + skip_i :], column[: max(j - skip_j, 0)], column[j + 1 + skip_j :])
    return sum(_is_outer_air(side) for side in sides) >= 2


def _is_outer_air(side: NDArray[np.int16]) -> bool:
    return side.size > 0 and not (side > TISSUE_HU).any() and float(np.percentile(side, 90.0)) < OUTER_AIR_HU
