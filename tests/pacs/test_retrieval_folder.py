"""Tests of the folder of a retrieval: its lock, completeness by the files on the disk, and deletion."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from pathlib import Path

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


def _replaced(tmp_path):
    """Retrieve series A, add files of the user to its folder, and return the folder."""
    target = tmp_path / "scan"
    with RetrievalFolder(target, SERIES) as folder:
        folder.add(A, b"a")
        folder.complete([A])
    (target / "notes.txt").write_text("mine")
    (target / "drawings").mkdir()
    (target / "drawings" / "plan.txt").write_text("mine too")
    return target


def _retrieve_again(target):
    with RetrievalFolder(target, SERIES, replaces=True) as folder:
        for uid, content in ((A, b"a2"), (B, b"b")):
            folder.add(uid, content)
        folder.complete([A, B])


class Crash(BaseException):
    """End of the process, after which nothing on the disk changes."""


def _crash_at(monkeypatch, step):
    """Let the change of the folder with this number, and all later ones, raise Crash; return the count of changes."""
    counted = []
    for name in ("rename", "unlink", "rmdir"):
        original = getattr(Path, name)

        def changed(path, *arguments, original=original, **options):
            if path.suffix != ".lock":
                counted.append(path)
                if len(counted) > step:
                    raise Crash
            return original(path, *arguments, **options)

        monkeypatch.setattr(Path, name, changed)
    return counted


def _contents(folder):
    return sorted(path.read_bytes() for path in folder.rglob("*") if path.is_file())


def test_files_of_the_user_survive_a_crash_at_each_step_of_a_replacement(tmp_path, monkeypatch):
    for step in range(99):
        parent = tmp_path / str(step)
        parent.mkdir()
        target = _replaced(parent)
        with monkeypatch.context() as patch:
            counted = _crash_at(patch, step)
            with contextlib.suppress(Crash):
                _retrieve_again(target)
        crashed = len(counted) > step
        assert {b"mine", b"mine too"} <= set(_contents(parent))
        # The next use restores the folder, also if it retrieves nothing.
        with pytest.raises(UsageError), RetrievalFolder(target, SERIES):
            pass
        found = _contents(target)
        assert found in ([b"a", b"mine", b"mine too"], [b"a2", b"b", b"mine", b"mine too"]), step
        _retrieve_again(target)
        assert _contents(target) == [b"a2", b"b", b"mine", b"mine too"]
        assert list(parent.iterdir()) == [target]
        if not crashed:
            break
    assert step > 5


def test_second_crash_and_a_new_file_of_the_same_name_lose_no_file(tmp_path, monkeypatch):
    target = _replaced(tmp_path)
    # The crash comes after the new folder has its name, before the files of the user are in it.
    with monkeypatch.context() as patch:
        _crash_at(patch, 2)
        with pytest.raises(Crash):
            _retrieve_again(target)
    (target / "notes.txt").write_text("newer")
    _retrieve_again(target)
    assert _contents(target) == [b"a2", b"b", b"mine", b"mine too", b"newer"]
    assert list(tmp_path.iterdir()) == [target]


def test_deletion_of_all_series_leaves_files_of_the_user(tmp_path, monkeypatch):
    target = _replaced(tmp_path)
    (tmp_path / "list.txt").write_text("a list")
    with monkeypatch.context() as patch:
        _crash_at(patch, 1)
        with pytest.raises(Crash):
            _retrieve_again(target)
    delete_retrieved(tmp_path, lambda: None)
    assert _contents(tmp_path) == [b"a list", b"mine", b"mine too"]
    assert sorted(tmp_path.iterdir()) == [tmp_path / "list.txt", target]


def test_hidden_folders_of_long_names_differ_and_fit_into_a_file_name(tmp_path):
    first, second = (tmp_path / ("肺" * 70 + end) for end in ("a" * 40, "b" * 40))
    for target, uid in ((first, A), (second, B)):
        with RetrievalFolder(target, SERIES) as folder:
            folder.add(uid, uid.encode())
            folder.complete([uid])
    assert [_contents(target) for target in (first, second)] == [[A.encode()], [B.encode()]]
    delete_retrieved(tmp_path, lambda: None)
    assert list(tmp_path.iterdir()) == []
