"""Segmentation of the lobes of the lungs from the airways, and from fissures where the CT shows them."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.errors import NoResultError
from carina.plan.cubic_box import Box
from carina.plan.lungs.fissures import FissureBox, fissures
from carina.plan.lungs.tissue_near_needle import lung_box
from carina.track import AirwayTree, branch_side_and_lobe
from carina.volume import Volume
from carina.volume.front_times import arrival_times
from carina.volume.mask_distances import ball_distance, extent
from carina.volume.mask_parts import numbered_parts

Mask = NDArray[np.bool_]
Values = NDArray[np.float32]

LOBE_NAMES = ("RUL", "RML", "RLL", "LUL", "LML", "LLL")
"""Names of the labels 1 to 6; label 0 is outside the lungs."""
STEP_MM = 2.0
FISSURE_SLOWS = 12.0
"""Factor by which a visible fissure slows the front that assigns voxels to lobes (fast marching)."""
UNSEEN_MM, SEEN_MM = 9.0, 3.0
"""Standard deviations in mm of a lobe border's position: estimated from airways alone, and at a visible fissure.

The value for airways alone was measured on patients with masks of lobes (benchmarks/carina_bench/plan_surroundings.py).
"""
FAR_SHARE = 0.35
"""Minimum standard deviation of a lobe border without fissure, as a share of the distance to the nearest airway.

The value is common knowledge, not measured.
"""
RIM_MM, WALL_HU = 6.0, -400.0
"""Width in mm of the layer at the lungs' surface that may be chest wall, and least density of this wall in HU.

The density is half-way between lung and muscle.
"""
SEEN_REACH_MM = 6.0
"""Maximum distance in mm between a fissure and the lobe border that the fissure defines."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Lobes:
    """Labels of the lobes of both lungs on a grid of 2 mm along LPS."""

    label_zyx: NDArray[np.uint8]
    """(nz, ny, nx) label: 0 outside the lungs, else the index in `LOBE_NAMES` plus one."""
    border_mm: Values
    """(nz, ny, nx) distance in mm of each voxel to the border with another lobe of the same lung.

    Infinite if there is none.
    """
    sure_zyx: Values
    """(nz, ny, nx) confidence in the label of each voxel, 0 to 1."""
    lps_from_ijk: NDArray[np.float64]
    missing: tuple[str, ...]
    """Names of the lobes without a bronchus in the tree; their volume is labelled as that of their neighbours."""
    fissure: FissureBox | None
    """Visible fissures; None if fissures were not searched."""

    def at(self, point_lps: NDArray[np.float64]) -> tuple[str | None, float]:
        """Return the name of the lobe at a point in LPS mm, and the confidence; (None, 0) outside the lungs."""
        ijk = np.rint((np.asarray(point_lps) - self.lps_from_ijk[:3, 3]) / STEP_MM).astype(np.intp)
        k, j, i = ijk[::-1]
        nz, ny, nx = self.label_zyx.shape
        if not (0 <= i < nx and 0 <= j < ny and 0 <= k < nz) or self.label_zyx[k, j, i] == 0:
            return None, 0.0
        return LOBE_NAMES[self.label_zyx[k, j, i] - 1], float(self.sure_zyx[k, j, i])

    def ml(self, lobe: str) -> float:
        """Return the volume of a lobe in ml."""
        return float((self.label_zyx == LOBE_NAMES.index(lobe) + 1).sum()) * STEP_MM**3 / 1000.0


@shows_progress
def lobes(
    volume: Volume,
    tree: AirwayTree,
    *,
    box: Box | None = None,
    progress: ProgressChoice = None,
) -> Lobes:
    """Segment the lobes by the airway that is nearest through the lung; visible fissures move the borders to them.

    Parameters
    ----------
    volume
        The CT.
    tree
        Its named airways (`carina.find_airways`).
    box
        `carina.plan.lungs.tissue_near_needle.lung_box` of the CT; computed if None.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown. The function may raise CancelledError to stop
        the calculation.

    Returns
    -------
    Lobes
        Labels on a grid of 2 mm, with their confidence.

    Raises
    ------
    NoResultError
        If there is no lung in the CT (``plan.no_lung``) or no bronchus of a lobe in the tree (``plan.no_lobe``).
    """
    report = progress_function(progress)

    def say(what: str, share: float) -> None:
        if report is not None:
            report(what, share)

    if box is None:
        say("finding the lungs", 0.0)
        box = lung_box(volume)
    say("the lobes by their airways", 0.2)
    inside, matrix = lung_grid(box)
    first = nearest_lobe(
        inside, matrix, tree, on_progress=fraction_callback(report, "the lobes by their airways", 0.2, 0.4)
    )
    say("looking for fissures", 0.4)
    on_progress = fraction_callback(report, "looking for fissures", 0.4, 0.7)
    seen = fissures(box, first.label_zyx, first.border_mm, matrix, on_progress=on_progress)
    last = "the lobes by airways and fissures"
    say(last, 0.7)
    return nearest_lobe(inside, matrix, tree, seen, on_progress=fraction_callback(report, last, 0.7, 1.0))


