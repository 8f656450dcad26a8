"""Tests of temporary folders: private, deleted even after kill -9, and never confused with those of other programs."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from carina.disk import ScratchFolder, sweep_scratch
from carina.disk.temporary_folders import LOCK, OLD_AFTER_S, PREFIX
from carina.errors import DiskError
from carina.server.files.uploads import Uploads

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills and modes of POSIX")

UPLOAD = """
import asyncio, sys
from carina.server.files.uploads import Uploads

async def body():
    yield b"the patient's scan"
    print("writing", flush=True)
    sys.stdin.read()

uploads = Uploads()
asyncio.run(uploads.add(uploads.begin(), "Doe^John.dcm", body()))
"""


HOLD = """
import sys
from carina.disk import ScratchFolder
(ScratchFolder().path / "file").write_bytes(b"1")
print("writing", flush=True)
sys.stdin.read()
"""


def uploading(folder, script=HOLD):
    """Start another Carina process that uses a temporary folder until it is ended."""
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        env={**os.environ, "TMPDIR": str(folder)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "writing\n"
    return process


def ended(process):
    process.stdin.close()
    process.wait()
    process.stdout.close()


@pytest.fixture
def temp(tmp_path, monkeypatch):
    """Return an empty folder that replaces the system's temporary folder."""
    folder = tmp_path / "temp"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def test_upload_of_a_killed_process_is_removed_by_the_next_process_and_its_name_is_not_on_disk(temp):
    process = uploading(temp, UPLOAD)
    names = [p.name for p in temp.rglob("*")]
    assert len(names) > 3
    assert not any("Doe" in name or "John" in name for name in names)
    assert {stat.S_IMODE(p.stat().st_mode) for p in temp.rglob("*") if p.is_dir()} == {0o700}
    assert {stat.S_IMODE(p.stat().st_mode) for p in temp.rglob("*") if p.is_file()} == {0o600}
    # A folder in use by another process is not deleted.
    assert sweep_scratch(temp, now_s=1e12) == 0
    process.send_signal(signal.SIGKILL)
    ended(process)
    assert [p.name for p in temp.rglob("*")] == names
    assert sweep_scratch(temp) == 1
    assert list(temp.iterdir()) == []


def test_only_the_temporary_folder_of_the_running_process_remains(temp):
    processes = [uploading(temp) for _ in range(6)]
    for process in processes[1:]:
        process.send_signal(signal.SIGKILL)
        ended(process)
    assert sweep_scratch(temp) == 5
    assert len(list(temp.iterdir())) == 1
    ended(processes[0])
    assert list(temp.iterdir()) == []


def test_cleanup_of_temporary_folders_by_two_processes_that_start_together_has_no_error(temp):
    left = [uploading(temp) for _ in range(4)]
    for process in left:
        process.send_signal(signal.SIGKILL)
        ended(process)
    sweep = "from carina.disk import sweep_scratch; print(sweep_scratch())"
    environment = {**os.environ, "TMPDIR": str(temp)}
    starting = [
        subprocess.Popen([sys.executable, "-c", sweep], env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    counts = [int(process.communicate()[0]) for process in starting]
    assert [process.returncode for process in starting] == [0] * 4
    assert sum(counts) == 4
    assert list(temp.iterdir()) == []


def test_links_files_and_folders_of_other_programs_are_not_deleted(temp, tmp_path, monkeypatch):
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / LOCK).touch()
    (victim / "dear").write_bytes(b"1")
    (temp / f"{PREFIX}abcdefgh").symlink_to(victim)
    # The locks are a symbolic link and a pipe; opening the pipe would block.
    linked, piped = temp / f"{PREFIX}linkedlo", temp / f"{PREFIX}pipedloc"
    for folder in (linked, piped):
        folder.mkdir()
    (linked / LOCK).symlink_to(victim / "dear")
    os.mkfifo(piped / LOCK)
    (temp / f"{PREFIX}afileeee").write_bytes(b"")
    (temp / "carina-releases").mkdir()
    (temp / "carina-releases" / "notes.txt").write_bytes(b"a person's own")
    before = sorted(p.name for p in temp.iterdir())
    assert sweep_scratch(temp, now_s=1e12) == 0
    assert sorted(p.name for p in temp.iterdir()) == before
    assert (victim / "dear").read_bytes() == b"1"
    # The folder belongs to another user, and its lock is free.
    foreign = temp / f"{PREFIX}foreign0"
    foreign.mkdir()
    (foreign / LOCK).touch()
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert sweep_scratch(temp, now_s=1e12) == 0
    monkeypatch.undo()
    assert sweep_scratch(temp) == 1


def test_links_in_an_abandoned_temporary_folder_are_removed_and_not_followed(temp, tmp_path):
    (tmp_path / "victim").mkdir()
    (tmp_path / "victim" / "dear").write_bytes(b"1")
    folder = temp / f"{PREFIX}abcdefgh"
    (folder / "upload").mkdir(parents=True)
    (folder / LOCK).touch()
    (folder / "link").symlink_to(tmp_path / "victim")
    (folder / "upload" / "link").symlink_to(tmp_path / "victim")
    assert sweep_scratch(temp) == 1
    assert (tmp_path / "victim" / "dear").read_bytes() == b"1"


def test_temporary_folders_of_older_versions_are_removed_after_a_day(temp):
    for name in ("carina-upload-abcdefgh", "carina-download-abcdefgh", f"{PREFIX}nolock00", "carina-abcdefgh"):
        (temp / name).mkdir()
        (temp / name / "pixels.dcm").write_bytes(b"1")
    now_s = temp.stat().st_mtime
    assert sweep_scratch(temp, now_s=now_s + OLD_AFTER_S / 2) == 0
    assert sweep_scratch(temp, now_s=now_s + OLD_AFTER_S + 10) == 4
    assert list(temp.iterdir()) == []


def test_temporary_folder_deleted_by_another_program_is_created_again(temp):
    first = ScratchFolder()
    for path in sorted(first.path.parent.rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    first.path.parent.rmdir()
    second = ScratchFolder()
    assert second.path.is_dir()
    first.remove()
    second.remove()


def test_upload_is_refused_with_a_message_if_the_temporary_folder_is_read_only(tmp_path, monkeypatch):
    (tmp_path / "file").write_bytes(b"")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "file"))
    monkeypatch.setattr("carina.disk.temporary_folders._Root._path", None)
    with pytest.raises(DiskError, match="the files dropped on the window could not be stored"):
        Uploads().begin()
    assert sweep_scratch(Path(tmp_path / "nowhere")) == 0
