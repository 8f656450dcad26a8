"""Tests of a target exported as a segmentation for 3D Slicer, and as DICOM for the images of an oblique CT."""

from __future__ import annotations

import dataclasses
import datetime
import functools
import json

import numpy as np
import pydicom
import pytest
import SimpleITK as sitk
from dicom_writer import chest, series
from nodules import ellipsoid

from cached_test_data import SMALL_CHEST, cached_airways, cached_phantom
from carina.errors import CancelledError, DiskError, NoResultError, UsageError, VolumeImportError
from carina.export.plan_dicom_seg import inside_on_grid, write_target_seg
from carina.export.plan_dicom_sr import write_target_report
from carina.export.plan_nrrd import write_target_nrrd
from carina.navigate.rotation import rotation_from_vector
from carina.track import lumen_mask
from carina.volume import Volume, open_mask, open_volume, write_grid
from carina.volume.inserted_structures import with_inserted

TURN = rotation_from_vector(np.array([0.31, -0.22, 0.47]))
FIRST_LPS = np.array([-40.125, 17.5, -203.25])
STEP_MM = np.array([0.7, 0.9, 2.5])
NOW = datetime.datetime(2026, 3, 4, 15, 30, 5, tzinfo=datetime.UTC)
SECRETS = ("Secret", "SECRET-1", "19010101")


def oblique(dataset, index):
    dataset.ImageOrientationPatient = [f"{v:.10f}" for v in (*TURN[:, 0], *TURN[:, 1])]
    dataset.ImagePositionPatient = [f"{v:.8f}" for v in FIRST_LPS + index * STEP_MM[2] * TURN[:, 2]]
    dataset.StudyDate, dataset.AccessionNumber, dataset.InstitutionName = "20250102", "ACC-77", "Secret Hospital"
    dataset.PatientSex, dataset.ReferringPhysicianName = "F", "Secret^Doctor"
    dataset.SpecificCharacterSet = "ISO_IR 100"
    dataset.PatientName = "Secret^Öne"


@pytest.fixture(scope="module")
def ct(tmp_path_factory):
    return series(tmp_path_factory.mktemp("ct"), oblique)


@pytest.fixture(scope="module")
def volume(ct) -> Volume:
    return open_volume(ct)


@functools.cache
def nodule():
    centre = FIRST_LPS + TURN @ (STEP_MM * [17.3, 14.1, 9.4])
    return ellipsoid([6.0, 4.5, 5.0], centre, step_mm=0.4)


def written(ct, volume, path, **options):
    return pydicom.dcmread(write_target_seg(path, nodule(), volume, ct, now=NOW, **options))


def frame_places(data) -> tuple[np.ndarray, np.ndarray]:
    """Return the centres of set voxels (n, 3), LPS mm, and the bits of the frames.

    The centres follow the definition of PS3.3 C.7.6.2.1.1.
    """
    bits = np.unpackbits(np.frombuffer(data.PixelData, np.uint8), bitorder="little")
    frames = bits[: data.NumberOfFrames * data.Rows * data.Columns].reshape(-1, data.Rows, data.Columns)
    shared = data.SharedFunctionalGroupsSequence[0]
    axes = np.array(shared.PlaneOrientationSequence[0].ImageOrientationPatient, float)
    row_mm, column_mm = (float(v) for v in shared.PixelMeasuresSequence[0].PixelSpacing)
    found = []
    for frame, group in zip(frames, data.PerFrameFunctionalGroupsSequence, strict=True):
        first = np.array(group.PlanePositionSequence[0].ImagePositionPatient, float)
        r, c = np.nonzero(frame)
        found.append(first + c[:, None] * column_mm * axes[:3] + r[:, None] * row_mm * axes[3:])
    return np.concatenate(found), frames


