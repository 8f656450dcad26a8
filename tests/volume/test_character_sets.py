"""Tests of the character sets of DICOM texts: declared ones are used, UTF-8 is recognised, all others are doubtful."""

from __future__ import annotations

import io
import warnings

import numpy as np
import pytest
from dicom_writer import chest, series
from pydicom import dcmread
from pydicom.dataelem import RawDataElement
from pydicom.tag import Tag

from carina.errors import UsageError
from carina.export.plan_dicom import ct_images, file_bytes, new_object
from carina.volume import open_volume
from carina.volume.character_sets import character_set_name, doubtful_texts
from carina.volume.dicom_headers import read_dataset, read_image_headers

MUELLER, JAPANESE = "Müller^Jürg", "Yamada^Tarou=山田^太郎=やまだ^たろう"


def _set_raw(dataset, keyword: str, value: bytes, vr: str) -> None:
    value += b" " * (len(value) % 2)
    dataset._dict[Tag(keyword)] = RawDataElement(Tag(keyword), vr, len(value), value, 0, False, True)


def _named(folder, name: bytes, character_set: str | None, *, keyword: str = "PatientName", vr: str = "PN"):
    """Write three slices whose patient name (and other texts) consists of the given bytes."""

    def edit(dataset, index):
        if character_set is not None:
            _set_raw(dataset, "SpecificCharacterSet", character_set.encode(), "CS")
        _set_raw(dataset, keyword, name, vr)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pydicom warns about the invalid character set
        return series(folder, edit, hu=chest()[:3])


KNOWN = {
    "Latin-1": (MUELLER, "latin_1", "ISO_IR 100"),
    "Latin-1, misspelt": (MUELLER, "latin_1", "ISO-8859-1"),
    "UTF-8": (MUELLER, "utf_8", "ISO_IR 192"),
    "UTF-8, no set": (MUELLER, "utf_8", None),
    "UTF-8, empty set": (MUELLER, "utf_8", ""),
    "UTF-8, default set": (MUELLER, "utf_8", "ISO_IR 6"),
    "UTF-8, misspelt with an underscore": (MUELLER, "utf_8", "ISO_IR_192"),
    "UTF-8, misspelt by its own name": (MUELLER, "utf_8", "UTF-8"),
    "UTF-8, misspelt in small letters": (MUELLER, "utf_8", "iso_ir 192"),
    "UTF-8, unknown set": (MUELLER, "utf_8", "WESTERN"),
    "UTF-8 in Chinese letters, no set": ("Wang^XiaoDong=王^小东", "utf_8", None),
    "UTF-8 in Korean letters, no set": ("Hong^Gildong=홍^길동", "utf_8", None),
    "Cyrillic": ("Иванов^Иван", "iso8859_5", "ISO_IR 144"),
    "Chinese": ("Wang^XiaoDong=王^小东", "gb18030", "GB18030"),
    "Chinese, misspelt": ("Wang^XiaoDong=王^小东", "gb18030", "GB 18030"),
    "ASCII, unknown set": ("Smith^Anna", "ascii", "ISO 2022 IR 6, IS"),
}


