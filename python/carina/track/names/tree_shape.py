"""Shape of a tree for naming: bronchi without twigs and stubs (false branches and forks), with directions."""

from __future__ import annotations

import dataclasses
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.tree.airway_tree import AirwayTree, Branch

TWIG = 1.1
"""Maximum distance of a twig's tip from its parent's axis, in parent radii; a twig is a bulge of the parent's lumen."""
STUB = 0.8
"""Maximum distance of two forks that count as one fork, in radii of the airway before them."""
MAX_AT_A_FORK = 5
START_MM = 8.0
"""Length in mm from the start of a branch over which the radius is measured from which its flow is estimated."""
TIP_START_MM = 20.0
"""Length in mm from the start of a tip over which the tip's radius is measured."""
TIP_END_MM = 6.0
"""Length in mm of the end of a tip that gives the direction in which a short tip is extended."""
AHEAD_MM = (10.0, 15.0, 20.0)
"""Distances beyond a fork at which the directions of its bronchi are compared, mm."""
LEAN = 0.22
"""Backward inclination of a typical trachea, in mm per mm of descent."""


@dataclass(frozen=True, slots=True, eq=False)
class Bronchus:
    """Airway between two forks (bulges excluded); it consists of one or several branches of the tree."""

    pieces: tuple[int, ...]
    """Indices of the bronchus's branches in ``tree.branches``, in order."""
    parent: int | None
    """Index of the parent in the list of bronchi; None at the root."""
    children: tuple[int, ...]
    """Indices of the child bronchi in the list of bronchi; parents come first."""
    stubs: tuple[int, ...]
    """Indices of the branches that were merged into the fork at the end of the bronchus."""
    start: NDArray[np.float64]
    """First point (3,) of the bronchus, LPS in mm."""
    end: NDArray[np.float64]
    """Last point (3,) of the bronchus, LPS in mm."""
    length_mm: float
    radius_mm: float
    """Mean of the branches' median radii, weighted by their lengths; for a bronchus with a tip, that of its first
    20 mm."""
    direction: NDArray[np.float64]
    """Unit vector (3,) along the bronchus, LPS."""
    middle: NDArray[np.float64]
    """Centre (3,) of the tips of the tree beyond the bronchus, LPS in mm."""
    ahead: NDArray[np.float64]
    """Mean position (3,) of the airways 10 to 20 mm beyond the start of the bronchus, LPS in mm."""
    bulk_mm: float
    """Total length in mm of the airways from the start of the bronchus outwards."""
    below: tuple[int, ...]
    """Indices of all branches beyond the bronchus's own pieces, including twigs and stubs."""


@dataclass(frozen=True, slots=True, eq=False)
class Lung:
    """All bronchi of one lung."""

    members: frozenset[int]
    """Indices of the lung's bronchi in the list of bronchi."""
    middle: NDArray[np.float64]
    """Centre (3,) of the tips of the lung's airways, LPS in mm."""
    size_mm: float
    """Root mean square distance in mm of the tips from their centre."""
    unit_radius_mm: float
    """Radius in mm of a bronchus of one segment, derived from trachea and main bronchi."""


