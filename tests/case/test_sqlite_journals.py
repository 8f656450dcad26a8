"""Tests of SQLite journals beside a case file: they are checked before a copy or a replay."""

from __future__ import annotations

import os
import shutil
import signal
import sqlite3
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from sample_case import ActiveCase, assert_same_moment, source_of

from carina.case import CaseFile, CaseFileError, migrate, rescued, sqlite_journals
from carina.errors import DiskError
from carina.session import is_case_file

SPARSE_BYTES = 50 << 30


@pytest.fixture(scope="module")
def saved_case(tmp_path_factory):
    """Return the edited case, and a folder with its file closed and its file after a kill (with a journal)."""
    folder = tmp_path_factory.mktemp("made")
    active_case = ActiveCase()
    with CaseFile.create(folder / "live.carina", source_of(active_case.case)) as file:
        file.save(active_case.moment())
        for tail in ("", "-wal"):
            shutil.copy(folder / f"live.carina{tail}", folder / f"killed.carina{tail}")
    shutil.copy(folder / "live.carina", folder / "closed.carina")
    return active_case, folder


@pytest.fixture
def closed(saved_case, tmp_path):
    """Return the path of a closed case, without a journal."""
    return Path(shutil.copy(saved_case[1] / "closed.carina", tmp_path / "x.carina"))


@pytest.fixture
def killed(saved_case, tmp_path):
    """Return the path of a case file with the journal that a killed writer has left."""
    shutil.copy(saved_case[1] / "killed.carina-wal", tmp_path / "x.carina-wal")
    return Path(shutil.copy(saved_case[1] / "killed.carina", tmp_path / "x.carina"))


@pytest.fixture(autouse=True)
def ends():
    """Limit the time of a test, because a call that blocks on a pipe never returns."""
    if os.name != "posix":
        yield
        return

    def interrupt(*_arguments):
        raise TimeoutError("the call waits for a pipe")

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def openings(path):
    """Return a function for every way to open a case file."""
    return {
        "read": lambda: CaseFile.open(path, read_only=True),
        "write": lambda: CaseFile.open(path),
        "migrate": lambda: migrate(path, path.with_name("migrated.carina")),
        "rescue": lambda: rescued(path, path.with_name("rescued.carina")),
    }


def refusals(path):
    """Return the error of each way to open a case file, and assert that all files are unchanged."""
    before = {one.name: one.stat() for one in path.parent.iterdir()}
    found = []
    for how, opens in openings(path).items():
        with pytest.raises(CaseFileError) as refusal:
            opens()
        found.append((how, refusal.value))
    after = {one.name: one.stat() for one in path.parent.iterdir()}
    assert after.keys() == before.keys()
    assert all(after[name].st_mtime_ns == before[name].st_mtime_ns for name in before)
    return found


@pytest.mark.parametrize("tail", ["-wal", "-journal"])
def test_journal_file_of_50_gb_is_refused_before_anything_is_copied(closed, tail, monkeypatch):
    with closed.with_name(closed.name + tail).open("wb") as file:
        file.truncate(SPARSE_BYTES)
    monkeypatch.setattr(sqlite_journals, "_copy", lambda *_: pytest.fail("copied"))
    for _, error in refusals(closed):
        assert error.code == "case.damaged"
        assert f"x.carina{tail}" in str(error)
        assert "expected at most 17.2 GB, found 53.7 GB" in str(error)
        assert "move that file" in str(error)


def test_only_the_valid_frames_of_an_oversized_journal_are_copied(saved_case, killed, monkeypatch):
    journal = killed.with_name("x.carina-wal")
    used = journal.stat().st_size
    os.truncate(journal, 8 << 30)
    copied = {}
    copy = sqlite_journals._copy

    def measured(part, target, size):
        copied[part.name] = size
        copy(part, target, size)

    monkeypatch.setattr(sqlite_journals, "_copy", measured)
    with CaseFile.open(killed, read_only=True) as file:
        assert_same_moment(file.load(saved_case[0].case.volume), saved_case[0].moment(), saved_case[0].case)
    assert 0 < copied["x.carina-wal"] <= used


@pytest.mark.parametrize("tail", ["-wal", "-journal"])
@pytest.mark.parametrize("content", [b"a letter", b"a letter" * 100, b"\x7fELF" + bytes(5000)])
def test_invalid_journal_is_not_replayed_and_is_renamed(saved_case, closed, tail, content):
    other = closed.with_name(closed.name + tail)
    other.write_bytes(content)
    with CaseFile.open(closed, read_only=True) as file:
        assert_same_moment(file.load(saved_case[0].case.volume), saved_case[0].moment(), saved_case[0].case)
    assert other.read_bytes() == content
    for number in (1, 2):
        other.write_bytes(content)
        with CaseFile.open(closed) as file:
            assert_same_moment(file.load(saved_case[0].case.volume), saved_case[0].moment(), saved_case[0].case)
        assert other.with_name(f"{other.name}.not-a-journal-{number}").read_bytes() == content


