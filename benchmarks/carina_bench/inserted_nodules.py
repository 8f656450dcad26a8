"""``python -m carina_bench.inserted_nodules CT ...``: volume, noise and edges of nodules inserted into CTs.

Nodules of all kinds are inserted at random free positions. Their volume is measured from the difference of both CTs. A
classifier (logistic regression, own code) then tries to tell the boundaries of solid nodules from boundaries between
soft tissue and lung that the CT has around them, by the slope, width and overshoot of the edge and by the noise behind
it. *Unmatched* nodules are pasted without blur and noise; *real again* are other places on boundaries of the CT, which
show what the classifier finds by chance.

The comparison is one of blur and noise, not of shape. Therefore both classes contain only places where the boundary is
nearly flat, and each real place has the same direction across the slices as its partner. The mean features of a CT are
subtracted from all its samples, so that differences between CTs hide nothing. The classifier is trained and tested on
other nodules (cross-validation).
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import carina
from carina.errors import CarinaError
from carina.phantom import generate_phantom
from carina.plan.cubic_box import smoothed, trilinear
from carina.track import Airways
from carina.training import InsertedNodule, free_nodule_position, insert_nodule
from carina.training.insert_nodule import NoduleKind
from carina.training.nodule_shape import NoduleShape
from carina.volume import Volume
from carina_bench.paint import paint
from carina_bench.paint_scene import mask_folders, masks_of, scene_of_masks
from carina_bench.track_painted import CONDITIONS

__all__ = ["FEATURES", "area_under_curve", "cross_validated_scores", "edge_features", "measured_share", "pasted"]

Floats = NDArray[np.float64]

KINDS: tuple[NoduleKind, ...] = ("solid", "solid", "part-solid", "ground-glass")
DIAMETERS_MM, GLASS_DIAMETERS_MM = (18.0, 26.0), (6.0, 26.0)
"""Ranges of the inserted nodules' diameters in mm, solid and ground glass. Only solid nodules are classified."""
INSIDE_MM, MOST_SPREAD_HU = 6.5, 80.0
"""Depth in mm of the block of voxels in which noise is measured, and maximum range in HU of its smoothed values."""
SAME_TILT = 0.15
"""Maximum difference between a nodule's and a real edge in the component of their direction across slices.

Edges across thick slices are wider than edges in them.
"""
MAX_CANDIDATES = 20_000
SITES = 8
"""Number of positions on a nodule's boundary over which edge features are averaged."""
AROUND_MM = 45.0
"""Half side, in mm, of the part of a CT round a nodule in which real boundaries are searched."""
STEP_MM, REACH_MM = 0.25, 4.5
"""Step and half length in mm of the profile of values across an edge."""
FLAT_RADIUS_MM, FLAT_MM = 2.0, 0.5
"""Radius of the ring around a place on a boundary, and largest distance in mm of the boundary from its tangent plane.

The classifier compares blur and noise; spicules and corners would tell it the shape.
"""
TISSUE_HU, LUNG_HU, EDGE_HU = (-60.0, 140.0), -600.0, -400.0
"""Soft tissue, lung, and the boundary between them, HU."""
CLEAR_MM = 2.0
"""Distance in mm before a boundary beyond which the lung is free of other structures."""
FEATURES = ("slope", "width", "overshoot", "noise in the slice", "noise across slices", "grain")
CLASSES = ("matched", "unmatched", "real", "real again")
SPICULATION = 0.3
FOLDS = 5


