"""``carina bench track --only hard``: the automatically found airways in painted CTs that are hard to search.

Tree length detected (TD) and branches detected (BD) are defined as in ``--only quality``. Precision within a voxel is
the share of the found voxels that contain lumen or touch a voxel that contains lumen. The contrast-to-noise ratio of
the missed lumens is the median over points along them. The contrast is the difference between the weakest quarter of
the surrounding wall (the lower quartile of a ring, the brightest of several rings) and the axis, in the same CT without
noise.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from carina.config import load_settings
from carina.errors import CarinaError, NoResultError
from carina.track import find_airways
from carina.track.find import growth
from carina.track.find.kernel_compensation import SOFT_HU
from carina.track.find.kernel_sharpness import edge_undershoot_hu
from carina.track.intensity_levels import air_scale
from carina.volume import Volume
from carina_bench.track_hard_cases import KERNELS, QUICK, SLICES, HardCase, hard_cases
from carina_bench.track_painted import PATIENTS
from carina_bench.track_quality import DETECTED_SHARE, centreline_figures, is_near
from carina_bench.track_truth import Truth

__all__ = ["AIMS", "CASES", "WITHOUT_SOFTENING", "Detected", "Missed", "detected_airways", "run", "within_a_voxel"]

Say = Callable[[str], None]
Row = dict[str, Any]

CALIBRES_MM = (0.45, 0.6, 0.8, 1.0, 1.5)
"""Lower limits of the classes of true radius, mm; the last class has no upper limit."""
WITHOUT_SOFTENING = "without-softening"
"""Name of the variant of the search that does not compensate sharp reconstruction kernels."""
CASES = (*PATIENTS, *KERNELS, *SLICES, WITHOUT_SOFTENING)
"""Values that ``--case`` accepts.

