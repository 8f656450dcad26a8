"""Tests of the import of DICOM folders: geometry from the tags of every slice, refusals with code and file name."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from pydicom.datadict import dictionary_VR
from pydicom.dataelem import DataElement
from pydicom.dataset import Dataset
from pydicom.encaps import encapsulate
from pydicom.uid import (
    MPEG2MPML,
    DeflatedExplicitVRLittleEndian,
    ExplicitVRBigEndian,
    ImplicitVRLittleEndian,
    JPEGLSLossless,
)

from carina.errors import VolumeImportError
from carina.volume import open_volume

GAP_MM = 1.25
SLICES = 9


def move(dataset: Dataset, offset_lps: np.ndarray) -> None:
    position = np.array([float(v) for v in dataset.ImagePositionPatient]) + offset_lps
    dataset.ImagePositionPatient = [float(f"{v:.9f}") for v in position]


def frame(dataset: Dataset) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the directions of the image's rows, columns and normal as unit vectors in LPS."""
    row, column = np.array(dataset.ImageOrientationPatient, dtype=np.float64).reshape(2, 3)
    return row, column, np.cross(row, column)


def refusal(path: Path) -> VolumeImportError:
    with pytest.raises(VolumeImportError) as caught:
        open_volume(path)
    assert caught.value.exit_code == 3
    return caught.value


