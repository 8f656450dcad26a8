"""The shape of a tree as the namer sees it: bronchi without twigs and stubs, their directions, what lies beyond."""

from __future__ import annotations

import dataclasses
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.track.tree.airway_tree import AirwayTree, Branch

__all__ = ["Bronchus", "Lung", "body_frame", "bronchi_of", "find_lungs"]

TWIG = 1.1
"""A tip that ends within this many radii of its parent's axis does not leave the parent's lumen."""
STUB = 0.8
"""Two forks closer than this many radii of the airway before them are one fork into three."""
MAX_AT_A_FORK = 5
LEAN = 0.22
"""How far a trachea leans back on its way down, per mm."""


@dataclass(frozen=True, slots=True, eq=False)
class Bronchus:
    """A stretch of airway between two forks that count; one or several branches of the tree."""

    pieces: tuple[int, ...]
    """Places in ``tree.branches``, in order."""
    parent: int | None
    children: tuple[int, ...]
    """Places in the list of bronchi; parents come first."""
    stubs: tuple[int, ...]
    """Branches that were merged into the fork at its end."""
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    length_mm: float
    radius_mm: float
    direction: NDArray[np.float64]
    """Unit vector, LPS."""
    middle: NDArray[np.float64]
    """Middle of the tips beyond it, LPS."""
    bulk_mm: float
    """Length of all airway from its start outwards."""
    below: tuple[int, ...]
    """All branches beyond its own pieces, twigs and stubs included."""


@dataclass(frozen=True, slots=True, eq=False)
class Lung:
    """All bronchi of one lung."""

    members: frozenset[int]
    middle: NDArray[np.float64]
    size_mm: float
    """Root mean square distance of its tips from the middle."""
    unit_radius_mm: float
    """Radius of a bronchus of one segment, from those of trachea and main bronchi: flow goes with its cube."""


def _arc(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])


def _unit(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-9 else np.zeros(3)


def bronchi_of(tree: AirwayTree, keep: AbstractSet[int] = frozenset()) -> list[Bronchus]:
    """Merge what a thinning over-split.

    Parameters
    ----------
    keep
        Places of branches that are neither twigs nor stubs, whatever they look like: a person named them.
    """
    branches = tree.branches
    place = {branch.id: number for number, branch in enumerate(branches)}
    children = [[place[child] for child in branch.children] for branch in branches]
    length = np.array([_arc(branch.points)[-1] if len(branch.points) > 1 else 0.0 for branch in branches])
    radius = np.array([float(np.median(branch.radius)) for branch in branches])
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
        """Bronchi that leave the end of a branch, through stubs."""
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
            # A person's name ends a bronchus: what goes on below it is another one.
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
            _bronchus(branches, pieces, stubs=stubs, parent=parent, children=children, length=length, radius=radius)
        )
    return [dataclasses.replace(b, children=tuple(offspring[number])) for number, b in enumerate(made)]


def _bronchus(
    branches: tuple[Branch, ...],
    pieces: list[int],
    *,
    stubs: list[int],
    parent: int | None,
    children: list[list[int]],
    length: NDArray[np.float64],
    radius: NDArray[np.float64],
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
    toward = np.array([np.interp(ahead, along, points[:, axis]) for axis in range(3)]) - points[0]
    if total < 2.5 * r:
        # Too short to have a direction of its own: half of it is that of what it leads to.
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
        bulk_mm=float(length[pieces].sum() + length[below].sum()),
        below=tuple(sorted(below)),
    )


def find_lungs(bronchi: list[Bronchus]) -> dict[int, Lung]:
    """The two lungs by the fork that parts the tree to the left and the right; empty where there is none."""
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
    # The middle one of three: a narrowed main bronchus does not count.
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
    """A first guess of the body's axes from trachea and lungs: rows left, posterior, superior in LPS."""
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
            # Undo the trachea's own lean: its lower end lies further back.
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
    """The rotation that best brings the seen directions (n, 3; LPS) to the expected ones (n, 3; body), near ``frame``.

    ``steadiness`` is the weight of each axis of the present frame beside the observations.
    """
    given = np.concatenate([seen, frame])
    wanted = np.concatenate([expected, np.eye(3)])
    weight = np.concatenate([weights, np.full(3, steadiness)])
    u, _, vt = np.linalg.svd((wanted * weight[:, None]).T @ given)
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    result: NDArray[np.float64] = turn
    return result