They are patients, kernels and slices (all if none of the kind is given), and the variant of the search.
"""

AIMS: dict[tuple[str, str], tuple[float, float]] = {
    **{(kernel, mm): (0.975, 0.95) for kernel in ("soft", "medium") for mm in ("0.7mm", "1mm")},
    **{("sharp", mm): (0.94, 0.88) for mm in ("0.7mm", "1mm")},
    **{(kernel, "1.5mm"): (0.94, 0.88) for kernel in KERNELS},
    **{(kernel, "2mm"): (0.88, 0.78) for kernel in KERNELS},
    **{(kernel, "2.5mm"): (0.82, 0.70) for kernel in KERNELS},
    **{(kernel, "3mm"): (0.75, 0.62) for kernel in KERNELS},
}
"""Minimum TD and BD, as means of the patients, by kernel and slice thickness."""
MIN_PRECISION = 0.98
"""Minimum share of the found lumen's voxels that are within a voxel of the true lumen."""
MAX_FALSE_MEDIAN, MAX_FALSE = 1, 3
"""Maximum number of false branches of a case: median over the cases, and of any case."""
RING_MM = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Distances in mm, outwards from the true wall of a missed lumen, of the rings on which its wall is searched."""
NUM_MISSED = 600
"""Approximate number of missed points at which the contrast is measured."""
NUM_DIRECTIONS = 12
"""Number of points of a ring around a missed lumen, at which its wall is examined."""


def run(quick: bool, say: Say, cases: Sequence[str] = ()) -> list[Row]:
    """Return a row for each patient, kernel and slice thickness, then the means over patients with the aims.

    Parameters
    ----------
    cases
        Cases to measure, of :data:`CASES`. If no patient, no kernel or no slices are named, all of them are measured.
    """
    data = load_settings().data_dir
    if data is None or not data.is_dir():
        raise NoResultError("no masks to paint CTs from: CARINA_DATA_DIR names no folder")

    def chosen(known: Sequence[str], short: Sequence[str]) -> list[str]:
        return [name for name in known if name in cases] or list(short if quick else known)

    patients = chosen(PATIENTS, PATIENTS[:1])
    kernels, slices = chosen(tuple(KERNELS), QUICK[:1]), chosen(tuple(SLICES), QUICK[1:])
    rows: list[Row] = []
    with _softening(WITHOUT_SOFTENING not in cases):
        for case in hard_cases(data, patients, kernels, slices, say, is_quick=quick):
            row = _measured(case)
            say(f"{row['case']}: {row['note']}")
            rows.append(row)
    return rows + _means(rows)


@contextmanager
def _softening(is_on: bool) -> Iterator[None]:
    """Disable the kernel compensation of the search in this context, unless ``is_on``.

    The compensation softens images of medium and sharp kernels.
    """
    with patch.object(growth, "SOFT_HU", SOFT_HU if is_on else 1e9):
        yield


def _measured(case: HardCase) -> Row:
    row: Row = {"what": "TD", "case": case.name, "condition": f"{case.kernel} {case.slices}", "figure": None}
    row["rim_hu"] = edge_undershoot_hu(case.volume, air_scale(case.volume))
    started = time.process_time()
    try:
        airways = find_airways(case.volume, progress=False)
    except CarinaError as error:
        return row | {"td": 0.0, "bd": 0.0, "precision": None, "false_branches": 0, "note": str(error)}
    row["cpu_seconds"] = time.process_time() - started
    detected = detected_airways(case.volume, case.truth, airways.lumen_zyx != 0)
    missed = [one for one in detected.missed if len(one.points)]
    row |= {
        "figure": detected.td,
        "td": detected.td,
        "bd": detected.bd,
        "true_branches": len(case.truth.branches),
        "precision": within_a_voxel(airways.lumen_zyx != 0, case.truth.touched_zyx),
        "false_branches": centreline_figures(case.volume, case.truth, airways)["false_branches"],
        "td_by_radius_mm": detected.by_radius_mm,
        "missed_contrast_to_noise": _contrast_to_noise(case, missed),
    }
    row["note"] = _note(row)
    return row


def _note(row: Row) -> str:
    curve = ", ".join(f"{size} {100.0 * share:.0f} %" for size, share in row["td_by_radius_mm"].items())
    floor, rim = row["missed_contrast_to_noise"], row["rim_hu"]
    rim_text = "not measured" if rim is None else f"{rim:.1f} HU"
    floor_text = "not measured" if floor is None else f"{floor:.1f}"
    return (
        f"TD {100.0 * row['td']:.1f} %, BD {100.0 * row['bd']:.1f} % of {row['true_branches']}, "
        f"precision within a voxel {row['precision']:.4f}, false branches {row['false_branches']}, rim {rim_text}; "
        f"TD by radius in mm: {curve}; contrast to noise of missed lumens {floor_text}; {row['cpu_seconds']:.0f} s CPU"
    )


def within_a_voxel(found_zyx: NDArray[np.bool_], touched_zyx: NDArray[np.bool_] | None) -> float:
    """Return the share of the found voxels that contain lumen or are among the 26 neighbours of such a voxel."""
    assert touched_zyx is not None
    near = touched_zyx.copy()
    for axis in range(3):
        before = np.moveaxis(near.copy(), axis, 0)
        after = np.moveaxis(near, axis, 0)
        after[1:] |= before[:-1]
        after[:-1] |= before[1:]
    return float((found_zyx & near).sum()) / max(float(found_zyx.sum()), 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Missed:
    """Points of a true branch that the found lumen does not contain."""

    points: NDArray[np.float64]
    """Points (n, 3) of the branch outside the lumen that was found, LPS mm."""
    radius_mm: NDArray[np.float64]
    course: NDArray[np.float64]
    """Unit vectors (n, 3) along the branch at the points, LPS."""


@dataclass(frozen=True, slots=True, eq=False)
class Detected:
    """Shares of the true airways that the found lumen contains, and the missed points."""

    td: float
    bd: float
    by_radius_mm: dict[str, float]
    """Share of the true length that was found, by class of true radius (the calibre curve)."""
    missed: tuple[Missed, ...]
    """Missed points of each true branch."""


def detected_airways(volume: Volume, truth: Truth, found_zyx: NDArray[np.bool_]) -> Detected:
    """Return the share of the true airways that was found, with the definitions of ``--only quality``."""
    length = np.zeros((2, len(CALIBRES_MM)))
    num_found = 0
    missed = []
    for branch in truth.branches:
        inside = is_near(found_zyx, volume, branch.points, 0.5 * max(volume.spacing_mm))
        step = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
        hits = step * 0.5 * (inside[1:].astype(float) + inside[:-1])
        radius = 0.5 * (branch.radius_mm[1:] + branch.radius_mm[:-1])
        size = np.maximum(np.searchsorted(CALIBRES_MM, radius + 1e-9, side="right") - 1, 0)
        length += [np.bincount(size, weights, len(CALIBRES_MM)) for weights in (hits, step)]
        num_found += bool(hits.sum() >= DETECTED_SHARE * step.sum())
        course = np.gradient(branch.points, axis=0)
        missed.append(Missed(branch.points[~inside], branch.radius_mm[~inside], course[~inside]))
    names = [f"{low:g}-{high:g}" for low, high in pairwise(CALIBRES_MM)]
    names.append(f">{CALIBRES_MM[-1]:g}")
    curve = {n: round(float(hit / whole), 4) for n, hit, whole in zip(names, *length, strict=True) if whole > 0.0}
    td = float(length[0].sum() / length[1].sum())
    return Detected(td, num_found / len(truth.branches), curve, tuple(missed))


def _contrast_to_noise(case: HardCase, missed: Sequence[Missed]) -> float | None:
    """Return the median of (wall - axis) / noise over missed points, with all values in HU.

    The result is None if no point is missed.
    """
    if not missed:
        return None
    every = max(sum(len(one.points) for one in missed) // NUM_MISSED, 1)
    points = np.concatenate([one.points for one in missed])[::every]
    radii = np.concatenate([one.radius_mm for one in missed])[::every]
    courses = np.concatenate([one.course for one in missed])[::every]
    courses = courses / np.maximum(np.linalg.norm(courses, axis=1, keepdims=True), 1e-12)
    other = np.where(np.abs(courses[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    one = np.cross(courses, other)
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two = np.cross(courses, one)
    turns = 2.0 * np.pi * np.arange(NUM_DIRECTIONS) / NUM_DIRECTIONS
    rings = []
    for beyond in RING_MM:
        values = [
            _values(case, points + (radii + beyond)[:, None] * (np.cos(turn) * one + np.sin(turn) * two))
            for turn in turns
        ]
        rings.append(np.percentile(values, 25.0, axis=0))
    contrast = np.max(rings, axis=0) - _values(case, points)
    noise = float((case.volume.hu_zyx.astype(np.float32) - case.clean_zyx).std())
    return float(np.median(contrast)) / max(noise, 1e-6)


def _values(case: HardCase, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the CT values without noise at points (n, 3), LPS mm, by linear interpolation, HU."""
    ijk = case.volume.to_ijk(points)
    last = np.array(case.clean_zyx.shape[::-1]) - 1
    ijk = np.clip(ijk, 0.0, last - 1e-6)
    base = np.minimum(ijk.astype(int), np.maximum(last - 1, 0))
    share = ijk - base
    result = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        i, j, k = (base + corner).T
        weight = np.prod(np.where(corner, share, 1.0 - share), axis=1)
        result += weight * case.clean_zyx[k, j, i]
    return result


