"""Fine vessels, thinner than those of the masks: their courses beside and between airways, and their effect on voxels.

A vessel of 0.3 to 0.6 mm radius is thinner than the blur of any kernel, so an image depends only on the area of its
cross-section. Each piece of its axis is added to the image as a Gaussian of the kernel's width, without a grid of fine
cells.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from carina_bench.paint_scanner import normal_share
from carina_bench.paint_tubes import Tube

__all__ = ["FineVessel", "add_fine_vessels", "fine_vessels"]

Floats = NDArray[np.float64]

RADII_MM = (0.3, 0.6)
"""Minimum and maximum radius in mm of the painted fine vessels."""
RADIUS_POWER = -2.9
"""Exponent of the density of vessels as a power of the radius.

Source: numbers of arteries by radius, Singhal 1973.
"""
LENGTH_RADII = (7.0, 14.0)
"""Minimum and maximum length of a vessel between two forks, in radii of the vessel."""
STEP_MM = 0.5
"""Distance in mm between two points of a painted vessel's centreline."""
SAMPLE_MM = 0.25
"""Maximum distance between two points at which a vessel is added to the image, mm."""
REACH_SIGMAS = 3.2
"""Distance from a point within which it contributes to voxels, in standard deviations of the blur."""
LUNG_MM = 1.5
"""Minimum distance in mm of a painted vessel from the lung's border."""
CLEAR_MM = 0.15
"""Minimum distance between a vessel's surface and the outside of an airway's wall, mm."""
BESIDE_SHARE = 0.25
"""Share of the vessels that run along an airway, at most :data:`BESIDE_MM` from the airway's wall."""
BESIDE_MM = 1.2
"""Maximum distance between an airway's wall and a vessel that runs along the airway, mm."""
MIN_POINTS = 4
"""Minimum number of points of a painted vessel; a vessel with fewer is omitted."""
NUM_AT_ONCE = 4000
"""Number of points that are added to the image in one step, which limits the memory."""


@dataclass(frozen=True, slots=True, eq=False)
class FineVessel:
    """Course and radius of a vessel that is thinner than the blur."""

    points: Floats
    """Centreline (n, 3) of the vessel, LPS mm."""
    radius_mm: float


class Axis(Protocol):
    """Cells of the scene and voxels of the image along one axis (see ``carina_bench.paint``)."""

    at_mm: Floats
    voxel_mm: float
    sigma_mm: float
    cell_mm: float
    num_cells: int


class Space(Protocol):
    """Masks of a patient, with tests whether points are in lung or near a vessel."""

    def in_lung(self, points: Floats, margin_mm: float, *, num: int = 26) -> NDArray[np.bool_]:
        """Return a mask (n,) of points in the lung, ``margin_mm`` or more from its border in ``num`` directions."""
        ...

    def at_vessel(self, points: Floats, reach_mm: float) -> NDArray[np.bool_]:
        """Return for each point whether a vessel of the masks is within ``reach_mm``."""
        ...


def fine_vessels(
    tubes: Sequence[Tube], space: Space, lung_lps: Floats, num: int, rng: np.random.Generator
) -> tuple[FineVessel, ...]:
    """Return random vessels between and beside airways.

    Parameters
    ----------
    tubes
        Airways and arteries, LPS mm. No vessel enters one.
    space
        Masks in which the vessels grow.
    lung_lps
        (n, 3) points in the lung, LPS mm; vessels that do not run beside an airway start at one of them.
    num
        Number of vessels to try. A vessel is omitted if it would leave the lung or meet an airway near its start.
    rng
        Random generator.
    """
    spatial: Any = importlib.import_module("scipy.spatial")
    low, high = (radius ** (RADIUS_POWER + 1.0) for radius in RADII_MM)
    radius = (low + rng.random(num) * (high - low)) ** (1.0 / (RADIUS_POWER + 1.0))
    start = lung_lps[rng.integers(len(lung_lps), size=num)]
    heading = _unit(rng.standard_normal((num, 3)))
    num_beside = _begin_beside(tubes, start, heading, radius, rng)
    length = radius * rng.uniform(*LENGTH_RADII, num)
    length[:num_beside] *= 2.0
    bend = 0.05 * rng.standard_normal((num, 3))
    steps = math.ceil(2.0 * RADII_MM[1] * LENGTH_RADII[1] / STEP_MM)
    points = np.empty((num, steps + 1, 3))
    points[:, 0] = start
    for n in range(steps):
        points[:, n + 1] = points[:, n] + STEP_MM * heading
        heading = _unit(heading + STEP_MM * bend)
    flat = points.reshape(-1, 3)
    clear = space.in_lung(flat, LUNG_MM, num=6)
    there = np.concatenate([tube.points for tube in tubes])
    outer = np.concatenate([tube.outer_mm() for tube in tubes])
    # Points of a tube are 0.5 mm apart, so the distance to its nearest point exceeds the distance to its axis by less
    # than 0.1 mm.
    tree = spatial.cKDTree(there)
    gap, nearest = tree.query(flat, k=4, distance_upper_bound=float(outer.max()) + 2.0 * RADII_MM[1])
    nearest = np.minimum(nearest, len(there) - 1)
    clear &= ((gap - outer[nearest]).min(axis=1) - np.repeat(radius, steps + 1)) > CLEAR_MM
    clear = clear.reshape(num, steps + 1) & (STEP_MM * np.arange(steps + 1) <= length[:, None])
    end = np.where(clear.all(axis=1), steps + 1, clear.argmin(axis=1))
    return tuple(FineVessel(points[n, : end[n]], float(radius[n])) for n in np.flatnonzero(end >= MIN_POINTS))


