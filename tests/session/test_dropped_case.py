"""Tests of dropped case files, which have no path: a copy is opened, or waits in the list until its CT is opened."""

from __future__ import annotations

import itertools
import sqlite3

import pytest

from cached_test_data import cached_phantom
from carina import commands as c
from carina.case import CaseFile
from carina.session import ErrorEvent, UserMessage, case_files
from carina.session.attach.select import program_session
from carina.session.store.case_names import neutral_alias
from carina.session.store.registry import CaseRecords
from carina.volume import write_grid


def write_ct(path, volume):
    write_grid(path, volume.hu_zyx, volume.lps_from_ijk, what="the phantom")
    return path


@pytest.fixture(scope="module")
def chest():
    return cached_phantom(spacing_mm=3.0, generations=3).volume


class RestartableWorkstation:
    """Workstation of one user, started with the user's stored cases or without any."""

    def __init__(self, folder):
        times = itertools.count(1_800_000_000)
        self.records = CaseRecords(folder / "cases", lambda: float(next(times)))
        self.session = program_session(records=self.records, files=case_files(None, self.records))
        self.events = []
        self.session.subscribe(self.events.append)

    def do(self, *commands):
        for command in commands:
            self.session.do(command)
            self.session.jobs.wait_idle(None)

    def drop(self, path):
        self.events.clear()
        self.do(c.OpenFiles(str(path)))
        return [event.code for event in self.events if isinstance(event, ErrorEvent)]

    def steps(self):
        return list(self.session.history())

    def worked_on(self):
        return [record for record in self.records.all() if record.num_changes]

    def messages(self):
        return " ".join(event.message for event in self.events if isinstance(event, UserMessage))


@pytest.fixture
def workstations(tmp_path):
    """Return two workstations, each with the stored cases of one user."""
    made = [RestartableWorkstation(tmp_path / name) for name in ("mine", "theirs")]
    yield made
    for workstation in made:
        workstation.session.close()


@pytest.fixture
def given(workstations, chest, tmp_path):
    """Return a case file with two steps, which one user made for the other."""
    mine, _ = workstations
    mine.do(
        c.OpenPath(str(write_ct(tmp_path / "ct.nii.gz", chest))),
        c.SetFov(80.0),
        c.SetOutline("none"),
        c.SaveCase(str(tmp_path / "given.carina")),
    )
    assert len(mine.steps()) == 2
    return tmp_path / "given.carina"


def test_dropped_case_file_whose_ct_is_open_opens_as_a_copy_without_a_path(workstations, given, chest, tmp_path):
    _, workstation = workstations
    workstation.do(c.OpenPath(str(write_ct(tmp_path / "their ct.nii.gz", chest))))
    before = given.read_bytes()
    assert workstation.drop(given) == []
    assert len(workstation.steps()) == 2
    saving = workstation.session.snapshot().saving
    assert (saving.copy_name, saving.copied_s, saving.problem) == (None, None, None)
    workstation.do(c.SetFov(70.0), c.CloseCase())
    assert given.read_bytes() == before, "no file is recorded as a copy"
    (record,) = workstation.worked_on()
    assert (record.copy_path, record.num_changes) == (None, 3)


def test_dropped_case_file_without_its_ct_is_listed_and_requests_the_ct_once(workstations, given, chest, tmp_path):
    _, workstation = workstations
    (tmp_path / "ct.nii.gz").unlink()
    for _ in range(2):
        assert workstation.drop(given) == ["case.no-ct"]
    given.unlink()
    (waiting,) = workstation.session.cases.listed()
    assert (waiting.opens, waiting.num_changes, waiting.title) == (False, 2, neutral_alias(waiting.recent_id))
    other = cached_phantom(spacing_mm=3.0, generations=4).volume
    workstation.events.clear()
    workstation.do(c.OpenPath(str(write_ct(tmp_path / "other.nii.gz", other))))
    assert "not the CT of the case that you dropped" in workstation.messages()
    assert workstation.steps() == []
    # The CT is also dropped, so it has no path.
    workstation.do(c.OpenFiles(str(write_ct(tmp_path / "their.nii.gz", chest))))
    assert len(workstation.steps()) == 2
    workstation.do(c.CloseCase())
    (listed,) = (one for one in workstation.session.cases.listed() if one.recent_id == waiting.recent_id)
    assert listed.title == waiting.title, "the name of the dropped file is not stored"


def test_stored_case_that_contains_later_changes_of_the_dropped_case_file_is_shown(workstations, given):
    mine, _ = workstations
    mine.do(c.SetFov(70.0), c.CloseCase())
    assert mine.drop(given) == []
    assert len(mine.steps()) == 3
    assert len(mine.records.all()) == 1
    assert mine.session.snapshot().saving.copy_name == "given.carina", "at the path that the user selected"


def test_dropped_case_file_that_contains_its_ct_opens_and_opens_again_from_the_list(
    workstations, given, chest, tmp_path
):
    _, workstation = workstations
    (tmp_path / "ct.nii.gz").unlink()
    with CaseFile.open(given, read_only=True) as case:
        case.write_copy(tmp_path / "packed.carina", volume=chest)
    assert workstation.drop(tmp_path / "packed.carina") == []
    assert len(workstation.steps()) == 2
    (tmp_path / "packed.carina").unlink()
    workstation.do(c.CloseCase())
    (listed,) = workstation.session.cases.listed()
    assert listed.opens
    workstation.do(c.OpenRecent(listed.recent_id))
    assert len(workstation.steps()) == 2


def test_damaged_or_foreign_dropped_file_is_refused_and_leaves_no_file(workstations, given, chest, tmp_path):
    _, workstation = workstations
    workstation.do(c.OpenPath(str(write_ct(tmp_path / "their ct.nii.gz", chest))))
    strange = tmp_path / "strange.carina"
    strange.write_bytes(b"not a case" * 1000)
    with sqlite3.connect(given) as file:
        file.execute("UPDATE tile SET data = zeroblob(length(data))")
    file.close()
    for path in (strange, given):
        (code,) = workstation.drop(path)
        assert code.startswith("case.")
        assert code != "case.no-ct"
    assert workstation.session.snapshot().case.volume.hu_zyx.shape == chest.hu_zyx.shape, "the case on screen stays"
    assert workstation.worked_on() == []


def test_dropped_case_file_of_a_newer_carina_is_shown_and_not_stored(workstations, given, chest, tmp_path):
    _, workstation = workstations
    with sqlite3.connect(given) as file:
        file.execute("PRAGMA user_version = 1000")
    file.close()
    (tmp_path / "ct.nii.gz").unlink()
    assert workstation.drop(given) == ["case.no-ct"]
    assert workstation.session.cases.listed() == ()
    workstation.do(c.OpenPath(str(write_ct(tmp_path / "their ct.nii.gz", chest))))
    assert workstation.drop(given) == []
    assert len(workstation.steps()) == 2
    assert "newer" in workstation.messages()
    assert workstation.worked_on() == []
