"""Tests of case files after a killed process, a full disk or a power failure: all saved content is present."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import crashing_writer
import numpy as np
import pytest
from sample_case import ActiveCase, act, assert_same_moment, source_of

from carina.case import CaseFile, CaseFileError
from carina.errors import DiskError

HERE = Path(__file__).parent


@pytest.fixture
def active_case():
    active_case = ActiveCase()
    rng = np.random.default_rng(21)
    for name in ("target", "cut", "key"):
        act(active_case, name, lambda n: int(rng.integers(n)))
    return active_case


@pytest.fixture
def begun(active_case, tmp_path):
    with CaseFile.create(tmp_path / "one.carina", source_of(active_case.case)) as file:
        file.save(active_case.moment())
    return tmp_path / "one.carina"


class Killing:
    """Process that writes to a case and is killed repeatedly."""

    def __init__(self, active_case, folder):
        self.active_case, self.path = active_case, folder / "one.carina"
        np.save(folder / "ct.npy", active_case.case.volume.hu_zyx)
        np.save(folder / "lps_from_ijk.npy", active_case.case.volume.lps_from_ijk)
        paths = [str(HERE), str(HERE.parent / "track"), str(HERE.parent)]
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "crashing_writer.py"), str(folder), *paths],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def kill_once(self, seed, last):
        """Kill the writer after it has written the output line ``last``.

        Return the content before the writer's start, the number of the last action that was saved, and the number of
        the last action whose save began.
        """
        with CaseFile.open(self.path, read_only=True) as file:
            before = file.load(self.active_case.case.volume)
        self.process.stdin.write(f"{seed} {self.path}\n")
        self.process.stdin.flush()
        pid, saved, saving = None, 0, 0
        for line in self.process.stdout:
            what, _, rest = line.strip().partition(" ")
            assert what != "failed", rest
            if what == "gone":
                break
            if what == "pid":
                pid = int(rest)
            elif what == "saved":
                saved = int(rest)
            else:
                saving = int(rest)
            if pid is not None and what != "pid" and f"{what} {rest}" == last:
                os.kill(pid, signal.SIGKILL)
        return before, saved, saving

    def check(self, before, seed, saved, saving):
        """Assert that the file contains each confirmed save and no other action, and that it is writable."""
        with CaseFile.open(self.path) as file:
            found = file.load(self.active_case.case.volume)
            done = found.numbers.get("acts", 0)
            assert saved <= done <= saving
            again = ActiveCase.of(before, self.active_case.case)
            acts = crashing_writer.acts_of(seed)
            for n in range(done):
                name, number = next(acts)
                act(again, name, number)
                again.numbers["acts"] = n + 1
            assert_same_moment(found, again.moment(), self.active_case.case, deep=False)
            again.numbers["acts"] = 0
            file.save(again.moment())
        assert not list(self.path.parent.glob("*.carina-*"))

    def end(self):
        self.process.stdin.close()
        self.process.wait()
        self.process.stdout.close()


def kill_often(active_case, begun, times):
    killing = Killing(active_case, begun.parent)
    rng = np.random.default_rng(5)
    try:
        for seed in range(times):
            last = f"{('saving', 'saved')[rng.integers(2)]} {rng.integers(1, 12)}"
            before, saved, saving = killing.kill_once(seed, last)
            killing.check(before, seed, saved, saving)
    finally:
        killing.end()
    named = begun.with_name("named.carina")
    if named.exists():
        with CaseFile.open(named, read_only=True) as copy:
            copy.load(active_case.case.volume)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_writer_process_killed_a_dozen_times_loses_no_saved_action(active_case, begun):
    kill_often(active_case, begun, 12)


@pytest.mark.soak
@pytest.mark.skipif(not hasattr(os, "fork"), reason="forks")
def test_writer_process_killed_two_hundred_times_loses_no_saved_action(active_case, begun):
    kill_often(active_case, begun, 200)


def test_power_failure_at_any_byte_of_the_journal_restores_one_of_the_saved_states(active_case, begun, tmp_path):
    rng = np.random.default_rng(8)
    moments = [active_case.moment()]
    with CaseFile.open(begun) as file:
        file.load(active_case.case.volume)
        whole = begun.read_bytes()
        lengths = []
        for name in ("key", "look", "rename", "undo"):
            act(active_case, name, lambda n: int(rng.integers(n)))
            file.save(active_case.moment())
            moments.append(active_case.moment())
            lengths.append(begun.with_name("one.carina-wal").stat().st_size)
        journal = begun.with_name("one.carina-wal").read_bytes()
        assert begun.read_bytes() == whole, "all changes are still in the journal"
    taken = tmp_path / "taken.carina"
    for cut in [0, 31, *rng.integers(0, len(journal), 20), *lengths]:
        taken.write_bytes(whole)
        # The part of the journal that was not written to the disk may contain any bytes.
        rest = bytes(rng.integers(0, 256, 5000, dtype=np.uint8))
        taken.with_name("taken.carina-wal").write_bytes(journal[:cut] + rest)
        with CaseFile.open(taken) as file:
            found = file.load(active_case.case.volume)
        expected = moments[sum(length <= cut for length in lengths)]
        assert_same_moment(found, expected, active_case.case, deep=False)


def test_full_disk_is_reported_and_the_last_saved_state_remains_readable(active_case, begun, tmp_path):
    import resource

    rng = np.random.default_rng(9)
    before = active_case.moment()
    with CaseFile.open(begun) as file:
        file.load(active_case.case.volume)
        file.save(before)
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        for name in ("paint", "target", "key"):
            act(active_case, name, lambda n: int(rng.integers(n)))
        journal = begun.with_name("one.carina-wal")
        resource.setrlimit(resource.RLIMIT_FSIZE, (journal.stat().st_size + 6000, limits[1]))
        try:
            for _ in range(3):
                with pytest.raises(DiskError) as error:
                    file.save(active_case.moment())
                assert error.value.code in {"disk.full", "disk.failed"}
            with pytest.raises(DiskError):
                file.write_copy(tmp_path / "copy.carina")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert not (tmp_path / "copy.carina").exists()
        with CaseFile.open(begun, read_only=True) as seen:
            assert_same_moment(seen.load(active_case.case.volume), before, active_case.case, deep=False)
        # The disk has free space again.
        file.save(active_case.moment())
    with CaseFile.open(begun) as file:
        assert_same_moment(file.load(active_case.case.volume), active_case.moment(), active_case.case)


def test_save_to_a_read_only_case_file_is_reported(active_case, begun):
    begun.chmod(0o400)
    with CaseFile.open(begun, read_only=True) as file:
        file.load(active_case.case.volume)
        with pytest.raises(CaseFileError, match="open for reading only"):
            file.set_extra("plan", ())
    if os.geteuid() != 0:
        with pytest.raises(DiskError):
            CaseFile.open(begun)
    shutil.rmtree(begun.parent)
    with pytest.raises(DiskError, match="no such folder"):
        CaseFile.open(begun)
