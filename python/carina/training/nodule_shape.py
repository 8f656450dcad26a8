"""Shape of an inserted nodule: a ball with lobes and spicules by seed, scaled to an exact volume."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

LOBES = 7
"""Number of bumps on the surface of a lobulated nodule."""
LOBE_SHARE = 0.16
"""Height of a bump as a share of the nodule's radius, at spiculation 1."""
LOBE_WIDTH = 0.45
"""Standard deviation of a bump, rad."""
MAX_SPICULES = 14
"""Number of spicules of a nodule at spiculation 1."""
SPICULE_LENGTH = (0.35, 0.75)
"""Lengths of spicules beyond the ball as shares of the radius."""
SPICULE_WIDTH = 0.13
"""Radius of a spicule at its foot as a share of the radius of the ball; the spicule ends in a point."""
CELLS = 48
"""Number of cells along the radius of the grid on which the volume of a shape is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class NoduleShape:
    """Star-shaped body round a centre: a ball of radius 1 with bumps, and cones on it; scaled by ``radius_mm``."""

    radius_mm: float
    """Radius in mm of the ball that the shape deforms."""
    lobes: Points
    """(n, 3) unit directions of the bumps."""
    lobe_heights: NDArray[np.float64]
    """(n,) heights of the bumps, shares of the radius."""
    spicules: Points
    """(m, 3) unit directions of the spicules."""
    spicule_lengths: NDArray[np.float64]
    """(m,) lengths of the spicules beyond the ball, shares of the radius."""

    @classmethod
    def of_volume(cls, diameter_mm: float, spiculation: float, seed: int) -> NoduleShape:
        """Return the shape of a seed whose volume is that of a ball of ``diameter_mm``.

        Parameters
        ----------
        diameter_mm
            Diameter of the ball of equal volume.
        spiculation
            0 for a ball, up to 1 for large lobes and many spicules.
        seed
            Seed of the directions and sizes.
        """
        one = _unit_shape(float(spiculation), int(seed))
        return cls(diameter_mm / 2.0 * one.radius_mm, one.lobes, one.lobe_heights, one.spicules, one.spicule_lengths)

    @property
    def reach_mm(self) -> float:
        """Upper limit in mm of the distance from the nodule's centre to its surface."""
        longest = max(1.0 + float(self.spicule_lengths.max(initial=0.0)), 1.0 + float(self.lobe_heights.sum()))
        return self.radius_mm * longest

    def contains(self, offsets_mm: Points, *, margin_mm: float = 0.0) -> NDArray[np.bool_]:
        """Return which offsets (..., 3) from the centre are inside the shape, or within a margin of the ball.

        The margin widens the ball with its lobes and the spicules alike.
        """
        away = np.linalg.norm(offsets_mm, axis=-1)
        inside = away <= self.radius_mm * (1.0 + self.lobe_heights.sum()) + margin_mm
        found = np.zeros(away.shape, dtype=np.bool_)
        some, length = offsets_mm[inside], away[inside]
        units = some / np.maximum(length, 1e-9)[:, None]
        surface = np.ones(len(some))
        for lobe, height in zip(self.lobes, self.lobe_heights, strict=True):
            angle = np.arccos(np.clip(units @ lobe, -1.0, 1.0))
            surface += height * np.exp(-0.5 * (angle / LOBE_WIDTH) ** 2)
        found[inside] = length <= self.radius_mm * surface + margin_mm
        near = ~found & (away <= self.reach_mm + margin_mm)
        rest = offsets_mm[near]
        hit = np.zeros(len(rest), dtype=np.bool_)
        for spicule, long in zip(self.spicules, self.spicule_lengths, strict=True):
            along = rest @ spicule
            across = np.linalg.norm(rest - along[:, None] * spicule, axis=1)
            top = self.radius_mm * (1.0 + long)
            wide = SPICULE_WIDTH * self.radius_mm * np.clip((top - along) / (top - 0.8 * self.radius_mm), 0.0, 1.0)
            hit |= (along > 0.0) & (along <= top + margin_mm) & (across <= wide + margin_mm)
        found[near] = hit
        return found

    def _unit_volume(self) -> float:
        reach = self.reach_mm
        at = (np.arange(math.ceil(reach * CELLS) * 2) + 0.5) / CELLS - math.ceil(reach * CELLS) / CELLS
        inside = 0
        for z in at:
            y, x = np.meshgrid(at, at, indexing="ij")
            inside += int(np.count_nonzero(self.contains(np.stack([x, y, np.full_like(x, z)], axis=-1))))
        return inside / CELLS**3


@lru_cache(maxsize=64)
def _unit_shape(spiculation: float, seed: int) -> NoduleShape:
    """Return the shape of a seed with the volume of a ball of radius 1 mm; the cache saves the count of its cells."""
    rng = np.random.default_rng([seed, 45])
    num = round(MAX_SPICULES * spiculation)
    one = NoduleShape(
        1.0,
        _directions(rng, LOBES),
        LOBE_SHARE * spiculation * rng.uniform(0.3, 1.0, LOBES),
        _directions(rng, num),
        rng.uniform(*SPICULE_LENGTH, num),
    )
    if spiculation == 0.0:
        return one
    return replace(one, radius_mm=(4.0 / 3.0 * math.pi / one._unit_volume()) ** (1.0 / 3.0))


def _directions(rng: np.random.Generator, num: int) -> Points:
    found = rng.normal(size=(num, 3))
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True)) if num else np.empty((0, 3))
