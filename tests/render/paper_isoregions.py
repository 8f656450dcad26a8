"""IsoRegions and their traversal, written from sections 4.1 to 4.3 of the paper alone, in NumPy.

This module shares no code with the kernels and with Carina's reference implementations; tests compare the kernels with
this module.
Arrays are ``[z, y, x]``; points, directions and shapes are ``(x, y, z)``.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.integer]
Dimensions = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]

NEIGHBOURS = [step for step in itertools.product((-1, 0, 1), repeat=3) if step != (0, 0, 0)]
DIAGONALS = list(itertools.product((-1, 1), repeat=3))


def isoregions_by_definition(values: Values) -> Dimensions:
    """Return the dimension d of the largest IsoRegion round each voxel (4.1).

    An IsoRegion is a cube of (2d+1)^3 voxels of one value. Voxels outside the volume have no value, so a cube is inside
    the volume, as in figure 12(a). Each cube is inspected voxel for voxel.
    """
    dimensions = np.zeros(values.shape, np.int64)
    for centre in np.ndindex(values.shape):
        d = 0
        while True:
            low = [c - d - 1 for c in centre]
            high = [c + d + 2 for c in centre]
            if min(low) < 0 or any(h > n for h, n in zip(high, values.shape, strict=True)):
                break
            cube = values[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
            if (cube != values[centre]).any():
                break
            d += 1
        dimensions[centre] = d
    return dimensions


def moved(numbers: Values, step: tuple[int, ...], outside: int) -> Values:
    """Return for each voxel the number of its neighbour at ``step``; a neighbour outside the volume has ``outside``."""
    padded = np.pad(numbers, 1, constant_values=outside)
    return padded[tuple(slice(1 + s, 1 + s + n) for s, n in zip(step, numbers.shape, strict=True))]


def isoregions_by_iteration(values: Values) -> Dimensions:
    """Return the dimension d of the IsoRegion of each voxel by the construction of section 4.2.

    The first iteration compares each voxel with its 26 neighbours. Each later iteration finds dimension d where all
    eight diagonal neighbours are centres of IsoRegions of dimension d-1 from the iteration before.
    """
    numbers = np.unique(values, return_inverse=True)[1].reshape(values.shape)
    dimensions = np.ones(values.shape, np.int64)
    for step in NEIGHBOURS:
        dimensions[moved(numbers, step, -1) != numbers] = 0
    d = 1
    while True:
        d += 1
        found = np.ones(values.shape, bool)
        for step in DIAGONALS:
            found &= moved(dimensions, step, 0) == d - 1
        if not found.any():
            return dimensions
        dimensions[found] = d


def irst(colours: Floats, opacities: Floats, steps: int) -> tuple[Floats, Floats]:
    """Return the IsoRegion step table of section 4.3: colour ``[v, d, 3]`` and transparency ``[v, d]``.

    The table has d from 0 to ``steps``. A segment of d equal samples has the colour C(1 - beta^d) and the transparency
    beta^d.
    """
    transparency = (1.0 - opacities)[:, None] ** np.arange(steps + 1)
    return colours[:, None, :] * (1.0 - transparency)[..., None], transparency


@dataclass(frozen=True)
class Rays:
    """Rays whose sample n is at ``start + n * step`` in voxel space; ``count`` samples are inside the volume."""

    start: Floats
    step: Floats
    count: npt.NDArray[np.int64]


@dataclass(frozen=True)
class CastImage:
    """Colour and transparency of each ray, and the number of samples that were read for it."""

    colour: Floats
    transparency: Floats
    reads: npt.NDArray[np.int64]


def voxels_at(points: Floats) -> tuple[npt.NDArray[np.int64], ...]:
    """Return the ``[z, y, x]`` index of the voxel that contains each ``(x, y, z)`` point."""
    nearest = np.floor(points + 0.5).astype(np.int64)
    return nearest[:, 2], nearest[:, 1], nearest[:, 0]


def cast(
    values: Values,
    rays: Rays,
    colours: Floats,
    opacities: Floats,
    dimensions: Dimensions | None = None,
) -> CastImage:
    """Return the image of the caster of section 4.3: by brute force, or with leaps if ``dimensions`` is given.

    ``values`` are indices into ``colours`` and ``opacities``. From a voxel of dimension d, a leap covers as many
    samples as fit into a chessboard distance of d, and at least one sample. A ray that misses the volume is black.
    """
    num_rays = len(rays.count)
    colour = np.zeros((num_rays, 3))
    transparency = np.ones(num_rays)
    reads = np.zeros(num_rays, np.int64)
    position = np.zeros(num_rays, np.int64)
    longest = int(rays.count.max(initial=0))
    segment_colour, segment_transparency = irst(colours, opacities, longest)
    chessboard = np.abs(rays.step).max(axis=1)
    while True:
        active = np.flatnonzero(position < rays.count)
        if active.size == 0:
            return CastImage(colour, transparency, reads)
        voxels = voxels_at(rays.start[active] + position[active, None] * rays.step[active])
        value = values[voxels]
        if dimensions is None:
            leap = np.ones(active.size, np.int64)
        else:
            leap = np.floor(dimensions[voxels] / chessboard[active]).astype(np.int64)
            leap = np.minimum(np.maximum(leap, 1), rays.count[active] - position[active])
        colour[active] += transparency[active, None] * segment_colour[value, leap]
        transparency[active] *= segment_transparency[value, leap]
        reads[active] += 1
        position[active] += leap