def _arc(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else np.zeros(3)


def bronchi_of(tree: AirwayTree, keep: AbstractSet[int] = frozenset()) -> list[Bronchus]:
    """Merge the branches that skeletonization divided too finely into bronchi.

    Parameters
    ----------
    tree
        The airway tree.
    keep
        Indices of branches that the user named; they are never treated as twigs or stubs.
    """
    branches = tree.branches
    place = {branch.id: number for number, branch in enumerate(branches)}
    children = [[place[child] for child in branch.children] for branch in branches]
    length = np.array([_arc(branch.points)[-1] if len(branch.points) > 1 else 0.0 for branch in branches])
    # The radius of a tip must not depend on where the search lost the tip.
    radius = np.array([float(np.median(b.radius) if b.children else _start_radius(b, TIP_START_MM)) for b in branches])
    end_radius = np.array([float(np.median(branch.radius[-max(len(branch.radius) // 3, 1) :])) for branch in branches])
    reach = length.copy()
    bulk = length.copy()
    held = np.array([number in keep for number in range(len(branches))])
    for number in range(len(branches) - 1, -1, -1):
        for child in children[number]:
            reach[number] = max(reach[number], length[number] + reach[child])
            bulk[number] += bulk[child]
            held[number] |= held[child]

    def real(number: int, parent: int) -> bool:
        return bool(held[number] or reach[number] > TWIG * end_radius[parent])

    def forks_from(number: int, before: float, stubs: list[int]) -> list[int]:
        """Return the bronchi that leave the end of a branch, directly or beyond a short piece between merged forks."""
        found: list[int] = []
        for child in (c for c in children[number] if real(c, number)):
            inner = [c for c in children[child] if real(c, child)]
            is_stub = len(inner) >= 2 and length[child] < STUB * before and child not in keep
            if is_stub:
                stubs.append(child)
                found.extend(forks_from(child, before, stubs))
            else:
                found.append(child)
        return found

    positions = _Positions(branches, children)
    made: list[Bronchus] = []
    waiting: list[tuple[int, int | None]] = [(0, None)]
    offspring: list[list[int]] = []
    while waiting:
        first, parent = waiting.pop(0)
        pieces = [first]
        stubs: list[int] = []
        while True:
            last = pieces[-1]
            stubs = []
            onward = forks_from(last, end_radius[last], stubs)
            # A user's name ends a bronchus: the continuation below is another bronchus.
            if len(onward) == 1 and not (onward[0] in keep or last in keep):
                pieces.extend([*stubs, onward[0]])
                continue
            break
        onward = sorted(onward, key=lambda child: (child not in keep, -bulk[child], child))[:MAX_AT_A_FORK]
        number = len(made)
        offspring.append([])
        if parent is not None:
            offspring[parent].append(number)
        waiting.extend((child, number) for child in onward)
        made.append(
            _bronchus(
                branches,
                pieces,
                stubs=stubs,
                parent=parent,
                children=children,
                length=length,
                radius=radius,
                positions=positions,
            )
        )
    return [dataclasses.replace(b, children=tuple(offspring[number])) for number, b in enumerate(made)]


class _Positions:
    """Positions of the airways at a distance beyond a fork, which hardly depend on the length of a tip."""

    def __init__(self, branches: tuple[Branch, ...], children: list[list[int]]) -> None:
        self._points = [branch.points for branch in branches]
        self._along = [_arc(branch.points) for branch in branches]
        self._children = children
        self._shares: list[NDArray[np.float64]] = []
        calibre = np.array([_start_radius(branch, START_MM) for branch in branches])
        for inner in children:
            area = np.maximum(calibre[inner], 1e-3) ** 2
            self._shares.append(area / area.sum())

    def position(self, number: int, distance_mm: float) -> NDArray[np.float64]:
        """Return the mean position (3,) of the airways at a distance from the start of a branch along the tree.

        A tip that ends before this distance counts as if it went on straight.
        """
        points, along = self._points[number], self._along[number]
        length_mm = float(along[-1])
        inner = self._children[number]
        if distance_mm > length_mm and inner:
            places = np.array([self.position(child, distance_mm - length_mm) for child in inner])
            return np.asarray(self._shares[number] @ places)
        if distance_mm > length_mm:
            back = _at(points, along, max(length_mm - TIP_END_MM, 0.0))
            return np.asarray(points[-1] + (distance_mm - length_mm) * _unit(points[-1] - back))
        return _at(points, along, distance_mm)


def _start_radius(branch: Branch, length_mm: float) -> float:
    """Return the median radius of a branch within a length from its start, in mm."""
    return float(np.median(branch.radius[_arc(branch.points) <= length_mm]))


def _at(points: NDArray[np.float64], along: NDArray[np.float64], distance_mm: float) -> NDArray[np.float64]:
    return np.array([np.interp(distance_mm, along, points[:, axis]) for axis in range(3)])


def _bronchus(
    branches: tuple[Branch, ...],
    pieces: list[int],
    *,
    stubs: list[int],
    parent: int | None,
    children: list[list[int]],
    length: NDArray[np.float64],
    radius: NDArray[np.float64],
    positions: _Positions,
) -> Bronchus:
    points = np.concatenate([branches[pieces[0]].points, *(branches[p].points[1:] for p in pieces[1:])])
    along = _arc(points)
    total = float(along[-1])
    weight = np.maximum(length[pieces], 1e-6)
    r = float(np.average(radius[pieces], weights=weight))
    below: list[int] = []
    waiting = [child for piece in pieces for child in children[piece] if child not in pieces]
    while waiting:
        number = waiting.pop()
        below.append(number)
        waiting.extend(children[number])
    tips = [number for number in (*below, *pieces[-1:]) if not children[number]] or [pieces[-1]]
    shares = np.sqrt(np.array([max(length[t], 1e-3) for t in tips]))
    middle = np.average([branches[t].points[-1] for t in tips], axis=0, weights=shares)
    ahead = min(total, 5.0 * max(r, 0.5))
    toward = _at(points, along, ahead) - points[0]
    if total < 2.5 * r:
        # A very short bronchus has too few points for a direction: half of it is the direction to its tips.
        toward = _unit(toward) + _unit(middle - points[0])
    return Bronchus(
        pieces=tuple(pieces),
        parent=parent,
        children=(),
        stubs=tuple(stubs),
        start=points[0],
        end=points[-1],
        length_mm=total,
        radius_mm=r,
        direction=_unit(toward),
        middle=middle,
        ahead=np.mean([positions.position(pieces[0], distance) for distance in AHEAD_MM], axis=0),
        bulk_mm=float(length[pieces].sum() + length[below].sum()),
        below=tuple(sorted(below)),
    )


def find_lungs(bronchi: list[Bronchus]) -> dict[int, Lung]:
    """Return the two lungs, by the fork that divides the tree to left and right; empty if there is no such fork."""
    best: tuple[float, int, int] | None = None
    whole = bronchi[0].bulk_mm
    for bronchus in bronchi:
        for one in bronchus.children:
            for two in bronchus.children:
                a, b = bronchi[one], bronchi[two]
                if one == two or min(a.bulk_mm, b.bulk_mm) < 0.12 * whole:
                    continue
                right, left = a.middle - bronchus.end, b.middle - bronchus.end
                apart = left[0] - right[0]
                if right[0] < -0.2 * np.linalg.norm(right) and left[0] > 0.2 * np.linalg.norm(left):
                    score = apart * min(a.bulk_mm, b.bulk_mm)
                    if best is None or score > best[0]:
                        best = (score, one, two)
    if best is None:
        return {}
    found: dict[int, Lung] = {}
    roots = [bronchi[number] for number in best[1:]]
    trunk = roots[0].parent
    assert trunk is not None
    # The median of three: a narrowed main bronchus has no effect.
    unit = sorted([bronchi[trunk].radius_mm / 18.0 ** (1 / 3), *(b.radius_mm / 9.0 ** (1 / 3) for b in roots)])[1]
    for root in best[1:]:
        members, waiting = [], [root]
        while waiting:
            number = waiting.pop()
            members.append(number)
            waiting.extend(bronchi[number].children)
        tips = np.array([bronchi[m].end for m in members if not bronchi[m].children])
        middle = tips.mean(axis=0)
        size = float(np.sqrt(((tips - middle) ** 2).sum(axis=1).mean()))
        if len(tips) >= 4 and size > 0.0:
            lung = Lung(frozenset(members), middle, size, unit)
            found.update(dict.fromkeys(members, lung))
    return found


def body_frame(bronchi: list[Bronchus], lungs: dict[int, Lung]) -> NDArray[np.float64]:
    """Estimate the body axes from trachea and lungs: rows left, posterior, superior in LPS."""
    middles = {id(lung): lung.middle for lung in lungs.values()}
    trunk = bronchi[0]
    frame = np.eye(3)
    if len(middles) == 2 and trunk.children:
        one, two = sorted(middles.values(), key=lambda middle: float(middle[0]))
        left = _unit(two - one)
        down = _unit(trunk.end - trunk.start)
        if trunk.length_mm > 5.0 * trunk.radius_mm and down[2] < -0.5:
            up = _unit(-down - (-down @ left) * left)
            back = np.cross(up, left)
            # Compensate the inclination of the trachea: its lower end is further back.
            up = _unit(up + LEAN * back)
            left = _unit(left - (left @ up) * up)
            frame = np.stack([left, np.cross(up, left), up])
    return frame


def refined_frame(
    frame: NDArray[np.float64],
    seen: NDArray[np.float64],
    expected: NDArray[np.float64],
    weights: NDArray[np.float64],
    *,
    steadiness: float = 4.0,
) -> NDArray[np.float64]:
    """Return the rotation near ``frame`` that best turns the measured directions of bronchi to the expected directions.

    Parameters
    ----------
    frame
        (3, 3) present frame: rows left, posterior, superior in LPS.
    seen, expected
        (n, 3) directions: seen in LPS, expected in the body frame.
    weights
        (n,) weights of the directions.
    steadiness
        Weight of each axis of the present frame, relative to the observations.
    """
    given = np.concatenate([seen, frame])
    wanted = np.concatenate([expected, np.eye(3)])
    weight = np.concatenate([weights, np.full(3, steadiness)])
    u, _, vt = np.linalg.svd((wanted * weight[:, None]).T @ given)
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    result: NDArray[np.float64] = turn
    return result
