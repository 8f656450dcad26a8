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
from restartable_workstation import Desk, MemoryFile

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


class StallingDesk(Desk):
    """Workstation whose case was saved once; its disk is reported as silent only if a test stalls it."""

    def be_silent(self, has_begun, do):
        """Run ``do`` and wait until its write reaches the stalled disk; a slow disk is reported after a short time."""
        has_begun.clear()
        writer.SLOW_S = 0.01
        do()
        with self.kept._wake:
            self.kept._wake.notify_all()
        assert has_begun.wait(WAIT_S)
        writer.SLOW_S = WAIT_S

    def kept_files(self, files):
        def create(path, _volume, digest):
            self.files.append(StalledFile(path, digest))
            return self.files[-1]

        return replace(files, create=create, open=lambda path: create(path, None, MemoryFile.kept[str(path)][0]))

    @property
    def file(self):
        return self.files[-1]

    @property
    def kept(self):
        return self.session._saving._saver

    def until(self, condition):
        """Wait until ``condition`` returns true.

        The caller holds the lock of the threads, which the condition must not acquire.
        """
        with self.kept._wake:
            assert self.kept._wake.wait_for(condition, WAIT_S)

    def saving(self):
        return self.kept.info

    def stall(self):
        """Make a change whose write stalls on the disk."""
        self.file.lets_save.clear()

        def change():
            self.session.do(c.SetFov(90.0))
            self.clock.advance(1.0)

        self.be_silent(self.file.saves, change)
        self.until(lambda: self.saving().problem is not None)


@pytest.fixture
def desk(tmp_path, monkeypatch):
    MemoryFile.kept.clear()
    monkeypatch.setattr(writer, "SLOW_S", WAIT_S)
    desk = StallingDesk(tmp_path)
    desk.start()
    desk.open()
    desk.session.do(c.SetFov(100.0))
    desk.saved()
    yield desk
    for file in desk.files:
        file.lets_save.set()
        file.lets_copy.set()
    desk.session.close()


def test_limits_for_an_unresponsive_disk_add_up_to_less_than_three_seconds():
    # No workstation is started here, so these are the real limits of the product.
    assert writer.DECIDED_WITHIN_S + writer.SLOW_S < 3.0


def test_session_continues_on_an_unresponsive_disk_and_saves_when_it_responds(desk):
    desk.stall()
    assert "another folder" in desk.saving().problem
    desk.session.do(c.SetFov(80.0))
    desk.session.do(c.EditKeyFrames(c.KeyFrameAdd()))
    assert not desk.session._saving.write_now()
    desk.file.lets_save.set()
    desk.until(lambda: desk.saving().problem is None)
    desk.saved()
    steps = MemoryFile.kept[str(desk.file.path)][1].steps
    assert [step.label for step in steps] == list(desk.session.history())


def test_case_is_renamed_while_its_disk_does_not_respond(desk):
    case_id = desk.kept.held.record.case_id
    desk.stall()
    desk.session.do(c.RenameCase(case_id, "Nodule in RB4"))
    assert desk.saving().title == "Nodule in RB4"
    desk.file.lets_save.set()
    desk.until(lambda: desk.saving().problem is None)
    desk.saved()
    assert desk.session._saving.records.find(case_id).alias == "Nodule in RB4"


def test_case_is_saved_to_another_disk_while_its_disk_does_not_respond_and_then_closed(desk, tmp_path):
    desk.stall()
    place = tmp_path / "stick" / "mine.carina"
    place.parent.mkdir()
    with pytest.raises(UsageError, match="the case stays open") as refused:
        desk.session.do(c.CloseCase())
    assert refused.value.code == "case.not-saved"
    desk.session.do(c.SetFov(70.0))
    desk.session.do(c.SaveCase(str(place)))
    desk.background.run_all()
    assert desk.written[str(place)].steps[-1].document.look.fov_deg == 70.0
    assert (desk.saving().copy_name, desk.saving().problem is None) == ("mine.carina", False)
    desk.session.do(c.CloseCase())
    assert desk.session.snapshot().case is None
    # The writer that waits for the disk holds the claim on the case until the case is written.
    file, (keeper,) = desk.file, desk.session._saving._ending
    opener = threading.Thread(target=desk.open)
    opener.start()
    file.lets_save.set()
    opener.join(WAIT_S)
    assert keeper.has_ended
    assert not [e for e in desk.events if isinstance(e, UserMessage) and "another window" in e.message]
    assert desk.session.snapshot().document.look.fov_deg == 70.0
    assert desk.kept.copy_path == place


def test_unresponsive_network_share_delays_only_the_named_file_on_it(desk, tmp_path):
    share = tmp_path / "share.carina"
    desk.session.do(c.SaveCase(str(share)))
    desk.background.run_all()
    desk.file.lets_copy.clear()
    desk.session.do(c.SetFov(90.0))
    desk.saved()
    desk.be_silent(desk.file.copies, lambda: desk.clock.advance(61.0))
    desk.until(lambda: desk.saving().copy_problem is not None)
    desk.session.do(c.SetFov(80.0))
    desk.saved()
    assert MemoryFile.kept[str(desk.file.path)][1].steps[-1].document.look.fov_deg == 80.0
    assert desk.saving().problem is None
    desk.file.lets_copy.set()
    desk.until(lambda: desk.saving().copy_problem is None)


