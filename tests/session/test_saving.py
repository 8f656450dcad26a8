"""Tests of automatic saving of an open case: at most two seconds late, and restored unchanged at the next opening."""

from __future__ import annotations

import errno
import os
import threading
from dataclasses import replace
from typing import Any

import pytest

from carina import commands as c
from carina.case.recordings import RecordingFacts
from carina.errors import CarinaError, UsageError
from carina.session import ErrorEvent, Session, UserMessage
from carina.session.saving.writer import CaseSaver
from carina.session.store.named_file import NamedFile
from carina.session.store.registry import CaseRecords, LockedCase
from restartable_workstation import WAIT_S, MemoryFile, RestartableWorkstation
from small_case import LEFT_TIP, Background


@pytest.fixture
def workstation(tmp_path):
    MemoryFile.contents.clear()
    return RestartableWorkstation(tmp_path)


def shown(session: Session) -> tuple[Any, ...]:
    snapshot, pose = session.snapshot(), session.pose_info()
    assert pose is not None
    return (
        snapshot.document,
        snapshot.sight,
        snapshot.undo_label,
        snapshot.redo_label,
        snapshot.mode,
        snapshot.airways,
        snapshot.airways_words,
        pose.pose.lps_from_camera.tolist(),
        pose.path_mm,
    )


def work(session: Session, background: Background) -> None:
    session.do(c.AddTarget(LEFT_TIP))
    background.run_all()
    session.do(c.SetFov(100.0))
    session.do(c.SetShading(False))
    session.do(c.EditKeyFrames(c.KeyFrameAdd()))
    session.do(c.SetOutline("octagon"))
    session.do(c.Undo())
    session.do(c.GoTo(12.0))


def test_reopened_case_is_restored_without_an_airway_search(workstation):
    session = workstation.start()
    workstation.open()
    work(session, workstation.background)
    before = shown(session)
    session.close()
    again = workstation.start()
    workstation.open()
    assert shown(again) == before
    again.do(c.Redo())
    assert again.snapshot().document.look.outline == "octagon"
    assert again.history()[-1] == "image outline"
    again.do(c.AddTarget(LEFT_TIP))
    workstation.background.run_all()
    assert again.snapshot().document.targets[-1].name == "Target 2"


def test_changes_written_before_a_crash_are_restored(workstation):
    session = workstation.start()
    workstation.open()
    work(session, workstation.background)
    workstation.saved()
    before = shown(session)
    session.do(c.SetFov(90.0))
    workstation.kill()
    again = workstation.start()
    workstation.open()
    assert shown(again) == before


def test_second_workstation_does_not_write_into_a_case_that_is_open(workstation, tmp_path):
    workstation.start()
    workstation.open()
    workstation.session.do(c.SetFov(100.0))
    workstation.saved()
    other = RestartableWorkstation(tmp_path)
    other.start()
    other.open()
    assert other.session.snapshot().document.look.fov_deg == 120.0
    assert any("another window" in e.message for e in other.events if isinstance(e, UserMessage))
    other.session.do(c.SetFov(80.0))
    other.saved()
    assert len(list((tmp_path / "cases").glob("*/record.json"))) == 2
    other.session.close()
    workstation.session.close()


def test_changes_of_one_ct_are_not_shown_for_another_ct_and_not_lost(workstation):
    session = workstation.start()
    workstation.open()
    work(session, workstation.background)
    session.close()
    workstation.digest = "another CT"
    again = workstation.start()
    workstation.open()
    assert again.history() == ()
    again.do(c.SetFov(100.0))
    again.close()
    assert len(MemoryFile.contents) == 2


def test_changes_of_a_ct_are_restored_if_the_ct_was_moved(workstation):
    session = workstation.start()
    workstation.session.do(c.OpenFiles("dropped"))
    workstation.background.run_all()
    session.do(c.SetFov(100.0))
    assert session.snapshot().saving.keeps
    session.close()
    again = workstation.start()
    workstation.open("elsewhere")
    assert again.snapshot().document.look.fov_deg == 100.0
    again.close()


