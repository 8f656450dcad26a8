"""Tests of least-cost paths in a field of weights, against Dijkstra's algorithm with a heap."""

from __future__ import annotations

import heapq

import numpy as np
import pytest

from carina.errors import CancelledError, GeometryError, NoResultError, TrackingError, UsageError
from carina.track import FieldPaths, aimed_path
from carina.volume.model import Volume

OFFSETS = [(k, j, i) for k in (-1, 0, 1) for j in (-1, 0, 1) for i in (-1, 0, 1) if (k, j, i) != (0, 0, 0)]


def volume_of(shape_zyx: tuple[int, int, int]) -> Volume:
    matrix = np.eye(4)
    c, s = np.cos(0.4), np.sin(0.4)
    matrix[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) * [0.8, 1.1, 2.5]
    matrix[:3, 3] = [10.0, -20.0, 5.0]
    return Volume(np.zeros(shape_zyx, np.int16), matrix)


def at(volume: Volume, i: int, j: int, k: int) -> np.ndarray:
    return volume.to_lps(np.array([float(i), float(j), float(k)]))


def heap(field: np.ndarray, root_zyx: tuple[int, int, int], spacing: tuple[float, ...] | None) -> np.ndarray:
    """Return the cost of each voxel by Dijkstra's algorithm with a heap, in floating point.

    With a spacing the cost of an edge uses the weights of both ends and the length in mm; without a spacing it is the
    weight of the entered voxel.
    """
    cost = np.full(field.shape, np.inf)
    cost[root_zyx] = 0.0
    queue = [(0.0, root_zyx)]
    while queue:
        here, u = heapq.heappop(queue)
        if here > cost[u]:
            continue
        for step in OFFSETS:
            v = tuple(a + b for a, b in zip(u, step, strict=True))
            if any(x < 0 or x >= n for x, n in zip(v, field.shape, strict=True)) or not np.isfinite(field[v]):
                continue
            edge = field[v]
            if spacing is not None:
                edge = 0.5 * (field[u] + field[v]) * np.linalg.norm(np.array(step)[::-1] * spacing)
            if here + edge < cost[v]:
                cost[v] = here + edge
                heapq.heappush(queue, (cost[v], v))
    return cost


@pytest.mark.parametrize("cost", ["mean", "enter"])
def test_path_costs_in_a_field_equal_those_of_a_heap_search_within_half_a_percent(cost):
    rng = np.random.default_rng(5)
    volume = volume_of((6, 7, 8))
    field = rng.uniform(1.0, 40.0, volume.shape_zyx).astype(np.float32)
    field[rng.random(field.shape) < 0.15] = np.inf
    field[0, 0, 0] = 1.0
    truth = heap(field.astype(float), (0, 0, 0), volume.spacing_mm if cost == "mean" else None)
    paths = FieldPaths(volume, field, at(volume, 0, 0, 0), cost=cost)
    for k, j, i in np.ndindex(field.shape):
        target = at(volume, i, j, k)
        if not np.isfinite(truth[k, j, i]):
            with pytest.raises(NoResultError, match="no path"):
                paths.path_to(target)
            continue
        found = paths.path_to(target)
        assert found.cost == pytest.approx(truth[k, j, i], rel=0.005)
        assert tuple(found.voxels_ijk[-1]) == (i, j, k)
        assert np.abs(np.diff(found.voxels_ijk, axis=0)).max(initial=0) <= 1
        assert np.allclose(found.points_lps[-1], target)
    assert paths.num_settled == np.isfinite(truth).sum()


def test_path_cost_of_integer_weights_is_their_exact_sum():
    rng = np.random.default_rng(6)
    volume = volume_of((7, 8, 9))
    field = rng.integers(0, 200, volume.shape_zyx).astype(np.float32)
    truth = heap(field.astype(float), (3, 4, 5), None)
    paths = FieldPaths(volume, field, at(volume, 5, 4, 3), cost="enter")
    assert paths.quantum == 1.0
    for k, j, i in np.ndindex(field.shape):
        assert paths.path_to(at(volume, i, j, k)).cost == truth[k, j, i]


def test_path_in_a_field_stays_in_the_given_region_and_mask():
    volume = volume_of((5, 20, 20))
    field = np.full(volume.shape_zyx, 10.0, np.float32)
    # A path of low cost exists outside the box.
    field[:, 15, :] = 1.0
    box = ((2, 18), (3, 12), (1, 4))
    paths = FieldPaths(volume, field, at(volume, 3, 4, 2), region_ijk=box)
    found = paths.path_to(at(volume, 17, 11, 3))
    for axis, (low, high) in enumerate(box):
        assert (found.voxels_ijk[:, axis] >= low).all()
        assert (found.voxels_ijk[:, axis] < high).all()
    assert paths.num_open == 16 * 9 * 3
    with pytest.raises(UsageError, match="region"):
        paths.path_to(at(volume, 19, 15, 2))
    mask = np.zeros(volume.shape_zyx, np.uint8)
    mask[2, 4, 3:18] = 1
    masked = FieldPaths(volume, field, at(volume, 3, 4, 2), mask_zyx=mask)
    assert len(masked.path_to(at(volume, 17, 4, 2)).voxels_ijk) == 15
    with pytest.raises(NoResultError, match="wall"):
        masked.path_to(at(volume, 17, 5, 2))


