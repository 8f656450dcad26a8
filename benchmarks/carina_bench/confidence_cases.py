"""Phantoms for the calibration of confidence: good CTs and degraded ones, with strands that look like airways.

A strand is a dark tube in the lung that leaves an airway, without a wall or with a wall on one side only. It resembles
a bulla, a fissure or emphysema, and a search may follow it. A branch that the search found is *true* if more than half
of its points lie within a voxel (the cube root of its volume) of a true lumen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.phantom import Phantom, generate_phantom, lumen_distance_at
from carina.track import AirwayTree
from carina.volume import Volume

__all__ = ["CtCase", "cases_of", "is_true_branch", "made_case", "true_tree"]

Points = NDArray[np.float64]
LUMEN_HU, ONE_SIDED_HU = -980.0, -450.0
"""CT values in HU of a painted strand that resembles an airway: of its air, and least value of a wall on one side."""
WALL_MM = 0.9
"""Thickness of the wall on one side of a painted strand, mm."""


@dataclass(frozen=True, slots=True)
class CtCase:
    """Parameters of the CT of one phantom."""

    seed: int
    is_good: bool
    spacing_mm: tuple[float, float, float]
    noise_hu: float
    generations: int
    num_strands: int


def cases_of(seeds: range, *, is_good: bool) -> Iterator[CtCase]:
    """Return one case for each seed, all good or all degraded.

    Good CTs have a spacing of 0.8 mm and noise of 20 to 30 HU; degraded CTs have slices of 1 to 3 mm and noise of 20 to
    60 HU.
    """
    for seed in seeds:
        rng = np.random.default_rng((seed, is_good))
        generations = int(rng.integers(5, 8))
        if is_good:
            yield CtCase(seed, True, (0.8, 0.8, 0.8), float(rng.uniform(20.0, 30.0)), generations, 3)
        else:
            slices = float(np.round(rng.uniform(1.0, 3.0), 2))
            plane = float(np.round(rng.uniform(0.8, 1.0), 2))
            yield CtCase(seed, False, (plane, plane, slices), float(rng.uniform(20.0, 60.0)), generations, 10)


def true_tree(seed: int, generations: int = 6) -> AirwayTree:
    """Return the exact airway tree of a phantom; the phantom is generated with very few voxels."""
    box = ((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))
    return AirwayTree.from_json(generate_phantom(seed=seed, spacing_mm=5.0, box_lps=box, generations=generations).truth)


def made_case(case: CtCase) -> Volume:
    """Return the CT of a case, with the strands added to it."""
    made = generate_phantom(
        seed=case.seed, spacing_mm=case.spacing_mm, noise_hu=case.noise_hu, generations=case.generations
    )
    hu_zyx = made.volume.hu_zyx.astype(np.float32)
    rng = np.random.default_rng((case.seed, 7))
    for points, radius_mm, side in _strands(made, case, rng):
        _paint(hu_zyx, made.volume, points, radius_mm, side, case.noise_hu, rng)
    return Volume(np.round(hu_zyx).astype(np.int16), made.volume.lps_from_ijk)


def _strands(made: Phantom, case: CtCase, rng: np.random.Generator) -> Iterator[tuple[Points, float, Points | None]]:
    """Yield the centreline, the radius (mm), and the direction of the wall (None without a wall) of each strand."""
    branches = [b for b in made.truth["branches"] if b["generation"] >= 4]
    for number in rng.choice(len(branches), case.num_strands, replace=False):
        branch: dict[str, Any] = branches[number]
        points = np.array(branch["points"])
        at = points[int(rng.integers(len(points) // 2, len(points)))]
        ahead = points[-1] - points[0]
        ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-9) + rng.normal(size=3) * 0.7
        length_mm, radius_mm = rng.uniform(8.0, 30.0), rng.uniform(0.7, 1.8)
        line = [at]
        for _ in range(int(length_mm)):
            ahead = ahead / np.linalg.norm(ahead) + rng.normal(size=3) * 0.12
            line.append(line[-1] + ahead / np.linalg.norm(ahead))
        side = rng.normal(size=3) if rng.random() < 0.6 else None
        yield np.array(line), float(radius_mm), side


def _paint(
    hu_zyx: NDArray[np.float32],
    volume: Volume,
    points: Points,
    radius_mm: float,
    side: Points | None,
    noise_hu: float,
    rng: np.random.Generator,
) -> None:
    spacing = np.array(volume.spacing_mm)
    reach = np.ceil((radius_mm + WALL_MM + 2.0) / spacing).astype(int)
    ijk = volume.to_ijk(points)
    size = np.array(hu_zyx.shape[::-1])
    low = np.maximum(np.floor(ijk.min(axis=0)).astype(int) - reach, 0)
    high = np.minimum(np.ceil(ijk.max(axis=0)).astype(int) + reach + 1, size)
    if (high <= low).any():
        return
    grid = np.stack(np.meshgrid(*(np.arange(a, b) for a, b in zip(low, high, strict=True)), indexing="ij"), axis=-1)
    place = grid @ volume.lps_from_ijk[:3, :3].T + volume.lps_from_ijk[:3, 3]
    distance = np.full(place.shape[:3], np.inf)
    offset = np.zeros(place.shape)
    for point in points:
        away = place - point
        far = np.linalg.norm(away, axis=-1)
        nearer = far < distance
        distance[nearer], offset[nearer] = far[nearer], away[nearer]
    voxel_mm = float(np.cbrt(np.prod(spacing)))
    lumen = np.clip(0.5 - (distance - radius_mm) / voxel_mm, 0.0, 1.0)
    wall = np.zeros_like(lumen)
    if side is not None:
        outer = np.clip(0.5 - (distance - radius_mm - WALL_MM) / voxel_mm, 0.0, 1.0)
        wall = np.where(offset @ side > 0.0, np.maximum(outer - lumen, 0.0), 0.0)
    part = hu_zyx[low[2] : high[2], low[1] : high[1], low[0] : high[0]]
    lumen, wall = lumen.transpose(2, 1, 0), wall.transpose(2, 1, 0)
    noise = rng.normal(size=part.shape).astype(np.float32) * noise_hu
    part += (lumen * (LUMEN_HU + noise - part) + wall * np.maximum(ONE_SIDED_HU + noise - part, 0.0)).astype(np.float32)


def is_true_branch(case: CtCase, tree: AirwayTree) -> list[bool]:
    """Return for each branch of a tree that was found whether it is a true airway of the case."""
    voxel_mm = float(np.cbrt(np.prod(case.spacing_mm)))
    points = np.concatenate([b.points for b in tree.branches])
    near = lumen_distance_at(points, seed=case.seed, generations=case.generations) <= voxel_mm
    ends = np.cumsum([len(b.points) for b in tree.branches])[:-1]
    return [bool(part.mean() > 0.5) for part in np.split(near, ends)]
