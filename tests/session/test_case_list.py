"""Tests of the list of stored cases: entries, selection, new cases, names, deletion and restoring."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from carina import commands as c
from carina.errors import UsageError
from carina.session import ErrorEvent, JobEnded, LocalStore
from carina.session.store.registry import FORGOTTEN_FOR_S, CaseRecords
from carina.volume import Volume
from restartable_workstation import MemoryFile, RestartableWorkstation
from small_case import small_volume


@dataclass(frozen=True)
class Size:
    digest: str
    num_bytes: int


class Cache:
    """Replacement of the cache of CTs that stores volumes in memory."""

    def __init__(self) -> None:
        self.bytes_by_digest = {"one CT": 1000, "another CT": 2000}
        self.is_on, self.can_be_on = True, True

    def sizes(self) -> tuple[Size, ...]:
        return tuple(Size(*item) for item in self.bytes_by_digest.items())

    def forget(self, digest: str) -> int:
        return self.bytes_by_digest.pop(digest, 0)

    def empty(self) -> int:
        self.bytes_by_digest.clear()
        return 0

    def switch(self, on: bool) -> None:
        self.is_on = on
        if not on:
            self.empty()


class ListWorkstation(RestartableWorkstation):
    """Workstation with a cache of CTs, thumbnails, and the list of recently opened paths."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.cache = Cache()
        self.store = LocalStore(folder / "config")

    def file_functions(self, files):
        return replace(files, picture=lambda scene: b"\xff\xd8\xff" + bytes([scene.case_number]), cache=self.cache)

    def work(self, *fovs: float) -> None:
        for fov in fovs:
            self.session.do(c.SetFov(fov))
            self.clock.advance(5.0)
        self.saved()

    def listed(self):
        return self.session.cases.listed()

    def ended(self) -> str:
        return [e for e in self.events if isinstance(e, JobEnded)][-1].outcome


@pytest.fixture
def workstation(tmp_path):
    MemoryFile.contents.clear()
    workstation = ListWorkstation(tmp_path)
    workstation.start()
    yield workstation
    workstation.session.close()


def test_case_list_shows_number_of_changes_time_and_thumbnail_of_each_case(workstation):
    workstation.open()
    workstation.work(100.0, 90.0)
    workstation.session.do(c.CloseCase())
    workstation.digest = "another CT"
    workstation.wall.now_s += 60.0
    workstation.open("other")
    workstation.work(100.0)
    workstation.session.do(c.CloseCase())
    second, first = workstation.listed()
    assert (first.num_changes, second.num_changes) == (2, 1)
    assert second.used_s == first.used_s + 60.0
    assert first.recent_id != second.recent_id
    assert first.opens
    pictures = {workstation.session.cases.picture(one.recent_id) for one in (first, second)}
    assert len(pictures) == 2
    assert None not in pictures


@pytest.mark.skipif(os.name == "nt", reason="no modes there")
def test_thumbnail_file_of_a_case_is_readable_by_its_user_only(workstation, tmp_path):
    workstation.open()
    workstation.work(100.0)
    workstation.session.do(c.CloseCase())
    (path,) = (tmp_path / "cases").glob("*/picture.jpg")
    assert path.stat().st_mode & 0o777 == 0o600


def test_recent_ct_path_without_a_stored_case_is_listed_and_opens(workstation, tmp_path):
    workstation.store.remember(str(tmp_path / "old"), "2026-01-31")
    (old,) = workstation.listed()
    assert old.num_changes is None
    workstation.session.do(c.OpenRecent(old.recent_id))
    workstation.background.run_all()
    workstation.work(100.0)
    (joined,) = workstation.listed()
    assert joined.num_changes == 1
    workstation.session.do(c.CloseCase())
    workstation.session.do(c.ForgetCase(joined.recent_id))
    assert workstation.listed() == ()


def test_recent_ct_path_that_no_longer_exists_is_removed_from_the_list(workstation, tmp_path):
    workstation.store.remember(str(tmp_path / "old"), "2026-01-31")
    workstation.session.do(c.ForgetCase(workstation.listed()[0].recent_id))
    assert workstation.listed() == ()
    assert workstation.session.cases.storage().forgotten == ()


