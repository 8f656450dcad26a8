"""Tests of the public class ``carina.Case``: a call returns after its change is complete and raises its errors."""

from __future__ import annotations

import os
import shutil
import time

import numpy as np
import pytest

import carina
from cached_test_data import cached_phantom
from carina import commands as c
from carina.case import CaseFile
from carina.config import load_settings
from carina.errors import CarinaError, NoResultError, UnsavedWorkError, UsageError
from carina.phantom import write_phantom
from carina.render import Renderer
from carina.session import Session, case_files
from carina.session.store.named_file_lock import NamedLock
from carina.session.store.registry import CaseRecords
from user_folders import user_folders


@pytest.fixture(scope="module")
def phantom():
    return carina.generate_phantom(spacing_mm=3.0, generations=3)


def test_case_can_be_opened_changed_undone_and_rendered_with_the_python_interface(phantom):
    with carina.Case.open(phantom.volume) as case:
        assert "found" in repr(case)
        assert case.airways.tree.tips()
        tip = case.airways.tree.tips()[0]
        case.do(c.AddTarget(tuple(tip.points[-1])))
        case.do(c.EditTree(c.RenameBranch(tip.id, "here")))
        assert case.history()[-1].startswith("rename ")
        assert case.airways.tree.branch(tip.id).name == "here"
        case.undo()
        assert case.airways.tree.branch(tip.id).name != "here"
        case.redo()
        assert case.airways.tree.branch(tip.id).name == "here"
        case.do(c.GoTo(path_mm=20.0))
        assert case.render("axial", width=40, height=30).rgb.shape == (30, 40, 3)
        assert case.ask(c.VoxelAt(tuple(case.pose.position_lps))) is not None


def test_errors_of_a_case_are_raised_in_the_python_call_that_caused_them(phantom):
    with carina.Case.open(phantom.volume) as case:
        before = case.history()
        with pytest.raises(UsageError, match=r"set_fov\.fov_deg must be at least 60"):
            case.do(c.SetFov(1.0))
        far = tuple(float(v) for v in np.add(phantom.volume.centre_lps, (60.0, 60.0, 0.0)))
        with pytest.raises(NoResultError):
            case.do(c.EditTree(c.AddBranch(far)))
        with pytest.raises(UsageError, match="view"):
            case.render("oblique")
        assert case.history() == before


def test_file_without_a_scan_is_refused_with_a_message():
    with pytest.raises(UsageError, match=r"Case\.open: source: expected str or Path; found int"):
        carina.Case.open(3)
    with pytest.raises(carina.VolumeImportError):
        carina.Case.open("/nowhere/at/all")


# ---------------------------------------------------------------- case files


@pytest.fixture(scope="module")
def made_case(phantom, tmp_path_factory):
    """Return a case file beside its CT, with a renamed branch; the addition of a target was undone."""
    folder = tmp_path_factory.mktemp("case")
    write_phantom(phantom, folder / "scan")
    with carina.Case.open(folder / "scan" / "ct.nii.gz") as case:
        with pytest.raises(UsageError, match="not been saved to a file yet"):
            case.save()
        tip = case.airways.tree.tips()[0]
        case.do(c.EditTree(c.RenameBranch(tip.id, "here")))
        case.do(c.AddTarget(tuple(float(v) for v in tip.points[-1])))
        case.undo()
        assert case.save(folder / "one") == case.path == folder / "one.carina"
    return folder


@pytest.fixture
def saved(made_case, tmp_path, monkeypatch):
    """Return a copy of the case file for one test."""
    for name, folder in user_folders(tmp_path / "home").items():
        monkeypatch.setenv(name, folder)
    shutil.copytree(made_case, tmp_path / "work")
    return tmp_path / "work" / "one.carina"


def searched(*_arguments, **_options):
    pytest.fail("the airways of a case were searched for again")


def test_saved_case_opens_with_its_undo_and_redo_steps(saved, monkeypatch):
    monkeypatch.setattr("carina.track.find_airways", searched)
    with carina.Case.open(saved) as case:
        assert case.note is None
        assert "here" in case.airways.tree.names
        assert len(case.history()) == 1
        case.redo()
        assert len(case.state.document.targets) == 1
        case.undo()
        case.undo()
        assert "here" not in case.airways.tree.names
    # Closing the case has saved the change.
    with carina.Case.open(str(saved)) as case:
        assert case.history() == ()
        case.redo()
        case.redo()
        assert len(case.history()) == 2
    assert sorted(p.name for p in saved.parent.iterdir()) == ["one.carina", "scan"]


def test_case_without_changes_is_not_written_on_close(saved):
    before = saved.read_bytes(), saved.stat().st_mtime_ns
    with carina.Case.open(saved) as case:
        case.render("axial", width=16, height=16)
    assert (saved.read_bytes(), saved.stat().st_mtime_ns) == before


def test_changes_are_saved_if_the_program_raises_an_error(saved):
    def fails():
        with carina.Case.open(saved) as case:
            case.do(c.SetFov(100.0))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fails()
    with carina.Case.open(saved) as case:
        assert case.state.document.look.fov_deg == 100.0


