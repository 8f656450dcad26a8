"""Tests of work that no disk has stored: its description, and the question or error when the session ends."""

from __future__ import annotations

import errno
import os
import threading
from dataclasses import replace

import pytest

from carina import commands as c
from carina.errors import CarinaError, UnsavedWorkError
from carina.server.unsaved_question import ConsoleTerminal, close_session
from carina.session.attach.remote_case import RemoteCase
from carina.session.attach.working_copy import NamedCase
from carina.session.saving import writer
from carina.session.saving.unsaved_work import unsaved_labels
from restartable_workstation import MemoryFile, RestartableWorkstation

WAIT_S = 60.0


class ScriptedTerminal:
    """Terminal of a user whose answers are given; an exception among the answers is raised."""

    def __init__(self, *answers, is_interactive=True):
        self.is_interactive = is_interactive
        self.answers = list(answers)
        self.printed = []
        self.num_questions = 0

    def say(self, text):
        self.printed.append(text)

    def ask(self, _prompt):
        self.num_questions += 1
        answer = self.answers.pop(0) if self.answers else None
        if callable(answer):
            answer = answer()
        if isinstance(answer, BaseException):
            raise answer
        return answer

    @property
    def text(self):
        return "\n".join(self.printed)


@pytest.fixture
def workstation(tmp_path, monkeypatch):
    """Provide a case with three saved changes and five more on a full disk."""
    MemoryFile.contents.clear()
    monkeypatch.setattr(writer, "SLOW_S", WAIT_S)
    workstation = RestartableWorkstation(tmp_path)
    workstation.start()
    workstation.open()
    for outline in ("octagon", "none", "round"):
        workstation.session.do(c.SetOutline(outline))
    workstation.saved()
    fill(workstation)
    for n in range(5):
        workstation.session.do(c.EditKeyFrames(c.KeyFrameAdd()))
        workstation.clock.advance(2.0)
        assert len(workstation.session.history()) == 4 + n
    yield workstation
    clear(workstation)
    workstation.session.close()


def fill(workstation):
    workstation.files[-1].refuses = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def clear(workstation):
    workstation.files[-1].refuses = None


def saved_steps(workstation):
    return [step.label for step in MemoryFile.contents[str(workstation.files[-1].path)][1].steps]


def test_unsaved_work_report_names_changes_case_reason_and_last_saved_state(workstation):
    (work,) = workstation.session.cases.unsaved()
    assert len(work.labels) == 5
    assert work.labels == tuple(workstation.session.history()[3:])
    assert work.title == workstation.session.snapshot().neutral_title
    assert "disk" in work.problem
    assert (work.saved_path, work.num_saved) == (workstation.files[-1].path, 3)
    assert work.amount == "5 changes"
    assert str(workstation.files[-1].path) in work.saved_state


def test_session_without_unsaved_work_ends_without_a_question(workstation):
    clear(workstation)
    terminal = ScriptedTerminal()
    close_session(workstation.session, terminal)
    assert (terminal.num_questions, terminal.printed) == (0, [])
    assert len(saved_steps(workstation)) == 8


def named_file(workstation, tmp_path):
    """Save the case to a file, change the case again, and return the path of the file."""
    clear(workstation)
    path = tmp_path / "share" / "team.carina"
    path.parent.mkdir()
    workstation.session.do(c.SaveCase(str(path)))
    workstation.background.run_all()
    workstation.session.do(c.SetOutline("octagon"))
    workstation.saved()
    return path


def test_closing_carina_reports_a_named_file_that_another_program_changed(workstation, tmp_path):
    """Check the message on the terminal, because no window remains to show it."""
    path = named_file(workstation, tmp_path)
    path.write_text("a letter")
    terminal = ScriptedTerminal(is_interactive=False)
    close_session(workstation.session, terminal)
    assert path.read_text() == "a letter"
    assert "team.carina was changed elsewhere" in terminal.text
    assert "saved in the case on this computer" in terminal.text
    assert len(saved_steps(workstation)) == 9


