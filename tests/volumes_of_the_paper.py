"""Small volumes for comparisons with the paper: parts of LIDC2 and headsq, an airway, and random blocks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from carina import open_volume
from carina.volume import Volume

FOLDER = "ct/head_and_lidc2_8bit"
"""Folder of the real volumes below the data folder."""


def part_of(volume: Volume, first_ijk: tuple[int, int, int], shape_ijk: tuple[int, int, int]) -> Volume:
    """Return a box of voxels of a volume at the same position in space."""
    i, j, k = first_ijk
    ni, nj, nk = shape_ijk
    lps_from_ijk = volume.lps_from_ijk.copy()
    lps_from_ijk[:3, 3] = volume.to_lps(np.array(first_ijk, dtype=np.float64))
    return Volume(np.ascontiguousarray(volume.hu_zyx[k : k + nk, j : j + nj, i : i + ni]), lps_from_ijk)


def in_8_bits(volume: Volume) -> Volume:
    """Return a volume whose values are scaled to 0 to 255, as in the paper."""
    low, high = int(volume.hu_zyx.min()), int(volume.hu_zyx.max())
    scaled = np.rint((volume.hu_zyx.astype(np.float64) - low) * (255.0 / (high - low)))
    return Volume(scaled.astype(np.int16), volume.lps_from_ijk)


def lidc2(data_dir: Path, first_ijk: tuple[int, int, int], shape_ijk: tuple[int, int, int]) -> Volume:
    """Return a part of LIDC2, a chest CT of 8 bits."""
    return part_of(open_volume(data_dir / FOLDER / "LIDC2_256x256x133_uint8.mha"), first_ijk, shape_ijk)


def headsq(data_dir: Path, first_ijk: tuple[int, int, int], shape_ijk: tuple[int, int, int]) -> Volume:
    """Return a part of headsq, a CT of a head with values from 0 to 3926 on an oblique grid."""
    return part_of(open_volume(data_dir / FOLDER / "headsq_64x64x93_int16.mha"), first_ijk, shape_ijk)


def random_blocks(seed: int, shape_zyx: tuple[int, int, int], num_values: int) -> NDArray[np.int16]:
    """Return values of random boxes, so that regions of many sizes touch each other and the border of the volume."""
    rng = np.random.default_rng(seed)
    values = np.full(shape_zyx, rng.integers(num_values), dtype=np.int16)
    for _ in range(int(rng.integers(0, 12))):
        box = tuple(slice(*sorted(rng.integers(0, n + 1, 2))) for n in shape_zyx)
        values[box] = rng.integers(num_values)
    speckled = rng.random(shape_zyx) < rng.choice([0.0, 0.002, 0.05])
    values[speckled] = rng.integers(num_values, size=int(speckled.sum()))
    return values
