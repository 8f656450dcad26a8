"""Tests of DICOM segmentations of highdicom: every type, overlaps, omitted frames, grids unlike that of the CT."""

from __future__ import annotations

import copy
import functools

import highdicom as hd
import numpy as np
import pydicom
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sr.codedict import codes
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian, generate_uid

from carina import open_mask
from carina.errors import VolumeImportError
from carina.plan import target_from_file
from carina.volume import MaskGridError, MaskLabelError, Volume

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:highdicom", "ignore::UserWarning:pydicom")

SHAPE_ZYX, SPACING_MM = (12, 19, 22), (0.8, 0.7, 1.5)
"""Shape (z, y, x) of the CT, and its spacing in mm.

Rows times columns is not a multiple of eight, so frames begin inside bytes.
"""


@functools.cache
def scene():
    """Return an oblique CT, its slices as DICOM, a ball in it, and a large structure round the ball."""
    a = np.radians(8.0)
    matrix = np.eye(4)
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    matrix[:3, :3] = turn * SPACING_MM
    matrix[:3, 3] = (-14.0, 22.0, -91.0)
    volume = Volume(np.full(SHAPE_ZYX, -850, np.int16), matrix)
    k, j, i = np.indices(SHAPE_ZYX)
    off = np.linalg.norm((np.stack([i, j, k], -1) - (13.2, 8.1, 5.3)) * SPACING_MM, axis=-1)
    lung = np.zeros(SHAPE_ZYX, bool)
    lung[1:11, 2:17, 2:20] = True
    uids = [generate_uid() for _ in range(3)]
    slices = []
    for k in range(SHAPE_ZYX[0]):
        data = Dataset()
        data.file_meta = FileMetaDataset()
        data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        data.SOPClassUID, data.SOPInstanceUID = CTImageStorage, generate_uid()
        data.StudyInstanceUID, data.SeriesInstanceUID, data.FrameOfReferenceUID = uids
        data.Modality, data.PatientID, data.PatientName = "CT", "1", "A"
        data.PatientBirthDate = data.PatientSex = data.AccessionNumber = data.StudyID = ""
        data.StudyDate, data.StudyTime, data.ReferringPhysicianName = "20200101", "000000", ""
        data.ImageOrientationPatient = [float(v) for v in (*turn[:, 0], *turn[:, 1])]
        data.ImagePositionPatient = [float(v) for v in matrix[:3, 3] + k * matrix[:3, 2]]
        data.PixelSpacing, data.SliceThickness = [SPACING_MM[1], SPACING_MM[0]], SPACING_MM[2]
        data.Rows, data.Columns = SHAPE_ZYX[1:]
        slices.append(data)
    return volume, tuple(slices), off < 4.0, lung, off


def write(path, pixels, *, kind="BINARY", labels=("nodule",), change=None, slices=None, **options):
    described = [
        hd.seg.SegmentDescription(
            segment_number=n + 1,
            segment_label=label,
            segmented_property_category=codes.SCT.MorphologicallyAbnormalStructure,
            segmented_property_type=codes.SCT.Neoplasm,
            algorithm_type="MANUAL",
        )
        for n, label in enumerate(labels)
    ]
    found = hd.seg.Segmentation(
        source_images=list(scene()[1] if slices is None else slices),
        pixel_array=pixels,
        segmentation_type=kind,
        segment_descriptions=described,
        series_instance_uid=generate_uid(),
        series_number=9,
        sop_instance_uid=generate_uid(),
        instance_number=1,
        manufacturer="x",
        manufacturer_model_name="x",
        software_versions="1",
        device_serial_number="1",
        **options,
    )
    found.save_as(path)
    if change is not None:
        data = pydicom.dcmread(path)
        change(data)
        data.save_as(path)
    return path


def inside(path, **options):
    mask = open_mask(path, scene()[0], **options)
    return mask.inside_zyx.astype(bool), mask.notes


def test_segment_opens_although_other_segments_overlap_it(tmp_path):
    volume, _, ball, lung, _ = scene()
    path = write(tmp_path / "s.dcm", np.stack([lung, ball], -1), labels=("lung", "nodule"))
    assert np.array_equal(inside(path, label=1)[0], lung)
    assert np.array_equal(inside(path, label=2)[0], ball)
    for wanted in (2, "nodule", "NODULE"):
        target = target_from_file(path, volume, structure=wanted)
        assert target.nodule.volume_mm3 == pytest.approx(ball.sum() * np.prod(SPACING_MM))
    with pytest.raises(MaskLabelError) as error:
        open_mask(path, volume)
    sizes = {label.name: label.volume_ml for label in error.value.labels}
    assert sizes == pytest.approx(
        {"lung": lung.sum() * np.prod(SPACING_MM) / 1000, "nodule": ball.sum() * np.prod(SPACING_MM) / 1000}
    )


