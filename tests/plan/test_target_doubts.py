"""Tests of the doubts whether a target is a nodule, and of the confirmation that a plan requires."""

from __future__ import annotations

import numpy as np
import pytest
from painted_nodules import Scene, painted
from test_clicked_positions import airway, chest

import carina
from cached_test_data import cached_phantom, found_airways
from carina.errors import UnconfirmedTargetError, UsageError
from carina.plan import PlanTarget, check_confirmed, grow_nodule, plan_route, sphere, target_doubts, target_from_click
from carina.scopes import WallField
from carina.volume import Volume

ALONG = ((0.0, 0.0, 0.0), (0.3, 0.2, 0.9))
BESIDE = ((5.5, 0.0, 0.0), (0.0, 0.3, 1.0))


def codes(doubts):
    return [doubt.code for doubt in doubts]


@pytest.mark.parametrize("radius_mm", [1.5, 2.0, 3.0, 4.5])
def test_target_in_a_lung_vessel_has_the_doubt_that_it_continues_as_a_tube(radius_mm):
    volume, _, middle = painted(Scene(radii_mm=(0.5, 0.5, 0.5), vessels=((*ALONG, radius_mm),)))
    assert "target.tube" in codes(target_doubts(volume, grow_nodule(volume, middle)))


@pytest.mark.parametrize(
    "scene",
    [
        Scene(radii_mm=(3.0, 3.0, 3.0)),
        Scene(radii_mm=(5.0, 4.0, 6.0)),
        Scene(radii_mm=(12.0, 10.0, 11.0)),
        Scene(radii_mm=(5.0, 5.0, 5.0), vessels=((*ALONG, 1.0),)),
        Scene(radii_mm=(6.0, 6.0, 6.0), vessels=((*BESIDE, 1.5),)),
        Scene(radii_mm=(5.0, 5.0, 5.0), pleura_mm=3.0),
        Scene(radii_mm=(8.0, 8.0, 8.0), level_hu=-550.0, core_mm=3.5),
        Scene(radii_mm=(9.0, 9.0, 9.0), core_mm=5.0, core_hu=-980.0),
        Scene(radii_mm=(5.0, 5.0, 5.0), spacing_mm=(0.7, 0.7, 2.5)),
    ],
)
def test_nodule_in_the_lung_or_at_the_pleura_has_no_doubt(scene):
    volume, _, middle = painted(scene)
    assert target_doubts(volume, grow_nodule(volume, middle + np.array([0.7 * scene.radii_mm[0], 0.0, 0.0]))) == ()


def test_target_denser_than_soft_tissue_has_a_density_doubt():
    volume, _, middle = painted(Scene(level_hu=300.0))
    (doubt,) = target_doubts(volume, grow_nodule(volume, middle))
    assert doubt.code == "target.density"
    assert "denser than soft tissue" in doubt.words


@pytest.mark.parametrize("level_hu", [-20.0, 40.0])
def test_dense_ball_that_thick_slices_show_as_ground_glass_has_a_density_doubt(level_hu):
    volume, _, middle = painted(Scene(radii_mm=(1.2, 1.2, 1.2), level_hu=level_hu, spacing_mm=(0.7, 0.7, 3.0)))
    nodule = grow_nodule(volume, middle)
    assert nodule.kind == "ground-glass"
    (doubt,) = target_doubts(volume, nodule)
    assert doubt.code == "target.density"
    assert "too small for slices of 3 mm" in doubt.words


@pytest.mark.parametrize("core_mm", [0.0, 3.0])
@pytest.mark.parametrize(
    ("radius_mm", "slice_mm"), [(3.0, 0.8), (4.0, 1.5), (4.5, 3.0), (7.0, 3.0)], ids=lambda value: f"{value:g}"
)
def test_ground_glass_larger_than_the_blur_of_its_slices_has_no_doubt(radius_mm, slice_mm, core_mm):
    scene = Scene((radius_mm,) * 3, -600.0, core_mm if radius_mm > 5.0 else 0.0, spacing_mm=(0.7, 0.7, slice_mm))
    volume, _, middle = painted(scene)
    nodule = grow_nodule(volume, middle + np.array([0.5 * radius_mm, 0.0, 0.0]))
    assert nodule.kind == ("part-solid" if scene.core_mm > 0.0 else "ground-glass")
    assert target_doubts(volume, nodule) == ()


def test_target_without_lung_around_it_has_a_doubt():
    volume = chest()
    assert codes(target_doubts(volume, sphere(volume, (0.0, 20.0, 0.0), 12.0))) == ["target.mediastinum"]
    assert target_doubts(volume, grow_nodule(volume, (-60.0, 10.0, 0.0))) == ()