def test_voxel_belongs_to_the_target_mask_if_at_least_half_of_it_is_inside_the_target(volume):
    # The exact ellipsoid is sampled at many more points than in the implementation.
    k, j, i = np.indices(volume.shape_zyx).reshape(3, -1)
    at = np.linspace(-0.5, 0.5, 15)[1::2]
    inner = np.stack(np.meshgrid(at, at, at), axis=-1).reshape(-1, 3)
    share = np.zeros(len(k))
    near = np.linalg.norm(volume.to_lps(np.stack([i, j, k], axis=1)) - nodule().centre_lps, axis=1) < 9.0
    points = volume.to_lps((np.stack([i, j, k], axis=1)[near, None] + inner).reshape(-1, 3))
    off = (points - nodule().centre_lps) / [6.0, 4.5, 5.0]
    share[near] = ((off**2).sum(axis=1) < 1.0).reshape(int(near.sum()), -1).mean(axis=1)
    expected, found = share.reshape(volume.shape_zyx), inside_on_grid(nodule(), volume)
    assert found[expected > 0.62].all()
    assert not found[expected < 0.38].any()
    assert found.sum() * np.prod(STEP_MM) == pytest.approx(nodule().volume_mm3, rel=0.03)


@pytest.mark.parametrize("identity", ["none", "from the CT"])
def test_dicom_segmentation_has_the_position_of_the_nodule(ct, volume, tmp_path, identity):
    data = written(ct, volume, tmp_path / "t.dcm", identity=identity)
    places, _ = frame_places(data)
    k, j, i = np.nonzero(inside_on_grid(nodule(), volume))
    expected = FIRST_LPS + (np.stack([i, j, k], axis=1) * STEP_MM) @ TURN.T
    assert len(places) == len(expected)
    order = [np.lexsort(np.round(one, 2).T) for one in (places, expected)]
    assert np.abs(places[order[0]] - expected[order[1]]).max() < 1e-4
    assert np.linalg.norm(places.mean(axis=0) - nodule().centre_lps) < 0.3


@pytest.mark.parametrize(
    "axes",
    [
        [[1, 0, 0], [0, 0, -1]],  # coronal
        [[0, 1, 0], [0, 0, -1]],  # sagittal
        [[-1, 0, 0], [0, 1, 0]],  # axial, mirrored: the stack is ordered from head to feet
        [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0]],
    ],
)
def test_dicom_segmentation_has_its_position_for_every_slice_orientation(axes, tmp_path):
    row, column = np.array(axes, dtype=float)
    normal = np.cross(row, column)

    def cut(dataset, index):
        dataset.ImageOrientationPatient = [float(v) for v in (*row, *column)]
        # The files are named in the order opposite to the normal of the slices.
        dataset.ImagePositionPatient = [f"{v:.8f}" for v in FIRST_LPS - index * STEP_MM[2] * normal]

    ct = series(tmp_path / "ct", cut)
    volume = open_volume(ct)
    place = volume.to_lps(np.array([15.2, 16.7, 8.4]))
    near = ellipsoid([5.0, 4.0, 6.0], place, step_mm=0.4)
    path = write_target_seg(tmp_path / "t.dcm", near, volume, ct)
    found, _ = frame_places(pydicom.dcmread(path))
    k, j, i = np.nonzero(inside_on_grid(near, volume))
    expected = volume.to_lps(np.stack([i, j, k], axis=1))
    order = [np.lexsort(np.round(one, 2).T) for one in (found, expected)]
    assert np.abs(found[order[0]] - expected[order[1]]).max() < 0.01
    assert np.linalg.norm(found.mean(axis=0) - place) < 0.3
    assert np.array_equal(open_mask(path, volume).inside_zyx, inside_on_grid(near, volume))
    centre = write_target_report(tmp_path / "r.dcm", near, volume, ct)
    assert np.abs(np.subtract(centre_of(pydicom.dcmread(centre)), place)).max() < 0.01