def nearest_lobe(
    inside: Mask,
    lps_from_ijk: NDArray[np.float64],
    tree: AirwayTree,
    seen: FissureBox | None = None,
    *,
    on_progress: Callable[[float], None] | None = None,
) -> Lobes:
    """Assign each voxel of the lungs (2 mm) to the lobe whose airways are nearest through the lung.

    Parameters
    ----------
    inside, lps_from_ijk
        (nz, ny, nx) mask of the lungs at 2 mm, and the (4, 4) transform of its grid.
    tree
        Named airways.
    seen
        Visible fissures, which slow the front.
    on_progress
        Receives the completed fraction; it may raise CancelledError.

    Raises
    ------
    NoResultError
        If no bronchus of a lobe is in the tree (``plan.no_lobe``).
    """
    seeds = _seeds(inside, lps_from_ijk, tree)
    if not seeds:
        raise NoResultError(
            "the lobes: no bronchus of a lobe is on the airway tree; find the airways again, or name the lobar bronchi",
            code="plan.no_lobe",
        )
    speed = np.where(inside, 1.0, 0.0).astype(np.float32)
    near_seen = np.zeros(inside.shape, dtype=bool)
    if seen is not None:
        near_seen = seen.on_grid(inside.shape, lps_from_ijk, STEP_MM)
        speed[near_seen & inside] = 1.0 / FISSURE_SLOWS
    times = np.full((len(LOBE_NAMES), *inside.shape), np.inf, dtype=np.float32)
    pieces = _pieces(speed > 0.0)
    # Threads, at most one per processor: they run in parallel, because fast marching releases the interpreter lock.
    pool = ThreadPoolExecutor(min(os.cpu_count() or 1, len(seeds)))
    try:
        fronts = {lobe: pool.submit(_arrival, speed, pieces, at) for lobe, at in seeds.items()}
        for n, (lobe, front) in enumerate(fronts.items()):
            if on_progress is not None:
                on_progress(n / len(seeds))
            times[LOBE_NAMES.index(lobe)] = front.result()
    finally:
        pool.shutdown(cancel_futures=True)
    best = times.argmin(axis=0)
    reached = np.isfinite(times.min(axis=0)) & inside
    label = np.where(reached, best + 1, 0).astype(np.uint8)
    border = _border_mm(label)
    # The position of a border is less certain far from the airways that were found.
    way_mm = STEP_MM * np.where(reached, np.minimum(times.min(axis=0), 200.0), 0.0)
    spread: Values = np.maximum(UNSEEN_MM, FAR_SHARE * way_mm).astype(np.float32)
    if near_seen.any():
        # Voxels whose nearest piece of border lies at a fissure have a smaller position error.
        spread[_nearest_border_is_seen(label, near_seen)] = SEEN_MM
    sure = np.where(reached, 0.5 * (1.0 + _erf(border / (spread * math.sqrt(2.0)))), 0.0).astype(np.float32)
    expected = {"RUL", "RML", "RLL", "LUL", "LLL"} if "LML" not in seeds else {"RUL", "RLL", "LUL", "LML", "LLL"}
    return Lobes(label, border, sure, lps_from_ijk, tuple(sorted(expected - set(seeds))), seen)


