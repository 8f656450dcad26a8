"""Tests of solids built from structure set outlines: exact volumes, repeated boundaries, outlines between slices."""

from __future__ import annotations

import functools

import numpy as np
import pydicom
import pytest
import structure_files as made
from pydicom.dataset import Dataset

import carina
from carina.errors import NoResultError, VolumeImportError
from carina.plan import target_from_file
from carina.plan.targets.contours import OutlineError, drawn_in
from carina.volume import Volume
from carina.volume.dicom_structures import Contour

RADII_MM = (8.0, 7.0, 9.0)
CENTRE_LPS = np.array([-31.3, 12.4, -70.7])
SLICE_MM = 1.0


@functools.cache
def grid():
    """Return an oblique CT with unequal spacings; the shapes are not in its middle."""
    turn = made.oblique()[:3, :3] / made.SPACING_MM
    matrix = np.eye(4)
    matrix[:3, :3] = turn * (0.7, 0.8, SLICE_MM)
    matrix[:3, 3] = CENTRE_LPS - matrix[:3, :3] @ np.array([31.2, 22.7, 24.4])
    return Volume(np.full((50, 48, 60), -850, np.int16), matrix)


def ellipse(height_mm, *, radii=RADII_MM, grow=1.0, shift=(0.0, 0.0), centre=CENTRE_LPS, is_xor=False):
    """Return the outline of an ellipsoid in a plane at a height above its centre."""
    volume = grid()
    across, up, normal = (volume.lps_from_ijk[:3, n] / volume.spacing_mm[n] for n in range(3))
    turn = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)[:, None]
    part = np.sqrt(max(1.0 - (height_mm / radii[2]) ** 2, 0.0)) * grow
    flat = part * (radii[0] * np.cos(turn) * across + radii[1] * np.sin(turn) * up)
    return Contour(centre + height_mm * normal + shift[0] * across + shift[1] * up + flat, is_xor)


def slice_heights(*, every=1, start=0, reach=RADII_MM[2], centre=CENTRE_LPS):
    """Return the heights (mm) above the centre of every n-th slice that cuts a shape of half height ``reach``."""
    volume = grid()
    normal = volume.lps_from_ijk[:3, 2] / volume.spacing_mm[2]
    found = [float((volume.to_lps(np.array([0.0, 0.0, k])) - centre) @ normal) for k in range(volume.shape_zyx[0])]
    return [h for k, h in enumerate(found) if abs(h) < reach - 1e-3 and k % every == start]


def measured(contours, **options):
    """Return the volume (mm3), the centroid (LPS mm) and the notes of the solid built from outlines."""
    volume = grid()
    drawn, notes, _ = drawn_in(volume, contours, **options)
    k, j, i = np.indices(drawn.share_zyx.shape)
    ijk = np.stack([i, j, k], axis=-1) + np.array(drawn.first_zyx[::-1])
    total = float(drawn.share_zyx.sum())
    middle = (ijk * drawn.share_zyx[..., None]).sum(axis=(0, 1, 2)) / total
    return total * float(np.prod(volume.spacing_mm)), volume.to_lps(middle), notes


def area_mm2(height_mm, *, radii=RADII_MM):
    return np.pi * radii[0] * radii[1] * max(1.0 - (height_mm / radii[2]) ** 2, 0.0)


# Relative error of the volume if every n-th slice has an outline: with every fifth slice, 3 or 4 planes cut a ball of 9
# mm.
TOLERANCE = {1: 0.01, 2: 0.02, 3: 0.03, 5: 0.08}


