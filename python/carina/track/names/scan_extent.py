"""Lobes and segments whose bronchus begins outside the scan."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.track.tree.airway_tree import AirwayTree
from carina.volume.model import Volume

Points = NDArray[np.float64]

# Start of each bronchus relative to the carina (lateral, posterior, up), in mm: the nearest position in four patients
# and six phantoms, so that a bronchus counts as outside only if no usual anatomy has it in the scan.
_ORIGINS = {
    "RUL": (12.0, 3.0, -6.0),
    "RML": (20.0, 3.0, -33.0),
    "RLL": (20.0, 5.0, -35.0),
    "LUL": (28.0, 8.0, -26.0),
    "LLL": (28.0, 8.0, -27.0),
    **dict.fromkeys(("RB1", "RB2", "RB3"), (25.0, 4.0, -8.0)),
    **dict.fromkeys(("RB4", "RB5"), (25.0, -2.0, -38.0)),
    "RB6": (23.0, 8.0, -36.0),
    **dict.fromkeys(("RB7", "RB8", "RB9", "RB10"), (25.0, 8.0, -48.0)),
    **dict.fromkeys(("LB1+2", "LB3"), (36.0, 0.0, -20.0)),
    **dict.fromkeys(("LB4", "LB5"), (38.0, -3.0, -30.0)),
    "LB6": (34.0, 10.0, -36.0),
    **dict.fromkeys(("LB8", "LB9", "LB10"), (36.0, 10.0, -46.0)),
}
PADDING_MM = 5.0
"""Distance in mm from a voxel within which equal values on all sides show that the voxel is padding."""


class ScanExtent:
    """Region of the chest that a scan contains, from which follows which bronchi can be visible."""

    def __init__(self, volume: Volume, tree: AirwayTree, names: Sequence[str | None]) -> None:
        self._volume = volume
        self._carina = _carina(tree, names)

    def is_outside(self, name: str, *, side: str, scale: float = 1.0) -> bool:
        """Return whether the start of a bronchus is outside the scan.

        Parameters
        ----------
        name
            Lobe or segment, with the side of a chest that is not mirrored.
        side
            R or L: the patient's side.
        scale
            Distance of the bronchus from the carina, relative to the nearest one.
        """
        if self._carina is None or name not in _ORIGINS:
            return False
        lateral, back, up = _ORIGINS[name]
        return not self._shows(self._carina + scale * np.array([lateral if side == "L" else -lateral, back, up]))

    def _shows(self, point: Points) -> bool:
        if not self._volume.contains_lps(point):
            return False
        ijk = self._volume.to_ijk(point)
        reach = np.maximum(PADDING_MM / np.array(self._volume.spacing_mm), 1.0)
        last = np.array(self._volume.shape_zyx[::-1])
        low = np.clip(np.floor(ijk - reach).astype(int), 0, last - 1)
        high = np.clip(np.ceil(ijk + reach).astype(int) + 1, low + 1, last)
        box = self._volume.hu_zyx[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
        return int(box.min()) != int(box.max())


def _carina(tree: AirwayTree, names: Sequence[str | None]) -> Points | None:
    """Return the end of the trachea (LPS, mm), or the start of a main bronchus if there is no trachea."""
    tracheas = [branch for branch, name in zip(tree.branches, names, strict=True) if name == "Trachea"]
    if tracheas:
        return np.asarray(tracheas[-1].points[-1])
    mains = [branch for branch, name in zip(tree.branches, names, strict=True) if name in ("RMB", "LMB")]
    return np.asarray(mains[0].points[0]) if mains else None