def measured_share(before: Volume, made: InsertedNodule) -> float:
    """Return the inserted nodule's volume, measured from the CT before and after, as a share of its true volume."""
    change = made.volume.hu_zyx.astype(np.float64) - before.hu_zyx
    voxel_mm3 = abs(float(np.linalg.det(before.lps_from_ijk[:3, :3])))
    total = float(change.sum()) * voxel_mm3
    if made.kind == "ground-glass":
        return total / (made.density_hu - made.lung_hu) / made.volume_mm3
    shape = NoduleShape.of_volume(made.core_diameter_mm or made.diameter_mm, made.spiculation, made.seed)
    if made.core_diameter_mm is not None:
        # The known contribution of the ground glass is subtracted, so that the core alone is measured.
        glass = -600.0 - made.lung_hu
        core_mm3 = np.pi / 6.0 * made.core_diameter_mm**3
        total -= made.volume_mm3 * glass
        return total / (made.density_hu - _mean_inside(before, made, shape) - glass) / core_mm3
    return total / (made.density_hu - _mean_inside(before, made, shape)) / made.volume_mm3


def _mean_inside(volume: Volume, made: InsertedNodule, shape: NoduleShape) -> float:
    """Return the mean of a CT in the voxels of a shape."""
    nz, ny, nx = volume.shape_zyx
    ijk = np.rint(volume.to_ijk(np.array(made.centre_lps))).astype(int)
    half = [int(np.ceil(shape.reach_mm / s)) + 1 for s in volume.spacing_mm]
    low = np.maximum(ijk - half, 0)
    high = np.minimum(ijk + np.array(half) + 1, [nx, ny, nz])
    k, j, i = np.meshgrid(*(np.arange(low[a], high[a]) for a in (2, 1, 0)), indexing="ij")
    points = volume.to_lps(np.stack([i, j, k], axis=-1).astype(np.float64))
    inside = shape.contains(points - np.array(made.centre_lps))
    return float(volume.hu_zyx[low[2] : high[2], low[1] : high[1], low[0] : high[0]][inside].mean())


