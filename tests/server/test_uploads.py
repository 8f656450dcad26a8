"""Tests of uploaded files: stored in separate folders, limited in number and size, and removed."""

from __future__ import annotations

import asyncio
import json
import os
import re
import stat
from pathlib import PurePosixPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carina.errors import UsageError
from carina.server.files.dropped_names import DroppedNames
from carina.server.files.uploads import Limits, Uploads, safe_relative_path


async def body(*chunks):
    for chunk in chunks:
        yield chunk


def add(uploads, upload_id, name, *chunks):
    asyncio.run(uploads.add(upload_id, name, body(*chunks)))


@pytest.fixture
def uploads():
    uploads = Uploads(Limits(num_files=3, total_bytes=100, file_bytes=60))
    yield uploads
    uploads.close()


HOSTILE = [
    "../../etc/passwd",
    "..\\..\\windows\\system32\\x",
    "/etc/passwd",
    "C:\\autoexec.bat",
    "....//....//x",
    ".bashrc",
    "a/../../../b",
    "\0/../x",
    "~/x",
    ". . /x",
    "..",
    "",
    "a" * 5000,
    "/".join("d" * 200 for _ in range(100)),
    "con.txt",
    "\u202etxt.exe",
]


@pytest.mark.parametrize("name", HOSTILE)
def test_file_name_with_path_parts_is_stored_inside_the_folder_of_the_upload(uploads, name, tmp_path):
    upload_id = uploads.begin()
    add(uploads, upload_id, name, b"x")
    place = uploads.place(upload_id)
    folder = uploads._uploads[upload_id].folder
    assert place.is_file()
    assert place.resolve().is_relative_to(folder)
    assert place.name not in {"passwd..", ".bashrc", "con.txt"}


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such modes")
def test_all_folders_of_an_upload_have_mode_0700_and_its_files_0600(uploads):
    before = os.umask(0o022)
    try:
        upload_id = uploads.begin()
        add(uploads, upload_id, "Mueller/1961/series 1/one.dcm", b"x")
        headers = uploads.begin()
        add(uploads, headers, "Mueller/1961/ct.mhd", b"ElementDataFile = LIST\nparts/slice-1.raw\n")
        add(uploads, headers, "Mueller/1961/parts/slice-1.raw", b"x")
        uploads.place(headers)
    finally:
        os.umask(before)
    made = [path for one in uploads._uploads.values() for path in (one.folder, *one.folder.rglob("*"))]
    assert sum(path.is_dir() for path in made) > 8
    for path in made:
        assert path.stat().st_mode & 0o777 == (0o700 if path.is_dir() else 0o600), path


@given(st.text(max_size=80))
def test_any_uploaded_file_name_becomes_a_relative_path_without_parent_and_hidden_parts(name):
    path = safe_relative_path(name)
    assert not path.is_absolute()
    assert path.parts
    assert all(not part.startswith(".") for part in path.parts)
    assert all(part.isascii() and not set(part) & set('/\\:*?"<>|\0') for part in path.parts)


def test_ordinary_file_names_are_unchanged_so_that_formats_are_recognised(uploads):
    assert safe_relative_path("series 3/IM-0001.dcm").as_posix() == "series 3/IM-0001.dcm"
    assert safe_relative_path("chest.nii.gz").name == "chest.nii.gz"


def test_two_uploaded_files_with_the_same_cleaned_name_are_both_stored(uploads):
    upload_id = uploads.begin()
    add(uploads, upload_id, "ä.dcm", b"1")
    add(uploads, upload_id, "ö.dcm", b"2")
    folder = uploads.place(upload_id)
    assert sorted(p.read_bytes() for p in folder.iterdir()) == [b"1", b"2"]


def test_uploaded_header_file_is_opened_with_the_data_file_beside_it(uploads):
    upload_id = uploads.begin()
    add(uploads, upload_id, "lung.mhd", b"NDims = 3")
    add(uploads, upload_id, "lung.zraw", b"123")
    place = uploads.place(upload_id)
    assert place.suffix == ".mhd"
    # The header does not contain the name of its data, so both files are stored in one folder under their original
    # names.
    assert (place.parent / "lung.zraw").read_bytes() == b"123"


@pytest.mark.parametrize(
    ("header", "line"),
    [("Lung, Anna.mhd", b"ElementDataFile = %s"), ("Lung, Anna.nhdr", b"data file: %s")],
)
def test_uploaded_header_is_opened_with_its_data_file_under_a_neutral_name(uploads, header, line):
    upload_id = uploads.begin()
    own = header.rsplit(".", 1)[0] + ".zraw"
    add(uploads, upload_id, header, b"NDims = 3\n" + line % own.encode() + b"\n")
    add(uploads, upload_id, own, b"123")
    place = uploads.place(upload_id)
    named = place.read_bytes().split()[-1].decode()
    assert (place.parent / named).read_bytes() == b"123"
    assert not [p for p in place.parent.iterdir() if "Anna" in p.name]


