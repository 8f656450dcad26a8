"""Tests of targets from masks, segmentations and structure sets: measures, and refusal of files of another CT."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
import SimpleITK as sitk
import structure_files as made

import carina
from carina.errors import NoResultError, UsageError, VolumeImportError
from carina.plan import nodule_from_mask, target_from_file, target_from_mask
from carina.volume import MaskGridError, MaskLabelError, Volume

RADIUS_MM = 6.0
BALL_MM3 = 4.0 / 3.0 * np.pi * RADIUS_MM**3


@functools.cache
def scene():
    volume, centre = made.lung_with_ball(RADIUS_MM)
    return volume, centre, made.ball_voxels(volume, centre, RADIUS_MM)


def off_voxels(volume, one, other) -> float:
    return float(np.abs(volume.to_ijk(np.array(one)) - volume.to_ijk(np.array(other))).max())


def nifti(path, volume, values):
    image = sitk.GetImageFromArray(values.astype(np.uint8))
    image.SetSpacing(volume.spacing_mm)
    image.SetOrigin(volume.lps_from_ijk[:3, 3].tolist())
    image.SetDirection((volume.lps_from_ijk[:3, :3] / volume.spacing_mm).ravel().tolist())
    sitk.WriteImage(image, str(path))
    return path


def test_target_from_a_mask_has_the_volume_and_diameters_of_the_mask():
    volume, centre, inside = scene()
    nodule = nodule_from_mask(volume, inside)
    voxel_mm3 = float(np.prod(volume.spacing_mm))
    assert nodule.volume_mm3 == pytest.approx(inside.sum() * voxel_mm3)
    assert abs(nodule.volume_mm3 - BALL_MM3) <= nodule.volume_error_mm3 < 0.3 * BALL_MM3
    # The voxels that the needle test uses have the same volume.
    step = np.linalg.norm(nodule.lps_from_ijk[:3, 0])
    assert nodule.inside_zyx.sum() * step**3 == pytest.approx(nodule.volume_mm3, rel=0.01)
    assert nodule.long_mm == pytest.approx(12.0, abs=nodule.diameter_error_mm)
    assert nodule.short_mm == pytest.approx(12.0, abs=nodule.diameter_error_mm)
    assert off_voxels(volume, nodule.centre_lps, centre) < 0.1
    assert nodule.distance_mm([centre + np.array([0.0, 0.0, 9.0])]) == pytest.approx(3.0, abs=0.7)
    assert (nodule.kind, nodule.touches, nodule.notes) == ("solid", (), ())


def test_dicom_segmentation_structure_set_and_mask_of_one_nodule_give_equal_targets(tmp_path):
    volume, centre, inside = scene()
    files = {
        "seg": made.segmentation(tmp_path / "seg.dcm", volume, inside.astype(int)),
        "rtstruct": made.structure_set(tmp_path / "rs.dcm", [("GTV", made.ball_outlines(volume, centre, RADIUS_MM))]),
        "mask": nifti(tmp_path / "mask.nii.gz", volume, inside),
    }
    found = {source: target_from_file(path, volume) for source, path in files.items()}
    assert {source: target.source for source, target in found.items()} == {source: source for source in files}
    assert found["rtstruct"].name == "GTV"
    for one in found.values():
        for other in found.values():
            apart = abs(one.nodule.volume_mm3 - other.nodule.volume_mm3)
            assert apart <= min(one.nodule.volume_error_mm3, other.nodule.volume_error_mm3)
            assert apart <= 0.02 * BALL_MM3
            assert off_voxels(volume, one.nodule.centre_lps, other.nodule.centre_lps) < 0.1
            assert abs(one.nodule.long_mm - other.nodule.long_mm) <= one.nodule.diameter_error_mm
    # Exact circles are rasterised without an error, so the error comes from the sum over slices.
    areas = sum(np.pi * (RADIUS_MM**2 - h**2) for h in _heights(volume, centre))
    assert found["rtstruct"].nodule.volume_mm3 == pytest.approx(areas * volume.spacing_mm[2], rel=3e-3)


def _heights(volume, centre):
    normal = volume.lps_from_ijk[:3, 2] / volume.spacing_mm[2]
    heights = [(volume.to_lps(np.array([0.0, 0.0, k])) - centre) @ normal for k in range(volume.shape_zyx[0])]
    return [h for h in heights if abs(h) < RADIUS_MM]


def test_outlines_around_voxels_and_through_voxel_centres_give_equal_masks(tmp_path):
    volume, _, inside = scene()
    expected = nodule_from_mask(volume, inside)
    for outlines, note in (
        (made.edge_outlines(volume, inside), None),
        (made.centre_outlines(volume, inside), "its outline runs through the centres of voxels"),
    ):
        path = made.structure_set(tmp_path / "rs.dcm", [("GTV", outlines)])
        nodule = target_from_file(path, volume).nodule
        # Files round coordinates to 0.001 mm.
        assert nodule.volume_mm3 == pytest.approx(expected.volume_mm3, rel=2e-3 if note is None else 0.01)
        assert off_voxels(volume, nodule.centre_lps, expected.centre_lps) < 0.1
        assert any(one.startswith(note) for one in nodule.notes) if note else len(nodule.notes) == 1


def test_nested_outline_and_keyhole_outline_are_read_as_holes(tmp_path):
    volume, centre, _ = scene()
    outer, inner = (made.ball_outlines(volume, centre, r) for r in (RADIUS_MM, 3.0))
    shell = {k: [*loops, *inner.get(k, [])] for k, loops in outer.items()}
    channel = {
        k: [np.concatenate([loops[0], loops[0][:1], inner[k][0][::-1], inner[k][0][-1:]])] if k in inner else loops
        for k, loops in outer.items()
    }
    xor = made.structure_set(tmp_path / "xor.dcm", [("GTV", shell)], kind="CLOSEDPLANAR_XOR")
    paths = [
        made.structure_set(tmp_path / "hole.dcm", [("GTV", shell)]),
        made.structure_set(tmp_path / "channel.dcm", [("GTV", channel)]),
        xor,
    ]
    for path in paths:
        nodule = target_from_file(path, volume).nodule
        assert nodule.volume_mm3 == pytest.approx(BALL_MM3 * (1.0 - 0.125), rel=0.02)
        assert not nodule.contains([centre])[0]
        assert nodule.contains([nodule.middle_lps])[0]


def test_file_with_several_structures_needs_the_name_of_one(tmp_path):
    volume, centre, inside = scene()
    small = made.ball_outlines(volume, centre, 3.0)
    rs = made.structure_set(
        tmp_path / "rs.dcm", [("GTV", made.ball_outlines(volume, centre, RADIUS_MM)), ("node", small), ("empty", {})]
    )
    labels = inside.astype(int) + made.ball_voxels(volume, centre, 3.0)
    seg = made.segmentation(tmp_path / "seg.dcm", volume, labels)
    with pytest.raises(MaskLabelError, match=r"1 \(GTV\), 2 \(node\); choose the nodule") as error:
        target_from_file(rs, volume)
    assert [round(label.volume_ml, 2) for label in error.value.labels] == [0.9, 0.11]
    with pytest.raises(MaskLabelError, match=r"1 \(nodule 1\), 2 \(nodule 2\); choose the nodule"):
        target_from_file(seg, volume)
    for wanted in (2, "NODE"):
        target = target_from_file(rs, volume, structure=wanted)
        assert target.name == "node"
        assert target.nodule.equivalent_mm == pytest.approx(6.0, abs=0.3)
    assert target_from_file(seg, volume, structure="nodule 2").nodule.equivalent_mm == pytest.approx(6.0, abs=0.4)
    assert target_from_file(seg, volume, structure=2, name="mine").name == "mine"
    for path, wanted in ((rs, "liver"), (rs, 9), (seg, "liver"), (seg, 9)):
        with pytest.raises(MaskLabelError, match=r"none is named liver|9 is not among them"):
            target_from_file(path, volume, structure=wanted)
    with pytest.raises(VolumeImportError, match=r"the structure 3 \(empty\) is empty"):
        target_from_file(rs, volume, structure=3)


def _tilted(outlines):
    return {
        k: [points + np.outer(np.arange(len(points)) / 60.0, [0, 0, 1.0]) for points in one]
        for k, one in outlines.items()
    }


def _raised(outlines, mm):
    normal = made.oblique()[:3, 2] / made.SPACING_MM[2]
    return {k: [points + mm * normal for points in one] for k, one in outlines.items()}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda outlines: {}, "its structure is empty"),
        (_tilted, "not parallel to the slices"),
        (lambda outlines: _raised(outlines, 0.5), r"0\.5 mm off the nearest slice"),
        (lambda outlines: _raised(outlines, 40.0), "outside this CT"),
        (
            lambda outlines: {k: [p + np.array([30.0, 0, 0]) for p in one] for k, one in outlines.items()},
            "outside this CT|nearest|parallel",
        ),
        (lambda outlines: {k: [p[:2] for p in one] for k, one in outlines.items()}, "only points or open lines"),
        (lambda outlines: {k: [np.repeat(p[:1], 5, axis=0) for p in one] for k, one in outlines.items()}, "no area"),
    ],
)
def test_invalid_outlines_for_this_ct_are_refused(tmp_path, change, text):
    volume, centre, _ = scene()
    outlines = change(made.ball_outlines(volume, centre, RADIUS_MM))
    path = made.structure_set(tmp_path / "rs.dcm", [("GTV", outlines)])
    chosen = None if not outlines else 1
    with pytest.raises((VolumeImportError, NoResultError), match=text):
        target_from_file(path, volume, structure=chosen)


def test_points_and_open_lines_are_refused_because_they_enclose_nothing(tmp_path):
    volume, centre, _ = scene()
    path = made.structure_set(
        tmp_path / "rs.dcm", [("line", made.ball_outlines(volume, centre, 5.0))], kind="OPEN_PLANAR"
    )
    with pytest.raises(VolumeImportError, match="only points or open lines, which enclose nothing"):
        target_from_file(path, volume, structure=1)


@pytest.mark.parametrize("left_out", [1, 2])
def test_slice_without_an_outline_is_filled_with_a_note(tmp_path, left_out):
    volume, centre, _ = scene()
    outlines = made.ball_outlines(volume, centre, RADIUS_MM)
    whole = target_from_file(made.structure_set(tmp_path / "a.dcm", [("GTV", outlines)]), volume).nodule
    for k in sorted(outlines)[3 : 3 + left_out]:
        del outlines[k]
    nodule = target_from_file(made.structure_set(tmp_path / "b.dcm", [("GTV", outlines)]), volume).nodule
    # Between two circles the ball is wider than the interpolation.
    assert nodule.volume_mm3 == pytest.approx(whole.volume_mm3, rel=0.02 * left_out)
    assert nodule.volume_error_mm3 > whole.volume_error_mm3
    assert f"{left_out} slice{'s' if left_out > 1 else ''} without an outline: interpolated" in nodule.notes[1]


def test_structure_with_two_lesions_needs_a_point_inside_one_of_them(tmp_path):
    volume, centre, inside = scene()
    other = centre + 14.0 * volume.lps_from_ijk[:3, 2] / volume.spacing_mm[2]
    both = {**made.ball_outlines(volume, centre, 4.0), **made.ball_outlines(volume, other, 3.0)}
    path = made.structure_set(tmp_path / "rs.dcm", [("GTV", both)])
    with pytest.raises(NoResultError, match=r"2 separate parts \(0.27 ml, 0.11 ml\)") as error:
        target_from_file(path, volume)
    assert error.value.code == "plan.mask-parts"
    nodule = target_from_file(path, volume, at_lps=other).nodule
    assert off_voxels(volume, nodule.centre_lps, other) < 0.1
    assert any("1 other part of the mask" in note for note in nodule.notes)
    with pytest.raises(NoResultError, match="nearest is"):
        target_from_file(path, volume, at_lps=centre + 25.0)
    # A single stray voxel does not count as a second lesion.
    stray = inside.copy()
    stray[2, 3, 4] = True
    assert nodule_from_mask(volume, stray).notes == ("1 other part of the mask (0.0007 ml) left out",)


def test_structures_drawn_on_another_ct_are_refused(tmp_path):
    volume, centre, inside = scene()
    folder = made.ct_files(tmp_path / "ct", volume)
    opened = carina.open_volume(folder)
    outlines = [("GTV", made.ball_outlines(volume, centre, RADIUS_MM))]
    own = made.structure_set(tmp_path / "own.dcm", outlines)
    target = target_from_file(own, opened, ct=folder)
    assert target.nodule.notes == ()
    assert off_voxels(volume, target.nodule.centre_lps, centre) < 0.1
    assert "could not be checked" in target_from_file(own, opened).nodule.notes[0]
    seg = made.segmentation(tmp_path / "seg.dcm", volume, inside.astype(int))
    assert target_from_file(seg, opened, ct=folder).nodule.notes == ()
    sister = made.structure_set(tmp_path / "sister.dcm", outlines, series="1.2.826.9")
    assert "another series of the same examination" in target_from_file(sister, opened, ct=folder).nodule.notes[0]
    newer = {"frame": "1.2.826.7.1", "study": "1.2.826.7.2", "series": "1.2.826.7.3"}
    for path in (
        made.structure_set(tmp_path / "newer.dcm", outlines, **newer),
        made.structure_set(tmp_path / "renamed.dcm", outlines, study="1.2.826.7.2", series="1.2.826.7.3"),
        made.segmentation(tmp_path / "newer-seg.dcm", volume, inside.astype(int), **newer),
    ):
        with pytest.raises(VolumeImportError, match=r"drawn on another CT.*open the CT that it was drawn on") as error:
            target_from_file(path, opened, ct=folder)
        assert error.value.code == "import.other-ct"
        assert "1.2.826" not in str(error.value)


def test_masks_of_another_ct_are_refused(tmp_path):
    volume, _, inside = scene()
    with pytest.raises(UsageError, match="drawn on another grid"):
        target_from_mask(volume, inside[:-1])
    with pytest.raises(UsageError, match="values other than 0 and 1"):
        nodule_from_mask(volume, inside.astype(np.uint8) * 3)
    with pytest.raises(NoResultError, match="the segmentation is empty"):
        nodule_from_mask(volume, np.zeros_like(inside))
    moved = volume.lps_from_ijk.copy()
    moved[:3, 3] += 0.3
    other = Volume(volume.hu_zyx, moved)
    path = nifti(tmp_path / "other.nii.gz", other, inside)
    with pytest.raises(MaskGridError):
        target_from_file(path, volume)
    assert "nearest voxel" in target_from_file(path, volume, resample=True).nodule.notes[0]
    coarse = Volume(np.zeros((4, 4, 4), np.int16), np.diag([90.0, 90.0, 90.0, 1.0]))
    with pytest.raises(NoResultError, match="a target has at most 200 mm"):
        nodule_from_mask(coarse, np.ones((4, 4, 4), bool))


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.ROIContourSequence[0].ContourSequence[0].ContourData.pop(),
        lambda data: data.StructureSetROISequence.clear(),
        lambda data: delattr(data.ROIContourSequence[0], "ReferencedROINumber"),
        lambda data: setattr(data, "SOPClassUID", "1.2.840.10008.5.1.4.1.1.2"),
        lambda data: data.ROIContourSequence.clear(),
    ],
)
def test_damaged_structure_set_is_refused(tmp_path, change):
    volume, centre, _ = scene()
    path = made.structure_set(tmp_path / "rs.dcm", [("GTV", made.ball_outlines(volume, centre, 5.0))], change=change)
    with pytest.raises(VolumeImportError):
        target_from_file(path, volume)
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(VolumeImportError):
        target_from_file(path, volume)


def test_structure_set_on_a_ct_with_permuted_axes_gives_an_equal_target(tmp_path):
    volume, centre, _ = scene()
    path = made.structure_set(tmp_path / "rs.dcm", [("GTV", made.ball_outlines(volume, centre, RADIUS_MM))])
    expected = target_from_file(path, volume).nodule
    # The axes i, j, k become j, k, i, and one of them is reversed.
    turned = np.ascontiguousarray(volume.hu_zyx.transpose(2, 0, 1)[:, ::-1])
    matrix = volume.lps_from_ijk[:, [1, 2, 0, 3]].copy()
    matrix[:3, 3] += matrix[:3, 1] * (volume.shape_zyx[0] - 1)
    matrix[:3, 1] *= -1.0
    found = target_from_file(path, Volume(turned, matrix)).nodule
    assert found.volume_mm3 == pytest.approx(expected.volume_mm3, rel=1e-3)
    assert found.centre_lps == pytest.approx(expected.centre_lps, abs=1e-2)


def test_target_from_a_file_has_an_anatomical_region_and_a_record():
    volume, _, inside = scene()
    target = target_from_mask(volume, inside, target_id="a", name="from a mask")
    assert (target.where, target.source) == ("lung", "mask")
    assert dataclasses.replace(target, priority=2).to_record()["priority"] == 2
