"""Sharpness of a CT's reconstruction kernel, measured by the undershoot that an edge-enhancing kernel leaves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.track.find.root_checks import LUNG_HU
from carina.track.intensity_levels import AirScale
from carina.volume.model import Volume

TISSUE_HU, EDGE_HU = -300.0, -500.0
# Distance in mm from an edge within which the undershoot of a sharp reconstruction kernel is measured.
RIM_MM = 2.3
# Distances in mm from an edge between which undisturbed lung is measured.
LUNG_FROM_MM, LUNG_TO_MM = 4.0, 7.0
# Maximum voxel size in mm at which undershoot is measured; longer voxels average it away.
MAX_VOXEL_MM = 1.6
# Approximate number of voxels per axis in which edges are searched.
NUM_VOXELS = 400_000
# Number of edges below which the sharpness of the kernel is not measured.
MIN_EDGES = 150


def edge_undershoot_hu(volume: Volume, scale: AirScale) -> float | None:
    """Measure how much darker lung is just beside soft tissue than a few millimetres farther away, in HU.

    Blur makes lung beside tissue brighter, so a CT with a soft kernel has no undershoot (about 0, or less). An
    edge-enhancing kernel produces a dark rim along every vessel and along the pleura. Like the lumen of a small
    airway, the rim is closed by tissue on one side and by brighter lung on the other; its depth is the contrast by
    which it resembles an airway.

    Returns
    -------
    float or None
        Mean of the medians over edges along the two axes with most undershoot; None if there are too few edges or
        the voxels are too long.
    """
    found = sorted(depth for depth in undershoots_hu(volume, scale) if depth is not None)
    # The two largest are usually those of the axes in the slice: a kernel sharpens there, less across slices.
    return None if not found else float(np.mean(found[-2:]))


def undershoots_hu(volume: Volume, scale: AirScale) -> tuple[float | None, float | None, float | None]:
    """Measure the undershoot beside soft tissue along i, j and k, in HU.

    A value is None if there are too few edges or the voxels are too long.
    """
    x, y, z = (
        _undershoot_along(volume.hu_zyx, 2 - axis, spacing_mm, scale) if spacing_mm <= MAX_VOXEL_MM else None
        for axis, spacing_mm in enumerate(volume.spacing_mm)
    )
    return x, y, z


def _undershoot_along(values: NDArray[np.int16], axis: int, voxel_mm: float, scale: AirScale) -> float | None:
    lines = np.moveaxis(values, axis, -1)
    every = max(int(np.sqrt(lines.size / NUM_VOXELS)), 1)
    lines = np.ascontiguousarray(lines[every // 2 :: every, every // 2 :: every])
    # The rim has at least two voxels and ends before the lung begins.
    num_rim = max(int(RIM_MM / voxel_mm), 2)
    first = max(int(np.ceil(LUNG_FROM_MM / voxel_mm)), num_rim + 1)
    last = max(int(LUNG_TO_MM / voxel_mm), first + 1)
    tissue, edge = scale.level(TISSUE_HU), scale.level(EDGE_HU)
    lung_from, lung_to = scale.level(LUNG_HU[0]), scale.level(LUNG_HU[1])
    length = lines.shape[-1]
    if length < last + 3:
        return None
    depths = []
    for way in (lines, lines[..., ::-1]):
        # An edge is tissue, then at most one voxel in between, then a voxel that is not tissue.
        is_tissue = way >= tissue
        ahead = way < edge
        steps = is_tissue[..., : length - last - 1] & ~is_tissue[..., 1 : length - last]
        steps &= ahead[..., 1 : length - last] | ahead[..., 2 : length - last + 1]
        row, line, at = np.nonzero(steps)
        at = at + np.where(ahead[row, line, at + 1], 0, 1)
        profile = np.stack([way[row, line, at + n] for n in range(1, last + 1)], axis=1).astype(np.float64)
        lung = profile[:, first - 1 :].mean(axis=1)
        usable = (lung >= lung_from) & (lung <= lung_to) & (profile < edge).all(axis=1)
        depths.append(lung[usable, None] - profile[usable, :num_rim])
    depth = np.concatenate(depths)
    if len(depth) < MIN_EDGES:
        return None
    return float(np.median(depth, axis=0).max()) / scale.span(1.0)
