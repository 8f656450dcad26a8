"""Tests of the reasons why a plan has no route: another CT, the end of the scan, lost airways, missing bronchi."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from nodules import ellipsoid

from cached_test_data import cached_airways, cached_phantom
from carina.errors import UsageError
from carina.plan import plan_route
from carina.plan.routes.standing_points import NearestPlace
from carina.scopes import WallField
from carina.track import Airways, AirwayTree, Uncertainty, wall_field
from carina.volume import Volume

CHEST: dict[str, Any] = {"seed": 4, "spacing_mm": 1.2, "generations": 4}


@cache
def wall() -> WallField:
    return wall_field(volume(), airways())


def volume() -> Volume:
    return cached_phantom(**CHEST).volume


def airways() -> Airways:
    return cached_airways(**CHEST)


@cache
def far_off() -> np.ndarray:
    """Return a point in the right lung that is farther from every airway than a needle reaches."""
    points = np.concatenate([one.points for one in airways().tree.branches])
    grid = np.stack(np.meshgrid(*(np.arange(lo, hi, 8.0) for lo, hi in ((-130, -20), (-80, 80), (-120, 90)))), -1)
    places = grid.reshape(-1, 3)
    ijk = np.rint(volume().to_ijk(places)).astype(int)
    inside = ((ijk >= 3) & (ijk < np.array(volume().shape_zyx[::-1]) - 3)).all(axis=1)
    places, ijk = places[inside], ijk[inside]
    lung = np.array([(volume().hu_zyx[k - 2 : k + 3, j - 2 : j + 3, i - 2 : i + 3] < -600).all() for i, j, k in ijk])
    off = np.array([np.linalg.norm(points - place, axis=1).min() for place in places])
    return places[lung & (off > 32.0)][0]


def without(tree: AirwayTree, name: str) -> AirwayTree:
    """Return the tree without the branch ``name`` and its descendants."""
    gone = {tree.named(name).id}
    for one in tree.branches:
        if one.parent in gone:
            gone.add(one.id)
    return dataclasses.replace(
        tree,
        branches=tuple(
            dataclasses.replace(one, children=tuple(child for child in one.children if child not in gone))
            for one in tree.branches
            if one.id not in gone
        ),
    )


def test_target_far_from_airways_reports_the_nearest_airway_and_remedies() -> None:
    found = plan_route(volume(), airways(), ellipsoid((4.0, 4.0, 4.0), far_off()), wall=wall())
    assert found.routes == () and isinstance(found.nearest, NearestPlace)
    points = np.concatenate([one.points for one in airways().tree.branches])
    gap = np.linalg.norm(points - far_off(), axis=1).min() - 4.0
    assert found.nearest.gap_mm == pytest.approx(gap, abs=0.6)
    branch = airways().tree.branch(found.nearest.branch_id)
    assert np.linalg.norm(branch.points - found.nearest.place_lps, axis=1).min() < 1e-9
    assert f"{found.nearest.branch_name}, {found.nearest.gap_mm:.0f} mm from the nodule" in found.why
    assert "reaches 15 mm" in found.why and "percutaneous access" in found.why
    assert found.to_json()["nearest"] == found.nearest.to_json()


def lost_at(place: np.ndarray, above_mm: float) -> Airways:
    lost = Uncertainty(
        lps=(float(place[0]), float(place[1]), float(place[2]) + above_mm),
        kind="lost",
        branch_id=5,
        width_mm=3.1,
        confidence=None,
        num_ends=None,
        voxel_mm=None,
    )
    return dataclasses.replace(airways(), uncertain=(lost,))


def test_airway_lost_near_the_target_is_reported_with_a_remedy() -> None:
    target = ellipsoid((4.0, 4.0, 4.0), far_off())
    found = plan_route(volume(), lost_at(far_off(), 14.0), target, wall=wall())
    assert any(
        note.startswith("the tree is lost 10 mm short of the target: lost here, 3.1 mm wide") for note in found.notes
    )
    assert "Check where the airway was lost" in found.why
    quiet = plan_route(volume(), lost_at(far_off(), 74.0), target, wall=wall())
    assert not any("lost here" in note for note in quiet.notes) and "was lost" not in quiet.why


def test_lobe_without_a_bronchus_is_reported_on_its_side_only() -> None:
    blocked = dataclasses.replace(airways(), tree=without(airways().tree, "RUL"))
    found = plan_route(volume(), blocked, ellipsoid((4.0, 4.0, 4.0), far_off()), wall=wall())
    assert any(note.startswith("RUL") and "was not found" in note for note in found.notes)
    left = plan_route(
        volume(), blocked, ellipsoid((4.0, 4.0, 4.0), airways().tree.named("LUL").points[-1]), wall=wall()
    )
    assert not any("was not found" in note for note in left.notes)


def test_target_cut_by_the_end_of_the_scan_is_reported() -> None:
    cut = dataclasses.replace(ellipsoid((4.0, 4.0, 4.0), far_off()), touches=("edge of the CT",))
    found = plan_route(volume(), airways(), cut, wall=wall())
    assert any(note.startswith("the CT ends within the target") for note in found.notes)


def test_target_of_another_ct_is_refused_or_reported() -> None:
    with pytest.raises(
        UsageError, match=r"the centre of the target .* lies outside the scan, which lies within x"
    ) as refused:
        plan_route(volume(), airways(), ellipsoid((4.0, 4.0, 4.0), (900.0, 0.0, 0.0)), wall=wall())
    assert refused.value.code == "plan.target"
    found = plan_route(volume(), airways(), ellipsoid((4.0, 4.0, 4.0), far_off()), wall=wall())
    assert any(note.startswith("the CT shows no nodule where the target lies (-") for note in found.notes)


def test_airways_of_another_grid_are_refused() -> None:
    smaller = Volume(volume().hu_zyx[:-3], volume().lps_from_ijk)
    with pytest.raises(UsageError, match="the airways belong to another CT") as refused:
        plan_route(smaller, airways(), ellipsoid((4.0, 4.0, 4.0), far_off()), wall=wall())
    assert refused.value.code == "plan.airways"


def test_plan_in_a_tree_of_only_a_trachea_reports_the_missing_airways() -> None:
    root = dataclasses.replace(airways().tree.root, children=())
    alone = dataclasses.replace(airways(), tree=AirwayTree((root,)))
    found = plan_route(volume(), alone, ellipsoid((4.0, 4.0, 4.0), far_off()), wall=wall())
    assert found.routes == () and found.why == "no route: the airway tree has no branches; find the airways first"