def centre_of(data) -> list[float]:
    """Return the only point of a report, in LPS mm."""
    waiting = list(data.ContentSequence)
    while waiting:
        one = waiting.pop()
        if one.ValueType == "SCOORD3D":
            return list(one.GraphicData)
        waiting += one.get("ContentSequence", [])
    raise AssertionError("no point")


def test_cancelled_export_of_a_segmentation_leaves_no_file(ct, volume, tmp_path):
    with pytest.raises(CancelledError):
        write_target_seg(tmp_path / "t.dcm", nodule(), volume, ct, cancel=lambda: True)
    assert not list(tmp_path.iterdir())


def test_import_of_a_written_segmentation_gives_the_same_voxels(ct, volume, tmp_path):
    path = write_target_seg(tmp_path / "t.dcm", nodule(), volume, ct)
    assert np.array_equal(open_mask(path, volume).inside_zyx, inside_on_grid(nodule(), volume))


def test_each_segmentation_frame_refers_to_the_ct_image_at_its_position(ct, volume, tmp_path):
    data = written(ct, volume, tmp_path / "t.dcm")
    images = {image.SOPInstanceUID: image for image in map(pydicom.dcmread, sorted(ct.iterdir()))}
    sources = []
    for group in data.PerFrameFunctionalGroupsSequence:
        (source,) = group.DerivationImageSequence[0].SourceImageSequence
        image = images[source.ReferencedSOPInstanceUID]
        assert source.ReferencedSOPClassUID == image.SOPClassUID
        off = np.subtract(group.PlanePositionSequence[0].ImagePositionPatient, image.ImagePositionPatient)
        assert np.abs(off).max() < 1e-6
        sources.append(source.ReferencedSOPInstanceUID)
    (referred,) = data.ReferencedSeriesSequence
    assert [one.ReferencedSOPInstanceUID for one in referred.ReferencedInstanceSequence] == sources
    one = next(iter(images.values()))
    assert referred.SeriesInstanceUID == one.SeriesInstanceUID
    assert (data.StudyInstanceUID, data.FrameOfReferenceUID) == (one.StudyInstanceUID, one.FrameOfReferenceUID)
    assert data.SeriesInstanceUID != one.SeriesInstanceUID


def test_segment_is_coded_as_nodule_of_the_lung_with_its_measured_size(ct, volume, tmp_path):
    (segment,) = written(ct, volume, tmp_path / "t.dcm").SegmentSequence
    codes = (
        segment.SegmentedPropertyCategoryCodeSequence,
        segment.SegmentedPropertyTypeCodeSequence,
        segment.AnatomicRegionSequence,
    )
    assert [(c[0].CodeValue, c[0].CodeMeaning) for c in codes] == [
        ("49755003", "Morphologically Abnormal Structure"),
        ("27925004", "Nodule"),
        ("39607008", "Lung"),
    ]
    assert segment.SegmentLabel == "Target"
    assert "0.57 ml" in segment.SegmentDescription


def test_segmentation_contains_no_patient_data_unless_requested(ct, volume, tmp_path):
    data = written(ct, volume, tmp_path / "t.dcm")
    raw = (tmp_path / "t.dcm").read_bytes()
    assert not any(secret.encode() in raw for secret in (*SECRETS, "ACC-77", "20250102"))
    assert data.PatientIdentityRemoved == "YES"
    assert [data.get(key) for key in ("PatientName", "PatientID", "StudyDate")] == ["", "", ""]


def test_segmentation_contains_the_patient_identity_of_the_ct_on_request(ct, volume, tmp_path):
    data = written(ct, volume, tmp_path / "t.dcm", identity="from the CT")
    assert str(data.PatientName) == "Secret^Öne"
    assert (data.PatientID, data.PatientBirthDate, data.PatientSex) == ("SECRET-1", "19010101", "F")
    assert (data.StudyDate, data.AccessionNumber) == ("20250102", "ACC-77")
    assert "PatientIdentityRemoved" not in data
    assert (data.ContentDate, data.ContentTime) == ("20260304", "153005")
    assert b"Secret Hospital" not in (tmp_path / "t.dcm").read_bytes()


