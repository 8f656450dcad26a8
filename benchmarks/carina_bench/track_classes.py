"""``carina bench track --only classes``: calibration of the confidence of branches by noise, kernel and slices.

Painted CTs of ``--only hard`` and phantoms get white or correlated noise. Each branch that the search finds has a
confidence. A branch is true if at least half of its points are within a voxel of a true lumen. The rows of each class
are the difference between the mean confidence and the share of true branches, and the expected calibration error over
ten bins.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.config import load_settings
from carina.errors import CarinaError, NoResultError
from carina.phantom import generate_phantom
from carina.track import AirwayTree, find_airways
from carina.volume import Volume
from carina_bench.track_confidence import calibration_error
from carina_bench.track_disturbed_cases import noisy
from carina_bench.track_hard_cases import KERNELS, OPTIONS, hard_cases
from carina_bench.track_painted import PATIENTS
from carina_bench.track_truth import Truth, truth_of_phantom

__all__ = ["CASES", "Judged", "are_true", "run"]

Say = Callable[[str], None]
Row = dict[str, Any]

NOISES: dict[str, tuple[float, float]] = {
    "25 HU": (25.0, 0.0),
    "60 HU white": (60.0, 0.0),
    "60 HU correlated": (60.0, 0.7),
    "100 HU white": (100.0, 0.0),
    "100 HU correlated": (100.0, 0.7),
}
"""Noise by name: standard deviation in HU, and sigma of its correlation in mm (0: white noise)."""
SLICES = ("0.7mm", "1.5mm", "2mm", "3mm")
"""Names of the slices of CTs with the least noise, 25 HU."""
FEWER_SLICES = ("0.7mm", "2mm")
"""Slices of CTs with more noise than 25 HU: for the soft and for the sharp kernel."""
PHANTOM_SEEDS = (1, 11)
"""Seeds of the phantoms in which the confidence of branches is compared with the truth."""
PHANTOM_PIXEL_MM = 0.8
"""Spacing of the phantoms in the plane of the slices, mm."""
PHANTOM_SLICES_MM = (0.8, 1.5, 2.0, 3.0)
"""Distances between slices of the phantoms, mm."""
MAX_ERROR = 0.05
"""Maximum difference of mean confidence and true share, and maximum calibration error, of a class of branches."""
CASES = (*PATIENTS, "phantoms")
"""Values that ``--case`` accepts: painted patients, or all phantoms."""


@dataclass(frozen=True, slots=True)
class Judged:
    """Branch that the search found in one CT: its confidence, and whether it is a true airway."""

    confidence: float
    is_true: bool
    classes: tuple[str, ...]
    """Names of the classes of the CT in which the branch was found: noise, kernel and slices."""


def run(quick: bool, say: Say, cases: Sequence[str] = ()) -> list[Row]:
    """Return two rows for each class: difference of means, and calibration error (see ``carina_bench.track``)."""
    judged: list[Judged] = []
    for name, classes, volume, truth in _cases(quick, say, cases):
        try:
            tree = find_airways(volume, progress=False).tree
        except CarinaError as error:
            say(f"{name}: {error}")
            continue
        own = [
            Judged(branch.confidence or 0.0, is_true, classes)
            for branch, is_true in zip(tree.branches, are_true(volume, truth, tree), strict=True)
        ]
        mean, share = np.mean([one.confidence for one in own]), np.mean([one.is_true for one in own])
        say(f"{name}: {len(own)} branches, {share:.2f} true, mean confidence {mean:.2f}")
        judged += own
    return list(_rows(judged))


def are_true(volume: Volume, truth: Truth, tree: AirwayTree) -> list[bool]:
    """Return for each branch of a tree whether it is a true airway.

    At least half of the points of a true airway are within a voxel of a true lumen.
    """
    spatial: Any = import_module("scipy.spatial")
    points = np.concatenate([branch.points for branch in truth.branches])
    radius: NDArray[np.float64] = np.concatenate([branch.radius_mm for branch in truth.branches])
    nearest = spatial.cKDTree(points)
    voxel_mm = float(np.cbrt(np.prod(volume.spacing_mm)))
    last = np.array(volume.shape_zyx[::-1]) - 1
    found = []
    for branch in tree.branches:
        off_mm, at = nearest.query(branch.points)
        i, j, k = np.clip(np.floor(volume.to_ijk(branch.points) + 0.5).astype(int), 0, last).T
        is_near = truth.lumen_zyx[k, j, i] | (off_mm <= radius[at] + voxel_mm)
        found.append(bool(is_near.mean() >= 0.5))
    return found


def _rows(judged: Sequence[Judged]) -> Iterator[Row]:
    for name in dict.fromkeys(name for one in judged for name in one.classes):
        own = [one for one in judged if name in one.classes]
        shares = np.array([one.confidence for one in own])
        hits = np.array([one.is_true for one in own], np.float64)
        note = f"{len(own)} branches, {hits.mean():.3f} true, mean confidence {shares.mean():.3f}"
        for what, figure in (
            ("mean confidence beside the share that is true", abs(float(shares.mean() - hits.mean()))),
            ("expected calibration error", calibration_error(shares, hits)),
        ):
            row: Row = {"what": what, "case": name, "figure": figure, "limit": MAX_ERROR, "better": "lower"}
            yield row | {"aim": True, "note": note}


def _cases(quick: bool, say: Say, cases: Sequence[str]) -> Iterator[tuple[str, tuple[str, ...], Volume, Truth]]:
    data = load_settings().data_dir
    if data is None or not data.is_dir():
        raise NoResultError("no masks to paint CTs from: CARINA_DATA_DIR names no folder")
    patients = [name for name in PATIENTS if not cases or name in cases][: 1 if quick else None]
    for kernel in KERNELS:
        for case in hard_cases(data, patients, (kernel,), SLICES, say):
            for noise, (noise_hu, sigma_mm) in NOISES.items():
                more_hu = float(np.sqrt(max(noise_hu**2 - OPTIONS.noise_hu**2, 0.0)))
                if more_hu > 0.0 and kernel != "medium" and case.slices not in FEWER_SLICES:
                    continue
                name = f"{case.name} {noise}"
                seed = zlib.crc32(name.encode()) % 10_000
                volume = case.volume if more_hu == 0.0 else noisy(case.volume, more_hu, seed=seed, sigma_mm=sigma_mm)
                yield name, (f"noise {noise}", f"kernel {kernel}", f"slices {case.slices}"), volume, case.truth
    if cases and "phantoms" not in cases:
        return
    for number in PHANTOM_SEEDS[: 1 if quick else None]:
        for slice_mm in PHANTOM_SLICES_MM:
            spacing_mm = (PHANTOM_PIXEL_MM, PHANTOM_PIXEL_MM, slice_mm)
            made = generate_phantom(seed=number, spacing_mm=spacing_mm, noise_hu=0.0)
            truth = truth_of_phantom(made.truth, made.lumen_zyx, made.volume)
            for noise, (noise_hu, sigma_mm) in NOISES.items():
                name = f"phantom {number} {slice_mm:g}mm {noise}"
                volume = noisy(made.volume, noise_hu, seed=zlib.crc32(name.encode()) % 10_000, sigma_mm=sigma_mm)
                slices = SLICES[PHANTOM_SLICES_MM.index(slice_mm)]
                yield name, (f"noise {noise}", "kernel of phantoms", f"slices {slices}"), volume, truth