def test_unreadable_stored_case_is_reported_and_left_unchanged(workstation):
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(100.0))
    session.close()
    (path,) = MemoryFile.contents
    again = workstation.start()
    MemoryFile.contents[path] = ("one CT", None)
    workstation.open()
    assert again.history() == ()
    (error,) = [e for e in workstation.events if isinstance(e, ErrorEvent)]
    assert error.code == "case.unreadable"
    assert path in error.message
    again.close()


def test_unreadable_case_file_is_unchanged_after_a_failed_opening(workstation, monkeypatch):
    """Check that the shown case continues as another case, and that file and record of the first case stay."""
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(100.0))
    workstation.saved()
    case_id = session._saving.open_case[0]
    session.do(c.RenameCase(case_id, "mine"))
    workstation.saved()
    live = session._saving.records.live_path(case_id)
    live.write_text("its flights")
    record = live.with_name("record.json").read_bytes()

    def fails(*_arguments, **_options):
        raise CarinaError("the disk reported an error", code="disk.failed")

    readable = session._saving._files
    session._saving._files = replace(readable, open=fails)
    with monkeypatch.context() as patched:
        patched.setattr("carina.session.cases.opening.new_case", fails)
        workstation.open("another")
    session._saving._files = readable
    session.do(c.SetFov(90.0))
    workstation.saved()
    assert session._saving.open_case[0] != case_id
    assert (live.read_text(), live.with_name("record.json").read_bytes()) == ("its flights", record)
    session.close()


def test_changes_are_stored_after_a_failed_opening_if_the_disk_does_not_return_the_case(workstation, monkeypatch):
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(100.0))
    workstation.saved()

    def fails(*_arguments, **_options):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patched:
        patched.setattr("carina.session.cases.opening.new_case", fails)
        patched.setattr(CaseRecords, "hold", fails)
        workstation.open("another")
    session.do(c.SetFov(90.0))
    workstation.saved()
    assert session.snapshot().saving.keeps
    assert {moment.steps[-1].document.look.fov_deg for _, moment in MemoryFile.contents.values()} == {100.0, 90.0}
    session.close()


def test_full_disk_is_reported_and_the_session_continues_until_space_is_available(workstation):
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(100.0))
    workstation.saved()
    saved_s = session.snapshot().saving.saved_s
    assert saved_s == workstation.wall.now_s
    workstation.wall.now_s += 60.0
    workstation.files[-1].refuses = OSError(28, "No space left on device")
    session.do(c.SetFov(90.0))
    assert not session._saving.write_now()
    saving = session.snapshot().saving
    assert "full" in saving.problem or "space" in saving.problem
    assert saving.saved_s == saved_s
    session.do(c.SetFov(85.0))
    workstation.files[-1].refuses = None
    assert session._saving.write_now()
    assert session.snapshot().saving.problem is None
    session.close()
    again = workstation.start()
    workstation.open()
    assert again.snapshot().document.look.fov_deg == 85.0


def test_case_is_saved_under_a_name_and_the_named_file_is_updated_later(workstation, tmp_path):
    session = workstation.start()
    workstation.open()
    with pytest.raises(UsageError, match="choose a folder and a name"):
        session.do(c.SaveCase())
    session.do(c.SaveCase(str(tmp_path / "nodule")))
    workstation.background.run_all()
    copy = tmp_path / "nodule.carina"
    assert copy.exists()
    assert session.snapshot().saving.copy_name == "nodule.carina"
    copy.unlink()
    workstation.wall.now_s += 5.0
    session.do(c.SaveCase())
    workstation.background.run_all()
    assert copy.exists()
    copy.write_text("of somebody else")
    other = tmp_path / "other.carina"
    other.write_text("there")
    with pytest.raises(UsageError, match="already exists"):
        session.do(c.SaveCase(str(other)))
    session.do(c.SaveCase(str(other), replace=True))
    workstation.background.run_all()
    assert other.read_text() != "there"
    assert copy.read_text() == "of somebody else"