def test_segmentation_of_an_anonymised_ct_is_anonymous(tmp_path):
    def stripped(dataset, index):
        oblique(dataset, index)
        dataset.PatientName = dataset.PatientID = "CASE-12"
        dataset.PatientIdentityRemoved, dataset.DeidentificationMethod = "YES", ["Basic profile", "Dates kept"]

    folder = series(tmp_path / "ct", stripped)
    data = written(folder, open_volume(folder), tmp_path / "t.dcm", identity="from the CT")
    assert (data.PatientID, data.PatientIdentityRemoved) == ("CASE-12", "YES")
    assert list(data.DeidentificationMethod) == ["Basic profile", "Dates kept"]


def test_two_overlapping_targets_are_written_as_two_segments(ct, volume, tmp_path):
    other = ellipsoid([4.0, 4.0, 4.0], nodule().centre_lps + TURN @ np.array([4.0, 0.0, 3.0]), step_mm=0.4)
    path = write_target_seg(tmp_path / "t.dcm", {"Nodule A": nodule(), "Knoten Ö": other}, volume, ct)
    data = pydicom.dcmread(path)
    assert [s.SegmentLabel for s in data.SegmentSequence] == ["Nodule A", "Knoten Ö"]
    _, frames = frame_places(data)
    numbers = [
        g.SegmentIdentificationSequence[0].ReferencedSegmentNumber for g in data.PerFrameFunctionalGroupsSequence
    ]
    for number, one in ((1, nodule()), (2, other)):
        assert frames[np.array(numbers) == number].sum() == inside_on_grid(one, volume).sum()


def test_segmentation_contains_the_lumen_as_a_second_segment(tmp_path):
    made, airways = cached_phantom(**SMALL_CHEST), cached_airways(**SMALL_CHEST)
    # Write the same chest as a DICOM series.
    nz = made.volume.shape_zyx[0]

    def placed(dataset, index):
        step = made.volume.lps_from_ijk
        dataset.PixelSpacing = [step[1, 1], step[0, 0]]
        dataset.ImagePositionPatient = [f"{v:.8f}" for v in step[:3, 3] + index * step[:3, 2]]

    ct = series(tmp_path / "ct", placed, hu=np.clip(made.volume.hu_zyx, -1024, 3000))
    volume = open_volume(ct)
    assert volume.shape_zyx[0] == nz
    middle = volume.centre_lps
    near = ellipsoid([5.0, 5.0, 5.0], middle)
    path = write_target_seg(tmp_path / "t.dcm", near, volume, ct, airways=airways)
    segments = pydicom.dcmread(path).SegmentSequence
    assert [s.SegmentLabel for s in segments] == ["Target", "Airway lumen"]
    assert segments[1].SegmentedPropertyTypeCodeSequence[0].CodeMeaning == "Airway structure"
    inside = open_mask(path, volume, label=2).inside_zyx
    assert np.array_equal(inside, lumen_mask(volume, airways))
    with pytest.raises(UsageError, match="rename it"):
        write_target_seg(tmp_path / "u.dcm", {"Airway lumen": near}, volume, ct, airways=airways)


def test_highdicom_reads_the_segmentation_of_each_image(ct, volume, tmp_path):
    highdicom = pytest.importorskip("highdicom", reason="highdicom, the independent reader, is not installed")
    found = highdicom.seg.segread(write_target_seg(tmp_path / "t.dcm", nodule(), volume, ct))
    uids = [image.SOPInstanceUID for image in map(pydicom.dcmread, sorted(ct.iterdir()))]
    pixels = found.get_pixels_by_source_instance(uids, segment_numbers=[1], assert_missing_frames_are_empty=True)
    assert np.array_equal(pixels[..., 0] != 0, inside_on_grid(nodule(), volume))
    grid = found.get_volume(segment_numbers=[1], combine_segments=True)
    at = np.argwhere(np.squeeze(grid.array) != 0)
    places = grid.map_indices_to_reference(at)
    k, j, i = np.nonzero(inside_on_grid(nodule(), volume))
    expected = volume.to_lps(np.stack([i, j, k], axis=1))
    assert np.abs(places.mean(axis=0) - expected.mean(axis=0)).max() < 0.01