def test_second_program_reads_an_open_case_and_saves_it_only_under_another_name(saved, tmp_path):
    with carina.Case.open(saved) as first:
        with pytest.warns(UserWarning, match="open for editing elsewhere"):
            second = carina.Case.open(saved)
        with second:
            second.do(c.SetFov(100.0))
            with pytest.raises(UsageError, match="another name") as refused:
                second.save()
            assert refused.value.code == "case.read-only"
            with pytest.raises(CarinaError, match="another name") as refused:
                second.save(saved, replace=True)
            assert refused.value.code == "case.read-only"
            assert second.save(tmp_path / "two.carina") == second.path
            assert second.note is None
            with pytest.raises(UsageError, match="already"):
                first.save(tmp_path / "two.carina")
            with pytest.raises(CarinaError, match="open for editing elsewhere"):
                first.save(tmp_path / "two.carina", replace=True)
            assert first.path == saved
    with carina.Case.open(tmp_path / "two.carina") as case:
        assert case.note is None
        assert case.state.document.look.fov_deg == 100.0
        assert case.save(saved, replace=True) == saved


def test_close_raises_an_error_if_another_program_has_the_file_open_and_changes_are_unsaved(saved, tmp_path):
    with carina.Case.open(saved) as first:
        with pytest.warns(UserWarning, match="open for editing elsewhere"):
            second = carina.Case.open(saved)
        second.do(c.SetFov(101.0))
        second.do(c.SetOutline("octagon"))
        labels = second.history()[-2:]
        with pytest.raises(UnsavedWorkError, match="2 changes") as lost:
            second.close()
        assert (lost.value.code, lost.value.exit_code) == ("case.not-saved", 5)
        assert all(label in str(lost.value) for label in labels)
        assert str(saved) in str(lost.value)
        with pytest.warns(UserWarning, match="open for editing elsewhere"):
            third = carina.Case.open(saved)
        third.do(c.SetTexture(on=False))
        third.close()
        with pytest.warns(UserWarning, match="open for editing elsewhere"):
            fourth = carina.Case.open(saved)
        fourth.do(c.SetFov(102.0))
        fourth.save(tmp_path / "four.carina")
        fourth.close()
        first.do(c.SetFov(100.0))


def test_case_that_is_open_in_a_window_is_readable_by_a_program(saved):
    records = CaseRecords(load_settings().cases_dir, lambda: 1_800_000_000.0)
    held = records.begin("ab" * 32, None)
    shutil.copyfile(saved, held.path)
    held.note(copy_path=str(saved))
    with pytest.warns(UserWarning, match="in a Carina window"):
        carina.Case.open(saved).close()
    held.release()
    carina.Case.open(saved).close()


def test_ct_of_a_case_is_found_beside_it_or_at_the_given_path(saved, tmp_path):
    (saved.parent / "scan").rename(tmp_path / "moved")
    with pytest.raises(carina.VolumeImportError, match="give its location as ct=") as refused:
        carina.Case.open(saved)
    assert refused.value.code == "case.no-scan"
    with carina.Case.open(saved, ct=tmp_path / "moved" / "ct.nii.gz") as case:
        case.do(c.SetFov(100.0))
    # From now on the case file refers to the CT at its new path.
    carina.Case.open(saved).close()
    with pytest.raises(UsageError, match="ct: only applies"):
        carina.Case.open(tmp_path / "moved" / "ct.nii.gz", ct=tmp_path)


def test_failed_save_is_reported_and_the_case_file_is_unchanged(saved, tmp_path):
    before = saved.read_bytes()
    with carina.Case.open(saved) as case:
        with pytest.raises(UsageError, match="does not exist"):
            case.save(tmp_path / "nowhere" / "one.carina")
        assert case.path == saved
    assert saved.read_bytes() == before


# ---------------------------------------------------------------- the window


@pytest.fixture
def window(saved):
    """Return a function that opens a workstation with the case and returns its session and its case records."""
    records = CaseRecords(load_settings().cases_dir, time.time)
    sessions = []

    def opened(ct=None, path=saved):
        session = Session(
            lambda volume, transfer: Renderer(volume, transfer=transfer),
            records=records,
            files=case_files(None, records),
        )
        sessions.append(session)
        session.do(c.OpenPath(str(path)) if ct is None else c.OpenCaseFile(path, ct))
        session.jobs.wait_idle(None)
        return session

    yield opened, records
    for session in sessions:
        session.close()


def test_window_opens_a_case_file_and_continues_its_case(saved, window, monkeypatch):
    monkeypatch.setattr("carina.track.find_airways", searched)
    opened, records = window
    session = opened()
    state = session.snapshot()
    assert (state.undo_label or "").startswith("rename")
    assert state.redo_label is not None
    assert session._saving.write_now()
    (record,) = records.all()
    assert record.copy_path == str(saved)
    assert record.place == str(saved.parent / "scan" / "ct.nii.gz")
    session.do(c.SetFov(100.0))
    session.close()
    # The named file was updated, and the window continues the same case, not another copy.
    with CaseFile.open(saved, read_only=True) as file:
        assert len(file.history()) == 2
    again = opened()
    assert again.history()[-1] == session_label(again)
    assert len(records.all()) == 1


