"""Tests of target boundaries edited by hand: each edit changes the boundary, is reported, and leaves a valid nodule."""

from __future__ import annotations

import functools
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from painted_nodules import Scene, painted

from carina.errors import UsageError
from carina.plan import brushed, grow_nodule, resized, sphere
from carina.volume import Volume


@functools.cache
def scene():
    volume, _, middle = painted(Scene(radii_mm=(8.0, 6.0, 6.0)))
    return volume, grow_nodule(volume, middle)


@pytest.mark.parametrize("diameter_mm", [8.0, 11.0, 16.0, 20.0, 30.0])
def test_boundary_set_to_a_diameter_has_that_diameter(diameter_mm):
    volume, nodule = scene()
    found = resized(nodule, volume, diameter_mm)
    assert found.long_mm == diameter_mm
    by_mm = 0.5 * (diameter_mm - nodule.long_mm)
    radii = np.array([8.0, 6.0, 6.0]) + by_mm
    # The boundary moves by the same distance everywhere, so the new boundary is only approximately an ellipsoid.
    expected = 4.0 / 3.0 * np.pi * radii.prod()
    assert found.volume_mm3 == pytest.approx(expected, abs=found.volume_error_mm3)
    assert found.volume_mm3 == pytest.approx(expected, rel=0.12)
    assert found.centre_lps == pytest.approx(nodule.centre_lps, abs=0.4)
    assert found.kind == nodule.kind
    assert found.notes == ("boundary set by hand to a diameter",)
    step = np.linalg.norm(found.lps_from_ijk[:3, 0])
    assert found.inside_zyx.sum() * step**3 == pytest.approx(found.volume_mm3)


def test_boundary_of_a_larger_diameter_contains_that_of_a_smaller_one():
    volume, nodule = scene()
    sizes = [resized(nodule, volume, mm) for mm in (8.0, 12.0, 15.0, 18.0)]
    for small, large in pairwise(sizes):
        zyx = np.argwhere(small.inside_zyx)
        points = zyx[:, ::-1] @ small.lps_from_ijk[:3, :3].T + small.lps_from_ijk[:3, 3]
        assert large.contains(points).all()
        assert large.volume_mm3 > small.volume_mm3


@settings(max_examples=25, deadline=None)
@given(
    off=st.tuples(*[st.floats(-9.0, 9.0)] * 3),
    radius_mm=st.floats(1.0, 7.0),
)
def test_brush_adds_a_ball_to_a_target_boundary_and_removes_it(off, radius_mm):
    volume, nodule = scene()
    centre = np.array(nodule.centre_lps) + off
    points = centre + np.random.default_rng(1).normal(size=(300, 3)) * 0.6 * radius_mm
    in_ball = np.linalg.norm(points - centre, axis=1) < radius_mm - 0.9
    if nodule.distance_mm([centre])[0] > radius_mm + 1.0:
        with pytest.raises(UsageError, match="does not touch"):
            brushed(nodule, volume, centre, radius_mm)
        return
    if nodule.distance_mm([centre])[0] > radius_mm - 1.0:
        return
    more = brushed(nodule, volume, centre, radius_mm)
    assert more.contains(points[in_ball]).all()
    assert more.volume_mm3 >= nodule.inside_zyx.sum() * np.linalg.norm(nodule.lps_from_ijk[:3, 0]) ** 3 - 1e-6
    less = brushed(nodule, volume, centre, radius_mm, add=False)
    assert not less.contains(points[in_ball]).any()
    inside = points[less.contains(points)]
    assert nodule.contains(inside).all()
    assert less.notes == more.notes == ("boundary edited by hand",)


def test_stroke_of_the_brush_equals_its_balls_one_after_another():
    volume, nodule = scene()
    stroke = np.array(nodule.centre_lps) + np.array([(x, 3.0, 1.0) for x in np.arange(-9.0, 9.1, 0.75)])
    for add in (True, False):
        one_by_one = nodule
        for point in stroke[4:-4]:
            one_by_one = brushed(one_by_one, volume, point, 3.0, add=add)
        whole = brushed(nodule, volume, stroke[4:-4], 3.0, add=add)
        assert whole.volume_mm3 == pytest.approx(one_by_one.volume_mm3, rel=1e-6)
        assert whole.notes == one_by_one.notes
    # An erasing stroke may begin and end outside the target; an added part must be connected to the target.
    far = np.array(nodule.centre_lps) + np.array([0.0, 18.0, 0.0])
    assert brushed(nodule, volume, [*stroke, far], 3.0, add=False).volume_mm3 < nodule.volume_mm3
    with pytest.raises(UsageError, match="a target is one piece"):
        brushed(nodule, volume, [*stroke, far], 2.0)