@pytest.mark.parametrize(("every", "start"), [(n, start) for n in TOLERANCE for start in range(n)])
def test_outlines_on_every_nth_slice_have_the_volume_of_an_ellipsoid(every, start):
    heights = slice_heights(every=every, start=start)
    mm3, middle, notes = measured([ellipse(h) for h in heights])
    slabs = sum(area_mm2(h) for h in heights) * every * SLICE_MM
    # The solid is a slab for each outline; the remaining error comes from rasterisation.
    assert mm3 == pytest.approx(slabs, rel=0.005)
    assert mm3 == pytest.approx(4.0 / 3.0 * np.pi * np.prod(RADII_MM), rel=TOLERANCE[every])
    # Planes that are not symmetric about the centre shift the centroid only along the normal.
    normal = grid().lps_from_ijk[:3, 2] / SLICE_MM
    off = middle - CENTRE_LPS
    along = sum(area_mm2(h) * h for h in heights) / sum(area_mm2(h) for h in heights)
    assert np.linalg.norm(off - along * normal) < 0.15
    assert any("without an outline: interpolated" in note for note in notes) == (every > 1)


@pytest.mark.parametrize("every", [3, 5])
def test_sparse_outlines_give_one_target_at_the_right_position(tmp_path, every):
    contours = {n: [ellipse(h).points_lps] for n, h in enumerate(slice_heights(every=every))}
    path = made.structure_set(tmp_path / "rs.dcm", [("GTV", contours)])
    target = target_from_file(path, grid())
    assert target.nodule.volume_mm3 == pytest.approx(4.0 / 3.0 * np.pi * np.prod(RADII_MM), rel=TOLERANCE[every])
    assert np.linalg.norm(np.array(target.nodule.middle_lps) - CENTRE_LPS) < 1.5
    assert not any("other part" in note for note in target.nodule.notes)


def test_cylinder_from_outlines_extends_half_an_outline_distance_beyond_its_ends():
    radii = (6.0, 6.0, 1e6)
    for every, start in ((1, 0), (2, 0), (3, 1), (4, 1)):
        heights = slice_heights(every=every, start=start, reach=9.0)
        mm3, middle, _ = measured([ellipse(h, radii=radii) for h in heights])
        assert mm3 == pytest.approx(np.pi * 36.0 * len(heights) * every * SLICE_MM, rel=0.005)
        normal = grid().lps_from_ijk[:3, 2] / SLICE_MM
        assert (middle - CENTRE_LPS) @ normal == pytest.approx(np.mean(heights), abs=0.02)


def test_outline_on_one_slice_is_one_slice_thick():
    height = slice_heights()[8]
    mm3, _, notes = measured([ellipse(height)])
    assert mm3 == pytest.approx(area_mm2(height) * SLICE_MM, rel=0.005)
    assert notes == ()


def test_target_from_outlines_ends_at_the_end_of_the_ct():
    normal = grid().lps_from_ijk[:3, 2] / SLICE_MM
    first = slice_heights(reach=1e3)[0]
    contours = [
        ellipse(h - first, radii=(6.0, 6.0, 1e6), centre=CENTRE_LPS + first * normal) for h in (first, first + 4.0)
    ]
    mm3, _, _ = measured(contours)
    # The slab covers slices 0 to 5 and half of slice 6, and nothing before the first slice of the CT.
    assert mm3 == pytest.approx(np.pi * 36.0 * 6.5, rel=0.005)


@pytest.mark.parametrize(
    ("grow", "text"),
    [((1.0, 1.0), "identical"), ((1.0, 1.01), "mm apart"), ((1.0, 0.96, 1.02), "mm apart"), ((1.0,) * 5, "identical")],
)
def test_several_outlines_of_one_boundary_are_averaged_with_a_note(grow, text):
    heights = slice_heights()
    mm3, middle, notes = measured([ellipse(h, grow=part) for h in heights for part in grow])
    expected = sum(area_mm2(h) for h in heights) * SLICE_MM * np.mean(np.square(grow))
    assert mm3 == pytest.approx(expected, rel=0.005)
    assert np.linalg.norm(middle - CENTRE_LPS) < 0.1
    assert len(notes) == 1
    assert text in notes[0]
    assert notes[0].startswith(f"on {len(heights)} slices the boundary was drawn more than once")