def pasted(volume: Volume, made: InsertedNodule) -> Volume:
    """Return the CT with the same nodule inserted without matching to the CT: whole voxels of one density."""
    shape = NoduleShape.of_volume(made.core_diameter_mm or made.diameter_mm, made.spiculation, made.seed)
    values = volume.hu_zyx.copy()
    ijk = np.rint(volume.to_ijk(np.array(made.centre_lps))).astype(int)
    half = [int(np.ceil(shape.reach_mm / s)) + 1 for s in volume.spacing_mm]
    part = tuple(slice(max(0, ijk[a] - half[a]), ijk[a] + half[a] + 1) for a in (2, 1, 0))
    k, j, i = np.meshgrid(*(np.arange(one.start, min(one.stop, size)) for one, size in
                            zip(part, volume.shape_zyx, strict=True)), indexing="ij")  # fmt: skip
    points = volume.to_lps(np.stack([i, j, k], axis=-1).astype(np.float64))
    values[part][shape.contains(points - np.array(made.centre_lps))] = round(made.density_hu)
    return Volume(values, volume.lps_from_ijk)


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Part of a CT round a nodule, with its smoothed values and their gradient."""

    values: NDArray[np.float32]
    soft: NDArray[np.float32]
    spacing_mm: tuple[float, float, float]
    first_ijk: NDArray[np.int64]

    @classmethod
    def around(cls, volume: Volume, centre_lps: Floats, half_mm: float) -> _Part:
        ijk = volume.to_ijk(centre_lps)
        size = np.array(volume.shape_zyx[::-1])
        half = half_mm / np.array(volume.spacing_mm)
        low = np.maximum(np.floor(ijk - half).astype(np.int64), 0)
        high = np.minimum(np.ceil(ijk + half).astype(np.int64) + 1, size)
        values = volume.hu_zyx[low[2] : high[2], low[1] : high[1], low[0] : high[0]].astype(np.float32)
        return cls(values, smoothed(values, 0.8), volume.spacing_mm, low)

    def at(self, mm: Floats) -> Floats:
        """Return values at positions (n, 3) in mm along i, j, k from the first voxel."""
        top = np.array(self.values.shape[::-1], dtype=np.float64) - 1.0
        ijk = np.clip(mm / np.array(self.spacing_mm), 0.0, top)
        return trilinear(self.values, ijk.T)

    def slope(self, mm: Floats) -> Floats:
        """Return the gradient (3,) of the smoothed values at a position, HU/mm along i, j, k."""
        top = np.array(self.soft.shape[::-1], dtype=np.float64) - 1.0
        found = np.empty(3)
        for axis in range(3):
            off = np.zeros(3)
            off[axis] = self.spacing_mm[axis]
            ends = np.stack([mm + off, mm - off]) / np.array(self.spacing_mm)
            high, low = trilinear(self.soft, np.clip(ends, 0.0, top).T)
            found[axis] = (high - low) / (2.0 * self.spacing_mm[axis])
        return found


def edge_features(part: _Part, mm: Floats) -> tuple[Floats, float] | None:
    """Return the features of the edge at a position, and its direction's component across slices.

    The result is None if there is no edge between homogeneous soft tissue and lung.
    """
    way = part.slope(mm)
    steep = float(np.linalg.norm(way))
    if steep < 40.0:
        return None
    way = way / steep
    off = np.arange(-REACH_MM, REACH_MM + 1e-9, STEP_MM)
    profile = part.at(mm + off[:, None] * way)
    if not _is_flat(part, mm, way):
        return None
    low, high = float(np.median(profile[off < -2.5])), float(np.median(profile[off > 2.5]))
    if not (low < LUNG_HU and TISSUE_HU[0] < high < TISSUE_HU[1]):
        return None
    # A vessel before the edge, or the ground glass round a core, would measure the anatomy instead of the blur.
    if profile[off < -CLEAR_MM].max() > 0.5 * (LUNG_HU + EDGE_HU):
        return None
    shares = (profile - low) / (high - low)
    slope = float(np.gradient(shares, STEP_MM).max())
    above = [float(off[int(np.argmax(shares >= level))]) for level in (0.25, 0.75)]
    overshoot = float(shares[(off > 0.0) & (off < 3.0)].max() - 1.0)
    inner = np.rint((mm + INSIDE_MM * way) / np.array(part.spacing_mm)).astype(int)
    i, j, k = inner
    nz, ny, nx = part.values.shape
    if not (4 <= i < nx - 4 and 4 <= j < ny - 4 and 2 <= k < nz - 2):
        return None
    place = (slice(k - 1, k + 2), slice(j - 2, j + 3), slice(i - 2, i + 3))
    flat = part.soft[place]
    # A block that reaches the edge of its structure would measure the shape instead of the noise.
    if flat.min() < TISSUE_HU[0] or flat.max() > TISSUE_HU[1] or np.ptp(flat) > MOST_SPREAD_HU:
        return None
    block = part.values[place].astype(np.float64)
    second = block[:, :, 2:] - 2.0 * block[:, :, 1:-1] + block[:, :, :-2]
    first = block[:, :, 1:] - block[:, :, :-1]
    across = block[1:] - block[:-1]
    fine, coarse, between = (float(np.sqrt(np.square(one - one.mean()).mean())) for one in (second, first, across))
    features = np.array([slope, above[1] - above[0], overshoot, np.log(fine + 1.0), np.log(between + 1.0),
                         np.log((fine + 1.0) / (coarse + 1.0))])  # fmt: skip
    return features, abs(float(way[2]))


def _is_flat(part: _Part, mm: Floats, way: Floats) -> bool:
    """Return whether the boundary near a position is nearly its tangent plane."""
    one = np.cross(way, (1.0, 0.0, 0.0) if abs(way[0]) < 0.8 else (0.0, 1.0, 0.0))
    one /= np.linalg.norm(one)
    other = np.cross(way, one)
    angles = np.arange(8) * np.pi / 4.0
    ring = FLAT_RADIUS_MM * (np.cos(angles)[:, None] * one + np.sin(angles)[:, None] * other)
    outer, inner = (part.at(mm + ring + off * way) for off in (-FLAT_MM, FLAT_MM))
    return bool((outer < EDGE_HU).all() and (inner > EDGE_HU).all())


def nodule_sample(
    volume: Volume, made: InsertedNodule, rng: np.random.Generator
) -> tuple[Floats, tuple[float, ...]] | None:
    """Return the mean features of some places on the boundary of a nodule, and the components across slices.

    The result is None if too few places are usable.
    """
    radius = (made.core_diameter_mm or made.diameter_mm) / 2.0
    centre = np.array(made.centre_lps)
    part = _Part.around(volume, centre, 2.0 * radius + 12.0)
    middle = (volume.to_ijk(centre) - part.first_ijk) * np.array(part.spacing_mm)
    found = []
    for _ in range(SITES * 30):
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)
        away = np.arange(0.3 * radius, 1.8 * radius, 0.2)
        ray = part.at(middle + away[:, None] * way)
        below = np.flatnonzero(ray < EDGE_HU)
        features = None if not len(below) else edge_features(part, middle + away[below[0]] * way)
        if features is not None:
            found.append(features)
        if len(found) == SITES:
            break
    if len(found) < SITES // 2:
        return None
    return np.mean([one for one, _ in found], axis=0), tuple(tilt for _, tilt in found)


def _candidates(part: _Part, rng: np.random.Generator) -> Floats:
    """Return positions (n, 3) in mm, in random order, of boundary voxels between soft tissue and lung."""
    edges = np.argwhere(np.abs(part.soft - EDGE_HU) < 120.0)[:, ::-1]
    size = np.array(part.values.shape[::-1])
    edges = edges[((edges > 0) & (edges < size - 1)).all(axis=1)]
    edges = edges[rng.permutation(len(edges))[:MAX_CANDIDATES]]

    def soft(ijk: NDArray[np.int64]) -> NDArray[np.float32]:
        i, j, k = np.clip(ijk, 0, size - 1).T
        return np.asarray(part.soft[k, j, i])

    way = np.stack([soft(edges + step) - soft(edges - step) for step in np.eye(3, dtype=int)], axis=1)
    way = way / (2.0 * np.array(part.spacing_mm))
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    behind, before = (soft(np.rint(edges + far * way / part.spacing_mm).astype(int)) for far in (INSIDE_MM, -REACH_MM))
    good = (behind > TISSUE_HU[0]) & (behind < TISSUE_HU[1]) & (before < EDGE_HU)
    return np.asarray(edges[good] * np.array(part.spacing_mm))


def real_sample(
    volume: Volume, made: InsertedNodule, tilts: tuple[float, ...], rng: np.random.Generator
) -> Floats | None:
    """Return the mean edge features of the CT's real boundaries round a nodule, and their components across slices."""
    part = _Part.around(volume, np.array(made.centre_lps), AROUND_MM)
    missing, found = list(tilts), []
    for at in _candidates(part, rng):
        features = edge_features(part, at)
        if features is None:
            continue
        near = [one for one in missing if abs(one - features[1]) <= SAME_TILT]
        if near:
            missing.remove(near[0])
            found.append(features[0])
        if not missing:
            break
    return np.mean(found, axis=0) if len(found) >= SITES // 2 else None


