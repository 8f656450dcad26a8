"""Tests of the messages about PACS with a real Orthanc on loopback: connections, search, retrieval, privacy."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from dicom_writer import series
from live_server import WAIT_S, open_case
from nodules import ellipsoid
from orthanc_server import free_port, require_orthanc, running_orthanc

import carina
import carina.pacs
from cached_test_data import masked_chest
from carina.errors import CancelledError
from carina.export.plan_dicom_seg import write_target_seg
from carina.pacs.retrieval_folder import RetrievalFolder
from carina.server import pacs_requests
from carina.server.pacs_requests import FOR_WINDOW, SENDING, PacsRequests, text_for_window
from carina.server.wire import messages as wire
from carina.volume import open_volume
from training_workstation import Workstation, until

pytest.importorskip("pynetdicom", reason="needs the extra dicom")
pytest.importorskip("dicomweb_client", reason="needs the extra dicom")

STUDY, SERIES = "1.2.3.4.5", "1.2.3.77.1"


def dated(dataset, index):
    dataset.StudyDate, dataset.PatientName, dataset.InstanceNumber = "20261103", "Muster^Erika", index + 1


@pytest.fixture(scope="module")
def orthanc(tmp_path_factory):
    require_orthanc()
    folder = tmp_path_factory.mktemp("orthanc")
    with running_orthanc(folder) as server:
        server.upload(series(folder / "scan", dated, uid=SERIES))
        yield server


@pytest.fixture(autouse=True)
def settings(tmp_path, monkeypatch):
    """Store connections and retrieved series in temporary folders, and passwords in a file."""
    monkeypatch.setitem(sys.modules, "keyring", None)
    real = pacs_requests.load_settings()
    folders = SimpleNamespace(retrieved_dir=tmp_path / "retrieved", config_dir=tmp_path / "config")
    monkeypatch.setattr(pacs_requests, "load_settings", lambda: folders)
    monkeypatch.setattr("carina.config.load_settings", lambda *_: folders)
    return real


def fields(**values):
    first = {
        "name": "hospital", "host": "127.0.0.1", "port": 104, "called_ae": "ORTHANC", "calling_ae": "CARINA",
        "listen_port": None, "listen_host": "", "tls": False, "url": "", "user": "", "ca_file": "",
    }  # fmt: skip
    return wire.PacsFields(**(first | values))


def answer(window, kind):
    found = window.until(lambda m: isinstance(m, (kind, wire.PacsProblemMessage)))
    assert isinstance(found, kind), found
    return found


def problem(window):
    return window.until(lambda m: isinstance(m, wire.PacsProblemMessage))


def connected(window, orthanc):
    window.send(wire.SavePacs(fields(port=orthanc.dicom_port), None))
    return answer(window, wire.PacsConnectionsMessage)


def test_connection_is_added_edited_tested_and_deleted(live, orthanc):
    with live.window() as window:
        assert [one.name for one in connected(window, orthanc).connections] == ["hospital"]
        window.send(wire.TestPacs("hospital"))
        test = answer(window, wire.PacsTestMessage)
        assert test.passed
        assert [step.name for step in test.steps] == ["network", "C-ECHO"]
        window.send(wire.SavePacs(fields(name="clinic", port=orthanc.dicom_port, called_ae="NOBODY"), None, "hospital"))
        assert [one.name for one in answer(window, wire.PacsConnectionsMessage).connections] == ["clinic"]
        window.send(wire.TestPacs("clinic"))
        failed = answer(window, wire.PacsTestMessage)
        assert not failed.passed
        assert "does not have the AE title NOBODY; ask its administrator" in failed.steps[-1].finding
        window.send(wire.RemovePacs("clinic"))
        assert answer(window, wire.PacsConnectionsMessage).connections == ()


def test_edited_connection_has_its_former_password_unless_a_new_one_is_given(live):
    web = {"host": "", "url": "https://pacs.example.org/dicom-web", "user": "erika"}
    with live.window() as window:
        window.send(wire.SavePacs(fields(**web), "geheim-1"))
        saved = answer(window, wire.PacsConnectionsMessage)
        assert "geheim" not in wire.encode_message(saved)
        window.send(wire.SavePacs(fields(name="clinic", **web), None, "hospital"))
        answer(window, wire.PacsConnectionsMessage)
        assert carina.pacs.PacsConnections().get("clinic").password == "geheim-1"
        window.send(wire.SavePacs(fields(name="clinic", **web), "geheim-2", "clinic"))
        answer(window, wire.PacsConnectionsMessage)
        assert carina.pacs.PacsConnections().get("clinic").password == "geheim-2"


@pytest.mark.parametrize(("change", "words"), [({"host": ""}, "expected the host name"), ({"name": "a/b"}, "a name")])
def test_invalid_connection_is_refused_with_the_reason(live, change, words):
    with live.window() as window:
        window.send(wire.SavePacs(fields(**change), None))
        found = problem(window)
        assert (found.task, found.code) == ("settings", "usage.pacs")
        assert words in found.problem


def test_new_connection_does_not_replace_one_of_its_name(live, orthanc):
    with live.window() as window:
        connected(window, orthanc)
        window.send(wire.SavePacs(fields(host="other.example"), None))
        assert "choose another name" in problem(window).problem


def test_series_is_found_retrieved_and_opened_as_a_case_without_a_name_in_its_path(live, orthanc, tmp_path, caplog):
    caplog.set_level(logging.DEBUG)
    with live.window() as window:
        connected(window, orthanc)
        window.send(wire.SearchPacs("hospital", "Muster", "", ""))
        found = answer(window, wire.PacsStudiesMessage)
        (study,) = found.studies
        assert (study.patient_name, study.date, found.has_more) == ("Muster^Erika", "2026-11-03", False)
        window.send(wire.AskPacsSeries("hospital", study.study_uid))
        listed = answer(window, wire.PacsSeriesMessage)
        assert (listed.preselected, listed.series[0].num_images) == (SERIES, 20)
        assert listed.reason.startswith("the likeliest chest CT: 20 images")
        preview = answer(window, wire.PacsPreviewMessage)
        assert (preview.series_uid, preview.scanned_on) == (SERIES, "2026-11-03")
        assert preview.picture is not None
        window.send(wire.GetPacsSeries("hospital", study.study_uid, SERIES))
        window.until_state(lambda state: state.case is not None)
        (opened,) = live.opened
        place = Path(opened)
        assert place.parent == tmp_path / "retrieved"
        assert len(list(place.iterdir())) == 20
        assert not any(text in str(place) for text in ("Muster", STUDY, SERIES))
        window.send(wire.EmptyPacs())
        assert "close the case first" in problem(window).problem
        window.send(wire.CloseCase())
        window.until_state(lambda state: state.case is None)
        window.send(wire.EmptyPacs())
        assert answer(window, wire.PacsConnectionsMessage).num_retrieved == 0
        assert not place.exists()
    # The WebSocket library logs every frame at DEBUG, on both sides of this process.
    logged = [record.getMessage() for record in caplog.records if not record.name.startswith("websockets")]
    assert not any(text in line for line in logged for text in ("Muster", STUDY, SERIES))
    stored = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert not any(b"Muster" in path.read_bytes() for path in stored)


def test_files_of_a_plan_are_stored_with_the_name_of_the_patient(live, tmp_path, monkeypatch):
    scan = series(tmp_path / "scan", dated, uid=SERIES)
    volume = open_volume(scan)
    target = ellipsoid([4.0, 3.0, 5.0], volume.centre_lps, step_mm=0.4)
    asked = []

    def write(_session, target_id, suffixes, folder, *, identity, job):
        asked.append((target_id, suffixes, identity))
        job.progress("writing", 0.5)
        return [write_target_seg(folder / "plan.seg.dcm", target, volume=volume, ct=scan, identity=identity)]

    monkeypatch.setattr(pacs_requests, "write_archive_files", write)
    (tmp_path / "server").mkdir()
    with running_orthanc(tmp_path / "server", DicomAlwaysAllowStore=True) as server, live.window() as window:
        connected(window, server)
        window.send(wire.SendPlanToPacs("hospital", "target-1", ("seg", "sr")))
        sent = answer(window, wire.PacsSentMessage)
        assert (sent.name, sent.target_id, sent.num_stored, sent.refused) == ("hospital", "target-1", 1, ())
        assert asked == [("target-1", [".seg.dcm", ".sr.dcm"], "from the CT")]
        (study,) = server.request("/studies?expand")
        assert study["PatientMainDicomTags"]["PatientName"] == "Muster^Erika"


def test_plan_without_a_dicom_folder_is_refused_and_nothing_is_sent(live, orthanc):
    with live.window() as window:
        open_case(window)
        connected(window, orthanc)
        before = orthanc.num_instances()
        window.send(wire.SendPlanToPacs("hospital", "target-1", ("seg",)))
        found = problem(window)
        assert (found.task, found.target_id) == ("send", "target-1")
        assert orthanc.num_instances() == before


def test_other_windows_and_observers_receive_no_search_result(live, orthanc):
    with live.window() as window, live.window() as other:
        connected(window, orthanc)
        window.send(wire.SearchPacs("hospital", "", "", "2026-11-03"))
        answer(window, wire.PacsStudiesMessage)
        other.send(wire.AskPacs())
        answer(other, wire.PacsConnectionsMessage)
        assert not any("Muster" in wire.encode_message(message) for message in other.seen)


def test_window_on_another_machine_may_not_use_the_pacs(live):
    requests = PacsRequests(live.session)
    sent = []
    away = SimpleNamespace(number=1, at_machine=False, send=sent.append)
    for message, task in (
        (wire.AskPacs(), "settings"),
        (wire.SearchPacs("hospital", "Muster", "", ""), "search"),
        (wire.SendPlanToPacs("hospital", "target-1", ("seg",)), "send"),
    ):
        assert requests.handle(message, away)
        found = sent.pop()
        assert (found.task, found.code) == (task, "pacs.other-machine")
        assert "only in a browser on the machine" in found.problem
    assert requests.handle(wire.StopPacs(), away)
    assert requests.handle(wire.AskStorage(), away) is False
    assert sent == []
    assert live.session.jobs.running == ()


# pynetdicom leaves the socket of a refused connection to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_failed_search_and_retrieval_state_the_reason_and_the_open_case_stays(live):
    with live.window() as window:
        before = open_case(window)
        window.send(wire.SavePacs(fields(port=free_port()), None))
        answer(window, wire.PacsConnectionsMessage)
        window.send(wire.SearchPacs("hospital", "", "17", ""))
        found = problem(window)
        assert (found.task, found.code) == ("search", "pacs.offline")
        assert "no program answers" in found.problem
        window.send(wire.GetPacsSeries("hospital", STUDY, SERIES))
        assert problem(window).task == "get"
        window.send(wire.SearchPacs("hospital", "", "", "yesterday"))
        assert "expected 2026-11-30" in problem(window).problem
        assert live.session.snapshot().case_number == before.case.number


def held_job(monkeypatch, name, result):
    """Replace a function of carina.pacs by one that waits; return the event that it has begun, and the one to end."""
    begun, end = threading.Event(), threading.Event()

    def function(*_, **__):
        begun.set()
        assert end.wait(WAIT_S)
        return result

    monkeypatch.setattr(carina.pacs, name, function)
    return begun, end


FOUND = carina.pacs.PacsStudies(
    (carina.pacs.PacsStudy(STUDY, "Muster^Erika", "17", "2026-11-03", "Chest", ("CT",), 1),), has_more=False
)


def until_idle(live):
    assert live.session.jobs.wait_idle(WAIT_S)


def test_closed_dialog_receives_no_name_from_a_search_that_ends_later(live, monkeypatch):
    begun, end = held_job(monkeypatch, "find_studies", FOUND)
    with live.window() as window:
        window.send(wire.SavePacs(fields(), None))
        answer(window, wire.PacsConnectionsMessage)
        window.send(wire.SearchPacs("hospital", "Muster", "", ""))
        assert begun.wait(WAIT_S)
        window.send(wire.StopPacs(), wire.AskPacs())
        answer(window, wire.PacsConnectionsMessage)  # the window has handled both messages
        end.set()
        until_idle(live)
        window.send(wire.AskPacs())
        answer(window, wire.PacsConnectionsMessage)
        assert not any("Muster" in wire.encode_message(message) for message in window.seen)


def test_closed_dialog_receives_no_series_and_no_preview(live, monkeypatch):
    series = carina.pacs.PacsSeries(SERIES, STUDY, "CT", "Muster", 1, 20)
    begun, end = held_job(monkeypatch, "preview_series", carina.pacs.SeriesPreview(picture=b"Muster"))
    monkeypatch.setattr(carina.pacs, "find_series", lambda *_, **__: (series,))
    with live.window() as window:
        window.send(wire.SavePacs(fields(), None))
        answer(window, wire.PacsConnectionsMessage)
        window.send(wire.AskPacsSeries("hospital", STUDY))
        answer(window, wire.PacsSeriesMessage)
        assert begun.wait(WAIT_S)
        window.send(wire.StopPacs(), wire.AskPacs())
        answer(window, wire.PacsConnectionsMessage)
        end.set()
        until_idle(live)
        window.send(wire.AskPacs())
        answer(window, wire.PacsConnectionsMessage)
        kinds = [type(message) for message in window.seen]
        assert kinds.count(wire.PacsSeriesMessage) == 1
        assert wire.PacsPreviewMessage not in kinds


def test_search_of_a_window_continues_when_another_window_searches_or_closes_its_dialog(live, monkeypatch):
    begun, end = held_job(monkeypatch, "find_studies", FOUND)
    with live.window() as window, live.window() as other:
        window.send(wire.SavePacs(fields(), None))
        answer(window, wire.PacsConnectionsMessage)
        window.send(wire.SearchPacs("hospital", "Muster", "", ""))
        assert begun.wait(WAIT_S)
        other.send(wire.SearchPacs("hospital", "", "17", ""), wire.StopPacs(), wire.AskPacs())
        answer(other, wire.PacsConnectionsMessage)
        end.set()
        assert answer(window, wire.PacsStudiesMessage).studies
        until_idle(live)
        assert not any(isinstance(message, wire.PacsStudiesMessage) for message in other.seen)


def test_search_of_a_window_that_has_left_is_stopped(live, monkeypatch):
    begun, end = held_job(monkeypatch, "find_studies", FOUND)
    with live.window() as window, live.window() as other:
        window.send(wire.SavePacs(fields(), None))
        answer(window, wire.PacsConnectionsMessage)
        until_idle(live)  # the job that saves the connection ends after its answer
        other.send(wire.SearchPacs("hospital", "Muster", "", ""))
        assert begun.wait(WAIT_S)
        other.socket.close()
        (job,) = live.session.jobs.running
        until(job.cancel)
        end.set()


# -- retrieval ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def held(monkeypatch):
    """Replace the retrieval by one that waits until the test ends it or the job is stopped."""
    calls = []

    def retrieve(_connection, _study, series, folder, *, reuse, progress, cancel):
        assert reuse, "an earlier retrieval must be compared with the PACS"
        progress("Retrieving the images", 0.5)
        call = SimpleNamespace(series=series, folder=folder, end=threading.Event(), cancel=cancel)
        calls.append(call)
        with RetrievalFolder(folder, series, replaces=True) as place:
            place.add(f"{series}.1", b"image")
            while not call.end.wait(0.01):
                if cancel():
                    raise CancelledError("stopped")
            place.complete([f"{series}.1"])
        return carina.pacs.Retrieved(folder, 1, 0)

    monkeypatch.setattr(carina.pacs, "retrieve_series", retrieve)
    return calls


def get(window, series=SERIES, name="hospital"):
    window.send(wire.GetPacsSeries(name, STUDY, series))


def saved(window, *names):
    for name in names or ("hospital",):
        window.send(wire.SavePacs(fields(name=name), None))
        answer(window, wire.PacsConnectionsMessage)


def test_same_series_of_two_connections_has_two_folders(live, held):
    with live.window() as window:
        saved(window, "hospital", "clinic")
        get(window, name="hospital")
        until(lambda: len(held) == 1)
        get(window, name="clinic")
        until(lambda: len(held) == 2)
        assert held[0].folder != held[1].folder
        assert held[0].cancel(), "another series replaces the retrieval of this window"
        held[1].end.set()
        window.until_state(lambda state: state.case is not None)
        assert live.opened == [str(held[1].folder)]


def test_repeated_click_on_a_series_does_not_stop_its_retrieval(live, held):
    with live.window() as window:
        saved(window)
        get(window)
        until(lambda: len(held) == 1)
        get(window)
        window.send(wire.AskPacs())
        answer(window, wire.PacsConnectionsMessage)
        assert not held[0].cancel()
        held[0].end.set()
        window.until_state(lambda state: state.case is not None)
        assert len(held) == 1


def test_second_window_cannot_retrieve_the_same_series_meanwhile(live, held):
    with live.window() as window, live.window() as other:
        saved(window)
        get(window)
        until(lambda: len(held) == 1)
        get(other)
        found = problem(other)
        assert (found.task, found.code) == ("get", "pacs.busy")
        assert not held[0].cancel()
        held[0].end.set()
        window.until_state(lambda state: state.case is not None)


def test_retrieved_series_are_not_deleted_during_a_retrieval_or_an_opening(live, held):
    with live.window() as window:
        saved(window)
        get(window)
        until(lambda: len(held) == 1)
        window.send(wire.EmptyPacs())
        found = problem(window)
        assert (found.task, found.code) == ("settings", "pacs.in-use")
        assert "being retrieved or opened" in found.problem
        held[0].end.set()
        window.until_state(lambda state: state.case is not None)
        assert list(held[0].folder.iterdir())


@pytest.mark.parametrize("kind", ["open", "pacs-get-7-abc"])
def test_retrieved_series_are_not_deleted_while_a_job_may_read_them(live, kind):
    end = threading.Event()
    place = pacs_requests.retrieved_folder() / "series-abc"
    place.mkdir(parents=True)
    live.session.jobs.start(kind, "reading", lambda _job: end.wait(WAIT_S))
    with live.window() as window:
        window.send(wire.EmptyPacs())
        assert problem(window).code == "pacs.in-use"
        assert place.is_dir()
        end.set()
        until_idle(live)
        window.send(wire.EmptyPacs())
        answer(window, wire.PacsConnectionsMessage)
        assert not place.exists()


def test_retrieval_continues_when_another_case_is_opened_and_does_not_close_it(live, held):
    with live.window() as window:
        saved(window)
        get(window)
        until(lambda: len(held) == 1)
        opened = open_case(window)
        assert not held[0].cancel()
        held[0].end.set()
        notice = window.until(lambda m: isinstance(m, wire.Notice) and "retrieved" in m.message)
        assert "another case was opened in the meantime" in notice.message
        until_idle(live)
        assert live.session.snapshot().case_number == opened.case.number
        assert live.opened == ["case"]


def test_retrieved_series_opens_in_place_of_the_case_of_the_request_or_of_none(live, held):
    with live.window() as window:
        saved(window)
        open_case(window)
        get(window)
        until(lambda: len(held) == 1)
        held[0].end.set()
        until(lambda: len(live.opened) == 2)
        until_idle(live)
        get(window, "1.2.3.77.9")
        until(lambda: len(held) == 2)
        window.send(wire.CloseCase())
        window.until_state(lambda state: state.case is None)
        held[1].end.set()
        until(lambda: len(live.opened) == 3)
        assert live.opened[1:] == [str(held[0].folder), str(held[1].folder)]


@pytest.fixture
def trained(tmp_path, monkeypatch):
    made = Workstation(tmp_path / "case", masked_chest(), monkeypatch)
    yield made
    made.session.close()


def test_retrieved_series_does_not_end_a_running_task(trained, held, tmp_path):
    carina.pacs.PacsConnections().save(carina.pacs.PacsConnection("hospital", host="127.0.0.1", called_ae="PACS"))
    sent = []
    window = SimpleNamespace(number=1, at_machine=True, send=sent.append)
    number = trained.session.snapshot().case_number
    PacsRequests(trained.session).handle(wire.GetPacsSeries("hospital", STUDY, SERIES), window)
    until(lambda: len(held) == 1)
    trained.start("inspect-all")
    held[0].end.set()
    until(lambda: sent)
    assert [type(message) for message in sent] == [wire.Notice]
    assert "a task of the training is running" in sent[0].message
    assert trained.info.running is not None
    assert trained.session.snapshot().case_number == number


# -- sending a plan ----------------------------------------------------------------------------------------------------


def test_second_plan_is_refused_while_a_plan_is_sent_and_answers_name_their_target(live, monkeypatch, tmp_path):
    begun, end = held_job(monkeypatch, "store_files", carina.pacs.Stored(2, ()))
    monkeypatch.setattr(pacs_requests, "write_archive_files", lambda *_, **__: [])
    with live.window() as window:
        saved(window)
        window.send(wire.SendPlanToPacs("hospital", "target-1", ("seg",)))
        assert begun.wait(WAIT_S)
        # The job that has sent the connections may not have ended yet.
        assert SENDING in [job.title for job in live.session.jobs.running]
        window.send(wire.SendPlanToPacs("hospital", "target-2", ("seg",)))
        refused = problem(window)
        assert (refused.task, refused.code, refused.target_id) == ("send", "pacs.busy", "target-2")
        end.set()
        assert answer(window, wire.PacsSentMessage).target_id == "target-1"


def test_page_disables_its_button_by_the_title_of_the_job():
    page = Path(__file__).parents[2] / "web/src/state/pacs.ts"
    assert f'"{SENDING}"' in page.read_text()


def test_used_space_is_stated_while_a_retrieval_renames_files(live, monkeypatch):
    place = pacs_requests.retrieved_folder() / ".series-a.incomplete"
    place.mkdir(parents=True)
    (place / "a.dcm").write_bytes(bytes(10))
    (place / "b.draft").write_bytes(bytes(10))
    scan = os.scandir

    @contextlib.contextmanager
    def renaming(folder):
        with scan(folder) as entries:
            found = list(entries)
            (place / "b.draft").unlink()
            yield found

    monkeypatch.setattr(pacs_requests.os, "scandir", renaming)
    assert pacs_requests._bytes_in(place) == 10


def test_actions_of_the_command_line_are_replaced_by_those_of_the_window():
    sources = " ".join(path.read_text() for path in Path(carina.pacs.__file__).parent.glob("*.py"))
    plain = "".join(sources.replace('"\n', "\x00").split("\x00"))
    joined = " ".join(plain.replace('"', " ").split())
    for command, action in FOR_WINDOW:
        assert command in joined, command
        assert action in text_for_window(f"text; {command}")
    assert "--" not in text_for_window("give it with --ca-file")
