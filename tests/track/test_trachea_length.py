"""Tests of the largest length of the trachea, beyond which connected air does not belong to the tree."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from carina.phantom import generate_phantom
from carina.track import find_airways
from carina.track.find.air_upwards import AirSection
from carina.track.find.upper_airway import find_cords


def section(height_mm: float, diameter_mm: float) -> AirSection:
    """Return a round section of the trachea at a height above the carina, both in mm."""
    air = np.ones((1, 1), dtype=np.bool_)
    return AirSection(
        k=round(height_mm),
        corner=(0, 0),
        air=air,
        whole=air,
        voxel=(0, 0, round(height_mm)),
        centre_lps=np.array([0.0, 0.0, height_mm]),
        area_mm2=0.25 * np.pi * diameter_mm**2,
        width_mm=diameter_mm,
        depth_mm=diameter_mm,
        septum_mm2=0.0,
        septum_hu=float("nan"),
        noise_hu=10.0,
        peak=0.0,
        leaves_in_front=False,
    )


def trachea(length_mm: int, diameter_mm: float = 17.3, *, bronchus_mm: int = 0) -> list[AirSection]:
    """Return sections from a bronchus (or from the carina if ``bronchus_mm`` is 0) to the top of the trachea."""
    below = [section(float(z), 0.5 * diameter_mm) for z in range(-bronchus_mm, 0)]
    return below + [section(float(z), diameter_mm) for z in range(length_mm + 1)]


def test_tree_of_an_airway_longer_than_a_trachea_begins_at_a_usual_tracheal_length():
    cords = find_cords(trachea(170), None)
    assert cords is not None
    assert not cords.are_visible
    assert cords.begins_at == 110


@pytest.mark.parametrize("bronchus_mm", [30, 69])
def test_bronchi_below_the_carina_do_not_count_towards_the_length_of_the_trachea(bronchus_mm):
    assert find_cords(trachea(140, bronchus_mm=bronchus_mm), None) is None
    cords = find_cords(trachea(170, bronchus_mm=bronchus_mm), None)
    assert cords is not None
    assert cords.begins_at == bronchus_mm + 110


def test_tree_begins_below_outside_air_that_is_connected_to_the_trachea():
    outside = [section(float(height), 90.0) for height in range(100, 190)]
    found = find_cords([*trachea(100), *outside], None)
    assert found is not None
    assert not found.are_visible
    assert found.root_above_carina_mm == pytest.approx(99.0, abs=1.0)


def test_wide_trachea_may_be_longer_than_a_narrow_one():
    assert find_cords(trachea(170, 22.0), None) is None
    cords = find_cords(trachea(190, 22.0), None)
    assert cords is not None
    assert cords.begins_at == round(110 * 1.2)


def test_search_in_a_large_chest_without_a_neck_reports_no_larynx():
    phantom = generate_phantom(seed=1, spacing_mm=1.4, generations=3)
    larger = phantom.volume.lps_from_ijk.copy()
    larger[:3] *= 1.4
    found = find_airways(dataclasses.replace(phantom.volume, lps_from_ijk=larger), progress=False)
    assert "track.larynx" not in {note.code for note in found.badges}
    assert found.root_lps[2] > 1.4 * 110.0 - 5.0