def test_closing_carina_reports_a_named_file_that_could_not_be_updated(workstation, tmp_path, monkeypatch):
    path = named_file(workstation, tmp_path)
    before = path.read_text()

    def refuses(*_arguments, **_options):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(MemoryFile, "write_copy", refuses)
    terminal = ScriptedTerminal(is_interactive=False)
    close_session(workstation.session, terminal)
    assert path.read_text() == before
    assert "team.carina" in terminal.text
    assert "read-only" in terminal.text
    assert "saved in the case on this computer" in terminal.text
    assert len(saved_steps(workstation)) == 9


def test_program_that_took_over_a_case_is_warned_of_a_named_file_changed_elsewhere(workstation, tmp_path):
    path = named_file(workstation, tmp_path)
    path.write_text("a letter")
    records = workstation.session._saving.records
    joined = RemoteCase(records, workstation.session.cases.open_case[0], workstation.session, None, None)
    with pytest.warns(UserWarning, match=r"team\.carina was changed elsewhere"):
        joined.close()
    assert path.read_text() == "a letter"
    assert len(saved_steps(workstation)) == 9


def test_unsaved_work_without_a_terminal_raises_an_error_without_a_question(workstation):
    terminal = ScriptedTerminal(is_interactive=False)
    with pytest.raises(UnsavedWorkError) as lost:
        close_session(workstation.session, terminal)
    assert terminal.num_questions == 0
    assert (lost.value.exit_code, lost.value.code) == (5, "case.not-saved")
    text = str(lost.value)
    for part in ("5 changes", "could not be saved", "with 3 changes", str(workstation.files[-1].path)):
        assert part in text
    assert len(saved_steps(workstation)) == 3


def test_terminal_lists_unsaved_work_and_saves_it_on_retry(workstation):
    terminal = ScriptedTerminal("r", lambda: (clear(workstation), "r")[1])
    close_session(workstation.session, terminal)
    assert terminal.num_questions == 2
    assert "5 changes" in terminal.text and str(workstation.files[-1].path) in terminal.text
    assert len(saved_steps(workstation)) == 8


def test_save_to_another_folder_stores_all_unsaved_changes(workstation, tmp_path):
    stick = tmp_path / "stick"
    stick.mkdir()
    steps = workstation.session.history()
    name = workstation.session.snapshot().neutral_title.replace(" ", "-")
    terminal = ScriptedTerminal(str(stick))
    close_session(workstation.session, terminal)
    (written,) = stick.iterdir()
    assert written.name == f"{name}.carina"
    moment = workstation.written[str(written)]
    assert tuple(step.label for step in moment.steps) == steps
    assert f"saved as {written}" in terminal.text


def test_changes_saved_to_another_folder_count_as_saved_after_an_event_without_changes(workstation, tmp_path):
    (work,) = workstation.session.cases.unsaved()
    workstation.session.cases.save_elsewhere(work.case_number, tmp_path / "elsewhere.carina")
    workstation.session._core.changed("state", "jobs")
    assert workstation.session.cases.unsaved() == ()
    terminal = ScriptedTerminal()
    close_session(workstation.session, terminal)
    assert (terminal.num_questions, terminal.printed) == (0, [])


def test_change_after_a_save_to_another_folder_is_unsaved_and_the_report_names_that_file(workstation, tmp_path):
    (work,) = workstation.session.cases.unsaved()
    elsewhere = workstation.session.cases.save_elsewhere(work.case_number, tmp_path / "elsewhere")
    workstation.session.do(c.SetOutline("octagon"))
    (work,) = workstation.session.cases.unsaved()
    assert work.labels == (workstation.session.history()[-1],)
    assert (work.saved_path, work.num_saved, work.copy_path) == (elsewhere, 8, None)
    clear(workstation)
    assert workstation.session.cases.unsaved() == ()
    assert len(saved_steps(workstation)) == 9


