"""Segmentation of an endobronchial lesion: tissue that protrudes into the lumen of an airway."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.plan.boundary import CLICK_MM, SMOOTH_MM, TISSUE_HU
from carina.plan.box import Box, ball_distance, component_at, distance_from, smoothed, uphill
from carina.plan.mask_measures import measured_mask
from carina.plan.nodule_value import Nodule
from carina.scopes import WallField
from carina.volume import Volume

__all__ = ["endobronchial_lesion"]

HALF_MM = 26.0
AIR_HU = -1000.0
CLOSING_MM = 9.0
"""Radius in mm of the closing of the lumen; tissue that protrudes up to about this far into the lumen is a lesion."""
THINNEST_MM = 1.0
"""Radius in mm of the largest ball in a lesion; anything thinner is unevenness of the wall, or mucus."""
OWN_AIR = 0.9
"""Least share of the airway's own air in the air beside a lesion; a nodule beside an airway touches lung."""
NOTE = "it stands into an airway; where its base lies in the wall the CT does not show"
BASE_OFF_MM = 0.5
"""Additional uncertainty in mm of the boundary, because the base of the lesion is assumed at the wall.

The value is common knowledge, not measured.
"""


def endobronchial_lesion(volume: Volume, wall: WallField, point_lps: NDArray[np.float64]) -> Nodule | None:
    """Segment the tissue that protrudes into an airway within 4 mm of a point; return None if there is none.

    The lumen without the lesion is the present lumen, closed by a ball of 9 mm.

    Parameters
    ----------
    volume, wall
        The CT and the wall of its airways.
    point_lps
        (3,) LPS mm.
    """
    box = Box.around(volume, point_lps, HALF_MM)
    step = box.step_mm
    k, j, i = (axis.reshape(-1) for axis in np.indices(box.hu_zyx.shape))
    places = np.stack([i, j, k], axis=1) * step + box.lps_from_ijk[:3, 3]
    to_wall = wall.distance_mm(places).reshape(box.hu_zyx.shape)
    lumen = to_wall > 0.0
    if not lumen.any():
        return None
    smooth = smoothed(box.hu_zyx, SMOOTH_MM / step)
    tissue = (smooth > 0.5 * (AIR_HU + TISSUE_HU)) & ~lumen
    grown = lumen | (distance_from(lumen, step, CLOSING_MM) <= CLOSING_MM)
    closed = lumen | (ball_distance(grown, step) > CLOSING_MM)
    lesion = closed & tissue
    core = ball_distance(lesion, step) >= THINNEST_MM
    off = np.where(core, box.offsets_mm(point_lps), np.inf)
    z, y, x = np.unravel_index(int(box.offsets_mm(point_lps).argmin()), off.shape)
    # A click in the lumen selects a near lesion. A click in tissue selects this tissue only, so that a lymph node
    # below the carina is not taken for a lesion.
    if float(off.min()) > (CLICK_MM if lumen[z, y, x] else 2.0 * step) or not (lumen | lesion)[z, y, x]:
        return None
    z, y, x = np.unravel_index(int(off.argmin()), off.shape)
    core = component_at(core, (int(z), int(y), int(x)))
    inside = lesion & (core | (distance_from(core, step, THINNEST_MM + step) <= THINNEST_MM + 0.5 * step))
    seed = uphill(ball_distance(inside, step), (int(z), int(y), int(x)))
    inside = component_at(inside, seed)
    if any(inside.take(end, axis=axis).any() for axis in range(3) for end in (0, -1)):
        return None
    air = (distance_from(inside, step, 2.6 * step) <= 2.6 * step) & ~inside & ~tissue
    own = air & (to_wall > -step)
    if not air.any() or float(own.sum()) < OWN_AIR * float(air.sum()):
        return None
    return measured_mask(volume, inside, box.lps_from_ijk, notes=(NOTE,), touches=("airway wall",), off_mm=BASE_OFF_MM)
