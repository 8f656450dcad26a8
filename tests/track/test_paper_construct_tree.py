"""Comparisons of the path search with an implementation of Algorithm 1 from the text of the paper (6 to 6.3)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paper_construct_tree import Node, branch_nodes, construct_tree, cost_of_path, edge_costs

from carina.track.targets.paper_tracker import track_on_graph
from carina.volume.model import Volume
from vessel_phantom import bent_vessel
from volumes_of_the_paper import headsq, in_8_bits, lidc2

ACCURACY = 0.005
"""Relative accuracy of path costs, which Carina sums as integers."""


def compare_with_algorithm_1(volume: Volume, root: Node, targets: list[Node]) -> list[float]:
    """Compare the paths from a root to targets with those of Algorithm 1; return the shares of equal nodes."""
    spacing = np.array(volume.spacing_mm[::-1])
    costs = edge_costs(volume.hu_zyx.astype(np.float64), spacing)
    constructed = construct_tree(costs, root, targets)

    def point(node: Node) -> np.ndarray:
        return volume.to_lps(np.array(node[::-1], dtype=np.float64))

    result = track_on_graph(
        volume, None, [point(t) for t in targets], cost="paper", graph="voxel", root_lps=point(root), relax=False
    )
    assert result.search is not None
    assert result.search.is_whole
    shares, paths = [], []
    for target, tracked, row in zip(targets, result.targets, result.search.targets, strict=True):
        assert tracked.path is not None
        assert row is not None
        ijk = np.rint(volume.to_ijk(tracked.path.voxel_path_lps)).astype(int)
        path: list[Node] = [(k, j, i) for i, j, k in ijk[::-1].tolist()]
        assert (path[0], path[-1]) == (target, root)
        least = constructed.cost[target]
        assert least == pytest.approx(cost_of_path(costs, constructed.path(target)))
        # The sum raises an error for two nodes that are not neighbours.
        assert least * (1 - 1e-9) <= cost_of_path(costs, path) <= least * (1 + ACCURACY) + 1e-9
        assert row.cost == pytest.approx(least, rel=ACCURACY)
        shares.append(len(set(path) & set(constructed.path(target))) / len(path))
        paths.append(path)
    nodes = {tuple(np.rint(volume.to_ijk(p)).astype(int)[::-1].tolist()) for p in result.search.branch_nodes_lps}
    assert nodes == branch_nodes(paths)
    settled = [row.num_settled for row in result.search.targets if row is not None]
    # The search continues for each target: nodes of earlier targets are not settled again. Integer costs change the
    # order of nodes whose costs are nearly equal.
    slack = 3 + 0.001 * len(constructed.final)
    assert np.cumsum(settled) == pytest.approx(np.cumsum(constructed.num_settled), abs=slack)
    return shares


MIN_SHARE = 0.95
"""Minimum share of equal nodes of two paths; paths whose costs are nearly equal may differ."""


@pytest.mark.data
def test_paths_in_lidc2_equal_those_of_algorithm_1(data_dir):
    volume = lidc2(data_dir, (112, 72, 40), (40, 36, 40))
    # The root and the first target are in the descending aorta; the other targets are in the lung and at the wall.
    targets = [(26, 21, 21), (33, 5, 4), (3, 30, 36), (18, 22, 22)]
    assert min(compare_with_algorithm_1(volume, (6, 21, 21), targets)) > MIN_SHARE


@pytest.mark.data
def test_paths_in_headsq_equal_those_of_algorithm_1(data_dir):
    part = headsq(data_dir, (10, 20, 20), (36, 36, 30))
    for volume in (part, in_8_bits(part)):
        targets = [(12, 22, 12), (28, 10, 20), (1, 33, 2)]
        assert min(compare_with_algorithm_1(volume, (12, 15, 17), targets)) > MIN_SHARE


def test_paths_in_a_vessel_phantom_equal_those_of_algorithm_1():
    volume, _, root, corner, end = bent_vessel()
    nodes = [tuple(np.rint(volume.to_ijk(p)).astype(int)[::-1].tolist()) for p in (root, end, corner)]
    shares = compare_with_algorithm_1(volume, nodes[0], [*nodes[1:], (0, 0, 0), nodes[0]])
    assert min(shares) > MIN_SHARE


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_paths_in_random_volumes_equal_those_of_algorithm_1(seed, is_smooth):
    rng = np.random.default_rng(seed)
    shape = tuple(int(n) for n in rng.integers(3, 13, 3))
    values = rng.integers(0, 256, shape).astype(np.int16)
    if is_smooth:
        values = np.rint(np.cumsum(values - 128.0, axis=int(rng.integers(3)))).astype(np.int16)
    volume = Volume(values, np.diag([*rng.uniform(0.5, 2.5, 3), 1.0]))
    root, *targets = (tuple(int(rng.integers(n)) for n in shape) for _ in range(5))
    compare_with_algorithm_1(volume, root, targets)
