"""Compact storage of edited airways for undo: some hundred kilobytes instead of a lumen and its tracker."""

from __future__ import annotations

import dataclasses
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina._core import lumen_states
from carina.display import one_line
from carina.errors import UsageError
from carina.track.edit.edit_list import TreeEdit
from carina.track.edit.lumen import EditedLumen
from carina.track.find.result import Airways
from carina.track.paths.rebuilt_tracker import CoreRecipe
from carina.track.paths.tracker import PathTracker
from carina.track.tree.airway_tree import AirwayTree, Branch
from carina.track.tree.uncertainty import Uncertainty
from carina.volume.sparse_mask import empty_mask


class FoldedAirways:
    """Compact form of edited airways, from which they are restored bit for bit."""

    __slots__ = ()

    base: Airways
    """Airways to which the edits were applied; their wall levels also apply to the edited airways."""

    def __repr__(self) -> str:
        """Return one line that shows ``base``."""
        return f"{type(self).__name__}(base={self.base!r})"

    def unfold(self) -> Airways:
        """Return the restored airways."""
        raise NotImplementedError


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PackedAirways(FoldedAirways):
    """Edited airways with a compressed lumen and without the path tracker, for undo."""

    base: Airways
    branches: tuple[Branch, ...]
    edits: tuple[TreeEdit, ...]
    next_id: int | None
    notes: tuple[str, ...]
    root_ijk: tuple[int, int, int]
    first_ijk: tuple[int, int, int]
    shape_zyx: tuple[int, int, int]
    uncertain: tuple[Uncertainty, ...]
    bridges: tuple[NDArray[np.float64], ...]
    packed: bytes | None
    """Lumen within its bounding box, one bit per voxel, compressed with deflate; None for an unchanged lumen.

    None if lumen and paths are those of ``base``, as after renaming.
    """

    def unfold(self) -> Airways:
        """Return the restored airways; their paths are calculated at first use."""
        if self.packed is None:
            # Keep the tracker of the search: it has the exact nodes of each branch; nodes from centrelines may differ
            # by a voxel.
            return dataclasses.replace(
                self.base,
                tree=dataclasses.replace(self.base.tree, branches=self.branches),
                notes=self.notes,
                base=self.base,
                edits=self.edits,
                next_id=self.next_id,
                uncertain=self.uncertain,
                bridges=self.bridges,
            )
        count = int(np.prod(self.shape_zyx))
        bits = np.frombuffer(zlib.decompress(self.packed), dtype=np.uint8)
        i, j, k = self.first_ijk
        nz, ny, nx = self.shape_zyx
        grid = self.base.tracker.grid
        lumen = empty_mask(grid.shape_zyx)
        box = lumen[k : k + nz, j : j + ny, i : i + nx]
        np.copyto(box, np.uint8(1), where=np.unpackbits(bits, count=count).reshape(self.shape_zyx) != 0)
        lumen.flags.writeable = False
        recipe = CoreRecipe(self.base.wall_levels, is_edited=True)
        tracker = PathTracker(grid, None, recipe=recipe, root_ijk=self.root_ijk, lumen_zyx=lumen)
        tracker.follow_branches(self.branches)
        return dataclasses.replace(
            self.base,
            lumen_zyx=grid.lumen_on_ct(lumen, self.branches),
            root_lps=self.branches[0].points[0].copy(),
            tree=AirwayTree(self.branches, _smooth=tracker.smooth, notes=self.base.tree.notes),
            tracker=tracker,
            notes=self.notes,
            base=self.base,
            edits=self.edits,
            next_id=self.next_id,
            uncertain=self.uncertain,
            bridges=self.bridges,
        )


def fold_airways(airways: Airways) -> PackedAirways:
    """Return edited airways in compact form; their base is stored unchanged.

    Raises
    ------
    UsageError
        If the airways were not edited.
    """
    if airways.base is None:
        raise UsageError("only edited airways can be folded to save memory; expected at least one edit, found none")
    lumen = EditedLumen(airways.tracker.grid, airways.tracker.core)
    first, shape = _box(airways.tracker.lumen_zyx)
    packed = None
    if airways.tracker is not airways.base.tracker:
        states = lumen_states(lumen.core, first, shape)
        packed = zlib.compress(np.packbits(states != 0).tobytes(), 1)
    return PackedAirways(
        base=airways.base,
        branches=airways.tree.branches,
        edits=airways.edits,
        next_id=airways.next_id,
        notes=airways.notes,
        uncertain=airways.uncertain,
        bridges=airways.bridges,
        root_ijk=lumen.root_ijk,
        first_ijk=first,
        shape_zyx=(shape[2], shape[1], shape[0]),
        packed=packed,
    )


def _box(lumen_zyx: NDArray[np.uint8]) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    """Return the first voxel and the shape (i, j, k) of the bounding box of the nonzero voxels."""
    first, shape = [], []
    for axis in (2, 1, 0):
        others = tuple(a for a in range(3) if a != axis)
        at = np.flatnonzero(lumen_zyx.any(axis=others))
        first.append(int(at[0]))
        shape.append(int(at[-1] - at[0] + 1))
    return (first[0], first[1], first[2]), (shape[0], shape[1], shape[2])