def _begin_beside(
    tubes: Sequence[Tube], start: Floats, heading: Floats, radius: Floats, rng: np.random.Generator
) -> int:
    """Move the starts of the first vessels beside small airways, and turn the vessels parallel to these airways.

    Return the number of vessels that were moved; ``start`` and ``heading`` are changed in place.
    """
    small = [tube for tube in tubes if not tube.is_artery and tube.generation >= 3 and len(tube.points) > 2]
    num = round(BESIDE_SHARE * len(start)) if small else 0
    places = np.concatenate([tube.points[:-1] for tube in small]) if small else np.empty((0, 3))
    along = np.concatenate([np.diff(tube.points, axis=0) for tube in small]) if small else np.empty((0, 3))
    outer = np.concatenate([tube.outer_mm()[:-1] for tube in small]) if small else np.empty(0)
    # At most one vessel starts at each 1.5 mm of an airway.
    num = min(num, len(places) // 3)
    chosen = rng.permutation(len(places))[:num]
    direction = _unit(along[chosen])
    side = rng.standard_normal((num, 3))
    side = _unit(side - (side * direction).sum(axis=1, keepdims=True) * direction)
    away = outer[chosen] + radius[:num] + CLEAR_MM + 0.1 + rng.uniform(0.0, BESIDE_MM, num)
    start[:num] = places[chosen] + away[:, None] * side
    heading[:num] = _unit(direction + 0.15 * rng.standard_normal((num, 3)))
    return num


def _unit(rows: Floats) -> Floats:
    result: Floats = rows / np.maximum(np.linalg.norm(rows, axis=-1, keepdims=True), 1e-12)
    return result


def add_fine_vessels(
    values: NDArray[np.float32],
    hu_zyx: NDArray[np.int16],
    vessels: Iterable[FineVessel],
    axes: tuple[Axis, Axis, Axis],
    vessel_hu: float,
) -> None:
    """Add vessels (mm from the centre of the first cell) to the blurred image ``values`` (nz, ny, nx), in place.

    Blood replaces the tissue of a cell, so a vessel that is inside a vessel of the masks adds nothing.
    """
    places, masses, radii = _samples(vessels)
    cells = [
        np.clip(np.rint(places[:, n] / axis.cell_mm).astype(int), 0, axis.num_cells - 1) for n, axis in enumerate(axes)
    ]
    masses = masses * (vessel_hu - hu_zyx[cells[2], cells[1], cells[0]])
    flat = values.reshape(-1)
    for first in range(0, len(places), NUM_AT_ONCE):
        part = slice(first, first + NUM_AT_ONCE)
        index, weight = [], []
        for n, axis in enumerate(axes):
            at, share = _weights(places[part, n], radii[part], axis)
            index.append(at)
            weight.append(share)
        added = (
            masses[part, None, None, None]
            * weight[2][:, :, None, None]
            * weight[1][:, None, :, None]
            * weight[0][:, None, None, :]
        )
        shape = values.shape
        to = (index[2][:, :, None, None] * shape[1] + index[1][:, None, :, None]) * shape[2] + index[0][
            :, None, None, :
        ]
        low, high = int(to.min()), int(to.max()) + 1
        flat[low:high] += np.bincount(to.ravel() - low, added.ravel(), high - low).astype(np.float32)


def _samples(vessels: Iterable[FineVessel]) -> tuple[Floats, Floats, Floats]:
    """Return points along all vessels, from the lowest slice up, with the volume (mm3) and the radius at each."""
    places, masses, radii = [], [], []
    for vessel in vessels:
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(vessel.points, axis=0), axis=1))])
        num = max(math.ceil(along[-1] / SAMPLE_MM), 1)
        at = (np.arange(num) + 0.5) * (along[-1] / num)
        places.append(np.stack([np.interp(at, along, vessel.points[:, n]) for n in range(3)], axis=1))
        masses.append(np.full(num, math.pi * vessel.radius_mm**2 * along[-1] / num))
        radii.append(np.full(num, vessel.radius_mm))
    order = np.argsort(np.concatenate(places)[:, 2], kind="stable")
    return np.concatenate(places)[order], np.concatenate(masses)[order], np.concatenate(radii)[order]


def _weights(places: Floats, radii: Floats, axis: Axis) -> tuple[NDArray[np.int64], Floats]:
    """Return the voxels (n, m) along an axis to which each point contributes, and the contributions."""
    # The projection of a disc onto a line has a variance of a quarter of the square of the disc's radius.
    sigma = np.sqrt(axis.sigma_mm**2 + 0.25 * radii**2)
    reach = math.ceil((0.5 * axis.voxel_mm + REACH_SIGMAS * float(sigma.max())) / axis.voxel_mm)
    middle = np.searchsorted(axis.at_mm, places - 0.5 * axis.voxel_mm)
    index = middle[:, None] + np.arange(-reach, reach + 1)
    inside = (index >= 0) & (index < len(axis.at_mm))
    index = np.clip(index, 0, len(axis.at_mm) - 1)
    scaled = (axis.at_mm[index] - places[:, None]) / sigma[:, None]
    half = 0.5 * (axis.voxel_mm / sigma)[:, None]
    share = normal_share(scaled + half) - normal_share(scaled - half)
    return index, np.where(inside, share / axis.voxel_mm, 0.0)