def _fitted(features: Floats, labels: Floats) -> Callable[[Floats], Floats]:
    """Return the function from features to scores of a ridge-penalised logistic regression (Newton's method)."""
    mean, spread = features.mean(axis=0), features.std(axis=0) + 1e-9
    x = np.column_stack([np.ones(len(features)), (features - mean) / spread])
    weights = np.zeros(x.shape[1])
    ridge = np.diag([0.0, *([1.0] * (x.shape[1] - 1))])
    for _ in range(30):
        chance = 1.0 / (1.0 + np.exp(-np.clip(x @ weights, -30.0, 30.0)))
        curve = x.T @ (x * (chance * (1.0 - chance))[:, None]) + ridge
        weights = weights + np.linalg.solve(curve, x.T @ (labels - chance) - ridge @ weights)
    return lambda other: np.asarray(np.column_stack([np.ones(len(other)), (other - mean) / spread]) @ weights)


def cross_validated_scores(features: Floats, labels: Floats, groups: NDArray[np.int64]) -> Floats:
    """Return the score of each sample by a classifier that was fitted without the samples of its fold."""
    scores = np.empty(len(labels))
    for fold in range(FOLDS):
        held = groups % FOLDS == fold
        if held.any():
            scores[held] = _fitted(features[~held], labels[~held])(features[held])
    return scores


