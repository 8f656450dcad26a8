"""Tests of volumes with padding: a constant value where nothing was scanned, as in the corners of a rotated CT."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from carina import Volume, find_airways, generate_phantom
from carina.track.find.padding import padding_near

FILL = -1000


def with_a_filled_corner(volume: Volume, rise: float, axis: int) -> Volume:
    """Return the volume with a constant value above an oblique plane.

    The plane cuts the trachea 30 mm below its upper end.

    Parameters
    ----------
    rise
        Height of the plane per mm along the axis of the slope.
    axis
        Axis along which the plane rises: x (0) or y (1).
    """
    nz, ny, nx = volume.shape_zyx
    k, j, i = np.ogrid[:nz, :ny, :nx]
    x, y, z = (volume.lps_from_ijk[n, 3] + volume.spacing_mm[n] * at for n, at in enumerate((i, j, k)))
    beside = x if axis == 0 else y - np.mean(y)
    values = volume.hu_zyx.copy()
    values[np.broadcast_to(z > np.max(z) - 30.0 + rise * beside, values.shape)] = FILL
    return dataclasses.replace(volume, hu_zyx=values)


@pytest.fixture(scope="module")
def chest() -> Volume:
    return generate_phantom(seed=4, spacing_mm=1.4, generations=3, noise_hu=20.0).volume


@pytest.fixture(scope="module")
def num_branches(chest: Volume) -> int:
    return len(find_airways(chest).tree)


@pytest.mark.parametrize(("rise", "axis"), [(0.36, 0), (-0.58, 0), (0.36, 1), (-0.58, 1)])
def test_no_airway_is_found_in_the_padded_corner_of_a_rotated_volume(chest, num_branches, rise, axis):
    cut = with_a_filled_corner(chest, rise, axis)
    airways = find_airways(cut)
    assert len(airways.tree) == num_branches
    assert airways.tree.root.name == "Trachea"
    assert not any("larynx" in note for note in airways.notes)
    assert not np.any((airways.lumen_zyx != 0) & (cut.hu_zyx == FILL) & (chest.hu_zyx != FILL))


def test_trachea_of_constant_value_is_not_detected_as_padding():
    values = np.full((30, 40, 40), 40, dtype=np.int16)
    values[:, 15:25, 15:25] = FILL
    volume = Volume(values, np.eye(4))
    assert padding_near(volume, [(20, 20, k) for k in range(29, -1, -1)]) is None


@pytest.mark.parametrize("spacing_mm", [pytest.param(1.0, marks=pytest.mark.soak), 1.5, 2.5, 4.0])
def test_phantom_without_noise_has_no_detected_padding(spacing_mm):
    made = generate_phantom(seed=1, spacing_mm=spacing_mm, generations=3, noise_hu=0)
    airways = find_airways(made.volume)
    top_mm = made.volume.to_lps(np.array([0.0, 0.0, made.volume.shape_zyx[0] - 1.0]))[2]
    assert airways.root_lps[2] > top_mm - 2.0 * spacing_mm


def test_volume_of_noise_has_no_detected_padding(chest):
    nz, ny, nx = chest.shape_zyx
    assert padding_near(chest, [(nx // 2, ny // 2, k) for k in range(nz - 1, nz // 2, -1)]) is None