def test_simpleitk_reads_the_segmentation_at_the_position_of_the_nodule(ct, volume, tmp_path):
    image = sitk.ReadImage(str(write_target_seg(tmp_path / "t.dcm", nodule(), volume, ct)))
    at = np.argwhere(sitk.GetArrayFromImage(image))[:, ::-1]
    found = np.array([image.TransformContinuousIndexToPhysicalPoint([float(v) for v in one]) for one in at])
    k, j, i = np.nonzero(inside_on_grid(nodule(), volume))
    expected = volume.to_lps(np.stack([i, j, k], axis=1))
    assert np.abs(found - expected).max() < 0.01


def test_dicom_object_of_a_ct_with_an_inserted_nodule_is_refused(ct, volume, tmp_path):
    # All pixels are those of the patient's images, as those of the compared slices are if the nodule is between them.
    marked = with_inserted(volume.source, ("solid nodule, 8.0 mm, at -41.0 12.0 -180.0",))
    trained = dataclasses.replace(volume, source=marked)
    out = tmp_path / "out"
    out.mkdir()
    for write in (write_target_seg, write_target_report):
        with pytest.raises(UsageError, match="a nodule was inserted") as caught:
            write(out / "t.dcm", nodule(), trained, ct)
        assert caught.value.code == "plan.other-ct"
    assert list(out.iterdir()) == []


def test_segmentation_for_another_ct_or_for_a_file_that_is_not_dicom_is_refused(ct, volume, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    write = functools.partial(write_target_seg, out / "t.dcm", nodule(), volume)
    # The files have the same geometry and other pixels, like a later scan or another reconstruction.
    newer = series(tmp_path / "newer", oblique, hu=chest(seed=6))
    with pytest.raises(UsageError, match="none of its series is the CT") as caught:
        write(newer)
    assert caught.value.code == "plan.other-ct"
    with pytest.raises(UsageError, match="none of its series is the CT"):
        write(series(tmp_path / "elsewhere", gap_mm=2.5))
    nifti = write_grid(tmp_path / "ct.nii.gz", volume.hu_zyx, volume.lps_from_ijk, what="the CT")
    with pytest.raises(UsageError, match=r"nifti file.*\.seg\.nrrd") as caught:
        write(nifti)
    assert caught.value.code == "plan.not-dicom"
    with pytest.raises(VolumeImportError, match="no such file"):
        write(tmp_path / "gone")
    assert not list(out.iterdir())


def test_segmentation_refers_to_the_series_of_the_plan_if_the_folder_has_two_series(ct, volume, tmp_path):
    folder = tmp_path / "both"
    series(folder, oblique, hu=chest(seed=6), name=lambda n: f"A{n}", number=2, uid="1.2.3.99")
    series(folder, oblique, name=lambda n: f"B{n}", number=3, uid="1.2.3.77")
    data = pydicom.dcmread(write_target_seg(tmp_path / "t.dcm", nodule(), volume, folder))
    assert data.ReferencedSeriesSequence[0].SeriesInstanceUID == "1.2.3.77"
    with pytest.raises(UsageError, match="that series is not"):
        write_target_seg(tmp_path / "u.dcm", nodule(), volume, folder, series="2")


def test_invalid_references_and_values_are_refused_with_a_message(ct, volume, tmp_path):
    def nameless(dataset, index):
        oblique(dataset, index)
        del dataset.FrameOfReferenceUID

    with pytest.raises(VolumeImportError, match="frame of reference"):
        write_target_seg(tmp_path / "t.dcm", nodule(), volume, series(tmp_path / "nameless", nameless))
    tiny = ellipsoid([0.4, 0.4, 0.4], nodule().centre_lps, step_mm=0.1)
    with pytest.raises(NoResultError, match=r"half of any voxel"):
        write_target_seg(tmp_path / "t.dcm", tiny, volume, ct)
    for name in ("", "a\\b", "x" * 65, "a\nb"):
        with pytest.raises(UsageError, match="name of a target"):
            write_target_seg(tmp_path / "t.dcm", {name: nodule()}, volume, ct)
    with pytest.raises(UsageError, match="identity"):
        write_target_seg(tmp_path / "t.dcm", nodule(), volume, ct, identity="all of it")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=r"\.dcm"):
        write_target_seg(tmp_path / "t.nii", nodule(), volume, ct)
    with pytest.raises(UsageError, match="no target"):
        write_target_seg(tmp_path / "t.dcm", {}, volume, ct)
    assert not [p for p in tmp_path.iterdir() if p.is_file()]
    with pytest.raises(DiskError):
        write_target_seg(tmp_path / "missing" / "t.dcm", nodule(), volume, ct)