def test_flight_recorded_before_a_save_to_another_folder_is_saved_and_the_next_is_not(workstation, tmp_path):
    for _ in range(2):
        workstation.session.do(c.RecordFlight())
        workstation.session.do(c.Steer(1.0, 0.0, 0.0, 0.0))
        workstation.session.do(c.StopRecording())
        if not (tmp_path / "elsewhere.carina").exists():
            (work,) = workstation.session.cases.unsaved()
            assert work.num_flights == 1
            workstation.session.cases.save_elsewhere(work.case_number, tmp_path / "elsewhere.carina")
            assert workstation.session.cases.unsaved() == ()
    (work,) = workstation.session.cases.unsaved()
    assert (work.num_flights, work.labels) == (1, ())


def test_changes_stay_unsaved_if_the_file_could_not_be_written_to_the_other_folder(workstation, tmp_path, monkeypatch):
    def refuses(*_arguments):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    (work,) = workstation.session.cases.unsaved()
    with monkeypatch.context() as patch:
        for name in ("replace", "rename", "link"):
            patch.setattr(os, name, refuses)
        with pytest.raises(CarinaError, match="read-only"):
            workstation.session.cases.save_elsewhere(work.case_number, tmp_path / "elsewhere")
    assert workstation.session.cases.unsaved() == (work,)


def test_unusable_save_path_is_refused_and_requested_again(workstation, tmp_path):
    taken = tmp_path / "taken.carina"
    taken.write_bytes(b"another case")
    terminal = ScriptedTerminal(str(taken), str(tmp_path / "nowhere" / "x"), str(tmp_path / "free"))
    close_session(workstation.session, terminal)
    assert terminal.num_questions == 3
    assert "already exists" in terminal.text and "does not exist" in terminal.text
    assert taken.read_bytes() == b"another case"
    assert str(tmp_path / "free.carina") in workstation.written


@pytest.mark.parametrize("answer", ["q", None, KeyboardInterrupt()])
def test_quit_interrupt_and_closed_terminal_raise_the_error_about_unsaved_work(workstation, answer):
    terminal = ScriptedTerminal(answer)
    with pytest.raises(UnsavedWorkError, match="5 changes"):
        close_session(workstation.session, terminal)
    assert terminal.num_questions == 1


def test_interrupt_before_the_question_raises_the_error_about_unsaved_work(workstation, monkeypatch):
    settle = workstation.session.cases.unsaved
    calls = []

    def interrupted():
        calls.append(1)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return settle()

    monkeypatch.setattr(workstation.session.cases, "unsaved", interrupted)
    terminal = ScriptedTerminal()
    with pytest.raises(UnsavedWorkError, match="5 changes"):
        close_session(workstation.session, terminal)
    assert terminal.num_questions == 0


def test_undone_changes_that_are_not_saved_count_as_unsaved(workstation):
    for _ in range(6):
        workstation.session.do(c.Undo())
    (work,) = workstation.session.cases.unsaved()
    assert work.labels == (f"undo: {saved_steps(workstation)[-1]}",)


def test_moved_tip_is_not_an_unsaved_change(workstation):
    clear(workstation)
    workstation.saved()
    fill(workstation)
    workstation.session.do(c.Steer(1.0, 0.0, 0.0, 0.0))
    terminal = ScriptedTerminal()
    close_session(workstation.session, terminal)
    assert terminal.num_questions == 0


