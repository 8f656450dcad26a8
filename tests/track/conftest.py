"""Synthetic chest for the tests: a trachea and two generations of forks in two lungs, on an oblique grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from carina.track import Airways, find_airways
from carina.volume.model import Volume

Tube = tuple[NDArray[np.float64], NDArray[np.float64], float]


@dataclass(frozen=True)
class DrawnChest:
    volume: Volume
    tubes: list[Tube]
    """Start, end and radius (mm) of each tube: trachea, right and left main bronchus, two right, two left."""

    def depth_mm(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the signed distance of each point (LPS mm) from the wall of the nearest tube, mm.

        Negative inside a tube.
        """
        return np.min([off_segment(points, a, b) - r for a, b, r in self.tubes], axis=0)


def off_segment(points: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of points (..., 3) from the segment between ``a`` and ``b``."""
    along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(points - a - along[..., None] * (b - a), axis=-1)


@cache
def draw(
    *,
    axes: tuple[int, int, int] = (0, 1, 2),
    flips: tuple[bool, bool, bool] = (False, False, False),
    num_tubes: int = 7,
    seed: int = 1,
) -> DrawnChest:
    """Return the synthetic chest, with permuted and flipped axes of the array."""
    shape = np.array([112, 80, 96])
    spacing = np.array([1.0, 1.1, 1.6])
    t, s = 0.2, 0.12
    turn = np.array([[np.cos(t), -np.sin(t), 0.0], [np.sin(t), np.cos(t), 0.0], [0.0, 0.0, 1.0]])
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(s), -np.sin(s)], [0.0, np.sin(s), np.cos(s)]])
    matrix = np.eye(4)
    matrix[:3, :3] = turn @ tilt * spacing
    matrix[:3, 3] = [12.0, -150.0, 240.0]
    ijk = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).astype(np.float64)
    points = ijk @ matrix[:3, :3].T + matrix[:3, 3]
    centre = ((shape - 1) / 2) @ matrix[:3, :3].T + matrix[:3, 3]

    def at(x: float, y: float, z: float) -> NDArray[np.float64]:
        return centre + np.array([x, y, z])

    carina, right, left = at(0, 0, 5), at(-18, 1, -14), at(19, -1, -16)
    tubes: list[Tube] = [
        (at(0, 2, 62), carina, 6.5),
        (carina, right, 5.0),
        (carina, left, 4.6),
        (right, at(-27, 4, -34), 3.2),
        (right, at(-17, -8, -36), 3.0),
        (left, at(28, 3, -35), 3.0),
        (left, at(17, -9, -37), 2.8),
    ][:num_tubes]
    chest = DrawnChest(Volume(np.zeros((1, 1, 1), np.int16), np.eye(4)), tubes)
    depth = chest.depth_mm(points)
    x, y, z = np.moveaxis(points - centre, -1, 0)
    values = np.where((x / 52) ** 2 + (y / 38) ** 2 < 1, 30.0, -1000.0)
    for side in (-28.0, 28.0):
        values[((x - side) / 22) ** 2 + (y / 27) ** 2 + ((z + 14) / 40) ** 2 < 1] = -880.0
    values[depth < 1.8] = 0.0
    air = np.clip(0.5 - depth / 1.2, 0.0, 1.0)
    noise = np.random.default_rng(seed).normal(0.0, 12.0, values.shape)
    values = np.rint(air * -1000.0 + (1.0 - air) * values + noise).astype(np.int16)

    # The array axes are permuted and flipped; the positions of the voxels in LPS stay the same.
    values = values.transpose(axes)
    stored = matrix.copy()
    stored[:3, :3] = matrix[:3, list(axes)]
    for axis, flip in enumerate(flips):
        if flip:
            values = np.flip(values, axis)
            stored[:3, 3] += (values.shape[axis] - 1) * stored[:3, axis]
            stored[:3, axis] *= -1.0
    return DrawnChest(Volume(np.ascontiguousarray(values.transpose(2, 1, 0)), stored), tubes)


@pytest.fixture(scope="session")
def draw_chest() -> Callable[..., DrawnChest]:
    return draw


@pytest.fixture(scope="session")
def chest() -> DrawnChest:
    return draw()


@pytest.fixture(scope="session")
def found(chest: DrawnChest) -> Airways:
    """Return the airways of the synthetic chest by the search with default options, which runs once per worker."""
    return find_airways(chest.volume)
