"""Tests of ``carina.deidentify``: no marker in the bytes, unchanged pixels and positions, burned-in text refused."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from dicom_writer import chest, packed, repack, series
from pydicom import dcmread
from pydicom.datadict import DicomDictionary
from pydicom.dataelem import DataElement
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.uid import ExplicitVRBigEndian, SecondaryCaptureImageStorage

import carina
from carina.deidentification.profile_table import ACTIONS, RETAINED_TEXT
from carina.errors import CancelledError, CarinaError, UsageError, VolumeImportError

TEXT = {"AE", "CS", "LO", "LT", "PN", "SH", "ST", "UC", "UT", "UR"}
TIMES = {"DA": "1987{:04d}", "DT": "1987{:04d}", "TM": "12{:04d}", "AS": "{:03d}Y"}
NUMBERS = {"DS": "77{:05d}", "IS": "77{:05d}"}


class Markers:
    """Values that occur in no other place, one for each attribute."""

    def __init__(self):
        self.texts: list[bytes] = []
        self.number = 0

    def of(self, tag: int, kind: str) -> DataElement | None:
        number = self.number
        self.number += 1
        if kind in TEXT:
            value = f"MARK{number:05d}" if kind == "CS" else f"Mark-{number:05d}"
        elif kind == "UI":
            value = f"1.2.777.{number}.5"
        elif kind in NUMBERS:
            value = NUMBERS[kind].format(number)
        elif kind in ("OB", "OW", "UN"):
            value = f"bytes-{number:05d}!".encode()
        elif kind == "SQ":
            inner = Dataset()
            inner.add(self.of(0x00081030, "LO"))
            inner.add(self.of(0x00080100, "SH"))
            value = Sequence([inner])
        else:
            return None
        if kind != "SQ" and (text := value if isinstance(value, bytes) else value.encode()) not in self.texts:
            self.texts.append(text)
        return DataElement(tag, kind, value)


def fill(dataset: Dataset, markers: Markers) -> None:
    """Add a marker to every attribute of the table, to private ones, to unlisted texts, and in nested items."""
    for tag in ACTIONS:
        kind = DicomDictionary.get(tag, ("",))[0]
        if tag >> 16 in (0, 2) or tag in (0x0020000D, 0x0020000E, 0x00080018, 0x00200052):
            continue
        element = markers.of(tag, kind)
        if element is not None:
            dataset.add(element)
    for tag, (kind, *_) in DicomDictionary.items():  # texts, names and binary data that the table does not list
        known = tag in ACTIONS or tag in RETAINED_TEXT or tag in dataset
        if (
            not known
            and tag >> 16 in (0x0010, 0x0012, 0x0018, 0x0032, 0x0038, 0x0040)
            and kind in {*TEXT, "OB"} - {"CS"}
        ):
            dataset.add(markers.of(tag, kind))
    for group in (0x0009, 0x0029):
        block = dataset.private_block(group, markers.of(group << 16 | 0x10, "LO").value, create=True)
        block.add_new(1, "LO", markers.of(0, "LO").value)
        block.add_new(2, "UN", markers.of(0, "UN").value)
    for tag, kind in ((0x60000022, "LO"), (0x60004000, "LT"), (0x60003000, "OW"), (0x50003000, "OW")):
        dataset.add(markers.of(tag, kind))
    # A sequence that stays, with items in items.
    inner, outer = Dataset(), Dataset()
    inner.add(markers.of(0x00100010, "PN"))
    inner.add(markers.of(0x00081155, "UI"))
    inner.add(markers.of(0x0008103E, "LO"))
    inner.CodeValue, inner.CodingSchemeDesignator, inner.CodeMeaning = (markers.of(0, "SH").value for _ in range(3))
    outer.DerivationCodeSequence = [inner]
    outer.private_block(0x0011, "OWN", create=True).add_new(1, "LO", markers.of(0, "LO").value)
    dataset.SourceImageSequence = [outer]


@pytest.fixture(scope="module")
def marked(tmp_path_factory):
    markers = Markers()
    folder = tmp_path_factory.mktemp("marked")

    def edit(dataset: Dataset, index: int) -> None:
        markers.number = 0  # the same values in all slices, as in a series
        fill(dataset, markers)
        dataset.preamble = b"Mark-preamble".ljust(128, b"\0")

    markers.texts.append(b"Mark-preamble")
    source = series(folder / "Secret-One", edit, hu=chest()[:4], name=lambda i: f"Secret_{i}.dcm")
    return source, markers


def all_bytes(folder: Path) -> bytes:
    return b"".join(
        path.read_bytes() + str(path.relative_to(folder)).encode() for path in folder.rglob("*") if path.is_file()
    )


def test_no_marker_of_any_attribute_is_left_in_the_bytes(marked, tmp_path):
    source, markers = marked
    assert len(markers.texts) > 600
    before = all_bytes(source)
    found = carina.deidentify(source, tmp_path / "copy")
    assert (found.num_images, found.num_series, found.refused) == (4, 1, ())
    data = all_bytes(tmp_path / "copy")
    assert [text for text in markers.texts if text in data] == []
    for text in (b"Secret", b"SECRET", b"19010101", b"1.2.3.4.5", b"OWN"):
        assert text not in data
    assert all_bytes(source) == before


def test_pixels_and_geometry_of_a_copy_are_unchanged(marked, tmp_path):
    source, _ = marked
    carina.deidentify(source, tmp_path / "copy")
    original, copy = carina.open_volume(source), carina.open_volume(tmp_path / "copy")
    np.testing.assert_array_equal(copy.hu_zyx, original.hu_zyx)
    np.testing.assert_array_equal(copy.lps_from_ijk, original.lps_from_ijk)
    assert copy.is_hu and original.is_hu
    assert copy.source.series.kernel == original.source.series.kernel
    assert {note.code for note in copy.source.notes} <= {note.code for note in original.source.notes}


def test_copy_states_the_profile_and_an_alias(tmp_path):
    series(tmp_path / "scan", hu=chest()[:3])
    carina.deidentify(tmp_path / "scan", tmp_path / "copy", alias="Chest 7")
    header = dcmread(next((tmp_path / "copy").rglob("*.dcm")))
    assert (header.PatientName, header.PatientID, header.PatientIdentityRemoved) == ("Chest 7", "Chest 7", "YES")
    assert [code.CodeValue for code in header.DeidentificationMethodCodeSequence] == ["113100"]
    assert header.file_meta.MediaStorageSOPInstanceUID == header.SOPInstanceUID
    assert "SeriesDescription" not in header


def test_new_uids_are_consistent_within_a_run_and_differ_between_runs(tmp_path):
    def refer(dataset, index):
        reference = Dataset()
        reference.ReferencedSOPClassUID = dataset.SOPClassUID
        reference.ReferencedSOPInstanceUID = "1.2.99.1" if index else dataset.SOPInstanceUID
        dataset.SourceImageSequence = [reference]
        if index == 0:
            dataset.SOPInstanceUID = dataset.file_meta.MediaStorageSOPInstanceUID = "1.2.99.1"

    series(tmp_path / "scan", refer, hu=chest()[:3])
    found = []
    for name in ("one", "two"):
        carina.deidentify(tmp_path / "scan", tmp_path / name)
        headers = [dcmread(path) for path in sorted((tmp_path / name).rglob("*.dcm"))]
        assert len({header.SeriesInstanceUID for header in headers}) == 1
        assert len({header.SOPInstanceUID for header in headers}) == 3
        first, second, _ = headers
        assert second.SourceImageSequence[0].ReferencedSOPInstanceUID == first.SOPInstanceUID
        found.append(first.StudyInstanceUID)
    assert found[0] != found[1]


def test_two_patients_get_two_aliases(tmp_path):
    series(tmp_path / "scan" / "a", hu=chest()[:2])
    series(tmp_path / "scan" / "b", lambda d, _: setattr(d, "PatientID", "SECRET-2"), hu=chest()[:2])
    found = carina.deidentify(tmp_path / "scan", tmp_path / "copy")
    assert found.num_patients == 2
    names = {str(dcmread(path).PatientID) for path in (tmp_path / "copy").rglob("*.dcm")}
    assert names == {"PATIENT", "PATIENT-2"}


def test_kernel_that_contains_the_name_of_the_patient_is_removed(tmp_path):
    series(tmp_path / "scan", lambda d, _: setattr(d, "ConvolutionKernel", "B41f secret"), hu=chest()[:2])
    carina.deidentify(tmp_path / "scan", tmp_path / "copy")
    assert b"secret" not in all_bytes(tmp_path / "copy")


@pytest.mark.parametrize("kind", ["JPEG2000", "JPEG"])
def test_comment_in_a_compressed_stream_is_removed(tmp_path, kind):
    def edit(dataset, _):
        packed(dataset, tmp_path, kind)
        comment = b"Secret^One"
        code = b"\xff\x64" if kind == "JPEG2000" else b"\xff\xfe"
        segment = code + (len(comment) + (4 if kind == "JPEG2000" else 2)).to_bytes(2, "big")
        segment += (b"\0\1" if kind == "JPEG2000" else b"") + comment

        def add(stream: bytes) -> bytes:
            if kind == "JPEG":
                return stream[:2] + segment + stream[2:]
            at = stream.index(b"\xff\x52")  # the segment of the coding style, after that of the size
            return stream[:at] + segment + stream[at:]

        repack(dataset, add)

    series(tmp_path / "scan", edit, hu=chest()[:3])
    assert b"Secret^One" in all_bytes(tmp_path / "scan")
    found = carina.deidentify(tmp_path / "scan", tmp_path / "copy")
    assert found.num_images == 3, found.refused
    assert b"Secret" not in all_bytes(tmp_path / "copy")
    np.testing.assert_array_equal(carina.open_volume(tmp_path / "copy").hu_zyx, chest()[:3])


def test_big_endian_pixels_are_unchanged(tmp_path):
    def edit(dataset, _):
        dataset.PixelData = np.frombuffer(dataset.PixelData, "<u2").astype(">u2").tobytes()

    series(tmp_path / "scan", edit, hu=chest()[:3], syntax=ExplicitVRBigEndian)
    carina.deidentify(tmp_path / "scan", tmp_path / "copy")
    np.testing.assert_array_equal(carina.open_volume(tmp_path / "copy").hu_zyx, chest()[:3])


def test_overlay_in_unused_bits_of_the_pixels_is_cleared(tmp_path):
    def edit(dataset, _):
        dataset.BitsStored, dataset.HighBit = 12, 11
        values = np.minimum(np.frombuffer(dataset.PixelData, "<u2"), 4095)
        dataset.PixelData = (values | 0x8000).astype("<u2").tobytes()
        dataset.add_new(0x60000100, "US", 16)
        dataset.add_new(0x60000102, "US", 15)

    series(tmp_path / "scan", edit, hu=chest()[:3])
    carina.deidentify(tmp_path / "scan", tmp_path / "copy")
    for path in (tmp_path / "copy").rglob("*.dcm"):
        assert np.frombuffer(dcmread(path).PixelData, "<u2").max() < 4096


def burn(dataset: Dataset, _index: int) -> None:
    dataset.BurnedInAnnotation = "YES"


@pytest.mark.parametrize(
    "edit",
    [
        burn,
        lambda d, _: setattr(d, "Modality", "US"),
        lambda d, _: setattr(d, "SOPClassUID", SecondaryCaptureImageStorage),
        lambda d, _: setattr(d, "ImageType", ["DERIVED", "SECONDARY", "SCREEN SAVE"]),
        lambda d, _: setattr(d, "ConversionType", "WSD"),
    ],
)
def test_images_that_may_show_text_are_refused(tmp_path, edit):
    series(tmp_path / "scan", edit, hu=chest()[:2])
    with pytest.raises(VolumeImportError, match="mask") as found:
        carina.deidentify(tmp_path / "scan", tmp_path / "copy")
    assert found.value.code == "deidentify.burned-in"
    assert not (tmp_path / "copy").exists()
    assert list(tmp_path.iterdir()) == [tmp_path / "scan"]


def test_only_images_with_text_are_left_out_of_a_mixed_folder(tmp_path):
    series(tmp_path / "scan" / "ct", hu=chest()[:3])
    series(tmp_path / "scan" / "screens", burn, hu=chest()[:2], number=9)
    found = carina.deidentify(tmp_path / "scan", tmp_path / "copy")
    assert found.num_images == 3
    assert found.refused == (("its header states burned-in annotation", 2),)


def test_mask_blackens_only_images_that_may_show_text(tmp_path):
    series(tmp_path / "scan" / "ct", hu=chest()[:3])
    series(tmp_path / "scan" / "screens", burn, hu=chest()[:2], number=9)
    found = carina.deidentify(tmp_path / "scan", tmp_path / "copy", mask=[(0, 0, 32, 8)])
    assert (found.num_images, found.num_masked) == (5, 2)
    for path in (tmp_path / "copy").rglob("*.dcm"):
        header = dcmread(path)
        values = np.frombuffer(header.PixelData, "<u2").reshape(32, 32)
        is_masked = header.SeriesNumber == 9
        assert (np.unique(values[:8]).size == 1) == is_masked
        assert np.unique(values[8:]).size > 50
        assert header.get("BurnedInAnnotation") == ("NO" if is_masked else None)


def hide(value: bytes):
    """Return edits that hide a text in places without an attribute for text."""

    def in_a_nested_picture(dataset, _index):
        item = Dataset()
        item.Rows, item.Columns, item.BitsAllocated = 4, 4, 8
        item.add_new(0x7FE00010, "OB", value)
        dataset.BasicGrayscaleImageSequence = Sequence([item])

    def behind_the_pixels(dataset, _index):
        dataset.PixelData += value

    def in_the_modality(dataset, _index):
        dataset.add_new(0x00080060, "CS", value.decode())

    def in_an_unknown_attribute(dataset, _index):
        dataset.add_new(0x00189999, "CS", value.decode().upper())

    return [in_a_nested_picture, behind_the_pixels, in_the_modality, in_an_unknown_attribute]


@pytest.mark.filterwarnings("ignore:Invalid value")
@pytest.mark.parametrize("edit", hide(b"Li^Bo 12 CRED 77"), ids=lambda edit: edit.__name__)
def test_text_in_hidden_places_is_removed(tmp_path, edit):
    source = series(tmp_path / "scan", edit, hu=chest()[:2])
    assert b"12 CRED 77" in all_bytes(source)
    assert carina.deidentify(source, tmp_path / "copy").num_images == 2
    assert b"12 CRED 77" not in all_bytes(tmp_path / "copy")


def test_mask_outside_of_the_image_refuses_the_image(tmp_path):
    source = series(tmp_path / "scan", burn, hu=chest()[:2])
    with pytest.raises(VolumeImportError, match="a rectangle to blacken is outside of it"):
        carina.deidentify(source, tmp_path / "copy", mask=[(0, 0, 8, 8), (5000, 0, 10, 10)])
    assert not (tmp_path / "copy").exists()


def test_frames_that_the_header_does_not_count_are_not_copied(tmp_path):
    def twice(dataset, index):
        burn(dataset, index)
        dataset.PixelData *= 2

    source = series(tmp_path / "scan", twice, hu=chest()[:1])
    carina.deidentify(source, tmp_path / "copy", mask=[(0, 0, 5000, 5000)])
    (path,) = (tmp_path / "copy").rglob("*.dcm")
    copy = dcmread(path)
    assert len(copy.PixelData) == copy.Rows * copy.Columns * 2
    assert len(np.unique(copy.pixel_array)) == 1


@pytest.mark.parametrize("keyword", ["SOPInstanceUID", "SOPClassUID", "Rows"])
def test_incomplete_image_does_not_end_the_run(tmp_path, keyword):
    source = series(tmp_path / "scan", lambda d, i: delattr(d, keyword) if i == 1 else None, hu=chest()[:3])
    found = carina.deidentify(source, tmp_path / "copy")
    assert (found.num_images, [count for _, count in found.refused]) == (2, [1])


def test_archive_is_copied_and_other_files_are_counted(tmp_path):
    series(tmp_path / "scan", hu=chest()[:3], name=lambda i: f"Secret-{i}.dcm")
    with zipfile.ZipFile(tmp_path / "scan.zip", "w") as archive:
        for path in (tmp_path / "scan").iterdir():
            archive.write(path, path.name)
        archive.writestr("report.txt", "Secret One")
    found = carina.deidentify(tmp_path / "scan.zip", tmp_path / "copy")
    assert (found.num_images, found.num_other_files) == (3, 1)
    assert b"Secret" not in all_bytes(tmp_path / "copy")


def test_existing_folder_and_folder_inside_the_source_are_refused(tmp_path):
    series(tmp_path / "scan", hu=chest()[:2])
    (tmp_path / "full").mkdir()
    for target in (tmp_path / "full", tmp_path / "scan" / "copy", tmp_path / "scan"):
        with pytest.raises(UsageError) as found:
            carina.deidentify(tmp_path / "scan", target)
        assert found.value.code == "deidentify.folder"


def test_cancelling_leaves_nothing(tmp_path):
    series(tmp_path / "scan", hu=chest()[:4])
    steps = []

    def cancel():
        steps.append(len(list(tmp_path.iterdir())))
        return len(steps) > 4

    with pytest.raises(CancelledError):
        carina.deidentify(tmp_path / "scan", tmp_path / "copy", cancel=cancel)
    assert max(steps) == 2  # a partial copy existed
    assert list(tmp_path.iterdir()) == [tmp_path / "scan"]


def test_neither_logs_nor_messages_contain_the_identity(marked, tmp_path, caplog):
    source, markers = marked
    caplog.set_level("DEBUG")
    messages = []
    carina.deidentify(source, tmp_path / "copy", progress=lambda what, _: messages.append(what))
    series(tmp_path / "burned", burn, hu=chest()[:2])
    try:
        carina.deidentify(tmp_path / "burned", tmp_path / "none")
    except CarinaError as error:
        messages.append(str(error))
    text = (caplog.text + " ".join(messages)).encode()
    assert not any(marker in text for marker in [*markers.texts, b"Secret", b"SECRET"])


@pytest.mark.parametrize("mask", [[(0, 0, 0, 4)], [(1, 2, 3)], ["text"], 5, [(-1, 0, 4, 4)]])
def test_invalid_masks_are_refused(tmp_path, mask):
    with pytest.raises(UsageError, match="mask"):
        carina.deidentify(tmp_path / "scan", tmp_path / "copy", mask=mask)
