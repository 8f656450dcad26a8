"""Tests of the path through the airways between two points."""

from __future__ import annotations

import itertools

import numpy as np

from carina.track import way_between
from small_case import BRANCHES_IJK, small_tree, small_volume

TREE = small_tree(small_volume().lps_from_ijk)


def test_path_between_two_points_follows_centrelines_up_and_down_without_jumps():
    places = [(branch, n) for branch in TREE.branches for n in range(0, len(branch.points), 4)]
    widest = max(np.linalg.norm(np.diff(b.points, axis=0), axis=1).max() for b in TREE.branches)
    known = {tuple(point) for branch in TREE.branches for point in branch.points}
    from_root = {}
    for branch in TREE.branches:
        lineage = TREE.lineage(branch.id)
        before = sum(one.length_mm for one in lineage[:-1])
        steps = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(branch.points, axis=0), axis=1))])
        from_root |= {tuple(p): before + mm for p, mm in zip(branch.points, steps, strict=True)}
    for (one, n), (other, m) in itertools.product(places, places):
        start, end = one.points[n], other.points[m]
        found = way_between(TREE, start, end)
        if np.array_equal(start, end):
            assert found is None
            continue
        points, apex = found
        np.testing.assert_array_equal(points[0], start)
        np.testing.assert_array_equal(points[-1], end)
        assert {tuple(p) for p in points} <= known
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        assert steps.min() > 0.0
        assert steps.max() <= widest + 1e-9
        depth = np.array([from_root[tuple(p)] for p in points])
        # The path first leads towards the root, then away from the root.
        assert (np.diff(depth[: apex + 1]) < 0).all()
        assert (np.diff(depth[apex:]) > 0).all()


def test_path_between_points_beside_the_airways_joins_the_nearest_airway_positions():
    left, right = (small_volume().to_lps(np.array(BRANCHES_IJK[n][1][1])) for n in (2, 3))
    points, apex = way_between(TREE, left + np.array([0.4, 0.3, 0.0]), right + np.array([0.0, 0.5, -0.2]))
    np.testing.assert_array_equal(points[[0, -1]], [TREE.branch(2).points[-1], TREE.branch(3).points[-1]])
    np.testing.assert_array_equal(points[apex], TREE.branch(0).points[-1])
