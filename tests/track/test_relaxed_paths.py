"""Tests of relaxed paths (cost ``walls``): they stay in the tube, are not longer, and cross no further wall."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cached_test_data import COARSE_CHEST, cached_airways, cached_phantom
from carina.track.targets import paper_tracker
from carina.track.targets.excursions import find_excursions, flyable_path, shortest_path, wide_lumen
from carina.track.targets.paper_tracker import search_box, track_on_graph
from carina.track.targets.relaxed_path import (
    CHECKED_SHARES,
    MAX_ROUNDS,
    ROUNDS_PER_CHECK,
    SETTLED_SHARE,
    evenly_spaced,
    relaxed_in_tube,
    relaxed_path,
    tube_around,
    wall_crossings,
)
from carina.volume.model import Volume
from carina_bench.track_walls import mean_turn_deg

SLOW = (HealthCheck.too_slow,)


def length_mm(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def random_case(seed: int) -> tuple[Volume, np.ndarray]:
    """Return a volume of noise and steps on an oblique grid, and a chain of neighbouring voxels in it, LPS mm."""
    rng = np.random.default_rng(seed)
    shape = rng.integers(6, 24, 3)
    values = rng.normal(0.0, rng.choice([0.0, 5.0, 50.0]), shape) + rng.choice([0.0, 300.0]) * (rng.random(shape) > 0.6)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = turn * rng.uniform(0.5, 3.0, 3)
    matrix[:3, 3] = rng.uniform(-100.0, 100.0, 3)
    volume = Volume(np.rint(values).astype(np.int16), matrix)
    last = shape[::-1] - 1
    chain = [rng.integers(0, last + 1)]
    for _ in range(int(rng.integers(0, 80))):
        chain.append(np.clip(chain[-1] + rng.integers(-1, 2, 3), 0, last))
    return volume, volume.to_lps(np.array(chain, dtype=np.float64))


def relaxed_one_by_one(points: np.ndarray, tube) -> np.ndarray:
    """Relax a path point by point: the slow reference of :func:`relaxed_in_tube`."""
    points = points.copy()
    before = length_mm(points)
    for number in range(1, MAX_ROUNDS + 1):
        for first in (1, 2):
            for n in range(first, len(points) - 1, 2):
                middle = 0.5 * (points[n - 1] + points[n + 1])
                checked = [
                    neighbour + share * (middle - neighbour)
                    for share in CHECKED_SHARES
                    for neighbour in (points[n - 1], points[n + 1])
                ]
                if all(bool(tube.inside(point[None])[0]) for point in checked):
                    points[n] = middle
        if number % ROUNDS_PER_CHECK == 0:
            after = length_mm(points)
            if before - after <= SETTLED_SHARE * before:
                break
            before = after
    return points


@settings(max_examples=40, deadline=None, suppress_health_check=SLOW)
@given(seed=st.integers(0, 2**32 - 1))
def test_relaxed_path_stays_in_its_tube_is_not_longer_and_has_the_same_ends(seed):
    volume, chain = random_case(seed)
    relaxed = relaxed_path(volume, None, chain)
    assert np.allclose(relaxed[[0, -1]], chain[[0, -1]], atol=1e-9)
    assert length_mm(relaxed) <= length_mm(chain) + 1e-9
    tube = tube_around(volume, None, chain)
    assert tube.inside(relaxed).all()
    assert tube.inside(evenly_spaced(chain, 0.2)).mean() > 0.98
    steps = np.linalg.norm(np.diff(relaxed, axis=0), axis=1)
    assert (steps < 2.0).all()


@settings(max_examples=5, deadline=None, suppress_health_check=SLOW)
@given(seed=st.integers(0, 2**32 - 1))
def test_relaxation_equals_the_relaxation_point_by_point(seed):
    volume, chain = random_case(seed)
    points = evenly_spaced(chain, 1.0)[:16]
    if len(points) < 3:
        return
    tube = tube_around(volume, None, chain)
    assert np.array_equal(relaxed_in_tube(points, tube), relaxed_one_by_one(points, tube))


@pytest.fixture(scope="module")
def chest():
    volume, airways = cached_phantom(**COARSE_CHEST).volume, cached_airways(**COARSE_CHEST)
    ends = [tip.points[-1] for tip in airways.tree.tips()][:3]
    return volume, airways, ends


@pytest.fixture(scope="module")
def results(chest):
    """Return the results of one search without and with relaxation."""
    volume, airways, ends = chest
    # A box round the targets makes the search short.
    box = search_box(volume, [airways.root_lps, *ends], max_bytes=22 * 600_000)
    return [
        track_on_graph(volume, airways, ends, cost="walls", graph="voxel", relax=relax, box_ijk=box)
        for relax in (False, True)
    ]


def test_relaxed_paths_in_a_phantom_reach_the_targets_of_length_turn_and_inside_share(chest, results):
    volume, airways, _ = chest
    wide = wide_lumen(airways.lumen_zyx != 0)
    searched, relaxed = results
    assert (searched.search.is_relaxed, relaxed.search.is_relaxed) == (False, True)
    for before, after, row in zip(searched.targets, relaxed.targets, relaxed.search.targets, strict=True):
        assert np.array_equal(before.path.voxel_path_lps, after.path.voxel_path_lps)
        assert before.path.cost == after.path.cost
        assert row.search_length_mm == pytest.approx(length_mm(before.path.voxel_path_lps))
        lumen = airways.tracker.path_to(after.requested_lps).points_lps
        points = after.path.points_lps
        assert length_mm(points) <= 1.05 * length_mm(lumen)
        assert mean_turn_deg(points) <= 6.0 < mean_turn_deg(before.path.points_lps)
        near = [int(np.linalg.norm(lumen - point, axis=1).argmin()) for point in points]
        i, j, k = np.rint(volume.to_ijk(lumen)).astype(int).T
        assert airways.tracker.inside(points)[wide[k, j, i][near]].all()


def test_branches_of_relaxed_paths_join_at_their_ends(results):
    tree = results[1].tree
    by_id = {branch.id: branch for branch in tree.branches}
    assert len(tree.branches) > 1
    for branch in tree.branches:
        assert len(branch.points) == len(branch.radius)
        if branch.parent is not None:
            assert np.allclose(branch.points[0], by_id[branch.parent].points[-1])


def test_a_path_through_tissue_is_marked_at_its_crossings_like_that_of_the_search(chest):
    volume, airways, _ = chest
    tube = airways.tree.branches[0]
    beside = tube.points[len(tube.points) // 2] + np.array([25.0, 10.0, 0.0])
    box = search_box(volume, [airways.root_lps, beside], max_bytes=22 * 400_000)
    searched, relaxed = (
        track_on_graph(volume, airways, [beside], cost="walls", graph="voxel", relax=relax, box_ijk=box)
        for relax in (False, True)
    )
    before, after = searched.search.targets[0].crossings, relaxed.search.targets[0].crossings
    assert [one.enters for one in after] == [one.enters for one in before]
    assert after[0].enters is False
    for one, other in zip(before, after, strict=True):
        assert np.linalg.norm(np.subtract(one.lps, other.lps)) < 10.0


def test_crossings_alternate_and_the_length_between_them_is_the_length_outside(chest):
    _, airways, _ = chest
    trunk = airways.tree.branches[0].points
    middle = trunk[len(trunk) // 2]
    line = np.stack([middle, middle + np.array([40.0, 0.0, 0.0]), middle, trunk[-1]])
    crossings = wall_crossings(line, airways)
    assert [one.enters for one in crossings] == [bool(n % 2) for n in range(len(crossings))]
    outside = sum(b.along_mm - a.along_mm for a, b in zip(crossings[::2], crossings[1::2], strict=True))
    assert outside == pytest.approx(2 * (40.0 - crossings[0].along_mm), abs=2.0)
    assert wall_crossings(trunk, airways) == ()


def test_printed_cost_is_not_relaxed(chest):
    volume, airways, _ = chest
    near = airways.tree.branches[0].points[-1]
    box = search_box(volume, [airways.root_lps, near], max_bytes=22 * 200_000)
    result = track_on_graph(volume, airways, [near], cost="paper", graph="voxel", box_ijk=box)
    assert not result.search.is_relaxed
    path = result.targets[0].path
    assert np.allclose(path.points_lps, evenly_spaced(path.voxel_path_lps, 1.0))


def test_a_path_that_leaves_a_wide_lumen_takes_the_way_through_the_lumen(chest):
    volume, airways, _ = chest
    trunk = airways.tree.branches[0].points
    first, last = trunk[len(trunk) // 4], trunk[3 * len(trunk) // 4]
    beside = np.array([15.0, 0.0, 0.0])
    nodes = evenly_spaced(np.stack([first, first + beside, last + beside, last]), 1.0)
    tube_only = relaxed_path(volume, airways, nodes)
    assert wall_crossings(tube_only, airways)
    (excursion,) = find_excursions(volume, airways, tube_only)
    assert excursion.is_beside_wide_lumen
    path = flyable_path(volume, airways, nodes)
    assert np.allclose(path[[0, -1]], nodes[[0, -1]], atol=1e-9)
    assert airways.tracker.inside(path).all()
    assert length_mm(path) <= 1.05 * np.linalg.norm(last - first)
    assert (np.linalg.norm(np.diff(path, axis=0), axis=1) < 2.0).all()


def test_a_path_from_one_branch_through_the_lung_into_another_has_no_detour_in_the_wrong_branch(chest):
    volume, airways, _ = chest
    tree = airways.tree
    fork = next(branch for branch in tree.branches if len(branch.children) > 1)
    one, other = (tree.branch(child).points[-1] for child in fork.children[:2])
    chain = [airways.tracker.path_to(one).points_lps, other[None]]
    nodes = evenly_spaced(np.concatenate(chain), 1.0)
    path = flyable_path(volume, airways, nodes)
    lumen = airways.tracker.path_to(other).points_lps
    assert airways.tracker.inside(path[:-1]).all()
    assert length_mm(path) <= 1.05 * length_mm(lumen)
    assert mean_turn_deg(path) <= 6.0


def test_paths_that_begin_outside_the_lumen_or_stay_in_it_are_only_relaxed(chest, results):
    volume, airways, _ = chest
    trunk = airways.tree.branches[0].points
    vessel = trunk + np.array([20.0, 8.0, 0.0])
    assert find_excursions(volume, airways, evenly_spaced(vessel, 1.0)) == []
    for nodes in (vessel, results[0].targets[0].path.voxel_path_lps):
        assert np.array_equal(flyable_path(volume, airways, nodes), relaxed_path(volume, airways, nodes))


@pytest.mark.parametrize("seed", range(6))
def test_excursions_remain_only_where_they_are_shorter_and_beside_narrow_lumen(seed, chest):
    volume, airways, _ = chest
    rng = np.random.default_rng(seed)
    tips = [tip.points[-1] for tip in airways.tree.tips()]
    one, other = rng.choice(len(tips), 2, replace=False)
    there = airways.tracker.path_to(tips[one]).points_lps
    leave = there[rng.integers(len(there) // 2, len(there))]
    nodes = np.concatenate([there[: np.flatnonzero((there == leave).all(axis=1))[0] + 1], tips[other][None]])
    tube_only = relaxed_path(volume, airways, nodes)
    path = flyable_path(volume, airways, nodes)
    assert np.allclose(path[[0, -1]], nodes[[0, -1]], atol=1e-9)
    excursions = find_excursions(volume, airways, tube_only)
    if any(excursion.is_beside_wide_lumen for excursion in excursions):
        assert not np.array_equal(path, tube_only)
    elif not np.array_equal(path, tube_only):
        assert length_mm(path) <= length_mm(tube_only) + 1.0
    remaining = find_excursions(volume, airways, path)
    assert not any(excursion.is_beside_wide_lumen for excursion in remaining)
    outside = path[~airways.tracker.inside(path)][:, None]
    assert len(outside) == 0 or np.linalg.norm(outside - tube_only[None], axis=2).min(axis=1).max() < 5.0


def test_the_shortest_path_of_a_matrix_equals_the_exhaustive_search():
    for seed in range(20):
        lengths = np.random.default_rng(seed).uniform(1.0, 9.0, (6, 6))
        lengths[np.random.default_rng(seed).random((6, 6)) < 0.4] = np.inf
        lengths[0, 1] = lengths[1, 5] = 50.0
        inner = [way for count in range(5) for way in itertools.permutations(range(1, 5), count)]
        costs = [sum(lengths[a, b] for a, b in itertools.pairwise((0, *way, 5))) for way in inner]
        found = shortest_path(lengths, 5)
        assert sum(lengths[a, b] for a, b in itertools.pairwise(found)) == pytest.approx(min(costs))


def test_tree_and_wall_crossings_use_the_path_without_its_excursion_from_the_lumen(chest, results, monkeypatch):
    volume, airways, ends = chest
    box = search_box(volume, [airways.root_lps, *ends], max_bytes=22 * 600_000)

    def with_excursion(volume, airways, nodes, **more):
        path = relaxed_path(volume, airways, nodes, **more)
        first, last = len(path) // 8, len(path) // 4
        beside = path[[first, last]] + np.array([15.0, 0.0, 0.0])
        return path if more else np.concatenate([path[: first + 1], evenly_spaced(beside, 1.0), path[last:]])

    monkeypatch.setattr(paper_tracker, "relaxed_path", with_excursion)
    result = track_on_graph(volume, airways, ends, cost="walls", graph="voxel", box_ijk=box)
    every = np.concatenate([branch.points for branch in result.tree.branches])
    assert airways.tracker.inside(every).all()
    assert [branch.id for branch in result.tree.branches if branch.parent is None] == [0]
    for target, row, plain in zip(result.targets, result.search.targets, results[1].targets, strict=True):
        assert row.outside_mm < 0.8, "more than half a voxel"
        assert row.crossings == ()
        assert target.path.length_mm <= 1.02 * plain.path.length_mm
        assert np.linalg.norm(target.path.points_lps[-1] - every, axis=1).min() < 0.1
