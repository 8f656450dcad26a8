"""Tests of masks from files, which are placed in the scan by their geometry."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pydicom
import pytest
import SimpleITK as sitk
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRLittleEndian, generate_uid

from carina.errors import VolumeImportError
from carina.volume import MaskLabelError, Volume, mask_files, open_mask

SHAPE = (6, 8, 10)


def oblique() -> np.ndarray:
    matrix = np.eye(4)
    c, s = np.cos(0.3), np.sin(0.3)
    matrix[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) * (0.7, 0.8, 1.5)
    matrix[:3, 3] = (-30.0, 12.0, 44.0)
    return matrix


@pytest.fixture
def volume() -> Volume:
    return Volume(np.zeros(SHAPE, dtype=np.int16), oblique())


@pytest.fixture
def inside() -> np.ndarray:
    mask = np.zeros(SHAPE, dtype=np.uint8)
    mask[1:4, 2:7, 3:5] = 1
    mask[4, 6, 8] = 1
    return mask


def write(path, array_zyx, lps_from_ijk):
    image = sitk.GetImageFromArray(array_zyx)
    spacing = np.linalg.norm(lps_from_ijk[:3, :3], axis=0)
    image.SetSpacing(spacing.tolist())
    image.SetDirection((lps_from_ijk[:3, :3] / spacing).ravel().tolist())
    image.SetOrigin(lps_from_ijk[:3, 3].tolist())
    sitk.WriteImage(image, str(path))
    return path


@pytest.mark.parametrize("name", ["m.nii.gz", "m.nrrd", "m.mha"])
def test_mask_on_the_grid_of_the_scan_is_unchanged(volume, inside, tmp_path, name):
    mask = open_mask(write(tmp_path / name, inside, oblique()), volume)
    assert np.array_equal(mask.inside_zyx, inside)
    assert mask.notes == ()


def test_mask_with_flipped_and_permuted_axes_is_placed_by_geometry(volume, inside, tmp_path):
    matrix = oblique()
    # The array is [x, z, y] with y reversed, and the transform states this order.
    turned = np.ascontiguousarray(inside.transpose(2, 0, 1)[:, :, ::-1])
    other = np.eye(4)
    other[:3, 0], other[:3, 1], other[:3, 2] = -matrix[:3, 1], matrix[:3, 2], matrix[:3, 0]
    other[:3, 3] = matrix[:3, 3] + matrix[:3, 1] * (SHAPE[1] - 1)
    mask = open_mask(write(tmp_path / "m.nrrd", turned, other), volume)
    assert np.array_equal(mask.inside_zyx, inside)


def test_mask_of_a_part_of_the_scan_is_placed_in_the_scan(volume, inside, tmp_path):
    part = oblique()
    part[:3, 3] = volume.to_lps(np.array([2.0, 1.0, 1.0]))
    mask = open_mask(write(tmp_path / "m.mha", inside[1:5, 1:8, 2:9], part), volume)
    assert np.array_equal(mask.inside_zyx, inside)
    assert "only part of the scan" in mask.notes[0]


def test_mask_that_exceeds_the_scan_is_refused(volume, tmp_path):
    shifted = oblique()
    shifted[:3, 3] = volume.to_lps(np.array([3.0, 0.0, 0.0]))
    path = write(tmp_path / "m.mha", np.ones(SHAPE, np.uint8), shifted)
    with pytest.raises(VolumeImportError, match="outside the scan") as caught:
        open_mask(path, volume)
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("change", ["spacing", "origin", "turn"])
def test_mask_on_another_grid_is_refused_with_both_grids_or_resampled_on_request(volume, inside, tmp_path, change):
    other = oblique()
    if change == "spacing":
        other[:3, 0] *= 1.5
    elif change == "origin":
        other[:3, 3] += other[:3, 0] * 0.4
    else:
        other[:3, :3] = oblique()[:3, :3] @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        other[:3, 0] *= 1.02
    path = write(tmp_path / "m.nii.gz", inside, other)
    with pytest.raises(
        VolumeImportError, match=r"grid differs.*expected 10 x 8 x 6 voxels of 0\.7 x 0\.8 x 1\.5 mm"
    ) as caught:
        open_mask(path, volume)
    assert caught.value.code == "import.mask-grid"
    if change == "turn":
        with pytest.raises(VolumeImportError, match="none of it"):
            open_mask(path, volume, resample=True)
        return
    mask = open_mask(path, volume, resample=True)
    # Each voxel of the scan has the value of the mask's nearest voxel.
    from_volume = np.linalg.inv(other) @ oblique()
    for k, j, i in np.ndindex(SHAPE):
        x, y, z = np.floor((from_volume @ (i, j, k, 1.0))[:3] + 0.5).astype(int)
        there = 0 <= x < SHAPE[2] and 0 <= y < SHAPE[1] and 0 <= z < SHAPE[0]
        assert mask.inside_zyx[k, j, i] == (inside[z, y, x] if there else 0)
    assert "nearest" in mask.notes[0]


def test_mask_with_several_labels_needs_the_selection_of_one(volume, inside, tmp_path):
    labels = inside.copy()
    labels[4, 6, 8] = 7
    path = write(tmp_path / "m.nrrd", labels, oblique())
    with pytest.raises(VolumeImportError, match="labels 1, 7; choose the airway label"):
        open_mask(path, volume)
    with pytest.raises(VolumeImportError, match="3 is not among them"):
        open_mask(path, volume, label=3)
    assert int(open_mask(path, volume, label=7).inside_zyx.sum()) == 1


@pytest.mark.parametrize(
    ("values", "text"),
    [
        (np.zeros(SHAPE, np.uint8), "it is empty"),
        (np.linspace(0.0, 1.0, 480, dtype=np.float32).reshape(SHAPE), "probability map"),
        (np.arange(480 * 4, dtype=np.int16).reshape(24, 8, 10), "different values"),
        # In 32 bits these two structures would have one number, and a browser cannot represent their numbers.
        (np.arange(480, dtype=np.float64).reshape(SHAPE) % 3 * 2.0**40, "not labels"),
        (np.arange(480, dtype=np.uint32).reshape(SHAPE) % 3 * np.uint32(2**30), "not labels"),
    ],
)
def test_mask_files_with_other_values_than_labels_are_refused(tmp_path, values, text):
    volume = Volume(np.zeros(values.shape, dtype=np.int16), oblique())
    with pytest.raises(VolumeImportError, match=text):
        open_mask(write(tmp_path / "m.nrrd", values, oblique()), volume)


def test_share_of_the_mask_inside_the_scan_is_reported_with_little_memory(volume):
    inside = np.random.default_rng(2).random((40, 90, 80)) < 0.4
    inside[30:] = True
    place = oblique()
    # The mask covers one corner of the volume; most of the mask is outside.
    place[:3, 3] -= place[:3, :3] @ (40.0, 45.0, 20.0)
    ijk = volume.to_ijk(np.argwhere(inside)[:, ::-1] @ place[:3, :3].T + place[:3, 3])
    truth = ((ijk >= -0.5) & (ijk < np.array(volume.shape_zyx[::-1]) - 0.5)).all(axis=1).mean()
    tracemalloc.start()
    share = mask_files._share_inside(inside, place, volume)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert 0.0 < truth < 0.01
    assert abs(share - truth) < 0.002
    assert peak_bytes < 2_500_000
    few = np.zeros(SHAPE, bool)
    few[0, 0, 0] = few[-1, -1, -1] = True
    assert mask_files._share_inside(few, oblique(), volume) == 1.0


def test_missing_mask_file_and_folder_are_refused(volume, tmp_path):
    with pytest.raises(VolumeImportError, match="no such file"):
        open_mask(tmp_path / "nothing.nrrd", volume)
    with pytest.raises(VolumeImportError, match="expected one NIfTI"):
        open_mask(tmp_path, volume)


# DICOM SEG


def segmentation(path, labels_zyx, lps_from_ijk, *, shuffled=True, change=None):
    """Write a SEG as other tools do: one frame for each segment and non-empty plane, in any order."""
    spacing = np.linalg.norm(lps_from_ijk[:3, :3], axis=0)
    direction = lps_from_ijk[:3, :3] / spacing
    frames, groups = [], Sequence()
    numbers = [int(v) for v in np.unique(labels_zyx) if v]
    for number in numbers:
        for k, plane in enumerate(labels_zyx):
            if not (plane == number).any():
                continue
            frames.append(plane == number)
            group, position, segment = Dataset(), Dataset(), Dataset()
            position.ImagePositionPatient = [f"{v:.6f}" for v in lps_from_ijk[:3, 3] + k * lps_from_ijk[:3, 2]]
            segment.ReferencedSegmentNumber = number
            group.PlanePositionSequence = Sequence([position])
            group.SegmentIdentificationSequence = Sequence([segment])
            groups.append(group)
    if shuffled:
        order = np.random.default_rng(1).permutation(len(frames))
        frames, groups = [frames[n] for n in order], Sequence([groups[n] for n in order])
    measures, orientation, shared = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing = [spacing[1], spacing[0]]
    measures.SpacingBetweenSlices = spacing[2]
    measures.SliceThickness = 2.0 * spacing[2]
    orientation.ImageOrientationPatient = [f"{v:.8f}" for v in [*direction[:, 0], *direction[:, 1]]]
    shared.PixelMeasuresSequence = Sequence([measures])
    shared.PlaneOrientationSequence = Sequence([orientation])
    data = Dataset()
    data.file_meta = FileMetaDataset()
    data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = "1.2.840.10008.5.1.4.1.1.66.4"
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = generate_uid()
    data.Modality = "SEG"
    data.SegmentationType = "BINARY"
    data.Rows, data.Columns, data.NumberOfFrames = labels_zyx.shape[1], labels_zyx.shape[2], len(frames)
    data.BitsAllocated = data.BitsStored = data.SamplesPerPixel = 1
    data.HighBit = data.PixelRepresentation = 0
    data.PhotometricInterpretation = "MONOCHROME2"
    data.SegmentSequence = Sequence()
    for number in numbers:
        item = Dataset()
        item.SegmentNumber, item.SegmentLabel = number, f"structure {number}"
        data.SegmentSequence.append(item)
    data.SharedFunctionalGroupsSequence = Sequence([shared])
    data.PerFrameFunctionalGroupsSequence = groups
    data.PixelData = np.packbits(np.stack(frames).ravel(), bitorder="little").tobytes()
    if len(data.PixelData) % 2:
        data.PixelData += b"\0"
    if change is not None:
        change(data)
    pydicom.dcmwrite(path, data, enforce_file_format=True)
    return path


def test_dicom_segmentation_is_placed_frame_by_frame(volume, inside, tmp_path):
    path = segmentation(tmp_path / "seg.dcm", inside, oblique())
    assert np.array_equal(open_mask(path, volume).inside_zyx, inside)


def test_names_of_segments_are_listed_for_the_selection(volume, inside, tmp_path):
    labels = inside.copy()
    labels[4, 6, 8] = 2
    path = segmentation(tmp_path / "seg.dcm", labels, oblique())
    with pytest.raises(VolumeImportError, match=r"labels 1 \(structure 1\), 2 \(structure 2\)"):
        open_mask(path, volume)
    assert np.array_equal(open_mask(path, volume, label=1).inside_zyx, labels == 1)


@pytest.mark.filterwarnings("ignore:The value length")
def test_segment_names_are_converted_to_printable_text(volume, inside, tmp_path):
    labels = inside.copy()
    labels[4, 6, 8] = 2

    def rename(data):
        data.SegmentSequence[0].SegmentLabel = "air\x01way" + 5000 * "y"

    path = segmentation(tmp_path / "seg.dcm", labels, oblique(), change=rename)
    with pytest.raises(MaskLabelError) as refusal:
        open_mask(path, volume)
    assert [label.name for label in refusal.value.labels] == [("air way" + 5000 * "y")[:64], "structure 2"]


def _tilt(data):
    position = data.PerFrameFunctionalGroupsSequence[1].PlanePositionSequence[0]
    position.ImagePositionPatient = [v + 0.6 for v in position.ImagePositionPatient]


def _unplaced(data):
    del data.PerFrameFunctionalGroupsSequence[0].PlanePositionSequence


def _fractional(data):
    data.SegmentationType = "FRACTIONAL"


def _an_image(data):
    data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.2"


def _short(data):
    data.PixelData = data.PixelData[:4]


def _wide(data):
    data.SharedFunctionalGroupsSequence[0].PixelMeasuresSequence[0].PixelSpacing = ["1e200", "1e200"]


def _segment_of_none(data):
    data.PerFrameFunctionalGroupsSequence[0].SegmentIdentificationSequence[0].ReferencedSegmentNumber = 300


def _many(data):
    data.NumberOfFrames = 2**31 - 1


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (_tilt, "one regular grid"),
        (_unplaced, "lacks its position"),
        (_fractional, "fractional"),
        (_an_image, "not a segmentation"),
        (_short, "pixels cannot be read"),
        (_many, "it claims"),
        (_wide, "spacing is implausible"),
        (_segment_of_none, "refer to segments"),
    ],
)
def test_dicom_segmentation_with_a_defect_is_refused_with_the_reason(volume, inside, tmp_path, change, text):
    path = segmentation(tmp_path / "seg.dcm", inside, oblique(), shuffled=False, change=change)
    with pytest.raises(VolumeImportError, match=text):
        open_mask(path, volume)
