"""Tests of bronchi filled with fluid or mucus: position, calibre from wall to wall, and airways beyond."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from plugged_chest import CHEST

import carina
from cached_test_data import cached_airways, cached_phantom
from cached_test_data import patient as the_patient
from carina.track import AirwayTree, Branch, Bridge, find_absent
from carina.track.find.airway_ends import find_uncertain
from carina.track.find.partial_plugs import find_narrowed
from carina.track.tree.uncertainty import filled_place
from carina_bench.filled_bronchi import with_secretions

VOXEL_MM = CHEST["spacing_mm"]
SEGMENTS = {"LB10": (5.0, 12.0), "RB6": (4.0, 11.0)}
"""Segmental bronchi with start and length of the fluid, mm: of the left lower lobe and the right superior segment."""
LEVELS = (0.4, 0.6, 0.8)
"""Filled shares of a section's height."""


def sampled(cases, some):
    """Return parameters of which only ``some`` are tested in `make test`; the others are soak tests."""
    return [case if case in some else pytest.param(*case, marks=pytest.mark.soak) for case in cases]


FLUID = sampled(
    [(name, share) for name in SEGMENTS for share in (*LEVELS, 1.0)], [("RB6", 0.4), ("LB10", 0.8), ("RB6", 1.0)]
)
BRIDGED = sampled(
    [(name, share) for name in (*SEGMENTS, "RML") for share in (0.8, 1.0)], [("RB6", 0.8), ("LB10", 1.0), ("RML", 1.0)]
)


@cache
def wet(name, share):
    from_mm, length_mm = SEGMENTS.get(name, (4.0, 11.0))
    made = with_secretions(cached_phantom(**CHEST), name, share=share, from_mm=from_mm, length_mm=length_mm)
    return made, carina.find_airways(made.volume)


def filled(airways):
    return [place for place in airways.uncertain if place.kind == "filled"]