def test_uploaded_header_that_lists_files_is_opened_with_these_files(uploads):
    upload_id = uploads.begin()
    add(uploads, upload_id, "lung.mhd", b"ElementDataFile = LIST\n1.raw\n")
    add(uploads, upload_id, "1.raw", b"123")
    assert (uploads.place(upload_id).parent / "1.raw").read_bytes() == b"123"


NAMES = ["Müller^Anna.dcm", "Doe_John_1970.nii.gz", "Doe John/IM-0001", "MUELLER.ANNA.19700101"]


@pytest.mark.parametrize("name", NAMES)
def test_uploaded_files_have_neutral_private_names_on_disk_and_their_original_names_in_the_window(uploads, name):
    upload_id = uploads.begin()
    add(uploads, upload_id, name, b"1")
    place = uploads.place(upload_id)
    folder = uploads._uploads[upload_id].folder
    for part in place.relative_to(folder.parent).parts:
        assert re.fullmatch(r"dropped-[0-9a-f]{8}(-\d+(\.dcm|\.nii\.gz)?)?", part)
    assert stat.S_IMODE(place.stat().st_mode) == 0o600
    assert {stat.S_IMODE(p.stat().st_mode) for p in place.parents if p.is_relative_to(folder.parents[1])} == {0o700}
    own = name.split("/")[-1]
    text = json.dumps({"message": f"reading {place.name}: it is cut short; the folder {folder.name}"})
    shown = json.loads(uploads.names.with_original_names(text))["message"]
    assert shown == f"reading {own}: it is cut short; the folder dropped files"


@given(st.text(max_size=40), st.sampled_from(["", ".dcm", ".nii.gz"]))
def test_any_uploaded_file_name_is_restored_in_messages_as_valid_json(stem, suffix):
    names = DroppedNames()
    names.begin("01234567")
    place = names.neutral_path("01234567", PurePosixPath("x" + suffix), stem + suffix)
    shown = json.loads(names.with_original_names(json.dumps([place.name, "a dropped-thing, dropped-76543210-1.dcm"])))
    assert shown[1] == "a dropped-thing, dropped-76543210-1.dcm"
    assert all(ord(c) >= 0x20 for c in shown[0])


def test_neutral_name_without_its_suffix_is_replaced_by_the_original_name_in_messages():
    """Use messages of readers that name both files, header and data, by their common stem."""
    names = DroppedNames()
    names.begin("01234567")
    place = names.neutral_path("01234567", PurePosixPath("scan.nii.gz"), "scan.nii.gz")
    stem = place.name.removesuffix(".nii.gz")
    assert json.loads(names.with_original_names(json.dumps(f"reading {stem} failed"))) == "reading scan failed"


def test_uploaded_files_with_a_common_stem_have_a_common_neutral_stem(uploads):
    upload_id = uploads.begin()
    for name in ("a/scan.hdr", "a/scan.img", "b/scan.img"):
        add(uploads, upload_id, name, b"1")
    stems = sorted((p.parent.name, p.name.split(".")[0]) for p in uploads.place(upload_id).rglob("*.*"))
    assert stems[0] == stems[1] or stems[1] == stems[2]
    assert len(set(stems)) == 2


@pytest.mark.parametrize("chunks", [[b"x" * 61], [b"x" * 30, b"x" * 31]])
def test_uploaded_file_over_its_size_limit_is_refused_and_removed(uploads, chunks):
    upload_id = uploads.begin()
    with pytest.raises(UsageError, match="too large"):
        add(uploads, upload_id, "big", *chunks)
    with pytest.raises(UsageError, match="no file"):
        uploads.place(upload_id)


def test_upload_beyond_the_total_limits_is_refused(uploads):
    upload_id = uploads.begin()
    add(uploads, upload_id, "a", b"x" * 60)
    with pytest.raises(UsageError, match="too large"):
        add(uploads, upload_id, "b", b"x" * 41)
    upload_id = uploads.begin()
    for name in "abc":
        add(uploads, upload_id, name, b"x")
    with pytest.raises(UsageError, match="too many files"):
        add(uploads, upload_id, "d", b"x")


def test_cancelled_or_closed_upload_is_removed_from_the_disk(uploads):
    first, second = uploads.begin(), uploads.begin()
    add(uploads, first, "a", b"1")
    folder = uploads._uploads[first].folder
    uploads.begin()  # The third upload cancels the first one.
    assert not folder.exists()
    with pytest.raises(UsageError, match="has expired"):
        uploads.place(first)
    add(uploads, second, "a", b"1")
    folder = uploads._uploads[second].scratch.path
    uploads.close()
    assert not folder.exists()


def test_retained_upload_stays_while_others_replace_each_other(uploads):
    first = uploads.begin()
    add(uploads, first, "a", b"1")
    place = uploads.place(first)
    uploads.retain(first)
    others = [uploads.begin() for _ in range(3)]
    assert place.exists()
    assert uploads.contains(first, place)
    assert not uploads.contains(others[0], place), "the oldest upload that is not retained was deleted"
    assert not uploads.contains(others[-1], place)
    uploads.discard(first)
    assert not place.exists()
