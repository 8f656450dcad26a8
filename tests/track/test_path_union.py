"""Tests of the tree of paths whose points are not nodes of one graph."""

from __future__ import annotations

import numpy as np
import pytest

from cached_test_data import COARSE_CHEST, cached_airways
from carina.track.targets.path_union import tree_of_paths
from carina.track.targets.relaxed_path import evenly_spaced
from carina.track.tree.airway_tree import AirwayTree


@pytest.fixture(scope="module")
def airways():
    return cached_airways(**COARSE_CHEST)


def distance_mm(points: np.ndarray, branches) -> float:
    """Return the largest distance of points from the branches."""
    every = np.concatenate([evenly_spaced(branch.points, 0.5) for branch in branches])
    return float(np.linalg.norm(points[:, None] - every[None], axis=2).min(axis=1).max())


@pytest.mark.parametrize("seed", range(8))
def test_tree_of_paths_joins_at_branch_ends_and_contains_every_path(airways, seed):
    rng = np.random.default_rng(seed)
    tips = airways.tree.tips()
    chosen = rng.choice(len(tips), int(rng.integers(1, 7)))
    paths = [airways.tracker.path_to(tips[number].points[-1]).points_lps for number in chosen]
    branches, forks = tree_of_paths(paths, airways)
    AirwayTree(branches)
    assert [branch.id for branch in branches] == list(range(len(branches)))
    assert [branch.id for branch in branches if branch.parent is None] == [0]
    for branch in branches:
        assert len(branch.points) == len(branch.radius) > 1
        assert all(branches[child].parent == branch.id for child in branch.children)
        if branch.parent is not None:
            parent = branches[branch.parent]
            assert branch.id in parent.children
            assert branch.generation == parent.generation + int(len(parent.children) > 1)
            assert np.array_equal(branch.points[0], parent.points[-1])
    for path in paths:
        assert distance_mm(path[-1:], branches) < 4.0
        assert distance_mm(path, branches) < 12.0
    ends = [branch for branch in branches if not branch.children]
    assert len(ends) == len(set(chosen.tolist()))
    assert len(forks) == sum(len(branch.children) > 1 for branch in branches)


def test_tree_of_one_path_is_one_branch_and_equal_paths_add_none(airways):
    path = airways.tracker.path_to(airways.tree.tips()[0].points[-1]).points_lps
    for paths in ([path], [path, path], [path, path[:20]], [path[:1], path]):
        branches, forks = tree_of_paths(paths, airways)
        assert len(branches) == 1
        assert np.array_equal(branches[0].points, path)
        assert len(forks) == 0
    assert tree_of_paths([path[:1]], airways)[0] == ()


def test_longer_path_is_the_continuation_of_a_shorter_path_along_it(airways):
    path = airways.tracker.path_to(airways.tree.tips()[0].points[-1]).points_lps
    branches, forks = tree_of_paths([path[:30], path], airways)
    assert len(branches) == 2
    assert branches[1].parent == 0
    assert [branch.generation for branch in branches] == [0, 0]
    assert np.array_equal(branches[1].points[-1], path[-1])
    assert len(forks) == 0


def test_paths_outside_the_lumen_fork_where_they_diverge(airways):
    trunk = airways.tree.branches[0].points
    start, away = trunk[len(trunk) // 2], np.array([40.0, 0.0, 0.0])
    one = evenly_spaced(np.stack([start, start + away, start + 2 * away]), 1.0)
    other = evenly_spaced(np.stack([start, start + away, start + away + away[[1, 0, 2]]]), 1.0)
    branches, forks = tree_of_paths([one, other], airways)
    assert [branch.generation for branch in branches] == [0, 1, 1]
    assert np.linalg.norm(forks[0] - (start + away)) < 6.0
