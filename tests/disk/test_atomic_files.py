"""Tests of atomic file writing: files are complete or unchanged, abandoned drafts are deleted, errors have messages."""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import signal
import stat
import subprocess
import sys
import threading

import numpy as np
import pytest
import SimpleITK as sitk

from carina.disk import disk_trouble, drafted, make_folder, sweep_drafts, write_whole
from carina.disk.atomic_files import DRAFT, UNKNOWN_AFTER_S, Draft
from carina.errors import CarinaError, DiskError
from carina.volume import GRID_SUFFIXES, write_grid

pytestmark = pytest.mark.skipif(os.name != "posix", reason="limits and modes of POSIX")

WRITER = """
import sys
from pathlib import Path
from carina.disk import drafted
with drafted(Path(sys.argv[1]), what="the test") as file:
    file.write(b"half")
    file.flush()
    print("writing", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def small_files():
    """Limit the size of files to 4 kB during a test, which simulates a disk that becomes full within a file."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def writing(path):
    """Start another process that stops in the middle of writing a file."""
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "writing\n"
    return process


def ended(process):
    process.stdin.close()
    process.wait()
    process.stdout.close()


def test_written_file_is_replaced_completely_and_no_draft_file_remains(tmp_path):
    target = tmp_path / "a.txt"
    write_whole(target, b"old", what="the test")
    write_whole(target, b"new", what="the test")
    assert target.read_bytes() == b"new"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_killed_writer_leaves_the_old_file_and_the_next_write_deletes_its_draft_file(tmp_path):
    target = tmp_path / "Doe_John.nii.gz"
    target.write_bytes(b"old")
    process = writing(target)
    process.send_signal(signal.SIGKILL)
    ended(process)
    left = [p.name for p in tmp_path.iterdir() if p != target]
    assert len(left) == 1
    assert DRAFT.fullmatch(left[0])
    assert target.read_bytes() == b"old"
    assert sweep_drafts(tmp_path, now_s=0.0) == 1
    assert [p.name for p in tmp_path.iterdir()] == [target.name]


def test_draft_file_in_use_by_another_process_is_never_deleted(tmp_path):
    process = writing(tmp_path / "a.bin")
    try:
        assert sweep_drafts(tmp_path, now_s=1e12) == 0
    finally:
        ended(process)
    assert (tmp_path / "a.bin").read_bytes() == b"half"


def test_two_concurrent_writers_and_a_repeated_cleanup_of_drafts_leave_complete_files(tmp_path):
    stop = threading.Event()

    def sweep():
        while not stop.is_set():
            sweep_drafts(tmp_path, now_s=0.0)

    def write(content):
        for _ in range(150):
            write_whole(tmp_path / "a.bin", content, what="the test")

    sweeper = threading.Thread(target=sweep)
    writers = [threading.Thread(target=write, args=(bytes([n]) * 5000,)) for n in (1, 2)]
    sweeper.start()
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    stop.set()
    sweeper.join()
    assert (tmp_path / "a.bin").read_bytes() in (b"\x01" * 5000, b"\x02" * 5000)
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]


def test_files_named_similarly_to_drafts_are_not_deleted(tmp_path):
    (tmp_path / "victim").write_bytes(b"dear")
    name = ".carina-0123456789abcde{}.draft"
    (tmp_path / name.format(0)).symlink_to(tmp_path / "victim")
    os.mkfifo(tmp_path / name.format(1))
    (tmp_path / name.format(2)).mkdir()
    (tmp_path / "carina-0123456789abcdef.draft").write_bytes(b"a person's")
    before = sorted(p.name for p in tmp_path.iterdir())
    assert sweep_drafts(tmp_path, now_s=1e12) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == before
    assert (tmp_path / "victim").read_bytes() == b"dear"


def test_only_old_draft_files_are_deleted_if_locks_are_unavailable(tmp_path, monkeypatch):
    monkeypatch.setattr("carina.disk.atomic_files.try_lock", lambda _descriptor: None)
    draft = Draft(tmp_path / "a", what="the test")
    now_s = next(p for p in tmp_path.iterdir()).stat().st_mtime
    assert sweep_drafts(tmp_path, now_s=now_s + UNKNOWN_AFTER_S / 2) == 0
    draft.commit()
    left = tmp_path / ".carina-0123456789abcdef.draft"
    left.write_bytes(b"old")
    assert sweep_drafts(tmp_path, now_s=now_s + 2 * UNKNOWN_AFTER_S) == 1