def area_under_curve(scores: Floats, labels: Floats) -> float:
    """Return the probability that a sample of the class 1 has a higher score than one of the class 0."""
    high, low = scores[labels == 1.0][:, None], scores[labels == 0.0][None, :]
    return float(((high > low) + 0.5 * (high == low)).mean())


def centred(samples: list[tuple[int, int, Floats]], other: list[tuple[int, int, Floats]]) -> tuple[Floats, Floats]:
    """Return the features of two classes after the mean of each CT is subtracted.

    Parameters
    ----------
    samples, other
        CT, number of the nodule, and features (f,) of each sample of a class.
    """
    both = np.array([row for _, _, row in (*samples, *other)])
    case = np.array([ct for ct, _, _ in (*samples, *other)])
    for ct in np.unique(case):
        both[case == ct] -= both[case == ct].mean(axis=0)
    return both[: len(samples)], both[len(samples) :]


def main(arguments: list[str] | None = None) -> int:
    """Insert nodules into the CTs, print each as it ends, and print the volumes and the classifier's results."""
    parser = argparse.ArgumentParser(prog="python -m carina_bench.inserted_nodules", description=__doc__)
    parser.add_argument(
        "ct",
        nargs="+",
        help="folder or file of a CT, `patient` for the bundled one, "
        "phantom:SEED, or painted:PATIENT:CONDITION (masks in CARINA_DATA_DIR)",
    )
    parser.add_argument("--num", type=int, default=40, help="number of nodules in all CTs together")
    parser.add_argument("--seconds", type=float, default=math.inf, help="time after which no more nodules are inserted")
    options = parser.parse_args(arguments)
    end_s = time.monotonic() + options.seconds
    shares: list[float] = []
    samples: dict[str, list[tuple[int, int, Floats]]] = {name: [] for name in CLASSES}
    for case, name in enumerate(options.ct):
        if time.monotonic() > end_s:
            break
        volume, airways = _opened(name)
        for number in range(case, options.num, len(options.ct)):
            if time.monotonic() > end_s:
                break
            made = _inserted(volume, airways, number)
            if isinstance(made, CarinaError):
                print(f"CT {case} nodule {number}: refused, {made.code}", flush=True)
                continue
            share = measured_share(volume, made)
            shares.append(share)
            # The core of a part-solid nodule is in ground glass, and no other boundary of a CT is like its boundary.
            rows = _classes(volume, made, number) if made.kind == "solid" else None
            for kind, row in (rows or {}).items():
                samples[kind].append((case, number, row))
            texture, percent = made.texture, 100 * (share - 1.0)
            print(
                f"CT {case} nodule {number:2} {made.kind:12} {made.diameter_mm:4.1f} mm: volume {percent:+.1f} %, blur "
                f"{', '.join(f'{one:.2f}' for one in texture.sigma_mm)} mm, gain {texture.gain:.2f}, noise "
                f"{texture.noise_hu:.0f} HU{', without features' if made.kind == 'solid' and rows is None else ''}",
                flush=True,
            )
    worst = max(abs(one - 1.0) for one in shares)
    print(f"\n{len(shares)} nodules: volume within {100 * worst:.1f} % (worst), "
          f"{sum(abs(one - 1.0) <= 0.05 for one in shares)} within 5 %")  # fmt: skip
    report_classes(samples)
    return 0