def test_one_repeated_outline_does_not_split_the_target(tmp_path):
    heights = slice_heights()
    contours = {n: [ellipse(h).points_lps] for n, h in enumerate(heights)}
    contours[7] = contours[7] * 2
    nodule = target_from_file(made.structure_set(tmp_path / "rs.dcm", [("GTV", contours)]), grid()).nodule
    assert nodule.volume_mm3 == pytest.approx(sum(area_mm2(h) for h in heights), rel=0.005)
    assert any(note.startswith("on 1 slice the boundary was drawn more than once") for note in nodule.notes)


def test_crossing_outlines_of_two_observers_are_averaged():
    heights = slice_heights()
    contours = [ellipse(h, shift=shift) for h in heights for shift in ((0.0, 0.0), (0.3, -0.3))]
    mm3, _, notes = measured(contours)
    assert mm3 == pytest.approx(sum(area_mm2(h) for h in heights), rel=0.01)
    assert "more than once" in notes[0]


def test_outline_that_winds_twice_round_the_target_has_the_volume_of_one_winding():
    heights = slice_heights()
    contours = [Contour(np.concatenate([one, one]), False) for one in (ellipse(h).points_lps for h in heights)]
    mm3, _, _ = measured(contours)
    assert mm3 == pytest.approx(sum(area_mm2(h) for h in heights), rel=0.005)


def test_equal_outlines_in_two_items_of_one_structure_are_counted_once(tmp_path):
    def repeat(data):
        item = Dataset()
        item.ReferencedROINumber = 1
        item.ContourSequence = list(data.ROIContourSequence[0].ContourSequence)
        data.ROIContourSequence.append(item)

    heights = slice_heights()
    contours = {n: [ellipse(h).points_lps] for n, h in enumerate(heights)}
    path = made.structure_set(tmp_path / "rs.dcm", [("GTV", contours)], change=repeat)
    assert len(pydicom.dcmread(path).ROIContourSequence) == 2
    nodule = target_from_file(path, grid()).nodule
    assert nodule.volume_mm3 == pytest.approx(sum(area_mm2(h) for h in heights), rel=0.005)


@pytest.mark.parametrize(("inner", "is_xor"), [(0.88, False), (0.87, False), (1.0, True), (0.99, True)])
def test_nested_outlines_that_may_be_two_boundaries_or_a_thin_wall_are_refused(inner, is_xor):
    contours = [ellipse(h, grow=part, is_xor=is_xor) for h in slice_heights() for part in (1.0, inner)]
    with pytest.raises(OutlineError, match=r"nearly equal and cancel|drawn twice, or a thin wall") as error:
        measured(contours)
    assert error.value.code == "import.mask"
    assert error.value.way_out.startswith("keep one of them")


def test_nested_outlines_are_read_as_holes_and_islands_with_a_note():
    heights = slice_heights()
    hollow = [h for h in heights if abs(h) < 7.0]
    contours = [ellipse(h) for h in heights]
    contours += [ellipse(h, grow=0.5) for h in hollow] + [ellipse(h, grow=0.2) for h in hollow]
    outer, inner = (sum(area_mm2(h) for h in some) * SLICE_MM for some in (heights, hollow))
    mm3, _, notes = measured(contours)
    assert mm3 == pytest.approx(outer - 0.25 * inner + 0.04 * inner, rel=0.005)
    assert notes == (
        f"on {len(hollow)} slices an outline within another was taken as a hole ({0.25 * inner / 1000:.2g} ml)",
    )
    as_xor = [Contour(one.points_lps, True) for one in contours]
    assert measured(as_xor)[0] == pytest.approx(mm3, rel=0.005)
    assert measured(as_xor)[2] == ()


def test_volumes_of_two_parts_add_up_if_one_part_ends_on_an_earlier_slice():
    radii = (3.0, 3.0, 1e6)
    heights = slice_heights(every=3, reach=11.0)
    long = [ellipse(h, radii=radii, shift=(-8.0, 0.0)) for h in heights]
    short = [ellipse(h, radii=radii, shift=(8.0, 0.0)) for h in heights[:3]]
    drawn, _, _ = drawn_in(grid(), long + short)
    half = drawn.share_zyx.shape[2] // 2
    voxel_mm3 = float(np.prod(grid().spacing_mm))
    # The two parts are side by side along the columns; each part has slabs for its outlines.
    for part, num in ((drawn.share_zyx[..., :half], len(heights)), (drawn.share_zyx[..., half:], 3)):
        assert float(part.sum()) * voxel_mm3 == pytest.approx(np.pi * 9.0 * 3.0 * num, rel=0.01)