def test_saving_thread_writes_a_change_without_a_request(workstation):
    """Wait for the saving thread itself; all other tests call its functions."""
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(100.0))
    workstation.clock.advance(5.0)
    saver = session._saving._saver
    with saver._wake:
        saver._wake.notify_all()
        assert saver._wake.wait_for(lambda: saver.info.saved_s is not None, 60.0)
    assert session.snapshot().saving.saved_s == workstation.wall.now_s
    session.close()


def test_undo_of_several_steps_at_once_is_saved(workstation):
    session = workstation.start()
    workstation.open()
    for fov in (100.0, 90.0):
        session.do(c.SetFov(fov))
        workstation.clock.advance(5.0)
    session.do(c.SetOutline("octagon"))
    session.do(c.GoToStep(1))
    assert session.snapshot().document.look.fov_deg == 100.0
    assert session.snapshot().redo_label == "field of view"
    session.do(c.GoToStep(3))
    assert session.snapshot().document.look.outline == "octagon"
    with pytest.raises(UsageError, match="has 3 steps; there is no step 4"):
        session.do(c.GoToStep(4))
    session.close()


def test_case_on_a_full_disk_is_not_closed_until_it_is_saved_to_another_disk(workstation, tmp_path):
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(100.0))
    workstation.saved()
    workstation.files[-1].refuses = OSError(28, "No space left on device")
    session.do(c.SetFov(90.0))
    with pytest.raises(UsageError, match="the case stays open") as refused:
        session.do(c.CloseCase())
    assert refused.value.code == "case.not-saved"
    session.do(c.OpenPath("other"))
    workstation.background.run_all()
    assert session.snapshot().document.look.fov_deg == 90.0
    place = tmp_path / "stick" / "mine.carina"
    place.parent.mkdir()
    session.do(c.SaveCase(str(place)))
    workstation.background.run_all()
    assert sorted(path.name for path in place.parent.iterdir()) == [".mine.carina.lock", "mine.carina"]
    assert workstation.written[str(place)].steps[-1].document.look.fov_deg == 90.0
    session.do(c.SetFov(80.0))
    with pytest.raises(UsageError, match="the case stays open"):
        session.do(c.CloseCase())
    session.do(c.SaveCase(str(place)))
    workstation.background.run_all()
    session.do(c.CloseCase())
    assert session.snapshot().case is None
    session.close()


def test_named_file_is_not_replaced_by_one_without_a_recorded_flight(workstation, tmp_path):
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(100.0))
    workstation.saved()
    flight = RecordingFacts(1, "Flight 1", "", 0.0, 1.0, complete=True)
    session._core.case.flights.listed = (flight,)  # The file will not return this flight.
    workstation.files[-1].refuses = OSError(5, "Input/output error")
    session.do(c.SetFov(90.0))
    place = tmp_path / "mine.carina"
    session.do(c.SaveCase(str(place)))
    workstation.background.run_all()
    reported = [event.message for event in workstation.events if isinstance(event, UserMessage)]
    assert reported[-1] == f"saved as {place}, without 1 recorded flight that could not be read from the faulty disk"
    before = place.read_text(), workstation.written[str(place)]
    session.do(c.SetFov(80.0))
    session.do(c.SaveCase(str(place)))
    workstation.background.run_all()
    error = [event for event in workstation.events if isinstance(event, ErrorEvent)][-1]
    assert "mine.carina was left as it is: 1 recorded flight cannot be read" in error.message
    assert (place.read_text(), workstation.written[str(place)]) == before
    session.close()


def test_case_record_that_cannot_be_written_does_not_block_saving(workstation, monkeypatch):
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(100.0))
    workstation.saved()

    def refuses(_held, **_notes):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(LockedCase, "note", refuses)
    saver = session._saving._saver
    saver.call("a name", None)
    assert saver.settle()
    assert saver.info.problem is not None
    monkeypatch.undo()
    assert saver.settle()
    assert saver.info.problem is None
    session.close()


