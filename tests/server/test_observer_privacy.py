"""Tests of privacy towards observers: no byte of their sockets and pages contains the file name of a CT."""

from __future__ import annotations

import json
from dataclasses import replace

import httpx
import pytest
from live_server import SHOWN, WAIT_S
from observers import insecure, page_of, sharing, watching

from carina.commands import AddLearner
from carina.errors import NoResultError, VolumeImportError
from carina.server.network.access_checks import comes_from_this_machine
from carina.server.observers.window import observer_error, observer_notes
from carina.server.wire import messages as wire
from carina.server.wire.messages_from_server import CaseNote
from carina.training import Course, task_names
from carina.volume import Note
from carina.volume.note_privacy import WITHOUT_NAMES
from small_case import small_volume

pytest.importorskip("cryptography")
NAME = "SURNAME_FIRSTNAME_1951.nii.gz"
PARTS = (b"SURNAME", b"FIRSTNAME", b"1951.nii", b"surname")


def named_volume(path, *_arguments):
    """Return a CT; its file, its folder, its notes and neighbouring files contain the patient's name in their names."""
    if path.endswith("refused"):
        raise VolumeImportError(f"reading {NAME}: it is damaged; copy it again", code="import.damaged")
    volume = small_volume(title=NAME)
    notes = (
        Note("import.files-unread", f"2 files could not be used: {NAME}", badge=True),
        Note("import.copies", f"2 slices have exact duplicates ({NAME})"),
        Note("import.lossy", "the slices were compressed with loss", badge=True),
        Note("import.not-hu", f"not HU: RescaleType is {NAME}", badge=True),
    )
    other = tuple(replace(one, description=NAME) for one in volume.source.other_series)
    source = replace(volume.source, title=NAME, notes=notes, other_series=other)
    return replace(volume, source=source, is_hu=False, not_hu_reason=f"RescaleType is {NAME}")


def no_airways(*_arguments, **_options):
    raise NoResultError(f"no airways were found in {NAME}")


@pytest.fixture
def shared_case(tmp_path, monkeypatch):
    """Provide a shared case without airways, whose CT has a patient's name."""
    with sharing(
        tmp_path, monkeypatch, path="/scans/SURNAME/case", open_volume=named_volume, find_airways=no_airways
    ) as shared:
        yield shared


class Recorder:
    """Client that records all bytes that it receives on a socket."""

    def __init__(self, socket):
        self._socket = socket
        self.received = []

    def recv(self, timeout=None):
        data = self._socket.recv(timeout=timeout)
        self.received.append(data if isinstance(data, bytes) else data.encode())
        return data

    def __getattr__(self, name):
        return getattr(self._socket, name)


def assert_nameless(received):
    assert received
    for data in received:
        for text in (data, json.dumps(data.decode("utf-8", "replace")).encode()):
            for part in PARTS:
                at = text.find(part)
                assert at < 0, text[max(0, at - 200) : at + 40]


def test_messages_to_an_observer_contain_no_file_name_after_any_command_or_error(shared_case, tmp_path):
    live, window, page = shared_case
    own = window.received(lambda m: isinstance(m, wire.State) and m.case is not None)
    assert own.case.ct_name == NAME, "the user at this machine reads it"
    assert NAME in own.case.notes[0].words
    with watching(page.url) as watcher:
        watcher.socket = recorder = Recorder(watcher.socket)
        watcher.send(SHOWN)
        shown = watcher.until_state(lambda s: s.case is not None and s.airways == "failed")
        assert shown.case.title == live.session.snapshot().neutral_title
        assert shown.case.ct_name is None
        texts = {note.code: note.words for note in shown.case.notes}
        assert texts["import.lossy"] == "the slices were compressed with loss"
        assert "ask the person at the workstation" in texts["import.files-unread"]
        watcher.until(lambda m: isinstance(m, wire.PictureHeader) and m.view == "axial")
        # These commands of the user fail with messages that contain the file's name.
        window.send(wire.OpenPath("/scans/SURNAME/refused"))
        assert NAME in window.until(lambda m: isinstance(m, wire.Error)).message
        window.send(wire.SaveCase(str(tmp_path / "SURNAME" / "mine")))
        window.until(lambda m: isinstance(m, wire.Error))
        with live.http(cookie=live.cookie, origin=live.origin) as client:
            client.get("/api/airways.json")
        # These commands of the observer fail.
        watcher.send(wire.Pick(1, 99_999, 1.0, 1.0), wire.OpenPath(f"/scans/{NAME}"), wire.Probe((0.0, 0.0, 0.0)))
        watcher.until(lambda m: isinstance(m, wire.Value))
        window.send(wire.SetFov(80.0))
        watcher.until_state(lambda s: s.look.fov_deg == 80.0)
        window.send(wire.CloseCase())
        code, reason = watcher.close_code()
        assert code == wire.CLOSE_CODES["protocol.watching-ended"]
        recorder.received.append(reason.encode())
    kinds = {type(m) for m in watcher.seen}
    assert {wire.State, wire.Start, wire.HistoryMessage, wire.PoseMessage, wire.Value} <= kinds
    assert_nameless(recorder.received)


def test_pages_and_headers_for_observers_contain_no_file_name(shared_case):
    _live, _window, page = shared_case
    origin = page.url.partition("/#")[0]
    with httpx.Client(base_url=origin, verify=insecure(), timeout=WAIT_S) as client:
        for path in ("/", "/api/airways.json", "/api/cases/1/picture.jpg", "/nothing"):
            answer = client.get(path)
            headers = "\n".join(f"{key}: {value}" for key, value in answer.headers.items())
            assert_nameless([answer.content + headers.encode()])