@pytest.mark.parametrize(("name", "share"), FLUID)
def test_fluid_level_or_mucus_plug_is_reported_with_the_bronchial_diameter_from_wall_to_wall(name, share):
    made, airways = wet(name, share)
    (place,) = filled(airways)
    assert np.linalg.norm(np.array(place.lps) - made.axis_lps[len(made.axis_lps) // 2]) < 5.0
    assert place.calibre_mm == pytest.approx(made.calibre_mm, abs=max(0.15 * made.calibre_mm, VOXEL_MM))
    assert abs(place.calibre_mm - made.calibre_mm) <= 2.0 * place.calibre_error_mm
    assert place.width_mm == pytest.approx(made.air_mm, abs=VOXEL_MM)
    assert (place.width_mm == 0.0) == (share == 1.0), "no air is reported exactly if there is none"
    assert "a CT cannot distinguish these from a tumour or a collapsed airway" in place.reason
    assert f"{place.calibre_mm:.1f} \u00b1 {place.calibre_error_mm:.1f} mm wide from wall to wall" in place.reason


@pytest.mark.parametrize(("name", "share"), BRIDGED)
def test_bridge_offered_for_a_filled_bronchus_restores_the_airways_beyond(name, share):
    made, airways = wet(name, share)
    (place,) = filled(airways)
    assert np.linalg.norm(np.array(place.beyond_lps) - made.axis_lps[-1]) < 6.0
    assert "there is an airway beyond it" in place.reason
    whole = cached_airways(**CHEST)
    assert len(airways.tree) <= len(whole.tree) - 6, "no branch was added without the edit"
    bridged = carina.edit_airways(made.volume, airways, Bridge(place.beyond_lps))
    (bridge,) = [branch for branch in bridged.tree.branches if branch.kind == "bridge"]
    assert bridge.name == name
    assert len(bridged.tree) >= len(whole.tree) - 3
    (reported,) = filled(bridged)
    assert reported.beyond_lps is None
    assert reported.lps == place.lps


@pytest.mark.parametrize("share", [0.8, 1.0])
def test_diameter_of_a_filled_bronchus_is_not_stated_if_its_border_is_not_visible(share):
    # The middle lobe bronchus is in the hilum, with tissue on all sides.
    _, airways = wet("RML", share)
    (place,) = filled(airways)
    assert place.calibre_mm is None
    assert place.calibre_error_mm is None
    assert "its calibre from wall to wall cannot be measured here" in place.reason


def test_filled_wide_bronchus_is_reported_once_with_an_error_that_covers_the_truth():
    made, airways = wet("BI", 0.8)
    (place,) = filled(airways)
    assert abs(place.calibre_mm - made.calibre_mm) <= place.calibre_error_mm


def test_missing_lobe_beyond_a_filled_bronchus_has_the_filling_as_reason():
    trunk = Branch(0, None, (1, 2), 0, "Trachea", "tracked", np.array([[0.0, 0, 0], [0, 0, -90]]), np.full(2, 8.0))
    right = Branch(1, 0, (), 1, "RMB", "tracked", np.array([[0.0, 0, -90], [-30, 0, -130]]), np.full(2, 6.0))
    left = Branch(2, 0, (), 1, "LMB", "tracked", np.array([[0.0, 0, -90], [40, 0, -110]]), np.full(2, 6.0))
    place = filled_place(
        np.array([-33.0, 0.0, -134.0]),
        1,
        air_mm=0.0,
        length_mm=9.0,
        calibre_mm=None,
        calibre_error_mm=None,
        beyond_lps=None,
    )
    absent = find_absent(AirwayTree((trunk, right, left)), [place])
    assert {one.name for one in absent if one.kind == "filled"} == {"RUL", "RML", "RLL"}
    assert "a bronchus beyond the start of RMB is narrowed or filled" in absent[0].words


@pytest.mark.parametrize("seed", [1, 2, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (3, 4, 5))])
def test_healthy_airways_have_no_filled_bronchus(seed):
    assert filled(cached_airways(**{**CHEST, "seed": seed})) == []


def test_bundled_patient_has_no_filled_bronchus():
    assert filled(the_patient()[1]) == []


def narrowed(width_mm, *, least_mm=2.5):
    """Return the filled places found in a straight branch of these widths, one per mm.

    Every section contains soft tissue.
    """
    num = len(width_mm)
    points = np.stack([np.zeros(num), np.zeros(num), -np.arange(float(num))], axis=1)
    trunk = Branch(0, None, (1,), 0, None, "tracked", np.array([[0.0, 0, 30], [0, 0, 0]]), np.full(2, 3.0))
    branch = Branch(1, 0, (), 1, None, "tracked", points, 0.5 * np.array(width_mm))
    return find_narrowed(None, AirwayTree((trunk, branch)), 0.7, least_mm)


def test_narrowing_within_the_error_of_the_bronchial_diameter_is_not_reported(monkeypatch):
    monkeypatch.setattr("carina.track.find.partial_plugs._centre_between_walls", lambda *_: np.zeros(3))
    (place,) = narrowed([2.8] * 7 + [4.0] * 15)
    assert place.calibre_mm - place.width_mm > place.calibre_error_mm
    assert narrowed([3.45] * 7 + [4.0] * 15) == []


def test_bronchus_narrower_than_two_slices_is_not_reported_as_filled(monkeypatch):
    monkeypatch.setattr("carina.track.find.partial_plugs._centre_between_walls", lambda *_: np.zeros(3))
    assert len(narrowed([4.0] * 10 + [2.4] * 7 + [4.0] * 10, least_mm=3.9)) == 1
    assert narrowed([4.0] * 10 + [2.4] * 7 + [4.0] * 10, least_mm=6.0) == []


def test_stenosis_in_the_mediastinum_is_reported_as_narrowed_or_filled_without_a_bridge():
    made = cached_phantom(**CHEST, stenosis=True)
    # In the mediastinum the wall has no visible border, so a thick wall cannot be distinguished from mucus on the wall.
    for place in filled(carina.find_airways(made.volume)):
        assert place.beyond_lps is None
        assert place.width_mm > 5.0
        assert place.reason.startswith("narrowed or filled here over")


def test_report_of_a_filled_bronchus_is_removed_when_its_branch_is_cut():
    made, airways = wet("LB10", 0.6)
    (place,) = filled(airways)
    cut = carina.edit_airways(made.volume, airways, carina.track.CutBranch(place.branch_id))
    assert filled(cut) == []
    again = find_uncertain(made.volume, airways.tree, np.zeros((0, 3)), [place])
    assert [one for one in again if one.kind == "filled"] == [place]
