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
from restartable_workstation import Desk, MemoryFile
from small_case import small_volume


@dataclass(frozen=True)
class Size:
    digest: str
    num_bytes: int


class Cache:
    """Replacement of the cache of CTs that stores volumes in memory."""

    def __init__(self) -> None:
        self.kept = {"one CT": 1000, "another CT": 2000}
        self.is_on, self.can_be_on = True, True

    def sizes(self) -> tuple[Size, ...]:
        return tuple(Size(*item) for item in self.kept.items())

    def forget(self, digest: str) -> int:
        return self.kept.pop(digest, 0)

    def empty(self) -> int:
        self.kept.clear()
        return 0

    def switch(self, on: bool) -> None:
        self.is_on = on
        if not on:
            self.empty()


class ListDesk(Desk):
    """Workstation with a cache of CTs, thumbnails, and the list of recently opened paths."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.cache = Cache()
        self.store = LocalStore(folder / "config")

    def kept_files(self, files):
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
def desk(tmp_path):
    MemoryFile.kept.clear()
    desk = ListDesk(tmp_path)
    desk.start()
    yield desk
    desk.session.close()


def test_case_list_shows_number_of_changes_time_and_thumbnail_of_each_case(desk):
    desk.open()
    desk.work(100.0, 90.0)
    desk.session.do(c.CloseCase())
    desk.digest = "another CT"
    desk.wall.now_s += 60.0
    desk.open("other")
    desk.work(100.0)
    desk.session.do(c.CloseCase())
    second, first = desk.listed()
    assert (first.num_changes, second.num_changes) == (2, 1)
    assert second.used_s == first.used_s + 60.0
    assert first.recent_id != second.recent_id
    assert first.opens
    pictures = {desk.session.cases.picture(one.recent_id) for one in (first, second)}
    assert len(pictures) == 2
    assert None not in pictures


@pytest.mark.skipif(os.name == "nt", reason="no modes there")
def test_thumbnail_file_of_a_case_is_readable_by_its_user_only(desk, tmp_path):
    desk.open()
    desk.work(100.0)
    desk.session.do(c.CloseCase())
    (path,) = (tmp_path / "cases").glob("*/picture.jpg")
    assert path.stat().st_mode & 0o777 == 0o600


def test_recent_ct_path_without_a_stored_case_is_listed_and_opens(desk, tmp_path):
    desk.store.remember(str(tmp_path / "old"), "2026-01-31")
    (old,) = desk.listed()
    assert old.num_changes is None
    desk.session.do(c.OpenRecent(old.recent_id))
    desk.background.run_all()
    desk.work(100.0)
    (joined,) = desk.listed()
    assert joined.num_changes == 1
    desk.session.do(c.CloseCase())
    desk.session.do(c.ForgetCase(joined.recent_id))
    assert desk.listed() == ()


def test_recent_ct_path_that_no_longer_exists_is_removed_from_the_list(desk, tmp_path):
    desk.store.remember(str(tmp_path / "old"), "2026-01-31")
    desk.session.do(c.ForgetCase(desk.listed()[0].recent_id))
    assert desk.listed() == ()
    assert desk.session.cases.storage().forgotten == ()


def test_selected_case_opens_if_two_cases_have_the_same_ct(desk):
    desk.open()
    desk.work(100.0)
    desk.session.do(c.BeginAnew())
    desk.background.run_all()
    assert desk.session.history() == ()
    assert desk.session.snapshot().saving.continued_s is None
    desk.wall.now_s += 60.0
    desk.work(80.0, 70.0)
    desk.session.do(c.CloseCase())
    new, old = desk.listed()
    assert (new.num_changes, old.num_changes) == (2, 1)
    desk.session.do(c.OpenRecent(old.recent_id))
    desk.background.run_all()
    assert desk.session.snapshot().document.look.fov_deg == 100.0
    saving = desk.session.snapshot().saving
    assert (saving.continued_s, saving.continued_changes) == (old.used_s, 1)


def test_another_ct_at_the_path_of_a_case_is_refused_and_the_open_case_stays_open(desk):
    desk.open()
    desk.work(100.0)
    desk.session.do(c.CloseCase())
    (expected,) = desk.listed()
    desk.digest = "another CT"
    desk.wall.now_s += 60.0
    desk.open("other")
    desk.work(90.0)
    desk.session.do(c.OpenRecent(expected.recent_id))
    desk.background.run_all()
    assert [e.code for e in desk.events if isinstance(e, ErrorEvent)] == ["case.other-ct"]
    assert desk.session.snapshot().document.look.fov_deg == 90.0
    desk.work(85.0)
    desk.session.do(c.CloseCase())
    assert [one.num_changes for one in desk.listed()] == [2, 1]


def test_case_of_a_dropped_ct_requests_the_ct_again_when_it_is_opened(desk):
    desk.session.do(c.OpenFiles("dropped"))
    desk.background.run_all()
    desk.work(100.0)
    desk.session.do(c.CloseCase())
    (dropped,) = desk.listed()
    assert not dropped.opens
    with pytest.raises(UsageError, match="drop the CT here or choose it to continue"):
        desk.session.do(c.OpenRecent(dropped.recent_id))
    desk.session.do(c.OpenFiles("dropped again"))
    desk.background.run_all()
    assert desk.session.snapshot().document.look.fov_deg == 100.0


def test_case_list_shows_the_scan_date_and_adds_it_to_records_without_one(desk):
    """Use records without a scan date: of earlier versions, and of a scan that has no date."""
    desk.open()
    desk.work(100.0)
    desk.session.do(c.CloseCase())
    assert [one.scanned_on for one in desk.listed()] == [None]
    made = small_volume()
    dated = Volume(made.hu_zyx, made.lps_from_ijk, source=replace(made.source, acquired_on="2021-05-03"))
    desk.session.do(c.OpenVolume(dated))
    desk.background.run_all()
    desk.session.do(c.CloseCase())
    assert [one.scanned_on for one in desk.listed()] == ["2021-05-03"]
    desk.open()
    desk.work(90.0)
    desk.session.do(c.CloseCase())
    assert [one.scanned_on for one in desk.listed()] == ["2021-05-03"], "the same CT in a file without a date"
    desk.digest = "another CT"
    desk.session.do(c.OpenVolume(dated))
    desk.background.run_all()
    desk.work(100.0)
    desk.session.do(c.CloseCase())
    assert [one.scanned_on for one in desk.listed()] == ["2021-05-03"] * 2, "a new one has it from the beginning"


def test_case_is_renamed_while_open_and_after_closing(desk):
    desk.open()
    desk.work(100.0)
    (listed,) = desk.listed()
    series = listed.title
    desk.session.do(c.RenameCase(listed.recent_id, "Nodule in RB4"))
    assert desk.session.snapshot().saving.title == "Nodule in RB4"
    desk.work(90.0)
    desk.session.do(c.CloseCase())
    assert (desk.listed()[0].title, desk.listed()[0].named) == ("Nodule in RB4", True)
    desk.session.do(c.RenameCase(listed.recent_id, "RB4"))
    desk.open()
    assert desk.session.snapshot().saving.title == "RB4"
    desk.session.do(c.CloseCase())
    desk.session.do(c.RenameCase(listed.recent_id, None))
    assert (desk.listed()[0].title, desk.listed()[0].named) == (series, False)
    with pytest.raises(UsageError, match="no longer in the list"):
        desk.session.do(c.RenameCase("nothing", "x"))


def test_deleted_case_that_is_restored_has_all_its_content(desk):
    desk.open()
    desk.work(100.0)
    (listed,) = desk.listed()
    with pytest.raises(UsageError, match="close it"):
        desk.session.do(c.ForgetCase(listed.recent_id))
    desk.session.do(c.CloseCase())
    (listed,) = desk.listed()
    desk.session.do(c.ForgetCase(listed.recent_id))
    assert desk.listed() == ()
    assert set(desk.cache.kept) == {"another CT"}
    (forgotten,) = desk.session.cases.storage().forgotten
    assert forgotten.recent_id == listed.recent_id
    assert desk.session.cases.picture(forgotten.recent_id) is not None
    desk.session.do(c.RestoreCase(listed.recent_id))
    assert desk.listed() == (listed,)
    desk.session.do(c.OpenRecent(listed.recent_id))
    desk.background.run_all()
    assert desk.session.snapshot().document.look.fov_deg == 100.0


def test_ct_stays_cached_while_another_case_uses_it(desk):
    desk.open()
    desk.work(100.0)
    desk.session.do(c.BeginAnew())
    desk.background.run_all()
    desk.work(80.0)
    desk.session.do(c.CloseCase())
    for one in desk.listed():
        assert "one CT" in desk.cache.kept
        desk.session.do(c.ForgetCase(one.recent_id))
    assert "one CT" not in desk.cache.kept


def test_start_removes_only_cases_that_were_deleted_a_day_ago(desk, tmp_path):
    desk.open()
    desk.work(100.0)
    desk.session.do(c.CloseCase())
    desk.digest = "another CT"
    desk.open("other")
    desk.work(100.0)
    desk.session.do(c.CloseCase())
    desk.session.do(c.ForgetCase(desk.listed()[0].recent_id))
    records = CaseRecords(tmp_path / "cases", desk.wall)
    desk.wall.now_s += FORGOTTEN_FOR_S - 1.0
    assert records.empty_forgotten(FORGOTTEN_FOR_S) == 0
    desk.wall.now_s += 1.0
    assert records.empty_forgotten(FORGOTTEN_FOR_S) == 1
    assert records.forgotten() == ()
    assert len(records.all()) == 1


def test_permanently_deleted_case_cannot_be_restored(desk, tmp_path):
    desk.open()
    desk.work(100.0)
    desk.session.do(c.CloseCase())
    (listed,) = desk.listed()
    desk.session.do(c.ForgetCase(listed.recent_id))
    desk.session.do(c.EmptyForgotten())
    assert list((tmp_path / "cases" / ".forgotten").iterdir()) == []
    with pytest.raises(UsageError, match="permanently deleted"):
        desk.session.do(c.RestoreCase(listed.recent_id))


def test_ct_cache_size_is_reported_and_the_cache_can_be_emptied_and_disabled_for_later_sessions(desk):
    storage = desk.session.cases.storage()
    assert (storage.num_cts, storage.ct_bytes, storage.keeps_cts) == (2, 3000, "on")
    desk.session.do(c.EmptyCtCache())
    assert desk.session.cases.storage().num_cts == 0
    desk.session.do(c.KeepCts(False))
    assert desk.session.cases.storage().keeps_cts == "off"
    desk.session.close()
    desk.cache = Cache()
    desk.start()
    assert not desk.cache.is_on
    desk.session.do(c.KeepCts(True))
    assert desk.cache.is_on
    desk.cache.is_on = desk.cache.can_be_on = False
    assert desk.session.cases.storage().keeps_cts == "never"
    with pytest.raises(UsageError, match="without the CT cache"):
        desk.session.do(c.KeepCts(True))


def test_case_record_that_names_another_folder_is_ignored(tmp_path):
    records = CaseRecords(tmp_path, lambda: 1_800_000_000.0)
    held = records.begin("one CT", None)
    held.release()
    path = held.folder / "record.json"
    path.write_text(path.read_text().replace(held.record.case_id, "../elsewhere"))
    assert records.all() == ()
