"""Phantoms whose voxel spacing is multiplied, and a comparison of their airway trees with the scaled truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carina.phantom import lumen_distance_at
from carina.track import AirwayTree, Branch
from carina.volume import Volume


def scaled(volume: Volume, scale: float) -> Volume:
    """Return a volume with the same voxels in which every distance is multiplied by ``scale``."""
    matrix = volume.lps_from_ijk.copy()
    matrix[:3] *= scale
    return Volume(volume.hu_zyx, matrix)


@dataclass(frozen=True)
class ScaledTruth:
    """Branches of a tree found in a scaled phantom, divided into true and false ones.

    A branch is true if more than half of its points are within a voxel of a true lumen.
    """

    true: list[Branch]
    false: list[Branch]

    @classmethod
    def of(cls, tree: AirwayTree, *, seed: int, scale: float, voxel_mm: float) -> ScaledTruth:
        """Compare a tree with the truth of the phantom ``seed``.

        Parameters
        ----------
        tree
            Tree found in the scaled phantom.
        seed
            Seed of the phantom.
        scale
            Factor by which the phantom is scaled.
        voxel_mm
            Edge of a voxel before the scaling, mm.
        """
        points = np.concatenate([branch.points for branch in tree.branches]) / scale
        near = lumen_distance_at(points, seed=seed) <= voxel_mm
        ends = np.cumsum([len(branch.points) for branch in tree.branches])[:-1]
        is_true = [bool(part.mean() > 0.5) for part in np.split(near, ends)]
        pairs = list(zip(tree.branches, is_true, strict=True))
        return cls([b for b, true in pairs if true], [b for b, true in pairs if not true])

    @property
    def most_confident_false(self) -> float:
        """Highest confidence of a false branch; 0 if no branch is false."""
        return max((branch.confidence or 0.0 for branch in self.false), default=0.0)
