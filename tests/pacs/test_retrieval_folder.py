"""Tests of the folder of a retrieval: its lock, completeness by the files on the disk, and deletion."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from carina.disk.locks import lock_file
from carina.errors import PacsError, UsageError
from carina.pacs.retrieval_folder import RetrievalFolder, delete_retrieved

SERIES, A, B = "1.2.3", "1.2.3.1", "1.2.3.2"


def test_second_job_for_a_folder_is_refused_and_the_images_of_the_first_stay(tmp_path):
    with RetrievalFolder(tmp_path / "scan", SERIES) as first:
        first.add(A, b"a")
        with (
            pytest.raises(PacsError, match="another job of Carina") as found,
            RetrievalFolder(tmp_path / "scan", SERIES),
        ):
            pass
        assert found.value.code == "pacs.busy"
        first.add(B, b"b")
        first.complete([A, B])
    assert len(list((tmp_path / "scan").iterdir())) == 2
    assert list(tmp_path.iterdir()) == [tmp_path / "scan"]


def test_lock_of_another_process_refuses_the_job_until_that_process_ends(tmp_path):
    script = (
        "import pathlib, sys\n"
        "from carina.pacs.retrieval_folder import RetrievalFolder\n"
        f"with RetrievalFolder(pathlib.Path({str(tmp_path)!r}) / 'scan', {SERIES!r}) as folder:\n"
        f"    folder.add({A!r}, b'a')\n"
        "    print('held', flush=True)\n"
        "    sys.stdin.read()\n"
    )
    other = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    try:
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(PacsError) as found, RetrievalFolder(tmp_path / "scan", SERIES):
            pass
        assert found.value.code == "pacs.busy"
    finally:
        other.kill()
        other.communicate(timeout=60)
    with RetrievalFolder(tmp_path / "scan", SERIES) as again:
        assert A in again


def test_series_is_incomplete_if_a_file_has_left_the_disk(tmp_path):
    with RetrievalFolder(tmp_path / "scan", SERIES) as folder:
        folder.add(A, b"a")
        folder.add(B, b"b")
        next(tmp_path.glob(".scan.*/*.dcm")).unlink()
        with pytest.raises(PacsError, match="1 of 2 images did not arrive") as found:
            folder.complete([A, B])
    assert found.value.code == "pacs.incomplete"
    assert not (tmp_path / "scan").exists()


def test_hidden_folder_with_images_stays_and_an_empty_one_is_removed(tmp_path):
    with RetrievalFolder(tmp_path / "scan", SERIES):
        pass
    assert list(tmp_path.iterdir()) == []
    with RetrievalFolder(tmp_path / "scan", SERIES) as folder:
        folder.add(A, b"a")
        folder._names.clear()  # the disk decides, not this memory
    with RetrievalFolder(tmp_path / "scan", SERIES) as folder:
        assert A in folder


def test_unfinished_files_of_a_crash_are_not_in_the_complete_folder(tmp_path):
    with RetrievalFolder(tmp_path / "scan", SERIES) as folder:
        folder.add(A, b"a")
        (next(tmp_path.glob(".scan.*.incomplete")) / ".carina-0.draft").write_bytes(b"half")
        folder.complete([A])
    assert len(list((tmp_path / "scan").iterdir())) == 1


def test_existing_folder_is_refused_and_its_lock_is_released(tmp_path):
    (tmp_path / "scan").mkdir()
    for _ in range(2):
        with pytest.raises(UsageError) as found, RetrievalFolder(tmp_path / "scan", SERIES):
            pass
        assert found.value.code == "pacs.folder"
    assert list(tmp_path.iterdir()) == [tmp_path / "scan"]


@pytest.mark.skipif(os.name == "nt", reason="Windows needs a privilege for links")
def test_link_to_a_folder_is_not_replaced(tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "scan").symlink_to(tmp_path / "other")
    with pytest.raises(UsageError), RetrievalFolder(tmp_path / "scan", SERIES, replaces=True):
        pass


def test_all_series_are_deleted_complete_or_not(tmp_path):
    with RetrievalFolder(tmp_path / "series-a", SERIES) as folder:
        folder.add(A, b"a")
        folder.complete([A])
    with RetrievalFolder(tmp_path / "series-b", SERIES) as folder:
        folder.add(A, b"a")
    (tmp_path / ".series-c.lock").touch()  # of a crash
    checks = []
    delete_retrieved(tmp_path, lambda: checks.append(1))
    assert list(tmp_path.iterdir()) == []
    assert len(checks) == 3
    delete_retrieved(tmp_path / "missing", checks.clear)


def test_series_that_is_being_retrieved_is_not_deleted(tmp_path):
    with RetrievalFolder(tmp_path / "series-a", SERIES) as folder:
        folder.add(A, b"a")
        with pytest.raises(PacsError) as found:
            delete_retrieved(tmp_path, lambda: None)
        assert found.value.code == "pacs.busy"
        folder.complete([A])


def test_no_series_is_deleted_while_a_job_uses_them(tmp_path):
    with RetrievalFolder(tmp_path / "series-a", SERIES) as folder:
        folder.add(A, b"a")
        folder.complete([A])

    def refuse():
        raise UsageError("in use", code="pacs.in-use")

    with pytest.raises(UsageError):
        delete_retrieved(tmp_path, refuse)
    assert list(tmp_path.iterdir()) == [tmp_path / "series-a"]


def test_lock_file_is_deleted_after_the_block_and_excludes_a_second_block(tmp_path):
    path = tmp_path / "lock"
    with lock_file(path) as held:
        assert held
        with lock_file(path) as second:
            assert not second
        assert path.exists()
    assert not path.exists()
    with lock_file(path) as held:
        assert held