def test_segmentation_for_slicer_has_the_position_of_the_nodule(tmp_path):
    # The nodule is in a box that exceeds it by a different number of voxels on each axis.
    rows = np.pad(nodule().inside_zyx, ((2, 0), (5, 0), (9, 0)))
    shifted = nodule().lps_from_ijk.copy()
    shifted[:3, 3] += shifted[:3, :3] @ [-9.0, -5.0, -2.0]
    wide = dataclasses.replace(nodule(), inside_zyx=rows, lps_from_ijk=shifted)
    path = write_target_nrrd(tmp_path / "Nodule.seg.nrrd", wide, name="Nodule, right")
    image = sitk.ReadImage(str(path))
    inside = sitk.GetArrayFromImage(image)
    found = [image.TransformContinuousIndexToPhysicalPoint([float(v) for v in at[::-1]]) for at in np.argwhere(inside)]
    expected = np.argwhere(nodule().inside_zyx)[:, ::-1] @ nodule().lps_from_ijk[:3, :3].T
    assert np.abs(np.array(found) - (expected + nodule().lps_from_ijk[:3, 3])).max() < 1e-6
    assert np.abs(np.mean(found, axis=0) - nodule().centre_lps).max() < 0.01
    fields = {key: image.GetMetaData(key) for key in image.GetMetaDataKeys()}
    assert fields["Segment0_Name"] == "Nodule, right"
    nx, ny, nz = image.GetSize()
    assert fields["Segment0_Extent"] == f"0 {nx - 1} 0 {ny - 1} 0 {nz - 1}"
    assert "SCT^27925004^Nodule" in fields["Segment0_Tags"]
    assert "Not a medical device" in fields["note"]
    # The written grid is cropped to the nodule.
    assert nx < nodule().inside_zyx.shape[2] + 1
    assert json.dumps(fields)


def test_segmentation_for_slicer_without_voxels_name_or_suffix_is_refused(tmp_path):
    empty = dataclasses.replace(nodule(), inside_zyx=np.zeros((3, 3, 3), bool))
    with pytest.raises(UsageError, match="no voxel"):
        write_target_nrrd(tmp_path / "a.seg.nrrd", empty)
    with pytest.raises(UsageError, match="one line"):
        write_target_nrrd(tmp_path / "a.seg.nrrd", nodule(), name="a\nSegment1_Name:=x")
    with pytest.raises(UsageError, match=r"\.seg\.nrrd"):
        write_target_nrrd(tmp_path / "a.nrrd", nodule())
    assert not list(tmp_path.iterdir())
