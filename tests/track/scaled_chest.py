"""Phantoms whose voxel spacing is multiplied, and a comparison of their airway trees with the scaled truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from carina.phantom import lumen_distance_at
from carina.track import AirwayTree, Branch
from carina.volume import Volume


def scaled(volume: Volume, scale: float) -> Volume:
    """Return the same voxels with every distance multiplied."""
    matrix = volume.lps_from_ijk.copy()
    matrix[:3] *= scale
    return Volume(volume.hu_zyx, matrix)


@dataclass(frozen=True)
class ScaledTruth:
    """The branches of a tree in a scaled phantom, split by the truth.

    A branch is true where more than half of its points are within a voxel of a true lumen.
    """

    true: list[Branch]
    false: list[Branch]

    @classmethod
    def of(cls, tree: AirwayTree, *, seed: int, scale: float, voxel_mm: float) -> ScaledTruth:
        """Compare a tree with the phantom of this seed.

        Parameters
        ----------
        voxel_mm
            Edge of a voxel before the scaling.
        """
        points = np.concatenate([branch.points for branch in tree.branches]) / scale
        near = lumen_distance_at(points, seed=seed) <= voxel_mm
        ends = np.cumsum([len(branch.points) for branch in tree.branches])[:-1]
        is_true = [bool(part.mean() > 0.5) for part in np.split(near, ends)]
        pairs = list(zip(tree.branches, is_true, strict=True))
        return cls([b for b, true in pairs if true], [b for b, true in pairs if not true])

    @property
    def most_confident_false(self) -> float:
        """Highest confidence of a false branch; 0 without one."""
        return max((branch.confidence or 0.0 for branch in self.false), default=0.0)