@pytest.fixture
def stalled_share(desk, tmp_path, monkeypatch):
    """Provide a named file whose update waits for a share, and the event that lets the update continue."""
    share, goes_on, has_begun = tmp_path / "share.carina", threading.Event(), threading.Event()
    write_copy = MemoryFile.write_copy

    def stalls(file, path, **options):
        if path == share:
            has_begun.set()
            assert goes_on.wait(3 * WAIT_S)
        write_copy(file, path, **options)

    desk.session.do(c.SaveCase(str(share)))
    desk.background.run_all()
    desk.session.do(c.SetFov(90.0))
    desk.saved()
    monkeypatch.setattr(StalledFile, "write_copy", stalls)
    desk.clock.advance(61.0)
    with desk.kept._wake:
        desk.kept._wake.notify_all()
    assert has_begun.wait(WAIT_S)
    yield share, goes_on
    goes_on.set()


def test_case_saved_to_another_file_uses_that_file_also_when_the_former_share_responds(desk, stalled_share, tmp_path):
    share, goes_on = stalled_share
    copier, stick = desk.kept._copier, tmp_path / "stick.carina"
    desk.session.do(c.SaveCase(str(stick)))
    desk.background.run_all()
    assert desk.kept.copy_path == stick
    goes_on.set()
    copier.join(WAIT_S)
    assert not copier.is_alive()
    assert (desk.kept.copy_path, desk.saving().copy_name) == (stick, "stick.carina")
    desk.saved()
    assert desk.kept.held.record.copy_path == str(stick)
    assert not lock_path(share).exists()
    assert lock_path(stick).exists()


def test_case_saved_to_another_file_is_updated_while_the_former_share_does_not_respond(desk, stalled_share, tmp_path):
    stick = tmp_path / "stick.carina"
    desk.session.do(c.SaveCase(str(stick)))
    desk.background.run_all()
    before = stick.read_text()
    desk.session.do(c.SetFov(80.0))
    desk.saved()
    desk.clock.advance(61.0)
    with desk.kept._wake:
        desk.kept._wake.notify_all()
    desk.until(lambda: desk.kept._num_copied >= desk.kept._num_saved)
    assert stick.read_text() != before
    desk.session.do(c.SetFov(70.0))
    desk.session.do(c.CloseCase())
    assert not lock_path(stick).exists(), "the case was given back"


def test_save_that_ends_after_its_case_was_closed_releases_its_file(desk, tmp_path):
    keeper, stick = desk.kept, tmp_path / "stick.carina"
    desk.file.lets_copy.clear()
    saver = threading.Thread(target=keeper.save_to, args=(stick,))
    desk.be_silent(desk.file.copies, saver.start)
    desk.session.do(c.CloseCase())
    assert keeper.has_ended
    desk.file.lets_copy.set()
    saver.join(WAIT_S)
    assert stick.exists()
    assert not lock_path(stick).exists()


def test_failed_update_of_the_named_file_is_retried_without_another_change(desk, tmp_path):
    desk.session.do(c.SaveCase(str(tmp_path / "share.carina")))
    desk.background.run_all()
    desk.session.do(c.SetFov(90.0))
    desk.saved()
    desk.file.refuses = OSError(5, "Input/output error")
    desk.clock.advance(61.0)
    with desk.kept._wake:
        desk.kept._wake.notify_all()
    desk.until(lambda: desk.saving().copy_problem is not None)
    desk.file.refuses = None
    desk.clock.advance(writer.COPY_RETRY_S + 1.0)
    with desk.kept._wake:
        desk.kept._wake.notify_all()
    desk.until(lambda: desk.saving().copy_problem is None)


def test_internal_error_while_saving_is_reported_and_later_changes_are_saved(desk):
    desk.file.refuses = TypeError("ours")
    desk.session.do(c.SetFov(90.0))
    assert not desk.session._saving.write_now()
    assert "internal error in Carina (TypeError)" in desk.saving().problem
    desk.file.refuses = None
    desk.saved()
    assert desk.saving().problem is None


def test_last_changes_are_written_to_the_named_file_if_the_disk_of_stored_cases_refuses_them(desk, tmp_path):
    place = tmp_path / "mine.carina"
    desk.session.do(c.SaveCase(str(place)))
    desk.background.run_all()
    desk.file.refuses = OSError(28, "No space left on device")
    desk.session.do(c.SetFov(70.0))
    desk.session.close()
    assert desk.written[str(place)].steps[-1].document.look.fov_deg == 70.0
    assert not [e for e in desk.events if isinstance(e, ErrorEvent)]