def test_draft_file_deleted_by_another_program_is_reported(tmp_path):
    with (
        pytest.raises(DiskError, match=("another program removed its temporary file")),
        drafted(tmp_path / "a", what="the test"),
    ):
        next(tmp_path.iterdir()).unlink()


def test_replaced_file_retains_its_permissions_and_a_private_file_is_readable_by_its_owner_only(tmp_path):
    target = tmp_path / "a"
    target.write_bytes(b"old")
    target.chmod(0o640)
    write_whole(target, b"new", what="the test")
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    write_whole(tmp_path / "b", b"x", what="the test", private=True)
    assert stat.S_IMODE((tmp_path / "b").stat().st_mode) == 0o600


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such modes")
@pytest.mark.parametrize("lasting", [False, True])
def test_every_created_private_folder_has_mode_0700(tmp_path, lasting):
    before = os.umask(0o022)
    try:
        make_folder(tmp_path / "a" / "b" / "c", what="the test", private=True, lasting=lasting)
        make_folder(tmp_path / "d" / "e", what="the test", lasting=lasting)
    finally:
        os.umask(before)
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.rglob("*")}
    assert modes == {"a": 0o700, "b": 0o700, "c": 0o700, "d": 0o755, "e": 0o755}


def test_file_with_the_name_of_a_new_folder_is_refused_and_unchanged(tmp_path):
    (tmp_path / "a").write_bytes(b"x")
    for place in (tmp_path / "a", tmp_path / "a" / "b"):
        with pytest.raises(DiskError, match="cannot create the folder for the test"):
            make_folder(place, what="the test", private=True)
    assert (tmp_path / "a").read_bytes() == b"x"


@pytest.mark.parametrize("suffix", GRID_SUFFIXES)
def test_mask_written_to_a_full_disk_leaves_the_former_file_and_no_library_message(
    tmp_path, suffix, small_files, capfd
):
    target = tmp_path / f"mask{suffix}"
    target.write_bytes(b"old")
    noise = np.random.default_rng(1).integers(-1000, 1000, (20, 30, 40), dtype=np.int16)
    with pytest.raises(DiskError, match=r"cannot write the mask to .*the existing file is unchanged") as caught:
        write_grid(target, noise, np.eye(4), what="the mask")
    assert caught.value.code == "disk.full"
    assert target.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == [target.name]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("suffix", GRID_SUFFIXES)
@pytest.mark.parametrize("dtype", [np.uint8, np.int16])
def test_written_grid_is_read_equal_by_itk_in_every_format_and_direction(tmp_path, suffix, dtype, rng):
    for number in range(12):
        values = rng.integers(-1000 if dtype is np.int16 else 0, 250, (3, 4, 5)).astype(dtype)
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))  # The matrix may mirror.
        matrix = np.eye(4)
        matrix[:3, :3] = turn * np.array([0.5, 0.75, 1.25])
        matrix[:3, 3] = rng.uniform(-300, 300, 3)
        path = write_grid(tmp_path / f"{number}{suffix}", values, matrix, what="the grid")
        image = sitk.ReadImage(str(path))
        assert np.array_equal(sitk.GetArrayFromImage(image), values)
        assert sitk.GetArrayFromImage(image).dtype == dtype
        assert np.allclose(image.GetSpacing(), (0.5, 0.75, 1.25), atol=1e-6)
        assert np.allclose(image.GetOrigin(), matrix[:3, 3], atol=1e-4)
        assert np.allclose(np.reshape(image.GetDirection(), (3, 3)), turn, atol=1e-6)
        if suffix == ".nii":
            assert path.read_bytes() == itk_nifti(values, matrix, tmp_path, like=path.read_bytes())


def itk_nifti(values, matrix, folder, *, like):
    """Return the NIfTI file of ITK with rounding, signed zeros and names of the header taken from ``like``."""
    image = sitk.GetImageFromArray(values)
    spacing = np.linalg.norm(matrix[:3, :3], axis=0)
    image.SetSpacing(spacing.tolist())
    image.SetDirection((matrix[:3, :3] / spacing).ravel().tolist())
    image.SetOrigin(matrix[:3, 3].tolist())
    sitk.WriteImage(image, str(folder / "itk.nii"))
    theirs = (folder / "itk.nii").read_bytes()
    floats = slice(256, 328)  # quaternion, offset and matrix
    assert np.allclose(np.frombuffer(like[floats], "<f4"), np.frombuffer(theirs[floats], "<f4"), atol=1e-4)
    return theirs[:76] + like[76:92] + theirs[92:256] + like[256:328] + theirs[328:]