def test_open_case_is_detected_by_the_lock_of_its_record(workstation):
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(100.0))
    workstation.saved()
    records = CaseRecords(workstation.folder / "cases", workstation.wall)
    (record,) = records.all()
    assert records.is_held(record)
    assert records.is_held(record)
    session.close()
    assert not records.is_held(record)


# ---------------------------------------------------------------- named files


@pytest.fixture
def named(workstation, tmp_path):
    """Return the path of a named case with a change since its last save."""
    workstation.start()
    workstation.open()
    workstation.session.do(c.SetFov(100.0))
    workstation.saved()
    path = tmp_path / "share" / "team.carina"
    path.parent.mkdir()
    workstation.session.do(c.SaveCase(str(path)))
    workstation.background.run_all()
    workstation.session.do(c.SetFov(90.0))
    workstation.saved()
    return path


def saving(workstation):
    return workstation.session._saving.info


def test_window_does_not_write_a_named_file_changed_by_another_program_and_reports_it(workstation, named):
    named.write_text("a letter")
    workstation.session.do(c.SaveCase())
    workstation.background.run_all()
    error = [event for event in workstation.events if isinstance(event, ErrorEvent)]
    assert [event.code for event in error] == ["case.changed"]
    assert "not a Carina case" in error[0].message
    assert named.read_text() == "a letter"
    info = saving(workstation)
    assert (info.copy_conflict, info.copy_name, info.problem) == ("not-a-case", "team.carina", None)
    assert info.beside == str(named.with_name("team (2).carina"))
    workstation.session.do(c.SaveCase(info.beside))
    workstation.background.run_all()
    assert (saving(workstation).copy_conflict, saving(workstation).copy_name) == (None, "team (2).carina")
    workstation.session.close()
    assert named.read_text() == "a letter"


def test_replaced_named_file_is_moved_to_a_new_name_that_is_reported(workstation, named):
    named.write_text("a letter")
    workstation.session.do(c.SaveCase())
    workstation.background.run_all()
    workstation.session.do(c.SaveCase(str(named), replace=True))
    workstation.background.run_all()
    (stored,) = named.parent.glob("team (replaced *).carina")
    assert stored.read_text() == "a letter"
    assert any(stored.name in event.message for event in workstation.events if isinstance(event, UserMessage))
    assert saving(workstation).copy_conflict is None
    workstation.session.close()


def test_closing_a_case_does_not_write_a_named_file_changed_by_another_program_and_reports_it(workstation, named):
    named.write_text("a letter")
    workstation.session.do(c.CloseCase())
    assert [event.code for event in workstation.events if isinstance(event, ErrorEvent)] == ["case.changed"]
    assert named.read_text() == "a letter"
    workstation.open()
    assert workstation.session.snapshot().document.look.fov_deg == 90.0
    saver = workstation.session._saving._saver
    with saver._wake:
        assert saver._wake.wait_for(lambda: saver.info.copy_conflict == "not-a-case", 60.0), "shown at once"
    workstation.session.close()


def test_named_file_that_was_renamed_is_recreated_only_on_request(workstation, named):
    named.rename(named.with_name("renamed.carina"))
    workstation.session.do(c.CloseCase())
    assert [path.name for path in named.parent.iterdir()] == ["renamed.carina"]
    workstation.open()
    workstation.session.do(c.SaveCase())
    workstation.background.run_all()
    assert saving(workstation).copy_conflict is None
    assert named.exists()
    workstation.session.close()


