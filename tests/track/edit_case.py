"""A small synthetic airway tree for tests of edits, on an oblique anisotropic grid."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from carina.track import Airways, AirwayTree, find_airways
from carina.track.find.per_volume_cache import PerVolumeCache
from carina.track.paths.path_grid import PathGrid
from carina.track.paths.rebuilt_tracker import CoreRecipe
from carina.track.paths.tracker import PathTracker
from carina.volume.model import Volume

SHAPE_ZYX = (34, 26, 32)
SPACING_MM = np.array([1.0, 1.1, 1.5])


@dataclass(frozen=True)
class EditCase:
    volume: Volume
    airways: Airways
    tips: list[NDArray[np.float64]]
    """Ends of the four small tubes, LPS mm: two on the right, two on the left."""
    hidden: NDArray[np.float64]
    """End of a tube beyond a mucus plug, which the automatic search cannot reach, LPS mm."""
    plug: NDArray[np.float64]
    """Middle of the mucus plug, LPS mm."""


def _off(points: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(points - a - along[..., None] * (b - a), axis=-1)


@cache
def edit_case() -> EditCase:
    turn, tilt = 0.15, 0.1
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    matrix = np.eye(4)
    matrix[:3, :3] = about_z @ about_x * SPACING_MM
    matrix[:3, 3] = [4.0, -30.0, 80.0]
    k, j, i = np.indices(SHAPE_ZYX)
    points = np.stack([i, j, k], axis=-1) @ matrix[:3, :3].T + matrix[:3, 3]
    centre = points[SHAPE_ZYX[0] // 2, SHAPE_ZYX[1] // 2, SHAPE_ZYX[2] // 2]

    def at(x: float, y: float, z: float) -> NDArray[np.float64]:
        return centre + np.array([x, y, z])

    carina, right, left = at(0, 0, 8), at(-7, 0, -3), at(7, 0, -3)
    tips = [at(-12, -3, -19), at(-4, 4, -19), at(4, -4, -19), at(12, 3, -19)]
    tubes = [
        (at(0, 1, 22), carina, 3.2),
        (carina, right, 2.6),
        (carina, left, 2.6),
        (right, tips[0], 1.9),
        (right, tips[1], 1.8),
        (left, tips[2], 1.8),
        (left, tips[3], 1.9),
    ]
    # The hidden tube is a branch of the trachea that is blocked near its start.
    hidden = (at(1, 2, 18), at(8, 8, 8), 1.9)
    depth = np.min([_off(points, a, b) - r for a, b, r in [*tubes, hidden]], axis=0)

    def blur(edge: float) -> NDArray[np.float64]:
        return np.clip((depth - edge) / 1.0 + 0.5, 0.0, 1.0)

    noise = np.random.default_rng(7).normal(0.0, 12.0, SHAPE_ZYX)
    values = -1000.0 + 1000.0 * blur(0.0) - 850.0 * blur(2.0) + noise
    plug = hidden[0] + 0.55 * (hidden[1] - hidden[0])
    values[np.linalg.norm(points - plug, axis=-1) < 2.9] = 40.0
    volume = Volume(np.round(values).astype(np.int16), matrix)
    airways = find_airways(volume, root_lps=tuple(at(0, 1, 20)))
    return EditCase(volume, airways, tips, hidden[1] - 0.1 * (hidden[1] - hidden[0]), plug)


@cache
def open_ended_volume() -> Volume:
    """Return the volume with the first two tubes open, so that paths lead from the tubes into plain lung."""
    case = edit_case()
    values = case.volume.hu_zyx.copy()
    k, j, i = np.indices(values.shape)
    places = case.volume.to_lps(np.stack([i, j, k], axis=-1).reshape(-1, 3).astype(np.float64))
    for tip in case.tips[:2]:
        near = (np.linalg.norm(places - tip, axis=1) < 5.0).reshape(values.shape)
        values[near & (values > -850)] = -850
    return Volume(values, case.volume.lps_from_ijk)


@cache
def open_ended_airways() -> Airways:
    """Return the airways of the case, with a tracker in the volume whose first two tubes are open."""
    airways, grid = edit_case().airways, PathGrid(open_ended_volume())
    reported = airways.tracker
    recipe = CoreRecipe(airways.wall_levels, is_edited=False)
    tracker = PathTracker(grid, reported.core, recipe=recipe, root_ijk=reported.root_ijk, lumen_zyx=reported.lumen_zyx)
    assert reported.given_nodes is not None
    tracker.set_branches(reported.branches, reported.given_nodes)
    return replace(airways, tracker=tracker, evidence=PerVolumeCache())


def in_plain_lung() -> tuple[float, float, float]:
    """Return a point (LPS mm) in plain lung that a path through an open tube reaches, without evidence of an airway."""
    x, y, z = (float(v) for v in edit_case().tips[0] + np.array([-3.0, 0.5, -3.0]))
    return x, y, z


def assert_same_tree(found: AirwayTree, expected: AirwayTree) -> None:
    """Assert that two trees have equal branches, bit for bit."""
    assert [b.id for b in found.branches] == [b.id for b in expected.branches]
    for one, other in zip(found.branches, expected.branches, strict=True):
        for key in (
            "parent",
            "children",
            "generation",
            "kind",
            "name",
            "name_from",
            "cost",
            "confidence",
            "doubtful_mm",
        ):
            assert getattr(one, key) == getattr(other, key), (one.id, key)
        np.testing.assert_array_equal(one.points, other.points, err_msg=f"points of branch {one.id}")
        np.testing.assert_array_equal(one.radius, other.radius, err_msg=f"radius of branch {one.id}")
        np.testing.assert_array_equal(one.wall_distance, other.wall_distance, err_msg=f"wall of branch {one.id}")


def assert_same(found: Airways, expected: Airways) -> None:
    """Assert equal trees, lumens, roots, and tracker results of every voxel."""
    assert_same_tree(found.tree, expected.tree)
    np.testing.assert_array_equal(found.lumen_zyx, expected.lumen_zyx)
    np.testing.assert_array_equal(found.root_lps, expected.root_lps)
    assert found.tracker.num_settled == expected.tracker.num_settled
    assert (found.edits, found.next_id) == (expected.edits, expected.next_id)
    assert found.uncertain == expected.uncertain
    assert len(found.bridges) == len(expected.bridges)
    for way, other_way in zip(found.bridges, expected.bridges, strict=True):
        np.testing.assert_array_equal(way, other_way)
    for branch in expected.tree.tips():
        one, other = (a.tracker.path_to(branch.points[-1]) for a in (found, expected))
        assert one.cost == other.cost
        np.testing.assert_array_equal(one.points_lps, other.points_lps)
        np.testing.assert_array_equal(one.branch_ids, other.branch_ids)
