"""``carina bench track --only names``: names of bronchi compared with phantoms' truth, and lobes with patients' masks.

A true segment is *right* if the found branch along it has the segment's name. It is *wrong* if that branch has the name
of another segment or of a stem. Otherwise it has no name. Phantoms have no true subsegments: the letters on the found
tree are compared with those on the true tree, which the same rule assigned. ``track_confidence`` measures whether the
confidence is a probability.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.config import load_settings
from carina.phantom import generate_phantom
from carina.track import AirwayTree, branch_side_and_lobe, find_airways, name_tree, name_words
from carina.volume import Volume, open_volume
from carina_bench import track_confidence

__all__ = ["along", "lobe_lengths", "run", "tally"]

Row = dict[str, Any]
SEEDS = range(1, 21)
"""Seeds of the phantoms whose bronchi are named."""
QUICK_SEEDS = range(1, 3)
"""Seeds of the phantoms in a quick run."""
SPACING_MM, NOISE_HU = 0.7, 25.0
"""Spacing (mm) and standard deviation of the noise (HU) of the phantoms."""
LOBES = ("RUL", "RML", "RLL", "LUL", "LLL")
"""Names of the five lobes of the lungs."""
LOBE_FOLDER = "masks/thin_slice_lobes"
"""Folder of the patients below CARINA_DATA_DIR."""
LOBE_CASES = {"thin-slice patient 1": "Patient1", "thin-slice patient 2": "Patient2"}
"""Patients whose lobes are compared under a limit: folder by name in the report."""
OTHER_LOBE_CASES = {"patient 3, 1.8 mm": "Patient3"}
"""Patient whose lobes are compared without a limit: folder by name in the report.

At 1.8 mm the lobes of this patient's masks extend beyond the roots of the bronchi of middle lobe and lingula.
"""
ROUND_MM = (0.0, 2.0, 4.0, 6.0, 8.0)
"""Radii of the balls around a point in which the lobe's voxels are counted, mm.

The masks exclude airways and vessels, so the lobe of a point is the majority in a ball.
"""
CLEAR_SHARE = 0.75
"""Minimum share of a lobe among the labelled voxels of a ball that counts as a clear majority."""


def run(quick: bool, say: Callable[[str], None]) -> list[Row]:
    """Return the report's rows for named segments, subsegments and lobes (see ``carina_bench.track``)."""
    seeds = QUICK_SEEDS if quick else SEEDS
    exact: Counter[str] = Counter()
    found: Counter[str] = Counter()
    seconds, sizes = [], []
    for seed in SEEDS:
        truth = _true_tree(seed)
        began = time.process_time()
        named = name_tree(truth)
        seconds.append(time.process_time() - began)
        sizes.append(len(truth))
        exact += tally(truth, named)
    for seed in seeds:
        say(f"names: phantom {seed}")
        phantom = generate_phantom(seed=seed, spacing_mm=SPACING_MM, noise_hu=NOISE_HU)
        truth = AirwayTree.from_json(phantom.truth)
        found += tally(truth, name_tree(find_airways(phantom.volume).tree))
    rows = [
        *_naming_rows(exact, f"true trees of {len(SEEDS)} phantoms"),
        *_naming_rows(found, f"found trees of {len(seeds)} phantoms, {SPACING_MM} mm, {NOISE_HU:g} HU"),
        {
            "what": "processor time of naming",
            "case": f"true trees, {min(sizes)} to {max(sizes)} branches",
            "figure": float(np.median(seconds)),
            "min": min(seconds),
            "max": max(seconds),
            "unit": "s",
            "limit": 1.0,
            "better": "lower",
        },
    ]
    rows += track_confidence.run(quick, say)
    for case, folder in (LOBE_CASES | OTHER_LOBE_CASES).items():
        say(f"lobes: {case}")
        limit = 0.98 if case in LOBE_CASES else None
        rows.append({**_lobe_row(case, load_settings().data_dir, folder), "limit": limit})
    return rows