def test_named_file_is_recognised_after_two_consecutive_crashes(workstation, named, monkeypatch):
    note = LockedCase.note

    def cut_off(held, **values):
        note(held, **{name: value for name, value in values.items() if "copied_s" not in values})

    # The first crash occurs after the file was replaced, before the record contains the new digest.
    with monkeypatch.context() as patched:
        patched.setattr(LockedCase, "note", cut_off)
        workstation.session._saving._saver.save_to(named)
        workstation.saved()
        workstation.kill()
    content = named.read_text()

    def power_cut(*_arguments, **_options):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    # The second crash occurs before the file is replaced.
    workstation.start()
    workstation.open()
    with monkeypatch.context() as patched:
        patched.setattr(NamedFile, "_replace_locked", power_cut)
        with pytest.raises(OSError, match="Input/output"):
            workstation.session._saving._saver.save_to(named)
        workstation.kill()
    assert named.read_text() == content
    workstation.start()
    workstation.open()
    workstation.session.do(c.SaveCase())
    workstation.background.run_all()
    assert saving(workstation).copy_conflict is None
    assert named.read_text() != content
    workstation.session.close()


def test_opening_a_case_compares_its_named_file_and_does_not_write_it(workstation, named, monkeypatch):
    workstation.session.do(c.SaveCase())
    workstation.background.run_all()
    workstation.session.close()
    content = named.read_text()
    is_open, run_copies = threading.Event(), CaseSaver._run_copies

    def run_after_opening(saver):
        assert is_open.wait(WAIT_S)
        run_copies(saver)

    monkeypatch.setattr(CaseSaver, "_run_copies", run_after_opening)
    workstation.start()
    workstation.open()
    is_open.set()
    saver = workstation.session._saving._saver
    with saver._wake:
        assert saver._wake.wait_for(lambda: saver._is_named_checked, WAIT_S)
    workstation.kill()
    assert named.read_text() == content


def test_suggested_file_names_differ_between_cases_and_contain_no_patient_data(tmp_path, workstation):
    suggested = set()
    for digest in ("one CT", "another CT"):
        workstation.digest = digest
        session = workstation.start()
        session._saving.records.documents = tmp_path
        workstation.open("SURNAME_FIRSTNAME_1951.nii.gz")
        session.do(c.SetFov(100.0))
        workstation.saved()
        suggested.add(saving(workstation).suggested)
        session.do(c.RenameCase(session._saving.open_case[0], "Nodule, left"))
        suggested.add(saving(workstation).suggested)
        session.close()
    names = {str(place).rsplit("/", 1)[1] for place in suggested}
    assert len(names) == 4
    assert sum(name.startswith("Nodule-left-") for name in names) == 2
    assert not any("1951" in name or "name" in name.lower() for name in names)


# ---------------------------------------------------------------- several windows, and changes of the clock


def test_windows_that_open_one_ct_at_the_same_time_are_notified_of_each_other(workstation, tmp_path):
    workstations = [workstation, *(RestartableWorkstation(tmp_path) for _ in range(3))]
    for one in workstations:
        one.start()
        one.open()
    reported = [
        any("another window" in e.message for e in one.events if isinstance(e, UserMessage)) for one in workstations
    ]
    assert reported == [False, True, True, True]
    for one in workstations:
        one.session.close()
    again = workstation.start()
    workstation.open()
    assert not any("another window" in e.message for e in workstation.events if isinstance(e, UserMessage))
    again.close()


def test_last_used_case_is_opened_also_after_the_computer_clock_was_set_back(workstation):
    session = workstation.start()
    workstation.open()
    session.do(c.SetFov(100.0))
    workstation.saved()
    session.do(c.BeginAnew())
    workstation.background.run_all()
    workstation.wall.now_s -= 2 * 365 * 86400.0
    session.do(c.SetFov(90.0))
    session.close()
    again = workstation.start()
    assert [one.used_s for one in again._saving.records.all()] == sorted(
        one.used_s for one in again._saving.records.all()
    )
    workstation.open()
    assert again.snapshot().document.look.fov_deg == 90.0
    assert [one.recent_id for one in again._cases.listed()] == [one.case_id for one in again._saving.records.all()]
    again.close()
