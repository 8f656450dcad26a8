"""Tests of vessels around a target: thin vessels are found, plates and noise are not, and the vessels form a tree."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from carina.plan import NearbyTissue, surroundings
from carina.plan.cubic_box import smoothed
from carina.plan.lungs.vessels import eigenvalues
from carina.scopes import WallField
from carina.volume import Volume

HALF_MM, STEP_MM, FINE = 15.0, 0.7, 2
LUNG_HU, BLOOD_HU = -860.0, 40.0
Line = tuple[tuple[float, float, float], tuple[float, float, float], float]
"""Start (LPS mm), end (LPS mm) and radius (mm) of a drawn vessel."""


def nowhere() -> WallField:
    """Return the wall field of an airway that is far from the scan."""
    k, j, i = np.indices((9, 9, 9)) - 4.0
    matrix = np.eye(4)
    matrix[:3, 3] = 200.0
    return WallField.from_distances((2.0 - np.sqrt(i * i + j * j + k * k)).astype(np.float32), matrix)


def scan(lines: tuple[Line, ...] = (), plate_mm: float = 0.0, noise_hu: float = 20.0, seed: int = 1) -> Volume:
    """Return a scan of lung with tubes and a plate across x, blurred like a CT."""
    num = 2 * int(HALF_MM / STEP_MM) + 1
    fine = STEP_MM / FINE
    axis = (np.arange(num * FINE) - (num * FINE - 1) / 2.0) * fine
    z, y, x = np.meshgrid(axis, axis, axis, indexing="ij", sparse=True)
    share = np.zeros((num * FINE,) * 3, np.float32)
    for start, end, radius in lines:
        a, d = np.array(start), np.array(end) - np.array(start)
        at = np.clip(((x - a[0]) * d[0] + (y - a[1]) * d[1] + (z - a[2]) * d[2]) / (d @ d), 0.0, 1.0)
        off = np.sqrt((x - a[0] - at * d[0]) ** 2 + (y - a[1] - at * d[1]) ** 2 + (z - a[2] - at * d[2]) ** 2)
        share = np.maximum(share, np.clip(0.5 + (radius - off) / fine, 0.0, 1.0)).astype(np.float32)
    if plate_mm:
        share = np.maximum(share, np.clip(0.5 + (0.5 * plate_mm - np.abs(x)) / fine, 0.0, 1.0)).astype(np.float32)
    share = smoothed(share, 0.5 / fine)
    share = share.reshape(num, FINE, num, FINE, num, FINE).mean(axis=(1, 3, 5))
    rng = np.random.default_rng(seed)
    hu = LUNG_HU + (BLOOD_HU - LUNG_HU) * share + noise_hu * rng.standard_normal(share.shape)
    matrix = np.diag([STEP_MM, STEP_MM, STEP_MM, 1.0])
    matrix[:3, 3] = -STEP_MM * (num - 1) / 2.0
    return Volume(np.rint(hu).astype(np.int16), matrix)


def seen(volume: Volume) -> NearbyTissue:
    return surroundings(volume, np.zeros(3), 13.0, None, nowhere())


def along(start: tuple[float, float, float], end: tuple[float, float, float]) -> NDArray[np.float64]:
    return np.linspace(start, end, 41)


@pytest.mark.parametrize(
    ("turn", "tilt", "radius", "aside"), [(0.1, 0.2, 0.55, 1.2), (1.1, 0.7, 0.6, -2.3), (2.6, 1.2, 1.4, 0.3)]
)
def test_vessel_of_any_direction_is_found_at_its_position(
    turn: float, tilt: float, radius: float, aside: float
) -> None:
    way = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    start, end = tuple(-14.0 * way + [aside, 0, 0]), tuple(14.0 * way + [aside, 0, 0])
    found = seen(scan(((start, end, radius),)))
    middle = along(tuple(-8.0 * way + [aside, 0, 0]), tuple(8.0 * way + [aside, 0, 0]))
    assert (found.read(found.vessel_mm, middle) == 0.0).mean() > 0.95
    # The distance map gives the distance of a needle from the vessel's edge; the needle passes 4 mm from the vessel.
    across = np.cross(way, [0.3, 0.5, 0.8])
    beside = middle + 4.0 * across / np.linalg.norm(across)
    assert np.median(found.read(found.vessel_mm, beside)) == pytest.approx(4.0 - radius, abs=0.5)
    assert (found.sure[found.vessel] >= 0.5).all()
    assert (found.sure[~found.vessel] == 0.0).all()


def test_no_vessel_is_found_in_plain_lung_or_in_a_thin_plate() -> None:
    for noise_hu in (10.0, 40.0):
        assert seen(scan(noise_hu=noise_hu)).vessel.mean() < 1e-4
    # The plate of 0.3 mm simulates a fissure.
    assert seen(scan(plate_mm=0.3)).vessel.mean() < 1e-3


@cache
def forked() -> NearbyTissue:
    return seen(scan((((0, 0, -14), (0, 0, 0), 2.0), ((0, 0, 0), (8, 0, 10), 1.2), ((0, 0, 0), (-8, 2, 10), 1.0))))


def test_vessel_tree_follows_a_vessel_that_forks() -> None:
    tree = forked().vessel_tree()
    assert tree.is_whole
    # The tree leads from its widest point to the three ends; noise changes the position of this point on the trunk.
    assert len(tree.branches) in {2, 3}
    assert [branch.parent for branch in tree.branches].count(None) == 1
    for branch in tree.branches:
        assert branch.sure > 0.9
        if branch.parent is not None:
            joint = branch.points_lps[0]
            assert np.linalg.norm(tree.branches[branch.parent].points_lps - joint, axis=1).min() < 1.0
    points = np.concatenate([branch.points_lps for branch in tree.branches])
    radius = np.concatenate([branch.radius_mm for branch in tree.branches])
    for end in ((-8, 2, 10), (8, 0, 10), (0, 0, -13)):
        assert np.linalg.norm(points - end, axis=1).min() < 1.5
    assert np.median(radius[points[:, 2] < -4.0]) == pytest.approx(2.0, abs=0.4)
    assert np.median(radius[points[:, 2] > 4.0]) == pytest.approx(1.1, abs=0.4)
    length = 13.0 + np.hypot(8, 10) + np.sqrt(64 + 4 + 100)
    assert tree.length_mm == pytest.approx(length, rel=0.12)


def test_separate_vessels_are_separate_trees_and_lung_without_vessels_has_no_vessel_tree() -> None:
    apart = seen(scan((((-6, 0, -14), (-6, 0, 14), 1.0), ((6, -14, 3), (6, 14, 3), 0.6)))).vessel_tree()
    assert [branch.parent for branch in apart.branches] == [None, None]
    assert seen(scan()).vessel_tree().branches == ()


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(-100, 100, width=32), min_size=6, max_size=6))
@example([0.0, 0.0, 1.0, 1.0, 0.0, 0.0])
def test_eigenvalues_of_symmetric_matrices_equal_those_of_numpy(second: list[float]) -> None:
    zz, yy, xx, zy, zx, yx = second
    expected = np.linalg.eigvalsh([[zz, zy, zx], [zy, yy, yx], [zx, yx, xx]])
    found = eigenvalues([np.array([value]) for value in second])
    np.testing.assert_allclose([float(one[0]) for one in found], expected, atol=1e-3)
