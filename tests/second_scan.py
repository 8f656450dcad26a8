"""Second CT of a phantom in another breath, for tests of the measured movement."""

from __future__ import annotations

import hashlib
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from cached_test_data import cached_value, name_of
from carina.volume import Volume, write_grid
from carina_bench import breathing

__all__ = ["write_second_ct"]


@cache
def digest_of_the_deformation() -> str:
    """Return a digest of the benchmark's module that deforms the CT, which is not part of the package."""
    return hashlib.sha256(Path(breathing.__file__).read_bytes()).hexdigest()[:8]


def write_second_ct(volume: Volume, path: Path) -> Path:
    """Write a phantom's CT in another breath to a compressed file, and return its path.

    The main carina is near the origin. The deformation takes up to 13 s of CPU time; all workers share the file.
    """

    def make() -> bytes:
        second = breathing.breathed(volume, breathing.random_breath(np.zeros(3), seed=5), seed=5)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "second.nii.gz"
            write_grid(file, second.hu_zyx, second.lps_from_ijk, what="the second CT")
            return file.read_bytes()

    path.write_bytes(cached_value(f"second CT of {name_of(volume)} {digest_of_the_deformation()}", make))
    return path