@pytest.mark.parametrize("tail", ["-wal", "-journal"])
@pytest.mark.parametrize("size", [0, 512, 5000])
def test_case_with_an_empty_journal_or_a_journal_of_zeros_opens_with_all_its_content(saved_case, closed, tail, size):
    closed.with_name(closed.name + tail).write_bytes(bytes(size))
    for read_only in (True, False):
        with CaseFile.open(closed, read_only=read_only) as file:
            assert_same_moment(file.load(saved_case[0].case.volume), saved_case[0].moment(), saved_case[0].case)


def test_journal_that_names_the_file_of_another_database_is_refused(closed, tmp_path):
    # After a replay SQLite deletes the file whose name is at the end of a rollback journal.
    victim = tmp_path / "work.txt"
    victim.write_text("years of work")
    pages = closed.stat().st_size // 4096
    name = str(victim).encode()
    header = sqlite_journals.JOURNAL_MAGIC + struct.pack(">IIIII", 1, 7, pages, 512, 4096)
    page = closed.read_bytes()[:4096]
    record = (
        struct.pack(">I", 1) + page + struct.pack(">I", (7 + sum(page[n] for n in range(3896, 0, -200))) & 0xFFFFFFFF)
    )
    trailer = struct.pack(">I", 1 + (1 << 30) // 4096) + name + struct.pack(">II", len(name), sum(name))
    journal = closed.with_name("x.carina-journal")
    for head in (header, b"no header"):
        journal.write_bytes(head.ljust(512, b"\x00") + record + trailer + sqlite_journals.JOURNAL_MAGIC)
        for _, error in refusals(closed):
            assert error.code == "case.damaged"
            assert "names a file of another" in str(error)
    assert victim.read_text() == "years of work"


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
@pytest.mark.parametrize("tail", ["", "-wal", "-journal", "-shm"])
@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_pipe_or_device_with_the_name_of_a_case_or_its_journal_is_refused(closed, tail, kind):
    path = closed.with_name(closed.name + tail)
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    assert is_case_file(closed)
    for _, error in refusals(closed):
        assert error.code == "case.not-a-case"
        assert {"pipe": "a named pipe (FIFO)", "device": "a device"}[kind] in str(error)
        assert f"x.carina{tail}: expected a file" in str(error)


def test_folder_with_the_name_of_a_journal_is_refused(closed):
    closed.with_name("x.carina-wal").mkdir()
    for _, error in refusals(closed):
        assert "found a folder" in str(error)


def test_copy_of_a_case_larger_than_the_free_space_is_refused_before_it_is_made(killed, monkeypatch):
    usage = shutil.disk_usage

    def full(path):
        return usage(path)._replace(free=1000) if hasattr(usage(path), "_replace") else replace(usage(path), free=1000)

    monkeypatch.setattr(sqlite_journals.shutil, "disk_usage", full)
    monkeypatch.setattr(sqlite_journals, "_copy", lambda *_: pytest.fail("copied"))
    with pytest.raises(DiskError) as refusal:
        CaseFile.open(killed, read_only=True)
    assert refusal.value.code == "disk.full"


def test_case_file_that_is_too_large_to_copy_is_refused(killed, monkeypatch):
    monkeypatch.setattr(sqlite_journals, "MAX_CASE_BYTES", 10_000)
    for _, error in refusals(killed):
        assert "expected at most 10 kB with its journal" in str(error)


def test_rollback_journal_of_sqlite_is_accepted(saved_case, closed, tmp_path):
    # A killed writer leaves such a hot rollback journal.
    connection = sqlite3.connect(closed, isolation_level=None)
    connection.execute("PRAGMA journal_mode=DELETE")
    connection.execute("PRAGMA cache_size=1")
    connection.execute("BEGIN")
    connection.execute("UPDATE moment SET facts = facts || zeroblob(0)")
    connection.execute("CREATE TABLE more (x)")
    connection.executemany("INSERT INTO more VALUES (zeroblob(4000))", [()] * 40)
    hot = tmp_path / "hot"
    hot.mkdir()
    for tail in ("", "-journal"):
        shutil.copy(closed.with_name(closed.name + tail), hot / f"x.carina{tail}")
    connection.execute("ROLLBACK")
    connection.close()
    for read_only in (True, False):
        with CaseFile.open(hot / "x.carina", read_only=read_only) as file:
            assert_same_moment(file.load(saved_case[0].case.volume), saved_case[0].moment(), saved_case[0].case)
