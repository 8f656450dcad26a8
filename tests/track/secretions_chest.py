"""The phantom chest with secretions in one of its bronchi: a fluid level, or a plug, over a known stretch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.volume import Volume

FLUID_HU = 15.0
AIR_HU = -1000.0
FINE = 4
"""Cells along each edge of a voxel: a level is not where voxels end."""


@dataclass(frozen=True)
class Secretions:
    """A volume, and what is true of it."""

    volume: Volume
    start_lps: NDArray[np.float64]
    """On the axis, where the fluid begins."""
    middle_lps: NDArray[np.float64]
    end_lps: NDArray[np.float64]
    calibre_mm: float
    """Inner wall to inner wall, in the middle of the stretch."""
    air_mm: float
    """Of the circle with the area of the air above the fluid there."""


def with_secretions(phantom, name: str, *, share: float, from_mm: float, length_mm: float) -> Secretions:
    """The phantom with fluid in a branch of its truth: the lowest (posterior) ``share`` of each section's height."""
    branch = next(one for one in phantom.truth["branches"] if one["name"] == name)
    points, radius = np.array(branch["points"]), np.array(branch["radius"])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    assert along[-1] > from_mm + length_mm, "the stretch ends within the branch"
    at = np.arange(from_mm, from_mm + length_mm, 0.1)
    axis = np.stack([np.interp(at, along, points[:, n]) for n in range(3)], axis=1)
    radii = np.interp(at, along, radius)
    volume = phantom.volume
    values = volume.hu_zyx.astype(np.float64)
    ijk = volume.to_ijk(axis)
    reach = np.ceil(radii.max() / np.array(volume.spacing_mm)) + 2
    low = np.floor(ijk.min(axis=0) - reach).astype(int)
    high = np.ceil(ijk.max(axis=0) + reach).astype(int)
    cells = (np.arange(FINE) + 0.5) / FINE - 0.5
    tangent = np.gradient(axis, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    for k in range(low[2], high[2] + 1):
        fine = np.stack(
            np.meshgrid(
                np.add.outer(np.arange(low[0], high[0] + 1), cells).ravel(),
                np.add.outer(np.arange(low[1], high[1] + 1), cells).ravel(),
                k + cells,
                indexing="ij",
            ),
            axis=-1,
        )
        places = volume.to_lps(fine.reshape(-1, 3))
        wet = np.zeros(len(places), dtype=bool)
        close = np.flatnonzero(np.abs(axis[:, 2] - places[:, 2].mean()) < radii.max() + 2.0)
        for n in close:
            off = places - axis[n]
            ahead = off @ tangent[n]
            inside = (np.abs(ahead) < 0.3) & ((off * off).sum(axis=1) <= radii[n] ** 2 + ahead**2)
            # A section across an airway that runs backwards is less high than wide along the patient's axes.
            height = (off[:, 1] - ahead * tangent[n, 1]) / max(np.sqrt(1.0 - tangent[n, 1] ** 2), 1e-3)
            wet |= inside & (height >= radii[n] * (1.0 - 2.0 * share))
        num_x, num_y = high[0] - low[0] + 1, high[1] - low[1] + 1
        part = wet.reshape(num_x, FINE, num_y, FINE, FINE).mean(axis=(1, 3, 4)).T
        values[k, low[1] : high[1] + 1, low[0] : high[0] + 1] += part * (FLUID_HU - AIR_HU)
    filled = Volume(np.round(np.minimum(values, np.maximum(volume.hu_zyx, 150))).astype(np.int16), volume.lps_from_ijk)
    middle = len(axis) // 2
    # The segment of a circle above its chord.
    angle = 2.0 * np.arccos(1.0 - 2.0 * (1.0 - share))
    air_mm = 2.0 * float(radii[middle]) * float(np.sqrt((angle - np.sin(angle)) / (2.0 * np.pi)))
    return Secretions(filled, axis[0], axis[middle], axis[-1], 2.0 * float(radii[middle]), air_mm)