def test_case_name_from_the_user_is_not_sent_to_observers(shared_case):
    live, window, page = shared_case
    # The name is free text and may be the patient's name.
    saving = replace_saving(live, title=NAME)
    with watching(page.url) as watcher:
        watcher.socket = recorder = Recorder(watcher.socket)
        watcher.until_state(lambda s: s.case is not None)
        window.send(wire.SetFov(81.0))
        watcher.until_state(lambda s: s.look.fov_deg == 81.0)
        assert_nameless(recorder.received)
    assert saving.title == NAME


def replace_saving(live, **values):
    """Replace fields of the saving info of a stored case."""
    core = live.session._core
    saving = core.saving().with_(keeps=True, copy_name=NAME, copy_folder="/scans/SURNAME", **values)
    core.saving = lambda: saving
    return saving


def test_messages_to_a_window_on_another_computer_contain_no_file_name(shared_case, monkeypatch):
    live, _window, _page = shared_case
    monkeypatch.setattr("carina.server.app.comes_from_this_machine", lambda _scope: False)
    with live.window() as far:
        assert far.until_state(lambda s: s.case is not None).case.ct_name is None


@pytest.mark.parametrize(
    ("client", "server", "is_here"),
    [
        (("127.0.0.1", 5), ("127.0.0.1", 80), True),
        (("::1", 5), ("::1", 80), True),
        (("::ffff:127.0.0.1", 5), ("::ffff:127.0.0.1", 80), True),
        (("192.168.1.7", 5), ("192.168.1.7", 80), True),
        (("192.168.1.8", 5), ("192.168.1.7", 80), False),
        (("192.168.1.8", 5), None, False),
        (("testclient", 5), ("127.0.0.1", 80), False),
        (None, ("127.0.0.1", 80), False),
    ],
)
def test_connection_counts_as_local_if_it_does_not_leave_the_computer(client, server, is_here):
    assert comes_from_this_machine({"client": client, "server": server}) is is_here


def test_notes_for_observers_are_replaced_unless_their_code_guarantees_text_without_names():
    notes = [CaseNote(code, f"words of {NAME}", True) for code in ("import.some-new-code", "import.not-hu")]
    assert all(NAME not in note.words for note in observer_notes(notes))
    assert [note.code for note in observer_notes(notes)] == ["import.some-new-code", "import.not-hu"]
    assert observer_notes([CaseNote("import.copies", "a passing note", False)]) == ()
    allowed = [CaseNote(code, "fixed words", True) for code in (*sorted(WITHOUT_NAMES), "airways.doubted")]
    assert list(observer_notes(allowed)) == allowed
    assert {"import.tilt-corrected", "import.slices-interpolated", "import.slices-resampled"} <= WITHOUT_NAMES


def test_errors_for_observers_contain_their_code_without_their_text():
    assert NAME not in observer_error(wire.Error("import.damaged", f"reading {NAME}", NAME)).message
    assert observer_error(wire.Error("import.damaged", "x", None)).code == "import.damaged"
    refused = wire.Error("session.watching", "you are watching", None)
    assert observer_error(refused) == refused


def test_observer_receives_the_training_without_learners(shared_case, tmp_path):
    live, _, page = shared_case
    live.session._course._course = Course(tmp_path / "learners")
    live.session.do(AddLearner("Blue heron"))
    with watching(page.url) as watcher:
        watcher.socket = recorder = Recorder(watcher.socket)
        watcher.send(SHOWN)
        shown = watcher.until(lambda m: isinstance(m, wire.TrainingMessage))
        assert len(shown.tasks) == len(task_names())
        assert not shown.course.stores
    assert not any(b"heron" in data for data in recorder.received)


def test_teacher_receives_pseudonyms_only_while_the_user_shares_the_learners(shared_case, tmp_path):
    live, window, page = shared_case
    live.session._course._course = Course(tmp_path / "learners")
    live.session.do(AddLearner("Blue heron"))
    with watching(page.url) as watcher:
        watcher.send(SHOWN)
        first = watcher.until(lambda m: isinstance(m, wire.TrainingMessage))
        assert first.classroom == ()
        window.send(wire.SetWatchPage(on=True, learners=True))
        assert page_of(window, lambda one: one is not None and one.learners).url == page.url, "the link is unchanged"
        shown = watcher.until(lambda m: isinstance(m, wire.TrainingMessage) and m.classroom)
        assert [(one.learner.name, one.attempts) for one in shown.classroom] == [("Blue heron", ())]
        assert not shown.course.stores
        assert (shown.task_folder, shown.task_problems) == (None, ())
        # Another process adds a learner to the folder, which the server reads again by itself.
        Course(tmp_path / "learners").add("Grey wagtail")
        watcher.until(lambda m: isinstance(m, wire.TrainingMessage) and len(m.classroom) == 2)
        window.send(wire.SetWatchPage(on=True, learners=False))
        watcher.until(lambda m: isinstance(m, wire.TrainingMessage) and not m.classroom)
        # A page that is opened again shares nothing.
        window.send(wire.SetWatchPage(on=True, learners=True))
        page_of(window, lambda one: one is not None and one.learners)
        window.send(wire.SetWatchPage(on=False))
        window.until(lambda m: isinstance(m, wire.Watching) and m.page is None)
        window.send(wire.SetWatchPage(on=True))
        assert not page_of(window).learners
