"""Tests of clicks in airways, walls, heart, chest wall and outside the body, and of the region that is stated."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from painted_nodules import Scene, painted

import carina
from carina.errors import CancelledError, NoResultError
from carina.plan import PlanTarget, grow_nodule, sphere, whereabouts
from carina.scopes import WallField
from carina.volume import Volume

SPACING_MM = (0.8, 0.7, 1.0)
TRACHEA_MM, WALL_MM = 8.0, 1.5


@functools.cache
def airway(polyp_mm: float, radius_mm: float = TRACHEA_MM, around_hu: float = 20.0):
    """Return a tube of air with a ball (polyp) half in its wall, and its wall field.

    The tube is along z, in tissue like the trachea or in lung like a bronchus.
    """
    shape = (70, 84, 74)
    matrix = np.diag([*SPACING_MM, 1.0])
    matrix[:3, 3] = (-29.2, -29.0, -35.0)
    k, j, i = np.indices(shape)
    x, y, z = (np.stack([i, j, k], axis=-1) * SPACING_MM + matrix[:3, 3]).transpose(3, 0, 1, 2)
    tube = np.hypot(x, y) - radius_mm
    ball = np.sqrt((x - radius_mm + 0.5 * polyp_mm) ** 2 + y**2 + z**2) - polyp_mm
    hu = np.full(shape, around_hu)

    def paint(distance, value):
        share = np.clip(0.5 - distance / 0.9, 0.0, 1.0)
        hu[:] = hu * (1.0 - share) + value * share

    paint(tube - WALL_MM, 20.0)
    paint(tube, -1000.0)
    if polyp_mm > 0.0:
        paint(ball, 30.0)
    hu += np.random.default_rng(2).normal(0.0, 20.0, shape)
    volume = Volume(np.rint(hu).astype(np.int16), matrix)
    lumen = np.maximum(tube, -ball) if polyp_mm > 0.0 else tube
    wall = WallField.from_distances(np.clip(-lumen, -2.5, 4.5).astype(np.float32), matrix)
    # The points are in the part of the ball that is inside the lumen.
    rng = np.random.default_rng(4)
    centre = np.array([radius_mm - 0.5 * polyp_mm, 0.0, 0.0])
    points = centre + rng.uniform(-polyp_mm, polyp_mm, (200_000, 3))
    within = (np.linalg.norm(points - centre, axis=1) < polyp_mm) & (np.hypot(points[:, 0], points[:, 1]) < radius_mm)
    return volume, wall, centre, within.mean() * (2.0 * polyp_mm) ** 3


@pytest.mark.parametrize("around_hu", [20.0, -860.0])
@pytest.mark.parametrize("polyp_mm", [3.0, 4.5, 6.0])
def test_click_on_a_lesion_in_the_trachea_gives_a_target(polyp_mm, around_hu):
    volume, wall, centre, true_mm3 = airway(polyp_mm, around_hu=around_hu)
    for at in (centre, centre + np.array([-0.5 * polyp_mm, 0.0, 1.0]), centre + np.array([-1.3 * polyp_mm, 0.0, 0.0])):
        nodule = grow_nodule(volume, at, wall=wall)
        assert nodule.volume_mm3 == pytest.approx(true_mm3, abs=nodule.volume_error_mm3)
        assert nodule.volume_mm3 == pytest.approx(true_mm3, rel=0.35)
        assert nodule.touches == ("airway wall",)
        assert "stands into an airway" in nodule.notes[0]
        assert whereabouts(volume, nodule, wall=wall) == "in an airway"
        target = PlanTarget("a", "polyp", nodule, tuple(at), "click", "in an airway")
        assert target.words.endswith("in an airway")


def test_click_in_a_lumen_without_a_lesion_is_refused_with_the_reason():
    volume, wall, _, _ = airway(0.0)
    with pytest.raises(NoResultError, match="lies in the lumen of an airway, and nothing stands into it") as error:
        grow_nodule(volume, (0.0, 0.0, 3.0), wall=wall)
    assert error.value.code == "plan.in-airway"
    # The click is beside the wall and no lesion is there, so the mediastinum around it has no boundary.
    with pytest.raises(NoResultError, match=r"lumen of an airway|no boundary"):
        grow_nodule(volume, (9.0, 0.0, 0.0), wall=wall)


def to_axis(x, y, z, start, direction):
    """Return the distance of points from the half line that begins at ``start``."""
    d = np.array(direction) / np.linalg.norm(direction)
    off = np.stack([x - start[0], y - start[1], z - start[2]])
    along = np.maximum(np.tensordot(d, off, 1), 0.0)
    return np.linalg.norm(off - along * d[:, None, None, None], axis=0)


ALONG = ((9.0, 0.0, -60.0), (0.0, 0.0, 1.0))
FORK = (((0.0, 0.0, 11.0), (0.5, 0.0, -0.87)), ((0.0, 0.0, 11.0), (-0.5, 0.0, -0.87)))


# The cases are a nodule beside one bronchus and one between both bronchi of a fork, where closing the lumen with a ball
# covers much of it.
@pytest.mark.parametrize(
    ("bronchi", "radius_mm", "lumen_mm"), [((ALONG,), 5.0, 2.0), (FORK, 3.6, 2.0), (FORK, 3.0, 2.6)]
)
def test_nodule_beside_a_bronchus_includes_no_lumen_of_the_bronchus(bronchi, radius_mm, lumen_mm):
    volume, true_mm3, middle = painted(Scene(radii_mm=(radius_mm,) * 3))
    hu = volume.hu_zyx.astype(float)
    k, j, i = np.indices(volume.shape_zyx)
    x, y, z = volume.to_lps(np.stack([i, j, k], axis=-1).astype(float)).transpose(3, 0, 1, 2)
    tube = np.min([to_axis(x, y, z, *one) for one in bronchi], axis=0) - lumen_mm
    hu = np.where(tube < 0.8, np.maximum(hu, 0.0), hu)
    hu = np.where(tube < 0.0, -1000.0, hu)
    beside = Volume(np.rint(hu).astype(np.int16), volume.lps_from_ijk)
    wall = WallField.from_distances(np.clip(-tube, -2.5, 4.5).astype(np.float32), volume.lps_from_ijk)
    nodule = grow_nodule(beside, middle, wall=wall)
    assert "airway wall" not in nodule.touches
    assert nodule.volume_mm3 == pytest.approx(true_mm3, rel=0.15 if len(bronchi) == 1 else 0.6)
    assert whereabouts(beside, nodule, wall=wall) == "lung"


def chest() -> Volume:
    """Return a body with two lungs and a heart between them, and air and an ECG cable outside, at 2 mm."""
    shape = (40, 120, 160)
    k, j, i = np.indices(shape)
    x, y, z = (i - 79.5) * 2.0, (j - 59.5) * 2.0, (k - 19.5) * 2.0
    hu = np.full(shape, -1000.0)
    hu[(x / 140.0) ** 2 + (y / 100.0) ** 2 < 1.0] = 30.0
    for side in (-1.0, 1.0):
        hu[((x - side * 70.0) / 50.0) ** 2 + (y / 75.0) ** 2 < 1.0] = -860.0
    for centre, radius in (((-60.0, 10.0, 0.0), 7.0), ((-115.0, 0.0, 0.0), 7.0), ((0.0, -104.0, 0.0), 3.5)):
        off = np.sqrt((x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2)
        hu[off < radius] = 40.0
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    matrix[:3, 3] = (-159.0, -119.0, -39.0)
    return Volume(np.rint(hu).astype(np.int16), matrix)


@pytest.mark.parametrize(
    ("at", "code", "text"),
    [
        ((0.0, -104.0, 0.0), "plan.outside-body", "outside the body"),
        ((-150.0, -110.0, 5.0), "plan.outside-body", "outside the body"),
        ((0.0, 0.0, 0.0), "plan.no-boundary", "the heart or the diaphragm.*set a sphere there by hand"),
        ((0.0, 90.0, 0.0), "plan.no-boundary", "the chest wall"),
        ((-60.0, -30.0, 0.0), "plan.no-nodule", "no nodule at this point"),
    ],
)
def test_clicks_outside_nodules_are_refused_with_their_anatomical_region(at, code, text):
    with pytest.raises(NoResultError, match=text) as error:
        grow_nodule(chest(), at)
    assert error.value.code == code


@pytest.mark.parametrize("at", [(-79.0, -170.9, 351.5), (-81.0, -102.5, 402.5), (100.9, -121.1, 204.5)])
def test_click_in_air_beside_faint_tissue_of_the_bundled_ct_is_refused(at):
    with pytest.raises(NoResultError, match=r"it is in (air|lung) \(-9..? HU\), and the nearest tissue is") as error:
        grow_nodule(carina.demo_patient(), at)
    assert error.value.code == "plan.no-nodule"


def test_click_beside_a_dense_nodule_selects_it_in_lung_and_is_refused_in_emphysema():
    volume, _, middle = painted(Scene(radii_mm=(5.0, 5.0, 5.0), noise_hu=45.0))
    at = middle + np.array([7.5, 0.0, 0.0])
    assert grow_nodule(volume, at).contains([middle])[0]
    hu = volume.hu_zyx
    emphysema = Volume(np.where(hu < -700, hu - 105, hu).astype(np.int16), volume.lps_from_ijk)
    assert grow_nodule(emphysema, middle + np.array([5.0, 0.0, 0.0])).contains([middle])[0]
    with pytest.raises(NoResultError, match="it is in air") as error:
        grow_nodule(emphysema, at)
    assert error.value.code == "plan.no-nodule"


def test_click_in_lung_beside_ground_glass_is_refused():
    volume, _, middle = painted(Scene(radii_mm=(5.0, 5.0, 5.0), level_hu=-600.0))
    assert grow_nodule(volume, middle + np.array([4.5, 0.0, 0.0])).kind == "ground-glass"
    with pytest.raises(NoResultError, match="it is in lung"):
        grow_nodule(volume, middle + np.array([7.5, 0.0, 0.0]))


def test_segmentation_of_a_nodule_can_be_cancelled_between_its_steps():
    reported = []

    def stop(what, share):
        reported.append((what, share))
        if len(reported) == 3:
            raise CancelledError("stopped")

    with pytest.raises(CancelledError):
        grow_nodule(chest(), (0.0, 0.0, 0.0), progress=stop)
    assert reported == 3 * [("looking for a nodule", None)]


def test_anatomical_region_of_a_target_is_stated_with_its_lobe_or_organ():
    volume = chest()
    in_lung = grow_nodule(volume, (-60.0, 10.0, 0.0))
    assert whereabouts(volume, in_lung) == "lung"
    assert whereabouts(volume, grow_nodule(volume, (-115.0, 0.0, 0.0))) == "beside pleura"
    assert whereabouts(volume, sphere(volume, (0.0, 20.0, 0.0), 12.0)) == "mediastinum or chest wall"
    assert whereabouts(volume, sphere(volume, (0.0, -104.0, 0.0), 6.0)) == "outside the body"


@pytest.mark.parametrize("hollow_mm", [4.0, 6.5])
def test_clicks_in_a_cavity_and_in_its_wall_give_equal_nodules(hollow_mm):
    scene = Scene(radii_mm=(9.0, 9.0, 9.0), core_mm=hollow_mm, core_hu=-980.0)
    volume, true_mm3, middle = painted(scene)
    for aside in (0.0, hollow_mm, 0.5 * (9.0 + hollow_mm)):
        nodule = grow_nodule(volume, middle + np.array([aside, 0.0, 0.0]))
        assert nodule.volume_mm3 == pytest.approx(true_mm3, rel=0.08)
        assert nodule.volume_mm3 == pytest.approx(true_mm3, abs=nodule.volume_error_mm3)
        assert nodule.kind == "solid"
        assert nodule.long_mm == pytest.approx(18.0, abs=1.0)
        assert "cavity" in nodule.notes[0]
        # In a hollow nodule a needle finds tissue only in the wall.
        assert not nodule.contains([middle])[0]
        assert nodule.contains([nodule.middle_lps])[0]
        wall_mm3 = true_mm3 - 4.0 / 3.0 * np.pi * hollow_mm**3
        assert nodule.solid_mm3 == pytest.approx(wall_mm3, rel=0.2)


@pytest.mark.parametrize(
    ("scene", "kind", "most"),
    [
        (Scene(radii_mm=(2.0, 2.0, 2.0)), "solid", 0.2),
        (Scene(radii_mm=(6.0, 6.0, 6.0), core_mm=3.0, core_hu=600.0), "solid", 0.06),
        (Scene(radii_mm=(4.0, 4.0, 4.0), level_hu=500.0), "solid", 0.15),
        (Scene(radii_mm=(8.0, 8.0, 8.0), level_hu=-700.0), "ground-glass", 0.05),
        (Scene(radii_mm=(8.0, 8.0, 8.0), level_hu=-550.0, core_mm=3.5), "part-solid", 0.06),
        (Scene(radii_mm=(21.0, 20.0, 21.0)), "solid", 0.02),
    ],
)
def test_small_calcified_ground_glass_and_large_nodules_are_classified(scene, kind, most):
    volume, true_mm3, middle = painted(scene)
    nodule = grow_nodule(volume, middle)
    assert nodule.kind == kind
    assert nodule.volume_mm3 == pytest.approx(true_mm3, rel=most)
    assert nodule.volume_mm3 == pytest.approx(true_mm3, abs=nodule.volume_error_mm3)