def _opened(name: str) -> tuple[Volume, Airways]:
    """Return a CT and its airways."""
    kind, _, rest = name.partition(":")
    if kind == "painted":
        patient, _, condition = rest.partition(":")
        options = CONDITIONS[condition].options
        folder = mask_folders(Path(os.environ["CARINA_DATA_DIR"]))[patient]
        volume = paint(scene_of_masks(masks_of(folder), options), options).volume
    elif kind == "phantom":
        volume = generate_phantom(seed=int(rest), spacing_mm=0.9, noise_hu=25.0, progress=False).volume
    else:
        volume = carina.demo_patient() if name == "patient" else carina.open_volume(Path(name), progress=False)
    return volume, carina.find_airways(volume, progress=False)


def _inserted(volume: Volume, airways: Airways, number: int) -> InsertedNodule | CarinaError:
    """Return the nodule of a number inserted at a random free position, or the error if there is no position."""
    rng = np.random.default_rng([number, 45])
    kind = KINDS[number % len(KINDS)]
    diameter = float(rng.uniform(*(GLASS_DIAMETERS_MM if kind == "ground-glass" else DIAMETERS_MM)))
    try:
        place = free_nodule_position(
            volume, airways, diameter_mm=diameter, spiculation=SPICULATION, seed=number, through_vessels=True
        )
        return insert_nodule(
            volume, airways, place, kind=kind, diameter_mm=diameter, spiculation=SPICULATION, seed=number,
            core_diameter_mm=0.8 * diameter if kind == "part-solid" else None, through_vessels=True,
        )  # fmt: skip
    except CarinaError as error:
        return error


def _classes(volume: Volume, made: InsertedNodule, number: int) -> dict[str, Floats] | None:
    """Return the edge features of the inserted and of real boundaries at one nodule; None with too few positions."""
    rng = np.random.default_rng([number, 46])
    matched = nodule_sample(made.volume, made, rng)
    unmatched = nodule_sample(pasted(volume, made), made, rng)
    if matched is None or unmatched is None:
        return None
    real, again = (real_sample(volume, made, matched[1], rng) for _ in range(2))
    if real is None or again is None:
        return None
    return dict(zip(CLASSES, (matched[0], unmatched[0], real, again), strict=True))


def report_classes(samples: dict[str, list[tuple[int, int, Floats]]]) -> dict[str, float]:
    """Print the medians of the features and the results of the classifier; return the areas under its curves."""
    print("medians of the features: " + ", ".join(FEATURES))
    for name, rows in samples.items():
        print(f"  {name:10} " + "  ".join(f"{one:7.3f}" for one in np.median([row for _, _, row in rows], axis=0)))
    areas: dict[str, float] = {}
    real = samples["real"]
    for name in CLASSES:
        if name == "real":
            continue
        ours, theirs = centred(samples[name], real)
        groups = np.array([number for _, number, _ in (*samples[name], *real)])
        # The numbers of the nodules of one CT differ by a constant, so their order gives the folds.
        groups = np.unique(groups, return_inverse=True)[1]
        features, labels = np.concatenate([ours, theirs]), np.repeat([1.0, 0.0], [len(ours), len(theirs)])
        areas[name] = area_under_curve(cross_validated_scores(features, labels, groups), labels)
        alone = [area_under_curve(features[:, n], labels) for n in range(features.shape[1])]
        print(f"{name:10} {len(ours)} nodules, {len(theirs)} real boundaries: AUC {areas[name]:.3f}; of one feature "
              + ", ".join(f"{max(one, 1.0 - one):.2f}" for one in alone))  # fmt: skip
    return areas


if __name__ == "__main__":
    raise SystemExit(main())