def _true_tree(seed: int) -> AirwayTree:
    # A small box saves time: only the truth of the phantom is used, which is complete in any box.
    box = ((-10.0, -10.0, -10.0), (10.0, 10.0, 10.0))
    return AirwayTree.from_json(generate_phantom(seed=seed, spacing_mm=5.0, box_lps=box).truth)


def _is_segment(name: str | None) -> bool:
    words = None if name is None else name_words(name)
    return words is not None and words.boyden is not None and not words.jackson_huber.startswith("common")


def _variants(truth: AirwayTree) -> list[str]:
    """Return the uncommon stems (anatomical variants) of a true tree."""
    return [stem for stem in ("RB1+2", "RB2+3", "RB9+10", "LB9+10") if stem in truth.names] or ["none"]


def along(tree: AirwayTree, points: NDArray[np.float64]) -> int:
    """Return the ID of the branch along which most of the points (n, 3) are."""
    stacked = np.concatenate([branch.points for branch in tree.branches])
    owner = np.concatenate([np.full(len(branch.points), branch.id) for branch in tree.branches])
    nearest = [owner[int(np.argmin(((stacked - point) ** 2).sum(axis=1)))] for point in points]
    return Counter(int(n) for n in nearest).most_common(1)[0][0]


def tally(truth: AirwayTree, named: AirwayTree) -> Counter[str]:
    """Count right, wrong and missing names by kind of branch, and for segments by variant and by confidence as well."""
    counts: Counter[str] = Counter()
    labelled = name_tree(truth)
    for branch in truth.branches:
        if len(branch.points) < 3:
            continue
        letters = labelled.branch(branch.id).name
        is_named = branch.name is not None
        if not is_named and (letters is None or not _is_segment(letters)):
            continue
        # Only the middle of a branch is compared, because its ends are inside the lumens of its neighbours.
        middle = branch.points[len(branch.points) // 3 : -max(len(branch.points) // 4, 1)]
        there = named.branch(along(named, middle))
        if not is_named:
            counts["letter, all"] += 1
            counts[
                "letter, right" if there.name == letters else "letter, none" if there.name is None else "letter, wrong"
            ] += 1
            continue
        kind = "segment" if _is_segment(branch.name) else "stem"
        verdict = "right" if there.name == branch.name else "none" if there.name is None else "wrong"
        counts[f"{kind}, all"] += 1
        counts[f"{kind}, {verdict}"] += 1
        if kind == "segment":
            for variant in _variants(truth):
                counts[f"{variant}: all"] += 1
                counts[f"{variant}: {verdict}"] += 1
            if there.name is not None and there.name_confidence is not None:
                tenth = min(int(there.name_confidence * 10), 9)
                counts[f"sure {tenth}: all"] += 1
                counts[f"sure {tenth}: {verdict}"] += 1
    return counts


def _share(counts: Counter[str], key: str, of: str) -> float | None:
    return counts[key] / counts[of] if counts[of] else None


def _naming_rows(counts: Counter[str], case: str) -> Iterable[Row]:
    for kind, limit in (("segment", 0.90), ("stem", None), ("letter", None)):
        yield {
            "what": f"{kind}s named rightly" if kind != "letter" else "letters of subsegments as on the true tree",
            "case": case,
            "figure": _share(counts, f"{kind}, right", f"{kind}, all"),
            "limit": limit,
            "wrong": _share(counts, f"{kind}, wrong", f"{kind}, all"),
            "note": f"{counts[f'{kind}, right']} right, {counts[f'{kind}, wrong']} wrong, {counts[f'{kind}, none']} "
            f"without a name",
        }
    for variant in ("none", "RB1+2", "RB2+3", "RB9+10", "LB9+10"):
        if counts[f"{variant}: all"]:
            yield {
                "what": f"segments named rightly where the variant is {variant}",
                "case": case,
                "figure": _share(counts, f"{variant}: right", f"{variant}: all"),
            }
    for tenth in range(5, 10):
        if counts[f"sure {tenth}: all"]:
            yield {
                "what": f"right among names of confidence {tenth / 10:.1f} to {(tenth + 1) / 10:.1f}",
                "case": case,
                "figure": _share(counts, f"sure {tenth}: right", f"sure {tenth}: all"),
                "note": f"{counts[f'sure {tenth}: all']} names",
            }


def _lobe_row(case: str, data_dir: Path | None, folder: str) -> Row:
    home = None if data_dir is None else data_dir / LOBE_FOLDER / folder
    row: Row = {"what": "branch length in the right lobe", "case": case, "unit": "of 1"}
    if home is None or not home.is_dir():
        return {**row, "figure": None, "note": "the data are not there"}
    lengths = lobe_lengths(home)
    judged = lengths["right"] + lengths["wrong"] + lengths["none"]
    return {
        **row,
        "figure": lengths["right"] / judged,
        "note": f"{lengths['right']:.0f} mm right, {lengths['wrong']:.0f} mm in another lobe, "
        f"{lengths['none']:.0f} mm without a name (trunks); {lengths['outside']:.0f} mm in no lobe's mask",
    }


def lobe_lengths(home: Path) -> Counter[str]:
    """Return the length of the airways in a patient's mask, mm, by agreement of their lobes.

    The lobe of an airway's name is compared with the lobe masks.
    """
    airway = next(p for p in (home / "BronchialTree.nii.gz", home / "BronchialTree.gz") if p.exists())
    # One of the files is a NIfTI with the suffix .gz alone, which Carina's reader accepts.
    image = open_volume(airway)
    mask = image.hu_zyx > 0
    matrix = image.lps_from_ijk
    where = np.argwhere(mask)
    low, high = np.maximum(where.min(axis=0) - 8, 0), where.max(axis=0) + 9
    lumen = np.ascontiguousarray(mask[low[0] : high[0], low[1] : high[1], low[2] : high[2]]).astype(np.uint8)
    cropped = matrix.copy()
    cropped[:3, 3] = (matrix @ np.array([low[2], low[1], low[0], 1.0]))[:3]
    volume = Volume(np.where(lumen > 0, -1000, 40).astype(np.int16), cropped)
    tree = find_airways(volume, lumen_zyx=lumen).tree
    sides_and_lobes = branch_side_and_lobe(tree)
    labels = np.zeros(mask.shape, dtype=np.uint8)
    for number, lobe in enumerate(LOBES):
        labels[open_volume(home / f"{lobe}.nii.gz").hu_zyx > 0] = number + 1
    inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    counts: Counter[str] = Counter()
    totals = dict.fromkeys(("right", "wrong", "none", "outside"), 0.0)
    for branch in tree.branches:
        steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
        for true, step in zip(_lobes_at(labels, inverse, branch.points[1:]), steps, strict=True):
            side_and_lobe = sides_and_lobes[branch.id]
            key = (
                "outside"
                if true is None
                else "right"
                if side_and_lobe == true
                else "none"
                if side_and_lobe is None
                else "wrong"
            )
            totals[key] += float(step)
    for key, length in totals.items():
        counts[key] = round(length)
    return counts


def _lobes_at(labels: NDArray[np.uint8], inverse: NDArray[np.float64], points: NDArray[np.float64]) -> list[str | None]:
    """Return the lobe around each point (n, 3), or None.

    The lobe is that of the smallest ball in which one lobe has a clear majority.
    """
    rng = np.random.default_rng(0)
    ways = rng.normal(size=(40, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    size = np.array(labels.shape[::-1])
    lobes: list[str | None] = [None] * len(points)
    for radius in ROUND_MM:
        around = points[:, None, :] + (ways * radius if radius else np.zeros((1, 3)))
        ijk = np.floor(around @ inverse[:3, :3].T + inverse[:3, 3] + 0.5).astype(int)
        inside = ((ijk >= 0) & (ijk < size)).all(axis=-1)
        i, j, k = np.moveaxis(np.clip(ijk, 0, size - 1), -1, 0)
        values = labels[k, j, i] * inside
        for number, row in enumerate(values):
            votes = np.bincount(row, minlength=len(LOBES) + 1)[1:]
            enough = votes.sum() > (0 if radius == 0.0 else 4)
            if lobes[number] is None and enough and votes.max() >= CLEAR_SHARE * votes.sum():
                lobes[number] = LOBES[int(votes.argmax())]
    return lobes