@pytest.mark.parametrize("omit", [True, False])
def test_segment_of_a_label_map_is_selected_by_number_or_name(tmp_path, omit):
    volume, _, ball, lung, _ = scene()
    numbers = lung.astype(np.uint8)
    numbers[ball] = 2
    path = write(tmp_path / "s.dcm", numbers, kind="LABELMAP", labels=("lung", "nodule"), omit_empty_frames=omit)
    assert pydicom.dcmread(path).SOPClassUID == "1.2.840.10008.5.1.4.1.1.66.7"
    assert np.array_equal(inside(path, label=2)[0], ball)
    assert np.array_equal(inside(path, label=1)[0], lung & ~ball)
    target = target_from_file(path, volume, structure="nodule")
    assert (target.name, target.source) == ("nodule", "seg")
    assert target.nodule.volume_mm3 == pytest.approx(ball.sum() * np.prod(SPACING_MM))
    with pytest.raises(MaskLabelError) as error:
        open_mask(path, volume)
    # The background that highdicom describes is not listed as a structure.
    assert [(label.number, label.name) for label in error.value.labels] == [(1, "lung"), (2, "nodule")]


def test_label_map_may_have_large_numbers_and_another_background(tmp_path):
    ball = scene()[2]

    def change(data):
        numbers = np.where(data.pixel_array == 1, 300, 7).astype(np.uint16)
        data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelPaddingValue = 16, 16, 15, 7
        data.PixelData = numbers.tobytes()
        data["PixelData"].VR = "OW"
        data.SegmentSequence[-1].SegmentNumber = 300

    path = write(tmp_path / "s.dcm", ball.astype(np.uint8), kind="LABELMAP", omit_empty_frames=False, change=change)
    assert np.array_equal(inside(path)[0], ball)


def test_segmentation_fractions_of_a_half_and_above_are_set_with_a_note(tmp_path):
    _, _, ball, _, off = scene()
    share = np.clip(0.5 + (4.0 - off) / 3.0, 0.0, 1.0).astype(np.float32)
    for kind, word in (("PROBABILITY", "probabilities"), ("OCCUPANCY", "occupancies")):
        path = write(tmp_path / "s.dcm", share, kind="FRACTIONAL", fractional_type=kind)
        found, notes = inside(path)
        # Fractions have 255 steps, so voxels within 0.4 % of a half may be set or not.
        assert not (found ^ ball)[np.abs(share - 0.5) > 0.004].any()
        assert notes[0] == f"the segmentation: it contains {word}; voxels of 50 % or more count as inside"
    path = write(tmp_path / "s.dcm", ball.astype(np.float32), kind="FRACTIONAL", fractional_type="OCCUPANCY")
    found, notes = inside(path)
    assert np.array_equal(found, ball)
    assert not any("50 %" in note for note in notes)
    path = write(tmp_path / "s.dcm", share * np.float32(0.4), kind="FRACTIONAL", fractional_type="PROBABILITY")
    with pytest.raises(VolumeImportError, match="no voxel of its fractional segments reaches 50 %"):
        open_mask(path, scene()[0])


def reverse(data):
    """Store the frames of the segmentation in reverse order."""
    size = data.Rows * data.Columns
    num = int(data.NumberOfFrames)
    bits = np.unpackbits(np.frombuffer(data.PixelData, np.uint8), bitorder="little")[: num * size].reshape(num, size)
    packed = np.packbits(bits[::-1].ravel(), bitorder="little").tobytes()
    data.PixelData = packed + b"\0" * (len(packed) % 2)
    data.PerFrameFunctionalGroupsSequence = pydicom.Sequence(list(data.PerFrameFunctionalGroupsSequence)[::-1])


def measures(data, **values):
    item = data.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0]
    for name in ("SpacingBetweenSlices", "SliceThickness"):
        if name in item:
            delattr(item, name)
        if values.get(name) is not None:
            setattr(item, name, values[name])


@pytest.mark.parametrize("kind", ["BINARY", "LABELMAP"])
@pytest.mark.parametrize(
    "change",
    [
        None,
        lambda data: measures(data, SliceThickness=1.5),
        lambda data: measures(data, SliceThickness=4.0),
        measures,
    ],
    ids=["as written", "thickness", "thick", "without distances"],
)
@pytest.mark.parametrize("planes", [slice(None), slice(5, 6), slice(3, 8, 2), slice(2, 9, 3)])
def test_segmentation_planes_without_a_frame_are_empty_and_the_ct_gives_their_distance(tmp_path, kind, change, planes):
    ball = np.zeros(SHAPE_ZYX, bool)
    ball[planes] = scene()[2][planes]
    pixels = ball if kind == "BINARY" else ball.astype(np.uint8)
    path = write(tmp_path / "s.dcm", pixels, kind=kind, change=change)
    assert np.array_equal(inside(path)[0], ball)


def test_segmentation_with_frames_in_reverse_order_gives_an_equal_mask(tmp_path):
    _, _, ball, lung, _ = scene()
    path = write(tmp_path / "s.dcm", np.stack([lung, ball], -1), labels=("lung", "nodule"), change=reverse)
    assert np.array_equal(inside(path, label=2)[0], ball)
    assert np.array_equal(inside(path, label=1)[0], lung)


