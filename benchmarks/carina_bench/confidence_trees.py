"""Airway trees for the calibration of names: true trees with noise and missing branches, and trees of other shapes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.track import AirwayTree, Branch

__all__ = ["degraded", "random_tree", "turned", "vessel_tree", "warped"]

Points = NDArray[np.float64]


def turned(tree: AirwayTree, matrix: NDArray[np.float64]) -> AirwayTree:
    """Return the tree with every point multiplied by a 3x3 matrix of determinant 1 or -1."""
    return AirwayTree(tuple(dataclasses.replace(b, points=b.points @ matrix.T) for b in tree.branches))


def degraded(tree: AirwayTree, rng: np.random.Generator, *, amount: float = 1.0) -> AirwayTree:
    """Return the tree as the search would find it in a poor CT: with noise, missing and additional branches.

    ``amount`` 0 to 1 scales all changes: noise of up to 2.5 mm that varies over about 10 mm, up to a third of the tips
    removed, up to four bronchi removed with all their descendants, and up to twelve twigs added.
    """
    tree = _cut(tree, rng, amount)
    tree = _grown_over(tree, rng, round(12.0 * amount * rng.random()))
    size_mm = 2.5 * amount * rng.random()
    moved: dict[int | None, Points] = {None: np.zeros(3)}
    tips: dict[int, Points] = {}
    made = []
    for branch in tree.branches:
        begin = moved[branch.parent]
        end = rng.normal(size=3) * size_mm * 0.7
        part = np.linspace(0.0, 1.0, len(branch.points))[:, None]
        points = branch.points + begin * (1.0 - part) + end * part
        if branch.parent is not None:
            points[0] = tips[branch.parent]
        tips[branch.id] = points[-1]
        moved[branch.id] = end
        radius = branch.radius * np.exp(rng.normal() * 0.12 * amount)
        made.append(dataclasses.replace(branch, points=points, radius=radius))
    return AirwayTree(tuple(made))


def warped(tree: AirwayTree, rng: np.random.Generator, spread_deg: float) -> AirwayTree:
    """Return a tree of another anatomy: each bronchus is turned at random about its start, with all its descendants."""
    moves: dict[int | None, tuple[NDArray[np.float64], Points]] = {None: (np.eye(3), np.zeros(3))}
    ends: dict[int, Points] = {}
    made = []
    for branch in tree.branches:
        matrix, offset = moves[branch.parent]
        axis = rng.normal(size=3) * np.radians(spread_deg) / np.sqrt(3.0) * (0.2 if branch.parent is None else 1.0)
        start = matrix @ branch.points[0] + offset
        matrix = _rotation(axis) @ matrix
        offset = start - matrix @ branch.points[0]
        points = branch.points @ matrix.T + offset
        if branch.parent is not None:
            points[0] = ends[branch.parent]
        ends[branch.id] = points[-1]
        moves[branch.id] = matrix, offset
        made.append(dataclasses.replace(branch, points=points))
    return AirwayTree(tuple(made))


def _rotation(axis: Points) -> NDArray[np.float64]:
    angle = float(np.linalg.norm(axis))
    k = axis / max(angle, 1e-12)
    cross = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    turn: NDArray[np.float64] = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return turn


def _cut(tree: AirwayTree, rng: np.random.Generator, amount: float) -> AirwayTree:
    deepest = int(rng.integers(4, 9)) if amount > 0.0 and rng.random() < 0.5 else 99
    share = amount * rng.random() / 3.0
    removed: set[int] = set()
    inner = [b.id for b in tree.branches if 3 <= b.generation <= 5]
    lost = rng.choice(inner, round(4.0 * amount * rng.random()), replace=False).tolist()
    for b in tree.branches:
        is_tip = not b.children and b.generation > 3
        if b.parent in removed or b.id in lost or b.generation > deepest or (is_tip and rng.random() < share):
            removed.add(b.id)
    return AirwayTree(
        tuple(
            dataclasses.replace(b, children=tuple(c for c in b.children if c not in removed))
            for b in tree.branches
            if b.id not in removed
        )
    )


def _grown_over(tree: AirwayTree, rng: np.random.Generator, num: int) -> AirwayTree:
    """Return the tree with ``num`` blind tubes added at the sides of branches; each tube divides its branch in two."""
    branches = {b.id: b for b in tree.branches}
    hosts = [b.id for b in tree.branches if len(b.points) > 8 and b.parent is not None]
    for host in rng.choice(hosts, min(num, len(hosts)), replace=False).tolist():
        b = branches[host]
        at = int(rng.integers(3, len(b.points) - 3))
        lower, twig = 1 + max(branches), 2 + max(branches)
        ahead = b.points[at + 1] - b.points[at]
        side = np.cross(ahead, rng.normal(size=3)) + ahead * np.linalg.norm(ahead)
        side *= (float(b.radius[at]) + rng.uniform(2.0, 20.0)) / max(float(np.linalg.norm(side)), 1e-9)
        branches[lower] = dataclasses.replace(
            b, id=lower, parent=b.id, points=b.points[at:], radius=b.radius[at:], generation=b.generation + 1
        )
        for child in b.children:
            branches[child] = dataclasses.replace(branches[child], parent=lower)
        branches[b.id] = dataclasses.replace(
            b, points=b.points[: at + 1], radius=b.radius[: at + 1], children=(lower, twig)
        )
        points = b.points[at] + np.linspace(0.0, 1.0, 6)[:, None] * side
        radius = np.full(6, 0.5 * float(b.radius[at]))
        branches[twig] = Branch(twig, b.id, (), b.generation + 1, None, "tracked", points, radius)
    made: list[Branch] = []
    waiting = [tree.root.id]
    while waiting:
        made.append(branches[waiting.pop(0)])
        waiting.extend(made[-1].children)
    return AirwayTree(tuple(made))


def random_tree(rng: np.random.Generator, *, generations: int = 6, two_lungs: bool = False) -> AirwayTree:
    """Return a tree of binary forks at random angles; the calibres follow the cube law.

    With ``two_lungs`` the first fork is like a carina.
    """
    made: list[tuple[int, int | None, list[int], int, Points, float]] = []

    def grow(parent: int | None, start: Points, ahead: Points, radius_mm: float, generation: int) -> int:
        number = len(made)
        length_mm = 90.0 if parent is None else float(radius_mm * rng.uniform(3.0, 8.0))
        bend = rng.normal(size=3) * 0.15
        along = np.linspace(0.0, 1.0, 12)[:, None]
        points = start + along * length_mm * ahead + along**2 * length_mm * bend
        children: list[int] = []
        made.append((number, parent, children, generation, points, radius_mm))
        if generation < generations and (generation < 4 or rng.random() < 0.8):
            side = np.cross(ahead, rng.normal(size=3))
            if generation == 0 and two_lungs:
                side = np.array([-1.0, 0.0, 0.0])
            side /= np.linalg.norm(side)
            share = rng.uniform(0.25, 0.75)
            for sign, part in ((1.0, share), (-1.0, 1.0 - share)):
                turn = np.radians(rng.uniform(20.0, 65.0))
                way = np.cos(turn) * ahead + sign * np.sin(turn) * side
                children.append(
                    grow(number, points[-1], way / np.linalg.norm(way), radius_mm * part ** (1 / 3), generation + 1)
                )
        return number

    grow(None, np.array([0.0, 0.0, 90.0]), np.array([0.0, 0.0, -1.0]), 8.0, 0)
    return AirwayTree(
        tuple(
            Branch(number, parent, tuple(children), generation, None, "tracked", points, np.full(len(points), radius))
            for number, parent, children, generation, points, radius in made
        )
    )


def vessel_tree(tree: AirwayTree, rng: np.random.Generator, *, is_vein: bool) -> AirwayTree:
    """Return a tree of arteries, or of veins if ``is_vein``, whose tips are between the tips of an airway tree.

    Starting at the tips, neighbouring vessels are joined first, towards the heart.
    """
    tips = np.array([b.points[-1] for b in tree.tips()])
    ends = tips + rng.normal(size=tips.shape) * (9.0 if is_vein else 4.0)
    heart = np.array([0.0, -5.0, -45.0]) if is_vein else np.array([10.0, -30.0, -25.0])
    nodes: list[tuple[Points, tuple[int, ...], int]] = [(end, (), 1) for end in ends]

    def joined(members: Sequence[int]) -> int:
        left = list(members)
        while len(left) > 1:
            places = np.array([nodes[k][0] for k in left])
            apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
            np.fill_diagonal(apart, np.inf)
            i, j = np.unravel_index(int(np.argmin(apart)), apart.shape)
            one, two = left[int(i)], left[int(j)]
            middle = 0.5 * (nodes[one][0] + nodes[two][0])
            toward = heart - middle
            far = float(np.linalg.norm(toward))
            fork = middle + toward / max(far, 1e-9) * min(0.5 * far, 0.6 * float(apart[i, j]) + 4.0)
            nodes.append((fork, (one, two), nodes[one][2] + nodes[two][2]))
            left = [k for k in left if k not in (one, two)] + [len(nodes) - 1]
        return left[0]

    if is_vein:
        # Two vessels on each side, from above and below the hilum.
        groups = [
            [k for k, end in enumerate(ends) if (end[0] < 0) == right and (end[2] > np.median(ends[:, 2])) == upper]
            for right in (True, False)
            for upper in (True, False)
        ]
    else:
        groups = [[k for k, end in enumerate(ends) if (end[0] < 0) == right] for right in (True, False)]
    roots = tuple(joined(group) for group in groups if group)
    start = heart + np.array([0.0, -10.0, 0.0] if is_vein else [0.0, -20.0, -40.0])
    branches: list[Branch] = []

    def emit(node: int | None, parent: int | None, begin: Points, generation: int) -> int:
        place, children, num = (heart, roots, len(ends)) if node is None else nodes[node]
        number = len(branches)
        points = begin + np.linspace(0.0, 1.0, 10)[:, None] * (place - begin)
        points[-1] = place
        radius = np.full(10, 12.0 * (num / len(ends)) ** (1 / 3))
        branches.append(Branch(number, parent, (), generation, None, "tracked", points, radius))
        below = tuple(emit(child, number, points[-1], generation + 1) for child in children)
        branches[number] = dataclasses.replace(branches[number], children=below)
        return number

    emit(None, None, start, 0)
    return AirwayTree(tuple(branches))
