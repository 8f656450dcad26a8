"""Second CT of a phantom in another breath, for tests of the measured movement."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from carina.volume import Volume, write_grid
from carina_bench.breathing import breathed, random_breath

__all__ = ["write_second_ct"]


def write_second_ct(volume: Volume, path: Path) -> Path:
    """Write a phantom's CT in another breath to a file, and return its path; the main carina is near the origin."""
    second = breathed(volume, random_breath(np.zeros(3), seed=5), seed=5)
    write_grid(path, second.hu_zyx, second.lps_from_ijk, what="the second CT")
    return path
