"""Tests of archives that are opened like folders, and of archives that are refused."""

from __future__ import annotations

import base64
import io
import struct
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dicom_writer import chest, series
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, MediaStorageDirectoryStorage

from carina.errors import CancelledError, VolumeImportError
from carina.volume import Volume, archives, inspect_path, open_volume, write_grid
from carina.volume.source_files import CtSource


def refusal(path: Path) -> VolumeImportError:
    with pytest.raises(VolumeImportError) as caught:
        open_volume(path)
    assert caught.value.exit_code == 3
    return caught.value


@pytest.fixture(autouse=True)
def no_file_stays_behind(tmp_path, monkeypatch):
    """Check that the temporary folder contains no unpacked file after a test."""
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    yield
    left = [path for path in place.rglob("*") if path.is_file() and path.name != "lock"]
    assert left == []


Pack = Callable[[Path, dict[str, bytes]], Path]


def zipped(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def tarred(path: Path, files: dict[str, bytes], mode: str = "w") -> Path:
    with tarfile.open(path, mode) as archive:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            archive.addfile(member, io.BytesIO(content))
    return path


def seven_zipped(path: Path, files: dict[str, bytes], options: str = "") -> Path:
    libarchive = pytest.importorskip("libarchive", reason="needs the extra sevenzip")
    with libarchive.file_writer(str(path), "7zip", options=options) as archive:
        for name, content in files.items():
            archive.add_file_from_memory(name, len(content), [content])
    return path


PACKERS: dict[str, Pack] = {
    "7z": seven_zipped,
    "zip": zipped,
    "tar": tarred,
    "tar.gz": lambda path, files: tarred(path, files, "w:gz"),
    "tar.xz": lambda path, files: tarred(path, files, "w:xz"),
    "tar.bz2": lambda path, files: tarred(path, files, "w:bz2"),
}


def files_of(folder: Path, prefix: str = "") -> dict[str, bytes]:
    return {
        prefix + path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def scan(tmp_path) -> dict[str, bytes]:
    """Return the files of a series by name."""
    return files_of(series(tmp_path / "scan"))


@pytest.mark.parametrize("kind", PACKERS)
@pytest.mark.parametrize("prefix", ["", "disc/DICOM/ST0/"])
def test_archive_opens_like_its_folder(tmp_path, scan, kind, prefix):
    path = PACKERS[kind](tmp_path / "scan.bin", {prefix + name: content for name, content in scan.items()})
    volume, expected = open_volume(path), open_volume(tmp_path / "scan")
    np.testing.assert_array_equal(volume.hu_zyx, expected.hu_zyx)
    np.testing.assert_array_equal(volume.lps_from_ijk, expected.lps_from_ijk)
    assert volume.source.notes == ()
    found = inspect_path(path)
    assert found.shape_zyx == volume.shape_zyx
    assert found.refused is None


def test_series_of_an_archive_are_listed_and_selected(tmp_path, scan):
    other = files_of(series(tmp_path / "other", number=4, hu=chest(seed=6)), "other/")
    path = zipped(tmp_path / "two.zip", {**scan, **other})
    assert len(inspect_path(path).series) == 2
    np.testing.assert_array_equal(open_volume(path, series="4").hu_zyx, chest(seed=6))


def test_grid_file_in_an_archive_opens_with_its_name(tmp_path):
    volume = Volume(chest().copy(), np.diag([0.7, 0.9, 2.5, 1.0]))
    write_grid(tmp_path / "Thorax.nii.gz", volume.hu_zyx, volume.lps_from_ijk, what="the CT")
    path = zipped(
        tmp_path / "one.zip", {"case/Thorax.nii.gz": (tmp_path / "Thorax.nii.gz").read_bytes(), "a.txt": b"hello"}
    )
    found = open_volume(path)
    np.testing.assert_array_equal(found.hu_zyx, volume.hu_zyx)
    assert "Thorax" in found.source.title


def test_header_and_data_file_in_an_archive_open_together(tmp_path):
    (tmp_path / "ct.raw").write_bytes(chest().astype("<i2").tobytes())
    header = "ObjectType = Image\nNDims = 3\nDimSize = 32 32 20\nElementSpacing = 0.7 0.9 2.5\nOffset = 0 0 0\n"
    header += "TransformMatrix = 1 0 0 0 1 0 0 0 1\nElementType = MET_SHORT\nElementDataFile = ct.raw\n"
    path = zipped(tmp_path / "two.zip", {"x/ct.mhd": header.encode(), "x/ct.raw": (tmp_path / "ct.raw").read_bytes()})
    np.testing.assert_array_equal(open_volume(path).hu_zyx, chest())


@pytest.mark.parametrize("kind", PACKERS)
def test_member_names_cannot_leave_the_folder(tmp_path, scan, kind):
    names = ["../../evil", "/etc/evil", "..\\..\\evil", "C:\\evil", "a/../../evil", "\u0000evil", "."]
    evil = {name: scan["IM000"] for name in names if "\u0000" not in name or kind != "zip"}
    before = {path for path in tmp_path.rglob("*") if "temporary" not in path.parts}
    path = PACKERS[kind](tmp_path / "scan.bin", {**scan, **evil})
    volume = open_volume(path)
    np.testing.assert_array_equal(volume.hu_zyx, chest())
    assert {one for one in tmp_path.rglob("*") if "temporary" not in one.parts} == before | {path}


def test_links_and_devices_in_a_tar_archive_are_skipped(tmp_path, scan):
    path = tarred(tmp_path / "scan.tar", scan)
    with tarfile.open(path, "a") as archive:
        for name, kind in (("link", tarfile.SYMTYPE), ("hard", tarfile.LNKTYPE), ("null", tarfile.CHRTYPE)):
            member = tarfile.TarInfo(name)
            member.type, member.linkname = kind, "/etc/passwd"
            archive.addfile(member)
    np.testing.assert_array_equal(open_volume(path).hu_zyx, chest())


def test_archive_in_an_archive_opens_to_the_largest_depth(tmp_path, scan):
    path = zipped(tmp_path / "1.zip", scan)
    for level in range(2, 5):
        pack, name = (zipped, "inner.zip") if level % 2 else (tarred, "inner.zip")
        path = pack(tmp_path / f"{level}.bin", {f"disc/{name}": path.read_bytes()})
        if level <= archives.MAX_DEPTH:
            np.testing.assert_array_equal(open_volume(path).hu_zyx, chest())
    error = refusal(path)
    assert error.code == "import.archive.too-large"
    assert "levels deep" in str(error)


@pytest.mark.parametrize("kind", PACKERS)
def test_bomb_is_refused_before_it_fills_the_disk(tmp_path, scan, monkeypatch, kind):
    monkeypatch.setattr(archives, "FREE_OF_RATIO_BYTES", 1 << 20)
    if kind == "tar":
        monkeypatch.setattr(archives, "MAX_UNPACKED_BYTES", 4 << 20)
    path = PACKERS[kind](tmp_path / "bomb.bin", {**scan, "zeros": bytes(64 << 20)})
    error = refusal(path)
    assert error.code == "import.archive.too-large"
    assert "bomb.bin" in str(error)


def test_too_many_members_are_refused(tmp_path, scan, monkeypatch):
    monkeypatch.setattr(archives, "MAX_FILES", 15)
    for pack, name in ((zipped, "a.zip"), (tarred, "a.tar"), (seven_zipped, "a.7z")):
        assert refusal(pack(tmp_path / name, scan)).code == "import.archive.too-large"


def test_long_tar_header_is_refused_without_reading_it(tmp_path):
    member = tarfile.TarInfo("x")
    member.type, member.size = tarfile.XHDTYPE, 3 << 30
    path = tmp_path / "long.tar"
    path.write_bytes(member.tobuf() + bytes(1024))
    assert refusal(path).code == "import.archive.damaged"


def test_zip_with_a_password_is_refused_with_its_remedy(tmp_path, scan):
    path = zipped(tmp_path / "scan.zip", scan)
    data = bytearray(path.read_bytes())
    for sign, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = data.find(sign)
        while at >= 0:
            data[at + offset] |= 1
            at = data.find(sign, at + 4)
    path.write_bytes(data)
    error = refusal(path)
    assert error.code == "import.archive.encrypted"
    assert "password" in str(error)


def test_zip_with_an_unknown_method_is_refused(tmp_path, scan):
    path = zipped(tmp_path / "scan.zip", scan)
    data = bytearray(path.read_bytes())
    for sign, offset in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
        at = data.find(sign)
        struct.pack_into("<H", data, at + offset, 9)  # Deflate64
    path.write_bytes(data)
    assert refusal(path).code == "import.archive.not-supported"


@pytest.mark.parametrize("kind", PACKERS)
def test_truncated_archive_is_refused_and_never_opens_in_part(tmp_path, scan, kind):
    path = PACKERS[kind](tmp_path / "scan.bin", scan)
    whole = path.read_bytes()
    # The end of an uncompressed tar archive is padding.
    for share in (0.3, 0.6) if kind == "tar" else (0.3, 0.6, 0.9, 0.99):
        path.write_bytes(whole[: int(share * len(whole))])
        # The first block of a short bzip2 file is its only one, so its kind is unknown without it.
        assert refusal(path).code in ("import.archive.damaged", *(("import.not-an-image",) if "bz2" in kind else ()))


def test_tar_archive_that_is_cut_between_two_members_is_refused(tmp_path, scan):
    path = tarred(tmp_path / "scan.tar", scan)
    with tarfile.open(path) as archive:
        member = archive.getmembers()[12]
    path.write_bytes(path.read_bytes()[: member.offset])
    assert refusal(path).code == "import.archive.damaged"


def test_changed_byte_of_a_zip_archive_is_refused(tmp_path, scan):
    path = zipped(tmp_path / "scan.zip", scan)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(data)
    assert refusal(path).code == "import.archive.damaged"


def test_unsupported_archive_is_refused_with_its_remedy(tmp_path):
    path = tmp_path / "scan.bin"
    path.write_bytes(b"Rar!\x1a\x07\x00" + bytes(100))
    error = refusal(path)
    assert error.code == "import.archive.not-supported"
    assert "unpack it and open the folder" in str(error)


ENCRYPTED_CONTENT = (
    "N3q8ryccAARFmI7BeQAAAAAAAAAUAAAAAAAAAIHWvcobzDkm1mSEeKNOfjaZLw+kAQBkAQQGAAEJEAoBmfUJ+gAHCwEAAiQG8QcBElMPLrNe"
    "U+Ed8TkTTLOxWzJUgSEhARgBAAwIBAAICgHHp4s7AAAFARENAGEALgB0AHgAdAAAABQKAQDAnkk/yIDdARUGAQAggICBAAAAFwYQAQlpAAcL"
    "AQABISEBGAxlAAA="
)
ENCRYPTED_NAMES = (
    "N3q8ryccAASgewR+gAAAAAAAAAAoAAAAAAAAAHP3sHmNTAKpcwHpHm+4jNQJK+EYXFyCyzEekeF+QUSp1SZvH59h3pAyO8vYqvjTHKJaXxbV"
    "I5LlrTrK0jWO7ig226tjcpYO2GfMraqdtqaVvqFTlCTxXG7EiDec/C3+Xq6hUMx/Jn1sIEm82uHs+T0AKT7tW/yOG2QsQx/550vwgz9bbxcG"
    "EAEJcAAHCwEAASQG8QcBElMPuWxHFbxL1GVyTw36QinMngxlAAA="
)


@pytest.mark.parametrize("data", [ENCRYPTED_CONTENT, ENCRYPTED_NAMES], ids=["content", "names"])
def test_encrypted_7z_archive_is_refused_with_its_remedy(tmp_path, data):
    pytest.importorskip("libarchive", reason="needs the extra sevenzip")
    path = tmp_path / "scan.7z"
    path.write_bytes(base64.b64decode(data))
    error = refusal(path)
    assert error.code == "import.archive.encrypted"
    assert "unpack it with its password" in str(error)


def test_7z_archive_without_the_library_names_the_command(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "libarchive", None)
    path = tmp_path / "scan.7z"
    path.write_bytes(b"7z\xbc\xaf\x27\x1c" + bytes(100))
    error = refusal(path)
    assert error.code == "import.archive.not-supported"
    assert "libarchive-c" in str(error)
    assert "install" in str(error)


@pytest.mark.parametrize("at", [30, 32, 0.5, -20])
def test_changed_byte_of_a_7z_archive_is_refused(tmp_path, scan, at):
    path = seven_zipped(tmp_path / "scan.7z", scan)
    data = bytearray(path.read_bytes())
    data[int(at * len(data)) if isinstance(at, float) else at] ^= 0x10
    path.write_bytes(data)
    assert refusal(path).code in ("import.archive.damaged", "import.archive.not-supported")


def test_changed_voxel_of_an_uncompressed_7z_archive_is_refused(tmp_path, scan):
    """Only the checksum shows such a damage."""
    path = seven_zipped(tmp_path / "scan.7z", scan, options="compression=store")
    data = bytearray(path.read_bytes())
    at = data.find(next(iter(scan.values()))[-100:])
    assert at > 0
    data[at + 50] ^= 0x10
    path.write_bytes(data)
    assert refusal(path).code == "import.archive.damaged"


def test_archive_without_images_is_refused_by_its_name(tmp_path):
    error = refusal(zipped(tmp_path / "letters.zip", {"a.txt": b"hello"}))
    assert error.code == "import.no-images"
    assert "the archive letters.zip" in str(error)


@pytest.mark.parametrize("utf8", [True, False])
def test_messages_show_member_names_in_utf8_and_cp437(tmp_path, scan, utf8):
    names = {f"Schicht ä {index:03d}": content for index, content in enumerate(scan.values())}
    names["Schicht ä 004"] = names["Schicht ä 004"][:-100]
    path = tmp_path / "scan.zip"
    if utf8:
        zipped(path, names)
    else:
        zipped(path, {name.replace("ä", "?"): content for name, content in names.items()})
        path.write_bytes(path.read_bytes().replace(b"Schicht ?", "Schicht ä".encode("cp437")))
    error = refusal(path)
    assert error.code == "import.truncated"
    assert "Schicht ä 004" in str(error)


def test_names_in_utf8_without_the_mark_of_utf8_are_read_as_utf8(tmp_path, scan):
    path = zipped(tmp_path / "scan.zip", {f"Schicht ?? {n}": text for n, text in enumerate(scan.values()) if n != 7})
    path.write_bytes(path.read_bytes().replace(b"Schicht ?? 4", "Schicht ä 4".encode()))
    with zipfile.ZipFile(path) as archive:
        assert archives._zip_name(archive.infolist()[4]) == "Schicht ä 4"


def test_unusable_file_in_an_archive_is_named_by_its_original_name(tmp_path, scan):
    volume = open_volume(zipped(tmp_path / "scan.zip", {**scan, "IM020": b"", "notes.txt": b"hello", "._IM001": b"x"}))
    (note,) = volume.source.notes
    assert note.code == "import.files-unread"
    assert "IM020 (empty)" in note.words


def test_uids_of_member_names_are_not_shown(tmp_path, scan):
    files = {f"1.2.840.113619.2.55.{n}": content for n, content in enumerate(scan.values())}
    files["1.2.840.113619.2.55.20"] = b""
    volume = open_volume(zipped(tmp_path / "scan.zip", files))
    assert "1.2.840" not in " ".join(volume.source.warnings)


def test_cancel_stops_the_unpacking(tmp_path, scan):
    path = zipped(tmp_path / "scan.zip", scan)
    calls = []

    def cancel() -> bool:
        calls.append(1)
        return len(calls) > 5

    with pytest.raises(CancelledError):
        open_volume(path, cancel=cancel)


def test_progress_of_the_unpacking_is_reported(tmp_path, scan):
    shares = []
    open_volume(
        zipped(tmp_path / "scan.zip", scan),
        progress=lambda what, share: shares.append(share) if "Unpacking" in what else None,
    )
    assert shares == sorted(shares)
    assert shares[-1] > 0.8


def test_source_of_an_archive_is_its_file(tmp_path, scan):
    path = zipped(tmp_path / "scan.zip", scan)
    source = CtSource.of(path)
    assert source is not None
    assert (source.files.reads, source.files.num_files) == ("files", 1)
    path.write_bytes(path.read_bytes() + b"x")
    assert not source.is_unchanged


def directory_file(path: Path) -> Path:
    dataset = Dataset()
    dataset.file_meta = FileMetaDataset()
    dataset.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    dataset.file_meta.MediaStorageSOPClassUID = MediaStorageDirectoryStorage
    dataset.file_meta.MediaStorageSOPInstanceUID = "1.2.3"
    dataset.FileSetID = "DISC"
    dataset.save_as(path, enforce_file_format=True)
    return path


def test_directory_file_and_root_of_a_disc_open_the_scan(tmp_path):
    expected = open_volume(series(tmp_path / "disc" / "DICOM" / "ST0" / "SE0", name=lambda index: f"I{index}"))
    (tmp_path / "disc" / "autorun.inf").write_text("[autorun]")
    path = directory_file(tmp_path / "disc" / "DICOMDIR")
    for place in (path, path.parent):
        volume = open_volume(place)
        np.testing.assert_array_equal(volume.hu_zyx, expected.hu_zyx)
        assert volume.source.notes == ()
    source = CtSource.of(path)
    assert source is not None
    assert source.files.num_files == 22
    (tmp_path / "disc" / "DICOM" / "ST0" / "SE0" / "I3").unlink()
    assert not source.is_unchanged


def test_headers_and_skipped_members_of_a_tar_archive_count_as_unpacked_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(archives, "FREE_OF_RATIO_BYTES", 4 << 20)
    path = tmp_path / "headers.tar.gz"
    with tarfile.open(path, "w:gz", format=tarfile.PAX_FORMAT) as archive:
        for number in range(16):
            member = tarfile.TarInfo(f"folder {number}")
            member.type = tarfile.DIRTYPE
            member.pax_headers = {"comment": "x" * (1 << 19)}
            archive.addfile(member)
    assert refusal(path).code == "import.archive.too-large"


def test_headers_of_a_tar_archive_are_not_stored(tmp_path, scan, monkeypatch):
    stored = []
    member_after = tarfile.TarFile.next
    monkeypatch.setattr(
        tarfile.TarFile, "next", lambda archive: (stored.append(len(archive.members)), member_after(archive))[1]
    )
    open_volume(tarred(tmp_path / "scan.tar", scan))
    assert max(stored) <= 1


def test_tar_archive_with_a_long_chain_of_headers_is_refused(tmp_path):
    member = tarfile.TarInfo("general")
    member.type, member.size = tarfile.XGLTYPE, 15
    path = tmp_path / "chain.tar"
    path.write_bytes((member.tobuf() + b"15 comment=abc\n".ljust(512, b"\0")) * 3000 + bytes(1024))
    assert refusal(path).code == "import.archive.damaged"


def test_damaged_bzip2_data_is_not_reported_as_a_disk_error(tmp_path, scan):
    # The damage is behind the first block (900 kB), by which the archive is recognised.
    first = {"NOTES": np.random.default_rng(1).bytes(2_500_000)}
    path = tarred(tmp_path / "scan.tar.bz2", first | scan, "w:bz2")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    assert refusal(path).code == "import.archive.damaged"


def test_zip_of_a_newer_version_of_the_format_is_refused(tmp_path, scan):
    path = zipped(tmp_path / "scan.zip", scan)
    content = bytearray(path.read_bytes())
    content[content.find(b"PK\x01\x02") + 6] = 99
    path.write_bytes(content)
    assert refusal(path).code == "import.archive.not-supported"


def test_zip_archive_whose_directory_states_a_position_before_its_begin_is_damaged(tmp_path, scan):
    path = tmp_path / "scan.zip"
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in scan.items():
            archive.writestr(name, content)
    data = bytearray(path.read_bytes())
    at = data.rindex(b"PK\x05\x06")
    # The directory is stated to begin after its true position, so that all positions are moved before the file.
    data[at + 16 : at + 20] = (int.from_bytes(data[at + 16 : at + 20], "little") + 100_000).to_bytes(4, "little")
    path.write_bytes(data)
    with pytest.raises(VolumeImportError) as caught:
        open_volume(path)
    assert caught.value.code == "import.archive.damaged"