TROUBLES = [
    (errno.ENOSPC, "disk.full", "the disk is full"),
    (errno.EDQUOT, "disk.full", "quota"),
    (errno.EFBIG, "disk.full", "exceed the size limit"),
    (errno.EROFS, "disk.denied", "read-only"),
    (errno.EACCES, "disk.denied", "permission"),
    (errno.ENOENT, "disk.missing", "no such file or folder; check the path"),
    (errno.ENOTDIR, "disk.missing", "is a file, not a folder"),
    (errno.EISDIR, "disk.in-the-way", "already exists"),
    (errno.EIO, "disk.failed", "reported an error"),
    (errno.ENAMETOOLONG, "disk.failed", "too long"),
    (errno.EMFILE, "machine.files", "too many files"),
    (errno.ETIMEDOUT, "disk.failed", "timed out"),
]


@pytest.mark.parametrize(("number", "code", "text"), TROUBLES)
def test_each_disk_error_has_a_code_and_a_message(tmp_path, number, code, text):
    error = disk_trouble(
        OSError(number, os.strerror(number)), "cannot write the tree to", tmp_path / "t", needed_bytes=9
    )
    assert (error.code, error.errno, error.exit_code) == (code, number, 1)
    assert str(error).startswith(f"cannot write the tree to {tmp_path / 't'}: ")
    assert text in str(error)
    assert isinstance(error, OSError)
    assert isinstance(error, CarinaError)


def test_write_into_a_missing_folder_is_refused_with_the_name_of_the_folder(tmp_path):
    error = disk_trouble(OSError(errno.ENOENT, ""), "cannot write the tree to", tmp_path / "no" / "t")
    assert error.code == "disk.missing"
    assert "there is no such folder; create it, or choose another" in str(error)


def test_message_of_a_full_disk_states_needed_and_free_space(tmp_path):
    error = disk_trouble(OSError(errno.ENOSPC, ""), "cannot write the CT to", tmp_path, needed_bytes=3_200_000)
    assert "about 3.2 MB needed" in str(error)
    assert "free)" in str(error)


def test_write_to_a_folder_device_or_missing_folder_is_refused(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_bytes(b"")
    os.mkfifo(tmp_path / "pipe")
    for place, code in (
        ("folder", "disk.in-the-way"),
        ("pipe", "disk.in-the-way"),
        ("no/where", "disk.missing"),
        ("file/x", "disk.missing"),
        ("x" * 300, "disk.failed"),
    ):
        with pytest.raises(DiskError) as caught:
            write_whole(tmp_path / place, b"x", what="the test")
        assert caught.value.code == code, place
    with pytest.raises(DiskError):
        make_folder(tmp_path / "file" / "x", what="the test")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder", "pipe"]


@pytest.mark.parametrize("at_byte", [0, 1, 4095, 4096, 4097, 20_000])
def test_disk_that_becomes_full_at_any_byte_leaves_the_former_file(tmp_path, small_files, at_byte):
    target = tmp_path / "a"
    target.write_bytes(b"old")
    fits = at_byte <= 4096
    refused = pytest.raises(DiskError, match="the existing file is unchanged")
    with contextlib.nullcontext() if fits else refused, drafted(target, what="the test") as file:
        for start in range(0, at_byte, 1000):
            file.write(b"x" * min(1000, at_byte - start))
    assert target.read_bytes() == (b"x" * at_byte if fits else b"old")
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


@pytest.mark.parametrize("suffix", GRID_SUFFIXES)
def test_note_in_a_written_grid_file_is_read_by_itk(tmp_path, suffix):
    note = "2 branches drawn by hand:\n12 mm \u2192 of 300 mm"
    path = write_grid(tmp_path / f"a{suffix}", np.zeros((2, 3, 4), np.uint8), np.eye(4), what="the mask", note=note)
    image = sitk.ReadImage(str(path))
    line = "2 branches drawn by hand: 12 mm \u2192 of 300 mm"
    if ".nii" in suffix:
        assert image.GetMetaData("descrip").rstrip("\0") == line.replace("\u2192", "?")
    else:
        assert image.GetMetaData("note") == line
