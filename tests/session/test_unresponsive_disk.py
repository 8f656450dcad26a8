"""Tests of disks that do not respond: only the saving thread waits for them, and no change is lost."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest

from carina import commands as c
from carina.errors import UsageError
from carina.session import ErrorEvent, UserMessage
from carina.session.saving import writer
from carina.session.store.named_file_lock import lock_path
from restartable_workstation import MemoryFile, RestartableWorkstation

WAIT_S = 60.0


class StalledFile(MemoryFile):
    """Case file whose disk operations a test can stall."""

    def __init__(self, path, digest):
        super().__init__(path, digest)
        self.lets_save, self.lets_copy = threading.Event(), threading.Event()
        self.saves, self.copies = threading.Event(), threading.Event()
        self.lets_save.set()
        self.lets_copy.set()

    def save(self, moment):
        self.saves.set()
        assert self.lets_save.wait(WAIT_S)
        super().save(moment)

    def write_copy(self, path, **options):
        self.copies.set()
        assert self.lets_copy.wait(WAIT_S)
        super().write_copy(path, **options)


class StallingWorkstation(RestartableWorkstation):
    """Workstation whose case was saved once; its disk is reported as silent only if a test stalls it."""

    def be_silent(self, has_begun, do):
        """Run ``do`` and wait until its write reaches the stalled disk; a slow disk is reported after a short time."""
        has_begun.clear()
        writer.SLOW_S = 0.01
        do()
        with self.saver._wake:
            self.saver._wake.notify_all()
        assert has_begun.wait(WAIT_S)
        writer.SLOW_S = WAIT_S

    def file_functions(self, files):
        def create(path, _volume, digest):
            self.files.append(StalledFile(path, digest))
            return self.files[-1]

        return replace(files, create=create, open=lambda path: create(path, None, MemoryFile.contents[str(path)][0]))

    @property
    def file(self):
        return self.files[-1]

    @property
    def saver(self):
        return self.session._saving._saver

    def until(self, condition):
        """Wait until ``condition`` returns true.

        The caller holds the lock of the threads, which the condition must not acquire.
        """
        with self.saver._wake:
            assert self.saver._wake.wait_for(condition, WAIT_S)

    def saving(self):
        return self.saver.info

    def stall(self):
        """Make a change whose write stalls on the disk."""
        self.file.lets_save.clear()

        def change():
            self.session.do(c.SetFov(90.0))
            self.clock.advance(1.0)

        self.be_silent(self.file.saves, change)
        self.until(lambda: self.saving().problem is not None)


@pytest.fixture
def workstation(tmp_path, monkeypatch):
    MemoryFile.contents.clear()
    monkeypatch.setattr(writer, "SLOW_S", WAIT_S)
    workstation = StallingWorkstation(tmp_path)
    workstation.start()
    workstation.open()
    workstation.session.do(c.SetFov(100.0))
    workstation.saved()
    yield workstation
    for file in workstation.files:
        file.lets_save.set()
        file.lets_copy.set()
    workstation.session.close()


def test_limits_for_an_unresponsive_disk_add_up_to_less_than_three_seconds():
    # No workstation is started here, so these are the real limits of the product.
    assert writer.DECIDED_WITHIN_S + writer.SLOW_S < 3.0


def test_session_continues_on_an_unresponsive_disk_and_saves_when_it_responds(workstation):
    workstation.stall()
    assert "another folder" in workstation.saving().problem
    workstation.session.do(c.SetFov(80.0))
    workstation.session.do(c.EditKeyFrames(c.KeyFrameAdd()))
    assert not workstation.session._saving.write_now()
    workstation.file.lets_save.set()
    workstation.until(lambda: workstation.saving().problem is None)
    workstation.saved()
    steps = MemoryFile.contents[str(workstation.file.path)][1].steps
    assert [step.label for step in steps] == list(workstation.session.history())


def test_case_is_renamed_while_its_disk_does_not_respond(workstation):
    case_id = workstation.saver.held.record.case_id
    workstation.stall()
    workstation.session.do(c.RenameCase(case_id, "Nodule in RB4"))
    assert workstation.saving().title == "Nodule in RB4"
    workstation.file.lets_save.set()
    workstation.until(lambda: workstation.saving().problem is None)
    workstation.saved()
    assert workstation.session._saving.records.find(case_id).alias == "Nodule in RB4"


def test_case_is_saved_to_another_disk_while_its_disk_does_not_respond_and_then_closed(workstation, tmp_path):
    workstation.stall()
    place = tmp_path / "stick" / "mine.carina"
    place.parent.mkdir()
    with pytest.raises(UsageError, match="the case stays open") as refused:
        workstation.session.do(c.CloseCase())
    assert refused.value.code == "case.not-saved"
    workstation.session.do(c.SetFov(70.0))
    workstation.session.do(c.SaveCase(str(place)))
    workstation.background.run_all()
    assert workstation.written[str(place)].steps[-1].document.look.fov_deg == 70.0
    assert (workstation.saving().copy_name, workstation.saving().problem is None) == ("mine.carina", False)
    workstation.session.do(c.CloseCase())
    assert workstation.session.snapshot().case is None
    # The writer that waits for the disk holds the claim on the case until the case is written.
    file, (keeper,) = workstation.file, workstation.session._saving._ending
    opener = threading.Thread(target=workstation.open)
    opener.start()
    file.lets_save.set()
    opener.join(WAIT_S)
    assert keeper.has_ended
    assert not [e for e in workstation.events if isinstance(e, UserMessage) and "another window" in e.message]
    assert workstation.session.snapshot().document.look.fov_deg == 70.0
    assert workstation.saver.copy_path == place


def test_unresponsive_network_share_delays_only_the_named_file_on_it(workstation, tmp_path):
    share = tmp_path / "share.carina"
    workstation.session.do(c.SaveCase(str(share)))
    workstation.background.run_all()
    workstation.file.lets_copy.clear()
    workstation.session.do(c.SetFov(90.0))
    workstation.saved()
    workstation.be_silent(workstation.file.copies, lambda: workstation.clock.advance(61.0))
    workstation.until(lambda: workstation.saving().copy_problem is not None)
    workstation.session.do(c.SetFov(80.0))
    workstation.saved()
    assert MemoryFile.contents[str(workstation.file.path)][1].steps[-1].document.look.fov_deg == 80.0
    assert workstation.saving().problem is None
    workstation.file.lets_copy.set()
    workstation.until(lambda: workstation.saving().copy_problem is None)


@pytest.fixture
def stalled_share(workstation, tmp_path, monkeypatch):
    """Provide a named file whose update waits for a share, and the event that lets the update continue."""
    share, goes_on, has_begun = tmp_path / "share.carina", threading.Event(), threading.Event()
    write_copy = MemoryFile.write_copy

    def stalls(file, path, **options):
        if path == share:
            has_begun.set()
            assert goes_on.wait(3 * WAIT_S)
        write_copy(file, path, **options)

    workstation.session.do(c.SaveCase(str(share)))
    workstation.background.run_all()
    workstation.session.do(c.SetFov(90.0))
    workstation.saved()
    monkeypatch.setattr(StalledFile, "write_copy", stalls)
    workstation.clock.advance(61.0)
    with workstation.saver._wake:
        workstation.saver._wake.notify_all()
    assert has_begun.wait(WAIT_S)
    yield share, goes_on
    goes_on.set()


def test_case_saved_to_another_file_uses_that_file_also_when_the_former_share_responds(
    workstation, stalled_share, tmp_path
):
    share, goes_on = stalled_share
    copier, stick = workstation.saver._copier, tmp_path / "stick.carina"
    workstation.session.do(c.SaveCase(str(stick)))
    workstation.background.run_all()
    assert workstation.saver.copy_path == stick
    goes_on.set()
    copier.join(WAIT_S)
    assert not copier.is_alive()
    assert (workstation.saver.copy_path, workstation.saving().copy_name) == (stick, "stick.carina")
    workstation.saved()
    assert workstation.saver.held.record.copy_path == str(stick)
    assert not lock_path(share).exists()
    assert lock_path(stick).exists()


def test_case_saved_to_another_file_is_updated_while_the_former_share_does_not_respond(
    workstation, stalled_share, tmp_path
):
    stick = tmp_path / "stick.carina"
    workstation.session.do(c.SaveCase(str(stick)))
    workstation.background.run_all()
    before = stick.read_text()
    workstation.session.do(c.SetFov(80.0))
    workstation.saved()
    workstation.clock.advance(61.0)
    with workstation.saver._wake:
        workstation.saver._wake.notify_all()
    workstation.until(lambda: workstation.saver._num_copied >= workstation.saver._num_saved)
    assert stick.read_text() != before
    workstation.session.do(c.SetFov(70.0))
    workstation.session.do(c.CloseCase())
    assert not lock_path(stick).exists(), "the case was released"


def test_save_that_ends_after_its_case_was_closed_releases_its_file(workstation, tmp_path):
    keeper, stick = workstation.saver, tmp_path / "stick.carina"
    workstation.file.lets_copy.clear()
    saver = threading.Thread(target=keeper.save_to, args=(stick,))
    workstation.be_silent(workstation.file.copies, saver.start)
    workstation.session.do(c.CloseCase())
    assert keeper.has_ended
    workstation.file.lets_copy.set()
    saver.join(WAIT_S)
    assert stick.exists()
    assert not lock_path(stick).exists()


def test_failed_update_of_the_named_file_is_retried_without_another_change(workstation, tmp_path):
    workstation.session.do(c.SaveCase(str(tmp_path / "share.carina")))
    workstation.background.run_all()
    workstation.session.do(c.SetFov(90.0))
    workstation.saved()
    workstation.file.refuses = OSError(5, "Input/output error")
    workstation.clock.advance(61.0)
    with workstation.saver._wake:
        workstation.saver._wake.notify_all()
    workstation.until(lambda: workstation.saving().copy_problem is not None)
    workstation.file.refuses = None
    workstation.clock.advance(writer.COPY_RETRY_S + 1.0)
    with workstation.saver._wake:
        workstation.saver._wake.notify_all()
    workstation.until(lambda: workstation.saving().copy_problem is None)


def test_internal_error_while_saving_is_reported_and_later_changes_are_saved(workstation):
    workstation.file.refuses = TypeError("ours")
    workstation.session.do(c.SetFov(90.0))
    assert not workstation.session._saving.write_now()
    assert "internal error in Carina (TypeError)" in workstation.saving().problem
    workstation.file.refuses = None
    workstation.saved()
    assert workstation.saving().problem is None


def test_last_changes_are_written_to_the_named_file_if_the_disk_of_stored_cases_refuses_them(workstation, tmp_path):
    place = tmp_path / "mine.carina"
    workstation.session.do(c.SaveCase(str(place)))
    workstation.background.run_all()
    workstation.file.refuses = OSError(28, "No space left on device")
    workstation.session.do(c.SetFov(70.0))
    workstation.session.close()
    assert workstation.written[str(place)].steps[-1].document.look.fov_deg == 70.0
    assert not [e for e in workstation.events if isinstance(e, ErrorEvent)]
