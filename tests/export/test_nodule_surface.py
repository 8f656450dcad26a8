"""Tests of the surface of a nodule: closed, oriented outwards and at the boundary."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nodules import ellipsoid

from carina.errors import UsageError
from carina.export.nodule_surface import nodule_surface
from carina.navigate.rotation import rotation_from_vector


def is_closed_and_turns_one_way(triangles: np.ndarray) -> bool:
    edges = np.concatenate([triangles[:, [a, (a + 1) % 3]] for a in range(3)]).astype(np.int64)
    size = int(triangles.max()) + 1
    forward, back = edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0]
    return np.array_equal(np.sort(forward), np.sort(back))


@pytest.mark.parametrize("mirrored", [False, True])
def test_surface_of_an_ellipsoid_is_closed_and_has_its_position_and_volume(mirrored):
    nodule = ellipsoid([6.0, 4.5, 5.0], step_mm=0.4)
    place = nodule.lps_from_ijk.copy()
    place[:3, :3] = rotation_from_vector(np.array([0.3, -0.5, 0.9])) @ place[:3, :3]
    if mirrored:
        place[:3, 0] *= -1.0
    mesh = nodule_surface(dataclasses.replace(nodule, lps_from_ijk=place))
    assert is_closed_and_turns_one_way(mesh.triangles)
    assert mesh.volume_mm3 == pytest.approx(nodule.volume_mm3, rel=0.02)
    # The vertices are converted to coordinates along the axes of the ellipsoid.
    own = (mesh.vertices_lps - place[:3, 3]) @ np.linalg.inv(place[:3, :3]).T * 0.4
    off = own - 0.4 * (np.array(nodule.inside_zyx.shape[::-1]) - 1) / 2
    radius = np.linalg.norm(off / [6.0, 4.5, 5.0], axis=1)
    assert np.abs(radius - 1.0).max() < 0.4 / 4.5
    assert np.abs(off.mean(axis=0)).max() < 0.02


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
def test_surface_of_any_set_of_voxels_is_closed(seed, num):
    chosen = np.random.default_rng(seed)
    inside = np.zeros((4, 5, 6), bool)
    inside[tuple(chosen.integers(0, inside.shape, (num, 3)).T)] = True
    mesh = nodule_surface(dataclasses.replace(ellipsoid([2.0, 2.0, 2.0]), inside_zyx=inside))
    assert is_closed_and_turns_one_way(mesh.triangles)
    assert mesh.volume_mm3 > 0.0


def test_surface_of_an_empty_mask_is_refused():
    with pytest.raises(UsageError, match="no voxel"):
        nodule_surface(dataclasses.replace(ellipsoid([2.0, 2.0, 2.0]), inside_zyx=np.zeros((3, 3, 3), bool)))
