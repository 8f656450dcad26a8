"""Tests of the resumable path tracker through its Python interface."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carina._core import LumenTracker


def tracker_of(lumen: np.ndarray, root_ijk: tuple[int, int, int]) -> tuple[LumenTracker, np.ndarray]:
    """Return a tracker on a lumen of 1 x 1.5 x 2.5 mm voxels, rotated by 20 degrees."""
    matrix = np.eye(4)
    c, s = np.cos(0.35), np.sin(0.35)
    matrix[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) * [1.0, 1.5, 2.5]
    matrix[:3, 3] = [5.0, -7.0, 11.0]
    values = np.where(lumen, -1000, 0).astype(np.int16)
    root = matrix[:3, :3] @ root_ijk + matrix[:3, 3]
    core = LumenTracker(values, matrix, lumen.astype(np.uint8), levels=None, root_lps=tuple(root), reach_mm=0.1)
    return core, matrix


@settings(max_examples=25)
@given(bits=st.lists(st.booleans(), min_size=210, max_size=210), order=st.permutations(range(12)))
def test_path_costs_of_targets_in_any_order_equal_those_of_a_complete_search(bits, order):
    lumen = np.array(bits).reshape(5, 6, 7)
    lumen[0, 0, 0] = True
    whole, _ = tracker_of(lumen, (0, 0, 0))
    whole.solve_all()
    resumed, _ = tracker_of(lumen, (0, 0, 0))
    for node in (n * resumed.num_nodes // 12 for n in order):
        reached = resumed.solve_to(node)
        assert reached == (whole.cost(node) is not None)
        assert resumed.cost(node) == whole.cost(node)
        if reached:
            assert np.array_equal(resumed.path(node)[0], whole.path(node)[0])
    assert resumed.num_settled <= whole.num_settled


def test_cost_of_a_straight_corridor_is_its_length_times_its_weight():
    lumen = np.zeros((3, 3, 20), bool)
    lumen[1, 1, 2:18] = True
    core, matrix = tracker_of(lumen, (2, 1, 1))
    end = matrix[:3, :3] @ [17, 1, 1] + matrix[:3, 3]
    node, distance = core.nearest(tuple(end), 0.1)
    assert distance == pytest.approx(0.0, abs=1e-9)
    assert core.solve_to(node)
    points, nodes = core.path(node)
    assert len(nodes) == 16
    assert np.allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), 1.0)
    # The wall is half a voxel away: 0.75 mm along y, the shortest distance; at both ends of the corridor 0.5 mm along
    # x.
    weight, end_weight = (10.0 / 0.75) ** 3, (10.0 / 0.5) ** 3
    expected = 14 * weight + end_weight
    # The tolerance of 0.5 % is the rounding to integer costs.
    assert core.cost(node) == pytest.approx(expected, rel=0.005)


def test_threads_get_correct_path_costs_while_another_thread_searches():
    lumen = np.ones((40, 40, 40), bool)
    lumen[0] = lumen[-1] = False
    core, _ = tracker_of(lumen, (20, 20, 20))
    calls = []

    def look() -> bool:
        calls.append(core.num_nodes)
        return False

    with ThreadPoolExecutor(4) as pool:
        jobs = [pool.submit(core.solve_all, cancel=look)]
        jobs += [pool.submit(lambda n: (core.num_settled, core.cost(n)), n) for n in range(200)]
        for job in jobs:
            job.result(timeout=60)
    assert core.num_settled == core.num_nodes
