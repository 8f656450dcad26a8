"""Canonical axis order for the search, so that the result does not depend on how a file stores the voxels."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.find.result import Airways
from carina.track.paths.path_grid import PathGrid
from carina.track.paths.rebuilt_tracker import CoreRecipe
from carina.track.paths.tracker import PathTracker
from carina.track.tree.airway_tree import AirwayTree
from carina.volume.digest import CanonicalAxes, canonical_axes, canonical_geometry
from carina.volume.model import Volume
from carina.volume.sparse_mask import empty_mask


@dataclass(frozen=True, slots=True)
class CanonicalOrder:
    """Pair of a volume as it is stored and the same volume with axes that run nearest to L, P and S.

    Floods, queues and least-cost paths take voxels in memory order, and the first of two equal voxels wins. The
    search therefore always runs in the canonical order, and its result is converted back to the stored order.
    """

    stored: Volume
    """Volume as it is stored."""
    volume: Volume
    """Volume in canonical order: ``stored`` itself if it is in this order, otherwise a copy."""
    _axes: CanonicalAxes

    @classmethod
    def of(cls, volume: Volume) -> CanonicalOrder:
        """Return the pair for a volume in any axis order; a volume already in canonical order is not copied."""
        axes = canonical_axes(volume.lps_from_ijk)
        if axes.letters == "LPS":
            return cls(volume, volume, axes)
        place = canonical_geometry(volume).lps_from_ijk
        values = np.ascontiguousarray(axes.view(volume.hu_zyx))
        return cls(volume, dataclasses.replace(volume, hu_zyx=values, lps_from_ijk=place), axes)

    @property
    def is_stored(self) -> bool:
        """Whether the stored volume is already in canonical order."""
        return self.volume is self.stored

    def in_canonical_order(self, lumen_zyx: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a mask on the stored grid in canonical order."""
        return lumen_zyx if self.is_stored else np.ascontiguousarray(self._axes.view(lumen_zyx))

    def _mask_on_stored_grid(self, mask_zyx: NDArray[np.uint8], shape_zyx: tuple[int, int, int]) -> NDArray[np.uint8]:
        mask = empty_mask(shape_zyx)
        np.copyto(self._axes.view(mask), np.uint8(1), where=mask_zyx != 0)
        mask.flags.writeable = False
        return mask

    def on_stored_grid(self, airways: Airways) -> Airways:
        """Return airways that were found in canonical order on the stored grid.

        The paths on the stored grid are calculated at first use; the tree is the one that was found.
        """
        if self.is_stored:
            return airways
        grid = PathGrid(self.stored, airways.tracker.grid.parts)
        lumen = self._mask_on_stored_grid(airways.tracker.lumen_zyx, grid.shape_zyx)
        on_ct = self._mask_on_stored_grid(airways.lumen_zyx, self.stored.shape_zyx) if grid.is_divided else lumen
        upper = airways.upper_airway_zyx
        upper = None if upper is None else self._mask_on_stored_grid(upper, self.stored.shape_zyx)
        place = np.linalg.inv(grid.lps_from_ijk) @ airways.tracker.grid.lps_from_ijk
        i, j, k = (int(v) for v in np.rint(place[:3, :3] @ np.array(airways.tracker.root_ijk) + place[:3, 3]))
        recipe = CoreRecipe(airways.wall_levels, is_edited=True)
        tracker = PathTracker(grid, None, recipe=recipe, root_ijk=(i, j, k), lumen_zyx=lumen)
        tracker.follow_branches(airways.tree.branches)
        tree = AirwayTree(airways.tree.branches, _smooth=tracker.smooth, notes=airways.tree.notes)
        return dataclasses.replace(airways, lumen_zyx=on_ct, tree=tree, tracker=tracker, upper_airway_zyx=upper)
