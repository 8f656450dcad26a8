"""Detection of metal streaks in a CT, and of the voxels that they change.

Streaks are in the slices that contain metal and are straight lines from it. On circles round the metal, dark and
bright alternate in the same way at every distance; nothing in a chest has this pattern (docs/decisions/0135).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.track.intensity_levels import AirScale
from carina.volume.model import Volume

Plane = NDArray[np.int16]
Mask = NDArray[np.bool_]
Floats = NDArray[np.float32]

METAL_HU = 2000.0
"""Minimum value in HU of metal; surgical clips, dense contrast medium and tooth enamel are brighter."""
MIN_METAL_HU = 1000.0
"""Minimum value in HU of metal in a file whose values have a smaller range.

Voxels at the highest value of such a file may be metal if that value is at least this.
"""
MIN_METAL_MM2 = 0.4
JOINED_MM = 4.0
"""Size in mm of the grid cells that join voxels of metal: voxels in adjacent cells are one piece of metal."""
MAX_PIECES = 5
"""Maximum number of pieces of metal that are examined per slice, the largest first."""

NUM_DIRECTIONS = 180
FROM_MM, TO_MM, STEP_MM = 3.0, 120.0, 1.0
LOWEST_HU, HIGHEST_HU = -1024.0, 300.0
"""Range in HU to which values are clipped, so that metal and bone do not dominate the comparison."""
ROUND_DEG = 24.0
"""Width in degrees of the range of directions whose median is compared with the direction in its middle."""
ALONG_MM = 20.0
"""Distance in mm over which a streak must differ from its surroundings (in the median)."""
STREAK_HU = 60.0
# Distance in mm from metal within which the directions of streaks are counted first.
BESIDE_MM = 18.0
# Least share of directions with a streak within BESIDE_MM. Most clips have 20 % or more. Dense contrast medium, calcium
# and catheters have at most 5 % (552 slices of four CTs), noise of 180 HU has 16 %.
MIN_SHARE = 0.18
# Least share of directions with a streak at the end of the changed part; slices without metal have at most 9 % from 18
# to 38 mm.
MIN_SHARE_FAR = 0.2
SAME_MM = 2.0
"""Distance in mm from a slice with streaks within which other slices contain a part of the streaks."""


def find_streaks(volume: Volume, scale: AirScale) -> Mask | None:
    """Find the part (nz, ny, nx) of a CT that metal streaks change; return None if there are no streaks.

    Parameters
    ----------
    volume
        Volume in canonical order: slices from the feet up.
    scale
        Conversion from HU to the values of the volume.
    """
    metal = min(scale.level(METAL_HU), volume.value_range[1])
    if metal < scale.level(MIN_METAL_HU):
        return None
    dx, dy, dz = volume.spacing_mm
    reach = max(round(SAME_MM / dz), 1)
    region: Mask | None = None
    for k, plane in enumerate(volume.hu_zyx):
        if int(plane.max()) < metal:
            continue
        for centre in _pieces(plane >= metal, (dy, dx)):
            radius_mm = _radius_mm(plane, centre, (dy, dx), scale)
            if radius_mm is None:
                continue
            region = np.zeros(volume.shape_zyx, np.bool_) if region is None else region
            j, i = (np.arange(n) - at for n, at in zip(plane.shape, centre, strict=True))
            disc = np.hypot(j[:, None] * dy, i[None, :] * dx) <= radius_mm
            region[max(k - reach, 0) : k + reach + 1] |= disc
    return region


def _pieces(metal: Mask, step_mm: tuple[float, float]) -> list[tuple[float, float]]:
    """Return the centres (j, i) of the largest pieces of metal in a slice."""
    voxels = np.argwhere(metal)
    cells: dict[tuple[int, int], list[int]] = {}
    for n, (j, i) in enumerate(np.floor(voxels * step_mm / JOINED_MM).astype(int).tolist()):
        cells.setdefault((j, i), []).append(n)
    pieces: list[list[int]] = []
    while cells:
        waiting = [cells.popitem()]
        own: list[int] = []
        while waiting:
            (j, i), members = waiting.pop()
            own += members
            for by in np.ndindex(3, 3):
                beside = (j + by[0] - 1, i + by[1] - 1)
                if beside in cells:
                    waiting.append((beside, cells.pop(beside)))
        pieces.append(own)
    pieces = [own for own in pieces if len(own) * step_mm[0] * step_mm[1] >= MIN_METAL_MM2]
    pieces.sort(key=lambda own: (-len(own), min(own)))
    centres = [voxels[own].mean(axis=0) for own in pieces[:MAX_PIECES]]
    return [(float(j), float(i)) for j, i in centres]


def _radius_mm(
    plane: Plane, centre: tuple[float, float], step_mm: tuple[float, float], scale: AirScale
) -> float | None:
    """Return the radius (mm) within which a piece of metal causes streaks in a slice; None if it causes none."""
    # Most metal causes no streaks: test close to it first, to avoid sampling the rest of the slice.
    close = np.arange(FROM_MM, BESIDE_MM + ALONG_MM, STEP_MM)
    share = _share_of_streaks(plane, centre, close, step_mm, scale)
    if share[close <= BESIDE_MM].mean() < MIN_SHARE:
        return None
    away = np.arange(FROM_MM, TO_MM, STEP_MM)
    share = _share_of_streaks(plane, centre, away, step_mm, scale)
    ends = np.flatnonzero((share < MIN_SHARE_FAR) & (away > BESIDE_MM))
    return float(away[int(ends[0])]) if len(ends) else TO_MM


def _share_of_streaks(
    plane: Plane,
    centre: tuple[float, float],
    away: NDArray[np.float64],
    step_mm: tuple[float, float],
    scale: AirScale,
) -> NDArray[np.float64]:
    """Return the share of directions that are brighter or darker than the directions beside them, at each distance."""
    turns = 2.0 * np.pi * np.arange(NUM_DIRECTIONS) / NUM_DIRECTIONS
    j = np.rint(centre[0] + np.sin(turns)[:, None] * away / step_mm[0]).astype(int)
    i = np.rint(centre[1] + np.cos(turns)[:, None] * away / step_mm[1]).astype(int)
    inside = (j >= 0) & (j < plane.shape[0]) & (i >= 0) & (i < plane.shape[1])
    seen = plane[np.clip(j, 0, plane.shape[0] - 1), np.clip(i, 0, plane.shape[1] - 1)].astype(np.float32)
    seen = np.clip(seen, scale.level(LOWEST_HU), scale.level(HIGHEST_HU)) / np.float32(scale.span(1.0))
    usual = _running_median(seen, round(0.5 * ROUND_DEG / 360.0 * NUM_DIRECTIONS), axis=0, mode="wrap")
    streaks = _running_median(seen - usual, round(0.5 * ALONG_MM / STEP_MM), axis=1, mode="edge")
    return np.asarray((inside & (np.abs(streaks) >= STREAK_HU)).mean(axis=0), np.float64)


def _running_median(values: Floats, reach: int, *, axis: int, mode: str) -> Floats:
    padding = [(reach, reach) if n == axis else (0, 0) for n in range(2)]
    padded = np.pad(values, padding, mode="wrap" if mode == "wrap" else "edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis=axis)
    return np.asarray(np.partition(windows, reach, axis=-1)[..., reach], np.float32)