def test_window_does_not_write_a_file_that_is_open_in_a_program(saved, window):
    opened, _ = window
    lock = NamedLock.take(saved)
    session = opened()
    session.do(c.SetFov(100.0))
    session.do(c.SaveCase())
    session.jobs.wait_idle(None)
    with CaseFile.open(saved, read_only=True) as file:
        assert len(file.history()) == 2, "the label and the undone target"
    lock.release()
    session.do(c.SaveCase())
    session.jobs.wait_idle(None)
    with CaseFile.open(saved, read_only=True) as file:
        assert file.history()[-1].label == session_label(session)


def session_label(session):
    return session.snapshot().undo_label


def test_case_file_changed_by_another_program_opens_as_another_case(saved, window):
    opened, records = window
    opened().close()
    with carina.Case.open(saved) as case:
        case.do(c.SetFov(95.0))
    os.utime(saved, (4e9, 4e9))
    session = opened()
    assert session.snapshot().document.look.fov_deg == 95.0
    assert len(records.all()) == 2


def test_window_opens_a_case_whose_scan_was_moved_if_the_new_path_is_given(saved, window, monkeypatch):
    monkeypatch.setattr("carina.track.find_airways", searched)
    opened, records = window
    (saved.parent / "scan").rename(saved.parent / "moved")
    lost = opened()
    assert lost.snapshot().case is None
    session = opened(saved.parent / "moved" / "ct.nii.gz")
    assert (session.snapshot().undo_label or "").startswith("rename")
    assert session._saving.write_now()
    (record,) = records.all()
    assert record.place == str(saved.parent / "moved" / "ct.nii.gz")
    # Another CT is refused, and nothing of the CT is stored in the case.
    write_phantom(cached_phantom(spacing_mm=4.0, generations=3), saved.parent / "other")
    other = opened(saved.parent / "other" / "ct.nii.gz")
    assert other.snapshot().case is None
    assert len(records.all()) == 1


# ---------------------------------------------------------------- live file of a stored case


def test_window_that_opens_an_internal_case_file_continues_the_stored_case(saved, window):
    opened, records = window
    session = opened()
    session.do(c.SetFov(100.0))
    assert session._saving.write_now()
    (record,) = records.all()
    live = records.path_of(record)
    session.close()
    again = opened(path=live)
    assert again.snapshot().document.look.fov_deg == 100.0
    assert again._saving.open_case[0] == record.case_id
    assert again.snapshot().saving.copy_name == saved.name, "the named file stays the same"
    again.do(c.SetFov(90.0))
    again.close()
    assert [one.case_id for one in records.all()] == [record.case_id]
    assert sorted(path.name for path in live.parent.iterdir() if path.suffix == ".carina") == ["case.carina"]


def test_internal_case_file_that_is_open_in_another_window_is_not_written(saved, window):
    opened, records = window
    first = opened()
    first.do(c.SetFov(100.0))
    assert first._saving.write_now()
    (record,) = records.all()
    live = records.path_of(record)
    second = opened(path=live)
    second.do(c.SetFov(80.0))
    assert second._saving.write_now()
    assert second.snapshot().saving.copy_name is None
    second.close()
    # A second change of the field of view within a second would become part of the first step.
    first.do(c.SetOutline("octagon"))
    first.close()
    with CaseFile.open(live, read_only=True) as file:
        assert len(file.history()) == 3
    assert len(records.all()) == 2, "the second window works on a copy"


def test_case_is_not_saved_by_name_into_the_folder_of_stored_cases(saved, window):
    opened, records = window
    session = opened()
    session.do(c.SetFov(100.0))
    assert session._saving.write_now()
    (record,) = records.all()
    live = records.path_of(record)
    for path, replace in ((live, True), (live.with_name("mine.carina"), False)):
        with pytest.raises(UsageError, match="stores its cases") as refused:
            session.do(c.SaveCase(str(path), replace))
        assert refused.value.code == "case.no-place"
    with pytest.raises(UsageError, match="stores its cases"):
        session.cases.save_elsewhere(session.snapshot().case_number, live.parent)
    session.close()
    with carina.Case.open(saved) as case:
        with pytest.raises(UsageError, match="stores its cases"):
            case.save(live, replace=True)
        case.do(c.SetFov(95.0))
    assert [path.name for path in live.parent.glob("*.carina")] == ["case.carina"]


def test_program_that_opens_an_internal_case_file_does_not_write_to_it(saved, window, tmp_path):
    opened, records = window
    session = opened()
    session.do(c.SetFov(100.0))
    assert session._saving.write_now()
    (record,) = records.all()
    live = records.path_of(record)
    session.close()
    before = live.read_bytes()
    with pytest.warns(UserWarning, match="another name"):
        case = carina.Case.open(live)
    with case:
        case.do(c.SetFov(95.0))
        with pytest.raises(UsageError, match="another name") as refused:
            case.save()
        assert refused.value.code == "case.read-only"
        case.save(tmp_path / "elsewhere.carina")
    assert live.read_bytes() == before
