"""Smooth deformation between two CTs that is fitted to shifts of matched places.

A rigid motion is searched first, so that false pairs and another pose are recognised. An affine motion is fitted to the
pairs that follow it. Near each place, the remaining shifts are fitted by a local affine motion with Gaussian weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Mask = NDArray[np.bool_]

NUM_TRIALS = 600
"""Maximum number of triples of forks from each of which a rigid motion from the first to the second CT is tried."""
RIGID_MM = 15.0
"""Maximum distance in mm of a pair from the rigid motion.

Breathing moves the bases of the lungs by 10 to 20 mm relative to the apices.
"""
NUM_NEAR = 10
"""Number of pairs within one standard deviation of the Gaussian weights, which determines their width."""
MIN_SIGMA_MM = 8.0
SLOPE_WEIGHT = 0.3
"""Weight of the penalty for slopes of the local affine motion, as a share of the weight of the pairs."""
MEAN_WEIGHT = 0.2
"""Weight, in each local motion, of the affine motion of all pairs, as an equal number of pairs."""
AT_ONCE = 2000


@dataclass(frozen=True, slots=True, eq=False)
class Affine:
    """Affine motion between two CTs in LPS mm."""

    matrix: Points
    """(3, 3) linear part."""
    offset: Points
    """(3,) translation, mm."""

    def shifts(self, places: Points) -> Points:
        """Return the movement (n, 3) in mm of tissue at points (n, 3) of the first CT."""
        found: Points = places @ self.matrix.T + self.offset - places
        return found


class Deformation:
    """Smooth shifts between matched places.

    Parameters
    ----------
    places, shifts
        (n, 3) LPS mm and mm.
    base
        Affine motion that the shifts approach far from all places.
    """

    def __init__(self, places: Points, shifts: Points, base: Affine) -> None:
        self.places = places
        self.shifts = shifts
        self.base = base
        self._rest = shifts - base.shifts(places)

    def at(self, places: Points, *, beyond_mm: float | NDArray[np.float64] = -1.0) -> Points:
        """Return the shifts (n, 3) in mm at places (n, 3), LPS mm.

        Parameters
        ----------
        places
            Places, LPS mm.
        beyond_mm
            Only pairs farther than this from each place are used; 0 leaves out a pair at the place itself.
        """
        found = np.empty(places.shape)
        for first in range(0, len(places), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            found[part] = self._fit(places[part], beyond_mm)[:, 0]
        return found + self.base.shifts(places)

    def gradient(self, place: Points) -> Points:
        """Return the (3, 3) derivative of the position in the second CT by the position in the first CT."""
        slopes = self._fit(place[None], -1.0)[0, 1:]
        found: Points = self.base.matrix + slopes.T
        return found

    def _fit(self, places: Points, beyond_mm: float | NDArray[np.float64]) -> Points:
        """Return for each place the local shift and its slopes, (n, 4, 3), relative to the base affine motion."""
        away = self.places[None] - places[:, None]
        distance = np.sqrt((away * away).sum(axis=2))
        usable = distance > beyond_mm + 1e-6
        of_use = np.where(usable, distance, np.inf)
        near = min(NUM_NEAR, of_use.shape[1]) - 1
        sigma = np.partition(of_use, near, axis=1)[:, near]
        sigma = np.clip(np.where(np.isfinite(sigma), sigma, 1e3), MIN_SIGMA_MM, None)[:, None]
        weight = np.where(usable, np.exp(-0.5 * (distance / sigma) ** 2), 0.0)
        terms = np.concatenate([np.ones((*distance.shape, 1)), away], axis=2)
        normal = np.einsum("ab,abi,abj->aij", weight, terms, terms)
        right = np.einsum("ab,abi,bk->aik", weight, terms, self._rest)
        total = weight.sum(axis=1)
        normal[:, 0, 0] += MEAN_WEIGHT
        slope = (SLOPE_WEIGHT * total + MEAN_WEIGHT) * sigma[:, 0] ** 2
        for axis in (1, 2, 3):
            normal[:, axis, axis] += slope
        solved: Points = np.linalg.solve(normal, right)
        return solved


def rigid_fit(first: Points, second: Points) -> tuple[Affine, Mask]:
    """Return the rigid motion that most pairs follow, and the mask (n,) of these pairs; three pairs are needed."""
    triples = list(combinations(range(len(first)), 3))
    chosen = np.random.default_rng(0).permutation(len(triples))[:NUM_TRIALS]
    best: Mask = np.zeros(len(first), dtype=bool)
    least = np.inf
    for number in chosen:
        motion = rigid_motion(first[list(triples[number])], second[list(triples[number])])
        off = np.linalg.norm(first + motion.shifts(first) - second, axis=1)
        cost = float(np.minimum(off, RIGID_MM).sum())
        if cost < least:
            least, best = cost, off <= RIGID_MM
    for _ in range(3):
        if best.sum() < 3:
            break
        motion = rigid_motion(first[best], second[best])
        best = np.linalg.norm(first + motion.shifts(first) - second, axis=1) <= RIGID_MM
    return rigid_motion(first[best], second[best]) if best.sum() >= 3 else motion, best


def affine_fit(first: Points, second: Points, rigid: Affine) -> Affine:
    """Return the affine motion of pairs, with a small weight of a rigid motion and of pairs with large residuals."""
    middle = first.mean(axis=0)
    terms = np.concatenate([np.ones((len(first), 1)), first - middle], axis=1)
    goal = second - first - rigid.shifts(first)
    spread = float((first - middle).std()) ** 2
    weight = np.ones(len(first))
    solved = np.zeros((4, 3))
    for _ in range(12):
        normal = (terms * weight[:, None]).T @ terms
        normal[1:, 1:] += 0.5 * spread * np.eye(3)
        solved = np.linalg.solve(normal, (terms * weight[:, None]).T @ goal)
        off = np.linalg.norm(goal - terms @ solved, axis=1)
        scale = max(1.5 * float(np.median(off)), 1.0)
        weight = 1.0 / (1.0 + (off / scale) ** 2)
    matrix = rigid.matrix + solved[1:].T
    return Affine(matrix, rigid.offset + solved[0] - solved[1:].T @ middle)


def rotation_deg(motion: Affine) -> float:
    """Return the angle in degrees of the rotation in a motion."""
    left, _, right = np.linalg.svd(motion.matrix)
    cosine = 0.5 * (float(np.trace(left @ right)) - 1.0)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def rigid_motion(first: Points, second: Points) -> Affine:
    """Return the rigid motion with the least squared distances of pairs (n, 3)."""
    here, there = first.mean(axis=0), second.mean(axis=0)
    left, _, right = np.linalg.svd((second - there).T @ (first - here))
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    return Affine(turn, there - turn @ here)
