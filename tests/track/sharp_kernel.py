"""CTs as a sharp reconstruction kernel would show them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from carina.volume import Volume

SIGMA_VOX = 1.2
"""Standard deviation of the blur of the unsharp mask, voxels."""


def sharpened(volume: Volume, amount: float, noise_hu: float = 0.0, *, seed: int = 1) -> Volume:
    """Return the volume with noise and an unsharp mask: ``values + amount * (values - blurred)``."""
    values = volume.hu_zyx.astype(np.float32)
    if noise_hu > 0.0:
        values += np.float32(noise_hu) * np.random.default_rng(seed).standard_normal(values.shape, dtype=np.float32)
    if amount > 0.0:
        values += amount * (values - _blurred(values))
    hu = np.clip(np.rint(values), -1024, 3071).astype(np.int16)
    hu.flags.writeable = False
    return replace(volume, hu_zyx=hu)


def _blurred(values: NDArray[np.float32]) -> NDArray[np.float32]:
    reach = 4
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / SIGMA_VOX) ** 2)
    weights = (weights / weights.sum()).astype(np.float32)
    for axis in range(3):
        edges = [(reach, reach) if a == axis else (0, 0) for a in range(3)]
        padded = np.moveaxis(np.pad(values, edges, mode="edge"), axis, 0)
        length = values.shape[axis]
        blurred = np.zeros_like(np.moveaxis(values, axis, 0))
        for n, weight in enumerate(weights):
            blurred += weight * padded[n : n + length]
        values = np.moveaxis(blurred, 0, axis)
    return values


def grown(lumen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a lumen with all voxels that share a face with one of its voxels."""
    wide = lumen.copy()
    for axis in range(3):
        a, b = np.moveaxis(wide, axis, 0), np.moveaxis(lumen, axis, 0)
        a[1:] |= b[:-1]
        a[:-1] |= b[1:]
    return wide
