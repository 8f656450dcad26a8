"""The compiled tracker of a lumen that is known already: of a case that is opened again, of edits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina._core import LumenTracker, reroot_lumen
from carina.volume.model import Volume

__all__ = ["CoreRecipe", "Levels", "edited_core", "found_core"]

Levels = tuple[float, float, float] | None
"""As :attr:`carina.track.Airways.wall_levels`."""


@dataclass(frozen=True, slots=True)
class CoreRecipe:
    """How the compiled tracker of a lumen is built again, in another process or from a case file."""

    levels: Levels
    is_edited: bool
    """Whether paths have the order of edits (`edited_core`), not that of a search (`found_core`)."""

    def build(self, volume: Volume, lumen_zyx: NDArray[np.uint8], root_ijk: tuple[int, int, int]) -> LumenTracker:
        """Return the compiled tracker of a lumen on the grid of a volume, from the voxel of the root."""
        return (edited_core if self.is_edited else found_core)(volume, lumen_zyx, root_ijk, self.levels)


def found_core(
    volume: Volume, lumen_zyx: NDArray[np.uint8], root_ijk: tuple[int, int, int], levels: Levels
) -> LumenTracker:
    """The compiled tracker as a search leaves it, of the lumen and the root that it came to."""
    core = _unsolved(volume, lumen_zyx, root_ijk, levels)
    core.solve_all()
    return core


def edited_core(
    volume: Volume, lumen_zyx: NDArray[np.uint8], root_ijk: tuple[int, int, int], levels: Levels
) -> LumenTracker:
    """The compiled tracker as edits leave it: of equally cheap paths it takes the first."""
    return reroot_lumen(_unsolved(volume, lumen_zyx, root_ijk, levels), root_ijk)


def _unsolved(
    volume: Volume, lumen_zyx: NDArray[np.uint8], root_ijk: tuple[int, int, int], levels: Levels
) -> LumenTracker:
    x, y, z = (float(v) for v in volume.to_lps(np.array(root_ijk, dtype=np.float64)))
    # A voxel's own centre: a tenth of a voxel is far more than its rounding.
    reach_mm = 0.1 * min(volume.spacing_mm)
    return LumenTracker(
        volume.hu_zyx, volume.lps_from_ijk, lumen_zyx, levels=levels, root_lps=(x, y, z), reach_mm=reach_mm
    )
