"""Calibration of two confidences on held-out phantoms: that a branch is an airway, and that a segment's name is right.

The rows are part of ``carina bench track --only names``. ``python -m carina_bench.track_confidence FOLDER`` collects
the data from which Carina's two confidence maps are fitted and by which they are judged. The data are stored in FOLDER,
so an interrupted run continues. Then the command prints both maps and writes the reliability diagram.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.track import AirwayTree, find_airways, name_words
from carina.track.names.naming import segment_readings
from carina.track.names.tree_fit import GOOD_FIT, POOR_FIT, SUREST, calibrated
from carina.track.tree.uncertainty import AIRWAY_SHARE
from carina_bench.confidence_cases import CtCase, cases_of, is_true_branch, made_case, true_tree
from carina_bench.confidence_trees import degraded, random_tree, vessel_tree, warped
from carina_bench.plot_svg import reliability_plot

__all__ = ["calibration_error", "fitted_airways", "fitted_names", "run"]

Row = dict[str, Any]
Say = Callable[[str], None]
Shares = NDArray[np.float64]
# The items are the confidence, whether the branch or name is true, and the kind of the case.
Judged = tuple[float, bool, str]

FIRST_SEED = {"fit": 101, "held": 201}
"""First seed of the phantoms for the fit, and of those held out for the judgement."""
NUM_GOOD, NUM_POOR, NUM_TREES = 8, 14, 24
"""Number of good CTs, of poor CTs, and of trees for the names, from which the confidence is fitted."""
QUICK_CTS, QUICK_TREES = 1, 6
"""Number of good and of poor CTs, and of trees, in a quick run."""
NUM_BINS = 10
"""Number of equal bins of confidence over which the calibration error is averaged."""
MAX_ERROR, SURE, SURE_SHARE = 0.05, 0.9, 0.7
"""Maximum calibration error; confidence that counts as sure; minimum share of right names that are sure."""
EDGES = (0.0, 0.5, 0.75, 0.85, 0.9, 0.925, 0.95, 0.97, 0.98, 0.99, 0.995, 0.999, 1.001)
"""Edges of the bins of a branch's score (how well its wall is visible); most branches have a score near 1."""


def calibration_error(shares: Shares, hits: Shares) -> float:
    """Return the expected calibration error over ten bins of the confidence ``shares``.

    The error of a bin is the difference between its mean confidence and its share of true cases (``hits``).
    """
    bins = np.minimum((shares * NUM_BINS).astype(int), NUM_BINS - 1)
    within = [bins == k for k in range(NUM_BINS)]
    return float(sum(abs(shares[m].mean() - hits[m].mean()) * m.mean() for m in within if m.any()))


def run(quick: bool, say: Say) -> list[Row]:
    """Return the report's rows for the confidence in phantoms with held-out seeds (see ``carina_bench.track``)."""
    airways, names = [], []
    num_good, num_poor, num_trees = (QUICK_CTS, QUICK_CTS, QUICK_TREES) if quick else (NUM_GOOD, NUM_POOR, NUM_TREES)
    for case, tree, true in _found_trees("held", num_good, num_poor, say):
        kind = _kind(case)
        airways += [(b.confidence or 0.0, hit, kind) for b, hit in zip(tree.branches, true, strict=True)]
        names += _judged_names(tree, true_tree(case.seed, case.generations), kind)
    for label, tree, truth in _made_trees("held", num_trees):
        names += _judged_names(tree, truth, label.split("-")[0])
    return [*_rows(airways, "airways"), *_rows(names, "names"), _unlike_row(2 if quick else 20)]


def _rows(judged: Sequence[Judged], what: str) -> Iterator[Row]:
    groups = {"all": list(judged)} | {k: [j for j in judged if j[2] == k] for k in sorted({j[2] for j in judged})}
    for kind, members in groups.items():
        shares, hits = np.array([m[0] for m in members]), np.array([m[1] for m in members], dtype=np.float64)
        stated = shares >= 0.5 if what == "names" else np.ones(len(shares), dtype=bool)
        if not stated.any():
            continue
        yield {
            "what": f"expected calibration error of {what}",
            "case": f"{kind}, {stated.sum()} stated",
            "figure": calibration_error(shares[stated], hits[stated]),
            "limit": MAX_ERROR if kind == "all" else None,
            "better": "lower",
        }
        if what == "names":
            yield {
                "what": f"right segments that are stated with {SURE:g} or more",
                "case": kind,
                "figure": float((shares[hits > 0] >= SURE).mean()),
                "limit": SURE_SHARE if kind == "good CTs" else None,
            }


