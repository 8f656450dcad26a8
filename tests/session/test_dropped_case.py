"""Tests of dropped case files, which have no path: a copy is opened, or waits in the list until its CT is opened."""

from __future__ import annotations

import itertools
import sqlite3

import pytest

from cached_test_data import made_phantom
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
    return made_phantom(spacing_mm=3.0, generations=3).volume


class Desk:
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

    def said(self):
        return " ".join(event.message for event in self.events if isinstance(event, UserMessage))


@pytest.fixture
def desks(tmp_path):
    """Return two workstations, each with the stored cases of one user."""
    made = [Desk(tmp_path / name) for name in ("mine", "theirs")]
    yield made
    for desk in made:
        desk.session.close()


@pytest.fixture
def given(desks, chest, tmp_path):
    """Return a case file with two steps, which one user made for the other."""
    mine, _ = desks
    mine.do(
        c.OpenPath(str(write_ct(tmp_path / "ct.nii.gz", chest))),
        c.SetFov(80.0),
        c.SetOutline("none"),
        c.SaveCase(str(tmp_path / "given.carina")),
    )
    assert len(mine.steps()) == 2
    return tmp_path / "given.carina"


def test_dropped_case_file_whose_ct_is_open_opens_as_a_copy_without_a_path(desks, given, chest, tmp_path):
    _, desk = desks
    desk.do(c.OpenPath(str(write_ct(tmp_path / "their ct.nii.gz", chest))))
    before = given.read_bytes()
    assert desk.drop(given) == []
    assert len(desk.steps()) == 2
    saving = desk.session.snapshot().saving
    assert (saving.copy_name, saving.copied_s, saving.problem) == (None, None, None)
    desk.do(c.SetFov(70.0), c.CloseCase())
    assert given.read_bytes() == before, "it is nobody's copy"
    (record,) = desk.worked_on()
    assert (record.copy_path, record.num_changes) == (None, 3)


def test_dropped_case_file_without_its_ct_is_listed_and_requests_the_ct_once(desks, given, chest, tmp_path):
    _, desk = desks
    (tmp_path / "ct.nii.gz").unlink()
    for _ in range(2):
        assert desk.drop(given) == ["case.no-ct"]
    given.unlink()
    (waiting,) = desk.session.cases.listed()
    assert (waiting.opens, waiting.num_changes, waiting.title) == (False, 2, neutral_alias(waiting.recent_id))
    other = made_phantom(spacing_mm=3.0, generations=4).volume
    desk.events.clear()
    desk.do(c.OpenPath(str(write_ct(tmp_path / "other.nii.gz", other))))
    assert "not the CT of the case that you dropped" in desk.said()
    assert desk.steps() == []
    # The CT is also dropped, so it has no path.
    desk.do(c.OpenFiles(str(write_ct(tmp_path / "their.nii.gz", chest))))
    assert len(desk.steps()) == 2
    desk.do(c.CloseCase())
    (listed,) = (one for one in desk.session.cases.listed() if one.recent_id == waiting.recent_id)
    assert listed.title == waiting.title, "the name of the dropped file is not stored"


def test_stored_case_that_contains_later_changes_of_the_dropped_case_file_is_shown(desks, given):
    mine, _ = desks
    mine.do(c.SetFov(70.0), c.CloseCase())
    assert mine.drop(given) == []
    assert len(mine.steps()) == 3
    assert len(mine.records.all()) == 1
    assert mine.session.snapshot().saving.copy_name == "given.carina", "where its person put it"


def test_dropped_case_file_that_contains_its_ct_opens_and_opens_again_from_the_list(desks, given, chest, tmp_path):
    _, desk = desks
    (tmp_path / "ct.nii.gz").unlink()
    with CaseFile.open(given, read_only=True) as case:
        case.write_copy(tmp_path / "packed.carina", volume=chest)
    assert desk.drop(tmp_path / "packed.carina") == []
    assert len(desk.steps()) == 2
    (tmp_path / "packed.carina").unlink()
    desk.do(c.CloseCase())
    (listed,) = desk.session.cases.listed()
    assert listed.opens
    desk.do(c.OpenRecent(listed.recent_id))
    assert len(desk.steps()) == 2


def test_damaged_or_foreign_dropped_file_is_refused_and_leaves_no_file(desks, given, chest, tmp_path):
    _, desk = desks
    desk.do(c.OpenPath(str(write_ct(tmp_path / "their ct.nii.gz", chest))))
    strange = tmp_path / "strange.carina"
    strange.write_bytes(b"not a case" * 1000)
    with sqlite3.connect(given) as file:
        file.execute("UPDATE tile SET data = zeroblob(length(data))")
    file.close()
    for path in (strange, given):
        (code,) = desk.drop(path)
        assert code.startswith("case.")
        assert code != "case.no-ct"
    assert desk.session.snapshot().case.volume.hu_zyx.shape == chest.hu_zyx.shape, "the case on screen stays"
    assert desk.worked_on() == []


def test_dropped_case_file_of_a_newer_carina_is_shown_and_not_stored(desks, given, chest, tmp_path):
    _, desk = desks
    with sqlite3.connect(given) as file:
        file.execute("PRAGMA user_version = 1000")
    file.close()
    (tmp_path / "ct.nii.gz").unlink()
    assert desk.drop(given) == ["case.no-ct"]
    assert desk.session.cases.listed() == ()
    desk.do(c.OpenPath(str(write_ct(tmp_path / "their ct.nii.gz", chest))))
    assert desk.drop(given) == []
    assert len(desk.steps()) == 2
    assert "newer" in desk.said()
    assert desk.worked_on() == []