def test_selected_case_opens_if_two_cases_have_the_same_ct(workstation):
    workstation.open()
    workstation.work(100.0)
    workstation.session.do(c.BeginAnew())
    workstation.background.run_all()
    assert workstation.session.history() == ()
    assert workstation.session.snapshot().saving.continued_s is None
    workstation.wall.now_s += 60.0
    workstation.work(80.0, 70.0)
    workstation.session.do(c.CloseCase())
    new, old = workstation.listed()
    assert (new.num_changes, old.num_changes) == (2, 1)
    workstation.session.do(c.OpenRecent(old.recent_id))
    workstation.background.run_all()
    assert workstation.session.snapshot().document.look.fov_deg == 100.0
    saving = workstation.session.snapshot().saving
    assert (saving.continued_s, saving.continued_changes) == (old.used_s, 1)


def test_another_ct_at_the_path_of_a_case_is_refused_and_the_open_case_stays_open(workstation):
    workstation.open()
    workstation.work(100.0)
    workstation.session.do(c.CloseCase())
    (expected,) = workstation.listed()
    workstation.digest = "another CT"
    workstation.wall.now_s += 60.0
    workstation.open("other")
    workstation.work(90.0)
    workstation.session.do(c.OpenRecent(expected.recent_id))
    workstation.background.run_all()
    assert [e.code for e in workstation.events if isinstance(e, ErrorEvent)] == ["case.other-ct"]
    assert workstation.session.snapshot().document.look.fov_deg == 90.0
    workstation.work(85.0)
    workstation.session.do(c.CloseCase())
    assert [one.num_changes for one in workstation.listed()] == [2, 1]


def test_case_of_a_dropped_ct_requests_the_ct_again_when_it_is_opened(workstation):
    workstation.session.do(c.OpenFiles("dropped"))
    workstation.background.run_all()
    workstation.work(100.0)
    workstation.session.do(c.CloseCase())
    (dropped,) = workstation.listed()
    assert not dropped.opens
    with pytest.raises(UsageError, match="drop the CT here or choose it to continue"):
        workstation.session.do(c.OpenRecent(dropped.recent_id))
    workstation.session.do(c.OpenFiles("dropped again"))
    workstation.background.run_all()
    assert workstation.session.snapshot().document.look.fov_deg == 100.0


def test_case_list_shows_the_scan_date_and_adds_it_to_records_without_one(workstation):
    """Use records without a scan date: of earlier versions, and of a scan that has no date."""
    workstation.open()
    workstation.work(100.0)
    workstation.session.do(c.CloseCase())
    assert [one.scanned_on for one in workstation.listed()] == [None]
    made = small_volume()
    dated = Volume(made.hu_zyx, made.lps_from_ijk, source=replace(made.source, acquired_on="2021-05-03"))
    workstation.session.do(c.OpenVolume(dated))
    workstation.background.run_all()
    workstation.session.do(c.CloseCase())
    assert [one.scanned_on for one in workstation.listed()] == ["2021-05-03"]
    workstation.open()
    workstation.work(90.0)
    workstation.session.do(c.CloseCase())
    assert [one.scanned_on for one in workstation.listed()] == ["2021-05-03"], "an equal CT in a file without a date"
    workstation.digest = "another CT"
    workstation.session.do(c.OpenVolume(dated))
    workstation.background.run_all()
    workstation.work(100.0)
    workstation.session.do(c.CloseCase())
    assert [one.scanned_on for one in workstation.listed()] == ["2021-05-03"] * 2, "a new record contains the date"


def test_case_is_renamed_while_open_and_after_closing(workstation):
    workstation.open()
    workstation.work(100.0)
    (listed,) = workstation.listed()
    series = listed.title
    workstation.session.do(c.RenameCase(listed.recent_id, "Nodule in RB4"))
    assert workstation.session.snapshot().saving.title == "Nodule in RB4"
    workstation.work(90.0)
    workstation.session.do(c.CloseCase())
    assert (workstation.listed()[0].title, workstation.listed()[0].named) == ("Nodule in RB4", True)
    workstation.session.do(c.RenameCase(listed.recent_id, "RB4"))
    workstation.open()
    assert workstation.session.snapshot().saving.title == "RB4"
    workstation.session.do(c.CloseCase())
    workstation.session.do(c.RenameCase(listed.recent_id, None))
    assert (workstation.listed()[0].title, workstation.listed()[0].named) == (series, False)
    with pytest.raises(UsageError, match="no longer in the list"):
        workstation.session.do(c.RenameCase("nothing", "x"))


