"""Tests of the path to the point under the pointer: length, width, position, confidence and time."""

from __future__ import annotations

import numpy as np
import pytest

import carina
from carina.errors import UsageError
from carina.track.paths.live_path import _perpendicular_vectors


def tip_of(chest, number: int) -> np.ndarray:
    start, end, _radius = chest.tubes[number]
    return end + 0.1 * (start - end)


def test_live_path_equals_the_path_of_a_click(chest, found):
    live = found.tracker.live_path(tip_of(chest, 3))
    path = found.tracker.path_to(tip_of(chest, 3))
    assert live.problem is None
    assert np.array_equal(live.points_lps, path.points_lps)
    assert live.length_mm == path.length_mm
    assert live.snapped_mm == 0.0


def test_live_path_in_a_bronchus_with_a_wall_has_high_confidence(chest, found):
    for number in range(1, len(chest.tubes)):
        live = found.tracker.live_path(tip_of(chest, number))
        assert live.confidence > 0.7, (number, live.confidence)
        # The least radius is that of the narrowest tube on the path; a voxel is 1.0 to 1.6 mm wide.
        assert live.min_radius_mm == pytest.approx(chest.tubes[number][2], abs=1.3)


def test_live_path_to_a_point_in_the_tree_is_new_only_beyond_the_centreline(chest, found):
    live = found.tracker.live_path(tip_of(chest, 2))
    assert live.new_mm < 2.0 * chest.tubes[2][2]
    ids = {branch.id for branch in found.tree.branches}
    assert live.joins_branch_id in ids


def test_live_path_through_a_leak_into_lung_has_low_confidence(chest, found):
    # The tube through lung simulates a leak: it has lung values and no wall.
    _start, end, _radius = chest.tubes[3]
    outward = end + np.linspace(-0.3, 1.0, 60)[:, None] * np.array([-12.0, 6.0, -14.0])
    lumen = found.lumen_zyx.copy()
    ijk = np.indices(lumen.shape)[::-1].reshape(3, -1).T.astype(float)
    points = chest.volume.to_lps(ijk)
    low, high = outward.min(axis=0) - 3.0, outward.max(axis=0) + 3.0
    near = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
    distance = np.linalg.norm(points[near, None, :] - outward[None, :, :], axis=2).min(axis=1)
    lumen.reshape(-1)[near[distance < 2.2]] = 1
    has_leaked = carina.find_airways(chest.volume, lumen_zyx=lumen, root_lps=found.root_lps)
    has_leaked.tracker.set_branches(has_leaked.tree.branches[:1], has_leaked.tracker._branch_nodes[:1])
    leak = has_leaked.tracker.live_path(outward[-5])
    bronchus = has_leaked.tracker.live_path(tip_of(chest, 5))
    assert leak.problem is None
    assert leak.new_mm > 20.0
    assert leak.confidence < 0.4
    assert bronchus.confidence > leak.confidence + 0.3


def test_live_path_to_a_point_beside_an_airway_ends_in_the_airway_with_less_confidence(chest, found):
    inside = found.tracker.live_path(tip_of(chest, 1))
    start, end, radius = chest.tubes[1]
    across = np.cross(end - start, [0.0, 0.0, 1.0])
    beside = tip_of(chest, 1) + across / np.linalg.norm(across) * (radius + 3.0)
    live = found.tracker.live_path(beside)
    assert live.problem is None
    assert 1.0 < live.snapped_mm <= 5.0
    assert live.confidence < inside.confidence
    assert found.tracker.live_path(beside, reach_mm=0.5).problem is not None


def test_live_path_to_a_point_outside_the_lumen_is_reported_with_a_remedy(chest, found):
    volume = chest.volume
    centre = volume.centre_lps
    lung = found.tracker.live_path(centre + np.array([-28.0, 18.0, -14.0]))
    assert "lung" in lung.problem
    assert "mm away" in lung.problem
    assert "paint" in lung.problem
    tissue = found.tracker.live_path(centre + np.array([0.0, 24.0, 30.0]))
    assert "soft tissue" in tissue.problem
    air = found.tracker.live_path(volume.to_lps(np.array([2.0, 2.0, 2.0])))
    assert "air" in air.problem
    for live in (lung, tissue, air):
        assert live.points_lps.shape == (0, 3)
        assert live.confidence is None


def test_live_path_to_a_point_outside_the_volume_is_an_error(found):
    with pytest.raises(UsageError, match="outside the scan"):
        found.tracker.live_path((9000.0, 0.0, 0.0))


def test_live_path_exists_to_every_point_in_the_lumen(chest, found):
    voxels = np.argwhere(found.lumen_zyx)
    chosen = voxels[np.random.default_rng(3).integers(0, len(voxels), 200)][:, ::-1].astype(float)
    for point in chest.volume.to_lps(chosen):
        live = found.tracker.live_path(point)
        assert live.problem is None
        assert 0.0 <= live.confidence <= 1.0
        assert live.new_mm <= live.length_mm + 1e-9


def test_noise_directions_are_perpendicular_to_a_path_of_any_point_density():
    along = np.array([1.0, 2.0, -2.0]) / 3.0
    path = np.linspace(0.0, 1.0, 11)[:, None] * along
    u, v = _perpendicular_vectors(path[3:6], path)
    assert np.allclose(u @ along, 0.0)
    assert np.allclose(v @ along, 0.0)
    assert np.allclose([np.linalg.norm(u, axis=1), np.linalg.norm(v, axis=1)], 1.0)