def _unlike_row(num: int) -> Row:
    """Return the row of ``num`` trees that are not airway trees: random forks, and vessels."""
    trees = [random_tree(np.random.default_rng(seed), two_lungs=seed % 2 == 1) for seed in range(num)]
    for seed in range(max(num // 4, 1)):
        trees += [vessel_tree(true_tree(seed), np.random.default_rng(seed), is_vein=vein) for vein in (True, False)]
    fits = [segment_readings(tree)[0] for tree in trees]
    return {
        "what": "random trees and vessels that are reported as unlike a human tree",
        "case": f"{len(trees)} trees",
        "figure": float(np.mean([fit is not None and fit < POOR_FIT for fit in fits])),
        "limit": 0.95,
    }


# Trees and names whose confidence is judged:


def _found_trees(part: str, num_good: int, num_poor: int, say: Say) -> Iterator[tuple[CtCase, AirwayTree, list[bool]]]:
    first = FIRST_SEED[part]
    for is_good, num in ((True, num_good), (False, num_poor)):
        for case in cases_of(range(first, first + num), is_good=is_good):
            say(f"confidence: CT of phantom {case.seed}, {_kind(case)}")
            tree = find_airways(made_case(case), progress=False).tree
            yield case, tree, is_true_branch(case, tree)


def _kind(case: CtCase) -> str:
    return "good CTs" if case.is_good else "degraded CTs"


def _made_trees(part: str, num: int) -> Iterator[tuple[str, AirwayTree, AirwayTree]]:
    """Yield the kind, a degraded tree and its truth: of true trees, and of trees with another anatomy."""
    for seed in range(FIRST_SEED[part], FIRST_SEED[part] + num):
        rng = np.random.default_rng((seed, 3))
        tree = true_tree(seed, int(rng.integers(5, 8)))
        other = warped(tree, rng, (10.0, 20.0, 30.0)[seed % 3])
        yield f"other anatomies-{seed}", degraded(other, rng, amount=0.4), other
        yield f"degraded trees-{seed}", degraded(tree, rng, amount=(0.0, 0.4, 1.0, 1.0)[seed % 4]), tree


def _judged_names(tree: AirwayTree, truth: AirwayTree, kind: str) -> list[Judged]:
    """Return the names of a tree with their confidence and truth; none if the tree is classified as not human."""
    fit, readings = _judged_readings(tree, truth)
    if fit is not None and fit < POOR_FIT:
        return []
    return [(calibrated(share, fit), is_right, kind) for share, is_right in readings]


def _judged_readings(tree: AirwayTree, truth: AirwayTree) -> tuple[float | None, list[tuple[float, bool]]]:
    """Return the fit of a tree, and the share of each segment that was named, with whether the name is right.

    The fit is None if the tree has none.
    """
    true: dict[int, str] = {}
    for branch in truth.branches:
        words = None if branch.name is None else name_words(branch.name)
        if branch.name is not None and words is not None and words.boyden is not None:
            is_stem = words.jackson_huber.startswith("common")
            true[branch.id] = "" if is_stem else branch.name
        else:
            true[branch.id] = true.get(branch.parent, "") if branch.parent is not None else ""
    places = np.concatenate([b.points for b in truth.branches])
    owners = [true[b.id] for b in truth.branches for _ in b.points]
    fit, readings = segment_readings(tree)
    judged = []
    for segment, share, ids in readings:
        points = np.concatenate([tree.branch(one).points for one in ids])
        points = points[len(points) // 3 :] if len(points) > 6 else points
        near = [owners[int(np.argmin(((places - point) ** 2).sum(axis=1)))] for point in points]
        there = max(set(near), key=near.count)
        halves = {"LB1": "LB1+2", "LB2": "LB1+2"}
        judged.append((share, halves.get(segment, segment) == halves.get(there, there)))
    return fit, judged


# Functions that fit the maps from evidence to confidence:


def fitted_airways(scores: Shares, hits: Shares) -> list[tuple[float, float]]:
    """Return the map from a branch's score to its confidence, fitted by isotonic regression over bins of the score."""
    blocks: list[list[float]] = []
    middles = []
    for low, high in itertools.pairwise(EDGES):
        inside = (scores >= low) & (scores < high)
        if inside.any():
            middles.append(float(scores[inside].mean()))
            blocks.append([(hits[inside].sum() + 0.5) / (inside.sum() + 1.0), float(inside.sum()), 1.0])
            while len(blocks) > 1 and blocks[-2][0] > blocks[-1][0]:
                share, num, bins = blocks.pop()
                before = blocks[-1]
                before[0] = (before[0] * before[1] + share * num) / (before[1] + num)
                before[1], before[2] = before[1] + num, before[2] + bins
    shares = [share for share, _, bins in blocks for _ in range(int(bins))]
    return [(round(x, 3), round(float(share), 3)) for x, share in zip(middles, shares, strict=True)]


def fitted_names(shares: Shares, fits: Shares, hits: Shares) -> tuple[float, float, float]:
    """Return the coefficients of the log odds of a right name, see ``carina.track.names.tree_fit.NAME_ODDS``.

    ``fits`` are limited to ``GOOD_FIT``.
    """
    parts = np.clip(shares, 0.01, SUREST)
    x = np.stack([np.ones(len(parts)), np.log(parts / (1.0 - parts)), np.minimum(fits, GOOD_FIT) - GOOD_FIT], axis=1)
    odds = np.array([0.0, 1.0, 0.0])
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-x @ odds))
        gradient = x.T @ (hits - p) - 0.01 * odds
        odds = odds + np.linalg.solve((x * (p * (1.0 - p))[:, None]).T @ x + 0.01 * np.eye(3), gradient)
    return float(odds[0]), float(odds[1]), float(odds[2])


# Functions that the command line calls to collect and store the data of the cases:


def _collected(folder: Path, part: str, say: Say) -> tuple[list[list[Any]], list[list[Any]]]:
    """Return the data of branches and names for ``part``, stored case by case in ``folder``.

    A branch is [score, is true, kind]; a name is [share, fit, is right, kind].
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{part}.jsonl"
    known = {} if not path.exists() else {row["label"]: row for row in map(json.loads, path.read_text().splitlines())}

    def keep(label: str, airways: Iterable[Any], fit: float | None, names: Iterable[Any]) -> None:
        known[label] = {"label": label, "airways": list(airways), "fit": fit, "names": list(names)}
        with path.open("a") as file:
            file.write(json.dumps(known[label]) + "\n")

    scores, shares = np.array(AIRWAY_SHARE).T
    first = FIRST_SEED[part]
    for is_good, num in ((True, NUM_GOOD), (False, NUM_POOR)):
        for case in cases_of(range(first, first + num), is_good=is_good):
            label = f"{_kind(case)}-{case.seed}"
            if label not in known:
                say(label)
                tree = find_airways(made_case(case), progress=False).tree
                # The stored value is the score, so the map from score to confidence is inverted.
                scored = np.interp([b.confidence or 0.0 for b in tree.branches], shares, scores)
                fit, names = _judged_readings(tree, true_tree(case.seed, case.generations))
                keep(label, zip(scored.tolist(), is_true_branch(case, tree), strict=True), fit, names)
    for label, tree, truth in _made_trees(part, NUM_TREES):
        if label not in known:
            say(label)
            fit, names = _judged_readings(tree, truth)
            keep(label, [], fit, names)
    rows = list(known.values())
    kind = {row["label"]: row["label"].split("-")[0] for row in rows}
    airways = [[*one, kind[row["label"]]] for row in rows for one in row["airways"]]
    named = [[one[0], row["fit"], one[1], kind[row["label"]]] for row in rows for one in row["names"]]
    return airways, named


def main() -> None:
    """Run the command line: fit the maps on some seeds, judge them on others, and write the diagram."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="Folder of the collected data.")
    parser.add_argument("--svg", type=Path, help="Where the reliability diagram goes (default: none).")
    options = parser.parse_args()
    print(f"carina {carina.__version__}")
    airways, names = _collected(options.folder, "fit", print)
    column = np.array([[score, hit] for score, hit, _ in airways], dtype=np.float64).T
    print("AIRWAY_SHARE", fitted_airways(column[0], column[1]))
    column = np.array(
        [[share, GOOD_FIT if fit is None else fit, hit] for share, fit, hit, _ in names], dtype=np.float64
    ).T
    print("NAME_ODDS", fitted_names(*column))
    airways, names = _collected(options.folder, "held", print)
    judged: dict[str, list[Judged]] = {
        "airways, raw": [(score, hit, kind) for score, hit, kind in airways],
        "airways": [(float(np.interp(s, *np.array(AIRWAY_SHARE).T)), hit, kind) for s, hit, kind in airways],
        "names, raw": [(share, hit, kind) for share, _, hit, kind in names if share >= 0.5],
    }
    stated = [(calibrated(s, fit), hit, kind) for s, fit, hit, kind in names if fit is None or fit >= POOR_FIT]
    judged["names"] = [one for one in stated if one[0] >= 0.5]
    for what, members in judged.items():
        for row in _rows(members, "names" if what.startswith("names") else what):
            print(f"{what}: {row['what']}, {row['case']}: {row['figure']:.4f}")
    if options.svg is not None:
        title = "Confidence and truth on held-out phantoms"
        options.svg.write_text(
            reliability_plot(title, {k: [(s, h) for s, h, _ in v] for k, v in judged.items()}, num_bins=NUM_BINS)
        )


if __name__ == "__main__":
    main()
