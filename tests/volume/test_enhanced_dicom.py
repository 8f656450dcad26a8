"""Tests of enhanced (multi-frame) CT and MR files: voxels and geometry equal those of the same single-frame series."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from dicom_writer import chest, packed, series
from enhanced_writer import chest_frames, enhanced, item
from pydicom import dcmread
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.encaps import encapsulate, generate_frames
from pydicom.sequence import Sequence as Items
from pydicom.uid import (
    DeflatedExplicitVRLittleEndian,
    EnhancedMRImageStorage,
    ImplicitVRLittleEndian,
    SegmentationStorage,
    generate_uid,
)

from carina.errors import VolumeImportError
from carina.volume import Volume, inspect_path, open_volume


def refusal(path: Path, **options) -> VolumeImportError:
    with pytest.raises(VolumeImportError) as caught:
        open_volume(path, **options)
    return caught.value


def codes(volume: Volume) -> list[str]:
    return [note.code for note in volume.source.notes]


@pytest.fixture
def classic(tmp_path) -> Volume:
    """Return the volume of the single-frame series with the same content."""
    return open_volume(series(tmp_path / "classic"))


def assert_same(volume: Volume, classic: Volume) -> None:
    np.testing.assert_array_equal(volume.hu_zyx, classic.hu_zyx)
    np.testing.assert_array_equal(volume.lps_from_ijk, classic.lps_from_ijk)
    assert volume.is_hu


@pytest.mark.parametrize("order", ["ascending", "descending", "shuffled"])
def test_enhanced_file_has_the_voxels_of_the_single_frame_series_in_any_frame_order(tmp_path, classic, order):
    frames = chest_frames()
    if order == "descending":
        frames.reverse()
    elif order == "shuffled":
        random.Random(1).shuffle(frames)
    volume = open_volume(enhanced(tmp_path / "scan" / "IM1", frames))
    assert_same(volume, classic)
    assert codes(volume) == []
    assert volume.source.slice_thickness_mm == 3.0


@pytest.mark.parametrize("syntax", [ImplicitVRLittleEndian, DeflatedExplicitVRLittleEndian])
def test_enhanced_file_in_every_uncompressed_transfer_syntax_has_equal_voxels(tmp_path, classic, syntax):
    assert_same(open_volume(enhanced(tmp_path / "scan" / "IM1", chest_frames(), syntax=syntax)), classic)


def test_rescale_of_each_frame_is_applied(tmp_path, classic):
    frames = chest_frames(slope=lambda index: (0.5, 1.0, 0.25)[index % 3], intercept=lambda index: -1200.0 + 7 * index)
    random.Random(2).shuffle(frames)
    assert_same(open_volume(enhanced(tmp_path / "scan" / "IM1", frames)), classic)


def test_rescale_in_the_shared_functional_groups_is_applied(tmp_path, classic):
    frames = chest_frames()
    for frame in frames:
        frame.groups = {}

    def share(dataset: Dataset) -> None:
        rescale = item(RescaleSlope=1, RescaleIntercept=-1024, RescaleType="HU")
        dataset.SharedFunctionalGroupsSequence[0].PixelValueTransformationSequence = Items([rescale])

    assert_same(open_volume(enhanced(tmp_path / "scan" / "IM1", frames, edit=share)), classic)


def test_real_world_value_map_in_hu_is_the_rescale_of_a_file_without_one(tmp_path, classic):
    frames = chest_frames()
    unit = item(CodeValue="[hnsf'U]", CodingSchemeDesignator="UCUM", CodeMeaning="Hounsfield unit")
    for frame in frames:
        frame.groups = {
            "RealWorldValueMappingSequence": {
                "RealWorldValueSlope": 1.0,
                "RealWorldValueIntercept": -1024.0,
                "MeasurementUnitsCodeSequence": Items([unit]),
            }
        }
    assert_same(open_volume(enhanced(tmp_path / "scan" / "IM1", frames)), classic)


@pytest.mark.parametrize("kind", ["JPEG2000", "JPEG"])
@pytest.mark.parametrize("layout", ["table", "no table", "two fragments", "two fragments without table"])
def test_compressed_frames_are_found_in_every_layout_of_fragments(tmp_path, classic, kind, layout):
    frames = chest_frames()
    streams, syntax = [], ""
    for frame in frames:
        dataset = Dataset()
        dataset.file_meta = FileMetaDataset()
        dataset.Rows, dataset.Columns, dataset.PixelRepresentation = *frame.stored.shape, 0
        dataset.PixelData = frame.stored.tobytes()
        packed(dataset, tmp_path, kind)
        syntax = dataset.file_meta.TransferSyntaxUID
        streams.append(next(generate_frames(dataset.PixelData, number_of_frames=1)))

    def lay_out(dataset: Dataset) -> None:
        dataset.PixelData = encapsulate(
            streams,
            fragments_per_frame=2 if "two" in layout else 1,
            has_bot="without" not in layout and "no" not in layout,
        )

    volume = open_volume(enhanced(tmp_path / "scan" / "IM1", frames, syntax=syntax, streams=streams, edit=lay_out))
    assert_same(volume, classic)


def test_frames_of_several_files_form_one_volume(tmp_path, classic):
    frames = chest_frames()
    random.Random(3).shuffle(frames)
    for number, begin in enumerate(range(0, 20, 5)):
        enhanced(tmp_path / "scan" / f"part{number}", frames[begin : begin + 5])
    volume = open_volume(tmp_path / "scan")
    assert_same(volume, classic)
    assert volume.source.series is not None
    assert volume.source.series.num_slices == 20
    assert_same(open_volume(tmp_path / "scan" / "part2"), classic)


def test_files_at_the_same_positions_are_separate_series(tmp_path, classic):
    second = chest(seed=6)
    enhanced(tmp_path / "scan" / "a", chest_frames())
    enhanced(tmp_path / "scan" / "b", chest_frames(second))
    volume = open_volume(tmp_path / "scan", series="3")
    assert_same(volume, classic)
    assert codes(volume) == ["import.series-parted"]
    np.testing.assert_array_equal(open_volume(tmp_path / "scan", series="3-2").hu_zyx, second)
    assert [info.description for info in inspect_path(tmp_path / "scan").series] == ["Thorax, file 1", "Thorax, file 2"]


@pytest.mark.parametrize(
    ("content", "groups", "label"),
    [
        ({"TemporalPositionIndex": 2}, {}, "temporal index 2"),
        ({"StackID": "2"}, {}, "stack 2"),
        ({}, {"CardiacSynchronizationSequence": {"NominalPercentageOfCardiacPhase": 70.0}}, "cardiac phase 70"),
        (
            {},
            {"RespiratorySynchronizationSequence": {"NominalPercentageOfRespiratoryPhase": 50.0}},
            "respiratory phase 50",
        ),
        ({}, {"CTReconstructionSequence": {"ConvolutionKernel": "B70f"}}, "reconstruction kernel b70f"),
    ],
)
def test_each_phase_stack_and_kernel_of_one_file_is_a_separate_series(tmp_path, classic, content, groups, label):
    second = chest(seed=6)
    one = {"TemporalPositionIndex": 1} if "TemporalPositionIndex" in content else {"StackID": "1"}
    first_groups = {key: dict.fromkeys(tags, 0.0) for key, tags in groups.items() if "Sync" in key}
    frames = chest_frames(content=one, groups=first_groups)
    frames += chest_frames(second, content={**one, **content}, groups=groups)
    random.Random(4).shuffle(frames)
    path = enhanced(tmp_path / "scan" / "IM1", frames)
    found = {info.description: info.key for info in inspect_path(path).series}
    assert len(found) == 2
    assert f"Thorax, {label}" in found
    np.testing.assert_array_equal(open_volume(path, series=found.pop(f"Thorax, {label}")).hu_zyx, second)
    assert_same(open_volume(path, series=next(iter(found.values()))), classic)


def test_two_stacks_of_one_file_with_a_space_between_them_are_separate_series(tmp_path):
    frames = chest_frames(chest()[:12], content={"StackID": "1"})
    frames += chest_frames(chest()[12:], content={"StackID": "2"}, first_mm=100.0)
    path = enhanced(tmp_path / "scan" / "IM1", frames)
    np.testing.assert_array_equal(open_volume(path).hu_zyx, chest()[:12])
    assert [info.num_slices for info in inspect_path(path).series] == [12, 8]


def test_two_stacks_that_continue_each_other_are_one_volume_with_a_note(tmp_path, classic):
    frames = chest_frames()
    for index, frame in enumerate(frames):
        frame.content["StackID"] = "1" if index < 9 else "2"
    volume = open_volume(enhanced(tmp_path / "scan" / "IM1", frames))
    assert_same(volume, classic)
    assert codes(volume) == ["import.settings-change"]


def test_frame_at_the_position_of_another_frame_is_refused(tmp_path):
    frames = chest_frames()
    frames[7].z_mm = frames[6].z_mm
    error = refusal(enhanced(tmp_path / "scan" / "IM1", frames))
    assert error.code == "import.geometry.duplicate"
    assert "IM1 (frame 7) and IM1 (frame 8)" in str(error)


def test_frame_with_another_orientation_is_refused(tmp_path):
    frames = chest_frames()
    frames[4].groups["PlaneOrientationSequence"] = {"ImageOrientationPatient": [0, 1, 0, 0, 0, -1]}
    error = refusal(enhanced(tmp_path / "scan" / "IM1", frames))
    assert error.code == "import.geometry.mixed"
    assert "IM1 (frame 5)" in str(error)


def test_frame_without_a_position_is_refused_by_its_number(tmp_path):
    def lose(dataset: Dataset) -> None:
        del dataset.PerFrameFunctionalGroupsSequence[3].PlanePositionSequence

    error = refusal(enhanced(tmp_path / "scan" / "IM1", chest_frames(), edit=lose))
    assert error.code == "import.tags"
    assert "IM1 (frame 4)" in str(error)


def test_number_of_frames_that_contradicts_the_description_is_refused(tmp_path):
    error = refusal(
        enhanced(tmp_path / "scan" / "IM1", chest_frames(), edit=lambda d: setattr(d, "NumberOfFrames", 21))
    )
    assert error.code == "import.header"
    assert "21 frames and describes 20" in str(error)


@pytest.mark.parametrize("change", [-2048, 2048])
def test_pixels_of_more_or_fewer_frames_than_stated_are_refused(tmp_path, change):
    def resize(dataset: Dataset) -> None:
        dataset.PixelData = dataset.PixelData[:change] if change < 0 else dataset.PixelData + bytes(change)

    error = refusal(enhanced(tmp_path / "scan" / "IM1", chest_frames(), edit=resize))
    assert error.code == ("import.truncated" if change < 0 else "import.header")


def test_copy_of_an_enhanced_file_is_used_once(tmp_path, classic):
    path = enhanced(tmp_path / "scan" / "IM1", chest_frames())
    shutil.copy(path, path.with_name("IM1 copy"))
    volume = open_volume(tmp_path / "scan")
    assert_same(volume, classic)
    assert codes(volume) == ["import.copies"]


def test_enhanced_mr_opens_without_hu(tmp_path, classic):
    path = enhanced(
        tmp_path / "scan" / "IM1",
        chest_frames(),
        kind=EnhancedMRImageStorage,
        edit=lambda dataset: setattr(dataset, "Modality", "MR"),
    )
    volume = open_volume(path)
    np.testing.assert_array_equal(volume.hu_zyx, classic.hu_zyx)
    assert not volume.is_hu


def test_segmentation_beside_a_scan_is_not_opened_as_scan(tmp_path, classic):
    folder = series(tmp_path / "scan")
    enhanced(folder / "seg", chest_frames(), kind=SegmentationStorage, series_uid=generate_uid(), number=9)
    assert_same(open_volume(folder), classic)
    assert refusal(folder, series="9").code == "import.multi-frame"


def test_legacy_converted_enhanced_file_of_another_library_has_equal_voxels(tmp_path):
    from highdicom.legacy import LegacyConvertedEnhancedCTImage

    def complete(dataset: Dataset, index: int) -> None:
        for keyword in ("PatientSex", "StudyID", "AccessionNumber", "StudyDate", "StudyTime", "Manufacturer"):
            setattr(dataset, keyword, "")
        dataset.InstanceNumber = index + 1
        dataset.SliceThickness = 3.0
        dataset.RescaleType = "HU"

    folder = series(tmp_path / "classic", complete)
    expected = open_volume(folder)
    slices = [dcmread(path) for path in sorted(folder.iterdir())]
    random.Random(5).shuffle(slices)
    converted = LegacyConvertedEnhancedCTImage(slices, generate_uid(), 7, generate_uid(), 1)
    (tmp_path / "scan").mkdir()
    converted.save_as(tmp_path / "scan" / "IM1")
    assert_same(open_volume(tmp_path / "scan"), expected)


def test_file_cut_anywhere_opens_equal_or_is_refused(tmp_path):
    whole = enhanced(tmp_path / "scan" / "IM1", chest_frames()).read_bytes()
    for length in range(132, len(whole), len(whole) // 40):
        (tmp_path / "scan" / "IM1").write_bytes(whole[:length])
        assert refusal(tmp_path / "scan").code.startswith("import.")