def test_oblique_anisotropic_series_has_the_positions_of_its_dicom_tags(
    write_series, expected_lps_from_ijk, expected_hu_zyx
):
    volume = open_volume(write_series())
    # Tags have nine decimals; 1e-8 mm is their rounding error over the whole grid.
    np.testing.assert_allclose(volume.lps_from_ijk, expected_lps_from_ijk, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(volume.hu_zyx, expected_hu_zyx)
    assert volume.is_hu
    assert volume.spacing_mm == pytest.approx((0.7, 0.9, 1.25))


@pytest.mark.parametrize("order", ["reversed", "shuffled"])
def test_slices_are_ordered_by_position_with_any_file_names(
    write_series, expected_lps_from_ijk, expected_hu_zyx, order
):
    names = {"reversed": lambda i: f"IM{100 - i}", "shuffled": lambda i: f"{(i * 5 + 3) % SLICES}.dcm"}[order]
    volume = open_volume(write_series(name=names))
    np.testing.assert_allclose(volume.lps_from_ijk, expected_lps_from_ijk, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(volume.hu_zyx, expected_hu_zyx)


def test_path_of_one_slice_opens_its_series(write_series, expected_hu_zyx):
    folder = write_series(name=lambda i: f"{i}.dcm")
    write_series("scan", number=4, name=lambda i: f"other{i}.dcm", num_slices=12)
    np.testing.assert_array_equal(open_volume(folder / "4.dcm").hu_zyx, expected_hu_zyx)


@pytest.mark.parametrize("syntax", [ImplicitVRLittleEndian, DeflatedExplicitVRLittleEndian])
def test_every_uncompressed_transfer_syntax_gives_equal_voxels(write_series, expected_hu_zyx, syntax):
    np.testing.assert_array_equal(open_volume(write_series(syntax=syntax)).hu_zyx, expected_hu_zyx)


def test_big_endian_series_has_the_values_of_its_pixels(write_series, expected_hu_zyx):
    def swap(dataset, index):
        dataset.PixelData = np.frombuffer(dataset.PixelData, "<i2").astype(">i2").tobytes()

    folder = write_series(syntax=ExplicitVRBigEndian, edit=swap)
    np.testing.assert_array_equal(open_volume(folder).hu_zyx, expected_hu_zyx)


def test_slope_and_intercept_of_each_slice_are_applied(write_series, expected_hu_zyx):
    slopes = [1.0, -1.0, 0.5, 2.5, 1.0, 1.0, 0.25, 1.0, -0.5]
    stored_zyx = [
        np.rint((hu - (-1000 + index)) / slopes[index]).astype(np.int16) for index, hu in enumerate(expected_hu_zyx)
    ]

    def rescale(dataset, index):
        dataset.RescaleSlope, dataset.RescaleIntercept = slopes[index], -1000 + index
        dataset.PixelData = stored_zyx[index].tobytes()

    volume = open_volume(write_series(edit=rescale))
    for index, slope in enumerate(slopes):
        expected = np.rint(stored_zyx[index] * slope - 1000 + index)
        np.testing.assert_array_equal(volume.hu_zyx[index], expected)
    assert volume.is_hu


def test_pixel_bits_above_bits_stored_are_ignored(write_series):
    def twelve_bits(dataset, index):
        dataset.BitsStored, dataset.HighBit = 12, 11
        values = np.full((dataset.Rows, dataset.Columns), 0xF801 if index % 2 else 0x57FF, dtype=np.uint16)
        dataset.PixelData = values.tobytes()

    volume = open_volume(write_series(edit=twelve_bits))
    # In 12 bits 0x57FF is 0x7FF = 2047 and 0xF801 is 0x801 = -2047; 1024 is subtracted from both.
    assert set(np.unique(volume.hu_zyx[0])) == {2047 - 1024}
    assert set(np.unique(volume.hu_zyx[1])) == {-2047 - 1024}


def test_pixel_values_outside_int16_are_clipped_with_a_note(write_series):
    volume = open_volume(write_series(edit=lambda d, i: setattr(d, "RescaleSlope", 100)))
    assert int(volume.hu_zyx.max()) == 32767
    assert any("outside -32768 to 32767" in warning for warning in volume.source.warnings)


def test_missing_slice_is_reported_with_its_gap(write_series):
    # One of nine slices is more than the share that is interpolated (test_corrected_stacks.py).
    folder = write_series()
    (folder / "IM004").unlink()
    error = refusal(folder)
    assert error.code == "import.geometry.irregular"
    for text in ("expected 1.25 mm", "found 2.50 mm", "after slice 4 of 8", "IM003", "a slice may be missing", "10 %"):
        assert text in str(error)


@pytest.mark.parametrize("moved", [lambda i: 0.5 if i >= 6 else 0.0, lambda i: 0.02 * i * i], ids=["step", "growing"])
def test_series_with_uneven_gaps_is_resampled_with_a_badge(write_series, moved):
    volume = open_volume(write_series(edit=lambda d, i: move(d, frame(d)[2] * moved(i))))
    assert [note.code for note in volume.source.notes if note.badge] == ["import.slices-resampled"]


@pytest.mark.parametrize(("off_mm", "good"), [(0.11, True), (0.14, False)])
def test_slice_up_to_a_tenth_of_the_gap_from_its_regular_position_is_not_moved(write_series, off_mm, good):
    # The tolerance is a tenth of the gap: 0.125 mm.
    volume = open_volume(write_series(edit=lambda d, i: move(d, frame(d)[2] * (off_mm if i == 4 else 0.0))))
    assert volume.spacing_mm[2] == pytest.approx(GAP_MM)
    assert ("import.slices-resampled" in [note.code for note in volume.source.notes]) is not good


def test_slice_positions_rounded_to_a_tenth_of_a_millimetre_are_accepted(write_series):
    def round_positions(dataset, index):
        move(dataset, frame(dataset)[2] * (round(0.625 * index, 1) - GAP_MM * index))

    assert open_volume(write_series(edit=round_positions)).shape_zyx[0] == SLICES


def test_two_different_slices_at_one_position_are_refused(write_series):
    folder = write_series()
    twin = bytearray((folder / "IM002").read_bytes())
    twin[-1] ^= 1
    (folder / "IM002 copy").write_bytes(twin)
    error = refusal(folder)
    assert error.code == "import.geometry.duplicate"
    assert "IM002 and IM002 copy" in str(error)


def test_repeated_slice_is_used_once_and_the_path_of_its_copy_opens_the_series(write_series, expected_hu_zyx):
    folder = write_series()
    shutil.copy(folder / "IM002", folder / "IM002 copy")
    for path in (folder, folder / "IM002 copy"):
        volume = open_volume(path)
        np.testing.assert_array_equal(volume.hu_zyx, expected_hu_zyx)
        assert [note.code for note in volume.source.notes] == ["import.copies"]


@pytest.mark.parametrize(("tilt_deg", "kept"), [(0.0, True), (0.15, True), (0.6, False), (16.5, False)])
def test_gantry_tilt_is_corrected_and_near_zero_tilt_is_not(write_series, expected_lps_from_ijk, tilt_deg, kept):
    # The tolerance is 0.2 degrees, or 0.1 mm over the height: at 0.6 degrees the shift over this stack of 10 mm is
    # 0.105 mm.
    lean_mm = GAP_MM * np.tan(np.radians(tilt_deg))
    volume = open_volume(write_series(edit=lambda d, i: move(d, frame(d)[1] * lean_mm * i)))
    if not kept:
        assert [note.code for note in volume.source.notes] == ["import.tilt-corrected"]
        assert f"{tilt_deg:.1f} degrees" in volume.source.warnings[0]
        np.testing.assert_allclose(volume.lps_from_ijk, expected_lps_from_ijk, rtol=0, atol=1e-8)
        return
    # The transform contains the tilt, so that every slice has the position of its tag.
    expected = expected_lps_from_ijk.copy()
    expected[:3, 2] += lean_mm * expected[:3, 1] / 0.9
    np.testing.assert_allclose(volume.lps_from_ijk, expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize(("shift_mm", "good"), [(0.08, True), (0.5, False)])
def test_slice_shifted_sideways_is_refused(write_series, shift_mm, good):
    folder = write_series(edit=lambda d, i: move(d, frame(d)[0] * (shift_mm if i == 4 else 0.0)))
    if good:
        assert open_volume(folder).shape_zyx[0] == SLICES
    else:
        assert refusal(folder).code == "import.geometry.shifted"


def _other_size(dataset: Dataset, index: int) -> None:
    if index == 5:
        dataset.Rows = 10
        dataset.PixelData = dataset.PixelData[: 10 * dataset.Columns * 2]


def _other_spacing(dataset: Dataset, index: int) -> None:
    if index == 5:
        dataset.PixelSpacing = [0.9, 0.75]


def _other_orientation(dataset: Dataset, index: int) -> None:
    if index == 5:
        dataset.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]


@pytest.mark.parametrize(
    ("edit", "text"),
    [
        (_other_size, "mixed sizes"),
        (_other_spacing, "mixed pixel spacing"),
        (_other_orientation, "mixed orientation"),
    ],
)
def test_series_with_mixed_sizes_or_orientations_is_refused(write_series, edit, text):
    error = refusal(write_series(edit=edit))
    assert error.code == "import.geometry.mixed"
    assert text in str(error)
    assert "IM005" in str(error)


def test_series_of_a_single_slice_is_refused(write_series):
    assert refusal(write_series(num_slices=1)).code == "import.single-slice"


@pytest.mark.parametrize(
    ("keyword", "value", "text"),
    [
        ("ImagePositionPatient", None, "ImagePositionPatient is missing"),
        ("ImagePositionPatient", [1, 2], "ImagePositionPatient should contain 3"),
        ("ImageOrientationPatient", None, "ImageOrientationPatient is missing"),
        ("ImageOrientationPatient", [1, 0, 0, 1, 0, 0], "perpendicular"),
        ("PixelSpacing", None, "PixelSpacing is missing"),
        ("PixelSpacing", [0, 0.7], "above 0 mm"),
        ("RescaleSlope", 0, "RescaleSlope is 0"),
    ],
)
def test_missing_and_invalid_dicom_tags_are_refused_by_name(write_series, keyword, value, text):
    def edit(dataset, index):
        if index == 3:
            if value is None:
                delattr(dataset, keyword)
            else:
                setattr(dataset, keyword, value)

    error = refusal(write_series(edit=edit))
    assert error.code == "import.tags"
    assert text in str(error)
    assert "IM003" in str(error)


def test_multi_frame_images_are_refused_by_name(write_series):
    error = refusal(write_series(edit=lambda d, i: setattr(d, "NumberOfFrames", 7)))
    assert error.code == "import.multi-frame"
    assert "7 frames" in str(error)


def test_truncated_slice_is_reported_with_its_file_name(write_series):
    folder = write_series()
    last = folder / "IM008"
    last.write_bytes(last.read_bytes()[:-100])
    error = refusal(folder)
    assert error.code == "import.truncated"
    assert "IM008" in str(error)


def test_slice_header_that_claims_more_pixels_than_the_file_contains_is_refused(write_series):
    def lie(dataset, index):
        dataset.Rows = dataset.Columns = 8000

    error = refusal(write_series(edit=lie))
    assert error.code == "import.truncated"
    assert "128000000 bytes" in str(error)


def test_slice_header_that_claims_an_enormous_size_is_refused(write_series):
    def lie(dataset, index):
        dataset.Rows = dataset.Columns = 60000

    assert refusal(write_series(edit=lie)).code == "import.header"


def test_damaged_compressed_pixels_are_reported_without_text_of_the_decoder_library(write_series, capfd):
    def damage(dataset, index):
        dataset.PixelData = encapsulate([b"\xff\xd8\xff\xf7 this is no picture "])
        dataset["PixelData"].VR = "OB"

    error = refusal(write_series(edit=damage, syntax=JPEGLSLossless))
    assert error.code == "import.truncated"
    assert "IM000" in str(error)
    assert "itk" not in str(error).lower()
    assert "itk" not in capfd.readouterr().err.lower()


def _jpeg_ls_header(rows: int, columns: int) -> bytes:
    return b"\xff\xd8\xff\xf7\x00\x0b\x10" + rows.to_bytes(2) + columns.to_bytes(2) + b"\x01\x01\x11\x00"


def test_compressed_slice_of_another_size_than_its_header_is_refused_before_decoding(write_series):
    import resource

    def lie(dataset, index):
        dataset.PixelData = encapsulate([_jpeg_ls_header(65000, 65000) + bytes(100)])
        dataset["PixelData"].VR = "OB"

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    error = refusal(write_series(edit=lie, syntax=JPEGLSLossless))
    assert error.code == "import.truncated"
    assert "65000 x 65000" in str(error)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB; the header claims 8,000,000 kB


def test_unknown_compression_is_refused_by_name(write_series):
    def video(dataset, index):
        dataset.PixelData = encapsulate([b"some video"])
        dataset["PixelData"].VR = "OB"

    assert refusal(write_series(edit=video, syntax=MPEG2MPML)).code == "import.not-supported"


def test_files_without_images_are_skipped_and_the_series_opens(write_series, expected_hu_zyx):
    folder = write_series()
    (folder / "report.pdf").write_bytes(b"%PDF-1.4 nothing here" * 20)
    (folder / "DIRFILE").write_bytes(b"\0" * 128 + b"DICM" + b"\x02\x00\x00\x00UL\x04\x00" + b"\xff" * 50)
    (folder / "empty").write_bytes(b"")
    (folder / "deep").mkdir()
    (folder / "IM000").rename(folder / "deep" / "IM000")
    np.testing.assert_array_equal(open_volume(folder).hu_zyx, expected_hu_zyx)


@pytest.mark.parametrize(
    ("name", "data", "text"),
    [
        ("report.pdf", b"%PDF-1.7" + b" " * 500, "PDF"),
        ("empty.dcm", b"", "empty"),
        ("notes.txt", b"no image", "not an image volume"),
    ],
)
def test_file_of_another_type_is_refused_with_the_name_of_its_type(tmp_path, name, data, text):
    (tmp_path / name).write_bytes(data)
    error = refusal(tmp_path / name)
    assert error.code == "import.not-an-image"
    assert name in str(error)
    assert text in str(error)


def test_folder_without_images_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    assert refusal(tmp_path).code == "import.no-images"
    (tmp_path / "a.nii.gz").write_bytes(b"x")
    assert "a.nii.gz" in str(refusal(tmp_path))


def test_missing_path_is_refused(tmp_path):
    assert refusal(tmp_path / "nowhere").code == "import.not-found"


def test_slice_that_would_decompress_to_an_enormous_size_is_skipped(write_series, tmp_path, expected_hu_zyx):
    import tracemalloc
    import zlib

    folder = write_series(syntax=DeflatedExplicitVRLittleEndian)
    sound = (folder / "IM000").read_bytes()
    meta_length = int.from_bytes(sound[140:144], "little")
    packer = zlib.compressobj(9, zlib.DEFLATED, -zlib.MAX_WBITS)
    zeros = bytes(1 << 20)
    bomb = b"".join(packer.compress(zeros) for _ in range(300)) + packer.flush()
    (folder / "bomb").write_bytes(sound[: 144 + meta_length] + bomb)
    tracemalloc.start()
    volume = open_volume(folder)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_array_equal(volume.hu_zyx, expected_hu_zyx)
    assert peak < 50e6  # the bomb inflates to 300 MB


@pytest.mark.parametrize(
    ("dates", "found"),
    [
        ({"AcquisitionDate": "20210503", "StudyDate": "20210502"}, "2021-05-03"),
        ({"AcquisitionDateTime": "20210503101500.00"}, "2021-05-03"),
        ({"StudyDate": "2021.05.03"}, "2021-05-03"),
        ({"AcquisitionDate": "", "StudyDate": "20210503"}, "2021-05-03"),
        ({"AcquisitionDate": "19000101", "StudyDate": "20211303"}, None),
        ({"StudyDate": "in May"}, None),
        ({}, None),
    ],
)
def test_scan_date_is_the_acquisition_date_else_the_study_date_and_is_not_shown(write_series, dates, found):
    def edit(dataset, _index):
        for keyword, value in dates.items():
            element = DataElement(keyword, dictionary_VR(keyword), None)
            # Set without pydicom's check of assigned values, because a file may contain this value.
            element._value = value
            dataset.add(element)

    volume = open_volume(write_series(edit=edit))
    assert volume.source.acquired_on == found
    assert "2021" not in repr(volume.source)
