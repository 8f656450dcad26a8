"""Reconstruction of the compiled tracker of a known lumen, after a case is opened or edited."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina._core import LumenTracker, reroot_lumen
from carina.volume.model import Volume

Levels = tuple[float, float, float] | None
"""Type of the wall levels of a lumen, as in :attr:`carina.track.Airways.wall_levels`."""


@dataclass(frozen=True, slots=True)
class CoreRecipe:
    """Parameters from which the compiled tracker of a lumen is rebuilt, in another process or from a case file."""

    levels: Levels
    """Wall levels of the lumen; None for a lumen from external software."""
    is_edited: bool
    """Whether paths have the order of edits (`edited_core`) rather than that of a search (`found_core`)."""

    def build(self, volume: Volume, lumen_zyx: NDArray[np.uint8], root_ijk: tuple[int, int, int]) -> LumenTracker:
        """Return the compiled tracker of a lumen on the grid of a volume, rooted at the given voxel."""
        return (edited_core if self.is_edited else found_core)(volume, lumen_zyx, root_ijk, self.levels)


def found_core(
    volume: Volume, lumen_zyx: NDArray[np.uint8], root_ijk: tuple[int, int, int], levels: Levels
) -> LumenTracker:
    """Return the compiled tracker of a lumen with all paths in the order in which a search computes them."""
    core = _unsolved(volume, lumen_zyx, root_ijk, levels)
    core.solve_all()
    return core


def edited_core(
    volume: Volume, lumen_zyx: NDArray[np.uint8], root_ijk: tuple[int, int, int], levels: Levels
) -> LumenTracker:
    """Return the compiled tracker of a lumen with all paths in the order of edits: the first of equally cheap paths."""
    return reroot_lumen(_unsolved(volume, lumen_zyx, root_ijk, levels), root_ijk)


def _unsolved(
    volume: Volume, lumen_zyx: NDArray[np.uint8], root_ijk: tuple[int, int, int], levels: Levels
) -> LumenTracker:
    x, y, z = (float(v) for v in volume.to_lps(np.array(root_ijk, dtype=np.float64)))
    # The root is a voxel centre: a tenth of a voxel is far more than the rounding error.
    reach_mm = 0.1 * min(volume.spacing_mm)
    return LumenTracker(
        volume.hu_zyx, volume.lps_from_ijk, lumen_zyx, levels=levels, root_lps=(x, y, z), reach_mm=reach_mm
    )