def lung_grid(box: Box) -> tuple[Mask, NDArray[np.float64]]:
    """Return the mask of the lungs on a grid of 2 mm, without the wall round them, and the transform of the grid."""
    every = round(STEP_MM / box.step_mm)
    matrix = np.diag([STEP_MM, STEP_MM, STEP_MM, 1.0])
    matrix[:3, 3] = box.lps_from_ijk[:3, 3]
    # Chest wall and mediastinum within the closed lungs block the fast-marching front; vessels do not.
    tissue = box.known[::every, ::every, ::every] & (box.hu_zyx[::every, ::every, ::every] > -300.0)
    solid = ball_distance(tissue, STEP_MM, 5.0) > 5.0
    # The box includes some millimetres of chest wall and mediastinum round the lungs.
    known = box.known[::every, ::every, ::every]
    rim = (ball_distance(known, STEP_MM, RIM_MM) < RIM_MM) & (box.hu_zyx[::every, ::every, ::every] > WALL_HU)
    inside: Mask = known & ~solid & ~rim
    return inside, matrix


def _seeds(inside: Mask, lps_from_ijk: NDArray[np.float64], tree: AirwayTree) -> dict[str, NDArray[np.intp]]:
    """Return for each lobe its start voxels (n, 3) k, j, i: lung voxels on the lobe's airways."""
    lobe_of = branch_side_and_lobe(tree)
    found: dict[str, list[NDArray[np.intp]]] = {}
    for branch in tree.branches:
        lobe = lobe_of[branch.id]
        if lobe not in LOBE_NAMES:
            continue
        ijk = np.rint((branch.points - lps_from_ijk[:3, 3]) / STEP_MM).astype(np.intp)
        voxels = ijk[((ijk >= 0) & (ijk < np.array(inside.shape[::-1]))).all(axis=1)][:, ::-1]
        voxels = voxels[inside[tuple(voxels.T)]]
        if len(voxels):
            found.setdefault(str(lobe), []).append(voxels)
    return {lobe: np.unique(np.concatenate(parts), axis=0) for lobe, parts in found.items()}


def _pieces(mask: Mask) -> NDArray[np.uint32]:
    """Return the connected components (by faces) of a mask, numbered from 1."""
    return numbered_parts(mask)


def _arrival(speed: Values, pieces: NDArray[np.uint32], at: NDArray[np.intp]) -> Values:
    """Return the arrival time of a fast-marching front from some voxels, in the bounding box of their components."""
    part = extent(np.isin(pieces, np.unique(pieces[tuple(at.T)])), 1)
    first = [axis.start for axis in part]
    times = arrival_times(speed[part], at - first)
    found = np.full(speed.shape, np.inf, dtype=np.float32)
    found[part] = np.where(times < 1e6, times, np.inf)
    return found


def _border_mm(label: NDArray[np.uint8]) -> Values:
    """Return for each voxel of a lobe the distance in mm to the nearest other lobe of the same lung."""
    right = np.isin(label, [1, 2, 3])
    out = np.full(label.shape, np.inf, dtype=np.float32)
    for side in (right, (label > 0) & ~right):
        for lobe in np.unique(label[side]):
            others = side & (label != lobe)
            own = label == lobe
            if others.any():
                out[own] = ball_distance(~others, STEP_MM)[own]
    return out


def _nearest_border_is_seen(label: NDArray[np.uint8], near_seen: Mask) -> Mask:
    """Return the mask of voxels whose nearest piece of border has a fissure beside it."""
    right = np.isin(label, [1, 2, 3])
    edge = np.zeros(label.shape, dtype=bool)
    for axis in range(3):
        one, other = label.take(range(1, label.shape[axis]), axis), label.take(range(label.shape[axis] - 1), axis)
        a, b = right.take(range(1, label.shape[axis]), axis), right.take(range(label.shape[axis] - 1), axis)
        cut = (one != other) & (one > 0) & (other > 0) & (a == b)
        where = [slice(None)] * 3
        where[axis] = slice(1, None)
        edge[tuple(where)] |= cut
    seen = edge & (ball_distance(~near_seen, STEP_MM, SEEN_REACH_MM) <= SEEN_REACH_MM)
    unseen = edge & ~seen
    if not seen.any():
        return np.zeros(label.shape, dtype=bool)
    if not unseen.any():
        return np.ones(label.shape, dtype=bool)
    found: Mask = ball_distance(~seen, STEP_MM) <= ball_distance(~unseen, STEP_MM)
    return found


def _erf(values: Values) -> Values:
    """Return the error function of values >= 0 (Abramowitz and Stegun 7.1.26, error 2e-7)."""
    t = 1.0 / (1.0 + 0.3275911 * values)
    poly = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    found: Values = 1.0 - poly * np.exp(-np.minimum(values * values, 80.0))
    return found
