"""Tests of the vessels and CT values of whole lungs in the box around a needle."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cached_test_data import cached_phantom
from carina.errors import NoResultError
from carina.plan.lungs.tissue_near_needle import lung_box, lung_surroundings
from carina.scopes import WallField
from carina.volume import Volume

SMALL_CHEST: dict[str, Any] = {"seed": 4, "spacing_mm": 2.0, "generations": 4}


def nowhere() -> WallField:
    """Return the wall field of an airway far from the chest; nearby walls would be excluded from the vessels."""
    k, j, i = np.indices((9, 9, 9)) - 4.0
    matrix = np.eye(4)
    matrix[:3, 3] = 900.0
    return WallField.from_distances((2.0 - np.sqrt(i * i + j * j + k * k)).astype(np.float32), matrix)


def test_box_around_both_lungs_has_vessels_on_both_sides_and_the_values_of_the_ct() -> None:
    volume = cached_phantom(**SMALL_CHEST).volume
    found = lung_surroundings(volume, nowhere())
    assert 100.0 < found.vessels_ml < 500.0
    tree = found.vessel_tree()
    tips = np.array([branch.points_lps[-1] for branch in tree.branches])
    assert (tips[:, 0] < -40.0).sum() > 20
    assert (tips[:, 0] > 40.0).sum() > 20
    # Each voxel of the box has the CT value at its stated position.
    rng = np.random.default_rng(1)
    at = rng.integers(0, np.array(found.box.hu_zyx.shape), (400, 3))
    places = at[:, ::-1] + found.box.lps_from_ijk[:3, 3]
    ijk = volume.to_ijk(places)
    whole = np.rint(ijk)
    near = np.abs(ijk - whole).max(axis=1) < 0.15
    ijk_near = whole[near].astype(int)
    inside = ((ijk_near >= 0) & (ijk_near < np.array(volume.shape_zyx[::-1]))).all(axis=1)
    i, j, k = ijk_near[inside].T
    off = volume.hu_zyx[k, j, i] - found.box.hu_zyx[tuple(at[near][inside].T)]
    assert np.median(np.abs(off)) < 40.0


@pytest.mark.parametrize("turn", [np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, 1.0, -1.0])[[1, 0, 2]]])
def test_ct_with_permuted_or_reversed_axes_gives_an_equal_box_around_the_lungs(turn: NDArray[np.float64]) -> None:
    volume = cached_phantom(**SMALL_CHEST).volume
    plain = lung_box(volume)
    order = np.argmax(np.abs(turn), axis=0)
    hu = np.transpose(
        volume.hu_zyx[::-1] if turn[:, 2].sum() < 0.0 else volume.hu_zyx, (0, 2, 1) if order[0] else (0, 1, 2)
    )
    matrix = volume.lps_from_ijk.copy()
    if order[0]:
        matrix[:, [0, 1]] = matrix[:, [1, 0]]
    if turn[:, 2].sum() < 0.0:
        matrix[:3, 3] += matrix[:3, 2] * (volume.shape_zyx[0] - 1)
        matrix[:3, 2] *= -1.0
    if turn[0, 0] < 0.0:
        hu = hu[:, :, ::-1]
        matrix[:3, 3] += matrix[:3, 0] * (volume.shape_zyx[2] - 1)
        matrix[:3, 0] *= -1.0
    turned = lung_box(Volume(np.ascontiguousarray(hu), matrix))
    np.testing.assert_allclose(turned.lps_from_ijk, plain.lps_from_ijk)
    np.testing.assert_allclose(turned.hu_zyx, plain.hu_zyx, atol=0.5)


def test_vessels_are_found_in_a_ct_that_cuts_off_parts_of_both_lungs() -> None:
    volume = cached_phantom(**SMALL_CHEST).volume
    whole = lung_box(volume)
    nx = volume.shape_zyx[2]
    first = round(0.22 * nx)
    matrix = volume.lps_from_ijk.copy()
    matrix[:3, 3] += matrix[:3, 0] * first
    cut = lung_box(Volume(np.ascontiguousarray(volume.hu_zyx[:, :, first : nx - first]), matrix))
    assert 0.3 * whole.known.sum() < cut.known.sum() < 0.95 * whole.known.sum()


def test_vessel_map_of_both_lungs_is_refused_for_a_ct_without_lungs() -> None:
    with pytest.raises(NoResultError):
        lung_box(Volume(np.full((40, 60, 60), 40, np.int16), np.diag([2.0, 2.0, 2.0, 1.0])))
