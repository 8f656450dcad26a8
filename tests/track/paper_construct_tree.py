"""Path tracking, written from sections 6 to 6.3 of the paper alone, in NumPy and plain Python.

This module shares no code with the kernels and with Carina's reference implementations; tests compare the kernels with it.
Arrays are ``[z, y, x]``, and nodes are indices in the same order.
"""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Node = tuple[int, int, int]

STEPS = [step for step in itertools.product((-1, 0, 1), repeat=3) if step != (0, 0, 0)]

# Section 6.2: "Experiments show that w_g = 0.7 and w_z = 0.3 give acceptable results."
GRADIENT_WEIGHT = 0.7
LAPLACIAN_WEIGHT = 0.3


def gradient_magnitude(values: Floats, spacing_zyx: Floats) -> Floats:
    """Return G(u) of section 6.2: the length of the gradient vector, by central differences, one-sided at the border."""
    return np.sqrt(sum(part**2 for part in np.gradient(values, *spacing_zyx)))  # type: ignore[no-any-return]


def laplacian(values: Floats) -> Floats:
    """Return the discrete Laplacian of section 6.2: (27 V - sum of the 27 voxels round V) / 26.

    The paper does not define the border; there the nearest voxel of the volume is used.
    """
    padded = np.pad(values, 1, mode="edge")
    total = np.zeros(values.shape)
    for step in itertools.product(range(3), repeat=3):
        total += padded[tuple(slice(s, s + n) for s, n in zip(step, values.shape, strict=True))]
    return (27.0 * values - total) / 26.0


@dataclass
class PathGraph:
    """The graph of section 6: each voxel is a node with 26 edges, whose costs are those of section 6.2."""

    values: Floats
    spacing_zyx: Floats
    # The printed f_g reaches -1 with a divisor of max(G), and Dijkstra's algorithm needs costs of at least 0.
    divisor: float = 2.0
    smallest_weight: float = 0.0
    gradient: Floats = field(init=False)
    laplacian: Floats = field(init=False)

    def __post_init__(self) -> None:
        """Compute gradient and Laplacian of each voxel."""
        self.gradient = gradient_magnitude(self.values, self.spacing_zyx)
        self.laplacian = laplacian(self.values)

    def cost(self, u: Node, v: Node) -> float:
        """Return the cost of the edge between two neighbours."""
        length = float(np.linalg.norm((np.array(u) - v) * self.spacing_zyx))
        f_g = 1.0 - (self.gradient[u] + self.gradient[v]) / (self.divisor * self.gradient.max())
        f_z = 0.0 if self.laplacian[u] * self.laplacian[v] <= 0.0 else 1.0
        weight = GRADIENT_WEIGHT * f_g + LAPLACIAN_WEIGHT * f_z
        return length * max(float(weight), self.smallest_weight)

    def neighbours(self, u: Node) -> list[Node]:
        """Return the neighbours of a node that are inside the volume."""
        near = []
        for step in STEPS:
            v = (u[0] + step[0], u[1] + step[1], u[2] + step[2])
            if all(0 <= i < n for i, n in zip(v, self.values.shape, strict=True)):
                near.append(v)
        return near


class BackPointers:
    """The result of Algorithm 1 (section 6.3): B(u) and the cost of each node that a search from the root has reached."""

    def __init__(self, graph: PathGraph, root: Node, targets: list[Node]) -> None:
        """Run Algorithm 1: search from the root for each target, and continue the earlier search where it stopped."""
        self.graph = graph
        self.root = root
        self.pointer: dict[Node, Node] = {}
        self.costs: dict[Node, float] = {root: 0.0}
        self.final: set[Node] = set()
        self.searches = 0
        self._queue: list[tuple[float, Node]] = [(0.0, root)]
        for target in targets:
            # Line 6 compares B(u) with nil. The back pointer of a node that was reached but not removed from the queue
            # may still change, so a path is known when its target has been removed from the queue.
            if target not in self.final:
                self._dijkstra(target)

    def _dijkstra(self, target: Node) -> None:
        self.searches += 1
        while self._queue:
            cost, u = heapq.heappop(self._queue)
            if u in self.final:
                continue
            self.final.add(u)
            for v in self.graph.neighbours(u):
                longer = cost + self.graph.cost(u, v)
                if longer < self.costs.get(v, np.inf):
                    self.costs[v] = longer
                    self.pointer[v] = u
                    heapq.heappush(self._queue, (longer, v))
            if u == target:
                return

    def path(self, target: Node) -> list[Node]:
        """Return the path {v, B(v), B(B(v)), ..., r} from a target to the root."""
        path = [target]
        while path[-1] != self.root:
            path.append(self.pointer[path[-1]])
        return path

    def branch_nodes(self, targets: list[Node]) -> set[Node]:
        """Return the nodes of the tree that two or more other nodes of the tree point to (figure 13b)."""
        children: dict[Node, set[Node]] = {}
        for target in targets:
            path = self.path(target)
            for node, parent in itertools.pairwise(path):
                children.setdefault(parent, set()).add(node)
        return {node for node, pointing in children.items() if len(pointing) > 1}