def _means(rows: Sequence[Row]) -> list[Row]:
    """Return rows with the mean, median, least or most of the patients of each condition, and the limits to reach."""
    result: list[Row] = []
    for condition in dict.fromkeys(row["condition"] for row in rows):
        own = [row for row in rows if row["condition"] == condition]
        kernel, slices = condition.split(" ")
        aims = AIMS.get((kernel, slices), (None, None))
        case = f"{condition}, patients: {len(own)}"
        for what, aim in zip(("td", "bd"), aims, strict=True):
            row: Row = {
                "what": f"{what.upper()}, mean",
                "case": case,
                "figure": float(np.mean([one[what] for one in own])),
            }
            result.append(row if aim is None else row | {"limit": aim, "aim": True})
        precisions = [one["precision"] for one in own if one["precision"] is not None]
        if precisions:
            row = {"what": "precision within a voxel, least", "case": case, "figure": min(precisions)}
            result.append(row | {"limit": MIN_PRECISION, "aim": True})
        num_false = [one["false_branches"] for one in own]
        for what, figure, limit in (
            ("false branches, median", float(np.median(num_false)), MAX_FALSE_MEDIAN),
            ("false branches, most", max(num_false), MAX_FALSE),
        ):
            row = {"what": what, "case": case, "figure": figure, "limit": limit, "better": "lower", "aim": True}
            result.append(row)
    return result