@pytest.mark.parametrize(
    ("distance_mm", "first_mm"), [(0.5, -8.7), (0.4, -8.85), (2.5, -7.6), (5.0, -7.1), (1.0, -8.5)]
)
def test_outlines_between_slices_are_assigned_by_their_position(distance_mm, first_mm):
    heights = np.arange(first_mm, RADII_MM[2], distance_mm)
    mm3, middle, notes = measured([ellipse(h) for h in heights], may_be_between=True)
    assert mm3 == pytest.approx(sum(area_mm2(h) for h in heights) * distance_mm, rel=0.01)
    assert mm3 == pytest.approx(4.0 / 3.0 * np.pi * np.prod(RADII_MM), rel=0.08)
    assert np.linalg.norm(middle - CENTRE_LPS) < 0.25 * distance_mm + 0.2
    assert notes[0].startswith("its outlines lie up to")
    assert "placed by position" in notes[0]


def test_outlines_between_slices_with_another_frame_of_reference_are_refused(tmp_path):
    volume, centre = made.lung_with_ball(6.0)
    folder = made.ct_files(tmp_path / "ct", volume)
    opened = carina.open_volume(folder)
    normal = volume.lps_from_ijk[:3, 2] / volume.spacing_mm[2]
    # Planes half a millimetre from the slices cut the ball around its unshifted centre.
    lower = made.ball_outlines(volume, centre - 0.5 * normal, 6.0)
    outlines = {k: [points + 0.5 * normal for points in one] for k, one in lower.items()}
    path = made.structure_set(tmp_path / "rs.dcm", [("GTV", outlines)])
    nodule = target_from_file(path, opened, ct=folder).nodule
    assert nodule.volume_mm3 == pytest.approx(4.0 / 3.0 * np.pi * 216.0, rel=0.03)
    assert np.linalg.norm(np.array(nodule.centre_lps) - centre) < 0.1
    assert any("placed by position" in note for note in nodule.notes)
    with pytest.raises(
        VolumeImportError, match=r"0\.5 mm off the nearest slice of this CT.*compare the frame of reference"
    ) as error:
        target_from_file(path, opened)
    assert error.value.code == "import.mask-grid"


def test_two_lesions_with_sparse_outlines_stay_separate(tmp_path):
    normal = grid().lps_from_ijk[:3, 2] / SLICE_MM
    heights = slice_heights(every=3, reach=23.0)
    one, other = heights[:3], heights[-3:]
    assert min(other) - max(one) > 20.0
    contours = {}
    for n, h in enumerate([*one, *other]):
        middle = one[1] if h in one else other[1]
        contours[n] = [ellipse(h - middle, radii=(4.0, 4.0, 5.0), centre=CENTRE_LPS + middle * normal).points_lps]
    path = made.structure_set(tmp_path / "rs.dcm", [("GTV", contours)])
    with pytest.raises(NoResultError, match="2 separate parts"):
        target_from_file(path, grid())
    # One missing outline, a gap of two typical distances, is filled.
    del contours[1]
    near = target_from_file(path, grid(), at_lps=CENTRE_LPS + other[1] * normal).nodule
    assert near.volume_mm3 == pytest.approx(sum(area_mm2(h - other[1], radii=(4, 4, 5)) for h in other) * 3.0, rel=0.01)


def test_missing_outlines_of_a_structure_on_every_slice_are_interpolated_and_its_ends_not_extended():
    heights = slice_heights()
    drawn_heights = heights[:5] + heights[6:]
    whole, _, _ = measured([ellipse(h) for h in heights])
    mm3, _, notes = measured([ellipse(h) for h in drawn_heights])
    assert mm3 == pytest.approx(whole, rel=0.005)
    assert notes[0].startswith("1 slice without an outline: interpolated")