def test_air_of_the_airways_beside_a_mediastinal_target_does_not_count_as_lung():
    # Two bronchi of 16 mm along z, 6 mm apart, with a node between them.
    matrix = np.diag([0.8, 0.8, 1.0, 1.0])
    matrix[:3, 3] = (-28.0, -28.0, -28.0)
    _, j, i = np.indices((57, 71, 71))
    x, y = 0.8 * i - 28.0, 0.8 * j - 28.0
    tubes = np.hypot(np.abs(x) - 11.0, y) - 8.0
    volume = Volume(np.where(tubes < 0.0, -1000, 20).astype(np.int16), matrix)
    wall = WallField.from_distances(np.clip(-tubes, -2.5, 4.5).astype(np.float32), matrix)
    node = sphere(volume, (0.0, 0.0, 0.0), 4.0)
    assert "target.mediastinum" in codes(target_doubts(volume, node, wall=wall))
    assert "target.mediastinum" not in codes(target_doubts(volume, node))


@pytest.mark.parametrize("polyp_mm", [3.0, 4.5, 6.0])
def test_lesion_in_the_lumen_of_an_airway_in_the_lung_has_no_doubt(polyp_mm):
    volume, wall, centre, _ = airway(polyp_mm, around_hu=-860.0)
    assert target_doubts(volume, grow_nodule(volume, centre, wall=wall)) == ()


def test_unconfirmed_doubt_raises_an_error_with_the_code_of_the_doubt():
    volume, _, middle = painted(Scene(level_hu=300.0))
    doubts = target_doubts(volume, grow_nodule(volume, middle))
    with pytest.raises(UnconfirmedTargetError, match="confirm it") as error:
        check_confirmed(doubts, ("target.tube",))
    assert (error.value.code, error.value.doubts) == ("target.density", doubts)
    check_confirmed(doubts, True)
    check_confirmed(doubts, ("target.density",))
    with pytest.raises(UsageError, match=r"found 'target\.odd'"):
        check_confirmed(doubts, ("target.odd",))


def test_target_record_contains_doubts_and_confirmations_and_an_older_record_without_them_opens():
    volume, _, middle = painted(Scene(level_hu=300.0))
    target = target_from_click(volume, middle, confirmed=("target.density",))
    record = target.to_record()
    again = PlanTarget.from_record(record)
    assert (again.doubts, again.confirmed) == (target.doubts, ("target.density",))
    assert target.to_json()["doubts"] == [doubt.to_json() for doubt in target.doubts]
    older = {name: value for name, value in record.items() if name not in {"doubts", "confirmed"}}
    assert (PlanTarget.from_record(older).doubts, PlanTarget.from_record(older).confirmed) == ((), ())


@pytest.fixture(scope="module")
def enhanced():
    """Return a chest with a vessel-dense nodule and dense great vessels, its airways, and the middle of the nodule."""
    made = cached_phantom(seed=4, spacing_mm=1.5, generations=4, nodule=True)
    airways = found_airways(made.volume)
    volume = made.volume
    hu = np.array(volume.hu_zyx)
    k, j, i = np.indices(volume.shape_zyx)
    points = volume.to_lps(np.stack([i, j, k], axis=-1).astype(float))
    middle = np.array(made.truth["nodule"]["centre_lps"])
    hu[np.linalg.norm(points - middle, axis=-1) < made.truth["nodule"]["radius_mm"]] = 280
    off = np.abs(points - (np.array(airways.tree.root.points[-1]) + np.array([0.0, -32.0, 0.0])))
    hu[(off < np.array([25.0, 14.0, 25.0])).all(axis=-1) & (hu > -100)] = 320
    return Volume(hu, volume.lps_from_ijk), made.volume, airways, middle


def test_target_as_dense_as_blood_with_contrast_medium_has_a_doubt(enhanced):
    volume, _, airways, middle = enhanced
    nodule = grow_nodule(volume, middle)
    assert codes(target_doubts(volume, nodule, airways=airways)) == ["target.density", "target.contrast"]
    assert codes(target_doubts(volume, nodule)) == ["target.density"]


def test_plan_of_a_doubtful_target_requires_a_confirmation_and_contains_the_doubts():
    made = cached_phantom(seed=4, spacing_mm=1.5, generations=4, nodule=True)
    airways = found_airways(made.volume)
    hu = np.array(made.volume.hu_zyx)
    k, j, i = np.indices(made.volume.shape_zyx)
    points = made.volume.to_lps(np.stack([i, j, k], axis=-1).astype(float))
    middle = np.array(made.truth["nodule"]["centre_lps"])
    hu[np.linalg.norm(points - middle, axis=-1) < made.truth["nodule"]["radius_mm"]] = 280
    volume = Volume(hu, made.volume.lps_from_ijk)
    wall = carina.wall_field(volume, airways)
    with pytest.raises(UnconfirmedTargetError) as error:
        plan_route(volume, airways, middle, wall=wall, drives=0)
    assert error.value.code == "target.density"
    plan = plan_route(volume, airways, middle, wall=wall, drives=0, confirmed=("target.density",))
    assert codes(plan.doubts) == ["target.density"]
    assert plan.to_json()["target"]["doubts"] == [doubt.to_json() for doubt in plan.doubts]
    target = target_from_click(volume, middle, airways=airways, wall=wall, confirmed=True)
    assert plan_route(volume, airways, target, wall=wall, drives=0).to_json() == plan.to_json()
