"""Path tracking, written from sections 6 to 6.3 of the paper alone, in NumPy and plain Python.

This module shares no code with the kernels and with Carina's reference implementations; tests compare the kernels with
this module.
Arrays are ``[z, y, x]``, and nodes are indices in the same order.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Node = tuple[int, int, int]

STEPS: list[Node] = [step for step in itertools.product((-1, 0, 1), repeat=3) if step != (0, 0, 0)]

# Section 6.2: "Experiments show that w_g = 0.7 and w_z = 0.3 give acceptable results."
GRADIENT_WEIGHT = 0.7
LAPLACIAN_WEIGHT = 0.3

# The printed f_g has the divisor max(G) and reaches -1, but Dijkstra's algorithm needs costs of at least 0.
DIVISOR = 2.0
# Carina departs from the paper in edges that would cost less than this per mm.
SMALLEST_WEIGHT = 1.0 / 256.0


def beside(values: Floats, step: tuple[int, ...]) -> Floats:
    """Return for each voxel the value of its neighbour at ``step``.

    The paper does not define the border of a volume; there the nearest voxel of the volume is used.
    """
    padded: Floats = np.pad(values, 1, mode="edge")
    return padded[tuple(slice(1 + s, 1 + s + n) for s, n in zip(step, values.shape, strict=True))]


def gradient_magnitude(values: Floats, spacing_zyx: Floats) -> Floats:
    """Return G(u) of section 6.2: the length of the gradient vector (I_x, I_y, I_z), by central differences per mm."""
    parts = [
        (beside(values, ahead) - beside(values, behind)) / (2.0 * spacing)
        for ahead, behind, spacing in zip(
            [(1, 0, 0), (0, 1, 0), (0, 0, 1)], [(-1, 0, 0), (0, -1, 0), (0, 0, -1)], spacing_zyx, strict=True
        )
    ]
    return np.sqrt(parts[0] ** 2 + parts[1] ** 2 + parts[2] ** 2)


def laplacian(values: Floats) -> Floats:
    """Return the discrete Laplacian of section 6.2: (27 V - sum of the 27 voxels round V) / 26."""
    total = sum((beside(values, step) for step in itertools.product((-1, 0, 1), repeat=3)), np.zeros(values.shape))
    return (27.0 * values - total) / 26.0


def edge_costs(values: Floats, spacing_zyx: Floats) -> dict[Node, Floats]:
    """Return cost(u, v) of section 6.2 for each of the 26 edges of each voxel u, by the step from u to v.

    An edge that leaves the volume has an infinite cost.
    """
    gradient = gradient_magnitude(values, spacing_zyx)
    zero_crossing = laplacian(values)
    largest = gradient.max()
    costs = {}
    for step in STEPS:
        length = np.linalg.norm(np.array(step) * spacing_zyx)
        f_g = 1.0 - (gradient + beside(gradient, step)) / (DIVISOR * largest)
        f_z = np.where(zero_crossing * beside(zero_crossing, step) <= 0.0, 0.0, 1.0)
        weight = np.maximum(GRADIENT_WEIGHT * f_g + LAPLACIAN_WEIGHT * f_z, SMALLEST_WEIGHT)
        inside = beside(np.pad(np.ones(values.shape), 1), step)[1:-1, 1:-1, 1:-1] > 0.0
        costs[step] = np.where(inside, length * weight, np.inf)
    return costs


@dataclass(frozen=True)
class ConstructedTree:
    """Result of Algorithm 1: back pointers and costs of the nodes, and the nodes whose cost is final.

    ``num_settled`` is the number of nodes whose cost became final in the search for each target.
    """

    root: Node
    pointer: dict[Node, Node]
    cost: dict[Node, float]
    final: set[Node]
    num_settled: list[int]

    def path(self, target: Node) -> list[Node]:
        """Return the path {v, B(v), B(B(v)), ..., r} from a target to the root."""
        path = [target]
        while path[-1] != self.root:
            path.append(self.pointer[path[-1]])
        return path


def construct_tree(costs: dict[Node, Floats], root: Node, targets: list[Node]) -> ConstructedTree:
    """Run Algorithm 1: search from the root for each target, and continue the earlier search from where it stopped.

    Line 6 compares B(u) with nil. Here a search starts if u was not yet removed from the queue, because the back
    pointer of a node in the queue may still change.
    """
    shape = costs[STEPS[0]].shape
    edges = [(step, cost.ravel().tolist()) for step, cost in costs.items()]
    tree = ConstructedTree(root, {}, {root: 0.0}, set(), [])
    queue: list[tuple[float, Node]] = [(0.0, root)]
    for target in targets:
        before = len(tree.final)
        while queue and target not in tree.final:
            cost, u = heapq.heappop(queue)
            if u in tree.final:
                continue
            tree.final.add(u)
            at = (u[0] * shape[1] + u[1]) * shape[2] + u[2]
            for step, cost_of in edges:
                longer = cost + cost_of[at]
                v = (u[0] + step[0], u[1] + step[1], u[2] + step[2])
                if longer < tree.cost.get(v, np.inf):
                    tree.cost[v] = longer
                    tree.pointer[v] = u
                    heapq.heappush(queue, (longer, v))
        tree.num_settled.append(len(tree.final) - before)
    return tree


def cost_of_path(costs: dict[Node, Floats], path: list[Node]) -> float:
    """Return the sum of the edge costs of a path in the direction from its last node, the root, to its first."""
    total = 0.0
    for v, u in itertools.pairwise(path):
        total += float(costs[v[0] - u[0], v[1] - u[1], v[2] - u[2]][u])
    return total


def branch_nodes(paths: list[list[Node]]) -> set[Node]:
    """Return the branch nodes of figure 13(b): those to which two or more other nodes of the paths point."""
    pointing: dict[Node, set[Node]] = {}
    for path in paths:
        for node, parent in itertools.pairwise(path):
            pointing.setdefault(parent, set()).add(node)
    return {node for node, others in pointing.items() if len(others) > 1}