def test_boundary_edits_that_leave_no_target_are_refused():
    volume, nodule = scene()
    centre = np.array(nodule.centre_lps)
    with pytest.raises(UsageError, match="nothing of the target would be left") as error:
        brushed(nodule, volume, centre, 15.0, add=False)
    assert error.value.code == "plan.edit"
    with pytest.raises(UsageError, match="does not touch the target; a target is one piece"):
        brushed(nodule, volume, centre + np.array([0.0, 18.0, 0.0]), 2.0)
    with pytest.raises(UsageError, match="does not touch"):
        brushed(nodule, volume, centre + np.array([0.0, 18.0, 0.0]), 2.0, add=False)
    with pytest.raises(UsageError, match="outside the scan"):
        brushed(nodule, volume, centre + 200.0, 2.0)
    with pytest.raises(UsageError, match="nothing of the target would be left"):
        resized(nodule, volume, 3.0)
    for wrong in (0.0, -3.0, np.nan, np.inf, 151.0):
        with pytest.raises(UsageError, match="expected a diameter of 1 to 150 mm"):
            resized(nodule, volume, wrong)
        with pytest.raises(UsageError, match="expected a brush radius"):
            brushed(nodule, volume, centre, wrong)
        with pytest.raises(UsageError, match="expected a diameter"):
            sphere(volume, centre, wrong)


def test_target_boundary_edited_beyond_the_ct_ends_at_its_border_with_a_note():
    volume, nodule = scene()
    k = int(volume.to_ijk(np.array(nodule.centre_lps))[2]) - 4
    place = volume.lps_from_ijk.copy()
    place[:3, 3] += k * place[:3, 2]
    cut = Volume(np.ascontiguousarray(volume.hu_zyx[k:]), place)
    wide = resized(nodule, cut, 24.0)
    assert "edge of the CT" in wide.touches
    assert wide.volume_mm3 < 0.9 * resized(nodule, volume, 24.0).volume_mm3
    low = cut.to_lps(np.array([0.0, 0.0, -0.4]))
    with pytest.raises(UsageError, match="more than half of the target would lie outside the CT"):
        sphere(cut, low, 20.0)


def test_part_of_a_target_that_an_erasing_brush_separates_is_removed():
    volume, nodule = scene()
    centre = np.array(nodule.centre_lps)
    less = brushed(nodule, volume, centre + np.array([4.0, 0.0, 0.0]), 6.2, add=False)
    assert not less.contains([centre + np.array([7.5, 0.0, 0.0])])[0]
    assert less.contains([centre - np.array([5.0, 0.0, 0.0])])[0]


def test_sphere_at_a_point_without_a_visible_boundary_is_a_valid_target():
    volume, _ = scene()
    made = sphere(volume, (3.0, 4.0, 5.0), 12.0)
    assert made.volume_mm3 == pytest.approx(np.pi / 6.0 * 12.0**3, rel=0.03)
    assert made.long_mm == pytest.approx(12.0, abs=0.6)
    assert made.centre_lps == pytest.approx((3.0, 4.0, 5.0), abs=0.1)
    assert made.notes == ("a sphere set by hand: the CT shows no boundary that was used",)
    assert made.diameter_error_mm > 2.0


def test_cavity_of_a_nodule_is_preserved_when_its_boundary_is_moved():
    volume, _, middle = painted(Scene(radii_mm=(9.0, 9.0, 9.0), core_mm=5.0, core_hu=-980.0))
    nodule = grow_nodule(volume, middle)
    wider = resized(nodule, volume, nodule.long_mm + 3.0)
    assert wider.volume_mm3 == pytest.approx(4.0 / 3.0 * np.pi * 10.5**3, rel=0.06)
    assert wider.volume_mm3 - wider.solid_mm3 == pytest.approx(nodule.volume_mm3 - nodule.solid_mm3, rel=0.15)
    assert not wider.contains([middle])[0]
