"""Tests that no path crosses a wall between neighbouring airways, and tests of unusual lumens and points."""

from __future__ import annotations

import numpy as np
import pytest

import carina
from carina.errors import NoResultError
from carina.track import Airways
from carina.volume.model import Volume

RADIUS_MM = 4.2
SHAPE = (66, 74, 82)
SPACING = (0.8, 0.9, 1.0)


def turned(seed: int) -> np.ndarray:
    """Return a random 3x3 rotation matrix for a seed."""
    q = np.random.default_rng(seed).normal(size=4)
    w, x, y, z = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def off_segment(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(points - a - along[..., None] * (b - a), axis=-1)


def hairpin(seed: int) -> tuple[Volume, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a CT with noise of two parallel tubes, which a third tube connects at one end.

    The wall between the parallel tubes is one voxel thick. The other results are the middle of the open end of the
    first and of the second tube, and the points of both axes at the connection.
    """
    matrix = np.diag([*SPACING, 1.0])
    k, j, i = np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij")
    points = np.stack([i, j, k], axis=-1) * np.array(SPACING)
    centre = 0.5 * (np.array(SHAPE[::-1]) - 1) * np.array(SPACING)
    turn = turned(seed)
    # The wall has the thickness of a voxel across the wall, from face to face.
    wall = float(np.abs(turn[:, 0]) @ np.array(SPACING))
    half = RADIUS_MM + 0.5 * wall

    def at(x: float, z: float) -> np.ndarray:
        return centre + turn @ np.array([x, 0.0, z])

    first, second = (at(-half, 18.0), at(-half, -18.0)), (at(half, 18.0), at(half, -18.0))
    tubes = [first, second, (first[1], second[1])]
    depth = np.min([off_segment(points, a, b) for a, b in tubes], axis=0) - RADIUS_MM
    # The value of a voxel at the edge is a mixture of air and tissue, by its depth.
    air = np.clip(0.5 - depth / 0.9, 0.0, 1.0)
    values = air * -1000.0 + (1.0 - air) * 40.0 + np.random.default_rng(seed).normal(0.0, 15.0, SHAPE)
    return Volume(np.rint(values).astype(np.int16), matrix), first[0], second[0], first[1], second[1]


@pytest.mark.parametrize("seed", range(20))
def test_path_does_not_cross_a_wall_of_one_voxel_between_two_tubes(seed):
    volume, root, target, first_end, second_end = hairpin(seed)
    airways = carina.find_airways(volume, root_lps=root)
    path = airways.tracker.path_to(target)
    # The path leads down one tube and up the other; through the wall it would be 10 mm long.
    assert path.length_mm > 60.0
    assert airways.tracker.inside(path.points_lps).all()
    assert airways.tracker.inside(path.voxel_path_lps).all()
    first = off_segment(path.points_lps, root, first_end)
    second = off_segment(path.points_lps, target, second_end)
    # The path changes the tube only at the connection.
    changes = np.flatnonzero(np.diff((first < second).astype(int)))
    assert len(changes) >= 1
    joint = 0.5 * (first_end + second_end)
    assert np.linalg.norm(path.points_lps[changes] - joint, axis=1).max() < 2.0 * RADIUS_MM + 2.0
    assert np.array_equal(airways.tracker.live_path(target).points_lps, path.points_lps)


def painted(lumen: np.ndarray, root: tuple[float, float, float]) -> Airways:
    values = np.where(lumen, -1000, 40).astype(np.int16)
    volume = Volume(values, np.diag([1.0, 1.2, 1.5, 1.0]))
    return carina.find_airways(volume, root_lps=root, lumen_zyx=lumen.astype(np.uint8))


def test_path_follows_a_lumen_one_voxel_wide_to_its_end():
    lumen = np.zeros((12, 12, 60), bool)
    lumen[4:8, 4:8, 2:30] = True
    lumen[6, 6, 30:58] = True
    airways = painted(lumen, (3.0, 6.0, 9.0))
    live = airways.tracker.live_path((57.0, 7.2, 9.0))
    assert live.problem is None
    assert live.snapped_mm == 0.0
    assert live.length_mm == pytest.approx(54.0, abs=2.0)
    # The lumen is one voxel wide, so the wall is half a voxel away.
    assert live.min_radius_mm == pytest.approx(0.5, abs=0.15)
    assert airways.tracker.inside(live.points_lps).all()


def test_path_states_the_wall_distance_and_the_radius_of_the_lumen():
    lumen = np.zeros((13, 20, 60), bool)
    lumen[4:9, 3:17, 2:58] = True
    airways = painted(lumen, (3.0, 1.2 * 10, 9.0))
    path = airways.tracker.path_to((55.0, 1.2 * 10, 9.0))
    middle = np.abs(path.points_lps[:, 0] - 30.0) < 15.0
    # The section is a slit of 7.5 by 17 mm.
    assert path.wall_mm[middle] == pytest.approx(3.75, abs=0.1)
    assert (path.radius_mm[middle] > 5.0).all()


def test_path_in_a_loop_takes_the_shorter_side_once():
    lumen = np.zeros((9, 50, 50), bool)
    lumen[3:6, 5:45, 5:8] = lumen[3:6, 5:45, 42:45] = True
    lumen[3:6, 5:8, 5:45] = lumen[3:6, 42:45, 5:45] = True
    airways = painted(lumen, (6.0, 1.2 * 6, 6.0))
    path = airways.tracker.path_to((43.0, 1.2 * 20, 6.0))
    # The short side of the loop is 37 mm + 17 mm; the other side is 37 + 43 + 25 mm.
    assert path.length_mm < 65.0
    ids = [tuple(p) for p in np.round(path.voxel_path_lps, 3)]
    assert len(set(ids)) == len(ids)


def test_path_across_a_gap_in_the_lumen_is_refused_with_a_remedy():
    lumen = np.zeros((9, 9, 60), bool)
    lumen[3:6, 3:6, 2:28] = lumen[3:6, 3:6, 34:58] = True
    airways = painted(lumen, (3.0, 4.8, 6.0))
    behind = (50.0, 4.8, 6.0)
    live = airways.tracker.live_path(behind)
    assert len(live.points_lps) == 0
    assert live.confidence is None
    assert "not connected" in live.problem
    assert "Bridge" in live.problem
    with pytest.raises(NoResultError, match="not connected"):
        airways.tracker.path_to(behind)
    assert any("not connected" in note for note in airways.notes)


def test_root_in_tissue_is_refused_and_a_target_in_tissue_is_reported():
    lumen = np.zeros((20, 20, 60), bool)
    lumen[3:6, 3:6, 2:58] = True
    with pytest.raises(NoResultError, match="5"):
        painted(lumen, (30.0, 1.2 * 15, 1.5 * 15))
    airways = painted(lumen, (3.0, 4.8, 6.0))
    far = (30.0, 1.2 * 15, 1.5 * 15)
    with pytest.raises(NoResultError, match="mm from the segmented lumen"):
        airways.tracker.path_to(far)
    live = airways.tracker.live_path(far)
    assert "soft tissue" in live.problem
    assert "paint" in live.problem