def test_deleted_case_that_is_restored_has_all_its_content(workstation):
    workstation.open()
    workstation.work(100.0)
    (listed,) = workstation.listed()
    with pytest.raises(UsageError, match="close it"):
        workstation.session.do(c.ForgetCase(listed.recent_id))
    workstation.session.do(c.CloseCase())
    (listed,) = workstation.listed()
    workstation.session.do(c.ForgetCase(listed.recent_id))
    assert workstation.listed() == ()
    assert set(workstation.cache.bytes_by_digest) == {"another CT"}
    (forgotten,) = workstation.session.cases.storage().forgotten
    assert forgotten.recent_id == listed.recent_id
    assert workstation.session.cases.picture(forgotten.recent_id) is not None
    workstation.session.do(c.RestoreCase(listed.recent_id))
    assert workstation.listed() == (listed,)
    workstation.session.do(c.OpenRecent(listed.recent_id))
    workstation.background.run_all()
    assert workstation.session.snapshot().document.look.fov_deg == 100.0


def test_ct_stays_cached_while_another_case_uses_it(workstation):
    workstation.open()
    workstation.work(100.0)
    workstation.session.do(c.BeginAnew())
    workstation.background.run_all()
    workstation.work(80.0)
    workstation.session.do(c.CloseCase())
    for one in workstation.listed():
        assert "one CT" in workstation.cache.bytes_by_digest
        workstation.session.do(c.ForgetCase(one.recent_id))
    assert "one CT" not in workstation.cache.bytes_by_digest


def test_start_removes_only_cases_that_were_deleted_a_day_ago(workstation, tmp_path):
    workstation.open()
    workstation.work(100.0)
    workstation.session.do(c.CloseCase())
    workstation.digest = "another CT"
    workstation.open("other")
    workstation.work(100.0)
    workstation.session.do(c.CloseCase())
    workstation.session.do(c.ForgetCase(workstation.listed()[0].recent_id))
    records = CaseRecords(tmp_path / "cases", workstation.wall)
    workstation.wall.now_s += FORGOTTEN_FOR_S - 1.0
    assert records.empty_forgotten(FORGOTTEN_FOR_S) == 0
    workstation.wall.now_s += 1.0
    assert records.empty_forgotten(FORGOTTEN_FOR_S) == 1
    assert records.forgotten() == ()
    assert len(records.all()) == 1


def test_permanently_deleted_case_cannot_be_restored(workstation, tmp_path):
    workstation.open()
    workstation.work(100.0)
    workstation.session.do(c.CloseCase())
    (listed,) = workstation.listed()
    workstation.session.do(c.ForgetCase(listed.recent_id))
    workstation.session.do(c.EmptyForgotten())
    assert list((tmp_path / "cases" / ".forgotten").iterdir()) == []
    with pytest.raises(UsageError, match="permanently deleted"):
        workstation.session.do(c.RestoreCase(listed.recent_id))


def test_ct_cache_size_is_reported_and_the_cache_can_be_emptied_and_disabled_for_later_sessions(workstation):
    storage = workstation.session.cases.storage()
    assert (storage.num_cts, storage.ct_bytes, storage.keeps_cts) == (2, 3000, "on")
    workstation.session.do(c.EmptyCtCache())
    assert workstation.session.cases.storage().num_cts == 0
    workstation.session.do(c.KeepCts(False))
    assert workstation.session.cases.storage().keeps_cts == "off"
    workstation.session.close()
    workstation.cache = Cache()
    workstation.start()
    assert not workstation.cache.is_on
    workstation.session.do(c.KeepCts(True))
    assert workstation.cache.is_on
    workstation.cache.is_on = workstation.cache.can_be_on = False
    assert workstation.session.cases.storage().keeps_cts == "never"
    with pytest.raises(UsageError, match="without the CT cache"):
        workstation.session.do(c.KeepCts(True))


def test_case_record_that_names_another_folder_is_ignored(tmp_path):
    records = CaseRecords(tmp_path, lambda: 1_800_000_000.0)
    held = records.begin("one CT", None)
    held.release()
    path = held.folder / "record.json"
    path.write_text(path.read_text().replace(held.record.case_id, "../elsewhere"))
    assert records.all() == ()