def test_frame_positions_have_precedence_over_the_stated_distance_of_planes(tmp_path):
    ball = scene()[2]
    path = write(tmp_path / "s.dcm", ball, change=lambda data: measures(data, SpacingBetweenSlices=4.0))
    found, notes = inside(path)
    assert np.array_equal(found, ball)
    assert notes[0].startswith("the segmentation: its SpacingBetweenSlices (4 mm) contradicts the positions")


def repeat_a_frame(data, *, invert):
    size = data.Rows * data.Columns
    num = int(data.NumberOfFrames)
    bits = np.unpackbits(np.frombuffer(data.PixelData, np.uint8), bitorder="little")[: num * size].reshape(num, size)
    again = 1 - bits[:1] if invert else bits[:1]
    packed = np.packbits(np.concatenate([bits, again]).ravel(), bitorder="little").tobytes()
    data.PixelData = packed + b"\0" * (len(packed) % 2)
    data.PerFrameFunctionalGroupsSequence.append(data.PerFrameFunctionalGroupsSequence[0])
    data.NumberOfFrames = num + 1


def test_two_segmentation_frames_at_one_position_are_read_once_or_refused(tmp_path):
    ball = scene()[2]
    path = write(tmp_path / "s.dcm", ball, change=lambda data: repeat_a_frame(data, invert=False))
    found, notes = inside(path)
    assert np.array_equal(found, ball)
    assert notes[0] == "the segmentation: 1 of its frames were stored twice and were read once"
    path = write(tmp_path / "s.dcm", ball, change=lambda data: repeat_a_frame(data, invert=True))
    with pytest.raises(VolumeImportError, match="two frames of segment 1 have the same position and differ"):
        open_mask(path, scene()[0])


def test_selecting_an_empty_segment_is_refused_as_empty(tmp_path):
    _, _, ball, lung, _ = scene()
    path = write(tmp_path / "s.dcm", np.stack([lung, ball & False, ball], -1), labels=("lung", "node", "nodule"))
    with pytest.raises(MaskLabelError, match=r"2 \(node\) is empty"):
        open_mask(path, scene()[0], label=2)


def coarse_slices():
    """Return slices at every second position of the CT, with other pixel sizes."""
    found = []
    for data in scene()[1][::2]:
        other = copy.deepcopy(data)
        other.SOPInstanceUID = generate_uid()
        other.PixelSpacing = [1.4, 1.6]
        other.Rows, other.Columns = 10, 11
        found.append(other)
    return found


def test_segmentation_on_a_coarser_grid_is_refused_or_resampled_on_request(tmp_path):
    volume, _, ball, _, _ = scene()
    coarse = ball[::2, ::2, ::2]
    path = write(tmp_path / "s.dcm", coarse, slices=coarse_slices(), omit_empty_frames=False)
    with pytest.raises(MaskGridError, match=r"1\.6 x 1\.4 x 3 mm"):
        target_from_file(path, volume)
    nodule = target_from_file(path, volume, resample=True).nodule
    assert nodule.volume_mm3 == pytest.approx(ball.sum() * np.prod(SPACING_MM), rel=0.25)
    assert any("nearest voxel" in note for note in nodule.notes)


def test_segmentation_with_reversed_planes_is_placed_exactly(tmp_path):
    _, slices, ball, _, _ = scene()
    flipped = []
    for data in slices[::-1]:
        other = copy.deepcopy(data)
        # The rows are reversed, so the normal of the planes is reversed too.
        step = np.array([float(v) for v in data.ImageOrientationPatient[:3]])
        first = np.array([float(v) for v in data.ImagePositionPatient])
        other.ImagePositionPatient = [float(v) for v in first + step * SPACING_MM[0] * (SHAPE_ZYX[2] - 1)]
        other.ImageOrientationPatient = [*(-step).tolist(), *[float(v) for v in data.ImageOrientationPatient[3:]]]
        flipped.append(other)
    path = write(tmp_path / "s.dcm", ball[::-1, :, ::-1].copy(), slices=flipped)
    assert np.array_equal(inside(path)[0], ball)


def test_unknown_segmentation_type_and_fractions_without_their_maximum_are_refused(tmp_path):
    ball = scene()[2]

    def rename(data):
        data.SegmentationType = "SURFACE"

    def forget(data):
        del data.MaximumFractionalValue

    path = write(tmp_path / "s.dcm", ball, change=rename)
    with pytest.raises(VolumeImportError, match="SegmentationType is not BINARY, FRACTIONAL or LABELMAP"):
        open_mask(path, scene()[0])
    path = write(tmp_path / "s.dcm", ball.astype(np.float32), kind="FRACTIONAL", change=forget)
    with pytest.raises(VolumeImportError, match="which number means all"):
        open_mask(path, scene()[0])