def _exported(folder) -> str:
    volume = open_volume(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        data = new_object(
            "1.2.840.10008.5.1.4.1.1.66.4",
            ct_images(folder, volume),
            identity="from the CT",
            modality="SEG",
            series_number=5,
            series_words="x",
        )
    written = dcmread(io.BytesIO(file_bytes(data)), force=True)
    assert written.SpecificCharacterSet == "ISO_IR 192"
    return str(written.PatientName)


@pytest.mark.parametrize("case", KNOWN)
def test_patient_name_in_any_character_set_is_exported_unchanged(tmp_path, case):
    name, encoding, character_set = KNOWN[case]
    assert _exported(_named(tmp_path, name.encode(encoding), character_set)) == name


@pytest.mark.parametrize(
    ("name", "raw", "character_set"),
    [
        (
            JAPANESE,
            b"Yamada^Tarou=\x1b$B;3ED\x1b(B^\x1b$BB@O:\x1b(B=\x1b$B$d$^$@\x1b(B^\x1b$B$?$m$&\x1b(B",
            "\\ISO 2022 IR 87",
        ),
        (
            "Hong^Gildong=홍^길동",
            b"Hong^Gildong=\x1b$)C" + "홍".encode("euc_kr") + b"^\x1b$)C" + "길동".encode("euc_kr"),
            "\\ISO 2022 IR 149",
        ),
    ],
)
def test_patient_names_with_escape_sequences_are_decoded(tmp_path, name, raw, character_set):
    assert _exported(_named(tmp_path, raw, character_set)) == name


DOUBTFUL = {
    "Latin-1, no set": (MUELLER.encode("latin_1"), None),
    "Latin-1, unknown set": (MUELLER.encode("latin_1"), "WESTERN"),
    "UTF-8, declared as Latin-1": (MUELLER.encode(), "ISO_IR 100"),
    "UTF-8 in which another program lost letters": ("M\ufffdller^Jürg".encode(), "ISO_IR 192"),
    "Japanese escape sequences, no set": (b"Yamada=\x1b$B;3ED\x1b(B", None),
    "a code page of Windows, declared as Latin-1": ("Müller^J\x93rg".encode("latin_1"), "ISO_IR 100"),
    "Chinese, no set": ("王^小东".encode("gb18030"), None),
}


@pytest.mark.parametrize("case", DOUBTFUL)
def test_patient_name_with_doubtful_characters_is_not_exported(tmp_path, case):
    folder = _named(tmp_path, *DOUBTFUL[case])
    with pytest.raises(UsageError, match="PatientName") as caught:
        _exported(folder)
    assert caught.value.code == "plan.identity"
    # The message contains no part of the name.
    assert "M" not in str(caught.value).replace("SpecificCharacterSet", "").split("PatientName")[0]
    images = ct_images(folder, open_volume(folder))
    data = new_object("1.2.3", images, identity="none", modality="SEG", series_number=5, series_words="x")
    assert data.PatientName == ""


def test_latin_1_text_declared_as_utf_8_is_doubtful(tmp_path):
    folder = _named(tmp_path, b"Mxller^Jurg", "ISO_IR 192")
    path = folder / "IM001"
    path.write_bytes(path.read_bytes().replace(b"Mxller", b"M\xfcller"))
    assert doubtful_texts(read_dataset(path, pixels=True)) == {"PatientName"}


def test_doubtful_study_description_is_omitted_and_the_patient_name_is_exported(tmp_path):
    folder = _named(tmp_path, "Lungen-Übersicht".encode("latin_1"), None, keyword="StudyDescription", vr="LO")
    images = ct_images(folder, open_volume(folder))
    assert images.doubtful == {"StudyDescription"}
    data = new_object("1.2.3", images, identity="from the CT", modality="SEG", series_number=5, series_words="x")
    assert "StudyDescription" not in data
    assert str(data.PatientName) == "Secret^One"


def test_one_patient_name_in_two_character_sets_is_one_patient(tmp_path):
    def edit(dataset, index):
        encoding, name = (("ISO_IR 100", "latin_1"), ("ISO_IR 192", "utf_8"), ("", "utf_8"))[index % 3]
        _set_raw(dataset, "SpecificCharacterSet", encoding.encode(), "CS")
        _set_raw(dataset, "PatientName", MUELLER.encode(name), "PN")

    volume = open_volume(series(tmp_path, edit))
    assert volume.source.notes == ()
    np.testing.assert_array_equal(volume.hu_zyx, chest())


def test_series_title_in_undeclared_utf_8_is_decoded(tmp_path):
    folder = _named(tmp_path, "Lungen-Übersicht".encode(), None, keyword="SeriesDescription", vr="LO")
    assert open_volume(folder).source.title == "Lungen-Übersicht"


def test_texts_in_dicom_sequences_use_the_character_set_of_the_file(tmp_path):
    def edit(dataset, index):
        from pydicom.dataset import Dataset

        item = Dataset()
        _set_raw(item, "CodeMeaning", "Übersicht".encode(), "LO")
        dataset.ProcedureCodeSequence = [item]

    folder = series(tmp_path, edit, hu=chest()[:2])
    dataset = read_dataset(folder / "IM000", pixels=True)
    assert dataset.ProcedureCodeSequence[0].CodeMeaning == "Übersicht"
    assert doubtful_texts(dataset) == frozenset()


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("ISO_IR 192", "ISO_IR 192"),
        ("utf8", "ISO_IR 192"),
        ("ISO IR 100", "ISO_IR 100"),
        ("ISO8859-5", "ISO_IR 144"),
        ("ISO_2022_IR_87", "ISO 2022 IR 87"),
        ("ISO 2022 IR 192", "ISO_IR 192"),
        ("gbk", "GBK"),
        ("", "ISO_IR 6"),
        ("ISO_IR 999", None),
        ("KLINGON", None),
    ],
)
def test_name_of_a_character_set_is_stated_without_its_escape_codes(text, name):
    assert character_set_name(text) == name


def test_dicom_header_with_a_damaged_character_set_is_read(tmp_path):
    folder = _named(tmp_path, b"Secret^One", "ISO_IR 100")
    path = folder / "IM001"
    path.write_bytes(path.read_bytes().replace(b"ISO_IR 100", b"\\\xff\\\\\xfe(\n\\  "))
    (header,), _ = read_image_headers(folder / "IM001")
    assert header is not None