def test_path_from_or_to_a_forbidden_voxel_is_refused_with_a_message():
    volume = volume_of((4, 5, 6))
    ones = np.ones(volume.shape_zyx, np.float32)
    root = at(volume, 1, 1, 1)
    with pytest.raises(GeometryError, match="grid"):
        FieldPaths(volume, ones[1:], root)
    with pytest.raises(GeometryError, match="mask"):
        FieldPaths(volume, ones, root, mask_zyx=np.ones((1, 1, 1), np.uint8))
    with pytest.raises(UsageError, match="float32"):
        FieldPaths(volume, ones.astype(np.float64), root)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="outside"):
        FieldPaths(volume, ones, (900.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="mean or enter"):
        FieldPaths(volume, ones, root, cost="length")  # type: ignore[arg-type]
    for weight, error in ((-1.0, UsageError), (0.0, UsageError), (1e9, TrackingError)):
        field = ones.copy()
        field[3, 3, 3] = weight
        with pytest.raises(error):
            FieldPaths(volume, field, root)
    with_wall = ones.copy()
    with_wall[1, 1, 1] = np.nan
    with pytest.raises(NoResultError, match="root"):
        FieldPaths(volume, with_wall, root)


def test_cancelled_search_reaches_every_voxel_when_resumed():
    volume = Volume(np.zeros((90, 90, 90), np.int16), np.eye(4))
    field = np.random.default_rng(1).uniform(1.0, 3.0, volume.shape_zyx).astype(np.float32)
    paths = FieldPaths(volume, field, (45.0, 45.0, 45.0))
    seen: list[tuple[str, float | None]] = []
    checks = iter([True])
    # Cancellation is checked by real time, so a fast machine may finish without a check.
    try:
        paths.solve_all(cancel=lambda: next(checks, False), progress=lambda what, share: seen.append((what, share)))
    except CancelledError:
        assert paths.num_settled < paths.num_open
        paths.solve_all()
    assert paths.num_settled == paths.num_open == 90**3
    assert sum(paths.num_bytes) <= 6 * 90**3


@pytest.mark.parametrize("cost", ["mean", "enter"])
def test_cost_of_a_search_for_one_target_equals_that_of_a_complete_search(cost):
    rng = np.random.default_rng(7)
    volume = volume_of((9, 10, 11))
    field = rng.uniform(1.0, 6.0, volume.shape_zyx).astype(np.float32)
    field[rng.random(field.shape) < 0.15] = np.inf
    field[3, 4, 5] = 1.0
    mask = (rng.random(field.shape) < 0.9).astype(np.uint8)
    mask[3, 4, 5] = 1
    root, box = at(volume, 5, 4, 3), ((1, 11), (0, 9), (1, 9))
    paths = FieldPaths(volume, field, root, cost=cost, region_ijk=box, mask_zyx=mask)
    refused = 0
    for k, j, i in np.ndindex(field.shape):
        target = at(volume, i, j, k)
        try:
            found = paths.path_to(target)
        except (NoResultError, UsageError) as error:
            refused += 1
            with pytest.raises(type(error)):
                aimed_path(volume, field, root, target, cost=cost, region_ijk=box, mask_zyx=mask)
            continue
        aimed = aimed_path(volume, field, root, target, cost=cost, region_ijk=box, mask_zyx=mask)
        assert aimed.cost == found.cost
        assert tuple(aimed.voxels_ijk[-1]) == (i, j, k)
        assert np.allclose(aimed.points_lps[0], root)
        assert np.abs(np.diff(aimed.voxels_ijk, axis=0)).max(initial=0) <= 1
        assert (mask[tuple(aimed.voxels_ijk.T[::-1])] != 0).all()
    assert 0 < refused < field.size


def test_search_for_one_target_refuses_invalid_arguments_with_a_message():
    volume = Volume(np.zeros((90, 90, 90), np.int16), np.eye(4))
    field = np.ones(volume.shape_zyx, np.float32)
    ends = ((1.0, 1.0, 1.0), (88.0, 88.0, 88.0))
    assert aimed_path(volume, field, *ends, cost="enter").num_settled == 88
    with pytest.raises(UsageError, match="float32"):
        aimed_path(volume, field.astype(np.float64), *ends)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="outside"):
        aimed_path(volume, field, ends[0], (900.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="mean or enter"):
        aimed_path(volume, field, *ends, cost="length")  # type: ignore[arg-type]
    field[80] = np.inf
    with pytest.raises(NoResultError, match="no path"):
        aimed_path(volume, field, *ends)


def test_compiled_module_returns_the_time_of_each_path():
    volume = volume_of((10, 10, 10))
    paths = FieldPaths(volume, np.ones(volume.shape_zyx, np.float32), at(volume, 0, 0, 0))
    paths.solve_all()
    ns, voxels = paths.core.time_paths([(9, 9, 9), (0, 0, 0), (3, 0, 0)])
    assert (ns >= 0).all()
    assert list(voxels[1:]) == [1, 4]