def test_failed_save_that_began_before_the_disk_recovered_is_repeated_at_once(workstation, monkeypatch):
    begun, goes_on = threading.Event(), threading.Event()

    def refuses(_moment):
        begun.set()
        assert goes_on.wait(WAIT_S)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(workstation.files[-1], "save", refuses)
        workstation.session.do(c.SetOutline("octagon"))
        # An earlier attempt may still be failing; the next attempt is due 2 s after it on this clock.
        for _ in range(100):
            workstation.clock.advance(10.0)
            if begun.wait(WAIT_S / 100):
                break
        assert begun.is_set()
    clear(workstation)
    keeper = workstation.session._saving._saver
    results = []
    asking = threading.Thread(target=lambda: results.append(workstation.session._saving.write_now()))
    asking.start()
    with keeper._wake:
        assert keeper._wake.wait_for(lambda: keeper._is_urgent, WAIT_S)
    goes_on.set()
    asking.join(WAIT_S)
    assert results == [True]
    assert len(saved_steps(workstation)) == 9


def test_later_value_of_a_dragged_setting_is_unsaved_and_a_step_without_a_stored_command_is_not(workstation):
    moment = workstation.session.ask(c.CurrentMoment())
    *steps, last = moment.steps
    later = replace(moment, steps=(*steps, replace(last, command=c.SetFov(91.0))))
    assert unsaved_labels(moment, later) == (last.label,)
    unknown = replace(moment, steps=(*steps, replace(last, command=None)))
    assert unsaved_labels(moment, unknown) == unsaved_labels(unknown, moment) == ()


def test_new_case_name_that_could_not_be_saved_counts_as_unsaved(workstation, monkeypatch):
    clear(workstation)
    workstation.saved()

    def refuses(*_arguments, **_options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("carina.session.store.registry.write_whole", refuses)
    case_id = workstation.session.cases.open_case[0]
    workstation.session.do(c.RenameCase(case_id, "Nodule in RB4"))
    (work,) = workstation.session.cases.unsaved()
    assert (work.title, work.labels) == ("Nodule in RB4", ("name of the case",))
    monkeypatch.undo()


def test_thumbnail_is_not_made_if_the_case_could_not_be_saved(workstation, caplog):
    with pytest.raises(UnsavedWorkError):
        close_session(workstation.session, ScriptedTerminal(is_interactive=False))
    assert "thumbnail" not in caplog.text


def test_report_of_unsaved_work_has_no_control_characters_and_a_limited_number_of_labels(workstation):
    (work,) = workstation.session.cases.unsaved()
    hostile = replace(work, labels=(*["x\x1b[2J" * 1000] * 400,))
    assert "\x1b" not in hostile.shown_labels
    assert len(hostile.shown_labels) < 400
    assert hostile.shown_labels.endswith("and 397 more")


def test_two_equal_states_have_no_unsaved_changes(workstation):
    moment = workstation.session.ask(c.CurrentMoment())
    assert unsaved_labels(moment, moment) == ()
    assert unsaved_labels(None, moment) == workstation.session.history()


def test_program_that_lost_the_owner_of_its_case_refuses_to_close_with_unsaved_changes(workstation, tmp_path):
    moment = workstation.session.ask(c.CurrentMoment())
    saved = MemoryFile.contents[str(workstation.files[-1].path)][1]
    named = NamedCase()
    named.note = "this program cannot take over: another program has it open"
    named.check_saved(moment, last_saved=moment, live=tmp_path / "case.carina")
    with pytest.raises(UnsavedWorkError, match="5 changes") as lost:
        named.check_saved(moment, last_saved=saved, live=tmp_path / "case.carina")
    assert "cannot take over" in str(lost.value) and str(tmp_path / "case.carina") in str(lost.value)
    named.note = None
    named.check_saved(moment, last_saved=saved, live=tmp_path / "case.carina")


def test_terminal_whose_console_is_gone_is_not_interactive():
    assert not ConsoleTerminal(is_closed=True).is_interactive


def test_terminal_shows_no_control_characters_of_file_names(capsys):
    terminal = ConsoleTerminal()
    terminal.say("saved as cases/\x1b[31mred\x07.carina")
    shown = capsys.readouterr().err
    assert "\x1b" not in shown
    assert "\x07" not in shown
    assert shown.startswith("saved as cases/")
